//! Parameters, friction and intervals of simulated arms, whose truth is known.

#![expect(clippy::expect_used, clippy::panic, reason = "functions that tests call")]

mod cycle_intervals;
mod load_friction;

use armwatch_method::analyse::Method;
use armwatch_method::model::base_parameters::BaseParameters;
use armwatch_model::analysis::finding::FindingKind;
use armwatch_model::analysis::settings::AnalysisSettings;
use armwatch_model::robot::{JointIndex, ParameterId, ParameterKind, Robot};
use armwatch_model::run::{Cycle, Samples};
use armwatch_simulate::{SimulationSettings, rows_of_run};
use armwatch_testing::{described, er3a, scara};

/// Six joints with horizontal and vertical axes, a SCARA with a sliding joint, and seven joints at odd angles.
fn arms() -> [Robot; 3] {
    [er3a(), scara(), described(include_str!("../../../../tests/reference/seven_joints.toml"))]
}

fn method(robot: Robot) -> Method {
    let accept = FindingKind::ALL.into_iter().collect();
    Method::new(robot, AnalysisSettings { accept, ..AnalysisSettings::default() }).expect("base parameters")
}

/// The cycles of a run as its export has them.
fn cycles(robot: &Robot, settings: &SimulationSettings, run: u32) -> Vec<Cycle> {
    let n = robot.joint_count();
    let mut cycles: Vec<Cycle> = Vec::new();
    rows_of_run(robot, settings, run, |row| {
        if cycles.last().is_none_or(|cycle| cycle.number != row.cycle) {
            let samples = Samples {
                position: vec![Vec::new(); n],
                velocity: Some(vec![Vec::new(); n]),
                torque: vec![Vec::new(); n],
                friction_signal: Some(Vec::new()),
                ..Samples::default()
            };
            cycles.push(Cycle { number: row.cycle, samples });
        }
        let Some(Cycle { samples, .. }) = cycles.last_mut() else { return };
        samples.time.push(row.time);
        samples.stage.push(row.stage);
        for j in 0..n {
            samples.position[j].push(row.position[j]);
            samples.torque[j].push(row.torque[j]);
            samples.velocity.iter_mut().for_each(|velocity| velocity[j].push(row.velocity[j]));
        }
        samples.friction_signal.iter_mut().for_each(|signal| signal.push(row.signal));
    })
    .expect("an arm that can be simulated");
    cycles
}

/// True base values of what the simulator moves; `None` for friction under load.
fn truth(robot: &Robot, base: &BaseParameters) -> Vec<Option<f64>> {
    let nominal = |joint: JointIndex| robot.joints[joint.index()].nominal.expect("nominal parameters");
    let phi: Vec<f64> = ParameterId::natural_order(robot)
        .iter()
        .map(|id| match id.kind {
            ParameterKind::Inertial(k) => nominal(id.joint).inertial.0[usize::from(k)],
            ParameterKind::MotorInertia => nominal(id.joint).motor_inertia,
            ParameterKind::Friction(term) => term.nominal(&nominal(id.joint).friction).unwrap_or(0.0),
            ParameterKind::Coupling(_) | ParameterKind::Spring(_) | ParameterKind::Crank(_) => 0.0,
        })
        .collect();
    let is_known = |id: &ParameterId| !matches!(id.kind, ParameterKind::Friction(term) if term.is_of_load());
    base.group(&phi).into_iter().zip(&base.kept).map(|(value, id)| is_known(id).then_some(value)).collect()
}
