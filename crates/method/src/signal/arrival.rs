//! Rows that a controller samples evenly and a logger stamps on arrival: several at once, or with a changing delay.
//! They get the times of an even grid.

use std::borrow::Cow;
use std::ops::Range;

use super::time_grid::median_step;
use armwatch_model::analysis::finding::{Evidence, Finding, FindingKind, FindingSeverity};
use armwatch_model::run::Samples;

/// Step, as a part of the mean step, below which rows arrived together or late.
const SHORT: f64 = 0.6;
/// Smallest share of short steps for an examination of times; loggers that drop rows have none.
const SHORT_SHARE: f64 = 0.02;
/// Number of rows in a mean step; among so many, at least one row arrives without delay.
const WINDOW: usize = 32;
/// Smallest ratio between the deviations of positions from the line between their neighbours by time stamp and by row
/// number, if positions follow the row number.
const BETTER: f64 = 2.0;
/// Smallest ratio of a pause to nearly all other steps.
const PAUSE: f64 = 2.5;
/// Smallest ratio of the time of a span of rows with a pause to the usual one.
const PAUSED_SPAN: f64 = 1.5;
/// Share of the steps that may be longer.
const LONGEST_SHARE: f64 = 0.01;
/// Largest change of the least delay between two windows, in steps; a larger change shows missing rows.
const LOST: f64 = 0.7;
/// Largest range of the windows' least delays, in steps of an even grid, at a steady rate.
const STEADY: f64 = 1.0;
/// Smallest number of rows for a check of the rate.
const LEAST_ROWS: usize = 4 * WINDOW;

/// Result of moving times of arrival to an even grid.
#[derive(Debug, Clone, PartialEq)]
pub enum ArrivalGrid {
    /// Even times, with a remark.
    Even(String),
    /// The rate is not steady.
    Unsteady(Finding),
}

/// Assigns the times of an even grid to rows that were stamped on arrival. `None` if times are those of the samples;
/// then they do not change.
pub fn take_arrival(samples: &mut Cow<'_, Samples>) -> Option<ArrivalGrid> {
    let time = &samples.time;
    let mean = mean_step(time)?;
    let steps: Vec<f64> = time.windows(2).map(|pair| pair[1] - pair[0]).collect();
    let short = steps.iter().filter(|step| **step < SHORT * mean).count();
    if (short as f64) < SHORT_SHARE * steps.len() as f64 || !follow_rows(samples, mean) {
        return None;
    }
    let words = words(&steps, mean);
    match even_times(time, &steps, mean) {
        Some(even) => {
            samples.to_mut().time = even;
            let rate = 1.0 / mean_step(&samples.time)?;
            Some(ArrivalGrid::Even(format!(
                "{words}: they are times of arrival, and the rows count as evenly sampled at {rate:.4} Hz"
            )))
        }
        None => Some(ArrivalGrid::Unsteady(Finding {
            kind: FindingKind::TimeAxis,
            severity: FindingSeverity::Refuse,
            joint: None,
            sentence: format!(
                "{words}, and their mean rate is not steady: when a row was sampled is not known; record the controller's own \
                 time"
            ),
            evidence: vec![Evidence { name: "mean_step_s", value: mean }],
        })),
    }
}

/// Mean step, s, without pauses.
fn mean_step(time: &[f64]) -> Option<f64> {
    if time.len() <= LEAST_ROWS {
        return None;
    }
    let mut spans: Vec<f64> = time.windows(4 * WINDOW + 1).map(|rows| rows[4 * WINDOW] - rows[0]).collect();
    let middle = spans.len().checked_sub(1)? / 2;
    let (_, &mut median, _) = spans.select_nth_unstable_by(middle, f64::total_cmp);
    // mean of all spans, because each covers whole bursts; those over a pause are much longer
    let usual = spans.iter().filter(|span| **span < PAUSED_SPAN * median);
    let (count, sum) = usual.fold((0_usize, 0.0), |(count, sum), span| (count + 1, sum + span));
    Some(sum / (count * 4 * WINDOW) as f64).filter(|mean| *mean > 0.0)
}

/// Returns true if positions are closer to the line between their neighbours by row number than by time stamp.
fn follow_rows(samples: &Samples, mean: f64) -> bool {
    let time = &samples.time;
    let (mut by_row, mut by_time) = (0.0, 0.0);
    for position in &samples.position {
        for row in 1..time.len() - 1 {
            let [before, here, after] = [position[row - 1], position[row], position[row + 1]];
            let span = time[row + 1] - time[row - 1];
            // folded angles jump, and pauses are between other rows
            let jumps = (here - before).abs().max((after - here).abs()) > std::f64::consts::PI;
            if jumps || span > 4.0 * WINDOW as f64 * mean {
                continue;
            }
            let part = (time[row] - time[row - 1]) / span;
            by_row += (here - 0.5 * (before + after)).abs();
            by_time += (here - before - part * (after - before)).abs();
        }
    }
    BETTER * by_row < by_time
}

/// Clause about the time stamps.
fn words(steps: &[f64], mean: f64) -> String {
    let mut sizes: Vec<usize> = Vec::new();
    let mut size = 1;
    for step in steps {
        if *step < SHORT * mean {
            size += 1;
        } else {
            sizes.push(size);
            size = 1;
        }
    }
    sizes.sort_unstable();
    let middle = sizes.get(sizes.len() / 2).copied().unwrap_or(1);
    let of_that_size = sizes.iter().filter(|size| **size == middle).count();
    match middle {
        2.. if 2 * of_that_size > sizes.len() => format!("times come in bursts of {middle}"),
        2.. => format!("times come in bursts of about {middle}"),
        _ => {
            let spread = steps.iter().map(|step| (step - mean).abs()).sum::<f64>() / steps.len() as f64;
            format!("times jitter by {:.1} ms", 1e3 * spread)
        }
    }
}

/// Times of an even grid for each stretch without missing rows; `None` if the rate is not steady.
fn even_times(time: &[f64], steps: &[f64], mean: f64) -> Option<Vec<f64>> {
    let mut sorted = steps.to_vec();
    let place = (sorted.len() as f64 * (1.0 - LONGEST_SHARE)) as usize;
    let (_, longest, _) = sorted.select_nth_unstable_by(place, f64::total_cmp);
    let longest = PAUSE * longest.max(mean);
    let mut even = time.to_vec();
    let mut start = 0;
    let ends = steps.iter().enumerate().filter(|(_, step)| **step > longest).map(|(row, _)| row + 1);
    for end in ends.chain([time.len()]) {
        for rows in without_missing(time, start..end, mean) {
            let (first, step) = line(&time[rows.clone()], mean)?;
            for (place, row) in rows.enumerate() {
                even[row] = first + step * place as f64;
            }
        }
        start = end;
    }
    even.windows(2).all(|pair| pair[0] < pair[1]).then_some(even)
}

/// Least delay of the rows of each window, s, relative to an even grid of `step`: one row of many arrives without
/// delay.
fn least_delays(time: &[f64], step: f64) -> Vec<f64> {
    let delays: Vec<f64> = time.iter().enumerate().map(|(row, time)| time - step * row as f64).collect();
    delays.chunks_exact(WINDOW).map(|window| window.iter().copied().fold(f64::INFINITY, f64::min)).collect()
}

/// Splits rows at missing ones: there the least delay grows from one window to the next, and stays.
fn without_missing(time: &[f64], rows: Range<usize>, mean: f64) -> Vec<Range<usize>> {
    let least = least_delays(&time[rows.clone()], mean);
    let mut cuts = vec![rows.start];
    for (window, pair) in least.windows(2).enumerate() {
        if (pair[1] - pair[0]).abs() > LOST * mean {
            let from = rows.start + window * WINDOW;
            let of_windows = from + 1..(from + 2 * WINDOW).min(rows.end);
            let step = |row: &usize| time[*row] - time[*row - 1];
            cuts.extend(of_windows.max_by(|a, b| step(a).total_cmp(&step(b))));
        }
    }
    cuts.push(rows.end);
    cuts.dedup();
    cuts.windows(2).map(|cut| cut[0]..cut[1]).filter(|cut| !cut.is_empty()).collect()
}

/// First time and step of the line through the times of rows; `None` if their rate is not steady.
fn line(time: &[f64], mean: f64) -> Option<(f64, f64)> {
    let rows = time.len() as f64;
    let middle = 0.5 * (rows - 1.0);
    let centre = time.iter().sum::<f64>() / rows;
    let mut step = mean;
    if time.len() >= LEAST_ROWS {
        let along: f64 = time.iter().enumerate().map(|(row, t)| (row as f64 - middle) * (t - centre)).sum();
        step = along / (rows * (rows * rows - 1.0) / 12.0);
        let least = least_delays(time, step);
        let (low, high) =
            least.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), x| (l.min(*x), h.max(*x)));
        if high - low > STEADY * step || (step / mean - 1.0).abs() > 0.05 {
            return None;
        }
    }
    Some((centre - step * middle, step))
}

/// Median step of rows that may have been stamped on arrival, s.
pub(crate) fn usual_step(time: &[f64]) -> Option<f64> {
    mean_step(time).or_else(|| median_step(time))
}

#[cfg(test)]
mod tests {
    use super::*;
    use armwatch_model::run::Stage;

    const STEP: f64 = 0.02;

    /// Evenly sampled sine whose rows have other times.
    fn stamped(rows: usize, stamp: impl Fn(usize) -> f64) -> Samples {
        let at = |row: usize| (1.3 * STEP * row as f64).sin();
        Samples {
            time: (0..rows).map(stamp).collect(),
            position: vec![(0..rows).map(at).collect()],
            velocity: None,
            torque: vec![vec![0.0; rows]],
            stage: vec![Stage::Excitation; rows],
            cycle: None,
            friction_signal: None,
            temperatures: None,
        }
    }

    fn taken(samples: Samples) -> (Vec<f64>, Option<ArrivalGrid>) {
        let mut samples = Cow::Owned(samples);
        let arrival = take_arrival(&mut samples);
        (samples.time.clone(), arrival)
    }

    /// Delays with an exponential distribution of this mean, s, in order of arrival.
    fn delayed(rows: usize, mean: f64) -> Vec<f64> {
        let mut state = 9_u64;
        let mut last = f64::NEG_INFINITY;
        (0..rows)
            .map(|row| {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                let uniform = ((state >> 11) as f64 + 0.5) / (1_u64 << 53) as f64;
                last = (STEP * row as f64 - mean * uniform.ln()).max(last + 1e-6);
                last
            })
            .collect()
    }

    fn assert_even(time: &[f64], but: impl Fn(usize) -> bool) {
        for (row, pair) in time.windows(2).enumerate().filter(|(row, _)| !but(*row)) {
            assert!((pair[1] - pair[0] - STEP).abs() < 1e-3 * STEP, "row {row}: {}", pair[1] - pair[0]);
        }
    }

    #[test]
    fn rows_that_arrive_together_are_evenly_sampled() {
        for size in [2, 3, 10] {
            let stamp =
                |row: usize| STEP * (row / size * size + size - 1) as f64 + 1e-4 * (row % size) as f64;
            let (time, arrival) = taken(stamped(3000, stamp));
            let Some(ArrivalGrid::Even(remark)) = arrival else { panic!("{arrival:?}") };
            assert!(remark.starts_with(&format!("times come in bursts of {size}:")), "{remark}");
            assert!(remark.contains("at 50.0"), "{remark}");
            assert_even(&time, |_| false);
        }
    }

    #[test]
    fn a_delay_that_changes_is_jitter() {
        let stamps = delayed(3000, 0.004);
        let (time, arrival) = taken(stamped(3000, |row| stamps[row]));
        let Some(ArrivalGrid::Even(remark)) = arrival else { panic!("{arrival:?}") };
        assert!(remark.starts_with("times jitter by "), "{remark}");
        assert_even(&time, |_| false);
    }

    #[test]
    fn missing_rows_stay_missing() {
        for lost in [3, 25, 500] {
            let of = |row: usize| if row < 1500 { row } else { row + lost };
            let stamp = |row: usize| STEP * (row / 3 * 3 + 2) as f64 + 1e-4 * (row % 3) as f64;
            let mut samples = stamped(3000, |row| stamp(of(row)));
            samples.position = vec![(0..3000).map(|row| (1.3 * STEP * of(row) as f64).sin()).collect()];
            let (time, arrival) = taken(samples);
            assert!(matches!(arrival, Some(ArrivalGrid::Even(_))), "{lost}: {arrival:?}");
            assert_even(&time, |row| (1490..1510).contains(&row));
            let gap = time[1510] - time[1490];
            assert!((gap / STEP - (20 + lost) as f64).abs() < 1.0, "{lost}: {gap}");
        }
    }

    #[test]
    fn a_rate_that_wanders_is_refused_with_that_cause() {
        let stamp = |row: usize| {
            let burst = row / 3 * 3 + 2;
            STEP * burst as f64 + 0.4 * (burst as f64 * 0.004).sin() + 1e-4 * (row % 3) as f64
        };
        let (time, arrival) = taken(stamped(3000, stamp));
        let Some(ArrivalGrid::Unsteady(finding)) = arrival else { panic!("{arrival:?}") };
        assert!(finding.sentence.starts_with("times come in bursts of 3, and their mean rate is not steady"));
        assert!((time[7] - stamp(7)).abs() < 1e-12, "times stay");
    }

    #[test]
    fn times_of_the_samples_stay() {
        let even = |row: usize| STEP * row as f64;
        let stamps = delayed(3000, 0.004);
        // here the motion follows the time stamps
        let mut uneven = stamped(3000, |row| stamps[row]);
        uneven.position = vec![stamps.iter().map(|time| (1.3 * time).sin()).collect()];
        for samples in [stamped(3000, even), stamped(40, even), uneven] {
            let expected = samples.time.clone();
            assert_eq!(taken(samples), (expected, None));
        }
    }
}
