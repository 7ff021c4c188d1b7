//! `guide effects`: what may be wrong with the plain model.

use super::output::Output;
use anyhow::ensure;
use formats::model_file::{expected_ids, has_neutral_value};
use mechanics::effects::{Effect, all};
use serde::Serialize;
use std::fmt::{self, Display};
use terminal_size::{Width, terminal_size_of};

/// List the effects that the model can have, with their parameters
#[derive(clap::Args)]
#[command(after_help = "Example:\n  guide effects\n  guide effects tissue.layers\n  guide effects --json")]
pub struct Args {
    /// Show this effect only, with ranges and priors of its parameters
    #[arg(value_name = "ID")]
    id: Option<String>,
}

#[derive(Serialize)]
struct Catalogue {
    schema: &'static str,
    effects: Vec<One>,
    /// Whether one was requested.
    #[serde(skip)]
    in_detail: bool,
}

#[derive(Serialize)]
struct One {
    id: &'static str,
    physics: &'static str,
    signature: &'static str,
    parameters: Vec<Parameter>,
}

#[derive(Serialize)]
struct Parameter {
    name: &'static str,
    unit: &'static str,
    /// Value at which the effect does nothing; none for a place or a time.
    neutral: Option<f64>,
    range: [f64; 2],
    likely: [f64; 2],
    prior_sd: f64,
    /// For a place or a time: values at which the effect is looked for.
    #[serde(skip_serializing_if = "<[f64]>::is_empty")]
    nodes: &'static [f64],
}

/// Runs the sub-command.
pub fn run(args: &Args, out: &mut Output) -> anyhow::Result<()> {
    let effects: Vec<One> = all()
        .into_iter()
        .filter(|effect| args.id.as_deref().is_none_or(|id| effect.id() == id))
        .map(One::new)
        .collect();
    if let Some(id) = &args.id {
        ensure!(!effects.is_empty(), "ID: \"{id}\" is not known, expected {}", expected_ids(id));
    }
    let catalogue = Catalogue { schema: "guide.effects/1", effects, in_detail: args.id.is_some() };
    out.result(&catalogue, wrapped(&catalogue.to_string(), width()))
}

/// Columns of the terminal that the text goes to; none where it goes elsewhere.
fn width() -> Option<usize> {
    let (Width(columns), _) = terminal_size_of(std::io::stdout())?;
    Some(usize::from(columns)).filter(|columns| *columns > 0)
}

/// Column at which the text of a line begins behind its label.
const INDENT: usize = 15;

/// A text whose lines fit a terminal: what is too long goes on below, behind the label.
fn wrapped(text: &str, width: Option<usize>) -> String {
    let Some(width) = width.filter(|width| *width > 2 * INDENT) else { return text.to_owned() };
    let mut wrapped_text = String::with_capacity(text.len() + text.len() / 8);
    for line in text.lines() {
        let mut column = 0;
        for word in line.split_inclusive(' ') {
            let length = word.trim_end().chars().count();
            if column + length > width && column > INDENT {
                wrapped_text.truncate(wrapped_text.trim_end_matches(' ').len());
                wrapped_text.push('\n');
                wrapped_text.push_str(&" ".repeat(INDENT));
                column = INDENT;
            }
            wrapped_text.push_str(word);
            column += word.chars().count();
        }
        wrapped_text.push('\n');
    }
    wrapped_text
}

impl One {
    fn new(effect: &dyn Effect) -> Self {
        Self {
            id: effect.id(),
            physics: effect.info().physics,
            signature: effect.info().signature,
            parameters: effect
                .parameters()
                .iter()
                .map(|info| Parameter {
                    name: info.name,
                    unit: unit(info.name),
                    neutral: has_neutral_value(info).then_some(info.neutral),
                    range: info.range,
                    likely: info.likely,
                    prior_sd: info.prior_sd,
                    nodes: info.nodes,
                })
                .collect(),
        }
    }
}

/// Units at the ends of names, longer ones before those they end with.
const UNITS: [(&str, &str); 15] = [
    ("_rad_per_n_m", "rad/(N m)"),
    ("_n_m_per_rad", "N m/rad"),
    ("n_s_per_mm", "N s/mm"),
    ("_mm_per_n", "mm/N"),
    ("_n_per_mm", "N/mm"),
    ("_n_per_s", "N/s"),
    ("_per_mm", "1/mm"),
    ("_per_m", "1/m"),
    ("_rad", "rad"),
    ("_mm", "mm"),
    ("_n", "N"),
    ("_s", "s"),
    ("_kpa", "kPa"),
    ("_deg", "deg"),
    ("_m", "m"),
];

/// Unit in a parameter's name; `1` for a ratio or a share.
fn unit(name: &str) -> &'static str {
    UNITS.iter().find(|(end, _)| name.ends_with(end)).map_or("1", |(_, unit)| unit)
}

impl Display for Catalogue {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for One { id, physics, signature, parameters } in &self.effects {
            writeln!(f, "{id}\n  physics      {physics}\n  signature    {signature}")?;
            for Parameter { name, unit, neutral, range: [least, most], likely, prior_sd, nodes } in parameters
            {
                let neutral = neutral.map_or("-".to_owned(), |neutral| neutral.to_string());
                writeln!(f, "  parameter    {name} ({unit}): neutral {neutral}, {least} to {most}")?;
                if self.in_detail {
                    let [low, high] = likely;
                    writeln!(f, "               likely {low} to {high}; as a nuisance sd {prior_sd}")?;
                    if !nodes.is_empty() {
                        let nodes: Vec<String> = nodes.iter().map(f64::to_string).collect();
                        writeln!(f, "               searched at {}", nodes.join(", "))?;
                    }
                }
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_fit_the_terminal_and_lose_no_word() {
        let text =
            "tissue.layers\n  physics      a modulus for each of several layers, from the surface on\n";
        let narrow = wrapped(text, Some(40));
        assert!(narrow.lines().all(|line| line.chars().count() <= 40), "{narrow}");
        assert_eq!(
            narrow.split_whitespace().collect::<Vec<_>>(),
            text.split_whitespace().collect::<Vec<_>>()
        );
        assert!(narrow.lines().nth(2).is_some_and(|line| line.starts_with(&" ".repeat(INDENT))), "{narrow}");
        assert_eq!(wrapped(text, None), text);
        assert_eq!(wrapped(text, Some(200)), text);
    }

    #[test]
    fn the_list_of_effects_fits_any_terminal() {
        for in_detail in [false, true] {
            let effects = all().into_iter().map(One::new).collect();
            let text = Catalogue { schema: "guide.effects/1", effects, in_detail }.to_string();
            // A word behind the label is longer than the rest of the narrowest line.
            let longest = text.split_whitespace().map(|word| word.chars().count()).max().unwrap_or(0);
            for width in [40, 61, 100, 157] {
                let lines = wrapped(&text, Some(width));
                let most = width.max(INDENT + longest);
                assert!(lines.lines().all(|line| line.chars().count() <= most), "{width}: {lines}");
                assert!(lines.split_whitespace().eq(text.split_whitespace()), "{width}");
            }
        }
    }
}
