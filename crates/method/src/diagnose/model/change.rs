//! Differences of a recording from its description and layout, as findings.

use nalgebra::Vector3;

use super::alternatives::gravity_text;
use super::causes::named;
use super::readings::ChannelReading;
use super::unmeasured::without_gravity;
use armwatch_model::analysis::finding::{Evidence, Finding, FindingKind, FindingSeverity};
use armwatch_model::robot::{JointIndex, Robot};

/// One change of channels, mounting or description.
#[derive(Debug, Clone)]
pub(super) enum ModelChange {
    /// Torques with the opposite sign.
    Turned(Vec<usize>),
    /// Two torques exchanged.
    Swapped(usize, usize),
    /// One torque recorded too large, with the factor.
    Scaled(usize, f64),
    /// Torques recorded too large, with their relative factors.
    Rescaled(Vec<f64>),
    /// Gravity in another direction, m/s².
    Mounted(Vector3<f64>),
    /// No gravity.
    Weightless,
    /// Another description, to be read after "with".
    Described(String, Box<Robot>),
}

impl ModelChange {
    /// Reading of a robot's recording with this change.
    pub(super) fn reading(&self, robot: &Robot) -> ChannelReading {
        let mut reading = ChannelReading::of(robot);
        match self {
            Self::Turned(joints) => joints.iter().for_each(|&joint| reading.scales[joint] = -1.0),
            Self::Swapped(a, b) => reading.order.swap(*a, *b),
            Self::Scaled(joint, scale) => reading.scales[*joint] = *scale,
            Self::Rescaled(scales) => reading.scales.clone_from(scales),
            Self::Mounted(gravity) => reading.robot.gravity = *gravity,
            Self::Weightless => reading.robot.gravity = Vector3::zeros(),
            Self::Described(_, other) => reading.robot = (**other).clone(),
        }
        reading
    }

    /// Findings of a change that leaves `ratio` of the squares of the torque error.
    pub(super) fn findings(&self, ratio: f64) -> Vec<Finding> {
        let left = 100.0 * ratio.sqrt();
        let finding = |kind, joint: Option<usize>, sentence: String| Finding {
            kind,
            severity: FindingSeverity::Refuse,
            joint: joint.map(JointIndex::new),
            sentence,
            evidence: vec![Evidence { name: "residual_ratio", value: ratio }],
        };
        let described = |joint, words: &str, remedy: &str| {
            let sentence = format!(
                "the torques contradict the description: with {words} the torque error would be {left:.0} % of what it is: \
                 {remedy}"
            );
            vec![finding(FindingKind::Description, joint, sentence)]
        };
        match self {
            Self::Turned(joints) => {
                let of_joint = |&joint: &usize| {
                    let sentence = format!(
                        "joint {}: its torque has the wrong sign: with the sign turned, the torque error of the arm would \
                         be {left:.0} % of what it is; turn the sign of the torque in the export layout",
                        JointIndex::new(joint)
                    );
                    finding(FindingKind::TorqueSign, Some(joint), sentence)
                };
                joints.iter().map(of_joint).collect()
            }
            Self::Swapped(a, b) => {
                let sentence = format!(
                    "{}: the torque of each follows the motion of the other; with the two exchanged, the torque error of \
                     the arm would be {left:.0} % of what it is: the torque columns, or position and velocity together, \
                     are swapped",
                    named(&[JointIndex::new(*a), JointIndex::new(*b)])
                );
                vec![finding(FindingKind::TorqueSwapped, Some(*a), sentence)]
            }
            Self::Scaled(joint, scale) => {
                let words = format!(
                    "the scale of the torque of joint {} = {scale:.3} in place of 1.000",
                    JointIndex::new(*joint)
                );
                let remedy = "check the unit (percent of rated, motor side, current), gain and gear ratio of that torque first";
                described(Some(*joint), &words, remedy)
            }
            Self::Rescaled(scales) => {
                let scales: Vec<String> = scales.iter().map(|scale| format!("{scale:.2}")).collect();
                let words = format!("torques recorded {} times as large as they are,", scales.join(", "));
                let remedy = "each torque has a unit of its own, as percent of the joint's rated torque is: check the \
                              unit of the torque (percent of rated, motor side, current) first";
                described(None, &words, remedy)
            }
            Self::Weightless => {
                let words =
                    format!("without it, the torque error of the arm would be {left:.0} % of what it is");
                vec![without_gravity(&words, ("residual_ratio", ratio))]
            }
            Self::Mounted(gravity) => described(
                None,
                &format!("{} (how the arm is mounted)", gravity_text(gravity)),
                "check that first",
            ),
            Self::Described(words, _) => described(None, words, "check that first"),
        }
    }
}
