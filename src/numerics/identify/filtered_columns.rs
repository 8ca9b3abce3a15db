//! Coulomb friction jumps where a motion turns round. The low-pass smears the jump in the measured
//! torque, so the columns that jump go through the same low-pass: both sides of `tau = w theta` are
//! filtered alike (Gautier 1997, Dynamic identification of robots with power model). The other
//! columns are smooth functions of channels that were filtered before.

use crate::numerics::model::actuator::coupling_columns;
use crate::numerics::model::regressor::Regressor;
use crate::numerics::signal::filter::FilteredSignals;
use crate::robot::{CouplingTerm, JointIndex, ParameterId, ParameterKind, Robot};

/// A column of the regressor that jumps, low-passed, in the rows of one joint.
#[derive(Debug, Clone, PartialEq)]
pub struct FilteredColumn {
    /// The parameter.
    pub id: ParameterId,
    /// Column of the parameter in natural order.
    pub column: usize,
    /// The joint whose torque it is part of.
    pub joint: JointIndex,
    /// Torque per unit of the parameter `[rows]`.
    pub values: Vec<f64>,
}

/// All columns of a robot's regressor that jump, low-passed over the rows of a cycle.
#[must_use]
pub fn filtered_coulomb_columns(robot: &Robot, filtered: &FilteredSignals) -> Vec<FilteredColumn> {
    let order = ParameterId::natural_order(robot);
    let column_of = |id: ParameterId| order.iter().position(|of| *of == id);
    let mut found = Vec::new();
    for joint in robot.joint_indices() {
        let model = robot.friction_of(joint);
        for (place, &term) in model.terms().iter().enumerate().filter(|(_, term)| term.jumps()) {
            let id = ParameterId { joint, kind: ParameterKind::Friction(term) };
            let raw = |row: usize| model.columns(filtered.qd[joint.index()][row])[place];
            found.extend(column_of(id).map(|column| filtered_column(filtered, id, column, joint, raw)));
        }
    }
    for coupling in &robot.couplings {
        let id =
            ParameterId { joint: coupling.motor_joint, kind: ParameterKind::Coupling(CouplingTerm::Coulomb) };
        let Some(column) = column_of(id) else { continue };
        let at = |row: usize| {
            let of =
                |channels: &[Vec<f64>]| channels.iter().map(|channel| channel[row]).collect::<Vec<f64>>();
            coupling_columns(
                coupling,
                robot.friction_of(coupling.motor_joint).law,
                &of(&filtered.qd),
                &of(&filtered.qdd),
            )
        };
        found.push(filtered_column(filtered, id, column, coupling.joint, |row| at(row).joint[2]));
        found.push(filtered_column(filtered, id, column, coupling.motor_joint, |row| at(row).motor_joint[2]));
    }
    found
}

/// Puts the low-passed values of `row` into its regressor.
pub fn write_filtered_columns(columns: &[FilteredColumn], row: usize, y: &mut Regressor) {
    for of in columns {
        y.set(of.joint.index(), of.column, of.values[row]);
    }
}

fn filtered_column(
    filtered: &FilteredSignals,
    id: ParameterId,
    column: usize,
    joint: JointIndex,
    raw: impl Fn(usize) -> f64,
) -> FilteredColumn {
    let series: Vec<f64> = (0..filtered.rows()).map(raw).collect();
    FilteredColumn { id, column, joint, values: filtered.low_passed(&series) }
}
