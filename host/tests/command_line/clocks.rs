//! Clocks of tables: one that files share, two that ramps bring together, and those of a computer.

use super::tables::{GRAVITY, Native, imported, imported_alone, modulus, notes};

#[test]
fn a_computers_clock_gives_the_same_modulus_to_the_last_digit() {
    let native = Native::new();
    let k_kpa = |start: &str, name: &str| {
        let file = native.file(name, "t,x,f\n", |_, t, x, f| {
            // Digits are added as text, so that the clock's own rounding is none.
            format!("{start}{:06.3},{x:.6},{f:.6}", t)
        });
        let maps = ["--map", "t=time_s:s", "--map", "x=displacement_y_mm:mm", "--map", "f=force_y_n:N"];
        imported(&native, name, &[&file], &maps, 5e-3);
        modulus(&native.dir(&format!("out-{name}")))
    };
    let from_zero = k_kpa("", "zero.csv");
    for (start, name) in [("17640000", "epoch.csv"), ("86400", "day.csv"), ("100000000", "century.csv")] {
        assert_eq!(k_kpa(start, name), from_zero, "{name}");
    }
}

#[test]
fn two_files_of_one_clock_or_two_give_the_modulus() {
    let native = Native::new();
    let wrench = native.file(
        "wrench.csv",
        "%time,field.header.seq,field.wrench.force.x,field.wrench.force.y\n",
        |i, t, _, f| format!("{},{i},0.01,{f:.6}", stamp(t)),
    );
    let joints = native.file("joints.csv", "%time,field.header.seq,field.position0\n", |i, t, x, _| {
        format!("{},{i},{:.9}", stamp(t + 1e-3), 1e-3 * x)
    });
    let maps = [
        "--map",
        "field.wrench.force.y=force_y_n:N",
        "--map",
        "field.position0=displacement_y_mm:m",
        "--map",
        "%time=time_s",
    ];
    let import_json = imported(&native, "topics", &[&wrench, &joints], &maps, 5e-3);
    assert!(
        import_json["runs"][0]["offset_s"].is_null() && notes(&import_json).contains("since 1970"),
        "{import_json}"
    );

    // A load cell and a stage that were started one after the other: 7.3 s, found by the ramp.
    let scale = native.file("scale.csv", "Time (ms),Force (kg)\n", |_, t, _, f| {
        format!("{:.0},{:.6}", 1e3 * t, f / GRAVITY)
    });
    let stage = native
        .file("stage.csv", "Time [s];Stage X\n", |_, t, x, _| format!("{:.3};{:.6}", t + 7.3, 1e-3 * x));
    let maps = ["--map", "Force (kg)=force_y_n", "--map", "Stage X=displacement_y_mm:m"];
    let import_json = imported(&native, "clocks", &[&scale, &stage], &maps, 1e-2);
    let offset_error_s = clock_value("offset_s", &import_json) + 7.3;
    assert!(
        offset_error_s.abs() < 3.0 * clock_value("offset_sd_s", &import_json)
            && clock_value("offset_sd_s", &import_json) < 0.05,
        "{offset_error_s} of {}",
        clock_value("offset_sd_s", &import_json)
    );
    assert!(notes(&import_json).contains("clocks of their own"), "{import_json}");
    // One clock by its name, although both count from their start.
    let combined_file = native
        .file("both.csv", "Time (ms),Stage X\n", |_, t, x, _| format!("{:.0},{:.6}", 1e3 * t, 1e-3 * x));
    let named = [&maps[..], &["--merge-on", "Time (ms)"]].concat();
    let import_json = imported(&native, "named", &[&scale, &combined_file], &named, 5e-3);
    assert!(import_json["runs"][0]["offset_s"].is_null(), "{import_json}");
    // Or as it is known.
    let offset_maps = [&maps[..], &["--offset-s", "-7.3"]].concat();
    imported(&native, "known", &[&scale, &stage], &offset_maps, 5e-3);
}

fn clock_value(name: &str, import_json: &serde_json::Value) -> f64 {
    import_json["runs"][0][name].as_f64().expect(name)
}

/// A topic each, as rostopic writes them: nanoseconds since 1970, at other rates.
fn stamp(t: f64) -> i64 {
    1_764_000_000_000_000_000 + (1e9 * t).round() as i64
}

/// Two laboratories of which nothing is known but their files: three tables of two clocks, and a clock of whole seconds.
#[test]
fn files_of_two_strangers_become_the_modulus_in_a_command_each() {
    let native = Native::new();
    let before = "Pr\u{fc}fstand Nadel\r\nAbtastrate: 50 Hz\r\n\r\nMesszeit [s];Kanal 3: Kraft Fz [cN];Kanal 4: Temperatur [\u{b0}C]\r\n";
    let cell =
        native.file("Messung.txt", before, |_, t, _, f| format!("{};{};22,4", comma(t), comma(100.0 * f)));
    let stage =
        native.file("stage.csv", "# log v3\ntimestamp_ms,ch0_position_nm,ch0_status\n", |_, t, x, _| {
            format!("{:.0},{:.0},OK", 8_812_345.0 + 1e3 * t, 1e6 * (12.4 + x))
        });
    let camera =
        native.shape_as("kamera.csv", "Messzeit [s];Abstand [cm];Auslenkung [\u{b5}m]\n", |z_mm, y_mm| {
            format!("{};{};{}", comma(7.5), comma(0.1 * z_mm), comma(1e3 * y_mm))
        });
    let maps = [
        "--map",
        "Kanal 3: Kraft Fz [cN]=force_y_n",
        "--map",
        "ch0_position_nm=displacement_y_mm",
        "--map",
        "Abstand [cm]=z_mm",
        "--map",
        "Auslenkung [\u{b5}m]=deflection_y_mm",
        "--merge-on",
        "Messzeit [s]",
        "--z-from",
        "surface",
    ];
    let import_json = imported_alone(&native, "german", &[&cell, &stage, &camera], &maps, 1e-2);
    let offset_error_s = import_json["runs"][0]["offset_s"].as_f64().expect("an offset") + 8_812.345;
    assert!(offset_error_s.abs() < 0.05, "{offset_error_s}");

    let tester = native.file(
        "run 3.csv",
        "Test,Gel pull 3\n\nDate/Time,Crosshead (in),Load (ozf),Remarks\n",
        |i, t, x, f| {
            let below = if i == 399 { "\r\n,3.2282,-1.4,mean" } else { "" };
            format!("{},{:.6},{:.6},{below}", date(t), 3.25 - x / 25.4, -f / 0.278_013_850_953_781_1)
        },
    );
    let shape = native.shape_as("bow.csv", "Date/Time,z (in),bow (in)\n", |z_mm, y_mm| {
        format!("{},{:.7},{:.7}", date(7.2), (70.0 + z_mm) / 25.4, -y_mm / 25.4)
    });
    let import_json = imported_alone(&native, "american", &[&tester, &shape], &["--z-from", "guide1"], 1e-2);
    assert!(notes(&import_json).contains("spread evenly, 50.0"), "{import_json}");
}

fn date(t: f64) -> String {
    format!("05/04/2026 02:03:{:02.0} PM", (7.34 + t).floor())
}

fn comma(value: f64) -> String {
    format!("{value:.6}").replace('.', ",")
}
