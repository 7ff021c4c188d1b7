//! Draws from the posterior of every insertion: modulus, gap, angle of entry and tip load, with the path that follows from them. The
//! readings of a path are drawn with the scatter of single depths about a smooth path, and with the noise of the median that is measured.

use super::results::Grid;
use insertion::{PathDraw, Tissue};
use readings::draws::{Draws, Group, Random};

/// Number of the first random stream of the insertions; each insertion has three.
const INSERTIONS: u64 = 100;
const STREAMS: u64 = 3;
/// Distance between the depths at which the tip load is drawn, millimetres; between them it is interpolated linearly.
const LOAD_EVERY_MM: usize = 5;

/// The random numbers of one insertion.
pub(super) struct Streams(u64, u64);

impl Streams {
    pub fn new(draws: &Draws, insertion: usize) -> Self {
        Self(draws.options().seed, INSERTIONS + STREAMS * insertion as u64)
    }

    /// Stream of the posterior.
    pub fn posterior(&self) -> Random {
        Random::new(self.0, self.1)
    }

    /// Stream of the prior.
    pub fn prior(&self) -> Random {
        Random::new(self.0, self.1 + 1)
    }

    /// Stream of the noise of readings.
    fn noise(&self) -> Random {
        Random::new(self.0, self.1 + 2)
    }
}

/// Draws of modulus and gap from their priors, as standard variates of their logarithms.
pub(super) struct Assumed {
    modulus: Vec<f64>,
    gap: Vec<f64>,
}

impl Assumed {
    pub fn new(streams: &Streams, count: usize) -> Self {
        let mut random = streams.prior();
        let modulus = (0..count).map(|_| random.normal()).collect();
        Self { modulus, gap: (0..count).map(|_| random.normal()).collect() }
    }

    /// Standard variates of the logarithm of the modulus.
    pub fn modulus(&self) -> &[f64] {
        &self.modulus
    }
}

/// Depths at which the tip load is drawn, the end of the observed part last.
pub(super) fn loads_at_m(grid: &Grid) -> Vec<f64> {
    grid.depth_m.iter().copied().step_by(LOAD_EVERY_MM).chain([grid.until_m()]).collect()
}

/// One insertion and its draws.
pub(super) struct DrawnInsertion<'a> {
    pub id: &'a str,
    pub tissue: &'a Tissue,
    pub grid: &'a Grid,
    /// Path of each draw; its tip load is at [`loads_at_m`].
    pub paths: &'a [PathDraw],
    pub assumed: &'a Assumed,
    /// Whether modulus and gap are from their priors.
    pub is_assumed: bool,
    /// Standard deviation of a measured median about the path.
    pub noise_m: f64,
    pub is_two_planes: bool,
}

impl DrawnInsertion<'_> {
    /// Adds the variables of the insertion, each under its name.
    pub fn add(&self, streams: &Streams, draws: &mut Draws) {
        let Self { tissue, paths, assumed, .. } = *self;
        let surface_kpa = 1e-3 * tissue.model.foundation.modulus_pa(0.0);
        let k_kpa = log_normal(surface_kpa, tissue.modulus_sd_ln, &assumed.modulus);
        let gap_mm = log_normal(1e3 * tissue.gap_m, tissue.gap_sd_ln, &assumed.gap);
        if self.is_assumed {
            draws.scalar(Group::Posterior, &self.name_of("k_kpa"), k_kpa.clone());
            draws.scalar(Group::Posterior, &self.name_of("gap_mm"), gap_mm.clone());
        } else {
            let k = paths.iter().map(|path| surface_kpa * path.modulus_ln.exp()).collect();
            draws.scalar(Group::Posterior, &self.name_of("k_kpa"), k);
            let gap = paths.iter().map(|path| 1e3 * path.gap_ln.exp()).collect();
            draws.scalar(Group::Posterior, &self.name_of("gap_mm"), gap);
        }
        draws.scalar(Group::Prior, &self.name_of("k_kpa"), k_kpa);
        draws.scalar(Group::Prior, &self.name_of("gap_mm"), gap_mm);
        let mut loads_mm = to_mm(&loads_at_m(self.grid));
        loads_mm.pop();
        draws.coordinate(&self.name_of("load_depth_mm"), loads_mm);
        let mut noise = streams.noise();
        for (plane, axis) in ["y", "x"].into_iter().enumerate().take(if self.is_two_planes { 2 } else { 1 }) {
            let angles: Option<Vec<f64>> =
                paths.iter().map(|path| Some(path.entry_angle_rad.get(plane)?.to_degrees())).collect();
            draws.scalar(
                Group::Posterior,
                &self.name_of(&format!("entry_angle_{axis}_deg")),
                angles.unwrap_or_default(),
            );
            let loads: Vec<&[f64]> =
                paths.iter().filter_map(|path| path.load_n.get(plane).map(Vec::as_slice)).collect();
            let at_end: Vec<f64> = loads.iter().filter_map(|load| load.last().copied()).collect();
            draws.scalar(Group::Posterior, &self.name_of(&format!("tip_force_{axis}_n")), at_end);
            let load_paths = loads.iter().filter_map(|load| Some(load.split_last()?.1.to_vec())).collect();
            draws.list(
                Group::Posterior,
                &self.name_of(&format!("load_{axis}_n")),
                &self.name_of("load_depth_mm"),
                load_paths,
            );
            self.add_path(plane, axis, &mut noise, draws);
        }
    }

    fn name_of(&self, of: &str) -> String {
        format!("{}.{of}", self.id)
    }

    /// Adds readings of the path in a plane: where it was measured, and where it was not.
    fn add_path(&self, plane: usize, axis: &str, noise: &mut Random, draws: &mut Draws) {
        let measured = self.grid.measured();
        let measured_mm = if plane == 0 { Some(measured.y_mm) } else { measured.x_mm };
        let Some(measured_mm) = measured_mm else { return };
        let readings: Vec<Vec<f64>> = self
            .paths
            .iter()
            .map(|path| {
                let tip_m = path.tip_m.get(plane).map(Vec::as_slice).unwrap_or_default();
                tip_m.iter().map(|tip_m| 1e3 * tip_m + self.reading_sd_mm(path) * noise.normal()).collect()
            })
            .collect();
        let (measured_points, not_taken): (Vec<usize>, Vec<usize>) =
            (0..self.grid.depth_m.len()).partition(|at| measured_mm.get(*at).copied().flatten().is_some());
        let name = format!("{}.tip_{axis}_mm", self.id);
        let dimension = format!("{}.tip_{axis}.depth_mm", self.id);
        draws.coordinate(&dimension, places_mm(&measured_points));
        draws.list(Group::PosteriorPredictive, &name, &dimension, rows_at(&measured_points, &readings));
        let of_taken = || measured_points.iter().filter_map(|at| measured_mm.get(*at).copied().flatten());
        draws.list(Group::ObservedData, &name, &dimension, vec![of_taken().collect()]);
        draws.list(
            Group::LogLikelihood,
            &name,
            &dimension,
            self.paths
                .iter()
                .map(|path| -> Vec<f64> {
                    let tip_m = path.tip_m.get(plane).map(Vec::as_slice).unwrap_or_default();
                    let sd_mm = self.reading_sd_mm(path);
                    measured_points
                        .iter()
                        .zip(of_taken())
                        .map(|(at, measured)| {
                            let standard_residual =
                                (measured - 1e3 * tip_m.get(*at).copied().unwrap_or(f64::NAN)) / sd_mm;
                            -0.5 * (standard_residual * standard_residual + std::f64::consts::TAU.ln())
                                - sd_mm.ln()
                        })
                        .collect()
                })
                .collect(),
        );
        let ahead_name = format!("{}.tip_{axis}.depth_ahead_mm", self.id);
        draws.coordinate(&ahead_name, places_mm(&not_taken));
        draws.list(Group::Predictions, &name, &ahead_name, rows_at(&not_taken, &readings));
    }

    fn reading_sd_mm(&self, path: &PathDraw) -> f64 {
        1e3 * path.irregularity_m.hypot(self.noise_m)
    }
}

fn rows_at(places: &[usize], readings: &[Vec<f64>]) -> Vec<Vec<f64>> {
    readings.iter().map(|path| places.iter().filter_map(|at| path.get(*at).copied()).collect()).collect()
}

fn places_mm(places: &[usize]) -> Vec<f64> {
    places.iter().map(|at| *at as f64).collect::<Vec<_>>()
}

fn to_mm(list: &[f64]) -> Vec<f64> {
    list.iter().map(|depth_m| 1e3 * depth_m).collect::<Vec<_>>()
}

fn log_normal(value: f64, sd_ln: f64, standard: &[f64]) -> Vec<f64> {
    standard.iter().map(|standard| value * (sd_ln * standard).exp()).collect()
}
