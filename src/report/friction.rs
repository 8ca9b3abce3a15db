//! Friction over time with the fitted curves [5.4]: a panel a joint.

use super::figure::{Figure, Key, Look, Mark, Panel, Series, extent};
use crate::analysis::{FrictionPoint, WarmUpFit};
use crate::numerics::warm_up::warm_up_torque;
use crate::robot::JointIndex;

/// Most points that are drawn of a joint, speed level and direction. More cannot be told apart; they are thinned
/// evenly.
const MAX_POINTS: usize = 1000;

/// Points along a fitted curve.
const CURVE_POINTS: usize = 120;

/// Draws the magnitude of friction over the minutes of a run, and the curves fitted to it. Levels have
/// the same colour in all panels.
#[must_use]
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
            look: Look::Series(place, Mark::LineWithDots),
        })
        .collect();
    legend.push(Key { label: "forwards".into(), look: Look::Series(0, Mark::Dots) });
    legend.push(Key { label: "backwards".into(), look: Look::Series(0, Mark::Rings) });
    Figure { title, subtitle, legend, panels, columns: 2 }
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
    for (colour, level) in levels.iter().enumerate() {
        let of_level: Vec<&FrictionPoint> =
            of_joint.iter().copied().filter(|point| point.speed_fraction.total_cmp(level).is_eq()).collect();
        for (direction, mark) in [(1, Mark::Dots), (-1, Mark::Rings)] {
            let ours: Vec<[f64; 2]> = (of_level.iter())
                .filter(|point| point.direction == direction)
                .map(|point| [point.time / 60.0, point.torque.abs()])
                .collect();
            let stride = ours.len().div_ceil(MAX_POINTS).max(1);
            series.push(Series { colour, mark, points: ours.into_iter().step_by(stride).collect() });
        }
        let fit = fits.iter().find(|fit| fit.joint == joint && fit.speed_fraction.total_cmp(level).is_eq());
        series.extend(fit.and_then(|fit| curve(fit, &of_level, colour)));
    }
    Panel {
        title: format!("joint {joint}"),
        x_label: "time since the start of the run, min".into(),
        y_label: "friction, Nm".into(),
        with_zero: true,
        bands: Vec::new(),
        series,
    }
}

/// The fitted curve over the time of its points: not beyond, where it would be an extrapolation.
fn curve(fit: &WarmUpFit, points: &[&FrictionPoint], colour: usize) -> Option<Series> {
    let (first, last) = extent(points.iter().map(|point| point.time / 60.0))?;
    let at = |i: usize| first + (last - first) * i as f64 / (CURVE_POINTS - 1) as f64;
    let points = (0..CURVE_POINTS).map(|i| [at(i), warm_up_torque(fit, at(i))]).collect();
    Some(Series { colour, mark: Mark::Line, points })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::{Estimate, GravityRemoval, WarmUpModel};

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
            rmsd: 0.0,
            samples: 6000,
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
}
