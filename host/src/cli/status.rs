//! Report of `guide status` and the commands that operate the rig about the device, in the units of a
//! user.

use super::output::Output;
use super::rig_args::Rest;
use device::link::Client;
use device::link::condition::{Condition, ErrorCounters};
use device::link::display;
use device::link::error::explain_fault;
use protocol::{Counters, Safety, Status, Stiffness};
use serde::Serialize;
use statrs::distribution::{ContinuousCDF, StudentsT};
use std::fmt::{self, Display};

/// Amount of text that is printed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Detail {
    /// Position of the guide, and errors.
    Brief,
    /// Everything.
    Full,
}

/// State of the device.
#[derive(Serialize)]
struct Report {
    schema: &'static str,
    time_s: f64,
    state: &'static str,
    fault: Option<String>,
    position_x_mm: f64,
    position_y_mm: f64,
    force_x_n: f64,
    force_y_n: f64,
    /// The force is of a valid reading, not of an earlier one.
    force_valid: bool,
    #[serde(flatten)]
    errors: ErrorCounters,
    board: String,
    firmware_version: String,
    commit: String,
    reset_reason: &'static str,
    last_panic: Option<String>,
    calibration_id: String,
    calibration_crc: String,
    sample_period_us: u32,
    #[serde(flatten)]
    condition: Condition,
    stiffness_x: Option<Slope>,
    stiffness_y: Option<Slope>,
    /// Source of the constants: stored, nominal, nominal and acknowledged.
    calibration_source: &'static str,
    /// A tare was completed since the device started.
    tared: bool,
    /// Zero of the force from that of the calibration.
    force_zero_x_n: f64,
    force_zero_y_n: f64,
    /// Rest until a hot motor has cooled.
    motor_cools_in_x_s: u16,
    motor_cools_in_y_s: u16,
    #[serde(skip)]
    counters: Counters,
    #[serde(skip)]
    detail: Detail,
}

/// Lateral stiffness along one axis.
#[derive(Serialize)]
struct Slope {
    n_per_mm: f64,
    ci95_n_per_mm: Option<[f64; 2]>,
    readings: u32,
}

impl Slope {
    fn new(stiffness: &Stiffness) -> Self {
        // A millinewton per metre is a millionth of a newton per millimetre.
        let n_per_mm = f64::from(stiffness.slope_mn_per_m) * 1e-6;
        let sd = f64::from(stiffness.sd_mn_per_m) * 1e-6;
        let t = StudentsT::new(0.0, 1.0, f64::from(stiffness.readings) - 2.0).ok();
        let half = t.map(|t| t.inverse_cdf(0.975) * sd);
        let ci95_n_per_mm = half.map(|half| [n_per_mm - half, n_per_mm + half]);
        Self { n_per_mm, ci95_n_per_mm, readings: stiffness.readings }
    }
}

impl Display for Slope {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.ci95_n_per_mm {
            Some([low, high]) => write!(f, "{:.3} ({low:.3} to {high:.3}) N/mm", self.n_per_mm),
            None => write!(f, "{:.3} N/mm, interval unknown", self.n_per_mm),
        }
    }
}

impl Report {
    fn new(
        schema: &'static str,
        client: &Client,
        status: &Status,
        safety: &Safety,
        rest: Option<Rest>,
        detail: Detail,
    ) -> Self {
        let now = Rest {
            time_s: status.t_us as f64 * 1e-6,
            displacement_m: client.displacement_m(status.position_counts),
            force_n: client.force_n(status.force_counts),
        };
        let Rest { time_s, displacement_m, force_n: [force_x_n, force_y_n] } = rest.unwrap_or(now);
        let [position_x_mm, position_y_mm] = displacement_m.map(|metres| metres * 1e3);
        let [stiffness_x, stiffness_y] = status.stiffness.map(|stiffness| stiffness.as_ref().map(Slope::new));
        let [force_zero_x_n, force_zero_y_n] = client.force_n(safety.zero_counts);
        let [motor_cools_in_x_s, motor_cools_in_y_s] = safety.cools_in_s;
        let (hello, counters) = (client.hello(), status.counters);
        Self {
            schema,
            time_s,
            state: display::state(status.state),
            fault: status.fault.map(explain_fault),
            position_x_mm,
            position_y_mm,
            force_x_n,
            force_y_n,
            force_valid: !status.repeats_force,
            errors: (&counters).into(),
            board: hello.board.as_str().to_owned(),
            firmware_version: hello.firmware_version.as_str().to_owned(),
            commit: hello.commit.as_str().to_owned(),
            reset_reason: display::reset_reason(hello.reset_reason),
            last_panic: hello.last_panic.as_ref().map(|panic| panic.as_str().to_owned()),
            calibration_id: hello.calibration.id.as_str().to_owned(),
            calibration_crc: format!("{:08x}", hello.calibration.crc),
            sample_period_us: hello.sample_period_us,
            condition: status.into(),
            stiffness_x,
            stiffness_y,
            calibration_source: display::calibration_source(safety.calibration),
            tared: safety.tared,
            force_zero_x_n,
            force_zero_y_n,
            motor_cools_in_x_s,
            motor_cools_in_y_s,
            counters,
            detail,
        }
    }

    fn details(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "device     {}, firmware {} ({}), started by {}",
            self.board, self.firmware_version, self.commit, self.reset_reason
        )?;
        writeln!(
            f,
            "calibrated {} (crc {}), {}",
            self.calibration_id, self.calibration_crc, self.calibration_source
        )?;
        if self.tared {
            let (x_n, y_n) = (self.force_zero_x_n, self.force_zero_y_n);
            writeln!(f, "zero       x {x_n:+.4} N    y {y_n:+.4} N from the calibration's, by tare")?;
        } else {
            writeln!(f, "zero       not tared since the device started")?;
        }
        writeln!(
            f,
            "limits     force {:.3} N, silence of the host {:.3} s",
            self.condition.force_limit_n, self.condition.silence_limit_s
        )?;
        writeln!(
            f,
            "load       processor {:.1} %, longest period {} us of {} us, latest start {} us, stack {} bytes free, \
             outbox at most {} messages",
            self.condition.cpu_percent,
            self.condition.longest_period_us,
            self.sample_period_us,
            self.condition.latest_start_us,
            self.condition.stack_free_bytes,
            self.condition.outbox_most
        )?;
        writeln!(
            f,
            "motors     x {:.1} %   y {:.1} % of their duty cycle used",
            self.condition.motor_duty_used_x_percent, self.condition.motor_duty_used_y_percent
        )?;
        let cools_in_s = self.motor_cools_in_x_s.max(self.motor_cools_in_y_s);
        if cools_in_s > 0 {
            writeln!(f, "           hot: {cools_in_s} s of rest until `guide clear`")?;
        }
        writeln!(
            f,
            "stiffness  x {}   y {} (95 % interval)",
            slope_text(&self.stiffness_x),
            slope_text(&self.stiffness_y)
        )
    }
}

fn slope_text(slope: &Option<Slope>) -> String {
    slope.as_ref().map_or("not identified yet".to_owned(), ToString::to_string)
}

impl Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "state      {}", self.state)?;
        if let Some(fault) = &self.fault {
            writeln!(f, "           {fault}")?;
        }
        writeln!(f, "guide 2    x {:+.3} mm   y {:+.3} mm", self.position_x_mm, self.position_y_mm)?;
        let remark =
            if self.force_valid { "" } else { " (of an earlier reading: there is no valid one now)" };
        writeln!(f, "force      x {:+.4} N    y {:+.4} N{remark}", self.force_x_n, self.force_y_n)?;
        writeln!(f, "clock      {:.3} s since the device started", self.time_s)?;
        if self.detail == Detail::Full {
            self.details(f)?;
        }
        if let Some(panic) = &self.last_panic {
            writeln!(f, "panic      before this start: {panic}")?;
        }
        for (count, what) in display::counters(&self.counters).into_iter().filter(|(count, _)| *count > 0) {
            writeln!(f, "counted    {what}: {count}")?;
        }
        Ok(())
    }
}

/// Requests the state of the device and prints it; position and force are those of `rest` where there is one.
pub fn report_status(
    schema: &'static str,
    client: &mut Client,
    rest: Option<Rest>,
    detail: Detail,
    out: &mut Output,
) -> anyhow::Result<()> {
    let status = client.status()?;
    let safety = client.safety()?;
    let report = Report::new(schema, client, &status, &safety, rest, detail);
    out.result(&report, &report)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_slope_has_its_interval_where_there_is_one() {
        let slope = Slope::new(&Stiffness { slope_mn_per_m: 512_000, sd_mn_per_m: 6_000, readings: 10_000 });
        assert_eq!(slope.to_string(), "0.512 (0.500 to 0.524) N/mm");
        let slope = Slope::new(&Stiffness { slope_mn_per_m: 512_000, sd_mn_per_m: 0, readings: 2 });
        assert_eq!(slope.to_string(), "0.512 N/mm, interval unknown");
    }
}
