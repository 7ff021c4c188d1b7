//! The section on the tissue's modulus: every method side by side, shapes, forces, residuals, the indentation beside it.

use super::page::{
    Block, FIGURES, Fact, Outcome, Section, count, estimate, number, p_value, thinned, value, words,
};
use crate::figures;
use formats::session::Session;
use inference::identify::{Directions, Identification, RunResult};

/// Shape points drawn of one run, and the least of one hold.
const POINTS: usize = 300;
const POINTS_OF_HOLD: usize = 8;
/// Depths closer than this are repeats of each other.
const SAME_DEPTH_MM: f64 = 0.5;
/// Facts for the summary; `is_short` where the model is known to lack something.
pub(super) fn facts(found: &Identification, is_short: bool) -> Vec<Fact> {
    let pooled = &found.pooled;
    let youngs = &found.youngs_modulus_kpa;
    let [least, most] = youngs.range_kpa;
    vec![
        Fact::new(
            model_name("Foundation modulus K, pooled (95 %)", is_short),
            format!(
                "{} kPa, {}",
                estimate(Some(pooled.k_kpa), Some(pooled.ci95_kpa), 2),
                count(pooled.runs, "run")
            ),
        ),
        Fact::new(
            model_name("Young's modulus E (95 %)", is_short),
            format!(
                "{} kPa by {} (Poisson's ratio {}{}); {least:.1} to {most:.1} kPa by the relations known",
                estimate(youngs.value, youngs.ci95, 2),
                youngs.relation,
                youngs.poisson,
                if found.walls.is_stated() { "" } else { ", walls of the tissue not stated" }
            ),
        ),
    ]
}

fn model_name(name: &str, is_short: bool) -> String {
    match is_short {
        true => format!("{name}, without what the model lacks"),
        false => name.to_owned(),
    }
}

/// The section.
pub(super) fn section(session: &Session, outcome: &Outcome<Identification>) -> Section {
    outcome.section("identification", "Identification", |found| {
        let mut blocks = Vec::new();
        if !found.effects.is_empty() {
            blocks.push(Block::Text(format!("The model has {}.", found.effects.join(", "))));
        }
        blocks.push(methods(found));
        blocks.push(fits(found));
        blocks.extend(pooled(found));
        blocks.push(relations(found));
        let sentences = found.foundation.sentences(&found.pooled, &found.youngs_modulus_kpa);
        blocks.push(Block::Text(format!("Tissue modelled as {}.", sentences.join("; "))));
        blocks.extend(found.walls.line().map(|line| Block::Text(format!("Walls of the tissue: {line}."))));
        blocks.extend(reference(found).into_iter().flatten());
        blocks.push(Block::Notes(found.warnings.clone()));
        let good: Vec<_> = found.runs.iter().filter(|run| run.error.is_none()).collect();
        let mut depths_mm: Vec<f64> = Vec::new();
        for run in good.iter().take(FIGURES) {
            // On paper one run of every depth: the tables have all.
            let figures = figures_of(session, run);
            if depths_mm.iter().any(|depth_mm| (depth_mm - run.depth_mm).abs() < SAME_DEPTH_MM) {
                blocks.push(Block::Screen(figures));
            } else {
                depths_mm.push(run.depth_mm);
                blocks.extend(figures);
            }
        }
        if good.len() > FIGURES {
            blocks.push(Block::Text(format!(
                "Figures of {} more are not shown; guide identify --plots draws them.",
                count(good.len() - FIGURES, "run")
            )));
        }
        blocks
    })
}

fn methods(found: &Identification) -> Block {
    let mut rows: Vec<_> = found
        .runs
        .iter()
        .map(|run| {
            let methods = &run.methods;
            let (best, shape, energy) =
                (&methods.likelihood, &methods.likelihood_without_force, &methods.energy);
            vec![
                run.id.clone(),
                value(Some(run.depth_mm), 1),
                estimate(best.k_kpa, best.ci95_kpa, 2),
                estimate(shape.k_kpa, shape.ci95_kpa, 2),
                estimate(energy.k_kpa, energy.ci95_kpa, 2),
                value(methods.energy_as_printed.k_kpa, 2),
            ]
        })
        .collect();
    let mut last = vec!["pooled".to_owned(), "-".to_owned()];
    last.push(estimate(Some(found.pooled.k_kpa), Some(found.pooled.ci95_kpa), 2));
    last.extend(std::iter::repeat_n("-".to_owned(), 3));
    rows.push(last);
    let columns = [
        words("run"),
        number("depth, mm"),
        number("beam likelihood"),
        number("without force"),
        number("energy, corrected"),
        number("energy, as printed"),
    ];
    Block::table("Foundation modulus K, kPa (95 % interval), by every method", columns, rows)
}

/// Noise that was taken, and how well each channel is met.
fn fits(found: &Identification) -> Block {
    let columns = [
        words("run"),
        number("holds used"),
        number("displacement sd, mm"),
        number("force sd, N"),
        number("shape sd, mm"),
        number("misfit of displacement"),
        number("of force"),
        number("of shape"),
    ];
    let caption =
        "Noise of a reading, and chi-square per value of the fit (about 1 or less where the model is right)";
    Block::table(
        caption,
        columns,
        found
            .runs
            .iter()
            .map(|run| {
                let noise = run.noise.as_ref();
                vec![
                    run.id.clone(),
                    run.holds.iter().filter(|hold| hold.used).count().to_string(),
                    value(noise.map(|noise| noise.displacement_mm), 4),
                    value(noise.map(|noise| noise.force_n), 4),
                    value(noise.map(|noise| noise.shape_mm), 4),
                    channel_text("displacement", &run.fit),
                    channel_text("force", &run.fit),
                    channel_text("shape", &run.fit),
                ]
            })
            .collect(),
    )
}

fn channel_text(name: &str, run_fit: &[inference::identify::ChannelResult]) -> String {
    let channel_fit = run_fit.iter().find(|fit| fit.channel == name).filter(|fit| fit.count > 0);
    value(channel_fit.map(|fit| fit.chi_square / fit.count as f64), 2)
}

fn pooled(found: &Identification) -> Vec<Block> {
    let mut blocks = Vec::new();
    if let Some(test) = &found.pooled.heterogeneity {
        blocks.push(Block::Text(format!(
            "Whether the runs share one K: Cochran's Q {:.2} with {} degrees of freedom, p: {}.",
            test.q,
            test.degrees_of_freedom,
            p_value(Some(test.p))
        )));
    }
    if let Some(Directions { y, x, ratio_x_to_y, ratio_ci95 }) = &found.directions {
        blocks.push(Block::Text(format!(
            "By plane: vertical K {} kPa, horizontal K {} kPa, ratio {}.",
            estimate(y.k_kpa, y.ci95_kpa, 2),
            estimate(x.k_kpa, x.ci95_kpa, 2),
            estimate(Some(*ratio_x_to_y), Some(*ratio_ci95), 3)
        )));
    }
    blocks
}

fn relations(found: &Identification) -> Block {
    let youngs = &found.youngs_modulus_kpa;
    let rows = youngs.relations.iter().map(|one| {
        let is_chosen = one.relation == youngs.relation;
        let modulus = match is_chosen {
            true => estimate(youngs.value, youngs.ci95, 2),
            false => value(Some(one.youngs_modulus_kpa), 2),
        };
        vec![one.relation.to_owned(), modulus, one.validity.to_owned()]
    });
    let caption = format!("Young's modulus by every relation; {} is the one chosen", youngs.relation);
    Block::table(caption, [words("relation"), number("E, kPa"), words("holds for")], rows.collect())
}

fn reference(found: &Identification) -> Option<Vec<Block>> {
    let reference = found.reference.as_ref()?;
    let row = vec![
        "indentation".to_owned(),
        estimate(Some(reference.k_kpa), reference.ci95_kpa, 2),
        value(reference.sd_kpa, 2),
        reference.runs.to_string(),
        p_value(reference.t_test_p),
        p_value(reference.t_test_p_youngs),
    ];
    let columns = [
        words("reference"),
        number("E, kPa (95 %)"),
        number("sd, kPa"),
        number("indentations"),
        number("p against K"),
        number("p against E"),
    ];
    let of_one = [
        words("indentation"),
        words("indenter"),
        number("E, kPa (95 %)"),
        number("contact, mm"),
        number("force offset, N"),
        number("not linear, %"),
        number("thickness factor"),
    ];
    let of_depth = [
        number("depth, mm"),
        number("runs"),
        number("K, kPa"),
        number("sd, kPa"),
        number("p against indentation"),
        number("E, kPa"),
        number("sd, kPa"),
        number("p against indentation"),
    ];
    Some(vec![
        Block::table("Independent indentation, and Welch's t-test against the runs", columns, vec![row]),
        Block::table(
            "Every indentation",
            of_one,
            reference
                .indentations
                .iter()
                .map(|one| {
                    vec![
                        one.id.clone(),
                        one.indenter.to_owned(),
                        estimate(Some(one.youngs_modulus_kpa), one.ci95_kpa, 2),
                        value(one.contact_mm, 3),
                        value(one.force_offset_n, 4),
                        value(Some(one.nonlinearity_percent), 1),
                        value(Some(one.thickness_factor), 3),
                    ]
                })
                .collect(),
        ),
        Block::table(
            "The runs of every depth, mean and standard deviation, with Welch's t-test",
            of_depth,
            reference
                .depths
                .iter()
                .map(|one| {
                    vec![
                        value(Some(one.depth_mm), 1),
                        one.runs.to_string(),
                        value(Some(one.k_kpa), 2),
                        value(one.k_sd_kpa, 2),
                        p_value(one.t_test_p),
                        value(one.youngs_modulus_kpa, 2),
                        value(one.youngs_modulus_sd_kpa, 2),
                        p_value(one.t_test_p_youngs),
                    ]
                })
                .collect(),
        ),
    ])
}

fn figures_of(session: &Session, run: &RunResult) -> Vec<Block> {
    let mut drawn = run.clone();
    let of_hold = (POINTS / run.shape.len().max(1)).max(POINTS_OF_HOLD);
    for shape in &mut drawn.shape {
        for list in [&mut shape.z_mm, &mut shape.measured_mm, &mut shape.fitted_mm] {
            *list = thinned(list, of_hold);
        }
    }
    let (shape, other_residuals): (Vec<_>, Vec<_>) =
        run.residuals.iter().partition(|one| one.channel == "shape");
    drawn.residuals = other_residuals.into_iter().chain(thinned(&shape, POINTS)).collect();
    let mut blocks = vec![
        Block::Heading(format!("Run {}", run.id)),
        Block::figure(
            format!(
                "Run {}: needle shape measured (dots) and fitted (lines) by hold; below, the residuals",
                run.id
            ),
            figures::shape(&drawn),
        ),
    ];
    if let Some(recorded) = session.lateral.iter().find(|recorded| recorded.id == run.id) {
        blocks.push(Block::figure(
            format!("Run {}: force against displacement of guide 2, recorded and fitted", run.id),
            figures::force(recorded, &drawn),
        ));
    }
    blocks.push(Block::figure(
        format!(
            "Run {}: residuals in standard deviations, along the needle and over time; grey lines at -2, 0 and 2",
            run.id
        ),
        figures::run_residuals(&drawn),
    ));
    blocks
}
