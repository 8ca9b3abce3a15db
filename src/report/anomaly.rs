//! The tests before and since an anomaly: friction index and RMSD.

use super::figure::{
    Area, Band, ESTIMATED, Figure, FigureLevel, Key, Limit, Look, Mark, Panel, Series, XAxis,
};
use armwatch_method::statistics::distributions::normal_quantile;
use armwatch_model::robot::JointIndex;

/// Tint of the period with the anomaly.
const SEEN: usize = 2;

/// Values of one joint in one test.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EvidencePoint {
    /// Start of the test as a [`day`](super::figure::day).
    pub day: f64,
    /// The joint.
    pub joint: JointIndex,
    /// Friction index, 1 = unchanged.
    pub friction_index: Option<f64>,
    /// Its standard error.
    pub friction_index_std_error: Option<f64>,
    /// Friction of the warm joint, Nm, which is drawn if no test has an index.
    pub warm_friction_nm: Option<f64>,
    /// Moving relative RMSD of the excitation stage, a fraction.
    pub relative_rmsd: Option<f64>,
}

/// Draws the tests in two panels, one colour per joint if there are several; `seen` are the days from onset to the
/// latest test that showed the anomaly.
pub fn anomaly_figure(tests: &[EvidencePoint], seen: [f64; 2], title: String, subtitle: String) -> Figure {
    let mut joints: Vec<JointIndex> = tests.iter().map(|test| test.joint).collect();
    joints.sort_unstable();
    joints.dedup();
    let colour = |joint: JointIndex| if joints.len() == 1 { ESTIMATED } else { joint.index() };
    let along = |joint: JointIndex, of: &dyn Fn(&EvidencePoint) -> Option<f64>| -> Vec<[f64; 2]> {
        let of_joint = tests.iter().filter(|test| test.joint == joint);
        // a test without the value breaks the line
        of_joint.map(|test| [test.day, of(test).unwrap_or(f64::NAN)]).collect()
    };
    let half = normal_quantile(0.975);
    let indexed = tests.iter().any(|test| test.friction_index.is_some());
    let end = |test: &EvidencePoint, sign: f64| {
        Some(test.friction_index? + sign * half * test.friction_index_std_error?)
    };
    let mut friction = Vec::new();
    let mut areas = Vec::new();
    let mut rmsd = Vec::new();
    for &joint in &joints {
        let series =
            |mark, points| Series { name: format!("joint {joint}"), colour: colour(joint), mark, points };
        if joints.len() == 1 && indexed {
            let (low, high) = (along(joint, &|test| end(test, -1.0)), along(joint, &|test| end(test, 1.0)));
            let points = low.iter().zip(&high).map(|(low, high)| [low[0], low[1], high[1]]).collect();
            areas.push(Area { colour: colour(joint), points });
        }
        let of = |test: &EvidencePoint| if indexed { test.friction_index } else { test.warm_friction_nm };
        friction.push(series(Mark::LineWithDots, along(joint, &of)));
        rmsd.push(series(Mark::LineWithDots, along(joint, &|test| Some(100.0 * test.relative_rmsd?))));
    }
    let panel = |title: &str, y_label: &str, limits, with_zero, areas, series| Panel {
        title: title.into(),
        x_label: "start of the test, UTC".into(),
        x_axis: XAxis::Date,
        y_label: y_label.into(),
        with_zero,
        limits,
        bands: vec![Band { from: seen[0], to: seen[1], tint: SEEN }],
        areas,
        series,
        ..Panel::default()
    };
    let baseline = vec![Limit { value: 1.0, level: FigureLevel::Usual }];
    let panels = vec![
        match indexed {
            true => panel("friction index", "friction index", baseline, false, areas, friction),
            false => panel("warm friction", "warm friction, Nm", Vec::new(), false, Vec::new(), friction),
        },
        panel("fit of the model", "relative RMSD, %", Vec::new(), true, Vec::new(), rmsd),
    ];
    let key = |label: String, look| Key { label, look };
    let mut legend: Vec<Key> = joints
        .iter()
        .map(|&joint| key(format!("joint {joint}"), Look::Series(colour(joint), Mark::LineWithDots)))
        .collect();
    if joints.len() == 1 && indexed {
        legend.push(key("95 % interval".into(), Look::Area(ESTIMATED)));
        legend.push(key("baseline".into(), Look::Limit(FigureLevel::Usual)));
    }
    legend.push(key("from onset to last seen".into(), Look::Band(SEEN)));
    Figure { title, subtitle, legend, panels, columns: 1 }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn test(day: f64, joint: usize, index: Option<f64>) -> EvidencePoint {
        EvidencePoint {
            day,
            joint: JointIndex::new(joint),
            friction_index: index,
            friction_index_std_error: Some(0.01),
            warm_friction_nm: Some(20.0),
            relative_rmsd: Some(0.05),
        }
    }

    #[test]
    fn one_joint_has_its_interval_and_several_a_colour_each() {
        let one = [test(0.0, 2, Some(1.0)), test(1.0, 2, None), test(2.0, 2, Some(1.2))];
        let figure = anomaly_figure(&one, [1.5, 2.0], "anomaly 4".into(), String::new());
        let ([index], [interval]) = (&figure.panels[0].series[..], &figure.panels[0].areas[..]) else {
            panic!("{:?}", figure.panels[0])
        };
        assert!((interval.points[2][2] - interval.points[2][1] - 2.0 * 0.0196).abs() < 1e-4);
        assert!(index.points[1][1].is_nan());
        assert!((figure.panels[1].series[0].points[0][1] - 5.0).abs() < 1e-12);
        let several = [test(0.0, 0, None), test(0.0, 1, None)];
        let figure = anomaly_figure(&several, [0.0, 0.0], String::new(), String::new());
        assert_eq!(figure.panels[0].series.len(), 2);
        // without any index, measured friction is drawn
        assert_eq!(figure.panels[0].series[0].points, [[0.0, 20.0]]);
        assert!(figure.svg().contains("joint 2"));
    }
}
