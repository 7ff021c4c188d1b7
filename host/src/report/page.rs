//! Content of a report, independent of how it is printed: facts, sections, tables, figures. All text is plain; the
//! printer escapes it.

use crate::figures::FigureError;

/// Runs of one kind with figures; of more the tables say enough. With what is drawn of a run it bounds the size of a report.
pub(super) const FIGURES: usize = 8;

/// A report.
#[derive(Debug, Clone, PartialEq)]
pub struct Report {
    /// Name of the session, or of its folder.
    pub name: String,
    /// Warnings that come before everything else.
    pub warnings: Vec<String>,
    /// The results on one screen.
    pub summary: Vec<Fact>,
    /// The rest, in the order in which it is read.
    pub sections: Vec<Section>,
    /// The day that the report is of.
    pub date: String,
}

/// A quantity and what was found.
#[derive(Debug, Clone, PartialEq)]
pub struct Fact {
    /// The quantity.
    pub name: String,
    /// Its value, with unit and interval.
    pub value: String,
}

impl Fact {
    /// A quantity and what was found.
    pub fn new(name: impl Into<String>, value: impl Into<String>) -> Self {
        Self { name: name.into(), value: value.into() }
    }
}

/// Outcome of an analysis.
#[derive(Debug, Clone, PartialEq)]
pub enum Outcome<T> {
    /// The session has nothing for it; what it lacks.
    NotThere(&'static str),
    /// It could not be done, and why.
    Failed(String),
    /// Its result.
    Found(T),
}

impl<T> Outcome<T> {
    /// The result, where there is one.
    pub fn found(&self) -> Option<&T> {
        match self {
            Self::Found(found) => Some(found),
            Self::NotThere(_) | Self::Failed(_) => None,
        }
    }

    /// The same outcome with what `section` makes of a result.
    pub(super) fn section(
        &self,
        id: &'static str,
        title: &'static str,
        section: impl FnOnce(&T) -> Vec<Block>,
    ) -> Section {
        let content = match self {
            Self::NotThere(what) => Outcome::NotThere(what),
            Self::Failed(why) => Outcome::Failed(why.clone()),
            Self::Found(found) => Outcome::Found(section(found)),
        };
        Section { id, title, content }
    }
}

/// A section.
#[derive(Debug, Clone, PartialEq)]
pub struct Section {
    /// For links and machines.
    pub id: &'static str,
    /// Its heading.
    pub title: &'static str,
    /// Content of the section, or the reason for its absence.
    pub content: Outcome<Vec<Block>>,
}

impl Section {
    /// Takes out notes that are among the warnings at the top: everything is stated once.
    pub(super) fn without_notes(&mut self, shown: &[String]) {
        let Outcome::Found(blocks) = &mut self.content else { return };
        for block in blocks {
            if let Block::Notes(notes) = block {
                notes.retain(|note| !shown.contains(note));
            }
        }
    }
}

/// A part of a section.
#[derive(Debug, Clone, PartialEq)]
pub enum Block {
    /// A heading.
    Heading(String),
    /// A paragraph.
    Text(String),
    /// Remarks.
    Notes(Vec<String>),
    /// A table.
    Table(Table),
    /// A figure.
    Figure(Figure),
    /// Parts for the screen; paper goes without.
    Screen(Vec<Block>),
}

/// A table.
#[derive(Debug, Clone, PartialEq)]
pub struct Table {
    /// Description of the content.
    pub caption: String,
    /// Its columns.
    pub columns: Vec<Column>,
    /// Its rows; the first cell names the row.
    pub rows: Vec<Vec<String>>,
}

/// A column of a table.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Column {
    /// Its heading, with the unit.
    pub name: &'static str,
    /// Whether it holds numbers.
    pub is_number: bool,
}

/// A column of words.
pub(super) const fn words(name: &'static str) -> Column {
    Column { name, is_number: false }
}

/// A column of numbers.
pub(super) const fn number(name: &'static str) -> Column {
    Column { name, is_number: true }
}

/// A figure.
#[derive(Debug, Clone, PartialEq)]
pub struct Figure {
    /// Description of the content, also for those who do not see it.
    pub caption: String,
    /// The drawing.
    pub svg: String,
}

impl Block {
    /// A table.
    pub(super) fn table(
        caption: impl Into<String>,
        columns: impl Into<Vec<Column>>,
        rows: Vec<Vec<String>>,
    ) -> Self {
        Self::Table(Table { caption: caption.into(), columns: columns.into(), rows })
    }

    /// A figure, or the remark that it could not be drawn.
    pub(super) fn figure(caption: impl Into<String>, drawn: Result<String, FigureError>) -> Self {
        let caption = caption.into();
        match drawn {
            Ok(svg) => Self::Figure(Figure { caption, svg }),
            Err(why) => Self::Notes(vec![format!("{caption}: {why}")]),
        }
    }
}

/// A value with its interval, `-` where there is none.
pub(super) fn estimate(value: Option<f64>, ci95: Option<[f64; 2]>, digits: usize) -> String {
    match (value, ci95) {
        (Some(value), Some([low, high])) => {
            format!("{} ({} to {})", fixed(value, digits), fixed(low, digits), fixed(high, digits))
        }
        (value, _) => value.map_or("-".to_owned(), |value| fixed(value, digits)),
    }
}

/// A number with so many digits; what is rounded to zero has no sign.
pub(super) fn fixed(value: f64, digits: usize) -> String {
    let text = format!("{value:.digits$}");
    match text.strip_prefix('-') {
        Some(zero) if zero.chars().all(|c| matches!(c, '0' | '.')) => zero.to_owned(),
        _ => text,
    }
}

/// A probability; of small ones only that they are.
pub(super) fn p_value(p: Option<f64>) -> String {
    match p {
        Some(p) if p < 0.001 => "< 0.001".to_owned(),
        p => value(p, 3),
    }
}

/// A value, `-` where there is none.
pub(super) fn value(value: Option<f64>, digits: usize) -> String {
    estimate(value, None, digits)
}

/// A word, `-` where there is none.
pub(super) fn word(word: Option<&str>) -> String {
    word.unwrap_or("-").to_owned()
}

/// `1 run`, `2 runs`.
pub(super) fn count(number: usize, what: &str) -> String {
    if number == 1 { format!("1 {what}") } else { format!("{number} {what}s") }
}

/// At most so many of the points, evenly.
pub(super) fn thinned<T: Clone>(points: &[T], most: usize) -> Vec<T> {
    points.iter().step_by(points.len().div_ceil(most.max(1)).max(1)).cloned().collect()
}
