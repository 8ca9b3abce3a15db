//! Words in dates: months, weekdays, morning and afternoon.

/// Names of the months in English, German and Italian, in small letters and without points.
pub(super) const MONTHS: [&[&str]; 12] = [
    &["jan", "january", "januar", "j\u{e4}n", "j\u{e4}nner", "gen", "gennaio"],
    &["feb", "february", "februar", "febr", "feber", "febbraio"],
    &["mar", "march", "m\u{e4}r", "mrz", "m\u{e4}rz", "marzo"],
    &["apr", "april", "aprile"],
    &["may", "mai", "mag", "maggio"],
    &["jun", "june", "juni", "giu", "giugno"],
    &["jul", "july", "juli", "lug", "luglio"],
    &["aug", "august", "ago", "agosto"],
    &["sep", "sept", "september", "set", "settembre"],
    &["oct", "october", "okt", "oktober", "ott", "ottobre"],
    &["nov", "november", "novembre"],
    &["dec", "december", "dez", "dezember", "dic", "dicembre"],
];

/// The word at the start of a text, without a point after it, and the rest.
fn word(text: &str) -> Option<(&str, &str)> {
    let end = text.find(|c: char| !c.is_alphabetic()).unwrap_or(text.len());
    let (word, rest) = text.split_at_checked(end)?;
    (!word.is_empty()).then(|| (word, rest.strip_prefix('.').unwrap_or(rest)))
}

/// The month, from 1, whose name is at the start of a text, and the rest.
pub(super) fn month(text: &str) -> Option<(i64, &str)> {
    let (word, rest) = word(text.trim_start_matches(super::is_blank))?;
    Some((month_of(word)?, rest))
}

/// The month, from 1, of that name.
pub(super) fn month_of(word: &str) -> Option<i64> {
    let lower = word.to_lowercase();
    let place = MONTHS.iter().position(|names| names.contains(&lower.as_str()))?;
    i64::try_from(place + 1).ok()
}

/// The text after a word.
pub(super) fn skip_word(text: &str) -> Option<&str> {
    word(text).map(|(_, rest)| rest)
}

/// Returns true if a text begins with PM, false for AM, and the rest.
pub(super) fn meridiem(text: &str) -> Option<(bool, &str)> {
    let text = text.trim_start_matches(super::is_blank);
    let spellings = [("a.m.", false), ("p.m.", true), ("am", false), ("pm", true)];
    spellings.into_iter().find_map(|(spelled, is_afternoon)| {
        let (head, rest) = text.split_at_checked(spelled.len())?;
        head.eq_ignore_ascii_case(spelled).then_some((is_afternoon, rest))
    })
}
