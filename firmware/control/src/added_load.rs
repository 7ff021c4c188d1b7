//! What retreats have added to a load since its fault, so that many small ones are no way into it.

use super::force::{LOADS, Loads};
use super::limits::STALE_LIMIT_PERIODS;
use super::mutation::Mutation;
use super::retreat::Bounds;

/// Periods for which a motor may roll on after the end of a retreat: several times the lag of one.
const ROLLS_ON_PERIODS: u16 = 50;
/// Time constant of the loads that are compared, periods: single readings of a cell differ by a tenth of what a direction may add, and the
/// largest of hundreds by half of it, so that retreats out of a load would use up their own direction.
const SMOOTHED_PERIODS: f32 = 16.0;
/// The loads from the calibration's zero, which come first: those from a tare end with it at a restart.
const FROM_ZERO: usize = LOADS / 2;
/// Bytes of a kept [`AddedLoad`].
pub const ADDED_LOAD_BYTES: usize = 22;
/// How far retreats without a force to follow may lead away from the straight needle in all, micrometres: tables of the wrong sign
/// do that, and each retreat may be too short for [`Fault::WrongWay`](protocol::Fault::WrongWay).
const BLIND_UM: f32 = 100.0;

/// What retreats have added to the load since the fault, force counts, in the directions +x, -x, +y, -y.
///
/// What rises along an axis that a retreat moves is counted for that direction; what rises along the other one, by the coupling of
/// both, for the same. What counts is how much more presses once the retreat has ended: on its way a rise ends it
/// ([`LoadWatch`](super::retreat::LoadWatch)).
///
/// Each of the four [`Loads`] is counted by itself. After a tare far from the calibration's zero one falls where the other rises: a
/// direction that has added to one of them is the way out once that one is no load any more, because of a higher limit, or because a
/// restart has ended the tare.
///
/// No direction has added more to a load than all retreats together have added to it and not taken off again: where axes are coupled,
/// each way out adds a little to the load along the other axis, and both would be used up for ever. A load still is at most what it was
/// and what the four directions have added to it.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct AddedLoad {
    /// Of each direction, to each load.
    added: [[u16; LOADS]; 4],
    /// By how much all retreats have raised each load above the least they have left of it.
    excess: [u16; LOADS],
    /// What retreats without a force to follow have led away from the straight needle, micrometres.
    blind_um: f32,
    /// Loads without most of their noise, force counts; nothing before the first reading, and after a time without any: what it was then
    /// would be compared with what it is now.
    smoothed: Option<[f32; LOADS]>,
    /// Periods in a row without a reading.
    unread: u16,
    present: Option<Present>,
}

/// A retreat that is followed.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Present {
    by_um: [i32; 2],
    from_um: [f32; 2],
    /// Nothing where there was no reading.
    from: Option<[f32; LOADS]>,
    /// By how much larger each load is now.
    rise: [i32; LOADS],
    /// How far it has led away from the straight needle, micrometres; less than 0 where it has led to it.
    outward_um: f32,
    /// Periods for which it is still followed after its end.
    left: Option<u16>,
}

impl AddedLoad {
    /// Begins a retreat; false where one of its directions has been used up.
    pub fn begin(
        &mut self,
        by_um: [i32; 2],
        from_um: [f32; 2],
        loads: Option<Loads>,
        bounds: Bounds,
    ) -> bool {
        self.close();
        if !self.allows(by_um, loads, bounds) {
            return false;
        }
        // Below the bound nothing is a load.
        let smoothed = self.smoothed.filter(|_| loads.is_some());
        let from = smoothed.map(|loads| loads.map(|load| load.max(bounds.unloaded as f32)));
        self.present = Some(Present { by_um, from_um, from, rise: [0; LOADS], outward_um: 0.0, left: None });
        true
    }

    /// None of its directions has been used up.
    pub fn allows(&self, by_um: [i32; 2], loads: Option<Loads>, bounds: Bounds) -> bool {
        let used_up = |direction: usize| {
            let mut added = self.added.get(direction).into_iter().flatten();
            added.any(|added| i32::from(*added) >= bounds.rise)
        };
        if directions(by_um).into_iter().flatten().any(used_up) && !Mutation::RetreatsClimb.is_out() {
            return false;
        }
        loads.is_some() || !self.is_blind_used_up()
    }

    /// Without a force to follow nothing may lead further away from the straight needle.
    pub(super) fn is_blind_used_up(&self) -> bool {
        let present = self.present.filter(|present| present.from.is_none());
        let outward_um = self.blind_um + present.map_or(0.0, |present| present.outward_um);
        outward_um >= BLIND_UM && !Mutation::BlindTurned.is_out()
    }

    /// Takes the loads of a period, and where the guide is.
    pub fn follow(&mut self, loads: Option<Loads>, position_um: [f32; 2], bounds: Bounds) {
        let smoothed = loads.map(|loads| self.smooth(loads.map(|load| load as f32)));
        self.unread = if loads.is_some() { 0 } else { self.unread.saturating_add(1) };
        if self.unread > STALE_LIMIT_PERIODS {
            self.smoothed = None;
        }
        if let Some(loads) = smoothed {
            self.forget_unloaded(loads, bounds.unloaded as f32);
        }
        let Some(present) = &mut self.present else { return };
        let outward_um = position_um.iter().zip(present.from_um).map(|(um, from)| um.abs() - from.abs());
        present.outward_um = outward_um.reduce(f32::max).unwrap_or(0.0);
        if let (Some(loads), Some(from)) = (smoothed, present.from) {
            for (rise, (load, from)) in present.rise.iter_mut().zip(loads.into_iter().zip(from)) {
                *rise = (load - from) as i32;
            }
        }
        match &mut present.left {
            Some(0) => self.close(),
            Some(left) => *left -= 1,
            None => {}
        }
    }

    /// Below the bound there is no load that anything could have been added to: what presses there later is on the other side.
    fn forget_unloaded(&mut self, loads: [f32; LOADS], unloaded: f32) {
        for (number, load) in loads.into_iter().enumerate() {
            if load >= unloaded {
                continue;
            }
            let all = self.added.iter_mut().filter_map(|added| added.get_mut(number));
            all.chain(self.excess.get_mut(number)).for_each(|counts| *counts = 0);
            let from = self.present.as_mut().and_then(|present| present.from.as_mut());
            if let Some(from) = from.and_then(|from| from.get_mut(number)) {
                *from = unloaded;
            }
        }
    }

    fn smooth(&mut self, loads: [f32; LOADS]) -> [f32; LOADS] {
        let mut smoothed = self.smoothed.unwrap_or(loads);
        for (smoothed, load) in smoothed.iter_mut().zip(loads) {
            *smoothed += (load - *smoothed) / SMOOTHED_PERIODS;
        }
        self.smoothed = Some(smoothed);
        smoothed
    }

    /// The retreat has ended; its motor rolls on.
    pub fn end(&mut self) {
        if let Some(present) = &mut self.present {
            present.left = Some(ROLLS_ON_PERIODS);
        }
    }

    /// Counts the present retreat.
    fn close(&mut self) {
        let Some(present) = self.present.take() else { return };
        if present.from.is_none() {
            self.blind_um = (self.blind_um + present.outward_um).max(0.0);
        }
        let [along_x, along_y] = directions(present.by_um);
        let moved = [along_x.or(along_y), along_y.or(along_x)];
        // The loads along x and y from the calibration's zero, then those from the tare.
        for (load, ((direction, rise), excess)) in
            moved.into_iter().cycle().zip(present.rise).zip(&mut self.excess).enumerate()
        {
            let raised = |by: u16| i32::from(by).saturating_add(rise).clamp(0, u16::MAX.into()) as u16;
            *excess = raised(*excess);
            for (number, added) in self.added.iter_mut().enumerate() {
                let Some(added) = added.get_mut(load) else { continue };
                if Some(number) == direction && rise > 0 {
                    *added = raised(*added);
                }
                *added = (*added).min(*excess);
            }
        }
    }

    /// State that is retained over a restart.
    pub fn to_bytes(mut self) -> [u8; ADDED_LOAD_BYTES] {
        self.close();
        let mut bytes = [0; ADDED_LOAD_BYTES];
        let counts = self.added.iter().chain([&self.excess]).flat_map(|counts| counts.iter().take(FROM_ZERO));
        let all = counts.copied().chain([self.blind_um as u16]);
        for (kept, added) in bytes.chunks_exact_mut(2).zip(all) {
            kept.copy_from_slice(&added.to_le_bytes());
        }
        bytes
    }

    /// What [`Self::to_bytes`] kept.
    pub fn from_bytes(bytes: [u8; ADDED_LOAD_BYTES]) -> Self {
        let mut added_load = Self::default();
        let mut kept = bytes.as_chunks::<2>().0.iter().map(|kept| u16::from_le_bytes(*kept));
        let all = added_load.added.iter_mut().chain([&mut added_load.excess]);
        for (counts, kept) in all.flat_map(|counts| counts.iter_mut().take(FROM_ZERO)).zip(&mut kept) {
            *counts = kept;
        }
        added_load.blind_um = kept.next().map_or(0.0, f32::from);
        added_load
    }
}

/// Direction of a motion along x and along y, as an index of [`AddedLoad::added`].
fn directions([x_um, y_um]: [i32; 2]) -> [Option<usize>; 2] {
    let of = |first: usize, um: i32| (um != 0).then_some(first + usize::from(um < 0));
    [of(0, x_um), of(2, y_um)]
}

#[cfg(test)]
mod tests {
    use super::super::campaign::acts::Random;
    use super::*;

    const BOUNDS: fn() -> Bounds = || Bounds::new(5_000, 5_000);

    /// Long after a load is this one.
    fn settle(added_load: &mut AddedLoad, loads: Option<Loads>) {
        (0..400).for_each(|_| added_load.follow(loads, [0.0; 2], BOUNDS()));
    }

    /// A retreat that goes from these loads to those.
    fn retreat(added_load: &mut AddedLoad, by_um: [i32; 2], from: Loads, to: Option<Loads>) -> bool {
        settle(added_load, Some(from));
        let begun = added_load.begin(by_um, [0.0; 2], Some(from), BOUNDS());
        settle(added_load, to);
        added_load.end();
        begun
    }

    #[test]
    fn a_direction_that_has_added_a_percent_is_used_up_and_no_other() {
        // 1 % of 5 N are 1000 counts.
        let mut added_load = AddedLoad::default();
        let along_y = |load: i32| [0, load, 0, load];
        for turn in 0..4 {
            let from = 100_000 + 300 * turn;
            let by_um = [0, 300];
            assert!(retreat(&mut added_load, by_um, along_y(from), Some(along_y(from + 300))), "turn {turn}");
        }
        assert!(!added_load.begin([0, 1], [0.0; 2], Some(along_y(101_200)), BOUNDS()));
        let kept = AddedLoad::from_bytes(added_load.to_bytes());
        assert_eq!(kept.to_bytes(), added_load.to_bytes());
        for by_um in [[0, -1], [1, 0], [-1, 0]] {
            assert!(retreat(&mut added_load, by_um, along_y(101_200), Some(along_y(95_000))), "{by_um:?}");
            assert!(retreat(&mut added_load, by_um, along_y(95_000), None), "it fell");
        }
        let mut kept = AddedLoad::from_bytes(kept.to_bytes());
        let oblique = kept.begin([-300, 301], [0.0; 2], Some(along_y(101_200)), BOUNDS());
        assert!(!oblique, "what it has added is still there");
        let open = added_load.begin([-300, 301], [0.0; 2], Some(along_y(95_000)), BOUNDS());
        assert!(open, "what it had added has been taken off");
    }

    /// A load that falls by itself opens nothing: a guide must not follow soft tissue into it.
    #[test]
    fn a_load_that_relaxes_leaves_its_direction_used_up() {
        let mut added_load = AddedLoad::default();
        let along_y = |load: i32| [0, load, 0, load];
        assert!(retreat(&mut added_load, [0, 300], along_y(100_000), Some(along_y(101_200))));
        (0..=ROLLS_ON_PERIODS).for_each(|_| added_load.follow(Some(along_y(101_200)), [0.0; 2], BOUNDS()));
        settle(&mut added_load, Some(along_y(90_000)));
        assert!(!added_load.begin([0, 300], [0.0; 2], Some(along_y(90_000)), BOUNDS()));
    }

    /// Out of a load along both axes, each of which adds to the other one by a tenth of what it takes off.
    #[test]
    fn the_ways_out_of_coupled_axes_stay_open_and_no_load_grows() {
        let mut added_load = AddedLoad::default();
        let (mut x, mut y) = (100_000, 100_000);
        let bounds = BOUNDS();
        for turn in 0.. {
            assert!(turn < 60, "{x}, {y}");
            let (by_um, to) = if turn % 2 == 0 {
                ([-500, 0], [x - 10_000, y + 1_000])
            } else {
                ([0, -500], [x + 1_000, y - 10_000])
            };
            let loads = |x, y| [x, y, x, y];
            assert!(
                retreat(&mut added_load, by_um, loads(x, y), Some(loads(to[0], to[1]))),
                "turn {turn}: {x}, {y}"
            );
            [x, y] = to;
            assert!(x <= 101_000 && y <= 101_000, "{x}, {y}");
            if x.max(y) < bounds.unloaded {
                break;
            }
        }
    }

    /// Tared far from the calibration's zero, the way out of one load is the way into the other.
    #[test]
    fn a_direction_is_open_again_once_what_it_has_added_to_is_no_load() {
        let mut added_load = AddedLoad::default();
        let at = |y: i32| [0, y, 0, 130_000 - y];
        assert!(retreat(&mut added_load, [0, -300], at(70_000), Some(at(68_800))));
        let allows = |added_load: &AddedLoad| added_load.allows([0, -300], Some(at(68_800)), BOUNDS());
        settle(&mut added_load, Some(at(68_800)));
        added_load.close();
        // 61,200 counts from the tare are below 85 % of 5 N, and never were a load.
        assert!(allows(&added_load));
        let narrow = Bounds::new(2_000, 5_000);
        let mut added_load = AddedLoad::default();
        let follow = |added_load: &mut AddedLoad, y: i32, bounds: Bounds| {
            (0..400).for_each(|_| added_load.follow(Some(at(y)), [0.0; 2], bounds));
        };
        follow(&mut added_load, 70_000, narrow);
        assert!(added_load.begin([0, -300], [0.0; 2], Some(at(70_000)), narrow));
        follow(&mut added_load, 68_800, narrow);
        added_load.close();
        assert!(!added_load.allows([0, -300], Some(at(68_800)), narrow), "it adds to the load from the tare");
        let restarted = AddedLoad::from_bytes(added_load.to_bytes());
        assert!(restarted.allows([0, -300], Some(at(68_800)), narrow), "which a restart ends");
        follow(&mut added_load, 68_800, BOUNDS());
        assert!(added_load.allows([0, -300], Some(at(68_800)), BOUNDS()), "which is none at a higher limit");
    }

    #[test]
    fn a_load_before_a_time_without_readings_is_compared_with_none_after_it() {
        let mut added_load = AddedLoad::default();
        let along_y = |load: i32| [0, load, 0, load];
        settle(&mut added_load, Some(along_y(96_000)));
        settle(&mut added_load, None);
        // The first readings after it, and a retreat that takes off a part of them.
        added_load.follow(Some(along_y(101_000)), [0.0; 2], BOUNDS());
        assert!(added_load.begin([0, -300], [0.0; 2], Some(along_y(101_000)), BOUNDS()));
        settle(&mut added_load, Some(along_y(99_000)));
        added_load.close();
        assert!(added_load.begin([0, -300], [0.0; 2], Some(along_y(99_000)), BOUNDS()));
    }

    #[test]
    fn the_noise_of_a_cell_uses_no_direction_up() {
        let mut random = Random::new(7);
        // The sum of twelve uniform numbers is nearly normal: 0.1 % of the range, 100 counts.
        let mut noise = || (0..12).map(|_| random.below(2_001) as i32 - 1_000).sum::<i32>() / 20;
        let mut added_load = AddedLoad::default();
        let mut loads = || Some([40_000, 41_000, 40_500, 39_000].map(|load| load + noise()));
        for turn in 0..24 {
            for by_um in [[-1_000, 0], [0, -1_000]] {
                assert!(added_load.begin(by_um, [0.0; 2], loads(), BOUNDS()), "turn {turn}: {by_um:?}");
                (0..500).for_each(|_| added_load.follow(loads(), [0.0; 2], BOUNDS()));
                added_load.end();
            }
        }
    }

    #[test]
    fn a_larger_load_along_y_hides_nothing_that_rises_along_x() {
        let mut added_load = AddedLoad::default();
        let loads = |x: i32| [x, 110_000, x, 109_000];
        assert!(retreat(&mut added_load, [300, 0], loads(100_000), Some(loads(101_500))));
        assert!(!added_load.begin([300, 0], [0.0; 2], Some(loads(101_500)), BOUNDS()));
        assert!(added_load.begin([-300, 0], [0.0; 2], Some(loads(101_500)), BOUNDS()));
    }

    #[test]
    fn what_the_motor_rolls_on_counts_and_what_comes_later_does_not() {
        let load = |counts: i32| [counts, 0, 0, 0];
        let mut added_load = AddedLoad::default();
        assert!(retreat(&mut added_load, [10, 0], load(100_000), Some(load(100_000))));
        settle(&mut added_load, Some(load(101_500)));
        assert!(!added_load.begin([10, 0], [0.0; 2], Some(load(101_500)), BOUNDS()));
        let mut added_load = AddedLoad::default();
        assert!(retreat(&mut added_load, [10, 0], load(100_000), Some(load(100_000))));
        (0..=ROLLS_ON_PERIODS).for_each(|_| added_load.follow(Some(load(100_000)), [0.0; 2], BOUNDS()));
        settle(&mut added_load, Some(load(101_500)));
        assert!(added_load.begin([10, 0], [0.0; 2], Some(load(101_500)), BOUNDS()));
    }

    /// Each is ended at once and the next one begun before its motor is at rest.
    #[test]
    fn hasty_retreats_add_no_more_than_slow_ones() {
        let mut added_load = AddedLoad::default();
        let (mut counts, mut turns) = (100_000, 0);
        settle(&mut added_load, Some([counts, 0, counts, 0]));
        while added_load.begin([300, 0], [0.0; 2], Some([counts, 0, counts, 0]), BOUNDS()) {
            for _ in 0..10 {
                counts += 5;
                added_load.follow(Some([counts, 0, counts, 0]), [0.0; 2], BOUNDS());
            }
            added_load.end();
            turns += 1;
            assert!(turns < 40, "no end of it");
        }
        assert!((101_000..101_200).contains(&counts), "{counts}");
    }

    #[test]
    fn retreats_without_a_reading_lead_away_from_the_straight_needle_by_no_more_than_a_tenth_of_a_millimetre()
    {
        let mut added_load = AddedLoad::default();
        let mut at_um = -3_000.0;
        let mut outward = |added_load: &mut AddedLoad, by_um: f32| {
            let begun = added_load.begin([0, 1_000], [0.0, at_um], None, BOUNDS());
            at_um -= by_um;
            added_load.follow(None, [0.0, at_um], BOUNDS());
            added_load.end();
            begun
        };
        assert!(outward(&mut added_load, 60.0) && outward(&mut added_load, 60.0));
        assert!(!outward(&mut added_load, 60.0));
        assert!(!AddedLoad::from_bytes(added_load.to_bytes()).begin([0, 1_000], [0.0; 2], None, BOUNDS()));
        // Towards it as far as needed.
        let mut added_load = AddedLoad::default();
        assert!((0..20).all(|_| outward(&mut added_load, -100.0)));
    }

    #[test]
    fn what_rises_along_an_axis_at_rest_counts_for_the_one_that_moved() {
        let mut added_load = AddedLoad::default();
        let to = [101_500, 99_000, 100_000, 99_000];
        assert!(retreat(&mut added_load, [0, 300], [100_000; LOADS], Some(to)));
        assert!(added_load.begin([300, 0], [0.0; 2], Some([101_500; LOADS]), BOUNDS()));
        assert!(!added_load.begin([0, 300], [0.0; 2], Some([101_500; LOADS]), BOUNDS()));
    }
}
