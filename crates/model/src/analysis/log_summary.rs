//! Summary of one log from its windows.

use super::median::median;
use super::work_evidence::{DEVIATION, JointEvidence, PRODUCTS};
use super::{FrictionExcess, JointCheck, ProductionJoint};
use crate::robot::JointIndex;

/// Largest ratio of a window's mean squared deviation to the median one. A window above it contains a contact or a stop
/// and is omitted.
const ODD_WINDOW: f64 = 4.0;
/// Fewest windows among which one may be omitted.
const FEWEST_WINDOWS: usize = 3;

/// The windows of one recording compared with one test, by joint: medians over the windows with motion of the joint.
/// The windows do not contain the test's own error.
///
/// Medians are used because single windows may contain a contact or a wait.
#[must_use]
pub fn summarise<'a>(checks: impl IntoIterator<Item = &'a [JointCheck]>) -> Vec<ProductionJoint> {
    let mut by_joint: Vec<(JointIndex, Vec<[f64; 3]>)> = Vec::new();
    for check in checks.into_iter().flatten() {
        let Some(friction) = check.friction.filter(|_| check.rmsd.moving_rows.samples > 0) else { continue };
        let figures = [check.rmsd.moving_rows.relative, friction.excess, friction.share];
        match by_joint.iter_mut().find(|(joint, _)| *joint == check.joint) {
            Some((_, windows)) => windows.push(figures),
            None => by_joint.push((check.joint, vec![figures])),
        }
    }
    by_joint.sort_unstable_by_key(|(joint, _)| *joint);
    let summary = |(joint, windows): (JointIndex, Vec<[f64; 3]>)| {
        let of = |figure: usize| median(&windows.iter().map(|of| of[figure]).collect::<Vec<_>>());
        Some(ProductionJoint {
            joint,
            windows: windows.len(),
            relative_rmsd: of(0)?,
            friction: FrictionExcess { excess: of(1)?, share: of(2)? },
            test_relative_rmsd: None,
        })
    };
    by_joint.into_iter().filter_map(summary).collect()
}

/// Evidence of a whole log from that of its windows, by joint: means over the rows of the windows that are not omitted.
#[must_use]
pub fn log_evidence(windows: &[Vec<JointEvidence>]) -> Vec<JointEvidence> {
    let joints = windows.iter().flatten().map(|of| of.joint.index() + 1).max().unwrap_or(0);
    let of_joint = |joint| {
        let own: Vec<&JointEvidence> = windows.iter().flatten().filter(|of| of.joint == joint).collect();
        let deviation = |of: &JointEvidence| of.product(DEVIATION, DEVIATION);
        let usual = median(&own.iter().map(|of| deviation(of)).collect::<Vec<_>>())?;
        let counts = |of: &&&JointEvidence| own.len() < FEWEST_WINDOWS || deviation(of) <= ODD_WINDOW * usual;
        let mut whole = JointEvidence { joint, windows: 0, samples: 0, products: [0.0; PRODUCTS] };
        for of in own.iter().filter(counts) {
            whole.windows += of.windows;
            whole.samples += of.samples;
            let share = of.samples as f64 / whole.samples as f64;
            for (mean, next) in whole.products.iter_mut().zip(of.products) {
                *mean += share * (next - *mean);
            }
        }
        (whole.samples > 0).then_some(whole)
    };
    (0..joints).map(JointIndex::new).filter_map(of_joint).collect()
}
