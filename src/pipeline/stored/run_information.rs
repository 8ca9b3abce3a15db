//! Information of a stored run's motion about a robot's parameters.

use super::chosen_cycles::{ChosenCycles, RunCycles, StoredError, chosen_cycles};
use armwatch_method::identify::joint_factors::{FactorColumns, unpack};
use armwatch_method::model::base_parameters::BaseParameters;
use armwatch_model::analysis::Motion;
use armwatch_model::robot::Robot;
use armwatch_store::{FactorsWanted, Store};
use armwatch_trajectory::information::Information;

/// Information of a run's rows.
#[derive(Debug, Clone)]
pub struct RunInformation {
    /// Information about the base parameters, from the rows of moving joints.
    pub information: Information,
    /// Rows of the run, moving or not.
    pub rows: usize,
}

/// Information of the moving rows of all stages of a run about the base parameters of `robot`, at the noise of each
/// joint's torque signal `[n]`, Nm (N).
///
/// # Errors
/// [`StoredError::Refused`] if the run has no factors or was analysed with another description.
pub async fn run_information(
    store: &Store,
    run_id: i64,
    robot: &Robot,
    base: &BaseParameters,
    noise: &[f64],
) -> Result<RunInformation, StoredError> {
    let chosen = RunCycles { named: true, ..RunCycles::all(run_id) };
    let chosen: ChosenCycles = chosen_cycles(store, &chosen, FactorsWanted::All).await?;
    let mut shown = RunInformation { information: Information::none(base.kept.len()), rows: 0 };
    let mut rows = vec![0; robot.joint_count()];
    for (_, model, factors) in chosen.all_factors() {
        if !model.describes(robot) {
            return Err(StoredError::Refused(format!(
                "run {run_id} was analysed with another description of model {} than this one",
                model.name
            )));
        }
        let columns = FactorColumns::of_stored(&factors.columns);
        let mut factors = unpack(factors)?;
        factors.iter().for_each(|of| rows[of.joint.index()] += of.factor.rows());
        factors.retain(|of| of.motion == Motion::Moving);
        let more = Information::of_factors(base, &columns, &factors, noise)?;
        shown.information = shown.information.with(&more);
    }
    shown.rows = rows.into_iter().max().unwrap_or(0);
    if shown.rows == 0 {
        return Err(StoredError::PassedOver(chosen.passed_over));
    }
    Ok(shown)
}
