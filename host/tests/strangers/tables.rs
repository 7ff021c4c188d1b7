//! Text files of data loggers, testing machines and statistics programs.

use super::{
    assert_rejected, assert_right_or_rejected, assert_staircase, import, rows_as, staircase, with_file,
};

const TABLE: [&str; 4] = ["table", "t.csv", "--depth-mm", "30"];
const LEAST: usize = 120;

/// Imports one table with further options.
fn table(content: impl AsRef<[u8]>, options: &[&str]) -> super::Answer {
    import(with_file("t.csv", content), &[&TABLE, options, &["--yes"]].concat())
}

fn right(answer: &super::Answer) {
    assert_staircase(answer, LEAST);
}

/// Digits of a country with decimal commas.
fn comma(number: f64) -> String {
    format!("{number:.4}").replace('.', ",")
}

#[test]
fn a_measurement_file_of_labview() {
    let header = "LabVIEW Measurement\t\nWriter_Version\t2\nReader_Version\t2\nSeparator\tTab\nDecimal_Separator\t,\n\
        Multi_Headings\tNo\nX_Columns\tOne\nTime_Pref\tAbsolute\nOperator\tlab\nDate\t2026/03/01\nTime\t10:21:33,1234567890123\n\
        ***End_of_Header***\t\n\t\nChannels\t2\t\t\nSamples\t125\t125\t\nDate\t2026/03/01\t2026/03/01\t\n\
        Time\t10:21:33,12\t10:21:33,12\t\nY_Unit_Label\tN\tmm\t\nX_Dimension\tTime\tTime\t\nX0\t0,0E+0\t0,0E+0\t\n\
        Delta_X\t0,100000\t0,100000\t\n***End_of_Header***\t\t\t\nX_Value\tLoad Cell\tStage\tComment\n";
    let content = rows_as(header, |[t, d, f]| format!("{}\t{}\t{}\t", comma(*t), comma(*f), comma(*d)));
    let maps = ["--map", "X_Value=time_s:s", "--map", "Load Cell=force_y_n:N", "--map"];
    right(&table(content, &[&maps[..], &["Stage=displacement_y_mm:mm"]].concat()));
}

#[test]
fn thousands_between_quotes_are_no_decimals() {
    let header =
        "\"Specimen label\",\"A, 1\"\n\n\"Time\",\"Extension\",\"Load\"\n\"(s)\",\"(mm)\",\"(mN)\"\n";
    let content = rows_as(header, |[t, d, f]| {
        let (whole, sign) = ((1e3 * f).abs(), if *f < 0.0 { "-" } else { "" });
        let thousands = (whole / 1e3).floor();
        let load = if thousands > 0.0 {
            format!("{thousands},{:05.1}", whole - 1e3 * thousands)
        } else {
            format!("{whole:.1}")
        };
        format!("\"{t:.4}\",\"{d:.4}\",\"{sign}{load}\"")
    });
    let maps = ["--map", "Extension=displacement_y_mm", "--map", "Load=force_y_n"];
    assert_right_or_rejected(&table(content, &maps), &["thousand", "number", ","], right);
}

#[test]
fn names_of_rows_without_a_name_of_their_own() {
    // `write.table` of R: the header has one cell less than the rows.
    let mut number = 0;
    let content = staircase().iter().fold(
        "\"time_s\" \"displacement_y_mm\" \"force_y_n\"\n".to_owned(),
        |text, [t, d, f]| {
            number += 1;
            text + &format!("\"{number}\" {t} {d} {f}\n")
        },
    );
    assert_right_or_rejected(&table(content, &[]), &["column", "header", "cells"], right);
}

#[test]
fn an_index_with_an_empty_name() {
    let mut number = -1;
    let content =
        staircase().iter().fold(",time_s,displacement_y_mm,force_y_n\n".to_owned(), |text, [t, d, f]| {
            number += 1;
            text + &format!("{number},{t},{d},{f}\n")
        });
    right(&table(content, &[]));
}

#[test]
fn a_run_across_midnight() {
    let content = rows_as("Time,Displacement (mm),Force (N)\n", |[t, d, f]| {
        let tenths = ((86_395.0 + t) * 10.0).round() as u64 % 864_000;
        let (h, m, s) = (tenths / 36_000, tenths / 600 % 60, tenths % 600);
        format!("{h:02}:{m:02}:{:02}.{},{d},{f}", s / 10, s % 10)
    });
    assert_right_or_rejected(&table(content, &[]), &["line 54", "back"], right);
}

#[test]
fn a_logger_that_was_started_again() {
    let header = "time_s,displacement_y_mm,force_y_n\n";
    let once = rows_as(header, |[t, d, f]| format!("{t},{d},{f}"));
    let content = once.clone() + &once;
    assert_rejected(&table(content, &[]), &["line 127", "line 128", "row 127", "row 128"]);
}

#[test]
fn inches_and_pounds() {
    let content = rows_as("Time (s),Position (in),Load (lbf)\n", |[t, d, f]| {
        format!("{t},{:.7},{:.7}", d / 25.4, f / 4.448_221_615_260_5)
    });
    let maps = ["--map", "Position (in)=displacement_y_mm", "--map", "Load (lbf)=force_y_n"];
    right(&table(content, &maps));
}

#[test]
fn kilograms_of_a_balance() {
    let content =
        rows_as("Time (s);Travel (mm);Load [kg]\n", |[t, d, f]| format!("{t};{d};{:.7}", f / 9.806_65));
    let maps = ["--map", "Travel (mm)=displacement_y_mm", "--map", "Load [kg]=force_y_n"];
    right(&table(content, &maps));
}

#[test]
fn a_typographic_minus() {
    let content = rows_as("time_s;displacement_y_mm;force_y_n\n", |[t, d, f]| {
        format!("{t};{d};{f}").replace('-', "\u{2212}")
    });
    assert_right_or_rejected(&table(content, &[]), &["number", "\u{2212}"], right);
}

#[test]
fn overload_of_a_meter() {
    let mut number = 0;
    let content = rows_as("time_s,displacement_y_mm,force_y_n\n", |[t, d, f]| {
        let is_overloaded = (8.0..8.25).contains(t);
        format!("{t},{d},{}", if is_overloaded { "9.90000000E+37".to_owned() } else { f.to_string() })
    });
    number += content.matches("E+37").count();
    assert_eq!(number, 3);
    assert_right_or_rejected(&table(content, &[]), &["9.9", "overload", "range"], |answer| {
        assert_staircase(answer, LEAST);
        assert!(answer.printed.contains("3 readings beyond the range"), "{}", answer.printed);
    });
}

#[test]
fn zeros_of_a_channel_that_was_off() {
    let is_off: [fn(f64) -> bool; 3] = [
        |t| (3.9..4.3).contains(&t),
        |t| t > 3.4 && ((10.0 * t).round() as u32).is_multiple_of(7),
        |t| (8.5..8.7).contains(&t),
    ];
    for is_off in is_off {
        let content = rows_as("Time (s),Displacement (mm),Force (N)\n", |[t, d, f]| {
            format!("{t},{d},{}", if is_off(*t) { 0.0 } else { *f })
        });
        assert_right_or_rejected(&table(content, &[]), &["zero", "0"], |answer| {
            assert_staircase(answer, 100);
            assert!(answer.printed.contains("to exactly 0"), "{}", answer.printed);
        });
    }
}

#[test]
fn a_tracker_that_lost_its_tool() {
    let content = rows_as("Time (s),Displacement (mm),Force (N)\n", |[t, d, f]| {
        if (3.9..4.3).contains(t) { format!("{t},-3.697314E28,{f}") } else { format!("{t},{d},{f}") }
    });
    assert_right_or_rejected(&table(content, &[]), &["3.69", "range"], |answer| {
        assert_staircase(answer, 100);
        assert!(answer.printed.contains("4 readings beyond the range"), "{}", answer.printed);
    });
}

#[test]
fn milliseconds_that_overflow() {
    let content = rows_as("Time (ms),Displacement (mm),Force (N)\n", |[t, d, f]| {
        let ms = 4_294_964_000_u32.wrapping_add((1e3 * t).round() as u32);
        format!("{ms},{d},{f}")
    });
    assert_right_or_rejected(&table(content, &[]), &["line 3", "back"], right);
}

#[test]
fn exponents_of_fortran() {
    let content = rows_as("   time_s   displacement_y_mm   force_y_n\n", |[t, d, f]| {
        format!("  {t:.6E}  {d:.6E}  {f:.6E}").replace('E', "D")
    });
    assert_right_or_rejected(&table(content, &[]), &["number", "D0"], right);
}

#[test]
fn unicode_text_of_a_spreadsheet() {
    let content =
        rows_as("Zeit [s]\t\"Weg [mm]\"\t\"Kraft [N]\"\n", |[t, d, f]| [*t, *d, *f].map(comma).join("\t"));
    let text = content.replace('\n', "\r\n");
    let bytes: Vec<u8> =
        std::iter::once(0xFEFF).chain(text.encode_utf16()).flat_map(u16::to_le_bytes).collect();
    right(&table(bytes, &["--map", "Weg [mm]=displacement_y_mm", "--map", "Kraft [N]=force_y_n"]));
}

#[test]
fn lines_that_end_with_carriage_returns() {
    let content = rows_as("time_s,displacement_y_mm,force_y_n\n", |[t, d, f]| format!("{t},{d},{f}"));
    assert_right_or_rejected(&table(content.replace('\n', "\r"), &[]), &["line", "row"], right);
}

#[test]
fn a_line_for_the_spreadsheet_that_names_the_separator() {
    let content = rows_as("sep=;\nTime (s);Displacement (mm);Force (N)\n", |row| row.map(comma).join(";"));
    right(&table(content, &[]));
}

#[test]
fn a_power_of_ten_before_the_unit() {
    let content = rows_as("Time (s),Displacement (mm),Force (x10^-3 N)\n", |[t, d, f]| {
        format!("{t},{d},{:.1}", 1e3 * f)
    });
    assert_right_or_rejected(&table(content, &[]), &["unit", "10^-3"], right);
}

#[test]
fn a_header_in_capitals() {
    let content =
        rows_as("TIME (S),DISPLACEMENT (MM),FORCE (MN)\n", |[t, d, f]| format!("{t},{d},{:.1}", 1e3 * f));
    assert_right_or_rejected(&table(content, &[]), &["MN", "unit"], right);
}

#[test]
fn two_columns_of_one_name() {
    let content = rows_as("Time (s),Displacement (mm),Force (N),Force (N)\n", |[t, d, f]| {
        format!("{t},{d},{f},{}", 0.1 * f)
    });
    assert_rejected(&table(content, &[]), &["Force (N)", "twice", "two columns"]);
}

#[test]
fn the_newest_row_first() {
    let content = rows_as("", |[t, d, f]| format!("{t},{d},{f}"));
    let mut lines: Vec<&str> = content.lines().collect();
    lines.push("time_s,displacement_y_mm,force_y_n");
    lines.reverse();
    assert_right_or_rejected(&table(lines.join("\n"), &[]), &["line 3", "row 3", "back"], right);
}

#[test]
fn two_specimens_one_below_the_other() {
    let header = "Time (s),Displacement (mm),Force (N)\n";
    let first = rows_as(header, |[t, d, f]| format!("{t},{d},{f}"));
    let second = rows_as(header, |[t, d, f]| format!("{},{d},{}", t + 20.0, 3.0 * f));
    let content = format!("Specimen 1\n{first}\nSpecimen 2\n{second}");
    assert_right_or_rejected(&table(content, &[]), &["line 127", "line 128", "line 129", "line 130"], right);
}

#[test]
fn days_of_a_spreadsheet_as_times() {
    let content = rows_as("Date;Weg [mm];Kraft [N]\n", |[t, d, f]| {
        format!(
            "{};{};{}",
            format!("{:.10}", 46_082.385_648 + t / 86_400.0).replace('.', ","),
            comma(*d),
            comma(*f)
        )
    });
    let maps =
        ["--map", "Date=time_s:d", "--map", "Weg [mm]=displacement_y_mm", "--map", "Kraft [N]=force_y_n"];
    assert_right_or_rejected(&table(content, &maps), &["unit", "d"], right);
}

#[test]
fn a_remark_between_the_rows() {
    let content = rows_as("time_s,displacement_y_mm,force_y_n\n", |[t, d, f]| {
        let remark = if *t == 3.0 { "# paused, the probe was moved\n" } else { "" };
        format!("{remark}{t},{d},{f}")
    });
    right(&table(content, &[]));
}

#[test]
fn channels_at_different_rates_with_empty_cells() {
    let content = rows_as("Time (s),Displacement (mm),Force (N)\n", |[t, d, f]| {
        let even = (10.0 * t).round() as i64 % 2 == 0;
        format!("{t},{d},{}", if even { f.to_string() } else { String::new() })
    });
    assert_right_or_rejected(&table(content, &[]), &["empty", "number"], |answer| {
        assert_staircase(answer, 60)
    });
}
