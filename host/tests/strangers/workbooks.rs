//! Workbooks, written cell by cell as a spreadsheet keeps them.

use super::{Answer, assert_right_or_rejected, assert_staircase, folder, import, staircase};
use std::fmt::Write as _;
use std::fs;

/// A ZIP archive without compression.
fn archive(files: &[(&str, String)]) -> Vec<u8> {
    let (mut body, mut directory) = (Vec::new(), Vec::new());
    for (name, content) in files {
        let offset = body.len() as u32;
        let mut fields: Vec<u8> =
            [20_u16, 0, 0, 0, 0x21].iter().flat_map(|field| field.to_le_bytes()).collect();
        let size = content.len() as u32;
        for field in [crc32fast::hash(content.as_bytes()), size, size] {
            fields.extend(field.to_le_bytes());
        }
        fields.extend((name.len() as u16).to_le_bytes());
        fields.extend([0, 0]);
        body.extend(b"PK\x03\x04");
        body.extend(&fields);
        body.extend(name.as_bytes());
        body.extend(content.as_bytes());
        directory.extend(b"PK\x01\x02\x14\x00");
        directory.extend(&fields);
        directory.extend([0; 10]);
        directory.extend(offset.to_le_bytes());
        directory.extend(name.as_bytes());
    }
    let (start, count) = (body.len() as u32, files.len() as u16);
    let size = directory.len() as u32;
    body.extend(directory);
    body.extend(b"PK\x05\x06\0\0\0\0");
    for field in [count, count] {
        body.extend(field.to_le_bytes());
    }
    for field in [size, start] {
        body.extend(field.to_le_bytes());
    }
    body.extend([0, 0]);
    body
}

/// A workbook with these sheets; a cell is its XML without its place.
fn workbook(properties: &str, sheets: &[(&str, Vec<Vec<String>>)]) -> Vec<u8> {
    let head = "<?xml version=\"1.0\" encoding=\"UTF-8\" standalone=\"yes\"?>\n";
    let main = "http://schemas.openxmlformats.org/spreadsheetml/2006/main";
    let relations = "http://schemas.openxmlformats.org/officeDocument/2006/relationships";
    let package = "http://schemas.openxmlformats.org/package/2006";
    let (mut list, mut links, mut types, mut files) =
        (String::new(), String::new(), String::new(), Vec::new());
    let content_prefix = "application/vnd.openxmlformats-officedocument.spreadsheetml";
    for (index, (name, rows)) in sheets.iter().enumerate() {
        let number = index + 1;
        let _ = write!(list, "<sheet name=\"{name}\" sheetId=\"{number}\" r:id=\"r{number}\"/>");
        let target = format!("worksheets/sheet{number}.xml");
        let _ = write!(
            links,
            "<Relationship Id=\"r{number}\" Type=\"{relations}/worksheet\" Target=\"{target}\"/>"
        );
        let _ = write!(
            types,
            "<Override PartName=\"/xl/{target}\" ContentType=\"{content_prefix}.worksheet+xml\"/>"
        );
        let mut cells = String::new();
        for (row, values) in rows.iter().enumerate() {
            let _ = write!(cells, "<row r=\"{}\">", row + 1);
            for (column, value) in values.iter().enumerate() {
                let cell_start = format!("<c r=\"{}{}\"", char::from(b'A' + column as u8), row + 1);
                cells.push_str(&value.replacen("<c", &cell_start, 1));
            }
            cells.push_str("</row>");
        }
        let sheet = format!("{head}<worksheet xmlns=\"{main}\"><sheetData>{cells}</sheetData></worksheet>");
        files.push((format!("xl/{target}"), sheet));
    }
    let style =
        "<cellXfs count=\"2\"><xf numFmtId=\"0\"/><xf numFmtId=\"164\" applyNumberFormat=\"1\"/></cellXfs>";
    let format_of_dates = "<numFmts count=\"1\"><numFmt numFmtId=\"164\" formatCode=\"yyyy\\-mm\\-dd\\ hh:mm:ss.000\"/></numFmts>";
    let styles = format!("{head}<styleSheet xmlns=\"{main}\">{format_of_dates}{style}</styleSheet>");
    let book = format!(
        "{head}<workbook xmlns=\"{main}\" xmlns:r=\"{relations}\">{properties}<sheets>{list}</sheets></workbook>"
    );
    let _ = write!(links, "<Relationship Id=\"s\" Type=\"{relations}/styles\" Target=\"styles.xml\"/>");
    let related = |links: &str| {
        format!("{head}<Relationships xmlns=\"{package}/relationships\">{links}</Relationships>")
    };
    let root =
        format!("<Relationship Id=\"b\" Type=\"{relations}/officeDocument\" Target=\"xl/workbook.xml\"/>");
    let content_types = format!(
        "{head}<Types xmlns=\"{package}/content-types\"><Default Extension=\"rels\" ContentType=\"application/vnd.openxmlformats-package.relationships+xml\"/><Default Extension=\"xml\" ContentType=\"application/xml\"/><Override PartName=\"/xl/workbook.xml\" ContentType=\"{content_prefix}.sheet.main+xml\"/><Override PartName=\"/xl/styles.xml\" ContentType=\"{content_prefix}.styles+xml\"/>{types}</Types>"
    );
    let mut workbook_files = vec![
        ("[Content_Types].xml", content_types),
        ("_rels/.rels", related(&root)),
        ("xl/workbook.xml", book),
        ("xl/_rels/workbook.xml.rels", related(&links)),
        ("xl/styles.xml", styles),
    ];
    workbook_files.extend(files.iter().map(|(name, sheet)| (name.as_str(), sheet.clone())));
    archive(&workbook_files)
}

fn text(content: &str) -> String {
    format!("<c t=\"inlineStr\"><is><t>{content}</t></is></c>")
}

fn number(value: f64) -> String {
    format!("<c><v>{value}</v></c>")
}

fn header() -> Vec<String> {
    ["Time (s)", "Displacement (mm)", "Force (N)"].map(text).to_vec()
}

/// A sheet of the staircase, its rows as this function writes them.
fn sheet(row: impl Fn(&[f64; 3]) -> [String; 3]) -> Vec<Vec<String>> {
    std::iter::once(header()).chain(staircase().iter().map(|values| row(values).to_vec())).collect()
}

fn table(workbook: Vec<u8>, name: &str) -> Answer {
    let folder = folder();
    fs::write(folder.path().join("book.xlsx"), workbook).expect("written");
    import(folder, &["table", name, "--depth-mm", "30", "--yes"])
}

fn right(answer: &Answer) {
    assert_staircase(answer, 120);
}

#[test]
fn numbers_kept_as_text_with_decimal_commas() {
    let rows = sheet(|[t, d, f]| [number(*t), number(*d), text(&f.to_string().replace('.', ","))]);
    assert_right_or_rejected(
        &table(workbook("", &[("Push", rows)]), "book.xlsx"),
        &["text", "number", ","],
        right,
    );
}

#[test]
fn dates_since_1904() {
    let rows = sheet(|[t, d, f]| {
        [format!("<c s=\"1\"><v>{:.11}</v></c>", 44_620.385_648 + t / 86_400.0), number(*d), number(*f)]
    });
    let book = workbook("<workbookPr date1904=\"1\"/>", &[("Push", rows)]);
    assert_right_or_rejected(&table(book, "book.xlsx"), &["date", "time"], right);
}

#[test]
fn a_cover_before_the_data() {
    let cover = vec![vec![text("Operator"), text("lab")], vec![text("Needle"), number(18.0)]];
    let rows = sheet(|values| values.map(number));
    let book = workbook("", &[("Cover", cover), ("Push", rows)]);
    assert_right_or_rejected(&table(book.clone(), "book.xlsx"), &["Push"], right);
    right(&table(book, "book.xlsx#Push"));
}

#[test]
fn errors_of_formulas() {
    let rows = sheet(|[t, d, f]| {
        let broken = (8.0..8.25).contains(t);
        let force = "<c t=\"e\"><f>B1/C1</f><v>#DIV/0!</v></c>".to_owned();
        [number(*t), number(*d), if broken { force } else { number(*f) }]
    });
    assert_right_or_rejected(&table(workbook("", &[("Push", rows)]), "book.xlsx"), &["#DIV"], |answer| {
        right(answer);
        assert!(answer.printed.contains("3 of 125 rows have no number"), "{}", answer.printed);
    });
}

#[test]
fn a_title_and_a_row_of_units() {
    let mut rows = sheet(|values| values.map(number));
    rows[0] = ["Zeit", "Weg", "Kraft"].map(text).to_vec();
    rows.insert(1, ["ms", "µm", "mN"].map(text).to_vec());
    rows.insert(0, vec![text("Versuch 7, Nadel G18")]);
    for row in &mut rows[3..] {
        for cell in row {
            let value: f64 =
                cell.trim_start_matches("<c><v>").trim_end_matches("</v></c>").parse().expect("a number");
            *cell = number(1e3 * value);
        }
    }
    let folder = folder();
    fs::write(folder.path().join("book.xlsx"), workbook("", &[("Push", rows)])).expect("written");
    let maps = ["--map", "Weg=displacement_y_mm", "--map", "Kraft=force_y_n", "--map", "Zeit=time_s"];
    right(&import(folder, &[&["table", "book.xlsx", "--depth-mm", "30", "--yes"][..], &maps].concat()));
}
