//! Sensors that fail now and then: what they read, and in which readings.

use super::random::Random;

/// What a channel reads when it fails.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Effect {
    /// Nothing at all.
    Zero,
    /// What it read when it began to fail.
    Frozen,
    /// The same, with its last bit alive.
    LastBit,
    /// The end of its range.
    Saturated,
}

/// In which readings it fails.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Pattern {
    /// In all but one of so many; 0: in all.
    AllButOneOf(u8),
    /// In each with this chance, percent.
    Percent(u8),
}

/// How the two channels of a sensor fail.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Failing {
    /// What they read.
    pub effect: Effect,
    /// In which readings.
    pub pattern: Pattern,
    /// Which of them.
    pub channels: [bool; 2],
}

impl Failing {
    /// Every pattern that is tried of itself, on either channel and on both.
    pub fn all() -> impl Iterator<Item = Self> {
        let effects = [Effect::Zero, Effect::Frozen, Effect::LastBit, Effect::Saturated];
        let patterns = [0, 2, 3, 4].map(Pattern::AllButOneOf).into_iter();
        let patterns = patterns.chain((5..=95).step_by(15).map(Pattern::Percent));
        let channels = [[true, false], [false, true], [true, true]];
        patterns.flat_map(move |pattern| {
            effects.into_iter().flat_map(move |effect| {
                channels.into_iter().map(move |channels| Self { effect, pattern, channels })
            })
        })
    }

    /// One of them.
    pub fn any(random: &mut Random) -> Self {
        let effect = [Effect::Zero, Effect::Frozen, Effect::LastBit, Effect::Saturated];
        let pattern = match random.below(8) {
            0 => Pattern::AllButOneOf(0),
            1..4 => Pattern::AllButOneOf(2 + random.below(3) as u8),
            _ => Pattern::Percent(random.between(5, 95) as u8),
        };
        let channels = [[true, false], [false, true], [true, true]];
        Self {
            effect: effect[random.below(4) as usize],
            pattern,
            channels: channels[random.below(3) as usize],
        }
    }

    /// What is read in a period: of the true codes, those when it began to fail, and the end of the range.
    pub fn codes(&self, period: u64, codes: [i32; 2], kept: [i32; 2], most: i32) -> [i32; 2] {
        let fails = match self.pattern {
            Pattern::AllButOneOf(0) => true,
            Pattern::AllButOneOf(count) => !period.is_multiple_of(count.into()),
            Pattern::Percent(percent) => Random::new(period).below(100) < percent.into(),
        };
        let mut read = codes;
        for ((read, kept), channel) in read.iter_mut().zip(kept).zip(self.channels) {
            if channel && fails {
                *read = match self.effect {
                    Effect::Zero => 0,
                    Effect::Frozen => kept,
                    Effect::LastBit => kept + (period / 3 % 2) as i32,
                    Effect::Saturated => most,
                };
            }
        }
        read
    }
}
