//! Typed access to the fields of a session file, every fault with its place.

use super::error::{Place, Problem, SessionError};
use std::path::Path;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// A table of the session file.
pub struct Fields<'d> {
    path: &'d Path,
    text: &'d str,
    /// Name of the table, as in `[[lateral]]`; empty for the whole file.
    name: &'static str,
    /// Where the table starts.
    offset: usize,
    table: &'d DeTable<'d>,
}

impl<'d> Fields<'d> {
    /// Parses a whole file and hands its fields to `use_fields`.
    pub fn parse<T>(
        path: &Path,
        text: &str,
        use_fields: impl FnOnce(&Fields<'_>) -> Result<T, SessionError>,
    ) -> Result<T, SessionError> {
        let document = DeTable::parse(text).map_err(|error| SessionError::Field {
            place: Place::at(path, text, error.span().map_or(0, |span| span.start)),
            field: "syntax".to_owned(),
            problem: Problem::Syntax(error.message().to_owned()),
            expected: "TOML".to_owned(),
        })?;
        use_fields(&Fields { path, text, name: "", offset: 0, table: document.get_ref() })
    }

    fn fault(
        &self,
        offset: usize,
        field: &str,
        problem: Problem,
        expected: impl Into<String>,
    ) -> SessionError {
        let dot = if self.name.is_empty() || field.is_empty() { "" } else { "." };
        SessionError::Field {
            place: Place::at(self.path, self.text, offset),
            field: format!("{}{dot}{field}", self.name),
            problem,
            expected: expected.into(),
        }
    }

    fn get(&self, field: &str) -> Option<&'d Spanned<DeValue<'d>>> {
        self.table.iter().find(|(key, _)| key.get_ref() == field).map(|(_, value)| value)
    }

    /// A fault of this field's value, or of the table where the field is missing.
    pub fn field_fault(&self, field: &str, problem: Problem, expected: impl Into<String>) -> SessionError {
        let offset = self.get(field).map_or(self.offset, |value| value.span().start);
        self.fault(offset, field, problem, expected)
    }

    /// A number within `[least, most]`, where there is one.
    pub fn optional_number(&self, field: &str, [least, most]: [f64; 2]) -> Result<Option<f64>, SessionError> {
        let Some(value) = self.get(field) else { return Ok(None) };
        let expected = || format!("a number from {least} to {most}");
        let number = match value.get_ref() {
            DeValue::Float(float) => float.as_str().replace('_', "").parse().ok(),
            DeValue::Integer(integer) => {
                i64::from_str_radix(&integer.as_str().replace('_', ""), integer.radix())
                    .ok()
                    .map(|i| i as f64)
            }
            other => return Err(self.field_fault(field, Problem::WrongType(other.type_str()), expected())),
        };
        match number {
            Some(number) if !f64::is_finite(number) => {
                Err(self.field_fault(field, Problem::NotFinite, expected()))
            }
            Some(number) if (least..=most).contains(&number) => Ok(Some(number)),
            Some(number) => Err(self.field_fault(field, Problem::OutOfRange(number), expected())),
            None => Err(self.field_fault(field, Problem::Syntax("not a number".to_owned()), expected())),
        }
    }

    /// A number within `[least, most]`.
    pub fn number(&self, field: &str, [least, most]: [f64; 2]) -> Result<f64, SessionError> {
        let missing =
            || self.field_fault(field, Problem::Missing, format!("a number from {least} to {most}"));
        self.optional_number(field, [least, most])?.ok_or_else(missing)
    }

    /// A string that is not empty, where there is one.
    pub fn optional_text(&self, field: &str) -> Result<Option<String>, SessionError> {
        match self.get(field).map(Spanned::get_ref) {
            None => Ok(None),
            Some(DeValue::String(text)) if text.trim().is_empty() => {
                Err(self.field_fault(field, Problem::Empty, "a string"))
            }
            Some(DeValue::String(text)) => Ok(Some(text.to_string())),
            Some(other) => Err(self.field_fault(field, Problem::WrongType(other.type_str()), "a string")),
        }
    }

    /// A string that is not empty.
    pub fn text(&self, field: &str) -> Result<String, SessionError> {
        self.optional_text(field)?.ok_or_else(|| self.field_fault(field, Problem::Missing, "a string"))
    }

    /// A table such as `[rig]`, where there is one.
    pub fn optional_table(&self, name: &'static str) -> Result<Option<Fields<'d>>, SessionError> {
        self.get(name).map(|value| self.as_table(name, value)).transpose()
    }

    /// A table such as `[rig]`.
    pub fn table(&self, name: &'static str) -> Result<Fields<'d>, SessionError> {
        let missing = || self.field_fault(name, Problem::Missing, format!("a table [{name}]"));
        self.optional_table(name)?.ok_or_else(missing)
    }

    /// The tables of an array such as `[[lateral]]`; none where there is no such array.
    pub fn tables(&self, name: &'static str) -> Result<Vec<Fields<'d>>, SessionError> {
        match self.get(name).map(|value| (value, value.get_ref())) {
            None => Ok(Vec::new()),
            Some((_, DeValue::Array(items))) => items.iter().map(|item| self.as_table(name, item)).collect(),
            Some((value, other)) => {
                let problem = Problem::WrongType(other.type_str());
                Err(self.fault(value.span().start, name, problem, format!("tables [[{name}]]")))
            }
        }
    }

    fn as_table(
        &self,
        name: &'static str,
        value: &'d Spanned<DeValue<'d>>,
    ) -> Result<Fields<'d>, SessionError> {
        let offset = value.span().start;
        match value.get_ref() {
            DeValue::Table(table) => Ok(Fields { path: self.path, text: self.text, name, offset, table }),
            other => Err(self.fault(
                offset,
                name,
                Problem::WrongType(other.type_str()),
                format!("a table [{name}]"),
            )),
        }
    }
}
