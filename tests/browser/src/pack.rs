//! Makes `guide.html`: the files in `page`, the compiled engine, an example session and records of more in one file that needs nothing else.
//!
//! Usage: `web-pack ENGINE.wasm EXAMPLE_FOLDER RECORDS.jsonl GUIDE.html`
#![forbid(unsafe_code)]
#![deny(missing_docs)]

use anyhow::{Context, Result, bail, ensure};
use flate2::Compression;
use flate2::write::GzEncoder;
use sha2::{Digest, Sha256};
use std::collections::BTreeMap;
use std::fs;
use std::io::Write;
use std::path::Path;

const PAGE: &str = include_str!("../../../host/web/page/index.html");
const STYLE: &str = include_str!("../../../host/web/page/style.css");
const WORKER: &str = include_str!("../../../host/web/page/worker.js");
/// In this order, the last line starts the page.
const SCRIPTS: [&str; 19] = [
    include_str!("../../../host/web/page/engine.js"),
    include_str!("../../../host/web/page/files.js"),
    include_str!("../../../host/web/page/plot.js"),
    include_str!("../../../host/web/page/words.js"),
    include_str!("../../../host/web/page/save.js"),
    include_str!("../../../host/web/page/served.js"),
    include_str!("../../../host/web/page/live.js"),
    include_str!("../../../host/web/page/serial.js"),
    include_str!("../../../host/web/page/app.js"),
    include_str!("../../../host/web/page/start.js"),
    include_str!("../../../host/web/page/play.js"),
    include_str!("../../../host/web/page/identify.js"),
    include_str!("../../../host/web/page/diagnose.js"),
    include_str!("../../../host/web/page/investigate.js"),
    include_str!("../../../host/web/page/predict.js"),
    include_str!("../../../host/web/page/plan.js"),
    include_str!("../../../host/web/page/blocks.js"),
    include_str!("../../../host/web/page/population.js"),
    include_str!("../../../host/web/page/tables.js"),
];
/// Size that the page should not exceed as a server sends it, bytes.
const GOAL: usize = 1_500_000;

fn main() -> Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [engine, example, records, page] = arguments.as_slice() else {
        bail!(
            "expected four arguments: the engine, the folder of the example, records of sessions, the page to write"
        );
    };
    let engine = fs::read(engine).with_context(|| format!("{engine}: cannot read"))?;
    let records = fs::read_to_string(records).with_context(|| format!("{records}: cannot read"))?;
    let packed_engine = packed_small(&engine)?;
    let text = page_of(&packed_engine, &files(Path::new(example))?, &records)?;
    fs::write(page, &text).with_context(|| format!("{page}: cannot write"))?;
    let sent = packed(text.as_bytes())?.len();
    println!(
        "{page}: {} kB; as a server sends it, gzip, {} kB (goal {} kB); the engine {} kB, packed {} kB",
        text.len() / 1000,
        sent / 1000,
        GOAL / 1000,
        engine.len() / 1000,
        packed_engine.len() / 1000
    );
    Ok(())
}

/// The files of a session by name.
fn files(folder: &Path) -> Result<BTreeMap<String, String>> {
    let mut files = BTreeMap::new();
    let cannot = || format!("{}: cannot read", folder.display());
    for entry in fs::read_dir(folder).with_context(cannot)? {
        let path = entry.with_context(cannot)?.path();
        let name =
            path.file_name().and_then(|name| name.to_str()).context("a file name that is not UTF-8")?;
        // The true parameters stay hidden.
        if name != "plan.toml" {
            let text =
                fs::read_to_string(&path).with_context(|| format!("{}: cannot read", path.display()))?;
            files.insert(name.to_owned(), text);
        }
    }
    ensure!(files.contains_key("session.toml"), "{}: there is no session.toml", folder.display());
    Ok(files)
}

/// The page, with the engine packed as [`packed_small`] does.
fn page_of(packed_engine: &[u8], example: &BTreeMap<String, String>, records: &str) -> Result<String> {
    let script = format!("'use strict';\n{}\nbegin();\n", SCRIPTS.join("\n"));
    let example = json(example);
    for (name, text) in
        [("script", script.as_str()), ("worker", WORKER), ("example", &example), ("records", records)]
    {
        ensure!(!text.contains("</script") && !text.contains("<!--"), "{name}: would end its element");
    }
    // The page may run this script, this style and the engine, and nothing else; it may not connect to anything.
    let policy = [
        "default-src 'none'".to_owned(),
        format!("script-src '{}' 'wasm-unsafe-eval'", hash(&script)),
        format!("style-src '{}'", hash(STYLE)),
        "worker-src blob:".to_owned(),
        // Pictures that the page makes itself, to save them as bitmaps.
        "img-src data:".to_owned(),
        "base-uri 'none'".to_owned(),
        "form-action 'none'".to_owned(),
    ];
    let mut page = PAGE.to_owned();
    for (mark, text) in [
        ("@CSP@", policy.join("; ")),
        ("@STYLE@", STYLE.to_owned()),
        ("@VERSION@", env!("CARGO_PKG_VERSION").to_owned()),
        ("@WORKER@", WORKER.to_owned()),
        ("@EXAMPLE@", example),
        ("@RECORDS@", records.to_owned()),
        ("@SCRIPT@", script),
        ("@ENGINE@", base64(packed_engine)),
    ] {
        ensure!(page.matches(mark).count() == 1, "{mark}: expected once in the page");
        page = page.replacen(mark, &text, 1);
    }
    Ok(page)
}

/// A JSON object of texts.
fn json(files: &BTreeMap<String, String>) -> String {
    serde_json::Value::from_iter(files.iter().map(|(name, text)| (name.clone(), text.clone()))).to_string()
}

/// As a server packs what it sends.
fn packed(bytes: &[u8]) -> Result<Vec<u8>> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::best());
    encoder.write_all(bytes)?;
    Ok(encoder.finish()?)
}

/// The same format, smaller and not in a hurry: for what is packed once and loaded often.
fn packed_small(bytes: &[u8]) -> Result<Vec<u8>> {
    let mut packed = Vec::new();
    zopfli::compress(zopfli::Options::default(), zopfli::Format::Gzip, bytes, &mut packed)?;
    Ok(packed)
}

/// A hash as a content security policy states it.
fn hash(text: &str) -> String {
    format!("sha256-{}", base64(&Sha256::digest(text.as_bytes())))
}

/// Base 64 with padding (RFC 4648).
fn base64(bytes: &[u8]) -> String {
    const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut text = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for group in bytes.chunks(3) {
        let mut word = [0u8; 4];
        word[1..=group.len()].copy_from_slice(group);
        let word = u32::from_be_bytes(word);
        for digit in 0..4 {
            let value = (word >> (18 - 6 * digit)) as usize & 63;
            text.push(if digit <= group.len() { char::from(DIGITS[value]) } else { '=' });
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_is_that_of_the_standard() {
        for (text, expected) in
            [("", ""), ("f", "Zg=="), ("fo", "Zm8="), ("foo", "Zm9v"), ("foobar", "Zm9vYmFy")]
        {
            assert_eq!(base64(text.as_bytes()), expected);
        }
    }

    #[test]
    fn the_page_is_whole_and_states_hashes_of_what_it_runs() {
        let example = BTreeMap::from([("session.toml".to_owned(), "[session]".to_owned())]);
        let page = page_of(b"engine", &example, "{}").expect("a page");
        assert!(page.contains(&hash(&between("<script>", "</script>", &page))));
        // The first one: a script writes another into pages that are saved.
        let style = page.split_once("<style>").and_then(|(_, rest)| rest.split_once("</style>"));
        assert!(page.contains(&hash(style.expect("there").0)));
        assert!(page.contains("default-src 'none'") && !page.contains("connect-src"));
        assert!(
            !page.contains("http://")
                || page.matches("http://").all(|_| page.contains("http://www.w3.org/2000/svg"))
        );
    }

    fn between(from: &str, to: &str, page: &str) -> String {
        let (_, page_tail) = page.rsplit_once(from).expect("there");
        page_tail.split_once(to).expect("there").0.to_owned()
    }

    #[test]
    fn an_example_that_would_end_its_element_is_rejected() {
        let example = BTreeMap::from([("session.toml".to_owned(), "</script>".to_owned())]);
        assert!(page_of(b"engine", &example, "{}").is_err());
        let example = BTreeMap::from([("session.toml".to_owned(), String::new())]);
        assert!(page_of(b"engine", &example, "</script>").is_err());
    }
}
