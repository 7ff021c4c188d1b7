//! Reports of sessions on disk, and how they look in a browser where there is one.

use super::{K_PA, add_insertions, add_lateral_run, failure, folder, guide, json, path, text, writer};
use std::collections::BTreeSet;
use std::fs::{self, File};
use std::io::BufReader;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Width of the window in pixels.
const WIDTH: u32 = 1000;

fn session(folder: &Path) {
    let mut session = writer(folder);
    add_lateral_run(&mut session);
    add_insertions(&mut session);
}

#[test]
fn a_report_has_the_numbers_of_the_other_commands() {
    let folder = folder();
    session(folder.path());
    let dir = path(folder.path());
    let report_json = json(&["report", dir, "--json"]);
    assert_eq!(report_json["schema"], "guide.report/2");
    let states: Vec<_> =
        report_json["sections"].as_array().expect("a list").iter().map(|one| &one["state"]).collect();
    assert_eq!(states, ["done", "done", "done", "skipped", "done", "done"]);
    let html = fs::read_to_string(folder.path().join("report.html")).expect("written");
    assert_eq!(report_json["bytes"], html.len());
    assert!(html.len() < 2_000_000);
    let identification = json(&["identify", dir, "--json"]);
    assert_eq!(report_json["k_kpa"], identification["pooled"]["k_kpa"]);
    let k_kpa = identification["pooled"]["k_kpa"].as_f64().expect("a modulus");
    assert!((k_kpa / (1e-3 * K_PA) - 1.0).abs() < 0.02);
    let load_n = json(&["predict", dir, "--json"])["insertions"][0]["tip_force_n"].as_f64().expect("a load");
    for part in
        [format!("{k_kpa:.2} ("), format!(">{load_n:.3}<"), "simulated".to_owned(), "i1.csv".to_owned()]
    {
        assert!(html.contains(&part), "{part} is not in the report");
    }
    assert_eq!(report_json["verdict"], json(&["diagnose", dir, "--json"])["verdict"]);
}

#[cfg(unix)]
#[test]
fn a_report_is_not_written_through_a_link() {
    let folder = folder();
    add_lateral_run(&mut writer(folder.path()));
    let (theirs, link) = (folder.path().join("theirs.html"), folder.path().join("report.html"));
    fs::write(&theirs, "theirs").expect("written");
    std::os::unix::fs::symlink(&theirs, &link).expect("linked");
    let line = failure(&["report", path(folder.path())]);
    assert!(line.contains("report.html: cannot write: it is a link"), "{line}");
    assert_eq!(fs::read(&theirs).expect("there"), b"theirs");
    fs::remove_file(&link).expect("removed");
    let refusal = guide(&["report", path(folder.path()), "--out", "/dev/stdout"]);
    assert!(refusal.status.success(), "{}", text(&refusal.stderr));
}

#[test]
fn a_report_is_the_same_bytes_each_time() {
    let folder = folder();
    add_lateral_run(&mut writer(folder.path()));
    let dir = path(folder.path());
    let first = json(&["report", dir, "--json"]);
    assert_eq!(first["sections"][2]["why"], "the session has no insertions");
    let html = fs::read_to_string(folder.path().join("report.html")).expect("written");
    // The report in the folder is no part of the session, and where it is written to changes nothing.
    let output_path = folder.path().join("again.html");
    let printed = guide(&["report", dir, "--out", path(&output_path)]);
    assert!(
        printed.status.success() && text(&printed.stdout).contains("again.html"),
        "{}",
        text(&printed.stderr)
    );
    assert_eq!(fs::read_to_string(&output_path).expect("written"), html);
    let dated = json(&[
        "report",
        dir,
        "--out",
        path(&output_path),
        "--date",
        "2025-03-01",
        "--until",
        "60",
        "--json",
    ]);
    assert_eq!(dated["date"], "2025-03-01");
    assert!(fs::read_to_string(&output_path).expect("written").contains("--until 60"));
}

#[test]
fn a_report_is_made_where_analyses_fail() {
    let folder = folder();
    session(folder.path());
    let dir = path(folder.path());
    // Guide 2 never moves, and the tip is measured once.
    let still: String = (0..200).map(|row| format!("{},0,0\n", 0.02 * f64::from(row))).collect();
    let header = "time_s,displacement_y_mm,force_y_n\n";
    fs::write(folder.path().join("d30-1.force.csv"), format!("{header}{still}")).expect("writes");
    for id in ["i1", "i2", "i3"] {
        fs::write(folder.path().join(format!("{id}.csv")), "depth_mm,tip_y_mm\n0,0\n").expect("writes");
    }
    let output = guide(&["report", dir]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    assert!(text(&output.stderr).contains("warning: identification failed"), "{}", text(&output.stderr));
    let html = fs::read_to_string(folder.path().join("report.html")).expect("written");
    assert!(html.contains("Failed: ") && html.contains("no hold is displaced"));

    assert!(failure(&["report", "no/such/folder"]).contains("session.toml: cannot read"));
    assert!(failure(&["report", dir, "--until", "nan"]).contains("--until: NaN"));
    assert!(failure(&["report", dir, "--out", "no/such/folder/r.html"]).contains("cannot write"));
    assert!(failure(&["report", dir, "--model", "none.toml"]).contains("none.toml: cannot read"));
    // The name of another format: refused before anything is computed or written.
    for name in ["report.pdf", "report.PDF", "report.docx"] {
        let file = folder.path().join(name);
        assert!(
            failure(&["report", dir, "--out", path(&file)]).contains("expected a name that ends in .html")
        );
        assert!(!file.exists(), "{name}");
    }
    assert_eq!(guide(&["report", dir, "--date", "yesterday"]).status.code(), Some(2));
}

/// The first of the names under which browsers of this family are installed.
fn browser() -> Option<PathBuf> {
    let folders: Vec<PathBuf> = std::env::split_paths(&std::env::var_os("PATH")?).collect();
    let names = ["chromium", "google-chrome", "chromium-browser", "chromium-headless-shell"];
    names
        .iter()
        .flat_map(|name| folders.iter().map(move |folder| folder.join(name)))
        .find(|file| file.is_file())
}

#[test]
fn a_report_fits_a_browser_window() {
    let Some(browser) = browser() else {
        println!("skipped: neither chromium nor google-chrome is on the PATH");
        return;
    };
    let folder = folder();
    session(folder.path());
    json(&["report", path(folder.path()), "--json"]);
    let page = folder.path().join("report.html");
    let run = |page: &Path, options: &[&str]| {
        let profile = format!("--user-data-dir={}", folder.path().join("profile").display());
        let size = format!("--window-size={WIDTH},1400");
        let output = Command::new(&browser)
            .args(["--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", &profile, &size])
            .args(options)
            .arg(format!("file://{}", page.display()))
            .output()
            .expect("the browser starts");
        assert!(output.status.success(), "{}", text(&output.stderr));
        text(&output.stdout)
    };

    let picture = folder.path().join("report.png");
    run(&page, &[&format!("--screenshot={}", picture.display())]);
    let file = BufReader::new(File::open(&picture).expect("a picture"));
    let mut decoder = png::Decoder::new(file);
    decoder.set_transformations(png::Transformations::normalize_to_color8());
    let mut reader = decoder.read_info().expect("a PNG");
    let mut pixels = vec![0; reader.output_buffer_size().expect("a size")];
    let info = reader.next_frame(&mut pixels).expect("a picture");
    let samples = info.color_type.samples();
    let colours: BTreeSet<&[u8]> = pixels[..info.buffer_size()].chunks_exact(samples).collect();
    assert_eq!(info.width, WIDTH);
    assert!(colours.len() > 20, "the picture is blank: {} colours", colours.len());

    // A copy with its width stated.
    let measured = folder.path().join("measured.html");
    let script = "<script>document.body.dataset.width = document.documentElement.scrollWidth + '/' + innerWidth</script></body>";
    let html = fs::read_to_string(&page).expect("written");
    fs::write(&measured, html.replace("</body>", script)).expect("writes");
    let dom = run(&measured, &["--dump-dom"]);
    let widths =
        dom.split_once("data-width=\"").and_then(|(_, rest)| rest.split_once('"')).expect("widths").0;
    let (content, window) = widths.split_once('/').expect("two widths");
    let [content, window] = [content, window].map(|width| width.parse::<u32>().expect("a number"));
    assert!(content <= window && window <= WIDTH, "{content} of {window} pixels");
}
