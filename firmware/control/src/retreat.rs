//! Retreat: a slow motion that unloads the guide while a fault is latched and the load is the only cause to stop, for as long as
//! the load falls.
//!
//! Without it a lead screw would hold the guide under the load, and the cause of the fault would last for ever. A retreat leads
//! towards the middle of the travel, where the needle is straight, and nowhere else. It ends at its target, once the load is below
//! the limit, or when further motion does not reduce the load; in the last case the needle's clamp has to be opened.
//!
//! * **The load** is the magnitude of the force from the calibration's zero, as a mean over [`BLOCK_PERIODS`]: whole periods of the
//!   mains at 50 Hz and at 60 Hz, so that hum cancels and white noise of 0.02 N becomes 2 mN. The force is a vector over
//!   both axes: where the axes are coupled, its magnitude can fall although the force along one of them rises.
//! * **It rises**: a mean that exceeds the smallest one since the fault (or since the last rise) by [`RISE_PERCENT`] of the rated
//!   range ends the retreat. After two such rises no further retreat moves. One rise may be a sensor that failed in the meantime;
//!   many rises would increase the load step by step where something else presses or the tables have the wrong sign. The first
//!   mean of a retreat is taken at rest: it excludes the coasting of the motor, and includes the load that an interrupted retreat
//!   has added. If a rise has ended a retreat, the coasting of the motor after it belongs to that rise.
//! * **It does not fall**: a straight line through the latest [`TREND_BLOCKS`] means has to fall by [`PROGRESS_PERCENT`] of the
//!   rated range, ten times the standard error of the line. The means are 25 um apart and span 0.3 mm, more than the play of
//!   the mechanism.
//! * **It is unknown** while there are no valid readings (saturated converter). Then a retreat moves only axes that have already
//!   moved in their driven direction.

use super::axis::Axis;
use super::force::ForceChannel;
use super::interlock::StopCauses;
use super::mutation::Mutation;
use super::program::Phase;
use super::{Controller, OutboundMessage, OutboundMessages, event, push};
use crate::calibration::counts_of_mn;
use heapless::HistoryBuf;
use protocol::{EventKind, RETREAT_LIMIT_UM, Refusal, RetreatOutcome};

/// Control periods of a mean: five cycles of 50 Hz, six of 60 Hz.
pub const BLOCK_PERIODS: u16 = 100;
/// Largest rise of the load above its minimum, percent of the rated range: 25 times the noise of a mean.
const RISE_PERCENT: f32 = 1.0;
/// Number of rises of the load that are allowed after one fault.
const RISES: u8 = 2;
/// Number of means from which the trend is computed.
const TREND_BLOCKS: usize = 12;
/// Smallest fall of the load over these means, percent of the rated range.
const PROGRESS_PERCENT: f32 = 0.4;
/// Longest wait for the guide to come to rest, microseconds. A guide that still moves then does not stop by itself.
const REST_LIMIT_US: u64 = 1_000_000;
/// Share of the limit below which the guide counts as unloaded: soft tissue takes up a part of the load again once the guide rests.
const UNLOADED: f32 = 0.85;

/// Mean force from the calibration's zero along x and y, force counts.
pub type Mean = [f32; 2];

/// Takes the mean of the force over whole periods of the mains.
#[derive(Debug, Clone, Copy, Default)]
pub struct LoadMeter {
    sums: [i32; 2],
    readings: u16,
    periods: u16,
}

impl LoadMeter {
    /// Takes a period. At the end of every [`BLOCK_PERIODS`] returns their mean, or `Some(None)` if fewer than half of them have an
    /// accepted reading.
    pub fn step(&mut self, force: &ForceChannel) -> Option<Option<Mean>> {
        if force.is_accepted() {
            for (sum, counts) in self.sums.iter_mut().zip(force.absolute_counts()) {
                *sum = sum.saturating_add(counts);
            }
            self.readings += 1;
        }
        self.periods += 1;
        if self.periods < BLOCK_PERIODS {
            return None;
        }
        let block = core::mem::take(self);
        let is_read = block.readings >= BLOCK_PERIODS / 2;
        Some(is_read.then(|| block.sums.map(|sum| sum as f32 / f32::from(block.readings))))
    }
}

/// Trend of the load.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Trend {
    /// Falling, or not yet decided: the retreat goes on.
    Falling,
    /// Below the limit, and either with a margin or no longer falling.
    Unloaded,
    /// Rising or not falling: the retreat stops.
    NotFalling,
}

/// Follows the load from a fault on, over its retreats.
#[derive(Debug, Clone)]
pub struct LoadWatch {
    /// Smallest load since the fault or since the last rise, counts.
    least: f32,
    latest: HistoryBuf<f32, TREND_BLOCKS>,
    /// Number of times it has risen since the fault.
    rises: u8,
    /// Whether a rise has ended the latest retreat.
    has_ended: bool,
}

impl LoadWatch {
    /// State at a new fault, whose load is still unknown.
    #[expect(clippy::new_without_default, reason = "made where a fault is latched")]
    pub const fn new() -> Self {
        Self { least: f32::INFINITY, latest: HistoryBuf::new(), rises: 0, has_ended: false }
    }

    /// Takes a mean. `range`: rated range of the cell, counts; `moves`: the mean is from the motion of a retreat, not from the rest
    /// before it.
    pub fn step(&mut self, [x, y]: Mean, range: f32, moves: bool) -> Trend {
        let load = libm::hypotf(x, y);
        let has_risen = load - self.least > range * RISE_PERCENT * 1e-2;
        let has_coasted = !moves && core::mem::take(&mut self.has_ended);
        if has_risen && !has_coasted {
            self.rises = self.rises.saturating_add(1);
        }
        self.has_ended |= has_risen && moves;
        self.least = if has_risen { load } else { self.least.min(load) };
        if !moves {
            self.latest = HistoryBuf::new();
        }
        self.latest.write(load);
        let used_up = self.rises >= RISES && !Mutation::RetreatsClimb.is_out();
        let stays = self.latest.is_full() && self.fall() < range * PROGRESS_PERCENT * 1e-2;
        if used_up || stays || (moves && has_risen) { Trend::NotFalling } else { Trend::Falling }
    }

    /// Fall of the least-squares line over the latest means.
    fn fall(&self) -> f32 {
        const N: f32 = TREND_BLOCKS as f32;
        let mut moment = 0.0;
        for (number, load) in (0_u8..).zip(self.latest.oldest_ordered()) {
            moment += (f32::from(number) - (N - 1.0) / 2.0) * load;
        }
        // The sum of the squared distances from the middle of N places is N (N^2 - 1) / 12.
        -moment * 12.0 / (N * N - 1.0)
    }
}

impl Controller {
    /// Starts to unload the guide, as soon as it is at rest.
    pub(super) fn begin_retreat(
        &mut self,
        by_um: [i32; 2],
        now_us: u64,
        causes: StopCauses,
    ) -> Result<(), Refusal> {
        self.while_idle()?;
        if self.restarting {
            return Err(Refusal::Busy);
        }
        if by_um == [0; 2] || by_um.into_iter().any(|um| um.unsigned_abs() > RETREAT_LIMIT_UM as u32) {
            return Err(Refusal::OutOfRange);
        }
        let under_load = self.interlock.latched().is_some() && causes.load() && !causes.other_than_load();
        if !under_load || Mutation::NoRetreat.is_out() {
            return Err(Refusal::NotUnderLoad);
        }
        self.retreat_by_um = by_um;
        self.retreat_path()?;
        if !self.force.is_fresh() && !self.is_proven() && !Mutation::BlindTurned.is_out() {
            return Err(Refusal::OutOfTravel);
        }
        self.load_meter = LoadMeter::default();
        self.executor.await_rest(now_us);
        Ok(())
    }

    /// Start and target of the retreat, which never passes the middle of the travel.
    fn retreat_path(&self) -> Result<([f32; 2], [f32; 2]), Refusal> {
        let start_um = self.axes.each_ref().map(Axis::position_um);
        let mut target_um = start_um;
        for (um, by_um) in target_um.iter_mut().zip(self.retreat_by_um) {
            let retreat_um = by_um as f32;
            if *um * retreat_um > 0.0 && !Mutation::BlindRetreat.is_out() {
                return Err(Refusal::OutOfTravel);
            }
            *um = if retreat_um.abs() > um.abs() && *um * retreat_um <= 0.0 { 0.0 } else { *um + retreat_um };
        }
        Ok((start_um, target_um))
    }

    /// Whether every axis that is to move has moved in its driven direction before.
    fn is_proven(&self) -> bool {
        self.watches.iter().zip(self.retreat_by_um).all(|(watch, by_um)| by_um == 0 || watch.is_proven())
    }

    /// Starts the motion of a retreat, follows the load during it, and ends it.
    pub(super) fn follow_load(&mut self, causes: StopCauses, now_us: u64, notes: &mut OutboundMessages) {
        if self.executor.phase() != Phase::Retreating {
            return;
        }
        if causes.other_than_load() {
            return self.end_retreat(RetreatOutcome::Stopped, now_us, notes);
        }
        let waited_us = self.executor.awaits_rest_us(now_us);
        if let Some(waited_us) = waited_us
            && !self.is_still()
        {
            self.load_meter = LoadMeter::default();
            if waited_us >= REST_LIMIT_US {
                self.end_retreat(RetreatOutcome::Stopped, now_us, notes);
            }
            return;
        }
        let Some(mean) = self.load_meter.step(&self.force) else { return };
        let outcome = match self.trend(mean, causes, waited_us.is_none()) {
            Trend::Unloaded => Err(RetreatOutcome::Unloaded),
            Trend::NotFalling => Err(RetreatOutcome::ForceNotFalling),
            Trend::Falling if waited_us.is_none() => Ok(()),
            Trend::Falling => match self.retreat_path() {
                Ok((from_um, to_um)) => {
                    self.executor.retreat(from_um, to_um, now_us);
                    Ok(())
                }
                // A coasting axis has passed the middle, to which the retreat was to lead.
                Err(_) => Err(RetreatOutcome::Moved),
            },
        };
        if let Err(outcome) = outcome {
            self.end_retreat(outcome, now_us, notes);
        }
    }

    /// Trend of the load after a mean, or after a missing mean.
    fn trend(&mut self, mean: Option<Mean>, causes: StopCauses, moves: bool) -> Trend {
        let Some(mean) = mean else {
            let goes_on = self.is_proven() || Mutation::BlindTurned.is_out();
            return if goes_on { Trend::Falling } else { Trend::NotFalling };
        };
        let range_mn = self.calibration.force_range_mn();
        let unloaded = UNLOADED * counts_of_mn(self.interlock.limits().force_mn.min(range_mn)) as f32;
        let tared = mean.into_iter().zip(self.force.zero_counts()).map(|(mean, zero)| mean - zero as f32);
        // Single readings have to be below the limit too, as otherwise the fault could not be cleared.
        if !causes.load() && mean.into_iter().chain(tared).all(|force| force.abs() < unloaded) {
            return Trend::Unloaded;
        }
        match self.load_watch.step(mean, counts_of_mn(range_mn) as f32, moves) {
            // The load is below the limit, though not by the margin: the remainder is the offset of the cell, or a tare.
            Trend::NotFalling if !causes.load() => Trend::Unloaded,
            trend => trend,
        }
    }

    /// Ends a retreat.
    pub(super) fn end_retreat(&mut self, outcome: RetreatOutcome, now_us: u64, notes: &mut OutboundMessages) {
        self.executor.abort();
        self.axes.iter_mut().for_each(Axis::rest);
        push(notes, OutboundMessage::Event(event(now_us, EventKind::RetreatEnded { outcome })));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use noise::Noise;

    const RANGE: f32 = 100_000.0;

    /// Trend of means that start at 5.1 N and change by this number of counts each, and the number of means until it is decided.
    fn trend_of(by_counts: f32) -> (Trend, usize) {
        let mut watch = LoadWatch::new();
        let load = |block: usize| [0.0, 102_000.0 + by_counts * block as f32];
        let mut trends = (0..40).map(|block| watch.step(load(block), RANGE, block > 0));
        let not_falling = trends.position(|trend| trend != Trend::Falling);
        not_falling.map_or((Trend::Falling, 40), |after| (Trend::NotFalling, after + 1))
    }

    #[test]
    fn a_retreat_continues_while_the_load_falls_and_stops_otherwise() {
        // A mean is 25 um: 0.1 N/mm are 50 counts.
        assert_eq!(trend_of(-50.0), (Trend::Falling, 40));
        assert_eq!(trend_of(-30.0), (Trend::NotFalling, TREND_BLOCKS));
        assert_eq!(trend_of(0.0), (Trend::NotFalling, TREND_BLOCKS));
        assert_eq!(trend_of(500.0), (Trend::NotFalling, 4));
    }

    /// Retreats into a load of 1 N/mm, 25 um per mean, which end by themselves or are stopped after a few means.
    #[test]
    fn repeated_retreats_do_not_increase_the_load_without_bound() {
        for means in [1, 2, 40] {
            let (mut watch, mut load) = (LoadWatch::new(), 100_000.0);
            for _ in 0..100 {
                for mean in 0..means {
                    if watch.step([0.0, load], RANGE, mean > 0) == Trend::NotFalling {
                        break;
                    }
                    load += 500.0;
                }
            }
            assert!((101_000.0..104_400.0).contains(&load), "{load} in retreats of {means}");
        }
    }

    /// The load rises in a retreat, and rises further while the motor coasts: that is one rise.
    #[test]
    fn coasting_after_a_rise_is_no_second_rise() {
        let mut watch = LoadWatch::new();
        let mut step = |load: f32, moves| watch.step([0.0, load], RANGE, moves);
        assert_eq!(step(44_000.0, false), Trend::Falling);
        assert_eq!(step(34_000.0, true), Trend::Falling);
        assert_eq!(step(40_000.0, true), Trend::NotFalling);
        assert_eq!(step(42_000.0, false), Trend::Falling, "the next retreat starts");
        assert_eq!(step(41_000.0, true), Trend::Falling);
        assert_eq!(step(43_000.0, true), Trend::NotFalling);
        assert_eq!(step(43_000.0, false), Trend::NotFalling, "it has risen twice");
    }

    #[test]
    fn a_load_falls_by_its_magnitude_though_it_rises_along_one_axis() {
        let mut watch = LoadWatch::new();
        let mut trends = (0..40_u8)
            .map(f32::from)
            .map(|block| watch.step([9e4 + 100.0 * block, 9e4 - 1e3 * block], RANGE, block > 0.0));
        assert!(trends.all(|trend| trend == Trend::Falling));
    }

    /// The hum of 0.1 N at 50 Hz or 60 Hz and noise of 0.02 N, on a load that falls by 0.1 N/mm, or stays.
    #[test]
    fn hum_and_noise_change_no_decision() {
        let mut random = Noise::new(7);
        let mut noise = || random.normal() as f32;
        let calibration = crate::calibration::Calibration::default();
        for hertz in [50.0, 60.0] {
            for (fall, lasts) in [(0.5, 40), (0.0, TREND_BLOCKS)] {
                let (mut meter, mut watch, mut force) =
                    (LoadMeter::default(), LoadWatch::new(), ForceChannel::new());
                let mut blocks = 0;
                for period in 0..40 * u32::from(BLOCK_PERIODS) {
                    let hum = 2_000.0 * libm::sinf(core::f32::consts::TAU * hertz * period as f32 * 1e-3);
                    let counts = 80_000.0 - fall * period as f32 + hum + 400.0 * noise();
                    // 50 uN a count, 1.118 uN a code.
                    force.update(&calibration, &Ok([0, (counts * 44.739) as i32]));
                    let Some(mean) = meter.step(&force) else { continue };
                    blocks += 1;
                    let mean = mean.expect("every period has a reading");
                    if watch.step(mean, RANGE, blocks > 1) != Trend::Falling {
                        break;
                    }
                }
                assert_eq!(blocks, lasts, "{hertz} Hz, {fall} counts a period");
            }
        }
    }
}
