//! The workflow on blind sessions.

use super::blind::{Design, Truth, session};
use super::*;

fn truth(effects: Vec<(&'static str, Vec<f64>)>) -> Truth {
    Truth { k_kpa: 12.0, tip_load_n: 0.2, effects, foreign: None }
}

#[test]
fn a_layer_is_named() {
    let session = session(&truth(vec![("tissue.layers", vec![2.2, 15.0])]), &Design::nine_runs(), 1);
    let found = diagnose(&session, &Options::default(), |_| {}).expect("a diagnosis");
    assert_eq!(found.verdict, Verdict::Named, "{found:#?}");
    assert_eq!(found.effects[0].id, "tissue.layers");
}

#[test]
#[ignore]
fn debug_gap() {
    let (session, truth) = study::make(&study::Hidden::One("tissue.entry_gap", 2), 11544314071155297837);
    let (runs, _) = runs_of(&session).unwrap();
    let (training, _) = split(runs);
    let noise = Noise::of(&training.runs, &session.noise);
    let layout =
        Layout { rig: session.rig.clone(), kinds: [true, false], effects: vec![], cache: Default::default() };
    let (prepared, start) = fit_start(&layout, &training.runs, &noise, &[]).unwrap();
    println!("start {:?} {} {:?}", start.values(), start.fit.chi_square, truth);
    let scores = score::Scores::new(&start, &prepared).unwrap();
    for s in scores.ranked().iter().take(6) {
        println!("{} {:.1} {:.1} {:?}", s.effect.id(), s.chi_square, s.log_evidence, s.starts);
    }
    let with = layout.with(crate::model::effects::effect("tissue.entry_gap").unwrap());
    for from in [2.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0] {
        let mut v = start.values().to_vec();
        v.push(from);
        match Fitted::new(&with, &prepared, &v) {
            Ok(f) => println!("{from:?} -> {:?} {:.1} {:?}", f.values(), f.fit.chi_square, f.fit.at_bound),
            Err(e) => println!("{from:?} {e}"),
        }
    }
    for i in 0..40 {
        let b = 5.0 + 0.1 * i as f64;
        let v = [truth.k_kpa.ln() + 1e3f64.ln(), b];
        let c: f64 =
            prepared.iter().map(|p| p.residuals(&with, &v).unwrap().iter().map(|r| r * r).sum::<f64>()).sum();
        print!("{b:.2} {c:.1} ; ");
    }
}

#[test]
#[ignore]
fn debug_cases() {
    let only = std::env::var("ONLY").unwrap_or_default();
    let per: usize = std::env::var("PER").ok().and_then(|v| v.parse().ok()).unwrap_or(1);
    let size = study::Size { nothing: 10 * per, one: per, pairs: 4 * per, foreign: per };
    for (hidden, seed) in study::cases(size, 1) {
        if !format!("{hidden:?}").to_lowercase().contains(&only) {
            continue;
        }
        let (session, truth) = study::make(&hidden, seed);
        println!("=== {hidden:?} {seed} {truth:?}");
        let t = std::time::Instant::now();
        let found = diagnose(&session, &Options { seed, ..Options::default() }, |what| {
            println!("   {what} {:.2}", t.elapsed().as_secs_f64())
        })
        .unwrap();
        println!(
            "  {:?} {:.2} s  p {:.1e} {:.1e} noise {:?}",
            found.verdict,
            t.elapsed().as_secs_f64(),
            found.adequacy[0].p,
            found.adequacy[1].p,
            found.noise
        );
        for e in &found.effects {
            println!("   {} {:?} gain {:.1} class {:?}", e.id, e.parameters, e.log_evidence_gain, e.class);
        }
        for r in found.ranking.iter().take(5) {
            println!("      {r:?}");
        }
        println!(
            "   p {:.1e} {:.1e} chi {:?} partial {:?} next {:?}",
            found.adequacy[0].p,
            found.adequacy[1].p,
            found.adequacy[1].channels,
            found.partial,
            found.next_measurement.as_ref().map(|n| &n.what)
        );
        println!(
            "   gap {:?}",
            found.gap.as_ref().map(|g| (g.before.chi2_reduced, g.after.chi2_reduced, g.removed))
        );
        for r in &found.regions {
            println!(
                "   {} {} {:.1}..{:.1} {:.3} {} {:.1}",
                r.channel, r.coordinate, r.from, r.to, r.mean_residual, r.unit, r.sigma
            );
        }
    }
}
