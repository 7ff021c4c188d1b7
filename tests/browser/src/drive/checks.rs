//! What is checked in the browser.

use crate::axe;
use crate::driver::Browser;
use crate::endurance;
use crate::figures;
use crate::live;
use crate::program::{compare, document};
use crate::served;
use crate::views;
use anyhow::{Context, Result, ensure};
use serde_json::{Value, json};
use std::fs;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Results of page and program may differ by this share.
pub const SAME: f64 = 1e-9;
/// The same where fits end as soon as a step is shorter than a twentieth of a standard deviation, whose end moves with the rounding of
/// each processor. Chosen after the example's differences of 2e-3 were measured; other sessions may differ by more.
const SAME_END: f64 = 5e-3;
/// Views with the marks of their addresses, and what they show when they are complete.
pub const VIEWS: [(&str, &str, &str); 8] = [
    ("start", "view=start", "document.querySelector('#open-example')"),
    ("play", "view=play&with=rig.backlash:0.3", "document.querySelector('.rig')"),
    ("session", "view=session&session=example", "document.querySelectorAll('#main .plot').length > 3"),
    ("identify", "view=identify&session=example", "document.querySelector('.made svg')"),
    (
        "diagnose",
        "view=diagnose&session=example&effects=tissue.layers",
        "document.querySelector('#diagnose-maps .cell')",
    ),
    ("predict", "view=predict&session=example&until=50", "document.querySelector('#predict-facts')"),
    ("plan", "view=plan&session=example", "document.querySelector('#plan-facts')"),
    (
        "population",
        "view=population&records=example&by=tissue",
        "document.querySelectorAll('#main .made svg').length > 3",
    ),
];
/// Widths of a tablet, a laptop and a wall screen.
const WIDTHS: [u32; 3] = [768, 1280, 1920];

/// A WebAssembly program that stops at once: as an engine that panics.
const STOPS: &str = "new Uint8Array([0,97,115,109,1,0,0,0,1,4,1,96,0,0,3,2,1,0,5,3,1,0,1,7,19,2,6,95,115,116,97,114,116,0,0,6,109,101,109,111,114,121,2,0,10,5,1,3,0,0,11])";

/// Which checks run, and what they write.
#[derive(Debug, Default)]
pub struct Options {
    /// Checks whose names contain this.
    pub only: String,
    /// Without the pictures of the views.
    pub no_pictures: bool,
    /// For how long the live view is watched at the full rate of a device; not at all where it is zero.
    pub minutes: u64,
    /// Folder for the pictures of the manual's live figures.
    pub figures: Option<PathBuf>,
}

/// The checks, on one browser.
pub struct Checks<'a> {
    browser: &'a Browser,
    address: String,
    page: PathBuf,
    folder: PathBuf,
    options: Options,
    passed: usize,
    failed: usize,
}

impl<'a> Checks<'a> {
    /// Of this page; what is made goes into the folder.
    pub fn new(browser: &'a Browser, page: &Path, folder: PathBuf, options: Options) -> Self {
        let address = format!("file://{}", page.display());
        Self { browser, address, page: page.to_owned(), folder, options, passed: 0, failed: 0 }
    }

    /// Runs all checks; returns how many failed.
    ///
    /// # Errors
    /// Where the browser itself fails.
    pub fn all(&mut self, sessions: &[PathBuf]) -> Result<usize> {
        self.browser.appear(1280, 900, "light")?;
        self.check("opens from disk", Self::opens);
        self.check("no connection is possible", Self::connects_to_nothing);
        self.check("a newcomer opens the example and switches an effect on, by keyboard", Self::newcomer);
        self.check("the example: results equal those of the program", |checks| {
            let folder = checks.folder.clone();
            checks.equals(&folder.join("example"))
        });
        for session in sessions {
            let name = format!("{}: results equal those of the program", session.display());
            self.check(&name, |checks| checks.equals(session));
        }
        self.check("the prediction follows its slider", Self::predicts);
        self.check("a plan equals the program's and follows its keys", |checks| {
            views::plans(checks.browser, &checks.address, &checks.folder)
        });
        self.check("a population equals the program's", |checks| {
            views::compares(checks.browser, &checks.address, &checks.folder)
        });
        self.check("every view is saved as JSON, SVG, PNG and page", |checks| {
            views::saves(checks.browser, &checks.address, &checks.folder)
        });
        self.check("the needle answers while a slider is dragged", Self::plays);
        self.check("bad input leads to a message", Self::bad_input);
        self.check("an engine that stops leads to a message, and to a new engine", Self::stopped);
        self.check("served by guide web", |checks| {
            served::check(checks.browser, &checks.page, &checks.folder)
        });
        self.check("live, with a device for tests", |checks| {
            live::check(checks.browser, &checks.page, &checks.folder)
        });
        if self.options.minutes > 0 {
            self.check("live for a long time at the full rate of a device", |checks| {
                endurance::check(checks.browser, &checks.page, &checks.folder, checks.options.minutes)
            });
        }
        self.check("figures of the manual are live, and pictures without the page", |checks| {
            figures::check(checks.browser, &checks.folder, checks.options.figures.as_deref())
        });
        self.check("accessibility (axe-core)", Self::accessible);
        if !self.options.no_pictures {
            self.check("pictures of every view", Self::pictures);
        }
        println!("{} passed, {} failed", self.passed, self.failed);
        Ok(self.failed)
    }

    fn check(&mut self, name: &str, run: impl FnOnce(&Self) -> Result<String>) {
        if !name.contains(&self.options.only) {
            return;
        }
        match run(self) {
            Ok(found) => {
                self.passed += 1;
                println!("ok      {name}: {found}");
            }
            Err(error) => {
                self.failed += 1;
                println!("failed  {name}: {error:#}");
            }
        }
    }

    fn open(&self, mark: &str) -> Result<()> {
        self.browser.open(&format!("{}#{mark}", self.address))
    }

    fn number(&self, expression: &str) -> Result<f64> {
        let value = self.browser.run(&format!("return Number({expression});"), json!([]))?;
        value.as_f64().with_context(|| format!("{expression}: no number"))
    }

    fn opens(&self) -> Result<String> {
        self.open("")?;
        self.browser.until("document.querySelector('#open-example')")?;
        let paint = "performance.getEntriesByName('first-contentful-paint')[0]?.startTime ?? NaN";
        self.browser.until(&format!("Number.isFinite({paint})"))?;
        let first_ms = self.number(paint)?;
        self.browser.wait_for("await engine.ready;", json!([]))?;
        let ready_ms = self.number("performance.now()")?;
        let log = self.browser.log()?;
        ensure!(log.is_empty(), "the page logged {log:?}");
        Ok(format!("first picture after {first_ms:.0} ms, engine ready after {ready_ms:.0} ms"))
    }

    fn connects_to_nothing(&self) -> Result<String> {
        self.open("")?;
        self.browser.until("document.querySelector('#open-example')")?;
        for attempt in [
            "await fetch('https://127.0.0.1:1/');",
            "await new Promise((yes, no) => { const s = new WebSocket('ws://127.0.0.1:1/'); s.onopen = yes; s.onerror = () => no(new Error('refused')); });",
            "await new Promise((yes, no) => { const i = new Image(); i.onload = yes; i.onerror = () => no(new Error('refused')); i.src = 'http://127.0.0.1:1/a.png'; });",
            "const s = document.createElement('script'); s.textContent = 'window.wasRun = 1'; document.head.append(s); if (!window.wasRun) throw new Error('refused');",
        ] {
            let outcome = self.browser.wait_for(attempt, json!([]));
            ensure!(outcome.is_err(), "was allowed: {attempt}");
        }
        let blocked =
            self.browser.log()?.iter().filter(|line| line.contains("Content Security Policy")).count();
        ensure!(blocked >= 4, "{blocked} of 4 attempts were blocked by the content security policy");
        Ok("4 attempts blocked by the content security policy".to_owned())
    }

    fn newcomer(&self) -> Result<String> {
        self.open("")?;
        self.browser.until("document.querySelector('#open-example')")?;
        let began_ms = self.number("performance.now()")?;
        self.browser.press("#open-example", "\u{e007}")?;
        self.browser.until("document.querySelector('#pooled-k')")?;
        let shown_ms = self.number("performance.now()")?;
        let k_kpa = self.number("document.querySelector('#pooled-k').dataset.k")?;
        let program = document(&self.folder, &["identify", "example"])?;
        let expected = program["pooled"]["k_kpa"].as_f64().context("the program has no K")?;
        ensure!((k_kpa / expected - 1.0).abs() < SAME, "K {k_kpa}, the program has {expected}");
        self.browser.press("#main .primary", "\u{e007}")?;
        self.browser.until("document.querySelector('#diagnose-numbers')?.dataset.after")?;
        let plain = self.number("document.querySelector('#diagnose-numbers').dataset.after")?;
        self.browser.press("#effect-tissue\\.layers", " ")?;
        self.browser
            .until("document.querySelector('#diagnose-numbers').dataset.effects === 'tissue.layers'")?;
        let after = self.number("document.querySelector('#diagnose-numbers').dataset.after")?;
        let first_ms = self.number("document.querySelector('#diagnose-numbers').dataset.took")?;
        ensure!(after < 0.5 * plain, "chi-square per reading {plain} before and {after} after");
        self.browser.press("#effect-tissue\\.entry_gap", " ")?;
        self.browser.until("document.querySelector('#diagnose-numbers').dataset.effects.includes(',')")?;
        let second_ms = self.number("document.querySelector('#diagnose-numbers').dataset.took")?;
        self.browser.press("#effect-tissue\\.entry_gap", " ")?;
        self.browser
            .until("document.querySelector('#diagnose-numbers').dataset.effects === 'tissue.layers'")?;
        let back_ms = self.number("document.querySelector('#diagnose-numbers').dataset.took")?;
        Ok(format!(
            "K {k_kpa:.3} kPa {:.0} ms after the key; chi-square per reading {plain:.2} to {after:.2}; fitted again in {first_ms:.0} ms, \
             with a second effect in {second_ms:.0} ms, without it again in {back_ms:.0} ms",
            shown_ms - began_ms
        ))
    }

    /// Compares every result of a session, and the times.
    fn equals(&self, session: &Path) -> Result<String> {
        let session =
            session.canonicalize().with_context(|| format!("{}: cannot read", session.display()))?;
        let (parent, name) =
            (session.parent().context("a folder")?, session.file_name().context("a folder")?);
        let name = name.to_string_lossy().into_owned();
        let mut files = Vec::new();
        collect(&session, &name, &mut files)?;
        self.open("")?;
        self.browser.wait_for(
            "await engine.ready; await engine.open(arguments[0].map(([name, text]) => [name, new TextEncoder().encode(text)]));",
            json!([files]),
        )?;
        let mut found = Vec::new();
        for (request, arguments, bound) in [
            (json!({"do": "check", "dir": name}), vec!["check", name.as_str()], SAME),
            (json!({"do": "identify", "dir": name}), vec!["identify", &name], SAME),
            (json!({"do": "diagnose", "dir": name}), vec!["diagnose", &name], SAME_END),
            (
                json!({"do": "predict", "dir": name, "until_mm": 50}),
                vec!["predict", &name, "--until", "50"],
                SAME_END,
            ),
        ] {
            let command = arguments[0];
            let start = Instant::now();
            let program = document(parent, &arguments);
            let program_s = start.elapsed().as_secs_f64();
            let timed = "const start = performance.now(); \
                 const text = JSON.stringify((await engine.request('compared', arguments[0])).document); return [performance.now() - start, text];";
            let page = self.browser.wait_for(timed, json!([request]));
            match (page, program) {
                (Ok(page), Ok(program)) => {
                    // As text: the driver's own numbers have fewer digits.
                    let document: Value = serde_json::from_str(page[1].as_str().unwrap_or_default())?;
                    let distance = compare(&document, &program).with_context(|| command.to_owned())?;
                    ensure!(
                        distance.largest < bound,
                        "{command}: {:.1e} apart at {}",
                        distance.largest,
                        distance.place
                    );
                    let page_s = 1e-3 * page[0].as_f64().unwrap_or(f64::NAN);
                    found.push(format!(
                        "{command} {} numbers within {:.0e} ({page_s:.2} s, program {program_s:.2} s)",
                        distance.numbers, distance.largest
                    ));
                }
                (Err(page), Err(program)) => {
                    let (page, program) = (page.to_string(), program.to_string());
                    // The program names the folder too.
                    let reason = page.split_once(": ").map_or(page.as_str(), |(_, reason)| reason);
                    ensure!(program.contains(reason), "{command}: \"{page}\", the program has \"{program}\"");
                    found.push(format!("{command}: the same error"));
                }
                (Err(page), Ok(_)) => return Err(page.context(format!("{command}: the page alone fails"))),
                (Ok(_), Err(program)) => {
                    return Err(program.context(format!("{command}: the program alone fails")));
                }
            }
        }
        Ok(found.join("; "))
    }

    fn predicts(&self) -> Result<String> {
        self.open("view=predict&session=example&until=50")?;
        self.browser.until("document.querySelector('#predict-facts')?.dataset.until === '50'")?;
        let half = "document.querySelector('#predict-facts').textContent";
        let before = self.browser.run(&format!("return {half};"), json!([]))?;
        let start = Instant::now();
        self.browser.press("#predict-until", "\u{e014}\u{e014}\u{e014}\u{e014}\u{e014}")?;
        self.browser.until("document.querySelector('#predict-facts')?.dataset.until === '55'")?;
        let took_ms = start.elapsed().as_millis();
        let after = self.browser.run(&format!("return {half};"), json!([]))?;
        ensure!(before != after, "nothing has changed: {before}");
        ensure!(
            self.browser.run("return location.hash.includes('until=55');", json!([]))? == json!(true),
            "the address"
        );
        Ok(format!("five steps of the slider by keyboard in {took_ms} ms"))
    }

    fn plays(&self) -> Result<String> {
        self.open("view=play")?;
        self.browser.until("document.querySelector('.rig')")?;
        let force = "document.querySelector('#play-force').textContent";
        let before = self.browser.run(&format!("return {force};"), json!([]))?;
        self.browser.press("#play-k_kpa", "\u{e014}")?;
        self.browser.until(&format!("{force} !== {before}"))?;
        let script = "const times = []; for (let i = 0; i < 120; i += 1) { const start = performance.now(); \
            await engine.request('quick', { do: 'play', k_kpa: 10 + 0.1 * i, depth_mm: 50, displacement_mm: 1.5, gap_mm: 10, tip_load_n: 0.2, effects: arguments[0] }); \
            times.push(performance.now() - start); } times.sort((a, b) => a - b); return times[Math.floor(0.5 * times.length)];";
        let mut found = Vec::new();
        for (name, effects) in [
            ("plain", json!({})),
            ("backlash", json!({"rig.backlash": {"clearance_mm": 0.3}})),
            ("layers", json!({"tissue.layers": {"k_ratio": 2, "boundary_mm": 15}})),
        ] {
            let median_ms = self.browser.wait_for(script, json!([effects]))?.as_f64().context("a time")?;
            found.push(format!("{name} {median_ms:.1} ms"));
        }
        Ok(format!("an answer takes (median of 120) {}", found.join(", ")))
    }

    fn bad_input(&self) -> Result<String> {
        self.open("")?;
        self.browser.until("document.querySelector('#open-example')")?;
        let drop = "const [name, size, text] = arguments[0]; hideFault(); await openChosen([[name, { size, arrayBuffer: async () => new TextEncoder().encode(text).buffer }]]); \
            return document.getElementById('fault').hidden ? document.querySelector('.findings')?.textContent ?? '' : document.getElementById('fault').textContent;";
        for (content, expected) in [
            (json!(["a.csv", 10, "1,2"]), "no session.toml"),
            (json!(["a.zip", 10, "no archive"]), "no zip archive"),
            (json!(["a/session.toml", 3_000_000_000u64, ""]), "too much"),
        ] {
            let message = self.browser.wait_for(drop, json!([content]))?;
            ensure!(message.as_str().is_some_and(|text| text.contains(expected)), "{content}: \"{message}\"");
        }
        self.browser.wait_for(drop, json!([["s/session.toml", 10, "[session]\nformat = 2\n"]]))?;
        self.browser.until("document.querySelector('.findings')")?;
        let shown = self.browser.run("return document.querySelector('.findings').textContent;", json!([]))?;
        ensure!(shown.as_str().is_some_and(|text| text.contains("s/session.toml:2:")), "{shown}");
        let error = self.browser.wait_for("return engine.request('quick', { do: 'nothing' });", json!([]));
        ensure!(error.is_err_and(|error| error.to_string().contains("unknown variant")), "a wrong request");
        Ok("no session, a broken archive, 3 GB, a wrong format, a wrong request".to_owned())
    }

    fn stopped(&self) -> Result<String> {
        self.open("view=identify&session=example")?;
        self.browser.until("document.querySelector('#pooled-k')")?;
        let script = format!(
            "const lane = engine.lane('identify'); await lane.send('load', await WebAssembly.compile({STOPS})); await lane.send('files', engine.files); \
             state.results.clear(); show('identify'); await new Promise((yes) => setTimeout(yes, 500)); \
             const text = document.getElementById('fault').textContent; await lane.send('load', engine.module); await lane.send('files', engine.files); return text;"
        );
        let shown = self.browser.wait_for(&script, json!([]))?;
        ensure!(shown.as_str().is_some_and(|text| text.contains("The engine stopped")), "{shown}");
        self.browser.press("#fault button", "\u{e007}")?;
        self.browser.until("document.querySelector('#pooled-k')")?;
        Ok("message with \"Try again\", which succeeds".to_owned())
    }

    /// All rules of axe-core on every view, where npm can install it.
    fn accessible(&self) -> Result<String> {
        let Some(axe) = axe::script(&self.folder)? else {
            return Ok("skipped: npm or axe-core is not available".to_owned());
        };
        let mut violations = Vec::new();
        for scheme in ["light", "dark"] {
            self.browser.appear(1280, 900, scheme)?;
            for (name, mark, complete) in VIEWS {
                self.open(mark)?;
                self.browser.until(complete)?;
                let found = axe::violations(self.browser, &axe)?;
                violations.extend(found.into_iter().map(|one| format!("{name} {scheme} {one}")));
            }
        }
        self.browser.appear(1280, 900, "light")?;
        ensure!(violations.is_empty(), "{} violations:\n  {}", violations.len(), violations.join("\n  "));
        Ok(format!("{} views, light and dark, without violations", VIEWS.len()))
    }

    fn pictures(&self) -> Result<String> {
        let folder = self.folder.join("pictures");
        fs::create_dir_all(&folder)?;
        let mut count = 0;
        for (name, mark, complete) in VIEWS {
            for scheme in ["light", "dark"] {
                for width in WIDTHS {
                    self.browser.appear(width, width * 10 / 16, scheme)?;
                    self.open(mark)?;
                    self.browser.until(complete)?;
                    let height = self.number("document.documentElement.scrollHeight")?.min(2600.0);
                    let wide = self.number("document.documentElement.scrollWidth")?;
                    ensure!(wide <= f64::from(width), "{name}: {wide} pixels wide on a screen of {width}");
                    self.browser.appear(width, height as u32, scheme)?;
                    // Bars and colours come to rest.
                    self.browser.wait_for("await new Promise((yes) => setTimeout(yes, 600));", json!([]))?;
                    fs::write(folder.join(format!("{name}-{scheme}-{width}.png")), self.browser.picture()?)?;
                    count += 1;
                }
            }
        }
        self.browser.appear(1280, 900, "light")?;
        Ok(format!("{count} in {}", folder.display()))
    }
}

/// The text files of a session, with the names that the page gives them.
fn collect(folder: &Path, prefix: &str, files: &mut Vec<(String, String)>) -> Result<()> {
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        let name = format!("{prefix}/{}", path.file_name().unwrap_or_default().to_string_lossy());
        if path.is_dir() {
            collect(&path, &name, files)?;
        } else if let Ok(text) = fs::read_to_string(&path) {
            files.push((name, text));
        }
    }
    Ok(())
}
