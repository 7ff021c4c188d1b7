//! Columns that are not found, and what there is in their place.

use super::super::TableError;
use super::super::mapping::{Choice, candidates};
use super::super::raw::{RawColumn, RawTable, WordColumn};
use super::super::unit::{Quantity, split_name};
use super::{Part, map_fault, series};
use crate::document::names::misspelt;
use std::path::{Path, PathBuf};

/// Error for the first column of words that is meant to have numbers.
pub(super) fn not_numbers(tables: &[RawTable], is_meant: impl Fn(&WordColumn) -> bool) -> Option<TableError> {
    tables.iter().find_map(|table| {
        let column = table.words.iter().find(|column| is_meant(column))?;
        Some(match &column.first {
            Some((line, text)) => series::bad(table, &column.header, *line, text),
            None => TableError::File {
                path: table.path.clone(),
                problem: format!("\"{}\" has no real numbers", column.header),
                expected: "a column or a full array of them".to_owned(),
            },
        })
    })
}

/// Columns that every lateral run needs, and the reason for each that is not found.
fn reasons(tables: &[RawTable], parts: &[Part]) -> Vec<String> {
    ["force_y_n", "displacement_y_mm"]
        .into_iter()
        .filter(|name| parts.iter().all(|part| part.target.name != *name))
        .map(|name| format!("{name}: {}", reason(name, tables, parts)))
        .collect()
}

/// The reason why a quantity has no column.
fn reason(name: &str, tables: &[RawTable], parts: &[Part]) -> String {
    let candidates: Vec<String> = tables
        .iter()
        .flat_map(|table| candidates(name, table))
        .filter(|column| !parts.iter().any(|part| std::ptr::eq(part.column, *column)))
        .map(|column| format!("\"{}\" (#{})", column.header, column.number))
        .collect();
    let name_along_x = name.replace("_y_", "_x_");
    if candidates.len() > 1 {
        format!("{} may all be this quantity: choose one by its number", candidates.join(" and "))
    } else if parts.iter().any(|part| part.target.name == name_along_x) {
        format!("only {name_along_x} is there, and a run along one axis is along y")
    } else if tables.iter().all(RawTable::is_without_names) {
        "the columns have no names: is the line of names missing, or not right above the numbers?".to_owned()
    } else {
        "no column has this name and one of its units".to_owned()
    }
}

/// Error for columns that every run needs.
pub(super) fn nothing(tables: &[RawTable], parts: &[Part]) -> TableError {
    let column_names: Vec<String> = tables
        .iter()
        .flat_map(|table| &table.columns)
        .map(|column| {
            let unit = column.unit.as_ref().map_or_else(String::new, |unit| format!(" in {}", unit.name));
            format!("\"{}\"{unit}", column.header)
        })
        .collect();
    let mapped_names: Vec<&str> = parts.iter().map(|part| part.target.name).collect();
    let path = tables.first().map_or(Path::new(""), |table| table.path.as_path());
    TableError::File {
        path: path.to_owned(),
        problem: format!(
            "columns {}; recognized: {} ({})",
            column_names.join(", "),
            if mapped_names.is_empty() { "none".to_owned() } else { mapped_names.join(", ") },
            reasons(tables, parts).join("; ")
        ),
        expected: "force_y_n and displacement_y_mm of a lateral run, or depth_mm and tip_y_mm of an insertion: --map 'COLUMN=QUANTITY:UNIT' for each".to_owned(),
    }
}

/// Error for a shape of which either the places or the deflections are missing.
pub(super) fn half_of_shape(parts: &[Part]) -> Option<TableError> {
    let has = |start: &str| parts.iter().any(|part| part.target.name.starts_with(start));
    let (there, missing) = match (has("z_mm"), has("deflection_y_mm"), has("deflection_")) {
        (true, false, _) => ("z_mm", "deflection_y_mm"),
        (false, _, true) => ("deflection_y_mm", "z_mm"),
        _ => return None,
    };
    Some(TableError::Map {
        choice: there.to_owned(),
        problem: format!("without {missing}"),
        expected: format!("both of a shape: --map 'COLUMN={missing}:UNIT' for a column of the same file"),
    })
}

/// Error for a file of which nothing but times is taken: it was given for something. Of the tables of a bag or of MATLAB one is enough.
pub(super) fn unused_file(tables: &[RawTable], parts: &[Part]) -> Option<TableError> {
    fn file(path: &Path) -> PathBuf {
        let text = path.to_string_lossy();
        let whole = text.rsplit_once('#').map(|(file, _)| PathBuf::from(file));
        fn has_tables(file: &Path) -> bool {
            let ending = file.extension().map(|ending| ending.to_string_lossy().to_lowercase());
            matches!(ending.as_deref(), Some("mcap" | "mat"))
        }
        whole.filter(|file| has_tables(file)).unwrap_or_else(|| path.to_owned())
    }
    let used: Vec<PathBuf> = parts
        .iter()
        .filter(|part| part.target.quantity != Quantity::Time)
        .map(|part| file(&part.table.path))
        .collect();
    let table = tables.iter().find(|table| !used.contains(&file(&table.path)))?;
    let names: Vec<String> = table
        .columns
        .iter()
        .map(|column| &column.header)
        .chain(table.words.iter().map(|column| &column.header))
        .map(|header| format!("\"{header}\""))
        .collect();
    Some(TableError::File {
        path: table.path.clone(),
        problem: format!("none of its columns is used: {}", names.join(", ")),
        expected: "--map 'COLUMN=QUANTITY:UNIT' for one of them, or the other files alone".to_owned(),
    })
}

/// The column of a choice in each table that has it.
pub(super) fn found<'t>(
    tables: &'t [RawTable],
    choice: &Choice,
) -> Result<Vec<(&'t RawTable, &'t RawColumn)>, TableError> {
    let mut matching = Vec::new();
    for table in tables {
        let column_number =
            table.find(&choice.column).map_err(|problem| map_fault(choice, &problem, "one column"))?;
        matching.extend(
            column_number
                .and_then(|column_number| table.columns.get(column_number))
                .map(|column| (table, column)),
        );
    }
    // A number is meant for a file without names.
    let unnamed = choice.column.strip_prefix('#').map(|number| format!("column {number}"));
    if unnamed.as_ref().is_some_and(|name| matching.iter().any(|(_, column)| column.header == *name)) {
        matching.retain(|(_, column)| Some(&column.header) == unnamed.as_ref());
    }
    if matching.is_empty() {
        let frames = choice.column.split_once(':').map(|(topic, _)| format!("{topic}@"));
        let headers = tables.iter().flat_map(|table| &table.columns).map(|column| &column.header);
        let of_frames: Vec<&str> = headers
            .filter(|header| frames.as_ref().is_some_and(|start| header.starts_with(start)))
            .map(String::as_str)
            .collect();
        if !of_frames.is_empty() {
            return Err(map_fault(
                choice,
                "the topic has messages of several frames",
                &format!("the column of one frame: one of {}", of_frames.join(", ")),
            ));
        }
        fn is_named(column: &WordColumn, choice: &Choice) -> bool {
            let is_numbered = choice.column.starts_with('#');
            let (name, _) = split_name(&column.header);
            !is_numbered && [&column.header, &name].iter().any(|of| of.eq_ignore_ascii_case(&choice.column))
        }
        if let Some(error) = not_numbers(tables, |column| is_named(column, choice)) {
            return Err(error);
        }
        let column_names: Vec<String> = tables
            .iter()
            .flat_map(|table| &table.columns)
            .map(|column| format!("\"{}\"", column.header))
            .collect();
        let is_number = choice.column.starts_with('#');
        let names = tables.iter().flat_map(|table| &table.columns).map(|column| column.header.as_str());
        let meant = misspelt(&choice.column, names);
        let problem = if tables.iter().all(RawTable::is_without_names) && !is_number {
            "no file has such a column of numbers, as the columns have no names (is the line of names missing, or not right above the numbers?)"
        } else {
            "no file has such a column of numbers"
        };
        let meant = meant.map_or_else(String::new, |meant| format!("\"{meant}\", or "));
        return Err(map_fault(choice, problem, &format!("{meant}one of {}", column_names.join(", "))));
    }
    Ok(matching)
}
