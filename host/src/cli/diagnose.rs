//! `guide diagnose`: where model and measurement disagree, what is missing, and what adding it is worth.

use super::characterized::CharacterizedArgs;
use super::diagnose_check::CheckText;
use super::draws_args::DrawsArgs;
use super::foundation_args::FoundationArgs;
use super::output::{Output, figures_file, write_json};
use crate::figures;
use anyhow::Context;
use formats::model_file::ModelFile;
use formats::session::Session;
use inference::diagnose::display::{channel, quantity, unit};
use inference::diagnose::{
    Diagnosis, Estimate, FoundEffect, HeldOutMisfit, INCOMPRESSIBLE, MeanModulus, Options, RemainingSize,
    check, diagnose,
};
use inference::walls::WallsResult;
use mechanics::effects::{Effect, all, effect};
use std::fmt::{self, Display};
use std::path::PathBuf;

/// Find where model and measurement disagree, name the missing effect, add it to the model and report how far the
/// misfit shrinks
#[derive(clap::Args)]
#[command(
    after_help = "Example:\n  guide diagnose phantom-a\n  guide diagnose phantom-a --out model.toml --plots figures\n  \
                  guide diagnose phantom-a --model model.toml\n  guide diagnose phantom-a-repaired --reference phantom-a\n  guide diagnose phantom-a --check"
)]
pub struct Args {
    /// Session folder (holds session.toml)
    dir: PathBuf,
    /// Start from the model of an earlier diagnosis: its effects are in the model from the beginning
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    #[command(flatten)]
    rig: CharacterizedArgs,
    /// Compare with this session: rig, tissue and the misfit that both have in common are taken from it; only a changed modulus and
    /// effects absent from it can be found
    #[arg(long, value_name = "DIR")]
    reference: Option<PathBuf>,
    /// Write the model with what was added to this file
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Draw residuals before and after, the ranking and the misfit as SVG files into this folder
    #[arg(long, value_name = "FOLDER")]
    plots: Option<PathBuf>,
    /// Write the result as JSON to this file: the document that --json prints, beside the text
    #[arg(long, value_name = "FILE")]
    json_out: Option<PathBuf>,
    /// Search for nothing: print for every effect the size from which on these runs would name it with 90 % probability
    #[arg(long, conflicts_with_all = ["reference", "out", "plots", "json_out", "draws"])]
    check: bool,
    #[command(flatten)]
    tissue: FoundationArgs,
    /// Name effects of the catalogue only; search for no laws
    #[arg(long)]
    no_discovery: bool,
    /// Search as if nobody knew this effect: what is then found is a law, or nothing
    #[arg(long, value_name = "EFFECT", value_parser = catalogued)]
    leave_out: Vec<&'static str>,
    /// Seed of the bootstraps, and of the draws of --draws
    #[arg(long, default_value_t = 1)]
    seed: u64,
    #[command(flatten)]
    draws: DrawsArgs,
}

/// The id of an effect of the catalogue.
fn catalogued(id: &str) -> Result<&'static str, String> {
    let ids: Vec<&'static str> = all().into_iter().map(Effect::id).collect();
    let known = ids.iter().find(|known| **known == id).copied();
    known.ok_or_else(|| format!("no such effect, expected one of {}", ids.join(", ")))
}

/// Runs the sub-command.
pub fn run(args: &Args, out: &mut Output) -> anyhow::Result<()> {
    let session = Session::read(&args.dir)?;
    let given = args.model.as_deref().map(ModelFile::read).transpose()?;
    let rig = args.rig.read(&args.dir)?.map(|(_, model)| model);
    let options = Options {
        given: given.as_ref().map(ModelFile::effects).unwrap_or_default(),
        known: Vec::new(),
        discrepancy: given.map(|file| file.discrepancy).unwrap_or_default(),
        seed: args.seed,
        discovery: !args.no_discovery,
        left_out: args.leave_out.clone(),
        draws: args.draws.options(args.seed),
        plans: Vec::new(),
        foundation: args.tissue.foundation.unwrap_or_else(|| session.tissue.foundation.into()),
        poisson: args.tissue.poisson.or(session.tissue.poisson).unwrap_or(INCOMPRESSIBLE),
        reference: args.reference.as_deref().map(Session::read).transpose()?,
    }
    .with_rig(rig.as_ref());
    let progress = out.progress();
    if args.check {
        let found = check(&session, &options, |step| progress.set_message(step.to_owned()));
        progress.finish_and_clear();
        let found = found.with_context(|| format!("cannot check {}", args.dir.display()))?;
        return out.result(&found, CheckText(&found));
    }
    let found = diagnose(&session, &options, |step| progress.set_message(step.to_owned()));
    progress.finish_and_clear();
    let mut found = found.with_context(|| format!("cannot diagnose {}", args.dir.display()))?;
    if let Some(path) = &args.out {
        found.model().write(path)?;
        found.model_file = Some(path.display().to_string());
    }
    if let Some(folder) = out.figures_folder(args.plots.as_deref()) {
        if let Some(gap) = &found.gap {
            figures_file(folder, "residuals", &figures::residuals(gap)?, out)?;
            figures_file(folder, "gap", &figures::gap(gap)?, out)?;
        }
        figures_file(folder, "ranking", &figures::ranking(&found)?, out)?;
    }
    if let Some(path) = &args.json_out {
        write_json(path, &found)?;
    }
    args.draws.write(found.draws.as_ref(), out)?;
    out.result(&found, Text(&found))
}

/// A diagnosis for the eye: one screen.
struct Text<'a>(&'a Diagnosis);

/// Regions shown.
const REGIONS: usize = 4;

impl Display for Text<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let found = self.0;
        for one in &found.moved_since {
            writeln!(f, "changed      {one}")?;
        }
        writeln!(f, "session      {}", found.split)?;
        let noise: Vec<String> = found.noise.iter().map(|(name, sd)| quantity(name, *sd)).collect();
        writeln!(f, "noise        {} (one standard deviation of a reading)", noise.join(", "))?;
        let tested = found.ranking.len() - found.not_identifiable.len().min(found.ranking.len());
        let not_identifiable = if found.not_identifiable.is_empty() {
            String::new()
        } else {
            format!("; not identifiable from these runs: {}", found.not_identifiable.join(", "))
        };
        let given = if found.given.is_empty() {
            String::new()
        } else {
            format!(" beside {} in the model", found.given.join(", "))
        };
        writeln!(f, "tested       {tested} effects{given}{not_identifiable}")?;
        for (number, region) in found.regions.iter().take(REGIONS).enumerate() {
            let name = if number == 0 { "where" } else { "" };
            writeln!(f, "{name:<13}{region}")?;
        }
        if found.regions.is_empty() {
            writeln!(f, "where        no region has significant residuals")?;
        }
        writeln!(f, "verdict      {}", found.verdict.explained())?;
        for effect in &found.effects {
            write_effect(f, effect)?;
        }
        if !found.partial.is_empty() {
            writeln!(
                f,
                "partial      {}: better by evidence, but leaves more than noise, or the larger part of the misfit, or does not improve held-out runs: a description and no name",
                found.partial.join(", ")
            )?;
        }
        if !found.effects.is_empty() {
            for (number, region) in found.left.iter().take(REGIONS).enumerate() {
                let name = if number == 0 { "left" } else { "" };
                writeln!(f, "{name:<13}{region}")?;
            }
        }
        write_remaining(f, found)?;
        write_foundation(f, found)?;
        write_reference(f, found)?;
        write!(f, "model        K {}", found.k_status.modulus_text(found.k_kpa, found.k_ci95_kpa))?;
        if let (Some(load_n), Some([low, high])) = (found.tip_load_n, found.tip_load_ci95_n) {
            write!(f, ", tip load {load_n:.3} N ({low:.3} to {high:.3})")?;
        }
        writeln!(f)?;
        if let Some(MeanModulus { to_depth_mm, modulus_kpa: Estimate { value, ci95: [low, high] } }) =
            found.mean_modulus.filter(|_| found.effects.iter().any(|effect| effect.id.starts_with("tissue.")))
        {
            writeln!(
                f,
                "             mean modulus down to {to_depth_mm:.0} mm {value:.2} kPa ({low:.2} to {high:.2})"
            )?;
        }
        if let Some(gap) = &found.gap {
            write_gap(f, gap)?;
        }
        if let Some(next) = &found.next_measurement {
            writeln!(
                f,
                "next         {}: distinguishes {} (chi-square {:.0} expected)",
                next.what,
                next.separates.join(" and "),
                next.expected_divergence
            )?;
        }
        for limit in &found.limits {
            writeln!(f, "limit        {limit}")?;
        }
        for warning in &found.warnings {
            writeln!(f, "note         {warning}")?;
        }
        match &found.model_file {
            Some(path) => writeln!(f, "written      {path}"),
            None => Ok(()),
        }
    }
}

/// How much remains, whether it matters, and which imperfections are larger than usual.
fn write_remaining(f: &mut fmt::Formatter<'_>, found: &Diagnosis) -> fmt::Result {
    let remaining = &found.remaining;
    let size = match remaining.size {
        RemainingSize::WithinNoise => "within noise",
        RemainingSize::Small => "small: K changes by less than its interval",
        RemainingSize::Large => "large: K moves by more than its interval where it is not allowed for",
    };
    let rms: Vec<String> = remaining.rms.iter().map(|(name, rms)| quantity(name, *rms)).collect();
    writeln!(f, "remaining    {size}; smooth misfit (RMS) {}", rms.join(", "))?;
    if !remaining.above_everyday.is_empty() {
        let times: Vec<String> = remaining
            .above_everyday
            .iter()
            .map(|(name, times)| format!("{name} ({times:.1} times)"))
            .collect();
        writeln!(f, "             more than in an ordinary rig: {}", times.join(", "))?;
    }
    Ok(())
}

/// What the tissue was taken for, and what the other foundation gives.
fn write_foundation(f: &mut fmt::Formatter<'_>, found: &Diagnosis) -> fmt::Result {
    let foundation = &found.foundation;
    let Some(gain) = foundation.log_evidence_of_body else { return Ok(()) };
    if let Some(line) = found.walls.as_ref().and_then(WallsResult::line) {
        writeln!(f, "walls        {line}")?;
    }
    match (foundation.youngs_modulus_kpa, foundation.youngs_modulus_of_plain_body_kpa) {
        (Some(e), _) => {
            writeln!(f, "tissue       an elastic body: E {}", found.k_status.modulus_text(e.value, e.ci95))?;
        }
        (None, Some(e)) => {
            let youngs = found.k_status.modulus_text(e.value, e.ci95);
            writeln!(f, "tissue       springs; as an elastic body E {youngs}")?;
        }
        (None, None) => {}
    }
    writeln!(f, "             log evidence of a body over springs, without effects: {gain:+.1}")
}

/// How the session differs from its reference.
fn write_reference(f: &mut fmt::Formatter<'_>, found: &Diagnosis) -> fmt::Result {
    let Some(reference) = &found.reference else { return Ok(()) };
    let name = reference.session.as_deref().unwrap_or("without a name");
    let ([from, to], [low, high]) = (reference.modulus_kpa.ci95, reference.modulus_ratio.ci95);
    writeln!(
        f,
        "reference    {name}: modulus {:.2} kPa ({from:.2} to {to:.2}); this session has {:.3} times that ({low:.3} to {high:.3})",
        reference.modulus_kpa.value, reference.modulus_ratio.value
    )
}

fn write_effect(f: &mut fmt::Formatter<'_>, found: &FoundEffect) -> fmt::Result {
    writeln!(
        f,
        "missing      {}: {}; log evidence +{:.1}, {}",
        found.id,
        found.parameters_in_words(),
        found.log_evidence_gain,
        found.probability_in_words()
    )?;
    if let Some(effect) = effect(&found.id) {
        writeln!(f, "             {}", effect.info().physics)?;
    }
    let others = found.competing_effects();
    if !others.is_empty() {
        writeln!(f, "             or {}", others.join(", or "))?;
    }
    Ok(())
}

fn write_gap(f: &mut fmt::Formatter<'_>, gap: &HeldOutMisfit) -> fmt::Result {
    write!(f, "held out     chi-square per reading {:.2}", gap.before.chi2_reduced)?;
    if (gap.before.chi2_reduced - gap.after.chi2_reduced).abs() > 1e-9 {
        write!(f, " before, {:.2} after", gap.after.chi2_reduced)?;
    }
    if let (Some(removed), Some([low, high])) = (gap.removed, gap.removed_ci95) {
        let percent = |share: f64| 100.0 * share;
        write!(
            f,
            ": {:.0} % of the removable misfit removed ({:.0} to {:.0})",
            percent(removed),
            percent(low),
            percent(high)
        )?;
    }
    writeln!(f)?;
    for (name, before) in &gap.before.rmse {
        let after = gap.after.rmse.get(name).copied().unwrap_or(f64::NAN);
        if (before - after).abs() > 1e-9 {
            let unit = unit(name);
            writeln!(
                f,
                "             {}: {before:.3} {unit} before, {after:.3} {unit} after",
                channel(name)
            )?;
        }
    }
    Ok(())
}
