//! Names that were perhaps meant by names that are not known.

/// The candidate that looks like a misspelt `wanted`: it differs in case alone, or in two of five characters at
/// most, and never in more than two.
pub(crate) fn misspelt<'c>(wanted: &str, candidates: impl IntoIterator<Item = &'c str>) -> Option<&'c str> {
    let near = |candidate: &str| {
        let off = distance(&wanted.to_lowercase(), &candidate.to_lowercase());
        (off <= 2 && 5 * off <= 2 * wanted.len()).then_some(off)
    };
    let found = candidates.into_iter().filter(|candidate| candidate.len() <= 2 * wanted.len());
    found.filter_map(|candidate| Some((near(candidate)?, candidate))).min().map(|(_, candidate)| candidate)
}

/// Number of characters to be changed, added or left out to make one text of another.
pub(crate) fn distance(a: &str, b: &str) -> usize {
    let b: Vec<char> = b.chars().collect();
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, from) in a.chars().enumerate() {
        let mut next = vec![i + 1];
        for ((to, pair), left) in b.iter().zip(row.windows(2)).zip(0..) {
            let &[diagonal, above] = pair else { continue };
            let beside = next.get(left).copied().unwrap_or(usize::MAX - 1);
            next.push((diagonal + usize::from(from != *to)).min(above + 1).min(beside + 1));
        }
        row = next;
    }
    row.last().copied().unwrap_or_default()
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
        assert_eq!(misspelt("id", ["i", "x"]), None, "too short to tell");
    }
}
