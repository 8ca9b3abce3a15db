//! Texts about limits: the margins of a motion, and the limits that it breaks.

use serde_json::{Value, json};

use crate::cli::context::CliError;
use crate::cli::shared::output;
use armwatch_method::NumericsError;
use armwatch_model::robot::{FourierExcitation, JointIndex, JointKind, Robot};
use armwatch_trajectory::limits::{Breach, MotionLimits, extremes};

/// A broken limit in one sentence.
pub(super) fn sentence(robot: &Robot, breach: &Breach) -> String {
    let unit = breach.quantity.unit(robot.joints[breach.joint.index()].kind);
    let share = if breach.limit == 0.0 {
        String::new()
    } else {
        format!(" ({:.1} %)", 100.0 * breach.excess() / breach.limit.abs())
    };
    format!(
        "joint {}: {} {:.5} {unit} at {:.3} s, limit {:.5} {unit}, beyond it by {:.5} {unit}{share}; first at {:.3} s",
        breach.joint,
        breach.quantity,
        breach.value,
        breach.time,
        breach.limit,
        breach.excess(),
        breach.since
    )
}

/// A broken limit for scripts.
pub(super) fn as_value(robot: &Robot, breach: &Breach) -> Value {
    json!({
        "joint": breach.joint.number(),
        "quantity": breach.quantity.to_string(),
        "unit": breach.quantity.unit(robot.joints[breach.joint.index()].kind),
        "value": breach.value,
        "limit": breach.limit,
        "excess": breach.excess(),
        "time_s": breach.time,
        "first_time_s": breach.since,
    })
}

/// Prints the margins of a series to each limit: one row per joint.
pub(super) fn print_nearness(robot: &Robot, series: &FourierExcitation) {
    let header = [
        "joint",
        "unit",
        "lowest",
        "highest",
        "range",
        "speed",
        "of top",
        "acceleration",
        "of top",
        "jerk",
        "of top",
    ];
    let rows: Vec<Vec<String>> = robot
        .joint_indices()
        .map(|index| {
            let (joint, found) = (&robot.joints[index.index()], extremes(series, index.index()));
            let limits = &joint.limits;
            let swing = found.high.value - found.low.value;
            let percent = |value: f64, limit: f64| format!("{:.1} %", 100.0 * value.abs() / limit);
            vec![
                index.to_string(),
                (if joint.kind == JointKind::Revolute { "rad" } else { "m" }).to_owned(),
                format!("{:.3}", found.low.value),
                format!("{:.3}", found.high.value),
                percent(swing, limits.position_max - limits.position_min),
                format!("{:.3}", found.speed.value.abs()),
                percent(found.speed.value, limits.velocity),
                format!("{:.3}", found.acceleration.value.abs()),
                percent(found.acceleration.value, limits.acceleration),
                format!("{:.1}", found.jerk.value.abs()),
                limits.jerk.map_or_else(|| "-".to_owned(), |jerk| percent(found.jerk.value, jerk)),
            ]
        })
        .collect();
    output::print_table(&header, &rows, &[]);
}

/// Tolerance of a requested speed, as a fraction.
const SPEED_TOLERANCE: f64 = 1e-3;

/// The same for scripts.
pub(super) fn nearness(robot: &Robot, series: &FourierExcitation) -> Value {
    let of_joint = |index: JointIndex| {
        let (limits, found) = (&robot.joints[index.index()].limits, extremes(series, index.index()));
        json!({
            "joint": index.number(),
            "lowest_position": found.low.value,
            "highest_position": found.high.value,
            "range_share": (found.high.value - found.low.value) / (limits.position_max - limits.position_min),
            "speed": found.speed.value.abs(),
            "speed_share": found.speed.value.abs() / limits.velocity,
            "acceleration": found.acceleration.value.abs(),
            "acceleration_share": found.acceleration.value.abs() / limits.acceleration,
            "jerk": found.jerk.value.abs(),
            "jerk_share": limits.jerk.map(|jerk| found.jerk.value.abs() / jerk),
        })
    };
    robot.joint_indices().map(of_joint).collect()
}

/// Joints that stay below the required share of their top speeds, one sentence each. `limits` `[n]` are those of the
/// search.
pub(super) fn slower(
    robot: &Robot,
    limits: &[MotionLimits],
    series: &FourierExcitation,
    share: f64,
) -> Vec<String> {
    let of_joint = |(index, limits): (JointIndex, &MotionLimits)| {
        let top = robot.joints[index.index()].limits.velocity;
        let reached = extremes(series, index.index()).speed.value.abs() / top;
        // from rest to rest over the whole range with the largest acceleration: v² = a (max - min)
        let possible = (2.0 * limits.acceleration * limits.half_range()).sqrt() / top;
        let forbidden = match possible < share {
            true => format!("; its range and acceleration allow at most {:.1} %", 100.0 * possible),
            false => String::new(),
        };
        (reached < (1.0 - SPEED_TOLERANCE) * share).then(|| {
            format!(
                "joint {index} reaches {:.1} % of its top speed, not the required {:.1} %{forbidden}",
                100.0 * reached,
                100.0 * share
            )
        })
    };
    robot.joint_indices().zip(limits).filter_map(of_joint).collect()
}

/// Why a motion of the arm `arm` gives no numbers, and the remedy.
pub(super) fn without_numbers(arm: &str, series: &FourierExcitation, error: &NumericsError) -> CliError {
    let remedy = match error {
        NumericsError::NotFinite(_) => format!(
            "; in {:.2} s the arm moves too little to show every parameter, so allow a longer motion (--seconds)",
            1.0 / series.base_frequency
        ),
        _ => String::new(),
    };
    CliError::Usage(format!("{arm}: {error}{remedy}"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::context::EXIT_USAGE;
    use armwatch_testing::er3a;
    use armwatch_trajectory::limits::Shares;

    #[test]
    fn a_speed_that_the_range_forbids_is_said() {
        let mut robot = er3a();
        let series = robot.excitation.clone().expect("Table 4.1");
        // 0.5 rad at 2 rad/s²: at most 1 rad/s
        robot.joints[0].limits.velocity = 4.0;
        let limits = |robot: &Robot| -> Vec<MotionLimits> {
            let whole = Shares { position: 1.0, velocity: 1.0, acceleration: 1.0 };
            robot.joints.iter().map(|joint| MotionLimits::of(joint, &whole)).collect()
        };
        let mut narrow = limits(&robot);
        (narrow[0].position_min, narrow[0].position_max, narrow[0].acceleration) = (-0.25, 0.25, 2.0);
        let said = slower(&robot, &narrow, &series, 0.9);
        assert!(
            said[0].contains("not the required 90.0 %; its range and acceleration allow at most 25.0 %"),
            "{said:?}"
        );
        assert!(slower(&robot, &narrow, &series, 0.0).is_empty());
    }

    #[test]
    fn a_motion_that_is_too_short_is_to_be_longer() {
        let mut series = er3a().excitation.expect("Table 4.1");
        series.base_frequency = 10.0;
        let error = without_numbers("er3a", &series, &NumericsError::NotFinite("the observation matrix"));
        assert_eq!(
            error.to_string(),
            "er3a: the observation matrix did not give finite numbers; in 0.10 s the arm moves too little to show every \
             parameter, so allow a longer motion (--seconds)"
        );
        assert_eq!(error.exit_code(), EXIT_USAGE);
        let other = without_numbers("er3a", &series, &NumericsError::Unsupported("a joint"));
        assert_eq!(other.to_string(), "er3a: not provided: a joint");
    }
}
