//! The view Live against a device for tests, which speaks the protocol at the far end of a pseudo terminal.

use crate::axe;
use crate::checks::WIDTHS;
use crate::driver::Browser;
use crate::served::Serving;
use crate::views;
use anyhow::{Context, Result, ensure};
use fake_device::{Act, FakeDevice, Script};
use protocol::Request;
use serde_json::json;
use std::path::Path;
use std::time::{Duration, Instant};

const ENTER: &str = "\u{e007}";
/// Samples of one program.
const SAMPLES: usize = 64;
/// Samples of a frame that does not arrive.
const LOST: usize = 16;
const HANGS: Duration = Duration::from_secs(30);

/// Frames of the device are decoded in the page and counted; control, motion and stop by keyboard; a page that is hidden gives up control.
///
/// # Errors
/// What is otherwise.
pub fn check(browser: &Browser, page: &Path, folder: &Path, is_pictured: bool) -> Result<String> {
    let device = FakeDevice::start(Script {
        program: vec![Act::Batch(32), Act::Lost(LOST), Act::Batch(32), Act::Complete],
        ..Script::default()
    });
    let (_serving, address) = Serving::start(page, folder, &["--port", &device.port])?;
    browser.open(&format!("{address}#view=live"))?;
    browser.until("document.querySelector('#live-take') && live.last")?;
    ensure!(
        browser.run("return document.querySelector('fieldset').disabled;", json!([]))? == json!(true),
        "motion is offered without control"
    );
    browser.press("#live-take", ENTER)?;
    browser.until("!document.querySelector('fieldset').disabled")?;
    browser.press("fieldset button", ENTER)?;
    wait("home", &|| count(|request| matches!(request, Request::Run { .. }), &device) > 0)?;
    browser.until(&format!("live.counts && live.counts.samples >= {SAMPLES}"))?;
    browser.until("live.points.length > 0 && document.querySelector('#main .plot .line')")?;
    let counts = browser.run("return JSON.stringify(live.counts);", json!([]))?;
    let counts: serde_json::Value = serde_json::from_str(counts.as_str().context("no counts")?)?;
    for (lost, expected) in
        [("frames_missing", 1), ("samples_missing", LOST), ("frames_corrupt", 0), ("frames_unreadable", 0)]
    {
        ensure!(counts[lost] == json!(expected), "{lost}: {counts}");
    }
    let stops = || count(|request| *request == Request::Stop, &device);
    let stops_before = stops();
    browser.press("#live-take", " ")?;
    wait("stop by the space bar", &|| stops() > stops_before)?;

    // Damaged or missing content is counted, and memory does not grow: the same frames again and
    // again. The page's own decoding rests meanwhile.
    let grows = "while (live.isFollowing) await new Promise((yes) => setTimeout(yes, 5)); live.isFollowing = true; \
        const bytes = new Uint8Array(20000).fill(7); const first = await engine.follow(bytes, true); \
        let last = first; for (let i = 0; i < 300; i += 1) last = await engine.follow(bytes, false); \
        live.isFollowing = false; \
        return [first.bytes, last.bytes, last.frames, last.columns.length];";
    let grown = browser.wait_for(grows, json!([]))?;
    ensure!(grown == json!([20_000, 6_020_000, 0, 0]), "{grown}");

    // Another page in front: this one is hidden.
    browser.run("Object.defineProperty(document, 'visibilityState', { value: 'hidden', configurable: true }); document.dispatchEvent(new Event('visibilitychange'));", json!([]))?;
    browser.until("live.last && live.last.control === 'none'")?;

    let mut accessible = "not checked by axe-core, which is not available";
    if let Some(script) = axe::script(folder)? {
        // With the motions on offer. The next run takes longer than a heartbeat may: control is lost, and nothing needs
        // it any more.
        browser.run(
            "Object.defineProperty(document, 'visibilityState', { value: 'visible', configurable: true });",
            json!([]),
        )?;
        browser.press("#live-take", ENTER)?;
        browser.until("!document.querySelector('fieldset').disabled")?;
        for scheme in ["light", "dark"] {
            browser.appear(1280, 900, scheme)?;
            let violations = axe::violations(browser, &script)?;
            ensure!(violations.is_empty(), "accessibility, {scheme}:\n  {}", violations.join("\n  "));
        }
        accessible = "without violations of axe-core, light and dark";
    }
    for scheme in ["light", "dark"].into_iter().filter(|_| is_pictured) {
        for width in WIDTHS {
            browser.appear(width, width * 10 / 16, scheme)?;
            views::picture(browser, &folder.join("pictures"), "live", width, scheme)?;
        }
    }
    browser.appear(1280, 900, "light")?;
    Ok(format!(
        "{} samples of {} frames decoded in the page, the lost frame of {LOST} samples counted; control, home and stop by keyboard; hidden, it gives up control; {accessible}",
        counts["samples"], counts["frames"]
    ))
}

fn wait(what: &str, wanted: &dyn Fn() -> bool) -> Result<()> {
    let began = Instant::now();
    while !wanted() {
        ensure!(began.elapsed() < HANGS, "{what}: not within {} s", HANGS.as_secs());
        std::thread::sleep(Duration::from_millis(20));
    }
    Ok(())
}

fn count(wanted: fn(&Request) -> bool, device: &FakeDevice) -> usize {
    device.executed().iter().filter(|request| wanted(request)).count()
}
