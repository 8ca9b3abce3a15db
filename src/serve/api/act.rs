//! Actions of people on a page: on alarms, on maintenance of a robot, on quarantined exports.

use std::sync::Arc;

use axum::extract::rejection::JsonRejection;
use axum::extract::{Path, State};
use axum::http::{HeaderMap, StatusCode};
use jiff::{SignedDuration, Timestamp};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::number::number;
use super::row::ViewRow;
use crate::serve::access::Scope;
use crate::serve::answer::{Json, Problem, Refusal, Refused};
use crate::serve::shared::Shared;
use armwatch_model::robot::JointIndex;
use armwatch_store::{
    AlarmAction, MaintenanceRow, NewMaintenance, NewWindow, NotDone, NotEntered, ViewRows, time_in_views,
};

/// Most characters of a name or a reason.
const LONGEST: usize = 1000;

/// Examples of bodies, for clients that sent a wrong one.
const DEED_EXAMPLE: &str = r#"{"who": "Lena", "why": "spare part is ordered"}"#;
const DISMISSAL_EXAMPLE: &str = r#"{"who": "Lena", "why": "a list of parts, not an export"}"#;
const WORK_EXAMPLE: &str = r#"{"who": "Lena", "what": "gearbox changed", "joint": 3}"#;

const PLAN_EXAMPLE: &str =
    r#"{"who": "Lena", "what": "gearbox is changed", "until": "2099-01-07T06:00:00Z"}"#;

/// Longest maintenance window. A longer one is probably a typing error, and would hide alarms for years.
const LONGEST_PLAN: SignedDuration = SignedDuration::from_hours(24 * 366);

/// Source of the numbers of maintenance entries.
const WORK_SOURCE: &str = "GET /v1/views/maintenance_log has the numbers in its column maintenance_id";

/// Source of the numbers of quarantined runs.
const QUARANTINE_SOURCE: &str = "GET /v1/views/quarantine has the numbers in its column run_id";

/// The person who acts on an alarm, and the reason
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Deed {
    /// The person, for those who read the history later
    #[schema(min_length = 1, max_length = 1000)]
    who: String,
    /// A reason
    #[schema(max_length = 1000)]
    why: Option<String>,
    /// End of shelve, in the future; for a critical anomaly at most 90 days from now
    until: Option<Timestamp>,
    /// The person who deals with it after an assign; absent: no one
    #[schema(max_length = 1000)]
    to: Option<String>,
}

/// Work that was done on a robot
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Work {
    /// The person, for those who read the history later
    #[schema(min_length = 1, max_length = 1000)]
    who: String,
    /// The completed work
    #[schema(min_length = 1, max_length = 1000, example = "gearbox changed")]
    what: String,
    /// Its joint, from 1; absent: the whole arm
    #[schema(minimum = 1)]
    joint: Option<usize>,
    /// When it was done; absent: now
    at: Option<Timestamp>,
}

/// An entry of work
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
    /// The completed work
    what: String,
    /// The person
    who: Option<String>,
}

/// The answer to a retry or a dismissal
#[derive(Debug, Serialize, ToSchema)]
pub struct Noted {
    /// The run in quarantine
    run_id: i64,
    /// The outcome for the run
    outcome: &'static str,
}

/// Answer an anomaly
///
/// `shelve` needs `until`, and `comment` needs `why`, its text. `comment` and `assign` change no state. The answer is
/// the anomaly in its new state, a row of the view `anomalies`.
#[utoipa::path(
    post, path = "/v1/anomalies/{id}/{action}", tag = "Actions", operation_id = "answerAnomaly",
    params(
        ("id" = i64, Path, description = "Its anomaly_id"),
        ("action" = String, Path, description = "acknowledge, shelve, resolve, false-alarm, comment, assign or reopen, which takes an earlier answer back", pattern = "^(acknowledge|shelve|resolve|false-alarm|comment|assign|reopen)$"),
    ),
    request_body = Deed,
    responses(
        (status = 200, description = "The anomaly as it stands then", body = ViewRow),
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
) -> Result<Json<Option<ViewRow>>, Refusal> {
    shared.access.check_for(Scope::Act, &headers)?;
    let id = number(&id, "anomaly", "GET /v1/views/anomalies has the numbers in its column anomaly_id")?;
    let Deed { who, why, until, to } = body(deed, DEED_EXAMPLE)?;
    let who = named(&who)?;
    let given = |text: Option<String>, name| {
        text.map(|text| bounded(&text, name)).transpose().map(|text| text.filter(|text| !text.is_empty()))
    };
    let (why, to) = (given(why, "why")?, given(to, "to")?);
    let noted = match (action.as_str(), &why) {
        ("comment", None) => return Err(bad("why is missing; give the text of the comment")),
        ("comment", Some(text)) => Some(shared.store.comment_on_anomaly(id, &who, text).await),
        ("assign", _) => Some(shared.store.assign_anomaly(id, to.as_deref(), &who).await),
        _ => None,
    };
    if let Some(noted) = noted {
        noted.map_err(Refusal::internal)?.map_err(|reason| not_done(&reason))?;
        return anomaly(&shared, id).await;
    }
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
            let actions = "acknowledge, shelve, resolve, false-alarm, comment, assign and reopen";
            return Err(Refusal::new(
                StatusCode::NOT_FOUND,
                format!("there is no action {action}; there are {actions}"),
            ));
        }
    };
    let acted = shared.store.act_on_anomalies(&[id], action, &who, why.as_deref()).await;
    acted.map_err(Refusal::internal)?.map_err(|reason| not_done(&reason))?;
    anomaly(&shared, id).await
}

/// The anomaly in its current state.
async fn anomaly(shared: &Shared, id: i64) -> Result<Json<Option<ViewRow>>, Refusal> {
    let wanted =
        ViewRows { filters: vec![("anomaly_id".into(), id.to_string())], limit: 1, ..ViewRows::default() };
    let rows = shared.store.rows_of_view("anomalies", &wanted).await.map_err(Refusal::unanswered)?;
    Ok(Json(rows.objects().find_map(ViewRow::of)))
}

/// Enter work on a robot
///
/// A new baseline begins. Earlier anomalies that are open, acknowledged or shelved enter maintenance. This applies to
/// anomalies of the joint or, without a joint, of the whole robot.
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
    let new = checked_work(&shared, robot, body(work, WORK_EXAMPLE)?).await?;
    let entered = shared.store.enter_maintenance(&new).await.map_err(Refusal::internal)?;
    let number = entered.map_err(|reason| not_entered(&reason, &new.robot))?;
    Ok((StatusCode::CREATED, Json(Entered::of(number, new))))
}

/// Correct an entry of work
///
/// If the place or the time changes, baselines and anomalies are as if the old entry had never existed. The entry then
/// has another number. Without `at`, the time does not change.
#[utoipa::path(
    put, path = "/v1/maintenance/{id}", tag = "Actions", operation_id = "correctWork",
    params(("id" = i64, Path, description = "Its maintenance_id")),
    request_body = Work,
    responses(
        (status = 200, description = "The entry as it stands then", body = Entered),
        (status = 400, description = "The number is none, or the body lacks a field or has a wrong or unknown one", body = Problem),
        (status = 404, description = "No such entry", body = Problem),
        (status = 409, description = "The same work was entered within the same minute", body = Problem),
        Refused,
    ),
    security(("token" = ["act"])),
)]
pub async fn edit_maintenance(
    State(shared): State<Arc<Shared>>,
    Path(id): Path<String>,
    headers: HeaderMap,
    work: Result<axum::Json<Work>, JsonRejection>,
) -> Result<Json<Entered>, Refusal> {
    shared.access.check_for(Scope::Act, &headers)?;
    let maintenance_id = number(&id, "entry of work", WORK_SOURCE)?;
    let all = shared.store.maintenance(None).await.map_err(Refusal::internal)?;
    let old = all.into_iter().find(|row| row.work.maintenance_id == maintenance_id);
    let old = old.ok_or_else(|| no_entry(maintenance_id))?;
    let mut work = body(work, WORK_EXAMPLE)?;
    work.at.get_or_insert(old.work.at);
    let new = checked_work(&shared, old.robot, work).await?;
    let edited = shared.store.edit_maintenance(maintenance_id, &new).await.map_err(Refusal::internal)?;
    let edited = edited.ok_or_else(|| no_entry(maintenance_id))?;
    let number = edited.map_err(|reason| not_entered(&reason, &new.robot))?;
    Ok(Json(Entered::of(number, new)))
}

impl Entered {
    fn of(maintenance_id: i64, new: NewMaintenance) -> Self {
        let NewMaintenance { robot, joint, at, what, who } = new;
        let joint = joint.map(JointIndex::number);
        Self { maintenance_id, robot, joint, at: time_in_views(at), what, who }
    }
}

async fn checked_work(shared: &Shared, robot: String, work: Work) -> Result<NewMaintenance, Refusal> {
    let Work { who, what, joint, at } = work;
    let (who, what) = (named(&who)?, bounded(&what, "what")?);
    if what.is_empty() {
        return Err(bad("give what was done, such as \"gearbox changed\""));
    }
    let now = Timestamp::now();
    let at = at.unwrap_or(now);
    if at > now {
        return Err(bad(
            "the time of the work is in the future; enter work after it is finished, or plan a window",
        ));
    }
    let joint = place(shared, &robot, joint).await?;
    Ok(NewMaintenance { robot, joint, at, what, who: Some(who) })
}

/// A joint that the robot has; `None` for the whole arm.
async fn place(shared: &Shared, robot: &str, joint: Option<usize>) -> Result<Option<JointIndex>, Refusal> {
    let joints = shared.store.known_joints(robot).await.map_err(Refusal::internal)?;
    let joints = joints.ok_or_else(|| no_robot(robot))?;
    let Some(number) = joint else { return Ok(None) };
    match JointIndex::from_number(number).filter(|_| joints == 0 || number <= joints) {
        Some(joint) => Ok(Some(joint)),
        None => Err(bad(&format!("{robot} has no joint {number}; its tests have {joints} joints"))),
    }
}

fn no_robot(robot: &str) -> Refusal {
    let sentence = format!("no export of a robot \"{robot}\" is stored; GET /v1/fleet lists the robots");
    Refusal::new(StatusCode::NOT_FOUND, sentence)
}

fn no_entry(maintenance_id: i64) -> Refusal {
    Refusal::new(StatusCode::NOT_FOUND, format!("there is no entry of work {maintenance_id}; {WORK_SOURCE}"))
}

fn not_entered(reason: &NotEntered, robot: &str) -> Refusal {
    match reason {
        NotEntered::NoRobot => no_robot(robot),
        NotEntered::Known(row) => {
            let sentence = format!(
                "this work is entered already, as number {}: {row}; GET /v1/views/maintenance_log has all",
                row.work.maintenance_id
            );
            Refusal::new(StatusCode::CONFLICT, sentence)
        }
    }
}

/// Work that is planned on a robot
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Plan {
    /// The person, for those who read the history later
    #[schema(min_length = 1, max_length = 1000)]
    who: String,
    /// The planned work
    #[schema(min_length = 1, max_length = 1000, example = "gearbox is changed")]
    what: String,
    /// Its joint, from 1; absent: the whole arm
    #[schema(minimum = 1)]
    joint: Option<usize>,
    /// When the window begins; absent: now
    from: Option<Timestamp>,
    /// When it ends, within 366 days
    until: Timestamp,
}

/// A planned maintenance window
#[derive(Debug, Serialize, ToSchema)]
pub struct Planned {
    /// Its number
    maintenance_window_id: i64,
}

/// Plan a maintenance window
///
/// During the window, alarms of its place are in maintenance and no message is sent. Alarms that continue are open
/// again at its end. The window begins no baseline: enter the work when it is done.
#[utoipa::path(
    post, path = "/v1/robots/{robot}/windows", tag = "Actions", operation_id = "planWindow",
    params(("robot" = String, Path, description = "Name of the robot")),
    request_body = Plan,
    responses(
        (status = 201, description = "The window is planned", body = Planned),
        (status = 400, description = "The body lacks a field or has a wrong or unknown one, or the window is over", body = Problem),
        (status = 404, description = "No such robot", body = Problem),
        Refused,
    ),
    security(("token" = ["act"])),
)]
pub async fn plan_window(
    State(shared): State<Arc<Shared>>,
    Path(robot): Path<String>,
    headers: HeaderMap,
    plan: Result<axum::Json<Plan>, JsonRejection>,
) -> Result<(StatusCode, Json<Planned>), Refusal> {
    shared.access.check_for(Scope::Act, &headers)?;
    let Plan { who, what, joint, from, until } = body(plan, PLAN_EXAMPLE)?;
    let (who, what) = (named(&who)?, bounded(&what, "what")?);
    if what.is_empty() {
        return Err(bad("give what is to be done, such as \"gearbox is changed\""));
    }
    let now = Timestamp::now();
    let from = from.unwrap_or(now);
    if until <= from || until <= now || until.duration_since(now) > LONGEST_PLAN {
        return Err(bad("until must be after from, in the future and within 366 days"));
    }
    let joint = place(&shared, &robot, joint).await?;
    let window = NewWindow { robot: robot.clone(), joint, from, until, what, who };
    let planned = shared.store.plan_window(&window, now).await.map_err(Refusal::internal)?;
    let maintenance_window_id = planned.ok_or_else(|| no_robot(&robot))?;
    Ok((StatusCode::CREATED, Json(Planned { maintenance_window_id })))
}

/// Delete a maintenance window
///
/// Alarms that are in maintenance only because of this window are open again.
#[utoipa::path(
    delete, path = "/v1/windows/{id}", tag = "Actions", operation_id = "cancelWindow",
    params(("id" = i64, Path, description = "Its maintenance_window_id")),
    responses(
        (status = 204, description = "The window is deleted"),
        (status = 400, description = "The number is none", body = Problem),
        (status = 404, description = "No such window", body = Problem),
        Refused,
    ),
    security(("token" = ["act"])),
)]
pub async fn cancel_window(
    State(shared): State<Arc<Shared>>,
    Path(id): Path<String>,
    headers: HeaderMap,
) -> Result<StatusCode, Refusal> {
    shared.access.check_for(Scope::Act, &headers)?;
    let source = "GET /v1/views/maintenance_windows has the numbers in its column maintenance_window_id";
    let window_id = number(&id, "maintenance window", source)?;
    let cancelled = shared.store.cancel_window(window_id, Timestamp::now()).await;
    if cancelled.map_err(Refusal::internal)? {
        return Ok(StatusCode::NO_CONTENT);
    }
    Err(Refusal::new(StatusCode::NOT_FOUND, format!("there is no maintenance window {window_id}; {source}")))
}

/// Delete an entry of work
///
/// Anomalies that only this entry put into the state maintenance are open again. The earlier baseline applies again.
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
    let maintenance_id = number(&id, "entry of work", WORK_SOURCE)?;
    let removed = shared.store.remove_maintenance(maintenance_id).await;
    let Some(MaintenanceRow { robot, work, .. }) = removed.map_err(Refusal::internal)? else {
        return Err(no_entry(maintenance_id));
    };
    tracing::info!(maintenance_id, robot, what = work.what, "deleted an entry of work over HTTP");
    let joint = work.joint.map(JointIndex::number);
    let at = time_in_views(work.at);
    Ok(Json(Entered { maintenance_id, robot, joint, at, what: work.what, who: work.who }))
}

/// Dismiss an export in quarantine
///
/// The file needs no action, for example because it is not an export. A retry reverses the dismissal.
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
    if !shared.store.dismiss(run_id, &who, &why).await.map_err(Refusal::internal)? {
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
    if !shared.store.ask_retry(run_id).await.map_err(Refusal::internal)? {
        return Err(not_in_quarantine(run_id));
    }
    shared.store.withdraw_dismissal(run_id).await.map_err(Refusal::internal)?;
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
