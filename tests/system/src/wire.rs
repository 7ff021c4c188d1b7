//! A line with errors between the firmware's serial port and its host.
//!
//! [`NoisyWire`] opens the firmware's line and offers a pseudo terminal in its stead. Bytes go through unchanged and at
//! once, unless set otherwise: bits flip at a given rate, the cable is cut and mended, a faulty host sends random
//! bytes. The flipped bits come from a seed; their positions depend only on the number of bits before them.

use crate::pty::{self, Pty, wait};
use anyhow::{Context, Result};
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rustix::event::{PollFlags, Timespec};
use rustix::io::Errno;
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

/// Interval at which the threads read the controls while no bytes come.
const TIMEOUT: Timespec = Timespec { tv_sec: 0, tv_nsec: 5_000_000 };
/// The same while a host babbles.
const BABBLE_TIMEOUT: Timespec = Timespec { tv_sec: 0, tv_nsec: 1_000_000 };
/// Most bytes taken at once.
const CHUNK_BYTES: usize = 1024;

/// Direction of bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Direction {
    /// From the host to the firmware.
    ToDevice,
    /// From the firmware to the host.
    ToHost,
}

/// Counts of a direction.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Counters {
    /// Bytes that came out at the other end, babble not included.
    pub bytes: u64,
    /// Bits of them that came out wrong.
    pub flipped_bits: u64,
    /// Bytes that went in and never came out.
    pub dropped: u64,
    /// Bytes that no host sent.
    pub babbled: u64,
}

/// One direction's controls and counters.
#[derive(Debug)]
struct Lane {
    errors: BitErrors,
    counters: Counters,
}

#[derive(Debug)]
struct Shared {
    to_device: Mutex<Lane>,
    to_host: Mutex<Lane>,
    babble_per_ms: Mutex<f64>,
    cut: AtomicBool,
    stop: AtomicBool,
}

impl Shared {
    fn lane(&self, direction: Direction) -> MutexGuard<'_, Lane> {
        lock(match direction {
            Direction::ToDevice => &self.to_device,
            Direction::ToHost => &self.to_host,
        })
    }

    fn is_cut(&self) -> bool {
        self.cut.load(Ordering::Acquire)
    }

    fn stops(&self) -> bool {
        self.stop.load(Ordering::Acquire)
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The cable. Dropping it takes it away.
#[derive(Debug)]
pub struct NoisyWire {
    shared: Arc<Shared>,
    device: Arc<OwnedFd>,
    host: Arc<Pty>,
    workers: Vec<JoinHandle<()>>,
}

impl NoisyWire {
    /// A perfect cable to the line at this path.
    ///
    /// # Errors
    /// Where it cannot be opened, or another one cannot be made.
    pub fn connect(device: &Path, seed: u64) -> Result<Self> {
        let device = pty::open(device)?;
        let host = Pty::open().context("cannot make a pseudo terminal")?;
        let shared = Arc::new(Shared {
            to_device: lane(0, seed),
            to_host: lane(1, seed),
            babble_per_ms: Mutex::new(0.0),
            cut: AtomicBool::new(false),
            stop: AtomicBool::new(false),
        });
        let (device, host) = (Arc::new(device), Arc::new(host));
        let worker = |name: &str, run: fn(&Shared, BorrowedFd<'_>, BorrowedFd<'_>, u64)| {
            let (shared, device, host) = (Arc::clone(&shared), Arc::clone(&device), Arc::clone(&host));
            thread::Builder::new()
                .name(name.into())
                .spawn(move || run(&shared, device.as_fd(), host.master.as_fd(), seed))
        };
        let workers = vec![worker("wire to device", to_device)?, worker("wire to host", to_host)?];
        Ok(Self { shared, device, host, workers })
    }

    /// The near end, as `guide` takes it.
    pub fn port(&self) -> String {
        self.host.name.clone()
    }

    /// Flips each bit of a direction with this probability from now on.
    pub fn bit_error_rate(&self, direction: Direction, rate: f64) {
        self.shared.lane(direction).errors.set_rate(rate);
    }

    /// Pulls the cable: nothing goes through, and what was under way or waited to be read is lost.
    pub fn cut(&self) {
        self.shared.cut.store(true, Ordering::Release);
        for end in [self.device.as_fd(), self.host.slave.as_fd()] {
            pty::discard(end);
        }
    }

    /// Plugs it in again.
    pub fn mend(&self) {
        self.shared.cut.store(false, Ordering::Release);
    }

    /// Sends so many random bytes per millisecond to the device, as far as it takes them; 0 ends it.
    pub fn babble(&self, bytes_per_ms: f64) {
        *lock(&self.shared.babble_per_ms) = bytes_per_ms;
    }

    /// Counts of a direction.
    pub fn counters(&self, direction: Direction) -> Counters {
        self.shared.lane(direction).counters
    }
}

fn lane(number: u64, seed: u64) -> Mutex<Lane> {
    Mutex::new(Lane { errors: BitErrors::new(seed, number), counters: Counters::default() })
}

impl Drop for NoisyWire {
    fn drop(&mut self) {
        self.shared.stop.store(true, Ordering::Release);
        for worker in self.workers.drain(..) {
            let _ = worker.join();
        }
    }
}

fn to_host(shared: &Shared, device: BorrowedFd<'_>, host: BorrowedFd<'_>, _seed: u64) {
    while !shared.stops() {
        carry(shared, Direction::ToHost, device, host, &TIMEOUT);
    }
}

fn to_device(shared: &Shared, device: BorrowedFd<'_>, host: BorrowedFd<'_>, seed: u64) {
    let mut random = stream(seed, 2);
    let (mut last, mut owed) = (Instant::now(), 0.0);
    while !shared.stops() {
        let babble_rate = *lock(&shared.babble_per_ms);
        let timeout = if babble_rate > 0.0 { &BABBLE_TIMEOUT } else { &TIMEOUT };
        carry(shared, Direction::ToDevice, host, device, timeout);
        let now = Instant::now();
        owed += babble_rate * (now - last).as_secs_f64() * 1e3;
        last = now;
        let mut nonsense = vec![0; (owed as usize).min(CHUNK_BYTES)];
        owed -= owed.floor();
        random.fill_bytes(&mut nonsense);
        if !nonsense.is_empty() && !shared.is_cut() {
            let mut lane = shared.lane(Direction::ToDevice);
            lane.counters.babbled += rustix::io::write(device, &nonsense).unwrap_or_default() as u64;
        }
    }
}

/// Takes what there is at one end, waiting a little for it, to the other.
fn carry(
    shared: &Shared,
    direction: Direction,
    from: BorrowedFd<'_>,
    to: BorrowedFd<'_>,
    timeout: &Timespec,
) {
    let mut buffer = [0; CHUNK_BYTES];
    if !wait(from, PollFlags::IN, timeout) {
        return;
    }
    let bytes = match rustix::io::read(from, &mut buffer) {
        Ok(length) => &mut buffer[..length],
        Err(Errno::AGAIN | Errno::INTR) => return,
        Err(_) => &mut [],
    };
    if bytes.is_empty() {
        // The far end has gone, and reads return at once each time.
        thread::sleep(Duration::from_millis(5));
        return;
    }
    let flipped = shared.lane(direction).errors.apply(bytes);
    let mut unsent = &*bytes;
    while !unsent.is_empty() && !shared.is_cut() && !shared.stops() {
        if wait(to, PollFlags::OUT, timeout) {
            // Held while they are written: what has been read is counted.
            let mut lane = shared.lane(direction);
            let written = rustix::io::write(to, unsent).unwrap_or_default();
            unsent = &unsent[written..];
            lane.counters.bytes += written as u64;
            lane.counters.flipped_bits += if unsent.is_empty() { flipped } else { 0 };
        }
    }
    shared.lane(direction).counters.dropped += unsent.len() as u64;
}

/// Rule for the bits that flip: each with the same probability, independent of all others. The distance to the next
/// one is drawn instead of every bit.
#[derive(Debug)]
struct BitErrors {
    rate: f64,
    /// Bits that stay right before the next wrong one.
    right_bits: u64,
    random: ChaCha8Rng,
}

impl BitErrors {
    fn new(seed: u64, number: u64) -> Self {
        Self { rate: 0.0, right_bits: u64::MAX, random: stream(seed, number) }
    }

    fn set_rate(&mut self, rate: f64) {
        self.rate = rate;
        self.right_bits = self.draw();
    }

    /// A geometric number: how many bits stay right.
    fn draw(&mut self) -> u64 {
        if self.rate <= 0.0 {
            return u64::MAX;
        }
        // In (0, 1]; a rate of 1 makes the denominator infinite and the distance 0. The cast saturates.
        let uniform = 1.0 - self.random.random::<f64>();
        (uniform.ln() / (-self.rate).ln_1p()) as u64
    }

    /// Flips bits; returns how many.
    fn apply(&mut self, bytes: &mut [u8]) -> u64 {
        let bits = 8 * bytes.len() as u64;
        let mut flipped = 0;
        let mut bit_position = self.right_bits;
        while bit_position < bits {
            bytes[(bit_position / 8) as usize] ^= 1 << (bit_position % 8);
            flipped += 1;
            bit_position = self.draw().saturating_add(bit_position + 1);
        }
        self.right_bits = if self.rate > 0.0 { bit_position - bits } else { u64::MAX };
        flipped
    }
}

fn stream(seed: u64, number: u64) -> ChaCha8Rng {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    random.set_stream(number);
    random
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::qemu::HANGS;

    /// A cable between two pseudo terminals; the first is the device's, the second a user's view of the near end.
    fn cable(seed: u64) -> (Pty, NoisyWire, OwnedFd) {
        let device = Pty::open().unwrap();
        let wire = NoisyWire::connect(Path::new(&device.name), seed).unwrap();
        let host = pty::open(Path::new(&wire.port())).unwrap();
        (device, wire, host)
    }

    /// Reads so many bytes.
    fn receive(from: BorrowedFd<'_>, count: usize) -> Vec<u8> {
        receive_within(from, count, &Timespec { tv_sec: HANGS.as_secs() as i64, tv_nsec: 0 })
    }

    /// Whether nothing comes for a while.
    fn is_silent(from: BorrowedFd<'_>) -> bool {
        receive_within(from, 1, &Timespec { tv_sec: 0, tv_nsec: 300_000_000 }).is_empty()
    }

    /// Reads what comes until nothing has for so long, or the count is reached.
    fn receive_within(from: BorrowedFd<'_>, count: usize, timeout: &Timespec) -> Vec<u8> {
        let mut bytes = Vec::new();
        let mut buffer = [0; 4096];
        while bytes.len() < count && wait(from, PollFlags::IN, timeout) {
            let length = rustix::io::read(from, &mut buffer).unwrap_or_default();
            bytes.extend_from_slice(&buffer[..length]);
        }
        bytes
    }

    /// Sends through one end and returns what comes out at the other.
    fn through(from: BorrowedFd<'_>, to: BorrowedFd<'_>, bytes: &[u8]) -> Vec<u8> {
        let mut passed = Vec::new();
        for chunk in bytes.chunks(512) {
            assert_eq!(rustix::io::write(from, chunk), Ok(chunk.len()));
            passed.extend(receive(to, chunk.len()));
        }
        passed
    }

    fn pattern(count: usize) -> Vec<u8> {
        (0..count).map(|i| (i * 31 + i / 256) as u8).collect()
    }

    fn eventually(mut holds: impl FnMut() -> bool) {
        let began = Instant::now();
        while !holds() {
            assert!(began.elapsed() < HANGS, "never");
            thread::sleep(Duration::from_millis(2));
        }
    }

    #[test]
    fn a_good_cable_changes_nothing_either_way() {
        let (device, wire, host) = cable(1);
        let sent = pattern(20_000);
        assert_eq!(through(device.master.as_fd(), host.as_fd(), &sent), sent);
        assert_eq!(through(host.as_fd(), device.master.as_fd(), &sent), sent);
        let expected = Counters { bytes: 20_000, ..Counters::default() };
        assert_eq!(wire.counters(Direction::ToHost), expected);
        assert_eq!(wire.counters(Direction::ToDevice), expected);
    }

    #[test]
    fn bits_flip_at_the_rate_in_one_direction_only() {
        let (device, wire, host) = cable(2);
        wire.bit_error_rate(Direction::ToHost, 1e-3);
        let sent = pattern(50_000);
        let received = through(device.master.as_fd(), host.as_fd(), &sent);
        let wrong: u32 =
            sent.iter().zip(&received).map(|(sent, received)| (sent ^ received).count_ones()).sum();
        assert_eq!(received.len(), sent.len());
        assert_eq!(wire.counters(Direction::ToHost).flipped_bits, u64::from(wrong));
        // 400 expected, standard deviation 20.
        assert!((320..480).contains(&wrong), "{wrong} bits of 400000 flipped");
        assert_eq!(through(host.as_fd(), device.master.as_fd(), &sent), sent);
    }

    #[test]
    fn errors_come_from_the_seed_however_the_bytes_are_cut() {
        assert_eq!(flipped(3, 4_000), flipped(3, 7));
        assert_ne!(flipped(3, 4_000), flipped(4, 4_000));
        let mut whole_stream = BitErrors::new(5, 0);
        whole_stream.set_rate(1.0);
        let mut bytes = [0; 3];
        assert_eq!((whole_stream.apply(&mut bytes), bytes), (24, [0xFF; 3]));
    }

    fn flipped(seed: u64, chunk: usize) -> Vec<u8> {
        let (mut errors, mut bytes) = (BitErrors::new(seed, 0), vec![0; 4_000]);
        errors.set_rate(0.01);
        bytes.chunks_mut(chunk).for_each(|chunk| {
            errors.apply(chunk);
        });
        bytes
    }

    #[test]
    fn a_cut_cable_loses_everything_until_it_is_reconnected() {
        let (device, wire, host) = cable(6);
        rustix::io::write(&device.master, b"unread").unwrap();
        eventually(|| wire.counters(Direction::ToHost).bytes == 6);
        // They are in the terminal's queue as soon as they can be read.
        assert!(wait(host.as_fd(), PollFlags::IN, &Timespec { tv_sec: HANGS.as_secs() as i64, tv_nsec: 0 }));
        wire.cut();
        rustix::io::write(&device.master, b"lost").unwrap();
        rustix::io::write(&host, b"lost").unwrap();
        for direction in [Direction::ToHost, Direction::ToDevice] {
            eventually(|| wire.counters(direction).dropped == 4);
        }
        assert!(is_silent(host.as_fd()) && is_silent(device.master.as_fd()));
        wire.mend();
        assert_eq!(through(device.master.as_fd(), host.as_fd(), b"back"), b"back");
        assert_eq!(through(host.as_fd(), device.master.as_fd(), b"again"), b"again");
    }

    #[test]
    fn a_mad_host_babbles_at_its_rate() {
        let (device, wire, _host) = cable(7);
        wire.babble(10.0);
        let began = Instant::now();
        let received = receive(device.master.as_fd(), 2_000);
        wire.babble(0.0);
        assert_eq!(received.len() / 2_000, 1);
        assert!(began.elapsed() >= Duration::from_millis(150), "2000 bytes in {:?}", began.elapsed());
        assert!(wire.counters(Direction::ToDevice).babbled >= received.len() as u64);
    }
}
