//! The online estimator on the target, in QEMU: processes a recorded stream, and logs every estimate and the number of instructions
//! per update.
//!
//! The recording `stream.bin` holds, in single precision: length and moving mass of the needle; wave number, frequency and four
//! factors of each of five modes; then samples of time, depth, base, force and tip, in SI units.
#![no_std]
#![no_main]

use cortex_m::Peripherals;
use estimator::needle::Mode;
use estimator::{Sample, Settings, Tracker};
use firmware::qemu::{ExitCode, Recording, Stopwatch, exit};
use static_cell::StaticCell;

/// The estimator with 5 modes, 45 cells of 2 mm (90 mm of tissue), 18 parameters and 128 rows.
type TargetTracker = Tracker<f32, 5, 45, 18, 128>;

static TRACKER: StaticCell<TargetTracker> = StaticCell::new();

#[cortex_m_rt::entry]
fn main() -> ! {
    let Some(mut peripherals) = Peripherals::take() else { exit(ExitCode::Fault) };
    let Some((tracker, mut recording)) = start() else {
        defmt::error!("no recording: stream.bin cannot be opened or has no needle");
        exit(ExitCode::PlantGone)
    };
    let stopwatch = Stopwatch::start(&mut peripherals.SYST);
    let (mut updates, mut sum, mut most) = (0_u32, 0_u64, 0_u32);
    while let Some([time_s, depth_m, base_m, force_n, tip_m]) = recording.numbers() {
        let sample = Sample { time_s, depth_m, base_m, force_n, tip_m };
        let (outcome, ticks) = stopwatch.ticks(|| tracker.update(&sample));
        updates += 1;
        sum += u64::from(ticks);
        most = most.max(ticks);
        match outcome {
            Ok(Some(estimate)) => defmt::info!(
                "estimate {=f32} {=f32} {=f32} {=f32} {=f32}",
                estimate.depth_m,
                estimate.stiffness.value,
                estimate.stiffness.low,
                estimate.stiffness.high,
                estimate.tip_m
            ),
            Ok(None) => {}
            Err(_) => defmt::error!("sample {=u32} refused", updates),
        }
    }
    defmt::info!(
        "cost {=u32} updates, {=u32} instructions on average, {=u32} at most; {=u32} bytes",
        updates,
        stopwatch.instructions(sum / u64::from(updates.max(1))),
        stopwatch.instructions(u64::from(most)),
        size_of::<TargetTracker>() as u32
    );
    exit(ExitCode::PowerOff)
}

/// The estimator for the needle at the recording's beginning.
fn start() -> Option<(&'static mut TargetTracker, Recording)> {
    let mut recording = Recording::open(c"stream.bin")?;
    let [length_m, moving_mass_kg] = recording.numbers()?;
    let mut modes = [Mode { wave_number_per_m: 0.0, frequency_rad_s: 0.0, factors: [0.0; 4] }; 5];
    for mode in &mut modes {
        let [wave_number_per_m, frequency_rad_s, a, b, c, d] = recording.numbers()?;
        *mode = Mode { wave_number_per_m, frequency_rad_s, factors: [a, b, c, d] };
    }
    let tracker = TargetTracker::new(Settings::new(length_m, moving_mass_kg, modes))?;
    Some((TRACKER.init(tracker), recording))
}
