//! Parameters that a motion does not show, and recordings that show them together.

#![expect(clippy::expect_used, reason = "functions that tests call")]

use armwatch_method::analyse::{Method, analyse_cycle};
use armwatch_method::identify::joint_factors::unpack;
use armwatch_method::pooled::estimate::{StackedEstimator, estimate};
use armwatch_method::pooled::pool::PooledFactors;
use armwatch_model::analysis::finding::FindingKind;
use armwatch_model::analysis::settings::AnalysisSettings;
use armwatch_model::analysis::{CycleAnalysis, IdentifiedParameter};
use armwatch_model::robot::Robot;
use armwatch_model::run::Cycle;
use armwatch_simulate::run::matched_model::{ExactSettings, record_excitation};
use armwatch_testing::er3a;

fn method() -> Method {
    let accept = FindingKind::ALL.into_iter().collect();
    Method::new(er3a(), AnalysisSettings { accept, ..AnalysisSettings::default() }).expect("base parameters")
}

/// Recording with these joints at rest.
fn recorded(method: &Method, still: &[usize], seed: u64) -> CycleAnalysis {
    let mut excitation = er3a().excitation.expect("an excitation");
    for &joint in still {
        excitation.a[joint].fill(0.0);
        excitation.b[joint].fill(0.0);
    }
    let robot = Robot { excitation: Some(excitation), ..er3a() };
    let settings = ExactSettings { seed, additional: false, ..ExactSettings::default() };
    let samples = record_excitation(&robot, &settings).expect("a recording");
    analyse_cycle(method, &Cycle { number: 1, samples })
}

fn shown(parameters: &[IdentifiedParameter]) -> Vec<&IdentifiedParameter> {
    parameters.iter().filter(|of| of.is_shown()).collect()
}

#[test]
fn a_parameter_that_the_motion_does_not_show_is_left_out_and_named() {
    let method = method();
    let (whole, part) = (recorded(&method, &[], 1), recorded(&method, &[5], 2));
    let whole_verification = whole.verification;
    let (whole, found) =
        (whole.identification.expect("all parameters"), part.identification.expect("the others"));
    assert_eq!(shown(&whole.parameters).len(), 64);
    assert_eq!(found.parameters.len(), 64, "left-out ones count as zero");
    let given = shown(&found.parameters);
    assert!((40..60).contains(&given.len()), "{}", given.len());
    let unshown = found.parameters.iter().filter(|of| !of.is_shown());
    let remark = part.remarks.iter().find(|of| of.contains("on their own")).expect("a remark");
    assert!(unshown.clone().all(|of| remark.contains(&of.id.to_string())), "{remark}");
    for friction in 1..=4 {
        assert!(unshown.clone().any(|of| of.id.to_string() == format!("J6_f{friction}")), "{remark}");
    }
    // given parameters have the same meaning as when all are shown
    for of in given {
        let truth = whole.parameters.iter().find(|other| other.id == of.id).expect("the same parameters");
        let error = of.std_error.hypot(truth.std_error);
        assert!(
            (of.value - truth.value).abs() < 5.0 * error,
            "{}: {} {} {error}",
            of.id,
            of.value,
            truth.value
        );
    }
    // together they explain the torque of the joints that move
    let explained = part.verification.iter().filter(|of| of.joint.number() < 6);
    let explained = explained.filter(|of| of.moving_rows.samples > 0);
    for of in explained {
        let usual =
            whole_verification.iter().find(|other| (other.joint, other.scope) == (of.joint, of.scope));
        let usual = usual.expect("the same rows").moving_rows.value;
        assert!(of.moving_rows.value < 1.3 * usual, "{of:?} {usual}");
    }
}

#[test]
fn recordings_together_show_what_none_of_them_does() {
    let method = method();
    let mut union = PooledFactors::new(method.columns.clone());
    for (still, seed) in [(4, 3), (5, 4)] {
        let part = recorded(&method, &[still], seed);
        let found = part.identification.as_ref().expect("the others");
        assert!(shown(&found.parameters).len() < 64);
        let factors = unpack(&part.factors).expect("factors are kept");
        union.add(&method.columns, &factors, &[0.3; 6]).expect("the same columns");
    }
    let together = estimate(&union, &StackedEstimator::Weighted).expect("parameters");
    assert_eq!(shown(&together.identification.parameters).len(), 64);
    assert!(together.half_width.iter().all(|half| half.is_finite()));
}

#[test]
fn a_motion_that_shows_few_parameters_gives_none_and_keeps_its_factors() {
    let method = method();
    let poor = recorded(&method, &[1, 2, 3, 4, 5], 5);
    let reason = poor.identification.expect_err("one joint moves");
    assert!(reason.contains("parameters"), "{reason}");
    assert!(!poor.factors.factors.is_empty());
}
