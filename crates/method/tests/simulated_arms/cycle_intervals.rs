//! Intervals of parameters over several cycles, which repeat what the model leaves out.

use crate::{arms, cycles, method, truth};
use armwatch_method::analyse::{Method, analyse_cycle};
use armwatch_method::identify::joint_factors::{FactorColumns, unpack};
use armwatch_method::pooled::estimate::{PooledEstimate, StackedEstimator, estimate};
use armwatch_method::pooled::pool::PooledFactors;
use armwatch_model::analysis::CycleAnalysis;
use armwatch_model::robot::{JointIndex, ParameterId, ParameterKind, Robot};
use armwatch_simulate::SimulationSettings;
use armwatch_simulate::arm::friction::FrictionShape;
use armwatch_testing::er3a;
use nalgebra::Vector3;

/// Stiffness of the gears of arms that bend, Nm/rad.
const STIFFNESS: [f64; 7] = [2e4, 2e4, 1.5e4, 4e3, 4e3, 3e3, 3e3];

/// Arms of other tests, and one that stands on a slope.
fn four_arms() -> Vec<Robot> {
    let sloping = Robot { gravity: Vector3::new(4.0, -3.0, -8.4), ..er3a() };
    arms().into_iter().chain([sloping]).collect()
}

/// A run whose friction follows another law than the model, with ripple and warm-up.
fn other_friction(seed: u64, cycles: u32) -> SimulationSettings {
    SimulationSettings {
        seed,
        cycles,
        warming_s: 30.0,
        levels: Some(Vec::new()),
        ..SimulationSettings::default()
    }
}

fn analysed(method: &Method, settings: &SimulationSettings) -> Vec<CycleAnalysis> {
    cycles(&method.robot, settings, 0).iter().map(|cycle| analyse_cycle(method, cycle)).collect()
}

fn together(cycles: &[CycleAnalysis]) -> PooledEstimate {
    let columns = FactorColumns::of_stored(&cycles[0].factors.columns);
    let mut union = PooledFactors::new(columns.clone());
    for cycle in cycles {
        let found = cycle.identification.as_ref().unwrap_or_else(|reason| panic!("{reason}"));
        let shares: Vec<f64> = found.residuals.iter().map(|of| of.independent_share).collect();
        union.add(&columns, &unpack(&cycle.factors).expect("factors"), &shares).expect("the same columns");
    }
    estimate(&union, &StackedEstimator::Weighted).expect("parameters")
}

/// Inertial parameters and motor inertias within their intervals, and all of them. The friction of these arms has no true
/// values of the model's law.
fn held(method: &Method, cycles: &[CycleAnalysis]) -> [usize; 2] {
    let truth = truth(&method.robot, &method.base);
    let found = together(cycles);
    let true_value = |id: &ParameterId| {
        let place = method.base.kept.iter().position(|kept| kept == id)?;
        truth[place].filter(|_| !matches!(id.kind, ParameterKind::Friction(_)))
    };
    let all = found.identification.parameters.iter().zip(&found.half_width);
    let known: Vec<bool> =
        all.filter_map(|(of, half)| Some((of.value - true_value(&of.id)?).abs() <= *half)).collect();
    [known.iter().filter(|held| **held).count(), known.len()]
}

fn share([held, all]: [usize; 2]) -> f64 {
    held as f64 / all as f64
}

#[test]
fn a_model_error_that_all_cycles_repeat_is_within_the_intervals() {
    let method = method(er3a());
    let cycles = analysed(&method, &other_friction(101, 12));
    for count in [4, 12] {
        let held = share(held(&method, &cycles[..count]));
        assert!(held >= 0.9, "{count} cycles: {held}");
    }
}

#[test]
fn cycles_without_a_model_error_share_their_noise() {
    let method = method(er3a());
    let settings = SimulationSettings { friction: FrictionShape::Polynomial, ..other_friction(102, 12) };
    let cycles = analysed(&method, &settings);
    assert!(share(held(&method, &cycles)) >= 0.9);
    let mean = |cycles: &[CycleAnalysis]| {
        let widths = together(cycles).half_width;
        widths.iter().map(|width| width.ln()).sum::<f64>() / widths.len() as f64
    };
    // a third more than the root of three would give
    let narrower = (mean(&cycles[..4]) - mean(&cycles)).exp();
    assert!(narrower > 1.3, "{narrower}");
}

/// Prints the coverage of intervals over cycles.
#[test]
#[ignore = "a minute: run by hand for docs/evidence/method.md"]
fn intervals_over_4_to_24_cycles_cover_the_truth_on_four_arms() {
    let mut all = [0; 2];
    for count in [4, 8, 24] {
        let mut of_count = [0; 2];
        for bends in [false, true] {
            for (place, robot) in four_arms().into_iter().enumerate() {
                let stiffness: Vec<(JointIndex, f64)> = match bends {
                    true => robot.joint_indices().zip(STIFFNESS).collect(),
                    false => Vec::new(),
                };
                let method = method(robot);
                let mut of_arm = [0; 2];
                for seed in 0..5 {
                    let settings = SimulationSettings {
                        stiffness: stiffness.clone(),
                        ..other_friction(200 + seed, count)
                    };
                    let [inside, known] = held(&method, &analysed(&method, &settings));
                    of_arm = [of_arm[0] + inside, of_arm[1] + known];
                }
                println!("{count} cycles, arm {}, elastic {bends}: {:.3}", place + 1, share(of_arm));
                of_count = [of_count[0] + of_arm[0], of_count[1] + of_arm[1]];
            }
        }
        println!("{count} cycles: {:.3}", share(of_count));
        assert!((0.9..=0.99).contains(&share(of_count)), "{count} cycles: {}", share(of_count));
        all = [all[0] + of_count[0], all[1] + of_count[1]];
    }
    println!("all: {:.3}", share(all));
    assert!((0.9..=0.98).contains(&share(all)), "{}", share(all));
}
