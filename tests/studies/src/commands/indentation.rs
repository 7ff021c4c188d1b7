//! `cargo xtask study indentation`: coverage of Young's modulus from synthetic indentations, contact recorded or not.

use anyhow::Result;
use inference::indentation::{Contact, Indenter, indented};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use worlds::random::normal;

/// Rows of a curve.
const ROWS: u32 = 120;

/// A curve's interval of E and the truth; nothing where no modulus was found.
type Judged = Option<([f64; 2], f64)>;

/// The laws of Sneddon (punch, cone) and Hertz (sphere) for a half space, written out here.
fn force_n(contact: &Contact, youngs_pa: f64, depth_m: f64) -> f64 {
    let x_m = depth_m.max(0.0);
    let modulus_pa = youngs_pa / (1.0 - contact.poisson.powi(2));
    modulus_pa
        * match contact.indenter {
            Indenter::Flat => 2.0 * contact.radius_m * x_m,
            Indenter::Sphere => 4.0 / 3.0 * (contact.radius_m * x_m.powi(3)).sqrt(),
            Indenter::Cone => 2.0 / std::f64::consts::PI * contact.half_angle_rad.tan() * x_m.powi(2),
        }
}

/// One curve: contact up to 0.3 mm per millimetre of indenter before or after the first row, an offset as large as the force, drift and noise of a
/// per cent, at scales of a tissue's punch and of a bio-indenter.
fn judged(indenter: Indenter, is_before: bool, random: &mut ChaCha8Rng) -> Judged {
    let scale = if random.random::<f64>() < 0.5 { 1.0 } else { 0.02 };
    let youngs_pa = 2e3 * 100f64.powf(random.random::<f64>());
    let contact = Contact {
        indenter,
        radius_m: scale * 1e-3 * (1.0 + 3.0 * random.random::<f64>()),
        half_angle_rad: 0.6 + 0.7 * random.random::<f64>(),
        poisson: 0.5,
        thickness_m: None,
    };
    let gap_m = scale * 0.3e-3 * random.random::<f64>();
    let contact_m = if is_before { -gap_m } else { gap_m };
    let last_m = scale * 1e-3 * (0.4 + 0.4 * random.random::<f64>());
    let depth_m: Vec<f64> = (0..ROWS).map(|row| last_m * f64::from(row) / f64::from(ROWS - 1)).collect();
    let exact: Vec<f64> = depth_m.iter().map(|m| force_n(&contact, youngs_pa, m - contact_m)).collect();
    let span_n =
        exact.iter().copied().fold(0.0, f64::max) - exact.iter().copied().fold(f64::INFINITY, f64::min);
    let (offset_n, drift_n) = (span_n * normal(random), 0.01 * span_n * normal(random));
    let forces: Vec<f64> = (0..ROWS)
        .zip(&exact)
        .map(|(row, exact_n)| {
            exact_n
                + offset_n
                + drift_n * f64::from(row) / f64::from(ROWS - 1)
                + 0.01 * span_n * normal(random)
        })
        .collect();
    let indentation = indented(&contact, &depth_m, &forces).ok()?;
    indentation.ci95_pa.map(|ends| (ends, youngs_pa))
}

/// Prints the table.
///
/// # Errors
/// None; the signature is that of the studies.
pub fn run(curves: usize, seed: u64) -> Result<()> {
    println!(
        "| indenter | contact | E in its 95 % interval | greatest over least end, median |\n|---|---|---|---|"
    );
    for (number, indenter) in (0..).zip(Indenter::ALL) {
        for (is_before, when) in [(false, "recorded"), (true, "before the first row")] {
            let mut random = ChaCha8Rng::seed_from_u64(seed);
            random.set_stream(2 * number + u64::from(is_before));
            let judged_curves: Vec<Judged> =
                (0..curves).map(|_| judged(indenter, is_before, &mut random)).collect();
            let estimates: Vec<([f64; 2], f64)> = judged_curves.into_iter().flatten().collect();
            let covered =
                estimates.iter().filter(|([low, high], truth)| (*low..=*high).contains(truth)).count();
            let mut ratios: Vec<f64> = estimates.iter().map(|([low, high], _)| high / low).collect();
            ratios.sort_by(f64::total_cmp);
            let median = ratios.get(ratios.len() / 2).copied().unwrap_or(f64::NAN);
            println!("| {} | {when} | {covered} of {curves} | {median:.2} |", indenter.name());
        }
    }
    println!("{curves} curves of {ROWS} rows each, seed {seed}");
    Ok(())
}
