//! Derives units from the numbers: velocity is the derivative of position, so the factor between them relates their
//! units and that of time.

use std::f64::consts::{PI, TAU};

/// A unit in the notation of layouts, and its factor to SI.
pub(super) type Unit = (&'static str, f64);

pub(super) const POSITION: [Unit; 3] = [("rad", 1.0), ("deg", PI / 180.0), ("rev", TAU)];
pub(super) const VELOCITY: [Unit; 4] =
    [("rad/s", 1.0), ("deg/s", PI / 180.0), ("rpm", TAU / 60.0), ("rev/s", TAU)];
pub(super) const TIME: [Unit; 4] = [("s", 1.0), ("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9)];

/// Units of time of spreadsheets and MATLAB.
pub(super) const LONG_TIME: [Unit; 3] = [("min", 60.0), ("h", 3600.0), ("d", 86_400.0)];

/// Name of the unit of a clock with an unknown step.
pub(super) const TICKS: &str = "ticks";

/// Plausible steps of a clock, s: those that a layout accepts.
const TICK: std::ops::RangeInclusive<f64> = 1e-9..=10.0;

/// Rows between two compared positions: enough to make the noise and steps of an encoder small compared with the
/// motion.
const WINDOW: usize = 20;

/// Largest relative difference between the measured factor and that of a pair of units. The nearest two, 1 rad/s and
/// 9.55 rpm or 57.3 deg/s, are far apart, and filtered velocities differ by a few per cent.
const SLOPE_TOLERANCE: f64 = 0.05;

/// The same for minutes, hours and days: degrees per radian are 60 except for 5 per cent.
const LONG_TIME_TOLERANCE: f64 = 0.02;

/// Least move of a joint in a window, as a fraction of its large moves; noise dominates smaller moves.
const LEAST_MOVE: f64 = 0.1;

/// Largest relative deviation of a window's factor from the median of all, for agreement.
const AGREES: f64 = 0.15;

/// Least share of agreeing windows for a factor to be accepted; gaps in time and turning points do not agree.
const LEAST_AGREEMENT: f64 = 0.7;

/// Sample rates of controllers and loggers, Hz.
const SAMPLE_RATES: std::ops::RangeInclusive<f64> = 5.0..=25_000.0;

/// Largest position of a joint without end stops, rad: three turns either way.
const MAX_POSITION: f64 = 3.0 * TAU;

/// Factor of its largest position that a joint may reach: controllers permit slightly more than a description.
const BEYOND: f64 = 1.1;

/// Least motion of a recording that permits identification, rad, as the largest position of any joint.
const LEAST_POSITION: f64 = 0.05;

/// Largest speed of a joint, rad/s: small arms reach ten.
const MAX_SPEED: f64 = 20.0;

/// Relation between velocity and the change of position.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Slope {
    /// Velocity divided by change of position per unit of time, all in the export's units.
    pub(super) ratio: f64,
    /// Share of agreeing windows.
    pub(super) agreement: f64,
}

/// The factor between `velocity` and the derivative of `position` `[rows]` over `time`; without time, the row number is
/// used. It is the median over windows of the sum of velocity divided by the change of position, so that gaps in time
/// and noise have no effect; `None` if the windows do not agree.
pub(super) fn slope(position: &[f64], velocity: &[f64], time: Option<&[f64]>) -> Option<Slope> {
    let at = |row: usize| time.map_or(row as f64, |time| time[row]);
    let rows = position.len().min(velocity.len()).min(time.map_or(usize::MAX, <[f64]>::len));
    let window = |start: usize| {
        let travelled: f64 = (start..start + WINDOW)
            .map(|row| (velocity[row] + velocity[row + 1]) / 2.0 * (at(row + 1) - at(row)))
            .sum();
        (position[start + WINDOW] - position[start], travelled)
    };
    let windows: Vec<(f64, f64)> = (0..rows.saturating_sub(WINDOW)).step_by(WINDOW / 2).map(window).collect();
    let mut moves: Vec<f64> = windows.iter().map(|(change, _)| change.abs()).collect();
    moves.sort_by(f64::total_cmp);
    let least = LEAST_MOVE * moves.get(moves.len() * 9 / 10).copied().filter(|wide| *wide > 0.0)?;
    let moving = windows.into_iter().filter(|(change, _)| change.abs() >= least);
    let mut ratios: Vec<f64> = moving.map(|(change, travelled)| travelled / change).collect();
    ratios.sort_by(f64::total_cmp);
    let ratio = ratios.get(ratios.len() / 2).copied().filter(|ratio| *ratio != 0.0)?;
    let agree = ratios.iter().filter(|one| (*one / ratio - 1.0).abs() <= AGREES).count();
    let agreement = agree as f64 / ratios.len() as f64;
    (agreement >= LEAST_AGREEMENT).then_some(Slope { ratio, agreement })
}

/// The factor over all joints `[n][rows]`: the median of the moving ones.
pub(super) fn joint_slope(position: &[&[f64]], velocity: &[&[f64]], time: Option<&[f64]>) -> Option<Slope> {
    let mut slopes: Vec<Slope> = (position.iter().zip(velocity))
        .filter_map(|(position, velocity)| slope(position, velocity, time))
        .collect();
    slopes.sort_by(|a, b| a.ratio.abs().total_cmp(&b.ratio.abs()));
    slopes.get(slopes.len() / 2).copied()
}

/// Units that are known before the numbers are examined.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Known {
    pub(super) position: Option<&'static str>,
    pub(super) velocity: Option<&'static str>,
    pub(super) time: Option<&'static str>,
}

/// Properties of the numbers, in the export's units.
#[derive(Debug, Clone, Copy)]
pub(super) struct ColumnNumbers {
    /// Largest magnitude of any position.
    pub(super) position: f64,
    /// Largest magnitude of any velocity, if recorded.
    pub(super) velocity: Option<f64>,
    /// Median step of time, if recorded.
    pub(super) step: Option<f64>,
    pub(super) slope: Option<Slope>,
    /// Largest magnitude of a position that the arm allows, rad, if known.
    pub(super) limit: Option<f64>,
    /// True if positions are those of motors, which turn many times.
    pub(super) is_motor: bool,
    /// Given rows per second, Hz, if no time is recorded.
    pub(super) rate: Option<f64>,
    /// True if time consists of whole numbers, like the counts of a clock.
    pub(super) is_counting: bool,
}

/// A choice of units: names and factors to SI.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Choice {
    pub(super) position: Unit,
    pub(super) velocity: Unit,
    pub(super) time: Unit,
}

impl Choice {
    /// Rows per second, Hz, that make velocities match the change of position from row to row.
    pub(super) fn rate(self, slope: Slope) -> Option<f64> {
        let rate = slope.ratio.abs() * self.velocity.1 / self.position.1;
        SAMPLE_RATES.contains(&rate).then_some(rate)
    }
}

/// Largest relative difference between a given sample rate and that of the velocities. Filtered velocities change
/// gradually; 10 and 9.55, a wrong digit and the factor of rpm, must not be confused.
pub(super) const RATE_TOLERANCE: f64 = 0.02;

/// All choices that match the known units and the numbers; more usual ones come first.
pub(super) fn choices(known: Known, figures: ColumnNumbers) -> Vec<Choice> {
    let of = |units: &[Unit], known: Option<&str>| -> Vec<Unit> {
        units.iter().copied().filter(|(name, _)| known.is_none_or(|known| known == *name)).collect()
    };
    let velocities = match figures.velocity {
        Some(_) => of(&VELOCITY, known.velocity),
        None => vec![("rad/s", 1.0)],
    };
    let times = match figures.step {
        Some(_) => of(&TIME, known.time),
        None => vec![("s", 1.0)],
    };
    let mut found = Vec::new();
    for position in of(&POSITION, known.position) {
        for &velocity in &velocities {
            for &time in &times {
                let choice = Choice { position, velocity, time };
                if is_possible(choice, known, figures) {
                    found.push(choice);
                }
            }
        }
    }
    if figures.step.is_some() {
        found.splice(0..0, of_long_times(known, figures, !found.is_empty()));
    }
    // minutes with rad, and s with deg, are closer to each other than filtered velocities to either
    found.sort_by_key(|choice| misfit(*choice, figures) > RATE_TOLERANCE);
    if found.is_empty() && known.time.is_none() && figures.is_counting {
        found = of_ticks(&of(&POSITION, known.position), &velocities, known, figures);
    }
    found
}

/// Choices with minutes, hours or days. If others match too, velocities must be in the positions' unit per second,
/// since nearly any factor is that of some three units.
fn of_long_times(known: Known, figures: ColumnNumbers, has_others: bool) -> Vec<Choice> {
    if has_others && figures.slope.is_none() && known.time.is_none() {
        return Vec::new();
    }
    let pairs = POSITION.into_iter().zip([VELOCITY[0], VELOCITY[1], VELOCITY[3]]);
    let agrees = |time: Unit| {
        figures.slope.is_none_or(|slope| (slope.ratio.abs() * time.1 - 1.0).abs() <= LONG_TIME_TOLERANCE)
    };
    let is_known = |known: Option<&str>, unit: Unit| known.is_none_or(|known| known == unit.0);
    pairs
        .flat_map(|(position, velocity)| LONG_TIME.map(|time| Choice { position, velocity, time }))
        .filter(|of| {
            is_known(known.position, of.position)
                && is_known(known.time, of.time)
                && (figures.velocity.is_none() || is_known(known.velocity, of.velocity))
                && agrees(of.time)
                && is_possible(*of, known, figures)
        })
        .collect()
}

/// Choices with a clock whose step follows from positions and velocities.
fn of_ticks(positions: &[Unit], velocities: &[Unit], known: Known, figures: ColumnNumbers) -> Vec<Choice> {
    let Some(slope) = figures.slope else { return Vec::new() };
    let pairs =
        positions.iter().flat_map(|position| velocities.iter().map(move |velocity| (*position, *velocity)));
    let choice = |(position, velocity): (Unit, Unit)| {
        let tick = position.1 / (slope.ratio.abs() * velocity.1);
        Choice { position, velocity, time: (TICKS, tick) }
    };
    pairs
        .map(choice)
        .filter(|choice| TICK.contains(&choice.time.1) && is_possible(*choice, known, figures))
        .collect()
}

/// Relative difference between the measured factor and that of the units; zero without a measured one.
fn misfit(choice: Choice, figures: ColumnNumbers) -> f64 {
    let expected = choice.position.1 / (choice.time.1 * choice.velocity.1);
    let of = |slope: Slope| (slope.ratio.abs() / expected - 1.0).abs();
    figures.slope.filter(|_| figures.step.is_some()).map_or(0.0, of)
}

fn is_possible(choice: Choice, known: Known, figures: ColumnNumbers) -> bool {
    let Choice { position, velocity, time } = choice;
    let agrees = match (figures.slope, figures.step) {
        (Some(_), Some(_)) => misfit(choice, figures) <= SLOPE_TOLERANCE,
        (Some(slope), None) => choice.rate(slope).is_some_and(|rate| {
            figures.rate.is_none_or(|given| (rate / given - 1.0).abs() <= RATE_TOLERANCE)
        }),
        _ => true,
    };
    let rate = figures.step.is_none_or(|step| SAMPLE_RATES.contains(&(1.0 / (step * time.1))));
    let reach = figures.position * position.1;
    let most = figures.limit.map_or(MAX_POSITION, |limit| BEYOND * limit);
    let inside = known.position.is_some() || figures.is_motor || (LEAST_POSITION..=most).contains(&reach);
    // Turns are rare: they need a word for them, or a factor that matches nothing else.
    let usual = position.0 != "rev" || known.position.is_some() || figures.slope.is_some();
    let speed = figures.velocity.map_or(0.0, |speed| speed * velocity.1);
    let sane = known.velocity.is_some() || figures.is_motor || speed <= MAX_SPEED;
    agrees && rate && inside && usual && sane
}

/// Returns true if a position is beyond a `limit`, rad, in any unit.
pub(super) fn is_beyond(position: f64, limit: f64) -> bool {
    POSITION.iter().all(|(_, to_si)| position * to_si > BEYOND * limit)
}

/// The median of the steps of a column.
pub(super) fn median_step(values: &[f64]) -> Option<f64> {
    let mut steps: Vec<f64> = values.windows(2).map(|pair| pair[1] - pair[0]).collect();
    steps.sort_by(f64::total_cmp);
    steps.get(steps.len() / 2).copied()
}

/// The largest magnitude.
pub(super) fn largest<'v>(values: impl IntoIterator<Item = &'v f64>) -> f64 {
    values.into_iter().fold(0.0, |most, value| value.abs().max(most))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A motion in rad and rad/s at 250 Hz.
    fn motion() -> (Vec<f64>, Vec<f64>, Vec<f64>) {
        let time: Vec<f64> = (0..2000).map(|row| f64::from(row) * 0.004).collect();
        let position = time.iter().map(|t| 1.2 * (1.7 * t).sin() + 0.3 * (5.0 * t).cos()).collect();
        let velocity =
            time.iter().map(|t| 1.2 * 1.7 * (1.7 * t).cos() - 0.3 * 5.0 * (5.0 * t).sin()).collect();
        (time, position, velocity)
    }

    fn in_units(values: &[f64], factor: f64) -> Vec<f64> {
        values.iter().map(|value| value / factor).collect()
    }

    #[test]
    fn every_triple_of_units_is_among_those_found() {
        let (time, position, velocity) = motion();
        for p in POSITION {
            for v in VELOCITY {
                for t in TIME {
                    let (time, position) = (in_units(&time, t.1), in_units(&position, p.1));
                    let velocity = in_units(&velocity, v.1);
                    let slope = joint_slope(&[&position], &[&velocity], Some(&time)).unwrap();
                    let figures = ColumnNumbers {
                        position: largest(&position),
                        velocity: Some(largest(&velocity)),
                        step: median_step(&time),
                        slope: Some(slope),
                        limit: Some(3.0),
                        is_motor: false,
                        rate: None,
                        is_counting: false,
                    };
                    let found = choices(Known::default(), figures);
                    let right = Choice { position: p, velocity: v, time: t };
                    assert!(found.contains(&right), "{right:?} is not in {found:?}");
                    let known = Known { position: Some(p.0), ..Known::default() };
                    assert_eq!(choices(known, figures), [right], "one unit known");
                }
            }
        }
    }

    #[test]
    fn a_clock_of_its_own_is_found_by_its_step() {
        let (time, position, velocity) = motion();
        let counts = in_units(&time, 0.002);
        let figures = ColumnNumbers {
            position: largest(&position),
            velocity: Some(largest(&velocity)),
            step: median_step(&counts),
            slope: joint_slope(&[&position], &[&velocity], Some(&counts)),
            limit: Some(3.0),
            is_motor: false,
            rate: None,
            is_counting: true,
        };
        let found = choices(Known::default(), figures);
        assert_eq!((found[0].position.0, found[0].time.0), ("rad", TICKS));
        assert!((found[0].time.1 - 0.002).abs() < 1e-5, "{found:?}");
    }

    #[test]
    fn a_velocity_that_is_none_has_no_slope() {
        let (time, position, _) = motion();
        assert_eq!(joint_slope(&[&position], &[&position], Some(&time)), None);
        assert_eq!(slope(&[1.0; 100], &[0.0; 100], None), None);
    }

    #[test]
    fn gaps_and_rests_do_not_matter() {
        let (time, mut position, mut velocity) = motion();
        position[1000..1800].fill(0.7);
        velocity[1000..1800].fill(0.0);
        let slope = slope(&position, &velocity, Some(&time)).unwrap();
        assert!((slope.ratio - 1.0).abs() < 0.01, "{slope:?}");
    }

    #[test]
    fn a_turned_velocity_has_a_negative_slope() {
        let (time, position, velocity) = motion();
        let velocity = in_units(&velocity, -1.0);
        let slope = slope(&position, &velocity, Some(&time)).unwrap();
        assert!((slope.ratio + 1.0).abs() < 0.01 && slope.agreement > 0.9, "{slope:?}");
    }
}
