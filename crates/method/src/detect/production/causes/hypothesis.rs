//! Hypotheses: the directions that each adds to the torque of each joint, with prior sizes and prices.

use armwatch_model::analysis::work_evidence::{JointEvidence, WorkDirection};

/// Standard deviations of the effect of temperature on friction, as fractions of the test's friction: common to all
/// joints, and per joint. Viscous friction falls with temperature, Coulomb friction hardly.
const COMMON_COULOMB: f64 = 0.2;
const COMMON_VISCOUS: f64 = 0.5;
const OWN_COULOMB: f64 = 0.05;
const OWN_VISCOUS: f64 = 0.10;

/// Prior standard deviations of the sizes of causes: friction, as a multiple of the test's; a gain; an offset, as a
/// fraction of the joint's torque; a load's mass, kg, and first moments, kg m.
const FRICTION_SIZE: f64 = 1.0;
const GAIN_SIZE: f64 = 0.3;
const OFFSET_SIZE: f64 = 1.0;
const MASS_SIZE: f64 = 20.0;
const MOMENT_SIZE: f64 = 5.0;

/// Price of one parameter, in units of chi².
const PARAMETER_PRICE: f64 = 4.0;
/// Additional price of a wrong torque signal. In a joint that carries no weight, friction is most of the torque, and a
/// gain looks like friction; wear is more frequent than a wrong signal.
const CHANNEL_PRICE: f64 = 20.0;

/// Torque added to some joints with one unknown size.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Column {
    /// Places of joints in the evidence, and directions.
    pub(super) along: Vec<(usize, WorkDirection)>,
    /// Prior variance of the size.
    pub(super) variance: f64,
    /// True if it is friction.
    pub(super) is_friction: bool,
}

impl Column {
    /// Effect of temperature on friction, with this standard deviation.
    fn warmth(along: Vec<(usize, WorkDirection)>, deviation: f64) -> Self {
        Self { along, variance: deviation * deviation, is_friction: true }
    }

    /// Returns true if the log shows this column.
    fn is_seen(&self, evidence: &[JointEvidence]) -> bool {
        self.along.iter().any(|(place, of)| evidence[*place].product(of.place(), of.place()) > 0.0)
    }
}

/// Hypothesis about the cause in addition to a load, by the place of its joint in the evidence.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Hypothesis {
    /// Nothing.
    None,
    /// More friction of a joint.
    Friction(usize),
    /// A gain of its torque signal.
    Gain(usize),
    /// An offset of its torque signal.
    Offset(usize),
}

impl Hypothesis {
    /// All hypotheses about `joints` joints.
    pub(super) fn all(joints: usize) -> impl Iterator<Item = Self> {
        let each = move |of: fn(usize) -> Self| (0..joints).map(of);
        std::iter::once(Self::None)
            .chain(each(Self::Friction))
            .chain(each(Self::Gain))
            .chain(each(Self::Offset))
    }

    /// The columns that it adds; `None` if the log shows none of them.
    pub(super) fn columns(self, evidence: &[JointEvidence]) -> Option<Vec<Column>> {
        let one = |place: usize, direction: WorkDirection, deviation: f64| {
            let is_friction = matches!(direction, WorkDirection::Coulomb | WorkDirection::Viscous);
            let variance = deviation * deviation;
            let column = Column { along: vec![(place, direction)], variance, is_friction };
            Some(column).filter(|of| variance > 0.0 && of.is_seen(evidence))
        };
        let columns: Vec<Column> = match self {
            Self::None => return Some(Vec::new()),
            Self::Friction(place) => [WorkDirection::Coulomb, WorkDirection::Viscous]
                .into_iter()
                .filter_map(|part| one(place, part, FRICTION_SIZE))
                .collect(),
            Self::Gain(place) => one(place, WorkDirection::Gain, GAIN_SIZE).into_iter().collect(),
            Self::Offset(place) => {
                let size = OFFSET_SIZE * expected_square(&evidence[place]).sqrt();
                one(place, WorkDirection::Offset, size).into_iter().collect()
            }
        };
        Some(columns).filter(|columns| !columns.is_empty())
    }

    /// Price of the hypothesis with this number of parameters, those of a load included, in units of chi².
    pub(super) fn price(self, parameters: usize) -> f64 {
        let channel = match self {
            Self::Gain(_) | Self::Offset(_) => CHANNEL_PRICE,
            Self::None | Self::Friction(_) => 0.0,
        };
        PARAMETER_PRICE * parameters as f64 + channel
    }
}

/// The columns of a load, mass first; `None` if the log shows none of them.
pub(super) fn load_columns(evidence: &[JointEvidence]) -> Option<Vec<Column>> {
    let all = |direction| (0..evidence.len()).map(|place| (place, direction)).collect();
    let column =
        |direction, size: f64| Column { along: all(direction), variance: size * size, is_friction: false };
    let columns = vec![
        column(WorkDirection::Load(0), MASS_SIZE),
        column(WorkDirection::Load(1), MOMENT_SIZE),
        column(WorkDirection::Load(2), MOMENT_SIZE),
        column(WorkDirection::Load(3), MOMENT_SIZE),
    ];
    columns.iter().any(|of| of.is_seen(evidence)).then_some(columns)
}

/// The random effects of every hypothesis: the effect of temperature on friction, common to all joints and per joint.
pub(super) fn warmth_columns(joints: usize) -> Vec<Column> {
    let all = |direction| (0..joints).map(|place| (place, direction)).collect();
    let mut columns = vec![
        Column::warmth(all(WorkDirection::Coulomb), COMMON_COULOMB),
        Column::warmth(all(WorkDirection::Viscous), COMMON_VISCOUS),
    ];
    for place in 0..joints {
        columns.push(Column::warmth(vec![(place, WorkDirection::Coulomb)], OWN_COULOMB));
        columns.push(Column::warmth(vec![(place, WorkDirection::Viscous)], OWN_VISCOUS));
    }
    columns
}

/// Mean square of a joint's torque by the test's parameters, (Nm)² ((N)²).
pub(super) fn expected_square(of: &JointEvidence) -> f64 {
    let gain = WorkDirection::Gain.place();
    of.product(gain, gain)
}
