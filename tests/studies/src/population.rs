//! Statistics over many sessions: coverage of means, spreads and predictions, and which shared effects are named.
//!
//! Records of sessions are drawn from templates: information, correlations and errors of a template are those of a diagnosed session of the
//! independent generator, its estimates are drawn again from the truth of a population: three tissues, twenty rigs over a year, one with a
//! gain of its force sensor, one with a gain from a date on, and a share of sessions with something that no effect describes, whose
//! records are those of diagnosed sessions unchanged.

use nalgebra::{DMatrix, DVector};
use population::{Options, Population, SharedKind, Summary, analyse};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

/// Tissues with the geometric mean of K in kilopascals and the standard deviation of ln K between subjects.
const TISSUES: [(&str, f64, f64); 3] = [("gel", 12.0, 0.08), ("liver", 5.0, 0.15), ("muscle", 20.0, 0.25)];
/// Rigs, and days over which they measure.
const RIGS: usize = 20;
const DAYS: usize = 365;
/// A date in the middle of which the records lie, as a day of [`Summary::day`].
const FIRST_DAY: f64 = 2_461_000.0;
/// The effect that two rigs have.
pub const EFFECT: &str = "sensor.force_gain";

/// True parameters of a population.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Truth {
    /// Sessions.
    pub sessions: usize,
    /// Gain of the first rig's force sensor.
    pub gain: f64,
    /// Gain of the second rig's from the middle of the year on.
    pub step: f64,
    /// Share of sessions with something that no effect describes.
    pub foreign: f64,
}

/// Sums over repetitions.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Outcome {
    /// Repetitions.
    pub repetitions: usize,
    /// Means and standard deviations inside their intervals, of three groups a repetition.
    pub means: usize,
    /// Standard deviations between subjects inside their intervals.
    pub taus: usize,
    /// New subjects inside the prediction interval, of a hundred a group.
    pub predicted: usize,
    /// Repetitions in which the gain is named for its rig, or is in the class of what is.
    pub gains: usize,
    /// Repetitions in which a gain that began on a date is named for its rig, as a step or as a trend.
    pub drifts: usize,
    /// Repetitions in which it is named as a step, and those of them whose interval holds the date.
    pub steps: [usize; 2],
    /// Repetitions in which another rig, label or effect is named.
    pub others: usize,
    /// Foreign sessions, and those of them that are listed.
    pub foreign: [usize; 2],
    /// Other sessions, and those of them that are listed.
    pub clean: [usize; 2],
}

/// A template with the root of its information.
struct Template {
    record: Summary,
    information: DMatrix<f64>,
    root: DMatrix<f64>,
    /// Number of the amplitude that stands for the effect.
    effect: Option<usize>,
}

impl Template {
    fn new(record: &Summary) -> Option<Self> {
        let result = record.result.as_ref()?;
        let amplitudes = &result.amplitudes;
        let information = DMatrix::from_fn(amplitudes.len(), amplitudes.len(), |i, j| {
            correlation(i, j, &result.correlation_per_mille)
                * (amplitudes[i].information * amplitudes[j].information).sqrt()
        });
        // Rounded correlations may leave tiny negative eigenvalues.
        let eigen = information.clone().symmetric_eigen();
        let roots = eigen.eigenvalues.map(|value| value.max(0.0).sqrt());
        Some(Self {
            root: eigen.eigenvectors * DMatrix::from_diagonal(&roots),
            effect: amplitudes.iter().position(|one| one.effect == EFFECT),
            record: record.clone(),
            information,
        })
    }

    /// A record of a session with this K and this amplitude of the effect.
    fn draw(&self, ln_k: f64, amplitude: f64, random: &mut ChaCha8Rng) -> Summary {
        let mut record = self.record.clone();
        let Some(result) = &mut record.result else { return record };
        let count = result.amplitudes.len();
        let mut truth = DVector::zeros(count);
        if let Some(effect) = self.effect {
            truth[effect] = amplitude;
        }
        let noise = DVector::from_fn(count, |_, _| StandardNormal.sample(random));
        let scores = &self.information * &truth + &self.root * noise;
        let mut measured = ln_k + result.ln_k_sd * Distribution::<f64>::sample(&StandardNormal, random);
        for ((one, score), truth) in result.amplitudes.iter_mut().zip(scores.iter()).zip(truth.iter()) {
            one.score = *score;
            measured += one.ln_k_slope * truth;
        }
        result.verdict = "adequate".to_owned();
        result.named.clear();
        set_k(result, measured);
        record
    }
}

fn correlation(i: usize, j: usize, correlation_per_mille: &[i16]) -> f64 {
    let (low, high) = (i.min(j), i.max(j));
    if low == high { 1.0 } else { 1e-3 * f64::from(correlation_per_mille[high * (high - 1) / 2 + low]) }
}

fn set_k(result: &mut population::SessionResult, ln_k: f64) {
    let half = 1.959_964 * result.ln_k_sd;
    result.ln_k_kpa = ln_k;
    result.k_kpa = ln_k.exp();
    result.k_ci95_kpa = [(ln_k - half).exp(), (ln_k + half).exp()];
}

/// Records of a population; `foreign` are of sessions of tissue with a K of `foreign_k_kpa`. Also which of them are foreign.
pub fn draw(
    truth: &Truth,
    templates: &[Summary],
    foreign: &[Summary],
    foreign_k_kpa: f64,
    seed: u64,
) -> Vec<(Summary, bool)> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let templates: Vec<Template> = templates.iter().filter_map(Template::new).collect();
    (0..truth.sessions)
        .map(|number| {
            let (tissue, mean_kpa, tau) = TISSUES[number % TISSUES.len()];
            let (rig, day) = (random.random_range(0..RIGS), random.random_range(0..DAYS));
            let ln_k = mean_kpa.ln() + tau * Distribution::<f64>::sample(&StandardNormal, &mut random);
            let gain: f64 = match rig {
                0 => truth.gain,
                1 if day >= DAYS / 2 => truth.step,
                _ => 1.0,
            };
            let is_foreign = !foreign.is_empty() && random.random::<f64>() < truth.foreign;
            let mut record = if is_foreign {
                let mut record = foreign[random.random_range(0..foreign.len())].clone();
                if let Some(result) = &mut record.result {
                    let ln_error = result.ln_k_kpa - foreign_k_kpa.ln();
                    set_k(result, ln_k + ln_error);
                }
                record
            } else {
                let template = &templates[random.random_range(0..templates.len())];
                template.draw(ln_k, gain.ln(), &mut random)
            };
            record.session = format!("s{number:06}");
            record.rig = Some(format!("r{rig:02}"));
            record.tissue = Some(tissue.to_owned());
            record.subject = Some(format!("p{number:06}"));
            record.date = population::date_of(FIRST_DAY + day as f64);
            (record, is_foreign)
        })
        .collect()
}

/// Draws and analyses populations.
///
/// # Errors
/// [`population::PopulationError`] where a population cannot be analysed.
pub fn study(
    truth: &Truth,
    templates: &[Summary],
    foreign: (&[Summary], f64),
    repetitions: usize,
    seed: u64,
) -> Result<Outcome, population::PopulationError> {
    let mut outcome = Outcome::default();
    for repetition in 0..repetitions {
        let seed = seed.wrapping_mul(1_000_003).wrapping_add(repetition as u64);
        let records = draw(truth, templates, foreign.0, foreign.1, seed);
        let is_foreign: Vec<bool> = records.iter().map(|(_, foreign)| *foreign).collect();
        let options = Options { by: vec!["tissue".to_owned()], ..Options::default() };
        let population =
            analyse(records.into_iter().map(|(record, _)| record).collect::<Vec<_>>(), &options)?;
        outcome.add(&population, truth, &is_foreign, seed);
    }
    Ok(outcome)
}

impl Outcome {
    fn add(&mut self, found: &Population, truth: &Truth, is_foreign: &[bool], seed: u64) {
        let mut random = ChaCha8Rng::seed_from_u64(seed ^ 0x5eed);
        for (tissue, mean_kpa, tau) in TISSUES {
            let Some(group) = found.groups.iter().find(|group| group.group == tissue) else { continue };
            self.means += count_inside(Some(group.k_kpa.ci95), mean_kpa);
            self.taus += count_inside(group.tau_ci95, tau);
            for _ in 0..100 {
                let new = mean_kpa.ln() + tau * Distribution::<f64>::sample(&StandardNormal, &mut random);
                self.predicted += count_inside(group.new_subject95_kpa, new.exp());
            }
        }
        let began = population::date_of(FIRST_DAY + (DAYS / 2) as f64);
        let (mut gain, mut drift, mut step, mut was_covered, mut other_effect) =
            (false, false, false, false, false);
        for one in &found.shared_effects {
            let is_effect =
                one.effect == EFFECT || one.class.iter().any(|other_effect| other_effect.effect == EFFECT);
            match one.group.as_str() {
                "r00" if is_effect && truth.gain != 1.0 => gain = true,
                "r01" if is_effect && truth.step != 1.0 => {
                    drift = true;
                    step |= one.kind == SharedKind::Step;
                    was_covered |= one
                        .began_ci95
                        .as_ref()
                        .zip(began.as_ref())
                        .is_some_and(|([from, to], began)| from <= began && began <= to);
                }
                _ => other_effect = true,
            }
        }
        self.repetitions += 1;
        self.gains += usize::from(gain);
        self.drifts += usize::from(drift);
        self.steps[0] += usize::from(step);
        self.steps[1] += usize::from(was_covered);
        self.others += usize::from(other_effect);
        for (index, is_foreign) in is_foreign.iter().enumerate() {
            let name = format!("s{index:06}");
            let listed =
                usize::from(found.listed.binary_search_by(|one| one.session.as_str().cmp(&name)).is_ok());
            let counts = if *is_foreign { &mut self.foreign } else { &mut self.clean };
            counts[0] += 1;
            counts[1] += listed;
        }
    }
}

fn count_inside(ends: Option<[f64; 2]>, value: f64) -> usize {
    usize::from(ends.is_some_and(|[low, high]| (low..=high).contains(&value)))
}
