//! The table of K/E that is part of the program: needles, depths, Poisson's ratios and Young's moduli of interest.

use inference::FitError;
use inference::relation::{Run, foundation_modulus_pa};
use mechanics::continuum::{Contact, Continuum, Resolution};
use mechanics::{Needle, Rig};
use std::fmt::Write;

/// Gauge, outer and inner diameter in millimetres.
const NEEDLES: [(u32, f64, f64); 5] =
    [(17, 1.47, 1.07), (18, 1.27, 1.0), (20, 0.91, 0.6), (22, 0.72, 0.41), (25, 0.51, 0.26)];
const DEPTHS_MM: [f64; 8] = [10.0, 20.0, 30.0, 40.0, 60.0, 80.0, 100.0, 140.0];
const POISSON: [f64; 3] = [0.45, 0.49, 0.5];
const YOUNGS_KPA: [f64; 5] = [5.0, 10.0, 16.0, 30.0, 50.0];
const GUIDE2_M: f64 = 0.06;
const ENTRY_M: f64 = 0.07;

/// Computes the table as CSV; `progress` is called for every needle.
///
/// # Errors
/// [`FitError`] where a case cannot be solved.
pub fn table(mut progress: impl FnMut(u32)) -> Result<String, FitError> {
    let mut text = String::from(
        "# K/E of a steel needle in an elastic half space with a free surface: `cargo xtask study modulus-relation`.\n\
         # guide 2 at 60 mm, surface at 70 mm, 1.2 mm displacement, 0.05 N, 0.02 mm, 0.03 mm noise; numerical\n\
         # uncertainty 2 %. ratio_rigid: needle that does not bend, bonded.\n\
         gauge,outer_diameter_mm,inner_diameter_mm,depth_mm,poisson,youngs_modulus_kpa,ratio_bonded,ratio_one_sided,ratio_rigid\n",
    );
    for (gauge, outer_mm, inner_mm) in NEEDLES {
        progress(gauge);
        let needle = Needle {
            outer_diameter_m: 1e-3 * outer_mm,
            inner_diameter_m: 1e-3 * inner_mm,
            ..Needle::gauge_18()
        };
        let rig = Rig::two_guides(needle.clone(), GUIDE2_M, ENTRY_M);
        for depth_mm in DEPTHS_MM {
            for poisson in POISSON {
                let bonded = Continuum::solve(
                    &needle,
                    1e-3 * depth_mm,
                    poisson,
                    Contact::Bonded,
                    Resolution::DEFAULT,
                )?;
                let one_sided = bonded.with_contact(Contact::OneSided);
                for youngs_kpa in YOUNGS_KPA {
                    let (a, b, rigid) = (
                        ratio(&bonded, &rig, youngs_kpa)?,
                        ratio(&one_sided, &rig, youngs_kpa)?,
                        bonded.rigid_ratio()?,
                    );
                    let _ = writeln!(
                        text,
                        "{gauge},{outer_mm},{inner_mm},{depth_mm},{poisson},{youngs_kpa},{a:.4},{b:.4},{rigid:.4}"
                    );
                }
            }
        }
    }
    Ok(text)
}

fn ratio(body: &Continuum, rig: &Rig, youngs_kpa: f64) -> Result<f64, FitError> {
    let modulus_pa = foundation_modulus_pa(body, rig, 1e3 * youngs_kpa, &Run::default())?;
    Ok::<f64, FitError>(1e-3 * modulus_pa / youngs_kpa)
}

#[cfg(test)]
mod tests {
    use super::*;
    use inference::relation::TABLE;

    /// One case of the table, computed again.
    #[test]
    fn the_table_is_what_the_solver_gives() {
        let rows: Vec<&str> = TABLE.lines().filter(|line| !line.starts_with('#')).skip(1).collect();
        assert_eq!(rows.len(), NEEDLES.len() * DEPTHS_MM.len() * POISSON.len() * YOUNGS_KPA.len());
        let row = rows.iter().find(|row| row.starts_with("18,1.27,1,30,0.5,16,")).expect("the row");
        let stated: f64 = row.split(',').nth(6).expect("a ratio").parse().expect("a number");
        let body = Continuum::solve(&Needle::gauge_18(), 0.03, 0.5, Contact::Bonded, Resolution::DEFAULT)
            .expect("solves");
        let rig = Rig::two_guides(Needle::gauge_18(), GUIDE2_M, ENTRY_M);
        let computed = foundation_modulus_pa(&body, &rig, 16e3, &Run::default()).expect("a modulus") / 16e3;
        assert!((computed - stated).abs() < 1e-3, "{computed} {stated}");
        for row in rows {
            let ratios: Vec<f64> =
                row.split(',').skip(6).map(|cell| cell.parse().expect("a number")).collect();
            assert!(ratios.iter().all(|ratio| (0.1..2.0).contains(ratio)) && ratios[1] < ratios[0], "{row}");
        }
    }
}
