//! Sessions of the study: what is hidden in each, behind which background, on which tissue.

use crate::commands::tipload::draw::{self as tipload, Hidden, Imperfections, World, world};
use clap::ValueEnum;
use formats::session::Session;
use mechanics::effects::effect;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use worlds::body::{Bodies, Body, BodyError};
use worlds::ids;
use worlds::{
    Background, Design, NoisePlan, Truth, misfit, misfit_of, session_on, strengths, touched_modulus,
};

/// Kinds of sessions.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Kind {
    /// One effect of the catalogue behind a background, lateral runs in springs
    Effects,
    /// A background alone, lateral runs in springs
    Background,
    /// An elastic body: homogeneous, layered or graded, or with an effect, with and without a background
    Body,
    /// Insertions with lateral runs: one effect of the tip or the tissue behind a background, or a background alone
    Insertions,
    /// Insertions by hand through one guide that is moved, of a needle whose rear is not known: a skin, a soft layer or a load that
    /// steps, or none of them, behind a background
    ByHand,
}

/// Tissue.
#[derive(Debug, Clone, PartialEq)]
enum Tissue {
    Springs(Truth),
    Body(Body),
    /// Truth of a world of one guide.
    ByHand(Hand),
}

/// Insertions by hand: what is hidden, and how large their imperfections are.
#[derive(Debug, Clone, PartialEq)]
struct Hand {
    effects: Vec<(&'static str, Vec<f64>)>,
    factor: f64,
}

impl Hand {
    fn world(&self, seed: u64, number: usize) -> World {
        let hidden = match self.effects.first().map(|(id, values)| (*id, values.as_slice())) {
            Some(("tissue.skin", [n_per_mm])) => Hidden::Skin(n_per_mm / MM),
            Some(("tissue.layers", [ratio, boundary_mm])) => Hidden::Softer(MM * boundary_mm, *ratio),
            Some(("tip.load_step", [step_n, depth_mm])) => Hidden::LoadStep(MM * depth_mm, *step_n),
            _ => Hidden::Nothing,
        };
        let imperfections = Imperfections::small().times(self.factor);
        world(seed, number, tipload::Kind { one_guide: true, imperfections, hidden })
    }

    /// The modulus of the model: that of the upper layer where there are two.
    fn modulus_pa(&self, world: &World) -> f64 {
        let mean_pa =
            world.truth.iter().map(|one| one.modulus_pa).sum::<f64>() / world.truth.len().max(1) as f64;
        match self.effects.first() {
            Some(("tissue.layers", values)) => mean_pa / values.first().copied().unwrap_or(1.0),
            _ => mean_pa,
        }
    }
}

const MM: f64 = 1e-3;

/// One session to be drawn.
#[derive(Debug, Clone, PartialEq)]
pub struct Case {
    /// Its number in its kind.
    pub number: usize,
    /// Its kind.
    pub kind: Kind,
    /// Seed of the noise.
    pub seed: u64,
    /// Background of the effect.
    pub background: Background,
    tissue: Tissue,
    design: Design,
}

/// A session with what it hides.
pub struct Drawn {
    /// Recorded session.
    pub session: Session,
    /// Chi-square that the hidden effect explains, and its share of all that a plain model leaves.
    pub expected: Option<[f64; 2]>,
    /// The modulus that was touched, kPa: K of springs, Young's modulus of a body.
    pub touched_kpa: f64,
}

/// Effects that one lateral run alone cannot distinguish from others, or that an insertion has.
const INSERTION_EFFECTS: [&str; 9] = [
    "tip.load_slope",
    "tip.load_step",
    "tip.entry_angle",
    "tip.bevel_roll",
    "tip.rate",
    "tissue.layers",
    "tissue.gradient",
    "tissue.skin",
    "rig.clamp_compliance",
];
/// Effects of bodies: all of a lateral run that a linear body can have.
const NO_BODY_EFFECTS: [&str; 3] = ["tissue.stiffening", "tissue.relaxation", "tissue.shear"];

/// Draws cases of a kind; a background is `factor` times as large as in an ordinary laboratory.
pub fn draw(kind: Kind, count: usize, seed: u64, factor: f64) -> Vec<Case> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    random.set_stream(kind as u64 + 1);
    (0..count).map(|number| case(kind, number, &mut random, factor)).collect()
}

/// Hidden effects of insertions by hand: nothing in every other one.
fn by_hand(number: usize, factor: f64, uniform: &mut impl FnMut(f64, f64) -> f64) -> Hand {
    let (fraction, position) = (uniform(0.0, 1.0), uniform(0.0, 1.0));
    let effect = match number % 6 {
        1 => Some(("tissue.skin", vec![0.5 * 4f64.powf(fraction)])),
        3 => Some(("tissue.layers", vec![2.0 + 3.0 * fraction, 10.0 + 15.0 * position])),
        5 => Some(("tip.load_step", vec![0.05 + 0.1 * fraction, 35.0 + 40.0 * position])),
        _ => None,
    };
    Hand { effects: effect.into_iter().collect(), factor }
}

fn case(kind: Kind, number: usize, random: &mut ChaCha8Rng, factor: f64) -> Case {
    let seed = random.random::<u64>();
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut uniform = |low: f64, high: f64| low + (high - low) * random.random::<f64>();
    if kind == Kind::ByHand {
        let tissue = Tissue::ByHand(by_hand(number, factor, &mut uniform));
        let (background, design) = (Background::default(), Design::insertions());
        return Case { number, kind, seed, background, tissue, design };
    }
    let depths_mm = [[20.0, 30.0, 40.0], [15.0, 25.0, 40.0], [20.0, 35.0, 50.0]];
    let mut design = match kind {
        Kind::Insertions => Design::insertions(),
        _ => Design::nine_runs_at(depths_mm[number % 3]),
    };
    if uniform(0.0, 1.0) < 0.25 {
        design.noise = NoisePlan::quiet_force();
    }
    let (k_kpa, tip_load_n) = (uniform(7.0, 22.0), uniform(0.12, 0.25));
    // A few of Poisson's ratios: bodies are kept from one session to the next.
    let (youngs_kpa, poisson) =
        (uniform(12.0, 32.0), [0.45, 0.48, 0.495, 0.5][(uniform(0.0, 4.0) as usize).min(3)]);
    let lateral = ids().filter(|id| !id.starts_with("tip."));
    let ids: Vec<&'static str> = match kind {
        Kind::Effects => lateral.collect(),
        Kind::Background | Kind::ByHand => Vec::new(),
        // Two homogeneous bodies for each layered or graded one and each one with any effect.
        Kind::Body => match number % 4 {
            2 => vec!["tissue.layers", "tissue.gradient"],
            3 => lateral.filter(|id| !NO_BODY_EFFECTS.contains(id)).collect(),
            _ => Vec::new(),
        },
        Kind::Insertions if number.is_multiple_of(3) => Vec::new(),
        Kind::Insertions => INSERTION_EFFECTS.to_vec(),
    };
    let id = ids.get((uniform(0.0, 1.0) * ids.len() as f64) as usize).copied();
    let effects: Vec<_> = id.into_iter().map(|id| (id, values(id, &mut uniform))).collect();
    let truth = Truth { k_kpa, tip_load_n, effects: effects.clone(), foreign: None };
    // A background is judged by springs of about the same stiffness, with ordinary instruments.
    let ordinary = Design { noise: NoisePlan::default(), ..design.clone() };
    let hides_none = kind == Kind::Body && number % 8 < 4;
    let background = if hides_none {
        Background::default()
    } else {
        Background::drawn(&Truth { effects: Vec::new(), ..truth.clone() }, &ordinary, seed).times(factor)
    };
    let tissue = match kind {
        Kind::Body => Tissue::Body(Body { youngs_kpa, poisson, effects }),
        _ => Tissue::Springs(truth),
    };
    Case { number, kind, seed, background, tissue, design }
}

/// Sizes that a careful laboratory might overlook, between weak and strong, of either sign where that is possible.
fn values(id: &'static str, uniform: &mut impl FnMut(f64, f64) -> f64) -> Vec<f64> {
    let (Some([weak, _, strong]), Some(effect)) = (strengths(id), effect(id)) else { return Vec::new() };
    let fraction = uniform(0.0, 1.0);
    let mut values: Vec<f64> =
        weak.iter().zip(&strong).map(|(weak, strong)| strength_between(weak, strong, fraction)).collect();
    let other_side = uniform(0.0, 1.0) < 0.4;
    match id {
        "tissue.layers" => values[1] = uniform(10.0, 20.0),
        "tip.load_step" => values[1] = uniform(30.0, 60.0),
        _ => {}
    }
    match id {
        "tissue.layers" | "tissue.anisotropy" if other_side => values[0] = 1.0 / values[0],
        // Tissue that gets softer still is tissue at the deepest tip.
        "tissue.gradient" => values[0] = if other_side { -values[0].min(0.012) } else { values[0] },
        _ if other_side && effect.parameters().first().is_some_and(|info| info.is_two_sided()) => {
            let has_nodes = effect.parameters().iter().map(|info| !info.nodes.is_empty());
            values
                .iter_mut()
                .zip(has_nodes)
                .for_each(|(value, place)| *value *= if place { 1.0 } else { -1.0 });
        }
        _ => {}
    }
    values
}

fn strength_between(weak: &f64, strong: &f64, fraction: f64) -> f64 {
    if weak * strong > 0.0 {
        weak * (strong / weak).powf(fraction)
    } else {
        weak + fraction * (strong - weak)
    }
}

impl Case {
    /// Hidden effects.
    pub fn effects(&self) -> &[(&'static str, Vec<f64>)] {
        match &self.tissue {
            Tissue::Springs(truth) => &truth.effects,
            Tissue::Body(body) => &body.effects,
            Tissue::ByHand(hand) => &hand.effects,
        }
    }

    /// Id of what is hidden.
    pub fn hidden(&self) -> Option<&'static str> {
        self.effects().first().map(|(id, _)| *id)
    }

    /// Its name in tables.
    pub fn name(&self) -> String {
        let tissue_prefix = match &self.tissue {
            Tissue::Springs(_) => "",
            Tissue::Body(_) => "body, ",
            Tissue::ByHand(_) => "by hand, ",
        };
        let hidden_name = match (self.hidden(), self.background.parts.is_empty()) {
            (Some(id), _) => id,
            (None, true) if self.kind == Kind::Body => "homogeneous",
            (None, true) => "background alone",
            (None, false) => "background alone",
        };
        let scope = if self.kind == Kind::Insertions { "insertions, " } else { "" };
        format!("{scope}{tissue_prefix}{hidden_name}")
    }

    /// Everything about it in a line.
    pub fn description(&self) -> String {
        let tissue = match &self.tissue {
            Tissue::Springs(truth) => format!("K {:.3} kPa, tip load {:.3} N", truth.k_kpa, truth.tip_load_n),
            Tissue::Body(body) => format!("E {:.3} kPa, Poisson {}", body.youngs_kpa, body.poisson),
            Tissue::ByHand(hand) => format!("by hand, imperfections times {}", hand.factor),
        };
        let part_texts: Vec<String> =
            self.background.parts.iter().map(|(kind, size)| format!("{} {size:.4}", kind.name())).collect();
        format!("{tissue}; {:?}; background {}", self.effects(), part_texts.join(", "))
    }

    /// The session and what can be expected of it.
    ///
    /// # Errors
    /// [`BodyError`].
    pub fn drawn(&self, bodies: &Bodies) -> Result<Drawn, BodyError> {
        let (design, no_background) = (&self.design, Background::default());
        let is_hidden = self.hidden().is_some();
        match &self.tissue {
            Tissue::Springs(truth) => {
                let plain = Truth { effects: Vec::new(), ..truth.clone() };
                let expected = is_hidden.then(|| {
                    gain_and_fraction(
                        self.misfit_by(&plain, truth, design),
                        self.misfit_by(truth, truth, design),
                    )
                });
                let touched = touched_modulus(&plain, &self.background, design);
                let session = session_on(truth, &self.background, design, self.seed);
                Ok(Drawn { session, expected, touched_kpa: truth.k_kpa * touched })
            }
            Tissue::ByHand(hand) => {
                let world = hand.world(self.seed, self.number);
                let touched_kpa = 1e-3 * hand.modulus_pa(&world);
                Ok(Drawn { session: world.session, expected: None, touched_kpa })
            }
            Tissue::Body(body) => {
                let quiet = Design { noise: design.noise.none(), ..design.clone() };
                let plain = Body { effects: Vec::new(), ..body.clone() };
                let measured = bodies.session(body, &self.background, &quiet, 1)?;
                let misfit_by_body = |model: &Body| {
                    // The model's body was solved once before without an error, so that there is always a session.
                    let predict = |[modulus, _]: [f64; 2]| {
                        let model = Body { youngs_kpa: model.youngs_kpa * modulus, ..model.clone() };
                        bodies.session(&model, &no_background, &quiet, 1).unwrap_or_else(|_| measured.clone())
                    };
                    misfit_of(&measured, &predict, &design.noise).chi2
                };
                let expected =
                    is_hidden.then(|| gain_and_fraction(misfit_by_body(&plain), misfit_by_body(body)));
                let springs =
                    Truth { k_kpa: body.youngs_kpa, tip_load_n: 0.0, effects: Vec::new(), foreign: None };
                let touched = touched_modulus(&springs, &self.background, design);
                let session = bodies.session(body, &self.background, design, self.seed)?;
                Ok(Drawn { session, expected, touched_kpa: body.youngs_kpa * touched })
            }
        }
    }

    fn misfit_by(&self, model: &Truth, truth: &Truth, design: &Design) -> f64 {
        misfit(truth, &self.background, model, design).chi2
    }

    /// Poisson's ratio where the tissue is a body: a laboratory states it.
    pub fn poisson(&self) -> Option<f64> {
        match &self.tissue {
            Tissue::Springs(_) | Tissue::ByHand(_) => None,
            Tissue::Body(body) => Some(body.poisson),
        }
    }
}

fn gain_and_fraction(before: f64, after: f64) -> [f64; 2] {
    [before - after, 1.0 - after / before.max(1e-9)]
}
