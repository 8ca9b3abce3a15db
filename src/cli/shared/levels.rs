//! Speed levels of the friction stage as arguments.

use std::str::FromStr;

/// Levels from 1, such as `2,4,6`; `none` is an empty list.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(in crate::cli) struct Levels(pub(in crate::cli) Vec<u8>);

impl FromStr for Levels {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        if text.trim() == "none" {
            return Ok(Self(Vec::new()));
        }
        let level = |cell: &str| cell.trim().parse::<u8>().ok().filter(|level| *level > 0);
        let levels: Option<Vec<u8>> = text.split(',').map(level).collect();
        levels
            .map(Self)
            .ok_or_else(|| "takes numbers of speed levels from 1, such as 2,4,6, or none".to_owned())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn levels_are_numbers_or_none() {
        assert_eq!("2, 4,6".parse(), Ok(Levels(vec![2, 4, 6])));
        assert_eq!("none".parse(), Ok(Levels(vec![])));
        for wrong in ["", "0", "1-3", "a", "300"] {
            assert!(wrong.parse::<Levels>().is_err(), "{wrong}");
        }
    }
}
