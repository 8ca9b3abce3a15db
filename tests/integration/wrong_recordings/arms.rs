//! Simulated arms in several conventions, and their recordings.

use std::convert::Infallible;

use armwatch_config::parse_robot;
use armwatch_model::robot::{
    DhParameters, JointGeometry, NominalJoint, Robot, StandardParameters, Transform, UrdfOrigin, WarmUpShape,
};
use armwatch_model::run::{Samples, Stage};
use armwatch_simulate::run::record::record;
use armwatch_simulate::{SimulationSettings, recording_of_run};

/// An arm and its name in failures.
pub struct Arm {
    pub name: &'static str,
    pub robot: Robot,
}

pub fn shipped(name: &str) -> Robot {
    let path = format!("{}/config/robots/{name}.toml", env!("CARGO_MANIFEST_DIR"));
    parse_robot(&path, &std::fs::read_to_string(&path).expect("a description"))
        .expect("the shipped description")
}

/// A body for each link of an arm whose description has none: rods along the next joint's offset.
pub fn with_bodies(mut robot: Robot) -> Robot {
    let n = robot.joint_count();
    let reach: Vec<_> = (0..n)
        .map(|j| {
            robot
                .joints
                .get(j + 1)
                .map_or_else(Default::default, |next| next.geometry.placement().translation)
        })
        .collect();
    for (j, reach) in reach.into_iter().enumerate() {
        let mass = 9.0 / (1.0 + j as f64);
        let centre = 0.45 * reach + nalgebra::Vector3::new(0.01, -0.015, 0.02);
        let own = mass * 0.004;
        let about = |a: usize| own + mass * (centre.norm_squared() - centre[a] * centre[a]);
        let mixed = |a: usize, b: usize| -mass * centre[a] * centre[b];
        let scale = robot.joints[j].limits.velocity;
        let torque = 40.0 / (1.0 + j as f64);
        robot.joints[j].nominal = Some(NominalJoint {
            inertial: StandardParameters([
                mass,
                mass * centre.x,
                mass * centre.y,
                mass * centre.z,
                about(0),
                mixed(0, 1),
                mixed(0, 2),
                about(1),
                mixed(1, 2),
                about(2),
            ]),
            motor_inertia: 1.5 / (1.0 + j as f64).powi(2),
            friction: [0.15 * torque, 0.2 * torque / scale, 0.0, 0.0],
            warm_up: WarmUpShape { b: 0.3, t1: 1500.0, c: 0.3, t2: 200.0 },
            torque_noise: 0.005 * torque,
        });
    }
    robot
}

/// The same arm in standard Denavit-Hartenberg rows, for tables whose first frame is in the base.
pub fn in_standard_dh(mut robot: Robot) -> Robot {
    let rows: Vec<DhParameters> =
        robot.joints.iter().map(|j| j.geometry.dh_row().expect("a table")).collect();
    let standard: Vec<DhParameters> = (0..rows.len())
        .map(|j| {
            let next = rows.get(j + 1);
            DhParameters { a: next.map_or(0.0, |r| r.a), alpha: next.map_or(0.0, |r| r.alpha), ..rows[j] }
        })
        .collect();
    let (places, _) = JointGeometry::standard_dh(&standard);
    robot.joints.iter_mut().zip(places).for_each(|(joint, place)| joint.geometry = place);
    robot
}

/// The same arm in the form of a URDF file.
pub fn as_urdf(mut robot: Robot) -> Robot {
    for joint in &mut robot.joints {
        let placement: Transform = *joint.geometry.placement();
        let origin = UrdfOrigin { xyz: placement.translation.into(), rpy: [0.0; 3], axis: [0.0, 0.0, 1.0] };
        joint.geometry = JointGeometry::urdf(placement, origin);
    }
    robot
}

pub fn arms() -> Vec<Arm> {
    vec![
        Arm { name: "er3a", robot: shipped("er3a") },
        Arm { name: "scara", robot: shipped("scara") },
        Arm { name: "ur10e, standard DH", robot: in_standard_dh(with_bodies(shipped("ur10e"))) },
        Arm { name: "er3a, URDF", robot: as_urdf(shipped("er3a")) },
    ]
}

/// The excitation stage of a cold simulated arm: friction with a bump at low speed, ripple and warm-up, noise and
/// resolution of the sensors.
pub fn excitation(robot: &Robot, seed: u64, rate: f64) -> Samples {
    let settings = SimulationSettings {
        seed,
        cycles: 1,
        warming_s: 0.0,
        sample_rate_hz: rate,
        ..SimulationSettings::default()
    };
    let mut recording = recording_of_run(robot, &settings, 0).expect("a recording");
    let last =
        recording.plan.segments.iter().filter(|s| s.stage == Stage::Excitation).map(|s| s.start + s.duration);
    recording.plan.duration = last.fold(0.0, f64::max) + 0.5;
    let n = robot.joint_count();
    let mut samples = Samples {
        position: vec![Vec::new(); n],
        velocity: Some(vec![Vec::new(); n]),
        torque: vec![Vec::new(); n],
        ..Samples::default()
    };
    let done: Result<_, Infallible> = record(&recording, seed, 0, |row| {
        samples.time.push(row.time);
        samples.stage.push(row.stage);
        for j in 0..n {
            samples.position[j].push(row.position[j]);
            samples.velocity.as_mut().expect("velocity")[j].push(row.velocity[j]);
            samples.torque[j].push(row.torque[j]);
        }
        Ok(())
    });
    done.expect("nothing fails");
    samples
}
