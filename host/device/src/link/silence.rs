//! Detection of a lost device, which sends nothing although it streams.

use super::client::Client;
use super::error::LinkError;
use super::telemetry::Telemetry;
use super::timeouts::SILENCE_LIMIT;
use std::time::{Duration, Instant};

/// Time spent waiting for a device that sends nothing. A program that was suspended has not waited, and reads first what came meanwhile.
#[derive(Debug, Default)]
pub(crate) struct Silence(Duration);

impl Silence {
    /// Next message of the device; `None` if it sends none within `poll`.
    ///
    /// # Errors
    /// Those of the link; [`LinkError::Silent`] where nothing has come for [`SILENCE_LIMIT`].
    pub(crate) fn next(
        &mut self,
        client: &mut Client,
        poll: Duration,
    ) -> Result<Option<Telemetry>, LinkError> {
        let polled = Instant::now();
        let received = client.next(poll)?;
        if received.is_some() {
            self.0 = Duration::ZERO;
        } else {
            self.0 += polled.elapsed().min(2 * poll);
            if self.0 > SILENCE_LIMIT {
                return Err(LinkError::Silent { port: client.port().to_owned() });
            }
        }
        Ok(received)
    }
}
