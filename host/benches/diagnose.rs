//! Time of a diagnosis: the whole catalogue on a session of nine runs, on one core. Each session is one of the blind study.

use criterion::Criterion;
use inference::diagnose::{Options, diagnose};
use std::hint::black_box;
use studies::diagnose::{Hidden, make};

fn nine_runs(criterion: &mut Criterion) {
    let cases = [
        ("nothing is missing", Hidden::Nothing, 2),
        ("a layer", Hidden::One("tissue.layers", 1), 1),
        ("relaxation", Hidden::One("tissue.relaxation", 1), 1),
        ("two effects", Hidden::Pair("rig.backlash", "tissue.skin"), 1),
    ];
    let mut group = criterion.benchmark_group("diagnose nine runs");
    group.sample_size(10);
    for (name, hidden, seed) in cases {
        let (session, _) = make(&hidden, seed);
        assert_eq!(session.lateral.len(), 9, "a session of nine lateral runs");
        group.bench_function(name, |bencher| {
            bencher.iter(|| diagnose(black_box(&session), &Options::default(), |_| {}).expect("a diagnosis"));
        });
    }
    group.finish();
}

fn main() {
    let mut criterion = Criterion::default().configure_from_args();
    nine_runs(&mut criterion);
    criterion.final_summary();
}
