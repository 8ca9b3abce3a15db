//! Low-pass of regressor columns with jumps. Coulomb friction jumps at a reversal of the motion. The low-pass smooths
//! the jump in the measured torque, so the columns with jumps pass the same low-pass: both sides of `tau = w theta` are
//! filtered equally (Gautier 1997, Dynamic identification of robots with power model). Friction under load jumps in the
//! same way, by the load of a model. The other columns are smooth functions of channels that are already filtered.

use crate::lanes::{LANES, Lanes};
use crate::model::actuator::coupling_columns;
use crate::model::dynamics::DynamicModel;
use crate::model::regressor::{Regressor, load_places};
use crate::model::regressor_lanes::RegressorLanes;
use crate::signal::filter::FilteredSignals;
use armwatch_model::robot::{CouplingTerm, JointIndex, MAX_JOINTS, ParameterId, ParameterKind, Robot};

/// Low-passed regressor column with jumps, in the rows of one joint.
#[derive(Debug, Clone, PartialEq)]
pub struct FilteredColumn {
    /// The parameter.
    pub id: ParameterId,
    /// Column of the parameter in natural order.
    pub column: usize,
    /// Joint to whose torque it belongs.
    pub joint: JointIndex,
    /// Torque per unit of the parameter `[rows]`.
    pub values: Vec<f64>,
}

/// All regressor columns of a robot with jumps, low-passed over the rows of a cycle.
#[must_use]
pub fn filtered_coulomb_columns(robot: &Robot, filtered: &FilteredSignals) -> Vec<FilteredColumn> {
    let order = ParameterId::natural_order(robot);
    let column_of = |id: ParameterId| order.iter().position(|of| *of == id);
    let (mut found, mut raw): (Vec<FilteredColumn>, Vec<Vec<f64>>) = (Vec::new(), Vec::new());
    let mut add = |id: ParameterId, joint: JointIndex, series: Vec<f64>| {
        if let Some(column) = column_of(id) {
            found.push(FilteredColumn { id, column, joint, values: Vec::new() });
            raw.push(series);
        }
    };
    for joint in robot.joint_indices() {
        let model = robot.friction_of(joint);
        let qd = &filtered.qd[joint.index()];
        for (place, &term) in model.terms().iter().enumerate().filter(|(_, term)| term.jumps()) {
            let id = ParameterId { joint, kind: ParameterKind::Friction(term) };
            let mut values = filtered.room();
            values.extend(qd.iter().map(|qd| model.columns(*qd)[place]));
            add(id, joint, values);
        }
    }
    for coupling in &robot.couplings {
        let id =
            ParameterId { joint: coupling.motor_joint, kind: ParameterKind::Coupling(CouplingTerm::Coulomb) };
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
        add(id, coupling.joint, series(filtered, |row| at(row).joint[2]));
        add(id, coupling.motor_joint, series(filtered, |row| at(row).motor_joint[2]));
    }
    for (column, values) in found.iter_mut().zip(filtered.low_passed(&raw)) {
        column.values = values;
    }
    filtered.give_back(raw);
    found
}

/// Columns of friction under load, low-passed over the rows of a cycle, with the load of `model` in this motion.
#[must_use]
pub fn filtered_load_columns(
    robot: &Robot,
    filtered: &FilteredSignals,
    model: &DynamicModel,
) -> Vec<FilteredColumn> {
    let (mut found, mut raw): (Vec<FilteredColumn>, Vec<Vec<f64>>) = (Vec::new(), Vec::new());
    let loads = gear_loads(robot, filtered, model);
    for (joint, first) in load_places(robot) {
        let (j, friction) = (joint.index(), robot.friction_of(joint));
        for (k, &term) in friction.load.terms().iter().enumerate() {
            let id = ParameterId { joint, kind: ParameterKind::Friction(term) };
            found.push(FilteredColumn { id, column: first + k, joint, values: Vec::new() });
            let mut values = filtered.room();
            let rows = loads[j].iter().zip(&filtered.qd[j]);
            values.extend(rows.map(|(load, qd)| friction.load_columns(*load, *qd)[k]));
            raw.push(values);
        }
    }
    for (column, values) in found.iter_mut().zip(filtered.low_passed(&raw)) {
        column.values = values;
    }
    filtered.give_back(raw);
    filtered.give_back(loads);
    found
}

/// Torque on each gear by `model`, `[n][rows]`, Nm (N).
fn gear_loads(robot: &Robot, filtered: &FilteredSignals, model: &DynamicModel) -> Vec<Vec<f64>> {
    let n = robot.joint_count();
    let mut loads: Vec<Vec<f64>> = (0..n).map(|_| filtered.room()).collect();
    let [mut q, mut qd, mut qdd, mut tau, mut load] = [[0.0; MAX_JOINTS]; 5];
    for row in 0..filtered.rows() {
        filtered.row(row, &mut q[..n], &mut qd[..n], &mut qdd[..n], &mut tau[..n]);
        model.gear_load(robot, &q[..n], &qd[..n], &qdd[..n], &mut load[..n]);
        loads.iter_mut().zip(load).for_each(|(loads, load)| loads.push(load));
    }
    loads
}

fn series(filtered: &FilteredSignals, value: impl Fn(usize) -> f64) -> Vec<f64> {
    let mut series = filtered.room();
    series.extend((0..filtered.rows()).map(value));
    series
}

/// Writes the low-passed values of `row` into its regressor.
pub fn write_filtered_columns(columns: &[FilteredColumn], row: usize, y: &mut Regressor) {
    for of in columns {
        y.set(of.joint.index(), of.column, of.values[row]);
    }
}

/// Writes the low-passed values of several rows, one per lane, into their regressor.
pub(crate) fn write_filtered_lanes(
    columns: &[FilteredColumn],
    rows: &[usize; LANES],
    y: &mut RegressorLanes,
) {
    for of in columns {
        y.set(of.joint.index(), of.column, Lanes(rows.map(|row| of.values[row])));
    }
}
