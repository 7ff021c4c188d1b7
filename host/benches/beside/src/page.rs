//! The page: tables in Markdown.

use crate::link::{BATCH, SAMPLES};
use crate::machine::Machine;
use crate::rows::Row;
use crate::scaling::Growing;
use crate::wire::Measured;
use anyhow::Result;
use std::fmt::Write;
use time::OffsetDateTime;
use time::macros::format_description;

/// Bytes that the line carries per second: ten bits a byte.
const BAUD: f64 = 460_800.0;
const LINE: f64 = BAUD / 10.0;

/// Measurements.
pub struct Page<'a> {
    pub machine: &'a Machine,
    pub python: Option<String>,
    pub seed: u32,
    pub wire: &'a [Measured],
    pub rows: &'a [Row],
    pub scaling: &'a [Growing],
}

/// A time with three digits.
fn time(seconds: f64) -> String {
    let (value, unit) = match seconds {
        s if s < 1e-6 => (1e9 * s, "ns"),
        s if s < 1e-3 => (1e6 * s, "us"),
        s if s < 1.0 => (1e3 * s, "ms"),
        s => (s, "s"),
    };
    format!("{} {unit}", digits(value))
}

/// Three digits.
fn digits(value: f64) -> String {
    let decimals = if value < 10.0 { 2 } else { usize::from(value < 100.0) };
    format!("{value:.decimals$}")
}

impl Page<'_> {
    /// All of it.
    pub fn text(&self) -> Result<String> {
        let mut page = String::new();
        let today = OffsetDateTime::now_utc().format(format_description!("[year]-[month]-[day]"))?;
        let python = self.python.as_deref().unwrap_or("peers in Python skipped");
        writeln!(
            page,
            "# Run times, beside those of alternative libraries, and how they scale\n\n\
             Written by `cargo xtask bench --seed {}` in one run, {today}; one core of {}; {python} (one thread).\n\
             Times are the least of many repeats, which other load on the machine disturbs least; they still differ from run to run.\n\
             All numbers are of the code of that day. Run it again, with nothing else on the machine, after a change of what it measures.\n",
            self.seed, self.machine.cpu
        )?;
        self.table(&mut page)?;
        self.peers(&mut page)?;
        self.link(&mut page)?;
        self.growth(&mut page)?;
        self.goals(&mut page)?;
        Ok(page)
    }

    fn table(&self, page: &mut String) -> Result<()> {
        writeln!(
            page,
            "## Each operation\n\n\
             The limit is what the time would be if nothing but the stated work were done, at {:.1} G additions and multiplications a second\n\
             and {:.1} GB/s from memory, both measured here in the same run with code compiled as ours is.\n\n\
             | operation | ours | best peer that runs here | peer | ratio | limit | ours / limit |\n|---|---|---|---|---|---|---|",
            1e-9 * self.machine.flops,
            1e-9 * self.machine.bytes
        )?;
        for row in self.rows {
            let (name, seconds, ratio) = match row.best() {
                Some((name, seconds)) => (name, time(seconds), digits(seconds / row.ours_s)),
                None => ("-", "-".to_owned(), "-".to_owned()),
            };
            let (limit, least_s) = &row.limit;
            let (limit, target_text) = match least_s {
                Some(least_s) => (format!("{limit}: {}", time(*least_s)), digits(row.ours_s / least_s)),
                None => (limit.clone(), "-".to_owned()),
            };
            writeln!(
                page,
                "| {} | {} | {name} | {seconds} | {ratio} | {limit} | {target_text} |",
                row.name,
                time(row.ours_s)
            )?;
        }
        let Some(ours) = self.wire.first() else { return Ok(()) };
        let fastest =
            |of: fn(&Measured) -> f64| self.wire.iter().skip(1).min_by(|a, b| of(a).total_cmp(&of(b)));
        for (name, of) in [
            ("frame encode, per sample", (|way| way.encode_s) as fn(&Measured) -> f64),
            ("frame decode, per sample", |way| way.decode_s),
        ] {
            let Some(best) = fastest(of) else { continue };
            let line_s = ours.bytes / LINE;
            writeln!(
                page,
                "| {name} | {} | {} | {} | {} | its {:.2} bytes on the line: {} | {:.5} |",
                time(of(ours)),
                best.name,
                time(of(best)),
                digits(of(best) / of(ours)),
                ours.bytes,
                time(line_s),
                of(ours) / line_s
            )?;
        }
        Ok(())
    }

    fn peers(&self, page: &mut String) -> Result<()> {
        writeln!(
            page,
            "\n## Every peer\n\n\
             Off: the largest difference of its numbers from ours, over the largest number. The frame programs put the tissue's springs\n\
             at nodes, which is what they are off by. OpenSeesPy needs the system's BLAS and LAPACK (Debian: libblas3, liblapack3).\n\n\
             | operation | peer | time | ratio | off | the same in both |\n|---|---|---|---|---|---|"
        )?;
        for row in self.rows {
            for peer in &row.peers {
                let error_text = peer.off.map_or_else(|| "-".to_owned(), |off| format!("{off:.0e}"));
                let (seconds, ratio) = match &peer.seconds {
                    Ok(seconds) => (time(*seconds), digits(seconds / row.ours_s)),
                    Err(why) => (format!("does not run here: {why}"), "-".to_owned()),
                };
                writeln!(
                    page,
                    "| {} | {} | {seconds} | {ratio} | {error_text} | {} |",
                    row.name, peer.name, row.same
                )?;
            }
        }
        Ok(())
    }

    fn link(&self, page: &mut String) -> Result<()> {
        let Some(ours) = self.wire.first() else { return Ok(()) };
        writeln!(
            page,
            "\n## The link\n\n\
             {SAMPLES} samples of four counts with the noise of the sensors (3 and 100 counts), as batches of {BATCH} with boot, number, time,\n\
             state, step and count of dropped samples, or one message per sample with the same. Ours and MAVLink find their frames and\n\
             check a checksum; JSON and protocol buffers have their lines or lengths only, and no checksum.\n\n\
             | way | bytes per sample | times ours | encode per sample | times ours | decode per sample | times ours |\n|---|---|---|---|---|---|---|"
        )?;
        for way in self.wire {
            writeln!(
                page,
                "| {} | {} | {} | {} | {} | {} | {} |",
                way.name,
                digits(way.bytes),
                digits(way.bytes / ours.bytes),
                time(way.encode_s),
                digits(way.encode_s / ours.encode_s),
                time(way.decode_s),
                digits(way.decode_s / ours.decode_s)
            )?;
        }
        let most_hz = LINE / ours.bytes;
        writeln!(
            page,
            "\nAt {BAUD} baud, {LINE} bytes a second, {:.0} of these samples a second fill the line, and {:.0} take 90 % of it. The device\n\
             takes one per control period, 1000 a second, which are {:.0} % of the line: the rest is for answers, events, the state, and for\n\
             catching up after a disturbance. That the samples may really take all but a few percent of a line is a test on the firmware\n\
             (`a_line_filled_to_nine_tenths_loses_nothing`): where the stream takes 96 % of the line's rate, nothing is lost in 40 s.",
            most_hz,
            0.9 * most_hz,
            100.0 * 1000.0 / most_hz
        )?;
        Ok(())
    }

    fn growth(&self, page: &mut String) -> Result<()> {
        writeln!(
            page,
            "\n## How cost grows\n\n\
             The exponent is the slope of time against size in logarithms, with its 95 % interval. Where parts of the cost do not grow, it is\n\
             below the theory's, which is for large sizes.\n\n\
             | what grows | sizes | time | exponent | theory | because |\n|---|---|---|---|---|---|"
        )?;
        for growing in self.scaling {
            let [exponent, half] = growing.exponent;
            writeln!(
                page,
                "| {} | {} | {} | {exponent:.2} +- {half:.2} | {} | {} |",
                growing.name,
                growing.sizes.iter().map(usize::to_string).collect::<Vec<_>>().join(", "),
                growing.seconds.iter().map(|seconds| time(*seconds)).collect::<Vec<_>>().join(", "),
                growing.theory,
                growing.why
            )?;
        }
        Ok(())
    }

    /// Goals, and whether they are reached.
    fn goals(&self, page: &mut String) -> Result<()> {
        writeln!(page, "\n## Goals\n\n| goal | measured | |\n|---|---|---|")?;
        let mut goal = |what: &str, measured: f64, least: f64, why: &str| {
            let met = if measured >= least { "met" } else { "missed" };
            writeln!(page, "| {what} | {} | {met}{why} |", digits(measured))
        };
        for (name, least) in [("beam solve", 1000.0), ("identification of a run", 100.0)] {
            let Some(row) = self.rows.iter().find(|row| row.name == name) else { continue };
            for peer in &row.peers {
                let Ok(seconds) = peer.seconds else { continue };
                let goal_s = seconds / least;
                let shortfall = row.limit.1.filter(|limit_s| goal_s < *limit_s).map(|limit_s| {
                    format!(": {} would be less than the limit, {}", time(goal_s), time(limit_s))
                });
                let goal_text = format!("{name}: {least} times faster than {}", peer.name);
                goal(&goal_text, seconds / row.ours_s, least, &shortfall.unwrap_or_default())?;
            }
        }
        let Some(ours) = self.wire.first() else { return Ok(()) };
        for way in self.wire.iter().skip(1).filter(|way| !way.name.contains("MAVLink")) {
            goal(
                &format!("decode: 10 times faster than {}", way.name),
                way.decode_s / ours.decode_s,
                10.0,
                "",
            )?;
            goal(&format!("at most half the bytes of {}", way.name), way.bytes / ours.bytes, 2.0, "")?;
        }
        Ok(())
    }
}
