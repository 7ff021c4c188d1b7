use super::*;

#[test]
fn times_of_a_computers_clock_are_counted_from_their_first_second() {
    let time_column = [Column::required("time_s", 1.0, [-1e10, 1e10]).increasing()];
    fn read(times: &str, clock: Clock, time_column: &[Column; 1]) -> (i64, Vec<f64>) {
        let table = Table::parse_on(Path::new("a.csv"), &format!("time_s\n{times}\n"), time_column, 0, clock);
        let mut table = table.expect("reads");
        (table.origin_s, table.take("time_s").expect("times"))
    }
    let plain = read("0.02\n0.07\n10.1000007", Clock::FromFirst, &time_column);
    assert_eq!(plain, (0, vec![0.02, 0.07, 10.1000007]));
    // Not by subtraction: 1764000000.07 as a double is 1e-7 s beside it.
    assert_eq!(
        read("1764000000.02\n1764000000.07\n1764000010.1000007", Clock::FromFirst, &time_column),
        (1_764_000_000, plain.1)
    );
    assert_eq!(read("1764000000\n1764000001", Clock::From(1_764_000_001), &time_column).1, [-1.0, 0.0]);
    assert_eq!(read("1.764e9\n1.764000001e9", Clock::FromFirst, &time_column).1, [0.0, 1.0]);
    assert_eq!(read("99.5\n1000", Clock::FromFirst, &time_column).0, 0, "seconds since a device was started");
    assert_eq!(
        read("1764000000.5\n1764000001", Clock::AsWritten, &time_column).1,
        [1_764_000_000.5, 1_764_000_001.0]
    );
}

#[test]
fn a_last_row_is_cut_off_where_it_has_no_end_and_too_few_cells() {
    fn at(text: &str) -> Option<(usize, usize)> {
        cut_row(Path::new("a.csv"), text).map(|cut| (cut.offset, cut.place.line))
    }
    assert_eq!(at("# c\na,b\n1,2\n3"), Some((12, 4)));
    assert_eq!(at("a,b\n1,2\n3,"), None, "its last number may be incomplete, but it is there");
    assert_eq!(at("a,b\n1,2\n3\n"), None, "a whole line with too few cells is a fault");
    assert_eq!(at("a,b\n1,2\n3,4"), None);
    assert_eq!(at("a"), None);
    assert_eq!(at("a,b\n# 1"), None);
    assert_eq!(at(""), None);
}

const KNOWN: [Column; 3] = [
    Column::required("time_s", 1.0, [0.0, 1e9]).increasing(),
    Column::required("force_y_n", 1.0, [-200.0, 200.0]),
    Column::optional("displacement_x_mm", 1e-3, [-50.0, 50.0]),
];

fn parse(text: &str) -> Result<Table, String> {
    Table::parse(Path::new("a.csv"), text, &KNOWN, 1).map_err(|error| error.to_string())
}

#[test]
fn order_comments_and_unknown_columns_are_free() {
    let text = "# a comment\r\nnote, force_y_n ,time_s\r\n# another\r\nx,0.5,0\r\n\"a,b\",-1e-1,0.1\r\n";
    let mut table = parse(text).expect("reads");
    assert_eq!(table.take_required("force_y_n"), [0.5, -0.1]);
    assert_eq!(table.take_required("time_s"), [0.0, 0.1]);
    assert_eq!(table.take("displacement_x_mm"), None);
}

#[test]
fn faults_name_place_field_and_what_was_expected() {
    for (text, message) in [
        ("", "a.csv:1:1: time_s: missing, expected a header with time_s, force_y_n"),
        ("time_s\n1\n", "a.csv:1:1: force_y_n: missing, expected a header with time_s, force_y_n"),
        (
            "# c\ntime_s,forse_y_n\n",
            "a.csv:2:8: force_y_n: missing, but there is \"forse_y_n\", expected a header with time_s, force_y_n",
        ),
        (
            "time_s;force_y_n\n0;1\n",
            "a.csv:1:1: time_s: missing, the header is separated by semicolons, expected commas between columns, and decimal points",
        ),
        ("time_s,force_y_n\n", "a.csv:1:1: rows: no rows, expected at least one row below the header"),
        (
            "time_s,force_y_n,time_s\n",
            "a.csv:1:18: header: \"time_s\" appears twice, expected each column once",
        ),
        (
            "time_s,force_y_n\n0,1\n# c\n\n1, oops\n",
            "a.csv:5:3: force_y_n: \"oops\" is not a number, expected a number from -200 to 200",
        ),
        (
            "time_s,force_y_n\n0,NaN\n",
            "a.csv:2:3: force_y_n: not a finite number, expected a number from -200 to 200",
        ),
        ("time_s,force_y_n\n0,\n", "a.csv:2:3: force_y_n: empty, expected a number from -200 to 200"),
        ("time_s,force_y_n\n0\n", "a.csv:2:2: row: 1 cell, expected 2, one for each column of the header"),
        (
            "time_s,force_y_n\r0,1\r0,1,5\r",
            "a.csv:3:5: row: 3 cells, expected 2, one for each column of the header; numbers with a decimal point, not a comma",
        ),
        (
            "time_s,force_y_n,note\n0,1,\"loose\n1,1,\n",
            "a.csv:2:5: row: a quotation mark that is not closed on its line, expected quotation marks in pairs",
        ),
        (
            "time_s,force_y_n\n0,1000\n",
            "a.csv:2:3: force_y_n: 1000 is out of range, expected a number from -200 to 200",
        ),
        (
            "time_s,force_y_n\n0,1\n0,1\n",
            "a.csv:3:1: time_s: 0 does not exceed the value before it, expected increasing values",
        ),
    ] {
        assert_eq!(parse(text).err().as_deref(), Some(message));
    }
}
