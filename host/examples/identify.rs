//! Identifies the foundation modulus K from the lateral runs of a session, and shows what a model file changes in it.
//!
//! ```sh
//! guide init --example playground
//! cargo run -p host --example identify -- playground
//! guide diagnose playground --out model.toml
//! cargo run -p host --example identify -- playground model.toml
//! ```

use anyhow::Context;
use formats::model_file::ModelFile;
use formats::session::Session;
use inference::identify::{FoundationChoice, Identification, Options, identify};
use mechanics::Support;
use std::path::Path;

fn main() -> anyhow::Result<()> {
    let mut arguments = std::env::args_os().skip(1);
    let folder = arguments.next().context("expected a session folder and, if any, a model file")?;
    let session = Session::read(Path::new(&folder))?;

    let plain = identify(&session, &Options::default())?;
    print_modulus("no effects", &plain);

    let Some(path) = arguments.next() else { return Ok(()) };
    let model = ModelFile::read(Path::new(&path))?;
    // The support by the tissue is a part of the model: with another foundation its effects would have other values.
    let (foundation, poisson) = match model.support {
        Some(Support::Springs) => (Some(FoundationChoice::Springs), None),
        Some(Support::Body { poisson, .. }) => (Some(FoundationChoice::Body), Some(poisson)),
        None => (None, None),
    };
    for learned in &model.effects {
        for (parameter, value) in learned.effect.parameters().iter().zip(&learned.values) {
            println!("effect       {}: {} = {value:.3}", learned.effect.id(), parameter.name);
        }
    }
    let options = Options {
        fixed: model.effects(),
        discrepancy: model.discrepancy,
        foundation,
        poisson,
        ..Options::default()
    };
    let with_model = identify(&session, &options)?;
    print_modulus("model file", &with_model);
    Ok(())
}

/// Modulus with its interval, and what to consider before it is used.
fn print_modulus(name: &str, found: &Identification) {
    let pooled = &found.pooled;
    let [low_kpa, high_kpa] = pooled.ci95_kpa;
    println!(
        "{name:<12} K = {:.2} ({low_kpa:.2} to {high_kpa:.2}, 95 %) kPa from {} runs",
        pooled.k_kpa, pooled.runs
    );
    for warning in &found.warnings {
        println!("warning      {warning}");
    }
}
