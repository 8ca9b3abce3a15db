//! Values of slower channels in the rows without one.

use armwatch_model::robot::JointIndex;
use armwatch_model::run::Samples;
use armwatch_model::run::slower::{Slower, SlowerChannels};

/// Gives each row of slower channels a value. Before the first value and, if resampled, after the last one, the nearest
/// value is used.
///
/// # Errors
/// The quantity and the joint of a channel without any value.
pub fn fill_slower(slower: SlowerChannels, samples: &mut Samples) -> Result<(), (&'static str, JointIndex)> {
    let Samples { time, torque, velocity, .. } = samples;
    let velocity = velocity.as_deref_mut().unwrap_or_default();
    for (how, name, channels) in
        [(slower.torque, "torque", &mut torque[..]), (slower.velocity, "velocity", velocity)]
    {
        let Some(how) = how else { continue };
        for (joint, channel) in channels.iter_mut().enumerate() {
            fill(how, time, channel).ok_or((name, JointIndex::new(joint)))?;
        }
    }
    Ok(())
}

/// Fills the rows of one channel; `None` if no row has a value.
fn fill(how: Slower, time: &[f64], values: &mut [f64]) -> Option<()> {
    if values.is_empty() {
        return Some(());
    }
    let mut before: Option<usize> = None;
    for row in 0..values.len() {
        if values[row].is_nan() {
            continue;
        }
        let from = before.map_or(0, |before| before + 1);
        let (value, start) = (values[row], before.map_or(values[row], |before| values[before]));
        let first = before.unwrap_or(row);
        for empty in from..row {
            let share = (time[empty] - time[first]) / (time[row] - time[first]);
            values[empty] = match how {
                Slower::Resample if first < row => start + share * (value - start),
                _ => start,
            };
        }
        before = Some(row);
    }
    let last = before?;
    let value = values[last];
    values[last + 1..].fill(value);
    Some(())
}

#[cfg(test)]
mod tests {
    use super::*;

    const NONE: f64 = f64::NAN;

    fn filled(how: Slower, values: &[f64]) -> Option<Vec<f64>> {
        // uneven steps
        let time: Vec<f64> = (0..values.len()).map(|row| (row * row) as f64).collect();
        let mut values = values.to_vec();
        fill(how, &time, &mut values).map(|()| values)
    }

    #[test]
    fn rows_without_a_value_take_the_last_one_or_lie_on_the_line_between() {
        let values = [NONE, 2.0, NONE, NONE, 10.0, NONE, 4.0, NONE];
        assert_eq!(filled(Slower::Hold, &values).unwrap(), [2.0, 2.0, 2.0, 2.0, 10.0, 10.0, 4.0, 4.0]);
        let line = filled(Slower::Resample, &values).unwrap();
        // times are 1, 4, 9 and 16
        let expected = [
            2.0,
            2.0,
            2.0 + 8.0 * 3.0 / 15.0,
            2.0 + 8.0 * 8.0 / 15.0,
            10.0,
            10.0 - 6.0 * 9.0 / 20.0,
            4.0,
            4.0,
        ];
        assert!(line.iter().zip(expected).all(|(found, wanted)| (found - wanted).abs() < 1e-12), "{line:?}");
        assert_eq!(filled(Slower::Hold, &[NONE, NONE]), None);
        assert_eq!(filled(Slower::Resample, &[]), Some(vec![]));
        let whole = [1.0, -3.0, 0.5];
        assert_eq!(filled(Slower::Resample, &whole).unwrap(), whole);
    }
}
