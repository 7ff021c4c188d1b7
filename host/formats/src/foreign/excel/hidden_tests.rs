//! Rows and sheets that a workbook does not show.

use crate::foreign::RawTable;
use std::fmt::Write as _;
use std::fs::File;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use zip::ZipWriter;
use zip::write::SimpleFileOptions;

/// Rows of numbers below the names.
const ROWS: usize = 40;

fn archive(path: &Path, parts: &[(&str, String)]) {
    let mut zip = ZipWriter::new(File::create(path).expect("created"));
    for (name, content) in parts {
        zip.start_file(*name, SimpleFileOptions::default()).expect("a part");
        zip.write_all(content.as_bytes()).expect("written");
    }
    zip.finish().expect("finished");
}

/// A workbook of Excel: a sheet for each factor of the force, with attributes of its row by its number.
fn excel(folder: &Path, sheets: &[(&str, &str, f64)], attributes: fn(usize) -> &'static str) -> PathBuf {
    let path = folder.join("book.xlsx");
    let (mut names, mut relations, mut sheet_files) = (String::new(), String::new(), Vec::new());
    for (at, (name, state, factor)) in sheets.iter().enumerate() {
        let _ = write!(names, "<sheet name='{name}' {state} sheetId='{at}' r:id='r{at}'/>");
        let _ = write!(
            relations,
            "<Relationship Id='r{at}' Type='http://schemas.openxmlformats.org/officeDocument/2006/relationships/worksheet' Target='worksheets/s{at}.xml'/>"
        );
        fn word(text: &str) -> String {
            format!("<c t='inlineStr'><is><t>{text}</t></is></c>")
        }
        let mut rows =
            format!("<row r='1'>{}{}{}</row>", word("t [s]"), word("Force [N]"), word("Stage [mm]"));
        for row in 2..ROWS + 2 {
            let cells: String = [0.1 * row as f64, factor * row as f64, 0.01 * row as f64]
                .iter()
                .map(|number| format!("<c><v>{number}</v></c>"))
                .collect();
            let _ = write!(rows, "<row r='{row}' {}>{cells}</row>", attributes(row));
        }
        sheet_files.push((format!("xl/worksheets/s{at}.xml"), format!(
            "<worksheet xmlns='http://schemas.openxmlformats.org/spreadsheetml/2006/main'><sheetData>{rows}</sheetData></worksheet>"
        )));
    }
    let space = "xmlns='http://schemas.openxmlformats.org/spreadsheetml/2006/main' xmlns:r='http://schemas.openxmlformats.org/officeDocument/2006/relationships'";
    let whole = [
        ("_rels/.rels", "<Relationships xmlns='http://schemas.openxmlformats.org/package/2006/relationships'><Relationship Id='r' Type='http://schemas.openxmlformats.org/officeDocument/2006/relationships/officeDocument' Target='xl/workbook.xml'/></Relationships>".to_owned()),
        ("xl/workbook.xml", format!("<workbook {space}><sheets>{names}</sheets></workbook>")),
        ("xl/_rels/workbook.xml.rels", format!("<Relationships xmlns='http://schemas.openxmlformats.org/package/2006/relationships'>{relations}</Relationships>")),
    ];
    let sheets = sheet_files.iter().map(|(name, content)| (name.as_str(), content.clone()));
    archive(&path, &whole.into_iter().chain(sheets).collect::<Vec<_>>());
    path
}

/// A workbook of OpenDocument, whose rows have these attributes.
fn open_document(folder: &Path, attributes: fn(usize) -> &'static str) -> PathBuf {
    let path = folder.join("book.ods");
    fn word(text: &str) -> String {
        format!("<table:table-cell office:value-type='string'><text:p>{text}</text:p></table:table-cell>")
    }
    let mut rows = format!(
        "<table:table-row>{}{}{}</table:table-row>",
        word("t [s]"),
        word("Force [N]"),
        word("Stage [mm]")
    );
    for row in 2..ROWS + 2 {
        let cells: String = [0.1 * row as f64, row as f64, 0.01 * row as f64]
            .iter()
            .map(|number| format!("<table:table-cell office:value-type='float' office:value='{number}'/>"))
            .collect();
        let _ = write!(rows, "<table:table-row {}>{cells}</table:table-row>", attributes(row));
    }
    let space = "xmlns:office='urn:oasis:names:tc:opendocument:xmlns:office:1.0' xmlns:table='urn:oasis:names:tc:opendocument:xmlns:table:1.0' xmlns:text='urn:oasis:names:tc:opendocument:xmlns:text:1.0'";
    archive(
        &path,
        &[
            ("mimetype", "application/vnd.oasis.opendocument.spreadsheet".to_owned()),
            (
                "META-INF/manifest.xml",
                "<manifest:manifest xmlns:manifest='urn:oasis:names:tc:opendocument:xmlns:manifest:1.0'/>"
                    .to_owned(),
            ),
            (
                "content.xml",
                format!(
                    "<office:document-content {space}><office:body><office:spreadsheet><table:table table:name='Push'>{rows}</table:table></office:spreadsheet></office:body></office:document-content>"
                ),
            ),
        ],
    );
    path
}

/// Forces and remarks of a workbook's sheet.
fn forces(path: &Path) -> (Vec<f64>, String) {
    let tables = RawTable::read(path).unwrap_or_else(|error| panic!("{error}"));
    let column = &tables[0].columns[1];
    (column.values.iter().map(|value| column.origin as f64 + value).collect(), tables[0].notes.join("; "))
}

const SHOWN: [(&str, &str, f64); 1] = [("Push", "", 1.0)];

#[test]
fn rows_that_a_filter_hides_are_left_out_and_counted() {
    let folder = tempfile::tempdir().expect("a folder");
    let right: Vec<f64> = (2..ROWS + 2).filter(|row| row % 4 != 1).map(|row| row as f64).collect();
    fn every_fourth(row: usize) -> &'static str {
        if row % 4 == 1 { "hidden='1'" } else { "" }
    }
    fn in_open_document(row: usize) -> &'static str {
        if row % 4 == 1 { "table:visibility='filter'" } else { "" }
    }
    for path in [excel(folder.path(), &SHOWN, every_fourth), open_document(folder.path(), in_open_document)] {
        let (values, notes) = forces(&path);
        assert_eq!(values, right, "{}: {notes}", path.display());
        assert_eq!(
            notes,
            "10 rows, from row 5 on, are hidden in the sheet, and left out",
            "{}",
            path.display()
        );
    }
}

#[test]
fn rows_below_hidden_ones_go_on_with_those_above() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = excel(folder.path(), &SHOWN, |row| if (20..38).contains(&row) { "hidden='true'" } else { "" });
    let right: Vec<f64> = (2..ROWS + 2).filter(|row| !(20..38).contains(row)).map(|row| row as f64).collect();
    let (values, notes) = forces(&path);
    assert_eq!(values, right, "{notes}");
}

#[test]
fn rows_that_are_folded_under_an_outline_are_used() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = excel(folder.path(), &SHOWN, |row| if row > 11 { "hidden='1' outlineLevel='1'" } else { "" });
    let (values, notes) = forces(&path);
    assert_eq!(
        (values.len(), notes.as_str()),
        (ROWS, "30 rows, from row 12 on, are folded in the sheet, and used")
    );
}

#[test]
fn a_sheet_that_is_shown_comes_before_hidden_ones() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = excel(
        folder.path(),
        &[("Old", "state='hidden'", 5.0), ("Older", "state='veryHidden'", 7.0), ("New", "", 1.0)],
        |_| "",
    );
    assert_eq!(forces(&path).0[0], 2.0);
    // One that is named, and one that no other is beside.
    assert_eq!(forces(&PathBuf::from(format!("{}#Old", path.display()))).0[0], 10.0);
    let path = excel(folder.path(), &[("Only", "state='hidden'", 5.0)], |_| "");
    assert_eq!(forces(&path).0[0], 10.0);
}
