//! Cost of the online estimators: a whole steering run of 1001 samples (80 mm at 4 mm/s, one every 20 ms), so that milliseconds here
//! are microseconds per update; the longest single update of the sound one; and the comparators on the same samples.

use criterion::Criterion;
use firmware::steering::Sample;
use host::model::{Dynamics, Needle, Rig};
use host::rig::steering::{Plan, Sensors, SteeringRig, Tissue, TissueLayer};
use host::track::kalman::{Kalman, Kind, Told};
use host::track::method::{Method, samples};
use host::track::published::{Printed, Published};
use host::track::sound::{Sound, settings};
use std::hint::black_box;
use std::time::{Duration, Instant};

const SENSORS: Sensors = Sensors { base_m: 2e-5, force_n: 0.05, tip_m: 2e-4 };

fn recorded(rig: &Rig) -> Vec<Sample<f64>> {
    let layer = |bottom_mm, stiffness_n_per_m2| TissueLayer {
        bottom_mm,
        stiffness_n_per_m2,
        damping_n_s_per_m2: 1e3,
    };
    let tissue = Tissue { layers: vec![layer(40.0, 1.5e4), layer(80.0, 4e4)], inclusions: Vec::new() };
    let plan = Plan {
        id: "s4".to_owned(),
        speed_mm_s: 4.0,
        depth_mm: 80.0,
        lateral_mm: 20.0,
        straight_mm: 0.0,
        wobble_mm: 0.0,
        wobble_hz: 0.5,
        period_ms: 20.0,
        disturbances: 0,
    };
    let rig = SteeringRig::new(rig.clone(), 0.13, 0.3, &tissue).expect("a rig");
    let run = rig.carry_out(&plan).expect("a plan").measure(SENSORS, 1, 0);
    samples(&run).collect()
}

fn main() {
    let rig = Rig { needle: Needle::gauge_18(), guide2_m: 0.06, entry_m: 0.07 };
    let needle = &rig.needle;
    let dynamics = Dynamics::steel(needle, 0.13, 0.3);
    let run = recorded(&rig);
    let printed = Printed::default();
    let told = Told {
        start: [printed.start[1], printed.start[0]],
        base_sd_m: SENSORS.base_m,
        force_sd_n: SENSORS.force_n,
        tip_sd_m: SENSORS.tip_m,
    };
    let sound = || Sound::new(settings::<f64>(needle, &dynamics).expect("a needle")).expect("fits");
    let mut criterion = Criterion::default().configure_from_args();
    let mut group = criterion.benchmark_group(format!("{} updates", run.len()));
    group.sample_size(10).measurement_time(Duration::from_secs(3));
    let mut bench = |name: &str, make: &dyn Fn() -> Box<dyn Method>| {
        group.bench_function(name, |bencher| {
            bencher.iter(|| {
                let mut method = make();
                run.iter().filter_map(|sample| method.update(black_box(sample))).count()
            });
        });
    };
    bench("sound, f64", &|| Box::new(sound()));
    bench("sound, f32", &|| {
        Box::new(Sound::new(settings::<f32>(needle, &dynamics).expect("a needle")).expect("fits"))
    });
    bench("published", &|| Box::new(Published::new(needle, &dynamics, printed).expect("a needle")));
    bench("EKF", &|| Box::new(Kalman::new(Kind::Extended, needle, &dynamics, told).expect("a needle")));
    bench("UKF", &|| Box::new(Kalman::new(Kind::Unscented, needle, &dynamics, told).expect("a needle")));
    group.finish();
    // The least of several runs is what each update takes when nothing else disturbs it.
    let mut least = vec![Duration::MAX; run.len()];
    for _ in 0..200 {
        let mut method = sound();
        for (sample, least) in run.iter().zip(&mut least) {
            let began = Instant::now();
            black_box(method.update(black_box(sample)));
            *least = (*least).min(began.elapsed());
        }
    }
    let longest = least.iter().max().copied().unwrap_or_default();
    println!("longest update of sound, f64: {longest:?}");
    criterion.final_summary();
}
