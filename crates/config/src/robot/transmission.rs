//! The tables `[transmission]` and `[[coupling]]`: relation between the positions of motors and joints.

use nalgebra::DMatrix;

use crate::toml::range::Limits;
use crate::toml::table::{Table, Value};
use armwatch_model::robot::transmission::joint_per_motor;
use armwatch_model::robot::{Coupling, Joint, JointIndex, JointKind, MAX_JOINTS, Robot};

/// Turns of a motor per turn of a joint.
const RATIO: Limits = Limits::within(1e5, "");

/// The matrix as given, before the number of joints is known.
pub(crate) struct GivenTransmission<'d> {
    matrix: Option<(Value<'d>, Vec<Vec<f64>>)>,
    /// True if a given value was wrong.
    wrong: bool,
}

impl GivenTransmission<'_> {
    /// The gear ratio of joint `index` in the matrix.
    pub fn ratio(&self, index: usize) -> Option<f64> {
        self.matrix.as_ref()?.1.get(index)?.get(index).copied()
    }
}

/// The transmission of an arm.
pub(crate) struct Transmission {
    /// `R` of `theta_motor = R q`.
    pub matrix: DMatrix<f64>,
    /// Motors with separate parameters for the shared motion.
    pub couplings: Vec<Coupling>,
}

/// Reads `[transmission] motor_per_joint`, if given.
pub(crate) fn read_matrix<'d>(root: &Table<'d>) -> GivenTransmission<'d> {
    let nothing = |wrong| GivenTransmission { matrix: None, wrong };
    let Some(value) = root.optional("transmission") else { return nothing(false) };
    let matrix = value.table().and_then(|table| table.required("motor_per_joint")).and_then(|value| {
        let rows: Vec<_> = value.items()?.iter().map(|row| row.numbers(None, &RATIO)).collect();
        Some((value, rows.into_iter().collect::<Option<Vec<_>>>()?))
    });
    match matrix {
        Some(matrix) => GivenTransmission { matrix: Some(matrix), wrong: false },
        None => nothing(true),
    }
}

/// Checks the matrix against the joints and reads the couplings.
pub(crate) fn read(
    root: &Table<'_>,
    given: GivenTransmission<'_>,
    joints: Option<&[Joint]>,
) -> Option<Transmission> {
    let couplings = root.optional("coupling").map(|value| value.sections());
    // Without joints there is nothing to check against.
    let matrix = match (joints?, given) {
        (_, GivenTransmission { wrong: true, .. }) => None,
        (joints, GivenTransmission { matrix: None, .. }) => Some(Robot::uncoupled_transmission(joints)),
        (joints, GivenTransmission { matrix: Some((value, rows)), .. }) => {
            check_matrix(&value, &rows, joints)
        }
    };
    let couplings = match couplings {
        None => Some(Vec::new()),
        Some(sections) => {
            let sections = sections?;
            let read = |value: &Value<'_>| read_coupling(value, joints?, matrix.as_ref()?);
            let couplings: Vec<_> = sections.iter().map(read).collect();
            couplings.into_iter().collect::<Option<Vec<Coupling>>>().filter(|couplings| {
                sections.iter().enumerate().all(|(i, section)| check_own_motor(section, couplings, i))
            })
        }
    };
    Some(Transmission { matrix: matrix?, couplings: couplings? })
}

fn check_matrix(value: &Value<'_>, rows: &[Vec<f64>], joints: &[Joint]) -> Option<DMatrix<f64>> {
    let n = joints.len();
    if rows.len() != n || rows.iter().any(|row| row.len() != n) {
        value.refuse(
            format!("must have {n} rows of {n} numbers, one row per motor and one column per joint"),
            None,
        );
        return None;
    }
    let matrix = DMatrix::from_fn(n, n, |i, j| rows[i][j]);
    if joint_per_motor(&matrix).is_none() {
        value.refuse(
            "is singular: some motors only repeat the motion of others".into(),
            Some("theta_motor = R q, with the gear ratios on the diagonal".into()),
        );
        return None;
    }
    if (0..n).any(|i| matrix[(i, i)] == 0.0) {
        value.refuse("has a zero on its diagonal, the place of the gear ratios".into(), None);
        return None;
    }
    Some(matrix)
}

fn read_coupling(value: &Value<'_>, joints: &[Joint], matrix: &DMatrix<f64>) -> Option<Coupling> {
    let table = value.table()?;
    let pair = table.required("joints").and_then(|value| {
        let items = value.items()?;
        let numbers: Vec<_> = items.iter().map(|item| read_joint_number(item, joints.len())).collect();
        match numbers.into_iter().collect::<Option<Vec<_>>>()?[..] {
            [a, b] if a != b => Some([a, b]),
            _ => {
                value.refuse("must be two different joints".into(), None);
                None
            }
        }
    });
    let motor = table.required("motor").and_then(|value| read_joint_number(&value, joints.len()));
    let (pair, motor) = (pair?, motor?);
    match pair {
        [joint, other] | [other, joint] if other == motor => {
            coupling_of(&table, joint, motor, joints, matrix)
        }
        [first, second] => {
            table.refuse(format!("the motor must be that of joint {first} or {second}"), None);
            None
        }
    }
}

fn coupling_of(
    table: &Table<'_>,
    joint: JointIndex,
    motor: JointIndex,
    joints: &[Joint],
    matrix: &DMatrix<f64>,
) -> Option<Coupling> {
    if [joint, motor].iter().any(|j| joints[j.index()].kind != JointKind::Revolute) {
        table.refuse("both joints must be revolute".into(), None);
        return None;
    }
    let ratio = matrix[(motor.index(), joint.index())] / matrix[(motor.index(), motor.index())];
    if ratio == 0.0 {
        table.refuse(
            format!("the motor of joint {motor} does not turn with joint {joint}"),
            Some(format!("give row {motor} of transmission.motor_per_joint an entry in column {joint}")),
        );
        return None;
    }
    Some(Coupling { joint, motor_joint: motor, ratio })
}

/// Refuses two couplings of one motor: their parameters would have the same names.
fn check_own_motor(section: &Value<'_>, couplings: &[Coupling], i: usize) -> bool {
    let motor = couplings[i].motor_joint;
    let first = couplings[..i].iter().all(|other| other.motor_joint != motor);
    if !first {
        section.refuse(format!("the motor of joint {motor} already has a coupling"), None);
    }
    first
}

pub(crate) fn read_joint_number(value: &Value<'_>, joint_count: usize) -> Option<JointIndex> {
    let last = joint_count.min(MAX_JOINTS);
    let number = value.integer(1..=i64::try_from(last).ok()?)?;
    JointIndex::from_number(usize::try_from(number).ok()?)
}
