//! Columns by their names.

use super::raw::{RawColumn, RawTable};

impl RawTable {
    /// Whether no line names its columns.
    pub(super) fn is_without_names(&self) -> bool {
        self.columns.iter().all(|column| column.header == format!("column {}", column.number))
    }

    /// The column of this name, as its header writes it or without its unit, or by its number: `#3`.
    ///
    /// # Errors
    /// What is wrong and what is valid, where there is none or there are several.
    pub fn find(&self, name: &str) -> Result<Option<usize>, String> {
        if let Some(number) = name.strip_prefix('#').and_then(|number| number.parse::<usize>().ok()) {
            return Ok(self.columns.iter().position(|column| column.number == number));
        }
        // The mark of a comment before the first name is no part of it.
        let name = name.trim_start_matches('%');
        let matching = |is: &dyn Fn(&RawColumn) -> bool| -> Vec<usize> {
            self.columns.iter().enumerate().filter(|(_, column)| is(column)).map(|(at, _)| at).collect()
        };
        let matching_by = |same: &dyn Fn(&str, &str) -> bool| {
            let whole = matching(&|column| same(&column.header, name));
            if whole.is_empty() { matching(&|column| same(&column.name, name)) } else { whole }
        };
        let exact = matching_by(&|a, b| a == b);
        let matching_columns =
            if exact.is_empty() { matching_by(&|a, b| a.to_lowercase() == b.to_lowercase()) } else { exact };
        match matching_columns.as_slice() {
            [] => Ok(None),
            [one] => Ok(Some(*one)),
            several => {
                let numbers: Vec<String> = several
                    .iter()
                    .filter_map(|at| Some(format!("#{}", self.columns.get(*at)?.number)))
                    .collect();
                Err(format!("there are several of this name: {}", numbers.join(", ")))
            }
        }
    }
}
