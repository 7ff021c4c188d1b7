//! Potentiometers on the internal converter, force sensor on the ADS131M02, emergency stop.

use super::pins::{ConverterPins, PotentiometerPins, SPI_FREQUENCY, StopPins};
use control::ads131m02::{Ads131m02, ForceFault, InitError};
use control::hal::{Readings, Sensors};
use embassy_stm32::adc::{Adc, AdcChannel, AdcConfig, AnyAdcChannel, Averaging, SampleTime};
use embassy_stm32::gpio::{Input, Level, Output, Pull, Speed};
use embassy_stm32::mode::Blocking;
use embassy_stm32::pac::ADC1 as ADC1_REGISTERS;
use embassy_stm32::peripherals::ADC1;
use embassy_stm32::spi::mode::Master;
use embassy_stm32::spi::{self, Spi};
use embedded_hal_bus::spi::{ExclusiveDevice, NoDelay};

/// Time to charge the sampling capacitor through a potentiometer of up to 16 kOhm (4 kOhm at mid travel).
const SAMPLE_TIME: SampleTime = SampleTime::CYCLES92_5;
/// Conversions averaged in hardware per reading.
const AVERAGING: Averaging = Averaging::Samples8;

/// The two potentiometers.
///
/// The driver sets the converter up and takes the first readings, which leave both channels' sampling time in its registers.
/// Later readings write only the bits that change, a third of the register accesses of the driver's own reading, because
/// conversions are the longest wait of a control period.
struct Potentiometers {
    /// Keeps the converter running.
    _adc: Adc<'static, ADC1>,
    channels: [u8; 2],
}

impl Potentiometers {
    fn new(pins: PotentiometerPins) -> Self {
        let config = AdcConfig { averaging: Some(AVERAGING), ..AdcConfig::default() };
        let mut adc = Adc::new_with_config(pins.adc, config);
        let mut channels: [AnyAdcChannel<'static, ADC1>; 2] = [pins.x.degrade_adc(), pins.y.degrade_adc()];
        for channel in &mut channels {
            adc.blocking_read(channel, SAMPLE_TIME);
        }
        Self { _adc: adc, channels: channels.map(|channel| channel.get_hw_channel()) }
    }

    fn read(&mut self) -> [u16; 2] {
        // The first conversion after a pause of about a millisecond may be wrong (STM32L475 errata, "wrong ADC result if conversion
        // done late after calibration or previous conversion"): therefore it is repeated, and only the repetition is used.
        convert(self.channels[0]);
        self.channels.map(convert)
    }
}

/// One averaged conversion. If it never ends, the watchdog resets the chip.
fn convert(channel: u8) -> u16 {
    ADC1_REGISTERS.sqr1().write(|sequence| sequence.set_sq(0, channel));
    // The other bits act only when a one is written.
    ADC1_REGISTERS.cr().write(|control| {
        control.set_advregen(true);
        control.set_adstart(true);
    });
    while !ADC1_REGISTERS.isr().read().eoc() {}
    // Reading the data clears the end-of-conversion flag.
    ADC1_REGISTERS.dr().read().regular_data()
}

/// The converter on its bus with its chip select.
type Converter = Ads131m02<ExclusiveDevice<Spi<'static, Blocking, Master>, Output<'static>, NoDelay>>;

/// The force converter's driver, not yet set up, and its data-ready line.
fn converter(pins: ConverterPins) -> (Converter, Input<'static>) {
    let mut config = spi::Config::default();
    config.mode = spi::MODE_1;
    config.frequency = SPI_FREQUENCY;
    let bus = Spi::new_blocking(pins.spi, pins.sck, pins.mosi, pins.miso, config);
    let cs = Output::new(pins.cs, Level::High, Speed::High);
    let Ok(device) = ExclusiveDevice::new_no_delay(bus, cs);
    // With the pull-up an absent converter reports no data.
    (Ads131m02::new(device), Input::new(pins.data_ready, Pull::Up))
}

/// All sensors.
pub struct BoardSensors {
    /// `None` if previous starts hung. Then only the emergency stop is read.
    potentiometers: Option<Potentiometers>,
    converter: Converter,
    data_ready: Input<'static>,
    emergency_stop: Input<'static>,
    /// Error of the converter's set-up, if it failed.
    converter_error: Option<InitError>,
}

impl BoardSensors {
    pub(super) fn new(
        potentiometers: PotentiometerPins,
        converter_pins: ConverterPins,
        stop: StopPins,
        is_blind: bool,
    ) -> Self {
        let potentiometers = (!is_blind).then(|| Potentiometers::new(potentiometers));
        let (mut converter, data_ready) = converter(converter_pins);
        let converter_error = if is_blind { None } else { converter.init(&mut embassy_time::Delay).err() };
        if let Some(error) = converter_error {
            defmt::error!("force converter: {}", error);
        }
        Self {
            potentiometers,
            converter,
            data_ready,
            emergency_stop: Input::new(stop.emergency_stop, Pull::Up),
            converter_error,
        }
    }

    /// Error of the force converter's set-up at the start, if it failed.
    pub fn converter_error(&self) -> Option<InitError> {
        self.converter_error
    }

    /// One force sample. A converter that has reset is configured again, so that the fault ends with its cause; the period of
    /// the configuration still reports the fault.
    fn read_force(&mut self) -> Result<[i32; 2], ForceFault> {
        if self.data_ready.is_high() {
            return Err(ForceFault::NotReady);
        }
        let sample = self.converter.read();
        if sample == Err(ForceFault::DeviceReset) {
            self.converter_error = self.converter.configure().err();
        }
        sample
    }
}

/// Code of a potentiometer that is not read, beyond every track.
const NOT_READ: u16 = u16::MAX;

impl Sensors for BoardSensors {
    fn read(&mut self) -> Readings {
        let (potentiometer_codes, force_codes) = match &mut self.potentiometers {
            Some(potentiometers) => (potentiometers.read(), self.read_force()),
            None => ([NOT_READ; 2], Err(ForceFault::NotReady)),
        };
        Readings { potentiometer_codes, force_codes, emergency_stop: self.emergency_stop.is_high() }
    }
}
