//! Odds of causes in words.

/// Odds in words. Beyond a million the difference does not matter, and no model is so accurate.
#[must_use]
pub fn odds_in_words(odds: f64) -> String {
    match odds {
        1e6.. => "more than a million to 1".into(),
        1.0.. => format!("{odds:.0} to 1"),
        1e-6.. => format!("1 to {:.0}", odds.recip()),
        _ => "less than 1 to a million".into(),
    }
}

#[cfg(test)]
mod tests {
    use super::odds_in_words;

    #[test]
    fn odds_are_said_as_people_say_them() {
        let said = [28_089.7, 1.4, 0.5, 1e-3, 1e9, 1e-30, 0.0].map(odds_in_words);
        assert_eq!(
            said,
            [
                "28090 to 1",
                "1 to 1",
                "1 to 2",
                "1 to 1000",
                "more than a million to 1",
                "less than 1 to a million",
                "less than 1 to a million"
            ]
        );
    }
}
