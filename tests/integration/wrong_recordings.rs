//! Recordings and descriptions that are wrong in one way each, through the whole analysis: none may
//! give numbers that pass as good.

use std::convert::Infallible;

use armwatch::analysis::CycleAnalysis;
use armwatch::config::parse_robot;
use armwatch::numerics::analyse::{AnalysisSettings, Method, analyse_cycle};
use armwatch::numerics::plausible::delay::torque_delays;
use armwatch::numerics::plausible::description::{Evidenced, test_description};
use armwatch::numerics::signal::condition;
use armwatch::robot::{
    DhParameters, GeometrySource, JointGeometry, NominalJoint, Robot, StandardParameters, Transform,
    UrdfOrigin, WarmUpShape,
};
use armwatch::run::{Cycle, Samples, Stage};
use armwatch::simulate::recording::record;
use armwatch::simulate::{SimulationSettings, recording_of_run};

const DEGREES: f64 = 180.0 / std::f64::consts::PI;

/// An arm and how it is called in a failure.
struct Arm {
    name: &'static str,
    robot: Robot,
}

fn shipped(name: &str) -> Robot {
    let path = format!("{}/config/robots/{name}.toml", env!("CARGO_MANIFEST_DIR"));
    parse_robot(&path, &std::fs::read_to_string(&path).expect("a description"))
        .expect("the shipped description")
}

/// A body for each link of an arm whose description has none: rods along the next joint's offset.
fn with_bodies(mut robot: Robot) -> Robot {
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

/// The same arm in standard Denavit-Hartenberg rows, for tables whose first frame lies in the base.
fn in_standard_dh(mut robot: Robot) -> Robot {
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

/// The same arm as a URDF file gives it.
fn as_urdf(mut robot: Robot) -> Robot {
    for joint in &mut robot.joints {
        let placement: Transform = *joint.geometry.placement();
        let origin = UrdfOrigin { xyz: placement.translation.into(), rpy: [0.0; 3], axis: [0.0, 0.0, 1.0] };
        joint.geometry = JointGeometry::urdf(placement, origin);
    }
    robot
}

fn arms() -> Vec<Arm> {
    vec![
        Arm { name: "er3a", robot: shipped("er3a") },
        Arm { name: "scara", robot: shipped("scara") },
        Arm { name: "ur10e, standard DH", robot: in_standard_dh(with_bodies(shipped("ur10e"))) },
        Arm { name: "er3a, URDF", robot: as_urdf(shipped("er3a")) },
    ]
}

/// The excitation stage of a cold arm as the simulator records it: friction with a bump at low speed,
/// ripple and warm-up, noise and steps of the sensors.
fn excitation(robot: &Robot, seed: u64, rate: f64) -> Samples {
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

fn analysed(described: &Robot, samples: &Samples) -> CycleAnalysis {
    let method = Method::new(described.clone(), AnalysisSettings::default()).expect("base parameters");
    analyse_cycle(&method, &Cycle { number: 1, samples: samples.clone() })
}

fn scale(channel: &mut [f64], factor: f64) {
    channel.iter_mut().for_each(|x| *x *= factor);
}

fn velocity(samples: &mut Samples) -> Option<&mut Vec<Vec<f64>>> {
    samples.velocity.as_mut()
}

/// The torque channels `delay` s later.
fn delayed(samples: &mut Samples, delay: f64) {
    let rate = (samples.rows() - 1) as f64 / (samples.time[samples.rows() - 1] - samples.time[0]);
    let shift = (delay * rate).round() as usize;
    for torque in &mut samples.torque {
        let first = torque[0];
        torque.truncate(torque.len() - shift);
        torque.splice(0..0, std::iter::repeat_n(first, shift));
    }
}

/// What is wrong with a recording.
struct Wrong {
    name: &'static str,
    spoil: fn(&mut Samples, usize),
}

const WRONG_RECORDINGS: &[Wrong] = &[
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

/// Gear ratios and rated torques that differ from joint to joint, as they do.
const GEARS: [f64; 6] = [121.0, 161.0, 101.0, 81.0, 50.0, 51.0];
const RATED: [f64; 6] = [160.0, 220.0, 80.0, 18.0, 21.0, 9.0];

fn saturate(samples: &mut Samples, part: f64) {
    let peak = samples.torque[1].iter().fold(0.0_f64, |peak, tau| peak.max(tau.abs()));
    samples.torque[1].iter_mut().for_each(|tau| *tau = tau.clamp(-part * peak, part * peak));
}

fn units(samples: &mut Samples, position: f64, speed: f64) {
    samples.position.iter_mut().for_each(|q| scale(q, position));
    if let Some(v) = velocity(samples) {
        v.iter_mut().for_each(|v| scale(v, speed));
    }
}

fn motor_side(samples: &mut Samples) {
    samples.torque.iter_mut().zip(GEARS).for_each(|(t, gear)| scale(t, 1.0 / gear));
    samples.position.iter_mut().zip(GEARS).for_each(|(q, gear)| scale(q, gear));
    if let Some(v) = velocity(samples) {
        v.iter_mut().zip(GEARS).for_each(|(v, gear)| scale(v, gear));
    }
}

/// What is wrong with a description; `None` where it does not apply to the arm.
struct WrongDescription {
    name: &'static str,
    spoil: fn(&Robot) -> Option<Robot>,
}

fn rows(robot: &Robot) -> Option<Vec<DhParameters>> {
    robot.joints.iter().map(|joint| joint.geometry.dh_row()).collect()
}

/// The arm with another table, read in the convention of its own.
fn with_rows(robot: &Robot, rows: &[DhParameters]) -> Robot {
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

fn edited(robot: &Robot, edit: impl FnOnce(&mut Vec<DhParameters>) -> Option<()>) -> Option<Robot> {
    let mut rows = rows(robot)?;
    edit(&mut rows)?;
    Some(with_rows(robot, &rows))
}

fn nth(rows: &[DhParameters], which: usize, of: impl Fn(&DhParameters) -> f64) -> Option<usize> {
    (0..rows.len()).filter(|&j| of(&rows[j]).abs() > 0.02).nth(which)
}

const WRONG_DESCRIPTIONS: &[WrongDescription] = &[
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

fn turned(rows: &mut [DhParameters], which: usize) -> Option<()> {
    let twisted = |r: &DhParameters| r.alpha.sin();
    nth(rows, which, twisted).map(|j| rows[j].alpha *= -1.0)
}

fn offset(robot: &Robot, joint: usize) -> Option<Robot> {
    if robot.joint_count() <= joint || robot.joints[joint].kind == armwatch::robot::JointKind::Prismatic {
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

/// What became of a recording, for the matrix that a person reads.
fn verdict(analysis: &CycleAnalysis) -> String {
    let rmsd = || {
        let of = |v: &armwatch::analysis::TorqueRmsd| v.moving_rows.relative;
        let all: Vec<String> = analysis
            .verification
            .iter()
            .filter(|v| v.scope == armwatch::analysis::RmsdScope::Stage(Stage::Excitation))
            .map(|v| format!("{:.3}", of(v)))
            .collect();
        all.join(" ")
    };
    let told: Vec<&String> = analysis.remarks.iter().filter(|r| !r.contains("stage")).collect();
    match &analysis.identification {
        Err(reason) => format!("refused: {reason}"),
        Ok(_) if told.is_empty() => format!("PASSES [{}]", rmsd()),
        Ok(_) => format!("told [{}]: {told:?}", rmsd()),
    }
}

fn probe(described: &Robot, samples: &Samples) -> String {
    let method = Method::new(described.clone(), AnalysisSettings::default()).expect("base parameters");
    let Ok(conditioned) = condition(samples, 12.0) else { return "no".into() };
    let rows: Vec<usize> = conditioned
        .usable
        .iter()
        .flat_map(Clone::clone)
        .filter(|&row| samples.stage[row] == Stage::Excitation)
        .collect();
    let factored = armwatch::numerics::factors::factor_cycle(
        described,
        &method.columns,
        &method.base.kept_columns,
        &conditioned,
        samples,
    );
    let factor = armwatch::numerics::factors::stacked(
        &method.columns,
        factored.factors.iter().filter(|of| armwatch::numerics::factors::identifies(of.stage, of.motion)),
    );
    let found = match armwatch::numerics::identify::identify(
        &method.base.kept,
        &factor,
        described.joint_count(),
        conditioned.independent_fraction(),
    ) {
        Ok(found) => found,
        Err(error) => return error.to_string(),
    };
    let theta: Vec<f64> = found.parameters.iter().map(|p| p.value).collect();
    let rmsd = armwatch::numerics::verify::torque_rmsd(&method.columns, &factored.factors, &theta);
    let noise: Vec<f64> = rmsd
        .iter()
        .filter(|v| v.scope == armwatch::analysis::RmsdScope::Stage(Stage::Excitation))
        .map(|v| v.moving_rows.value)
        .collect();
    let evidenced = Evidenced::new(&conditioned, &rows, noise);
    let delays: Vec<String> =
        torque_delays(described, &method.columns, &method.base.kept_columns, &conditioned, &rows)
            .iter()
            .map(|d| format!("{}:{:.1}ms/{:.2}", d.joint, 1e3 * d.delay, d.residual_ratio))
            .collect();
    let Some(test) = test_description(described, &method.base.kept_columns, &found, &evidenced) else {
        return "no test".into();
    };
    let scores: Vec<String> = test
        .scores
        .iter()
        .take(4)
        .map(|s| format!("{}: {:.3}±{:.3} ({:.2})", s.number, s.change, s.std_error, s.share))
        .collect();
    format!(
        "share {:.3} F {:.0} {:?} | {} | {} | absorbed {}",
        test.share,
        test.f,
        test.freedom,
        scores.join(", "),
        delays.join(" "),
        test.absorbed.len()
    )
}

#[test]
#[ignore = "prints the matrix"]
fn matrix() {
    for arm in arms() {
        for rate in [50.0, 250.0] {
            let healthy = excitation(&arm.robot, 1, rate);
            for with in [true, false] {
                let mut samples = healthy.clone();
                if !with {
                    samples.velocity = None;
                }
                println!("# {} {rate} Hz, velocity {with}", arm.name);
                println!(
                    "healthy | {} | {}",
                    verdict(&analysed(&arm.robot, &samples)),
                    probe(&arm.robot, &samples)
                );
                for wrong in WRONG_DESCRIPTIONS {
                    let Some(described) = (wrong.spoil)(&arm.robot) else { continue };
                    println!(
                        "{} | {} | {}",
                        wrong.name,
                        verdict(&analysed(&described, &samples)),
                        probe(&described, &samples)
                    );
                }
                for wrong in WRONG_RECORDINGS {
                    let mut spoilt = samples.clone();
                    (wrong.spoil)(&mut spoilt, arm.robot.joint_count());
                    println!(
                        "{} | {} | {}",
                        wrong.name,
                        verdict(&analysed(&arm.robot, &spoilt)),
                        probe(&arm.robot, &spoilt)
                    );
                }
            }
        }
    }
}

#[test]
#[ignore = "prints what healthy arms show, 20 seeds"]
fn healthy_matrix() {
    for arm in arms() {
        for rate in [50.0, 100.0, 250.0, 500.0] {
            for seed in 1..=20 {
                let mut samples = excitation(&arm.robot, seed, rate);
                if seed % 2 == 0 {
                    samples.velocity = None;
                }
                println!(
                    "{} {rate} Hz seed {seed} | {} | {}",
                    arm.name,
                    verdict(&analysed(&arm.robot, &samples)),
                    probe(&arm.robot, &samples)
                );
            }
        }
    }
}
