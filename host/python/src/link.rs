//! A connected device.

use super::failure::{device, unavailable};
use super::work::{Leave, Message, interruptible};
use ::device::link::display;
use ::device::link::{Batch, Client, Program, Telemetry};
use host::cli::device::{self as operate, Motion};
use protocol::Request;
use pyo3::prelude::*;
use pyo3::types::PyBytes;
use std::sync::Mutex;
use std::time::{Duration, Instant};

/// Duration of one wait for telemetry between checks for signals.
const POLL: Duration = Duration::from_millis(50);

/// The link to a device. One call at a time uses it.
#[pyclass(frozen)]
pub struct Link {
    client: Mutex<Option<Client>>,
}

/// Manner of a motion: nominal calibration, force limit in newtons.
type How = (bool, Option<f64>);

#[pymethods]
impl Link {
    /// Connects to the device at a port.
    #[new]
    fn open(py: Python<'_>, port: String) -> PyResult<Self> {
        let client = interruptible(py, move |_, _| Client::connect(&port), |_| Ok(()), Leave::Behind)?;
        let client = client.map_err(|error| device(py, &error.into()))?;
        Ok(Self { client: Mutex::new(Some(client)) })
    }

    /// Closes the port.
    fn close(&self) {
        if let Ok(mut client) = self.client.lock() {
            *client = None;
        }
    }

    /// Document of `guide status`.
    fn status(&self, py: Python<'_>) -> PyResult<String> {
        self.with(py, |client, _, _| operate::status(client), None)
    }

    /// Document of `guide stop`.
    fn stop(&self, py: Python<'_>) -> PyResult<String> {
        self.with(py, |client, _, _| operate::stop(client), None)
    }

    /// Document of `guide clear`.
    fn clear(&self, py: Python<'_>) -> PyResult<String> {
        self.with(py, |client, _, _| operate::clear(client), None)
    }

    /// Document of `guide retreat`.
    fn retreat(&self, py: Python<'_>) -> PyResult<String> {
        self.with(py, |client, flag, _| operate::retreat(client, flag.inner()), None)
    }

    /// Document of `guide tare`.
    fn tare(&self, py: Python<'_>, duration_s: f64, how: How) -> PyResult<String> {
        self.with(
            py,
            move |client: &mut Client, flag: &_, _: &_| {
                operate::tare(client, duration_s, &motion(how, flag), |_| {})
            },
            None,
        )
    }

    /// Document of `guide move`; `on_samples` gets packed samples.
    fn move_to(
        &self,
        py: Python<'_>,
        target_mm: [f64; 2],
        speed_mm_s: f64,
        how: How,
        on_samples: Option<Py<PyAny>>,
    ) -> PyResult<String> {
        self.with(
            py,
            move |client: &mut Client, flag: &_, messages: &super::work::Messages| {
                operate::move_guide(client, target_mm, speed_mm_s, &motion(how, flag), |batch| {
                    messages.send(Message::Samples(pack(batch)));
                })
            },
            on_samples,
        )
    }

    /// Runs a program (a built-in name or a file) and returns the packed samples of it.
    fn run<'py>(
        &self,
        py: Python<'py>,
        program: String,
        how: How,
        on_samples: Option<Py<PyAny>>,
    ) -> PyResult<Bound<'py, PyBytes>> {
        let work = move |client: &mut Client, flag: &_, messages: &super::work::Messages| {
            let program = Program::load(&program)?;
            let mut samples = Vec::new();
            motion(how, flag).run(client, &program, |batch| {
                let packed = pack(batch);
                samples.extend_from_slice(&packed);
                messages.send(Message::Samples(packed));
            })?;
            Ok(samples)
        };
        let samples = self.with(py, work, on_samples)?;
        Ok(PyBytes::new(py, &samples))
    }

    /// Has the device send every sample, or none.
    fn stream(&self, py: Python<'_>, enable: bool) -> PyResult<()> {
        self.with(py, move |client, _, _| Ok(client.request(Request::Stream { enable })?), None)
    }

    /// The next samples, packed; none where the device sends none in time.
    fn next_samples<'py>(&self, py: Python<'py>, timeout_s: f64) -> PyResult<Option<Bound<'py, PyBytes>>> {
        let began = Instant::now();
        loop {
            let next = py.detach(|| {
                let mut client = self.client.lock().ok()?;
                Some(client.as_mut()?.next(POLL))
            });
            match next {
                None => return Err(unavailable(py, "the device is closed, or another thread uses it")),
                Some(Err(error)) => return Err(device(py, &error.into())),
                Some(Ok(Some(Telemetry::Samples(batch)))) => {
                    return Ok(Some(PyBytes::new(py, &pack(&batch))));
                }
                Some(Ok(_)) if began.elapsed().as_secs_f64() >= timeout_s => return Ok(None),
                Some(Ok(_)) => py.check_signals()?,
            }
        }
    }

    /// Names of states by their number in the samples.
    #[staticmethod]
    fn states() -> Vec<&'static str> {
        STATES.map(display::state).to_vec()
    }
}

const STATES: [protocol::State; 7] = [
    protocol::State::Idle,
    protocol::State::Pending,
    protocol::State::Moving,
    protocol::State::Holding,
    protocol::State::Taring,
    protocol::State::Faulted,
    protocol::State::Retreating,
];

fn motion((nominal, force_limit_n): How, flag: &super::work::Flag) -> Motion<'_> {
    Motion { nominal, force_limit_n, interrupted: flag.inner() }
}

impl Link {
    /// Does work with the client, which nobody else can use meanwhile. An interrupt ends it by the flag, and is waited for: work that moves
    /// the guide stops it.
    fn with<T: Send + 'static>(
        &self,
        py: Python<'_>,
        work: impl FnOnce(&mut Client, &super::work::Flag, &super::work::Messages) -> anyhow::Result<T>
        + Send
        + 'static,
        on_samples: Option<Py<PyAny>>,
    ) -> PyResult<T> {
        let client_taken = self.client.lock().ok().and_then(|mut client| client.take());
        let Some(mut client) = client_taken else {
            return Err(unavailable(py, "the device is closed, or another thread uses it"));
        };
        let (sender, returned) = std::sync::mpsc::channel();
        let outcome = interruptible(
            py,
            move |messages, flag| {
                let outcome = work(&mut client, &flag, &messages);
                // The receiver lives until this has ended.
                let _ = sender.send(client);
                outcome
            },
            |message| match (message, &on_samples) {
                (Message::Samples(packed), Some(on_samples)) => {
                    on_samples.call1(py, (PyBytes::new(py, &packed),)).map(drop)
                }
                _ => Ok(()),
            },
            Leave::Finished,
        );
        if let (Ok(client), Ok(mut client_slot)) = (returned.try_recv(), self.client.lock()) {
            *client_slot = Some(client);
        }
        outcome?.map_err(|error| device(py, &error))
    }
}

/// Bytes of one sample: five numbers, samples lost before it, step (-1 outside a program) and state.
pub const SAMPLE_BYTES: usize = 5 * 8 + 8 + 2 + 2;

fn pack(batch: &Batch) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(batch.points.len() * SAMPLE_BYTES);
    let step = batch.step.map_or(-1, i16::from);
    let state = STATES.iter().position(|state| *state == batch.state).unwrap_or(STATES.len());
    for (number, point) in batch.points.iter().enumerate() {
        let [x_m, y_m] = point.displacement_m;
        let [force_x_n, force_y_n] = if point.repeats_force { [f64::NAN; 2] } else { point.force_n };
        for value in [point.time_s, 1e3 * x_m, 1e3 * y_m, force_x_n, force_y_n] {
            bytes.extend_from_slice(&value.to_le_bytes());
        }
        let lost = if number == 0 { batch.lost_before } else { 0 };
        bytes.extend_from_slice(&lost.to_le_bytes());
        bytes.extend_from_slice(&step.to_le_bytes());
        bytes.extend_from_slice(&(state as u16).to_le_bytes());
    }
    bytes
}
