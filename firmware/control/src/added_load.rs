//! What retreats have added to a load since its fault, so that many small ones are no way into it.

use super::force::{LOADS, Loads};
use super::mutation::Mutation;
use super::retreat::Bounds;

/// Periods for which a motor may roll on after the end of a retreat: several times the lag of one.
const ROLLS_ON_PERIODS: u16 = 50;
/// Time constant of the loads that are compared, periods: single readings of a cell differ by a tenth of what a direction may add, and the
/// largest of hundreds by half of it, so that retreats out of a load would use up their own direction.
const SMOOTHED_PERIODS: f32 = 16.0;
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
/// No direction has added more to the load along an axis than all retreats together have added there and not taken off again: where
/// axes are coupled, each way out adds a little to the load along the other axis, and both would be used up for ever. The load along an
/// axis still is at most what it was and what the four directions have added to it.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct AddedLoad {
    /// Of each direction, to the loads along x and y.
    added: [[u16; 2]; 4],
    /// By how much all retreats have raised the loads along x and y above the least they have left there.
    excess: [u16; 2],
    /// What retreats without a force to follow have led away from the straight needle, micrometres.
    blind_um: f32,
    /// Loads without most of their noise, force counts; nothing before the first reading.
    smoothed: Option<[f32; LOADS]>,
    present: Option<Present>,
}

/// A retreat that is followed.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Present {
    by_um: [i32; 2],
    from_um: [f32; 2],
    /// Nothing where there was no reading.
    from: Option<[f32; LOADS]>,
    /// By how much more each axis is loaded now.
    rise: [i32; 2],
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
        self.present = Some(Present { by_um, from_um, from, rise: [0; 2], outward_um: 0.0, left: None });
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
        if let Some(loads) = smoothed {
            self.forget_unloaded(loads, bounds.unloaded as f32);
        }
        let Some(present) = &mut self.present else { return };
        let outward_um = position_um.iter().zip(present.from_um).map(|(um, from)| um.abs() - from.abs());
        present.outward_um = outward_um.reduce(f32::max).unwrap_or(0.0);
        if let (Some([x, y, tared_x, tared_y]), Some(from)) = (smoothed, present.from) {
            let [from_x, from_y, from_tared_x, from_tared_y] = from;
            let along = [(x - from_x).max(tared_x - from_tared_x), (y - from_y).max(tared_y - from_tared_y)];
            present.rise = along.map(|more| more as i32);
        }
        match &mut present.left {
            Some(0) => self.close(),
            Some(left) => *left -= 1,
            None => {}
        }
    }

    /// An axis below its bound has no load that anything could have been added to: what presses there later is on its other side.
    fn forget_unloaded(&mut self, [x, y, tared_x, tared_y]: [f32; LOADS], unloaded: f32) {
        for (axis, load) in [x.max(tared_x), y.max(tared_y)].into_iter().enumerate() {
            if load >= unloaded {
                continue;
            }
            let all = self.added.iter_mut().filter_map(|added| added.get_mut(axis));
            all.chain(self.excess.get_mut(axis)).for_each(|counts| *counts = 0);
            let from = self.present.as_mut().and_then(|present| present.from.as_mut());
            from.into_iter().flatten().skip(axis).step_by(2).for_each(|from| *from = unloaded);
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
        for (axis, ((direction, rise), excess)) in
            moved.into_iter().zip(present.rise).zip(&mut self.excess).enumerate()
        {
            let raised = |by: u16| i32::from(by).saturating_add(rise).clamp(0, u16::MAX.into()) as u16;
            *excess = raised(*excess);
            for (number, added) in self.added.iter_mut().enumerate() {
                let Some(added) = added.get_mut(axis) else { continue };
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
        let all = self.added.into_iter().flatten().chain(self.excess).chain([self.blind_um as u16]);
        for (kept, added) in bytes.chunks_exact_mut(2).zip(all) {
            kept.copy_from_slice(&added.to_le_bytes());
        }
        bytes
    }

    /// What [`Self::to_bytes`] kept.
    pub fn from_bytes(bytes: [u8; ADDED_LOAD_BYTES]) -> Self {
        let mut added_load = Self::default();
        let mut kept = bytes.as_chunks::<2>().0.iter().map(|kept| u16::from_le_bytes(*kept));
        let counts = added_load.added.iter_mut().flatten().chain(&mut added_load.excess);
        for (counts, kept) in counts.zip(&mut kept) {
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
