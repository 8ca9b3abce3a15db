//! Correction of channels that are recorded later than the positions.

use super::time_grid::median_step;
use armwatch_model::run::Samples;
use armwatch_model::run::channel_delays::ChannelDelays;

/// Largest step, in median steps, that is interpolated; a longer one is a gap.
const GAP_STEPS: f64 = 3.0;

/// Applies `delays`: moves the late channels of `samples` to the times of their rows. The value at `t` is the one
/// recorded at `t` plus the delay, by the cubic through the four neighbouring rows at their true times. If the delay
/// reaches beyond an end or a gap, the last value before it is used.
pub fn take_delays(delays: &ChannelDelays, samples: &mut Samples) {
    if delays.is_none() {
        return;
    }
    let Some(step) = median_step(&samples.time) else { return };
    let time = &samples.time;
    let shift = |channels: &mut Vec<Vec<f64>>, delays: &[f64]| {
        for (channel, delay) in channels.iter_mut().zip(delays).filter(|(_, delay)| **delay != 0.0) {
            *channel = shifted(time, channel, *delay, GAP_STEPS * step);
        }
    };
    shift(&mut samples.torque, &delays.torque);
    if let Some(velocity) = &mut samples.velocity {
        shift(velocity, &delays.velocity);
    }
}

/// Returns the values at the times `time + delay`.
fn shifted(time: &[f64], values: &[f64], delay: f64, gap: f64) -> Vec<f64> {
    let last = time.len().saturating_sub(1);
    let mut at = 0;
    let mut out = Vec::with_capacity(values.len());
    for (row, now) in time.iter().enumerate() {
        let wanted = now + delay;
        while at < last && time[at + 1] <= wanted {
            at += 1;
        }
        while at > 0 && time[at] > wanted {
            at -= 1;
        }
        // only within the stretch of this row: values beyond a gap belong to another motion
        let joined = |from: usize, to: usize| (from..to).all(|k| time[k + 1] - time[k] <= gap);
        let reached = match at >= row {
            true => (row..at).find(|&k| time[k + 1] - time[k] > gap).unwrap_or(at),
            false => (at..row).rev().find(|&k| time[k + 1] - time[k] > gap).map_or(at, |k| k + 1),
        };
        out.push(match reached == at && at < last && wanted >= time[at] && joined(at, at + 1) {
            true => interpolated(time, values, at, wanted, gap),
            false => values[reached],
        });
    }
    out
}

/// Value of the cubic through the rows `at - 1` to `at + 2` at the time `wanted` between `at` and `at + 1`; of the
/// straight line if one of them is beyond a gap or an end.
fn interpolated(time: &[f64], values: &[f64], at: usize, wanted: f64, gap: f64) -> f64 {
    let whole = at >= 1
        && at + 2 < time.len()
        && time[at] - time[at - 1] <= gap
        && time[at + 2] - time[at + 1] <= gap;
    let rows = if whole { at - 1..at + 3 } else { at..at + 2 };
    let weight = |k: usize| -> f64 {
        rows.clone().filter(|&m| m != k).map(|m| (wanted - time[m]) / (time[k] - time[m])).product()
    };
    rows.clone().map(|k| weight(k) * values[k]).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Motion of 2 Hz at 100 Hz with steps that alternate between 8 and 12 ms, as in loggers, and a torque in phase
    /// with it, `delay` later.
    fn late(delay: f64) -> Samples {
        let time: Vec<f64> =
            (0..400).map(|row| 0.01 * f64::from(row) + if row % 2 == 1 { 0.002 } else { 0.0 }).collect();
        let wave = |t: f64| (2.0 * std::f64::consts::TAU * t).sin();
        Samples {
            position: vec![time.iter().map(|t| wave(*t)).collect()],
            torque: vec![time.iter().map(|t| 5.0 * wave(t - delay)).collect()],
            velocity: Some(vec![time.iter().map(|t| wave(t - delay)).collect()]),
            time,
            ..Samples::default()
        }
    }

    #[test]
    fn a_delay_is_taken_off_at_the_true_times_of_uneven_rows() {
        for delay in [0.012, 0.0004, 0.05, -0.017] {
            let mut samples = late(delay);
            let delays = ChannelDelays { torque: vec![delay], velocity: vec![delay] };
            take_delays(&delays, &mut samples);
            let inside = 10..390;
            for row in inside {
                let truth = samples.position[0][row];
                assert!((samples.torque[0][row] - 5.0 * truth).abs() < 2e-3, "{delay} {row}");
                assert!((samples.velocity.as_ref().expect("recorded")[0][row] - truth).abs() < 4e-4);
            }
        }
    }

    #[test]
    fn nothing_is_carried_over_a_gap_or_an_end() {
        let mut samples = late(0.0);
        samples.time.iter_mut().skip(200).for_each(|time| *time += 5.0);
        samples.torque[0] = (0..400).map(|row| if row < 200 { 1.0 } else { 9.0 }).collect();
        for delay in [0.03, -0.03] {
            let mut shifted = samples.clone();
            take_delays(&ChannelDelays { torque: vec![delay], velocity: Vec::new() }, &mut shifted);
            let near = |(found, expected): (&f64, &f64)| (found - expected).abs() < 1e-12;
            assert!(
                shifted.torque[0].iter().zip(&samples.torque[0]).all(near),
                "{delay}: {:?}",
                shifted.torque[0]
            );
            assert_eq!((&shifted.time, &shifted.position), (&samples.time, &samples.position));
        }
    }

    #[test]
    fn without_delay_nothing_changes_by_a_bit() {
        let samples = late(0.012);
        let mut same = samples.clone();
        take_delays(&ChannelDelays { torque: vec![0.0], velocity: Vec::new() }, &mut same);
        assert_eq!(same, samples);
        assert!(ChannelDelays::default().is_none());
    }
}
