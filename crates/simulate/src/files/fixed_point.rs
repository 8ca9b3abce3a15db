//! Numbers with a fixed count of decimals, several times faster than `format!` and equal to it.

use std::io::Write;

/// Scaled values below this are exact to 1e-7, so that only a near tie can be rounded wrongly.
const FAST_LIMIT: f64 = 1e9;
/// Distance from a tie below which the slow way decides; ten times the error of the scaled value.
const TIE_MARGIN: f64 = 1e-6;
/// Most decimals that the fast way writes.
const DECIMALS_MAX: usize = 9;

/// Appends `value` with `decimals` decimals, byte for byte as `format!("{value:.decimals$}")`.
pub fn push_fixed(line: &mut Vec<u8>, value: f64, decimals: usize) {
    const SCALE: [f64; DECIMALS_MAX + 1] = [1.0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9];
    let scaled = SCALE.get(decimals).map_or(f64::INFINITY, |scale| value.abs() * scale);
    let whole = scaled.floor();
    let tie = (scaled - whole - 0.5).abs();
    // Written so that NaN and infinity go the slow way, too.
    if !(scaled < FAST_LIMIT && tie > TIE_MARGIN) {
        // Writing to memory does not fail.
        let _ = write!(line, "{value:.decimals$}");
        return;
    }
    if value.is_sign_negative() {
        line.push(b'-');
    }
    let rounded = if scaled - whole > 0.5 { whole as u32 + 1 } else { whole as u32 };
    push_digits(line, rounded, decimals);
}

/// Appends a whole number.
pub fn push_whole(line: &mut Vec<u8>, value: u32) {
    push_digits(line, value, 0);
}

/// Digits of `scaled` with a point before the last `decimals`, at least one before it.
fn push_digits(line: &mut Vec<u8>, mut scaled: u32, decimals: usize) {
    // Ten digits of a u32, a leading zero and the point.
    let mut digits = [0_u8; 12];
    let mut start = digits.len();
    let mut written = 0;
    while scaled > 0 || written <= decimals {
        if written == decimals && decimals > 0 {
            start -= 1;
            digits[start] = b'.';
        }
        start -= 1;
        digits[start] = b'0' + (scaled % 10) as u8;
        scaled /= 10;
        written += 1;
    }
    line.extend_from_slice(&digits[start..]);
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn fixed(value: f64, decimals: usize) -> String {
        let mut line = Vec::new();
        push_fixed(&mut line, value, decimals);
        String::from_utf8(line).unwrap()
    }

    #[test]
    fn edges_equal_format() {
        for value in [
            0.0,
            -0.0,
            0.5,
            1.5,
            2.5,
            -0.5,
            0.05,
            0.00005,
            -0.00004,
            0.99999,
            9.99995,
            1e-12,
            123_456.789,
            1e9,
            4.2e9,
            -1e12,
            1e300,
            f64::NAN,
            f64::INFINITY,
            f64::NEG_INFINITY,
            0.000_000_5,
            429_496.729_6,
        ] {
            for decimals in 0..12 {
                assert_eq!(fixed(value, decimals), format!("{value:.decimals$}"));
            }
        }
    }

    #[test]
    fn whole_numbers() {
        for value in [0, 7, 10, 24, u32::MAX] {
            let mut line = Vec::new();
            push_whole(&mut line, value);
            assert_eq!(String::from_utf8(line).unwrap(), value.to_string());
        }
    }

    proptest! {
        #[test]
        fn any_number_equals_format(value in -2000.0..2000.0_f64, decimals in 0_usize..7) {
            prop_assert_eq!(fixed(value, decimals), format!("{value:.decimals$}"));
        }

        #[test]
        fn ties_and_their_neighbours_equal_format(half in -4_000_000_i64..4_000_000, decimals in 0_usize..7) {
            let tie = (half as f64 + 0.5) / 10_f64.powi(decimals as i32);
            for value in [tie, tie.next_up(), tie.next_down()] {
                prop_assert_eq!(fixed(value, decimals), format!("{value:.decimals$}"));
            }
        }
    }
}
