//! Windows of ordinary work against parameters that a test has given: no identification, since a program
//! of production moves as it must and not as parameters need.

use super::analyse::{Method, keep_factors, note_gaps, unanalysed};
use super::factors::factor_cycle;
use super::jumps::jumps;
use super::signal::condition;
use super::torque_series::{SeriesRows, TorqueSeries, torque_series};
use crate::analysis::{CycleAnalysis, JointCheck, ProductionCheck, RmsdPair, RmsdScope};
use crate::robot::{JointIndex, ParameterId};
use crate::run::{Cycle, RunKind};

/// Why a window of production has no parameters; never shown while it has factors.
const NO_IDENTIFICATION: &str = "production is not identified on";

/// Parameters of a test.
#[derive(Debug, Clone, PartialEq)]
pub struct Reference {
    /// The run that they were identified on.
    pub run_id: i64,
    /// Base parameters, friction among them.
    pub parameters: Vec<(ParameterId, f64)>,
}

/// Conditions a window as a cycle of a test, keeps its factors, and holds its torques against those that
/// `reference` gives [5.1]: deviation with and without slow rows, its mean and its largest value.
///
/// Never fails: what could not be had says why in the result. Channels are not diagnosed as those of a
/// test, since in ordinary work joints may well stand still or move at one speed.
#[must_use]
pub fn analyse_window(method: &Method, cycle: &Cycle, reference: Option<&Reference>) -> CycleAnalysis {
    let samples = &cycle.samples;
    let mut analysis = CycleAnalysis { kind: RunKind::Production, ..unanalysed(method, cycle) };
    let conditioned = match condition(samples, analysis.cutoff) {
        Ok(conditioned) => conditioned,
        Err(error) => {
            analysis.identification = Err(error.to_string());
            return analysis;
        }
    };
    analysis.identification = Err(NO_IDENTIFICATION.into());
    analysis.sample_rate = conditioned.sample_rate;
    note_gaps(samples, &conditioned, &mut analysis.remarks);
    let jumps = jumps(&method.robot, &conditioned);
    let kept = &method.base.kept_columns;
    let factored = factor_cycle(&method.robot, &method.columns, kept, &conditioned, &jumps, samples);
    keep_factors(method, &factored, &mut analysis);
    let Some(reference) = reference else { return analysis };
    let rows = SeriesRows::Counted;
    match torque_series(&method.robot, &reference.parameters, samples, &conditioned, rows) {
        Ok(series) => {
            let joints = (0..series.joints.len()).map(|j| joint_check(&series, JointIndex::new(j)));
            let joints = joints.collect();
            analysis.production = Some(ProductionCheck { reference_run_id: reference.run_id, joints });
        }
        Err(error) => analysis.remarks.push(format!("not held against run {}: {error}", reference.run_id)),
    }
    analysis
}

fn joint_check(series: &TorqueSeries, joint: JointIndex) -> JointCheck {
    let of_joint = &series.joints[joint.index()];
    let moving: Vec<f64> =
        (0..series.rows()).filter(|&row| of_joint.moving[row]).map(|row| of_joint.residual(row)).collect();
    let some = |value: f64| (!moving.is_empty()).then_some(value);
    let rmsd = series.rmsd(joint, RmsdScope::WholeCycle);
    JointCheck {
        joint,
        rmsd: RmsdPair { all_rows: rmsd.all_rows, moving_rows: rmsd.moving_rows },
        bias: some(moving.iter().sum::<f64>() / moving.len().max(1) as f64),
        max: some(moving.iter().fold(0.0, |most: f64, residual| most.max(residual.abs()))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numerics::analyse::AnalysisSettings;
    use crate::numerics::factors::tests::cycle;
    use crate::numerics::factors::unpack;
    use crate::numerics::verify::torque_rmsd;
    use crate::run::Stage;
    use crate::testing::er3a;

    /// Sums of some hundred squares against norms of triangular factors of the same rows.
    const EQUAL: f64 = 1e-9;

    #[test]
    fn a_window_gives_the_deviation_that_its_factors_give() {
        let method = Method::new(er3a(), AnalysisSettings::default()).expect("base parameters");
        let mut window = cycle(4, 1200);
        window.samples.stage.fill(Stage::Between);
        let parameters: Vec<(ParameterId, f64)> = (method.base.kept.iter().enumerate())
            .map(|(k, id)| (*id, 1.0 + (k * 7919 % 13) as f64))
            .collect();
        let theta: Vec<f64> = parameters.iter().map(|(_, value)| *value).collect();
        let reference = Reference { run_id: 7, parameters };
        let analysis = analyse_window(&method, &window, Some(&reference));
        assert_eq!((analysis.refusal(), analysis.cycle, analysis.rows), (None, 4, 1200));
        assert!(analysis.friction_points.is_empty() && analysis.verification.is_empty());
        let factors = unpack(&analysis.factors).expect("factors");
        let expected = torque_rmsd(&method.columns, &factors, &theta);
        let check = analysis.production.expect("a reference");
        assert_eq!((check.reference_run_id, check.joints.len()), (7, 6));
        for joint in &check.joints {
            let whole = |of: &&crate::analysis::TorqueRmsd| {
                of.scope == RmsdScope::WholeCycle && of.joint == joint.joint
            };
            let expected = expected.iter().find(whole).expect("the whole window");
            let pairs =
                [(joint.rmsd.all_rows, expected.all_rows), (joint.rmsd.moving_rows, expected.moving_rows)];
            for (found, expected) in pairs {
                assert_eq!(found.samples, expected.samples);
                assert!((found.value - expected.value).abs() <= EQUAL * expected.value);
            }
            let (bias, max) = (joint.bias.expect("it moves"), joint.max.expect("it moves"));
            let rmsd = joint.rmsd.moving_rows.value;
            assert!(bias.abs() <= rmsd && rmsd <= max, "{bias} {rmsd} {max}");
        }
    }

    #[test]
    fn a_window_without_a_model_keeps_its_factors_and_a_short_one_says_why_it_has_none() {
        let method = Method::new(er3a(), AnalysisSettings::default()).expect("base parameters");
        let analysis = analyse_window(&method, &cycle(1, 600), None);
        assert!(analysis.production.is_none() && analysis.refusal().is_none());
        assert!(!analysis.factors.factors.is_empty());
        let short = analyse_window(&method, &cycle(1, 5), None);
        assert!(short.refusal().is_some_and(|reason| !reason.contains(NO_IDENTIFICATION)), "{short:?}");
    }
}
