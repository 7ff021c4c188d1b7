//! Figures of results, by the figure code of the program.

use figures::FigureError;
use formats::session::Session;
use inference::diagnose::Diagnosis;
use inference::identify::Identification;
use inference::predict::Prediction;
use serde::Serialize;

/// A figure as SVG text.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Figure {
    /// Name of the figure, as the program's files are named.
    pub name: String,
    /// Description of the figure, for screen readers.
    pub title: String,
    /// The figure.
    pub svg: String,
}

impl Figure {
    pub(crate) fn new(name: String, title: String, svg: String) -> Self {
        Self { name, title, svg }
    }
}

/// Shape, forces and residuals of every run.
pub fn identification(session: &Session, found: &Identification) -> Result<Vec<Figure>, FigureError> {
    let mut drawn = Vec::new();
    for run in found.runs.iter().filter(|run| run.error.is_none()) {
        let id = &run.id;
        let title = format!("Run {id}: needle shape, measured and fitted, and the residuals below");
        drawn.push(Figure::new(format!("{id}.shape"), title, figures::shape(run)?));
        if let Some(recorded) = session.lateral.iter().find(|recorded| recorded.id == *id) {
            let title = format!("Run {id}: force against displacement, measured and fitted");
            drawn.push(Figure::new(format!("{id}.force"), title, figures::force(recorded, run)?));
        }
        let title = format!("Run {id}: residuals of all readings in standard deviations");
        drawn.push(Figure::new(format!("{id}.residuals"), title, figures::run_residuals(run)?));
    }
    Ok(drawn)
}

/// Residuals, ranking and misfit.
pub fn diagnosis(found: &Diagnosis) -> Result<Vec<Figure>, FigureError> {
    let mut drawn = Vec::new();
    if let Some(gap) = &found.gap {
        let title = "Residuals of the runs that were held out, before and after".to_owned();
        drawn.push(Figure::new("residuals".to_owned(), title, figures::residuals(gap)?));
        let title = "Root mean square of the residuals, before and after".to_owned();
        drawn.push(Figure::new("gap".to_owned(), title, figures::gap(gap)?));
    }
    let title = "Log evidence of the leading effects over the starting model".to_owned();
    drawn.push(Figure::new("ranking".to_owned(), title, figures::ranking(found)?));
    if let Some(svg) = found.draws.as_ref().map(figures::predictive).transpose()?.flatten() {
        let title = "Measured forces, with their prior and posterior predictive intervals".to_owned();
        drawn.push(Figure::new("predictive".to_owned(), title, svg));
    }
    Ok(drawn)
}

/// Path and tip load of every insertion.
pub fn prediction(found: &Prediction) -> Result<Vec<Figure>, FigureError> {
    let good = found.insertions.iter().filter(|one| one.error.is_none());
    good.map(|one| {
        let title = format!("Insertion {}: path of the tip with its band, and tip load", one.id);
        Ok(Figure::new(format!("{}.path", one.id), title, figures::insertion(one)?))
    })
    .collect()
}
