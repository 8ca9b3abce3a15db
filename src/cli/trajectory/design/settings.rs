//! Converts options to settings of the search.

use super::options::{ColumnsArg, DesignArgs, ObjectiveArg};
use crate::cli::context::CliError;
use crate::cli::shared::output;
use crate::cli::trajectory::torque::{DutyLimits, nominal_parameters};
use armwatch_method::least_squares::essential::EssentialSettings;
use armwatch_method::model::base_parameters::BaseParameters;
use armwatch_method::pooled::nominal_prior::nominal_base;
use armwatch_model::analysis::settings::AnalysisSettings;
use armwatch_model::robot::{JointKind, ParameterKind, Robot};
use armwatch_simulate::plan::excitation::fourier_excitation;
use armwatch_trajectory::information::Information;
use armwatch_trajectory::limits::{MotionLimits, Shares, TorqueLimits};
use armwatch_trajectory::objective::Objective;
use armwatch_trajectory::prediction::load_direction;
use armwatch_trajectory::problem::SearchSettings;
use armwatch_trajectory::recorded_rows::RecordingPlan;

/// Name for all parameters that a mass at the tool frame changes.
const LOAD: &str = "load";
/// Name for all essential parameters.
const ESSENTIAL: &str = "essential";

/// Factor on torque limits in the search, since a resulting motion is not made smaller for torques.
const TORQUE_CLEARANCE: f64 = 0.999;

impl DesignArgs {
    pub(super) fn settings(&self, robot: &Robot, base: &BaseParameters) -> Result<SearchSettings, CliError> {
        let is_chosen = |k: &usize| match self.columns {
            ColumnsArg::Inertial if !self.beside.is_asked() => {
                matches!(base.kept[*k].kind, ParameterKind::Inertial(_) | ParameterKind::MotorInertia)
            }
            _ => true,
        };
        let parameters: Vec<usize> = (0..base.kept.len()).filter(is_chosen).collect();
        let nominal = nominal_base(robot, base);
        let noise = self.noise(robot);
        let statistical =
            !matches!(self.objective(), ObjectiveArg::Condition | ObjectiveArg::ScaledCondition);
        let row_scales = match (&noise, statistical) {
            (Some(noise), true) => noise.iter().map(|noise| 1.0 / noise).collect(),
            _ => vec![1.0; robot.joint_count()],
        };
        let shares = Shares {
            position: self.position_share,
            velocity: self.speed_share,
            acceleration: self.acceleration_share,
        };
        Ok(SearchSettings {
            period: self.seconds,
            harmonics: usize::from(self.harmonics),
            form: self.form.form(),
            objective: match self.objective() {
                ObjectiveArg::Condition => Objective::Condition,
                ObjectiveArg::ScaledCondition => Objective::ScaledCondition,
                ObjectiveArg::LogDeterminant => Objective::LogDeterminant,
                ObjectiveArg::Mixed => Objective::Mixed { condition: self.condition_share },
                ObjectiveArg::StandardDeviation => Objective::StandardDeviation,
            },
            scales: self.scales(robot, base, &parameters, &nominal)?,
            parameters,
            known: None,
            row_scales,
            limits: robot.joints.iter().map(|joint| MotionLimits::of(joint, &shares)).collect(),
            clearance: None,
            torque: self.torque_limits(robot, base),
            // the search counts relative to its own speed limit
            reached_speed: self.reached() / self.speed_share,
        })
    }

    /// Reference values of the standard deviations; infinite for parameters that do not count.
    pub(super) fn scales(
        &self,
        robot: &Robot,
        base: &BaseParameters,
        parameters: &[usize],
        nominal: &[Option<f64>],
    ) -> Result<Vec<f64>, CliError> {
        let mut scales = sizes(base, parameters, nominal);
        if self.precise.is_empty() {
            return Ok(scales);
        }
        if !matches!(self.objective(), ObjectiveArg::StandardDeviation) {
            return Err(CliError::Usage("--precise requires --objective standard-deviation".into()));
        }
        let mut counts = vec![false; parameters.len()];
        let by_load = load_direction(robot, base);
        let essential = match self.precise.iter().any(|name| name == ESSENTIAL) {
            true => self.essential(robot, base, nominal)?,
            false => Vec::new(),
        };
        for name in &self.precise {
            let mut any = false;
            for (counts, &k) in counts.iter_mut().zip(parameters) {
                let id = &base.kept[k];
                let is_friction = matches!(id.kind, ParameterKind::Friction(_));
                let group = if is_friction { "friction" } else { "link" };
                let meant = id.to_string() == *name
                    || format!("{group}-{}", id.joint) == *name
                    || (name == LOAD && by_load[k] != 0.0)
                    || (name == ESSENTIAL && essential.contains(&k));
                *counts |= meant;
                any |= meant;
            }
            if !any {
                let names: Vec<String> = parameters.iter().map(|&k| base.kept[k].to_string()).collect();
                return Err(CliError::Usage(format!(
                    "--precise {name}: no such parameter among {}; load, essential, friction-1 to \
                    friction-{} and link-1 to link-{} are groups of parameters, and --columns all includes \
                    friction",
                    names.join(", "),
                    robot.joint_count(),
                    robot.joint_count()
                )));
            }
        }
        scales
            .iter_mut()
            .zip(counts)
            .filter(|(_, counts)| !counts)
            .for_each(|(scale, _)| *scale = f64::INFINITY);
        Ok(scales)
    }

    /// Parameters that a period of the description's excitation, or of a random one, identifies well enough.
    fn essential(
        &self,
        robot: &Robot,
        base: &BaseParameters,
        nominal: &[Option<f64>],
    ) -> Result<Vec<usize>, CliError> {
        let lacking = |what: &str| CliError::Usage(format!("--precise {ESSENTIAL} needs {what}"));
        let values: Option<Vec<f64>> = nominal.iter().copied().collect();
        let values = values.ok_or_else(|| lacking("nominal parameters of all joints in the description"))?;
        let noise =
            self.noise(robot).ok_or_else(|| lacking("the noise of every torque signal; give --noise-nm"))?;
        let series =
            fourier_excitation(robot, self.seed).map_err(|error| CliError::Usage(error.to_string()))?;
        Information::of_series(robot, base, &series, &self.recording_of(noise))
            .and_then(|known| known.essential(&values, EssentialSettings::default().relative_error))
            .map_err(|error| CliError::Usage(error.to_string()))
    }

    /// Limits of torques, if they are described and the parameters are known.
    pub(super) fn torque_limits(&self, robot: &Robot, base: &BaseParameters) -> Option<TorqueLimits> {
        let DutyLimits { weights, rated } = DutyLimits::of(robot);
        let share = TORQUE_CLEARANCE * self.torque_share;
        let mean_square_root: Vec<Option<f64>> = rated
            .into_iter()
            .map(|rated| rated.map(|rated| share * rated).filter(|limit| *limit > 0.0))
            .collect();
        let peak: Vec<Option<f64>> =
            robot.joints.iter().map(|joint| joint.peak_torque.map(|peak| TORQUE_CLEARANCE * peak)).collect();
        if mean_square_root.iter().chain(&peak).all(Option::is_none) {
            return None;
        }
        // MotionCheck reports a limit without parameters
        let parameters = nominal_parameters(robot, base).ok()?;
        Some(TorqueLimits { parameters, duty: weights, mean_square_root, peak })
    }

    /// Noise of each torque signal, if known.
    pub(super) fn noise(&self, robot: &Robot) -> Option<Vec<f64>> {
        let of_joint = |joint: &armwatch_model::robot::Joint| {
            let known = joint.nominal.as_ref().map(|nominal| nominal.torque_noise);
            self.noise_nm.or(known).filter(|noise| *noise > 0.0)
        };
        robot.joints.iter().map(of_joint).collect()
    }

    pub(super) fn recording(&self, robot: &Robot) -> Result<Option<RecordingPlan>, CliError> {
        let noise = self.noise(robot);
        if noise.is_none() {
            output::print_hint(
                "the description has no noise of every torque signal, so there is no prediction; give it \
                with --noise-nm",
            );
        }
        Ok(noise.map(|noise| self.recording_of(noise)))
    }

    fn recording_of(&self, noise: Vec<f64>) -> RecordingPlan {
        let cutoff_hz = AnalysisSettings::default().cutoff;
        RecordingPlan { sample_rate_hz: self.rate_hz, periods: 1, cutoff_hz, noise }
    }
}

/// Reference values of the standard deviations: the nominal value, or the root mean square of those of the same unit if
/// that is larger; 1 if nothing is known.
pub(super) fn sizes(base: &BaseParameters, chosen: &[usize], nominal: &[Option<f64>]) -> Vec<f64> {
    let unit = |k: usize| base.kept[k].unit(JointKind::Revolute);
    let of = |&k: &usize| {
        let like: Vec<f64> = (0..nominal.len())
            .filter(|&other| unit(other) == unit(k))
            .filter_map(|other| nominal[other])
            .collect();
        let squares: f64 = like.iter().map(|value| value * value).sum();
        let usual = (squares / like.len().max(1) as f64).sqrt();
        let size = nominal[k].map_or(usual, |value| usual.max(value.abs()));
        if size > 0.0 { size } else { 1.0 }
    };
    chosen.iter().map(of).collect()
}
