//! Windows of production compared with the parameters of a test. There is no identification, since the motion of
//! production is not chosen for parameters.

use std::borrow::Cow;

use super::evidence::window_evidence;
use super::reference::Reference;
use crate::NumericsError;
use crate::analyse::{Method, keep_factors, note_gaps, unanalysed, without_positions};
use crate::identify::carried_torque::subtract_carried;
use crate::identify::filtered_columns::{filtered_coulomb_columns, filtered_load_columns};
use crate::identify::joint_factors::{FactorColumns, JointFactor, factor_cycle};
use crate::identify::verify::torque_rmsd;
use crate::model::dynamics::DynamicModel;
use crate::signal::filter::filter_signals;
use crate::signal::restore::restore;
use armwatch_model::analysis::{
    CycleAnalysis, FrictionExcess, JointCheck, Motion, ProductionCheck, RmsdPair, RmsdScope,
};
use armwatch_model::robot::{JointIndex, ParameterId, ParameterKind};
use armwatch_model::run::{Cycle, RunKind};

/// The reason for missing parameters of a window of production; never shown while it has factors.
const NO_IDENTIFICATION: &str = "production is not identified on";

/// Conditions a window as a cycle of a test, keeps its factors, and compares its torques with those of `reference`, see
/// [`check_window`].
///
/// Never fails: the result contains the reason for each missing part. Channels are not diagnosed as in a test, since
/// joints may stand still or move at one speed in production.
#[must_use]
pub fn analyse_window(method: &Method, cycle: &Cycle, reference: Option<&Reference>) -> CycleAnalysis {
    let mut samples = Cow::Borrowed(&cycle.samples);
    let restored = restore(&method.robot, &mut samples);
    let mut analysis =
        CycleAnalysis { kind: RunKind::Production, ..unanalysed(method, cycle.number, &samples) };
    if without_positions(&samples, &mut analysis) {
        return analysis;
    }
    analysis.remarks.extend(restored.remarks);
    analysis.remarks.extend(restored.unsteady.map(|finding| finding.sentence));
    let mut filtered = match filter_signals(&samples, analysis.cutoff) {
        Ok(filtered) => filtered,
        Err(error) => {
            analysis.identification = Err(match error {
                NumericsError::TooShort { rows, needed, .. } => format!(
                    "a short window: it has {rows} of the {needed} rows that a comparison needs, as where a log pauses"
                ),
                error => error.to_string(),
            });
            return analysis;
        }
    };
    analysis.identification = Err(NO_IDENTIFICATION.into());
    analysis.sample_rate = filtered.sample_rate;
    note_gaps(&samples, &filtered, &mut analysis.remarks);
    subtract_carried(&method.robot, &mut samples, &mut filtered);
    let mut filtered_coulomb_columns = filtered_coulomb_columns(&method.robot, &filtered);
    // without a reference the windows have no load: their own rows do not identify one
    if let Some(reference) = reference.filter(|_| method.robot.has_load_friction()) {
        let model = DynamicModel::from_parameters(&method.robot, reference.parameters.iter().copied());
        filtered_coulomb_columns.extend(filtered_load_columns(&method.robot, &filtered, &model));
    }
    let kept = &method.base.kept_columns;
    let factored =
        factor_cycle(&method.robot, &method.columns, kept, &filtered, &filtered_coulomb_columns, &samples);
    keep_factors(method, &factored, &mut analysis);
    // parameters of other columns are no error here: the comparison is made later
    analysis.production =
        reference.and_then(|reference| check_window(&method.columns, &factored.factors, reference).ok());
    analysis
}

/// Compares the rows of `factors` with the parameters of `reference` `[b]`. The results are the deviation with and
/// without slow rows [5.1], and the friction excess `e` that minimises `|tau - w theta - e w_f theta_f|` over the
/// moving rows, with the columns `w_f` of the joint's own friction.
///
/// # Errors
/// [`NumericsError::ColumnsDiffer`] unless the parameters are exactly those of the columns.
pub fn check_window(
    columns: &FactorColumns,
    factors: &[JointFactor],
    reference: &Reference,
) -> Result<ProductionCheck, NumericsError> {
    let theta = columns.theta(reference.parameters.iter().copied())?;
    let rmsd = torque_rmsd(columns, factors, &theta);
    let whole = rmsd.iter().filter(|of| of.scope == RmsdScope::WholeCycle);
    let joints = whole.map(|of| JointCheck {
        joint: of.joint,
        rmsd: RmsdPair { all_rows: of.all_rows, moving_rows: of.moving_rows },
        friction: friction_excess(columns, factors, &theta, of.joint),
    });
    Ok(ProductionCheck {
        reference_run_id: reference.run_id,
        estimator: reference.estimator,
        joints: joints.collect(),
        evidence: window_evidence(columns, factors, reference)?,
    })
}

/// Friction excess from factors alone: reflections keep the inner products of `w theta - tau` and `w_f theta_f`.
fn friction_excess(
    columns: &FactorColumns,
    factors: &[JointFactor],
    theta: &[f64],
    joint: JointIndex,
) -> Option<FrictionExcess> {
    let theta = columns.select(joint, theta);
    let ids = columns.by_joint().get(joint.index())?;
    let own = |id: &ParameterId| id.joint == joint && matches!(id.kind, ParameterKind::Friction(_));
    let (mut of_friction, mut of_deviation, mut of_both) = (0.0, 0.0, 0.0);
    for of in factors.iter().filter(|of| of.joint == joint && of.motion == Motion::Moving) {
        let r = of.factor.upper();
        for row in 0..r.nrows() {
            let friction: f64 =
                (row..theta.len()).filter(|&k| own(&ids[k])).map(|k| r[(row, k)] * theta[k]).sum();
            let estimated: f64 = (row..theta.len()).map(|k| r[(row, k)] * theta[k]).sum();
            let deviation = r[(row, theta.len())] - estimated;
            of_friction += friction * friction;
            of_deviation += deviation * deviation;
            of_both += friction * deviation;
        }
    }
    let excess = of_both / of_friction;
    let share = if of_deviation > 0.0 { excess * of_both / of_deviation } else { 0.0 };
    excess.is_finite().then_some(FrictionExcess { excess, share })
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;
    use crate::identify::joint_factors::unpack;
    use crate::identify::torque_series::{SeriesRows, torque_series};
    use armwatch_model::analysis::log_summary::summarise;
    use armwatch_model::analysis::settings::AnalysisSettings;
    use armwatch_model::analysis::{Estimator, ProductionJoint, Rmsd};
    use armwatch_model::run::Stage;
    use armwatch_testing::cycle::cycle;
    use armwatch_testing::er3a;

    /// Sums of some hundred squares against norms of triangular factors of the same rows.
    const EQUAL: f64 = 1e-9;

    #[test]
    fn a_window_gives_the_deviation_that_its_rows_give_one_by_one() {
        let method = Method::new(er3a(), AnalysisSettings::default()).expect("base parameters");
        let mut window = cycle(4, 1200);
        window.samples.stage.fill(Stage::Between);
        let parameters: Vec<(ParameterId, f64)> = (method.base.kept.iter().enumerate())
            .map(|(k, id)| (*id, 1.0 + (k * 7919 % 13) as f64))
            .collect();
        let reference = Reference {
            run_id: 7,
            estimator: Estimator::Weighted,
            parameters: parameters.clone(),
            last_link: BTreeMap::new(),
        };
        let analysis = analyse_window(&method, &window, Some(&reference));
        assert_eq!((analysis.refusal(), analysis.cycle, analysis.rows), (None, 4, 1200));
        assert!(analysis.friction_points.is_empty() && analysis.verification.is_empty());
        let stored = unpack(&analysis.factors).expect("factors");
        let check = analysis.production.expect("a reference");
        assert_eq!((check.reference_run_id, check.joints.len()), (7, 6));
        assert_eq!(check_window(&method.columns, &stored, &reference).expect("the same columns"), check);
        let filtered = filter_signals(&window.samples, analysis.cutoff).expect("a long window");
        let series = |parameters: &[(ParameterId, f64)]| {
            torque_series(&method.robot, parameters, &window.samples, &filtered, SeriesRows::Counted)
                .expect("the same columns")
        };
        let whole = series(&parameters);
        for joint in &check.joints {
            let expected = whole.rmsd(joint.joint, RmsdScope::WholeCycle);
            let pairs =
                [(joint.rmsd.all_rows, expected.all_rows), (joint.rmsd.moving_rows, expected.moving_rows)];
            for (found, expected) in pairs {
                assert_eq!(found.samples, expected.samples);
                assert!((found.value - expected.value).abs() <= EQUAL * expected.value);
            }
            let own = |of: &&(ParameterId, f64)| {
                of.0.joint == joint.joint && matches!(of.0.kind, ParameterKind::Friction(_))
            };
            let friction: Vec<(ParameterId, f64)> = parameters.iter().filter(own).copied().collect();
            let (friction, whole) =
                (&series(&friction).joints[joint.joint.index()], &whole.joints[joint.joint.index()]);
            let moving: Vec<usize> = (0..whole.q.len()).filter(|&row| whole.moving[row]).collect();
            let sum = |of: &dyn Fn(usize) -> f64| moving.iter().map(|&row| of(row)).sum::<f64>();
            let square = sum(&|row| friction.estimated[row].powi(2));
            let both = sum(&|row| friction.estimated[row] * whole.residual(row));
            let all = sum(&|row| whole.residual(row).powi(2));
            let found = joint.friction.expect("it moves");
            assert!((found.excess - both / square).abs() <= EQUAL * all.sqrt() / square.sqrt());
            assert!((found.share - both * both / square / all).abs() <= EQUAL);
        }
    }

    #[test]
    fn medians_leave_out_windows_in_which_a_joint_rests() {
        let check = |joint: usize, relative: f64, friction: Option<f64>| JointCheck {
            joint: JointIndex::new(joint),
            rmsd: RmsdPair {
                all_rows: Rmsd { value: 1.0, relative: 1.0, samples: 10 },
                moving_rows: Rmsd { value: relative, relative, samples: 5 * usize::from(friction.is_some()) },
            },
            friction: friction.map(|excess| FrictionExcess { excess, share: 0.5 }),
        };
        let windows = [
            vec![check(1, 0.02, Some(0.1)), check(0, 0.3, None)],
            vec![check(1, 0.9, Some(4.0))],
            vec![check(1, 0.03, Some(0.2))],
        ];
        let found = summarise(windows.iter().map(Vec::as_slice));
        let expected = ProductionJoint {
            joint: JointIndex::new(1),
            windows: 3,
            relative_rmsd: 0.03,
            friction: FrictionExcess { excess: 0.2, share: 0.5 },
            test_relative_rmsd: None,
        };
        assert_eq!(found, [expected]);
    }

    #[test]
    fn a_window_without_a_model_keeps_its_factors_and_a_short_one_says_why_it_has_none() {
        let method = Method::new(er3a(), AnalysisSettings::default()).expect("base parameters");
        let analysis = analyse_window(&method, &cycle(1, 600), None);
        assert!(analysis.production.is_none() && analysis.refusal().is_none());
        assert!(!analysis.factors.factors.is_empty());
        let short = analyse_window(&method, &cycle(1, 5), None);
        let named = |reason: &str| reason.starts_with("a short window: it has 5 of the 32 rows");
        assert!(short.refusal().is_some_and(named), "{short:?}");
    }
}
