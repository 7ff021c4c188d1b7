//! The steps of a diagnosis, one after the other.

use super::adequacy::{self, Adequacy, regions};
use super::averaged::Averaged;
use super::choice::{Choice, choose};
use super::data::{Kind, Run};
use super::found::{Found, Member};
use super::known::{self, Released};
use super::layout::{Layout, kinds};
use super::noise::Noise;
use super::on_springs::OnSprings;
use super::remaining::Remaining;
use super::report::{self, DiagnosisReport};
use super::split::{Training, split};
use super::start::{Noises, Start, fit_start};
use super::whole::{Stated, Whole};
use super::{DiagnoseError, Diagnosis, HeldOutMisfit, Options, RemainingSize, Verdict, runs_of, share_nodes};
use formats::session::Session;
use mechanics::effects::Effect;
use modulus::walls::WallsResult;

/// The whole workflow. `beside` computes a further result from the chosen starting model.
pub(super) fn workflow<T>(
    session: &Session,
    options: &Options,
    mut on_progress: impl FnMut(&str),
    beside: impl FnOnce(&Start) -> Result<T, DiagnoseError>,
) -> Result<(Diagnosis, T), DiagnoseError> {
    let (runs, mut warnings) = runs_of(session)?;
    let all_runs: Vec<Run> = runs.clone();
    let (Training { mut runs, rule }, held_out) = split(runs);
    on_progress(&rule);
    let (noise, disagreements) = Noise::with_disagreements(&runs, &session.stated_noise());
    warnings.extend(disagreements);
    let given_effects: Vec<&'static dyn Effect> = options.given.iter().map(|(effect, _)| *effect).collect();
    let mut layout = Layout::new(&session.rig, &runs, given_effects);
    layout.known = options.known.clone().into();
    let mut noises = Noises { session: noise, reference: noise };
    let mut multiples = options.discrepancy.clone();
    if let Some(reference) = &options.reference {
        on_progress("the reference is fitted");
        let (mut of_reference, skipped) = runs_of(reference)?;
        of_reference.iter_mut().for_each(|run| run.is_reference = true);
        warnings.extend(skipped.into_iter().map(|what| format!("reference: {what}")));
        noises.reference = Noise::of(&of_reference, &reference.stated_noise());
        let alone = Layout { rig: reference.rig.clone(), kinds: kinds(&of_reference), ..layout.clone() };
        let fitted = fit_start(&alone, &of_reference, &noises, &options.given, &multiples)?;
        multiples.extend(fitted.fitted.multiples(&fitted.patterns));
        layout.reference = Some(reference.rig.clone());
        runs.extend(of_reference);
        layout.kinds = kinds(&runs);
        share_nodes(&mut runs);
    }
    let Released { start, as_known, moved: moved_since } =
        known::released(&mut layout, |layout| fit_start(layout, &runs, &noises, &options.given, &multiples))?;
    let judge = held_out.judge(&start, &noise, &multiples)?;
    on_progress(&format!("{} effects are scored", mechanics::effects::EFFECTS.len() - layout.effects.len()));
    let Choice { foundation, start, found, beside: other_foundation } =
        choose(start, &judge, options, &session.tissue, &mut on_progress)?;
    let more = beside(&start)?;
    let search_result = found.around_itself(&start, &judge, &multiples);
    let (search_result, is_stated_wrong) = search_result.with_names_of_stated(&start, &judge)?;
    // If the rig has changed since it was characterized, the misfit before is that with the known values. The change needs no name,
    // because its effect is in the model already.
    let as_known = match as_known {
        Some(known) => Some(known.beside(&start)?),
        None if is_stated_wrong => Some(start.as_stated()?),
        None => None,
    };
    let disagreement = as_known.as_ref().map(Start::adequacy).transpose()?;
    let adequacy_before = start.adequacy()?;
    let compared = as_known.as_ref().unwrap_or(&start);
    let where_start = regions(&start.fitted, &start.runs, &start.patterns)?;
    let where_before = match &as_known {
        Some(known) => regions(&known.fitted, &known.runs, &known.patterns)?,
        None => where_start.clone(),
    };
    let where_left = adequacy::regions(&search_result.fitted, &start.runs, &start.patterns)?;
    let is_explained = !adequacy::has_regions_beyond_prior(&start.fitted, &start.runs, &start.patterns)?;
    let is_adequate = adequacy_before.is_adequate() && is_explained;
    let compared = compared.fitted.clone();
    let Start { runs: prepared, patterns, fitted: start } = start;
    let adequacy_after = Adequacy::of(&search_result.fitted, &prepared, &patterns)?;

    on_progress("the models are compared on the held-out runs");
    let gap_of_found = judge.gap(&compared, &search_result.fitted, options.seed)?;
    // With a reference the held-out misfit is not judged, because the reference may have it too.
    let judged = gap_of_found.as_ref().filter(|_| options.reference.is_none());
    let verdict = verdict(&search_result, is_adequate, judged);
    // A misfit that changes the modulus by more than its interval is not adequate, even if it is within usual imperfections.
    let is_unexplained = verdict == Verdict::Adequate
        && Remaining::of(&adequacy_before, &start, &patterns, None).size == RemainingSize::Large;
    let verdict = if is_unexplained { Verdict::Unexplained } else { verdict };
    let is_named = matches!(verdict, Verdict::Named | Verdict::Ambiguous);
    let final_fit = if is_named { &search_result.fitted } else { &start };
    let gap = if is_named { gap_of_found } else { judge.gap(&compared, final_fit, options.seed)? };
    let remaining = Remaining::of(
        if is_named { &adequacy_after } else { &adequacy_before },
        final_fit,
        &patterns,
        gap.as_ref(),
    );
    let multiples_found = final_fit.multiples(&patterns);
    let final_fit = if is_named { final_fit.clone() } else { start.clone().over_sizes(&patterns) };
    let averaged = Averaged::over(&final_fit, &search_result, is_named, &patterns, touched_m(&all_runs));
    let mut stated = Stated {
        start: Start { runs: prepared, patterns, fitted: start.clone() },
        final_fit,
        averaged,
        beside: other_foundation,
        foundation,
    };
    // The noise of the fits from which values are reported.
    let mut stated_noise = noise;
    if judge.runs() > 0 {
        on_progress("the models are fitted to all runs");
        let mut whole = all_runs.clone();
        whole.extend(runs.iter().filter(|run| run.is_reference).cloned());
        share_nodes(&mut whole);
        noises.session = Noise::of(&all_runs, &session.stated_noise());
        let of_all = Whole::new(&layout, &whole, &noises, &options.given, &multiples)
            .and_then(|whole| whole.stated(&stated, is_named, &multiples));
        match of_all {
            Ok(of_all) => (stated, stated_noise) = (of_all, noises.session),
            Err(why) => {
                warnings.push(format!("the values are those of fits without the held-out data: {why}"))
            }
        }
    }
    let on_springs = OnSprings::of(&stated.start, &stated.averaged, &stated.beside)?;
    let report = DiagnosisReport {
        session,
        options,
        all: &all_runs,
        start: &start,
        found: &search_result,
        final_fit: &stated.final_fit,
        averaged: stated.averaged,
        other_foundation: stated.beside,
        on_springs,
        noise: &stated_noise,
        adequacy: [&adequacy_before, &adequacy_after],
        disagreement: disagreement.as_ref(),
        verdict,
        foundation: stated.foundation,
        split: rule,
        multiples: multiples_found,
        held_out: judge.runs(),
    };
    let mut result =
        report.diagnosis(where_before.iter().map(report::region).collect(), gap, remaining, warnings);
    if verdict == Verdict::Adequate && disagreement.is_none() {
        // Imperfections within the limits of their priors explain these regions.
        result.regions.clear();
    }
    result.left =
        if is_named { where_left.iter().map(report::region).collect() } else { result.regions.clone() };
    result.moved_since = moved_since;
    if let Some(draws) = options.draws {
        on_progress("draws are taken");
        result.draws =
            Some(report.sources(&stated.start.runs, &stated.start.patterns).draws(&result, draws)?);
    }
    if !options.plans.is_empty() {
        on_progress("the expected information of further runs is computed");
        result.prospects = Some(report.foreseen(&stated.start.runs, &stated.start.patterns)?);
    }
    let walls =
        WallsResult::new(session.tissue.walls, &session.rig.needle, touched_m(&all_runs), options.poisson);
    Ok((result.with_walls(walls), more))
}

/// Greatest depth that the runs have reached: of lateral runs if there are any, otherwise of insertions.
fn touched_m(runs: &[Run]) -> f64 {
    let [lateral, _] = kinds(runs);
    runs.iter()
        .filter(|run| (run.kind == Kind::Lateral) == lateral)
        .map(|run| run.depth_m)
        .fold(0.0, f64::max)
}

/// The verdict. No effect is named that leaves more than half of the held-out misfit.
fn verdict(found: &Found, is_adequate: bool, gap: Option<&HeldOutMisfit>) -> Verdict {
    let removed = gap.and_then(|gap| gap.removed);
    match found.members.is_empty() {
        true if is_adequate => Verdict::Adequate,
        true => Verdict::Unexplained,
        false if removed.is_some_and(|share| share < 0.5) => Verdict::Unexplained,
        false if found.members.iter().all(Member::is_the_only_explanation) => Verdict::Named,
        false => Verdict::Ambiguous,
    }
}
