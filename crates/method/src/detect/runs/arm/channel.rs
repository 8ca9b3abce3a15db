//! Channel faults whose effect on the parameters is known except for its size.

use nalgebra::{Matrix2, Vector2};

use super::baseline::{Baseline, Direction, MOST_CHI_SQUARE, Usual};
use super::cause::{ArmCause, SignalFault};
use super::change::{Change, LEAST_MEAN_SQUARE};
use super::price::{CHANNEL_PRICE, PARAMETER_PRICE, PATTERN_ERROR};
use super::signal::Signal;
use armwatch_model::analysis::response::{ChannelFault, STRENGTHS};
use armwatch_model::anomaly::RunSummary;
use armwatch_model::robot::JointIndex;

/// Part of a change that may differ from a direction. The direction is computed from the motion: a load, which has more
/// unknowns, must not be found instead.
const DIRECTION_ERROR: f64 = 0.015;

/// Part of an offset that the friction stage may show with the opposite sign: the model of the cycle absorbs all of it
/// there, or slightly more.
const TURNED: f64 = 0.1;

/// Least part of the effect of an offset on the parameters at a known strength: the weight of its joint in the estimate
/// is uncertain.
const LEAST_ANSWER: f64 = 0.3;

/// Data with which channel faults are compared.
pub(super) struct Shown<'a> {
    pub(super) change: &'a Change,
    pub(super) signals: &'a [Signal],
    pub(super) run: &'a RunSummary,
    pub(super) baseline: &'a Baseline,
}

impl Shown<'_> {
    /// Faults of each channel with the size and strength that explain most, and their costs in units of chi².
    pub(super) fn channels(&self) -> Vec<(ArmCause, f64)> {
        let mut found = Vec::new();
        let mut seen: Vec<(JointIndex, ChannelFault)> = Vec::new();
        for of in &self.baseline.directions {
            let channel = (of.joint, of.fault);
            if seen.contains(&channel) {
                continue;
            }
            seen.push(channel);
            let strengths: Vec<&Direction> = self
                .baseline
                .directions
                .iter()
                .filter(|other| (other.joint, other.fault) == channel)
                .collect();
            let mut all = Vec::new();
            if self.change.square > 0.0 {
                all.extend(strengths.iter().map(|of| self.along(of)));
                all.extend(strengths.windows(2).filter_map(|pair| self.between(pair[0], pair[1])));
            }
            all.extend(self.offset_by_rest(&strengths));
            found.extend(all.into_iter().min_by(|a, b| a.1.total_cmp(&b.1)));
        }
        found
    }

    /// The fault with the size that explains most of the change, with or without the shift.
    fn along(&self, direction: &Direction) -> (ArmCause, f64) {
        let Change { deviations, scale, .. } = self.change;
        let with = |part: f64| {
            let left = deviations - &direction.shift * (part * scale);
            let size = direction.change.dot(&left) / direction.change.norm_squared() / scale;
            let cost = self.rest(direction, size, part) + self.signals(direction, size, None);
            (cause(direction, size), cost + price_of_shift(part))
        };
        let [without, shifted] = [0.0, direction.shifted(self.change)].map(with);
        if shifted.1 < without.1 { shifted } else { without }
    }

    /// The fault at a strength between two known ones, by least squares along both: one more parameter.
    fn between(&self, weak: &Direction, strong: &Direction) -> Option<(ArmCause, f64)> {
        let deviations = &self.change.deviations;
        let (a, b) = (&weak.change, &strong.change);
        let normal = Matrix2::new(a.norm_squared(), a.dot(b), a.dot(b), b.norm_squared());
        let parts = normal.try_inverse()? * Vector2::new(a.dot(deviations), b.dot(deviations));
        let is_between = parts[0] * parts[1] > 0.0;
        let mixed = weak.mixed(strong, parts[1] / (parts[0] + parts[1]));
        is_between.then(|| {
            let (cause, cost) = self.along(&mixed);
            (cause, cost + PARAMETER_PRICE)
        })
    }

    /// An offset that the friction stage shows in part, from the torque that it leaves unexplained. This gives its
    /// size, and so the strength for the effect on the parameters. A large offset hardly moves them, since the estimate
    /// gives that joint little weight.
    fn offset_by_rest(&self, strengths: &[&Direction]) -> Option<(ArmCause, f64)> {
        let (first, last) = (strengths.first()?, strengths.last()?);
        let (joint, signal) = (first.joint, &self.signals[first.joint.index()]);
        if first.fault != ChannelFault::TorqueOffset || !signal.shows_offset() || signal.unexplained.1 == 0.0
        {
            return None;
        }
        let usual = self.baseline.rmsd[joint.index()]?.value.exp();
        let times = ((self.baseline.rmsd_of(self.run, joint)? / usual).powi(2) - 1.0).max(0.0).sqrt();
        let is_weaker = |of: &&&Direction| STRENGTHS[of.strength] <= times;
        let (direction, least) =
            match (strengths.iter().rfind(is_weaker), strengths.iter().find(|of| !is_weaker(of))) {
                (Some(weak), Some(strong)) => (weak.at_strength(strong, times), LEAST_ANSWER),
                _ => (last.beyond(times), 0.0),
            };
        let size = times * usual / direction.unexplained[joint.index()];
        if !size.is_finite() {
            return None;
        }
        let Change { deviations, scale, .. } = self.change;
        let squares = direction.change.norm_squared().max(f64::MIN_POSITIVE);
        let of = |(sign, part): (f64, f64)| {
            let left = deviations - &direction.shift * (part * scale);
            let along = direction.change.dot(&left) / squares / scale;
            let answer = (sign * along).clamp(least * size, size);
            let left = (left - &direction.change * (sign * answer * scale)).norm_squared();
            let turned =
                if sign * signal.offset.0 < 0.0 { (signal.offset.0 / (TURNED * size)).powi(2) } else { 0.0 };
            let prices = turned + price_of_shift(part);
            let signals = self.signals(&direction, sign * size, Some(joint));
            let cost = self.rest(&direction, sign * answer, part) + signals + prices;
            (cause(&direction, sign * size), cost, prices + left / self.variance(&direction))
        };
        let part = direction.shifted(self.change);
        let all = [(1.0, 0.0), (-1.0, 0.0), (1.0, part), (-1.0, part)].map(of);
        let found = all.into_iter().min_by(|a, b| a.2.total_cmp(&b.2));
        found.map(|(cause, cost, _)| (cause, cost)).filter(|(_, cost)| cost.is_finite())
    }

    /// Variance of the deviations of the parameters about the best multiple of a direction, one at least: seasons move
    /// parameters more than their errors.
    fn variance(&self, direction: &Direction) -> f64 {
        let Change { deviations, square, .. } = self.change;
        let all = deviations.norm_squared();
        if *square > 0.0 {
            return (all / square).max(1.0);
        }
        let along = direction.change.dot(deviations);
        let left = all - along * along / direction.change.norm_squared().max(f64::MIN_POSITIVE);
        (left / (deviations.len() as f64 - 1.0).max(1.0)).max(1.0)
    }

    /// Residual of the change of the parameters after a fault of this size, with this part of the shift. If the change
    /// does not count, it is the increase by the fault.
    fn rest(&self, direction: &Direction, size: f64, part: f64) -> f64 {
        let Change { deviations, scale, square } = self.change;
        let all = deviations.norm_squared();
        let expected = (&direction.change * size + &direction.shift * part) * *scale;
        let left = (deviations - &expected).norm_squared();
        if *square > 0.0 {
            return (left / all - DIRECTION_ERROR).max(0.0) * square;
        }
        (left - DIRECTION_ERROR * expected.norm_squared() - all).max(0.0) / self.variance(direction)
    }

    /// Residual of the torque signals plus the price of the fault. The residual of `known` is accounted for.
    fn signals(&self, direction: &Direction, size: f64, known: Option<JointIndex>) -> f64 {
        let mut cost = CHANNEL_PRICE + PARAMETER_PRICE;
        for (other, signal) in self.signals.iter().enumerate() {
            // a wrong position changes gravity and is an offset of every joint that carries it
            cost += match direction.fault {
                ChannelFault::PositionOffset => 0.0,
                ChannelFault::TorqueOffset if other == direction.joint.index() => 0.0,
                _ => signal.offset.1,
            };
            cost += signal.noise_cost();
            if known.is_some_and(|joint| joint.index() == other) {
                continue;
            }
            cost += match (self.baseline.rmsd[other], self.baseline.rmsd_of(self.run, JointIndex::new(other)))
            {
                (Some(usual), Some(now)) => {
                    let expected = usual.value.exp().hypot(size * direction.unexplained[other]);
                    match other == direction.joint.index() {
                        true => missed(expected, now, &usual),
                        false => Usual { value: expected.ln(), ..usual }.excess_of_rmsd(now).1,
                    }
                }
                _ => 0.0,
            };
        }
        cost
    }
}

/// Difference between the expected unexplained torque of the fault's own joint and that of the run, `now`, in units of
/// chi².
fn missed(expected: f64, now: f64, usual: &Usual) -> f64 {
    let error = usual.deviation.hypot(PATTERN_ERROR);
    ((expected / now).ln() / error).powi(2).min(MOST_CHI_SQUARE)
}

/// Square of a change that a constant torque of a joint does not explain; zero if no test has its effect on the
/// parameters, or if the residual is within the effect of seasons.
pub(super) fn offset_rest(change: &Change, joint: JointIndex, baseline: &Baseline) -> f64 {
    if baseline.directions.is_empty() {
        return 0.0;
    }
    let own = |of: &&Direction| of.joint == joint && of.fault == ChannelFault::TorqueOffset;
    let left = |of: &Direction| {
        let left = |part: f64| {
            let left = &change.deviations - &of.shift * (part * change.scale);
            let size = of.change.dot(&left) / of.change.norm_squared();
            (left - &of.change * size).norm_squared() / change.deviations.norm_squared()
        };
        left(0.0).min(left(of.shifted(change)))
    };
    let least = baseline.directions.iter().filter(own).map(left).min_by(f64::total_cmp);
    let rest = (least.unwrap_or(1.0) - DIRECTION_ERROR).max(0.0) * change.square;
    if rest > LEAST_MEAN_SQUARE * change.deviations.len() as f64 { rest } else { 0.0 }
}

fn cause(direction: &Direction, size: f64) -> ArmCause {
    let joint = direction.joint;
    match direction.fault {
        ChannelFault::TorqueGain => ArmCause::TorqueSignal { joint, fault: SignalFault::Gain(size) },
        ChannelFault::TorqueOffset => ArmCause::TorqueSignal { joint, fault: SignalFault::Offset(size) },
        ChannelFault::PositionOffset => ArmCause::PositionSignal { joint, offset: size },
    }
}

/// Price of an assumed shift.
fn price_of_shift(part: f64) -> f64 {
    if part > 0.0 { PARAMETER_PRICE } else { 0.0 }
}

impl Direction {
    /// The part of the shift, between none and all, that explains most of a change together with the fault.
    fn shifted(&self, change: &Change) -> f64 {
        let Change { deviations, scale, .. } = change;
        let (a, b) = (&self.change, &self.shift);
        let normal = Matrix2::new(a.norm_squared(), a.dot(b), a.dot(b), b.norm_squared());
        let Some(inverse) = normal.try_inverse() else { return 0.0 };
        let part = (inverse * Vector2::new(a.dot(deviations), b.dot(deviations)))[1] / scale;
        if part.is_finite() { part.clamp(0.0, 1.0) } else { 0.0 }
    }

    /// Mean of this direction and another of the same fault, which has the weight `part`.
    fn mixed(&self, other: &Self, part: f64) -> Self {
        let both = |a: f64, b: f64| (1.0 - part) * a + part * b;
        let unexplained =
            self.unexplained.iter().zip(&other.unexplained).map(|(a, b)| both(*a, *b)).collect();
        Self {
            joint: self.joint,
            fault: self.fault,
            strength: self.strength,
            change: &self.change * (1.0 - part) + &other.change * part,
            shift: &self.shift * (1.0 - part) + &other.shift * part,
            unexplained,
        }
    }

    /// The direction at a strength between this one's and that of a stronger one. The inverse of the change is linear
    /// in the square of the strength, since the weight of the joint's rows falls that way.
    fn at_strength(&self, stronger: &Self, times: f64) -> Self {
        let [from, to] = [self, stronger].map(|of| STRENGTHS[of.strength].powi(2));
        let way = (times * times - from) / (to - from);
        let [weak, strong] = [(1.0 - way) / self.change.norm(), way / stronger.change.norm()];
        self.mixed(stronger, strong / (weak + strong))
    }

    /// The direction beyond the largest known strength, which is this one's: its weight is small already.
    fn beyond(&self, times: f64) -> Self {
        let known = 1.0 + STRENGTHS[self.strength].powi(2);
        let change = &self.change * (known / (1.0 + times * times));
        Self { change, shift: self.shift.clone(), unexplained: self.unexplained.clone(), ..*self }
    }
}
