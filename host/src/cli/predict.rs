//! `guide predict`: tip load from the first part of each insertion, path with its band for the rest.

use super::characterized::CharacterizedArgs;
use super::draws_args::DrawsArgs;
use super::identify::modulus_prior;
use super::output::{Output, figures_file};
use crate::figures;
use anyhow::{Context, ensure};
use formats::model_file::ModelFile;
use formats::session::Session;
use inference::predict::{InsertionResult, ModelResult, Options, Prediction, PredictionPrior, predict};
use mechanics::effects::{Effect, all, effect};
use std::fmt::{self, Display};
use std::path::{Path, PathBuf};

/// Identify the tip load from the first part of each insertion and predict the path of the rest
#[derive(clap::Args)]
#[command(
    after_help = "Example:\n  guide predict phantom-a\n  guide predict phantom-a --until 70 --compare\n  guide predict phantom-a \
                        --json > predicted.json\n  guide predict phantom-a --model model.toml"
)]
pub struct Args {
    /// Session folder (holds session.toml)
    dir: PathBuf,
    /// Depth up to which readings of each insertion are used, millimetres
    #[arg(long, default_value_t = 50.0, value_name = "MM")]
    until: f64,
    /// Depth to which it is predicted, millimetres (default: its last recorded depth)
    #[arg(long, value_name = "MM")]
    to: Option<f64>,
    /// Foundation modulus and its standard deviation, kilopascals, instead of the estimate from the lateral runs
    #[arg(long, num_args = 2, value_names = ["K", "SD"])]
    k_kpa: Option<Vec<f64>>,
    /// Take two layers from the lateral runs
    #[arg(long)]
    layers: bool,
    /// Take an effect into the model, with the values of its parameters: may be given more than once
    #[arg(long, value_name = "EFFECT=VALUE[,VALUE]", value_parser = effect_values)]
    effect: Vec<(&'static dyn Effect, Vec<f64>)>,
    /// Take the effects of a model file (model.toml) into the model, and its modulus where the session has no lateral runs and
    /// --k-kpa is not given; an --effect replaces that of the file
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    #[command(flatten)]
    rig: CharacterizedArgs,
    /// Use the prior of K from many sessions (prior.toml of `guide population --out`), and also report the prediction without it
    #[arg(long, value_name = "FILE", conflicts_with_all = ["k_kpa", "layers"])]
    prior: Option<PathBuf>,
    /// Predict each insertion by itself, without learning from the others of the session
    #[arg(long)]
    alone: bool,
    /// Compare with polynomials, the bicycle model, the mean of the other insertions and the published method on
    /// the same data
    #[arg(long)]
    compare: bool,
    /// Seed of the draws of --draws
    #[arg(long, default_value_t = 1)]
    seed: u64,
    #[command(flatten)]
    draws: DrawsArgs,
    /// Draw each insertion (path with band, tip load) as an SVG file into this folder
    #[arg(long, value_name = "FOLDER")]
    plots: Option<PathBuf>,
}

/// `tissue.gradient=0.01`: as many values as the effect has parameters, each in its range.
fn effect_values(text: &str) -> Result<(&'static dyn Effect, Vec<f64>), String> {
    let (id, values) = text.split_once('=').ok_or("expected EFFECT=VALUE[,VALUE]")?;
    let effect = effect(id).ok_or_else(|| format!("no such effect, expected one of {}", ids()))?;
    let values: Result<Vec<f64>, _> = values.split(',').map(|value| value.trim().parse()).collect();
    let values = values.map_err(|_| "expected numbers after =")?;
    let expected = effect.parameters();
    if values.len() != expected.len() {
        return Err(format!("expected {} values: {}", expected.len(), names(expected)));
    }
    for (value, parameter) in values.iter().zip(expected) {
        let [least, most] = parameter.range;
        if !(least..=most).contains(value) {
            return Err(format!("{}: {value}, expected {least} to {most}", parameter.name));
        }
    }
    Ok((effect, values))
}

fn names(expected: &[mechanics::effects::ParameterInfo]) -> String {
    expected.iter().map(|parameter| parameter.name).collect::<Vec<_>>().join(", ")
}

fn ids() -> String {
    all().into_iter().map(Effect::id).collect::<Vec<_>>().join(", ")
}

/// Runs the sub-command.
pub fn run(args: &Args, out: &mut Output) -> anyhow::Result<()> {
    check_range_mm("--until", args.until, [5.0, 500.0])?;
    if let Some(end_mm) = args.to {
        check_range_mm("--to", end_mm, [1.0, 500.0])?;
    }
    let modulus_pa = match args.k_kpa.as_deref() {
        Some(&[k_kpa, sd_kpa]) => {
            ensure!(
                k_kpa > 0.0 && k_kpa <= 1e4 && sd_kpa >= 0.0 && sd_kpa <= k_kpa,
                "--k-kpa: {k_kpa} {sd_kpa}, expected a modulus above 0 and a standard deviation of 0 up to the modulus"
            );
            Some([1e3 * k_kpa, 1e3 * sd_kpa])
        }
        _ => None,
    };
    let model = args.model.as_deref().map(ModelFile::read).transpose()?.unwrap_or_default();
    let session = Session::read(&args.dir)?;
    let rig = args.rig.read(&args.dir)?.map(|(_, model)| model);
    let stated = Options { effects: args.effect.clone(), modulus_pa, ..Options::default() };
    let options = stated.with_model(&model, session.lateral.is_empty()).with_rig(rig.as_ref());
    ensure!(
        !args.layers || options.effects.iter().all(|(effect, _)| effect.id() != "tissue.layers"),
        "--layers: tissue.layers is in the model already, expected a model without"
    );
    let options = Options {
        until_m: 1e-3 * args.until,
        to_m: args.to.map(|to| 1e-3 * to),
        learn: !args.alone,
        layers: args.layers,
        draws: args.draws.options(args.seed),
        prior: args.prior.as_deref().map(|path| modulus_prior(path, &args.dir)).transpose()?,
        ..options
    };
    let result =
        predict(&session, &options).with_context(|| format!("cannot predict {}", args.dir.display()))?;
    ensure_within_readings(args, &result)?;
    if let Some(folder) = out.figures_folder(args.plots.as_deref()) {
        draw(&result, folder, out)?;
    }
    args.draws.write(result.draws.as_ref(), out)?;
    out.result(&result, Text { result: &result, compare: args.compare })
}

fn check_range_mm(name: &str, value: f64, [least, most]: [f64; 2]) -> anyhow::Result<()> {
    ensure!((least..=most).contains(&value), "{name}: {value}, expected {least} to {most} mm");
    Ok(())
}

/// Metres that were millimetres are not whole ones to the last digit.
const ROUNDING_MM: f64 = 1e-6;

/// Checks that something is left to predict, where no depth is stated to which it is predicted: an insertion is observed no further than
/// its deepest reading. Depths are stated to the millimetre.
fn ensure_within_readings(args: &Args, result: &Prediction) -> anyhow::Result<()> {
    let predicted = result.insertions.iter().filter(|one| one.error.is_none());
    let deepest_mm = predicted.map(|one| one.identified_until_mm).fold(0.0, f64::max);
    let most_mm = (deepest_mm - ROUNDING_MM).ceil();
    ensure!(
        args.to.is_some() || args.until <= most_mm,
        "--until: {}, expected at most {most_mm} mm, the depth of the deepest reading, or also --to with the depth to which it is predicted",
        args.until
    );
    Ok(())
}

/// Depths up to which the insertions were measured.
fn depths_text(insertions: &[&InsertionResult]) -> String {
    let depths_mm = || insertions.iter().map(|one| one.identified_until_mm.round());
    let least_mm = depths_mm().fold(f64::INFINITY, f64::min);
    let most_mm = depths_mm().fold(0.0, f64::max);
    if least_mm < most_mm { format!("{least_mm:.0} to {most_mm:.0}") } else { format!("{most_mm:.0}") }
}

/// Draws every insertion and reports the paths.
fn draw(result: &Prediction, folder: &Path, out: &Output) -> anyhow::Result<()> {
    for insertion in result.insertions.iter().filter(|insertion| insertion.error.is_none()) {
        let svg = figures::insertion(insertion)?;
        figures_file(folder, &format!("{}.path", insertion.id), &svg, out)?;
    }
    Ok(())
}

/// A prediction for the eye.
struct Text<'a> {
    result: &'a Prediction,
    compare: bool,
}

impl Display for Text<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let good: Vec<_> = self.result.insertions.iter().filter(|one| one.error.is_none()).collect();
        writeln!(
            f,
            "tip measured to {} mm, predicted beyond (95 % band); tip load at that depth, before any rotation",
            depths_text(&good)
        )?;
        let width = good.iter().map(|one| one.id.chars().count()).fold(9, usize::max);
        writeln!(
            f,
            "  {:<width$}  plane  tip load            at depth  predicted                  measured    error",
            "insertion"
        )?;
        for insertion in &good {
            write_insertion(f, insertion, width)?;
        }
        write_learned(f, &good, width)?;
        write_models(f, &self.result.models)?;
        if let Some(prior) = &self.result.prior {
            write_prior(f, prior, width)?;
        }
        if let Some(k_per_ei) = good.first().and_then(|one| one.learned.as_ref()?.k_per_ei.as_ref()) {
            let [low, high] = k_per_ei.ci95_per_m4;
            writeln!(
                f,
                "K/(E I)      {:.3e} ({low:.3e} to {high:.3e}) 1/m^4; K is for E I = {:.4} N m^2",
                k_per_ei.k_per_ei_per_m4, k_per_ei.reference_ei_n_m2
            )?;
        }
        if self.compare {
            write_comparison(f, &good)?;
        }
        for message in self.result.messages() {
            writeln!(f, "note         {message}")?;
        }
        Ok(())
    }
}

fn write_insertion(f: &mut fmt::Formatter<'_>, one: &InsertionResult, width: usize) -> fmt::Result {
    // Depth at which the prediction was last checked, or its end.
    let index = one.last_measured_mm.map_or(one.depth_mm.len().saturating_sub(1), |mm| mm.round() as usize);
    let plane = |f: &mut fmt::Formatter<'_>,
                 id: &str,
                 name: &str,
                 force: String,
                 tip: [f64; 3],
                 measured: Option<f64>| {
        let [rounded, low, high] = tip.map(|mm| unsigned_zero(mm, 2));
        let predicted = format!("{rounded:.2} ({low:.2} to {high:.2}) mm");
        let (measured, error) = match measured {
            Some(value) => (
                format!("{:.2} mm", unsigned_zero(value, 2)),
                format!("{:+.2} mm", unsigned_zero(tip[0] - value, 2)),
            ),
            None => ("-".to_owned(), "-".to_owned()),
        };
        writeln!(
            f,
            "  {id:<width$}  {name}      {force:<18}  {index:>5} mm  {predicted:<25}  {measured:<10}  {error}"
        )
    };
    let tip =
        [value_at(&one.tip_y_mm, index), value_at(&one.lo95_y_mm, index), value_at(&one.hi95_y_mm, index)];
    plane(
        f,
        &one.id,
        "y",
        force_text(one.tip_force_n, one.tip_force_sd_n),
        tip,
        reading_at(&one.measured_y_mm, index),
    )?;
    if let (Some(tip_x), Some(low), Some(high)) = (&one.tip_x_mm, &one.lo95_x_mm, &one.hi95_x_mm) {
        let tip = [value_at(tip_x, index), value_at(low, index), value_at(high, index)];
        let measured = one.measured_x_mm.as_deref().and_then(|list| reading_at(list, index));
        plane(f, "", "x", force_text(one.tip_force_x_n, one.tip_force_x_sd_n), tip, measured)?;
    }
    Ok(())
}

fn reading_at(list: &[Option<f64>], index: usize) -> Option<f64> {
    list.get(index).copied().flatten()
}

fn value_at(list: &[f64], index: usize) -> f64 {
    list.get(index).copied().unwrap_or(f64::NAN)
}

fn force_text(n: Option<f64>, sd: Option<f64>) -> String {
    match (n, sd) {
        (Some(n), Some(sd)) => format!("{:+.3} (sd {sd:.3}) N", unsigned_zero(n, 3)),
        _ => "-".to_owned(),
    }
}

/// A value without the sign that it would be printed with where it is rounded to nothing.
fn unsigned_zero(value: f64, decimals: i32) -> f64 {
    if value.abs() < 0.5 * 10f64.powi(-decimals) { 0.0 } else { value }
}

/// Modulus and gap of every insertion.
fn write_learned(f: &mut fmt::Formatter<'_>, good: &[&InsertionResult], width: usize) -> fmt::Result {
    let learned: Vec<_> = good.iter().filter_map(|one| Some((&one.id, one.learned.as_ref()?))).collect();
    if learned.is_empty() {
        return Ok(());
    }
    writeln!(
        f,
        "rig and tissue of each insertion (95 % interval; each of tip load, K, gap and path marginalised over the others)"
    )?;
    let has_rear = learned.iter().any(|(_, learned)| learned.rear_text().is_some());
    let rear = if has_rear { "            rotation stiffness of the rear, y and x" } else { "" };
    writeln!(f, "  {:<width$}  K                              effective gap{rear}", "insertion")?;
    for (id, learned) in learned {
        let (modulus, gap) = (learned.modulus_text(), learned.gap_text());
        match learned.rear_text() {
            Some(rear) => writeln!(f, "  {id:<width$}  {modulus:<29}  {gap:<23}  {rear}")?,
            None => writeln!(f, "  {id:<width$}  {modulus:<29}  {gap}")?,
        }
    }
    Ok(())
}

/// The models that all values are averaged over.
fn write_models(f: &mut fmt::Formatter<'_>, models: &[ModelResult]) -> fmt::Result {
    if models.is_empty() {
        return Ok(());
    }
    let list: Vec<String> =
        models.iter().map(|one| format!("{} {:.0} %", model_name(one), 100.0 * one.probability)).collect();
    writeln!(f, "effects      averaged over models by their probability: {}", list.join(", "))
}

fn model_name(one: &ModelResult) -> String {
    match one.effects.as_slice() {
        [] => "none".to_owned(),
        effects => effects.join(" with "),
    }
}

/// The prior, and what is predicted without it.
fn write_prior(f: &mut fmt::Formatter<'_>, prior: &PredictionPrior, width: usize) -> fmt::Result {
    for (number, line) in prior.modulus.lines().iter().enumerate() {
        writeln!(f, "{:<13}{line}", if number == 0 { "prior" } else { "" })?;
    }
    if !prior.modulus.used {
        return Ok(());
    }
    writeln!(f, "without the prior")?;
    writeln!(
        f,
        "  {:<width$}  K                       tip at the last depth, vertical   error",
        "insertion"
    )?;
    for one in &prior.without {
        let modulus = with_interval(one.k_kpa, one.k_ci95_kpa, "kPa");
        let tip = with_interval(one.tip_y_mm, one.band95_y_mm, "mm");
        let error = one.last_error_mm.map_or("-".to_owned(), |mm| format!("{mm:.2} mm"));
        writeln!(f, "  {:<width$}  {modulus:<22}  {tip:<32}  {error}", one.id)?;
    }
    Ok(())
}

fn with_interval(value: Option<f64>, ends: Option<[f64; 2]>, unit: &str) -> String {
    match (value, ends) {
        (Some(value), Some([low, high])) => {
            let [value, low, high] = [value, low, high].map(|number| unsigned_zero(number, 2));
            format!("{value:.2} ({low:.2} to {high:.2}) {unit}")
        }
        _ => "-".to_owned(),
    }
}

/// Mean over the insertions of each method's error.
fn write_comparison(f: &mut fmt::Formatter<'_>, good: &[&InsertionResult]) -> fmt::Result {
    writeln!(f, "distance from the measured tip, mean over the insertions")?;
    writeln!(f, "  method            mean beyond the readings    at the last depth")?;
    let of =
        |value: fn(&InsertionResult) -> Option<f64>| mean_text(good.iter().map(|one| value(one)).collect());
    write_line(f, "mechanics", of(|one| one.mae_mm), of(|one| one.last_error_mm))?;
    let methods: Vec<_> =
        good.first().map(|one| one.compare.iter().map(|c| c.method)).into_iter().flatten().collect();
    for method in methods {
        let found = || good.iter().map(|one| one.compare.iter().find(|c| c.method == method));
        let mae = mean_text(found().map(|c| c.and_then(|c| c.mae_mm)).collect());
        let last = mean_text(found().map(|c| c.and_then(|c| c.last_error_mm)).collect());
        write_line(f, method, mae, last)?;
    }
    Ok(())
}

fn write_line(f: &mut fmt::Formatter<'_>, name: &str, mae: String, last: String) -> Result<(), fmt::Error> {
    writeln!(f, "  {name:<16}  {mae:<26}  {last}")
}

fn mean_text(errors: Vec<Option<f64>>) -> String {
    let errors: Vec<f64> = errors.into_iter().flatten().collect();
    if errors.is_empty() {
        "-".to_owned()
    } else {
        format!("{:.2} mm", errors.iter().sum::<f64>() / errors.len() as f64)
    }
}
