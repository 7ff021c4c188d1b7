//! Who may move the device: one page at a time, as long as its heartbeat arrives.
//!
//! A heartbeat names the update of the live view that the page has drawn last, and counts from when that update was sent. So it shows that the
//! whole way works: the program sends, the page draws, and its answer arrives. It has no clock of its own: times are passed in.

use std::time::{Duration, Instant};

/// Longest time without a heartbeat of the page in control; the device's own limit of a silent host where that is shorter.
pub const HEARTBEAT_LIMIT: Duration = Duration::from_millis(1_000);

/// Number of a connected page.
pub type PageId = u64;

#[derive(Debug, Clone, Copy)]
struct Holder {
    page: PageId,
    alive: Instant,
}

/// Control of the device by one page.
#[derive(Debug, Default)]
pub struct Control {
    holder: Option<Holder>,
}

impl Control {
    /// Gives control to a page, unless another one has it.
    pub fn take(&mut self, page: PageId, now: Instant) -> bool {
        self.holder.get_or_insert(Holder { page, alive: now }).page == page
    }

    /// A heartbeat of a page, for an update that was sent then. A page without control gains nothing by it.
    pub fn heartbeat(&mut self, page: PageId, sent: Instant) {
        if let Some(holder) = self.holder.as_mut().filter(|holder| holder.page == page) {
            holder.alive = holder.alive.max(sent);
        }
    }

    /// Ends the control of a page; false where it had none.
    pub fn leave(&mut self, page: PageId) -> bool {
        self.holder.take_if(|holder| holder.page == page).is_some()
    }

    /// Ends the control of a page whose heartbeat is missing; false where there is none such.
    pub fn expire(&mut self, now: Instant, limit: Duration) -> bool {
        let limit = limit.min(HEARTBEAT_LIMIT);
        self.holder.take_if(|holder| now.saturating_duration_since(holder.alive) >= limit).is_some()
    }

    /// The page in control.
    pub fn holder(&self) -> Option<PageId> {
        self.holder.map(|holder| holder.page)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: Duration = Duration::from_millis(1);

    #[test]
    fn one_page_has_control_and_others_wait_until_it_leaves() {
        let (mut control, now) = (Control::default(), Instant::now());
        assert!(control.take(1, now) && control.take(1, now));
        assert!(!control.take(2, now));
        assert!(!control.leave(2));
        assert_eq!(control.holder(), Some(1));
        assert!(control.leave(1));
        assert!(control.take(2, now));
    }

    #[test]
    fn control_ends_with_the_heartbeat() {
        let (mut control, now) = (Control::default(), Instant::now());
        control.take(1, now);
        assert!(!control.expire(now + 999 * MS, 2_000 * MS));
        control.heartbeat(1, now + 500 * MS);
        assert!(!control.expire(now + 1_499 * MS, 2_000 * MS));
        // A heartbeat of another page, and an older one that arrives late.
        control.heartbeat(2, now + 1_400 * MS);
        control.heartbeat(1, now + 100 * MS);
        assert!(control.expire(now + 1_500 * MS, 2_000 * MS));
        assert_eq!(control.holder(), None);
        assert!(!control.expire(now + 9_000 * MS, 2_000 * MS));
        control.heartbeat(1, now + 9_000 * MS);
        assert_eq!(control.holder(), None, "a heartbeat takes no control");
    }

    #[test]
    fn a_shorter_limit_of_the_device_counts() {
        let (mut control, now) = (Control::default(), Instant::now());
        control.take(1, now);
        assert!(!control.expire(now + 299 * MS, 300 * MS));
        assert!(control.expire(now + 300 * MS, 300 * MS));
    }

    #[test]
    fn taking_control_again_is_no_heartbeat() {
        let (mut control, now) = (Control::default(), Instant::now());
        control.take(1, now);
        control.take(1, now + 900 * MS);
        assert!(control.expire(now + 1_000 * MS, 2_000 * MS));
    }
}
