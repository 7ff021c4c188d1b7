//! Follows an insertion reading by reading, and prints at every centimetre where the tip will be at the end, with its 95 % band.
//!
//! The last insertion of the session is the one that is followed; K is identified from the lateral runs, and tip load and path are
//! learned from the other insertions, as `guide predict` does. The noise of a reading is not in the band.
//!
//! ```sh
//! guide init --example playground
//! cargo run --release -p host --example follow_insertion -- playground
//! ```

use anyhow::{Context, ensure};
use formats::session::Session;
use inference::identify::{FoundationChoice, Options, identify};
use inference::insertion::{Candidates, OnlinePosterior, Posterior, ReadingNoise, TipPath, Tissue, learn};
use mechanics::Model;
use std::path::Path;

/// Uncertainty of the modulus in an insertion relative to that of a lateral run: standard deviation of the
/// logarithm.
const INSERTION_SD_LN: f64 = 0.1;
/// Standard deviation of the logarithm of the gap between guide 2 and the tissue.
const GAP_SD_LN: f64 = 0.7;
/// Half of a 95 % band, standard deviations.
const HALF_BAND_SD: f64 = 1.96;

fn main() -> anyhow::Result<()> {
    let folder = std::env::args_os().nth(1).context("expected a session folder")?;
    let session = Session::read(Path::new(&folder))?;
    ensure!(!session.rig.has_one_guide(), "rig.guides: 1, expected a rig with two guides");
    let position_m = session.noise.tip_m.context("noise.tip_mm: missing, expected the noise of a reading")?;
    let (followed, earlier) = session.insertion.split_last().context("insertion: missing, expected two")?;
    ensure!(!earlier.is_empty(), "insertion: one, expected two or more");

    // The path is that of a needle on springs.
    let springs = Options { foundation: Some(FoundationChoice::Springs), ..Options::default() };
    let pooled = identify(&session, &springs)?.pooled;
    let gap_m = session.rig.entry_m - session.rig.guide2_m;
    let tissue = Tissue {
        model: Model::uniform(session.rig.clone(), 1e3 * pooled.k_kpa)?,
        modulus_sd_ln: (pooled.sd_kpa / pooled.k_kpa).hypot(INSERTION_SD_LN),
        gap_m,
        gap_sd_ln: GAP_SD_LN,
        rear: None,
    };
    // Only the plan of the insertion that is followed is used: its depth, and how the needle is turned and moved.
    let paths = session.insertion.iter().map(TipPath::new).collect::<Result<Vec<_>, _>>()?;
    let end_m = paths.last().map_or(0.0, |path| path.deepest_m);
    let candidates = Candidates::new(&tissue, &paths, end_m)?;
    let numbers: Vec<usize> = (0..earlier.len()).collect();
    let noise = ReadingNoise { position_m, ..ReadingNoise::default() };
    let learned = learn(&candidates, &paths, &numbers, earlier.len(), noise);

    println!("{}: tip at {:.0} mm, predicted from the readings up to a depth", followed.id, 1e3 * end_m);
    println!("depth_mm  tip_y_mm  lo95_y_mm  hi95_y_mm");
    let mut live = OnlinePosterior::new(Posterior::new(&candidates, &learned));
    let mut next_m = 0.010;
    for (row, (depth_m, tip_y_m)) in followed.depth_m.iter().zip(&followed.tip_y_m).enumerate() {
        if *depth_m < 0.0 {
            continue; // not in the tissue yet
        }
        let tip_x_m = followed.tip_x_m.as_ref().and_then(|tip_m| tip_m.get(row)).copied().unwrap_or(0.0);
        live.push(*depth_m, [*tip_y_m, tip_x_m]);
        if *depth_m >= next_m {
            ensure!(live.posterior().is_sound(), "no modulus and gap explain the readings up to here");
            let predicted = live.posterior().tip_m(&[end_m]);
            let tip = predicted.first().and_then(|plane| plane.first()).context("no plane was measured")?;
            let [low_m, high_m] = [-HALF_BAND_SD, HALF_BAND_SD].map(|sds| tip.mean + sds * tip.sd);
            println!(
                "{:8.0}  {:8.2}  {:9.2}  {:9.2}",
                1e3 * depth_m,
                1e3 * tip.mean,
                1e3 * low_m,
                1e3 * high_m
            );
            next_m += 0.010;
        }
    }
    let measured_mm = followed.tip_y_m.last().map_or(f64::NAN, |tip_m| 1e3 * tip_m);
    println!("measured  {measured_mm:8.2}");
    Ok(())
}
