//! Figures of the manual that are views of the page: the page takes the place of the picture, and makes the picture.

use crate::driver::Browser;
use anyhow::{Context, Result, ensure};
use serde_json::json;
use std::fs;
use std::path::Path;

const SCRIPT: &str = include_str!("../../../../host/manual/live.js");
/// Pages with such a figure: the page's text, and the picture.
const FIGURES: [(&str, &str); 3] = [
    (include_str!("../../../../host/manual/src/theory/beam.md"), "play.svg"),
    (include_str!("../../../../host/manual/src/diagnosing.md"), "diagnose.svg"),
    (include_str!("../../../../host/manual/src/methods.md"), "blocks.svg"),
];
/// Width of a page of the manual, pixels.
const WIDTH: u32 = 1000;
/// The views are taller than a screen.
const HEIGHT: u32 = 900;

/// Embeds every figure as the manual does; with a folder, makes its picture too.
///
/// # Errors
/// What is otherwise.
pub fn check(browser: &Browser, folder: &Path, pictures: Option<&Path>) -> Result<String> {
    browser.appear(WIDTH, HEIGHT, "light")?;
    let mut heights = Vec::new();
    for (text, name) in FIGURES {
        let (_, figure_text) =
            text.split_once("<figure data-view=\"").with_context(|| format!("{name}: no figure"))?;
        let (view, _) = figure_text.split_once('"').context("no view")?;
        ensure!(text.contains(&format!("live/{name})")), "{name}: not the picture of the figure");
        let page = format!(
            "<!doctype html><title>Manual</title><script>const path_to_root = '';</script>\
             <figure data-view=\"{view}\" data-title=\"{name}\"><p>the picture</p></figure><script>{SCRIPT}</script>"
        );
        let file = folder.join("manual.html");
        fs::write(&file, page)?;
        browser.open(&format!("file://{}", file.display()))?;
        browser.until("document.querySelector('figure p').hidden").with_context(|| name.to_owned())?;
        // Content that arrives later changes the height.
        browser.wait_for("await new Promise((yes) => setTimeout(yes, 600));", json!([]))?;
        let height = browser.run("return document.querySelector('iframe').clientHeight;", json!([]))?;
        ensure!(height.as_f64().is_some_and(|height| height > 200.0), "{name}: {height} pixels high");
        heights.push(format!("{name} {height} pixels high"));
        // Without the page beside it the picture stays.
        fs::create_dir_all(folder.join("alone"))?;
        let alone = folder.join("alone").join("manual.html");
        fs::copy(&file, &alone)?;
        browser.open(&format!("file://{}", alone.display()))?;
        browser.until("document.querySelector('iframe')")?;
        browser.wait_for("await new Promise((yes) => setTimeout(yes, 600));", json!([]))?;
        let stays = "const picture = document.querySelector('figure p'); return picture.offsetHeight > 0 && document.querySelector('iframe').clientHeight === 0;";
        ensure!(browser.run(stays, json!([]))? == json!(true), "{name}: the picture is gone");
        if let Some(pictures) = pictures {
            browser.open(&format!("file://{}#{view}&embed=yes", folder.join("guide.html").display()))?;
            browser.until("document.querySelector('#main .rig, #main .cell, #blocks-facts')")?;
            browser.wait_for("await new Promise((yes) => setTimeout(yes, 600));", json!([]))?;
            let drawn = browser.run("return pictureOf(main()).text;", json!([]))?;
            fs::create_dir_all(pictures)?;
            fs::write(pictures.join(name), drawn.as_str().context("no picture")?)
                .with_context(|| format!("{}: cannot write", pictures.join(name).display()))?;
        }
    }
    browser.appear(1280, 900, "light")?;
    Ok(heights.join(", "))
}
