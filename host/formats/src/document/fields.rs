//! Typed access to the fields of a session, model or plan file, every fault with its place.

use super::error::{Place, Problem, SessionError, split_message};
use super::names::misspelt;
use std::path::{Path, PathBuf};
use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// A table of a file.
pub struct Fields<'d> {
    path: &'d Path,
    text: &'d str,
    /// Name of the table with those it is in, as in `[[lateral]]`; empty for the whole file.
    name: String,
    /// Start of the table.
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
        let document = DeTable::parse(text).map_err(|error| {
            let offset = error.span().map_or(0, |span| span.start);
            let (problem, expected) = syntax(error.message(), text, offset);
            let location = Place::at(path, text, offset);
            SessionError::Field { place: location, field: "syntax".to_owned(), problem, expected }
        })?;
        use_fields(&Fields { path, text, name: String::new(), offset: 0, table: document.get_ref() })
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

    /// A fault of a field that is missing, with the place of one of a similar name.
    fn missing(&self, field: &str, expected: impl Into<String>) -> SessionError {
        let similar = misspelt(field, self.names()).map(str::to_owned);
        let key =
            similar.as_ref().and_then(|similar| self.table.iter().find(|(key, _)| key.get_ref() == similar));
        let offset = key.map_or(self.offset, |(key, _)| key.span().start);
        self.fault(offset, field, similar.map_or(Problem::Missing, Problem::Misspelt), expected)
    }

    /// Start of the table.
    pub fn place(&self) -> Place {
        Place::at(self.path, self.text, self.offset)
    }

    /// Position of a field's value, or the table where there is none.
    pub fn place_of(&self, field: &str) -> Place {
        let offset = self.get(field).map_or(self.offset, |value| value.span().start);
        Place::at(self.path, self.text, offset)
    }

    /// The number of the format, of which there is one so far.
    pub fn format(&self) -> Result<(), SessionError> {
        const EXPECTED: &str = "1, the format that this version of guide supports";
        let problem = match self.get("format").map(Spanned::get_ref) {
            None => return Err(self.missing("format", EXPECTED)),
            Some(DeValue::Integer(number)) if number.as_str() == "1" => return Ok(()),
            Some(DeValue::Float(number)) if number.as_str() == "1.0" => return Ok(()),
            Some(DeValue::Integer(number)) => Problem::Unsupported(number.as_str().to_owned()),
            Some(DeValue::Float(number)) => Problem::Unsupported(number.as_str().to_owned()),
            Some(other) => Problem::WrongType(other.type_str()),
        };
        Err(self.field_fault("format", problem, EXPECTED))
    }

    /// Reads the file that a field names, in `dir`. An unreadable file is an error of the field.
    pub fn file<T>(
        &self,
        dir: &Path,
        field: &str,
        read: impl FnOnce(&Path) -> Result<T, SessionError>,
    ) -> Result<(PathBuf, T), SessionError> {
        let path = dir.join(self.text(field)?);
        match read(&path) {
            Ok(content) => Ok((path, content)),
            Err(SessionError::Io { path, cause, .. }) => {
                let problem = Problem::Unreadable(format!("{}: {cause}", path.display()));
                Err(self.field_fault(field, problem, "a file that can be read"))
            }
            Err(other) => Err(other),
        }
    }

    /// Refuses fields that are not among `known`, for tables in which a misspelt field must not be ignored.
    pub fn only(&self, known: &[&str]) -> Result<(), SessionError> {
        fn names(known: &[&str]) -> String {
            if known.is_empty() { "nothing here".to_owned() } else { known.join(", ") }
        }
        let unknown = self.table.iter().filter(|(key, _)| !known.contains(&key.get_ref().as_ref()));
        match unknown.min_by_key(|(key, _)| key.span().start) {
            Some((key, _)) => {
                let name = key.get_ref().to_string();
                Err(self.fault(key.span().start, &name, Problem::Unknown(name.clone()), names(known)))
            }
            None => Ok(()),
        }
    }

    /// Refuses a field that is not among `known` and similar to one that is and is missing; others are ignored.
    pub fn none_misspelt(&self, known: &[&str]) -> Result<(), SessionError> {
        let unknown_names = || self.names().filter(|name| !known.contains(name));
        match known.iter().find(|name| self.get(name).is_none() && misspelt(name, unknown_names()).is_some())
        {
            Some(name) => Err(self.missing(name, "this name, or one that is not similar")),
            None => Ok(()),
        }
    }

    /// Fields that are not among `known`, with their places.
    pub fn others(&self, known: &[&str]) -> Vec<(Place, String)> {
        let unknown_fields = self.table.iter().filter(|(key, _)| !known.contains(&key.get_ref().as_ref()));
        let dot = if self.name.is_empty() { "" } else { "." };
        unknown_fields
            .map(|(key, _)| {
                let location = Place::at(self.path, self.text, key.span().start);
                (location, format!("{}{dot}{}", self.name, key.get_ref()))
            })
            .collect()
    }

    /// Names of its fields.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.table.iter().map(|(key, _)| key.get_ref().as_ref())
    }

    /// A number within `[least, most]`, where there is one.
    pub fn optional_number(&self, field: &str, range: [f64; 2]) -> Result<Option<f64>, SessionError> {
        self.optional_scaled(field, range, 0)
    }

    /// A number within `[least, most]` times a power of ten, where there is one: the decimal number in the file is scaled, so that
    /// nothing is lost by rounding twice.
    pub fn optional_scaled(
        &self,
        field: &str,
        range: [f64; 2],
        power: i32,
    ) -> Result<Option<f64>, SessionError> {
        self.get(field).map(|value| self.scaled(field, value, range, power)).transpose()
    }

    /// A list of numbers within `[least, most]` times a power of ten, where there is one.
    pub fn optional_list(
        &self,
        field: &str,
        range: [f64; 2],
        power: i32,
    ) -> Result<Option<Vec<f64>>, SessionError> {
        let Some(value) = self.get(field) else { return Ok(None) };
        match value.get_ref() {
            DeValue::Array(items) => {
                let numbers: Result<_, _> =
                    items.iter().map(|item| self.scaled(field, item, range, power)).collect();
                numbers.map(Some)
            }
            other => {
                let problem = Problem::WrongType(other.type_str());
                Err(self.field_fault(field, problem, "a list of numbers"))
            }
        }
    }

    /// A list of lists of numbers within `[least, most]` times a power of ten, where there is one.
    pub fn optional_rows(
        &self,
        field: &str,
        range: [f64; 2],
        power: i32,
    ) -> Result<Option<Vec<Vec<f64>>>, SessionError> {
        let Some(value) = self.get(field) else { return Ok(None) };
        const EXPECTED: &str = "a list of lists of numbers";
        let DeValue::Array(rows) = value.get_ref() else {
            return Err(self.wrong_type(field, value, EXPECTED));
        };
        rows.iter()
            .map(|row| match row.get_ref() {
                DeValue::Array(items) => {
                    items.iter().map(|item| self.scaled(field, item, range, power)).collect()
                }
                _ => Err(self.wrong_type(field, row, EXPECTED)),
            })
            .collect::<Result<_, _>>()
            .map(Some)
    }

    /// A list of strings, where there is one.
    pub fn optional_texts(&self, field: &str) -> Result<Option<Vec<String>>, SessionError> {
        let Some(value) = self.get(field) else { return Ok(None) };
        const EXPECTED: &str = "a list of strings";
        let DeValue::Array(items) = value.get_ref() else {
            return Err(self.wrong_type(field, value, EXPECTED));
        };
        items
            .iter()
            .map(|item| match item.get_ref() {
                DeValue::String(text) => Ok(text.to_string()),
                _ => Err(self.wrong_type(field, item, EXPECTED)),
            })
            .collect::<Result<_, _>>()
            .map(Some)
    }

    /// An interval `[low, high]` within `[least, most]` times a power of ten, where there is one.
    pub fn optional_interval(
        &self,
        field: &str,
        range: [f64; 2],
        power: i32,
    ) -> Result<Option<[f64; 2]>, SessionError> {
        let Some(ends) = self.optional_list(field, range, power)? else { return Ok(None) };
        match ends.as_slice() {
            &[low, high] if low <= high => Ok(Some([low, high])),
            _ => {
                let problem = match ends.as_slice() {
                    [low, _] => {
                        Problem::Syntax(format!("{} is more than the second number", low / 10f64.powi(power)))
                    }
                    _ => Problem::Count(ends.len()),
                };
                Err(self.field_fault(field, problem, "[low, high], two numbers in order"))
            }
        }
    }

    fn wrong_type(&self, field: &str, value: &Spanned<DeValue<'_>>, expected: &str) -> SessionError {
        let problem = Problem::WrongType(value.get_ref().type_str());
        self.fault(value.span().start, field, problem, expected)
    }

    fn scaled(
        &self,
        field: &str,
        value: &Spanned<DeValue<'_>>,
        [least, most]: [f64; 2],
        power: i32,
    ) -> Result<f64, SessionError> {
        let fault = |problem| {
            let expected = format!("a number from {least} to {most}");
            self.fault(value.span().start, field, problem, expected)
        };
        let parsed: Option<[f64; 2]> = match value.get_ref() {
            DeValue::Float(float) => {
                let text = float.as_str().replace('_', "");
                let number: Option<f64> = text.parse().ok();
                number.map(|number| [number, shifted(&text, power).unwrap_or(number)])
            }
            DeValue::Integer(integer) => {
                let text = integer.as_str().replace('_', "");
                // Beyond 64 bits only its size matters.
                let whole = i64::from_str_radix(&text, integer.radix())
                    .map_or_else(|_| text.parse().ok(), |n| Some(n as f64));
                whole.map(|whole| {
                    [
                        whole,
                        shifted(&text, power)
                            .filter(|_| integer.radix() == 10)
                            .unwrap_or(whole * 10f64.powi(power)),
                    ]
                })
            }
            other => return Err(fault(Problem::WrongType(other.type_str()))),
        };
        match parsed {
            Some([number, _]) if !number.is_finite() => Err(fault(Problem::NotFinite)),
            Some([number, scaled]) if (least..=most).contains(&number) => Ok(scaled),
            Some([number, _]) => Err(fault(Problem::OutOfRange(number))),
            None => Err(fault(Problem::Syntax("not a number".to_owned()))),
        }
    }

    /// A number within `[least, most]`.
    pub fn number(&self, field: &str, [least, most]: [f64; 2]) -> Result<f64, SessionError> {
        self.optional_number(field, [least, most])?
            .ok_or_else(|| self.missing(field, format!("a number from {least} to {most}")))
    }

    /// 0 or a number within `[least, most]`.
    pub fn number_or_zero(&self, field: &str, [least, most]: [f64; 2]) -> Result<f64, SessionError> {
        match self.number(field, [least, most]) {
            Err(SessionError::Field { problem: Problem::OutOfRange(0.0), .. }) => Ok(0.0),
            Err(SessionError::Field { place, field, problem, .. }) => {
                let expected = format!("0 (in air) or a number from {least} to {most}");
                Err(SessionError::Field { place, field, problem, expected })
            }
            other => other,
        }
    }

    /// A whole number within `[least, most]`, where there is one.
    pub fn optional_whole(&self, field: &str, [least, most]: [f64; 2]) -> Result<Option<f64>, SessionError> {
        let number = self.optional_number(field, [least, most])?;
        match number.filter(|number| number.fract() != 0.0) {
            Some(number) => {
                let expected = format!("a whole number from {least} to {most}");
                Err(self.field_fault(field, Problem::NotWhole(number), expected))
            }
            None => Ok(number),
        }
    }

    /// A flag; false where it is not stated.
    pub fn flag(&self, field: &str) -> Result<bool, SessionError> {
        Ok(self.optional_flag(field)?.unwrap_or(false))
    }

    /// A flag, where it is stated.
    pub fn optional_flag(&self, field: &str) -> Result<Option<bool>, SessionError> {
        match self.get(field).map(Spanned::get_ref) {
            None => Ok(None),
            Some(DeValue::Boolean(flag)) => Ok(Some(*flag)),
            Some(other) => {
                Err(self.field_fault(field, Problem::WrongType(other.type_str()), "true or false"))
            }
        }
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

    /// A date as text: a string that is not empty, or a date of TOML; where there is one.
    pub fn optional_date_text(&self, field: &str) -> Result<Option<String>, SessionError> {
        match self.get(field).map(Spanned::get_ref) {
            Some(DeValue::Datetime(date)) => Ok(Some(date.to_string())),
            _ => self.optional_text(field),
        }
    }

    /// A string that is not empty.
    pub fn text(&self, field: &str) -> Result<String, SessionError> {
        self.optional_text(field)?.ok_or_else(|| self.missing(field, "a string"))
    }

    /// A table such as `[rig]`, where there is one.
    pub fn optional_table(&self, name: &str) -> Result<Option<Fields<'d>>, SessionError> {
        self.get(name).map(|value| self.as_table(name, value)).transpose()
    }

    /// A table such as `[rig]`.
    pub fn table(&self, name: &str) -> Result<Fields<'d>, SessionError> {
        let dot = if self.name.is_empty() { "" } else { "." };
        self.optional_table(name)?
            .ok_or_else(|| self.missing(name, format!("a table [{}{dot}{name}]", self.name)))
    }

    /// The tables of an array such as `[[lateral]]`; none where there is no such array.
    pub fn tables(&self, name: &str) -> Result<Vec<Fields<'d>>, SessionError> {
        match self.get(name).map(|value| (value, value.get_ref())) {
            None => Ok(Vec::new()),
            Some((_, DeValue::Array(items))) => items.iter().map(|item| self.as_table(name, item)).collect(),
            Some((value, other)) => {
                let problem = Problem::WrongType(other.type_str());
                Err(self.fault(value.span().start, name, problem, format!("tables [[{name}]]")))
            }
        }
    }

    fn as_table(&self, name: &str, value: &'d Spanned<DeValue<'d>>) -> Result<Fields<'d>, SessionError> {
        let offset = value.span().start;
        let dot = if self.name.is_empty() { "" } else { "." };
        let full = format!("{}{dot}{name}", self.name);
        match value.get_ref() {
            DeValue::Table(table) => {
                Ok(Fields { path: self.path, text: self.text, name: full, offset, table })
            }
            other => Err(self.fault(
                offset,
                name,
                Problem::WrongType(other.type_str()),
                format!("a table [{full}]"),
            )),
        }
    }
}

/// A fault of the syntax in words, better ones than the parser's where it misleads.
fn syntax(message: &str, text: &str, offset: usize) -> (Problem, String) {
    fn digit(byte: Option<&u8>) -> bool {
        byte.is_some_and(u8::is_ascii_digit)
    }
    let (offending, preceding) = (text.as_bytes().get(offset..), offset.checked_sub(1));
    let remaining_bytes = offending.unwrap_or_default();
    let (problem, expected) = if remaining_bytes.first() == Some(&b',')
        && digit(remaining_bytes.get(1))
        && digit(preceding.and_then(|preceding| text.as_bytes().get(preceding)))
    {
        ("a comma in a number", "a decimal point")
    } else if message.starts_with("string values must be quoted") {
        match remaining_bytes.iter().find(|byte| !matches!(byte, b' ' | b'\t')) {
            None | Some(b'\n' | b'\r' | b'#') => ("no value", "a number, a list, or text in quotation marks"),
            Some(_) => ("text without quotation marks", "a number, a list, or text in straight ones (\")"),
        }
    } else if message.starts_with("duplicate key") {
        ("this name appears twice", "every name once in a table")
    } else if message.contains("recurs") {
        ("nested too deeply", "lists and tables as the format has them")
    } else {
        return split_message(message, "TOML");
    };
    (Problem::Syntax(problem.to_owned()), expected.to_owned())
}

/// The number that a decimal text times a power of ten is nearest to.
fn shifted(text: &str, power: i32) -> Option<f64> {
    if power == 0 {
        return text.parse().ok();
    }
    let (digits, exponent) = text.split_once(['e', 'E']).unwrap_or((text, "0"));
    let exponent: i32 = exponent.parse().ok()?;
    format!("{digits}e{}", exponent.saturating_add(power)).parse().ok()
}
