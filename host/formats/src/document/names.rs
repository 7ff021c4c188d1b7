//! Names that were perhaps meant by names that are not known.

use strsim::levenshtein;

/// The candidate that is probably a misspelt `wanted`: it differs in case alone, or in two of five characters at
/// most, and never in more than two.
pub fn misspelt<'c>(wanted: &str, candidates: impl IntoIterator<Item = &'c str>) -> Option<&'c str> {
    fn near(candidate: &str, wanted: &str) -> Option<usize> {
        let edit_distance = levenshtein(&wanted.to_lowercase(), &candidate.to_lowercase());
        (edit_distance <= 2 && 5 * edit_distance <= 2 * wanted.len()).then_some(edit_distance)
    }
    let closest = candidates.into_iter().filter(|candidate| candidate.len() <= 2 * wanted.len());
    closest
        .filter_map(|candidate| Some((near(candidate, wanted)?, candidate)))
        .min()
        .map(|(_, candidate)| candidate)
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
