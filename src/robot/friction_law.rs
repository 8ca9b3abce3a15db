//! How friction depends on speed: the laws, their terms, names and units.

/// Which columns describe the friction of a robot's joints.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct FrictionModel {
    /// The law.
    pub law: FrictionLaw,
    /// Whether each direction of motion has its own Coulomb and viscous friction. A torque offset is
    /// then no column of its own: it is half the difference of the two Coulomb parts. Not for
    /// [`FrictionLaw::Polynomial`].
    pub asymmetric: bool,
}

/// How friction depends on speed.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum FrictionLaw {
    /// `f1 sign(v) + f2 v + f3 v² sign(v) + f4 v³` [3.10].
    #[default]
    Polynomial,
    /// `fs sign(v) + fv v + off`.
    ViscousCoulomb,
    /// No friction in the measured torque, as of sensors behind gears without seals.
    None,
    /// `fs tanh(v / speed) + fv v + off`.
    Smooth {
        /// Speed at which three quarters of the Coulomb friction act, rad/s (m/s).
        speed: f64,
    },
}

impl FrictionModel {
    /// The source's law [3.10].
    pub const POLYNOMIAL: Self = Self { law: FrictionLaw::Polynomial, asymmetric: false };
    /// Most terms that a model has.
    pub const MAX_TERMS: usize = 4;

    /// Terms of each joint, in natural order.
    #[must_use]
    pub fn terms(&self) -> &'static [FrictionTerm] {
        use FrictionTerm::{
            Coulomb, CoulombNegative, CoulombPositive, F1, F2, F3, F4, Offset, Viscous, ViscousNegative,
            ViscousPositive,
        };
        match (self.law, self.asymmetric) {
            (FrictionLaw::None, _) => &[],
            (FrictionLaw::Polynomial, _) => &[F1, F2, F3, F4],
            (_, false) => &[Coulomb, Viscous, Offset],
            (_, true) => &[CoulombPositive, CoulombNegative, ViscousPositive, ViscousNegative],
        }
    }
}

/// A friction coefficient of a joint.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum FrictionTerm {
    /// `f1 sign(v)` [3.10].
    F1,
    /// `f2 v` [3.10].
    F2,
    /// `f3 v² sign(v)` [3.10].
    F3,
    /// `f4 v³` [3.10].
    F4,
    /// `fs`: Coulomb friction.
    Coulomb,
    /// `fs_p`: Coulomb friction while the position grows.
    CoulombPositive,
    /// `fs_n`: Coulomb friction while the position falls.
    CoulombNegative,
    /// `fv`: viscous friction.
    Viscous,
    /// `fv_p`: viscous friction while the position grows.
    ViscousPositive,
    /// `fv_n`: viscous friction while the position falls.
    ViscousNegative,
    /// `off`: offset of the torque signal.
    Offset,
}

impl FrictionTerm {
    /// Every term of every model.
    pub const ALL: [Self; 11] = [
        Self::F1,
        Self::F2,
        Self::F3,
        Self::F4,
        Self::Coulomb,
        Self::CoulombPositive,
        Self::CoulombNegative,
        Self::Viscous,
        Self::ViscousPositive,
        Self::ViscousNegative,
        Self::Offset,
    ];

    pub(super) fn name(self) -> &'static str {
        match self {
            Self::F1 => "f1",
            Self::F2 => "f2",
            Self::F3 => "f3",
            Self::F4 => "f4",
            Self::Coulomb => "fs",
            Self::CoulombPositive => "fs_p",
            Self::CoulombNegative => "fs_n",
            Self::Viscous => "fv",
            Self::ViscousPositive => "fv_p",
            Self::ViscousNegative => "fv_n",
            Self::Offset => "off",
        }
    }

    /// Power of the speed that the coefficient multiplies.
    pub(super) fn degree(self) -> u8 {
        match self {
            Self::F1 | Self::Coulomb | Self::CoulombPositive | Self::CoulombNegative | Self::Offset => 0,
            Self::F2 | Self::Viscous | Self::ViscousPositive | Self::ViscousNegative => 1,
            Self::F3 => 2,
            Self::F4 => 3,
        }
    }
}
