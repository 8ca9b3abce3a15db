//! `GET /v1/runs/RUN/cycles/CYCLE/torque`: measured and estimated torque of a cycle, read again from its export.

use std::sync::Arc;
use std::time::Duration;

use axum::extract::rejection::QueryRejection;
use axum::extract::{Path, Query, State};
use axum::http::{HeaderMap, StatusCode};
use serde::{Deserialize, Serialize};
use tokio::sync::Semaphore;
use tokio::task::JoinError;
use utoipa::{IntoParams, ToSchema};

use super::number::number;
use crate::pipeline::look::replay::ReplayError;
use crate::pipeline::look::torque::{CycleTorque, JointTorque, cycle_torque};
use crate::serve::answer::{Json, Problem, Refusal, Refused};
use crate::serve::shared::Shared;
use armwatch_model::robot::JointKind;

/// Rows per joint if the request sets no number: more than the pixels of a plot.
const USUAL_POINTS: usize = 1200;

/// Longest wait of a request until another cycle has been read.
pub(in crate::serve) const PATIENCE: Duration = Duration::from_secs(20);

/// Significant digits of a value in a plot.
const DIGITS: i32 = 6;

/// How much is asked for
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct TorqueQuery {
    /// Most rows of each joint; 1200 where it is not given
    #[param(minimum = 8, maximum = 10_000)]
    points: Option<usize>,
}

/// Measured and estimated torque of a cycle
#[derive(Debug, Serialize, ToSchema)]
pub struct Torque {
    /// The run
    run_id: i64,
    /// The cycle
    cycle: u32,
    /// The robot
    robot: String,
    /// Name of the export
    source_name: String,
    /// Cut-off of the low-pass on both torques, Hz
    cutoff_hz: f64,
    /// Stages in their order
    stages: Vec<TorqueStage>,
    /// One entry a joint
    joints: Vec<JointTorqueRows>,
}

/// A stage of a cycle
#[derive(Debug, Serialize, ToSchema)]
pub struct TorqueStage {
    /// excitation, friction, warming, or between them
    stage: &'static str,
    /// Its first row, s since the start of the recording
    from_s: f64,
    /// Its last row, s since the start of the recording
    to_s: f64,
}

/// Torque of a joint; all lists have the same length
#[derive(Debug, Serialize, ToSchema)]
pub struct JointTorqueRows {
    /// Its number, from 1
    joint: usize,
    /// revolute, or prismatic: then torques are forces in N, and the velocity is in m/s
    kind: &'static str,
    /// RMSD of the whole cycle, rows at rest included, Nm (N); null without rows that count
    rmsd_nm: Option<f64>,
    /// RMSD while the joint moves, Nm (N)
    moving_rmsd_nm: Option<f64>,
    /// The same over the RMS of the measured torque
    moving_relative_rmsd: Option<f64>,
    /// Time since the start of the recording, s
    time_s: Vec<f64>,
    /// Measured torque after the low-pass, Nm (N)
    measured_nm: Vec<f64>,
    /// Torque that the cycle's own parameters give for its motion, Nm (N)
    estimated_nm: Vec<f64>,
    /// Measured less estimated torque, Nm (N)
    residual_nm: Vec<f64>,
    /// Velocity, rad/s (m/s)
    velocity_rad_s: Vec<f64>,
    /// Whether the joint moves; at rest the sign of its friction is not known, and the estimate says little
    moving: Vec<bool>,
}

/// Torques of a cycle
///
/// The export is read again, so it must still be there. Each joint's rows are thinned: the smallest and largest torques and
/// residuals of each stretch stay.
#[utoipa::path(
    get, path = "/v1/runs/{run_id}/cycles/{cycle}/torque", tag = "Rows", operation_id = "cycleTorque",
    params(
        ("run_id" = i64, Path, description = "The run"),
        ("cycle" = u32, Path, description = "The cycle, from 1"),
        TorqueQuery,
    ),
    responses(
        (status = 200, description = "The torques", body = Torque),
        (status = 400, description = "Run, cycle or points are no such numbers", body = Problem),
        (status = 404, description = "No such run or cycle, or one without torques or parameters", body = Problem),
        (status = 410, description = "The export is not at hand any more, or another one", body = Problem),
        (status = 503, description = "Other cycles are being read; try again after Retry-After", body = Problem),
        Refused,
    ),
    security(("token" = ["read"]), ()),
)]
pub async fn of_cycle(
    State(shared): State<Arc<Shared>>,
    Path((run_id, cycle)): Path<(String, String)>,
    asked: Result<Query<TorqueQuery>, QueryRejection>,
    headers: HeaderMap,
) -> Result<Json<Torque>, Refusal> {
    const POINTS: std::ops::RangeInclusive<usize> = 8..=10_000;
    shared.access.check(&headers)?;
    let run_id = number(&run_id, "run", "GET /v1/views/runs has the numbers in its column run_id")?;
    let cycle = number(&cycle, "cycle", "GET /v1/views/cycles has the numbers in its column cycle")?;
    let bad = |sentence: String| Refusal::new(StatusCode::BAD_REQUEST, sentence);
    let range = format!("a whole number from {} to {}", POINTS.start(), POINTS.end());
    let Query(TorqueQuery { points }) =
        asked.map_err(|_| bad(format!("the only parameter is points, {range}, as in ?points=1200")))?;
    let points = points.unwrap_or(USUAL_POINTS);
    if !POINTS.contains(&points) {
        return Err(bad(format!("points = {points}: give {range}")));
    }
    let config = Arc::clone(&shared.config.borrow());
    let store = shared.looking().await?.clone();
    let read = async move { cycle_torque(&config, &store, run_id, cycle, points).await };
    let Some(read) = in_turn(&shared.replays, PATIENCE, read).await else {
        let sentence = "other cycles are being read; try again";
        return Err(Refusal::new(StatusCode::SERVICE_UNAVAILABLE, sentence).after(5));
    };
    let found = read.unwrap_or_else(|error| Err(error.into())).map_err(|error| refused(&error))?;
    let CycleTorque { robot, source_name, cutoff_hz, stages, joints } = found;
    let stage = |span: crate::pipeline::look::torque::StageSpan| TorqueStage {
        stage: span.stage.name(),
        from_s: span.from_s,
        to_s: span.to_s,
    };
    Ok(Json(Torque {
        run_id,
        cycle,
        robot,
        source_name,
        cutoff_hz,
        stages: stages.into_iter().map(stage).collect(),
        joints: joints.iter().map(told).collect(),
    }))
}

/// Does `work` when a turn is free. Its own task holds the turn until the work ends, because the request is dropped if
/// its client disconnects, but the reading continues. `None` if no turn became free in time.
pub(in crate::serve) async fn in_turn<T: Send + 'static>(
    turns: &Arc<Semaphore>,
    patience: Duration,
    work: impl Future<Output = T> + Send + 'static,
) -> Option<Result<T, JoinError>> {
    let Ok(Ok(turn)) = tokio::time::timeout(patience, Arc::clone(turns).acquire_owned()).await else {
        return None;
    };
    let task = tokio::spawn(async move {
        let _turn = turn;
        work.await
    });
    Some(task.await)
}

fn told(of: &JointTorque) -> JointTorqueRows {
    let column = |of: &[f64]| of.iter().map(|value| rounded(*value)).collect();
    let residual =
        of.measured_nm.iter().zip(&of.estimated_nm).map(|(measured, estimated)| measured - estimated);
    JointTorqueRows {
        joint: of.joint.number(),
        kind: match of.kind {
            JointKind::Revolute => "revolute",
            JointKind::Prismatic => "prismatic",
        },
        rmsd_nm: (of.rmsd.all_rows.samples > 0).then_some(of.rmsd.all_rows.value),
        moving_rmsd_nm: (of.rmsd.moving_rows.samples > 0).then_some(of.rmsd.moving_rows.value),
        moving_relative_rmsd: (of.rmsd.moving_rows.samples > 0).then_some(of.rmsd.moving_rows.relative),
        time_s: column(&of.time_s),
        measured_nm: column(&of.measured_nm),
        estimated_nm: column(&of.estimated_nm),
        residual_nm: residual.map(rounded).collect(),
        velocity_rad_s: column(&of.velocity_rad_s),
        moving: of.moving.clone(),
    }
}

/// Rounds a value to the digits that a plot shows. Keeps at least three decimal places, for the milliseconds of times.
fn rounded(value: f64) -> f64 {
    if value == 0.0 || !value.is_finite() {
        return value;
    }
    // a small integer for any finite value
    let places = DIGITS - 1 - value.abs().log10().floor() as i32;
    let scale = 10_f64.powi(places.max(3));
    (value * scale).round() / scale
}

fn refused(error: &ReplayError) -> Refusal {
    match error {
        ReplayError::Refused(_) => Refusal::new(StatusCode::NOT_FOUND, error.to_string()),
        ReplayError::Source(_) | ReplayError::Rejected(_) => {
            Refusal::new(StatusCode::GONE, error.to_string())
        }
        ReplayError::Numerics(_) => Refusal::new(StatusCode::NOT_FOUND, error.to_string()),
        ReplayError::Store(_) | ReplayError::Task(_) => Refusal::internal(error),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SOON: Duration = Duration::from_millis(50);
    const LONG: Duration = Duration::from_secs(60);

    #[tokio::test]
    async fn a_turn_lasts_as_long_as_its_work_also_when_nobody_waits_for_it() {
        let turns = Arc::new(Semaphore::new(1));
        let (end, ended) = tokio::sync::oneshot::channel::<()>();
        let (begin, begun) = tokio::sync::oneshot::channel::<()>();
        let request = {
            let turns = Arc::clone(&turns);
            tokio::spawn(async move {
                let work = async move {
                    begin.send(()).expect("somebody waits");
                    ended.await
                };
                in_turn(&turns, LONG, work).await
            })
        };
        begun.await.expect("begun");
        // the client disconnects
        request.abort();
        assert!(request.await.is_err_and(|error| error.is_cancelled()));
        assert!(in_turn(&turns, SOON, async {}).await.is_none(), "two read at once");
        end.send(()).expect("the work goes on");
        assert!(in_turn(&turns, LONG, async {}).await.is_some_and(|done| done.is_ok()));
        assert_eq!(turns.available_permits(), 1);
    }

    #[tokio::test]
    async fn work_that_fails_gives_its_turn_back() {
        let turns = Arc::new(Semaphore::new(1));
        let failed = in_turn(&turns, LONG, async { panic!("index 7 of 3") }).await;
        assert!(failed.is_some_and(|done: Result<(), _>| done.is_err_and(|error| error.is_panic())));
        assert_eq!(turns.available_permits(), 1);
    }
}
