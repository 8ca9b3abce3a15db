//! What people do in a page: with alarms, with work on a robot, with exports that were not understood.

use std::sync::Arc;

use axum::extract::rejection::JsonRejection;
use axum::extract::{Path, State};
use axum::http::{HeaderMap, StatusCode};
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::number::number;
use super::row::Row;
use crate::serve::access::Scope;
use crate::serve::answer::{Json, Problem, Refusal, Refused};
use crate::serve::shared::Shared;
use armwatch_model::robot::JointIndex;
use armwatch_store::{
    AlarmAction, MaintenanceRow, NewMaintenance, NotDone, NotEntered, ViewRows, time_in_views,
};

/// Most characters of a name or a reason.
const LONGEST: usize = 1000;

/// Bodies as they are sent, for those who sent another one.
const DEED_EXAMPLE: &str = r#"{"who": "Lena", "why": "spare part is ordered"}"#;
const DISMISSAL_EXAMPLE: &str = r#"{"who": "Lena", "why": "a list of parts, not an export"}"#;
const WORK_EXAMPLE: &str = r#"{"who": "Lena", "what": "gearbox changed", "joint": 3}"#;

/// Source of the numbers of quarantined runs.
const QUARANTINE_SOURCE: &str = "GET /v1/views/quarantine has the numbers in its column run_id";

/// Who does something with an alarm, and why
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Deed {
    /// The person, for those who read the history later
    #[schema(min_length = 1, max_length = 1000)]
    who: String,
    /// A reason
    #[schema(max_length = 1000)]
    why: Option<String>,
    /// End of shelve, which lies ahead, of a critical anomaly by at most 90 days
    until: Option<Timestamp>,
}

/// Work that was done on a robot
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Work {
    /// The person, for those who read the history later
    #[schema(min_length = 1, max_length = 1000)]
    who: String,
    /// What was done
    #[schema(min_length = 1, max_length = 1000, example = "gearbox changed")]
    what: String,
    /// Its joint, from 1; absent: the whole arm
    #[schema(minimum = 1)]
    joint: Option<usize>,
    /// When it was done; absent: now
    at: Option<Timestamp>,
}

/// Work as it is entered
#[derive(Debug, Serialize, ToSchema)]
pub struct Entered {
    /// Its number
    maintenance_id: i64,
    /// The robot
    robot: String,
    /// Its joint, from 1; null: the whole arm
    joint: Option<usize>,
    /// When it was done, UTC
    #[schema(format = DateTime)]
    at: String,
    /// What was done
    what: String,
    /// The person
    who: Option<String>,
}

/// A retry as it is noted
#[derive(Debug, Serialize, ToSchema)]
pub struct Noted {
    /// The run in quarantine
    run_id: i64,
    /// What becomes of it
    outcome: &'static str,
}

/// Answer an anomaly
///
/// `shelve` needs `until`. The answer is the anomaly as it stands then, a row of the view `anomalies`.
#[utoipa::path(
    post, path = "/v1/anomalies/{id}/{action}", tag = "Actions", operation_id = "answerAnomaly",
    params(
        ("id" = i64, Path, description = "Its anomaly_id"),
        ("action" = String, Path, description = "acknowledge, shelve, resolve, false-alarm or reopen, which takes an earlier answer back", pattern = "^(acknowledge|shelve|resolve|false-alarm|reopen)$"),
    ),
    request_body = Deed,
    responses(
        (status = 200, description = "The anomaly as it stands then", body = Row),
        (status = 400, description = "The number is none, or the body lacks a field or has a wrong or unknown one", body = Problem),
        (status = 404, description = "No such anomaly or action", body = Problem),
        (status = 409, description = "The anomaly stands so already", body = Problem),
        (status = 413, description = "The body is larger than 256 KiB", body = Problem),
        (status = 415, description = "The body is not said to be JSON", body = Problem),
        Refused,
    ),
    security(("token" = ["act"])),
)]
pub async fn on_anomaly(
    State(shared): State<Arc<Shared>>,
    Path((id, action)): Path<(String, String)>,
    headers: HeaderMap,
    deed: Result<axum::Json<Deed>, JsonRejection>,
) -> Result<Json<Option<Row>>, Refusal> {
    shared.access.check_for(Scope::Act, &headers)?;
    let id = number(&id, "anomaly", "GET /v1/views/anomalies has the numbers in its column anomaly_id")?;
    let Deed { who, why, until } = body(deed, DEED_EXAMPLE)?;
    let who = named(&who)?;
    let why = why.map(|why| bounded(&why, "why")).transpose()?.filter(|why| !why.is_empty());
    let action = match (action.as_str(), until) {
        ("acknowledge", _) => AlarmAction::Acknowledge,
        ("resolve", _) => AlarmAction::Resolve,
        ("reopen", _) => AlarmAction::Reopen,
        ("false-alarm", _) => AlarmAction::FalseAlarm,
        ("shelve", Some(until)) if until > Timestamp::now() => AlarmAction::Shelve(until),
        ("shelve", _) => {
            return Err(bad(
                "until is missing or in the past; give a time in the future, such as 2099-01-07T06:00:00Z",
            ));
        }
        _ => {
            let actions = "acknowledge, shelve, resolve, false-alarm and reopen";
            return Err(Refusal::new(
                StatusCode::NOT_FOUND,
                format!("there is no action {action}; there are {actions}"),
            ));
        }
    };
    let acted = shared.store.act_on_anomalies(&[id], action, &who, why.as_deref()).await;
    acted.map_err(|error| Refusal::internal(&error))?.map_err(|reason| not_done(&reason))?;
    let wanted =
        ViewRows { filters: vec![("anomaly_id".into(), id.to_string())], limit: 1, ..ViewRows::default() };
    let rows = shared.store.rows_of_view("anomalies", &wanted).await.map_err(Refusal::unanswered)?;
    Ok(Json(rows.objects().find_map(Row::of)))
}

/// Enter work on a robot
///
/// A new baseline begins. Anomalies of the joint, or without one of the whole robot, that began before and are open,
/// acknowledged or shelved are in maintenance then.
#[utoipa::path(
    post, path = "/v1/robots/{robot}/maintenance", tag = "Actions", operation_id = "enterWork",
    params(("robot" = String, Path, description = "Name of the robot")),
    request_body = Work,
    responses(
        (status = 201, description = "The work is entered", body = Entered),
        (status = 400, description = "The body lacks a field or has a wrong or unknown one", body = Problem),
        (status = 404, description = "No such robot", body = Problem),
        (status = 409, description = "The same work was entered within the same minute", body = Problem),
        (status = 413, description = "The body is larger than 256 KiB", body = Problem),
        (status = 415, description = "The body is not said to be JSON", body = Problem),
        Refused,
    ),
    security(("token" = ["act"])),
)]
pub async fn maintenance(
    State(shared): State<Arc<Shared>>,
    Path(robot): Path<String>,
    headers: HeaderMap,
    work: Result<axum::Json<Work>, JsonRejection>,
) -> Result<(StatusCode, Json<Entered>), Refusal> {
    shared.access.check_for(Scope::Act, &headers)?;
    let Work { who, what, joint, at } = body(work, WORK_EXAMPLE)?;
    let (who, what) = (named(&who)?, bounded(&what, "what")?);
    if what.is_empty() {
        return Err(bad("give what was done, such as \"gearbox changed\""));
    }
    let now = Timestamp::now();
    let at = at.unwrap_or(now);
    if at > now {
        return Err(bad("the time of the work is in the future; enter work after it is finished"));
    }
    let failed = |error| Refusal::internal(&error);
    let unknown = || {
        let sentence = format!("no export of a robot \"{robot}\" is stored; GET /v1/fleet lists the robots");
        Refusal::new(StatusCode::NOT_FOUND, sentence)
    };
    let joints = shared.store.known_joints(&robot).await.map_err(failed)?.ok_or_else(unknown)?;
    let place = match joint {
        Some(number) => {
            Some(JointIndex::from_number(number).filter(|_| joints == 0 || number <= joints).ok_or_else(
                || bad(&format!("{robot} has no joint {number}; its tests have {joints} joints")),
            )?)
        }
        None => None,
    };
    let new = NewMaintenance { robot: robot.clone(), joint: place, at, what, who: Some(who) };
    let number = match shared.store.enter_maintenance(&new).await.map_err(failed)? {
        Ok(number) => number,
        Err(NotEntered::NoRobot) => return Err(unknown()),
        Err(NotEntered::Known(row)) => {
            let sentence = format!(
                "this work is entered already, as number {}: {row}; GET /v1/views/maintenance_log has all",
                row.work.maintenance_id
            );
            return Err(Refusal::new(StatusCode::CONFLICT, sentence));
        }
    };
    let NewMaintenance { what, who, .. } = new;
    let entered = Entered { maintenance_id: number, robot, joint, at: time_in_views(at), what, who };
    Ok((StatusCode::CREATED, Json(entered)))
}

/// Delete an entry of work
///
/// Anomalies that only this entry put into the state maintenance are open again, and the baseline is that of before.
#[utoipa::path(
    delete, path = "/v1/maintenance/{id}", tag = "Actions", operation_id = "deleteWork",
    params(("id" = i64, Path, description = "Its maintenance_id")),
    responses(
        (status = 200, description = "The entry as it was", body = Entered),
        (status = 400, description = "The number is none", body = Problem),
        (status = 404, description = "No such entry", body = Problem),
        Refused,
    ),
    security(("token" = ["act"])),
)]
pub async fn delete_maintenance(
    State(shared): State<Arc<Shared>>,
    Path(id): Path<String>,
    headers: HeaderMap,
) -> Result<Json<Entered>, Refusal> {
    shared.access.check_for(Scope::Act, &headers)?;
    let source = "GET /v1/views/maintenance_log has the numbers in its column maintenance_id";
    let maintenance_id = number(&id, "entry of work", source)?;
    let removed = shared.store.remove_maintenance(maintenance_id).await;
    let Some(MaintenanceRow { robot, work, .. }) = removed.map_err(|error| Refusal::internal(&error))? else {
        let sentence = format!("there is no entry of work {maintenance_id}; {source}");
        return Err(Refusal::new(StatusCode::NOT_FOUND, sentence));
    };
    tracing::info!(maintenance_id, robot, what = work.what, "deleted an entry of work over HTTP");
    let joint = work.joint.map(JointIndex::number);
    let at = time_in_views(work.at);
    Ok(Json(Entered { maintenance_id, robot, joint, at, what: work.what, who: work.who }))
}

/// Dismiss an export in quarantine
///
/// Nothing is to be done about it, for example because it is not an export. A retry takes that back.
#[utoipa::path(
    post, path = "/v1/quarantine/{run_id}/dismiss", tag = "Actions", operation_id = "dismiss",
    params(("run_id" = i64, Path, description = "Its run")),
    request_body = Deed,
    responses(
        (status = 200, description = "The export is no longer counted as a problem", body = Noted),
        (status = 400, description = "The number is none, or the body lacks who or why", body = Problem),
        (status = 409, description = "The run is not in quarantine, or it is dismissed already", body = Problem),
        Refused,
    ),
    security(("token" = ["act"])),
)]
pub async fn dismiss(
    State(shared): State<Arc<Shared>>,
    Path(run_id): Path<String>,
    headers: HeaderMap,
    deed: Result<axum::Json<Deed>, JsonRejection>,
) -> Result<Json<Noted>, Refusal> {
    shared.access.check_for(Scope::Act, &headers)?;
    let run_id = number(&run_id, "run", QUARANTINE_SOURCE)?;
    let Deed { who, why, .. } = body(deed, DISMISSAL_EXAMPLE)?;
    let who = named(&who)?;
    let why = bounded(&why.unwrap_or_default(), "why")?;
    if why.is_empty() {
        return Err(bad("why is missing; say why nothing is to be done, such as \"not an export\""));
    }
    if !shared.store.dismiss(run_id, &who, &why).await.map_err(|error| Refusal::internal(&error))? {
        return Err(not_in_quarantine(run_id));
    }
    Ok(Json(Noted { run_id, outcome: "it is dismissed; a retry takes that back" }))
}

fn not_in_quarantine(run_id: i64) -> Refusal {
    let sentence = format!("run {run_id} is not in quarantine; GET /v1/views/quarantine lists what is");
    Refusal::new(StatusCode::CONFLICT, sentence)
}

/// Have an export in quarantine read again
#[utoipa::path(
    post, path = "/v1/quarantine/{run_id}/retry", tag = "Actions", operation_id = "retry",
    params(("run_id" = i64, Path, description = "Its run")),
    responses(
        (status = 202, description = "It is read again at the next scan", body = Noted),
        (status = 400, description = "The number is none", body = Problem),
        (status = 409, description = "The run is not in quarantine", body = Problem),
        Refused,
    ),
    security(("token" = ["act"])),
)]
pub async fn retry(
    State(shared): State<Arc<Shared>>,
    Path(run_id): Path<String>,
    headers: HeaderMap,
) -> Result<(StatusCode, Json<Noted>), Refusal> {
    shared.access.check_for(Scope::Act, &headers)?;
    let run_id = number(&run_id, "run", QUARANTINE_SOURCE)?;
    if !shared.store.ask_retry(run_id).await.map_err(|error| Refusal::internal(&error))? {
        return Err(not_in_quarantine(run_id));
    }
    shared.store.withdraw_dismissal(run_id).await.map_err(|error| Refusal::internal(&error))?;
    Ok((StatusCode::ACCEPTED, Json(Noted { run_id, outcome: "it is read again at the next scan" })))
}

fn body<T>(sent: Result<axum::Json<T>, JsonRejection>, example: &str) -> Result<T, Refusal> {
    sent.map(|axum::Json(body)| body).map_err(|rejection| Refusal::of_json(&rejection, example))
}

fn named(who: &str) -> Result<String, Refusal> {
    let who = bounded(who, "who")?;
    if who.is_empty() { Err(bad("give who does it, for those who read the history later")) } else { Ok(who) }
}

fn bounded(text: &str, name: &str) -> Result<String, Refusal> {
    let text = text.trim();
    if text.chars().count() > LONGEST || text.contains('\0') {
        return Err(bad(&format!("{name}: give at most {LONGEST} characters")));
    }
    Ok(text.to_owned())
}

fn bad(sentence: &str) -> Refusal {
    Refusal::new(StatusCode::BAD_REQUEST, sentence)
}

fn not_done(reason: &NotDone) -> Refusal {
    let status = match reason {
        NotDone::Unknown(_) | NotDone::Withdrawn(_) => StatusCode::NOT_FOUND,
        NotDone::TooLong(_) => StatusCode::BAD_REQUEST,
        NotDone::NotFrom { .. } => StatusCode::CONFLICT,
    };
    Refusal::new(status, reason.to_string())
}
