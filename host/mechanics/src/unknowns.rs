//! The table of unknowns: what is assumed of every quantity before any data, in one place.
//!
//! An entry is an [`Unknown`]: prior, typical size, range, unit, who uses it and why it is what it is. Programs take their priors from here
//! by name, so that a misspelt quantity does not compile; no other file states one, which a test holds, and the manual's page of
//! assumptions is made from it. The part of the table for effects is their catalogue ([`effects`](crate::effects)): prior and range of a
//! parameter stand with its physics ([`ParameterInfo`](crate::effects::ParameterInfo)).
//!
//! Values are in SI. Truths that a simulation draws are no part of it: a generator that shared them would confirm them.
//!
//! | section | of |
//! |---|---|
//! | [`tissue`] | modulus, surface, gap |
//! | [`rig`] | needle, guides, rear |
//! | [`tip`] | load, angles, path |
//! | [`sensors`] | noise, zeros, clocks |
//! | [`discrepancy`] | what every rig and tissue leave behind any model |

/// One section: a constant per entry, and all of them in order.
macro_rules! section {
    ($($id:ident { name: $name:literal, unit: $unit:literal, prior: $prior:expr, $(scale: $scale:expr,)? $(range: $range:expr,)?
        used_by: $used_by:literal, why: $why:literal $(,)? })+) => {
        $(
            #[doc = concat!("Of ", $name, " (", $unit, "): ", $why, ".")]
            pub const $id: Unknown = {
                let entry = Unknown::new($name, $unit, $prior, $used_by, $why);
                $(let entry = Unknown { scale: $scale, ..entry };)?
                $(let entry = Unknown { range: $range, ..entry };)?
                entry
            };
        )+
        /// Every entry of the section.
        pub const ALL: &[Unknown] = &[$($id),+];
    };
}

pub mod discrepancy;
pub mod rig;
pub mod sensors;
pub mod tip;
pub mod tissue;

/// Shape of a prior.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Family {
    /// The quantity is normal.
    Normal,
    /// Its logarithm is.
    LogNormal,
    /// A standard deviation that the data determine, about a typical one: log-normal where all sizes are found together
    /// (predictions); in a diagnosis half-normal above the typical one, so that no tail explains what an effect does.
    Size,
    /// A value that is taken as it is: where neither a session nor its readings give it.
    Fixed,
}

/// In a diagnosis the logarithm of a [`Family::Size`] is normal with this standard deviation below the typical value; above it the size itself
/// is normal.
pub const SMALLER_SIZE_SD_LN: f64 = 1.5;

/// Assumption about a quantity.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Prior {
    /// Shape.
    pub family: Family,
    /// Mean; the median where the logarithm is normal; the typical value of a size; the value that is taken.
    pub mean: f64,
    /// Standard deviation: in the unit of the quantity where that is normal, of the logarithm where that is. Standard
    /// deviation of a size: of its logarithm, and above its typical value in multiples of that. 0 of a value that is
    /// taken.
    pub sd: f64,
}

impl Prior {
    /// A normal quantity.
    pub const fn normal(mean: f64, sd: f64) -> Self {
        Self { family: Family::Normal, mean, sd }
    }

    /// An error of a known size: zero is the likeliest.
    pub const fn error(sd: f64) -> Self {
        Self::normal(0.0, sd)
    }

    /// A quantity whose logarithm is normal.
    pub const fn log_normal(median: f64, sd_ln: f64) -> Self {
        Self { family: Family::LogNormal, mean: median, sd: sd_ln }
    }

    /// A standard deviation that the data determine.
    pub const fn size(typical: f64, sd: f64) -> Self {
        Self { family: Family::Size, mean: typical, sd }
    }

    /// A value that is taken as it is.
    pub const fn fixed(value: f64) -> Self {
        Self { family: Family::Fixed, mean: value, sd: 0.0 }
    }
}

/// An entry of the table.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Unknown {
    /// The quantity, as a noun.
    pub name: &'static str,
    /// Its unit, SI; `1` for a share, a ratio or a logarithm.
    pub unit: &'static str,
    /// Assumption about it.
    pub prior: Prior,
    /// Typical size: where a search starts, or a step is a part of.
    pub scale: f64,
    /// Possible values.
    pub range: [f64; 2],
    /// Commands that assume it.
    pub used_by: &'static str,
    /// Reason or source of the values.
    pub why: &'static str,
}

impl Unknown {
    const fn new(
        name: &'static str,
        unit: &'static str,
        prior: Prior,
        used_by: &'static str,
        why: &'static str,
    ) -> Self {
        let is_signed = matches!(prior.family, Family::Normal);
        let range = if is_signed { [f64::NEG_INFINITY, f64::INFINITY] } else { [0.0, f64::INFINITY] };
        let scale = if is_signed && prior.mean == 0.0 { prior.sd } else { prior.mean };
        Self { name, unit, prior, scale, range, used_by, why }
    }

    /// Mean of the prior, median or typical size ([`Prior::mean`]).
    pub const fn mean(&self) -> f64 {
        self.prior.mean
    }

    /// Standard deviation of the prior ([`Prior::sd`]).
    pub const fn sd(&self) -> f64 {
        self.prior.sd
    }

    /// The same where a session states how well the quantity is known.
    #[must_use]
    pub const fn with_sd(self, sd: f64) -> Self {
        Self { prior: Prior { sd, ..self.prior }, ..self }
    }

    /// Standard deviation of an error: that of a normal one, and the typical or taken one where the entry is itself a standard deviation.
    pub const fn typical_sd(&self) -> f64 {
        match self.prior.family {
            Family::Normal | Family::LogNormal => self.prior.sd,
            Family::Size | Family::Fixed => self.prior.mean,
        }
    }

    /// Least value that is possible, or better than which nothing is known.
    pub const fn least(&self) -> f64 {
        self.range[0]
    }

    /// Largest value that is possible.
    pub const fn most(&self) -> f64 {
        self.range[1]
    }
}

/// A section's title and entries.
pub type Section = (&'static str, &'static [Unknown]);

/// The whole table.
pub static SECTIONS: [Section; 6] = [
    ("Tissue", tissue::ALL),
    ("Needle and guides", rig::ALL),
    ("Tip and path", tip::ALL),
    ("Sensors", sensors::ALL),
    ("Discrepancy in lateral runs", discrepancy::lateral::ALL),
    ("Discrepancy in insertions", discrepancy::insertion::ALL),
];

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    fn all() -> impl Iterator<Item = &'static Unknown> {
        SECTIONS.iter().flat_map(|(_, entries)| entries.iter())
    }

    #[test]
    fn every_entry_is_a_distribution_within_its_range() {
        for Unknown { name, unit, prior, scale, range: [least, most], used_by, why } in all() {
            assert!(prior.sd.is_finite() && prior.mean.is_finite(), "{name}");
            assert_eq!(prior.sd > 0.0, prior.family != Family::Fixed, "{name}");
            assert!(least < most && (*least..=*most).contains(&prior.mean), "{name}");
            assert!(*scale != 0.0 && (*least..=*most).contains(scale), "{name}");
            assert!(prior.family == Family::Normal || prior.mean > 0.0, "{name}: no logarithm");
            assert!(!unit.is_empty() && !used_by.is_empty() && why.len() > 20, "{name}");
            assert!(!why.ends_with('.') && !name.ends_with('.'), "{name}: no sentence of its own");
        }
    }

    #[test]
    fn every_quantity_stands_once() {
        let names: BTreeSet<&str> = all().map(|entry| entry.name).collect();
        assert_eq!(names.len(), all().count());
    }
}
