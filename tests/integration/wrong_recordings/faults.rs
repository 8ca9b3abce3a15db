//! Errors of people and loggers, one at a time.

use super::arms::shipped;
use armwatch_model::robot::{DhParameters, GeometrySource, JointGeometry, Robot, Transform, UrdfOrigin};
use armwatch_model::run::{Samples, Stage};

pub const DEGREES: f64 = 180.0 / std::f64::consts::PI;

pub fn scale(channel: &mut [f64], factor: f64) {
    channel.iter_mut().for_each(|x| *x *= factor);
}

pub fn velocity(samples: &mut Samples) -> Option<&mut Vec<Vec<f64>>> {
    samples.velocity.as_mut()
}

/// Delays the torque channels by `delay` s.
pub fn delayed(samples: &mut Samples, delay: f64) {
    let rate = (samples.rows() - 1) as f64 / (samples.time[samples.rows() - 1] - samples.time[0]);
    let shift = (delay * rate).round() as usize;
    for torque in &mut samples.torque {
        let first = torque[0];
        torque.truncate(torque.len() - shift);
        torque.splice(0..0, std::iter::repeat_n(first, shift));
    }
}

/// An error in a recording.
pub struct Wrong {
    pub name: &'static str,
    pub spoil: fn(&mut Samples, usize),
}

pub const WRONG_RECORDINGS: &[Wrong] = &[
    Wrong {
        name: "joint 2 still",
        spoil: |s, _| {
            let at = s.position[1][0];
            s.position[1].fill(at);
            if let Some(v) = velocity(s) {
                v[1].fill(0.0);
            }
        },
    },
    Wrong {
        name: "constant speed, joint 1",
        spoil: |s, _| {
            for row in 0..s.rows() {
                let phase = (s.time[row] / 4.0).fract();
                let (q, qd) = if phase < 0.5 { (2.0 * phase - 0.5, 0.5) } else { (1.5 - 2.0 * phase, -0.5) };
                s.position[0][row] = q;
                if let Some(v) = velocity(s) {
                    v[0][row] = qd;
                }
            }
        },
    },
    Wrong {
        name: "short: 2 s of excitation",
        spoil: |s, _| {
            let start = s.stage.iter().position(|stage| *stage == Stage::Excitation).expect("an excitation");
            let at = s.time[start] + 2.0;
            let rows = s.time.partition_point(|t| *t < at);
            *s = s.take_front(rows);
        },
    },
    Wrong { name: "saturated at 90 %", spoil: |s, _| saturate(s, 0.9) },
    Wrong { name: "saturated at 70 %", spoil: |s, _| saturate(s, 0.7) },
    Wrong { name: "saturated at 50 %", spoil: |s, _| saturate(s, 0.5) },
    Wrong { name: "saturated at 30 %", spoil: |s, _| saturate(s, 0.3) },
    Wrong { name: "positions 1, 2 swapped", spoil: |s, _| s.position.swap(0, 1) },
    Wrong { name: "positions of the last two swapped", spoil: |s, n| s.position.swap(n - 1, n - 2) },
    Wrong { name: "torques 1, 2 swapped", spoil: |s, _| s.torque.swap(0, 1) },
    Wrong { name: "torques of the last two swapped", spoil: |s, n| s.torque.swap(n - 1, n - 2) },
    Wrong {
        name: "velocities 1, 2 swapped",
        spoil: |s, _| {
            if let Some(v) = velocity(s) {
                v.swap(0, 1);
            }
        },
    },
    Wrong {
        name: "position and velocity swapped",
        spoil: |s, _| {
            if let Some(v) = s.velocity.take() {
                s.velocity = Some(std::mem::replace(&mut s.position, v));
            }
        },
    },
    Wrong { name: "torque 2 turned", spoil: |s, _| scale(&mut s.torque[1], -1.0) },
    Wrong { name: "all torques turned", spoil: |s, _| s.torque.iter_mut().for_each(|t| scale(t, -1.0)) },
    Wrong {
        name: "velocity 2 turned",
        spoil: |s, _| {
            if let Some(v) = velocity(s) {
                scale(&mut v[1], -1.0);
            }
        },
    },
    Wrong { name: "position 2 turned", spoil: |s, _| scale(&mut s.position[1], -1.0) },
    Wrong {
        name: "position and velocity 2 turned",
        spoil: |s, _| {
            scale(&mut s.position[1], -1.0);
            if let Some(v) = velocity(s) {
                scale(&mut v[1], -1.0);
            }
        },
    },
    Wrong {
        name: "axis 2 turned (all channels)",
        spoil: |s, _| {
            scale(&mut s.position[1], -1.0);
            scale(&mut s.torque[1], -1.0);
            if let Some(v) = velocity(s) {
                scale(&mut v[1], -1.0);
            }
        },
    },
    Wrong { name: "degrees read as radians", spoil: |s, _| units(s, DEGREES, DEGREES) },
    Wrong { name: "radians read as degrees", spoil: |s, _| units(s, 1.0 / DEGREES, 1.0 / DEGREES) },
    Wrong { name: "velocity in deg/s read as rad/s", spoil: |s, _| units(s, 1.0, DEGREES) },
    Wrong { name: "velocity in rpm read as rad/s", spoil: |s, _| units(s, 1.0, 30.0 / std::f64::consts::PI) },
    Wrong {
        name: "torque of the motor read as the joint's, 2",
        spoil: |s, _| scale(&mut s.torque[1], 1.0 / 100.0),
    },
    Wrong {
        name: "torque of the motors read as the joints'",
        spoil: |s, _| s.torque.iter_mut().zip(GEARS).for_each(|(t, gear)| scale(t, 1.0 / gear)),
    },
    Wrong {
        name: "torque in percent of rated",
        spoil: |s, _| s.torque.iter_mut().zip(RATED).for_each(|(t, rated)| scale(t, 100.0 / rated)),
    },
    Wrong { name: "motor side read as joint side", spoil: |s, _| motor_side(s) },
    Wrong { name: "torque 20 ms late", spoil: |s, _| delayed(s, 0.02) },
    Wrong { name: "torque 40 ms late", spoil: |s, _| delayed(s, 0.04) },
    Wrong { name: "torque 100 ms late", spoil: |s, _| delayed(s, 0.1) },
    Wrong { name: "clock 10 % fast", spoil: |s, _| scale(&mut s.time, 1.1) },
    Wrong { name: "clock twice as fast", spoil: |s, _| scale(&mut s.time, 2.0) },
    Wrong { name: "clock half as fast", spoil: |s, _| scale(&mut s.time, 0.5) },
    Wrong { name: "torque 3 constant", spoil: |s, _| s.torque[2].fill(3.25) },
    Wrong { name: "torque 3 zero", spoil: |s, _| s.torque[2].fill(0.0) },
    Wrong { name: "all torques zero", spoil: |s, _| s.torque.iter_mut().for_each(|t| t.fill(0.0)) },
];

/// Gear ratios and rated torques that differ from joint to joint, as is usual.
pub const GEARS: [f64; 6] = [121.0, 161.0, 101.0, 81.0, 50.0, 51.0];
pub const RATED: [f64; 6] = [160.0, 220.0, 80.0, 18.0, 21.0, 9.0];

pub fn saturate(samples: &mut Samples, part: f64) {
    let peak = samples.torque[1].iter().fold(0.0_f64, |peak, tau| peak.max(tau.abs()));
    samples.torque[1].iter_mut().for_each(|tau| *tau = tau.clamp(-part * peak, part * peak));
}

pub fn units(samples: &mut Samples, position: f64, speed: f64) {
    samples.position.iter_mut().for_each(|q| scale(q, position));
    if let Some(v) = velocity(samples) {
        v.iter_mut().for_each(|v| scale(v, speed));
    }
}

pub fn motor_side(samples: &mut Samples) {
    samples.torque.iter_mut().zip(GEARS).for_each(|(t, gear)| scale(t, 1.0 / gear));
    samples.position.iter_mut().zip(GEARS).for_each(|(q, gear)| scale(q, gear));
    if let Some(v) = velocity(samples) {
        v.iter_mut().zip(GEARS).for_each(|(v, gear)| scale(v, gear));
    }
}

/// An error in a description; `None` if it does not apply to the arm.
pub struct WrongDescription {
    pub name: &'static str,
    pub spoil: fn(&Robot) -> Option<Robot>,
}

pub fn rows(robot: &Robot) -> Option<Vec<DhParameters>> {
    robot.joints.iter().map(|joint| joint.geometry.dh_row()).collect()
}

/// The arm with another table, read in its own convention.
pub fn with_rows(robot: &Robot, rows: &[DhParameters]) -> Robot {
    let mut robot = robot.clone();
    if matches!(robot.joints[0].geometry.source(), GeometrySource::StandardDh(_)) {
        let (places, _) = JointGeometry::standard_dh(rows);
        robot.joints.iter_mut().zip(places).for_each(|(joint, place)| joint.geometry = place);
    } else {
        robot
            .joints
            .iter_mut()
            .zip(rows)
            .for_each(|(joint, row)| joint.geometry = JointGeometry::modified_dh(*row));
    }
    robot
}

pub fn edited(robot: &Robot, edit: impl FnOnce(&mut Vec<DhParameters>) -> Option<()>) -> Option<Robot> {
    let mut rows = rows(robot)?;
    edit(&mut rows)?;
    Some(with_rows(robot, &rows))
}

pub fn nth(rows: &[DhParameters], which: usize, of: impl Fn(&DhParameters) -> f64) -> Option<usize> {
    (0..rows.len()).filter(|&j| of(&rows[j]).abs() > 0.02).nth(which)
}

pub const WRONG_DESCRIPTIONS: &[WrongDescription] = &[
    WrongDescription {
        name: "the other DH convention",
        spoil: |robot| {
            let rows = rows(robot)?;
            let mut robot = robot.clone();
            if matches!(robot.joints[0].geometry.source(), GeometrySource::StandardDh(_)) {
                robot
                    .joints
                    .iter_mut()
                    .zip(&rows)
                    .for_each(|(j, row)| j.geometry = JointGeometry::modified_dh(*row));
            } else {
                let (places, _) = JointGeometry::standard_dh(&rows);
                robot.joints.iter_mut().zip(places).for_each(|(j, place)| j.geometry = place);
            }
            Some(robot)
        },
    },
    WrongDescription {
        name: "first length 20 % long",
        spoil: |robot| edited(robot, |rows| nth(rows, 0, |r| r.a).map(|j| rows[j].a *= 1.2)),
    },
    WrongDescription {
        name: "second length 20 % long",
        spoil: |robot| edited(robot, |rows| nth(rows, 1, |r| r.a).map(|j| rows[j].a *= 1.2)),
    },
    WrongDescription {
        name: "third length 20 % long",
        spoil: |robot| edited(robot, |rows| nth(rows, 2, |r| r.a).map(|j| rows[j].a *= 1.2)),
    },
    WrongDescription {
        name: "second d 20 % long",
        spoil: |robot| edited(robot, |rows| nth(rows, 1, |r| r.d).map(|j| rows[j].d *= 1.2)),
    },
    WrongDescription {
        name: "lengths swapped",
        spoil: |robot| {
            edited(robot, |rows| {
                let (i, j) = (nth(rows, 0, |r| r.a)?, nth(rows, 1, |r| r.a)?);
                let a = rows[i].a;
                rows[i].a = rows[j].a;
                rows[j].a = a;
                Some(())
            })
        },
    },
    WrongDescription {
        name: "first alpha of wrong sign",
        spoil: |robot| edited(robot, |rows| turned(rows, 0)),
    },
    WrongDescription {
        name: "second alpha of wrong sign",
        spoil: |robot| edited(robot, |rows| turned(rows, 1)),
    },
    WrongDescription {
        name: "third alpha of wrong sign",
        spoil: |robot| edited(robot, |rows| turned(rows, 2)),
    },
    WrongDescription { name: "90 deg at joint 2 missing", spoil: |robot| offset(robot, 1) },
    WrongDescription { name: "90 deg at joint 3 missing", spoil: |robot| offset(robot, 2) },
    WrongDescription { name: "90 deg at joint 5 missing", spoil: |robot| offset(robot, 4) },
    WrongDescription {
        name: "gravity turned over",
        spoil: |robot| Some(Robot { gravity: -robot.gravity, ..robot.clone() }),
    },
    WrongDescription {
        name: "gravity along x",
        spoil: |robot| Some(Robot { gravity: nalgebra::Vector3::new(9.81, 0.0, 0.0), ..robot.clone() }),
    },
    WrongDescription {
        name: "gravity 20 % small",
        spoil: |robot| Some(Robot { gravity: 0.8 * robot.gravity, ..robot.clone() }),
    },
    WrongDescription {
        name: "another robot",
        spoil: |robot| {
            let other = match robot.joint_count() {
                6 => shipped("tx40"),
                _ => return None,
            };
            let mut wrong = robot.clone();
            wrong.joints.iter_mut().zip(&other.joints).for_each(|(j, o)| j.geometry = o.geometry);
            Some(wrong)
        },
    },
];

pub fn turned(rows: &mut [DhParameters], which: usize) -> Option<()> {
    let twisted = |r: &DhParameters| r.alpha.sin();
    nth(rows, which, twisted).map(|j| rows[j].alpha *= -1.0)
}

pub fn offset(robot: &Robot, joint: usize) -> Option<Robot> {
    if robot.joint_count() <= joint || robot.joints[joint].kind == armwatch_model::robot::JointKind::Prismatic
    {
        return None;
    }
    let turn = Transform::about_z(std::f64::consts::FRAC_PI_2);
    let mut wrong = robot.clone();
    match rows(robot) {
        Some(mut rows) => {
            rows[joint].theta_offset += std::f64::consts::FRAC_PI_2;
            wrong = with_rows(robot, &rows);
        }
        None => {
            let placement = robot.joints[joint].geometry.placement().then(&turn);
            let origin = UrdfOrigin { xyz: [0.0; 3], rpy: [0.0; 3], axis: [0.0, 0.0, 1.0] };
            wrong.joints[joint].geometry = JointGeometry::urdf(placement, origin);
        }
    }
    Some(wrong)
}
