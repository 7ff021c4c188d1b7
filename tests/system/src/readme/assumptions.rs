//! Tables of the page of assumptions, from the table of unknowns.

use anyhow::{Context, Result};
use mechanics::unknowns::{Family, SECTIONS, Unknown};

/// Unit on the page and how many of it the one of the table has.
fn shown(unit: &str) -> (&str, f64) {
    match unit {
        "1" => ("", 1.0),
        "m" => (" mm", 1e3),
        "rad" => (" mrad", 1e3),
        "Pa" => (" kPa", 1e-3),
        "s" => (" ms", 1e3),
        "N" => (" N", 1.0),
        "px" => (" px", 1.0),
        "N/m" => (" N/m", 1.0),
        "rad/(N m)" => (" rad/(N m)", 1.0),
        _ => unreachable!("{unit}: a unit of the table without one on the page"),
    }
}

/// With the digits that it is stated with.
fn number(value: f64) -> String {
    let rounded: f64 = format!("{value:.3e}").parse().unwrap_or(value);
    format!("{rounded}")
}

/// Assumption about a quantity, in words.
fn assumed(unknown: &Unknown) -> String {
    let (unit, per_si) = shown(unknown.unit);
    let (mean, sd) = (unknown.mean(), unknown.sd());
    let prior = match unknown.prior.family {
        Family::Normal => format!("{}, sd {}", number(per_si * mean), in_unit(sd, per_si, unit)),
        Family::LogNormal => format!("{}, sd of ln {}", in_unit(mean, per_si, unit), number(sd)),
        Family::Size => format!("sd about {}, found", in_unit(mean, per_si, unit)),
        Family::Fixed => in_unit(mean, per_si, unit),
    };
    match unknown.range {
        [least, most] if least.is_finite() && most.is_finite() => {
            format!("{prior}; {} to {}", number(per_si * least), in_unit(most, per_si, unit))
        }
        _ => prior,
    }
}

fn in_unit(value: f64, per_si: f64, unit: &str) -> String {
    format!("{}{unit}", number(per_si * value))
}

/// The table of a section.
///
/// # Errors
/// Where there is none of this title.
pub fn table(title: &str) -> Result<String> {
    let (_, entries) = SECTIONS
        .iter()
        .find(|(section, _)| *section == title)
        .with_context(|| format!("{title}: no section of the table of unknowns, expected {}", titles()))?;
    let rows: String = entries
        .iter()
        .map(|unknown| {
            let Unknown { name, used_by, why, .. } = unknown;
            format!("| {name} | {} | {used_by} | {why} |\n", assumed(unknown))
        })
        .collect();
    Ok(format!("| quantity | assumed | used by | why |\n|---|---|---|---|\n{rows}"))
}

fn titles() -> String {
    SECTIONS.map(|(title, _)| title).join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::images;
    use crate::readme::book::Book;
    use crate::readme::page::Made;
    use mechanics::unknowns::{rig, sensors, tissue};

    #[test]
    fn an_entry_is_read_in_the_units_of_a_lab() {
        assert_eq!(assumed(&tissue::MODULUS), "15 kPa, sd of ln 1; 0.05 to 5000 kPa");
        assert_eq!(assumed(&rig::GUIDE2_POSITION), "0, sd 0.3 mm");
        assert_eq!(assumed(&sensors::FORCE_ZERO), "sd about 0.01 N, found");
    }

    #[test]
    fn every_section_has_its_table_on_a_page() {
        let blocks = Book::read(images::root()).unwrap().blocks().unwrap();
        for (title, _) in SECTIONS {
            assert!(shown(title, &blocks), "{title}: no page has its table");
        }
        assert!(table("Weather").is_err());
    }

    fn shown(title: &str, blocks: &[crate::readme::page::Block]) -> bool {
        blocks.iter().any(|block| block.made == Made::Assumptions(title.to_owned()))
    }
}
