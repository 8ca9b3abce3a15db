//! Loads that alarms name, as `armwatch payload` finds them.

use crate::pipeline::context::{Pipeline, PipelineError};
use crate::pipeline::stored::chosen_cycles::StoredError;
use crate::pipeline::stored::payload::{PayloadQuantity, payload_of_runs};
use armwatch_method::detect::load_message::load_message;
use armwatch_model::anomaly::Anomaly;
use armwatch_model::anomaly::quantity::Quantity;
use armwatch_model::run::{RunKind, RunStatus};

impl Pipeline {
    /// Gives each load among `anomalies` the mass, centre and interval that `armwatch payload` finds between the last test
    /// before the anomaly and the latest test that shows it. A load keeps the figures of its detector if factors of these
    /// tests are gone, or the motion does not show the mass.
    pub(super) async fn measure_loads(
        &self,
        robot: &str,
        anomalies: &mut [Anomaly],
    ) -> Result<(), PipelineError> {
        let is_load = |of: &&mut Anomaly| of.quantity == Quantity::Load && of.value.is_finite();
        let mut loads = anomalies.iter_mut().filter(is_load).peekable();
        if loads.peek().is_none() {
            return Ok(());
        }
        let mut tests = self.store.runs().await?;
        tests.retain(|run| {
            run.robot == robot && run.kind == RunKind::Test && run.status == RunStatus::Complete
        });
        for load in loads {
            let before = tests.iter().filter(|run| run.started_at < load.first_seen_at);
            let Some(before) = before.max_by_key(|run| run.started_at) else { continue };
            let [empty, loaded] = [before.run_id, load.last_run_id].map(|id| id.to_string());
            let found = match payload_of_runs(&self.config, &self.store, &empty, &loaded).await {
                Ok(found) => found,
                Err(StoredError::Store(error)) => return Err(error.into()),
                Err(StoredError::Task(error)) => return Err(error.into()),
                Err(reason) => {
                    tracing::debug!(robot, empty, loaded, "no interval of the load: {reason}");
                    continue;
                }
            };
            let known = |of: &PayloadQuantity| Some([of.value?, of.interval_low?, of.interval_high?]);
            let [mass, x, y, z, ..] = &found.quantities[..] else { continue };
            let Some([mass, low, high]) = known(mass) else { continue };
            let centre = match [x, y, z].map(|of| of.value) {
                [Some(x), Some(y), Some(z)] => Some(([x, y, z], "tool frame")),
                _ => None,
            };
            let error = format!(
                "95 % interval {low:.2} to {high:.2} kg, for drive gains that are off by up to {:.0} %",
                100.0 * found.gain_uncertainty
            );
            load.value = mass;
            load.message = load_message(mass, &error, centre);
        }
        Ok(())
    }
}
