//! Numbers as text, several bytes at once.
//!
//! Up to fifteen digits make a whole number that a double represents exactly, and so is ten to the power of their
//! decimals: one division rounds once, which gives the nearest double (Clinger 1990, How to read floating point numbers
//! accurately). The standard library reads longer numbers, and also gives the nearest double.

use std::num::NonZeroUsize;

/// Bytes of a word.
const WORD: usize = 8;

/// Most bytes of a number.
const LONGEST: usize = 64;

/// Ten to the power of the decimals of two words.
const POWERS: [f64; 2 * WORD] =
    [1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15];

/// All powers of ten that a double represents exactly.
const EXACT_POWERS: [f64; 23] = [
    1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15, 1e16, 1e17, 1e18,
    1e19, 1e20, 1e21, 1e22,
];

/// Digits with a decimal mark or without, and a minus or no sign.
struct Digits {
    negative: bool,
    /// All digits as a whole number, at most fifteen of them.
    whole: u64,
    /// Digits after the decimal mark.
    decimals: usize,
    /// Their end.
    end: usize,
}

impl Digits {
    /// Reads the digits that begin at `start`; `None` for anything else, and for more than fifteen.
    #[inline(always)]
    fn at(text: &[u8], start: usize, point: u8) -> Option<Self> {
        let negative = *text.get(start)? == b'-';
        let digits = start + usize::from(negative);
        let bytes = text.get(digits..digits + 2 * WORD)?;
        let (low, high) = bytes.split_at(WORD);
        let (low, high) = (word(low) ^ repeated(b'0'), word(high) ^ repeated(b'0'));
        let others = [non_digits(low), non_digits(high)];
        if others[0] == 0 {
            return None;
        }
        let first = place(others[0]);
        let (end, joined) = if bytes[first] == point {
            let behind = others[0] & (others[0] - 1);
            let end = if behind == 0 { WORD + place(others[1]) } else { place(behind) };
            // digits after the mark move into its place
            let before = (1_u64 << (8 * first)) - 1;
            (end, (low & before) | (((low >> 8) | (high << 56)) & !before))
        } else {
            (first, low)
        };
        let with_point = usize::from(end > first);
        let count = end - with_point;
        let whole = match count {
            1..=WORD => eight_digits(joined << (8 * (WORD - count))),
            // no more than fifteen, because otherwise the line would not end within the words
            9.. if others[1] != 0 => {
                let rest = (high >> 8) << (8 * (2 * WORD - count));
                eight_digits(joined) * POWERS[count - WORD] as u64 + eight_digits(rest)
            }
            _ => return None,
        };
        Some(Self { negative, whole, decimals: end - first - with_point, end: digits + end })
    }

    /// The number `size` with the sign. Signs of noise are unpredictable, so this uses no branch.
    #[inline(always)]
    fn signed(&self, size: f64) -> f64 {
        f64::from_bits(size.to_bits() | (u64::from(self.negative) << (u64::BITS - 1)))
    }

    /// Fifteen digits fit a signed number too, which takes one instruction to convert.
    #[inline(always)]
    fn whole(&self) -> f64 {
        self.whole.cast_signed() as f64
    }
}

/// The number that begins at `start`: digits with or without a decimal mark `point`, and a minus or no sign. Also
/// returns its end; `None` for anything else. The text after it is not checked, but must exist: text ends with a line
/// end.
///
/// The end is not zero, so that the processor returns all of it in registers: the next number waits for the end of this
/// one.
#[inline(always)]
pub(super) fn number_at(text: &[u8], start: usize, point: u8) -> Option<(f64, NonZeroUsize)> {
    match Digits::at(text, start, point) {
        Some(digits) => {
            let size = digits.whole() / POWERS[digits.decimals];
            Some((digits.signed(size), NonZeroUsize::new(digits.end)?))
        }
        None => long_number_at(text, start, point),
    }
}

/// Like [`number_at`], for a number with an exponent after `e`, `E`, `d` or `D`.
#[inline]
pub(super) fn exponent_number_at(text: &[u8], start: usize, point: u8) -> Option<(f64, NonZeroUsize)> {
    let Some(digits) = Digits::at(text, start, point) else {
        return long_exponent_number_at(text, start, point);
    };
    if !is_exponent_sign(*text.get(digits.end)?) {
        return None;
    }
    let (exponent, end) = exponent_at(text, digits.end + 1)?;
    let scale = exponent - digits.decimals as i32;
    let power = EXACT_POWERS.get(scale.unsigned_abs() as usize);
    let size = match (power, scale < 0) {
        (Some(power), false) => digits.whole() * power,
        (Some(power), true) => digits.whole() / power,
        (None, _) => return long_exponent_number_at(text, start, point),
    };
    Some((digits.signed(size), NonZeroUsize::new(end)?))
}

fn is_exponent_sign(byte: u8) -> bool {
    matches!(byte, b'e' | b'E' | b'd' | b'D')
}

/// An exponent of at most three digits, with or without a sign, and its end.
fn exponent_at(text: &[u8], start: usize) -> Option<(i32, usize)> {
    let sign = *text.get(start)?;
    let first = start + usize::from(matches!(sign, b'-' | b'+'));
    let digits = text.get(first..)?.iter().take(4).take_while(|byte| byte.is_ascii_digit());
    let (size, count) =
        digits.fold((0, 0), |(size, count), byte| (size * 10 + i32::from(byte - b'0'), count + 1));
    (1..=3).contains(&count).then_some((if sign == b'-' { -size } else { size }, first + count))
}

#[inline(always)]
fn word(bytes: &[u8]) -> u64 {
    u64::from_le_bytes(bytes.try_into().unwrap_or_default())
}

#[inline(always)]
const fn repeated(byte: u8) -> u64 {
    u64::from_le_bytes([byte; WORD])
}

/// The high bit of each byte that is not a digit, of a word from whose bytes `0` was subtracted.
#[inline(always)]
fn non_digits(word: u64) -> u64 {
    (((word & repeated(0x7f)) + repeated(0x76)) | word) & repeated(0x80)
}

/// The byte of the lowest bit; [`WORD`] if there is none.
#[inline(always)]
fn place(of: u64) -> usize {
    (of.trailing_zeros() / 8) as usize
}

/// The number of eight digits, 0 to 9 each, the first in the lowest byte: pairs, then fours, then all.
#[inline(always)]
fn eight_digits(digits: u64) -> u64 {
    let pairs = digits.wrapping_mul(10).wrapping_add(digits >> 8);
    let every_other = 0x0000_00ff_0000_00ff;
    let upper = (pairs & every_other).wrapping_mul(100 + (1_000_000 << 32));
    let lower = ((pairs >> 16) & every_other).wrapping_mul(1 + (10_000 << 32));
    upper.wrapping_add(lower) >> 32
}

#[cold]
#[inline(never)]
fn long_number_at(text: &[u8], start: usize, point: u8) -> Option<(f64, NonZeroUsize)> {
    let digits = start + usize::from(text.get(start) == Some(&b'-'));
    parsed(text, start, mantissa_end(text, digits, point)?, point)
}

fn long_exponent_number_at(text: &[u8], start: usize, point: u8) -> Option<(f64, NonZeroUsize)> {
    let digits = start + usize::from(text.get(start) == Some(&b'-'));
    let end = mantissa_end(text, digits, point)?;
    if !is_exponent_sign(*text.get(end)?) {
        return None;
    }
    parsed(text, start, exponent_at(text, end + 1)?.1, point)
}

/// End of digits with at most one decimal mark.
fn mantissa_end(text: &[u8], start: usize, point: u8) -> Option<usize> {
    let is_part = |byte: &&u8| byte.is_ascii_digit() || **byte == point;
    let part = text.get(start..)?.iter().take(LONGEST).take_while(is_part);
    let (length, points) =
        part.fold((0, 0), |(length, points), byte| (length + 1, points + usize::from(*byte == point)));
    (length > points && points <= 1 && length < LONGEST).then_some(start + length)
}

/// The number between two positions, by the standard library.
fn parsed(text: &[u8], start: usize, end: usize, point: u8) -> Option<(f64, NonZeroUsize)> {
    let text = text.get(start..end)?;
    if point == b'.' && !text.iter().any(|byte| matches!(byte, b'd' | b'D')) {
        return Some((std::str::from_utf8(text).ok()?.parse().ok()?, NonZeroUsize::new(end)?));
    }
    let mut written = [0; LONGEST + 8];
    let written = written.get_mut(..end - start)?;
    written.copy_from_slice(text);
    for byte in written.iter_mut() {
        match *byte {
            b'd' | b'D' => *byte = b'e',
            mark if mark == point => *byte = b'.',
            _ => {}
        }
    }
    Some((std::str::from_utf8(written).ok()?.parse().ok()?, NonZeroUsize::new(end)?))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// The number by another method: fast-float2, which polars uses.
    fn expected(cell: &str) -> Option<f64> {
        let digits = cell.strip_prefix('-').unwrap_or(cell);
        let plain =
            digits.bytes().all(|byte| byte.is_ascii_digit() || byte == b'.') && digits.len() < LONGEST;
        (plain && digits.bytes().any(|byte| byte.is_ascii_digit()))
            .then(|| fast_float2::parse::<f64, _>(cell).ok())
            .flatten()
    }

    fn assert_number(cell: &str) {
        for (behind, before) in [(",", ""), ("\n", ",1."), ("\r\n", "9"), (",123456789012345678\n", "")] {
            for point in [b'.', b','] {
                if point == b',' && behind.starts_with(',') {
                    continue;
                }
                let written = if point == b',' { cell.replace('.', ",") } else { cell.to_owned() };
                let text = format!("{before}{written}{behind}");
                let found = number_at(text.as_bytes(), before.len(), point);
                let found = found.map(|(number, end)| (number, end.get()));
                // a text that is not a number may be one with text after it, which its reader refuses
                let whole =
                    found.filter(|(_, end)| *end == before.len() + cell.len()).map(|(number, _)| number);
                assert_eq!(whole.map(f64::to_bits), expected(cell).map(f64::to_bits), "{text:?}");
            }
        }
    }

    /// Checks exponents by another method: the standard library.
    fn assert_exponent(cell: &str) {
        let plain = cell.replace(['d', 'D'], "e");
        let expected = plain.contains(['e', 'E']).then(|| plain.parse::<f64>().ok()).flatten();
        for (behind, before) in [(",", ""), ("\n", ",1."), (",123456789012345678\n", "")] {
            for point in [b'.', b','] {
                if point == b',' && behind.starts_with(',') {
                    continue;
                }
                let written = if point == b',' { cell.replace('.', ",") } else { cell.to_owned() };
                let text = format!("{before}{written}{behind}");
                let found = exponent_number_at(text.as_bytes(), before.len(), point);
                let whole = found.filter(|(_, end)| end.get() == before.len() + cell.len());
                assert_eq!(whole.map(|(number, _)| number.to_bits()), expected.map(f64::to_bits), "{text:?}");
            }
        }
    }

    #[test]
    fn exponents_of_any_writer() {
        for cell in [
            "1e5",
            "-1.5E+05",
            "1.5D+03",
            "1.5d-3",
            "-0e0",
            "1.e2",
            ".5e1",
            "7e-22",
            "7e22",
            "7e23",
            "7e-23",
            "123456789012345e22",
            "1.000000000000000000e+00",
            "-9.999999999999999999E-01",
            "1e308",
            "1e309",
            "4.9e-324",
            "1e-400",
            "9007199254740993e0",
            "1e",
            "1e+",
            "e5",
            ".e5",
            "1.5",
            "1e5.5",
            "--1e5",
        ] {
            assert_exponent(cell);
        }
    }

    #[test]
    fn corners() {
        for cell in [
            "0",
            "-0",
            "0.0",
            "-0.000000",
            "7",
            "-7.",
            ".5",
            "-.5",
            ".",
            "-",
            "",
            "--1",
            "1-",
            "+1",
            "1e5",
            "1.2.3",
            "9007199254740992",
            "9007199254740993",
            "900719925474099.3",
            "-123456789012345",
            "1234567890123456",
            "12345678901234567890",
            "0.1234567890123456789",
            "0.000000000000000000000000000001",
            "99999999.99999999",
            "00000000000000000001.5",
            "1 ",
            " 1",
            "nan",
            "inf",
            "1:2",
            "1/2",
            "\u{b9}",
            "3.141592653589793",
        ] {
            assert_number(cell);
        }
        assert_eq!(number_at(b"5", 0, b'.'), NonZeroUsize::new(1).map(|end| (5.0, end)));
        assert_eq!(number_at(b"", 0, b'.'), None);
        assert_eq!(number_at(&[b'1'; 80], 0, b'.'), None);
    }

    #[test]
    fn all_short_decimals_of_an_encoder() {
        for k in -120_000..120_000 {
            let number = f64::from(k);
            assert_number(&format!("{:.4}", number * 1e-4));
            assert_number(&format!("{:.6}", number * 7.3e-5));
        }
    }

    proptest! {
        #[test]
        fn the_bits_of_fast_float(cell in "-?[0-9]{0,22}(\\.[0-9]{0,22})?") {
            assert_number(&cell);
        }

        #[test]
        fn the_bits_of_the_shortest_text(number in any::<f64>(), decimals in 0..20_usize) {
            assert_number(&format!("{:.decimals$}", number % 1e6));
            assert_number(&format!("{}", number % 1e6));
        }

        #[test]
        fn the_bits_of_exponents(number in any::<f64>(), decimals in 0..20_usize, power in -30..30_i32) {
            assert_exponent(&format!("{number:.decimals$e}"));
            assert_exponent(&format!("{:.decimals$e}", number % 1e3));
            assert_exponent(&format!("{:.decimals$}e{power:+03}", number % 1e3));
        }

        #[test]
        fn no_text_is_taken_for_a_number(cell in "[-+.0-9eE, \"a\u{e4}]{0,20}") {
            if !cell.contains(',') {
                assert_number(&cell);
            }
        }
    }
}
