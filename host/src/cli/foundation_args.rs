//! Foundation of the tissue: the same options wherever a modulus is estimated.

use clap::builder::{PossibleValuesParser, TypedValueParser};
use inference::diagnose::FoundationChoice;

/// Springs or a body, and how compressible.
#[derive(clap::Args)]
pub struct FoundationArgs {
    /// Model of the tissue: independent springs, an elastic body, or the one that the evidence of the runs favours (default: as the session
    /// states, or auto)
    #[arg(long, value_parser = foundation())]
    pub foundation: Option<FoundationChoice>,
    /// Poisson's ratio of the tissue, 0 to 0.5 (default: the session's, or 0.5)
    #[arg(long, value_name = "RATIO", value_parser = poisson)]
    pub poisson: Option<f64>,
}

fn foundation() -> impl TypedValueParser<Value = FoundationChoice> {
    PossibleValuesParser::new(FoundationChoice::ALL.map(FoundationChoice::name)).map(|name| {
        // The parser before lets nothing else pass.
        FoundationChoice::ALL.into_iter().find(|choice| choice.name() == name).unwrap_or_default()
    })
}

fn poisson(text: &str) -> Result<f64, String> {
    within(text, 0.5)
}

/// A number from 0 to a largest one.
///
/// # Errors
/// What is expected.
pub fn within(text: &str, most: f64) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| format!("expected a number from 0 to {most}"))?;
    if (0.0..=most).contains(&value) { Ok(value) } else { Err(format!("expected 0 to {most}")) }
}
