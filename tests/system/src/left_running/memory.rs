//! The size of a process over time.

use anyhow::{Result, ensure};

/// Largest growth of a process in [`WINDOW_MS`], bytes: less than a hundredth of the samples of that time.
pub(super) const GROWTH_LIMIT_BYTES: u64 = 512 * 1024;
/// Time over which growth is checked, milliseconds of the rig's.
const WINDOW_MS: u64 = 600_000;
/// Interval at which the size is sampled.
const SAMPLE_INTERVAL_MS: u64 = 1_000;

/// The size of a process over time.
#[derive(Debug)]
pub(super) struct Memory {
    process: u32,
    from_ms: u64,
    next_ms: u64,
    window: Option<(u64, u64)>,
    /// After warming up, and last.
    pub(super) first_bytes: Option<u64>,
    /// The latest.
    pub(super) last_bytes: Option<u64>,
}

impl Memory {
    /// The process of this number: growth counts from this time on.
    pub(super) fn of(process: u32, from_ms: u64) -> Self {
        Self { process, from_ms, next_ms: from_ms, window: None, first_bytes: None, last_bytes: None }
    }

    /// Samples it now and then.
    ///
    /// # Errors
    /// Where it has grown by more than it may.
    pub(super) fn sample(&mut self, now_ms: u64) -> Result<()> {
        if now_ms < self.next_ms {
            return Ok(());
        }
        self.next_ms = now_ms + SAMPLE_INTERVAL_MS;
        self.last_bytes = resident_bytes(self.process);
        let Some(bytes) = self.last_bytes else { return Ok(()) };
        self.first_bytes.get_or_insert(bytes);
        let &mut (window_start_ms, least) = self.window.get_or_insert((self.from_ms, bytes));
        ensure!(
            bytes <= least + GROWTH_LIMIT_BYTES,
            "process {} has grown from {least} to {bytes} bytes in {} s of the rig",
            self.process,
            (now_ms - window_start_ms) / 1_000
        );
        if now_ms >= window_start_ms + WINDOW_MS {
            self.window = Some((now_ms, bytes));
        }
        Ok(())
    }
}

/// Memory of a process that is in use; `None` where the system does not report it.
fn resident_bytes(process: u32) -> Option<u64> {
    let statm = std::fs::read_to_string(format!("/proc/{process}/statm")).ok()?;
    let pages: u64 = statm.split_whitespace().nth(1)?.parse().ok()?;
    Some(pages * rustix::param::page_size() as u64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_memory_of_a_process_is_known_where_the_system_reports_it() {
        if cfg!(target_os = "linux") {
            assert!(resident_bytes(std::process::id()).unwrap() > 100_000);
        }
        let mut memory = Memory::of(std::process::id(), 5);
        memory.sample(4).unwrap();
        assert_eq!(memory.first_bytes, None);
        memory.sample(5).unwrap();
        assert_eq!(memory.first_bytes, memory.last_bytes);
    }
}
