//! Assigns values of a stage signal to stages, by the motion of the joints during them.

use std::collections::BTreeMap;

/// Most different values of a column that may be a stage signal.
const MOST_VALUES: usize = 32;

/// Share of its largest speed below which a joint is at rest.
const AT_REST: f64 = 0.01;

/// Largest mean number of moving joints, over rows with motion, of a stage with joints moving one by one.
const ONE_BY_ONE: f64 = 1.3;

/// Least mean number of moving joints of a stage with joints moving together.
const TOGETHER: f64 = 1.8;

/// A whole number and the rows with it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct StageValue {
    pub(super) value: i64,
    pub(super) rows: usize,
    /// Rows with any joint moving.
    pub(super) moved: usize,
    /// Mean number of moving joints over these rows.
    pub(super) moving: f64,
}

/// Assignment of values to stages.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub(super) struct Meaning {
    pub(super) between: Vec<i64>,
    pub(super) excitation: Vec<i64>,
    pub(super) friction: Vec<i64>,
    pub(super) warming: Vec<i64>,
}

/// The values of a column of few whole numbers, in the order of their first appearance; `None` for any other column.
pub(super) fn alphabet(values: &[f64]) -> Option<Vec<i64>> {
    let mut found: Vec<i64> = Vec::new();
    let mut last = f64::NAN;
    for value in values {
        if *value == last {
            continue;
        }
        last = *value;
        if value.fract() != 0.0 || value.abs() > 1e6 {
            return None;
        }
        if !found.contains(&(*value as i64)) {
            found.push(*value as i64);
        }
        if found.len() > MOST_VALUES {
            return None;
        }
    }
    (!found.is_empty()).then_some(found)
}

/// Motion of the joints for each value; `speeds` `[n][rows]` in any unit.
pub(super) fn values(signal: &[f64], alphabet: &[i64], speeds: &[Vec<f64>]) -> Vec<StageValue> {
    let limits: Vec<f64> = speeds.iter().map(|speed| AT_REST * super::units::largest(speed)).collect();
    let mut counts: BTreeMap<i64, (usize, usize, usize)> = BTreeMap::new();
    for (row, value) in signal.iter().enumerate() {
        let moving = (speeds.iter().zip(&limits))
            .filter(|(speed, limit)| speed.get(row).is_some_and(|speed| speed.abs() > **limit))
            .count();
        let (rows, moved, sum) = counts.entry(*value as i64).or_default();
        *rows += 1;
        *moved += usize::from(moving > 0);
        *sum += moving;
    }
    let mean = |value: &i64| {
        let (rows, moved, sum) = counts.get(value).copied().unwrap_or_default();
        let moving = if moved > 0 { sum as f64 / moved as f64 } else { 0.0 };
        StageValue { value: *value, rows, moved, moving }
    };
    alphabet.iter().map(mean).collect()
}

/// The assignment for the native layout's values, 0 to 3.
pub(super) fn native(alphabet: &[i64]) -> Option<Meaning> {
    alphabet.iter().all(|value| (0..=3).contains(value)).then(|| Meaning {
        between: vec![0],
        excitation: vec![1],
        friction: vec![2],
        warming: vec![3],
    })
}

/// The assignment by motion: one joint after the other is friction, all together are excitation and, after it, warming;
/// no motion, or only moves, is between. `None` if no value has joints moving together.
pub(super) fn by_motion(values: &[StageValue]) -> Option<Meaning> {
    let mut meaning = Meaning::default();
    for value in values {
        let list = if value.value == 0 || value.moving == 0.0 {
            &mut meaning.between
        } else if value.moving <= ONE_BY_ONE {
            &mut meaning.friction
        } else if value.moving < TOGETHER {
            &mut meaning.between
        } else if meaning.excitation.is_empty() {
            &mut meaning.excitation
        } else if meaning.warming.is_empty() {
            &mut meaning.warming
        } else {
            &mut meaning.between
        };
        list.push(value.value);
    }
    (!meaning.excitation.is_empty()).then_some(meaning)
}

/// Largest share of the rows between stages with motion, for the motion to confirm a signal.
const MOVES_BETWEEN: f64 = 0.3;

/// Returns true if the joints move as the stages require: together in excitation and differently in at least one other
/// stage. This excludes signals such as a gripper's state.
pub(super) fn is_confirmed(meaning: &Meaning, values: &[StageValue]) -> bool {
    let of = |list: &[i64]| -> Vec<StageValue> {
        values.iter().copied().filter(|v| list.contains(&v.value)).collect()
    };
    let excitation = of(&meaning.excitation);
    let friction = of(&meaning.friction);
    let between = of(&meaning.between);
    let rests = |value: &StageValue| (value.moved as f64) < MOVES_BETWEEN * value.rows as f64;
    !excitation.is_empty()
        && excitation.iter().all(|value| value.moving >= TOGETHER)
        && friction.iter().all(|value| value.moving > 0.0 && value.moving <= ONE_BY_ONE)
        && (!friction.is_empty() || (!between.is_empty() && between.iter().all(rests)))
}

/// Beginnings of words for each stage, in lower case: between, excitation, friction, warming.
const WORDS: [&str; 4] = [
    "idle between pause rest wait home stop none leer warten ruhe halt start end ende fine pausa attesa move transfer",
    "exc anreg eccit ident",
    "fric reib attrit frott fricc",
    "warm heat aufw erwärm riscald chauff calent",
];

/// The stage of a word, from 0 as in [`WORDS`]; an empty cell is between.
pub(super) fn stage_of(word: &str) -> Option<usize> {
    let word = word.to_lowercase();
    if word.is_empty() {
        return Some(0);
    }
    WORDS.iter().position(|list| list.split_ascii_whitespace().any(|beginning| word.starts_with(beginning)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn few_whole_numbers_are_an_alphabet() {
        assert_eq!(alphabet(&[0.0, 0.0, 2.0, 1.0, 2.0]), Some(vec![0, 2, 1]));
        assert_eq!(alphabet(&[0.0, 0.5]), None);
        let many: Vec<f64> = (0..100).map(f64::from).collect();
        assert_eq!(alphabet(&many), None);
    }

    #[test]
    fn motion_tells_friction_from_the_others() {
        // 7: nothing, 10: both joints, 20: one after the other, 30: both again
        let signal: Vec<f64> = [7.0, 10.0, 20.0, 20.0, 30.0].iter().flat_map(|v| [*v; 10]).collect();
        let first: Vec<f64> = [0.0, 1.0, 1.0, 0.0, 1.0].iter().flat_map(|v| [*v; 10]).collect();
        let second: Vec<f64> = [0.0, 1.0, 0.0, 1.0, 1.0].iter().flat_map(|v| [*v; 10]).collect();
        let found = values(&signal, &alphabet(&signal).unwrap(), &[first, second]);
        let meaning = by_motion(&found).unwrap();
        let lists = (meaning.between, meaning.excitation, meaning.friction, meaning.warming);
        assert_eq!(lists, (vec![7], vec![10], vec![20], vec![30]));
    }
}
