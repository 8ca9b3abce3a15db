//! Arms for tests of the simulator.

use armwatch_model::robot::{FourierExcitation, Joint, JointKind, JointLimits, Robot, WarmUpShape};

/// The ER3A without its own excitation, and with round friction values.
pub fn er3a() -> Robot {
    let mut robot = armwatch_testing::er3a();
    robot.excitation = None;
    for nominal in robot.joints.iter_mut().filter_map(|joint| joint.nominal.as_mut()) {
        nominal.friction = [1.0, 8.0, -1.0, 0.2];
        nominal.warm_up = WarmUpShape { b: 0.3, t1: 1500.0, c: 0.3, t2: 200.0 };
        nominal.torque_noise = 0.3;
    }
    robot
}

/// The ER3A with the published excitation.
pub fn er3a_with_excitation() -> Robot {
    let text = include_str!("../../../tests/reference/excitation_fourier.csv");
    let rows: Vec<Vec<f64>> = text
        .lines()
        .skip(1)
        .map(|line| line.split(',').skip(1).map(|c| c.parse().unwrap()).collect())
        .collect();
    let transposed = |rows: &[Vec<f64>]| (0..6).map(|j| rows.iter().map(|r| r[j]).collect()).collect();
    let excitation = FourierExcitation {
        base_frequency: 0.1,
        a: transposed(&rows[..5]),
        b: transposed(&rows[5..10]),
        centre: rows[10].clone(),
    };
    Robot { excitation: Some(excitation), ..er3a() }
}

/// A single revolute joint.
pub fn one_joint() -> Robot {
    let mut robot = er3a();
    robot.joints.truncate(1);
    robot
}

/// The ER3A on a linear axis, with two more revolute joints after its flange.
pub fn nine_joints() -> Robot {
    let mut robot = er3a();
    let slide = Joint {
        kind: JointKind::Prismatic,
        limits: JointLimits {
            position_min: 0.2,
            position_max: 2.2,
            velocity: 1.2,
            acceleration: 3.0,
            jerk: None,
        },
        ..robot.joints[0].clone()
    };
    let extra = [robot.joints[3].clone(), robot.joints[4].clone()];
    robot.joints.insert(0, slide);
    robot.joints.extend(extra);
    robot
}
