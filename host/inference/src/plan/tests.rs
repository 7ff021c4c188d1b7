//! The bound against reference values, limits, ranges, and the scatter of simulated sessions.

use super::*;
use formats::prior_file::ModulusPrior;
use mechanics::Needle;
use mechanics::effects::effect;

fn question() -> PlanInput {
    PlanInput {
        rig: Rig::two_guides(Needle::gauge_18(), 0.06, 0.07),
        support: Support::Springs,
        poisson_sd: 0.0,
        walls: None,
        modulus_range_pa: [16e3, 16e3],
        // Noise of one of 18 readings, from that of their mean: 0.1 N and 15 um.
        force_sd_n: 0.1 * 18f64.sqrt(),
        displacement_sd_m: 15e-6 * 18f64.sqrt(),
        shape_sd_m: 25e-6,
        shape_spacing_m: 1e-3,
        rate_hz: 20.0,
        hold_s: 1.0,
        levels: vec![1.0],
        nuisances: Vec::new(),
        depths_m: vec![0.02, 0.03, 0.04],
        displacements_m: vec![1.2e-3],
        guide2_m: vec![0.06],
        limits: Limits { force_n: 4.0, needle_strain: 2e-3, deflection_m: 2e-3 },
    }
}

#[test]
fn half_widths_are_those_of_the_reference_bound() {
    let plan = plan(&question()).expect("a plan");
    let bounds = [0.05517608893544766, 0.02335154058660031, 0.013981029964844035];
    for (choice, sd_ln) in plan.choices.iter().zip(bounds) {
        let expected = 100.0 * (f64::exp(1.959964 * sd_ln) - 1.0);
        assert!((choice.half_width_percent / expected - 1.0).abs() < 1e-3, "{choice:?}");
    }
    assert_eq!(plan.best.expect("a best").depth_mm, 40.0);
    assert!((plan.choices[1].force_n - 1.309563697895257).abs() < 1e-9);
}

#[test]
fn the_worst_of_the_range_counts_and_limits_are_kept() {
    let wide = PlanInput { modulus_range_pa: [8e3, 32e3], ..question() };
    let wide_plan = plan(&wide).expect("a plan");
    let narrow_plan = plan(&question()).expect("a plan");
    for (wide, narrow) in wide_plan.choices.iter().zip(&narrow_plan.choices) {
        assert!(wide.half_width_percent >= narrow.half_width_percent && wide.force_n > narrow.force_n);
    }
    let gentle = PlanInput { limits: Limits { force_n: 1.4, ..question().limits }, ..question() };
    assert_eq!(plan(&gentle).expect("a plan").best.expect("a best").depth_mm, 30.0);
    let impossible = PlanInput { limits: Limits { force_n: 0.1, ..question().limits }, ..question() };
    assert_eq!(plan(&impossible).expect("a plan").best, None);
}

/// Without tissue guide 2 bends a cantilever of its own length: a moment of `3 EI u / L^2` at the clamp.
#[test]
fn needle_strain_is_that_of_a_cantilever_where_there_is_no_tissue() {
    let air = PlanInput { modulus_range_pa: [10.0, 10.0], force_sd_n: 1e-9, ..question() };
    let expected = 100.0 * 0.5 * Needle::gauge_18().outer_diameter_m * 3.0 * 1.2e-3 / 0.06f64.powi(2);
    let choice = plan(&air).expect("air is a foundation too").choices[0].needle_strain_percent;
    assert!((choice / expected - 1.0).abs() < 5e-3, "{choice} {expected}");
}

#[test]
fn nuisances_widen() {
    let nuisances = ["rig.clamp_compliance", "sensor.depth_shift"];
    let nuisances = nuisances.iter().map(|id| effect(id).expect("an effect")).collect();
    let plain = plan(&question()).expect("a plan");
    let honest = plan(&PlanInput { nuisances, ..question() }).expect("a plan");
    for (plain, honest) in plain.choices.iter().zip(&honest.choices) {
        assert!(honest.half_width_percent > 1.02 * plain.half_width_percent, "{plain:?} {honest:?}");
    }
}

#[test]
fn readings_average_and_an_unknown_zero_widens() {
    let question = || PlanInput { force_sd_n: 0.01 * 18f64.sqrt(), ..question() };
    let plain = half_width(&question());
    // Four times the readings halve what comes from force and displacement; the shape stays.
    let longer = half_width(&PlanInput { hold_s: 0.1 + 4.0 * 0.9, ..question() });
    assert!((0.5..0.9).contains(&(longer / plain)), "{longer} {plain}");
    // The measured force of a hold at zero displacement replaces the uncertainty after a tare, 0.01 N: the mean of a
    // hold is known as well here, five times better with a quiet sensor, and five times worse with a noisy one.
    let zero_helps = |force_sd_n: f64| {
        let width_of = |levels: Vec<f64>| half_width(&PlanInput { force_sd_n, levels, ..question() });
        width_of(vec![0.0, 1.0]) / width_of(vec![1.0])
    };
    let mean_of_hold = 18f64.sqrt();
    assert!((0.95..1.08).contains(&zero_helps(0.01 * mean_of_hold)), "{}", zero_helps(0.01 * mean_of_hold));
    assert!(zero_helps(0.002 * mean_of_hold) < 0.95, "{}", zero_helps(0.002 * mean_of_hold));
    assert!(zero_helps(0.05 * mean_of_hold) > 1.04, "{}", zero_helps(0.05 * mean_of_hold));
}

fn half_width(question: &PlanInput) -> f64 {
    plan(question).expect("a plan").choices[1].half_width_percent
}

#[test]
fn what_no_run_can_be_is_refused_by_name() {
    let fine = refusal(PlanInput { shape_spacing_m: 1e-9, ..question() });
    assert_eq!(fine, "spacing_mm: 0.000001, expected 0.05 to 100");
    let shallow = refusal(PlanInput { depths_m: vec![0.02e-3], ..question() });
    assert_eq!(shallow, "depth_mm: 0.02, expected 0.5 to 500");
    let sparse = refusal(PlanInput { depths_m: vec![2e-3], ..question() });
    assert!(
        sparse.contains("2 shape points in 2 mm of depth, expected at least 3: at most 0.667"),
        "{sparse}"
    );
    assert!(refusal(PlanInput { hold_s: 0.6, ..question() }).contains("12 readings, expected 20"));
    assert!(refusal(PlanInput { levels: vec![0.0], ..question() }).starts_with("levels: no displaced hold"));
    assert!(refusal(PlanInput { depths_m: vec![], ..question() }).starts_with("depth_mm: nothing"));
    assert!(
        refusal(PlanInput { displacements_m: vec![f64::NAN], ..question() })
            .starts_with("displacement_mm: NaN")
    );
}

fn refusal(question: PlanInput) -> String {
    plan(&question).expect_err("refused").to_string()
}

/// A needle that hardly touches the tissue determines nothing: no number of hundreds of digits, and no best choice.
#[test]
fn what_is_not_identifiable_has_no_half_width() {
    let question = PlanInput {
        modulus_range_pa: [10.0, 10.0],
        depths_m: vec![0.5e-3],
        shape_spacing_m: 0.1e-3,
        force_sd_n: 10.0,
        displacements_m: vec![0.1e-3],
        ..question()
    };
    let plan = plan(&question).expect("a plan");
    assert_eq!((plan.choices[0].half_width_percent, plan.best), (f64::INFINITY, None));
    let json = serde_json::to_value(plan.choices[0]).expect("serialises");
    assert!(json["half_width_percent"].is_null(), "{json}");
}

/// In a body E is what is identified: the half-width follows the noise, and Poisson's ratio widens it.
#[test]
fn a_body_has_a_half_width_of_e() {
    let (plain, quiet, loose) = (body_plan(0.0, 1.0), body_plan(0.0, 0.5), body_plan(0.05, 1.0));
    assert_eq!((plain.protocol.foundation, plain.protocol.poisson), ("body", Some(0.45)));
    for ((plain, quiet), loose) in plain.choices.iter().zip(&quiet.choices).zip(&loose.choices) {
        let ratio = plain.half_width_percent / quiet.half_width_percent;
        assert!((1.9..2.2).contains(&ratio), "{plain:?} {quiet:?}");
        assert!(loose.half_width_percent > plain.half_width_percent + 0.05, "{plain:?} {loose:?}");
    }
}

fn body_plan(poisson_sd: f64, noise: f64) -> Plan {
    let plain = question();
    let question = PlanInput {
        support: Support::half_space(0.45),
        poisson_sd,
        force_sd_n: noise * plain.force_sd_n,
        displacement_sd_m: noise * plain.displacement_sd_m,
        shape_sd_m: noise * plain.shape_sd_m,
        ..plain
    };
    plan(&question).expect("a plan")
}

#[test]
fn a_prior_narrows_every_interval_as_precisions_add_up_beside_the_run_alone() {
    let alone = plan(&question()).expect("a plan");
    let with_prior = alone.clone().with_prior(&modulus_prior(0.1));
    for (alone, with_prior) in alone.choices.iter().zip(&with_prior.choices) {
        assert_eq!(alone.half_width_percent.to_bits(), with_prior.half_width_percent.to_bits());
        let run_precision =
            if alone.half_width_percent.is_finite() { sd_ln(alone.half_width_percent).powi(-2) } else { 0.0 };
        let combined_sd = sd_ln(with_prior.half_width_with_prior_percent.expect("with the prior"));
        assert!((combined_sd.powi(-2) / (run_precision + 100.0) - 1.0).abs() < 1e-3, "sd {combined_sd}");
    }
    let vague = alone.with_prior(&modulus_prior(10.0)).best.expect("a best");
    let width_ratio = vague.half_width_with_prior_percent.expect("with the prior") / vague.half_width_percent;
    assert!((width_ratio - 1.0).abs() < 1e-3, "ratio {width_ratio}");
}

fn sd_ln(percent: f64) -> f64 {
    (1e-2 * percent).ln_1p() / NORMAL_975
}

fn modulus_prior(scale_ln: f64) -> ModulusPrior {
    ModulusPrior {
        file: "prior.toml".to_owned(),
        group: "all".to_owned(),
        sessions: 20,
        modulus_pa: 15e3,
        scale_ln,
        degrees_of_freedom: 1e6,
    }
}
