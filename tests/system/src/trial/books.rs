//! The books of a device's samples: each one that arrives is what the rig's sensors gave in its millisecond, each one that does
//! not is counted, and where no host was receiving the gap is known.

use crate::cosim::{Cosim, Period};
use anyhow::{Context, Result, ensure};
use control::calibration::Calibration;
use device::link::{Batch, Point};
use protocol::State;

/// Periods that a reading may be late while the converter is slow.
const SLOW_PERIODS: u64 = 3;

/// What has become of the samples.
#[derive(Debug)]
pub struct Books {
    calibration: Calibration,
    /// Period of the rig that is the zero of the device's clock.
    base: u64,
    /// Time that the next sample should have; `None` where the books have just been opened.
    next_ms: Option<u64>,
    /// Where the books of this start of the device end.
    until_ms: Option<u64>,
    /// Zero of the force channels in counts, and how often a tare may have changed it unreported.
    zero: [i32; 2],
    tares: u32,
    /// A zero that was reported, and the time of the last sample before it.
    reported: Option<(u64, [i32; 2])>,
    force: Option<[i32; 2]>,
    span_ms: u64,
    samples: u64,
    missing: u64,
    /// What a client that takes the books over has lost so far.
    lost: u64,
    unreceived: u64,
}

impl Books {
    /// The books of a device that has started in this period of the rig.
    pub fn new(base: u64) -> Self {
        Self {
            calibration: Calibration::default(),
            base,
            next_ms: None,
            until_ms: None,
            zero: [0; 2],
            tares: 0,
            reported: None,
            force: None,
            span_ms: 0,
            samples: 0,
            missing: 0,
            lost: 0,
            unreceived: 0,
        }
    }

    /// Time from the first sample to the last while the books were open, milliseconds.
    pub fn span_ms(&self) -> u64 {
        self.span_ms
    }

    /// Samples that arrived.
    pub fn samples(&self) -> u64 {
        self.samples
    }

    /// Samples that did not, each counted by the host.
    pub fn missing(&self) -> u64 {
        self.missing
    }

    /// Samples between two openings of the books.
    pub fn unreceived(&self) -> u64 {
        self.unreceived
    }

    /// Samples counted as lost since the last client took over.
    pub fn lost_of_client(&self) -> u64 {
        self.lost
    }

    /// The device's samples are not received for a while, or by another client from now on.
    pub fn reopen(&mut self, another_client: bool) {
        self.next_ms = None;
        self.force = None;
        if another_client {
            self.lost = 0;
        }
    }

    /// The device has started again in this period of the rig.
    pub fn restarted(&mut self, base: u64) {
        if let Some(until_ms) = self.until_ms.take() {
            self.unreceived += base.saturating_sub(self.base + until_ms);
        }
        (self.base, self.zero, self.tares, self.reported) = (base, [0; 2], 0, None);
        // The time since the start is part of the next gap.
        self.until_ms = Some(0);
        self.reopen(true);
    }

    /// A program with so many tares may have begun.
    pub fn tares_begin(&mut self, count: u32) {
        self.tares += count;
    }

    /// A tare is reported: the samples after that time have this zero.
    pub fn tared(&mut self, t_ms: u64, zero: [i32; 2]) {
        self.reported = Some((t_ms, zero));
        self.tares = self.tares.saturating_sub(1);
    }

    /// A tare was rejected: the zero is what it was.
    pub fn tare_rejected(&mut self) {
        self.tares = self.tares.saturating_sub(1);
    }

    /// Every sample is what the sensors gave, and every gap is as long as reported.
    ///
    /// # Errors
    /// Where one is not, or the bridges were on in a period that reports them off.
    pub fn compare(&mut self, batch: &Batch, rig: &Cosim) -> Result<()> {
        self.lost += batch.lost_before;
        let mut lost = batch.lost_before;
        for point in &batch.points {
            let t_ms = (point.time_s * 1e3).round() as u64;
            match self.next_ms {
                Some(next_ms) => {
                    ensure!(
                        t_ms == next_ms + lost,
                        "the sample of {t_ms} ms comes after that of {} ms, and {lost} are reported lost",
                        next_ms.saturating_sub(1)
                    );
                    self.missing += lost;
                    self.span_ms += lost;
                    if lost > 0 {
                        self.force = None;
                    }
                }
                None => {
                    if let Some(until_ms) = self.until_ms {
                        ensure!(t_ms >= until_ms, "the sample of {t_ms} ms comes after {until_ms} ms");
                        self.unreceived += t_ms - until_ms;
                    }
                }
            }
            lost = 0;
            self.next_ms = Some(t_ms + 1);
            self.until_ms = self.next_ms;
            self.samples += 1;
            self.span_ms += 1;
            self.is_as_sensed(t_ms, point, rig)?;
            let step = self.base + t_ms;
            if matches!(batch.state, State::Idle | State::Faulted)
                && let Some(period) = rig.period(step)
            {
                let slow = |step| rig.period(step).is_none_or(|period| period.slow);
                let late = (step.saturating_sub(SLOW_PERIODS)..=step).any(slow);
                ensure!(
                    period.released || late,
                    "at {t_ms} ms the device reports {:?}, and a bridge was on",
                    batch.state
                );
            }
        }
        Ok(())
    }

    /// The reading of a period is what the rig gave at its begin, in reply to the request before.
    fn is_as_sensed(&mut self, t_ms: u64, point: &Point, rig: &Cosim) -> Result<()> {
        let step = self.base + t_ms - 1;
        let sensed = rig
            .period(step)
            .with_context(|| format!("a sample of {t_ms} ms, which the rig does not have"))?;
        let late = if sensed.slow { SLOW_PERIODS } else { 0 };
        let candidates: Vec<Period> = (step..=step + late).filter_map(|step| rig.period(step)).collect();
        for axis in [0, 1] {
            let measured_um = (point.displacement_m[axis] * 1e6).round();
            let position = |period: &Period| {
                let position_um = self.calibration.position_um(period.potentiometer_codes, [0.5; 2]);
                f64::from(position_um[axis].round())
            };
            ensure!(
                candidates.iter().any(|period| position(period) == measured_um),
                "the sample of {t_ms} ms has {measured_um} um of axis {axis} where {} was sensed",
                position(&sensed)
            );
        }
        if let Some((_, zero)) = self.reported.take_if(|(reported_ms, _)| t_ms > *reported_ms) {
            self.zero = zero;
        }
        let measured = point.force_n.map(|force_n| (force_n / 50e-6).round() as i32);
        let relative = |period: &Period| {
            let counts = self.calibration.force_counts(period.force_codes);
            [0, 1].map(|axis| counts[axis] - self.zero[axis])
        };
        let found = candidates.iter().any(|period| relative(period) == measured);
        // What a converter does not give, or is too large to be valid, leaves the reading as it was.
        let is_repeated = |step| {
            rig.period(step).is_none_or(|period| {
                period.force_repeats || period.slow || period.force_codes.iter().any(|code| is_at_end(*code))
            })
        };
        let repeats = || {
            (step.saturating_sub(SLOW_PERIODS)..=step).any(is_repeated)
                && self.force.is_none_or(|before| before == measured)
        };
        if !found && !repeats() {
            let absolute = self.calibration.force_counts(sensed.force_codes);
            ensure!(
                self.tares > 0,
                "the sample of {t_ms} ms has a force of {measured:?} counts where {:?} was sensed",
                relative(&sensed)
            );
            // The tare's own event was lost; its effect is measured here.
            self.zero = [0, 1].map(|axis| absolute[axis] - measured[axis]);
            self.tares -= 1;
        }
        self.force = Some(measured);
        Ok(())
    }
}

/// A code at the end of the converter's range.
fn is_at_end(code: i32) -> bool {
    code == emulation::plant::FORCE_CODE_MAX || code == -emulation::plant::FORCE_CODE_MAX - 1
}
