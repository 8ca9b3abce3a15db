//! What encoding text that is not plain UTF-8 looks like, so that a rejection can name it.

/// The encoding that the first bytes of a file look like, where it is not UTF-8.
///
/// Knows byte order marks, and UTF-16 without one by its zero bytes: in digits and Latin letters
/// every second byte is zero.
pub(super) fn wide_encoding(head: &[u8]) -> Option<&'static str> {
    match head {
        [0xFF, 0xFE, 0, 0, ..] => Some("UTF-32 (little endian)"),
        [0, 0, 0xFE, 0xFF, ..] => Some("UTF-32 (big endian)"),
        [0xFF, 0xFE, ..] => Some("UTF-16 (little endian)"),
        [0xFE, 0xFF, ..] => Some("UTF-16 (big endian)"),
        [a, 0, b, 0, ..] if *a != 0 && *b != 0 => Some("UTF-16 (little endian)"),
        [0, a, 0, b, ..] if *a != 0 && *b != 0 => Some("UTF-16 (big endian)"),
        _ => None,
    }
}

/// The eight-bit encoding that invalid UTF-8 looks like.
pub(super) fn narrow_encoding(text: &[u8]) -> &'static str {
    // Latin-1 has control characters at 0x80..0x9F, Windows-1252 has letters and signs there.
    if text.iter().any(|byte| (0x80..0xA0).contains(byte)) { "Windows-1252" } else { "Latin-1" }
}

/// The text without the UTF-8 byte order mark.
pub(super) fn without_bom(text: &[u8]) -> &[u8] {
    text.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(text)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_what_the_first_bytes_look_like() {
        let little: Vec<u8> = "time".encode_utf16().flat_map(u16::to_le_bytes).collect();
        let big: Vec<u8> = "time".encode_utf16().flat_map(u16::to_be_bytes).collect();
        assert_eq!(wide_encoding(&little), Some("UTF-16 (little endian)"));
        assert_eq!(wide_encoding(&big), Some("UTF-16 (big endian)"));
        assert_eq!(wide_encoding(b"\xFF\xFEt\0"), Some("UTF-16 (little endian)"));
        assert_eq!(wide_encoding(b"\xFE\xFF\0t"), Some("UTF-16 (big endian)"));
        assert_eq!(wide_encoding(b"\xFF\xFE\0\0t\0\0\0"), Some("UTF-32 (little endian)"));
        assert_eq!(wide_encoding(b"time,pos_1"), None);
        assert_eq!(wide_encoding(b"\xEF\xBB\xBFtime"), None);
        assert_eq!(narrow_encoding(b"\xB0C"), "Latin-1");
        assert_eq!(narrow_encoding(b"\x80"), "Windows-1252");
    }
}
