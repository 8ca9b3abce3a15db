//! The history of a robot for marks in pictures: status of joints, alarms, maintenance.

use jiff::Timestamp;

use crate::cli::context::CliError;
use crate::report::figure::{FigureEvent, FigureEventKind, FigureLevel, StatusWord, day};
use crate::report::friction_index::IndexPoint;
use armwatch_method::statistics::distributions::normal_quantile;
use armwatch_model::anomaly::Severity;
use armwatch_model::robot::JointIndex;
use armwatch_store::{AlarmState, AnomalyRow, FleetHealthRow, HealthStatus, IndexRow, MaintenanceRow, Store};

/// The history of a robot.
#[derive(Debug, Default)]
pub(in crate::cli) struct RobotLife {
    /// Its joints.
    pub(in crate::cli) health: Vec<FleetHealthRow>,
    /// Its anomalies, the oldest first.
    pub(in crate::cli) anomalies: Vec<AnomalyRow>,
    /// Maintenance in chronological order.
    pub(in crate::cli) work: Vec<MaintenanceRow>,
    /// Start of its latest run.
    last_run: Option<Timestamp>,
}

impl RobotLife {
    /// Reads the history of the robot with this name.
    pub(in crate::cli) async fn read(store: &Store, robot: &str) -> Result<Self, CliError> {
        let mut health = store.fleet_health().await?;
        health.retain(|row| row.robot == robot);
        let mut anomalies = store.anomalies_after(0).await?;
        anomalies.retain(|row| row.robot == robot);
        let mut work = store.maintenance(Some(robot)).await?;
        work.sort_by_key(|row| row.work.at);
        let last_run = health.iter().map(|row| row.last_run_at).max();
        Ok(Self { health, anomalies, work, last_run })
    }

    /// Status of a joint.
    pub(in crate::cli) fn standing(&self, joint: JointIndex) -> Option<StatusWord> {
        self.health.iter().find(|row| row.joint == joint).map(|row| standing(row.status))
    }

    /// Events of the robot, by joint; without a joint for the whole arm.
    pub(in crate::cli) fn events(&self) -> Vec<(Option<JointIndex>, FigureEvent)> {
        let alarm = |row: &AnomalyRow| {
            let at = row.onset_at.unwrap_or(row.first_seen_at);
            let label = format!(
                "{} {} from {}: {}",
                row.severity.name(),
                row.kind,
                at.strftime("%Y-%m-%d"),
                row.message
            );
            (row.joint, FigureEvent { at: day(at), kind: FigureEventKind::Alarm, label })
        };
        let repair = |row: &MaintenanceRow| {
            let label = format!("maintenance on {}: {}", row.work.at.strftime("%Y-%m-%d"), row.work.what);
            (row.work.joint, FigureEvent { at: day(row.work.at), kind: FigureEventKind::Repair, label })
        };
        let alarms = self.anomalies.iter().filter(|row| is_alarm(row)).map(alarm);
        alarms.chain(self.work.iter().map(repair)).collect()
    }

    /// Events of a joint, including those of the whole arm.
    pub(in crate::cli) fn events_of(&self, joint: JointIndex) -> Vec<FigureEvent> {
        let events = self.events().into_iter();
        events.filter(|(of, _)| of.is_none_or(|of| of == joint)).map(|(_, event)| event).collect()
    }

    /// Days between which an alarm of a joint was seen; an open alarm lasts to the latest run.
    pub(in crate::cli) fn alarms_of(&self, joint: JointIndex) -> Vec<[f64; 2]> {
        let of_joint = self.anomalies.iter().filter(|row| row.joint == Some(joint) && is_alarm(row));
        of_joint
            .map(|row| {
                let last = if row.ended { None } else { self.last_run };
                let end = last.unwrap_or(row.last_seen_at).max(row.last_seen_at);
                [day(row.onset_at.unwrap_or(row.first_seen_at)), day(end)]
            })
            .collect()
    }
}

/// Returns true if it needs attention; a false alarm does not.
fn is_alarm(row: &AnomalyRow) -> bool {
    row.severity != Severity::Info && row.state != AlarmState::FalseAlarm
}

/// The status of a joint as a word with its colour.
pub(in crate::cli) fn standing(status: HealthStatus) -> StatusWord {
    let level = match status {
        HealthStatus::Ok => FigureLevel::Usual,
        HealthStatus::Warning | HealthStatus::Overdue => FigureLevel::Warning,
        HealthStatus::Critical => FigureLevel::Critical,
        HealthStatus::Learning | HealthStatus::Unknown => FigureLevel::Unknown,
    };
    StatusWord::new(status.name(), level)
}

/// Indices of a joint with their 95 % intervals in the form of a picture.
pub(in crate::cli) fn index_points(rows: &[IndexRow]) -> Vec<IndexPoint> {
    let half = normal_quantile(0.975);
    let point = |row: &IndexRow| IndexPoint {
        day: day(row.started_at),
        index: row.index.value,
        interval: [-half, half].map(|by| row.index.value + by * row.index.std_error),
        raw: row.raw,
    };
    rows.iter().map(point).collect()
}
