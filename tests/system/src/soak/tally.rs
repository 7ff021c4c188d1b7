//! What was done in a soak, counted, and how it is printed.

use super::answers::Answer;
use std::collections::BTreeMap;
use std::fmt::{self, Display};

/// Counts of one command.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Commands {
    accepted: u32,
    refused: u32,
    unanswered: u32,
}

/// Counts of one cause of a fault.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Faults {
    count: u32,
    worst_periods: u64,
}

/// All counts.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Tally {
    commands: BTreeMap<&'static str, Commands>,
    programs: BTreeMap<&'static str, u32>,
    faults: BTreeMap<&'static str, Faults>,
    /// Starts of the device after the first.
    pub restarts: u32,
    /// Ports closed and opened again.
    pub reopened: u32,
}

impl Tally {
    /// A command.
    pub fn command(&mut self, name: &'static str, answer: Answer) {
        let counts = self.commands.entry(name).or_default();
        match answer {
            Answer::Accepted => counts.accepted += 1,
            Answer::Refused(_) => counts.refused += 1,
            Answer::Unanswered => counts.unanswered += 1,
        }
    }

    /// A program that was tried.
    pub fn program(&mut self, name: &'static str) {
        *self.programs.entry(name).or_default() += 1;
    }

    /// A fault, and the periods until both bridges were off.
    pub fn fault(&mut self, name: &'static str, periods: u64) {
        let counts = self.faults.entry(name).or_default();
        counts.count += 1;
        counts.worst_periods = counts.worst_periods.max(periods);
    }

    /// Commands of all kinds.
    pub fn commands(&self) -> u32 {
        self.commands.values().map(|counts| counts.accepted + counts.refused + counts.unanswered).sum()
    }

    /// Faults of all kinds.
    pub fn faults(&self) -> u32 {
        self.faults.values().map(|counts| counts.count).sum()
    }

    /// Kinds of faults.
    pub fn fault_kinds(&self) -> usize {
        self.faults.len()
    }
}

/// Breaks a list into lines of an even length.
fn wrapped(f: &mut fmt::Formatter<'_>, head: &str, items: Vec<String>) -> fmt::Result {
    const WIDTH: usize = 130;
    let mut line = format!("  {head}: ");
    let last = items.len().saturating_sub(1);
    for (index, item) in items.into_iter().enumerate() {
        let item = if index == last { item } else { format!("{item}, ") };
        if line.len() + item.trim_end().len() > WIDTH {
            writeln!(f, "{}", line.trim_end())?;
            line = "    ".to_owned();
        }
        line += &item;
    }
    writeln!(f, "{}", line.trim_end())
}

impl Display for Tally {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let one = |(name, counts): (&&str, &Commands)| {
            let Commands { accepted, refused, unanswered } = *counts;
            let lost = if unanswered > 0 { format!(" + {unanswered} lost") } else { String::new() };
            let refused = if refused > 0 { format!(" + {refused} refused") } else { String::new() };
            format!("{name} {accepted}{refused}{lost}")
        };
        let head = format!("{} commands", self.commands());
        wrapped(f, &head, self.commands.iter().map(one).collect())?;
        let programs = self.programs.iter().map(|(name, count)| format!("{name} {count}"));
        wrapped(f, "programs", programs.collect())?;
        let of_kind = |(name, faults): (&&str, &Faults)| {
            format!("{name} {} ({} ms)", faults.count, faults.worst_periods)
        };
        let head = format!("{} faults (longest time until both bridges were off)", self.faults());
        wrapped(f, &head, self.faults.iter().map(of_kind).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::Refusal;

    #[test]
    fn counts_are_reported_by_kind_with_the_worst_of_each_fault() {
        let mut tally = Tally::default();
        tally.command("run", Answer::Accepted);
        tally.command("run", Answer::Refused(Refusal::Busy));
        tally.command("stop", Answer::Unanswered);
        tally.program("tare");
        tally.fault("jam", 300);
        tally.fault("jam", 200);
        assert_eq!((tally.commands(), tally.faults(), tally.fault_kinds()), (3, 2, 1));
        let expected = "  3 commands: run 1 + 1 refused, stop 0 + 1 lost\n  programs: tare 1\n  \
                        2 faults (longest time until both bridges were off): jam 2 (300 ms)\n";
        assert_eq!(tally.to_string(), expected);
    }
}
