//! Rows of a sheet that its program does not show, which the library for cells does not tell from others.
//!
//! A row that a filter or its user hides is no part of what that user sees, prints or charts. One that is folded away under an outline
//! is: the outline shows that it belongs to the rows beside it. Formats whose sheets are XML are read; in `.xls` and `.xlsb` hidden
//! rows are not known.

use quick_xml::Reader;
use quick_xml::XmlVersion;
use quick_xml::events::{BytesStart, Event};
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::Path;
use zip::ZipArchive;

/// Most XML of one part: a sheet of a million rows has a fifth of it.
const MAX_XML_BYTES: u64 = 1 << 30;
/// Most repetitions of a row: what OpenDocument states of the empty rest of a sheet is of no use.
const MAX_ROWS: u32 = 1 << 20;

/// Hidden rows of a sheet, by their numbers from 1.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(super) struct HiddenRows {
    rows: Vec<HiddenRow>,
}

/// A row that is not shown.
#[derive(Debug, Clone, PartialEq, Eq)]
struct HiddenRow {
    first: u32,
    /// Number of rows in a row that are alike.
    count: u32,
    is_folded: bool,
}

impl HiddenRows {
    /// Hidden rows of a sheet; none where the file does not state them in XML.
    pub fn read(path: &Path, sheet: &str) -> Self {
        let ending = path.extension().map(|ending| ending.to_string_lossy().to_lowercase());
        let rows = match ending.as_deref() {
            Some("xlsx" | "xlsm") => of_excel(path, sheet),
            Some("ods") => of_open_document(path, sheet),
            _ => None,
        };
        // Cells are the other reader's: what this one cannot read it reports.
        Self { rows: rows.unwrap_or_default() }
    }

    /// Whether a row is hidden, and whether it is folded under an outline.
    pub fn state(&self, row: usize) -> Option<RowState> {
        let next_index = self.rows.partition_point(|hidden| (hidden.first as usize) <= row);
        let hidden = self.rows.get(next_index.checked_sub(1)?)?;
        let is_inside = row < hidden.first as usize + hidden.count as usize;
        is_inside.then_some(if hidden.is_folded { RowState::Folded } else { RowState::Hidden })
    }
}

/// Why a row is not shown.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum RowState {
    /// By a filter or by hand.
    Hidden,
    /// Under an outline.
    Folded,
}

type Xml<R> = Reader<BufReader<R>>;

/// The XML of a part of the file.
fn part<'a>(archive: &'a mut ZipArchive<BufReader<File>>, name: &str) -> Option<Xml<impl Read + use<'a>>> {
    Some(Reader::from_reader(BufReader::new(archive.by_name(name).ok()?.take(MAX_XML_BYTES))))
}

/// Hands the begin and the end of every element to a function, with which of both it is; nothing where the XML is damaged.
fn elements<R: Read>(mut xml: Xml<R>, mut each: impl FnMut(&BytesStart<'_>, bool)) -> Option<()> {
    let mut bytes = Vec::new();
    loop {
        match xml.read_event_into(&mut bytes).ok()? {
            Event::Start(element) => each(&element, true),
            Event::Empty(element) => {
                each(&element, true);
                each(&element, false);
            }
            Event::End(end) => each(&BytesStart::new(end.name().0), false),
            Event::Eof => return Some(()),
            _ => {}
        }
        bytes.clear();
    }
}

fn attribute(element: &BytesStart<'_>, name: &str) -> Option<String> {
    let attribute = element.try_get_attribute(name).ok()??;
    Some(attribute.normalized_value(XmlVersion::Implicit1_0).ok()?.into_owned())
}

fn archive(path: &Path) -> Option<ZipArchive<BufReader<File>>> {
    ZipArchive::new(BufReader::new(File::open(path).ok()?)).ok()
}

/// Targets of the relations of a part, in whose folder they are, with their identifiers and kinds.
fn relations(archive: &mut ZipArchive<BufReader<File>>, name: &str) -> Option<Vec<[String; 3]>> {
    let (folder, file) = name.rsplit_once('/').unwrap_or(("", name));
    fn inside(folder: &str, target: &str) -> String {
        match target.strip_prefix('/') {
            Some(whole) => whole.to_owned(),
            None if folder.is_empty() => target.to_owned(),
            None => format!("{folder}/{target}"),
        }
    }
    let mut targets = Vec::new();
    elements(part(archive, &inside(folder, &format!("_rels/{file}.rels")))?, |element, begins| {
        let [id, kind, target] = ["Id", "Type", "Target"].map(|name| attribute(element, name));
        if begins && let (Some(id), Some(kind), Some(target)) = (id, kind, target) {
            targets.push([id, kind, inside(folder, &target)]);
        }
    })?;
    Some(targets)
}

/// `row` elements with `hidden`; the sheet's file is found by its name and relation.
fn of_excel(path: &Path, sheet: &str) -> Option<Vec<HiddenRow>> {
    let mut archive = archive(path)?;
    let of_file = relations(&mut archive, "")?;
    let [_, _, workbook] = of_file.into_iter().find(|[_, kind, _]| kind.ends_with("/officeDocument"))?;
    let mut relation = None;
    elements(part(&mut archive, &workbook)?, |element, begins| {
        let is_it = begins
            && element.local_name().as_ref() == "sheet"
            && attribute(element, "name").as_deref() == Some(sheet);
        if is_it {
            relation = attribute(element, "r:id");
        }
    })?;
    let of_workbook = relations(&mut archive, &workbook)?;
    let [_, _, name] = of_workbook.into_iter().find(|[id, _, _]| Some(id) == relation.as_ref())?;
    let (mut rows, mut number) = (Vec::new(), 0);
    elements(part(&mut archive, &name)?, |element, begins| {
        if !begins || element.local_name().as_ref() != "row" {
            return;
        }
        // Rows without a number follow the one before.
        number = attribute(element, "r").and_then(|text| text.parse().ok()).unwrap_or(number + 1);
        if attribute(element, "hidden").is_some_and(|text| matches!(text.as_str(), "1" | "true")) {
            let level = attribute(element, "outlineLevel").unwrap_or_default();
            rows.push(HiddenRow { first: number, count: 1, is_folded: !matches!(level.as_str(), "" | "0") });
        }
    })?;
    rows.sort_by_key(|row| row.first);
    Some(rows)
}

/// `table-row` elements whose visibility is `filter` or `collapse`, the latter in a group where they are folded.
fn of_open_document(path: &Path, sheet: &str) -> Option<Vec<HiddenRow>> {
    let mut archive = archive(path)?;
    let (mut rows, mut next, mut groups, mut is_inside) = (Vec::new(), 1u32, 0usize, false);
    elements(part(&mut archive, "content.xml")?, |element, begins| match element.local_name().as_ref() {
        "table" => is_inside = begins && attribute(element, "table:name").as_deref() == Some(sheet),
        "table-row-group" if begins => groups += 1,
        "table-row-group" => groups = groups.saturating_sub(1),
        "table-row" if begins && is_inside => {
            let repeated = attribute(element, "table:number-rows-repeated");
            let count = repeated.and_then(|text| text.parse().ok()).unwrap_or(1u32).min(MAX_ROWS);
            let visibility = attribute(element, "table:visibility");
            if matches!(visibility.as_deref(), Some("filter" | "collapse")) {
                let is_folded = groups > 0 && visibility.as_deref() == Some("collapse");
                rows.push(HiddenRow { first: next, count, is_folded });
            }
            next = next.saturating_add(count);
        }
        _ => {}
    })?;
    Some(rows)
}
