//! Channels with data that several checks share, and the thresholds of the checks.

use super::coarse;
use crate::lanes::{dot, extent};
use crate::signal::filter::FilteredSignals;
use armwatch_model::analysis::finding::{Evidence, Finding, FindingKind, FindingSeverity};
use armwatch_model::robot::{Joint, JointIndex, Robot};
use armwatch_model::run::{Samples, Stage};

/// Thresholds of the checks.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DiagnoseSettings {
    /// Smallest share of the excitation's rows with motion of a joint that is not at rest.
    pub moving_share: f64,
    /// Largest relative distance of the middle 80 % of the speeds from their median for a single speed.
    pub speed_spread: f64,
    /// Smallest share of rows at the largest torque that is reported as saturation, and that is refused.
    pub saturated_shares: [f64; 2],
    /// Smallest relative deviation of a velocity from its position's derivative that is reported. Low-pass and
    /// differences leave 1 %.
    pub velocity_gain: f64,
    /// Smallest distance of positions beyond a limit, as a part of the range, that is reported, and that is refused.
    pub limit_margins: [f64; 2],
    /// Part of its range that at least one rotary joint must move over. The excitation of a test uses most of it; a
    /// degree read as radian is 0.017 of it.
    pub range_share: f64,
    /// Duration of an excitation, s, below which it is reported: each joint then has at most about 70 independent
    /// values after the low-pass, hardly more than there are parameters.
    pub shortest: f64,
}

impl Default for DiagnoseSettings {
    fn default() -> Self {
        Self {
            moving_share: 0.02,
            speed_spread: 0.05,
            saturated_shares: [0.005, 0.02],
            velocity_gain: 0.05,
            limit_margins: [0.02, 0.1],
            range_share: 0.03,
            shortest: 3.0,
        }
    }
}

/// Correlation of a velocity with its own position's derivative: above the first value they match, below the second
/// they do not. Noise of healthy recordings leaves 0.99.
pub(super) const BELONGS: [f64; 2] = [0.95, 0.7];

/// Degrees per radian.
pub(super) const DEGREES: f64 = 180.0 / std::f64::consts::PI;

/// Channels with data that several checks share.
pub(super) struct ChannelView<'a> {
    pub(super) robot: &'a Robot,
    pub(super) samples: &'a Samples,
    pub(super) filtered: &'a FilteredSignals,
    /// Number of usable rows, all stages.
    pub(super) row_count: usize,
    /// Rows of the excitation stage, or all if there is none.
    pub(super) excitation: Vec<usize>,
    /// True if there is an excitation stage. Without one, a joint may be at rest.
    pub(super) has_excitation: bool,
    /// Derivative of the low-passed position, `[n][rows of the recording]`.
    pub(super) dq: Vec<Vec<f64>>,
    /// Root mean square of `dq` and of the low-passed velocity of each joint, `[n]`.
    pub(super) dq_rms: Vec<f64>,
    pub(super) qd_rms: Vec<f64>,
    /// Smallest and largest recorded position and torque, and low-passed position of each joint, `[n]`.
    pub(super) position_extents: Vec<[f64; 2]>,
    pub(super) torque_extents: Vec<[f64; 2]>,
    pub(super) q_extents: Vec<[f64; 2]>,
    /// Step of each recorded torque, Nm (N), if it is coarse, `[n]`.
    pub(super) torque_steps: Vec<Option<f64>>,
    /// Mean time between rows, s.
    pub(super) mean_step: f64,
    /// Shortest time between rows, s; infinite if there is only one.
    pub(super) shortest_step: f64,
}

impl<'a> ChannelView<'a> {
    pub(super) fn new(robot: &'a Robot, samples: &'a Samples, filtered: &'a FilteredSignals) -> Self {
        let usable = || filtered.usable.iter().flat_map(Clone::clone);
        let excitation: Vec<usize> =
            usable().filter(|&row| samples.stage[row] == Stage::Excitation).collect();
        let has_excitation = !excitation.is_empty();
        let excitation = if has_excitation { excitation } else { usable().collect() };
        let mut view = Self {
            robot,
            samples,
            filtered,
            row_count: usable().count(),
            excitation,
            has_excitation,
            dq: filtered.q.iter().map(|q| filtered.derivative(q)).collect(),
            dq_rms: Vec::new(),
            qd_rms: Vec::new(),
            position_extents: Vec::new(),
            torque_extents: Vec::new(),
            q_extents: Vec::new(),
            torque_steps: Vec::new(),
            mean_step: mean_step(samples, filtered),
            shortest_step: shortest_step(samples, filtered),
        };
        let every = coarse::counted(view.row_count);
        let step = |torque: &Vec<f64>| coarse::step(view.rows().step_by(every).map(|row| torque[row]));
        view.torque_steps = samples.torque.iter().map(step).collect();
        let rms = |channels: &[Vec<f64>]| channels.iter().map(|channel| view.rms(channel)).collect();
        let extents = |channels: &[Vec<f64>]| channels.iter().map(|channel| view.extent(channel)).collect();
        (view.dq_rms, view.qd_rms, view.position_extents, view.torque_extents, view.q_extents) = (
            rms(&view.dq),
            rms(&filtered.qd),
            extents(&samples.position),
            extents(&samples.torque),
            extents(&filtered.q),
        );
        view
    }

    /// Returns the memory of the derived channels.
    pub(super) fn end(self) {
        self.filtered.give_back(self.dq);
    }

    /// Usable rows, all stages.
    pub(super) fn rows(&self) -> impl Iterator<Item = usize> + '_ {
        self.filtered.usable.iter().flat_map(Clone::clone)
    }

    pub(super) fn joint(&self, joint: JointIndex) -> &Joint {
        &self.robot.joints[joint.index()]
    }

    /// Usable pieces of a channel.
    pub(super) fn pieces<'c>(&'c self, channel: &'c [f64]) -> impl Iterator<Item = &'c [f64]> + 'c {
        self.filtered.usable.iter().map(move |stretch| &channel[stretch.clone()])
    }

    fn rms(&self, channel: &[f64]) -> f64 {
        self.product(channel, channel).sqrt()
    }

    pub(super) fn product(&self, a: &[f64], b: &[f64]) -> f64 {
        let of_piece = |(a, b): (&[f64], &[f64])| dot(a, b);
        self.pieces(a).zip(self.pieces(b)).map(of_piece).sum::<f64>() / self.row_count as f64
    }

    pub(super) fn extent(&self, channel: &[f64]) -> [f64; 2] {
        self.pieces(channel)
            .map(extent)
            .fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], [l, h]| [low.min(l), high.max(h)])
    }
}

/// Mean time between rows, s. The mean over a stretch is independent of bunched times of arrival.
fn mean_step(samples: &Samples, filtered: &FilteredSignals) -> f64 {
    let of = |stretch: &std::ops::Range<usize>| {
        let steps = stretch.len().saturating_sub(1);
        (samples.time[stretch.start + steps] - samples.time[stretch.start], steps)
    };
    let (time, steps) =
        filtered.usable.iter().map(of).fold((0.0, 0), |(t, n), (time, steps)| (t + time, n + steps));
    time / steps.max(1) as f64
}

fn shortest_step(samples: &Samples, filtered: &FilteredSignals) -> f64 {
    let times = filtered.usable.iter().map(|stretch| &samples.time[stretch.clone()]);
    let steps = times.flat_map(|time| time.array_windows().map(|[from, to]| to - from));
    steps.fold(f64::INFINITY, |shortest, step| if step < shortest { step } else { shortest })
}

pub(super) fn finding(
    kind: FindingKind,
    severity: FindingSeverity,
    joint: Option<JointIndex>,
    sentence: String,
    evidence: &[(&'static str, f64)],
) -> Finding {
    let evidence = evidence.iter().map(|&(name, value)| Evidence { name, value }).collect();
    Finding { kind, severity, joint, sentence, evidence }
}
