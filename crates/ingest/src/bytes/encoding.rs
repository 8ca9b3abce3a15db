//! Converts bytes to UTF-8 text, for any encoding of an export, during reading.
//!
//! The result does not depend on how the bytes are divided: a unit or character that the end of a growing file cuts
//! waits for its rest. UTF-8 text passes through unchanged.

use std::io::{self, Read};

use encoding_rs::{CoderResult, Decoder, UTF_16BE, UTF_16LE, WINDOWS_1252};

use crate::rejection::Unreadable;
use armwatch_config::TextEncoding;

/// First bytes that determine the encoding; fewer only if the file has fewer.
const HEAD_BYTES: usize = 4;

/// Bytes decoded at once.
const DECODE_BYTES: usize = 64 << 10;

/// Detected encoding of an export.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Found {
    /// UTF-8, or an unknown encoding, passed on unchanged.
    Utf8,
    /// UTF-16, low byte first.
    Utf16Le,
    /// UTF-16, high byte first.
    Utf16Be,
    /// Windows-1252.
    Windows1252,
}

impl Found {
    /// The encoding in the notation of layouts.
    pub fn declared(self) -> TextEncoding {
        match self {
            Self::Utf8 => TextEncoding::Utf8,
            Self::Utf16Le => TextEncoding::Utf16Le,
            Self::Utf16Be => TextEncoding::Utf16Be,
            Self::Windows1252 => TextEncoding::Windows1252,
        }
    }

    /// Bytes that this UTF-8 text has in the file.
    pub fn bytes_in_file(self, text: &[u8]) -> u64 {
        let count = |is: fn(&u8) -> bool| text.iter().filter(|byte| is(byte)).count() as u64;
        let characters = || count(|byte| byte & 0xC0 != 0x80);
        match self {
            Self::Utf8 => text.len() as u64,
            Self::Windows1252 => characters(),
            // Characters of four bytes are two units.
            Self::Utf16Le | Self::Utf16Be => 2 * (characters() + count(|byte| *byte >= 0xF0)),
        }
    }
}

/// Returns the text of `inner` as UTF-8, without byte order mark.
///
/// With [`TextEncoding::Auto`] a byte order mark decides, otherwise zero bytes in the first characters; text that was
/// ASCII so far and then contains invalid UTF-8 is Windows-1252. A byte order mark overrides the declared encoding.
/// Halves of characters become U+FFFD; invalid UTF-8 is passed on, so that the reader of cells can report its place.
pub struct TextReader<R> {
    inner: R,
    declared: TextEncoding,
    found: Found,
    state: ReaderState,
    /// Bytes of `inner` that are neither decoded nor returned.
    input: Vec<u8>,
    /// Decoded bytes; those from `given` on are not yet returned.
    output: Vec<u8>,
    given: usize,
    mark_bytes: u64,
    at_end: bool,
}

enum ReaderState {
    /// Fewer bytes than needed were seen.
    Undecided,
    /// Unchanged.
    Raw,
    /// UTF-8 or Windows-1252; whether a character of several bytes was seen.
    EightBit { several: bool },
    /// Through a decoder.
    Decoding(Box<Decoder>),
}

impl<R> std::fmt::Debug for TextReader<R> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("TextReader").field("found", &self.found()).finish_non_exhaustive()
    }
}

impl<R> TextReader<R> {
    /// Reads `inner` as `declared`.
    pub fn new(inner: R, declared: TextEncoding) -> Self {
        Self {
            inner,
            declared,
            found: Found::Utf8,
            state: ReaderState::Undecided,
            input: Vec::new(),
            output: Vec::new(),
            given: 0,
            mark_bytes: 0,
            at_end: false,
        }
    }

    /// The detected encoding of the text read so far.
    pub fn found(&self) -> Found {
        self.found
    }

    /// Bytes of the byte order mark.
    pub fn mark_bytes(&self) -> u64 {
        self.mark_bytes
    }
}

impl<R: Read> TextReader<R> {
    fn decide(&mut self) -> io::Result<()> {
        while self.input.len() < HEAD_BYTES && !self.at_end {
            let mut more = [0; HEAD_BYTES];
            let wanted = HEAD_BYTES - self.input.len();
            match self.inner.read(&mut more[..wanted]) {
                Ok(0) => self.at_end = true,
                Ok(count) => self.input.extend_from_slice(&more[..count]),
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => return Err(error),
            }
        }
        let (encoding, mark) = told(&self.input, self.declared)?;
        self.mark_bytes = mark as u64;
        self.input.drain(..mark);
        self.state = match encoding {
            Told::Raw => ReaderState::Raw,
            Told::EightBit => ReaderState::EightBit { several: false },
            Told::Other(found) => self.decoding(found),
        };
        Ok(())
    }

    /// Appends bytes to `input`; `false` at the end.
    fn fill(&mut self) -> io::Result<bool> {
        let before = self.input.len();
        self.input.resize(before + DECODE_BYTES, 0);
        let read = self.inner.read(&mut self.input[before..]);
        self.input.truncate(before + read.as_ref().map_or(0, |count| *count));
        let count = read?;
        self.at_end |= count == 0;
        Ok(count > 0)
    }

    /// Returns waiting bytes, or reads on, until it is clear that the next bytes are UTF-8 or not.
    fn read_eight_bit(&mut self, buffer: &mut [u8], several: bool) -> io::Result<usize> {
        if self.input.is_empty() {
            let count = self.inner.read(buffer)?;
            if buffer[..count].is_ascii() {
                return Ok(count);
            }
            self.input.extend_from_slice(&buffer[..count]);
        }
        loop {
            let (valid, broken) = match std::str::from_utf8(&self.input) {
                Ok(text) => (text.len(), false),
                Err(error) => (error.valid_up_to(), error.error_len().is_some()),
            };
            if valid > 0 {
                let count = given_from(&mut self.input, valid, buffer);
                self.state = ReaderState::EightBit { several: several || !buffer[..count].is_ascii() };
                return Ok(count);
            }
            if broken || self.at_end {
                // At the end, half a character: the line is cut there, which is reported.
                let windows = broken && !several;
                self.state = if windows { self.decoding(Found::Windows1252) } else { ReaderState::Raw };
                return self.read(buffer);
            }
            self.fill()?;
        }
    }

    fn decoding(&mut self, found: Found) -> ReaderState {
        let encoding = match found {
            Found::Utf16Le => UTF_16LE,
            Found::Utf16Be => UTF_16BE,
            Found::Windows1252 => WINDOWS_1252,
            Found::Utf8 => return ReaderState::Raw,
        };
        self.found = found;
        ReaderState::Decoding(Box::new(encoding.new_decoder_without_bom_handling()))
    }

    fn read_decoded(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        while self.given == self.output.len() {
            if self.at_end && self.input.is_empty() && self.output.is_empty() {
                return Ok(0);
            }
            if self.input.is_empty() && !self.at_end {
                self.fill()?;
            }
            self.decode();
            if self.at_end && self.output.is_empty() {
                return Ok(0);
            }
        }
        let left = &self.output[self.given..];
        let count = left.len().min(buffer.len());
        buffer[..count].copy_from_slice(&left[..count]);
        self.given += count;
        Ok(count)
    }

    /// Decodes all of `input` into `output`.
    fn decode(&mut self) {
        self.output.clear();
        self.given = 0;
        let ReaderState::Decoding(decoder) = &mut self.state else { return };
        // A unit of UTF-16 becomes three bytes at most, and the decoder may keep one back.
        let most = decoder.max_utf8_buffer_length(self.input.len()).unwrap_or(3 * DECODE_BYTES);
        self.output.resize(most, 0);
        let (result, read, written, _) = decoder.decode_to_utf8(&self.input, &mut self.output, self.at_end);
        self.output.truncate(written);
        self.input.drain(..read);
        if result == CoderResult::InputEmpty && self.at_end {
            // A decoder that has reached the end must not be called again.
            self.state = ReaderState::Raw;
        }
    }
}

impl<R: Read> Read for TextReader<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if buffer.is_empty() {
            return Ok(0);
        }
        if matches!(self.state, ReaderState::Undecided) {
            self.decide()?;
        }
        match self.state {
            ReaderState::Undecided => Ok(0),
            ReaderState::Raw if self.given < self.output.len() => self.read_decoded(buffer),
            ReaderState::Raw if !self.input.is_empty() => {
                let all = self.input.len();
                Ok(given_from(&mut self.input, all, buffer))
            }
            ReaderState::Raw if self.at_end => Ok(0),
            ReaderState::Raw => self.inner.read(buffer),
            ReaderState::EightBit { several } => self.read_eight_bit(buffer, several),
            ReaderState::Decoding(..) => self.read_decoded(buffer),
        }
    }
}

/// Moves up to `most` bytes from the front of `input` into `buffer`.
fn given_from(input: &mut Vec<u8>, most: usize, buffer: &mut [u8]) -> usize {
    let count = most.min(buffer.len());
    buffer[..count].copy_from_slice(&input[..count]);
    input.drain(..count);
    count
}

enum Told {
    Raw,
    EightBit,
    Other(Found),
}

/// Encoding by the first bytes of a file and its layout, and length of the byte order mark.
fn told(head: &[u8], declared: TextEncoding) -> io::Result<(Told, usize)> {
    let marked = match head {
        // UTF-32 begins like UTF-16; the reader of the header reports it.
        [0xFF, 0xFE, 0, 0] | [0, 0, 0xFE, 0xFF] => Some((Told::Raw, 0)),
        [0xEF, 0xBB, 0xBF, ..] => Some((Told::Raw, 3)),
        [0xFF, 0xFE, ..] => Some((Told::Other(Found::Utf16Le), 2)),
        [0xFE, 0xFF, ..] => Some((Told::Other(Found::Utf16Be), 2)),
        _ => None,
    };
    if let Some(marked) = marked {
        return Ok(marked);
    }
    let told = match (declared, wide_encoding(head)) {
        (TextEncoding::Auto, Some(Wide::Utf16Le)) => Told::Other(Found::Utf16Le),
        (TextEncoding::Auto, Some(Wide::Utf16Be)) => Told::Other(Found::Utf16Be),
        (TextEncoding::Auto, _) => Told::EightBit,
        (TextEncoding::Utf8, _) => Told::Raw,
        (TextEncoding::Windows1252, _) => Told::Other(Found::Windows1252),
        (TextEncoding::Utf16Le, _) => Told::Other(Found::Utf16Le),
        (TextEncoding::Utf16Be, _) => Told::Other(Found::Utf16Be),
    };
    let ascii = head.len() == HEAD_BYTES && head.iter().all(|byte| (b' '..=b'~').contains(byte));
    if ascii && matches!(declared, TextEncoding::Utf16Le | TextEncoding::Utf16Be) {
        return Err(io::Error::other(Unreadable {
            reason: format!("text with one byte per character, but the layout has {}", declared.name()),
            remedy: "remove encoding from the layout, so that it is detected in each file".into(),
        }));
    }
    Ok((told, 0))
}

/// An encoding with several bytes per unit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Wide {
    Utf16Le,
    Utf16Be,
    Utf32Le,
    Utf32Be,
}

impl Wide {
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Utf16Le => "UTF-16 (little endian)",
            Self::Utf16Be => "UTF-16 (big endian)",
            Self::Utf32Le => "UTF-32 (little endian)",
            Self::Utf32Be => "UTF-32 (big endian)",
        }
    }
}

/// The encoding with two or four bytes per unit that the first bytes of a file look like.
///
/// Recognises byte order marks, and UTF-16 without one by its zero bytes: in digits and Latin letters every second byte
/// is zero.
pub(crate) fn wide_encoding(head: &[u8]) -> Option<Wide> {
    match head {
        [0xFF, 0xFE, 0, 0, ..] => Some(Wide::Utf32Le),
        [0, 0, 0xFE, 0xFF, ..] => Some(Wide::Utf32Be),
        [0xFF, 0xFE, ..] => Some(Wide::Utf16Le),
        [0xFE, 0xFF, ..] => Some(Wide::Utf16Be),
        [a, 0, b, 0, ..] if *a != 0 && *b != 0 => Some(Wide::Utf16Le),
        [0, a, 0, b, ..] if *a != 0 && *b != 0 => Some(Wide::Utf16Be),
        _ => None,
    }
}

/// The eight-bit encoding that invalid UTF-8 looks like.
pub(crate) fn narrow_encoding(text: &[u8]) -> &'static str {
    // Latin-1 has control characters at 0x80..0x9F, Windows-1252 has letters and signs there.
    if text.iter().any(|byte| (0x80..0xA0).contains(byte)) { "Windows-1252" } else { "Latin-1" }
}

/// The text without the UTF-8 byte order mark.
pub(crate) fn without_bom(text: &[u8]) -> &[u8] {
    text.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(text)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const TEXT: &str = "Zeit;Drehmoment 1 [Nm];Notiz\n0,5;1;größer 10 € ≥ 𝄞\n";

    fn utf16(text: &str, big: bool, mark: bool) -> Vec<u8> {
        let units = mark.then_some(0xFEFF).into_iter().chain(text.encode_utf16());
        units.flat_map(|unit| if big { unit.to_be_bytes() } else { unit.to_le_bytes() }).collect()
    }

    fn windows(text: &str) -> Vec<u8> {
        let (bytes, _, lost) = WINDOWS_1252.encode(text);
        assert!(!lost);
        bytes.into_owned()
    }

    /// Returns pieces of these lengths, with a pause before each, like a growing file.
    struct GrowingBytes<'a>(&'a [u8], Vec<usize>, bool);

    impl Read for GrowingBytes<'_> {
        fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
            self.2 = !self.2;
            if self.2 {
                return Err(io::ErrorKind::WouldBlock.into());
            }
            let next = self.1.pop().unwrap_or(usize::MAX).min(self.0.len()).min(buffer.len());
            buffer[..next].copy_from_slice(&self.0[..next]);
            self.0 = &self.0[next..];
            Ok(next)
        }
    }

    /// All text and its detected encoding; reads again after pauses.
    fn read(inner: impl Read, declared: TextEncoding, buffer: usize) -> (Vec<u8>, Found, u64) {
        let mut reader = TextReader::new(inner, declared);
        let (mut text, mut piece) = (Vec::new(), vec![0; buffer]);
        loop {
            match reader.read(&mut piece) {
                Ok(0) => return (text, reader.found(), reader.mark_bytes()),
                Ok(count) => text.extend_from_slice(&piece[..count]),
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => {}
                Err(error) => panic!("{error}"),
            }
        }
    }

    fn told_by_itself(bytes: &[u8]) -> (String, Found, u64) {
        let (text, found, mark) = read(bytes, TextEncoding::Auto, 7);
        (String::from_utf8(text).unwrap(), found, mark)
    }

    #[test]
    fn encodings_are_told_by_mark_zeros_and_what_is_no_utf_8() {
        let bom = ["\u{feff}", TEXT].concat();
        let text = TEXT.to_owned();
        assert_eq!(told_by_itself(TEXT.as_bytes()), (text.clone(), Found::Utf8, 0));
        assert_eq!(told_by_itself(bom.as_bytes()), (text.clone(), Found::Utf8, 3));
        assert_eq!(told_by_itself(&utf16(TEXT, false, true)), (text.clone(), Found::Utf16Le, 2));
        assert_eq!(told_by_itself(&utf16(TEXT, true, true)), (text.clone(), Found::Utf16Be, 2));
        assert_eq!(told_by_itself(&utf16(TEXT, false, false)), (text.clone(), Found::Utf16Le, 0));
        assert_eq!(told_by_itself(&utf16(TEXT, true, false)), (text, Found::Utf16Be, 0));
        let narrow = "Zeit;Winkel [°]\n1;ä\n";
        assert_eq!(told_by_itself(&windows(narrow)), (narrow.to_owned(), Found::Windows1252, 0));
        assert_eq!(told_by_itself(b""), (String::new(), Found::Utf8, 0));
    }

    #[test]
    fn text_that_was_utf_8_does_not_become_windows_1252() {
        let bytes = ["ä".as_bytes(), b"\xE4;1\n"].concat();
        assert_eq!(read(&bytes[..], TextEncoding::Auto, 9), (bytes.clone(), Found::Utf8, 0));
        assert_eq!(read(&b"1;\xE4\n"[..], TextEncoding::Utf8, 9).0, b"1;\xE4\n");
    }

    #[test]
    fn what_is_declared_decides_where_there_is_no_mark() {
        let chinese = "时间,位置\n";
        let bytes = utf16(chinese, false, false);
        assert_eq!(read(&bytes[..], TextEncoding::Utf16Le, 5).0, chinese.as_bytes());
        assert_eq!(read(&utf16(chinese, true, true)[..], TextEncoding::Utf16Le, 5).0, chinese.as_bytes());
        assert_eq!(read("ä".as_bytes(), TextEncoding::Windows1252, 5).0, "Ã¤".as_bytes());
        let error = TextReader::new(&b"time,pos\n"[..], TextEncoding::Utf16Le).read(&mut [0; 9]).unwrap_err();
        assert!(error.to_string().contains("one byte per character"), "{error}");
    }

    #[test]
    fn halves_at_the_end_are_not_lost_in_silence() {
        let whole = utf16("1\n2", false, true);
        let (text, ..) = read(&whole[..whole.len() - 1], TextEncoding::Auto, 9);
        assert_eq!(String::from_utf8(text).unwrap(), "1\n\u{fffd}");
        let (text, ..) = read(&"1\nä".as_bytes()[..3], TextEncoding::Auto, 9);
        assert_eq!(text, b"1\n\xC3");
    }

    #[test]
    fn bytes_in_the_file_are_counted_back() {
        for big in [false, true] {
            let bytes = utf16(TEXT, big, false);
            let found = if big { Found::Utf16Be } else { Found::Utf16Le };
            assert_eq!(found.bytes_in_file(TEXT.as_bytes()), bytes.len() as u64);
        }
        assert_eq!(Found::Utf8.bytes_in_file(TEXT.as_bytes()), TEXT.len() as u64);
        assert_eq!(Found::Windows1252.bytes_in_file("°C\n".as_bytes()), 3);
    }

    #[test]
    fn names_what_the_first_bytes_look_like() {
        let name = |head: &[u8]| wide_encoding(head).map(Wide::name);
        assert_eq!(name(&utf16("time", false, false)), Some("UTF-16 (little endian)"));
        assert_eq!(name(&utf16("time", true, false)), Some("UTF-16 (big endian)"));
        assert_eq!(name(b"\xFF\xFEt\0"), Some("UTF-16 (little endian)"));
        assert_eq!(name(b"\xFE\xFF\0t"), Some("UTF-16 (big endian)"));
        assert_eq!(name(b"\xFF\xFE\0\0t\0\0\0"), Some("UTF-32 (little endian)"));
        assert_eq!(name(b"time,pos_1"), None);
        assert_eq!(name(b"\xEF\xBB\xBFtime"), None);
        assert_eq!(narrow_encoding(b"\xB0C"), "Latin-1");
        assert_eq!(narrow_encoding(b"\x80"), "Windows-1252");
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn any_pieces_give_the_same_text(
            pieces in proptest::collection::vec(1_usize..9, 0..60),
            buffer in 1_usize..20,
            kind in 0_usize..6,
            cut in 0_usize..40,
        ) {
            let bytes = match kind {
                0 => TEXT.as_bytes().to_vec(),
                1 => utf16(TEXT, false, true),
                2 => utf16(TEXT, true, false),
                3 => windows("Zeit;Winkel [°]\n1;ä€\n"),
                4 => ["\u{feff}", TEXT].concat().into_bytes(),
                _ => [TEXT.as_bytes(), b"\xFF;\xE4\n"].concat(),
            };
            let bytes = &bytes[..bytes.len().saturating_sub(cut)];
            let whole = read(bytes, TextEncoding::Auto, 1 << 12);
            prop_assert_eq!(read(GrowingBytes(bytes, pieces, false), TextEncoding::Auto, buffer), whole);
        }
    }
}
