//! `guide diagnose --check` and `guide plan --check`: from which size on each effect would have a name.

use inference::diagnose::{Check, Showable};
use std::fmt::{self, Display};

/// Possible uses of a session, as text.
pub(super) struct CheckText<'a>(pub &'a Check);

impl Display for CheckText<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self(check) = self;
        writeln!(f, "session      {}", check.split)?;
        if check.held_out == 0 {
            writeln!(
                f,
                "limit        nothing could be held out, so nothing would be named: repeat the run, or take a staircase with several holds"
            )?;
        }
        writeln!(f, "a name       {}", check.of_names())?;
        let percent = 100.0 * check.probability;
        writeln!(f, "named with {percent:.0} % probability from this size on, if held-out runs confirm it")?;
        writeln!(f, "  {:<22}  {:<34}  {:<26}  not told apart from", "effect", "size", "seen best at")?;
        for one in &check.effects {
            writeln!(f, "{}", line(one).trim_end())?;
        }
        if !check.not_shown.is_empty() {
            writeln!(
                f,
                "not shown    of any size within its range, or an unknown of the model anyway: {}",
                check.not_shown.join(", ")
            )?;
        }
        for warning in &check.warnings {
            writeln!(f, "note         {warning}")?;
        }
        Ok(())
    }
}

fn line(one: &Showable) -> String {
    let size = format!("{} {}", one.parameter, rounded(one.value));
    let parameter_text =
        one.place.map_or(String::new(), |(name, place)| format!("{name} {}", rounded(place)));
    format!("  {:<22}  {size:<34}  {parameter_text:<26}  {}", one.effect, one.alike.join(", "))
}

/// Three digits.
fn rounded(value: f64) -> String {
    let digits = 2 - value.abs().max(1e-9).log10().floor().clamp(-4.0, 2.0) as i32;
    format!("{value:.*}", usize::try_from(digits).unwrap_or_default())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_have_three_digits() {
        assert_eq!(rounded(0.012_345), "0.0123");
        assert_eq!(rounded(1.034_5), "1.03");
        assert_eq!(rounded(123.4), "123");
        assert_eq!(rounded(0.0), "0.000000");
    }
}
