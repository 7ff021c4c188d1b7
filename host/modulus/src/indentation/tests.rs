//! Curves with known modulus, offset and contact point; intervals by Monte Carlo; every way in which data are not what was stated.

use super::*;
use noise::Noise;

const YOUNGS_PA: f64 = 20e3;

fn contact(indenter: Indenter) -> Contact {
    Contact { indenter, radius_m: 3e-3, half_angle_rad: 1.2, poisson: 0.5, thickness_m: None }
}

/// Depth from `from_mm` to `to_mm` in 120 rows; Sneddon's and Hertz's laws written out here, times `factor`.
fn pressed(
    contact: &Contact,
    [from_mm, to_mm]: [f64; 2],
    [contact_mm, offset_n, sd_n]: [f64; 3],
    factor: impl Fn(f64) -> f64,
    noise: &mut Noise,
) -> (Vec<f64>, Vec<f64>) {
    let modulus_pa = YOUNGS_PA / (1.0 - contact.poisson.powi(2));
    (0..120)
        .map(|i| {
            let depth_m = 1e-3 * (from_mm + (to_mm - from_mm) * f64::from(i) / 119.0);
            let x_m = (depth_m - 1e-3 * contact_mm).max(0.0);
            let law = match contact.indenter {
                Indenter::Flat => 2.0 * contact.radius_m * x_m,
                Indenter::Sphere => 4.0 / 3.0 * (contact.radius_m * x_m.powi(3)).sqrt(),
                Indenter::Cone => 2.0 / std::f64::consts::PI * 1.2f64.tan() * x_m.powi(2),
            };
            (depth_m, offset_n + modulus_pa * law * factor(x_m) + sd_n * noise.normal())
        })
        .unzip()
}

/// Late contact and an offset do not matter, and the interval covers.
#[test]
fn modulus_offset_and_contact_are_found_and_covered() {
    for (indenter, seed) in [(Indenter::Flat, 1), (Indenter::Sphere, 2)] {
        let contact = contact(indenter);
        let mut noise = Noise::new(seed);
        let (mut covered, mut sum) = (0, 0.0);
        for _ in 0..60 {
            let contact_mm = 0.5 * noise.uniform();
            let offset_n = 0.05 * noise.normal();
            let (depth_m, force_n) =
                pressed(&contact, [-0.3, 3.0], [contact_mm, offset_n, 0.003], |_| 1.0, &mut noise);
            let result = indented(&contact, &depth_m, &force_n).expect("a modulus");
            let [low, high] = result.ci95_pa.expect("an interval");
            covered += usize::from((low..=high).contains(&YOUNGS_PA));
            sum += result.youngs_pa / 60.0;
            let (contact_m, zero_n) =
                (result.contact_m.expect("a contact"), result.offset_n.expect("an offset"));
            assert!((1e3 * contact_m - contact_mm).abs() < 0.12, "{indenter:?}: {contact_m} {contact_mm}");
            assert!((zero_n - offset_n).abs() < 0.006, "{indenter:?}: {zero_n} {offset_n}");
            assert!(
                result.fits_other_form.is_none()
                    && result.nonlinearity.abs() < 4.0 * result.nonlinearity_se + 0.02
            );
        }
        assert!((sum / YOUNGS_PA - 1.0).abs() < 0.01, "{indenter:?}: {sum}");
        // 95 % of 60 is 57, with a standard deviation of 1.7.
        assert!(covered >= 51, "{indenter:?}: {covered} of 60");
    }
}

#[test]
fn a_punch_in_contact_from_the_first_row_needs_no_contact_point() {
    let contact = contact(Indenter::Flat);
    let (depth_m, force_n) = pressed(&contact, [0.1, 3.0], [0.0, 0.2, 0.0], |_| 1.0, &mut Noise::new(3));
    let result = indented(&contact, &depth_m, &force_n).expect("a modulus");
    assert!((result.youngs_pa / YOUNGS_PA - 1.0).abs() < 1e-6, "{result:?}");
    assert_eq!((result.contact_m, result.offset_n), (None, None));
    // The way back is not used, though the force is less then.
    let retraction_m: Vec<f64> = depth_m.iter().rev().copied().collect();
    let less: Vec<f64> = force_n.iter().rev().map(|force_n| 0.7 * force_n).collect();
    let round_trip =
        indented(&contact, &[depth_m, retraction_m].concat(), &[force_n, less].concat()).expect("a modulus");
    assert!((round_trip.youngs_pa / result.youngs_pa - 1.0).abs() < 1e-9);
}

/// Hayes' table for the punch, the series of Dimitriadis for the sphere: layers that this module did not compute.
#[test]
fn thin_tissue_is_not_taken_for_stiff_tissue() {
    let punch = Contact { thickness_m: Some(15e-3), ..contact(Indenter::Flat) };
    let (depth_m, force_n) = pressed(&punch, [-0.2, 2.0], [0.0, 0.0, 0.0], |_| 1.281, &mut Noise::new(4));
    let result = indented(&punch, &depth_m, &force_n).expect("a modulus");
    assert!((result.youngs_pa / YOUNGS_PA - 1.0).abs() < 3e-3, "{result:?}");
    assert!((result.thickness_factor - 1.281).abs() < 2e-3);
    let thick = indented(&contact(Indenter::Flat), &depth_m, &force_n).expect("a modulus");
    assert!(thick.youngs_pa > 1.25 * YOUNGS_PA);

    let sphere = Contact { thickness_m: Some(10e-3), ..contact(Indenter::Sphere) };
    let (depth_m, force_n) = pressed(
        &sphere,
        [-0.2, 1.0],
        [0.0, 0.0, 0.0],
        |x_m: f64| {
            let x = (3e-3 * x_m).sqrt() / 10e-3;
            1.0 + 1.133 * x + 1.283 * x * x + 0.769 * x.powi(3) + 0.0975 * x.powi(4)
        },
        &mut Noise::new(5),
    );
    let result = indented(&sphere, &depth_m, &force_n).expect("a modulus");
    assert!((result.youngs_pa / YOUNGS_PA - 1.0).abs() < 0.04, "{result:?}");

    let paper = Contact { thickness_m: Some(1.5e-3), ..contact(Indenter::Flat) };
    let why = indented(&paper, &depth_m, &force_n);
    assert!(
        why.is_ok_and(|result| result.thickness_factor > 5.0),
        "a thin layer is solved as long as it is one"
    );
    let gone = Contact { thickness_m: Some(0.9e-3), ..contact(Indenter::Flat) };
    assert!(matches!(indented(&gone, &depth_m, &force_n), Err(IndentationError::TooThin { .. })));
}

#[test]
fn the_wrong_form_and_bent_curves_are_noticed() {
    let sphere = contact(Indenter::Sphere);
    let (depth_m, force_n) = pressed(&sphere, [0.0, 3.0], [0.0, 0.0, 0.001], |_| 1.0, &mut Noise::new(6));
    let misjudged = indented(&contact(Indenter::Flat), &depth_m, &force_n).expect("a modulus");
    assert!(misjudged.fits_other_form.is_some() && misjudged.nonlinearity > 0.2, "{misjudged:?}");
    let flat = contact(Indenter::Flat);
    let (depth_m, force_n) = pressed(&flat, [0.0, 3.0], [0.0, 0.0, 0.001], |_| 1.0, &mut Noise::new(7));
    let misjudged = indented(&sphere, &depth_m, &force_n).expect("a modulus");
    assert_eq!(misjudged.fits_other_form, Some(Indenter::Flat), "{misjudged:?}");
    // Strain hardening: twice the slope at the end.
    let (depth_m, force_n) =
        pressed(&flat, [-0.3, 3.0], [0.0, 0.0, 0.001], |x_m| 1.0 + 0.5 * x_m / 3e-3, &mut Noise::new(8));
    let bent = indented(&flat, &depth_m, &force_n).expect("a modulus");
    assert!(bent.nonlinearity > 3.0 * bent.nonlinearity_se && bent.nonlinearity > 0.1, "{bent:?}");
}

#[test]
fn what_is_no_indentation_has_no_modulus() {
    let flat = contact(Indenter::Flat);
    assert_eq!(indented(&flat, &[], &[]), Err(IndentationError::FewRows { found: 0 }));
    let pulled = indented(&flat, &[0.0, 1e-3, 2e-3, 3e-3], &[0.0, -0.1, -0.2, -0.3]);
    assert_eq!(pulled, Err(IndentationError::NoSlope));
    assert!(indented(&flat, &[1e-3; 5], &[0.1; 5]).is_err());
    // Three exact rows of a table, as printed in a paper.
    let printed = indented(&flat, &[1e-3, 2e-3, 3e-3], &[0.16, 0.32, 0.48]).expect("a modulus");
    assert!((printed.youngs_pa / 20e3 - 1.0).abs() < 1e-9 && printed.ci95_pa.is_none(), "{printed:?}");
}

/// Contact up to 0.3 mm before the first row or after it, offset, drift and noise of a per cent, at a millimetre and at a hundredth: the
/// interval holds the modulus, and is wider where the contact of a sphere or a cone was not recorded.
#[test]
fn the_interval_covers_whether_contact_was_recorded_or_not() {
    for (indenter, seed) in [(Indenter::Flat, 21), (Indenter::Sphere, 22), (Indenter::Cone, 23)] {
        for scale in [1.0, 0.01] {
            let contact = Contact { radius_m: 3e-3 * scale, ..contact(indenter) };
            let mut noise = Noise::new(seed);
            let (mut covered, mut late, mut early) = (0, Vec::new(), Vec::new());
            for _ in 0..20 {
                let contact_mm = scale * (0.6 * noise.uniform() - 0.3);
                let mut no_noise = Noise::new(1);
                let (depth_m, exact_n) =
                    pressed(&contact, [0.0, 1.2 * scale], [contact_mm, 0.0, 0.0], |_| 1.0, &mut no_noise);
                let span_n = exact_n.iter().copied().fold(0.0, f64::max);
                let (offset_n, drift_n) = (span_n * noise.normal(), 0.01 * span_n * noise.normal());
                let force_n: Vec<f64> = exact_n
                    .iter()
                    .enumerate()
                    .map(|(i, force_n)| {
                        force_n + offset_n + drift_n * i as f64 / 119.0 + 0.01 * span_n * noise.normal()
                    })
                    .collect();
                let result = indented(&contact, &depth_m, &force_n).expect("a modulus");
                let [low, high] = result.ci95_pa.expect("an interval");
                covered += usize::from((low..=high).contains(&YOUNGS_PA));
                if contact_mm > 0.0 { &mut late } else { &mut early }.push((high / low).ln());
            }
            // 95 % of 20 is 19, with a standard deviation of 1.
            assert!(covered >= 17, "{indenter:?} {scale}: {covered} of 20");
            if indenter != Indenter::Flat {
                assert!(mean(&early) > 1.2 * mean(&late), "{indenter:?}: {} {}", mean(&early), mean(&late));
            }
        }
    }
}

fn mean(all: &[f64]) -> f64 {
    all.iter().sum::<f64>() / all.len() as f64
}
