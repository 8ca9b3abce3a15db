//! Robots: joints in a chain, with their places, limits, transmission and parameters. No particular arm is built in;
//! descriptions are read from files.

mod geometry;
mod coupling;
mod joint_index;
mod friction_law;
mod load_friction;
mod standard_parameters;
mod parallelogram;
mod parameter;
mod shape;
mod spring;
pub mod name;
pub mod transmission;

use nalgebra::{DMatrix, Vector3};

pub use self::coupling::{Coupling, CouplingTerm};
pub use self::friction_law::{FrictionLaw, FrictionModel, FrictionTerm, LawKind};
pub use self::geometry::{DhParameters, GeometrySource, JointGeometry, Transform, UrdfOrigin};
pub use self::joint_index::JointIndex;
pub use self::load_friction::{LoadFriction, LoadKind};
pub use self::parallelogram::Parallelogram;
pub use self::parameter::{ParameterId, ParameterKind, shares_of_link};
pub use self::shape::{ArmShape, Capsule, Cell, Obstacle, ObstacleForm};
pub use self::spring::{Spring, SpringForm, SpringTerm};
pub use self::standard_parameters::StandardParameters;

/// Most joints of a described arm; numerics keep their per-joint scratch on the stack.
pub const MAX_JOINTS: usize = 9;

/// A serial arm as in its description file. SI units, radians.
#[derive(Debug, Clone, PartialEq)]
pub struct Robot {
    /// Name of the model, such as `er3a`.
    pub model: String,
    /// Joints from the base outwards, 1 to [`MAX_JOINTS`].
    pub joints: Vec<Joint>,
    /// Gravitational acceleration in the base frame, m/s²; a ceiling-mounted arm only changes this.
    pub gravity: Vector3<f64>,
    /// Tool frame in the frame of the last link.
    pub tool: Transform,
    /// Body that the arm is known to carry in a recording, in the frame of the last link: no part of the arm's parameters.
    pub carried: StandardParameters,
    /// Which columns describe friction, but for joints that have their own: see [`Robot::friction_of`].
    pub friction: FrictionModel,
    /// Place of the torque measurement.
    pub torque_sensors: TorqueSensors,
    /// Matrix `R` `[n x n]` of `theta_motor = R q`; the gear ratios on its diagonal.
    pub transmission: DMatrix<f64>,
    /// Motors that turn with two joints and have parameters of their own.
    pub couplings: Vec<Coupling>,
    /// Springs and counterbalances, at most one of each form per joint.
    pub springs: Vec<Spring>,
    /// Parallelograms, at most one per forearm.
    pub parallelograms: Vec<Parallelogram>,
    /// Speeds of the friction stage as fractions of each joint's largest speed, level 1 first.
    pub speed_levels: Vec<f64>,
    /// Excitation motion of the test, if the description gives one.
    pub excitation: Option<FourierExcitation>,
    /// Space of the links, if the description has it.
    pub shape: ArmShape,
    /// Parts of the description that were interpreted differently from their text, as sentences.
    pub remarks: Vec<String>,
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

    /// Columns that describe the friction of a joint.
    #[must_use]
    pub fn friction_of(&self, joint: JointIndex) -> FrictionModel {
        self.joints.get(joint.index()).and_then(|joint| joint.friction).unwrap_or(self.friction)
    }

    /// True if the friction of a joint depends on the torque that its gear carries.
    #[must_use]
    pub fn has_load_friction(&self) -> bool {
        self.joint_indices().any(|joint| self.friction_of(joint).load != LoadFriction::None)
    }

    /// Whether the arm is known to carry a body.
    #[must_use]
    pub fn has_carried(&self) -> bool {
        self.carried != StandardParameters::default()
    }

    /// The springs that drive a joint.
    pub fn springs_of(&self, joint: JointIndex) -> impl Iterator<Item = &Spring> {
        self.springs.iter().filter(move |spring| spring.joint == joint)
    }

    /// True if motor inertias are part of the measured torque.
    #[must_use]
    pub fn has_motor_inertia(&self) -> bool {
        self.torque_sensors == TorqueSensors::Motor
    }

    /// True if a motor turns with more than its own joint.
    #[must_use]
    pub fn has_coupled_motors(&self) -> bool {
        let r = &self.transmission;
        (0..r.nrows()).any(|i| (0..r.ncols()).any(|j| i != j && r[(i, j)] != 0.0))
    }

    /// Number of parameters of the dynamic model, the columns of its regressor. Each joint has ten, the friction terms
    /// and, if torque is measured by the motors, a motor inertia. There are three more for each coupling, two for each
    /// spring and ten for each parallelogram.
    #[must_use]
    pub fn parameter_count(&self) -> usize {
        let friction: usize =
            self.joint_indices().map(|joint| self.friction_of(joint).all_terms().count()).sum();
        let per_joint = StandardParameters::COUNT + usize::from(self.has_motor_inertia());
        per_joint * self.joints.len()
            + friction
            + CouplingTerm::ALL.len() * self.couplings.len()
            + 2 * self.springs.len()
            + StandardParameters::COUNT * self.parallelograms.len()
    }

    /// The transmission of joints with one motor each: gear ratios on the diagonal.
    #[must_use]
    pub fn uncoupled_transmission(joints: &[Joint]) -> DMatrix<f64> {
        DMatrix::from_fn(joints.len(), joints.len(), |i, j| if i == j { joints[i].gear_ratio } else { 0.0 })
    }
}

/// One joint and the link that it moves.
#[derive(Debug, Clone, PartialEq)]
pub struct Joint {
    /// Name, if the description has one.
    pub name: Option<String>,
    /// Revolute or prismatic.
    pub kind: JointKind,
    /// Place on the previous link.
    pub geometry: JointGeometry,
    /// Range and largest rates.
    pub limits: JointLimits,
    /// Motor turns per joint turn; negative for opposite directions.
    pub gear_ratio: f64,
    /// Added to the position from the controller, or the transmission, to obtain `q`: rad (m). See
    /// [`Joint::recorded_position`].
    pub position_offset: f64,
    /// Joint torque per motor current, Nm/A (N/A), if known.
    pub drive_gain: Option<f64>,
    /// Torque of the motor at its own shaft per current, before gears: Nm/A, if known.
    pub motor_torque_constant: Option<f64>,
    /// Rated torque of the motor at its own shaft, Nm, if known.
    pub rated_motor_torque: Option<f64>,
    /// Rated torque (force) of the joint behind the gear, Nm (N), if known.
    pub rated_torque: Option<f64>,
    /// Largest permissible torque (force) of the joint for a moment, Nm (N), if known.
    pub peak_torque: Option<f64>,
    /// Speed below which a row does not count as moving, rad/s (m/s for a sliding joint).
    pub low_speed: f64,
    /// True if the exports have a torque of it, according to the layout.
    pub has_torque: bool,
    /// Columns that describe friction, if they differ from the arm's.
    pub friction: Option<FrictionModel>,
    /// Parameters from a drawing or catalogue, if known; the simulator uses them.
    pub nominal: Option<NominalJoint>,
}

impl Joint {
    /// Position at the joint as the controller counts it, if the model's position is `q`: rad (m).
    #[must_use]
    pub fn recorded_position(&self, q: f64) -> f64 {
        q - self.position_offset
    }

    /// The model's position `q` if the controller's position at the joint is `recorded`: rad (m).
    #[must_use]
    pub fn model_position(&self, recorded: f64) -> f64 {
        recorded + self.position_offset
    }

    /// Least speed of a moving row of its torque, rad/s (m/s); infinite if its torque is not recorded.
    #[must_use]
    pub fn counted_speed(&self) -> f64 {
        if self.has_torque { self.low_speed } else { f64::INFINITY }
    }
}

/// Place of the torque measurement.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum TorqueSensors {
    /// In the drives: motor inertia and all friction are part of it.
    #[default]
    Motor,
    /// Behind the gears, by sensors at the joints: motors and their couplings are no part of it.
    Link,
}

/// Kind of a joint's motion.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum JointKind {
    /// Turns about its z axis; position in rad, effort in Nm.
    Revolute,
    /// Slides along its z axis; position in m, effort in N.
    Prismatic,
}

/// Range and largest rates of a joint: rad, rad/s, rad/s², rad/s³ (m for a sliding joint).
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
    /// Largest jerk, if the controller limits it.
    pub jerk: Option<f64>,
}

/// Friction coefficients of a joint in [3.10].
pub const FRICTION_COUNT: usize = 4;

/// Data of a joint from a drawing, a catalogue or an earlier identification.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NominalJoint {
    /// Inertia of the link.
    pub inertial: StandardParameters,
    /// Motor inertia seen at the joint, kg m² (kg for a sliding joint).
    pub motor_inertia: f64,
    /// Warm friction coefficients f1..f4 of [3.10]: Nm, Nm s/rad, Nm s²/rad², Nm s³/rad³. The simulator uses them,
    /// whichever columns of [`Robot::friction`] identification uses.
    pub friction: [f64; FRICTION_COUNT],
    /// Additional friction of a cold gearbox.
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
