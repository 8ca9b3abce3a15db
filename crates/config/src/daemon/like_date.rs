//! File names that contain something like a date and match no pattern.

/// Digits in a row that may be a mistyped date.
const DIGITS_OF_A_DATE: usize = 7;

/// Least count of consecutive two-digit numbers that form a date with a time: 26_01_05_08_47.
const PARTS_OF_A_MOMENT: usize = 5;

const MONTHS: [&str; 12] =
    ["jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec"];

/// True if a name without endings contains something like a date.
pub(super) fn has_date_like(stem: &str) -> bool {
    let numbers = numbers(stem);
    numbers.iter().any(|(digits, _)| digits.len() >= DIGITS_OF_A_DATE)
        || numbers.windows(3).any(is_date)
        || longest_of_pairs(&numbers) >= PARTS_OF_A_MOMENT
        || numbers.windows(2).any(|pair| {
            let month = pair[0].1.trim_matches(['-', '.', '_', ' ']).to_ascii_lowercase();
            MONTHS.iter().any(|name| month.starts_with(name) && month.len() <= 9)
                && pair.iter().any(|of| is_year(of.0))
        })
}

/// Numbers of a name, each with the text after it.
fn numbers(stem: &str) -> Vec<(&str, &str)> {
    let mut found = Vec::new();
    let mut rest = stem;
    while let Some(at) = rest.find(|c: char| c.is_ascii_digit()) {
        rest = &rest[at..];
        let end = rest.find(|c: char| !c.is_ascii_digit()).unwrap_or(rest.len());
        let (digits, behind) = rest.split_at(end);
        let next = behind.find(|c: char| c.is_ascii_digit()).unwrap_or(behind.len());
        found.push((digits, &behind[..next]));
        rest = &behind[next..];
    }
    found
}

/// Year, month and day in some order, separated by the same character.
fn is_date(three: &[(&str, &str)]) -> bool {
    let [(a, first), (b, second), (c, _)] = three else { return false };
    let is_part =
        |digits: &str| digits.len() <= 2 && digits.parse::<u8>().is_ok_and(|part| (1..=31).contains(&part));
    let is_parted = first == second && ["-", ".", "_", " "].contains(first);
    is_parted && is_part(b) && ((is_year(a) && is_part(c)) || (is_part(a) && is_year(c)))
}

fn is_year(digits: &str) -> bool {
    digits.len() == 4 && digits.parse::<u16>().is_ok_and(|year| (1970..2200).contains(&year))
}

/// Longest sequence of two-digit numbers that single characters separate.
fn longest_of_pairs(numbers: &[(&str, &str)]) -> usize {
    let (mut longest, mut row) = (0, 0);
    for (digits, behind) in numbers {
        row = if digits.len() == 2 { row + 1 } else { 0 };
        longest = longest.max(row);
        if behind.chars().count() != 1 || behind.chars().any(char::is_alphabetic) {
            row = 0;
        }
    }
    longest
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_with_dates_are_told_from_names_with_numbers() {
        for stem in [
            "KR7-01.03.2026 08-00",
            "R01-2026-01-05",
            "R01_2026_1_5",
            "R01 5.1.2026",
            "R01_26_01_05_08_47",
            "R01 05Jan2026",
            "R01-5-march-2026",
            "R00_2026015_0847",
        ] {
            assert!(has_date_like(stem), "{stem}");
        }
        for stem in [
            "R01",
            "cell_4_left",
            "er3a-0815",
            "line 1-2-3",
            "10.20.12.30",
            "KR-120-2700",
            "cell 12 robot 2026",
            "R-2-17",
        ] {
            assert!(!has_date_like(stem), "{stem}");
        }
    }
}
