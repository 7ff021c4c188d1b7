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
use inference::draws::DrawOptions;
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
    /// Draw residuals before and after, the ranking, the misfit, and the forces beside their predictions before and with the data as SVG files
    /// into this folder
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
    let known_id = ids.iter().find(|known| **known == id).copied();
    known_id.ok_or_else(|| format!("no such effect, expected one of {}", ids.join(", ")))
}

/// Runs the sub-command.
pub fn run(args: &Args, out: &mut Output) -> anyhow::Result<()> {
    let session = Session::read(&args.dir)?;
    let given_model = args.model.as_deref().map(ModelFile::read).transpose()?;
    let rig = args.rig.read(&args.dir)?.map(|(_, model)| model);
    let options = Options {
        given: given_model.as_ref().map(ModelFile::effects).unwrap_or_default(),
        known: Vec::new(),
        discrepancy: given_model.map(|file| file.discrepancy).unwrap_or_default(),
        seed: args.seed,
        discovery: !args.no_discovery,
        left_out: args.leave_out.clone(),
        draws: args.draws.options(args.seed).or(args.plots.as_ref().map(|_| DrawOptions::FIGURE)),
        plans: Vec::new(),
        foundation: args.tissue.foundation.unwrap_or_else(|| session.tissue.foundation.into()),
        poisson: args.tissue.poisson.or(session.tissue.poisson).unwrap_or(INCOMPRESSIBLE),
        reference: args.reference.as_deref().map(Session::read).transpose()?,
    }
    .with_rig(rig.as_ref());
    let progress = out.progress();
    if args.check {
        let checked = check(&session, &options, |step| progress.set_message(step.to_owned()));
        progress.finish_and_clear();
        let report = checked.with_context(|| format!("cannot check {}", args.dir.display()))?;
        return out.result(&report, CheckText(&report));
    }
    let diagnosed = diagnose(&session, &options, |step| progress.set_message(step.to_owned()));
    progress.finish_and_clear();
    let mut diagnosis = diagnosed.with_context(|| format!("cannot diagnose {}", args.dir.display()))?;
    if let Some(path) = &args.out {
        diagnosis.model().write(path)?;
        diagnosis.model_file = Some(path.display().to_string());
    }
    if let Some(folder) = out.figures_folder(args.plots.as_deref()) {
        if let Some(gap) = &diagnosis.gap {
            figures_file(folder, "residuals", &figures::residuals(gap)?, out)?;
            figures_file(folder, "gap", &figures::gap(gap)?, out)?;
        }
        figures_file(folder, "ranking", &figures::ranking(&diagnosis)?, out)?;
        if let Some(svg) = diagnosis.draws.as_ref().map(figures::predictive).transpose()?.flatten() {
            figures_file(folder, "predictive", &svg, out)?;
        }
    }
    if let Some(path) = &args.json_out {
        write_json(path, &diagnosis)?;
    }
    args.draws.write(diagnosis.draws.as_ref(), out)?;
    out.result(&diagnosis, Text(&diagnosis))
}

/// A diagnosis for the eye: one screen.
struct Text<'a>(&'a Diagnosis);

/// Regions shown.
const REGIONS: usize = 4;

impl Display for Text<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let diagnosis = self.0;
        for one in &diagnosis.moved_since {
            writeln!(f, "changed      {one}")?;
        }
        writeln!(f, "session      {}", diagnosis.split)?;
        let noise: Vec<String> = diagnosis.noise.iter().map(|(name, sd)| quantity(name, *sd)).collect();
        writeln!(f, "noise        {} (one standard deviation of a reading)", noise.join(", "))?;
        let tested = diagnosis.ranking.len() - diagnosis.not_identifiable.len().min(diagnosis.ranking.len());
        let not_identifiable = if diagnosis.not_identifiable.is_empty() {
            String::new()
        } else {
            format!("; not identifiable from these runs: {}", diagnosis.not_identifiable.join(", "))
        };
        let model_note = if diagnosis.given.is_empty() {
            String::new()
        } else {
            format!(" beside {} in the model", diagnosis.given.join(", "))
        };
        writeln!(f, "tested       {tested} effects{model_note}{not_identifiable}")?;
        for (number, region) in diagnosis.regions.iter().take(REGIONS).enumerate() {
            let name = if number == 0 { "where" } else { "" };
            writeln!(f, "{name:<13}{region}")?;
        }
        if diagnosis.regions.is_empty() {
            writeln!(f, "where        no region has significant residuals")?;
        }
        writeln!(f, "verdict      {}", diagnosis.verdict.explained())?;
        for effect in &diagnosis.effects {
            write_effect(f, effect)?;
        }
        if !diagnosis.partial.is_empty() {
            writeln!(
                f,
                "partial      {}: better by evidence, but leaves more than noise, or the larger part of the misfit, or does not improve held-out runs: a description and no name",
                diagnosis.partial.join(", ")
            )?;
        }
        if !diagnosis.effects.is_empty() {
            for (number, region) in diagnosis.left.iter().take(REGIONS).enumerate() {
                let name = if number == 0 { "left" } else { "" };
                writeln!(f, "{name:<13}{region}")?;
            }
        }
        write_remaining(f, diagnosis)?;
        write_foundation(f, diagnosis)?;
        write_reference(f, diagnosis)?;
        write!(
            f,
            "model        K {}",
            diagnosis.k_status.modulus_text(diagnosis.k_kpa, diagnosis.k_ci95_kpa)
        )?;
        if let (Some(load_n), Some([low, high])) = (diagnosis.tip_load_n, diagnosis.tip_load_ci95_n) {
            write!(f, ", tip load {load_n:.3} N ({low:.3} to {high:.3})")?;
        }
        writeln!(f)?;
        if let Some(MeanModulus { to_depth_mm, modulus_kpa: Estimate { value, ci95: [low, high] } }) =
            diagnosis
                .mean_modulus
                .filter(|_| diagnosis.effects.iter().any(|effect| effect.id.starts_with("tissue.")))
        {
            writeln!(
                f,
                "             mean modulus down to {to_depth_mm:.0} mm {value:.2} kPa ({low:.2} to {high:.2})"
            )?;
        }
        if let Some(gap) = &diagnosis.gap {
            write_gap(f, gap)?;
        }
        if let Some(next) = &diagnosis.next_measurement {
            writeln!(
                f,
                "next         {}: distinguishes {} (chi-square {:.0} expected)",
                next.what,
                next.separates.join(" and "),
                next.expected_divergence
            )?;
        }
        for limit in &diagnosis.limits {
            writeln!(f, "limit        {limit}")?;
        }
        for warning in &diagnosis.warnings {
            writeln!(f, "note         {warning}")?;
        }
        match &diagnosis.model_file {
            Some(path) => writeln!(f, "written      {path}"),
            None => Ok(()),
        }
    }
}

/// Remaining misfit, whether it matters, and imperfections that are larger than usual.
fn write_remaining(f: &mut fmt::Formatter<'_>, found: &Diagnosis) -> fmt::Result {
    let remaining = &found.remaining;
    let size = match remaining.size {
        RemainingSize::WithinNoise => "within noise",
        RemainingSize::Small => {
            "small: K changes by less than its interval, or than usual imperfections move it"
        }
        RemainingSize::Large => {
            "large: where it is not allowed for, K moves by more than its interval and than usual imperfections move it"
        }
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

/// Foundation of the tissue, and the result of the other one.
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

/// Differences of the session from its reference.
fn write_reference(f: &mut fmt::Formatter<'_>, found: &Diagnosis) -> fmt::Result {
    let Some(reference) = &found.reference else { return Ok(()) };
    let name = reference.session.as_deref().unwrap_or("without a name");
    let ([lowest_kpa, highest_kpa], [low, high]) = (reference.modulus_kpa.ci95, reference.modulus_ratio.ci95);
    writeln!(
        f,
        "reference    {name}: modulus {:.2} kPa ({lowest_kpa:.2} to {highest_kpa:.2}); this session has {:.3} times that ({low:.3} to {high:.3})",
        reference.modulus_kpa.value, reference.modulus_ratio.value
    )
}

fn write_effect(f: &mut fmt::Formatter<'_>, found: &FoundEffect) -> fmt::Result {
    writeln!(
        f,
        "missing      {}: {}; log evidence {:+.1}, {}",
        found.id,
        found.parameters_in_words(),
        found.log_evidence_gain,
        found.probability_in_words()
    )?;
    if let Some(effect) = effect(&found.id) {
        writeln!(f, "             {}", effect.info().physics)?;
    }
    let competitors = found.competing_effects();
    if !competitors.is_empty() {
        writeln!(f, "             or {}", competitors.join(", or "))?;
    }
    Ok(())
}

fn write_gap(f: &mut fmt::Formatter<'_>, gap: &HeldOutMisfit) -> fmt::Result {
    write!(f, "held out     chi-square per reading {:.2}", gap.before.chi2_reduced)?;
    if (gap.before.chi2_reduced - gap.after.chi2_reduced).abs() > 1e-9 {
        write!(f, " before, {:.2} after", gap.after.chi2_reduced)?;
    }
    if let (Some(removed), Some([low, high])) = (gap.removed, gap.removed_ci95) {
        fn percent(share: f64) -> f64 {
            100.0 * share
        }
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
        let rmse_after = gap.after.rmse.get(name).copied().unwrap_or(f64::NAN);
        if (before - rmse_after).abs() > 1e-9 {
            let unit = unit(name);
            writeln!(
                f,
                "             {}: {before:.3} {unit} before, {rmse_after:.3} {unit} after",
                channel(name)
            )?;
        }
    }
    Ok(())
}
