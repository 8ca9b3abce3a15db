//! Numbers in addresses.

use std::str::FromStr;

use axum::http::StatusCode;

use crate::serve::answer::Refusal;

/// Parses the number of `what`, such as a run, from an address.
///
/// # Errors
/// 400 for any other text, with the view and column that contain the numbers.
pub fn number<T: FromStr>(text: &str, what: &str, column: &str) -> Result<T, Refusal> {
    text.parse().map_err(|_| {
        let sentence = format!("{what} \"{}\" is no whole number from 1 on; {column}", text.escape_debug());
        Refusal::new(StatusCode::BAD_REQUEST, sentence)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_text_that_is_no_number_is_refused_with_where_the_numbers_are() {
        let runs = "GET /v1/views/runs has the numbers in its column run_id";
        assert_eq!(number::<i64>("12", "run", runs), Ok(12));
        for text in ["x", "", "1.5", "99999999999999999999"] {
            let refused = number::<i64>(text, "run", runs).expect_err("a refusal");
            assert_eq!(refused.status, StatusCode::BAD_REQUEST);
            assert!(refused.sentence.contains(&format!("run \"{text}\"")), "{}", refused.sentence);
            assert!(refused.sentence.ends_with(runs), "{}", refused.sentence);
        }
        assert!(number::<u32>("-1", "cycle", runs).is_err());
    }
}
