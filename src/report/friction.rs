//! Friction over time with the fitted curves [5.4], and over speed from cold to warm: one panel per joint.

use std::collections::BTreeSet;

use super::figure::{Figure, Key, Look, MEASURED, Mark, Panel, RAMP, Series, extent, ramp};
use armwatch_method::friction::points::level_means::friction_means;
use armwatch_method::friction::warm_up::warm_up_torque;
use armwatch_model::analysis::{FrictionPoint, WarmUpFit};
use armwatch_model::robot::JointIndex;

/// Most points drawn per joint, speed level and direction. More cannot be distinguished; they are thinned evenly.
const MAX_POINTS: usize = 1000;

/// Points along a fitted curve.
const CURVE_POINTS: usize = 120;

/// Draws the magnitude of friction over the minutes of a run, and the curves fitted to it. Levels have
/// the same colour in all panels, from the slowest to the fastest.
pub fn friction_figure(
    points: &[FrictionPoint],
    fits: &[WarmUpFit],
    title: String,
    subtitle: String,
) -> Figure {
    let levels = levels(points);
    let mut joints: Vec<JointIndex> = points.iter().map(|point| point.joint).collect();
    joints.sort_unstable();
    joints.dedup();
    let panels = joints.into_iter().map(|joint| panel(points, fits, joint, &levels)).collect();
    let mut legend: Vec<Key> = levels
        .iter()
        .enumerate()
        .map(|(place, level)| Key {
            label: format!("{:.0} % of the largest speed", 100.0 * level),
            look: Look::Series(ramp(place, levels.len()), Mark::LineWithDots),
        })
        .collect();
    legend.push(Key { label: "forwards".into(), look: Look::Series(MEASURED, Mark::Dots) });
    legend.push(Key { label: "backwards".into(), look: Look::Series(MEASURED, Mark::Rings) });
    Figure { title, subtitle, legend, panels, columns: 2 }
}

/// Friction points of one cycle.
#[derive(Debug, Clone, PartialEq)]
pub struct CyclePoints {
    /// Label of the cycle, such as `cycle 3`.
    pub label: String,
    /// Its points.
    pub points: Vec<FrictionPoint>,
}

/// Draws the magnitude of friction over speed, mean of both directions, for some of the cycles: the first, the last and
/// others evenly between them, as many as there are colours. The subtitle lists the omitted ones.
pub fn friction_speed_figure(cycles: &[CyclePoints], title: String, subtitle: String) -> Figure {
    let shown = evenly(cycles, RAMP.len());
    let subtitle = subtitle + &left_out(cycles, &shown, |cycle| &cycle.label);
    let joints: BTreeSet<JointIndex> =
        cycles.iter().flat_map(|cycle| &cycle.points).map(|point| point.joint).collect();
    let panel = |joint: JointIndex| Panel {
        title: format!("joint {joint}"),
        x_label: "speed, rad/s".into(),
        y_label: "friction, Nm".into(),
        with_zero: true,
        series: (shown.iter().enumerate())
            .map(|(place, cycle)| over_speed(cycle, joint, ramp(place, shown.len())))
            .collect(),
        ..Panel::default()
    };
    let key = |(place, cycle): (usize, &&CyclePoints)| Key {
        label: cycle.label.clone(),
        look: Look::Series(ramp(place, shown.len()), Mark::LineWithDots),
    };
    let legend = shown.iter().enumerate().map(key).collect();
    Figure { title, subtitle, legend, panels: joints.into_iter().map(panel).collect(), columns: 2 }
}

/// Friction points of one run at one speed level, with the curves fitted to them.
#[derive(Debug, Clone, PartialEq)]
pub struct RunCurves {
    /// Label of the run, such as `run 3, 2026-01-05`.
    pub label: String,
    /// Its points.
    pub points: Vec<FrictionPoint>,
    /// Its own fits.
    pub fits: Vec<WarmUpFit>,
}

/// Draws friction over time of several runs in one picture, each with its own curve, like thesis figure 5.23 with the
/// four tests of a robot: one panel per joint, one colour per run. If there are more runs than colours, the first, the
/// last and others evenly between them are drawn; the subtitle lists the omitted ones. Points are means of both
/// directions.
pub fn run_comparison_figure(runs: &[RunCurves], title: String, subtitle: String) -> Figure {
    let shown = evenly(runs, RAMP.len());
    let subtitle = subtitle + &left_out(runs, &shown, |run| &run.label);
    let levels: BTreeSet<(JointIndex, u64)> = runs
        .iter()
        .flat_map(|run| &run.points)
        .map(|point| (point.joint, point.speed_fraction.to_bits()))
        .collect();
    let panel = |(joint, bits): (JointIndex, u64)| {
        let level = f64::from_bits(bits);
        Panel {
            title: format!("joint {joint}, {:.0} % of the largest speed", 100.0 * level),
            x_label: "time since the start of the run, min".into(),
            y_label: "friction, Nm".into(),
            with_zero: false,
            series: (shown.iter().enumerate())
                .flat_map(|(place, run)| of_run(run, joint, level, ramp(place, shown.len())))
                .collect(),
            ..Panel::default()
        }
    };
    let key = |(place, run): (usize, &&RunCurves)| Key {
        label: run.label.clone(),
        look: Look::Series(ramp(place, shown.len()), Mark::LineWithDots),
    };
    let legend = shown.iter().enumerate().map(key).collect();
    Figure { title, subtitle, legend, panels: levels.into_iter().map(panel).collect(), columns: 2 }
}

fn of_run(run: &RunCurves, joint: JointIndex, level: f64, colour: usize) -> Vec<Series> {
    let means = friction_means(&run.points, joint, level);
    let stride = means.len().div_ceil(MAX_POINTS).max(1);
    let dots = means.iter().step_by(stride).map(|mean| [mean.time / 60.0, mean.torque]).collect();
    let points: Vec<&FrictionPoint> = run.points.iter().filter(|point| point.joint == joint).collect();
    let fit = run.fits.iter().find(|fit| fit.joint == joint && fit.speed_fraction.total_cmp(&level).is_eq());
    let mut series = vec![Series { name: run.label.clone(), colour, mark: Mark::Dots, points: dots }];
    series.extend(fit.and_then(|fit| curve(fit, &points, &run.label, colour)));
    series
}

/// At most `most` of `all`, including the first and the last.
fn evenly<T>(all: &[T], most: usize) -> Vec<&T> {
    if all.len() <= most {
        return all.iter().collect();
    }
    (0..most).map(|i| &all[i * (all.len() - 1) / (most - 1)]).collect()
}

/// Lists the items that are not shown; empty if all are.
fn left_out<'a, T>(all: &'a [T], shown: &[&T], label: impl Fn(&'a T) -> &'a str) -> String {
    let is_shown = |one: &&T| shown.iter().any(|of| std::ptr::eq(*of, *one));
    let names: Vec<&str> = all.iter().filter(|one| !is_shown(one)).map(label).collect();
    match names.len() {
        0 => String::new(),
        count if count <= MAX_NAMED => {
            format!("; {} of {} shown, left out: {}", shown.len(), all.len(), names.join(", "))
        }
        count => format!("; {} of {} shown, {count} between them left out", shown.len(), all.len()),
    }
}

/// Most omitted items that are listed individually.
const MAX_NAMED: usize = 8;

/// Mean speed and mean magnitude of friction at each level of a joint.
fn over_speed(cycle: &CyclePoints, joint: JointIndex, colour: usize) -> Series {
    let of_joint: Vec<FrictionPoint> =
        cycle.points.iter().filter(|point| point.joint == joint).copied().collect();
    let mean = |level: f64| {
        let of_level: Vec<&FrictionPoint> =
            of_joint.iter().filter(|point| point.speed_fraction.total_cmp(&level).is_eq()).collect();
        let count = of_level.len() as f64;
        let sum = |value: fn(&FrictionPoint) -> f64| of_level.iter().map(|point| value(point)).sum::<f64>();
        [sum(|point| point.speed) / count, sum(|point| point.torque.abs()) / count]
    };
    Series {
        name: cycle.label.clone(),
        colour,
        mark: Mark::LineWithDots,
        points: levels(&of_joint).into_iter().map(mean).collect(),
    }
}

/// Speed levels, slowest first.
fn levels(points: &[FrictionPoint]) -> Vec<f64> {
    let mut levels: Vec<f64> = points.iter().map(|point| point.speed_fraction).collect();
    levels.sort_by(f64::total_cmp);
    levels.dedup();
    levels
}

fn panel(points: &[FrictionPoint], fits: &[WarmUpFit], joint: JointIndex, levels: &[f64]) -> Panel {
    let mut series = Vec::new();
    let of_joint: Vec<&FrictionPoint> = points.iter().filter(|point| point.joint == joint).collect();
    for (place, level) in levels.iter().enumerate() {
        let colour = ramp(place, levels.len());
        let name = format!("{:.0} % of the largest speed", 100.0 * level);
        let of_level: Vec<&FrictionPoint> =
            of_joint.iter().copied().filter(|point| point.speed_fraction.total_cmp(level).is_eq()).collect();
        for (direction, mark, word) in [(1, Mark::Dots, "forwards"), (-1, Mark::Rings, "backwards")] {
            let ours: Vec<[f64; 2]> = (of_level.iter())
                .filter(|point| point.direction == direction)
                .map(|point| [point.time / 60.0, point.torque.abs()])
                .collect();
            let stride = ours.len().div_ceil(MAX_POINTS).max(1);
            let points = ours.into_iter().step_by(stride).collect();
            series.push(Series { name: format!("{name}, {word}"), colour, mark, points });
        }
        let fit = fits.iter().find(|fit| fit.joint == joint && fit.speed_fraction.total_cmp(level).is_eq());
        series.extend(fit.and_then(|fit| curve(fit, &of_level, &name, colour)));
    }
    Panel {
        title: format!("joint {joint}"),
        x_label: "time since the start of the run, min".into(),
        y_label: "friction, Nm".into(),
        with_zero: true,
        series,
        ..Panel::default()
    }
}

/// The fitted curve over the time of its points only, since it would extrapolate beyond them.
fn curve(fit: &WarmUpFit, points: &[&FrictionPoint], name: &str, colour: usize) -> Option<Series> {
    let (first, last) = extent(points.iter().map(|point| point.time / 60.0))?;
    let at = |i: usize| first + (last - first) * i as f64 / (CURVE_POINTS - 1) as f64;
    let points = (0..CURVE_POINTS).map(|i| [at(i), warm_up_torque(fit, at(i))]).collect();
    Some(Series { name: format!("{name}, fitted"), colour, mark: Mark::Line, points })
}

#[cfg(test)]
mod tests {
    use super::*;
    use armwatch_model::analysis::{Estimate, GravityRemoval, WarmUpModel};

    fn point(joint: usize, minute: f64, level: f64, direction: i8) -> FrictionPoint {
        FrictionPoint {
            joint: JointIndex::new(joint),
            time: 60.0 * minute,
            speed_fraction: level,
            speed: level,
            direction,
            torque: f64::from(direction) * (10.0 + level),
            std: 0.1,
            samples: 50,
            gravity: GravityRemoval::AxisVertical,
            load: None,
        }
    }

    #[test]
    fn points_of_both_directions_stand_on_their_curve() {
        let mut points = Vec::new();
        for i in 0..3000 {
            for direction in [-1, 1] {
                points.push(point(0, f64::from(i) * 0.04, 0.6, direction));
            }
        }
        points.push(point(3, 1.0, 0.2, 1));
        let fit = WarmUpFit {
            joint: JointIndex::new(0),
            speed_fraction: 0.6,
            model: WarmUpModel::Constant,
            a: Estimate { value: 10.6, std_error: 0.0 },
            slow: None,
            fast: None,
            fast_shown: None,
            rmsd: 0.0,
            samples: 6000,
            record: [0.0, 120.0],
        };
        let figure = friction_figure(&points, &[fit], "R01".into(), String::new());
        assert_eq!(figure.panels.len(), 2);
        assert_eq!(figure.panels[1].title, "joint 4");
        // two levels and two directions
        assert_eq!(figure.legend.len(), 4);
        let curve = figure.panels[0].series.last().expect("a curve");
        assert_eq!((curve.mark, curve.points.len()), (Mark::Line, CURVE_POINTS));
        for series in &figure.panels[0].series {
            assert!(series.points.len() <= MAX_POINTS);
            assert!(series.points.iter().all(|point| (point[1] - 10.6).abs() < 1e-9));
        }
    }

    #[test]
    fn each_run_has_its_colour_its_means_and_its_curve() {
        let fit = |a: f64| WarmUpFit {
            joint: JointIndex::new(0),
            speed_fraction: 0.6,
            model: WarmUpModel::Constant,
            a: Estimate { value: a, std_error: 0.0 },
            slow: None,
            fast: None,
            fast_shown: None,
            rmsd: 0.0,
            samples: 4,
            record: [0.0, 5.0],
        };
        let run = |number: usize| RunCurves {
            label: format!("run {number}"),
            points: [0.0, 5.0]
                .into_iter()
                .flat_map(|minute| [1, -1].map(|sign| point(0, minute, 0.6, sign)))
                .collect(),
            fits: vec![fit(10.0 + number as f64)],
        };
        let runs: Vec<RunCurves> = (1..=4).map(run).collect();
        let figure = run_comparison_figure(&runs, "R01".into(), String::new());
        assert_eq!((figure.legend.len(), figure.panels.len()), (4, 1));
        let series = &figure.panels[0].series;
        assert_eq!(series.len(), 8, "dots and a curve of each run");
        assert_eq!((series[6].mark, series[6].colour, series[6].points.len()), (Mark::Dots, ramp(3, 4), 2));
        assert_eq!(figure.subtitle, "");
        let many: Vec<RunCurves> = (1..=12).map(run).collect();
        let figure = run_comparison_figure(&many, "R01".into(), "means".into());
        assert_eq!(figure.subtitle, "means; 9 of 12 shown, left out: run 4, run 8, run 11");
        assert!((series[6].points[1][1] - 10.6).abs() < 1e-9);
        assert!((series[7].points[5][1] - 14.0).abs() < 1e-9);
    }

    #[test]
    fn friction_over_speed_is_the_mean_of_both_directions_from_cold_to_warm() {
        let cycle = |number: usize| {
            let mut points: Vec<FrictionPoint> = [0.2, 0.6]
                .into_iter()
                .flat_map(|level| [1, -1].map(|sign| point(0, 1.0, level, sign)))
                .collect();
            points[0].torque = 12.2;
            CyclePoints { label: format!("cycle {number}"), points }
        };
        let cycles: Vec<CyclePoints> = (1..=24).map(cycle).collect();
        let figure = friction_speed_figure(&cycles, "R01".into(), String::new());
        let labels: Vec<&str> = figure.legend.iter().map(|key| key.label.as_str()).collect();
        assert_eq!((labels.len(), labels[0], labels[8]), (9, "cycle 1", "cycle 24"));
        assert_eq!(figure.subtitle, "; 9 of 24 shown, 15 between them left out");
        let points = &figure.panels[0].series[3].points;
        for (found, expected) in points.iter().zip([[0.2, 11.2], [0.6, 10.6]]) {
            assert!(
                (found[0] - expected[0]).abs() < 1e-9 && (found[1] - expected[1]).abs() < 1e-9,
                "{found:?}"
            );
        }
        assert_eq!(points.len(), 2);
        assert_eq!(friction_speed_figure(&cycles[..2], "R01".into(), String::new()).legend.len(), 2);
    }
}
