//! `/v1/`: what is stored, as JSON, for pages and programs; and what people do with alarms.
//!
//! Reading goes through a handle of its own, so that pages take no turn of the pipeline's readers. Rows have the names
//! and units of the SQL views. What changes something needs a token, also on this machine: any page in a browser could
//! send such a request otherwise.

mod act;
mod events;
mod fleet;
mod number;
mod payload;
mod quarantined;
mod row;
mod rows;
mod session;
mod sql;
pub(super) mod torque;

use std::sync::Arc;

use axum::Extension;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use super::shared::Shared;
pub(super) use events::watch;

/// The addresses under `/v1/` besides those of exports.
pub(super) fn routes() -> OpenApiRouter<Arc<Shared>> {
    OpenApiRouter::new()
        .routes(routes!(session::session, session::log_in, session::log_out))
        .routes(routes!(fleet::fleet))
        .routes(routes!(rows::views))
        .routes(routes!(rows::of_view))
        .routes(routes!(sql::sql))
        .routes(routes!(torque::of_cycle))
        .routes(routes!(payload::payload))
        .routes(routes!(quarantined::of_fault))
        .routes(routes!(quarantined::file))
        .routes(routes!(events::events))
        .routes(routes!(act::on_anomaly))
        .routes(routes!(act::maintenance))
        .routes(routes!(act::edit_maintenance, act::delete_maintenance))
        .routes(routes!(act::plan_window))
        .routes(routes!(act::cancel_window))
        .routes(routes!(act::retry))
        .routes(routes!(act::dismiss))
        .layer(Extension(Arc::<fleet::FleetCache>::default()))
}
