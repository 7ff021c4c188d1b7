//! The live view for a long time, with a device that streams at its full rate.

use crate::driver::Browser;
use crate::served::Serving;
use anyhow::{Context, Result, ensure};
use fake_device::{Act, FakeDevice, Script};
use serde_json::{Value, json};
use std::fmt::Write;
use std::path::Path;
use std::time::{Duration, Instant};

/// Samples of a frame, as the firmware packs them.
const SAMPLES: usize = 32;
/// Pause between frames: with what a frame takes itself, a thousand samples a second and a little more.
const PAUSE_MS: u64 = 30;
/// Memory is compared from here on, when half a minute of traces is kept.
const SETTLED: Duration = Duration::from_secs(90);
/// The computer may be busy; what is tested is the page.
const SILENCE_MS: u32 = 30_000;

/// Milliseconds from the arrival of bytes to the end of the first drawing with what they contain, counted by the millisecond; the last
/// place is for all that are longer.
const WATCH: &str = "const of = window.measured = { waiting: [], decoded: [], delays: new Array(2001).fill(0) }; \
    const follow = engine.follow.bind(engine); \
    const receive = followLive; \
    followLive = (data) => { of.waiting.push(performance.now()); return receive(data); }; \
    engine.follow = async (...content) => { const these = of.waiting; of.waiting = []; const answer = await follow(...content); of.decoded.push(...these); return answer; }; \
    const draw = plot; \
    plot = (...content) => { draw(...content); const now = performance.now(); of.decoded.forEach((then) => { of.delays[Math.min(2000, Math.round(now - then))] += 1; }); of.decoded = []; };";

/// Checks that no data are lost, memory does not grow, and the picture follows.
///
/// # Errors
/// What is otherwise.
pub fn check(browser: &Browser, page: &Path, folder: &Path, minutes: u64) -> Result<String> {
    let pair = [Act::Batch(SAMPLES), Act::Wait(PAUSE_MS)];
    let frames = usize::try_from(minutes * 60_000 / PAUSE_MS)?;
    let mut program = pair.repeat(frames);
    program.push(Act::Complete);
    let device = FakeDevice::start(Script { program, silence_limit_ms: SILENCE_MS, ..Script::default() });
    let (_serving, address) = Serving::start(page, folder, &["--port", &device.port])?;
    browser.open(&format!("{address}#view=live"))?;
    browser.until("document.querySelector('#live-take') && live.last")?;
    browser.run(WATCH, json!([]))?;
    browser.press("#live-take", "\u{e007}")?;
    browser.until("!document.querySelector('fieldset').disabled")?;
    browser.press("fieldset button", "\u{e007}")?;
    browser.until("live.counts && live.counts.samples > 0")?;
    let began = Instant::now();
    let (mut settled, mut memory) = (None, Vec::new());
    while began.elapsed() < Duration::from_secs(60 * minutes) {
        std::thread::sleep(Duration::from_secs(15));
        if began.elapsed() > SETTLED {
            memory.push([browser.heap_bytes()?, browser.resident_bytes()]);
            settled = settled.or_else(|| memory.first().copied());
        }
    }
    let seconds = began.elapsed().as_secs_f64();
    let measured_text =
        browser.run("return JSON.stringify({ counts: live.counts, delays: measured.delays });", json!([]))?;
    let measured: Value = serde_json::from_str(measured_text.as_str().context("no counts")?)?;
    let counts = &measured["counts"];
    for lost in ["frames_missing", "samples_missing", "frames_corrupt", "frames_unreadable"] {
        ensure!(counts[lost] == json!(0), "{lost}: {counts}");
    }
    let samples = counts["samples"].as_f64().context("no samples")?;
    let delays: Vec<u64> = serde_json::from_value(measured["delays"].clone())?;
    let total: u64 = delays.iter().sum();
    let mut text = format!(
        "{samples} samples in {:.0} min ({:.0} a second), none lost; picture behind by",
        seconds / 60.0,
        samples / seconds
    );
    for (share, name) in [(0.5, "median"), (0.99, "99 %"), (1.0, "most")] {
        write!(text, " {} ms ({name})", quantile(share, total, &delays).context("nothing was drawn")?)?;
    }
    if let (Some(first), Some(last)) = (settled, memory.last()) {
        write!(
            text,
            "; heap of the page {:.1} MB after {} s and {:.1} MB at the end, all processes of the browser {:.0} and {:.0} MB",
            megabytes(first[0]),
            SETTLED.as_secs(),
            megabytes(last[0]),
            megabytes(first[1]),
            megabytes(last[1])
        )?;
    }
    Ok(text)
}

fn megabytes(bytes: u64) -> f64 {
    bytes as f64 / 1e6
}

fn quantile(share: f64, total: u64, delays: &[u64]) -> Option<usize> {
    let wanted_count = share * total as f64;
    let mut sum = 0;
    delays.iter().position(|count| {
        sum += count;
        sum as f64 >= wanted_count
    })
}
