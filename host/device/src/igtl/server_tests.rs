//! Peers of the server: too many, too talkative, and ones that send parts of messages and leave.

use super::message::{Content, Message};
use super::server::{ClientChange, MAX_CLIENTS};
use super::{Publisher, wire::Decoder};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::io::{ErrorKind, Read, Write};
use std::net::TcpStream;
use std::time::{Duration, Instant};

const LIMIT: Duration = Duration::from_secs(20);

fn serve(max_clients: usize) -> Publisher {
    Publisher::bind("127.0.0.1:0".parse().expect("an address"), max_clients).expect("binds")
}

fn text(number: u64) -> Message {
    Message {
        device: "Guide".to_owned(),
        stamp: Duration::from_millis(number),
        content: Content::Text(number.to_string()),
    }
}

fn eventually(what: &str, mut is_so: impl FnMut() -> bool) {
    let deadline = Instant::now() + LIMIT;
    while !is_so() {
        assert!(Instant::now() < deadline, "{what}");
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// Whether the server has closed a connection.
fn is_closed(stream: &mut TcpStream) -> bool {
    stream.set_read_timeout(Some(Duration::from_millis(20))).expect("a timeout");
    match stream.read(&mut [0; 64]) {
        Ok(count) => count == 0,
        Err(error) => !matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut),
    }
}

#[test]
fn more_clients_than_allowed_are_rejected_and_every_change_is_reported() {
    let publisher = serve(2);
    fn connect(publisher: &Publisher) -> TcpStream {
        TcpStream::connect(publisher.address()).expect("connects")
    }
    let first = connect(&publisher);
    let _second = connect(&publisher);
    eventually("two clients", || publisher.clients() == 2);
    let mut third = connect(&publisher);
    eventually("the third is rejected", || is_closed(&mut third));
    let first_address = first.local_addr().expect("an address");
    drop(first);
    eventually("one has left", || publisher.clients() == 1);
    let _fourth = connect(&publisher);
    eventually("its place is taken", || publisher.clients() == 2);
    let mut changes = Vec::new();
    eventually("five changes", || {
        changes.extend(publisher.client_changes());
        changes.len() == 5
    });
    fn count(wanted: ClientChange, changes: &[(std::net::SocketAddr, ClientChange)]) -> usize {
        changes.iter().filter(|(_, change)| *change == wanted).count()
    }
    assert_eq!(
        (count(ClientChange::Connected, &changes), count(ClientChange::Rejected, &changes)),
        (3, 1),
        "{changes:?}"
    );
    assert!(changes.contains(&(first_address, ClientChange::Left)), "{changes:?}");
}

#[test]
fn a_client_that_sends_without_end_is_disconnected() {
    let publisher = serve(MAX_CLIENTS);
    let mut flood = TcpStream::connect(publisher.address()).expect("connects");
    flood.set_write_timeout(Some(Duration::from_millis(100))).expect("a timeout");
    let message = Message { content: Content::Text("x".repeat(30_000)), ..text(1) }.to_bytes();
    let began = Instant::now();
    while flood.write_all(&message).is_ok() {
        assert!(began.elapsed() < LIMIT, "it still takes messages");
    }
    eventually("it is left", || publisher.clients() == 0);
}

/// Parts of messages, damaged ones and whole ones, in pieces, from peers that come and go: a sound client receives every message
/// meanwhile, and no peer keeps its place.
#[test]
fn peers_that_send_parts_of_messages_do_not_disturb_others() {
    let publisher = serve(MAX_CLIENTS);
    let mut sound = TcpStream::connect(publisher.address()).expect("connects");
    sound.set_read_timeout(Some(Duration::from_millis(500))).expect("a timeout");
    eventually("one client", || publisher.clients() == 1);
    let mut random = ChaCha8Rng::seed_from_u64(8);
    let (mut decoder, mut received, mut peers) = (Decoder::default(), 0u64, Vec::new());
    const MESSAGES: u64 = 40;
    for number in 1..=MESSAGES {
        let mut bytes = text(number).to_bytes();
        for _ in 0..random.random_range(0..4) {
            let flipped = random.random_range(0..bytes.len());
            bytes[flipped] = random.random();
        }
        bytes.truncate(random.random_range(0..=bytes.len()));
        let mut peer = TcpStream::connect(publisher.address()).expect("connects");
        for piece in bytes.chunks(random.random_range(1..40)) {
            // It may have been left in the middle.
            if peer.write_all(piece).is_err() {
                break;
            }
        }
        if random.random_range(0..3) == 0 {
            peers.push(peer);
            peers.drain(..peers.len().saturating_sub(3));
        }
        publisher.publish(&[text(number)]);
        let mut buffer = [0; 4096];
        while received < number {
            let count = sound.read(&mut buffer).expect("the sound client is served");
            assert!(count > 0, "the sound client was left");
            decoder.feed(&buffer[..count], |_| received += 1).expect("sound messages");
        }
    }
    assert_eq!(received, MESSAGES);
    drop(peers);
    eventually("the peers have left", || publisher.clients() == 1);
}
