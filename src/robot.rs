//! What a robot is: joints in a chain, their modified Denavit-Hartenberg geometry, limits and
//! parameters. Nothing here knows a particular arm; descriptions come from files.

use std::fmt;

use nalgebra::{Matrix3, Vector3};

/// Most joints a described arm may have; numerics keep their per-joint scratch on the stack.
pub const MAX_JOINTS: usize = 9;

/// A joint of a chain. Counts from 0 inside; people read [`JointIndex::number`], which counts
/// from 1.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct JointIndex(usize);

impl JointIndex {
    /// The joint at `index`, counted from 0 at the base.
    #[must_use]
    pub const fn new(index: usize) -> Self {
        Self(index)
    }

    /// The joint that people call `number`, counted from 1 at the base; `None` for 0.
    #[must_use]
    pub const fn from_number(number: usize) -> Option<Self> {
        match number.checked_sub(1) {
            Some(index) => Some(Self(index)),
            None => None,
        }
    }

    /// Position in the chain, from 0 at the base.
    #[must_use]
    pub const fn index(self) -> usize {
        self.0
    }

    /// The number people read, from 1 at the base.
    #[must_use]
    pub const fn number(self) -> usize {
        self.0 + 1
    }
}

impl fmt::Display for JointIndex {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.number())
    }
}

/// A serial arm as its description file gives it. SI units, radians.
#[derive(Debug, Clone, PartialEq)]
pub struct Robot {
    /// Name of the model, such as `er3a`.
    pub model: String,
    /// Joints from the base outwards, 1 to [`MAX_JOINTS`].
    pub joints: Vec<Joint>,
    /// Gravitational acceleration in the base frame, m/s²; a ceiling-mounted arm only changes this.
    pub gravity: Vector3<f64>,
    /// Speeds of the friction stage as fractions of each joint's largest speed, level 1 first.
    pub speed_levels: Vec<f64>,
    /// Excitation motion of the test, if the description gives one.
    pub excitation: Option<FourierExcitation>,
}

impl Robot {
    /// Number of joints `n`.
    #[must_use]
    pub fn joint_count(&self) -> usize {
        self.joints.len()
    }

    /// Joints in chain order.
    pub fn joint_indices(&self) -> impl Iterator<Item = JointIndex> + use<> {
        (0..self.joints.len()).map(JointIndex::new)
    }
}

/// One joint and the link that it moves.
#[derive(Debug, Clone, PartialEq)]
pub struct Joint {
    /// Turning or sliding.
    pub kind: JointKind,
    /// Transform from the previous link's frame.
    pub geometry: ModifiedDh,
    /// Range and largest rates.
    pub limits: JointLimits,
    /// Motor turns per joint turn.
    pub gear_ratio: f64,
    /// Rated torque of the motor at its own shaft, Nm, where known.
    pub rated_motor_torque: Option<f64>,
    /// Speed below which a row does not count as moving, rad/s (m/s for a sliding joint).
    pub low_speed: f64,
    /// Parameters from a drawing or catalogue, where known: what the simulator moves.
    pub nominal: Option<NominalJoint>,
}

/// How a joint moves.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum JointKind {
    /// Turns about its z axis; position in rad, effort in Nm.
    Revolute,
    /// Slides along its z axis; position in m, effort in N.
    Prismatic,
}

/// Modified Denavit-Hartenberg parameters (Craig) of joint `i`:
/// `T(i-1,i) = Rx(alpha) Dx(a) Rz(theta) Dz(d)` [2.1, 2.2], where `a` and `alpha` belong to axis
/// `i-1`. A revolute joint has `theta = q + theta_offset`; a prismatic one `theta = theta_offset`
/// and slides by `d + q`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ModifiedDh {
    /// Distance from axis `i-1` to axis `i` along `x(i-1)`, m.
    pub a: f64,
    /// Angle from axis `i-1` to axis `i` about `x(i-1)`, rad.
    pub alpha: f64,
    /// Offset along `z(i)`, m.
    pub d: f64,
    /// Added to the joint position to give `theta`, rad.
    pub theta_offset: f64,
}

/// Range and largest rates of a joint: rad, rad/s, rad/s² (m for a sliding joint).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JointLimits {
    /// Smallest position.
    pub position_min: f64,
    /// Largest position.
    pub position_max: f64,
    /// Largest speed; the levels of the friction stage are fractions of it.
    pub velocity: f64,
    /// Largest acceleration.
    pub acceleration: f64,
}

/// Ten inertial parameters of a link about the origin of its own frame, in the order
/// [`StandardParameters::NAMES`]. `mP` is the first moment, mass times centre of mass; inertia is
/// about the frame's origin, not about the centre of mass.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct StandardParameters(pub [f64; 10]);

impl StandardParameters {
    /// Number of inertial parameters of a link.
    pub const COUNT: usize = 10;
    /// Names in order; `m` in kg, `mP*` in kg m, `I**` in kg m².
    pub const NAMES: [&'static str; 10] =
        ["m", "mPx", "mPy", "mPz", "Ixx", "Ixy", "Ixz", "Iyy", "Iyz", "Izz"];

    /// Mass, kg.
    #[must_use]
    pub fn mass(&self) -> f64 {
        self.0[0]
    }

    /// First moment `m c`, kg m, in the link frame.
    #[must_use]
    pub fn first_moment(&self) -> Vector3<f64> {
        Vector3::new(self.0[1], self.0[2], self.0[3])
    }

    /// Inertia about the origin of the link frame, kg m².
    #[must_use]
    pub fn inertia(&self) -> Matrix3<f64> {
        let [_, _, _, _, xx, xy, xz, yy, yz, zz] = self.0;
        Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz)
    }
}

/// What a drawing, a catalogue or an earlier identification says of a joint.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NominalJoint {
    /// Inertia of the link.
    pub inertial: StandardParameters,
    /// Motor inertia seen at the joint, kg m² (kg for a sliding joint).
    pub motor_inertia: f64,
    /// Warm friction coefficients f1..f4 of [3.10]: Nm, Nm s/rad, Nm s²/rad², Nm s³/rad³.
    pub friction: [f64; 4],
    /// How much more friction a cold gearbox has.
    pub warm_up: WarmUpShape,
    /// Standard deviation of the torque signal, Nm.
    pub torque_noise: f64,
}

/// Friction over time relative to warm friction: `1 + b exp(-t/t1) + c exp(-t/t2)` [5.4].
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct WarmUpShape {
    /// Slow part, as a fraction of warm friction.
    pub b: f64,
    /// Time constant of the slow part, s.
    pub t1: f64,
    /// Fast part, as a fraction of warm friction.
    pub c: f64,
    /// Time constant of the fast part, s.
    pub t2: f64,
}

/// Excitation as a finite Fourier series [4.19-4.21].
#[derive(Debug, Clone, PartialEq)]
pub struct FourierExcitation {
    /// Base frequency, Hz.
    pub base_frequency: f64,
    /// Cosine amplitudes of the speed, `[n][N]`, rad/s.
    pub a: Vec<Vec<f64>>,
    /// Sine amplitudes of the speed, `[n][N]`, rad/s.
    pub b: Vec<Vec<f64>>,
    /// Centre position, `[n]`, rad.
    pub centre: Vec<f64>,
}

/// Which quantity a parameter of a joint or its link is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum ParameterKind {
    /// Inertial parameter of the link, index into [`StandardParameters::NAMES`].
    Inertial(u8),
    /// Friction coefficient f1..f4 of [3.10], index from 0.
    Friction(u8),
    /// Motor inertia seen at the joint.
    MotorInertia,
}

/// A parameter of the dynamic model: a kind at a joint.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ParameterId {
    /// The joint, and the link that it moves.
    pub joint: JointIndex,
    /// The quantity.
    pub kind: ParameterKind,
}

/// Friction coefficients of a joint in [3.10].
pub const FRICTION_COUNT: usize = 4;

impl ParameterId {
    /// All `15 n` parameters in the model's natural column order: ten inertial ones link by link,
    /// four friction coefficients joint by joint, motor inertias.
    #[must_use]
    pub fn natural_order(joint_count: usize) -> Vec<Self> {
        let inertial = (0..joint_count).flat_map(|j| (0..10).map(move |k| (j, ParameterKind::Inertial(k))));
        let friction = (0..joint_count).flat_map(|j| (0..4).map(move |k| (j, ParameterKind::Friction(k))));
        let motor = (0..joint_count).map(|j| (j, ParameterKind::MotorInertia));
        inertial
            .chain(friction)
            .chain(motor)
            .map(|(j, kind)| Self { joint: JointIndex::new(j), kind })
            .collect()
    }

    /// Name without the joint, as in the view `cycle_parameters`: `mPx`, `f1`, `I_m`.
    #[must_use]
    pub fn name(&self) -> &'static str {
        match self.kind {
            ParameterKind::Inertial(k) => StandardParameters::NAMES[usize::from(k)],
            ParameterKind::Friction(k) => ["f1", "f2", "f3", "f4"][usize::from(k)],
            ParameterKind::MotorInertia => "I_m",
        }
    }

    /// Unit of the value for a joint of the given kind.
    #[must_use]
    pub fn unit(&self, joint: JointKind) -> &'static str {
        match (self.kind, joint) {
            (ParameterKind::Inertial(0), _) => "kg",
            (ParameterKind::Inertial(1..=3), _) => "kg m",
            (ParameterKind::Inertial(_), _) | (ParameterKind::MotorInertia, JointKind::Revolute) => "kg m^2",
            (ParameterKind::MotorInertia, JointKind::Prismatic) => "kg",
            (ParameterKind::Friction(0), JointKind::Revolute) => "Nm",
            (ParameterKind::Friction(1), JointKind::Revolute) => "Nm s/rad",
            (ParameterKind::Friction(2), JointKind::Revolute) => "Nm s^2/rad^2",
            (ParameterKind::Friction(_), JointKind::Revolute) => "Nm s^3/rad^3",
            (ParameterKind::Friction(0), JointKind::Prismatic) => "N",
            (ParameterKind::Friction(1), JointKind::Prismatic) => "N s/m",
            (ParameterKind::Friction(2), JointKind::Prismatic) => "N s^2/m^2",
            (ParameterKind::Friction(_), JointKind::Prismatic) => "N s^3/m^3",
        }
    }
}

impl fmt::Display for ParameterId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "J{}_{}", self.joint, self.name())
    }
}
