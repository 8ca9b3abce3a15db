//! Bodies of all links from stored factors: no export is read.

use std::sync::Arc;

use super::chosen_cycles::{PooledCycles, StoredError};
use armwatch_method::model::base_parameters::base_parameters;
use armwatch_method::physical::fit::{PhysicalFit, physical_fit};
use armwatch_model::robot::Robot;

/// Fits physically consistent parameters of all links to combined cycles.
///
/// # Errors
/// [`StoredError::Refused`] if `robot` is not the description of the cycles; [`StoredError::Numerics`] if the motion is
/// too poor.
pub async fn fit_bodies(taken: PooledCycles, robot: Arc<Robot>) -> Result<PhysicalFit, StoredError> {
    if !taken.model.describes(&robot) {
        return Err(StoredError::Refused(format!(
            "the description {} is not the one that the cycles were analysed with ({}): geometry, gravity, \
            friction columns or couplings differ; give the right one with --description",
            robot.model, taken.model.name
        )));
    }
    let fit = tokio::task::spawn_blocking(move || {
        let base = base_parameters(&robot)?;
        physical_fit(&robot, &base, &taken.union.embedded_in(&base)?, taken.union.independent_fraction())
    });
    Ok(fit.await??)
}
