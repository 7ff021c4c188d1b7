//! Random numbers of the sequences and of the plant.

/// SplitMix64 (Steele, Lea, Flood: Fast splittable pseudorandom number generators, 2014): the seeds that are kept stay the same
/// sequences when a library changes. Bytes of a fuzzer come before its numbers, as long as there are some.
#[derive(Debug, Clone)]
pub struct Random {
    state: u64,
    bytes: Vec<u8>,
}

impl Random {
    /// The numbers of a seed.
    pub fn new(seed: u64) -> Self {
        Self { state: seed, bytes: Vec::new() }
    }

    /// First these bytes, then the numbers of a seed.
    pub fn after(bytes: &[u8], seed: u64) -> Self {
        Self { state: seed, bytes: bytes.iter().rev().copied().collect() }
    }

    /// 64 bits.
    pub fn bits(&mut self) -> u64 {
        if let Some(byte) = self.bytes.pop() {
            // The upper bits decide, whatever the limit.
            return u64::from(byte) << 56 | u64::from(self.bytes.pop().unwrap_or_default()) << 48;
        }
        self.state = self.state.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mixed = (self.state ^ (self.state >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        mixed ^ (mixed >> 31)
    }

    /// At least 0 and below a limit.
    pub fn below(&mut self, limit: u32) -> u32 {
        (((self.bits() >> 32) * u64::from(limit)) >> 32) as u32
    }

    /// Between two numbers, both included.
    pub fn between(&mut self, least: i32, most: i32) -> i32 {
        least + self.below((most - least + 1) as u32) as i32
    }

    /// True once in so many times.
    pub fn one_in(&mut self, count: u32) -> bool {
        self.below(count) == 0
    }

    /// One of these.
    pub fn pick<T: Copy, const N: usize>(&mut self, choices: [T; N]) -> T {
        choices[self.below(N as u32) as usize]
    }

    /// Standard normal but for tails beyond 3.4: the sum of four uniform numbers.
    pub fn normal(&mut self) -> f64 {
        let bits = self.bits();
        let sum: u64 = [0, 16, 32, 48].into_iter().map(|shift| bits >> shift & 0xffff).sum();
        // Four uniforms of variance 1/12 each.
        (sum as f64 / 65_536.0 - 2.0) * 3.0_f64.sqrt()
    }
}
