//! `guide identify`: the tissue's modulus from the lateral runs of a session, every method side by side.

use super::characterized::CharacterizedArgs;
use super::draws_args::DrawsArgs;
use super::foundation_args::{FoundationArgs, within};
use super::output::{Output, figures_file};
use crate::figures;
use anyhow::{Context, ensure};
use clap::builder::PossibleValuesParser;
use clap::builder::TypedValueParser;
use formats::model_file::ModelFile;
use formats::prior_file::{ModulusPrior, PriorFile};
use formats::session::{Labels, Session};
use inference::holds::HoldCriteria;
use inference::identify::{
    Bootstrap, Directions, FoundationChoice, Identification, Indentations, KPerEi, Layers, NoiseAlone,
    NuisanceResult, Options, Reference, RestsOn, RunResult, YoungsMethod, identify, indentations,
};
use inference::prior::PriorResult;
use mechanics::Support;
use mechanics::effects::{EFFECTS, Effect, all, effect};
use std::fmt::{self, Display};
use std::path::{Path, PathBuf};

/// Identify the tissue's modulus from the lateral runs of a session
#[derive(clap::Args)]
#[command(
    after_help = "Example:\n  guide identify phantom-a\n  guide identify phantom-a --json > identified.json\n  guide identify phantom-a --model \
                  model.toml"
)]
pub struct Args {
    /// Session folder (holds session.toml)
    dir: PathBuf,
    /// Relation that converts the foundation modulus K to Young's modulus E
    #[arg(long, default_value = "continuum", value_parser = relation())]
    relation: YoungsMethod,
    #[command(flatten)]
    tissue: FoundationArgs,
    /// Standard deviation of Poisson's ratio: it widens the interval of E (default: the session's, or 0)
    #[arg(long, value_name = "SD", value_parser = poisson_sd)]
    poisson_sd: Option<f64>,
    /// Take an effect's parameters as unknown, so that the interval of K includes them: may be given more than once
    #[arg(long, value_name = "EFFECT", value_parser = nuisance())]
    nuisance: Vec<&'static dyn Effect>,
    /// Take the effects of a model file (model.toml) into the model
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    #[command(flatten)]
    rig: CharacterizedArgs,
    /// Use the prior of K from many sessions (prior.toml of `guide population --out`), and report K with and without it
    #[arg(long, value_name = "FILE")]
    prior: Option<PathBuf>,
    /// Find two layers, a modulus each and the boundary, from runs at several depths
    #[arg(long)]
    layers: bool,
    /// Report the interval of the profile likelihood too
    #[arg(long)]
    profile: bool,
    /// Report the interval of a parametric bootstrap with this many draws too
    #[arg(long, value_name = "DRAWS", value_parser = clap::value_parser!(u32).range(20..=100_000))]
    bootstrap: Option<u32>,
    /// Seed of the draws
    #[arg(long, default_value_t = 1)]
    seed: u64,
    #[command(flatten)]
    draws: DrawsArgs,
    /// Draw figures (shape measured and fitted, residuals, profile likelihood) as SVG files into this folder
    #[arg(long, value_name = "FOLDER")]
    plots: Option<PathBuf>,
}

/// An effect by its id.
pub(super) fn nuisance() -> impl TypedValueParser<Value = &'static dyn Effect> {
    PossibleValuesParser::new(all().into_iter().map(Effect::id)).map(|id| effect(&id).unwrap_or(EFFECTS[0]))
}

fn relation() -> impl TypedValueParser<Value = YoungsMethod> {
    PossibleValuesParser::new(YoungsMethod::ALL.map(YoungsMethod::name)).map(|name| {
        // The parser before lets nothing else pass.
        YoungsMethod::ALL.into_iter().find(|relation| relation.name() == name).unwrap_or(YoungsMethod::ALL[0])
    })
}

fn poisson_sd(text: &str) -> Result<f64, String> {
    within(text, 0.2)
}

/// Runs the sub-command.
pub fn run(args: &Args, out: &mut Output) -> anyhow::Result<()> {
    let session = Session::read(&args.dir)?;
    let mut nuisances = args.nuisance.clone();
    nuisances.sort_by_key(|effect| effect.id());
    nuisances.dedup_by_key(|effect| effect.id());
    let model = args.model.as_deref().map(ModelFile::read).transpose()?.unwrap_or_default();
    let rig = args.rig.read(&args.dir)?.map(|(_, model)| model);
    // The command line has precedence over the model's source, and this over the session's statement.
    let learned = match model.support {
        Some(Support::Body { poisson, .. }) => (Some(FoundationChoice::Body), Some(poisson)),
        Some(Support::Springs) => (Some(FoundationChoice::Springs), None),
        None => (None, None),
    };
    let (foundation, poisson) = (args.tissue.foundation.or(learned.0), args.tissue.poisson.or(learned.1));
    let options = Options::default().with_model(&model).with_rig(rig.as_ref());
    for nuisance in &nuisances {
        let id = nuisance.id();
        ensure!(
            options.fixed.iter().all(|(effect, _)| effect.id() != id),
            "--nuisance: {id} is in the model already, expected an effect that is not"
        );
    }
    ensure!(
        !args.layers || options.fixed.iter().all(|(effect, _)| effect.id() != "tissue.layers"),
        "--layers: tissue.layers is in the model already, expected a model without"
    );
    let options = Options {
        relation: args.relation,
        poisson,
        poisson_sd: args.poisson_sd,
        foundation,
        criteria: HoldCriteria::default(),
        nuisances,
        model_error: true,
        layers: args.layers,
        profile: args.profile || args.plots.is_some(),
        bootstrap: args.bootstrap.unwrap_or(0) as usize,
        seed: args.seed,
        draws: args.draws.options(args.seed),
        prior: args.prior.as_deref().map(|path| modulus_prior(path, &args.dir)).transpose()?,
        ..options
    };
    warn_of_calibrations(&session, out);
    if session.lateral.is_empty() && !session.indentation.is_empty() {
        ensure!(
            options.draws.is_none(),
            "--draws: {} has indentations alone, expected lateral runs",
            args.dir.display()
        );
        let indentation =
            indentations(&session).with_context(|| format!("cannot identify {}", args.dir.display()))?;
        return out.result(&indentation, IndentationsText(&indentation));
    }
    let result =
        identify(&session, &options).with_context(|| format!("cannot identify {}", args.dir.display()))?;
    if let Some(folder) = out.figures_folder(args.plots.as_deref()) {
        draw(&result, folder, out)?;
    }
    args.draws.write(result.draws.as_ref(), out)?;
    out.result(&result, Text(&result))?;
    if !result.runs.iter().all(|run| run.error.is_none() && run.skipped.is_none()) {
        out.note("some runs are skipped; see the warnings");
    }
    Ok(())
}

/// Prior for the session in a folder.
pub(super) fn modulus_prior(path: &Path, dir: &Path) -> anyhow::Result<ModulusPrior> {
    let labels = Labels::read(dir)?;
    Ok(PriorFile::read(path)?.group(&labels, &dir.join("session.toml"))?.clone())
}

/// Reports which runs were recorded with which calibration where it is not the same for all.
fn warn_of_calibrations(session: &Session, out: &Output) {
    let calibrations = session.calibrations();
    if calibrations.len() > 1 {
        let named = calibrations.iter().map(|(crc, runs)| format!("{} with {crc:08x}", runs.join(", ")));
        out.note(format_args!(
            "warning: runs were recorded with different calibrations of the device: {}",
            named.collect::<Vec<_>>().join("; ")
        ));
    }
}

/// Draws the figures and reports their paths.
fn draw(result: &Identification, folder: &Path, out: &Output) -> anyhow::Result<()> {
    for run in result.runs.iter().filter(|run| run.error.is_none()) {
        figures_file(folder, &format!("{}.shape", run.id), &figures::shape(run)?, out)?;
    }
    match figures::likelihood(&result.pooled)? {
        Some(svg) => figures_file(folder, "likelihood", &svg, out),
        None => Ok(()),
    }
}

/// An identification for the eye.
struct Text<'a>(&'a Identification);

impl Display for Text<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Identification {
            effects,
            runs,
            pooled,
            others,
            prior,
            k_per_ei,
            directions,
            layers,
            foundation,
            youngs_modulus_kpa: youngs,
            walls,
            reference,
            warnings,
            ..
        } = self.0;
        if !effects.is_empty() {
            writeln!(f, "model with   {}", effects.join(", "))?;
        }
        writeln!(f, "foundation modulus K, kPa (95 % interval)")?;
        let width = runs.iter().map(|run| run.id.chars().count()).fold(3, usize::max);
        writeln!(
            f,
            "  {:<width$}  depth      beam likelihood         without force           energy, corrected       energy, as printed",
            "run"
        )?;
        for run in runs {
            write_run(f, run, width)?;
        }
        let pooled_text = estimate(Some(pooled.k_kpa), Some(pooled.ci95_kpa));
        let plural = if pooled.runs == 1 { "run" } else { "runs" };
        writeln!(
            f,
            "pooled       K {pooled_text} kPa, sd {:.2} kPa, {} {plural}",
            pooled.sd_kpa, pooled.runs
        )?;
        if let Some(NoiseAlone { k_kpa, sd_kpa, ci95_kpa: [low, high] }) = pooled.noise_alone {
            writeln!(
                f,
                "             by noise alone {k_kpa:.2} ({low:.2} to {high:.2}) kPa, sd {sd_kpa:.2} kPa"
            )?;
        }
        if let Some(RestsOn { assumption, share_of_variance }) = pooled.rests_on {
            writeln!(
                f,
                "             largest contribution: {assumption} ({:.0} % of the variance)",
                1e2 * share_of_variance
            )?;
        }
        for (number, other) in others.iter().enumerate() {
            writeln!(f, "{:<13}{other}", if number == 0 { "or" } else { "" })?;
        }
        for (number, line) in prior.iter().flat_map(PriorResult::lines).enumerate() {
            writeln!(f, "{:<13}{line}", if number == 0 { "prior" } else { "" })?;
        }
        if let Some(KPerEi { k_per_ei_per_m4: ratio, ci95_per_m4: [low, high], reference_ei_n_m2 }) = k_per_ei
        {
            writeln!(
                f,
                "K/(E I)      {ratio:.3e} ({low:.3e} to {high:.3e}) 1/m^4; moduli are for E I = {reference_ei_n_m2:.4} N m^2"
            )?;
        }
        if let Some(Directions { y, x, ratio_x_to_y, ratio_ci95: [low, high] }) = directions {
            let (y, x) = (estimate(y.k_kpa, y.ci95_kpa), estimate(x.k_kpa, x.ci95_kpa));
            writeln!(
                f,
                "directions   K_y {y} kPa, K_x {x} kPa, ratio {ratio_x_to_y:.3} ({low:.3} to {high:.3})"
            )?;
        }
        if let Some(layers_result) = layers {
            let Layers { upper, lower, k_ratio, boundary_mm, boundary_ci95_mm: [low, high], .. } =
                layers_result;
            let [least, most] = layers_result.k_ratio_ci95;
            let gain = match layers_result.log_evidence_gain {
                Some(gain) => format!("log evidence {gain:+.1} nats against one layer"),
                None => "intervals are those of noise alone".to_owned(),
            };
            let modulus = if layers_result.foundation == "body" { "E" } else { "K" };
            let (upper, lower) =
                (estimate(upper.k_kpa, upper.ci95_kpa), estimate(lower.k_kpa, lower.ci95_kpa));
            writeln!(
                f,
                "layers       {modulus} {upper} kPa above, {lower} kPa below {boundary_mm:.1} mm ({low:.1} to {high:.1}), ratio \
                 {k_ratio:.2} ({least:.2} to {most:.2}); chi-square falls by {:.1}, {gain}",
                layers_result.chi_square_gain
            )?;
        }
        for found in &pooled.nuisances {
            let NuisanceResult { effect, parameter, value, sd, prior_sd } = found;
            writeln!(f, "nuisance     {effect}: {parameter} {value:.4}, sd {sd:.4} (prior sd {prior_sd})")?;
        }
        if let Some(profile) = &pooled.profile {
            let [low, high] =
                profile.ci95_kpa.map(|end| end.map_or("open".to_owned(), |k| format!("{k:.2}")));
            writeln!(f, "profile      K {low} to {high} kPa")?;
        }
        if let Some(Bootstrap { ci95_kpa: [low, high], count, seed }) = &pooled.bootstrap {
            writeln!(f, "bootstrap    K {low:.2} to {high:.2} kPa, {count} draws, seed {seed}")?;
        }
        if let Some(line) = walls.line() {
            writeln!(f, "walls        {line}")?;
        }
        for (number, line) in foundation.sentences(pooled, youngs).iter().enumerate() {
            writeln!(f, "{:<13}{line}", if number == 0 { "tissue" } else { "" })?;
        }
        match &youngs.refused {
            Some(why) => writeln!(f, "Young's      E is not reported: {why}")?,
            None => writeln!(
                f,
                "Young's      E {} kPa by `{}`, Poisson's ratio {}; by relations of K:",
                estimate(youngs.value, youngs.ci95),
                youngs.relation,
                youngs.poisson
            )?,
        }
        for other in youngs.relations.iter().filter(|other| other.relation != youngs.relation) {
            writeln!(
                f,
                "             {:>6.2} kPa by `{}` ({})",
                other.youngs_modulus_kpa, other.relation, other.validity
            )?;
        }
        if let Some(reference) = reference {
            write_reference(f, reference)?;
        }
        for warning in warnings {
            writeln!(f, "note         {warning}")?;
        }
        Ok(())
    }
}

/// Indentations for the eye.
struct IndentationsText<'a>(&'a Indentations);

impl Display for IndentationsText<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Indentations { youngs_modulus_kpa, sd_kpa, ci95_kpa, indentations, warnings, .. } = self.0;
        let width = indentations.iter().map(|one| one.id.len()).max().unwrap_or(0);
        for one in indentations {
            let contact = match (one.contact_mm, one.contact_ci95_mm) {
                (Some(at), Some([from, to])) => format!("contact {at:.3} ({from:.3} to {to:.3}) mm"),
                _ => "in contact all along".to_owned(),
            };
            writeln!(
                f,
                "  {:<width$}  {:<6}  E {} kPa, {contact}, {:.3} mm deep",
                one.id,
                one.indenter,
                estimate(Some(one.youngs_modulus_kpa), one.ci95_kpa),
                one.deepest_mm
            )?;
        }
        let sd = sd_kpa.map_or(String::new(), |sd| format!(", sd {sd:.2} kPa"));
        let plural = if indentations.len() == 1 { "" } else { "s" };
        writeln!(
            f,
            "Young's      E {} kPa{sd} from {} indentation{plural}",
            estimate(Some(*youngs_modulus_kpa), *ci95_kpa),
            indentations.len()
        )?;
        for warning in warnings {
            writeln!(f, "note         {warning}")?;
        }
        Ok(())
    }
}

fn write_reference(f: &mut fmt::Formatter<'_>, reference: &Reference) -> fmt::Result {
    let sd = reference.sd_kpa.map_or(String::new(), |sd| format!(", sd {sd:.2} kPa"));
    let plural = if reference.runs == 1 { "" } else { "s" };
    writeln!(
        f,
        "reference    E {} kPa{sd} from {} indentation{plural}; t-test against K: {}, against E: {}",
        estimate(Some(reference.k_kpa), reference.ci95_kpa),
        reference.runs,
        p_text(reference.t_test_p),
        p_text(reference.t_test_p_youngs)
    )?;
    for one in &reference.depths {
        let sd = one.k_sd_kpa.map_or(String::new(), |sd| format!(" +- {sd:.2}"));
        let youngs = one.youngs_modulus_kpa.map_or("-".to_owned(), |kpa| format!("{kpa:.2}"));
        let youngs_sd = one.youngs_modulus_sd_kpa.map_or(String::new(), |sd| format!(" +- {sd:.2}"));
        let plural = if one.runs == 1 { "" } else { "s" };
        writeln!(
            f,
            "             {:>5.1} mm, {} run{plural}: K {:.2}{sd} kPa, {}; E {youngs}{youngs_sd} kPa, {}",
            one.depth_mm,
            one.runs,
            one.k_kpa,
            p_text(one.t_test_p),
            p_text(one.t_test_p_youngs)
        )?;
    }
    Ok(())
}

fn p_text(p: Option<f64>) -> String {
    match p {
        Some(p) if p < 0.001 => "p < 0.001".to_owned(),
        Some(p) => format!("p = {p:.3}"),
        None => "-".to_owned(),
    }
}

fn write_run(f: &mut fmt::Formatter<'_>, run: &RunResult, width: usize) -> fmt::Result {
    let methods = &run.methods;
    let likelihood = estimate(methods.likelihood.k_kpa, methods.likelihood.ci95_kpa);
    let shape = &methods.likelihood_without_force;
    let without_force = estimate(shape.k_kpa, shape.ci95_kpa);
    let energy = estimate(methods.energy.k_kpa, methods.energy.ci95_kpa);
    let printed = estimate(methods.energy_as_printed.k_kpa, None);
    writeln!(
        f,
        "  {:<width$}  {:>5.1} mm   {likelihood:<22}  {without_force:<22}  {energy:<22}  {printed}{}",
        run.id,
        run.depth_mm,
        if run.skipped.is_some() { "  (not pooled)" } else { "" }
    )
}

/// A value with its interval, `-` where there is none.
fn estimate(k_kpa: Option<f64>, ci95_kpa: Option<[f64; 2]>) -> String {
    match (k_kpa, ci95_kpa) {
        (Some(k_kpa), Some([low, high])) => format!("{k_kpa:.2} ({low:.2} to {high:.2})"),
        (Some(k_kpa), None) => format!("{k_kpa:.2}"),
        (None, _) => "-".to_owned(),
    }
}
