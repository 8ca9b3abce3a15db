//! "Did you mean": the known word that a misspelt one is nearest to.

/// The candidate that is fewest single-letter changes away from `word`, if those are few enough
/// to be a slip of the pen: one change in short words, a third of the letters in long ones.
pub(crate) fn nearest<'c>(word: &str, candidates: impl IntoIterator<Item = &'c str>) -> Option<&'c str> {
    let permitted = (word.chars().count() / 3).max(1);
    candidates
        .into_iter()
        .map(|candidate| (edit_distance(word, candidate), candidate))
        .filter(|&(distance, _)| distance <= permitted)
        .min_by_key(|&(distance, _)| distance)
        .map(|(_, candidate)| candidate)
}

/// Fewest insertions, deletions, replacements and swaps of neighbours from one word to the other
/// (optimal string alignment). Case does not count: `Joint` for `joint` is the smallest slip.
fn edit_distance(from: &str, to: &str) -> usize {
    strsim::osa_distance(&from.to_lowercase(), &to.to_lowercase())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distance_is_zero_only_for_the_same_word_and_symmetric() {
        let words = ["", "settle_s", "setle_s", "settel_s", "scan_interval_s", "alpha_deg", "alpha_rad"];
        for a in words {
            for b in words {
                assert_eq!(edit_distance(a, b), edit_distance(b, a), "{a} {b}");
                assert_eq!(edit_distance(a, b) == 0, a == b, "{a} {b}");
            }
        }
        assert_eq!(edit_distance("settel_s", "settle_s"), 1);
        assert_eq!(edit_distance("", "settle_s"), 8);
    }

    #[test]
    fn only_a_slip_is_mended() {
        let keys = ["settle_s", "scan_interval_s", "folders"];
        assert_eq!(nearest("setle_s", keys), Some("settle_s"));
        assert_eq!(nearest("Folders", keys), Some("folders"));
        assert_eq!(nearest("database", keys), None);
    }
}
