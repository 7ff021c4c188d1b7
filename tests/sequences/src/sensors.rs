//! Sensors that fail now and then: what they read, and in which readings.

use crate::random::Random;

/// Reading of a channel when it fails.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Effect {
    /// Zero.
    Zero,
    /// Reading when it began to fail.
    Frozen,
    /// The same, with its last bit alive.
    LastBit,
    /// Last reading when it was in order: a converter that skips conversions.
    Held,
    /// The end of its range.
    Saturated,
    /// Zero, with the noise of the converter: a contact to a shorted input. No code repeats, and nothing but its jumps tells it from a
    /// sound channel without a load, so that it is tried only where enough readings are true ([`Failing::is_bounded`]).
    Shorted,
}

impl Effect {
    /// Every one.
    pub const ALL: [Self; 6] =
        [Self::Zero, Self::Frozen, Self::LastBit, Self::Held, Self::Saturated, Self::Shorted];
}

/// In which readings it fails.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Pattern {
    /// In all but one of so many; 0: in all.
    AllButOneOf(u8),
    /// In each with this chance, percent.
    Percent(u8),
}

/// Failure of the two channels of a sensor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Failing {
    /// Their reading.
    pub effect: Effect,
    /// In which readings.
    pub pattern: Pattern,
    /// Failing channels.
    pub channels: [bool; 2],
}

/// Noise of a converter whose input is shorted, share of its range: 0.4 uV of 9.4 mV.
const SHORTED_NOISE: f64 = 4.2e-5;

/// Either channel, and both.
const CHANNELS: [[bool; 2]; 3] = [[true, false], [false, true], [true, true]];

impl Failing {
    /// Every pattern that is tried of itself, on either channel and on both.
    pub fn all() -> impl Iterator<Item = Self> {
        let patterns = [0, 2, 3, 4].map(Pattern::AllButOneOf).into_iter();
        let patterns = patterns.chain((5..=95).step_by(15).map(Pattern::Percent));
        let failing = patterns.flat_map(move |pattern| {
            Effect::ALL.into_iter().flat_map(move |effect| {
                CHANNELS.into_iter().map(move |channels| Self { effect, pattern, channels })
            })
        });
        failing.filter(Self::is_bounded)
    }

    /// Its false readings show themselves, or two of its readings are true within the stated overshoot: of half of them at random, two of
    /// 24 but for once in 700,000.
    pub fn is_bounded(&self) -> bool {
        match (self.effect, self.pattern) {
            (Effect::Shorted, Pattern::AllButOneOf(count)) => count > 0,
            (Effect::Shorted, Pattern::Percent(percent)) => percent <= 50,
            _ => true,
        }
    }

    /// One of them.
    pub fn any(random: &mut Random) -> Self {
        loop {
            let pattern = match random.below(8) {
                0 => Pattern::AllButOneOf(0),
                1..4 => Pattern::AllButOneOf(2 + random.below(3) as u8),
                _ => Pattern::Percent(random.between(5, 95) as u8),
            };
            let failing = Self { effect: random.pick(Effect::ALL), pattern, channels: random.pick(CHANNELS) };
            if failing.is_bounded() {
                return failing;
            }
        }
    }
}

/// Two channels of a sensor with what fails of them.
#[derive(Debug, Clone)]
pub struct Contacts {
    failing: Option<Failing>,
    random: Random,
    readings: u32,
    /// Codes when they began to fail, and when they were last in order.
    began: Option<[i32; 2]>,
    latest: [i32; 2],
}

impl Default for Contacts {
    fn default() -> Self {
        Self::new(None, 0)
    }
}

impl Contacts {
    /// Channels that fail so from the next reading on.
    pub fn new(failing: Option<Failing>, seed: u64) -> Self {
        Self { failing, random: Random::new(seed), readings: 0, began: None, latest: [0; 2] }
    }

    /// Reading of these codes, where `most` is the end of the range.
    pub fn read(&mut self, codes: [i32; 2], most: i32) -> [i32; 2] {
        let Some(Failing { effect, pattern, channels }) = self.failing else { return codes };
        let first = self.began.is_none();
        let began = *self.began.get_or_insert(codes);
        if first {
            self.latest = codes;
        }
        self.readings += 1;
        let fails = match pattern {
            Pattern::AllButOneOf(0) => true,
            Pattern::AllButOneOf(count) => !self.readings.is_multiple_of(count.into()),
            Pattern::Percent(percent) => self.random.below(100) < percent.into(),
        };
        if !fails {
            self.latest = codes;
            return codes;
        }
        let mut read = codes;
        for axis in [0, 1] {
            if channels[axis] {
                read[axis] = match effect {
                    Effect::Zero => 0,
                    Effect::Frozen => began[axis],
                    Effect::LastBit => began[axis] ^ self.random.below(2) as i32,
                    Effect::Held => self.latest[axis],
                    Effect::Saturated => most,
                    Effect::Shorted => {
                        (SHORTED_NOISE * f64::from(most) * self.random.normal()).round() as i32
                    }
                };
            }
        }
        read
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Reading of the codes 10, 20, 30 and so on.
    fn read(effect: Effect, pattern: Pattern) -> Vec<i32> {
        let mut contacts = Contacts::new(Some(Failing { effect, pattern, channels: [true, false] }), 1);
        (1..=6)
            .map(|count| {
                let [read, sound] = contacts.read([10 * count; 2], 99);
                assert_eq!(sound, 10 * count, "the other channel");
                read
            })
            .collect()
    }

    #[test]
    fn a_channel_fails_in_the_readings_of_its_pattern() {
        assert_eq!(read(Effect::Zero, Pattern::AllButOneOf(2)), [0, 20, 0, 40, 0, 60]);
        assert_eq!(read(Effect::Zero, Pattern::AllButOneOf(3)), [0, 0, 30, 0, 0, 60]);
        assert_eq!(read(Effect::Frozen, Pattern::AllButOneOf(0)), [10; 6]);
        assert_eq!(read(Effect::Held, Pattern::AllButOneOf(3)), [10, 10, 30, 30, 30, 60]);
        assert_eq!(read(Effect::Saturated, Pattern::AllButOneOf(2)), [99, 20, 99, 40, 99, 60]);
        let last_bit = read(Effect::LastBit, Pattern::AllButOneOf(0));
        assert!(last_bit.iter().all(|code| code | 1 == 11) && last_bit.contains(&11), "{last_bit:?}");
        let half = read(Effect::Zero, Pattern::Percent(50));
        assert!(half.contains(&0) && half.iter().any(|code| *code > 0), "{half:?}");
    }
}
