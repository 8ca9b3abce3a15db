//! Torques of one cycle for a picture: read again from its export and reduced to the points of a screen.

use super::replay::{Replay, ReplayError};
use armwatch_config::Config;
use armwatch_method::identify::torque_series::{SeriesRows, TorqueSeries, peaks};
use armwatch_model::analysis::{RmsdScope, TorqueRmsd};
use armwatch_model::robot::{JointIndex, JointKind};
use armwatch_model::run::Stage;
use armwatch_store::Store;

/// Measured and estimated torque of one cycle.
#[derive(Debug, Clone, PartialEq)]
pub struct CycleTorque {
    /// The robot.
    pub robot: String,
    /// File name of the export.
    pub source_name: String,
    /// Cut-off of the low-pass on both torques, Hz.
    pub cutoff_hz: f64,
    /// Stages of the cycle in their order.
    pub stages: Vec<StageSpan>,
    /// One entry per joint.
    pub joints: Vec<JointTorque>,
}

/// Consecutive rows of one stage.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StageSpan {
    /// The stage.
    pub stage: Stage,
    /// First of them, s since the start of the recording.
    pub from_s: f64,
    /// Last of them, s since the start of the recording.
    pub to_s: f64,
}

/// Torque of a joint; all vectors have the same length.
#[derive(Debug, Clone, PartialEq)]
pub struct JointTorque {
    /// The joint.
    pub joint: JointIndex,
    /// Type of the joint, revolute or prismatic, which determines the units of its values.
    pub kind: JointKind,
    /// RMSD over the rows of the whole cycle that count in verification.
    pub rmsd: TorqueRmsd,
    /// Time since the start of the recording, s.
    pub time_s: Vec<f64>,
    /// Velocity, rad/s (m/s).
    pub velocity_rad_s: Vec<f64>,
    /// Measured torque, Nm (N).
    pub measured_nm: Vec<f64>,
    /// Torque that the cycle's own parameters predict for its motion, Nm (N).
    pub estimated_nm: Vec<f64>,
    /// True if the joint's speed is at least its low-speed threshold. The sign of friction is unknown at rest.
    pub moving: Vec<bool>,
}

/// Torques of cycle `cycle` of run `run_id` with its own parameters, with at most `points` rows per joint, including
/// the smallest and largest torques and residuals of each section.
///
/// # Errors
/// [`ReplayError::Refused`] for a cycle that is not stored or has no parameters, others as for [`Replay::export`] and
/// [`Replay::torque`].
pub async fn cycle_torque(
    config: &Config,
    store: &Store,
    run_id: i64,
    cycle: u32,
    points: usize,
) -> Result<CycleTorque, ReplayError> {
    let replay = Replay::find(config, store, run_id, cycle).await?;
    let parameters = store.cycle_parameters(run_id, cycle).await?;
    if parameters.is_empty() {
        let reason = replay.cycle.reason.as_deref().unwrap_or("none are stored");
        let sentence = format!("cycle {cycle} of run {run_id} has no own parameters: {reason}");
        return Err(ReplayError::Refused(sentence));
    }
    let export = replay.export(config, None).await?;
    let parameters = parameters.iter().map(|parameter| (parameter.id, parameter.value)).collect();
    let series = replay.torque(&export, parameters, SeriesRows::Filtered).await?;
    let Replay { run, robot, cutoff, .. } = replay;
    Ok(CycleTorque {
        robot: run.robot,
        source_name: run.source_name,
        cutoff_hz: cutoff,
        stages: stages(&series),
        joints: (0..series.joints.len())
            .map(|joint| thinned(&series, JointIndex::new(joint), robot.joints[joint].kind, points))
            .collect(),
    })
}

fn stages(series: &TorqueSeries) -> Vec<StageSpan> {
    let mut spans: Vec<StageSpan> = Vec::new();
    for (&stage, &time) in series.stage.iter().zip(&series.time) {
        match spans.last_mut().filter(|span| span.stage == stage) {
            Some(span) => span.to_s = time,
            None => spans.push(StageSpan { stage, from_s: time, to_s: time }),
        }
    }
    spans
}

fn thinned(series: &TorqueSeries, joint: JointIndex, kind: JointKind, points: usize) -> JointTorque {
    let of_joint = &series.joints[joint.index()];
    let rows = peaks(of_joint, &series.rows_of(RmsdScope::WholeCycle), points);
    let column = |of: &[f64]| rows.iter().map(|&row| of[row]).collect();
    JointTorque {
        joint,
        kind,
        rmsd: series.rmsd(joint, RmsdScope::WholeCycle),
        time_s: column(&series.time),
        velocity_rad_s: column(&of_joint.qd),
        measured_nm: column(&of_joint.measured),
        estimated_nm: column(&of_joint.estimated),
        moving: rows.iter().map(|&row| of_joint.moving[row]).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use armwatch_method::identify::torque_series::JointTorqueSeries;

    #[test]
    fn a_screen_shows_the_extremes_and_the_stages() {
        const ROWS: usize = 10_000;
        let mut joint = JointTorqueSeries {
            q: vec![0.0; ROWS],
            qd: vec![1.0; ROWS],
            measured: vec![2.0; ROWS],
            estimated: vec![2.5; ROWS],
            moving: vec![true; ROWS],
        };
        joint.measured[4321] = 9.0;
        let mut stage = vec![Stage::Excitation; ROWS];
        stage[6000..].fill(Stage::Friction);
        let series = TorqueSeries {
            time: (0..ROWS).map(|row| row as f64 * 0.001).collect(),
            stage,
            counted: vec![true; ROWS],
            joints: vec![joint],
        };
        let shown = thinned(&series, JointIndex::new(0), JointKind::Revolute, 200);
        assert!(shown.time_s.len() <= 200 && shown.measured_nm.contains(&9.0), "{}", shown.time_s.len());
        assert!(shown.time_s.is_sorted() && shown.time_s.last() == series.time.last());
        // one of 10,000 rows is off by 6.5, the others by 0.5
        let expected = ((6.5_f64.powi(2) + 9999.0 * 0.25) / 10_000.0).sqrt();
        assert!((shown.rmsd.all_rows.value - expected).abs() < 1e-12);
        let spans = stages(&series);
        assert_eq!(
            spans.iter().map(|span| span.stage).collect::<Vec<_>>(),
            [Stage::Excitation, Stage::Friction]
        );
        assert!((spans[0].to_s - 5.999).abs() < 1e-12 && (spans[1].from_s - 6.0).abs() < 1e-12);
    }
}
