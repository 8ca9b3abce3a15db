//! First cycles of a test as a summary for the detectors: of a test that is still being written, or of a complete one
//! that is compared with it.

use crate::statistics::descriptive::{median, parameter_statistics};
use armwatch_model::analysis::cycle_friction::cycle_friction;
use armwatch_model::analysis::measurements::RunMeasurements;
use armwatch_model::analysis::{FrictionPoint, JointSummary, StatisticsWindow};
use armwatch_model::anomaly::{CycleSeries, RunParameter, RunSummary};
use armwatch_model::robot::{JointIndex, ParameterKind};

/// Summary of cycles 1 to `last_cycle` of a test: friction of each cycle, means of the inertial parameters, and the
/// median relative RMSD of each joint. Results that need the whole test, such as a friction index, are omitted.
///
/// `run` provides key, start, epochs and the meaning of its parameters; its other values are not read.
#[must_use]
pub fn first_cycles(run: &RunSummary, measurements: &RunMeasurements, last_cycle: u32) -> RunSummary {
    let measured = RunMeasurements {
        friction_points: kept(&measurements.friction_points, |of| of.cycle <= last_cycle),
        parameters: kept(&measurements.parameters, |of| of.cycle <= last_cycle),
        relative_rmsd: kept(&measurements.relative_rmsd, |of| of.cycle <= last_cycle),
        whole_cycle_rmsd: kept(&measurements.whole_cycle_rmsd, |of| of.cycle <= last_cycle),
        torque_noise: kept(&measurements.torque_noise, |of| of.cycle <= last_cycle),
    };
    let cycle_friction: Vec<CycleSeries> = measured
        .friction_points
        .chunk_by(|a, b| a.cycle == b.cycle)
        .flat_map(|of| {
            let points: Vec<FrictionPoint> = of.iter().map(|of| of.point).collect();
            let friction = cycle_friction(&points).into_iter();
            friction.map(move |friction| CycleSeries { cycle: of[0].cycle, friction })
        })
        .collect();
    let terms = |of: &RunParameter| {
        let known = run.parameters.iter().find(|known| known.id == of.id);
        known.map(|known| known.terms.clone()).unwrap_or_default()
    };
    let mut parameters: Vec<RunParameter> = measured
        .by_parameter()
        .into_iter()
        .filter(|(id, _)| matches!(id.kind, ParameterKind::Inertial(_)))
        .filter_map(|(id, values)| {
            let of = parameter_statistics(id, &values).into_iter();
            let of = of.into_iter().find(|of| of.window == StatisticsWindow::All)?;
            let (mean, std_dev) = (of.mean, of.sdv.unwrap_or(f64::NAN));
            let found = RunParameter { id, mean, std_dev, cycles: of.cycles.try_into().ok()?, terms: vec![] };
            Some(RunParameter { terms: terms(&found), ..found })
        })
        .collect();
    parameters.sort_by_key(|of| of.id);
    let rmsd = measured.rmsd_by_joint();
    let of_friction = cycle_friction.iter().map(|of| of.friction.joint);
    let last = of_friction.chain(rmsd.iter().map(|(joint, _)| *joint)).max();
    let joint = |joint: JointIndex| {
        let of_joint = rmsd.iter().filter(|(of, _)| *of == joint).flat_map(|(_, values)| values);
        JointSummary {
            joint,
            warm_friction: None,
            excitation_friction: None,
            half_speed_friction: None,
            friction_index: None,
            relative_rmsd: median(&of_joint.map(|(_, value)| *value).collect::<Vec<f64>>()),
            rmsd_swing: None,
            relative_noise: median(&measured.noise_of(joint)),
            torque_rms: median(&measured.torque_of(joint)),
        }
    };
    RunSummary {
        run_id: run.run_id,
        started_at: run.started_at,
        cycles: last_cycle,
        joints: (0..last.map_or(0, |last| last.index() + 1)).map(JointIndex::new).map(joint).collect(),
        cycle_friction,
        whole_cycle_rmsd: measured.whole_cycle_rmsd,
        parameters,
        response: run.response.clone(),
        epochs: run.epochs.clone(),
        ..RunSummary::default()
    }
}

fn kept<T: Clone>(all: &[T], is_kept: impl Fn(&T) -> bool) -> Vec<T> {
    all.iter().filter(|of| is_kept(of)).cloned().collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use armwatch_model::analysis::measurements::{CycleParameters, CyclePoint, CycleRmsd};
    use armwatch_model::analysis::{GravityRemoval, IdentifiedParameter};
    use armwatch_model::robot::ParameterId;

    fn measurements(cycles: u32) -> RunMeasurements {
        let joint = JointIndex::new(1);
        let id = ParameterId { joint, kind: ParameterKind::Inertial(1) };
        let friction = ParameterId { joint, kind: ParameterKind::MotorInertia };
        let point = |cycle: u32, direction: i8| FrictionPoint {
            joint,
            time: 60.0 * f64::from(cycle),
            speed_fraction: 0.5,
            speed: 1.0,
            direction,
            torque: f64::from(direction) * (10.0 - f64::from(cycle)) + 0.5,
            std: 0.1,
            samples: 100,
            gravity: GravityRemoval::Model,
            load: None,
        };
        let identified = |id: ParameterId, value: f64| IdentifiedParameter {
            id,
            value,
            std_error: 0.1,
            degrees_of_freedom: 100.0,
        };
        let mut found = RunMeasurements::default();
        for cycle in 1..=cycles {
            let points = [1, -1].map(|direction| CyclePoint { cycle, point: point(cycle, direction) });
            found.friction_points.extend(points);
            found.parameters.push(CycleParameters {
                cycle,
                minute: f64::from(cycle),
                mean_speeds: vec![],
                parameters: vec![identified(id, f64::from(cycle)), identified(friction, 7.0)],
            });
            found.relative_rmsd.push(CycleRmsd { cycle, joint, relative_rmsd: 0.01 * f64::from(cycle) });
            found.whole_cycle_rmsd.push(CycleRmsd { cycle, joint, relative_rmsd: 0.02 });
        }
        found
    }

    #[test]
    fn the_first_cycles_of_a_test_are_what_a_test_of_so_many_cycles_is() {
        let run = RunSummary { run_id: 7, epochs: vec![0, 2], ..RunSummary::default() };
        let found = first_cycles(&run, &measurements(9), 3);
        assert_eq!(found, first_cycles(&run, &measurements(3), 3));
        assert_eq!((found.run_id, found.cycles, &found.epochs), (7, 3, &vec![0, 2]));
        let friction: Vec<(u32, f64, f64)> = found
            .cycle_friction
            .iter()
            .map(|of| (of.cycle, of.friction.ln_torque.exp(), of.friction.offset))
            .collect();
        for ((cycle, torque, offset), wanted) in friction.iter().zip([9.0, 8.0, 7.0]) {
            assert!((torque - wanted).abs() < 1e-9 && (offset - 0.5).abs() < 1e-9, "{cycle} {torque}");
        }
        let [parameter] = &found.parameters[..] else { panic!("inertial ones alone: {found:?}") };
        assert_eq!((parameter.mean, parameter.std_dev, parameter.cycles), (2.0, 1.0, 3));
        assert_eq!(found.joints.len(), 2);
        assert_eq!(found.whole_cycle_rmsd.len(), 3);
        assert_eq!((found.joints[0].relative_rmsd, found.joints[1].relative_rmsd), (None, Some(0.02)));
    }

    #[test]
    fn what_a_parameter_stands_for_is_that_of_the_complete_test() {
        let id = ParameterId { joint: JointIndex::new(1), kind: ParameterKind::Inertial(1) };
        let terms = vec![(1.0, id)];
        let known = RunParameter { id, mean: 99.0, std_dev: 99.0, cycles: 9, terms: terms.clone() };
        let run = RunSummary { parameters: vec![known], ..RunSummary::default() };
        assert_eq!(first_cycles(&run, &measurements(4), 2).parameters[0].terms, terms);
    }

    #[test]
    fn a_test_without_figures_has_none() {
        let found = first_cycles(&RunSummary::default(), &RunMeasurements::default(), 2);
        assert_eq!(found, RunSummary { cycles: 2, ..RunSummary::default() });
    }
}
