//! Thermal: friction of all joints changes together.
//!
//! One joint wears alone. Effects of ambient temperature or lubricant beyond the correction of the friction index show
//! in most joints in the same run. The common part of a joint's friction is the median over the *other* joints of the
//! logarithm of friction over its baseline. It is subtracted from the joint's own friction, so that it is no drift or
//! step of each joint. Its standard deviation is 40 % of it, since joints differ in their sensitivity. A common part of
//! 10 % or more, smoothed over the tests, is reported once for the arm: `info`, and a warning from 20 % on.

use jiff::Timestamp;

use crate::detect::control_chart::{EWMA_WEIGHT, Ewma};
use crate::detect::episodes::episodes;
use crate::detect::runs::arm::cause::ArmCause;
use crate::detect::runs::history::friction_history::FrictionHistory;
use crate::detect::verdict::{Verdict, Why};
use crate::statistics::descriptive::median;
use armwatch_model::anomaly::quantity::Quantity;
use armwatch_model::anomaly::{Anomaly, AnomalyKind, Severity};

/// Fewest other joints whose median does not depend on a single one.
const FEWEST_OTHERS: usize = 3;
/// Smoothed common part, a fraction of friction, for the severities info and warning.
const INFO: f64 = 0.10;
const WARNING: f64 = 0.20;

/// The part of each joint's friction that the other joints share, in logarithms, by joint and run; 0 if too few of them
/// are known.
pub(in crate::detect::runs) fn common_parts(histories: &[FrictionHistory], runs: usize) -> Vec<Vec<f64>> {
    let ratios: Vec<Vec<Option<(f64, f64)>>> = histories.iter().map(|of| ln_ratios(of, runs)).collect();
    let of = |joint: usize, run: usize| {
        let others = ratios.iter().enumerate().filter(|(other, _)| *other != joint);
        let found: Vec<(f64, f64)> = others.filter_map(|(_, of)| of[run]).collect();
        if found.len() < FEWEST_OTHERS {
            return 0.0;
        }
        let values: Vec<f64> = found.iter().map(|(value, _)| *value).collect();
        let middle = median(&values).unwrap_or(0.0);
        // error of the median: a small median is more noise than signal
        let error = std::f64::consts::FRAC_PI_2 * found.iter().map(|(_, variance)| variance).sum::<f64>()
            / (found.len() * found.len()) as f64;
        middle * middle * middle / (middle * middle + error)
    };
    (0..histories.len()).map(|joint| (0..runs).map(|run| of(joint, run)).collect()).collect()
}

/// The median over each joint's others of the logarithm that the friction maps attribute to temperature, by joint and
/// run; `None` if too few of them are known.
pub(in crate::detect::runs) fn thermal_parts(
    histories: &[FrictionHistory],
    runs: usize,
) -> Vec<Vec<Option<f64>>> {
    let mut corrections = vec![vec![None; runs]; histories.len()];
    for (history, found) in histories.iter().zip(&mut corrections) {
        history.runs.iter().for_each(|of| found[of.run] = of.correction());
    }
    let of = |joint: usize, run: usize| {
        let others = corrections.iter().enumerate().filter(|(other, _)| *other != joint);
        let found: Vec<f64> = others.filter_map(|(_, of)| of[run]).collect();
        median(&found).filter(|_| found.len() >= FEWEST_OTHERS)
    };
    (0..histories.len()).map(|joint| (0..runs).map(|run| of(joint, run)).collect()).collect()
}

/// Logarithm of each run's measured friction over the baseline, with its own variance.
fn ln_ratios(history: &FrictionHistory, runs: usize) -> Vec<Option<(f64, f64)>> {
    let mut found = vec![None; runs];
    for of in &history.runs {
        found[of.run] = Some((of.measured_ratio().ln(), history.own_variance(of)));
    }
    found
}

/// Anomalies of the friction that all joints share. `histories` has one entry per joint, `faults` the fault of the arm
/// in each run, `runs` key and start of each.
pub(in crate::detect::runs) fn common_changes(
    histories: &[FrictionHistory],
    faults: &[Option<ArmCause>],
    runs: &[(i64, Timestamp)],
) -> Vec<Anomaly> {
    let compared = |history: &FrictionHistory| {
        let mut found = vec![None; runs.len()];
        for of in history.runs.iter().filter(|of| !history.is_learnt_from(of)) {
            found[of.run] = Some(of.measured_ratio().ln());
        }
        found
    };
    let ratios: Vec<Vec<Option<f64>>> = histories.iter().map(compared).collect();
    let mut average = Ewma::new(0.0);
    let verdict = |run: usize| {
        let found: Vec<f64> = ratios.iter().filter_map(|of| of[run]).collect();
        if found.len() <= FEWEST_OTHERS || matches!(faults.get(run), Some(Some(ArmCause::Load(_)))) {
            return Verdict::Unknown;
        }
        let change = average.add(median(&found).unwrap_or(0.0), EWMA_WEIGHT).exp_m1();
        if change.abs() < INFO {
            return Verdict::Quiet;
        }
        let (least, most) = found
            .iter()
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(least, most), of| (least.min(*of), most.max(*of)));
        Verdict::Out {
            severity: if change.abs() >= WARNING { Severity::Warning } else { Severity::Info },
            score: change.abs(),
            threshold: INFO,
            value: 1.0 + change,
            baseline: 1.0,
            message: format!(
                "friction of all joints has changed together by {:+.0} %, smoothed over the tests (in the latest test \
                 {:+.0} to {:+.0} %), beyond what temperature explains; a much {} room or another lubricant causes this, wear \
                 does not",
                100.0 * change,
                100.0 * least.exp_m1(),
                100.0 * most.exp_m1(),
                if change > 0.0 { "colder" } else { "warmer" },
            ),
            why: Why::default(),
        }
    };
    let verdicts = (0..runs.len()).map(verdict).collect();
    episodes(runs, None, AnomalyKind::Thermal, Quantity::CommonFrictionRatio, verdicts)
}

#[cfg(test)]
mod tests {
    use crate::detect::runs::detect;
    use crate::detect::runs::fixtures::{indexed, wobble};
    use armwatch_model::analysis::{Estimate, JointSummary, WarmFriction};
    use armwatch_model::anomaly::settings::DetectSettings;
    use armwatch_model::anomaly::{AnomalyKind, RunSummary, Severity};
    use armwatch_model::robot::JointIndex;

    /// Daily tests of six joints with given indexes.
    fn history(runs: usize, index: impl Fn(usize, usize) -> f64) -> Vec<RunSummary> {
        let joint = |run: usize, j: usize| {
            let wobble = 1.0 + 0.5 * (wobble(run * 7 + j * 5) - 1.0);
            JointSummary {
                joint: JointIndex::new(j),
                friction_index: Some(Estimate { value: index(run, j) * wobble, std_error: 0.004 }),
                ..indexed(0, None).joints[0]
            }
        };
        (0..runs)
            .map(|run| RunSummary {
                joints: (0..6).map(|j| joint(run, j)).collect(),
                ..indexed(run as i64, Some(1.0))
            })
            .collect()
    }

    #[test]
    fn a_hall_that_moves_all_joints_is_one_word_about_the_arm() {
        // joints differ in their sensitivity to ambient temperature
        let hall = |run: usize, j: usize| if run >= 10 { 1.16 + 0.02 * j as f64 } else { 1.0 };
        let found = detect(&history(20, hall), &DetectSettings::default());
        let [anomaly] = &found.anomalies[..] else { panic!("one anomaly: {:?}", found.anomalies) };
        assert_eq!(
            (anomaly.kind, anomaly.joint, anomaly.severity),
            (AnomalyKind::Thermal, None, Severity::Warning)
        );
        assert!((anomaly.value - 1.21).abs() < 0.02, "{anomaly:?}");
        // a smaller change is not reported
        let small = |run: usize, j: usize| if run >= 10 { 1.05 + 0.01 * j as f64 } else { 1.0 };
        assert_eq!(detect(&history(20, small), &DetectSettings::default()).anomalies, vec![]);
    }

    #[test]
    fn a_joint_of_an_arm_without_a_friction_stage_is_found_beside_a_hall_that_differs_from_test_to_test() {
        let excited = |worn: usize| {
            let joint = |run: usize, j: usize| {
                let hall = [0.05, -0.05, 0.02, -0.03, 0.04, -0.04, 0.01][run % 7];
                let own = if j == worn && run >= 20 { 1.15 } else { 1.0 };
                let torque = 10.0 * own * wobble(run * 7 + j * 5) * (1.0 + hall);
                let friction = WarmFriction { torque, std_error: 0.05, minute: 100.0, speed_fraction: 0.6 };
                JointSummary {
                    joint: JointIndex::new(j),
                    excitation_friction: Some(friction),
                    ..indexed(0, None).joints[0]
                }
            };
            let of = |run: usize| RunSummary {
                joints: (0..6).map(|j| joint(run, j)).collect(),
                ..indexed(run as i64, Some(1.0))
            };
            (0..30).map(of).collect::<Vec<_>>()
        };
        for worn in 0..6 {
            let runs = excited(worn);
            let found = detect(&runs, &DetectSettings::default());
            let [anomaly] = &found.anomalies[..] else { panic!("one anomaly: {:?}", found.anomalies) };
            assert_eq!(anomaly.joint, Some(JointIndex::new(worn)));
            // during the rise, or at most two tests later
            assert!(anomaly.first_run_id <= runs[22].run_id, "{anomaly:?}");
        }
        assert_eq!(detect(&excited(6), &DetectSettings::default()).anomalies, vec![]);
    }

    /// Daily tests of six joints. Friction at equal speed grows by the fraction `colder` within a month, because the room
    /// gets colder, and the index of joint 4 by `own`.
    fn in_colder_room(colder: f64, own: f64) -> Vec<RunSummary> {
        let part = |run: usize| run.saturating_sub(9).min(30) as f64 / 30.0;
        let mut runs = history(60, |run, j| if j == 3 { 1.0 + own * part(run) } else { 1.0 });
        for (run, summary) in runs.iter_mut().enumerate() {
            for joint in &mut summary.joints {
                let index = joint.friction_index.map_or(1.0, |of| of.value);
                joint.warm_friction = Some(WarmFriction {
                    torque: 10.0 * index * (1.0 + colder * part(run)),
                    std_error: 0.05,
                    minute: 100.0,
                    speed_fraction: 0.6,
                });
            }
        }
        runs
    }

    #[test]
    fn an_index_is_as_uncertain_as_its_correction_for_temperature() {
        let alarms = |colder: f64, own: f64| {
            let found = detect(&in_colder_room(colder, own), &DetectSettings::default()).anomalies;
            found.iter().map(|of| (of.kind, of.joint.map(JointIndex::index))).collect::<Vec<_>>()
        };
        let worn = vec![(AnomalyKind::Drift, Some(3))];
        assert_eq!(alarms(0.0, 0.08), worn);
        // a third more friction in the cold: three standard errors of 15 % of its logarithm are 0.13
        assert_eq!(alarms(0.33, 0.08), vec![]);
        assert_eq!(alarms(0.33, 0.20), worn);
        assert_eq!(alarms(-0.25, 0.08), vec![]);
    }

    #[test]
    fn a_worn_joint_is_found_beside_the_hall_and_alone() {
        for hall in [1.0, 0.93, 1.08] {
            let worn = |run: usize, j: usize| {
                let own = if j == 3 { 1.0 + 0.04 * run.saturating_sub(9) as f64 } else { 1.0 };
                own * if run >= 8 { hall } else { 1.0 }
            };
            let found = detect(&history(20, worn), &DetectSettings::default());
            let [anomaly] = &found.anomalies[..] else { panic!("one anomaly: {:?}", found.anomalies) };
            assert_eq!(anomaly.joint, Some(JointIndex::new(3)));
            assert_eq!(anomaly.kind, AnomalyKind::Drift, "{hall}: {}", anomaly.message);
        }
    }
}
