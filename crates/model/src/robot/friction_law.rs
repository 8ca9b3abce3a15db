//! Friction over speed: the laws with their terms, columns, names, units and keys in descriptions.
//! `load_friction.rs` has the dependence on load.

use super::load_friction::LoadFriction;

/// Columns that describe the friction of a robot's joints.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct FrictionModel {
    /// The law.
    pub law: FrictionLaw,
    /// True if each direction of motion has separate Coulomb and viscous friction. A torque offset has no column then:
    /// it is half the difference of the two Coulomb parts. Not for [`FrictionLaw::Polynomial`].
    pub asymmetric: bool,
    /// Additional friction that depends on the torque of the gear.
    pub load: LoadFriction,
}

/// Dependence of friction on speed.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum FrictionLaw {
    /// `f1 sign(v) + f2 v + f3 v² sign(v) + f4 v³` [3.10].
    #[default]
    Polynomial,
    /// `fs sign(v) + fv v + off`.
    ViscousCoulomb,
    /// No friction in the measured torque, as for sensors behind gears without seals.
    None,
    /// `fs tanh(v / speed) + fv v + off`.
    Smooth {
        /// Speed with three quarters of the Coulomb friction, rad/s (m/s).
        speed: f64,
    },
}

/// Keys of a law in descriptions, and its needs.
#[derive(Debug)]
pub struct LawKind {
    /// Value of the key `friction_model`.
    pub name: &'static str,
    /// Description of the law, for messages.
    pub about: &'static str,
    /// Keys of its speed, in rad/s for a revolute joint and in m/s for a prismatic one.
    pub speed_keys: Option<[&'static str; 2]>,
    /// True if each direction of motion may have separate coefficients.
    pub has_directions: bool,
    /// The law with this speed, rad/s (m/s), if it has one.
    pub with_speed: fn(f64) -> FrictionLaw,
}

impl FrictionLaw {
    /// Every law, in the order of messages.
    pub const KINDS: [LawKind; 4] = [
        LawKind {
            name: "polynomial",
            about: "f1 to f4 of [3.10]",
            speed_keys: None,
            has_directions: false,
            with_speed: |_| Self::Polynomial,
        },
        LawKind {
            name: "viscous_coulomb",
            about: "Coulomb, viscous and offset",
            speed_keys: None,
            has_directions: true,
            with_speed: |_| Self::ViscousCoulomb,
        },
        LawKind {
            name: "smooth",
            about: "the same with a tanh for the sign",
            speed_keys: Some(["smooth_speed_rad_s", "smooth_speed_m_s"]),
            has_directions: true,
            with_speed: |speed| Self::Smooth { speed },
        },
        LawKind {
            name: "none",
            about: "no friction in the measured torque",
            speed_keys: None,
            has_directions: false,
            with_speed: |_| Self::None,
        },
    ];

    /// Name in descriptions.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Polynomial => "polynomial",
            Self::ViscousCoulomb => "viscous_coulomb",
            Self::Smooth { .. } => "smooth",
            Self::None => "none",
        }
    }

    /// Its speed, rad/s (m/s), if it has one.
    #[must_use]
    pub fn speed(self) -> Option<f64> {
        match self {
            Self::Smooth { speed } => Some(speed),
            Self::Polynomial | Self::ViscousCoulomb | Self::None => None,
        }
    }

    /// Factor of its Coulomb friction at a speed, rad/s (m/s); 0 at rest.
    #[inline]
    #[must_use]
    pub fn sign(self, speed: f64) -> f64 {
        match self {
            Self::Smooth { speed: scale } => (speed / scale).tanh(),
            _ if speed == 0.0 => 0.0,
            _ => speed.signum(),
        }
    }

    /// Its number in the hash of a description, which never changes.
    fn code(self) -> f64 {
        match self {
            Self::Polynomial => 0.0,
            Self::ViscousCoulomb => 1.0,
            Self::Smooth { .. } => 2.0,
            Self::None => 3.0,
        }
    }
}

impl FrictionModel {
    /// The source's law [3.10].
    pub const POLYNOMIAL: Self =
        Self { law: FrictionLaw::Polynomial, asymmetric: false, load: LoadFriction::None };
    /// Most terms that a model has.
    pub const MAX_TERMS: usize = 4;

    /// Terms of each joint that depend only on its speed, in natural order. Those of [`LoadFriction::terms`] follow.
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

    /// Factors of a joint's friction coefficients at the speed `qd` (rad/s or m/s), in the order of
    /// [`FrictionModel::terms`]; zero beyond them. `sign(0) = 0`.
    ///
    /// - polynomial [3.10]: `sign(qd), qd, qd² sign(qd), qd³`;
    /// - viscous and Coulomb: `sign(qd), qd, 1`; smooth: `tanh(qd / speed), qd, 1`;
    /// - none: no column;
    /// - asymmetric: the sign's positive and its negative part, then those of the speed.
    #[inline]
    #[must_use]
    pub fn columns(&self, qd: f64) -> [f64; Self::MAX_TERMS] {
        let sign = self.law.sign(qd);
        match (self.law, self.asymmetric) {
            (FrictionLaw::None, _) => [0.0; Self::MAX_TERMS],
            (FrictionLaw::Polynomial, _) => [sign, qd, qd * qd.abs(), qd * qd * qd],
            (_, false) => [sign, qd, 1.0, 0.0],
            (_, true) => [sign.max(0.0), sign.min(0.0), qd.max(0.0), qd.min(0.0)],
        }
    }

    /// Friction torque, Nm (N), of the coefficients `f` in the order of [`FrictionModel::terms`] at the speed `qd` in
    /// rad/s (m/s).
    #[inline]
    #[must_use]
    pub fn torque(&self, f: &[f64; Self::MAX_TERMS], qd: f64) -> f64 {
        self.columns(qd).iter().zip(f).map(|(column, f)| f * column).sum()
    }

    /// All terms of a joint, in natural order: those of speed, then those of load.
    pub fn all_terms(&self) -> impl Iterator<Item = FrictionTerm> + use<> {
        self.terms().iter().chain(self.load.terms()).copied()
    }

    /// Factors of the load coefficients if the gear carries `load`, Nm (N), at the speed `qd`, rad/s (m/s), in the
    /// order of [`LoadFriction::terms`]; zero beyond them.
    #[inline]
    #[must_use]
    pub fn load_columns(&self, load: f64, qd: f64) -> [f64; LoadFriction::MAX_TERMS] {
        self.load.columns(load, qd, self.law.sign(qd))
    }

    /// The friction torque at the speed `v` as a formula; `L` is the torque that the gear carries.
    #[must_use]
    pub fn formula(&self) -> String {
        let of_speed = self.speed_formula();
        match self.load {
            LoadFriction::None => of_speed,
            load => {
                let sign = match self.law {
                    FrictionLaw::Smooth { speed } => format!("tanh(v / {speed})"),
                    _ => "sign(v)".to_owned(),
                };
                format!("{of_speed} + {} {sign}, L: torque that the gear carries", load.formula())
            }
        }
    }

    fn speed_formula(&self) -> String {
        match (self.law, self.asymmetric) {
            (FrictionLaw::None, _) => "none".to_owned(),
            (FrictionLaw::Polynomial, _) => "f1 sign(v) + f2 v + f3 v^2 sign(v) + f4 v^3".to_owned(),
            (FrictionLaw::ViscousCoulomb, false) => "fs sign(v) + fv v + off".to_owned(),
            (FrictionLaw::ViscousCoulomb, true) => {
                "fs_p + fv_p v forwards, -fs_n + fv_n v backwards".to_owned()
            }
            (FrictionLaw::Smooth { speed }, false) => format!("fs tanh(v / {speed}) + fv v + off"),
            (FrictionLaw::Smooth { speed }, true) => {
                format!("fs_p tanh(v / {speed}) + fv_p v forwards, fs_n tanh(v / {speed}) + fv_n v backwards")
            }
        }
    }

    /// Difference from a line over speed that is equal in both directions, as in formats of other programs; completes
    /// "friction was identified as ..".
    #[must_use]
    pub fn beside_a_line(&self) -> &'static str {
        if self.load != LoadFriction::None {
            return "dependent on the load, of which the part that no load changes is written as its nearest line";
        }
        match (self.law, self.asymmetric) {
            (FrictionLaw::None, _) => "none: the torque was measured behind the gears",
            (FrictionLaw::Polynomial, _) => "a polynomial of speed, of which the nearest line is written",
            (FrictionLaw::Smooth { .. }, false) => "smooth at zero speed and has an offset",
            (FrictionLaw::ViscousCoulomb, false) => "the written one and an offset of torque",
            (_, true) => "different in the two directions, of which the mean is written",
        }
    }

    /// Numbers that represent it in the hash of a description. A model without load friction has the same numbers as
    /// before load friction existed.
    #[must_use]
    pub fn numbers(&self) -> Vec<f64> {
        let of_speed =
            [self.law.code(), self.law.speed().unwrap_or(0.0), f64::from(u8::from(self.asymmetric))];
        of_speed.into_iter().chain(self.load.numbers()).collect()
    }
}

/// Power of a speed or of a carried torque.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum TermFactor {
    Speed(u8),
    Load(u8),
}

crate::named_enum! {
    /// A friction coefficient of a joint.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
    pub enum FrictionTerm {
        /// `f1 sign(v)` [3.10].
        F1 = "f1",
        /// `f2 v` [3.10].
        F2 = "f2",
        /// `f3 v² sign(v)` [3.10].
        F3 = "f3",
        /// `f4 v³` [3.10].
        F4 = "f4",
        /// `fs`: Coulomb friction.
        Coulomb = "fs",
        /// `fs_p`: Coulomb friction while the position grows.
        CoulombPositive = "fs_p",
        /// `fs_n`: Coulomb friction while the position falls.
        CoulombNegative = "fs_n",
        /// `fv`: viscous friction.
        Viscous = "fv",
        /// `fv_p`: viscous friction while the position grows.
        ViscousPositive = "fv_p",
        /// `fv_n`: viscous friction while the position falls.
        ViscousNegative = "fv_n",
        /// `off`: offset of the torque signal.
        Offset = "off",
        /// `mu`: friction per torque that the gear carries.
        Load = "mu",
        /// `mu_a`: increase of `mu` while the motor drives the load, and decrease while the load drives the motor.
        LoadAsymmetry = "mu_a",
        /// `mu2`: friction per square of the torque that the gear carries.
        LoadSquared = "mu2",
        /// `mu_s`: increase of `mu` at standstill.
        LoadStribeck = "mu_s",
    }
}

impl FrictionTerm {
    /// Factor of the coefficient.
    pub(super) fn factor(self) -> TermFactor {
        match self {
            Self::F1 | Self::Coulomb | Self::CoulombPositive | Self::CoulombNegative | Self::Offset => {
                TermFactor::Speed(0)
            }
            Self::F2 | Self::Viscous | Self::ViscousPositive | Self::ViscousNegative => TermFactor::Speed(1),
            Self::F3 => TermFactor::Speed(2),
            Self::F4 => TermFactor::Speed(3),
            Self::Load | Self::LoadAsymmetry | Self::LoadStribeck => TermFactor::Load(1),
            Self::LoadSquared => TermFactor::Load(2),
        }
    }

    /// True if it multiplies the torque that the gear carries.
    #[must_use]
    pub fn is_of_load(self) -> bool {
        matches!(self.factor(), TermFactor::Load(_))
    }

    /// Its value from the nominal friction, a polynomial with these coefficients [3.10]. Laws without the higher powers
    /// have a value only if these vanish; a drive without a fault has no offset.
    #[must_use]
    pub fn nominal(self, [f1, f2, f3, f4]: &[f64; 4]) -> Option<f64> {
        let is_linear = *f3 == 0.0 && *f4 == 0.0;
        match self {
            Self::F1 => Some(*f1),
            Self::F2 => Some(*f2),
            Self::F3 => Some(*f3),
            Self::F4 => Some(*f4),
            Self::Coulomb | Self::CoulombPositive | Self::CoulombNegative => is_linear.then_some(*f1),
            Self::Viscous | Self::ViscousPositive | Self::ViscousNegative => is_linear.then_some(*f2),
            Self::Offset => Some(0.0),
            // the nominal friction has no load
            Self::Load | Self::LoadAsymmetry | Self::LoadSquared | Self::LoadStribeck => None,
        }
    }

    /// True if its column jumps when a motion reverses.
    #[must_use]
    pub fn jumps(self) -> bool {
        matches!(self, Self::F1 | Self::Coulomb | Self::CoulombPositive | Self::CoulombNegative)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rounding errors of a few operations.
    const ROUNDING: f64 = 1e-14;

    fn model(law: FrictionLaw, asymmetric: bool) -> FrictionModel {
        FrictionModel { law, asymmetric, load: LoadFriction::None }
    }

    #[test]
    fn friction_is_odd_and_a_resting_joint_has_none() {
        let f = [1.5, 8.0, -1.2, 0.3];
        let torque = |qd| FrictionModel::POLYNOMIAL.torque(&f, qd);
        assert_eq!((torque(0.0), torque(-0.0)), (0.0, 0.0));
        let expected = 1.5 + 8.0 * 2.0 - 1.2 * 4.0 + 0.3 * 8.0;
        assert!((torque(2.0) - expected).abs() < ROUNDING * expected);
        assert!((torque(-2.0) + expected).abs() < ROUNDING * expected);
    }

    #[test]
    fn viscous_and_coulomb_friction_has_an_offset_in_both_directions() {
        let f = [1.5, 8.0, 0.25, 99.0];
        for (law, sign) in
            [(FrictionLaw::ViscousCoulomb, 1.0), (FrictionLaw::Smooth { speed: 0.5 }, 4.0_f64.tanh())]
        {
            let torque = |qd| model(law, false).torque(&f, qd);
            assert!((torque(2.0) - (1.5 * sign + 16.25)).abs() < ROUNDING * 20.0);
            assert!((torque(-2.0) + (1.5 * sign + 15.75)).abs() < ROUNDING * 20.0);
            assert_eq!(torque(0.0), 0.25);
        }
    }

    #[test]
    fn asymmetric_friction_of_equal_directions_is_symmetric_and_an_offset_is_half_the_difference() {
        let symmetric = |law, qd| model(law, false).torque(&[1.5, 8.0, 0.0, 0.0], qd);
        let coulomb = FrictionLaw::ViscousCoulomb;
        for qd in [-2.0, -0.1, 0.0, 0.3, 4.0] {
            for law in [coulomb, FrictionLaw::Smooth { speed: 0.2 }] {
                let both = model(law, true).torque(&[1.5, 1.5, 8.0, 8.0], qd);
                assert!((both - symmetric(law, qd)).abs() < ROUNDING * 40.0);
            }
            if qd != 0.0 {
                let skewed = model(coulomb, true).torque(&[1.75, 1.25, 8.0, 8.0], qd);
                assert!((skewed - symmetric(coulomb, qd) - 0.25).abs() < ROUNDING * 40.0);
            }
        }
    }

    /// Every law, with and without separate coefficients for each direction.
    pub(in crate::robot) fn models() -> Vec<FrictionModel> {
        let of_kind = |kind: &LawKind| {
            let law = (kind.with_speed)(0.1);
            let both = [false, true].into_iter().take(1 + usize::from(kind.has_directions));
            both.map(move |asymmetric| model(law, asymmetric)).collect::<Vec<_>>()
        };
        FrictionLaw::KINDS.iter().flat_map(of_kind).collect()
    }

    #[test]
    fn each_law_has_a_name_a_number_and_as_many_columns_as_terms() {
        let names: Vec<&str> = FrictionLaw::KINDS.iter().map(|kind| (kind.with_speed)(0.1).name()).collect();
        assert_eq!(names, FrictionLaw::KINDS.each_ref().map(|kind| kind.name));
        for (at, model) in models().iter().enumerate() {
            assert!(models()[..at].iter().all(|other| other.numbers() != model.numbers()), "{model:?}");
            let terms = model.terms();
            assert!(terms.len() <= FrictionModel::MAX_TERMS && terms.windows(2).all(|w| w[0] < w[1]));
            let columns = [-2.0, -0.05, 0.05, 2.0].map(|qd| model.columns(qd));
            for column in 0..FrictionModel::MAX_TERMS {
                let is_used = columns.iter().any(|of| of[column] != 0.0);
                assert_eq!(is_used, column < terms.len(), "{model:?} {columns:?}");
            }
        }
    }
}
