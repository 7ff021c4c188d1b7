//! `guide capture`: ultrasound frames of a scanner that sends them over OpenIGTLink, as a sequence.

use super::output::Output;
use super::rig_args::interrupted;
use anyhow::{Context, bail};
use device::igtl::capture::{Capture, Captured};
use device::igtl::source::ConnectionEvent;
use device::igtl::{Content, Source};
use serde::Serialize;
use std::collections::BTreeSet;
use std::fmt::{self, Display};
use std::path::PathBuf;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

/// Interval at which messages that have arrived are taken.
const POLL_INTERVAL: Duration = Duration::from_millis(5);
/// Most different remarks: their words come from the peer.
const MAX_NOTES: usize = 16;

/// Record ultrasound frames that a scanner or PLUS server sends over OpenIGTLink
#[derive(clap::Args)]
#[command(group = clap::ArgGroup::new("end").args(["duration_s", "frames"]).required(true).multiple(true))]
#[command(after_help = "Example:\n  guide capture --igtl plus.local --duration-s 20 --out frames\n  \
                        guide acquire --port /dev/ttyACM0 --out phantom-e --depth-mm 30 --rig rig.toml --program staircase \\\n    \
                        --frames-command 'guide capture --igtl plus.local --duration-s 2.5 --out phantom-e/frames'")]
pub struct Args {
    /// OpenIGTLink server that sends IMAGE messages (port 18944 unless given)
    #[arg(long, value_name = "HOST")]
    igtl: String,
    /// Device name of the IMAGE messages (default: that of the first)
    #[arg(long, value_name = "NAME")]
    image: Option<String>,
    /// Longest duration, seconds
    #[arg(long, value_name = "SECONDS", value_parser = seconds)]
    duration_s: Option<f64>,
    /// Largest number of frames
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=100_000))]
    frames: Option<u32>,
    /// Folder in which the sequence is kept, under a new name
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

fn seconds(text: &str) -> Result<f64, String> {
    let value = text.parse().ok().filter(|value| (0.1..=3600.0).contains(value));
    value.ok_or_else(|| "expected a number from 0.1 to 3600".to_owned())
}

#[derive(Serialize)]
struct Report {
    schema: &'static str,
    image: String,
    #[serde(flatten)]
    captured: Captured,
    /// Frames that had arrived and were not taken in time.
    dropped: u64,
}

impl Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Captured { path, frames, rate_hz, lost, other } = &self.captured;
        let rate = rate_hz.map_or_else(String::new, |rate_hz| format!(", {rate_hz:.1} per second"));
        writeln!(f, "frames     {frames} of {}{rate}", self.image)?;
        writeln!(f, "lost       {lost} by their stamps, {} of them here", self.dropped)?;
        if *other > 0 {
            writeln!(f, "other size {other}, not in the sequence")?;
        }
        writeln!(f, "{}", path.display())
    }
}

/// Runs `guide capture`.
pub fn run(args: &Args, out: &mut Output) -> anyhow::Result<()> {
    let source = Source::connect_images(&args.igtl)?;
    let interrupted = interrupted()?;
    let cannot = || format!("{}: cannot write", args.out.display());
    let mut capture = Capture::create(&args.out).with_context(cannot)?;
    let (mut image, mut noted) = (args.image.clone(), BTreeSet::new());
    let began = Instant::now();
    let most = args.frames.map_or(usize::MAX, |frames| frames as usize);
    let is_over = || {
        let is_late = args.duration_s.is_some_and(|most_s| began.elapsed().as_secs_f64() >= most_s);
        is_late || interrupted.load(Ordering::Acquire)
    };
    let mut has_room = true;
    while has_room && capture.frames() < most && !is_over() {
        for news in source.news() {
            if !has_room || capture.frames() >= most {
                break;
            }
            let note = match news {
                ConnectionEvent::Message(message, _) => match message.content {
                    Content::Image(frame) if image.as_ref().is_none_or(|name| *name == message.device) => {
                        image.get_or_insert_with(|| message.device.clone());
                        let stamp = if message.stamp.is_zero() { now() } else { message.stamp };
                        has_room = capture.add(&frame, stamp).with_context(cannot)?;
                        None
                    }
                    other => Some(format!("{} `{}` is not used", other.kind(), message.device)),
                },
                ConnectionEvent::Unreadable(why) => Some(format!("a message is skipped: {why}")),
                ConnectionEvent::Skipped(kind, device) => Some(format!("{kind} `{device}` is not used")),
                ConnectionEvent::Invalid(kind, device, stated) => {
                    Some(format!("{kind} `{device}` is not used while it is not valid: {stated}"))
                }
                ConnectionEvent::Lost(why) => {
                    Some(format!("the connection is lost: {why}; it is tried again"))
                }
                ConnectionEvent::Back => Some("the connection is there again".to_owned()),
            };
            if let Some(note) = note
                && noted.len() < MAX_NOTES
                && noted.insert(note.clone())
            {
                out.note(format_args!("OpenIGTLink at {}: {note}", source.address()));
            }
        }
        std::thread::sleep(POLL_INTERVAL);
    }
    let dropped = source.dropped();
    let Some(captured) = capture.finish().with_context(cannot)? else {
        let name = args.image.as_ref().map_or_else(String::new, |name| format!(" `{name}`"));
        bail!(
            "no IMAGE{name} came from {} in {:.1} s, expected one or more: is the scanner running, and is --image its device name?",
            source.address(),
            began.elapsed().as_secs_f64()
        );
    };
    let report = Report { schema: "guide.capture/1", image: image.unwrap_or_default(), captured, dropped };
    out.result(&report, &report)
}

/// Some senders state no time.
fn now() -> Duration {
    SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default()
}
