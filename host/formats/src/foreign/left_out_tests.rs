//! Rows and numbers of a table that are no readings.

use super::layout_tests::{lines, same, taken, truth};

#[test]
fn rows_that_a_column_marks_as_unusable_are_not_used() {
    for (name, good, bad) in [
        ("Status", "OK", "OVERLOAD"),
        ("valid", "1", "0"),
        ("sensor_status", "ok", "Out of range"),
        ("Is valid", "true", "false"),
        ("fault", "0", "1"),
        ("Cell overload", "no", "yes"),
        ("Error code", "0", "17"),
    ] {
        let bytes = lines(&format!("Time (s),Extension (mm),Load (N),{name}\n"), |i, t, x, f| {
            if (200..205).contains(&i) { format!("{t},{x},9.9,{bad}") } else { format!("{t},{x},{f},{good}") }
        });
        let lateral_run = taken(&bytes, &[], None).expect("a run");
        let force = lateral_run.force.expect("a force");
        let largest = force.force_y_n.iter().copied().fold(0.0, f64::max);
        assert!(force.time_s.len() == 395 && largest < 1.0, "{name}: {largest}");
        let note = format!("5 rows whose \"{name}\" is {bad} are skipped");
        assert!(lateral_run.notes.iter().any(|known| known.contains(&note)), "{:?}", lateral_run.notes);
    }
    let bytes = lines("Time (s),Extension (mm),Load (N),Status\n", |i, t, x, f| {
        format!("{t},{x},{f},{}", 4 * (i / 300))
    });
    let lateral_run = taken(&bytes, &[], None).expect("a run");
    assert_eq!(lateral_run.force.expect("a force").time_s.len(), 400);
    assert!(
        lateral_run.notes.iter().any(|note| note.contains("\"Status\" has 0, 4")),
        "{:?}",
        lateral_run.notes
    );
}

#[test]
fn numbers_that_stand_for_no_reading_are_none() {
    for mark in ["-99.99", "9999", "-999", "32767", "-32768"] {
        let bytes = lines("Time (s),Extension (mm),Load (mN)\n", |i, t, x, f| {
            // Among the readings are numbers of nines, too.
            let force = if i == 3 { 9.9 } else { 1e3 * f };
            if i % 90 == 7 { format!("{t},{x},{mark}") } else { format!("{t},{x},{force}") }
        });
        let lateral_run = taken(&bytes, &[], None).expect("a run");
        let force = lateral_run.force.expect("a force");
        assert_eq!(force.time_s.len(), 395, "{mark}: {:?}", lateral_run.notes);
        assert!(force.force_y_n.iter().all(|force_n| force_n.abs() < 0.5), "{mark}");
        assert!(lateral_run.notes.iter().any(|note| note.contains(mark)), "{mark}: {:?}", lateral_run.notes);
    }
    // Levels of a stage, and a number of nines among others.
    same(
        "levels",
        &lines("Time (s),Stage (um),Load (N)\n", |_, t, x, f| format!("{t},{:.6},{f}", 1e3 * x)),
        &["Stage (um)=displacement_y_mm"],
        None,
    );
}

#[test]
fn marks_are_told_from_readings_by_the_steps_of_the_column() {
    let header = "Time (s),Extension (mm),Load (N)\n";
    let marks = ["9999", "-9999", "1e30", "3.4028235e38", "-3.697314E28", "9.91E+37"];
    let bytes = lines(header, |i, t, x, f| {
        marks
            .get(i.wrapping_sub(77) / 20)
            .filter(|_| i % 20 == 17)
            .map_or_else(|| format!("{t},{x},{f}"), |mark| format!("{t},{x},{mark}"))
    });
    let run = taken(&bytes, &[], None).expect("a run");
    assert_eq!(run.force.expect("a force").time_s.len(), 394, "{:?}", run.notes);
    assert!(
        run.notes.iter().any(|note| note.contains("line 79: \"Load (N)\": 9999 differs from")),
        "{:?}",
        run.notes
    );
    // More than a quarter of the readings, and a stage whose highest level is of nines.
    let bytes = lines(
        header,
        |i, t, x, f| if i % 3 == 0 { format!("{t},{x},-99.9") } else { format!("{t},{x},{f}") },
    );
    assert_eq!(taken(&bytes, &[], None).expect("a run").force.expect("a force").time_s.len(), 266);
    fn stage(i: usize) -> f64 {
        [0.0, 33.0, 66.0, 99.0, 66.0, 33.0, 0.0, 33.0][i / 50]
    }
    let bytes = lines("Time (s),Stage (um),Load (N)\n", |i, t, _, f| format!("{t},{},{f}", stage(i)));
    let force =
        taken(&bytes, &["Stage (um)=displacement_y_mm"], None).expect("a run").force.expect("a force");
    assert_eq!(force.time_s.len(), 400);
    assert!((force.displacement_y_m[160] - 99e-6).abs() < 1e-9);
}

#[test]
fn the_last_reading_is_one_unless_it_is_cut_off() {
    let header = "Time (s),Extension (mm),Load (N)\n";
    let whole = lines(header, |_, t, x, f| format!("{t:.3},{x:.4},{f:.5}"));
    // Without an end of the line; then without its last digits.
    let without_end = &whole[..whole.len() - 2];
    assert_eq!(taken(without_end, &[], None).expect("a run").force.expect("a force").time_s.len(), 400);
    for cut in [3, 5, 7] {
        let run = taken(&whole[..whole.len() - cut], &[], None).expect("a run");
        assert_eq!(run.force.expect("a force").time_s.len(), 399, "{cut}");
        assert!(
            run.notes.iter().any(|note| note.contains("line 401: the last row is cut off")),
            "{:?}",
            run.notes
        );
    }
    // A short table of a program that leaves out zeros at the end.
    let short: Vec<String> = (1..16)
        .map(|i| {
            format!("{i},{i}.{}5,{}", i % 5, if i == 15 { "0.3".to_owned() } else { format!("0.{}7", i % 3) })
        })
        .collect();
    let run = taken((header.to_owned() + &short.join("\n")).as_bytes(), &["Time (s)=time_s:s"], None)
        .expect("a run");
    assert_eq!(run.force.expect("a force").time_s.len(), 15, "{:?}", run.notes);
    // Every number of the last row is the greatest of its column, and a counter goes on.
    let bytes = lines("Frame,Time (s),Extension (mm),Load (N)\n", |i, t, x, _| {
        format!("{},{t:.2},{x:.4},{:.5}", i + 1, 0.3 * x)
    });
    let run = taken(&bytes, &[], None).expect("a run");
    assert_eq!(run.force.expect("a force").time_s.len(), 400, "{:?}", run.notes);
}

#[test]
fn names_are_found_beside_marks_and_empty_columns() {
    let header = "Time (s),Extension (mm),Load (N)\n";
    same("a separator behind every row", &lines(header, |_, t, x, f| format!("{t},{x},{f},")), &[], None);
    let semicolons = lines("Time (s);Extension (mm);Load (N)\n", |_, t, x, f| format!("{t};{x};{f};"));
    same("semicolons", &semicolons, &[], None);
    // The mark of UTF-16 is no part of the first name; a time that is named counts beside one that is found.
    let text = String::from_utf8(lines(&format!("\u{feff}{header}"), |_, t, x, f| format!("{t},{x},{f}")))
        .expect("text");
    let wide: Vec<u8> = text.encode_utf16().flat_map(u16::to_le_bytes).collect();
    same("UTF-16", &wide, &["Time (s)=time_s:s"], None);
    let stamps = lines("%time,field.header.stamp,x (mm),f (N)\n", |_, t, x, f| {
        let ns = 1_764_324_000_000_000_000 + (1e9 * t).round() as i64;
        format!("{ns},{},{x},{f}", ns + 5000)
    });
    same("two times", &stamps, &["%time=time_s:ns", "x (mm)=displacement_y_mm", "f (N)=force_y_n"], None);
}

#[test]
fn remarks_summaries_and_names_in_other_places_are_no_readings() {
    fn row(t: f64, x: f64, f: f64) -> String {
        format!("{t:.3},{x:.6},{f:.6}")
    }
    let header = "Time (s),Extension (mm),Load (N)\n";
    fn remark(i: usize, t: f64, x: f64, f: f64) -> String {
        if i == 9 { format!("{}\r\n# pause, 3, 4", row(t, x, f)) } else { row(t, x, f) }
    }
    same("remark", &lines(header, remark), &[], None);
    fn summary(i: usize, t: f64, x: f64, f: f64) -> String {
        if i == 399 { format!("{}\r\n\r\nMax,1.2,0.3\r\nMean,0.6,0.1", row(t, x, f)) } else { row(t, x, f) }
    }
    same("summary", &lines(header, summary), &[], None);
    statistics_at_the_end_are_no_readings(header);
    same(
        "names of two lines",
        &lines("\"Time\n(s)\",\"Extension\n(mm)\",\"Load\n(N)\"\n", |_, t, x, f| row(t, x, f)),
        &[],
        None,
    );
    same(
        "numbered rows of R",
        &lines("\"Time_s\" \"Stage_mm\" \"Force_N\"\n", |i, t, x, f| {
            format!("\"{}\" {}", i + 1, row(t, x, f).replace(',', " "))
        }),
        &[],
        None,
    );
    same("single quotes", &lines(header, |_, t, x, f| format!("'{t:.3}','{x:.6}','{f:.6}'")), &[], None);
    same(
        "text of a spreadsheet",
        &lines(header, |_, t, x, f| format!("=\"{t:.3}\",=\"{x:.6}\",=\"{f:.6}\"")),
        &[],
        None,
    );
    fn apart(value: f64) -> String {
        format!("{value:.6}").replace('-', "- ")
    }
    same(
        "a blank behind the sign",
        &lines(header, |_, t, x, f| format!("{t},{},{}", apart(x), apart(f))),
        &[],
        None,
    );
    let words = ["-nan(ind)", "1.#QNAN", "-nan", "-1.#IND"];
    let bytes = lines(header, |i, t, x, f| {
        words.get(i.wrapping_sub(9)).map_or_else(|| row(t, x, f), |word| format!("{t},{x},{word}"))
    });
    assert_eq!(taken(&bytes, &[], None).expect("a run").force.expect("a force").time_s.len(), 396);
    // Names again, in another order or other ones: the columns below them are others.
    for again in ["Time (s),Load (N),Extension (mm)", "t,force,travel", header.trim_end()] {
        let two = lines(
            header,
            |i, t, x, f| if i == 200 { format!("{again}\r\n{t},{f},{x}") } else { row(t, x, f) },
        );
        let error = taken(&two, &[], None).expect_err(again).to_string();
        assert!(error.contains("line 202 has names again"), "{error}");
    }
    let dashes = lines(header, |i, t, x, f| if i == 9 { format!("{t},{x},---") } else { row(t, x, f) });
    assert_eq!(taken(&dashes, &[], None).expect("a run").force.expect("a force").time_s.len(), 399);
    let mut zeros = lines(header, |_, t, x, f| row(t, x, f));
    zeros.extend([0; 512]);
    same("zeros behind the end", &zeros, &[], None);
    let text = String::from_utf8(lines(header, |_, t, x, f| row(t, x, f))).expect("text");
    fn wide(text: &str, bytes: fn(u16) -> [u8; 2]) -> Vec<u8> {
        text.encode_utf16().flat_map(bytes).collect()
    }
    same("UTF-16 without a mark", &wide(&text, u16::to_le_bytes), &[], None);
    same("UTF-16 without a mark, big-endian", &wide(&text, u16::to_be_bytes), &[], None);
}

/// Statistics below the readings, with and without words, with all digits and with few.
fn statistics_at_the_end_are_no_readings(header: &str) {
    let columns: [Vec<f64>; 3] = [0, 1, 2].map(|axis: usize| (0..400).map(|i| truth(i)[axis]).collect());
    fn total(values: &[f64]) -> f64 {
        values.iter().sum()
    }
    fn mean(values: &[f64]) -> f64 {
        total(values) / values.len() as f64
    }
    fn sd(values: &[f64]) -> f64 {
        (values.iter().map(|value| (value - mean(values)).powi(2)).sum::<f64>() / (values.len() - 1) as f64)
            .sqrt()
    }
    fn most(values: &[f64]) -> f64 {
        values.iter().copied().fold(f64::NEG_INFINITY, f64::max)
    }
    let statistics: [fn(&[f64]) -> f64; 4] = [mean, sd, total, most];
    for decimals in [3, 9] {
        let rows: Vec<String> = statistics
            .iter()
            .map(|of| {
                columns
                    .iter()
                    .map(|values| format!("{:.decimals$}", of(values)))
                    .collect::<Vec<_>>()
                    .join(",")
            })
            .collect();
        for tail in [rows[..2].to_vec(), rows[2..3].to_vec(), rows[3..].to_vec(), rows.clone()] {
            for above in ["", "\r\n"] {
                let text = lines(header, |i, t, x, f| {
                    let tail_text =
                        if i == 399 { format!("\r\n{above}{}", tail.join("\r\n")) } else { String::new() };
                    format!("{t},{x},{f}{tail_text}")
                });
                same(&format!("{decimals} digits of {tail:?}"), &text, &[], None);
            }
        }
    }
    // Without a clock only an empty line tells a mean from the end of a hold.
    let unclocked = |i: usize, x: f64, f: f64| {
        let means_text = format!("\r\n\r\n{:.6},{:.6}", mean(&columns[1]), mean(&columns[2]));
        format!("{x:.6},{f:.6}{}", if i == 399 { means_text } else { String::new() })
    };
    same("no clock", &lines("Extension (mm),Load (N)\n", |i, _, x, f| unclocked(i, x, f)), &[], Some(50.0));
    // Results of a fit, which are no statistics.
    fn results(i: usize, t: f64, x: f64, f: f64) -> String {
        format!("{t},{x},{f}{}", if i == 399 { "\r\n\r\n13.2,2.4,0.998" } else { "" })
    }
    same("results of a fit", &lines(header, results), &[], None);
    let at_rest = lines("Extension (mm),Load (N)\n", |i, _, _, _| {
        let x = [1.0, -1.0, 0.0][(i / 100).min(2)];
        format!("{x},{}", 0.3 * x)
    });
    let force = taken(&at_rest, &[], Some(50.0)).expect("a run").force.expect("a force");
    assert_eq!(force.time_s.len(), 400);
}
