//! Torque in steps: whole newton metres, whole per cent or permille of the rated torque.

use super::view::{ChannelView, finding};
use armwatch_model::analysis::finding::{Finding, FindingKind, FindingSeverity};

/// Largest number of values of a coarse channel; with more, its step is far below the error of a model.
const MOST_VALUES: usize = 400;
/// Smallest number of values: two may be a contact that opens and closes.
const FEWEST_VALUES: usize = 3;
/// Number of rows for counting values.
const ROWS: usize = 20_000;
/// Distance of values from multiples of the smallest difference, relative to it, that is allowed for decimals of a
/// conversion.
const OFF_GRID: f64 = 0.05;
/// Smallest step, relative to the RMS of the torque, that is reported.
const TOLD: f64 = 0.02;

/// Step of a torque channel, Nm (N), if it has few values and all are multiples of one step.
pub(super) fn step(torque: impl Iterator<Item = f64>) -> Option<f64> {
    let mut values: Vec<f64> = Vec::new();
    for value in torque {
        // a zero of either sign is one value
        let value = value + 0.0;
        if let Err(place) = values.binary_search_by(|of| of.total_cmp(&value)) {
            values.insert(place, value);
        }
        if values.len() > MOST_VALUES {
            return None;
        }
    }
    let step = values.array_windows().map(|[a, b]| b - a).fold(f64::INFINITY, f64::min);
    let on_grid = |[a, b]: &[f64; 2]| {
        let steps = (b - a) / step;
        (steps - steps.round()).abs() <= OFF_GRID * steps.max(1.0)
    };
    (values.len() >= FEWEST_VALUES && values.array_windows().all(on_grid)).then_some(step)
}

/// Stride of the rows for counting a channel's values.
pub(super) fn counted(rows: usize) -> usize {
    rows.div_ceil(ROWS).max(1)
}

/// Findings of torques whose step is large relative to their RMS.
pub(super) fn torque_steps(view: &ChannelView<'_>) -> Vec<Finding> {
    let of_joint = |(joint, step): (armwatch_model::robot::JointIndex, &Option<f64>)| {
        let step = (*step)?;
        let torque = &view.samples.torque[joint.index()];
        let squares: f64 = view.excitation.iter().map(|&row| torque[row] * torque[row]).sum();
        let rms = (squares / view.excitation.len().max(1) as f64).sqrt();
        (rms > 0.0 && step > TOLD * rms).then(|| {
            finding(
                FindingKind::CoarseTorque,
                FindingSeverity::Warn,
                Some(joint),
                format!(
                    "joint {joint}: the torque is recorded in steps of {step:.4} Nm (N), {:.0} % of its root mean square; \
                     smaller changes are not seen: record it with more digits if the controller can",
                    100.0 * step / rms
                ),
                &[("step_nm", step), ("rms_nm", rms)],
            )
        })
    };
    view.robot.joint_indices().zip(&view.torque_steps).filter_map(of_joint).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_are_found_in_whole_values_and_not_in_measured_ones() {
        let sine =
            |step: f64| (0..2000).map(move |i| step * (40.0 * (0.01 * f64::from(i)).sin() / step).round());
        for expected in [0.5, 1.0, 5.0] {
            let found = step(sine(expected)).expect("steps");
            assert!((found - expected).abs() < 1e-9, "{found}");
        }
        assert_eq!(step([-1.0, -0.0, 0.0, 1.0].into_iter()), Some(1.0));
        assert_eq!(step(sine(1e-3)), None);
        assert_eq!(step([1.0, 1.0].into_iter()), None);
        assert_eq!(step([0.0, 1.0, 2.4, 7.9].into_iter()), None);
    }
}
