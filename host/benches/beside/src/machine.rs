//! Capabilities of this machine: the rates that stated limits are computed with.

use crate::clock::Clock;
use anyhow::Result;
use std::hint::black_box;

/// Rates of one core, for code compiled as ours is.
pub struct Machine {
    /// Name of the processor.
    pub cpu: String,
    /// Additions and multiplications of doubles per second, as many at once as the compiler's vectors take.
    pub flops: f64,
    /// Bytes read from memory per second.
    pub bytes: f64,
}

impl Machine {
    /// Measures them.
    pub fn new(clock: &mut Clock) -> Result<Self> {
        let info = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
        let name = info.lines().find_map(|line| line.strip_prefix("model name")?.split_once(": "));
        let cpu = name.map_or_else(|| std::env::consts::ARCH.to_owned(), |(_, name)| name.to_owned());
        const ROUNDS: usize = 10_000;
        const CHAINS: usize = 16;
        let seconds = clock.seconds("machine flops", || {
            let mut sums = black_box([1.0_f64; CHAINS]);
            let (factor, term) = black_box((0.999_999, 1e-6));
            for _ in 0..ROUNDS {
                sums.iter_mut().for_each(|sum| *sum = *sum * factor + term);
            }
            sums
        })?;
        let memory = vec![1_u64; 8 << 20];
        Ok(Self {
            cpu,
            flops: (2 * CHAINS * ROUNDS) as f64 / seconds,
            bytes: (8 * memory.len()) as f64 / clock.seconds("machine memory", || black_box(&memory).iter().fold(0_u64, |sum, word| sum.wrapping_add(*word)))?,
        })
    }
}
