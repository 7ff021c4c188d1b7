//! Tables of any laboratory, from files to the modulus in one command each. Columns, units and separators are those of recordings and programs
//! of others; the numbers are made here, from one run whose modulus is known.

use super::{add_lateral_run, failure, folder, guide, json, path, text, writer};
use formats::session::{LateralRun, Session};
use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

pub(super) const GRAVITY: f64 = 9.806_65;
const POUND_N: f64 = 4.448_221_615_260_5;

/// A run of its own session, and a folder for files that are made of it.
pub(super) struct Native {
    folder: TempDir,
    run: LateralRun,
}

impl Native {
    pub(super) fn new() -> Self {
        let folder = folder();
        let native = folder.path().join("native");
        add_lateral_run(&mut writer(&native));
        let run = Session::read(&native).expect("reads").lateral.remove(0);
        Self { folder, run }
    }

    pub(super) fn dir(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Writes a file with a line for each row of time in seconds, displacement in millimetres, force in newtons.
    pub(super) fn file(
        &self,
        name: &str,
        before: &str,
        row: impl Fn(usize, f64, f64, f64) -> String,
    ) -> String {
        let force = &self.run.force;
        let rows = force.time_s.iter().zip(&force.displacement_y_m).zip(&force.force_y_n).enumerate();
        let lines = rows.map(|(at, ((time_s, y_m), force_n))| row(at, *time_s, 1e3 * y_m, *force_n) + "\r\n");
        self.write(name, (before.to_owned() + &lines.collect::<String>()).as_bytes())
    }

    fn write(&self, name: &str, bytes: &[u8]) -> String {
        let file = self.dir(name);
        fs::write(&file, bytes).expect("written");
        path(&file).to_owned()
    }

    /// The shape from the surface, millimetres, as a table of its own.
    pub(super) fn shape_as(&self, name: &str, before: &str, row: impl Fn(f64, f64) -> String) -> String {
        let points = self.run.shape.z_m.iter().zip(&self.run.shape.y_m);
        let lines = points.map(|(z_m, y_m)| row(1e3 * z_m - 70.0, 1e3 * y_m) + "\n");
        self.write(name, (before.to_owned() + &lines.collect::<String>()).as_bytes())
    }
}

const SHAPE: [&str; 6] =
    ["--map", "Abstand=z_mm", "--map", "Durchbiegung=deflection_y_mm", "--z-from", "surface"];

pub(super) fn modulus(dir: &Path) -> f64 {
    json(&["identify", path(dir), "--json"])["pooled"]["k_kpa"].as_f64().expect("a modulus")
}

/// Imports files and their shape; the modulus is that of the native session within a share.
pub(super) fn imported(
    native: &Native,
    name: &str,
    files: &[&str],
    options: &[&str],
    within: f64,
) -> serde_json::Value {
    let shape = native.shape_as("shape.csv", "Abstand [mm];Durchbiegung [µm]\n", |z_mm, y_mm| {
        format!("{z_mm:.4};{:.3}", 1e3 * y_mm).replace('.', ",")
    });
    imported_alone(native, name, &[files, &[shape.as_str()]].concat(), &[options, &SHAPE].concat(), within)
}

/// As [`imported`], of files that have the shape too.
pub(super) fn imported_alone(
    native: &Native,
    name: &str,
    files: &[&str],
    options: &[&str],
    within: f64,
) -> serde_json::Value {
    let (output_dir, rig) = (native.dir(&format!("out-{name}")), native.dir("native/session.toml"));
    let common = ["--depth-mm", "30", "--rig", path(&rig), "--out", path(&output_dir), "--yes", "--json"];
    let import_json = json(&[&["import", "table"], files, options, &common].concat());
    let (native_kpa, imported_kpa) = (modulus(&native.dir("native")), modulus(&output_dir));
    assert!((imported_kpa / native_kpa - 1.0).abs() < within, "{name}: {imported_kpa} and {native_kpa}");
    import_json
}

pub(super) fn notes(done: &serde_json::Value) -> String {
    done["runs"][0]["notes"].to_string()
}

#[test]
fn one_file_of_any_layout_gives_the_modulus() {
    let native = Native::new();
    let layouts: Vec<(&str, String, Vec<String>)> = vec![
        (
            "tensile tester, comma",
            native.file("tester.csv", "Time (s),Extension (mm),Load (N)\n", |_, t, x, f| format!("{t},{x:.6},{f:.6}")),
            maps_of("Load (N)=force_y_n", "Extension (mm)=displacement_y_mm"),
        ),
        (
            "microcontroller with raw counts",
            native.file("motor.csv", "time (ms),forceRaw,force (mN), encoderRaw,position (um)\n", |i, t, x, f| {
                format!("{:.0},{},{:.3},{},{:.3}", 1e3 * t, 400 + i, 1e3 * f, 9000 + i, 1e3 * x)
            }),
            maps_of("force (mN)=force_y_n", "position (um)=displacement_y_mm"),
        ),
        (
            "hydraulic tester: preamble, tabulators, decimal commas, a line of units, forces down",
            native.file(
                "mts.txt",
                "MTS793|MPT|ENU|1|2\r\nData Header:\tTimed\r\n\r\nTime\t25 N MTS Force\t250 MTS Displacement\r\nSec\tkN\tmm\r\n",
                |_, t, x, f| format!("{}\t{}\t{}", mts(t), mts(-1e-3 * f), mts(-x)),
            ),
            maps_of("25 N MTS Force=force_y_n:-kN", "250 MTS Displacement=displacement_y_mm:-mm"),
        ),
        (
            "rock mechanics: pounds and channels",
            native.file("rock.csv", "Time (sec),Ch:Load (lbs),Ch:Position (mm),Ch:Stress (PSI)\n", |_, t, x, f| {
                format!("{t},{:.8},{x:.6},{}", f / POUND_N, 0.5)
            }),
            maps_of("Ch:Load (lbs)=force_y_n", "Ch:Position (mm)=displacement_y_mm"),
        ),
        (
            "materials tester of Windows: Latin-1, semicolons, decimal commas, units below the names",
            {
                let mut bytes = b"\"Pr\xfcfzeit\";\"Standardweg\";\"Standardkraft\"\r\n\"s\";\"\xb5m\";\"N\"\r\n".to_vec();
                let force = &native.run.force;
                for ((t, x), f) in force.time_s.iter().zip(&force.displacement_y_m).zip(&force.force_y_n) {
                    bytes.extend(format!("{};{};{}\r\n", mts(*t), mts(1e6 * x), mts(*f)).into_bytes());
                }
                native.write("zwick.TXT", &bytes)
            },
            [maps_of("Standardkraft=force_y_n", "Standardweg=displacement_y_mm"), ["--map", "Prüfzeit=time_s"].map(str::to_owned).to_vec()]
                .concat(),
        ),
        (
            "script of a robot: seconds since 1970, a stage at 112 mm, axes by name",
            native.file("robot.csv", "t_unix,pos_x,pos_y,pos_z,force_x,force_y\n", |_, t, x, f| {
                format!("{:.6},{:.7},0.2,0.3,{:.6},{:.6}", 1_764_000_000.0 + t, 0.112 + 1e-3 * x, 0.01, f)
            }),
            [maps_of("force_y=force_y_n:N", "pos_x=displacement_y_mm:m"), ["--map", "t_unix=time_s"].map(str::to_owned).to_vec()].concat(),
        ),
        (
            "blanks, no names, a preamble of 22 lines with numbers in it",
            native.file("friction.dat", &(1..=22).map(|i| format!("setting {i} = {i}.5\n")).collect::<String>(), |i, t, x, f| {
                format!(" {t:.4}   {f:.6}  {}  {x:.6}", 0.1 * i as f64)
            }),
            [maps_of("#2=force_y_n:N", "#4=displacement_y_mm:mm"), ["--map", "#1=time_s:s"].map(str::to_owned).to_vec()].concat(),
        ),
        (
            "data logger: dates, times of day, grams, UTF-16",
            {
                let mut lines = "Sample;Date and Time;Load [gf];Stage [inch]\n".to_owned();
                let force = &native.run.force;
                for (at, ((t, x), f)) in force.time_s.iter().zip(&force.displacement_y_m).zip(&force.force_y_n).enumerate() {
                    let (second, milli) = (58 + *t as u32, (1e3 * t).round() as u32 % 1000);
                    let (hour, minute, second) = if second < 60 { (23, 59, second) } else { (0, 0, second - 60) };
                    let day = if hour == 23 { 30 } else { 31 };
                    let _ = writeln!(
                        lines,
                        "{at};{day}.12.2025 {hour:02}:{minute:02}:{second:02}.{milli:03};{:.5};{:.8}",
                        1e3 * f / GRAVITY,
                        x / 0.0254
                    );
                }
                native.write("logger.csv", &[&[0xFF, 0xFE][..], &lines.encode_utf16().flat_map(u16::to_le_bytes).collect::<Vec<u8>>()].concat())
            },
            maps_of("Load [gf]=force_y_n", "Stage [inch]=displacement_y_mm"),
        ),
        (
            "numpy: a header behind a mark, scientific notation",
            native.file("numpy.txt", "# t force disp\n", |_, t, x, f| format!("{t:.18e} {f:.18e} {:.18e}", 1e-3 * x)),
            [maps_of("force=force_y_n:N", "disp=displacement_y_mm:m"), ["--map", "t=time_s:s"].map(str::to_owned).to_vec()].concat(),
        ),
        (
            "instrument program: header of its own, rows at a rate, vertical bars",
            native.file("lvm.txt", "LabVIEW Measurement\nWriter_Version|2\n***End_of_Header***\nX_Value|Fy|LVDT|Comment\n", |i, _, x, f| {
                format!("{i}|{:.6}|{x:.6}|", 1e3 * f)
            }),
            [maps_of("Fy=force_y_n:mN", "LVDT=displacement_y_mm:mm"), ["--rate-hz", "50"].map(str::to_owned).to_vec()].concat(),
        ),
        (
            "force plate of a gait laboratory: a name and a unit over each column, tabulators, times from frames, newtons down",
            native.file("plate.txt", "Trajectories\n100\nFrame\tSub Frame\tFy\tStage\ncount\tcount\tN\tum\n", |i, _, x, f| {
                format!("{}\t0\t{:.6}\t{:.4}", i + 1, -f, 1e3 * x)
            }),
            [maps_of("Fy=force_y_n:-N", "Stage=displacement_y_mm"), ["--rate-hz", "50"].map(str::to_owned).to_vec()].concat(),
        ),
        (
            "data frame of R: quoted names, times as minutes and seconds, kilograms",
            native.file("frame.csv", "\"\",\"elapsed\",\"cell.kg\",\"travel.mm\"\n", |i, t, x, f| {
                format!("\"{}\",\"0:{:02}:{:06.3}\",{:.8},{:.6}", i + 1, t as u32 / 60, t % 60.0, f / GRAVITY, x)
            }),
            maps_of("cell.kg=force_y_n:kg", "travel.mm=displacement_y_mm:mm"),
        ),
    ];
    assert_eq!(layouts.len(), 12);
    for (name, file, options) in &layouts {
        let options: Vec<&str> = options.iter().map(String::as_str).collect();
        let id = name.split([' ', ',', ':']).next().unwrap_or_default();
        let import_json = imported(&native, id, &[file], &options, 5e-3);
        // The echo: what was taken for what, and the command that repeats it.
        let column_names: Vec<&str> = import_json["runs"][0]["columns"]
            .as_array()
            .expect("columns")
            .iter()
            .filter_map(|one| one["is"].as_str())
            .collect();
        for quantity in ["force_y_n", "displacement_y_mm", "z_mm", "deflection_y_mm"] {
            assert!(column_names.contains(&quantity), "{name}: {column_names:?}");
        }
        let again = import_json["again"].as_str().expect("a command line");
        assert!(again.starts_with("guide import table") && again.contains("--map"), "{name}: {again}");
    }
}

/// The user states force and displacement; the other columns are recognized.
fn maps_of(force: &str, moved: &str) -> Vec<String> {
    ["--map", force, "--map", moved].map(str::to_owned).to_vec()
}

fn mts(value: f64) -> String {
    format!("{value:.8}").replace('.', ",")
}

#[test]
fn the_echo_states_what_was_taken_and_the_command_that_repeats_it() {
    let native = Native::new();
    let file =
        native.file("my test.csv", "Time (s),Extension (mm),Load (N),Temp (C),Comment\n", |_, t, x, f| {
            format!("{t},{:.6},{f:.6},21.5,ok", x + 40.0)
        });
    let (output_dir, rig, map) =
        (native.dir("out"), native.dir("native/session.toml"), native.dir("map.toml"));
    let common = ["--depth-mm", "30", "--rig", path(&rig), "--out", path(&output_dir)];
    // A script that does not confirm writes nothing.
    let silent = failure(&[&["import", "table", file.as_str()], &common[..]].concat());
    assert!(silent.contains("expected --yes") && !output_dir.exists(), "{silent}");
    // Everything is found by names and units.
    let shown = guide(
        &[&["import", "table", file.as_str(), "--yes", "--save-map", path(&map)], &common[..]].concat(),
    );
    assert!(shown.status.success(), "{}", text(&shown.stderr));
    let echo = text(&shown.stderr);
    for part in [
        "force_y_n          Load (N)        N",
        "displacement_y_mm  Extension (mm)  mm",
        "time_s             Time (s)        s",
        "not taken: ",
        "Temp (C), Comment",
        "UTF-8, commas, decimal points, names in line 1, 400 rows",
        "is never near 0",
        "its zero is where the run begins",
        "again: guide import table",
        "--map 'Load (N)=force_y_n:N'",
    ] {
        assert!(echo.contains(part), "{part} is not in\n{echo}");
    }
    assert!(
        text(&shown.stdout).contains("my-test: 400 rows, 30.0 mm deep, without a shape"),
        "{}",
        text(&shown.stdout)
    );
    let first = Session::read(&output_dir).expect("reads").lateral.remove(0);
    // The command line that is shown, in another folder.
    let again = echo.lines().find_map(|line| line.split_once("again: guide ")).expect("a command line").1;
    let words = shlex::split(again).expect("words");
    let other_dir = native.dir("other");
    let words: Vec<&str> =
        words.iter().map(|word| if word == path(&output_dir) { path(&other_dir) } else { word }).collect();
    assert!(guide(&words).status.success());
    assert_eq!(Session::read(&other_dir).expect("reads").lateral[0].force, first.force);
    // The map for a folder: a run for each of its tables.
    let many = native.dir("many");
    fs::create_dir(&many).expect("a folder");
    for name in ["a.csv", "b.csv", "._a.csv"] {
        fs::copy(&file, many.join(name)).expect("a copy");
    }
    let all_dir = native.dir("all");
    let import_json = json(&[
        "import",
        "table",
        path(&many),
        "--map-file",
        path(&map),
        "--depth-mm",
        "30",
        "--rig",
        path(&rig),
        "--out",
        path(&all_dir),
        "--yes",
        "--json",
    ]);
    assert_eq!(import_json["runs"].as_array().map(Vec::len), Some(2));
    assert_eq!(Session::read(&all_dir).expect("reads").lateral[1].force, first.force);
}

#[test]
fn what_is_not_known_is_asked_for_by_name() {
    let native = Native::new();
    let output_dir = native.dir("out");
    let with = |name: &str, before: &str, options: &[&str]| {
        let file = native.file(name, before, |_, t, x, f| format!("{t},{x:.6},{f:.6}"));
        failure(&[&["import", "table", file.as_str(), "--out", path(&output_dir), "--yes"], options].concat())
    };
    let depth = ["--depth-mm", "30"];
    for (before, options, words) in [
        ("Time (s),Extension,Load (N)\n", &depth[..], "'Extension=displacement_y_mm': no unit is stated"),
        ("Time (s),Extension (mm),Load (V)\n", &depth, "'Load (V)=force_y_n': no unit is stated"),
        (
            "Time (s),Extension (N),Load (N)\n",
            &["--map", "Extension (N)=displacement_y_mm"],
            "its unit, N, is one of force",
        ),
        ("a,b,c\n", &depth, "--map 'COLUMN=QUANTITY:UNIT' for each"),
        ("Time (s),Extension (mm),Load (N)\n", &[], "--depth-mm: missing"),
        ("Time (s),Extension (m),Load (N)\n", &depth, "is the unit right?"),
        (
            "Time (s),Extension (mm),Load (N)\n",
            &["--map", "Force=force_y_n:N"],
            "no file has such a column of numbers, expected one of \"Time (s)\"",
        ),
        ("x,Extension (mm),Load (N)\n", &depth, "no column of times among"),
        (
            "Time (s),Extension (mm),Load (N)\n",
            &[
                "--map",
                "Load (N)=force_y_n",
                "--map",
                "Extension (mm)=z_mm",
                "--map",
                "Extension (mm)=displacement_y_mm",
                "--map",
                "Extension (mm)=deflection_y_mm",
            ],
            "--z-from: missing",
        ),
    ] {
        let printed = with("t.csv", before, options);
        assert!(printed.contains(words), "{words} is not in {printed}");
    }
    for (map, words) in [
        ("Load=force", "\"force\" is no quantity"),
        ("Load=force_y_n:mm", "\"mm\" is no unit of force"),
        ("Load", "no =, expected COLUMN=QUANTITY:UNIT"),
    ] {
        let output = guide(&["import", "table", "x.csv", "--out", path(&output_dir), "--map", map]);
        assert!(
            output.status.code() == Some(2) && text(&output.stderr).contains(words),
            "{}",
            text(&output.stderr)
        );
    }
    // A clock that steps back, and a cell that is no number, at their lines.
    let returning = native.file("back.csv", "Time (s),Extension (mm),Load (N)\n", |i, t, x, f| {
        format!("{:.3},{x:.6},{f:.6}", if i < 200 { t + 20.0 } else { t })
    });
    let printed =
        failure(&["import", "table", &returning, "--out", path(&output_dir), "--yes", "--depth-mm", "30"]);
    assert!(printed.contains("back.csv:202: Time (s): 19.980000 s before the row before"), "{printed}");
    let word = native.file("word.csv", "Time (s),Extension (mm),Load (N)\n", |i, t, x, f| {
        if i == 9 { format!("{t},{x},over") } else { format!("{t},{x},{f}") }
    });
    let printed =
        failure(&["import", "table", &word, "--out", path(&output_dir), "--yes", "--depth-mm", "30"]);
    assert!(printed.contains("word.csv:11: Load (N): \"over\" is not a number"), "{printed}");
    let mixed = failure(&["import", "fbg", &word, "--out", path(&output_dir), "--map", "Load (N)=force_y_n"]);
    assert!(mixed.contains("options that are for tables"), "{mixed}");
}
