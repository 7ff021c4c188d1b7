//! Statement of a session about the tissue's walls: `body_mm`, `needle_at_mm`, `sides` and `far_side` of
//! `[tissue]`.

use crate::document::{Fields, Problem, SessionError};
use mechanics::{Block, ModelError, Mounting};
use std::fmt::Write as _;

/// Mounting of the tissue at its ends.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Walls {
    /// They are so far from the needle that the tissue is a half space.
    Far,
    /// A block of this size, held like this.
    Block(Block),
}

/// Names of [`Walls`] in files.
const FAR: &str = "far";
/// Fields of `[tissue]` that state them.
pub const WALL_FIELDS: [&str; 4] = ["body_mm", "needle_at_mm", "sides", "far_side"];
const SIDES: &str = "\"free\", \"held\", or \"far\" where no wall is near";

impl Walls {
    /// Reads what is stated; nothing of what is not.
    ///
    /// # Errors
    /// [`SessionError`] for the first fault found, with its place.
    pub fn read(fields: &Fields<'_>) -> Result<Option<Self>, SessionError> {
        let [least_mm, most_mm] = Block::EDGE_RANGE_M.map(|m| 1e3 * m);
        let body_m = list::<3>(fields, "body_mm", [least_mm, most_mm], "[x, y, z], the edges of the block")?;
        let entry_xy_m = list::<2>(
            fields,
            "needle_at_mm",
            [0.0, most_mm],
            "[x, y], the entry from the corner of the block",
        )?;
        let sides = fields.optional_text("sides")?;
        let unknown = |field: &str, name: &str, expected: &'static str| {
            fields.field_fault(field, Problem::Unknown(name.chars().take(40).collect()), expected)
        };
        let mounting = |field: &'static str, name: &str, expected: &'static str| {
            Mounting::ALL
                .into_iter()
                .find(|kind| kind.name() == name)
                .ok_or_else(|| unknown(field, name, expected))
        };
        let far_side = match fields.optional_text("far_side")? {
            Some(name) => Some(mounting("far_side", &name, "\"free\" or \"held\"")?),
            None => None,
        };
        let needs = |field: &str, what: &str| {
            fields.field_fault(
                field,
                Problem::Syntax(format!("stated without {what}")),
                "body_mm and sides beside it",
            )
        };
        let stated = [("needle_at_mm", entry_xy_m.is_some()), ("far_side", far_side.is_some())];
        match (body_m, sides.as_deref()) {
            (None, Some(FAR)) | (None, None) => {
                if let Some((field, _)) = stated.into_iter().find(|(_, is_stated)| *is_stated) {
                    return Err(needs(field, "body_mm"));
                }
                Ok(sides.map(|_| Self::Far))
            }
            (None, Some(name)) => {
                mounting("sides", name, SIDES)?;
                Err(needs("sides", "body_mm"))
            }
            (Some(_), None) => Err(needs("body_mm", "sides")),
            (Some(_), Some(FAR)) => Err(needs("body_mm", "sides that are free or held")),
            (Some(size_m), Some(name)) => {
                let block = Block {
                    size_m,
                    needle_at_m: entry_xy_m.unwrap_or([0.5 * size_m[0], 0.5 * size_m[1]]),
                    sides: mounting("sides", name, SIDES)?,
                    far_side: far_side.unwrap_or(Mounting::Held),
                };
                block.check().map_err(|why| match why {
                    ModelError::OutOfRange { name, value, expected } => {
                        let field = if fields.names().any(|field| field == name) { name } else { "body_mm" };
                        let problem = if name == "far_side" {
                            Problem::Syntax("nothing holds the block".to_owned())
                        } else {
                            Problem::OutOfRange(value)
                        };
                        fields.field_fault(field, problem, expected)
                    }
                    other => fields.field_fault("body_mm", Problem::Syntax(other.to_string()), "a block"),
                })?;
                Ok(Some(Self::Block(block)))
            }
        }
    }

    /// The block, where it is one.
    pub fn block(self) -> Option<Block> {
        match self {
            Self::Far => None,
            Self::Block(block) => Some(block),
        }
    }

    /// The fields as text, a line each.
    pub(super) fn to_toml(self) -> String {
        let Self::Block(block) = self else { return format!("sides = \"{FAR}\"\n") };
        // Millimetres that were read as metres are decimal numbers again.
        fn list(all_m: &[f64]) -> String {
            all_m.iter().map(|m| format!("{:?}", (1e12 * m).round() / 1e9)).collect::<Vec<_>>().join(", ")
        }
        let mut text = String::new();
        let _ = writeln!(text, "body_mm = [{}]", list(&block.size_m));
        let _ = writeln!(text, "needle_at_mm = [{}]", list(&block.needle_at_m));
        let _ = writeln!(text, "sides = \"{}\"", block.sides.name());
        let _ = writeln!(text, "far_side = \"{}\"", block.far_side.name());
        text
    }
}

/// So many numbers, in millimetres.
fn list<const N: usize>(
    fields: &Fields<'_>,
    field: &str,
    range: [f64; 2],
    expected: &'static str,
) -> Result<Option<[f64; N]>, SessionError> {
    let Some(numbers) = fields.optional_list(field, range, -3)? else { return Ok(None) };
    let count = numbers.len();
    let fixed: Result<[f64; N], _> = numbers.try_into();
    fixed.map(Some).map_err(|_| fields.field_fault(field, Problem::Count(count), expected))
}
