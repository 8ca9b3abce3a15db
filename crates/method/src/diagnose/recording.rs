//! Faults of a recording, in words for the people at the arm, with the values that show them.
//!
//! A fault that explains another finding suppresses it. Findings about the identified model are in [`super::model`].

mod coarse;
mod glitches;
mod position;
mod velocity;
pub mod view;

use crate::diagnose::recording::view::{ChannelView, DiagnoseSettings, finding};
use crate::lanes::counts_within;
use crate::signal::filter::FilteredSignals;
use armwatch_model::analysis::finding::{Finding, FindingKind, FindingSeverity};
use armwatch_model::robot::{JointIndex, Robot};
use armwatch_model::run::Samples;

/// Smallest share of the rows with one constant value for a coarse torque to count as a stuck channel.
const COARSE_RUN: f64 = 0.5;
/// Shortest duration of a constant value that is examined, s.
const REPEATS_S: f64 = 0.5;

/// All faults that the channels of one cycle show, the most severe first.
///
/// `samples` are the recorded rows, `filtered` the same rows after [`crate::signal::filter::filter_signals`]. Torques
/// of wrong sign or order are found with the model, by the fit of all joints.
#[must_use]
pub fn diagnose_samples(
    robot: &Robot,
    samples: &Samples,
    filtered: &FilteredSignals,
    settings: &DiagnoseSettings,
) -> Vec<Finding> {
    let view = ChannelView::new(robot, samples, filtered);
    if view.row_count == 0 {
        return Vec::new();
    }
    let mut findings = stuck(&view);
    let explained = |findings: &[Finding], joint: JointIndex, kinds: &[FindingKind]| {
        findings.iter().any(|f| f.joint == Some(joint) && (kinds.is_empty() || kinds.contains(&f.kind)))
    };
    findings.extend(glitches::spikes(&view));
    let repeated = glitches::repeats(&view);
    findings.extend(glitches::leaps(&view, &findings, repeated.as_ref()));
    let broken: Vec<bool> = robot.joint_indices().map(|j| explained(&findings, j, &[])).collect();
    if samples.velocity.is_some() {
        findings.extend(velocity::velocity_against_position(&view, settings, &broken));
    }
    // a wrong value also appears as too fast, and beyond the limits
    let glitches: Vec<Option<JointIndex>> =
        findings.iter().filter(|f| f.kind == FindingKind::Spike).map(|f| f.joint).collect();
    let found = position::positions(&view, settings).into_iter();
    findings.extend(found.filter(|finding| !glitches.contains(&finding.joint)));
    findings.extend(position::small_motion(&view, settings));
    if let Some(repeated) = repeated {
        // steps of several rows at once appear as too fast, and as another velocity
        let follows = [FindingKind::TooFast, FindingKind::VelocityUnrelated];
        findings.retain(|finding| !follows.contains(&finding.kind));
        findings.push(repeated);
    }
    findings.extend(coarse::torque_steps(&view));
    findings.extend(short(&view, settings).filter(|_| view.has_excitation));
    for joint in robot.joint_indices().filter(|j| !broken[j.index()]) {
        // a joint without torque has no parameters that its own motion must show
        if view.has_excitation && view.joint(joint).has_torque {
            findings.extend(motion(&view, joint, settings));
        }
        findings.extend(saturation(&view, joint, settings));
    }
    view.end();
    findings.sort_by_key(|finding| std::cmp::Reverse(finding.severity));
    findings
}

/// Channels that repeat exactly one value while the joint's other channels show motion.
fn stuck(view: &ChannelView<'_>) -> Vec<Finding> {
    let mut found = Vec::new();
    let edge = (view.filtered.sample_rate / view.filtered.cutoff).ceil() as usize;
    let least = (REPEATS_S * view.filtered.sample_rate).ceil().max(8.0) as usize + 2 * edge;
    for joint in view.robot.joint_indices() {
        let j = joint.index();
        let (dq, qd) = (&view.dq[j], &view.filtered.qd[j]);
        let low = view.joint(joint).counted_speed();
        // Speed must change by this much within the repeats, which excludes a plateau.
        let swing = (0.2 * view.qd_rms[j].max(view.dq_rms[j])).max(2.0 * low);
        let torque = &view.samples.torque[j];
        let peaks = view.torque_extents[j];
        let channels = [
            ("position", Some(&view.samples.position[j]), qd),
            ("velocity", view.samples.velocity.as_ref().map(|velocity| &velocity[j]), dq),
            ("torque", Some(torque), qd),
        ];
        for (name, channel, witness) in channels {
            let Some(channel) = channel else { continue };
            let clipped = |value: f64| name == "torque" && peaks[0] < peaks[1] && peaks.contains(&value);
            let is_coarse = name == "torque" && view.torque_steps[j].is_some();
            let run = longest_run(view, channel, least, |start, end| {
                // a coarse torque keeps one value for long, but not for most of a recording
                if is_coarse && ((end - start) as f64) < COARSE_RUN * view.row_count as f64 {
                    return false;
                }
                // the low-pass carries motion from outside across the edges
                let inside = &witness[start + edge..(end - edge).max(start + edge)];
                let range = inside.iter().copied().fold(f64::NEG_INFINITY, f64::max)
                    - inside.iter().copied().fold(f64::INFINITY, f64::min);
                range > swing && !clipped(channel[start])
            });
            let Some((start, end)) = run else { continue };
            let (value, seconds) = (channel[start], (end - start) as f64 / view.filtered.sample_rate);
            found.push(finding(
                FindingKind::Stuck,
                FindingSeverity::Refuse,
                Some(joint),
                format!(
                    "joint {joint}: the {name} signal stands at {value} for {seconds:.1} s while the joint moves; \
                     check that the channel is connected and recorded"
                ),
                &[("value", value), ("duration_s", seconds), (name, value)],
            ));
        }
    }
    found
}

/// Longest stretch of at least `least` equal values that `counts(start, end)` accepts.
fn longest_run(
    view: &ChannelView<'_>,
    channel: &[f64],
    least: usize,
    counts: impl Fn(usize, usize) -> bool,
) -> Option<(usize, usize)> {
    let mut longest: Option<(usize, usize)> = None;
    for stretch in &view.filtered.usable {
        for (start, end) in runs(&channel[stretch.clone()], least) {
            let (start, end) = (stretch.start + start, stretch.start + end);
            if longest.is_none_or(|(s, e)| end - start > e - s) && counts(start, end) {
                longest = Some((start, end));
            }
        }
    }
    longest
}

/// Maximal stretches of at least `least` equal values (at least two), in order. Such a stretch contains two neighbours
/// of any grid that is half as wide, and only from such a pair are single rows examined.
fn runs(values: &[f64], least: usize) -> Vec<(usize, usize)> {
    let least = least.max(2);
    let equal = |a: f64, b: f64| (a - b).abs() <= 0.0;
    let step = least / 2;
    let mut found: Vec<(usize, usize)> = Vec::new();
    for place in (0..values.len()).step_by(step) {
        let value = values[place];
        let covered = found.last().is_some_and(|(_, end)| place < *end);
        if covered || !values.get(place + step).is_some_and(|next| equal(*next, value)) {
            continue;
        }
        let before = values[..place].iter().rev().take_while(|x| equal(**x, value)).count();
        let behind = values[place..].iter().take_while(|x| equal(**x, value)).count();
        if before + behind >= least {
            found.push((place - before, place + behind));
        }
    }
    found
}

/// Finding of an excitation stage that is too short.
fn short(view: &ChannelView<'_>, settings: &DiagnoseSettings) -> Option<Finding> {
    let seconds = view.excitation.len() as f64 / view.filtered.sample_rate;
    (seconds < settings.shortest).then(|| {
        finding(
            FindingKind::ShortExcitation,
            FindingSeverity::Warn,
            None,
            format!(
                "the excitation lasts {seconds:.1} s only: what parameters it gives are uncertain, as their standard errors \
                 say; record 10 s or more"
            ),
            &[("excitation_s", seconds)],
        )
    })
}

/// Finding of a joint that the excitation does not move enough.
fn motion(view: &ChannelView<'_>, joint: JointIndex, settings: &DiagnoseSettings) -> Option<Finding> {
    let qd = &view.filtered.qd[joint.index()];
    let low = view.joint(joint).low_speed;
    let mut speeds: Vec<f64> =
        view.excitation.iter().map(|&row| qd[row].abs()).filter(|speed| *speed >= low).collect();
    let share = speeds.len() as f64 / view.excitation.len() as f64;
    if share < settings.moving_share {
        let fastest = view.excitation.iter().map(|&row| qd[row].abs()).fold(0.0, f64::max);
        return Some(finding(
            FindingKind::Still,
            FindingSeverity::Refuse,
            Some(joint),
            format!(
                "joint {joint} stands still during the excitation: it is faster than {low} rad/s (m/s) in \
                 {:.1} % of the rows, at most {fastest:.4}; its parameters cannot be seen, record with all joints moving",
                100.0 * share
            ),
            &[("moving_share", share), ("fastest_si", fastest)],
        ));
    }
    let last = (speeds.len() - 1) as f64;
    let mut at = |part: f64| *speeds.select_nth_unstable_by((last * part) as usize, f64::total_cmp).1;
    let (median, spread) = (at(0.5), at(0.9) - at(0.1));
    (spread < settings.speed_spread * median).then(|| {
        finding(
            FindingKind::OneSpeed,
            FindingSeverity::Refuse,
            Some(joint),
            format!(
                "joint {joint} moves at one speed only during the excitation ({median:.3} rad/s or m/s, 80 % of the rows \
                 within {spread:.4}): friction and inertia cannot be told apart, record with changing speed"
            ),
            &[("speed_si", median), ("spread_si", spread)],
        )
    })
}

/// Smallest ratio of rows at the highest step of a coarse torque to rows at the next three steps for saturation.
const COARSE_DWELL: usize = 3;

/// Finding of torque that stays at its largest value.
///
/// Rows *at* the peak must be consecutive and far more frequent than rows just below it; a smooth peak has as many of
/// both.
fn saturation(view: &ChannelView<'_>, joint: JointIndex, settings: &DiagnoseSettings) -> Option<Finding> {
    let torque = &view.samples.torque[joint.index()];
    let [low, high] = view.torque_extents[joint.index()];
    let mut worst: Option<(f64, f64)> = None;
    for (peak, sign) in [(high, 1.0), (-low, -1.0)] {
        if !(peak > 0.0 && high > low) {
            continue;
        }
        let range = |from: f64, to: f64| {
            let [near, far] = [sign * (from * peak), sign * (to * peak)];
            [near.min(far), near.max(far)]
        };
        // a smooth peak stays about as long in the highest step as in the next three
        let (near, dwell) = match view.torque_steps[joint.index()] {
            Some(step) => ((1.0 - 3.5 * step / peak).clamp(0.0, 0.97), COARSE_DWELL),
            None => (0.97, 1),
        };
        let (at_peak, below) = (range(1.0 - 1e-6, 1.0), range(near, 1.0 - 1e-6));
        let [at, just_below] = view
            .pieces(torque)
            .map(|piece| counts_within(piece, [at_peak, below]))
            .fold([0, 0], |[at, near], [a, b]| [at + a, near + b]);
        if at <= dwell * just_below {
            continue;
        }
        let run = longest_run(view, torque, 4, |start, _| sign * torque[start] >= peak * (1.0 - 1e-6));
        // parameters come only from the excitation, which may be a small part of the cycle
        let is_at = |row: &&usize| (at_peak[0]..=at_peak[1]).contains(&torque[**row]);
        let excited = view.excitation.iter().filter(is_at).count();
        let excited = excited as f64 / view.excitation.len() as f64;
        let share = excited.max(at as f64 / view.row_count as f64);
        if run.is_some() && worst.is_none_or(|(_, before)| share > before) {
            worst = Some((sign * peak, share));
        }
    }
    let (limit, share) = worst.filter(|(_, share)| *share >= settings.saturated_shares[0])?;
    let severity = match share >= settings.saturated_shares[1] {
        true => FindingSeverity::Refuse,
        false => FindingSeverity::Warn,
    };
    Some(finding(
        FindingKind::Saturated,
        severity,
        Some(joint),
        format!(
            "joint {joint}: the torque is cut off at {limit:.3} in {:.1} % of the rows; the drive or the recording is at \
             its limit, record with less load, speed or acceleration, or a larger range",
            100.0 * share
        ),
        &[("limit_nm", limit), ("share", share)],
    ))
}

#[cfg(test)]
mod tests;
