//! `guide investigate`: the loop of diagnosis and measurement, closed.

mod measure;

use super::characterized::CharacterizedArgs;
use super::foundation_args::FoundationArgs;
use super::output::Output;
use anyhow::{Context, bail};
use formats::session::Session;
use inference::diagnose::{Diagnosis, INCOMPRESSIBLE, Options, Prospect, diagnose};
use inference::investigate::{Bounds, ChosenRun, Decision, End, Goal, Log, Menu, Step, decide};
use measure::{Measured, Rig};
use serde::Serialize;
use simulation::simulate::Axis;
use std::fmt::{self, Display};
use std::path::{Path, PathBuf};

/// Alternate diagnosis and the measurement that tells most per minute, until what is missing has its name
///
/// Every step diagnoses the session, computes what each run that the rig can make would tell about the explanations that are still in
/// question, and makes the best one: with --port on the device, with --simulate in the forward model. Without either the motion program of the next
/// run is written into the session's folder; the same command goes on once it was measured. investigation.json in that folder keeps every step.
#[derive(clap::Args)]
#[command(
    after_help = "Example:\n  guide investigate phantom-a\n  guide investigate phantom-a --port /dev/ttyACM0 --rig rig.toml --ask -- --sweep-command 'probe-export --csv'\n  \
                  guide investigate simulated --simulate plan.toml --depths-mm 20 30 40"
)]
pub struct Args {
    /// Session folder; a new one with --simulate, or with --port and --rig
    dir: PathBuf,
    /// Port of the device that makes the runs, as for `guide acquire`; options of that command follow after `--`
    #[arg(long, value_name = "PORT", conflicts_with = "simulate")]
    port: Option<String>,
    /// Make the runs by the forward model: a file as `guide simulate` has, of which needle, rig, noise, tissue and effects are used
    #[arg(long, value_name = "FILE")]
    simulate: Option<PathBuf>,
    /// Needle, guides and noise of a new session on the device
    #[arg(long, value_name = "FILE", requires = "port")]
    rig: Option<PathBuf>,
    /// Ask before every run, and for another depth of the needle; without it the device measures at the present depth alone
    #[arg(long)]
    ask: bool,
    /// What it is for: `name`, what is missing; or `k:PERCENT`, the modulus within so many percent
    #[arg(long, default_value = "name", value_name = "GOAL")]
    goal: Goal,
    /// Runs that are made at most
    #[arg(long, default_value_t = 12, value_name = "RUNS", value_parser = clap::value_parser!(u32).range(1..=200))]
    max_runs: u32,
    /// Depths to which the needle can be brought, millimetres (default: those of the session and 10 mm more; of a new session 20, 30, 40)
    #[arg(long, num_args = 1.., value_name = "MM", value_parser = super::record::depth_mm)]
    depths_mm: Vec<f64>,
    /// Largest displacement of guide 2, millimetres (default: twice that of the session; of a new one 2.4)
    #[arg(long, value_name = "MM", value_parser = displacement_mm)]
    displacement_mm: Option<f64>,
    /// Guide 2 moves along y alone
    #[arg(long)]
    only_y: bool,
    /// Largest lateral force that a run is expected to reach, newtons
    #[arg(long, default_value_t = 4.0, value_name = "N")]
    force_limit_n: f64,
    /// Minutes that it takes to bring the needle to another depth
    #[arg(long, default_value_t = 3.0, value_name = "MINUTES")]
    change_min: f64,
    #[command(flatten)]
    characterized: CharacterizedArgs,
    #[command(flatten)]
    tissue: FoundationArgs,
    /// Seed of the bootstraps, and of the noise of --simulate
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Further options of `guide acquire`
    #[arg(last = true, value_name = "OPTIONS", requires = "port")]
    acquire: Vec<String>,
}

/// Reads a displacement of guide 2.
fn displacement_mm(text: &str) -> Result<f64, String> {
    let number = text.parse().ok().filter(|number| (0.1..=50.0).contains(number));
    number.ok_or_else(|| "expected a number from 0.1 to 50".to_owned())
}

/// The document.
#[derive(Serialize)]
struct Document<'a> {
    schema: &'static str,
    session: String,
    end: End,
    /// Runs that were made.
    runs_made: u32,
    /// Minutes of all runs that were chosen, with changes of depth.
    minutes: f64,
    /// The run that is to be made next, where it is left to the person.
    #[serde(skip_serializing_if = "Option::is_none")]
    next: Option<NextRun>,
    steps: &'a [Step],
    /// The last diagnosis.
    diagnosis: Option<&'a Diagnosis>,
    /// The file of the investigation.
    log: String,
}

/// A run that is left to the person.
#[derive(Serialize)]
struct NextRun {
    what: String,
    /// The motion program that was written.
    program: String,
    /// The command that makes the run.
    command: String,
}

/// Runs the sub-command.
pub fn run(args: &Args, out: &mut Output) -> anyhow::Result<()> {
    if args.port.is_none() && args.simulate.is_none() && !args.dir.join("session.toml").exists() {
        bail!(
            "{}: no session.toml, expected the folder of a session (`guide init` makes one), or --simulate FILE, or --port PORT with --rig FILE",
            args.dir.display()
        );
    }
    let mut rig = args.rig();
    let mut log = Log::read(&args.dir)?;
    let mut made = 0;
    let mut last: Option<Diagnosis> = None;
    let (end, next) = loop {
        let session = existing(&args.dir)?;
        let menu = args.menu(session.as_ref());
        let decision = match &session {
            None => first(&menu)?,
            Some(session) => {
                let (diagnosis, decision) = args.step(session, &menu, &mut log, args.max_runs - made, out)?;
                let step = log.steps.last().map(StepText);
                if let Some(step) = step.filter(|_| !out.is_json()) {
                    out.line(&(), step)?;
                }
                last = Some(diagnosis);
                decision
            }
        };
        let choice = match decision {
            Decision::Stop(end) => break (end, None),
            Decision::Measure(choice) => choice,
        };
        log.choose(&choice);
        if session.is_some() {
            log.write(&args.dir)?;
        }
        if !out.is_json() {
            out.line(&(), ChoiceText(&choice))?;
        }
        match rig.measure(&args.dir, &choice.run)? {
            Measured::Done => made += 1,
            Measured::Stopped => break (End::Stopped, None),
            Measured::Left { program, command } => {
                let what = choice.run.words.clone();
                break (End::Stopped, Some(NextRun { what, program, command }));
            }
        }
    };
    log.end = Some(end);
    let minutes = log.minutes();
    let file = log.write(&args.dir)?;
    let document = Document {
        schema: "guide.investigate/1",
        session: args.dir.display().to_string(),
        end,
        runs_made: made,
        minutes,
        next,
        steps: &log.steps,
        diagnosis: last.as_ref(),
        log: file.display().to_string(),
    };
    out.result(&document, &document)
}

/// The session, where there is one.
fn existing(dir: &Path) -> anyhow::Result<Option<Session>> {
    fn has_runs(session: &Session) -> bool {
        !session.lateral.is_empty() || !session.insertion.is_empty()
    }
    if !dir.join("session.toml").exists() {
        return Ok(None);
    }
    Ok(Some(Session::read(dir)?).filter(has_runs))
}

/// A session without runs begins with a staircase at the middle depth.
fn first(menu: &Menu) -> anyhow::Result<Decision> {
    let Some(run) = menu.first() else { bail!("--depths-mm: no depth, expected one or more") };
    let prospect = Prospect {
        run: run.plan.id.clone(),
        information_nats: 0.0,
        modulus_nats: 0.0,
        force_n: 0.0,
        reasons: Vec::new(),
    };
    Ok(Decision::Measure(Box::new(ChosenRun { run, prospect })))
}

impl Args {
    fn rig(&self) -> Rig<'_> {
        match (&self.port, &self.simulate) {
            (Some(port), _) => Rig::device(port, self.rig.as_deref(), &self.acquire, self.ask),
            (None, Some(plan)) => Rig::simulated(plan, self.seed, self.ask),
            (None, None) => Rig::Person,
        }
    }

    fn menu(&self, session: Option<&Session>) -> Menu {
        let menu = Menu::new(session, &self.depths_mm, self.displacement_mm);
        let axes = if self.only_y { vec![Axis::Y] } else { menu.axes };
        Menu { axes, change_min: self.change_min, stays: self.port.is_some() && !self.ask, ..menu }
    }

    /// Diagnoses the session and decides what is next.
    fn step(
        &self,
        session: &Session,
        menu: &Menu,
        log: &mut Log,
        runs_left: u32,
        out: &Output,
    ) -> anyhow::Result<(Diagnosis, Decision)> {
        let runs = menu.runs(Some(session));
        let rig = self.characterized.read(&self.dir)?.map(|(_, model)| model);
        let options = Options {
            seed: self.seed,
            foundation: self.tissue.foundation.unwrap_or_else(|| session.tissue.foundation.into()),
            poisson: self.tissue.poisson.or(session.tissue.poisson).unwrap_or(INCOMPRESSIBLE),
            plans: runs.iter().map(|run| run.plan.clone()).collect(),
            ..Options::default()
        }
        .with_rig(rig.as_ref());
        let progress = out.progress();
        let found = diagnose(session, &options, |step| progress.set_message(step.to_owned()));
        progress.finish_and_clear();
        let mut found = found.with_context(|| format!("cannot diagnose {}", self.dir.display()))?;
        let Some(prospects) = found.prospects.take() else { bail!("no run can be planned") };
        log.push(session.lateral.len() + session.insertion.len(), &found, &prospects);
        let bounds = Bounds { runs_left, force_limit_n: self.force_limit_n };
        let decision = decide(self.goal, &found, &prospects, runs, bounds);
        Ok((found, decision))
    }
}

/// A step for the eye.
struct StepText<'a>(&'a Step);

/// Explanations that are shown.
const SHOWN: usize = 3;

impl Display for StepText<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Step {
            runs, verdict, explanations, unseen_probability, k_kpa, k_ci95_kpa, realised_nats, ..
        } = self.0;
        fn percent(probability: f64) -> f64 {
            100.0 * probability
        }
        let shown: Vec<String> = explanations
            .iter()
            .take(SHOWN)
            .map(|one| format!("{} {:.0} %", effects_text(&one.effects), percent(one.probability)))
            .collect();
        write!(
            f,
            "{runs:<3} {}   {verdict}: {}",
            if *runs == 1 { "run " } else { "runs" },
            shown.join(", ")
        )?;
        if *unseen_probability > 0.005 {
            write!(f, "; one more that no run has shown {:.0} %", percent(*unseen_probability))?;
        }
        let [low, high] = k_ci95_kpa;
        write!(f, "; K {k_kpa:.2} kPa ({low:.2} to {high:.2})")?;
        if let Some(nats) = realised_nats {
            write!(f, "; the last run told {nats:.2} nats")?;
        }
        writeln!(f)
    }
}

fn effects_text(effects: &[String]) -> String {
    if effects.is_empty() { "nothing missing".to_owned() } else { effects.join(" and ") }
}

/// A chosen run for the eye.
struct ChoiceText<'a>(&'a ChosenRun);

impl Display for ChoiceText<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let ChosenRun { run, prospect } = self.0;
        write!(f, "next       {}: {} ({:.1} min)", run.plan.id, run.words, run.minutes)?;
        if !prospect.reasons.is_empty() {
            let reasons = prospect.reasons.join(", ");
            write!(f, "; expected {:.2} nats, most about {reasons}", prospect.information_nats)?;
        }
        writeln!(f)
    }
}

impl Display for Document<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(NextRun { what, program, command }) = &self.next {
            writeln!(f, "measure    {what}")?;
            writeln!(f, "program    {program}")?;
            writeln!(f, "           {command}")?;
            writeln!(f, "           then the same command again")?;
        } else {
            writeln!(f, "end        {}", self.end)?;
            let named: Vec<String> = self
                .diagnosis
                .into_iter()
                .flat_map(|found| &found.effects)
                .map(|effect| format!("{}: {}", effect.id, effect.parameters_in_words()))
                .collect();
            for effect in named {
                writeln!(f, "missing    {effect}")?;
            }
            writeln!(f, "made       {} runs, {:.1} min by the plans", self.runs_made, self.minutes)?;
        }
        writeln!(f, "written    {}", self.log)
    }
}
