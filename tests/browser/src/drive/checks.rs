//! Checks of the page in the browser.

use crate::axe;
use crate::driver::Browser;
use crate::endurance;
use crate::figures;
use crate::live;
use crate::program::document;
use crate::results;
use crate::serial;
use crate::served;
use crate::views;
use anyhow::{Context, Result, ensure};
use serde_json::json;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Results of page and program may differ by this share.
pub const SAME: f64 = 1e-9;
/// Views with the marks of their addresses, and what they show when they are complete.
pub const VIEWS: [(&str, &str, &str); 10] = [
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
    ("blocks", "view=blocks&depth=30", "document.querySelector('#blocks-facts')"),
    (
        "population",
        "view=population&records=example&by=tissue",
        "document.querySelectorAll('#main .made svg').length > 3",
    ),
    (
        "tables",
        "view=tables",
        "document.querySelector('#tables-taken') && document.querySelector('#main .plot')",
    ),
];
/// Widths of a tablet, a laptop and a wall screen.
pub const WIDTHS: [u32; 3] = [768, 1280, 1920];

/// A WebAssembly program that stops at once: as an engine that panics.
const STOPS: &str = "new Uint8Array([0,97,115,109,1,0,0,0,1,4,1,96,0,0,3,2,1,0,5,3,1,0,1,7,19,2,6,95,115,116,97,114,116,0,0,6,109,101,109,111,114,121,2,0,10,5,1,3,0,0,11])";

/// Choice of checks, and of their output.
#[derive(Debug, Default)]
pub struct Options {
    /// Checks whose names contain this.
    pub only: String,
    /// Without the pictures of the views.
    pub no_pictures: bool,
    /// For how long the live view is watched at the full rate of a device; not at all where it is zero.
    pub minutes: u64,
    /// The program that results and times are compared with; that of the tests where it is not given.
    pub program: Option<PathBuf>,
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
    /// Checks of this page; files that are made go into the folder.
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
        let example = self.folder.join("example");
        for (session, name) in std::iter::once((&example, "the example".to_owned()))
            .chain(sessions.iter().map(|session| (session, session.display().to_string())))
        {
            self.check(&format!("{name}: results equal those of the program"), |checks| {
                let program = checks.options.program.as_deref();
                results::equal(checks.browser, &checks.address, session, program)
            });
        }
        self.check("the prediction follows its slider", Self::predicts);
        self.check("a plan equals the program's and follows its keys", |checks| {
            views::plans(checks.browser, &checks.address, &checks.folder)
        });
        self.check("a population equals the program's", |checks| {
            views::compares(checks.browser, &checks.address, &checks.folder)
        });
        self.check("an investigation is drawn with the reason of every step", |checks| {
            views::investigates(checks.browser, &checks.address)
        });
        self.check("tables of others become a session", |checks| {
            views::imports(checks.browser, &checks.address)
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
            live::check(checks.browser, &checks.page, &checks.folder, !checks.options.no_pictures)
        });
        self.check("live, at a serial port of the browser", |checks| {
            serial::check(checks.browser, &checks.address)
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
        let (began_ms, began_s) = (self.number("performance.now()")?, self.browser.engine_s());
        self.browser.press("#open-example", "\u{e007}")?;
        self.browser.until("document.querySelector('#pooled-k')")?;
        let (shown_ms, shown_s) = (self.number("performance.now()")?, self.browser.engine_s());
        let k_kpa = self.number("document.querySelector('#pooled-k').dataset.k")?;
        let program = document(&self.folder, &["identify", "example"])?;
        let expected = program["pooled"]["k_kpa"].as_f64().context("the program has no K")?;
        ensure!((k_kpa / expected - 1.0).abs() < SAME, "K {k_kpa}, the program has {expected}");
        self.browser.press("#main .primary", "\u{e007}")?;
        self.browser.until("document.querySelector('#diagnose-numbers')?.dataset.after")?;
        let plain = self.number("document.querySelector('#diagnose-numbers').dataset.after")?;
        // Requests of the earlier view would count too.
        self.browser.wait_for("await Promise.all(state.results.values());", json!([]))?;
        let first = self.switched("#effect-tissue\\.layers", " === 'tissue.layers'")?;
        let gap_after = self.number("document.querySelector('#diagnose-numbers').dataset.after")?;
        ensure!(gap_after < 0.5 * plain, "chi-square per reading {plain} before and {gap_after} after");
        let second = self.switched("#effect-tissue\\.entry_gap", ".includes(',')")?;
        let switched_back = self.switched("#effect-tissue\\.entry_gap", " === 'tissue.layers'")?;
        Ok(format!(
            "K {k_kpa:.3} kPa {:.0} ms after the key (processor {:.0} ms); chi-square per reading {plain:.2} to {gap_after:.2}; fitted again \
             in {first}, with a second effect in {second}, without it again in {switched_back}",
            shown_ms - began_ms,
            1e3 * (shown_s - began_s)
        ))
    }

    fn switched(&self, effect: &str, shown: &str) -> Result<String> {
        let engine_before_s = self.browser.engine_s();
        self.browser.press(effect, " ")?;
        self.browser.until(&format!("document.querySelector('#diagnose-numbers').dataset.effects{shown}"))?;
        let took_ms = self.number("document.querySelector('#diagnose-numbers').dataset.took")?;
        let took_s = self.browser.engine_s() - engine_before_s;
        Ok(format!("{took_ms:.0} ms (processor {:.0} ms)", 1e3 * took_s))
    }

    fn predicts(&self) -> Result<String> {
        self.open("view=predict&session=example&until=50")?;
        self.browser.until("document.querySelector('#predict-facts')?.dataset.until === '50'")?;
        let half = "document.querySelector('#predict-facts').textContent";
        let half_before = self.browser.run(&format!("return {half};"), json!([]))?;
        let start = Instant::now();
        self.browser.press("#predict-until", "\u{e014}\u{e014}\u{e014}\u{e014}\u{e014}")?;
        self.browser.until("document.querySelector('#predict-facts')?.dataset.until === '55'")?;
        let took_ms = start.elapsed().as_millis();
        let half_after = self.browser.run(&format!("return {half};"), json!([]))?;
        ensure!(half_before != half_after, "nothing has changed: {half_before}");
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
        let force_before = self.browser.run(&format!("return {force};"), json!([]))?;
        self.browser.press("#play-k_kpa", "\u{e014}")?;
        self.browser.until(&format!("{force} !== {force_before}"))?;
        let script = "const times = []; for (let i = 0; i < 120; i += 1) { const start = performance.now(); \
            await engine.request('quick', { do: 'play', k_kpa: 10 + 0.1 * i, depth_mm: 50, displacement_mm: 1.5, gap_mm: 10, tip_load_n: 0.2, effects: arguments[0] }); \
            times.push(performance.now() - start); } times.sort((a, b) => a - b); return times[Math.floor(0.5 * times.length)];";
        let mut seen_effects = Vec::new();
        for (name, effects) in [
            ("plain", json!({})),
            ("backlash", json!({"rig.backlash": {"clearance_mm": 0.3}})),
            ("layers", json!({"tissue.layers": {"k_ratio": 2, "boundary_mm": 15}})),
        ] {
            let median_ms = self.browser.wait_for(script, json!([effects]))?.as_f64().context("a time")?;
            seen_effects.push(format!("{name} {median_ms:.1} ms"));
        }
        Ok(format!("an answer takes (median of 120) {}", seen_effects.join(", ")))
    }

    fn bad_input(&self) -> Result<String> {
        self.open("")?;
        self.browser.until("document.querySelector('#open-example')")?;
        let drop = "const [name, size, text] = arguments[0]; hideFault(); await openChosen([[name, { size, arrayBuffer: async () => new TextEncoder().encode(text).buffer }]]); \
            return document.getElementById('fault').hidden ? document.querySelector('.findings')?.textContent ?? '' : document.getElementById('fault').textContent;";
        for (content, expected) in [
            (json!(["a.pdf", 10, "1,2"]), "no session.toml"),
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
        let mut count = 0;
        for (name, mark, complete) in VIEWS {
            for scheme in ["light", "dark"] {
                for width in WIDTHS {
                    self.browser.appear(width, width * 10 / 16, scheme)?;
                    self.open(mark)?;
                    self.browser.until(complete)?;
                    views::picture(self.browser, &folder, name, width, scheme)?;
                    count += 1;
                }
            }
        }
        self.browser.appear(1280, 900, "light")?;
        Ok(format!("{count} in {}", folder.display()))
    }
}
