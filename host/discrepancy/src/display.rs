//! The result as text.

use super::regions::Region;
use super::report::{Estimate, LawName, Misfit, PartReport, Report, Verdict};
use std::fmt::{Display, Formatter, Result};

/// Largest number of refused laws, and of regions, that are listed.
const LISTED: usize = 6;

/// A number with as many decimals as show two digits of its standard deviation.
struct Number<'a>(&'a Estimate);

impl Display for Number<'_> {
    fn fmt(&self, f: &mut Formatter<'_>) -> Result {
        let Estimate { name, unit, value, ci95: [low, high], sd } = self.0;
        let digits = (1.0 - sd.max(1e-300).log10().floor()).clamp(0.0, 9.0) as usize;
        write!(f, "{name} {value:.digits$} ({low:.digits$} to {high:.digits$})")?;
        if unit.is_empty() { Ok(()) } else { write!(f, " {unit}") }
    }
}

fn percent(f: &mut Formatter<'_>, misfit: &Misfit, unit: &str) -> Result {
    let Misfit { before, after, measured } = misfit;
    let [percent_before, percent_after] =
        [before, after].map(|value| 100.0 * value / measured.max(f64::MIN_POSITIVE));
    write!(
        f,
        "{before:.4} {unit} before, {after:.4} {unit} after ({percent_before:.2} and {percent_after:.2} % of what is measured)"
    )
}

fn region(f: &mut Formatter<'_>, label: &str, region: &Region) -> Result {
    let Region { channel, unit, coordinate, from, to, mean, sigma } = region;
    writeln!(
        f,
        "{label:<12} {channel}: {mean:+.4} {unit} for {coordinate} {from:.4} to {to:.4} ({sigma:+.1} sd)"
    )
}

fn part(f: &mut Formatter<'_>, label: &str, part: &PartReport, meaning: &str) -> Result {
    let status = if part.is_named { "named" } else { "not named" };
    let (probability, laws) = (100.0 * part.probability, part.laws.join(" and "));
    writeln!(f, "{label:<12} {}; {status}, probability {probability:.1} %", Number(&part.estimate))?;
    writeln!(f, "{:<12}   {meaning}; of {laws}", "")
}

impl Display for LawName {
    fn fmt(&self, f: &mut Formatter<'_>) -> Result {
        write!(f, "{}: {}", self.id(), self.formula)
    }
}

impl Display for Report {
    fn fmt(&self, f: &mut Formatter<'_>) -> Result {
        let verdict = match self.verdict {
            Verdict::Adequate => "adequate: nothing is missing",
            Verdict::Explained => "explained: with these laws nothing is missing",
            Verdict::Ambiguous => "ambiguous: these runs do not decide between several laws",
            Verdict::Partial => "partial: something is missing beside these laws",
            Verdict::Unexplained => "unexplained: something is missing that no candidate describes",
        };
        writeln!(f, "verdict      {verdict}")?;
        for one in self.regions.iter().take(LISTED) {
            region(f, "where", one)?;
        }
        for term in &self.terms {
            let label = if term.is_named { "missing" } else { "one of" };
            let probability = 100.0 * term.probability;
            writeln!(
                f,
                "{label:<12} {}; probability {probability:.1} %, log odds {:+.1}",
                term.law, term.ln_odds
            )?;
            for value in &term.values {
                writeln!(f, "{:<12}   {}", "", Number(value))?;
            }
            for rival in &term.rivals {
                write!(f, "{:<12}   or {}", "", rival.law)?;
                if let Some(second) = &rival.with {
                    write!(f, " and {second}")?;
                }
                writeln!(f, " ({:.0} %)", 100.0 * rival.probability)?;
            }
            if let Some(held_out) = &term.held_out {
                let (gain, sd) = (100.0 * held_out.gain, 100.0 * held_out.gain_sd);
                writeln!(
                    f,
                    "{:<12}   held out: squared error {gain:.1} % smaller (sd {sd:.1}), p {:.2e}",
                    "", held_out.p
                )?;
            }
        }
        for offset in &self.offsets {
            part(f, "offset", offset, "in both directions alike, mean over the data")?;
        }
        for reversal in &self.reversals {
            part(
                f,
                "reversal",
                reversal,
                "half the change from one direction to the other: all dry friction of a force, half the play of a position",
            )?;
        }
        for parameter in &self.parameters {
            writeln!(
                f,
                "parameter    {}; before {}",
                Number(&parameter.estimate),
                Number(&parameter.before)
            )?;
        }
        for channel in &self.channels {
            let noise = &channel.noise;
            let (sd, unit, correlated) = (noise.sd, &channel.unit, 100.0 * noise.correlated);
            let memory = noise.memory_s;
            writeln!(
                f,
                "noise        {}: sd {sd:.4} {unit}, {correlated:.0} % of it correlated over {memory:.3} s",
                channel.name
            )?;
            write!(f, "misfit       {}: ", channel.name)?;
            percent(f, &channel.training, unit)?;
            writeln!(f)?;
            if let Some(held_out) = &channel.held_out {
                write!(f, "held out     {}: ", channel.name)?;
                percent(f, held_out, unit)?;
                writeln!(f)?;
            }
        }
        for one in self.refused.iter().take(LISTED) {
            write!(f, "refused      {}: {}, log odds {:+.1}", one.law.id(), one.reason, one.ln_odds)?;
            match &one.held_out {
                Some(held_out) => writeln!(
                    f,
                    ", squared error {:.2} % smaller (sd {:.2}), p {:.2}",
                    100.0 * held_out.gain,
                    100.0 * held_out.gain_sd,
                    held_out.p
                )?,
                None => writeln!(f)?,
            }
        }
        for one in self.remaining.iter().take(LISTED) {
            region(f, "remaining", one)?;
        }
        for note in &self.notes {
            writeln!(f, "note         {note}")?;
        }
        Ok(())
    }
}
