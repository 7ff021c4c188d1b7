//! Time of a replan on one core: a needle that is guided, one that is held by hand, and one at half of the force limit, on plants that share no
//! computation with the model. `cargo bench -p steering`; the median over needles of the median stop, and the worst stop of all. Every run is made
//! some times and the least time counts, which other load on the machine disturbs least.

use steering::{Event, Options, steer};
use worlds::steering::{Kind, SimulatedPlant, reachable_target, target_by_rotations, world};

const DEPTH_MM: f64 = 100.0;
/// Seed of the needles.
const SEED: u64 = 4417;
/// A force limit that holds many moves back, N.
const LOW_LIMIT_N: f64 = 4.0;

/// Number of repetitions of each run.
const REPEATS: usize = 4;

/// Median and worst replan of a run, s.
fn times_s(plant: &SimulatedPlant, options: &Options) -> Option<[f64; 2]> {
    let mut least = [f64::INFINITY; 2];
    for _ in 0..REPEATS {
        let run = steer(&mut plant.clone(), options, &mut |_: &Event| {}).ok()?;
        least = [least[0].min(run.median_replan_s), least[1].min(run.slowest_replan_s)];
    }
    Some(least)
}

fn main() {
    // `cargo test --benches` runs this too: then once.
    let count = if std::env::args().any(|argument| argument == "--bench") { 20 } else { 1 };
    println!("| replan ({count} needles, seed {SEED}) | median, ms | worst, ms |\n|---|---|---|");
    for (name, rotations, limit_n) in
        [("guided", 0, None), ("guided, 4 N", 0, Some(LOW_LIMIT_N)), ("held by hand", 2, None)]
    {
        let times: Vec<[f64; 2]> = (0..count)
            .filter_map(|number| {
                let mut plant = world(Kind::Plain, SEED, number);
                let target_mm = if rotations > 0 {
                    plant.stated.limits.guide_travel_mm = 0.0;
                    target_by_rotations(&plant, DEPTH_MM, SEED, number).ok()?
                } else {
                    reachable_target(&plant, DEPTH_MM, SEED, number).ok()?
                };
                plant.stated.limits.guide_force_n = limit_n.or(plant.stated.limits.guide_force_n);
                times_s(&plant, &Options { rotations, ..Options::new(target_mm) })
            })
            .collect();
        let mut medians: Vec<f64> = times.iter().map(|[median, _]| *median).collect();
        medians.sort_by(f64::total_cmp);
        let median_s = medians.get(medians.len() / 2).copied().unwrap_or(f64::NAN);
        let worst_s = times.iter().map(|[_, worst]| *worst).fold(0.0, f64::max);
        println!("| {name} | {:.1} | {:.0} |", 1e3 * median_s, 1e3 * worst_s);
    }
}
