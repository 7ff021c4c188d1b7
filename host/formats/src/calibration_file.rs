//! Calibration files: the constants of one rig as people measure them, to and from the record that the device keeps.
//!
//! A file has any number of points per potentiometer; the record has a position at every 512 codes, found between the points on
//! straight lines and beyond them along the first and the last. The page on calibration of the manual describes the file.

use crate::document::{Fields, Problem, SessionError, read_text, replace};
use protocol::{CODES_PER_KNOT, CalibrationRecord, Implausible, KNOTS, PotentiometerTable, Text};
use std::fmt::Write as _;
use std::path::Path;

/// Most bytes of an id.
const ID_BYTES: usize = 16;
/// Codes of the converter; the last knot of a record lies one beyond them.
const CODES: [f64; 2] = [0.0, 4_095.0];
const KNOT_CODES: [f64; 2] = [0.0, 4_096.0];
/// Range of the record's 16 bits of micrometres.
const POSITION_MM: [f64; 2] = [-32.768, 32.767];
const TRAVEL_MM: [f64; 2] = [0.001, 32.767];
const FORCE_RANGE_N: [f64; 2] = [0.001, 1_000.0];
/// Range of the record's 32 bits of piconewtons.
const FORCE_N_PER_CODE: [f64; 2] = [-2.147e-3, 2.147e-3];
/// Least sine of the angle between the rows of the force matrix.
const MIN_SINE: f64 = 0.05;
const AXES: [&str; 2] = ["x", "y"];

/// Reads a calibration file.
///
/// # Errors
/// [`SessionError`] for the first fault found, with its place.
pub fn read(path: &Path) -> Result<CalibrationRecord, SessionError> {
    sound(path, &read_text(path)?)
}

/// Writes a record as a calibration file, which reads as the same record.
///
/// # Errors
/// As reported by the operating system.
pub fn write(path: &Path, record: &CalibrationRecord) -> Result<(), SessionError> {
    replace(path, &to_toml(record))
}

/// A record that a rig can have. The device refuses any other too, but gives no reason.
fn sound(path: &Path, text: &str) -> Result<CalibrationRecord, SessionError> {
    Fields::parse(path, text, |file| {
        let record = record(file)?;
        let Err(implausible) = record.check() else { return Ok(record) };
        let field = match implausible {
            Implausible::Id => "id",
            Implausible::Travel { .. } => "travel_mm",
            Implausible::ForceRange { .. } => "force_range_n",
            Implausible::ForceGain { .. } | Implausible::CrossTalk { .. } => "force_n_per_code",
            Implausible::Track { .. }
            | Implausible::Turns { .. }
            | Implausible::Play { .. }
            | Implausible::Slope { .. } => "potentiometer",
        };
        Err(file.field_fault(
            field,
            Problem::Syntax(implausible.to_string()),
            "constants that a rig can have",
        ))
    })
}

fn record(file: &Fields<'_>) -> Result<CalibrationRecord, SessionError> {
    file.only(&["id", "travel_mm", "force_range_n", "force_n_per_code", "potentiometer"])?;
    let id = file.text("id")?;
    if id.len() > ID_BYTES {
        let problem = Problem::Syntax(format!("{} bytes", id.len()));
        return Err(file.field_fault("id", problem, format!("1 to {ID_BYTES} bytes")));
    }
    let potentiometers = file.table("potentiometer")?;
    potentiometers.only(&AXES)?;
    let [x, y] = AXES.map(|axis| potentiometers.table(axis).and_then(|fields| potentiometer(&fields)));
    Ok(CalibrationRecord {
        id: Text::new(&id),
        potentiometers: [x?, y?],
        travel_um: (1e3 * file.number("travel_mm", TRAVEL_MM)?).round() as u32,
        force_pn_per_code: force_matrix(file)?,
        force_range_mn: (1e3 * file.number("force_range_n", FORCE_RANGE_N)?).round() as u32,
    })
}

fn force_matrix(file: &Fields<'_>) -> Result<[[i32; 2]; 2], SessionError> {
    const FIELD: &str = "force_n_per_code";
    const EXPECTED: &str = "two rows (force along x, y) of two numbers (channel 0, 1)";
    let fault = |problem| Err(file.field_fault(FIELD, problem, EXPECTED));
    let Some(rows) = file.optional_rows(FIELD, FORCE_N_PER_CODE, 12)? else {
        return fault(Problem::Missing);
    };
    let [x, y] = rows.as_slice() else { return fault(Problem::Count(rows.len())) };
    let (&[xx, xy], &[yx, yy]) = (x.as_slice(), y.as_slice()) else {
        return fault(Problem::Count(if x.len() == 2 { y.len() } else { x.len() }));
    };
    let [[xx, xy], [yx, yy]] = [[xx, xy], [yx, yy]].map(|row| row.map(f64::round));
    let size = xx.hypot(xy) * yx.hypot(yy);
    if (xx * yy - xy * yx).abs() <= MIN_SINE * size {
        let problem = Problem::Syntax("the two rows are proportional".to_owned());
        return Err(file.field_fault(FIELD, problem, "rows that determine both forces"));
    }
    Ok([[xx, xy], [yx, yy]].map(|row| row.map(|pn| pn as i32)))
}

fn potentiometer(fields: &Fields<'_>) -> Result<PotentiometerTable, SessionError> {
    fields.only(&["track_codes", "codes", "rising_mm", "falling_mm"])?;
    let track = rising_codes(fields, "track_codes", CODES)?;
    let &[first, last] = track.as_slice() else {
        return Err(fields.field_fault(
            "track_codes",
            Problem::Count(track.len()),
            "the least and the greatest code",
        ));
    };
    let codes = rising_codes(fields, "codes", KNOT_CODES)?;
    let rising_um = knots_um(fields, "rising_mm", &codes)?;
    let rising_um = rising_um.ok_or_else(|| {
        fields.field_fault("rising_mm", Problem::Missing, "a list of positions, one per code")
    })?;
    let falling_um = knots_um(fields, "falling_mm", &codes)?.unwrap_or(rising_um);
    if direction(&rising_um) != direction(&falling_um) {
        let problem = Problem::Syntax("against the direction of rising_mm".to_owned());
        return Err(fields.field_fault("falling_mm", problem, "both lists rising or both falling"));
    }
    Ok(PotentiometerTable { track_codes: [first as u16, last as u16], rising_um, falling_um })
}

/// Two or more whole codes in rising order.
fn rising_codes(fields: &Fields<'_>, field: &str, range: [f64; 2]) -> Result<Vec<f64>, SessionError> {
    fn expected(range: &[f64; 2]) -> String {
        format!("two or more whole codes from {} to {}, rising", range[0], range[1])
    }
    let codes = fields.optional_list(field, range, 0)?;
    let codes = codes.ok_or_else(|| fields.field_fault(field, Problem::Missing, expected(&range)))?;
    let problem = if codes.len() < 2 {
        Some(Problem::Count(codes.len()))
    } else if let Some(code) = codes.iter().find(|code| code.fract() != 0.0) {
        Some(Problem::Syntax(format!("{code} is not whole")))
    } else {
        let pair = codes.iter().zip(codes.iter().skip(1)).find(|(before, after)| after <= before);
        pair.map(|(_, after)| Problem::NotIncreasing(*after))
    };
    match problem {
        Some(problem) => Err(fields.field_fault(field, problem, expected(&range))),
        None => Ok(codes),
    }
}

/// Positions at the record's knots from those at the file's codes, where the file has them.
fn knots_um(fields: &Fields<'_>, field: &str, codes: &[f64]) -> Result<Option<[i16; KNOTS]>, SessionError> {
    let Some(positions_um) = fields.optional_list(field, POSITION_MM, 3)? else { return Ok(None) };
    if positions_um.len() != codes.len() {
        let expected = format!("{} positions, one per code", codes.len());
        return Err(fields.field_fault(field, Problem::Count(positions_um.len()), expected));
    }
    let points: Vec<[f64; 2]> = codes.iter().zip(&positions_um).map(|(c, p)| [*c, *p]).collect();
    let mut knots_um = [0; KNOTS];
    for (knot, um) in (0u16..).zip(&mut knots_um) {
        let code = f64::from(knot * CODES_PER_KNOT);
        let position_um = along(&points, code).round();
        let [least, most] = POSITION_MM;
        if !(1e3 * least..=1e3 * most).contains(&position_um) {
            let problem =
                Problem::Syntax(format!("the position at code {code} is {} mm", 1e-3 * position_um));
            return Err(fields.field_fault(field, problem, format!("positions from {least} to {most} mm")));
        }
        *um = position_um as i16;
    }
    fn is_monotonic(values: &[f64]) -> bool {
        let steps: Vec<bool> =
            values.iter().zip(values.iter().skip(1)).map(|(before, after)| after > before).collect();
        steps.iter().all(|up| *up) || !steps.iter().any(|up| *up)
    }
    let turns = !is_monotonic(&positions_um)
        || positions_um.windows(2).any(|pair| pair.first() == pair.last())
        || knots_um.windows(2).any(|pair| pair.first() == pair.last());
    if turns {
        let problem = Problem::Syntax("the positions are not strictly monotonic".to_owned());
        return Err(fields.field_fault(field, problem, "positions that rise, or fall, from code to code"));
    }
    Ok(Some(knots_um))
}

/// Position at a code on the straight lines between two or more points, and on the first and the last beyond them.
fn along(points: &[[f64; 2]], code: f64) -> f64 {
    let lines = || points.iter().zip(points.iter().skip(1));
    let line = lines().find(|(_, to)| code <= to[0]).or_else(|| lines().next_back());
    line.map_or(0.0, |(from, to)| {
        let fraction = (code - from[0]) / (to[0] - from[0]);
        from[1] + fraction * (to[1] - from[1])
    })
}

fn direction(knots_um: &[i16; KNOTS]) -> bool {
    knots_um.first() < knots_um.last()
}

/// Newtons per code, from a record's piconewtons.
pub fn force_n_per_code(record: &CalibrationRecord) -> [[f64; 2]; 2] {
    // The decimal number itself, which a product would miss by a last digit.
    record.force_pn_per_code.map(|row| row.map(|pn| format!("{pn}e-12").parse().unwrap_or_default()))
}

/// The codes of a record's knots.
pub fn knot_codes() -> [u16; KNOTS] {
    std::array::from_fn(|knot| CODES_PER_KNOT * knot as u16)
}

/// Positions in millimetres.
pub fn knots_mm(knots_um: [i16; KNOTS]) -> [f64; KNOTS] {
    knots_um.map(|um| f64::from(um) / 1e3)
}

fn to_toml(record: &CalibrationRecord) -> String {
    fn decimals(values: [f64; KNOTS]) -> String {
        values.map(|value| format!("{value:.3}")).join(", ")
    }
    let [x, y] = force_n_per_code(record).map(|row| row.map(|n| format!("{n:e}")).join(", "));
    let mut text = format!(
        "id = {id}\ntravel_mm = {travel:.3}\nforce_range_n = {range:.3}\n\
         # newtons per converter code; rows: force x, y; columns: channel 0, 1\n\
         force_n_per_code = [[{x}], [{y}]]\n",
        id = toml::Value::from(record.id.as_str()),
        travel = f64::from(record.travel_um) / 1e3,
        range = f64::from(record.force_range_mn) / 1e3,
    );
    for (axis, table) in AXES.iter().zip(&record.potentiometers) {
        let _ = write!(
            text,
            "\n[potentiometer.{axis}]\ntrack_codes = {:?}\ncodes = {:?}\n\
             # position in mm (0 where the needle is straight) when moving towards larger positions, and back\n\
             rising_mm = [{}]\nfalling_mm = [{}]\n",
            table.track_codes,
            knot_codes(),
            decimals(knots_mm(table.rising_um)),
            decimals(knots_mm(table.falling_um)),
        );
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const FILE: &str = r#"
id = "unit-7"
travel_mm = 10.0
force_range_n = 5.0
force_n_per_code = [[9.31e-7, 0.0], [0.0, 9.31e-7]]
[potentiometer.x]
track_codes = [40, 4055]
codes = [0, 1000, 4000]
rising_mm = [-10, 0, 30]
[potentiometer.y]
track_codes = [40, 4055]
codes = [100, 4000]
rising_mm = [20.0, -19.0]
falling_mm = [20.1, -19.0]
"#;

    fn parse(text: &str) -> Result<CalibrationRecord, String> {
        Fields::parse(Path::new("c.toml"), text, record).map_err(|error| error.to_string())
    }

    #[test]
    fn constants_that_no_rig_has_name_their_field() {
        let text = FILE.replace("[-10, 0, 30]", "[-10.5, 0, 30]").replace("[20.0, -19.0]", "[25.0, -24.0]");
        let text = text.replace("[20.1, -19.0]", "[25.1, -24.0]");
        fn parse(text: &str) -> Result<CalibrationRecord, String> {
            sound(Path::new("c.toml"), text).map_err(|error| error.to_string())
        }
        parse(&text).expect("sound");
        for (from, to, expected) in [
            (
                "[[9.31e-7, 0.0], [0.0, 9.31e-7]]",
                "[[9.31e-10, 0.0], [0.0, 9.31e-10]]",
                "force_n_per_code: the force along axis 0",
            ),
            (
                "[[9.31e-7, 0.0], [0.0, 9.31e-7]]",
                "[[9.31e-7, 5e-7], [0.0, 9.31e-7]]",
                "force_n_per_code: the cross-talk of axis 0",
            ),
            ("travel_mm = 10.0", "travel_mm = 30.0", "travel_mm: the travel of 30000 um"),
            ("[-10.5, 0, 30]", "[-1.05, 0, 3]", "potentiometer: the position of axis 0 changes by"),
        ] {
            let message = parse(&text.replacen(from, to, 1)).expect_err(to);
            assert!(message.contains(expected), "{message}");
        }
    }

    #[test]
    fn any_points_become_the_knots_of_the_record() {
        let record = parse(FILE).expect("good");
        let [x, y] = record.potentiometers;
        assert_eq!(x.rising_um, [-10_000, -4_880, 240, 5_360, 10_480, 15_600, 20_720, 25_840, 30_960]);
        assert_eq!(x.falling_um, x.rising_um, "no play");
        assert_eq!((y.rising_um[0], y.rising_um[8]), (21_000, -19_960), "beyond the ends along the lines");
        assert_eq!(y.falling_um[0], 21_103);
        assert_eq!((record.travel_um, record.force_range_mn), (10_000, 5_000));
        assert_eq!(record.force_pn_per_code, [[931_000, 0], [0, 931_000]]);
    }

    #[test]
    fn mistakes_name_their_field() {
        for (from, to, expected) in [
            ("\"unit-7\"", "\"a rig with a long name\"", "c.toml:2:6: id: 22 bytes, expected 1 to 16 bytes"),
            ("\"unit-7\"", "\"\"", "id: empty"),
            ("travel_mm = 10.0", "travel_mm = 40", "travel_mm: 40 is out of range"),
            ("travel_mm = 10.0", "travel = 40", "travel: \"travel\" is not known"),
            ("[[9.31e-7, 0.0], [0.0, 9.31e-7]]", "[[9.31e-7, 0.0]]", "force_n_per_code: a list of 1"),
            ("[[9.31e-7, 0.0], [0.0, 9.31e-7]]", "[[1e-7, 0.0], [1]]", "1 is out of range"),
            ("[[9.31e-7, 0.0], [0.0, 9.31e-7]]", "[[1e-7, 0.0], [0]]", "force_n_per_code: a list of 1"),
            ("[[9.31e-7, 0.0], [0.0, 9.31e-7]]", "[1, 2]", "force_n_per_code: this is an integer"),
            (
                "[[9.31e-7, 0.0], [0.0, 9.31e-7]]",
                "[[1e-7, 2e-7], [2e-7, 4e-7]]",
                "the two rows are proportional",
            ),
            ("[[9.31e-7, 0.0], [0.0, 9.31e-7]]", "[[1e-7, 0], [0, 0]]", "the two rows are proportional"),
            (
                "codes = [0, 1000, 4000]",
                "codes = [0, 1000.5, 4000]",
                "potentiometer.x.codes: 1000.5 is not whole",
            ),
            ("codes = [0, 1000, 4000]", "codes = [0, 1000, 4097]", "codes: 4097 is out of range"),
            (
                "codes = [0, 1000, 4000]",
                "codes = [0, 1000, 1000]",
                "codes: 1000 does not exceed the value before",
            ),
            ("codes = [0, 1000, 4000]", "codes = [0, 1000]", "rising_mm: a list of 3, expected 2 positions"),
            ("track_codes = [40, 4055]", "track_codes = [40, 4096]", "x.track_codes: 4096 is out of range"),
            ("track_codes = [40, 4055]", "track_codes = [40]", "x.track_codes: a list of 1"),
            ("[-10, 0, 30]", "[-10, 0, 0]", "rising_mm: the positions are not strictly monotonic"),
            ("[-10, 0, 30]", "[-10, 0, -5]", "rising_mm: the positions are not strictly monotonic"),
            ("[-10, 0, 30]", "[-10, 0, 32.5]", "rising_mm: the position at code 4096 is 33.54 mm"),
            ("[20.1, -19.0]", "[-20.1, 19.0]", "falling_mm: against the direction of rising_mm"),
            ("[potentiometer.y]", "[potentiometer.z]", "potentiometer.z: \"z\" is not known"),
        ] {
            let message = parse(&FILE.replacen(from, to, 1)).expect_err(to);
            assert!(message.contains(expected), "{message}");
        }
    }

    prop_compose! {
        fn table()(rising in any::<bool>(), first in -32_000i16..-20_000, steps in prop::array::uniform8(1i16..6_000), play in 0i16..300)
            -> PotentiometerTable
        {
            let mut knots_um = [first; KNOTS];
            for (knot, step) in steps.iter().enumerate() {
                knots_um[knot + 1] = knots_um[knot] + step;
            }
            if !rising {
                knots_um.reverse();
            }
            PotentiometerTable { track_codes: [40, 4_055], rising_um: knots_um, falling_um: knots_um.map(|um| um - play) }
        }
    }

    proptest! {
        #[test]
        fn what_is_written_reads_as_the_same_record(
            id in "[\\PC&&[^\\s]]{1,4}", potentiometers in [table(), table()], travel_um in 1u32..32_000, force_range_mn in 1u32..1_000_000,
            gains in prop::array::uniform2(100_000i32..2_000_000_000), crosstalk in prop::array::uniform2(-50_000i32..50_000),
        ) {
            let [[xx, yy], [xy, yx]] = [gains, crosstalk];
            let force_pn_per_code = [[xx, xy], [yx, -yy]];
            let record = CalibrationRecord { id: Text::new(&id), potentiometers, travel_um, force_pn_per_code, force_range_mn };
            let text = to_toml(&record);
            prop_assert_eq!(parse(&text), Ok(record), "{}", text);
        }

        #[test]
        fn arbitrary_text_never_panics(text in "\\PC{0,80}", at in any::<prop::sample::Index>(), with in any::<char>()) {
            let _ = parse(&text);
            let damaged_index = at.index(FILE.len());
            let mut damaged: Vec<char> = FILE.chars().collect();
            damaged[damaged_index] = with;
            let _ = parse(&damaged.into_iter().collect::<String>());
        }
    }
}
