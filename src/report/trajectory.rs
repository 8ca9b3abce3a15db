//! A test motion relative to its limits, and the progress of the search for it.

use super::figure::{
    ESTIMATED, Figure, FigureLevel, Key, Limit, Look, MEASURED, Mark, Panel, Series, XAxis, ramp,
};
use armwatch_model::robot::{FourierExcitation, Robot};
use armwatch_trajectory::limits::{MotionLimits, Shares};
use armwatch_trajectory::series::state_at;

/// Points of a curve.
const POINTS: u32 = 250;

/// Draws positions, velocities and accelerations of all joints over one period, each in per cent of its limit, and the
/// resulting values of a search's starts.
pub fn trajectory_figure(
    robot: &Robot,
    series: &FourierExcitation,
    starts: &[Option<f64>],
    title: String,
    subtitle: String,
) -> Figure {
    let times: Vec<f64> =
        (0..=POINTS).map(|k| f64::from(k) / f64::from(POINTS) / series.base_frequency).collect();
    let states: Vec<Vec<[f64; 3]>> = times.iter().map(|&time| state_at(series, time)).collect();
    let (mut panels, mut legend) = (panels(robot, &times, &states), legend(robot.joint_count()));
    if starts.iter().any(Option::is_some) {
        panels.push(search_panel(starts));
        legend.push(Key { label: "a start of the search".into(), look: Look::Series(MEASURED, Mark::Dots) });
        legend.push(Key { label: "best so far".into(), look: Look::Series(ESTIMATED, Mark::Line) });
    }
    Figure { title, subtitle, legend, panels, columns: 2 }
}

/// Draws positions, velocities and accelerations of all joints over any motion, each in per cent of its limit. `states`
/// has `[q, qd, qdd]` of each joint at each of the `times`, s.
pub fn motion_figure(
    robot: &Robot,
    times: &[f64],
    states: &[Vec<[f64; 3]>],
    title: String,
    subtitle: String,
) -> Figure {
    let panels = panels(robot, times, states);
    Figure { title, subtitle, legend: legend(robot.joint_count()), panels, columns: 1 }
}

/// Positions, velocities and accelerations.
fn panels(robot: &Robot, times: &[f64], states: &[Vec<[f64; 3]>]) -> Vec<Panel> {
    let n = robot.joint_count();
    let whole = Shares { position: 1.0, velocity: 1.0, acceleration: 1.0 };
    let limits: Vec<MotionLimits> =
        robot.joints.iter().map(|joint| MotionLimits::of(joint, &whole)).collect();
    let part = |j: usize, quantity: usize, state: &[f64; 3]| {
        let of = &limits[j];
        100.0
            * match quantity {
                0 => (state[0] - of.middle()) / of.half_range(),
                1 => state[1] / of.velocity,
                _ => state[2] / of.acceleration,
            }
    };
    let panel = |quantity: usize, title: &str, y_label: &str| Panel {
        title: title.into(),
        x_label: "time, s".into(),
        y_label: y_label.into(),
        y_range: Some([-110.0, 110.0]),
        limits: [-100.0, 100.0].map(|value| Limit { value, level: FigureLevel::Critical }).to_vec(),
        series: (0..n)
            .map(|j| Series {
                name: format!("joint {}", j + 1),
                colour: ramp(j, n),
                mark: Mark::Line,
                points: times.iter().zip(states).map(|(t, of)| [*t, part(j, quantity, &of[j])]).collect(),
            })
            .collect(),
        ..Panel::default()
    };
    vec![
        panel(0, "position", "of half the range, about its middle, %"),
        panel(1, "velocity", "of the largest speed, %"),
        panel(2, "acceleration", "of the largest acceleration, %"),
    ]
}

fn legend(n: usize) -> Vec<Key> {
    let of_joint =
        |j: usize| Key { label: format!("joint {}", j + 1), look: Look::Series(ramp(j, n), Mark::Line) };
    let limit = Key { label: "limit".into(), look: Look::Limit(FigureLevel::Critical) };
    (0..n).map(of_joint).chain([limit]).collect()
}

/// Resulting values of the starts, in per cent above the best of them: objectives have values of any size.
fn search_panel(starts: &[Option<f64>]) -> Panel {
    let at = |k: usize| (k + 1) as f64;
    let least = starts.iter().flatten().copied().fold(f64::INFINITY, f64::min);
    let above = |value: f64| 100.0 * (value / least - 1.0);
    let mut best = f64::INFINITY;
    let so_far: Vec<[f64; 2]> = starts
        .iter()
        .enumerate()
        .map(|(k, value)| {
            best = best.min(value.unwrap_or(f64::INFINITY));
            [at(k), above(best)]
        })
        .collect();
    let each =
        starts.iter().enumerate().map(|(k, value)| [at(k), above(value.unwrap_or(f64::NAN))]).collect();
    Panel {
        title: "search".into(),
        x_label: "start".into(),
        x_axis: XAxis::Count,
        y_label: "above the best, %".into(),
        series: vec![
            Series { name: "start".into(), colour: MEASURED, mark: Mark::Dots, points: each },
            Series { name: "best so far".into(), colour: ESTIMATED, mark: Mark::Line, points: so_far },
        ],
        ..Panel::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use armwatch_testing::er3a;

    #[test]
    fn curves_are_parts_of_limits_and_the_best_start_never_rises() {
        let robot = er3a();
        let series = robot.excitation.clone().expect("Table 4.1");
        let values = [Some(6.0), None, Some(5.0), Some(7.0)];
        let figure = trajectory_figure(&robot, &series, &values, "t".into(), String::new());
        let largest = |panel: usize, joint: usize| {
            let points = &figure.panels[panel].series[joint].points;
            points.iter().map(|point| point[1].abs()).fold(0.0, f64::max)
        };
        // the stated speeds of this motion
        for (joint, percent) in [66.0, 61.0, 59.0, 52.0, 46.0, 39.0].into_iter().enumerate() {
            assert!((largest(1, joint) - percent).abs() < 0.6, "{joint} {}", largest(1, joint));
        }
        assert!((0..6).all(|joint| largest(0, joint) <= 100.0 && largest(2, joint) <= 100.0));
        for (point, expected) in
            figure.panels[3].series[1].points.iter().zip([[1.0, 20.0], [2.0, 20.0], [3.0, 0.0], [4.0, 0.0]])
        {
            assert!((point[0] - expected[0]).abs() + (point[1] - expected[1]).abs() < 1e-9, "{point:?}");
        }
        let without = trajectory_figure(&robot, &series, &[], "t".into(), String::new());
        assert_eq!(without.panels.len(), 3);
        assert!(without.svg().len() < 200_000);
    }
}
