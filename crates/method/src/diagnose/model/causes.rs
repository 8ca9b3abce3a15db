//! Combination of findings: one sentence per cause. A fault at several joints is one sentence, the most likely cause
//! comes first, and consequences of a cause are not reported.

use super::nominal::InertiaRatio;
use armwatch_model::analysis::finding::{Evidence, Finding, FindingKind, FindingKinds, FindingSeverity};
use armwatch_model::robot::{JointIndex, Robot};

/// Largest number of sentences of a reason: a cause, and its evidence.
const SENTENCES: usize = 3;
/// Largest factor between the ratio of a joint's inertia and the value expected from its gear: nominal parameters are
/// no more accurate.
const GEAR_FACTOR: f64 = 4.0;

/// Kinds that a wrong channel, unit, sign or description causes in a model.
const CONSEQUENCES: [FindingKind; 5] = [
    FindingKind::FarFromNominal,
    FindingKind::NegativeFriction,
    FindingKind::NegativeInertia,
    FindingKind::Unexplained,
    FindingKind::TooFast,
];

/// Joints in words: "joint 3", "joints 1, 2 and 4". The caller writes "all 6 joints".
#[must_use]
pub fn named(joints: &[JointIndex]) -> String {
    let mut numbers: Vec<usize> = joints.iter().map(|joint| joint.number()).collect();
    numbers.sort_unstable();
    numbers.dedup();
    let texts: Vec<String> = numbers.iter().map(ToString::to_string).collect();
    match texts.split_last() {
        None => "the joints".into(),
        Some((only, [])) => format!("joint {only}"),
        Some((last, others)) => format!("joints {} and {last}", others.join(", ")),
    }
}

/// Reason for refusing a cycle, with the most likely cause first, and the setting that accepts it. `findings` are those
/// of severity refuse, at least one.
#[must_use]
pub fn reason(robot: &Robot, findings: &[Finding]) -> String {
    let mut sentences = sentences(robot, findings);
    sentences.truncate(SENTENCES);
    let causes = without_consequences(findings.to_vec());
    let kinds: FindingKinds = causes.iter().map(|finding| finding.kind).collect();
    let names: Vec<String> = FindingKind::ALL
        .iter()
        .filter(|kind| kinds.contains(**kind))
        .map(|kind| format!("\"{}\"", kind.name()))
        .collect();
    format!("{}; to take it anyway: [analysis] accept = [{}]", sentences.join("; "), names.join(", "))
}

/// One sentence per kind of finding, the most likely cause first.
#[must_use]
pub fn sentences(robot: &Robot, findings: &[Finding]) -> Vec<String> {
    let causes = without_consequences(findings.to_vec());
    let of_kind = |kind: FindingKind| -> Vec<&Finding> {
        causes.iter().filter(|finding| finding.kind == kind).collect()
    };
    FindingKind::ALL.into_iter().flat_map(|kind| together(robot, &of_kind(kind))).collect()
}

/// Findings without consequences of a refused or accepted one, the most likely cause first. A wrong channel, unit, sign
/// or description causes an impossible model, which is no second fault.
#[must_use]
pub fn without_consequences(mut findings: Vec<Finding>) -> Vec<Finding> {
    let refused = |kinds: &dyn Fn(FindingKind) -> bool| {
        findings.iter().any(|finding| finding.severity >= FindingSeverity::Accepted && kinds(finding.kind))
    };
    let caused = refused(&|kind| !CONSEQUENCES.contains(&kind));
    let explained = refused(&|kind| kind == FindingKind::MotorTorque);
    findings.retain(|finding| match finding.kind {
        FindingKind::MotorTorque => true,
        kind if CONSEQUENCES.contains(&kind) => !caused,
        _ => !explained,
    });
    findings.sort_by_key(|finding| (std::cmp::Reverse(finding.severity), finding.kind.rank()));
    findings
}

/// Findings of one kind: those about joints as one sentence, with the numbers of the first.
fn together(robot: &Robot, findings: &[&Finding]) -> Vec<String> {
    let (of_joints, others): (Vec<&&Finding>, Vec<&&Finding>) =
        findings.iter().partition(|finding| finding.joint.is_some());
    let mut told: Vec<String> = others.iter().map(|finding| finding.sentence.clone()).collect();
    let joints: Vec<JointIndex> = of_joints.iter().filter_map(|finding| finding.joint).collect();
    let body = |finding: &Finding| {
        let joint = finding.joint?;
        finding.sentence.strip_prefix(&format!("joint {joint}: ")).map(|body| (joint, body.to_owned()))
    };
    match (of_joints.as_slice(), of_joints.first().and_then(|first| body(first))) {
        ([], _) => {}
        ([_, _, ..], Some((joint, body))) => {
            let all = joints.len() == robot.joint_count();
            let which = if all { format!("all {} joints", joints.len()) } else { named(&joints) };
            told.push(format!("{which}, as joint {joint}: {body}"));
        }
        _ => told.extend(of_joints.iter().map(|finding| finding.sentence.clone())),
    }
    told
}

/// Finding that motor torques were recorded as joint torques: inertias are smaller by the gear ratios if positions are
/// the joints', and by their squares if positions are the motors' too.
#[must_use]
pub fn motor_torques(robot: &Robot, ratios: &[InertiaRatio]) -> Option<Finding> {
    let geared: Vec<(f64, f64)> = ratios
        .iter()
        .map(|of| (of.ratio, robot.joints[of.joint.index()].gear_ratio.abs()))
        .filter(|(_, gear)| *gear > GEAR_FACTOR * GEAR_FACTOR)
        .collect();
    if geared.len() < 2 || 2 * geared.len() <= robot.joint_count() {
        return None;
    }
    let fits = |power: i32| {
        geared.iter().all(|(ratio, gear)| {
            let off = ratio * gear.powi(power);
            *ratio > 0.0 && (1.0 / GEAR_FACTOR..=GEAR_FACTOR).contains(&off)
        })
    };
    let (words, key) = match (fits(1), fits(2)) {
        (true, _) => (
            "as their gear ratios would make them: the torques seem to be the motors'",
            "side = \"motor\" in the section [torque] of the export layout",
        ),
        (_, true) => (
            "as the squared gear ratios would make them: positions and torques seem to be the motors'",
            "side = \"motor\" in the sections [position], [velocity] and [torque] of the export layout",
        ),
        _ => return None,
    };
    let mut of_nominal: Vec<f64> = geared.iter().map(|(ratio, _)| ratio.recip()).collect();
    of_nominal.sort_unstable_by(f64::total_cmp);
    let middle = of_nominal[of_nominal.len() / 2];
    let digits = 10.0_f64.powf(middle.log10().floor());
    let rounded = (middle / digits).round() * digits;
    Some(Finding {
        kind: FindingKind::MotorTorque,
        severity: FindingSeverity::Refuse,
        joint: None,
        sentence: format!(
            "the inertias of {} are about 1/{rounded:.0} of nominal, {words}; set {key}",
            if geared.len() == robot.joint_count() {
                format!("all {} joints", geared.len())
            } else {
                format!("{} joints", geared.len())
            }
        ),
        evidence: vec![Evidence { name: "inertia_ratio", value: middle.recip() }],
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use armwatch_testing::er3a;

    fn finding(kind: FindingKind, joint: Option<usize>, sentence: &str) -> Finding {
        Finding {
            kind,
            severity: FindingSeverity::Refuse,
            joint: joint.map(JointIndex::new),
            sentence: sentence.into(),
            evidence: Vec::new(),
        }
    }

    #[test]
    fn one_fault_at_every_joint_is_one_sentence_without_what_follows_from_it() {
        let mut found: Vec<Finding> = (0..6)
            .map(|j| {
                finding(FindingKind::Unexplained, Some(j), &format!("joint {}: 80 % unexplained", j + 1))
            })
            .collect();
        found.extend((0..6).map(|j| {
            finding(FindingKind::TorqueSign, Some(j), &format!("joint {}: friction would drive it", j + 1))
        }));
        let reason = reason(&er3a(), &found);
        assert_eq!(
            reason,
            "all 6 joints, as joint 1: friction would drive it; to take it anyway: [analysis] accept = [\"torque_sign\"]"
        );
    }

    #[test]
    fn torques_of_the_motors_are_known_by_the_gear_ratios() {
        let robot = er3a();
        let ratios = |power: i32, off: f64| -> Vec<InertiaRatio> {
            let ratio = |joint: JointIndex| {
                let gear: f64 = robot.joints[joint.index()].gear_ratio;
                InertiaRatio { joint, ratio: off * gear.powi(-power) }
            };
            robot.joint_indices().map(ratio).collect()
        };
        let one = motor_torques(&robot, &ratios(1, 1.5)).expect("the motors'");
        assert!(
            one.sentence.contains("all 6 joints") && one.sentence.contains("side = \"motor\""),
            "{}",
            one.sentence
        );
        let two = motor_torques(&robot, &ratios(2, 0.8)).expect("the motors'");
        assert!(two.sentence.contains("squared"), "{}", two.sentence);
        assert_eq!(motor_torques(&robot, &ratios(0, 1.0)), None);
        assert_eq!(motor_torques(&robot, &ratios(1, 6.0)), None);
    }

    #[test]
    fn joints_are_named_in_order() {
        let joints = [3, 0, 1].map(JointIndex::new);
        assert_eq!(named(&joints), "joints 1, 2 and 4");
        assert_eq!(named(&joints[..1]), "joint 4");
    }
}
