//! Forecasts of simulated wear. The random fates follow formulas of wear over use, not the model of the forecast.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

use super::*;

const LIMITS: Limits = Limits { warning: 0.05, critical: 0.15, sigma: 4.0 };

/// Tests of a baseline, whose mean is the unit of all indices.
const BASELINE: f64 = 5.0;

/// Change of a joint's friction.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Fate {
    Linear,
    /// A power of time, or exponential.
    Accelerating,
    /// Exponential towards a level that may be below the critical limit.
    Stalling,
    /// Linear in use, which changes from week to week and is zero in some.
    Irregular,
    Healthy,
}

const WORN: [Fate; 4] = [Fate::Linear, Fate::Accelerating, Fate::Stalling, Fate::Irregular];

/// Tests of a joint until today, and the days from the latest one until the limits are reached.
struct Drawn {
    tests: Vec<Test>,
    warning_days: Option<f64>,
    critical_days: Option<f64>,
}

/// Change of friction by day since its beginning, quarter day by quarter day.
fn wear(fate: Fate, days_to_critical: f64, random: &mut ChaCha8Rng) -> Vec<f64> {
    let quarters = (days_to_critical * 12.0 * 4.0) as usize;
    let share = |quarter: usize| quarter as f64 / 4.0 / days_to_critical;
    let critical = LIMITS.critical;
    let by = |of: &dyn Fn(f64) -> f64| (0..quarters).map(|quarter| critical * of(share(quarter))).collect();
    match fate {
        Fate::Linear => by(&|share| share),
        Fate::Accelerating if random.random_bool(0.5) => {
            let power = random.random_range(1.4..2.6);
            by(&|share| share.powf(power))
        }
        Fate::Accelerating => {
            let rate: f64 = random.random_range(1.0..3.0);
            by(&|share| (rate * share.min(3.0)).exp_m1() / rate.exp_m1())
        }
        Fate::Stalling => {
            let (end, time) = (random.random_range(0.4..2.0), random.random_range(0.4..1.2));
            by(&|share| end * -(-share / time).exp_m1())
        }
        Fate::Irregular => {
            let mut used = 0.0;
            let mut pace = 1.0;
            let mut changes = Vec::with_capacity(quarters);
            for quarter in 0..quarters {
                if quarter % 28 == 0 {
                    let z: f64 = random.sample(StandardNormal);
                    pace = if random.random_bool(0.08) { 0.0 } else { (0.5 * z).exp() };
                }
                changes.push(critical * used);
                used += pace / 4.0 / days_to_critical;
            }
            changes
        }
        Fate::Healthy => by(&|_| 0.0),
    }
}

fn drawn(fate: Fate, random: &mut ChaCha8Rng) -> Drawn {
    let interval_days = [1.0, 2.0, 7.0][random.random_range(0..3)];
    let scatter = random.random_range(0.003..0.012);
    let healthy_days = f64::from(random.random_range(0..31)) * interval_days;
    let changes = wear(fate, random.random_range(20.0..120.0) * interval_days, random);
    let reached =
        |change: f64| changes.iter().position(|of| *of >= change).map(|quarter| quarter as f64 / 4.0);
    let last = changes.last().copied().unwrap_or(0.0).min(LIMITS.critical);
    let now = match fate {
        Fate::Healthy => random.random_range(20.0..120.0) * interval_days,
        _ => reached(last * random.random_range(0.2..0.85)).expect("below the last"),
    };
    let z: f64 = random.sample(StandardNormal);
    let baseline = 1.0 + scatter / BASELINE.sqrt() * z;
    let mut tests = Vec::new();
    let mut day = -healthy_days;
    let mut latest = day;
    while day <= now {
        let std_error = scatter * random.random_range(0.8..1.25);
        let z: f64 = random.sample(StandardNormal);
        let odd: f64 = if random.random_bool(0.02) { random.sample(StandardNormal) } else { 0.0 };
        let change = if day < 0.0 { 0.0 } else { changes[(day * 4.0) as usize] };
        tests.push(Test {
            at: Timestamp::UNIX_EPOCH + SignedDuration::from_secs_f64((day + 4000.0) * SECONDS_PER_DAY),
            ratio: (1.0 + change + std_error * z + 5.0 * scatter * odd) / baseline,
            std_error: f64::max(std_error, 0.005),
        });
        latest = day;
        let late = if random.random_bool(0.05) { random.random_range(2.0..5.0) } else { 1.0 };
        day += interval_days * late * random.random_range(0.7..1.3);
    }
    let until = |change: f64| reached(change).map(|day| day - latest);
    Drawn { warning_days: until(LIMITS.warning), critical_days: until(LIMITS.critical), tests }
}

/// Results of the forecasts of one limit.
#[derive(Debug, Default)]
struct Outcome {
    forecasts: usize,
    /// Reached before the interval.
    before: usize,
    /// Reached after the interval.
    after: usize,
    /// Sum of the widths of closed intervals, as a fraction of the time until their middle, and their number.
    width: (f64, usize),
}

impl Outcome {
    fn add(&mut self, tests: &[Test], crossing: &Crossing, days: Option<f64>) {
        let last = tests.last().expect("tests").at;
        let day = |date: Date| {
            let at = date.to_zoned(TimeZone::UTC).expect("a day").timestamp();
            at.duration_since(last).as_secs_f64() / SECONDS_PER_DAY
        };
        self.forecasts += 1;
        let reached = days.unwrap_or(f64::INFINITY);
        self.before += usize::from(reached < day(crossing.lower));
        if let Some(upper) = crossing.upper {
            self.after += usize::from(reached > day(upper));
            let middle = day(crossing.by).max(1.0);
            self.width = (self.width.0 + (day(upper) - day(crossing.lower)) / middle, self.width.1 + 1);
        }
    }

    fn coverage(&self) -> f64 {
        1.0 - (self.before + self.after) as f64 / self.forecasts as f64
    }

    fn row(&self) -> String {
        let share = |of: usize| 100.0 * of as f64 / self.forecasts as f64;
        format!(
            "{} | {:.1} % | {:.1} % | {:.1} % | {:.2}",
            self.forecasts,
            100.0 * self.coverage(),
            share(self.before),
            share(self.after),
            self.width.0 / self.width.1 as f64
        )
    }
}

/// Share without a trend of the drawn fates with enough tests, and outcomes for the limits.
fn outcomes(fate: Fate, count: usize, seed: u64) -> (f64, [Outcome; 2]) {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut outcomes = [Outcome::default(), Outcome::default()];
    let (mut judged, mut without) = (0, 0);
    for _ in 0..count {
        let drawn = drawn(fate, &mut random);
        let Some(forecast) = forecast(&drawn.tests, &LIMITS) else { continue };
        judged += 1;
        without += usize::from(forecast.trend == Trend::None);
        let limits = [(forecast.warning_at, drawn.warning_days), (forecast.critical_at, drawn.critical_days)];
        for (outcome, (crossing, days)) in outcomes.iter_mut().zip(limits) {
            // no forecast for a passed limit
            if let Some(crossing) = crossing.filter(|_| days.is_none_or(|days| days > 0.0)) {
                outcome.add(&drawn.tests, &crossing, days);
            }
        }
    }
    (without as f64 / f64::from(judged), outcomes)
}

/// The forecasts of 300 fates have a standard error of 2.5 to 3 % in their coverage, so the bounds are wider than in
/// `coverage_of_thousands_of_fates`.
#[test]
fn intervals_hold_four_fifths_of_simulated_fates() {
    for fate in WORN {
        let (without, [_, critical]) = outcomes(fate, 300, 71);
        assert!(critical.forecasts >= 120, "{fate:?}: {critical:?}");
        assert!((0.70..=0.90).contains(&critical.coverage()), "{fate:?}: {critical:?}");
        assert!(without < 0.6, "{fate:?}: {without}");
    }
}

#[test]
fn healthy_joints_have_no_trend() {
    let (without, _) = outcomes(Fate::Healthy, 300, 72);
    assert!(without >= 0.96, "{without}");
}

/// The table of docs/method.md: `cargo test --lib thousands_of_fates -- --ignored --nocapture`.
#[test]
#[ignore = "minutes; the table of docs/method.md"]
fn coverage_of_thousands_of_fates() {
    let mut table =
        String::from("| fate | no trend | limit | forecasts | coverage | before | after | width |\n");
    let mut within = true;
    for fate in WORN {
        let (without, [warning, critical]) = outcomes(fate, 4000, 2026);
        for (name, outcome) in [("warning", warning), ("critical", critical)] {
            let row = format!("| {fate:?} | {:.0} % | {name} | {} |\n", 100.0 * without, outcome.row());
            table.push_str(&row);
            within &= name == "warning" || (0.76..=0.86).contains(&outcome.coverage());
        }
    }
    let (without, _) = outcomes(Fate::Healthy, 4000, 2026);
    table.push_str(&format!("| Healthy | {:.1} % |\n", 100.0 * without));
    assert!(within, "{table}");
    eprintln!("{table}");
}

/// Daily tests without scatter except for a small wobble.
fn daily(tests: usize, ratio: impl Fn(f64) -> f64) -> Vec<Test> {
    let wobble = |day: usize| 0.002 * ((day * 37 % 11) as f64 / 5.0 - 1.0);
    let at = |day: usize| {
        "2026-01-01T06:00Z".parse::<Timestamp>().expect("a time")
            + SignedDuration::from_hours(24 * day as i64)
    };
    (0..tests)
        .map(|day| Test { at: at(day), ratio: ratio(day as f64) + wobble(day), std_error: 0.0015 })
        .collect()
}

/// Days since the first test: begin, middle and end of the interval.
fn days(crossing: Option<Crossing>) -> [i32; 3] {
    let crossing = crossing.expect("ahead");
    let upper = crossing.upper.expect("within the horizon");
    let start: Date = "2026-01-01".parse().expect("a day");
    [crossing.lower, crossing.by, upper].map(|date| date.since(start).expect("days").get_days())
}

#[test]
fn a_straight_line_reaches_its_limits_in_time() {
    // 0.1 % a day: 5 % after 50 days, 15 % after 150 days
    let at = |tests| forecast(&daily(tests, |day| 1.0 + 0.001 * day), &LIMITS).expect("enough tests");
    assert_eq!(at(40).trend, Trend::Rising);
    let [lower, by, upper] = days(at(40).warning_at);
    assert!((47..=53).contains(&by) && lower <= 50 && upper >= 50, "{lower} {by} {upper}");
    // the nearer the day, the narrower the interval
    let mut width = i32::MAX;
    for tests in [80, 110, 140] {
        let [lower, by, upper] = days(at(tests).critical_at);
        assert!((135..=165).contains(&by) && lower <= 150 && upper >= 150, "{tests}: {lower} {by} {upper}");
        assert!(upper - lower <= width, "{tests}: {lower} {upper}, before {width}");
        width = upper - lower;
    }
}

#[test]
fn a_falling_line_falls_and_a_passed_limit_has_no_date() {
    let found = forecast(&daily(70, |day| 1.0 - 0.001 * day), &LIMITS).expect("enough tests");
    assert_eq!((found.trend, found.warning_at), (Trend::Falling, None));
    assert!(found.critical_at.is_some(), "{found:?}");
}

#[test]
fn few_tests_tests_at_one_moment_and_slow_trends_give_no_dates() {
    assert_eq!(forecast(&[], &LIMITS), None);
    assert_eq!(forecast(&daily(FEWEST_TESTS - 1, |day| 1.0 + 0.01 * day), &LIMITS), None);
    let mut at_once = daily(20, |day| 1.0 + 0.01 * day);
    let first = at_once[0].at;
    at_once.iter_mut().for_each(|test| test.at = first);
    assert_eq!(forecast(&at_once, &LIMITS), None);
    // clear, but 5 % are 500 days away and the horizon is 400
    let slow = daily(100, |day| 1.0 + 0.0001 * day);
    assert_eq!(forecast(&slow, &LIMITS), Some(Forecast::default()));
}

#[test]
fn one_odd_test_moves_no_date_by_much() {
    let line = daily(100, |day| 1.0 + 0.001 * day);
    let mut odd = line.clone();
    odd[97].ratio += 0.08;
    let by = |tests: &[Test]| days(forecast(tests, &LIMITS).expect("enough tests").critical_at)[1];
    assert!((by(&odd) - by(&line)).abs() <= 10, "{} {}", by(&odd), by(&line));
}

/// Against the definition: the state after two steps is that after one of both lengths, with and without growth.
#[test]
fn two_steps_are_one() {
    let start =
        TrendState { level: 1.02, slope: 0.1, level_variance: 1e-4, covariance: 2e-5, slope_variance: 4e-3 };
    for growth in [-4.0, 0.0, 1e-9, 1e-3, 3.0] {
        let dynamics = Dynamics { growth, slope_noise: 0.3, level_noise: 0.1 };
        let (once, twice) = (start.after(0.5, &dynamics), start.after(0.2, &dynamics).after(0.3, &dynamics));
        let figures =
            |of: TrendState| [of.level, of.slope, of.level_variance, of.covariance, of.slope_variance];
        for (a, b) in figures(once).into_iter().zip(figures(twice)) {
            assert!((a - b).abs() <= 1e-6 * a.abs(), "{growth}: {a} {b}");
        }
    }
}
