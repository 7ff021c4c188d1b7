//! What must hold of every status, of the rig and of this process, at any time.

use crate::cosim::Reach;
use anyhow::{Result, ensure};
use protocol::{Counters, Status};

/// Bytes of the device's stack that have never been used, at least.
pub const STACK_LEAST_BYTES: u32 = 48 * 1024;
/// Entries of the outbox, as the firmware has them.
const OUTBOX_PLACES: u8 = 24;
/// How much this process may grow in [`WINDOW_MS`], bytes: less than a hundredth of the samples of that time.
pub const GROWTH_LIMIT_BYTES: u64 = 512 * 1024;
/// Time over which growth is checked, milliseconds of the rig's.
const WINDOW_MS: u64 = 600_000;
/// How often the size is sampled.
const SAMPLE_INTERVAL_MS: u64 = 1_000;
/// Travel with what a motor rolls on and the loop may overshoot, metres.
const TRAVEL_M: f64 = 10.2e-3;
/// Range of the force sensor with what is added while a motor that has been switched off rolls on, newtons.
const FORCE_N: f64 = 5.5;

/// What was last reported.
#[derive(Debug, Default)]
pub struct Watch {
    counters: Counters,
    /// Late periods have a cause since the device started.
    may_be_late: bool,
    /// Least free stack and most entries of the outbox, over all starts.
    pub stack_free_bytes: Option<u32>,
    /// As the device reports.
    pub outbox_most: u8,
    /// Late periods of all starts that are over.
    overruns_before: u32,
    /// Messages dropped in those.
    dropped_before: u32,
    /// Furthest and hardest of the whole run.
    pub reach: Reach,
}

impl Watch {
    /// The device has started again.
    pub fn restarted(&mut self) {
        self.overruns_before += self.counters.control_overruns;
        self.dropped_before += self.counters.messages_dropped;
        (self.counters, self.may_be_late) = (Counters::default(), false);
    }

    /// Something makes control late.
    pub fn may_be_late(&mut self) {
        self.may_be_late = true;
    }

    /// Late periods, each with a cause.
    pub fn overruns(&self) -> u32 {
        self.overruns_before + self.counters.control_overruns
    }

    /// Answers and events without room.
    pub fn messages_dropped(&self) -> u32 {
        self.dropped_before + self.counters.messages_dropped
    }

    /// A status.
    ///
    /// # Errors
    /// Where a counter has gone back, control was late without a cause, or memory is short.
    pub fn status(&mut self, status: &Status) -> Result<()> {
        let (before, now) = (list(&self.counters), list(&status.counters));
        for ((name, before), (_, now)) in before.into_iter().zip(now) {
            ensure!(now >= before, "the counter {name} has gone back from {before} to {now}");
        }
        self.counters = status.counters;
        let late = status.counters.control_overruns;
        ensure!(late == 0 || self.may_be_late, "{late} late control periods without a cause");
        // None before it has been measured.
        let free = status.load.stack_free_bytes;
        if free > 0 {
            ensure!(free >= STACK_LEAST_BYTES, "only {free} bytes of the device's stack are free");
            self.stack_free_bytes = Some(self.stack_free_bytes.map_or(free, |least| least.min(free)));
        }
        let most = status.load.outbox_most;
        ensure!(most <= OUTBOX_PLACES, "{most} places taken of {OUTBOX_PLACES}");
        self.outbox_most = self.outbox_most.max(most);
        Ok(())
    }

    /// Where the guide has been.
    ///
    /// # Errors
    /// Where that is too far, or it was pressed too hard.
    pub fn reach(&mut self, reach: Reach) -> Result<()> {
        let Reach { position_m, force_n } = reach;
        ensure!(position_m <= TRAVEL_M, "the guide was {} mm from the middle", position_m * 1e3);
        ensure!(force_n <= FORCE_N, "the guide was pressed with {force_n} N");
        self.reach.position_m = self.reach.position_m.max(position_m);
        self.reach.force_n = self.reach.force_n.max(force_n);
        Ok(())
    }
}

fn list(counters: &Counters) -> [(&'static str, u32); 13] {
    [
        ("samples_dropped", counters.samples_dropped),
        ("messages_dropped", counters.messages_dropped),
        ("frames_corrupt", counters.frames_corrupt),
        ("frames_overlong", counters.frames_overlong),
        ("frames_unreadable", counters.frames_unreadable),
        ("force_readings_bad", counters.force_readings_bad),
        ("control_overruns", counters.control_overruns),
        ("line_errors", counters.line_errors),
        ("force_corrupt", counters.force_corrupt),
        ("force_missing", counters.force_missing),
        ("force_resets", counters.force_resets),
        ("force_saturated", counters.force_saturated),
        ("faults", counters.faults),
    ]
}

/// The size of a process over time.
#[derive(Debug)]
pub struct Memory {
    process: u32,
    from_ms: u64,
    next_ms: u64,
    window: Option<(u64, u64)>,
    /// After warming up, and last.
    pub first_bytes: Option<u64>,
    /// The latest.
    pub last_bytes: Option<u64>,
}

impl Memory {
    /// This process: growth counts from this time on.
    pub fn new(from_ms: u64) -> Self {
        Self::of(std::process::id(), from_ms)
    }

    /// The process of this number.
    pub fn of(process: u32, from_ms: u64) -> Self {
        Self { process, from_ms, next_ms: from_ms, window: None, first_bytes: None, last_bytes: None }
    }

    /// Samples it now and then.
    ///
    /// # Errors
    /// Where it has grown by more than it may.
    pub fn sample(&mut self, now_ms: u64) -> Result<()> {
        if now_ms < self.next_ms {
            return Ok(());
        }
        self.next_ms = now_ms + SAMPLE_INTERVAL_MS;
        self.last_bytes = resident_bytes(self.process);
        let Some(bytes) = self.last_bytes else { return Ok(()) };
        self.first_bytes.get_or_insert(bytes);
        let &mut (since_ms, least) = self.window.get_or_insert((self.from_ms, bytes));
        ensure!(
            bytes <= least + GROWTH_LIMIT_BYTES,
            "process {} has grown from {least} to {bytes} bytes in {} s of the rig",
            self.process,
            (now_ms - since_ms) / 1_000
        );
        if now_ms >= since_ms + WINDOW_MS {
            self.window = Some((now_ms, bytes));
        }
        Ok(())
    }
}

/// Memory of a process that is in use; `None` where the system does not report it.
fn resident_bytes(process: u32) -> Option<u64> {
    let statm = std::fs::read_to_string(format!("/proc/{process}/statm")).ok()?;
    let pages: u64 = statm.split_whitespace().nth(1)?.parse().ok()?;
    Some(pages * rustix::param::page_size() as u64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_counter_that_goes_back_and_a_late_period_are_noticed() {
        let mut status = crate::soak::testing::idle();
        status.load.stack_free_bytes = STACK_LEAST_BYTES;
        status.counters.faults = 2;
        let mut watch = Watch::default();
        watch.status(&status).unwrap();
        status.counters.faults = 1;
        assert!(watch.status(&status).unwrap_err().to_string().contains("faults has gone back from 2 to 1"));
        watch.restarted();
        status.counters.control_overruns = 1;
        assert!(watch.status(&status).unwrap_err().to_string().contains("1 late control periods"));
        watch.may_be_late();
        watch.status(&status).unwrap();
        assert_eq!(watch.overruns(), 1);
        status.load.stack_free_bytes -= 1;
        assert!(watch.status(&status).is_err());
    }

    #[test]
    fn the_memory_of_a_process_is_known_where_the_system_reports_it() {
        if cfg!(target_os = "linux") {
            assert!(resident_bytes(std::process::id()).unwrap() > 100_000);
        }
        let mut memory = Memory::new(5);
        memory.sample(4).unwrap();
        assert_eq!(memory.first_bytes, None);
        memory.sample(5).unwrap();
        assert_eq!(memory.first_bytes, memory.last_bytes);
    }
}
