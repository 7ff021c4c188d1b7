//! The measured shape of a hold as data.
//!
//! A tracker measures the whole shape many times a second: a hold has hundreds of points at every position along the needle. They
//! are replaced by their mean, which is a sufficient statistic. The factorisation of the covariance of thousands of separate data
//! would take minutes, and the noise estimate, which uses the first data of a sweep, would have only data at one position, which do
//! not show the correlation of the noise along the needle.

use formats::session::LateralRun;
use mechanics::ShapePoint;
use readings::holds::Hold;
use std::collections::BTreeMap;

/// Points up to this distance beyond the tip count as points at the tip.
const BEYOND_M: f64 = 0.5e-3;
/// Points closer than this are at the same place.
const SAME_PLACE_M: f64 = 0.01e-3;
/// Largest number of places of a hold, approximately: more are joined with their neighbours, over a length on which a needle is straight.
const MAX_PLACES: usize = 240;

/// The shape of a hold.
pub(super) struct HoldShape {
    /// Its places, along the needle.
    pub places: Vec<ShapePoint>,
    /// Number, in the file, of the first point at each place.
    pub indices: Vec<usize>,
    /// Measurements at them, plane by plane.
    pub means: Vec<PlaceMean>,
}

/// The mean of the points at a place in a plane.
pub(super) struct PlaceMean {
    /// 0 for the vertical plane, 1 for the horizontal one.
    pub plane: usize,
    /// Number of the place.
    pub place: usize,
    /// Deflection.
    pub deflection_m: f64,
    /// Number of points.
    pub points: usize,
}

/// The shape of one hold of a needle whose tip is at `tip_m`.
pub(super) fn of_hold(run: &LateralRun, tip_m: f64, hold: &Hold) -> HoldShape {
    let middle_s = 0.5 * (hold.time_s[0] + hold.time_s[1]);
    let mut indices: Vec<usize> =
        hold.shape.iter().copied().filter(|i| run.shape.z_m[*i] <= tip_m + BEYOND_M).collect();
    indices.sort_by(|a, b| run.shape.z_m[*a].total_cmp(&run.shape.z_m[*b]));
    let z_m: Vec<f64> = indices.iter().map(|i| run.shape.z_m[*i].min(tip_m)).collect();
    let times_s = run.shape.time_s.as_ref();
    let times_s = indices.iter().map(|i| times_s.map_or(middle_s, |times_s| hold.observed_s(times_s[*i])));
    let times_s: Vec<f64> = times_s.collect();
    // Points imaged forth and back are kept apart, because a lag of the images shifts them in opposite directions.
    let directions: Vec<_> = indices
        .iter()
        .map(|index| run.shape.image(*index).map(|image| image.probe_m_per_s.total_cmp(&0.0)))
        .collect();
    let groups = places(&z_m, &directions);
    let mut means = Vec::new();
    for (plane, column) in [Some(&run.shape.y_m), run.shape.x_m.as_ref()].into_iter().enumerate() {
        let Some(column) = column else { continue };
        let values: Vec<f64> = indices.iter().map(|i| column[*i]).collect();
        let kept_points = super::misread::without_misread(&z_m, &values, super::misread::step_m(column));
        for (place, members) in groups.iter().enumerate() {
            let members: Vec<usize> = members.iter().copied().filter(|member| kept_points[*member]).collect();
            if !members.is_empty() {
                let deflection_m = mean(&values, &members);
                means.push(PlaceMean { plane, place, deflection_m, points: members.len() });
            }
        }
    }
    let mean_points = groups.iter().map(|members| ShapePoint {
        time_s: mean(&times_s, members),
        z_m: mean(&z_m, members),
        image: run.shape.image(indices[members[0]]),
    });
    HoldShape {
        places: mean_points.collect(),
        indices: groups.iter().map(|members| indices[members[0]]).collect(),
        means,
    }
}

/// Mean of some of the values.
fn mean(values: &[f64], members: &[usize]) -> f64 {
    members.iter().map(|member| values[*member]).sum::<f64>() / members.len() as f64
}

/// Groups of points at the same place and with the same direction of the sweep, in the order of their first points; `z_m` increases.
fn places<W: Ord + Copy>(z_m: &[f64], ways: &[W]) -> Vec<Vec<usize>> {
    let same_place = joined(z_m, ways, SAME_PLACE_M);
    if same_place.len() <= MAX_PLACES {
        return same_place;
    }
    let length_m = z_m.last().zip(z_m.first()).map_or(0.0, |(last, first)| last - first);
    let direction_count = ways.iter().collect::<std::collections::BTreeSet<_>>().len();
    joined(z_m, ways, length_m * direction_count as f64 / MAX_PLACES as f64)
}

/// Groups of points with the same direction of the sweep that are within a width of the first point.
fn joined<W: Ord + Copy>(z_m: &[f64], ways: &[W], width_m: f64) -> Vec<Vec<usize>> {
    let mut place_groups: Vec<Vec<usize>> = Vec::new();
    let mut last: BTreeMap<W, usize> = BTreeMap::new();
    for (number, (at_m, way)) in z_m.iter().zip(ways).enumerate() {
        let open = last.get(way).filter(|place| at_m - z_m[place_groups[**place][0]] <= width_m);
        match open {
            Some(place) => place_groups[*place].push(number),
            None => {
                last.insert(*way, place_groups.len());
                place_groups.push(vec![number]);
            }
        }
    }
    place_groups
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_at_one_place_are_one_and_others_stay_as_they_are() {
        let z_m = [0.07, 0.07, 0.070_005, 0.071, 0.0712, 0.0712];
        assert_eq!(places(&z_m, &[0; 6]), [vec![0, 1, 2], vec![3], vec![4, 5]]);
        // Points of the two directions are separate.
        assert_eq!(places(&z_m, &[1, -1, 1, 1, -1, -1]), [vec![0, 2], vec![1], vec![3], vec![4, 5]]);
        assert!(places::<i8>(&[], &[]).is_empty());
    }

    #[test]
    fn dense_points_are_joined_to_a_number_that_is_bounded() {
        let z_m: Vec<f64> = (0..5000).map(|i| 0.07 + 6e-6 * f64::from(i)).collect();
        for ways in [vec![0; 5000], (0..5000).map(|i| i % 2).collect()] {
            let place_groups = places(&z_m, &ways);
            assert!(
                (MAX_PLACES / 2..=MAX_PLACES + 2).contains(&place_groups.len()),
                "{}",
                place_groups.len()
            );
            assert_eq!(place_groups.iter().map(Vec::len).sum::<usize>(), 5000);
            assert!(place_groups.iter().all(|place| z_m[place[place.len() - 1]] - z_m[place[0]] < 0.3e-3));
        }
    }
}
