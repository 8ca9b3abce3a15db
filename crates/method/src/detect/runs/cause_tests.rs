//! Causes are distinguished on made-up histories. The friction of the arm's six joints falls as the arm warms. The
//! ambient temperature changes, and the parameters vary from run to run.

use std::cell::Cell;
use std::sync::Arc;

use jiff::{SignedDuration, Timestamp};

use super::*;
use armwatch_model::analysis::friction::CycleFriction;
use armwatch_model::analysis::response::{ChannelFault, ChannelResponse, FaultResponse, STRENGTHS};
use armwatch_model::analysis::{Estimate, JointSummary, RmsdSwing, WarmFriction};
use armwatch_model::anomaly::quantity::Quantity;
use armwatch_model::anomaly::{Alternative, Anomaly, AnomalyKind, CycleSeries, RunParameter, Severity};
use armwatch_model::robot::{ParameterId, ParameterKind};

pub(super) const JOINTS: usize = 6;
pub(super) const CYCLES: u32 = 8;
/// Places of mass and first moments among the standard parameters.
const MASS: u8 = 0;

/// Standard normal numbers, always the same.
struct Noise(Cell<u64>);

impl Noise {
    fn uniform(&self) -> f64 {
        let next =
            self.0.get().wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        self.0.set(next);
        ((next >> 11) as f64 + 0.5) / (1_u64 << 53) as f64
    }

    /// Box and Muller (1958).
    fn normal(&self) -> f64 {
        (-2.0 * self.uniform().ln()).sqrt() * (std::f64::consts::TAU * self.uniform()).cos()
    }
}

/// The faults of the arm in a run.
#[derive(Clone, Copy, Default)]
pub(super) struct State {
    /// Logarithm of the excess friction by joint and cycle.
    pub(super) friction: Option<fn(usize, u32) -> f64>,
    /// Scatter of the friction of a joint from cycle to cycle.
    pub(super) swing: Option<(usize, f64)>,
    /// Slow time constant of a joint as a multiple of the usual.
    pub(super) slower: Option<(usize, f64)>,
    /// Slow time constants of all joints as a multiple of the usual.
    pub(super) lubricant: Option<f64>,
    /// Offset of a joint's torque, Nm.
    pub(super) offset: Option<(usize, f64)>,
    /// Unexplained torque of a joint as a multiple of the usual.
    pub(super) unexplained: Option<(usize, f64)>,
    /// Joint and noise of its torque signal as a multiple of the usual; `None` if noise is not measured. Noise is
    /// usually half of the unexplained torque.
    pub(super) noise: Option<(usize, f64)>,
    /// Load, kg.
    pub(super) mass: f64,
    /// Logarithm of the friction of all joints at the start, due to the ambient temperature.
    pub(super) hall: f64,
}

/// Daily tests; `state` gives the faults in each.
pub(super) fn fleet(runs: i64, seed: u64, state: impl Fn(i64) -> State) -> Vec<RunSummary> {
    let noise = Noise(Cell::new(seed));
    (0..runs).map(|run| test(run, &noise, state(run))).collect()
}

fn test(run: i64, noise: &Noise, state: State) -> RunSummary {
    let hall = state.hall + 0.02 * noise.normal();
    let mut cycle_friction = Vec::new();
    let mut joints = Vec::new();
    for j in 0..JOINTS {
        let mut level = 0.0;
        for cycle in 1..=CYCLES {
            let minute = 3.1 * f64::from(cycle) - 1.2;
            let own = state.slower.filter(|of| of.0 == j).map(|of| of.1);
            let slow = 25.0 * own.or(state.lubricant).unwrap_or(1.0);
            let warm_up = 0.15 * (-minute / 5.0).exp() + 0.25 * (-minute / slow).exp();
            let wrong = state.friction.map_or(0.0, |of| of(j, cycle));
            let swing = state.swing.filter(|of| of.0 == j).map_or(0.0, |of| of.1 * noise.normal());
            let share = 0.8 + 0.06 * j as f64;
            level += (wrong + swing) / f64::from(CYCLES);
            cycle_friction.push(CycleSeries {
                cycle,
                friction: CycleFriction {
                    joint: JointIndex::new(j),
                    minute,
                    ln_torque: 2.0 + warm_up + share * hall + wrong + swing + 0.003 * noise.normal(),
                    offset: 0.01 * noise.normal()
                        + state.offset.filter(|of| of.0 == j).map_or(0.0, |of| of.1),
                    levels: 6,
                    speed_fraction: 0.45,
                },
            });
        }
        let unexplained = state.unexplained.filter(|of| of.0 == j).map_or(1.0, |of| of.1);
        joints.push(JointSummary {
            joint: JointIndex::new(j),
            warm_friction: None,
            excitation_friction: None,
            half_speed_friction: None,
            friction_index: Some(Estimate {
                value: (level + 0.003 * noise.normal()).exp(),
                std_error: 0.004,
            }),
            relative_rmsd: Some(0.02 * unexplained * (0.01 * noise.normal()).exp()),
            rmsd_swing: Some(RmsdSwing { value: 0.001, cycles: CYCLES as usize }),
            relative_noise: state
                .noise
                .map(|(of, ratio)| 0.01 * if of == j { ratio } else { 1.0 } * (0.01 * noise.normal()).exp()),
            torque_rms: None,
        });
    }
    RunSummary {
        run_id: run + 1,
        started_at: Timestamp::UNIX_EPOCH + SignedDuration::from_hours(24 * run),
        cycles: CYCLES,
        joints,
        cycle_friction,
        parameters: parameters(noise, state.mass),
        ..RunSummary::default()
    }
}

/// Parameters of links 2 to 6. They contain the last link's mass and first moments. The load is a point mass 0.1 m
/// above the last frame.
fn parameters(noise: &Noise, mass: f64) -> Vec<RunParameter> {
    let last = JointIndex::new(JOINTS - 1);
    let of_last = |place: u8| ParameterId { joint: last, kind: ParameterKind::Inertial(place) };
    let mut found = Vec::new();
    for link in 1..JOINTS {
        for place in 1..4_u8 {
            let id = ParameterId { joint: JointIndex::new(link), kind: ParameterKind::Inertial(place) };
            let arm = 0.05 * f64::from(place) + 0.03 * link as f64;
            let terms = match place {
                1 => vec![(1.0, id), (arm, of_last(MASS))],
                2 => vec![(1.0, id), (-arm, of_last(MASS)), (-1.0, of_last(3))],
                _ => vec![(1.0, id)],
            };
            let load = match place {
                1 => arm * mass,
                2 => -arm * mass - 0.1 * mass,
                _ if link == JOINTS - 1 => 0.1 * mass,
                _ => 0.0,
            };
            let mean = 1.0 + load + 0.002 * noise.normal();
            found.push(RunParameter { id, mean, std_dev: 0.005, cycles: CYCLES, terms });
        }
    }
    found
}

pub(super) fn alarms(history: &[RunSummary]) -> Vec<Anomaly> {
    let found = detect(history, &DetectSettings::default()).anomalies;
    found.into_iter().filter(|of| of.severity > Severity::Info).collect()
}

/// The only alarm; checks its kind and joint number.
pub(super) fn only(history: &[RunSummary], kind: AnomalyKind, joint: Option<usize>) -> Anomaly {
    let found = alarms(history);
    let [alarm] = &found[..] else { panic!("one alarm: {found:#?}") };
    assert_eq!((alarm.kind, alarm.joint.map(JointIndex::number)), (kind, joint), "{alarm:#?}");
    assert!(alarm.odds.is_none_or(|odds| odds > 10.0), "{alarm:#?}");
    alarm.clone()
}

#[test]
fn healthy_arms_in_a_changing_hall_raise_nothing() {
    for seed in 1..=6 {
        let season = |run: i64| State { hall: 0.06 * (run as f64 / 9.0).sin(), ..State::default() };
        let history = fleet(60, seed, season);
        // for any number of known runs
        for runs in [1, 2, 3, 4, 5, 6, 8, 12, 25, 60] {
            assert_eq!(alarms(&history[..runs]), vec![], "seed {seed}, {runs} runs");
        }
    }
}

#[test]
fn a_step_inside_a_run_is_found_in_that_run_with_its_cycle() {
    let step = |joint: usize, cycle: u32| if joint == 1 && cycle >= 5 { 0.22 } else { 0.0 };
    let after = |joint: usize, _: u32| if joint == 1 { 0.22 } else { 0.0 };
    let state = |run: i64| State {
        friction: match run {
            0..=7 => None,
            8 => Some(step),
            _ => Some(after),
        },
        ..State::default()
    };
    for seed in 1..=4 {
        let history = fleet(14, seed, state);
        for runs in 9..=14 {
            let found = only(&history[..runs], AnomalyKind::Step, Some(2));
            assert_eq!(
                (found.onset.run_id, found.onset.cycle, found.first_run_id),
                (9, Some(5), 9),
                "{runs}"
            );
            assert!(rejects(&found, "no change"), "{runs}: {found:?}");
            assert!(!found.ended, "{runs}: {found:?}");
        }
    }
}

/// The detector watches the warm friction of the joint. Only a ratio is known inside the test that jumps; a torque is
/// known in later tests.
#[test]
fn a_step_of_warm_friction_is_a_ratio_inside_its_test_and_a_torque_after_it() {
    let step = |joint: usize, cycle: u32| if joint == 1 && cycle >= 5 { 0.22 } else { 0.0 };
    let after = |joint: usize, _: u32| if joint == 1 { 0.22 } else { 0.0 };
    let state = |run: i64| State {
        friction: match run {
            0..=7 => None,
            8 => Some(step),
            _ => Some(after),
        },
        ..State::default()
    };
    let mut history = fleet(14, 1, state);
    for joint in history.iter_mut().flat_map(|run| &mut run.joints) {
        let index = joint.friction_index.take().expect("an index");
        joint.warm_friction = Some(WarmFriction {
            torque: 12.0 * index.value,
            std_error: 12.0 * index.std_error,
            speed_fraction: 0.45,
            minute: 20.0,
        });
    }
    let found = only(&history[..9], AnomalyKind::Step, Some(2));
    assert_eq!((found.quantity, found.baseline), (Quantity::FrictionJumpRatio, 1.0), "{found:?}");
    assert!((found.value - 0.22_f64.exp()).abs() < 0.03, "{found:?}");
    let found = only(&history, AnomalyKind::Step, Some(2));
    assert_eq!(found.quantity, Quantity::WarmFriction, "{found:?}");
    for torque in [found.value, found.peak_value] {
        assert!((torque - 12.0 * 0.22_f64.exp()).abs() < 0.6, "{found:?}");
    }
    assert!((found.baseline - 12.0).abs() < 0.2, "{found:?}");
}

#[test]
fn a_step_while_the_baseline_is_learnt_is_no_part_of_it() {
    let step = |joint: usize, cycle: u32| if joint == 4 && cycle >= 4 { 0.22 } else { 0.0 };
    let after = |joint: usize, _: u32| if joint == 4 { 0.22 } else { 0.0 };
    let state = |run: i64| State {
        friction: match run {
            0..=1 => None,
            2 => Some(step),
            _ => Some(after),
        },
        ..State::default()
    };
    let history = fleet(14, 3, state);
    for runs in 3..=14 {
        let found = only(&history[..runs], AnomalyKind::Step, Some(5));
        assert_eq!((found.onset.run_id, found.onset.cycle), (3, Some(4)), "{runs}");
        assert!(!found.ended, "{runs}: {found:?}");
    }
}

#[test]
fn a_joint_that_always_swung_is_found_in_its_first_run() {
    for seed in 1..=4 {
        let history = fleet(8, seed, |_| State { swing: Some((4, 0.12)), ..State::default() });
        for runs in 1..=8 {
            only(&history[..runs], AnomalyKind::Oscillation, Some(5));
        }
    }
}

#[test]
fn a_plateau_that_is_missing_in_the_first_cycle_blinds_nothing() {
    let mut history = fleet(3, 2, |_| State { swing: Some((4, 0.12)), ..State::default() });
    let first = history[0].cycle_friction.iter_mut().find(|of| of.friction.joint.index() == 4);
    first.expect("a first cycle").friction.levels = 5;
    for runs in 1..=3 {
        only(&history[..runs], AnomalyKind::Oscillation, Some(5));
    }
}

#[test]
fn wear_that_begins_in_the_first_tests_is_found() {
    fn worn<const PERCENT: u32>(joint: usize, _: u32) -> f64 {
        if joint == 2 { f64::from(PERCENT) / 100.0 } else { 0.0 }
    }
    let levels: [fn(usize, u32) -> f64; 12] = [
        worn::<0>, worn::<4>, worn::<8>, worn::<12>, worn::<16>, worn::<20>, worn::<24>, worn::<28>,
        worn::<32>, worn::<36>, worn::<40>, worn::<44>,
    ];
    let state = |run: i64| State { friction: Some(levels[run as usize]), ..State::default() };
    for seed in 1..=4 {
        let history = fleet(12, seed, state);
        for runs in 9..12 {
            let found = only(&history[..runs], AnomalyKind::Drift, Some(3));
            assert!(found.first_run_id <= 9, "{seed}, {runs}: {found:?}");
        }
        let found = only(&history, AnomalyKind::Drift, Some(3));
        assert_eq!(found.severity, Severity::Critical, "{seed}: {found:?}");
    }
}

#[test]
fn a_joint_that_goes_on_swinging_keeps_its_alarm() {
    let arms = 12;
    let of_arm = |seed: u64| {
        let swings = |_| State { swing: Some((4, 0.12)), ..State::default() };
        let found = alarms(&fleet(25, seed, swings));
        let of_joint =
            |of: &&Anomaly| of.kind == AnomalyKind::Oscillation && of.quantity == Quantity::FrictionSwing;
        found.iter().filter(of_joint).count()
    };
    let episodes: Vec<usize> = (1..=arms).map(of_arm).collect();
    assert!(episodes.iter().all(|count| *count == 1), "{episodes:?}");
}

#[test]
fn a_warm_up_twice_as_slow_is_thermal_and_wear_is_drift() {
    let slower = |run: i64| State { slower: (run >= 7).then_some((3, 2.0)), ..State::default() };
    let found = only(&fleet(10, 5, slower), AnomalyKind::Thermal, Some(4));
    assert!((1.4..=3.0).contains(&found.value), "{found:?}");
    let worn = |run: i64| State {
        friction: match run - 6 {
            1 => Some(|j, _| if j == 2 { 0.04 } else { 0.0 }),
            2 => Some(|j, _| if j == 2 { 0.08 } else { 0.0 }),
            3 => Some(|j, _| if j == 2 { 0.12 } else { 0.0 }),
            4.. => Some(|j, _| if j == 2 { 0.16 } else { 0.0 }),
            _ => None,
        },
        ..State::default()
    };
    let found = only(&fleet(11, 6, worn), AnomalyKind::Drift, Some(3));
    assert!((7..=9).contains(&found.onset.run_id) && found.first_run_id <= 10, "{found:?}");
    assert!(rejects(&found, "no change") && rejects(&found, "another temperature at the start"), "{found:?}");
}

/// Returns true if an alarm has odds and lists `words` among its much less likely causes.
fn rejects(alarm: &Anomaly, words: &str) -> bool {
    let rejected = |of: &Alternative| of.cause == words && of.odds < 0.01;
    alarm.odds.is_some_and(|odds| odds > 100.0) && alarm.alternatives.iter().any(rejected)
}

#[test]
fn friction_that_is_higher_from_a_test_on_says_which_causes_were_rejected() {
    let higher = |run: i64| State {
        friction: (run >= 8).then_some(|j, _| if j == 2 { 0.1 } else { 0.0 }),
        ..State::default()
    };
    let found = only(&fleet(12, 4, higher), AnomalyKind::Step, Some(3));
    assert_eq!((found.onset.run_id, found.onset.cycle), (9, None), "{found:?}");
    assert!(rejects(&found, "no change") && rejects(&found, "another temperature at the start"), "{found:?}");
}

#[test]
fn a_load_is_one_alarm_of_the_arm_with_its_mass() {
    for mass in [0.8, -0.5] {
        let history =
            fleet(9, 7, |run| State { mass: if run >= 7 { mass } else { 0.0 }, ..State::default() });
        let found = only(&history[..8], AnomalyKind::Payload, None);
        assert!((found.value / mass - 1.0).abs() < 0.15, "{found:?}");
        assert_eq!(found.first_run_id, 8);
    }
}

#[test]
fn a_load_in_the_first_tests_hides_no_later_one() {
    let loaded = |run: i64| State {
        mass: if [1, 3].contains(&run) || run >= 7 { 0.8 } else { 0.0 },
        ..State::default()
    };
    for seed in 1..=4 {
        let history = fleet(9, seed, loaded);
        for runs in 8..=9 {
            let all = alarms(&history[..runs]);
            let open: Vec<&Anomaly> = all.iter().filter(|of| !of.ended).collect();
            let [found] = &open[..] else { panic!("one open alarm: {all:#?}") };
            assert_eq!((found.kind, found.first_run_id), (AnomalyKind::Payload, 8), "{found:#?}");
            assert!((found.value / 0.8 - 1.0).abs() < 0.15, "{found:#?}");
        }
    }
}

/// A lasting change during the learning of the baseline is reported with its own sign and from its first test.
#[test]
fn faults_from_the_third_test_on_are_no_part_of_the_baseline() {
    for (seed, size) in (1..=4).zip([0.8, -0.5, 3.0, 0.8]) {
        let mass = |run: i64| State { mass: if run >= 2 { size } else { 0.0 }, ..State::default() };
        let found = only(&fleet(9, seed, mass), AnomalyKind::Payload, None);
        assert!((found.value / size - 1.0).abs() < 0.15, "{found:#?}");
        assert_eq!((found.first_run_id, found.ended), (3, false), "{found:#?}");
        let offset = |run: i64| State { offset: (run >= 2).then_some((1, size)), ..State::default() };
        let found = only(&fleet(9, seed, offset), AnomalyKind::Sensor, Some(2));
        assert!((found.value / size - 1.0).abs() < 0.1, "{found:#?}");
        assert_eq!((found.first_run_id, found.ended), (3, false), "{found:#?}");
    }
    let stiff = |run: i64| State {
        friction: (run >= 2).then_some(|joint, _| if joint == 3 { 0.22 } else { 0.0 }),
        ..State::default()
    };
    for seed in 1..=4 {
        let found = only(&fleet(9, seed, stiff), AnomalyKind::Step, Some(4));
        assert!((found.value - 0.22_f64.exp()).abs() < 0.02, "{found:#?}");
        assert!(found.first_run_id <= 4 && !found.ended, "{found:#?}");
        assert_eq!((found.onset.run_id, found.onset.cycle), (3, None), "{found:#?}");
    }
    let noisy = |run: i64| State { noise: Some((2, if run >= 2 { 3.0 } else { 1.0 })), ..State::default() };
    let found = only(&fleet(9, 5, noisy), AnomalyKind::Sensor, Some(3));
    assert_eq!((found.first_run_id, found.ended), (3, false), "{found:#?}");
}

#[test]
fn friction_that_differs_between_the_directions_may_fall_as_a_whole() {
    // friction falls by a fifth, and so does the difference between the directions; no torque signal causes this
    let repaired = |run: i64| State {
        friction: (run >= 7).then_some(|joint, _| if joint == 2 { -0.22 } else { 0.0 }),
        offset: Some((2, if run >= 7 { 1.6 } else { 2.0 })),
        ..State::default()
    };
    for seed in 1..=4 {
        let found = detect(&fleet(11, seed, repaired), &DetectSettings::default()).anomalies;
        assert!(found.iter().all(|of| of.kind == AnomalyKind::Step), "{seed}: {found:#?}");
    }
    // an additional offset of the signal is found
    let offset = |run: i64| State { offset: Some((2, if run >= 7 { 3.0 } else { 2.0 })), ..State::default() };
    only(&fleet(11, 1, offset), AnomalyKind::Sensor, Some(3));
}

#[test]
fn a_load_whose_mass_no_joint_carries_is_a_load_without_a_mass() {
    let state = |run: i64| State { mass: if run >= 7 { 0.8 } else { 0.0 }, ..State::default() };
    let mut history = fleet(9, 7, state);
    for (run, of) in (0..).zip(&mut history) {
        // the last axis is vertical, so only its link's first moments across it are identified
        of.parameters.retain(|of| of.id.joint.index() == JOINTS - 1);
        for (parameter, sign) in of.parameters.iter_mut().zip([-1.0, 1.0, 0.0]) {
            let is_mass = |id: ParameterId| id.kind == ParameterKind::Inertial(MASS);
            let arm: f64 = parameter.terms.iter().filter(|of| is_mass(of.1)).map(|of| of.0.abs()).sum();
            parameter.mean += sign * arm * state(run).mass;
            parameter.terms.retain(|of| !is_mass(of.1));
        }
    }
    let found = only(&history[..8], AnomalyKind::Payload, None);
    assert!(found.value.is_nan() && found.first_run_id == 8, "{found:?}");
    assert!(found.message.contains("do not show its mass"), "{found:?}");
}

/// A constant torque that moves no parameter cannot explain a change of the parameters.
#[test]
fn an_offset_of_a_torque_does_not_excuse_a_load() {
    let state = |run: i64| match run {
        0..=6 => State::default(),
        _ => State { mass: 0.8, offset: Some((1, 0.4)), ..State::default() },
    };
    let mut history = fleet(9, 7, state);
    let parameters: Vec<ParameterId> = history[0].parameters.iter().map(|of| of.id).collect();
    let faults = (0..JOINTS).flat_map(|joint| {
        let of = |fault, change: f64| FaultResponse {
            joint: JointIndex::new(joint),
            fault,
            strength: 0,
            shift: Vec::new(),
            change: parameters
                .iter()
                .map(|id| if id.joint.index() == joint { change } else { 0.0 })
                .collect(),
            unexplained: vec![0.0; JOINTS],
        };
        [of(ChannelFault::TorqueGain, 1.0), of(ChannelFault::TorqueOffset, 1e-15)]
    });
    let response = Arc::new(ChannelResponse { parameters: parameters.clone(), faults: faults.collect() });
    for run in &mut history {
        run.response = Some(Arc::clone(&response));
    }
    let found = only(&history[..8], AnomalyKind::Payload, None);
    assert!((found.value / 0.8 - 1.0).abs() < 0.15, "{found:?}");
}

/// Sets the response of the parameters as weighted least squares give it. A fault that leaves more of a joint's torque
/// unexplained moves that joint's own parameters less. `change` and `left`, a fraction of the torque, are per unit of
/// the fault's size.
pub(super) fn answers(history: &mut [RunSummary], joint: usize, fault: ChannelFault, change: f64, left: f64) {
    let parameters: Vec<ParameterId> = history[0].parameters.iter().map(|of| of.id).collect();
    let of_strength = |(strength, times): (usize, f64)| FaultResponse {
        joint: JointIndex::new(joint),
        fault,
        strength,
        shift: Vec::new(),
        change: parameters
            .iter()
            .map(|id| if id.joint.index() == joint { change / (1.0 + times * times) } else { 0.0 })
            .collect(),
        unexplained: (0..JOINTS).map(|of| if of == joint { left } else { 0.0 }).collect(),
    };
    let faults = STRENGTHS.into_iter().enumerate().map(of_strength).collect();
    let response = Arc::new(ChannelResponse { parameters: parameters.clone(), faults });
    for run in history {
        run.response = Some(Arc::clone(&response));
    }
}

/// An offset of 2 Nm moves the parameters. The friction stage shows 0.1 Nm of it, less than 3 % of friction. The model
/// leaves ten times as much torque unexplained as usual. Play leaves as much and changes friction equally in both
/// directions.
#[test]
fn an_offset_that_goes_into_the_parameters_is_told_from_play() {
    let state = |offset: f64| {
        move |run: i64| match run {
            0..=6 => State { noise: Some((3, 1.0)), ..State::default() },
            _ => State {
                noise: Some((3, 1.0)),
                unexplained: Some((3, 10.05)),
                offset: Some((3, offset)),
                ..State::default()
            },
        }
    };
    for size in [2.0, -2.0] {
        let mut history = fleet(9, 13, state(0.05 * size));
        // the usual unexplained torque is 0.02 Nm (N) per unit of torque
        answers(&mut history, 3, ChannelFault::TorqueOffset, 0.8, 0.1);
        for (run, of) in (0..).zip(&mut history) {
            let moved = if run >= 7 { 0.8 * size / 101.0 } else { 0.0 };
            let own = of.parameters.iter_mut().filter(|of| of.id.joint.index() == 3);
            own.for_each(|of| of.mean += moved);
        }
        let found = only(&history[..8], AnomalyKind::Sensor, Some(4));
        assert!((found.value / size - 1.0).abs() < 0.15, "{found:?}");
        assert!(found.message.contains("offset") && found.odds.is_some_and(|odds| odds > 100.0), "{found:?}");
    }
    let mut history = fleet(9, 13, state(0.0));
    answers(&mut history, 3, ChannelFault::TorqueOffset, 0.8, 0.1);
    let found = only(&history[..8], AnomalyKind::Accuracy, Some(4));
    assert_eq!(found.quantity, Quantity::UnexplainedTorque);
}

/// A gain of 6 % moves the parameters along its own direction. It leaves three times as much of the joint's torque
/// unexplained as usual, and noise does not explain that.
#[test]
fn a_gain_that_leaves_torque_unexplained_is_no_play() {
    let rest = 10.0_f64.sqrt();
    let state = |run: i64| State {
        noise: Some((3, 1.0)),
        unexplained: (run >= 7).then_some((3, rest)),
        ..State::default()
    };
    let mut history = fleet(9, 14, state);
    answers(&mut history, 3, ChannelFault::TorqueGain, 3.0, 1.0);
    for (run, of) in (0..).zip(&mut history) {
        let moved = if run >= 7 { 0.06 * 3.0 / 10.0 } else { 0.0 };
        let own = of.parameters.iter_mut().filter(|of| of.id.joint.index() == 3);
        own.for_each(|of| of.mean += moved);
    }
    let found = only(&history, AnomalyKind::Sensor, Some(4));
    assert_eq!((found.quantity, found.baseline), (Quantity::TorqueGainRatio, 1.0), "{found:?}");
    assert!((found.value - 1.06).abs() < 0.01, "{found:?}");
}

#[test]
fn a_torque_signal_that_reads_wrong_is_named_and_no_other_joint_is() {
    let offset = |run: i64| State { offset: (run >= 7).then_some((1, 1.1)), ..State::default() };
    let found = only(&fleet(9, 8, offset), AnomalyKind::Sensor, Some(2));
    assert_eq!((found.quantity, found.baseline), (Quantity::TorqueOffset, 0.0), "{found:?}");
    assert!((found.value - 1.1).abs() < 0.1 && (found.peak_value - 1.1).abs() < 0.1, "{found:?}");
    // a cable that pulls looks the same
    assert!(found.message.contains("a cable, a hose or a seal"), "{found:?}");
    let noisy = |run: i64| State { unexplained: (run >= 7).then_some((3, 4.0)), ..State::default() };
    let found = only(&fleet(9, 9, noisy), AnomalyKind::Sensor, Some(4));
    assert_eq!((found.quantity, found.baseline), (Quantity::TorqueNoiseRatio, 1.0), "{found:?}");
    assert!((3.0..5.0).contains(&found.value), "{found:?}");
    // also beyond the limit of accuracy
    let bad = |run: i64| State { unexplained: (run >= 7).then_some((0, 9.0)), ..State::default() };
    only(&fleet(9, 10, bad), AnomalyKind::Sensor, Some(1));
}

#[test]
fn play_is_told_from_noise_and_both_at_once_are_one_of_them() {
    // noise is half of the unexplained torque: four times the noise makes the unexplained torque 2.2 times as large
    let with = |noise: f64, unexplained: f64| {
        move |run: i64| {
            let [noise, unexplained] = if run >= 7 { [noise, unexplained] } else { [1.0, 1.0] };
            State { noise: Some((3, noise)), unexplained: Some((3, unexplained)), ..State::default() }
        }
    };
    let noisy = only(&fleet(9, 9, with(4.0, 2.18)), AnomalyKind::Sensor, Some(4));
    assert!((noisy.value / 4.0 - 1.0).abs() < 0.05 && noisy.message.contains("noise"), "{noisy:?}");
    let loose = only(&fleet(9, 9, with(1.0, 3.0)), AnomalyKind::Accuracy, Some(4));
    assert_eq!(loose.quantity, Quantity::UnexplainedTorque);
    assert!((loose.value / 3.0 - 1.0).abs() < 0.1 && loose.message.contains("play"), "{loose:?}");
    // either is more than the model may leave unexplained: reported once
    only(&fleet(9, 9, with(1.0, 9.0)), AnomalyKind::Accuracy, Some(4));
    only(&fleet(9, 9, with(9.0, 9.0)), AnomalyKind::Accuracy, Some(4));
    assert_eq!(alarms(&fleet(40, 11, with(1.0, 1.0))), vec![]);
    assert_eq!(alarms(&fleet(40, 12, with(1.3, 1.1))), vec![]);
}

#[test]
fn noise_that_the_first_tests_did_not_measure_is_not_known() {
    let mut history = fleet(9, 9, |run| State {
        noise: Some((3, 1.0)),
        unexplained: (run >= 7).then_some((3, 4.0)),
        ..State::default()
    });
    history[1].joints[3].relative_noise = None;
    only(&history, AnomalyKind::Sensor, Some(4));
}

/// A short check of the same arm: one cold cycle. Its parameters deviate more than the scatter of whole tests explains.
fn check(mut run: RunSummary, noise: &Noise) -> RunSummary {
    run.cycles = 1;
    run.cycle_friction.retain(|of| of.cycle == 1);
    for (place, of) in run.parameters.iter_mut().enumerate() {
        of.mean += 0.05 + 0.01 * place as f64 + 0.02 * noise.normal();
        (of.std_dev, of.cycles) = (0.02, 1);
    }
    for joint in &mut run.joints {
        (joint.friction_index, joint.rmsd_swing) = (None, None);
        joint.relative_rmsd = joint.relative_rmsd.map(|rmsd| 1.8 * rmsd);
    }
    run
}

#[test]
fn short_checks_between_whole_tests_raise_nothing_and_show_a_load() {
    for seed in 1..=4 {
        let noise = Noise(Cell::new(100 + seed));
        let loaded = |run: i64| State { mass: if run >= 30 { 3.0 } else { 0.0 }, ..State::default() };
        let runs = fleet(40, seed, loaded).into_iter().enumerate();
        // whole tests first, then one after every three checks
        let is_whole = |place: usize| place < 6 || place.is_multiple_of(4);
        let history: Vec<RunSummary> =
            runs.map(|(place, run)| if is_whole(place) { run } else { check(run, &noise) }).collect();
        for runs in [7, 8, 12, 20, 30] {
            assert_eq!(alarms(&history[..runs]), vec![], "seed {seed}, {runs} runs");
        }
        let found = only(&history[..31], AnomalyKind::Payload, None);
        assert!(found.first_run_id == 31 && (found.value / 3.0 - 1.0).abs() < 0.15, "{found:?}");
    }
}
