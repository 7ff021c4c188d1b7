//! Plan and population, and what every view saves.

use crate::checks::{SAME, VIEWS};
use crate::driver::Browser;
use crate::program::{compare, document};
use anyhow::{Context, Result, ensure};
use serde_json::{Value, json};
use std::fs;
use std::path::Path;

const ENTER: &str = "\u{e007}";
/// Pictures are no higher.
const HIGHEST: f64 = 2600.0;
const DOWN: &str = "\u{e015}";

/// A document of the engine that the page carries, as text: the driver's own numbers have fewer digits.
fn of_engine(browser: &Browser, script: &str, arguments: Value) -> Result<Value> {
    let text = browser.wait_for(&format!("return JSON.stringify(({script}).document);"), arguments)?;
    Ok(serde_json::from_str(text.as_str().unwrap_or_default())?)
}

/// Takes a picture of the whole view that is shown on a screen of this width.
///
/// # Errors
/// Where it is wider than the screen, or the picture cannot be written.
pub fn picture(browser: &Browser, folder: &Path, name: &str, width: u32, scheme: &str) -> Result<()> {
    wait_ms(600, browser)?;
    let height = number("document.documentElement.scrollHeight", browser)?.min(HIGHEST);
    let wide = number("document.documentElement.scrollWidth", browser)?;
    ensure!(wide <= f64::from(width), "{name}: {wide} pixels wide on a screen of {width}");
    browser.appear(width, height as u32, scheme)?;
    wait_ms(200, browser)?;
    fs::create_dir_all(folder)?;
    fs::write(folder.join(format!("{name}-{scheme}-{width}.png")), browser.picture()?)?;
    Ok(())
}

/// Figures are drawn for the width, bars and colours come to rest.
fn wait_ms(ms: u32, browser: &Browser) -> Result<Value> {
    browser.wait_for("await new Promise((yes) => setTimeout(yes, arguments[0]));", json!([ms]))
}

fn number(expression: &str, browser: &Browser) -> Result<f64> {
    let value = browser.run(&format!("return Number({expression});"), json!([]))?;
    value.as_f64().with_context(|| format!("{expression}: no number"))
}

/// The plan of the example's rig equals that of the program; another depth is chosen by keyboard.
///
/// # Errors
/// What is otherwise.
pub fn plans(browser: &Browser, address: &str, folder: &Path) -> Result<String> {
    browser.open(&format!("{address}#view=plan&session=example&depth=40&displacement=1.2"))?;
    browser.until("document.querySelector('#plan-facts')")?;
    let request = json!({
        "do": "plan", "dir": "example", "modulus_kpa": [5, 30], "depth_mm": [20, 40, 60], "displacement_mm": [0.4, 1.2],
        "hold_s": 3, "force_limit_n": 4, "strain_limit_percent": 0.2, "deflection_limit_mm": 2.5
    });
    let plan_result = of_engine(browser, "await engine.request('quick', arguments[0])", json!([request]))?;
    let arguments =
        ["plan", "--rig", "example/session.toml", "--k-kpa", "5", "30", "--depth-mm", "20", "40", "60"];
    let program = document(folder, &[&arguments[..], &["--displacement-mm", "0.4", "1.2"]].concat())?;
    let distance = compare(&plan_result, &program)?;
    ensure!(distance.largest < SAME, "{:.1e} apart at {}", distance.largest, distance.place);

    let percent_before = percent(browser)?;
    browser.press("#plan-depth", DOWN)?;
    browser.until("location.hash.includes('depth=50')")?;
    let percent_after = percent(browser)?;
    ensure!(percent_before != percent_after, "another depth has the same half-width {percent_before}");
    browser.press("#plan-best", ENTER)?;
    browser.until("document.querySelectorAll('#main .map .chosen').length === 1")?;
    ensure!(percent(browser)? < percent_after, "the best run is not narrower");
    let took_ms = browser.wait_for(
        "const start = performance.now(); document.querySelector('#plan-hold_s').stepUp(); document.querySelector('#plan-hold_s').dispatchEvent(new Event('input')); \
         const was = document.querySelector('#plan-facts'); while (document.querySelector('#plan-facts') === was) await new Promise((yes) => setTimeout(yes, 5)); \
         return performance.now() - start;",
        json!([]),
    )?;
    Ok(format!(
        "{} numbers within {:.0e}; 50 mm deep {percent_after:.2} %; the map of 80 runs in {:.0} ms",
        distance.numbers,
        distance.largest,
        took_ms.as_f64().unwrap_or(f64::NAN)
    ))
}

fn percent(browser: &Browser) -> Result<f64> {
    let value =
        browser.run("return Number(document.querySelector('#plan-facts').dataset.percent);", json!([]))?;
    value.as_f64().context("no half-width")
}

/// The example's records are analysed as by the program; the open session is added.
///
/// # Errors
/// What is otherwise.
pub fn compares(browser: &Browser, address: &str, folder: &Path) -> Result<String> {
    browser.open(&format!("{address}#view=population"))?;
    browser.until("document.querySelector('#use-records')")?;
    browser.press("#use-records", ENTER)?;
    browser.until("document.querySelectorAll('#population-groups tbody tr').length === 2")?;
    let population =
        of_engine(browser, "await engine.population(state.records.files, ['tissue'])", json!([]))?;
    let program = document(folder, &["population", "example.jsonl", "--by", "tissue"])?;
    let distance = compare(&population, &program)?;
    ensure!(distance.largest < SAME, "{:.1e} apart at {}", distance.largest, distance.place);
    // One group by keyboard.
    browser.press("#population-by", "\u{e011}")?;
    browser.until("document.querySelectorAll('#population-groups tbody tr').length === 1")?;

    // A file that is no record names its place.
    let drop = "hideFault(); await openChosen([['a.jsonl', { size: 2, arrayBuffer: async () => new TextEncoder().encode('{}').buffer }]]); \
        while (document.getElementById('fault').hidden) await new Promise((yes) => setTimeout(yes, 20)); return document.getElementById('fault').textContent;";
    let message = browser.wait_for(drop, json!([]))?;
    ensure!(message.as_str().is_some_and(|text| text.contains("a.jsonl:1:")), "{message}");

    browser.open(&format!("{address}#view=session&session=example"))?;
    browser.until("document.querySelectorAll('#main .plot').length > 3")?;
    browser.run("exampleRecords();", json!([]))?;
    browser.until("document.querySelector('#population-counts')?.textContent.includes('12 sessions')")?;
    browser.press("#add-session", ENTER)?;
    browser.until("document.querySelector('#population-counts')?.textContent.includes('13 sessions')")?;
    Ok(format!("{} numbers within {:.0e}; the open session added", distance.numbers, distance.largest))
}

/// A table without units is asked for them, and becomes a session that opens.
///
/// # Errors
/// What is otherwise.
pub fn imports(browser: &Browser, address: &str) -> Result<String> {
    browser.open(&format!("{address}#view=start"))?;
    browser.until("document.querySelector('#open-example')")?;
    let drop = "const rows = [...Array(400).keys()].map((i) => { const t = i / 20; const x = Math.max(0, Math.min(1.2, (t - 4) / 2)); return [t, x, 2.4 * x + 0.01 * Math.sin(i)].join(';').replaceAll('.', ','); }); \
        const text = ['t;Weg;Kraft', ...rows].join('\\n'); \
        await openChosen([['my run.csv', { size: text.length, arrayBuffer: async () => new TextEncoder().encode(text).buffer }]]);";
    browser.wait_for(drop, json!([]))?;
    browser.until("document.querySelector('#tables-problem')?.textContent.includes('unit')")?;
    let choose = "const set = (id, value) => { document.getElementById(id).value = value; }; \
        set('tables-column-1', 'displacement_y_mm'); set('tables-unit-1', 'mm'); set('tables-column-2', 'force_y_n'); set('tables-unit-2', 'N'); \
        document.getElementById('tables-column-2').dispatchEvent(new Event('change'));";
    browser.run(choose, json!([]))?;
    browser
        .until("document.querySelector('#tables-problem')?.textContent.includes('length of the needle')")?;
    browser.run(
        "const depth = document.getElementById('tables-depth_mm'); depth.value = '30'; depth.dispatchEvent(new Event('change'));",
        json!([]),
    )?;
    browser.until("document.querySelectorAll('#tables-taken tbody tr').length === 3")?;
    let command = browser.run("return document.getElementById('tables-command').textContent;", json!([]))?;
    let expected = "guide import table 'my run.csv' --map t=time_s:s --map Weg=displacement_y_mm:mm --map Kraft=force_y_n:N";
    ensure!(command.as_str().is_some_and(|text| text.starts_with(expected)), "{command}");
    browser.press("#tables-open", ENTER)?;
    browser.until("state.session === 'my-run' && document.querySelectorAll('#main .plot').length >= 2")?;
    Ok("400 rows with decimal commas, units chosen, opened".to_owned())
}

/// Saves a view by its buttons, with the keyboard; what is saved is read again.
///
/// # Errors
/// What is otherwise.
pub fn saves(browser: &Browser, address: &str, folder: &Path) -> Result<String> {
    let saved = folder.join("saved");
    fs::create_dir_all(&saved)?;
    let mut bytes = 0;
    let views = VIEWS.iter().filter(|(name, ..)| *name != "start");
    for (name, mark, complete) in views.clone() {
        browser.open(&format!("{address}#{mark}"))?;
        browser.until(complete)?;
        browser.until("document.querySelectorAll('[data-save]').length === 4")?;
        browser.run(
            "window.kept = {}; saveFile = (name, content, type) => { window.kept[type] = [name, content]; };",
            json!([]),
        )?;
        for (label, kind) in [
            ("JSON", "application/json"),
            ("SVG", "image/svg+xml"),
            ("PNG", "image/png"),
            ("page", "text/html"),
        ] {
            browser.press(&format!("[data-save=\"{label}\"]"), ENTER)?;
            browser
                .until(&format!("window.kept['{kind}'] || !document.getElementById('fault').hidden"))
                .with_context(|| format!("{name}: {label}"))?;
        }
        let sound = "const parser = new DOMParser(); const of = (kind) => window.kept[kind]?.[1]; const wrong = []; \
            if (typeof JSON.parse(of('application/json')) !== 'object') wrong.push('JSON'); \
            const svg = parser.parseFromString(of('image/svg+xml'), 'image/svg+xml'); \
            if (svg.querySelector('parsererror') || svg.querySelectorAll('svg svg').length < 2 || svg.querySelector('[class], [style], script')) wrong.push('SVG'); \
            const page = parser.parseFromString(of('text/html'), 'text/html'); \
            if (page.querySelector('script, button, input, select, link, img') || !page.querySelector('main svg') || page.querySelector('style').textContent.length < 1000) wrong.push('page'); \
            const bitmap = await createImageBitmap(of('image/png')); const canvas = new OffscreenCanvas(bitmap.width, bitmap.height); \
            const drawn = canvas.getContext('2d'); drawn.drawImage(bitmap, 0, 0); \
            const colours = new Set(new Uint32Array(drawn.getImageData(0, 0, bitmap.width, Math.min(bitmap.height, 1500)).data.buffer)); \
            if (bitmap.width < 300 || colours.size < 8) wrong.push('PNG'); \
            return [wrong, of('image/svg+xml'), of('text/html')];";
        let saved_files = browser.wait_for(sound, json!([])).with_context(|| (*name).to_owned())?;
        ensure!(saved_files[0] == json!([]), "{name}: not saved correctly: {}", saved_files[0]);
        for (content, ending) in [(&saved_files[1], "svg"), (&saved_files[2], "html")] {
            let text = content.as_str().context("no text")?;
            bytes += text.len();
            fs::write(saved.join(format!("{name}.{ending}")), text)?;
        }
    }
    Ok(format!("{} views by keyboard, {} kB of pictures and pages", views.count(), bytes / 1000))
}

/// An investigation by its log: probabilities over the runs with the plain names of the explanations, and every step with its reason and what it told.
///
/// # Errors
/// What is otherwise.
pub fn investigates(browser: &Browser, address: &str) -> Result<String> {
    browser.open(address)?;
    browser.until("document.querySelector('#open-example')")?;
    let step = |runs: u32, none: f64, layers: f64, told: Value, next: Value| {
        json!({"runs": runs, "verdict": "adequate", "explanations": [{"effects": [], "probability": none}, {"effects": ["tissue.layers"], "probability": layers}],
            "unseen_probability": 0.2, "k_kpa": 12.0, "k_ci95_kpa": [11.0, 13.0], "realised_nats": told, "next": next})
    };
    let next = json!({"run": "x30-1", "what": "a staircase along x", "minutes": 0.5, "information_nats": 0.06, "modulus_nats": 0.1,
        "reasons": ["tissue.skin"]});
    let steps = [step(1, 0.9, 0.05, Value::Null, next), step(2, 0.1, 0.9, json!(2.5), Value::Null)];
    let log = json!({"schema": "guide.investigate/1", "end": "named", "steps": steps});
    let script = "const made = investigationSection(arguments[0]); main().replaceChildren(made); return made.textContent;";
    browser.run(script, json!([log]))?;
    browser.until("document.querySelectorAll('#investigation-drawn .line').length === 2")?;
    let shown = browser.run("return document.getElementById('investigation').innerText;", json!([]))?;
    let shown = shown.as_str().unwrap_or_default();
    for text in [
        "nothing missing",
        "a layer of another stiffness",
        "A staircase along x",
        "a stiff skin",
        "0.06",
        "2.5",
        "was named",
    ] {
        ensure!(shown.contains(text), "no {text:?} in {shown}");
    }
    let without = browser.run("return investigationSection(null) === null;", json!([]))?;
    ensure!(without == json!(true), "a session without an investigation has a section");
    Ok("two steps with reason, expected and told information; nothing without a log".to_owned())
}
