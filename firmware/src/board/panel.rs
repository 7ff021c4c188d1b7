//! Status LED and independent watchdog.

use super::pins::{PanelPins, WATCHDOG_TIMEOUT_US};
use control::hal::Panel;
use embassy_stm32::Peri;
use embassy_stm32::gpio::{Level, Output, Speed};
use embassy_stm32::peripherals::IWDG;
use embassy_stm32::wdg::IndependentWatchdog;

/// Time limit for the set-up of the sensors, microseconds: a hundred times its duration.
const START_TIMEOUT_US: u32 = 500_000;

/// From here on the watchdog ends a start that hangs, for example at a sensor that never answers.
pub(super) fn watch_start(watchdog: &mut Peri<'static, IWDG>) {
    IndependentWatchdog::new(watchdog.reborrow(), START_TIMEOUT_US).unleash();
}

/// LED and watchdog.
pub struct BoardPanel {
    led: Output<'static>,
    watchdog: IndependentWatchdog<'static, IWDG>,
}

impl BoardPanel {
    /// Sets the watchdog to the time limit of the control task, which has to feed it from here on.
    pub(super) fn new(pins: PanelPins) -> Self {
        let mut watchdog = IndependentWatchdog::new(pins.watchdog, WATCHDOG_TIMEOUT_US);
        watchdog.unleash();
        Self { led: Output::new(pins.led, Level::Low, Speed::Low), watchdog }
    }
}

impl Panel for BoardPanel {
    fn led(&mut self, on: bool) {
        self.led.set_level(on.into());
    }

    fn feed_watchdog(&mut self) {
        self.watchdog.pet();
    }
}
