//! Torque that identification leaves unexplained, over the cycles of a run: one panel per joint.

use std::collections::BTreeSet;

use super::figure::{Figure, Key, Look, Mark, Panel, RESIDUAL, Series, XAxis};
use armwatch_model::robot::JointIndex;

/// Residual of a joint in a cycle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CycleResidual {
    /// Number of the cycle, from 1.
    pub cycle: u32,
    /// The joint.
    pub joint: JointIndex,
    /// Root of the mean squared residual, Nm (N); NaN if unknown.
    pub residual_nm: f64,
}

/// Draws the residuals over the cycles.
pub fn residual_figure(residuals: &[CycleResidual], title: String, subtitle: String) -> Figure {
    let joints: BTreeSet<JointIndex> = residuals.iter().map(|of| of.joint).collect();
    let panel = |joint: JointIndex| Panel {
        title: format!("joint {joint}"),
        x_label: "cycle".into(),
        x_axis: XAxis::Count,
        y_label: "residual, Nm".into(),
        with_zero: true,
        series: vec![Series {
            name: format!("joint {joint}"),
            colour: RESIDUAL,
            mark: Mark::LineWithDots,
            points: (residuals.iter().filter(|of| of.joint == joint))
                .map(|of| [f64::from(of.cycle), of.residual_nm])
                .collect(),
        }],
        ..Panel::default()
    };
    let label = "root of the mean squared residual of a cycle".into();
    let legend = vec![Key { label, look: Look::Series(RESIDUAL, Mark::LineWithDots) }];
    Figure { title, subtitle, legend, panels: joints.into_iter().map(panel).collect(), columns: 2 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panel_a_joint_over_its_cycles() {
        let of =
            |cycle, joint, residual_nm| CycleResidual { cycle, joint: JointIndex::new(joint), residual_nm };
        let figure =
            residual_figure(&[of(1, 0, 0.5), of(2, 0, 0.4), of(1, 5, 0.1)], "t".into(), String::new());
        assert_eq!(figure.panels.len(), 2);
        assert_eq!(figure.panels[0].series[0].points, [[1.0, 0.5], [2.0, 0.4]]);
        assert_eq!(figure.panels[1].title, "joint 6");
    }
}
