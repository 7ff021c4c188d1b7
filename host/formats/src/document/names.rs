//! Names that were perhaps meant by names that are not known.

use strsim::levenshtein;

/// The candidate that is probably a misspelt `wanted`: it differs in case alone, or in two of five characters at
/// most, and never in more than two.
pub fn misspelt<'c>(wanted: &str, candidates: impl IntoIterator<Item = &'c str>) -> Option<&'c str> {
    let near = |candidate: &str| {
        let off = levenshtein(&wanted.to_lowercase(), &candidate.to_lowercase());
        (off <= 2 && 5 * off <= 2 * wanted.len()).then_some(off)
    };
    let found = candidates.into_iter().filter(|candidate| candidate.len() <= 2 * wanted.len());
    found.filter_map(|candidate| Some((near(candidate)?, candidate))).min().map(|(_, candidate)| candidate)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slips_are_recognised_and_other_names_are_not() {
        let names = ["guide_2_mm", "entry_mm", "note", "Depth_mm"];
        assert_eq!(misspelt("guide2_mm", names), Some("guide_2_mm"));
        assert_eq!(misspelt("depth_mm", names), Some("Depth_mm"));
        assert_eq!(misspelt("noise", ["nosie"]), Some("nosie"));
        assert_eq!(misspelt("force_n", names), None);
        assert_eq!(misspelt("id", ["i", "x"]), None, "too short");
    }
}
