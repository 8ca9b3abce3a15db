//! Units of positions, velocities and time: from the names of the columns, otherwise from the motion in the numbers.

use super::head::Head;
use super::joints::{Joints, QuantityColumns};
use super::proposal::Hints;
use super::units::{Choice, ColumnNumbers, Known, Slope};
use super::{names, units};
use armwatch_model::robot::Robot;

pub(super) struct Slopes {
    pub(super) overall: Option<Slope>,
    /// For each joint.
    pub(super) each: Vec<Option<Slope>>,
}

pub(super) fn slopes(joints: &Joints<'_>, time: Option<&[f64]>) -> Slopes {
    let (Some(position), Some(velocity)) = (&joints.position, &joints.velocity) else {
        return Slopes { overall: None, each: Vec::new() };
    };
    let each = position.values.iter().zip(&velocity.values);
    Slopes {
        overall: units::joint_slope(&position.values, &velocity.values, time),
        each: each.map(|(position, velocity)| units::slope(position, velocity, time)).collect(),
    }
}

/// The units, and their evidence.
pub(super) struct Units {
    pub(super) choices: Vec<Choice>,
    pub(super) known: Known,
    pub(super) figures: ColumnNumbers,
    /// True if positions are beyond the arm's limits in any unit.
    pub(super) beyond_limits: bool,
    /// Rows per second that match the velocities if there is no time column, Hz, the most likely first.
    pub(super) rates: Vec<f64>,
    /// True if the given rate matches no units.
    pub(super) is_rate_refuted: bool,
}

/// Units of a shipped layout.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Shipped {
    /// Unit of time.
    pub(super) time: Option<&'static str>,
    /// True if the units of joints that it gives are certain.
    pub(super) is_trusted: bool,
}

/// Finds the units.
pub(super) fn decide_units(
    head: &Head,
    joints: &Joints<'_>,
    time: Option<(usize, &[f64])>,
    slopes: &Slopes,
    hints: Hints<'_>,
    shipped: Shipped,
) -> Units {
    let robot = hints.robot;
    let unit = |found: &Option<QuantityColumns<'_>>, allowed: &[units::Unit]| {
        let said = found.as_ref()?.said;
        let said = said.unit.filter(|_| shipped.is_trusted || !said.is_unit_shipped)?;
        allowed.iter().find(|(name, _)| *name == said).map(|(name, _)| *name)
    };
    let of_time = time.and_then(|(column, _)| {
        let column = &head.columns[column];
        let said = names::said(&column.name, &column.under).unit;
        if column.time_forms.is_text() {
            Some("s")
        } else {
            said.filter(|said| units::TIME.iter().chain(&units::LONG_TIME).any(|(u, _)| u == said))
        }
    });
    let known = Known {
        position: unit(&joints.position, &units::POSITION),
        velocity: unit(&joints.velocity, &units::VELOCITY),
        time: shipped.time.or(of_time),
    };
    let most = |found: &QuantityColumns<'_>| units::largest(found.values.iter().copied().flatten());
    let limit = |robot: &Robot| {
        let recorded = robot.joints.iter().flat_map(|joint| {
            [joint.limits.position_min, joint.limits.position_max].map(|q| joint.recorded_position(q))
        });
        recorded.fold(0.0_f64, |most, position| most.max(position.abs()))
    };
    let mut figures = ColumnNumbers {
        position: joints.position.as_ref().map_or(0.0, most),
        velocity: joints.velocity.as_ref().map(most),
        step: time.and_then(|(_, values)| units::median_step(values)),
        slope: slopes.overall,
        limit: robot.map(limit),
        is_motor: joints.position.as_ref().is_some_and(|found| found.said.is_motor),
        rate: hints.sample_rate.filter(|_| time.is_none()),
        is_counting: time.is_some_and(|(_, values)| values.iter().all(|value| value.fract() == 0.0)),
    };
    let mut choices = units::choices(known, figures);
    let mut beyond_limits = false;
    let is_far = figures.limit.is_some_and(|limit| units::is_beyond(figures.position, limit));
    if choices.is_empty() && !figures.is_motor && known.position.is_none() && is_far {
        figures.is_motor = true;
        choices = units::choices(known, figures);
        beyond_limits = !choices.is_empty();
        figures.is_motor = beyond_limits;
    }
    let mut is_rate_refuted = false;
    if choices.is_empty() && figures.rate.take().is_some() {
        choices = units::choices(known, figures);
        is_rate_refuted = !choices.is_empty() && figures.slope.is_some();
    }
    let mut rates: Vec<f64> = Vec::new();
    for rate in choices.iter().filter_map(|choice| choice.rate(figures.slope.filter(|_| time.is_none())?)) {
        if !rates.iter().any(|known| (rate / known - 1.0).abs() <= units::RATE_TOLERANCE) {
            rates.push(rate);
        }
    }
    Units { choices, known, figures, beyond_limits, rates, is_rate_refuted }
}

impl Units {
    /// Returns true if the numbers alone are consistent with the units of `shipped`.
    pub(super) fn allow(&self, shipped: &Self) -> bool {
        let names = |of: Choice| (of.position.0, of.velocity.0, of.time.0);
        let wanted = shipped.choice().map(names);
        !shipped.beyond_limits && self.choices.iter().any(|choice| Some(names(*choice)) == wanted)
    }

    pub(super) fn choice(&self) -> Option<Choice> {
        self.choices.first().copied()
    }

    /// Units of time that are consistent with the others.
    pub(super) fn times(&self) -> Vec<&'static str> {
        let mut times: Vec<&str> = self.choices.iter().map(|choice| choice.time.0).collect();
        times.sort_unstable();
        times.dedup();
        times
    }

    /// The evidence for a unit that the name does not give.
    pub(super) fn by_numbers(&self) -> String {
        let Some(Choice { position, velocity, time }) = self.choice() else { return String::new() };
        match (self.figures.slope, self.figures.velocity) {
            (Some(slope), _) => format!(
                "velocity is {:.4} times the change of position over that of time (in {:.0} % of places): as {} over \
                 {} and {} would be; positions reach {:.4}",
                slope.ratio.abs(),
                100.0 * slope.agreement,
                velocity.0,
                position.0,
                time.0,
                self.figures.position
            ),
            (None, _) => format!("positions reach {:.4}", self.figures.position),
        }
    }
}

impl Units {
    /// Other possible units of position, which are listed after the reason for the first.
    pub(super) fn alternatives(&self) -> String {
        let Some(first) = self.choice() else { return String::new() };
        let mut others: Vec<&str> = self.choices.iter().map(|choice| choice.position.0).collect();
        others.retain(|unit| *unit != first.position.0);
        others.dedup();
        match others.is_empty() {
            true => String::new(),
            false => format!("; {} would fit too, but is less common", others.join(" or ")),
        }
    }
}
