//! Bags of ROS 2, written byte by byte as MCAP and CDR specify them.

use super::{
    Answer, assert_rejected, assert_right_or_rejected, assert_staircase, import, staircase, with_file,
};

const START_NS: u64 = 1_764_000_000_123_000_000;

/// A record of MCAP.
fn record(file: &mut Vec<u8>, kind: u8, content: &[u8]) {
    file.push(kind);
    file.extend((content.len() as u64).to_le_bytes());
    file.extend(content);
}

fn string(text: &str) -> Vec<u8> {
    [&(text.len() as u32).to_le_bytes()[..], text.as_bytes()].concat()
}

/// A bag without chunks and without a summary: topics with their types, and messages as (topic, time, body).
fn bag(topics: &[(&str, &str)], messages: &[(u16, u64, Vec<u8>)]) -> Vec<u8> {
    let magic = b"\x89MCAP0\r\n";
    let mut file = magic.to_vec();
    record(&mut file, 1, &[string("ros2"), string("a stranger")].concat());
    for (index, (topic, kind)) in topics.iter().enumerate() {
        let id = (index as u16 + 1).to_le_bytes();
        let schema = [id.to_vec(), string(kind), string("ros2msg"), string("# left out")].concat();
        record(&mut file, 3, &schema);
        record(&mut file, 4, &[id.to_vec(), id.to_vec(), string(topic), string("cdr"), vec![0; 4]].concat());
    }
    for (sequence, (topic, time_ns, body)) in messages.iter().enumerate() {
        let time = time_ns.to_le_bytes();
        let head = [(topic + 1).to_le_bytes().to_vec(), (sequence as u32).to_le_bytes().to_vec()].concat();
        record(&mut file, 5, &[head, time.to_vec(), time.to_vec(), body.clone()].concat());
    }
    record(&mut file, 15, &[0; 4]);
    record(&mut file, 2, &[0; 20]);
    file.extend(magic);
    file
}

/// A message in CDR: every number is aligned to its own size, counted from behind the four bytes of the head.
struct Cdr {
    bytes: Vec<u8>,
    big: bool,
}

impl Cdr {
    fn new(big: bool) -> Self {
        Self { bytes: vec![0, u8::from(!big), 0, 0], big }
    }

    fn aligned<const N: usize>(mut self, little: [u8; N]) -> Self {
        while !(self.bytes.len() - 4).is_multiple_of(N) {
            self.bytes.push(0);
        }
        let ordered: Vec<u8> = if self.big { little.into_iter().rev().collect() } else { little.to_vec() };
        self.bytes.extend(ordered);
        self
    }

    fn u32(self, value: u32) -> Self {
        self.aligned(value.to_le_bytes())
    }

    fn f64(self, value: f64) -> Self {
        self.aligned(value.to_le_bytes())
    }

    fn text(self, text: &str) -> Self {
        let mut longer = self.u32(text.len() as u32 + 1);
        longer.bytes.extend(text.as_bytes());
        longer.bytes.push(0);
        longer
    }

    /// `std_msgs/Header`.
    fn header(self, time_ns: u64, frame: &str) -> Self {
        self.u32((time_ns / 1_000_000_000) as u32).u32((time_ns % 1_000_000_000) as u32).text(frame)
    }
}

fn wrench(big: bool, stamp_ns: u64, frame: &str, force_n: f64) -> Vec<u8> {
    let numbers = [0.3, force_n, -4.0, 0.01, 0.02, 0.03];
    numbers.iter().fold(Cdr::new(big).header(stamp_ns, frame), |cdr, value| cdr.f64(*value)).bytes
}

fn joints(big: bool, stamp_ns: u64, named: &[(&str, f64)]) -> Vec<u8> {
    let mut cdr = Cdr::new(big).header(stamp_ns, "").u32(named.len() as u32);
    for (name, _) in named {
        cdr = cdr.text(name);
    }
    cdr = cdr.u32(named.len() as u32);
    for (_, position) in named {
        cdr = cdr.f64(*position);
    }
    cdr.u32(0).u32(0).bytes
}

const TOPICS: [(&str, &str); 2] =
    [("/ft", "geometry_msgs/msg/WrenchStamped"), ("/joint_states", "sensor_msgs/msg/JointState")];

/// The staircase as two topics, each message as these functions write it: row number, time, value.
fn staircase_as(
    force: impl Fn(usize, u64, f64) -> Vec<u8>,
    stage: impl Fn(usize, u64, f64) -> Vec<u8>,
) -> Vec<u8> {
    let mut messages = Vec::new();
    for (row, [time_s, displacement_mm, force_n]) in staircase().iter().enumerate() {
        let time_ns = START_NS + (1e9 * time_s).round() as u64;
        messages.push((0, time_ns, force(row, time_ns, *force_n)));
        messages.push((1, time_ns, stage(row, time_ns, 1e-3 * displacement_mm)));
    }
    bag(&TOPICS, &messages)
}

fn table(bag: Vec<u8>) -> Answer {
    let maps =
        ["--map", "/ft:force.y=force_y_n", "--map", "/joint_states:guide.position=displacement_y_mm:m"];
    import(
        with_file("run.mcap", bag),
        &[&["table", "run.mcap", "--depth-mm", "30", "--yes"][..], &maps].concat(),
    )
}

fn right(answer: &Answer) {
    assert_staircase(answer, 120);
}

#[test]
fn joints_that_change_their_order() {
    right(&table(staircase_as(
        |_, time, force| wrench(false, time, "sensor", force),
        |row, time, position| {
            let mut named = [("rail", 0.2), ("guide", position), ("gripper", 7e-4)];
            named.rotate_left(row % 3);
            joints(false, time, &named)
        },
    )));
}

#[test]
fn numbers_with_the_most_significant_byte_first() {
    let bag = staircase_as(
        |_, time, force| wrench(true, time, "sensor", force),
        |_, time, position| joints(true, time, &[("guide", position)]),
    );
    assert_right_or_rejected(&table(bag), &["CDR", "big", "endian"], right);
}

#[test]
fn headers_that_were_never_stamped() {
    let bag = staircase_as(
        |_, _, force| wrench(false, 0, "sensor", force),
        |_, time, position| joints(false, time, &[("guide", position)]),
    );
    assert_right_or_rejected(&table(bag), &["stamp", "time"], right);
}

#[test]
fn two_frames_in_one_topic() {
    // Every second force is stated in another frame, in which y is turned round.
    let bag = staircase_as(
        |row, time, force| {
            if row % 2 == 0 {
                wrench(false, time, "sensor", force)
            } else {
                wrench(false, time, "base", -force)
            }
        },
        |_, time, position| joints(false, time, &[("guide", position)]),
    );
    assert_rejected(&table(bag), &["frame"]);
}

#[test]
fn a_joint_without_a_position() {
    let bag = staircase_as(
        |_, time, force| wrench(false, time, "sensor", force),
        |row, time, position| {
            let cdr = Cdr::new(false).header(time, "").u32(1).text("guide");
            if row % 25 == 7 {
                cdr.u32(0).u32(1).f64(9.0).u32(0).bytes
            } else {
                cdr.u32(1).f64(position).u32(0).u32(0).bytes
            }
        },
    );
    assert_right_or_rejected(&table(bag), &["position"], |answer| assert_staircase(answer, 110));
}
