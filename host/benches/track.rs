//! Cost of the online estimators: a whole steering run of 1001 samples (80 mm at 4 mm/s, one every 20 ms), so that milliseconds here
//! are microseconds per update; the longest single update of that of `guide track`; and the comparators on the same samples.

#![allow(dead_code, reason = "the modules are those of the page of benches, which uses more of them")]

#[path = "beside/src/clock.rs"]
mod clock;
#[path = "beside/src/estimators.rs"]
mod estimators;
#[path = "beside/src/forward.rs"]
mod forward;

use criterion::Criterion;
use estimators::SENSORS;
use inference::track::kalman::{FilterConfig, Kalman, Kind};
use inference::track::method::Method;
use inference::track::online::{OnlineEstimator, settings};
use inference::track::published::{Published, PublishedSettings};
use std::hint::black_box;
use std::time::{Duration, Instant};

fn main() {
    let (rig, dynamics) = estimators::steered();
    let needle = &rig.needle;
    let run = estimators::steering(1).expect("a run");
    let printed = PublishedSettings::default();
    let config = FilterConfig {
        start: [printed.start[1], printed.start[0]],
        base_sd_m: SENSORS.base_m,
        force_sd_n: SENSORS.force_n,
        tip_sd_m: SENSORS.tip_m,
    };
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
    bench("guide track, f64", &|| Box::new(online(&dynamics, needle)));
    bench("guide track, f32", &|| {
        Box::new(OnlineEstimator::new(settings::<f32>(needle, &dynamics).expect("a needle")).expect("fits"))
    });
    bench("published", &|| Box::new(Published::new(needle, &dynamics, printed).expect("a needle")));
    bench("EKF", &|| Box::new(Kalman::new(Kind::Extended, needle, &dynamics, config).expect("a needle")));
    bench("UKF", &|| Box::new(Kalman::new(Kind::Unscented, needle, &dynamics, config).expect("a needle")));
    group.finish();
    // The least of several runs is what each update takes when nothing else disturbs it.
    let mut least = vec![Duration::MAX; run.len()];
    for _ in 0..200 {
        let mut method = online(&dynamics, needle);
        for (sample, least) in run.iter().zip(&mut least) {
            let began = Instant::now();
            black_box(method.update(black_box(sample)));
            *least = (*least).min(began.elapsed());
        }
    }
    let longest = least.iter().max().copied().unwrap_or_default();
    println!("longest update of guide track, f64: {longest:?}");
    criterion.final_summary();
}

fn online(dynamics: &mechanics::Dynamics, needle: &mechanics::Needle) -> OnlineEstimator<f64> {
    OnlineEstimator::new(settings::<f64>(needle, dynamics).expect("a needle")).expect("fits")
}
