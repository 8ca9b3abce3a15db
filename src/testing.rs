//! What several unit tests share.

use nalgebra::Vector3;

use crate::robot::{
    Joint, JointKind, JointLimits, ModifiedDh, NominalJoint, Robot, StandardParameters, WarmUpShape,
};

fn table(text: &str) -> Vec<Vec<f64>> {
    text.lines().skip(1).map(|l| l.split(',').map(|c| c.parse().expect("a number")).collect()).collect()
}

/// The ER3A with the inertia of the reference data.
pub fn er3a() -> Robot {
    let geometry = table(include_str!("../tests/reference/geometry.csv"));
    let inertia = table(include_str!("../tests/reference/er3a_inertial_parameters.csv"));
    let joints = geometry
        .iter()
        .zip(&inertia)
        .map(|(g, p)| Joint {
            kind: JointKind::Revolute,
            geometry: ModifiedDh {
                a: g[1],
                alpha: g[2].to_radians(),
                d: g[3],
                theta_offset: g[4].to_radians(),
            },
            limits: JointLimits {
                position_min: g[5].to_radians(),
                position_max: g[6].to_radians(),
                velocity: g[7].to_radians(),
                acceleration: g[8].to_radians(),
            },
            gear_ratio: g[10],
            rated_motor_torque: Some(g[9]),
            low_speed: 0.02,
            nominal: Some(NominalJoint {
                inertial: StandardParameters(p[1..11].try_into().expect("ten parameters")),
                motor_inertia: p[11],
                friction: [1.0, 8.0, -1.0, 0.2],
                warm_up: WarmUpShape { b: 0.3, t1: 1500.0, c: 0.3, t2: 200.0 },
                torque_noise: 0.3,
            }),
        })
        .collect();
    Robot {
        model: "er3a".into(),
        joints,
        gravity: Vector3::new(0.0, 0.0, -9.81),
        speed_levels: vec![0.05, 0.2, 0.4, 0.6, 0.8, 1.0],
        excitation: None,
    }
}
