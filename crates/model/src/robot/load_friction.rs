//! Friction over the torque that a gear carries: terms, columns, names and keys in descriptions.

use super::friction_law::FrictionTerm;

/// Friction in addition to that of speed, from the torque `L` that the gear carries: the rigid-body torque of the links
/// at the joint. `s` is the sign of the speed, smooth if the law of speed has a smooth sign.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum LoadFriction {
    /// No such friction.
    #[default]
    None,
    /// `mu |L| s`.
    Linear,
    /// `(mu |L| + mu2 L²) s`.
    Quadratic,
    /// `mu |L| s + mu_a L |s|`: `mu + mu_a` while the motor drives the load, `mu - mu_a` while the load drives the
    /// motor. A gear of constant efficiency `e` has `1/e - 1` and `1 - e`. At speed, `mu_a` acts like a gain of the
    /// joint's torque: only measurements of other joints that carry the same links determine it.
    Directional,
    /// `(mu + mu_s exp(-(v / speed)²)) |L| s`.
    Stribeck {
        /// Speed where `mu_s` has fallen to 1/e, rad/s (m/s).
        speed: f64,
    },
}

/// Keys of a dependence on load in descriptions.
#[derive(Debug)]
pub struct LoadKind {
    /// Value of the key `load_friction`.
    pub name: &'static str,
    /// Description of the dependence, for messages.
    pub about: &'static str,
    /// The dependence with this speed, rad/s (m/s), if it has one.
    pub with_speed: fn(f64) -> LoadFriction,
}

impl LoadFriction {
    /// Every dependence, in the order of messages.
    pub const KINDS: [LoadKind; 5] = [
        LoadKind { name: "none", about: "friction depends on speed alone", with_speed: |_| Self::None },
        LoadKind {
            name: "linear",
            about: "proportional to the carried torque",
            with_speed: |_| Self::Linear,
        },
        LoadKind { name: "quadratic", about: "the same and its square", with_speed: |_| Self::Quadratic },
        LoadKind {
            name: "directional",
            about: "more while the motor drives the load than while the load drives the motor",
            with_speed: |_| Self::Directional,
        },
        LoadKind {
            name: "stribeck",
            about: "proportional, and more at low speed",
            with_speed: |speed| Self::Stribeck { speed },
        },
    ];
    /// Most terms that a dependence has.
    pub const MAX_TERMS: usize = 2;

    fn kind(self) -> (f64, &'static LoadKind) {
        let at = match self {
            Self::None => 0,
            Self::Linear => 1,
            Self::Quadratic => 2,
            Self::Directional => 3,
            Self::Stribeck { .. } => 4,
        };
        (at as f64, &const { &Self::KINDS }[at])
    }

    /// Name in descriptions.
    #[must_use]
    pub fn name(self) -> &'static str {
        self.kind().1.name
    }

    /// Its speed, rad/s (m/s), if it has one.
    #[must_use]
    pub fn speed(self) -> Option<f64> {
        match self {
            Self::Stribeck { speed } => Some(speed),
            _ => None,
        }
    }

    /// Its terms, in natural order.
    #[must_use]
    pub fn terms(self) -> &'static [FrictionTerm] {
        use FrictionTerm::{Load, LoadAsymmetry, LoadSquared, LoadStribeck};
        match self {
            Self::None => &[],
            Self::Linear => &[Load],
            Self::Quadratic => &[Load, LoadSquared],
            Self::Directional => &[Load, LoadAsymmetry],
            Self::Stribeck { .. } => &[Load, LoadStribeck],
        }
    }

    /// Factors of the coefficients if the gear carries `load`, Nm (N), at the speed `qd`, rad/s (m/s), with the sign
    /// `sign` of that speed; zero beyond the terms.
    #[inline]
    #[must_use]
    pub fn columns(self, load: f64, qd: f64, sign: f64) -> [f64; Self::MAX_TERMS] {
        let along = load.abs() * sign;
        match self {
            Self::None => [0.0, 0.0],
            Self::Linear => [along, 0.0],
            Self::Quadratic => [along, load * load * sign],
            Self::Directional => [along, load * sign.abs()],
            Self::Stribeck { speed } => [along, along * (-(qd / speed).powi(2)).exp()],
        }
    }

    /// Factor of the sign of the speed, as a formula.
    pub(super) fn formula(self) -> String {
        match self {
            Self::None => "0".to_owned(),
            Self::Linear => "mu |L|".to_owned(),
            Self::Quadratic => "(mu |L| + mu2 L^2)".to_owned(),
            Self::Directional => "(mu |L| + mu_a L sign(v))".to_owned(),
            Self::Stribeck { speed } => format!("(mu + mu_s exp(-(v / {speed})^2)) |L|"),
        }
    }

    /// Numbers that represent it in the hash of a description; none without load friction.
    pub(super) fn numbers(self) -> Vec<f64> {
        match self {
            Self::None => Vec::new(),
            _ => vec![self.kind().0, self.speed().unwrap_or(0.0)],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn load_friction_opposes_the_motion_in_every_quadrant() {
        for kind in &LoadFriction::KINDS {
            let load_friction = (kind.with_speed)(0.2);
            assert_eq!(load_friction.name(), kind.name);
            let mut used = [false; LoadFriction::MAX_TERMS];
            let most = [1.0, 0.9];
            for (load, qd) in [(30.0, 0.1), (30.0, -0.1), (-30.0, 0.1), (-30.0, -0.1)] {
                let columns = load_friction.columns(load, qd, f64::signum(qd));
                let friction: f64 = columns.iter().zip(most).map(|(column, most)| column * most).sum();
                assert!(friction * qd >= 0.0, "{kind:?} {columns:?}");
                used.iter_mut().zip(columns).for_each(|(used, column)| *used |= column != 0.0);
            }
            let expected: Vec<bool> = (0..used.len()).map(|k| k < load_friction.terms().len()).collect();
            assert_eq!(used.to_vec(), expected, "{kind:?}");
        }
    }

    #[test]
    fn a_gear_of_constant_efficiency_is_directional() {
        let (efficiency, load) = (0.9_f64, 40.0_f64);
        let [driving, driven] = [efficiency.recip() - 1.0, 1.0 - efficiency];
        let [mu, mu_a] = [0.5 * (driving + driven), 0.5 * (driving - driven)];
        let motor = |qd: f64| {
            let [both, difference] = LoadFriction::Directional.columns(load, qd, qd.signum());
            load + mu * both + mu_a * difference
        };
        assert!((motor(0.5) - load / efficiency).abs() < 1e-12);
        assert!((motor(-0.5) - load * efficiency).abs() < 1e-12);
    }
}
