//! Sessions of a study on all cores.

use std::panic::resume_unwind;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Calls `of` with 0, 1, ... on all cores and returns what it gives, in order.
///
/// Each core has a pool of its own: in a common one a thread that waits for others takes up another session, whose time would be
/// that of the session that waits too.
pub fn on_all_cores<T: Send>(count: usize, of: impl Fn(usize) -> T + Sync) -> Vec<T> {
    let next = AtomicUsize::new(0);
    let some = || {
        let mut completed = Vec::new();
        loop {
            let number = next.fetch_add(1, Ordering::Relaxed);
            if number >= count {
                return completed;
            }
            completed.push((number, of(number)));
        }
    };
    let mut per_core: Vec<_> = std::thread::scope(|scope| {
        let cores: Vec<_> = (0..rayon::current_num_threads())
            .map(|_| {
                scope.spawn(|| match rayon::ThreadPoolBuilder::new().num_threads(1).build() {
                    Ok(pool) => pool.install(some),
                    Err(_) => some(),
                })
            })
            .collect();
        cores.into_iter().flat_map(|core| core.join().unwrap_or_else(|panic| resume_unwind(panic))).collect()
    });
    per_core.sort_by_key(|(number, _)| *number);
    per_core.into_iter().map(|(_, result)| result).collect()
}
