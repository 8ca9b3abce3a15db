//! Choice of load-dependent friction laws per joint, by the torque error on rows that the identification did not use.

use super::Method;
use super::load_iteration::{LoadIteration, add_load_columns};
use crate::NumericsError;
use crate::identify::carried_torque::subtract_carried;
use crate::identify::cycle::identify_factors;
use crate::identify::filtered_columns::filtered_coulomb_columns;
use crate::identify::joint_factors::{FactoredRows, embedded, used_for_identification};
use crate::identify::load_visibility::with_load;
use crate::least_squares::factor::TriangularFactor;
use crate::signal::filter::{carried_cutoff, filter_signals};
use crate::signal::restore::restore;
use crate::signal::time_grid::sample_rate;
use armwatch_model::analysis::settings::AnalysisSettings;
use armwatch_model::analysis::{Estimator, IdentifiedParameter};
use armwatch_model::robot::{JointIndex, LoadFriction, ParameterKind, Robot};
use armwatch_model::run::Samples;
use std::borrow::Cow;

/// Number of parts into which the excitation of each cycle is divided.
const PARTS: usize = 4;
/// Smallest number of cycles for holding out whole cycles, because parts of one cycle have a common temperature.
const WHOLE_CYCLES: usize = 3;
/// Smallest relative reduction of the held-out error that justifies a law with more terms. Cycles differ by less than
/// this.
const LEAST_GAIN: f64 = 0.03;

/// Score of one law for one joint.
#[derive(Debug, Clone, PartialEq)]
pub struct LawScore {
    /// The law.
    pub load: LoadFriction,
    /// Torque error on held-out rows over the torque, root mean squares of the moving rows.
    pub held_out: f64,
    /// Bayesian information criterion minus that of the law without load; smaller is better.
    pub criterion: f64,
    /// Coefficients from all rows.
    pub coefficients: Vec<IdentifiedParameter>,
    /// Largest number of passes until the load of a cycle converged.
    pub passes: usize,
}

/// Result for one joint.
#[derive(Debug, Clone, PartialEq)]
pub struct JointChoice {
    /// The joint.
    pub joint: JointIndex,
    /// Simplest law that none of the others beats clearly.
    pub chosen: LoadFriction,
    /// All laws that could be identified, fewest terms first.
    pub scores: Vec<LawScore>,
}

/// Comparison of all joints.
#[derive(Debug, Clone, PartialEq)]
pub struct FrictionChoice {
    /// Results by joint.
    pub joints: Vec<JointChoice>,
    /// Number of held-out sets of rows.
    pub held_out_sets: usize,
    /// Laws that could not be compared, with reasons, in sentences.
    pub remarks: Vec<String>,
}

/// Factors of an arm for one law.
struct FrictionCandidate {
    name: &'static str,
    method: Method,
    /// Factors by cycle, part and joint `[n]`.
    cycles: Vec<Vec<Vec<TriangularFactor>>>,
    passes: usize,
    failed: Option<String>,
}

/// Comparison of laws, cycle by cycle, so that only one cycle is in memory.
pub struct FrictionComparison {
    candidates: Vec<FrictionCandidate>,
    settings: AnalysisSettings,
    independent: Vec<f64>,
}

impl FrictionComparison {
    /// Creates a comparison of the load laws of an arm, without cycles; its speed laws remain.
    ///
    /// # Errors
    /// Those of [`Method::new`].
    pub fn new(robot: &Robot, settings: AnalysisSettings) -> Result<Self, NumericsError> {
        let candidate = |kind: &armwatch_model::robot::LoadKind| {
            let method = Method::new(with_load(robot, kind.with_speed), settings)?;
            Ok(FrictionCandidate { name: kind.name, method, cycles: Vec::new(), passes: 0, failed: None })
        };
        let candidates = LoadFriction::KINDS.iter().map(candidate).collect::<Result<_, NumericsError>>()?;
        Ok(Self { candidates, settings, independent: Vec::new() })
    }

    /// Adds the rows of a cycle.
    ///
    /// # Errors
    /// Those of [`filter_signals`].
    pub fn add(&mut self, samples: &Samples) -> Result<(), NumericsError> {
        let mut samples = Cow::Borrowed(samples);
        restore(&self.candidates[0].method.robot, &mut samples);
        let asked = self.settings.cutoff;
        let cutoff = sample_rate(&samples.time).map_or(asked, |rate| carried_cutoff(asked, rate));
        let mut filtered = filter_signals(&samples, cutoff)?;
        subtract_carried(&self.candidates[0].method.robot, &mut samples, &mut filtered);
        self.independent.push(filtered.independent_fraction());
        for candidate in self.candidates.iter_mut().filter(|of| of.failed.is_none()) {
            let method = &candidate.method;
            let mut columns = filtered_coulomb_columns(&method.robot, &filtered);
            if method.robot.has_load_friction() {
                let settled = add_load_columns(method, &filtered, &samples, &mut columns);
                if let LoadIteration::Settled(passes) = settled {
                    candidate.passes = candidate.passes.max(passes);
                }
                candidate.failed = settled.remark();
            }
            let rows = FactoredRows {
                robot: &method.robot,
                columns: &method.columns,
                regressor_columns: &method.base.kept_columns,
                filtered: &filtered,
                filtered_coulomb_columns: &columns,
                samples: &samples,
            };
            let part = |factors: Vec<crate::identify::joint_factors::JointFactor>| {
                let used = factors.iter().filter(|of| used_for_identification(of.stage, of.motion));
                embedded(&method.columns, used)
            };
            candidate.cycles.push(rows.factored_parts(PARTS).into_iter().map(part).collect());
        }
        Ok(())
    }

    /// Scores of all laws and the choice for each joint.
    ///
    /// # Errors
    /// [`NumericsError::TooShort`] without a cycle, and those of the identification without load.
    pub fn choice(&self) -> Result<FrictionChoice, NumericsError> {
        let plain = &self.candidates[0];
        let n = plain.method.robot.joint_count();
        let mut joints: Vec<JointChoice> = (0..n)
            .map(|j| JointChoice {
                joint: JointIndex::new(j),
                chosen: LoadFriction::None,
                scores: Vec::new(),
            })
            .collect();
        let (mut remarks, mut sets) = (Vec::new(), 0);
        for (at, candidate) in self.candidates.iter().enumerate() {
            let scored = match &candidate.failed {
                None => self.scored(candidate).map_err(|error| (error.to_string(), error)),
                Some(reason) => {
                    remarks.push(format!("{}: {reason}", candidate.name));
                    continue;
                }
            };
            match scored {
                Ok((scores, folds)) => {
                    sets = folds;
                    joints.iter_mut().zip(scores).for_each(|(joint, score)| joint.scores.push(score));
                }
                Err((_, error)) if at == 0 => return Err(error),
                Err((reason, _)) => remarks.push(format!("{}: {reason}", candidate.name)),
            }
        }
        joints.iter_mut().for_each(choose);
        Ok(FrictionChoice { joints, held_out_sets: sets, remarks })
    }

    /// Score of each joint, and the number of held-out sets.
    fn scored(&self, candidate: &FrictionCandidate) -> Result<(Vec<LawScore>, usize), NumericsError> {
        let robot = &candidate.method.robot;
        let kept = &candidate.method.base.kept;
        let n = robot.joint_count();
        let folds: Vec<Vec<TriangularFactor>> = match candidate.cycles.len() >= WHOLE_CYCLES {
            true => candidate.cycles.iter().map(|parts| joined(parts.iter(), n)).collect(),
            false => candidate.cycles.concat(),
        };
        if folds.len() < 2 {
            return Err(NumericsError::TooShort {
                what: "the comparison, in sets of rows,",
                rows: 0,
                needed: 2,
            });
        }
        let shares = vec![1.0; n];
        let identify =
            |factors: &[TriangularFactor]| identify_factors(kept, factors, &shares, Estimator::Weighted);
        let (mut errors, mut torques) = (vec![0.0; n], vec![0.0; n]);
        let nothing = vec![0.0; kept.len()];
        for held in 0..folds.len() {
            let others = folds.iter().enumerate().filter(|(at, _)| *at != held).map(|(_, fold)| fold);
            let found = identify(&joined(others, n))?;
            let theta: Vec<f64> = found.parameters.iter().map(|of| of.value).collect();
            for (j, factor) in folds[held].iter().enumerate() {
                errors[j] += factor.residual_sum_of_squares(&theta);
                torques[j] += factor.residual_sum_of_squares(&nothing);
            }
        }
        let all = joined(folds.iter(), n);
        let found = identify(&all)?;
        let theta: Vec<f64> = found.parameters.iter().map(|of| of.value).collect();
        let independent = self.independent.iter().sum::<f64>() / self.independent.len().max(1) as f64;
        let score = |joint: JointIndex| {
            let j = joint.index();
            let rows = (all[j].rows() as f64 * independent).max(1.0);
            let load = robot.friction_of(joint).load;
            let own = |of: &&IdentifiedParameter| {
                let term = |term: &_| ParameterKind::Friction(*term) == of.id.kind;
                of.id.joint == joint && load.terms().iter().any(term)
            };
            let residual = all[j].residual_sum_of_squares(&theta);
            LawScore {
                load,
                held_out: (errors[j] / torques[j]).sqrt(),
                criterion: rows * residual.ln() + load.terms().len() as f64 * rows.ln(),
                coefficients: found.parameters.iter().filter(own).copied().collect(),
                passes: candidate.passes,
            }
        };
        Ok((robot.joint_indices().map(score).collect(), folds.len()))
    }
}

/// Factor of each joint over several sets of rows.
fn joined<'a>(sets: impl Iterator<Item = &'a Vec<TriangularFactor>>, n: usize) -> Vec<TriangularFactor> {
    let mut all: Vec<Option<TriangularFactor>> = vec![None; n];
    for set in sets {
        for (all, factor) in all.iter_mut().zip(set) {
            match all {
                Some(all) => all.join(factor),
                None => *all = Some(factor.clone()),
            }
        }
    }
    all.into_iter().flatten().collect()
}

/// Subtracts the criterion of the law without load, and chooses the simplest law that none of the others beats clearly.
fn choose(joint: &mut JointChoice) {
    let Some(zero) = joint.scores.first().map(|score| score.criterion) else { return };
    joint.scores.iter_mut().for_each(|score| score.criterion -= zero);
    let mut best = &joint.scores[0];
    for score in &joint.scores[1..] {
        // friction under load cannot return power
        let opposes = score.coefficients.first().is_some_and(|of| of.value > 0.0);
        let better = score.held_out < (1.0 - LEAST_GAIN) * best.held_out && score.criterion < best.criterion;
        if opposes && better {
            best = score;
        }
    }
    joint.chosen = best.load;
}
