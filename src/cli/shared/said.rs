//! Texts from people for later readers: work done, reason, and author.

/// Reads a text, without surrounding spaces; an empty one is refused.
pub(in crate::cli) fn said(text: &str) -> Result<String, String> {
    match text.trim() {
        "" => Err("it is empty; write a text for later readers of the history".to_owned()),
        words => Ok(words.to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_text_of_spaces_says_nothing() {
        assert_eq!(said(" gearbox changed\n"), Ok("gearbox changed".to_owned()));
        for nothing in ["", "  ", "\t\n"] {
            assert!(said(nothing).is_err_and(|words| words.contains("it is empty")));
        }
    }
}
