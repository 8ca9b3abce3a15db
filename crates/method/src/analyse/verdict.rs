//! Findings about a cycle: checks of its channels, of its model and of the description. A cause precedes its
//! consequences.

use super::Method;
use crate::diagnose::model::assignment::{assign, is_weightless, turned_by_friction};
use crate::diagnose::model::causes::motor_torques;
use crate::diagnose::model::channels::Channels;
use crate::diagnose::model::combination::PlausibleSettings;
use crate::diagnose::model::doubt::{DoubtSettings, JudgedCycle, diagnose_description, late_torques};
use crate::diagnose::model::level::{BaseTilt, RESIDUAL_RATIO, TILT};
use crate::diagnose::model::nominal::inertia_ratios;
use crate::diagnose::model::unmeasured::{accelerations, unmeasured};
use crate::diagnose::model::weigh::{ModelWeights, WeighSettings, weigh};
use crate::diagnose::model::{diagnose_model, top_speeds};
use crate::identify::cycle::{identify_rows, noise_errors};
use crate::identify::cycle_rows::CycleRows;
use crate::identify::filtered_columns::FilteredColumn;
use crate::identify::joint_factors::{Factored, FactoredRows, embedded, used_for_identification};
use crate::identify::verify::torque_rmsd;
use crate::least_squares::factor::TriangularFactor;
use crate::model::regressor::KeptColumns;
use crate::signal::filter::FilteredSignals;
use armwatch_model::analysis::Identification;
use armwatch_model::analysis::finding::{Finding, FindingKind, FindingSeverity};
use armwatch_model::run::{Samples, Stage};

/// Cycle with its filtered channels and factors.
#[derive(Clone, Copy)]
pub(crate) struct CycleRecord<'a> {
    pub(crate) samples: &'a Samples,
    pub(crate) filtered: &'a FilteredSignals,
    pub(crate) filtered_coulomb_columns: &'a [FilteredColumn],
    pub(crate) factored: &'a Factored,
}

impl<'a> CycleRecord<'a> {
    /// Channels in the form that the assignment of torques needs.
    fn channels(&self, method: &'a Method, excitation: &'a [usize]) -> Channels<'a> {
        Channels {
            robot: &method.robot,
            columns: &method.columns,
            kept_columns: &method.base.kept_columns,
            filtered: self.filtered,
            filtered_coulomb_columns: self.filtered_coulomb_columns,
            factored: self.factored,
            excitation,
        }
    }

    /// Usable rows of the excitation.
    pub(crate) fn excitation(&self) -> Vec<usize> {
        let usable = self.filtered.usable.iter().flat_map(Clone::clone);
        usable.filter(|&row| self.samples.stage[row] == Stage::Excitation).collect()
    }
}

/// Findings about channels, with signs and order of the torques and the mounting. A wrong position, velocity or time
/// prevents the judgement of torques. `level` receives the tilt of the base if it was estimated.
pub(crate) fn judge_channels(
    method: &Method,
    recorded: &CycleRecord<'_>,
    mut findings: Vec<Finding>,
    level: &mut Option<BaseTilt>,
) -> Vec<Finding> {
    if findings.iter().all(|finding| finding.severity != FindingSeverity::Refuse) {
        let excitation = recorded.excitation();
        let channels = recorded.channels(method, &excitation);
        if let Some(found) = accelerations(&method.robot, recorded.filtered, &excitation) {
            findings.push(found);
        } else {
            let assigned = assign(&channels, level);
            // late torques resemble any change of the arm, but the fit of each single joint shows them
            let late = if assigned.is_empty() { None } else { late_torques(&channels) };
            findings.extend(late.map_or(assigned, |late| vec![late]));
        }
    }
    findings
}

/// Findings about the identified model. If the torques show a tilt of the base, it is a remark, and all other findings
/// take it into account.
pub(crate) fn judge_model(
    method: &Method,
    recorded: &CycleRecord<'_>,
    (factors, found): (&[TriangularFactor], &Identification),
    level: Option<BaseTilt>,
) -> Vec<Finding> {
    let given = judged(method, recorded, (factors, found));
    let is_suspect = |of: &Finding| {
        of.severity >= FindingSeverity::Doubt || of.evidence.iter().any(|evidence| evidence.name == TILT)
    };
    if !given.iter().any(is_suspect) {
        return given;
    }
    let excitation = recorded.excitation();
    let channels = recorded.channels(method, &excitation);
    let Some(level) = level.or_else(|| BaseTilt::of(&channels)) else { return given };
    let tilted = if level.is_shown() { judged_beside_tilt(method, recorded, &level) } else { None };
    let mut findings = tilted.unwrap_or(given);
    findings.extend(turned_by_friction(&channels, &level, &findings));
    findings
}

/// Findings with the tilted description, and its tilt; `None` if it identifies nothing.
fn judged_beside_tilt(method: &Method, recorded: &CycleRecord<'_>, level: &BaseTilt) -> Option<Vec<Finding>> {
    let tilted = method.of_other(level.robot().clone(), level.base.clone(), level.columns.clone());
    let CycleRecord { samples, filtered, filtered_coulomb_columns, .. } = *recorded;
    let rows = FactoredRows {
        robot: &tilted.robot,
        columns: &tilted.columns,
        regressor_columns: &tilted.base.kept_columns,
        filtered,
        filtered_coulomb_columns,
        samples,
    };
    let factored = rows.factored_excitation();
    let recorded = CycleRecord { factored: &factored, ..*recorded };
    let factors = identifying_factors(&tilted, &factored);
    let found = identify_excitation(&tilted, &recorded, &factors).ok()?;
    let mut findings = judged(&tilted, &recorded, (&factors, &found));
    // next to a tilt, only a change that explains more is evidence against the description
    let names_change = |of: &Finding| of.evidence.iter().any(|evidence| evidence.name == RESIDUAL_RATIO);
    findings.retain(|of| {
        of.kind != FindingKind::Description || of.severity > FindingSeverity::Warn || names_change(of)
    });
    findings.push(level.remark());
    Some(findings)
}

/// Findings about a model of the robot of `method`.
fn judged(
    method: &Method,
    recorded: &CycleRecord<'_>,
    (factors, found): (&[TriangularFactor], &Identification),
) -> Vec<Finding> {
    let CycleRecord { samples, filtered, filtered_coulomb_columns, factored } = *recorded;
    let theta: Vec<f64> = found.parameters.iter().map(|p| p.value).collect();
    let verification = torque_rmsd(&method.columns, &factored.factors, &theta);
    let rows = recorded.excitation();
    let speeds = top_speeds(&filtered.qd, &rows);
    let mut doubted = found.clone();
    let fraction = filtered.independent_fraction();
    if let Ok(errors) = noise_errors(&method.base.kept, factors, found.residual_std, fraction) {
        let parameters = doubted.parameters.iter_mut();
        parameters.zip(errors).for_each(|(parameter, error)| parameter.std_error = error);
    }
    let of_model =
        diagnose_model(&method.robot, &doubted, &verification, &speeds, &PlausibleSettings::default());
    let weighed = ModelWeights {
        robot: &method.robot,
        base: &method.base,
        factors,
        samples,
        filtered,
        excitation: &rows,
        identified: &doubted,
        verification: &verification,
    };
    if let Some(found) = unmeasured(&weighed, || is_weightless(&recorded.channels(method, &rows))) {
        // without a measured torque, the model has no meaning
        return vec![found];
    }
    let of_model = weigh(of_model, &weighed, &WeighSettings::default());
    let judged = JudgedCycle {
        robot: &method.robot,
        columns: &method.columns,
        kept_columns: &method.base.kept_columns,
        filtered,
        filtered_coulomb_columns,
        excitation: &rows,
        identified: &doubted,
        verification: &verification,
    };
    let mut findings = diagnose_description(&judged, &of_model, &DoubtSettings::default());
    let refused = of_model.iter().any(|finding| finding.severity == FindingSeverity::Refuse);
    let motors = motor_torques(&method.robot, &inertia_ratios(&method.robot, &doubted));
    findings.extend(motors.filter(|_| refused));
    findings.extend(of_model);
    findings
}

/// Factor of each joint over the rows of the identification.
pub(crate) fn identifying_factors(method: &Method, factored: &Factored) -> Vec<TriangularFactor> {
    let chosen = factored.factors.iter().filter(|of| used_for_identification(of.stage, of.motion));
    embedded(&method.columns, chosen)
}

pub(crate) fn identify_excitation(
    method: &Method,
    recorded: &CycleRecord<'_>,
    factors: &[TriangularFactor],
) -> Result<Identification, String> {
    let CycleRecord { samples, filtered, filtered_coulomb_columns, .. } = *recorded;
    if factors.iter().all(|factor| factor.rows() == 0) {
        return Err(match samples.stage.contains(&Stage::Excitation) {
            true => "no row of the excitation stage can be used: its time has gaps, or no joint moves in it"
                .into(),
            false => super::without_excitation(&[]),
        });
    }
    let columns = KeptColumns::new(&method.base.kept_columns);
    let rows = CycleRows::new(&method.robot, &columns, filtered, filtered_coulomb_columns, samples);
    identify_rows(&method.base.kept, factors, &rows, method.settings().estimator)
        .map_err(|error| error.to_string())
}
