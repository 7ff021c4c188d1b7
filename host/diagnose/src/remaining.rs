//! Remaining difference between a model and the measurement once every named effect is in it.

use super::adequacy::Adequacy;
use super::evidence::Patterns;
use super::layout::NORMAL_975;
use super::posterior::Fitted;
use super::results::{HeldOutMisfit, RemainingResult, RemainingSize};

/// A size this many times the everyday one is worth a line.
const ABOVE: f64 = 1.5;

/// Puts together what remains.
pub(super) struct Remaining;

impl Remaining {
    /// Beside a model whose adequacy is known.
    pub fn of(
        adequacy: &Adequacy,
        fitted: &Fitted,
        patterns: &Patterns,
        gap: Option<&HeldOutMisfit>,
    ) -> RemainingResult {
        let change_ln = fitted.change_without_discrepancy(patterns);
        let size = if adequacy.is_within_noise() {
            RemainingSize::WithinNoise
        } else if change_ln.is_some_and(|change| change.abs() <= NORMAL_975 * fitted.sd(0)) {
            RemainingSize::Small
        } else {
            RemainingSize::Large
        };
        let rms = adequacy.discrepancy.iter().map(|(channel, sd)| {
            let name = format!("{}_{}", channel.name(), channel.unit().to_lowercase());
            (name, channel.per_si() * sd)
        });
        let larger_groups = patterns.groups.iter().zip(&fitted.sizes).filter_map(|(group, size)| {
            let times = group.multiple * size / group.everyday;
            (times > ABOVE).then(|| (group.name.to_owned(), times))
        });
        RemainingResult {
            size,
            rms: rms.collect(),
            share_of_gap: gap.and_then(|gap| gap.removed).map(|removed| (1.0 - removed).max(0.0)),
            k_change_without_discrepancy: change_ln.map_or(f64::NAN, |change| change.exp() - 1.0),
            above_everyday: larger_groups.collect(),
        }
    }
}
