//! Patterns over robot names: `*` matches any characters, all other characters are literal.

use std::fmt;

use armwatch_model::robot::name::composed;

/// Groups of patterns over the file names of exports.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FilePatterns(pub Vec<Vec<String>>);

impl FilePatterns {
    /// Whether one pattern of each group matches the whole name.
    pub fn matches(&self, file_name: &str) -> bool {
        self.0.iter().all(|group| group.iter().any(|pattern| matches(pattern, file_name)))
    }

    /// The names that both match.
    pub fn and(&self, other: &Self) -> Self {
        Self([&self.0[..], &other.0[..]].concat())
    }
}

impl fmt::Display for FilePatterns {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let groups: Vec<String> = self.0.iter().map(|group| group.join(" or ")).collect();
        f.write_str(&groups.join(", and "))
    }
}

/// Returns true if `pattern` matches the whole of `name`.
pub(super) fn matches(pattern: &str, name: &str) -> bool {
    let name: Vec<_> = composed(name).chars().map(PatternPiece::One).collect();
    meet(&pieces(pattern), &name)
}

/// Returns true if `wide` matches every name that `narrow` matches.
pub(super) fn covers(wide: &str, narrow: &str) -> bool {
    // The star of the narrow pattern is replaced by a character that no name contains, which only a star can match. A
    // pattern that matches the result matches all texts of the narrow pattern's star.
    let narrow: Vec<_> = pieces(narrow)
        .into_iter()
        .map(|piece| if piece == PatternPiece::Any { PatternPiece::Unwritable } else { piece })
        .collect();
    meet(&pieces(wide), &narrow)
}

/// Returns true if some name matches both patterns.
pub(super) fn overlap(a: &str, b: &str) -> bool {
    meet(&pieces(a), &pieces(b))
}

#[derive(Clone, Copy, PartialEq)]
enum PatternPiece {
    Any,
    One(char),
    Unwritable,
}

fn pieces(pattern: &str) -> Vec<PatternPiece> {
    composed(pattern)
        .chars()
        .map(|c| if c == '*' { PatternPiece::Any } else { PatternPiece::One(c) })
        .collect()
}

/// Returns true if two sequences match a common text: `reachable[i][j]` is true if the first `i` and `j` pieces do.
fn meet(a: &[PatternPiece], b: &[PatternPiece]) -> bool {
    let mut reachable = vec![vec![false; b.len() + 1]; a.len() + 1];
    for i in 0..=a.len() {
        for j in 0..=b.len() {
            let star_a = i > 0 && a[i - 1] == PatternPiece::Any;
            let star_b = j > 0 && b[j - 1] == PatternPiece::Any;
            let without_a = i > 0 && reachable[i - 1][j];
            let without_b = j > 0 && reachable[i][j - 1];
            // A star may end here, or match the other side's last piece.
            reachable[i][j] = (i == 0 && j == 0)
                || ((star_a || star_b) && (without_a || without_b))
                || (i > 0 && j > 0 && a[i - 1] == b[j - 1] && reachable[i - 1][j - 1]);
        }
    }
    reachable[a.len()][b.len()]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_star_stands_for_any_characters_and_the_whole_name_counts() {
        for (pattern, name, expected) in [
            ("*", "R00", true),
            ("*", "", true),
            ("R00", "R00", true),
            ("R00", "R001", false),
            ("R00", "XR00", false),
            ("R*", "R00", true),
            ("*0", "R00", true),
            ("R*0", "R0", true),
            ("R*0*", "R1", false),
            ("line-1-*", "line-1-left", true),
            ("r00", "R00", false),
            ("R.0", "R00", false),
            ("", "R00", false),
        ] {
            assert_eq!(matches(pattern, name), expected, "{pattern} {name}");
        }
    }

    #[test]
    fn covering_and_overlap_agree_with_all_short_names() {
        // Second method: every name up to four letters, over an alphabet with one letter that no pattern contains, is
        // enough to distinguish patterns of up to three pieces.
        let patterns = words(&['a', 'b', '*'], 3);
        let names = words(&['a', 'b', 'c'], 4);
        for p in &patterns {
            for q in &patterns {
                let both = names.iter().any(|n| matches(p, n) && matches(q, n));
                assert_eq!(overlap(p, q), both, "{p} {q}");
                let all = names.iter().all(|n| !matches(q, n) || matches(p, n));
                assert_eq!(covers(p, q), all, "{p} {q}");
            }
        }
    }

    fn words(letters: &[char], longest: usize) -> Vec<String> {
        let mut words = vec![String::new()];
        let mut last = words.clone();
        for _ in 0..longest {
            last = last.iter().flat_map(|w| letters.iter().map(move |l| format!("{w}{l}"))).collect();
            words.extend(last.clone());
        }
        words
    }
}
