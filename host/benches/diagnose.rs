//! Time of a diagnosis: the whole catalogue on a session of nine lateral runs, and on one of twelve insertions (straight, turned, with guide 2
//! moved at rest). Sessions are those of the blind generators. On one core with `RAYON_NUM_THREADS=1`.

use criterion::Criterion;
use inference::diagnose::{Options, diagnose};
use std::hint::black_box;
use studies::diagnose::{Hidden, make};
use worlds::{Design, InsertionPlan, Truth, session};

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

fn twelve_insertions(criterion: &mut Criterion) {
    let mut design = Design::moved_insertions();
    let more: Vec<_> = design.insertion.iter().take(4).cloned().collect();
    design
        .insertion
        .extend(more.into_iter().map(|plan| InsertionPlan { id: format!("{}b", plan.id), ..plan }));
    assert_eq!((design.lateral.len(), design.insertion.len()), (0, 12), "a session of twelve insertions");
    let cases =
        [("nothing is missing", Vec::new()), ("a bent needle", vec![("needle.prebend", vec![0.25, 0.1])])];
    let mut group = criterion.benchmark_group("diagnose twelve insertions");
    group.sample_size(10);
    for (name, effects) in cases {
        let truth = Truth { k_kpa: 12.0, tip_load_n: 0.2, effects, foreign: None };
        let session = session(&truth, &design, 1);
        group.bench_function(name, |bencher| {
            bencher.iter(|| diagnose(black_box(&session), &Options::default(), |_| {}).expect("a diagnosis"));
        });
    }
    group.finish();
}

fn main() {
    let mut criterion = Criterion::default().configure_from_args();
    nine_runs(&mut criterion);
    twelve_insertions(&mut criterion);
    criterion.final_summary();
}
