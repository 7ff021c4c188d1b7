//! Simulated worlds with hidden laws, integrated by code of their own in small steps of Euler: what is found, what is named falsely, and what
//! intervals hold, over seeds.

mod common;

use common::{coloured, column, parameter, regressor};
use discrepancy::*;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

const SEEDS: u64 = 12;

/// Force of a cart by acceleration and speed.
struct Cart {
    parameters: Vec<Parameter>,
    sites: Vec<Site>,
}

impl Cart {
    fn new() -> Self {
        let friction = Site {
            name: "friction".to_owned(),
            unit: "N".to_owned(),
            adds_to: Some("force".to_owned()),
            regressors: vec![regressor("speed", "m/s"), regressor("position", "m")],
            forms: Vec::new(),
        };
        Self {
            parameters: vec![parameter("mass", "kg", 3.0, 1.0), parameter("viscous", "N s/m", 2.0, 2.0)],
            sites: vec![friction],
        }
    }
}

impl ForwardModel for Cart {
    fn parameters(&self) -> &[Parameter] {
        &self.parameters
    }

    fn sites(&self) -> &[Site] {
        &self.sites
    }

    fn predict(&self, run: &Run, parameters: &[f64], _: &Terms<'_>) -> Result<Vec<Vec<f64>>, ModelFailure> {
        let column = |name| run.column(name).ok_or_else(|| ModelFailure::Failed(format!("no column {name}")));
        let pairs = column("acceleration")?.iter().zip(column("speed")?);
        Ok(vec![pairs.map(|(a, v)| parameters[0] * a + parameters[1] * v).collect()])
    }
}

/// A cart that is moved to and fro, of 2.4 kg and 3 N s/m, with a hidden friction and coloured noise of the force.
fn cart(seed: u64, judges: bool, friction: &dyn Fn(f64, f64) -> f64) -> Run {
    let mut rng = ChaCha8Rng::seed_from_u64(1000 * seed + u64::from(judges));
    let hz = if judges { 0.31 } else { 0.2 };
    let count = 1500;
    let noise = coloured(&mut rng, count, 0.10, 0.15, 0.97);
    let phase = f64::from(u32::try_from(seed % 7).expect("small"));
    let (mut position, mut speed) = (0.0, 0.0);
    let [mut times, mut positions, mut speeds, mut accelerations, mut forces] = [(); 5].map(|()| Vec::new());
    for (i, noise) in noise.iter().enumerate() {
        let acceleration = |t: f64| {
            let turn = std::f64::consts::TAU * hz;
            1.5 * (turn * t + phase).cos() + 0.9 * (2.7 * turn * t).cos() - 0.8 * position - 0.3 * speed
        };
        let now = 0.02 * i as f64;
        let rate = acceleration(now);
        times.push(now);
        positions.push(position);
        speeds.push(speed);
        accelerations.push(rate);
        forces.push(2.4 * rate + 3.0 * speed + friction(speed, position) + noise);
        for _ in 0..40 {
            speed += rate * 0.02 / 40.0;
            position += speed * 0.02 / 40.0;
        }
    }
    Run {
        name: if judges { "judge".to_owned() } else { "train".to_owned() },
        time_s: times,
        channels: vec![Channel { name: "force".to_owned(), unit: "N".to_owned(), values: forces, sds: None }],
        columns: vec![
            column("position", "m", positions),
            column("speed", "m/s", speeds),
            column("acceleration", "m/s^2", accelerations),
        ],
        judges,
    }
}

fn of_cart(seed: u64, friction: &dyn Fn(f64, f64) -> f64) -> Report {
    let data = Data::new(vec![cart(seed, false, friction), cart(seed, true, friction)]).expect("data");
    diagnose(&Cart::new(), &data, &Options::default(), &|_| ()).expect("a result")
}

fn holds(estimate: &Estimate, value: f64) -> bool {
    (estimate.ci95[0]..=estimate.ci95[1]).contains(&value)
}

fn ids(report: &Report) -> Vec<String> {
    report.terms.iter().map(|term| term.law.id()).collect()
}

/// No law is hidden, and the noise has a memory: no name, and intervals hold.
#[test]
#[ignore = "second tier: Monte Carlo over a dozen seeds, up to a minute"]
fn coloured_noise_gets_no_name_and_intervals_hold() {
    let (mut named, mut held_count) = (0, 0);
    for seed in 0..SEEDS {
        let report = of_cart(seed, &|_, _| 0.0);
        println!("seed {seed}: {:?} {:?}", report.verdict, ids(&report));
        named += usize::from(!report.terms.is_empty());
        held_count += usize::from(holds(&report.parameters[0].estimate, 2.4));
        held_count += usize::from(holds(&report.parameters[1].estimate, 3.0));
    }
    println!("named falsely {named} of {SEEDS}; intervals held {held_count} of {}", 2 * SEEDS);
    // 5 % of 12 are 0.6, and two or more of them have a probability of 12 %; of 24 intervals 20 or fewer hold with 3 %.
    assert!(named <= 1 && held_count >= 21, "{named} named, {held_count} held");
}

/// One seed of each of the two below and above, for the first tier.
#[test]
fn one_cart_with_and_one_without_dry_friction() {
    let report = of_cart(3, &|v, _| 0.8 * v.signum());
    assert_eq!((report.verdict, ids(&report)), (Verdict::Explained, vec!["friction/speed/sign".to_owned()]));
    assert!(holds(&report.terms[0].values[0], 0.8), "{report}");
    let report = of_cart(3, &|_, _| 0.0);
    assert_eq!(report.verdict, Verdict::Adequate, "{report}");
}

/// Dry friction beside it: found by its name, with its size and the parameters in their intervals.
#[test]
#[ignore = "second tier: Monte Carlo over a dozen seeds, up to a minute"]
fn dry_friction_is_found_and_its_interval_holds() {
    let (mut found_count, mut wrong, mut held_count) = (0, 0, 0);
    for seed in 0..SEEDS {
        let report = of_cart(seed, &|v, _| 0.8 * v.signum());
        println!("seed {seed}: {:?} {:?}", report.verdict, ids(&report));
        for term in &report.terms {
            if term.law.id() == "friction/speed/sign" {
                found_count += 1;
                held_count += usize::from(holds(&term.values[0], 0.8));
            } else {
                wrong += 1;
            }
        }
        held_count += usize::from(holds(&report.parameters[0].estimate, 2.4));
        held_count += usize::from(holds(&report.parameters[1].estimate, 3.0));
    }
    println!("found {found_count} of {SEEDS}, wrong {wrong}; intervals held {held_count} of {}", 3 * SEEDS);
    assert!(
        found_count >= 11 && wrong <= 1 && held_count >= 30,
        "{found_count} found, {wrong} wrong, {held_count} held"
    );
}

/// Dry friction, an offset and an asymmetry at once, of which the last two hide each other: their sum has a mean of about zero.
#[test]
#[ignore = "second tier: Monte Carlo over a dozen seeds, up to a minute"]
fn three_laws_at_once_are_found() {
    let (mut found_count, mut wrong) = (0, 0);
    for seed in 0..SEEDS {
        let report = of_cart(seed, &|v, _| 0.8 * v.signum() - 0.5 + 0.7 * v.abs());
        println!("seed {seed}: {:?} {:?}", report.verdict, ids(&report));
        let truth = ["friction/speed/sign", "friction/constant", "friction/speed/asymmetry"];
        let explanations = |term: &TermReport| {
            let rivals = term.rivals.iter();
            let rivals =
                rivals.flat_map(|rival| std::iter::once(&rival.law).chain(&rival.with).map(LawName::id));
            std::iter::once(term.law.id()).chain(rivals).collect::<Vec<_>>()
        };
        let in_a_class =
            |law: &&&str| report.terms.iter().any(|term| explanations(term).iter().any(|id| id == **law));
        found_count += truth.iter().filter(in_a_class).count();
        let is_wrong = |term: &&TermReport| term.is_named && !truth.contains(&term.law.id().as_str());
        wrong += report.terms.iter().filter(is_wrong).count();
    }
    println!("named or in a class {found_count} of {}, named falsely {wrong}", 3 * SEEDS);
    // Beside the truth a square or a step with the asymmetry is named in one of six seeds: a pair in the place of a law is searched, three laws are not.
    assert!(found_count >= 30 && wrong <= 2, "{found_count} found, {wrong} named falsely");
}

/// The level of a tank that drains; the model integrates with its terms inside.
struct Tank {
    parameters: Vec<Parameter>,
    sites: Vec<Site>,
}

impl Tank {
    fn new() -> Self {
        let balance = Site {
            name: "balance".to_owned(),
            unit: "cm/s".to_owned(),
            adds_to: None,
            regressors: vec![regressor("level", "cm")],
            forms: Vec::new(),
        };
        Self {
            parameters: vec![
                parameter("outflow", "cm^0.5/s", 0.3, 0.15),
                parameter("pump", "cm/(V s)", 0.5, 0.25),
            ],
            sites: vec![balance],
        }
    }
}

impl ForwardModel for Tank {
    fn parameters(&self) -> &[Parameter] {
        &self.parameters
    }

    fn sites(&self) -> &[Site] {
        &self.sites
    }

    fn predict(
        &self,
        run: &Run,
        parameters: &[f64],
        terms: &Terms<'_>,
    ) -> Result<Vec<Vec<f64>>, ModelFailure> {
        let pump = run.column("pump").ok_or_else(|| ModelFailure::Failed("no column pump".to_owned()))?;
        let rate = |level: f64, pump: f64| {
            parameters[1] * pump - parameters[0] * level.max(0.0).sqrt()
                + terms.value("balance", &[("level", level)])
        };
        let mut level = 4.0;
        let mut levels = Vec::new();
        for u in pump {
            levels.push(level);
            for _ in 0..2 {
                // Heun's method in steps of half a second.
                let first = rate(level, *u);
                level += 0.25 * (first + rate(level + 0.5 * first, *u));
                level = level.max(0.0);
            }
        }
        Ok(vec![levels])
    }
}

fn tank(seed: u64, judges: bool, loss: f64) -> Run {
    let mut rng = ChaCha8Rng::seed_from_u64(77 + 1000 * seed + u64::from(judges));
    let noise = coloured(&mut rng, 600, 0.03, 0.03, 0.9);
    let mut level: f64 = 4.0;
    let (mut levels, mut pumps) = (Vec::new(), Vec::new());
    for (i, noise) in noise.iter().enumerate() {
        let phase = i as f64 / if judges { 37.0 } else { 29.0 };
        let pump = 1.6 + 0.9 * phase.sin() + 0.5 * (2.3 * phase + seed as f64).sin();
        levels.push(level + noise);
        pumps.push(pump);
        for _ in 0..200 {
            let overflow = loss * (level - 9.0_f64).max(0.0);
            level += 0.005 * (0.55 * pump - 0.32 * level.max(0.0).sqrt() - overflow);
        }
    }
    Run {
        name: if judges { "judge".to_owned() } else { "train".to_owned() },
        time_s: (0..levels.len()).map(|i| i as f64).collect(),
        channels: vec![Channel {
            name: "level".to_owned(),
            unit: "cm".to_owned(),
            values: levels,
            sds: None,
        }],
        columns: vec![column("pump", "V", pumps)],
        judges,
    }
}

fn of_tank(seed: u64, loss: f64) -> Report {
    let data = Data::new(vec![tank(seed, false, loss), tank(seed, true, loss)]).expect("data");
    diagnose(&Tank::new(), &data, &Options::default(), &|_| ()).expect("a result")
}

/// An overflow inside the equations of a simulation, and the same tank without it.
#[test]
#[ignore = "second tier: Monte Carlo over a dozen seeds, up to a minute"]
fn an_overflow_is_found_in_a_simulation_and_only_there() {
    let (mut found_count, mut wrong, mut held_count) = (0, 0, 0);
    for seed in 0..SEEDS {
        let report = of_tank(seed, 0.3);
        println!("seed {seed}: {:?} {:?}", report.verdict, ids(&report));
        for term in &report.terms {
            if term.law.id() == "balance/level/above_level" {
                found_count += 1;
                held_count += usize::from(holds(&term.values[1], 9.0));
            } else {
                wrong += 1;
            }
        }
        let plain = of_tank(seed, 0.0);
        println!("seed {seed}: {:?} {:?} without", plain.verdict, ids(&plain));
        wrong += plain.terms.len();
        held_count += usize::from(holds(&plain.parameters[0].estimate, 0.32));
    }
    println!("found {found_count} of {SEEDS}, wrong {wrong}; intervals held {held_count} of {}", 2 * SEEDS);
    assert!(
        found_count >= 10 && wrong <= 2 && held_count >= 20,
        "{found_count} found, {wrong} wrong, {held_count} held"
    );
}
