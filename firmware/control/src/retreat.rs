//! Out of a load while its fault stands: a short, slow motion that ends as soon as the force does not fall.
//!
//! A lead screw holds the guide where the load stopped it, so that the cause of the fault would stay for ever. The host states which
//! way; the device ensures that it leads out: every [`PROGRESS_UM`] must take [`PROGRESS_PERCENT`] of the rated range off the
//! load, which must never be more than [`RISE_PERCENT`] above its least so far. Where the converter is saturated there is no
//! force to watch: then only the way towards the straight needle is open.
//!
//! Retreats must not add up to a way into the load: what they add in one direction is counted over the fault ([`Climb`]), and a
//! direction that has added [`RISE_PERCENT`] is refused until the fault is cleared.

use super::mutation::Mutation;
use crate::calibration::counts_of_mn;

/// Speed of a retreat, micrometres per second.
pub const RETREAT_SPEED_UM_S: f32 = 500.0;
/// The load may rise above its least by this, percent of the rated range: ten times the noise of a cell.
pub const RISE_PERCENT: u32 = 1;
/// Way in which the load must have fallen, micrometres: beyond the play of the mechanism.
pub const PROGRESS_UM: f32 = 300.0;
/// By how much, percent of the rated range.
pub const PROGRESS_PERCENT: f32 = 0.4;
/// Share of the limit below which the guide counts as unloaded.
pub const UNLOADED: f32 = 0.9;

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
    /// Where the load was last compared, and what it was, counts.
    mark: Option<([f32; 2], i32)>,
    least: i32,
}

impl LoadWatch {
    /// At the start.
    #[expect(clippy::new_without_default, reason = "`LoadWatch::new()` is clearer at its only use")]
    pub const fn new() -> Self {
        Self { mark: None, least: i32::MAX }
    }

    /// Takes the load of a period, in force counts (nothing where the converter gives none), and where the guide is.
    pub fn step(&mut self, load: Option<i32>, position_um: [f32; 2], limit_mn: u32, range_mn: u32) -> Trend {
        let Some(load) = load else { return Trend::Falling };
        let range = counts_of_mn(range_mn) as f32;
        if (load as f32) < UNLOADED * counts_of_mn(limit_mn.min(range_mn)) as f32 {
            return Trend::Unloaded;
        }
        self.least = self.least.min(load);
        if (load - self.least) as f32 > range * RISE_PERCENT as f32 * 1e-2 {
            return Trend::NotFalling;
        }
        let (from_um, before) = *self.mark.get_or_insert((position_um, load));
        let ([x, y], [from_x, from_y]) = (position_um, from_um);
        if libm::hypotf(x - from_x, y - from_y) >= PROGRESS_UM {
            if ((before - load) as f32) < range * PROGRESS_PERCENT * 1e-2 {
                return Trend::NotFalling;
            }
            self.mark = Some((position_um, load));
        }
        Trend::Falling
    }
}

/// Bytes of a kept [`Climb`].
pub const CLIMB_BYTES: usize = 8;

/// What retreats have added to the load since the fault, force counts, in the directions +x, -x, +y, -y. One along neither axis counts
/// as along the axis of its larger part.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Climb {
    added: [u16; 4],
    /// Direction of the present retreat, and the load at its start.
    from: Option<(usize, i32)>,
}

impl Climb {
    /// Begins a retreat; false where its direction has been used up.
    pub fn begin(&mut self, by_um: [i32; 2], load: Option<i32>, range_mn: u32) -> bool {
        let [x_um, y_um] = by_um;
        let along_y = usize::from(y_um.unsigned_abs() > x_um.unsigned_abs());
        let negative = usize::from(if along_y == 1 { y_um } else { x_um } < 0);
        let direction = 2 * along_y + negative;
        let most = counts_of_mn(range_mn) * RISE_PERCENT as i32 / 100;
        let used_up = self.added.get(direction).is_none_or(|added| i32::from(*added) >= most);
        if used_up && !Mutation::RetreatsClimb.is_out() {
            return false;
        }
        self.from = load.map(|load| (direction, load));
        true
    }

    /// Ends it. Where there is no reading the load is taken to be what it was.
    pub fn end(&mut self, load: Option<i32>) {
        if let Some(((direction, from), load)) = self.from.take().zip(load)
            && let Some(added) = self.added.get_mut(direction)
        {
            let sum = i32::from(*added).saturating_add(load.saturating_sub(from));
            *added = u16::try_from(sum.max(0)).unwrap_or(u16::MAX);
        }
    }

    /// What a restart must not forget.
    pub fn to_bytes(self) -> [u8; CLIMB_BYTES] {
        let mut bytes = [0; CLIMB_BYTES];
        for (kept, added) in bytes.chunks_exact_mut(2).zip(self.added) {
            kept.copy_from_slice(&added.to_le_bytes());
        }
        bytes
    }

    /// What [`Self::to_bytes`] kept.
    pub fn from_bytes(bytes: [u8; CLIMB_BYTES]) -> Self {
        let mut climb = Self::default();
        for (added, kept) in climb.added.iter_mut().zip(bytes.as_chunks::<2>().0) {
            *added = u16::from_le_bytes(*kept);
        }
        climb
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_direction_that_has_added_a_percent_is_used_up_and_no_other() {
        // 1 % of 5 N are 1000 counts.
        let mut climb = Climb::default();
        for turn in 0..4 {
            assert!(climb.begin([20, 300], Some(100_000 + 300 * turn), 5_000), "turn {turn}");
            climb.end(Some(100_300 + 300 * turn));
        }
        assert!(!climb.begin([0, 1], Some(101_200), 5_000));
        let kept = Climb::from_bytes(climb.to_bytes());
        assert_eq!(kept, climb);
        for direction in [[0, -1], [1, 0], [-1, 0]] {
            assert!(climb.begin(direction, Some(101_200), 5_000), "{direction:?}");
            climb.end(Some(90_000));
            assert!(climb.begin(direction, None, 5_000), "it fell");
            climb.end(None);
        }
        assert!(
            !climb.begin([-300, 301], Some(90_000), 5_000),
            "nothing that another direction does opens it"
        );
    }

    /// Moves by 1 um a step from 5.1 N on; the load changes by so many counts a micrometre (20 counts are 1 N/mm).
    fn way(counts_per_um: f32) -> (Trend, u32) {
        let mut watch = LoadWatch::new();
        for um in 0..1_000_u32 {
            let load = (102_000.0 + counts_per_um * um as f32) as i32;
            let trend = watch.step(Some(load), [0.0, um as f32], 5_000, 5_000);
            if trend != Trend::Falling {
                return (trend, um);
            }
        }
        (Trend::Falling, 1_000)
    }

    #[test]
    fn the_way_out_is_gone_to_its_end_and_the_wrong_one_is_not() {
        // 102000 to 90000 counts at 20 a micrometre.
        assert_eq!(way(-20.0), (Trend::Unloaded, 601));
        assert_eq!(way(-2.0), (Trend::Falling, 1_000));
        assert_eq!(way(0.0), (Trend::NotFalling, 300));
        assert_eq!(way(-0.5), (Trend::NotFalling, 300));
        assert_eq!(way(20.0), (Trend::NotFalling, 51));
    }

    #[test]
    fn without_a_reading_nothing_is_compared() {
        let mut watch = LoadWatch::new();
        assert_eq!(watch.step(None, [0.0; 2], 5_000, 5_000), Trend::Falling);
        assert_eq!(watch.step(None, [0.0, 900.0], 5_000, 5_000), Trend::Falling);
        assert_eq!(watch.step(Some(102_000), [0.0, 900.0], 5_000, 5_000), Trend::Falling);
    }
}
