//! `cargo xtask sequences`: random sequences of commands, loads, tares, calibrations, faults of sensors, restarts and
//! old frames, by the million on the controller in this process and by the thousand on the firmware in QEMU. The
//! conditions are in the crate [`sequences`], and so is the plant of both.
//!
//! | part | does |
//! |---|---|
//! | [`lockstep`] | the firmware in QEMU on that plant, a control period at a time |
//! | [`device`] | what a sequence does to it; every sample is compared with what was sensed |

mod device;
pub mod lockstep;

use anyhow::{Result, anyhow, bail};
use sequences::{CampaignCounts, run_in_process};
use std::fmt;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread;
use std::time::{Duration, Instant};

/// Sequences of a power-on in QEMU: a violation is reproduced from the first of them.
const SEQUENCES_PER_BOOT: u64 = 50;
/// Interval at which the progress is reported.
const REPORT_INTERVAL: Duration = Duration::from_secs(60);

/// Options of `cargo xtask sequences`.
#[derive(Debug, Clone, Copy, clap::Args)]
pub struct Args {
    /// Sequences on the controller in this process
    #[arg(long, default_value_t = 20_000)]
    pub sequences: u64,
    /// Sequences on the firmware in QEMU, after them
    #[arg(long, default_value_t = 0)]
    pub qemu: u64,
    /// First seed: each sequence has its own, one after the other
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
}

/// Counts without a violation.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Survived {
    /// In this process, and the time that took.
    pub in_process: Option<(CampaignCounts, Duration)>,
    /// On the firmware in QEMU, and the time that took.
    pub in_qemu: Option<(CampaignCounts, Duration)>,
}

impl fmt::Display for Survived {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let rows = [("in process", self.in_process), ("in QEMU", self.in_qemu)];
        for (name, (tally, took)) in rows.into_iter().filter_map(|(name, done)| Some((name, done?))) {
            writeln!(f, "{name:<11}  {tally}, in {:.0} s", took.as_secs_f64())?;
        }
        f.write_str("no force, travel, duty or latched fault was got round, and every fault was left by its documented way")
    }
}

/// Runs both.
///
/// # Errors
/// The first violation, with the seed of its sequence; or where the bench fails.
pub fn run(args: Args) -> Result<Survived> {
    let mut survived = Survived::default();
    if args.sequences > 0 {
        survived.in_process = Some(timed(|| in_process(args.seed, args.sequences))?);
    }
    if args.qemu > 0 {
        survived.in_qemu = Some(timed(|| in_qemu(args.seed, args.qemu))?);
    }
    Ok(survived)
}

fn timed(run: impl FnOnce() -> Result<CampaignCounts>) -> Result<(CampaignCounts, Duration)> {
    let began = Instant::now();
    Ok((run()?, began.elapsed()))
}

/// On all processors, a sequence at a time.
fn in_process(seed: u64, sequences: u64) -> Result<CampaignCounts> {
    on_all_processors(sequences, |index| {
        run_in_process(seed.wrapping_add(index)).map_err(|violation| anyhow!("{violation}"))
    })
}

/// On all processors, a device with its power-on at a time.
fn in_qemu(seed: u64, sequences: u64) -> Result<CampaignCounts> {
    let (finished, reported) = (AtomicU64::new(0), Mutex::new(Instant::now()));
    on_all_processors(sequences.div_ceil(SEQUENCES_PER_BOOT), |boot| {
        let first = boot * SEQUENCES_PER_BOOT;
        let count = SEQUENCES_PER_BOOT.min(sequences - first);
        let tally = device::boot(seed.wrapping_add(first), count)?;
        let finished_count = finished.fetch_add(count, Ordering::Relaxed) + count;
        if let Ok(mut reported) = reported.lock()
            && reported.elapsed() > REPORT_INTERVAL
        {
            *reported = Instant::now();
            eprintln!("{finished_count} of {sequences} sequences in QEMU");
        }
        Ok(tally)
    })
}

/// Does so many parts, one after the other on each processor, up to the first that fails.
fn on_all_processors(
    parts: u64,
    part: impl Fn(u64) -> Result<CampaignCounts> + Sync,
) -> Result<CampaignCounts> {
    let (next, ends, failed) = (AtomicU64::new(0), AtomicBool::new(false), Mutex::new(None));
    let worker = || {
        let mut tally = CampaignCounts::default();
        while !ends.load(Ordering::Relaxed) {
            let index = next.fetch_add(1, Ordering::Relaxed);
            if index >= parts {
                break;
            }
            match part(index) {
                Ok(of_one) => tally.add(of_one),
                Err(error) => {
                    ends.store(true, Ordering::Relaxed);
                    if let Ok(mut failed) = failed.lock() {
                        failed.get_or_insert(error);
                    }
                }
            }
        }
        tally
    };
    let mut totals = CampaignCounts::default();
    thread::scope(|scope| -> Result<()> {
        let count = thread::available_parallelism()?.get();
        let workers: Vec<_> = (0..count).map(|_| scope.spawn(worker)).collect();
        for worker in workers {
            totals.add(worker.join().map_err(|_| anyhow!("a sequence panicked"))?);
        }
        Ok(())
    })?;
    match failed.into_inner() {
        Ok(None) => Ok(totals),
        Ok(Some(error)) => Err(error),
        Err(_) => bail!("a sequence panicked"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_run_counts_what_it_did() {
        let survived = run(Args { sequences: 12, qemu: 0, seed: 5 }).unwrap();
        let (tally, _) = survived.in_process.unwrap();
        assert_eq!(tally.sequences, 12);
        assert!(tally.acts >= 12 && tally.commands > tally.acts && tally.device_ms > 1_000, "{tally}");
        assert_eq!(survived.in_qemu, None);
    }
}
