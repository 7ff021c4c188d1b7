//! Out of a load while its fault is latched: a short, slow motion that ends as soon as the force does not fall.
//!
//! A lead screw holds the guide where the load stopped it, so that the cause of the fault would stay for ever. The host states which
//! way; the device ensures that it leads out: every [`PROGRESS_UM`] must take [`PROGRESS_PERCENT`] of the rated range off the
//! load, of which none may be more than [`RISE_PERCENT`] above its least so far. Where the converter is saturated there is no
//! force to watch: then only the way towards the straight needle is open, and another one that is under way ends.
//!
//! Retreats must not add up to a way into the load: what they add in one direction is counted over the fault ([`AddedLoad`](super::added_load::AddedLoad)), and a
//! direction that has added [`RISE_PERCENT`] is refused until the fault is cleared. What the motor rolls on is part of it.
//!
//! A retreat that is accepted while a motor still rolls on, from the motion that caused the fault or from the retreat before, sets out when
//! both axes are at rest: what rolls on would be counted for its direction, and hasty retreats along x and y in turn would use up the
//! way out.
//!
//! A retreat ends where the axes that it moves are unloaded, though another one still is not: it would lead to their other side.
//!
//! Both follow each of the four [`Loads`] by itself: a larger force along y must not hide one along x that rises up to it.

use super::axis::Axis;
use super::force::{LOADS, Loads};
use super::interlock::StopCauses;
use super::limits::STALE_LIMIT_PERIODS;
use super::mutation::Mutation;
use super::program::Phase;
use super::{Controller, OutboundMessage, OutboundMessages, event, push};
use crate::calibration::counts_of_mn;
use protocol::{EventKind, RETREAT_LIMIT_UM, Refusal, RetreatOutcome};

/// The load may rise above its least by this, percent of the rated range: ten times the noise of a cell.
pub const RISE_PERCENT: u32 = 1;
/// Way in which the load must have fallen, micrometres: beyond the play of the mechanism.
pub const PROGRESS_UM: f32 = 300.0;
/// By how much, percent of the rated range.
pub const PROGRESS_PERCENT: f32 = 0.4;
/// A guide that is not at rest by then does not stop by itself, microseconds.
const REST_LIMIT_US: u64 = 1_000_000;
/// Share of the limit below which the guide counts as unloaded: soft tissue takes up a part of the load again once the guide rests.
pub const UNLOADED: f32 = 0.85;

/// What the loads are compared with, force counts.
#[derive(Debug, Clone, Copy)]
pub struct Bounds {
    pub(super) unloaded: i32,
    pub(super) rise: i32,
    progress: i32,
}

impl Bounds {
    /// For a limit and a rated range.
    pub fn new(limit_mn: u32, range_mn: u32) -> Self {
        let range = counts_of_mn(range_mn) as f32;
        Self {
            unloaded: (UNLOADED * counts_of_mn(limit_mn.min(range_mn)) as f32) as i32,
            rise: (range * RISE_PERCENT as f32 * 1e-2) as i32,
            progress: (range * PROGRESS_PERCENT * 1e-2) as i32,
        }
    }
}

/// What the load does.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Trend {
    /// Go on.
    Falling,
    /// Below the limit, with a margin.
    Unloaded,
    /// Stop.
    NotFalling,
}

/// The load on the way.
#[derive(Debug, Clone)]
pub struct LoadWatch {
    /// Where the load was last compared, and what its largest value was, counts.
    mark: Option<([f32; 2], i32)>,
    least: [i32; LOADS],
    /// It leads towards the straight needle on every axis that it moves.
    inward: bool,
    /// Axes that it moves and that were loaded when it began: once they no longer are, it would only lead to their other side.
    unloads: Option<[bool; 2]>,
    by_um: [i32; 2],
    /// Periods in a row without a reading.
    unread: u16,
}

impl LoadWatch {
    /// At the start of a retreat by a vector, micrometres, that leads towards the straight needle, or not.
    pub const fn new(by_um: [i32; 2], inward: bool) -> Self {
        Self { mark: None, least: [i32::MAX; LOADS], inward, unloads: None, by_um, unread: 0 }
    }

    /// Takes the loads of a period, in force counts (nothing where the converter gives none), and where the guide is.
    ///
    /// Each load is followed by itself: the largest alone would hide what rises on the other axis up to it.
    pub fn step(&mut self, loads: Option<Loads>, position_um: [f32; 2], bounds: Bounds) -> Trend {
        let Some(loads) = loads else {
            self.unread = self.unread.saturating_add(1);
            // A converter that saturates on the way leaves nothing to follow.
            let goes_on =
                self.inward || self.unread <= STALE_LIMIT_PERIODS || Mutation::BlindRetreat.is_out();
            return if goes_on { Trend::Falling } else { Trend::NotFalling };
        };
        self.unread = 0;
        let largest = loads.into_iter().max().unwrap_or(0);
        if largest < bounds.unloaded {
            return Trend::Unloaded;
        }
        for (load, least) in loads.into_iter().zip(&mut self.least) {
            let load = load.max(bounds.unloaded);
            *least = load.min(*least);
            if load - *least > bounds.rise {
                return Trend::NotFalling;
            }
        }
        // Whatever it still takes off another axis: after a tare far from zero its own load comes back on the other side soon.
        if self.has_unloaded_its_axes(loads, bounds) {
            return Trend::NotFalling;
        }
        let (from_um, before) = *self.mark.get_or_insert((position_um, largest));
        let ([x, y], [from_x, from_y]) = (position_um, from_um);
        if libm::hypotf(x - from_x, y - from_y) >= PROGRESS_UM {
            if before - largest < bounds.progress {
                return Trend::NotFalling;
            }
            self.mark = Some((position_um, largest));
        }
        Trend::Falling
    }

    /// No axis is loaded any more that it moves and that was.
    fn has_unloaded_its_axes(&mut self, [x, y, tared_x, tared_y]: Loads, bounds: Bounds) -> bool {
        let [by_x, by_y] = self.by_um.map(|um| um != 0);
        let loaded = [by_x && x.max(tared_x) >= bounds.unloaded, by_y && y.max(tared_y) >= bounds.unloaded];
        let unloads = *self.unloads.get_or_insert(loaded);
        unloads != [false; 2] && unloads.into_iter().zip(loaded).all(|(unloads, loaded)| !unloads || !loaded)
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
        if self.is_still() || Mutation::HastyRetreat.is_out() {
            return self.set_out(now_us);
        }
        self.retreat_path()?;
        if !self.added_load.allows(by_um, self.force.loads(), self.retreat_bounds()) {
            return Err(Refusal::OutOfTravel);
        }
        self.executor.await_rest(now_us);
        Ok(())
    }

    /// Where the retreat begins and ends, and whether it leads towards the straight needle on every axis that it moves.
    fn retreat_path(&self) -> Result<([f32; 2], [f32; 2], bool), Refusal> {
        let from_um = self.axes.each_ref().map(Axis::position_um);
        let travel_um = self.calibration.travel_um() as f32;
        // Without a force to watch, only towards the straight needle.
        let blind = self.force.loads().is_none();
        let (mut to_um, mut leads_inward) = (from_um, true);
        for (to_um, by_um) in to_um.iter_mut().zip(self.retreat_by_um) {
            let from_um = *to_um;
            *to_um += by_um as f32;
            let inward = to_um.abs() < from_um.abs() && *to_um * from_um >= 0.0;
            let stays = by_um == 0;
            leads_inward &= stays || inward;
            if !stays && !inward && (blind || to_um.abs() > travel_um) {
                return Err(Refusal::OutOfTravel);
            }
        }
        Ok((from_um, to_um, leads_inward))
    }

    /// Starts the motion of a retreat.
    fn set_out(&mut self, now_us: u64) -> Result<(), Refusal> {
        let (from_um, to_um, leads_inward) = self.retreat_path()?;
        let (by_um, loads, bounds) = (self.retreat_by_um, self.force.loads(), self.retreat_bounds());
        if !self.added_load.begin(by_um, from_um, loads, bounds) {
            return Err(Refusal::OutOfTravel);
        }
        self.retreat = LoadWatch::new(by_um, leads_inward);
        self.executor.retreat(from_um, to_um, now_us);
        Ok(())
    }

    /// A retreat that was accepted while a motor still rolled on: what that adds to the load is not the retreat's, and would close
    /// the way out. True while it waits, or has just ended.
    pub(super) fn awaits_rest(&mut self, now_us: u64, notes: &mut OutboundMessages) -> bool {
        let Some(waited_us) = self.executor.awaits_rest_us(now_us) else { return false };
        if !self.is_still() {
            if waited_us >= REST_LIMIT_US {
                self.end_retreat(RetreatOutcome::Stopped, now_us, notes);
            }
            return true;
        }
        // What rolled on may have led out of the travel, or have used the direction up.
        let stays = self.set_out(now_us).is_err();
        if stays {
            self.end_retreat(RetreatOutcome::ForceNotFalling, now_us, notes);
        }
        stays
    }

    /// Ends a retreat that has done its work, or does harm.
    pub(super) fn follow_load(&mut self, causes: StopCauses, now_us: u64, notes: &mut OutboundMessages) {
        let position_um = self.axes.each_ref().map(Axis::position_um);
        self.added_load.follow(self.force.loads(), position_um, self.retreat_bounds());
        if self.executor.phase() != Phase::Retreating {
            return;
        }
        if causes.other_than_load() {
            return self.end_retreat(RetreatOutcome::Stopped, now_us, notes);
        }
        if self.executor.awaits_rest_us(now_us).is_some() {
            return;
        }
        // With a force to follow it decides, whatever went before.
        if self.force.loads().is_none() && self.added_load.is_blind_used_up() {
            return self.end_retreat(RetreatOutcome::ForceNotFalling, now_us, notes);
        }
        match self.retreat.step(self.force.loads(), position_um, self.retreat_bounds()) {
            Trend::Falling => {}
            Trend::Unloaded => self.end_retreat(RetreatOutcome::Unloaded, now_us, notes),
            Trend::NotFalling => self.end_retreat(RetreatOutcome::ForceNotFalling, now_us, notes),
        }
    }

    /// Ends a retreat.
    pub(super) fn end_retreat(&mut self, outcome: RetreatOutcome, now_us: u64, notes: &mut OutboundMessages) {
        self.executor.abort();
        self.axes.iter_mut().for_each(Axis::rest);
        self.added_load.end();
        push(notes, OutboundMessage::Event(event(now_us, EventKind::RetreatEnded { outcome })));
    }

    fn retreat_bounds(&self) -> Bounds {
        Bounds::new(self.interlock.limits().force_mn, self.calibration.force_range_mn())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BOUNDS: fn() -> Bounds = || Bounds::new(5_000, 5_000);

    /// Moves by 1 um a step from 5.1 N on; the load changes by so many counts a micrometre (20 counts are 1 N/mm).
    fn way(counts_per_um: f32) -> (Trend, u32) {
        let mut watch = LoadWatch::new([0, 1_000], false);
        for um in 0..1_000_u32 {
            let load = (102_000.0 + counts_per_um * um as f32) as i32;
            let trend = watch.step(Some([0, load, 0, load]), [0.0, um as f32], BOUNDS());
            if trend != Trend::Falling {
                return (trend, um);
            }
        }
        (Trend::Falling, 1_000)
    }

    #[test]
    fn a_larger_load_along_y_hides_nothing_that_rises_along_x() {
        let mut watch = LoadWatch::new([0, 1_000], false);
        let trend = |watch: &mut LoadWatch, x, y, um| watch.step(Some([x, y, 0, 0]), [um, 0.0], BOUNDS());
        assert_eq!(trend(&mut watch, 95_000, 110_000, 0.0), Trend::Falling);
        assert_eq!(trend(&mut watch, 95_900, 109_000, 1.0), Trend::Falling);
        assert_eq!(trend(&mut watch, 96_100, 108_000, 2.0), Trend::NotFalling);
    }

    /// Along y, from 0.37 N with a tare at 0.47 N and a limit of 0.3 N: between the two zeros both loads are below the bound for 45 um.
    /// The load along x stays.
    #[test]
    fn a_retreat_ends_where_its_axis_is_unloaded_though_the_largest_load_has_fallen() {
        let bounds = Bounds::new(300, 5_000);
        let mut watch = LoadWatch::new([0, 1_000], true);
        let mut trends = (0..1_000_u32).map(|um| {
            let y = 7_400 - 20 * um as i32;
            (watch.step(Some([6_300, y, 3_000, (9_303 - y).abs()]), [0.0, um as f32], bounds), um)
        });
        assert_eq!(trends.find(|(trend, _)| *trend != Trend::Falling), Some((Trend::NotFalling, 116)));
    }

    #[test]
    fn the_way_out_is_gone_to_its_end_and_the_wrong_one_is_not() {
        // 102000 to 85000 counts at 20 a micrometre.
        assert_eq!(way(-20.0), (Trend::Unloaded, 851));
        assert_eq!(way(-2.0), (Trend::Falling, 1_000));
        assert_eq!(way(0.0), (Trend::NotFalling, 300));
        assert_eq!(way(-0.5), (Trend::NotFalling, 300));
        assert_eq!(way(20.0), (Trend::NotFalling, 51));
    }

    #[test]
    fn a_converter_that_saturates_on_the_way_ends_what_does_not_lead_to_the_straight_needle() {
        let after = |inward: bool, periods: u16| {
            let mut watch = LoadWatch::new([0, -1_000], inward);
            assert_eq!(watch.step(Some([102_000; LOADS]), [0.0; 2], BOUNDS()), Trend::Falling);
            (0..periods).map(|_| watch.step(None, [0.0; 2], BOUNDS())).last()
        };
        assert_eq!(after(false, STALE_LIMIT_PERIODS), Some(Trend::Falling));
        assert_eq!(after(false, STALE_LIMIT_PERIODS + 1), Some(Trend::NotFalling));
        assert_eq!(after(true, 10 * STALE_LIMIT_PERIODS), Some(Trend::Falling));
    }

    #[test]
    fn without_a_reading_nothing_is_compared() {
        let mut watch = LoadWatch::new([0, 1_000], false);
        assert_eq!(watch.step(None, [0.0; 2], BOUNDS()), Trend::Falling);
        assert_eq!(watch.step(None, [0.0, 900.0], BOUNDS()), Trend::Falling);
        assert_eq!(watch.step(Some([102_000; LOADS]), [0.0, 900.0], BOUNDS()), Trend::Falling);
    }
}
