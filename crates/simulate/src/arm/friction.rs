//! Friction of a gearbox: similar to the identifier's polynomial [3.10], but not equal to it.
//!
//! It has a bump at low speed, a sign that is smooth through zero, a ripple with the angle of the gear, and a warm-up
//! that reduces the viscous part more than the Coulomb part.

use std::f64::consts::TAU;

use super::efficiency::Teeth;
use super::fault::Wear;
use armwatch_model::robot::{FRICTION_COUNT, Joint, NominalJoint, WarmUpShape};

/// Share of the thermal excess in the Coulomb friction f1; the oil's viscosity has all of it.
pub const COULOMB_EXCESS: f64 = 0.3;
/// Height of the bump at low speed, as a fraction of f1.
const STRIBECK_FRACTION: f64 = 0.15;
/// Speed of decay of the bump to 1/e, as a fraction of the largest speed.
const STRIBECK_SPEED: f64 = 0.02;
/// Speed scale of the smooth sign, as a fraction of the largest speed: some mrad/s.
const SIGN_SPEED: f64 = 0.001;
/// Amplitude of the ripple, as a fraction of f1.
const RIPPLE_FRACTION: f64 = 0.04;
/// Ripples per turn of the motor: a wave generator is an ellipse and passes twice.
const RIPPLES_A_TURN: f64 = 2.0;
/// Corner frequency of the ripple, Hz; inertia and the current loop smooth it above.
const RIPPLE_CORNER_HZ: f64 = 10.0;
/// Change of the thermal excess and of warm friction per kelvin below the usual ambient.
const EXCESS_PER_KELVIN: f64 = 0.03;
const WARM_PER_KELVIN: f64 = 0.004;

/// Scale of the smooth sign of [`FrictionShape::Smooth`], as a fraction of the largest speed.
const SMOOTH_SPEED: f64 = 0.005;
/// The same of the last joint of [`FrictionShape::LateTurnOver`]: 0.1 to 0.2 rad/s of a wrist.
const LATE_SPEED: f64 = 0.025;
/// Height of the bump of [`FrictionShape::Stiction`], as a fraction of f1 (Armstrong-Helouvry, 1994: breakaway
/// torques of 1.2 to 1.6 times the Coulomb torque).
const STICTION_FRACTION: f64 = 0.5;
/// Travel of a reversal of the torque of [`FrictionShape::Presliding`], rad (m).
const PRESLIDING_TRAVEL: f64 = 2e-3;

/// Form of a gearbox's friction.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum FrictionShape {
    /// Like a real gearbox: bump, smooth sign, ripple, warm-up.
    #[default]
    Gearbox,
    /// Exactly [3.10] with the warm coefficients of the description, from the first row on.
    Polynomial,
    /// Coulomb friction that jumps with the sign of the speed, without bump and ripple.
    Sign,
    /// Coulomb friction that reverses within a few hundredths of a rad/s.
    Smooth,
    /// Like [`Self::Smooth`], with a last joint that reverses within some tenths of a rad/s.
    LateTurnOver,
    /// Breakaway torque that is 1.5 times the Coulomb torque.
    Stiction,
    /// Coulomb friction that reverses along a travel instead of a speed (Dahl, 1968).
    Presliding,
}

/// Temperature state of the gearboxes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ThermalState {
    /// Time since the cold start, s.
    pub seconds: f64,
    /// Difference between the ambient temperature and the usual one, K.
    pub ambient_offset_k: f64,
}

/// Friction of one joint in one run.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JointFriction {
    /// Warm coefficients f1..f4 with wear.
    pub warm: [f64; FRICTION_COUNT],
    /// Growth towards cold.
    pub warm_up: WarmUpShape,
    /// Height of the bump at low speed, as a fraction of f1.
    pub bump: f64,
    /// Scale of the bump at low speed, rad/s.
    pub stribeck_speed: f64,
    /// Scale of the smooth sign, rad/s.
    pub sign_speed: f64,
    /// Amplitude of the ripple, Nm.
    pub ripple: f64,
    /// Ripples per radian of the joint, times 2 pi.
    pub ripple_wave_number: f64,
    /// More ripples, of other orders of the gear.
    pub more_ripples: [Ripple; MORE_RIPPLES],
    /// A ripple of damage.
    pub damage: Ripple,
    /// Travel along which the Coulomb part turns over, rad; 0 where it follows the speed alone.
    pub presliding_travel: f64,
    /// Excess of friction in the joint's positive direction, as a fraction; the negative direction has as much less.
    pub direction: f64,
    /// Friction per Nm (N) of torque that the gear carries.
    pub load: f64,
    /// Loss of the teeth from the power that they transmit.
    pub teeth: Teeth,
}

/// Most ripples of a joint in addition to the first.
pub const MORE_RIPPLES: usize = 3;

/// A ripple of the torque with the angle of the gear.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Ripple {
    /// Amplitude, Nm.
    pub amplitude: f64,
    /// Ripples per radian of the joint, times 2 pi.
    pub wave_number: f64,
}

/// A ripple as requested.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RippleOrder {
    /// Ripples per turn of the motor.
    pub order: f64,
    /// Amplitude, as a fraction of f1.
    pub part: f64,
}

/// Friction of a joint with `wear`; `load` is its healthy friction per Nm (N) that the gear carries, `teeth_loss` the
/// fraction of the transmitted power that healthy teeth lose.
pub fn joint_friction(
    joint: &Joint,
    nominal: &NominalJoint,
    (load, teeth_loss): (f64, f64),
    wear: &Wear,
) -> JointFriction {
    let warm = std::array::from_fn(|k| nominal.friction[k] * (1.0 + wear.coefficients[k]));
    JointFriction {
        warm,
        warm_up: nominal.warm_up,
        bump: STRIBECK_FRACTION,
        stribeck_speed: STRIBECK_SPEED * joint.limits.velocity,
        sign_speed: SIGN_SPEED * joint.limits.velocity,
        ripple: RIPPLE_FRACTION * warm[0].abs(),
        ripple_wave_number: RIPPLES_A_TURN * joint.gear_ratio,
        more_ripples: [Ripple::default(); MORE_RIPPLES],
        damage: Ripple::default(),
        presliding_travel: 0.0,
        direction: 0.0,
        load: load * (1.0 + wear.load),
        teeth: Teeth { loss: teeth_loss * (1.0 + wear.load), top_speed: joint.limits.velocity },
    }
}

impl JointFriction {
    /// The same gearbox with `factor` times the friction.
    #[must_use]
    pub fn scaled(self, factor: f64) -> Self {
        Self {
            warm: self.warm.map(|f| f * factor),
            ripple: self.ripple * factor,
            load: self.load * factor,
            teeth: Teeth { loss: self.teeth.loss * factor, ..self.teeth },
            ..self
        }
    }

    /// Warm friction without ripple and load at the speed `qd`, Nm.
    pub fn warm_torque(&self, qd: f64) -> f64 {
        friction_torque(self, &self.warm, qd)
    }

    /// The same gearbox with a ripple of damage at the turn of the motor, a part of its Coulomb friction.
    #[must_use]
    pub fn damaged(self, part: f64, gear_ratio: f64) -> Self {
        Self { damage: Ripple { amplitude: part * self.warm[0].abs(), wave_number: gear_ratio }, ..self }
    }

    /// The same gearbox with these ripples in place of its own; those beyond 1 + [`MORE_RIPPLES`] are left out.
    #[must_use]
    pub fn with_ripples(self, orders: &[RippleOrder], gear_ratio: f64) -> Self {
        let of = |of: &RippleOrder| Ripple {
            amplitude: of.part * self.warm[0].abs(),
            wave_number: of.order * gear_ratio,
        };
        let mut all = orders.iter().map(of);
        let first = all.next().unwrap_or_default();
        Self {
            ripple: first.amplitude,
            ripple_wave_number: first.wave_number,
            more_ripples: std::array::from_fn(|_| all.next().unwrap_or_default()),
            ..self
        }
    }

    /// The same gearbox with another form of friction; `is_last` is true for the joint at the end of the arm,
    /// `top_speed` is its largest speed, rad/s.
    #[must_use]
    pub fn in_shape(self, shape: FrictionShape, is_last: bool, top_speed: f64) -> Self {
        let plain = Self { bump: 0.0, ripple: 0.0, sign_speed: f64::MIN_POSITIVE, ..self };
        match shape {
            FrictionShape::Gearbox => self,
            FrictionShape::Polynomial => self.polynomial(),
            FrictionShape::Sign => plain,
            FrictionShape::LateTurnOver if is_last => Self { sign_speed: LATE_SPEED * top_speed, ..plain },
            FrictionShape::Smooth | FrictionShape::LateTurnOver => {
                Self { sign_speed: SMOOTH_SPEED * top_speed, ..plain }
            }
            FrictionShape::Stiction => Self { bump: STICTION_FRACTION, ..self },
            FrictionShape::Presliding => Self { presliding_travel: PRESLIDING_TRAVEL, ..plain },
        }
    }

    /// The same gearbox with only the terms of [3.10].
    #[must_use]
    pub fn polynomial(self) -> Self {
        // the smooth sign becomes a jump: tanh of an extremely large quotient
        Self {
            warm_up: WarmUpShape::default(),
            bump: 0.0,
            sign_speed: f64::MIN_POSITIVE,
            ripple: 0.0,
            ..self
        }
    }
}

/// Friction relative to warm friction in the usual ambient, `1 + b exp(-t/t1) + c exp(-t/t2)` [5.4],
/// with the ambient's influence.
pub fn thermal_multiplier(shape: &WarmUpShape, state: ThermalState) -> f64 {
    multiplier_of(shape, cold_parts(shape, state.seconds), state.ambient_offset_k)
}

/// Remaining coldness `seconds` after a cold start, 1 to 0: of the slow part and the fast one.
pub fn cold_parts(shape: &WarmUpShape, seconds: f64) -> [f64; 2] {
    [shape.t1, shape.t2].map(|constant| if constant > 0.0 { (-seconds / constant).exp() } else { 0.0 })
}

/// Like [`thermal_multiplier`], from the remaining coldness.
pub fn multiplier_of(shape: &WarmUpShape, [slow, fast]: [f64; 2], ambient_offset_k: f64) -> f64 {
    let excess = shape.b * slow + shape.c * fast;
    let colder = -ambient_offset_k;
    1.0 + excess * (1.0 + EXCESS_PER_KELVIN * colder).max(0.0) + WARM_PER_KELVIN * colder
}

/// Coefficients f1..f4 at a moment: the thermal excess of the Coulomb part is [`COULOMB_EXCESS`] times that of the
/// others.
pub fn coefficients_at(friction: &JointFriction, state: ThermalState) -> [f64; FRICTION_COUNT] {
    coefficients_with(friction, thermal_multiplier(&friction.warm_up, state))
}

/// Like [`coefficients_at`], from [`thermal_multiplier`].
pub fn coefficients_with(friction: &JointFriction, multiplier: f64) -> [f64; FRICTION_COUNT] {
    let [f1, f2, f3, f4] = friction.warm;
    let coulomb = 1.0 + COULOMB_EXCESS * (multiplier - 1.0);
    [f1 * coulomb, f2 * multiplier, f3 * multiplier, f4 * multiplier]
}

/// Friction torque without ripple at the speed `qd`, signed as the motion, Nm.
///
/// `f1 (1 + s exp(-(qd/v_s)²)) tanh(qd/v_0) + f2 qd + f3 qd² sign(qd) + f4 qd³` after [3.10].
pub fn friction_torque(friction: &JointFriction, coefficients: &[f64; FRICTION_COUNT], qd: f64) -> f64 {
    friction_torque_at(friction, coefficients, qd, turned_at(friction, qd))
}

/// Share of the Coulomb friction that is present at the speed `qd`, -1 to 1, if it follows the speed alone.
pub fn turned_at(friction: &JointFriction, qd: f64) -> f64 {
    (qd / friction.sign_speed).tanh()
}

/// Like [`friction_torque`], with the share `turned` of the Coulomb friction, -1 to 1.
pub fn friction_torque_at(
    friction: &JointFriction,
    coefficients: &[f64; FRICTION_COUNT],
    qd: f64,
    turned: f64,
) -> f64 {
    let [f1, f2, f3, f4] = coefficients;
    let bump = 1.0 + friction.bump * (-(qd / friction.stribeck_speed).powi(2)).exp();
    f1 * bump * turned + f2 * qd + f3 * qd * qd.abs() + f4 * qd.powi(3)
}

/// Friction of a gear with losses that depend on direction and load. `lost`, Nm, is its friction without them while it
/// carries `carried`, Nm, at the speed `qd`, rad/s, with the share `turned` of its Coulomb friction.
pub fn with_direction_and_load(
    friction: &JointFriction,
    lost: f64,
    (carried, qd): (f64, f64),
    turned: f64,
) -> f64 {
    let of_load = friction.load * carried.abs() + friction.teeth.lost(carried, qd);
    lost * (1.0 + friction.direction * turned) + of_load * turned
}

/// Share of the Coulomb friction after a small travel `dq` at the speed `qd`, from the share `before` it: Dahl's
/// equation `dz/dq = (sign(qd) - z) / x`, solved over the travel.
pub fn turned_along(friction: &JointFriction, before: f64, dq: f64, qd: f64) -> f64 {
    if friction.presliding_travel <= 0.0 {
        return turned_at(friction, qd);
    }
    let end = if dq == 0.0 { before } else { dq.signum() };
    end + (before - end) * (-dq.abs() / friction.presliding_travel).exp()
}

/// Torque of the gear's ripple at the position `q` and speed `qd`, Nm; weaker at high speed.
pub fn ripple_torque(friction: &JointFriction, q: f64, qd: f64) -> f64 {
    let of = |amplitude: f64, wave_number: f64| {
        let frequency = wave_number * qd / (TAU * RIPPLE_CORNER_HZ);
        amplitude * (wave_number * q).sin() / (1.0 + frequency * frequency)
    };
    let more = friction.more_ripples.iter().chain([&friction.damage]).filter(|ripple| ripple.amplitude > 0.0);
    more.fold(of(friction.ripple, friction.ripple_wave_number), |sum, ripple| {
        sum + of(ripple.amplitude, ripple.wave_number)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_arms::er3a;

    fn first_joint(wear: f64) -> JointFriction {
        let robot = er3a();
        let wear = Wear { coefficients: [wear; FRICTION_COUNT], load: wear };
        joint_friction(&robot.joints[0], &robot.joints[0].nominal.unwrap(), (0.0, 0.0), &wear)
    }

    fn after(seconds: f64) -> ThermalState {
        ThermalState { seconds, ambient_offset_k: 0.0 }
    }

    #[test]
    fn friction_falls_while_the_arm_warms_and_ends_at_the_warm_value() {
        let friction = first_joint(0.0);
        let at = |s: f64| friction_torque(&friction, &coefficients_at(&friction, after(s)), 2.0);
        let torques: Vec<f64> = (0..30).map(|k| at(f64::from(k) * 240.0)).collect();
        assert!(torques.windows(2).all(|w| w[1] < w[0]), "{torques:?}");
        // 1 + 8 * 2 - 4 + 0.2 * 8 of the test arm; the bump has vanished at 2 rad/s.
        assert!((at(1e6) - 14.6).abs() < 1e-9, "{}", at(1e6));
        assert!((thermal_multiplier(&friction.warm_up, after(0.0)) - 1.6).abs() < 1e-15);
    }

    #[test]
    fn the_coulomb_part_shows_less_of_the_cold() {
        let friction = first_joint(0.0);
        let [f1, f2, ..] = coefficients_at(&friction, after(0.0));
        assert!((f1 - 1.18).abs() < 1e-12 && (f2 - 8.0 * 1.6).abs() < 1e-12);
    }

    #[test]
    fn wear_raises_friction_by_its_fraction() {
        let (healthy, worn) = (first_joint(0.0), first_joint(0.12));
        for qd in [-3.0, -0.1, 0.4, 3.5] {
            let of = |f: &JointFriction| friction_torque(f, &coefficients_at(f, after(300.0)), qd);
            assert!((of(&worn) / of(&healthy) - 1.12).abs() < 1e-12);
        }
    }

    #[test]
    fn friction_is_odd_smooth_at_zero_and_bumps_at_low_speed() {
        let friction = first_joint(0.0);
        let warm = friction.warm;
        let at = |qd: f64| friction_torque(&friction, &warm, qd);
        assert_eq!(at(0.0), 0.0);
        assert!((at(0.3) + at(-0.3)).abs() < 1e-12);
        let polynomial = |qd: f64| warm[0] + warm[1] * qd + warm[2] * qd * qd + warm[3] * qd.powi(3);
        assert!(at(0.03) > polynomial(0.03) + 0.05, "the bump is missing");
        assert!((at(2.0) - polynomial(2.0)).abs() < 1e-9);
    }

    #[test]
    fn a_polynomial_gearbox_is_the_polynomial_at_any_speed_and_time() {
        let friction = first_joint(0.0).polynomial();
        let [f1, f2, f3, f4] = friction.warm;
        for qd in [1e-4, 0.02, 0.5, 3.0] {
            let found = friction_torque(&friction, &coefficients_at(&friction, after(0.0)), qd);
            let expected = f1 + f2 * qd + f3 * qd * qd + f4 * qd.powi(3);
            assert!((found - expected).abs() < 1e-12, "{qd}: {found} {expected}");
            assert_eq!(ripple_torque(&friction, 0.3, qd), 0.0);
        }
        assert_eq!(friction_torque(&friction, &friction.warm, 0.0), 0.0);
    }

    #[test]
    fn presliding_friction_turns_over_along_the_travel_and_keeps_its_end() {
        let friction = first_joint(0.0).in_shape(FrictionShape::Presliding, false, 3.0);
        let travel = friction.presliding_travel;
        let half = turned_along(&friction, -1.0, travel * 2.0_f64.ln(), 0.1);
        assert!(half.abs() < 1e-12, "{half}");
        // in one step or in a thousand
        let (mut z, step) = (-1.0, 3.0 * travel / 1000.0);
        (0..1000).for_each(|_| z = turned_along(&friction, z, step, 0.1));
        assert!((z - turned_along(&friction, -1.0, 3.0 * travel, 0.1)).abs() < 1e-12);
        assert_eq!(turned_along(&friction, 0.3, 0.0, 0.0), 0.3, "a joint at rest keeps its torque");
    }

    #[test]
    fn shapes_differ_at_low_speed_and_agree_at_high_speed() {
        let at = |shape, qd: f64| {
            let friction = first_joint(0.0).in_shape(shape, true, 3.0);
            friction_torque(&friction, &friction.warm, qd)
        };
        let jump = at(FrictionShape::Sign, 0.01);
        assert!(at(FrictionShape::LateTurnOver, 0.01) < 0.3 * jump);
        assert!(
            at(FrictionShape::Smooth, 0.01) > 0.5 * jump && at(FrictionShape::Smooth, 0.01) < 0.99 * jump
        );
        assert!(at(FrictionShape::Stiction, 0.01) > 1.3 * jump);
        for shape in [FrictionShape::Smooth, FrictionShape::LateTurnOver, FrictionShape::Stiction] {
            assert!((at(shape, 2.5) / at(FrictionShape::Sign, 2.5) - 1.0).abs() < 1e-9, "{shape:?}");
        }
    }

    #[test]
    fn ripples_are_those_of_the_orders_that_are_asked_for() {
        let orders = [RippleOrder { order: 1.0, part: 0.1 }, RippleOrder { order: 4.0, part: 0.02 }];
        let friction = first_joint(0.0).with_ripples(&orders, 100.0);
        // the first joint's Coulomb friction is 1 Nm
        for q in [0.0_f64, 0.003, 0.0171] {
            let expected = 0.1 * (100.0 * q).sin() + 0.02 * (400.0 * q).sin();
            assert!((ripple_torque(&friction, q, 0.0) - expected).abs() < 1e-15);
        }
        assert_eq!(ripple_torque(&first_joint(0.0).with_ripples(&[], 100.0), 0.3, 0.1), 0.0);
    }

    #[test]
    fn damage_ripples_at_the_turn_of_the_motor() {
        let friction = first_joint(0.0).with_ripples(&[], 100.0).damaged(0.15, 100.0);
        for q in [0.0_f64, 0.003, 0.0171] {
            assert!((ripple_torque(&friction, q, 0.0) - 0.15 * (100.0 * q).sin()).abs() < 1e-15);
        }
    }

    #[test]
    fn friction_depends_on_direction_and_load_where_it_is_asked_for() {
        let plain = first_joint(0.0);
        let friction = JointFriction { direction: 0.1, load: 0.05, ..plain };
        let at = |lost: f64, turned: f64| with_direction_and_load(&friction, lost, (-40.0, turned), turned);
        assert!((at(2.0, 1.0) - (2.2 + 2.0)).abs() < 1e-12);
        assert!((at(-2.0, -1.0) - (-1.8 - 2.0)).abs() < 1e-12);
        assert_eq!(with_direction_and_load(&plain, 2.0, (-40.0, 1.0), 1.0), 2.0);
    }

    #[test]
    fn a_colder_room_adds_friction() {
        let friction = first_joint(0.0);
        let cold = ThermalState { seconds: 60.0, ambient_offset_k: -5.0 };
        assert!(
            thermal_multiplier(&friction.warm_up, cold) > thermal_multiplier(&friction.warm_up, after(60.0))
        );
    }

    #[test]
    fn no_time_constant_means_no_excess() {
        let shape = WarmUpShape { b: 0.5, t1: 0.0, c: 0.0, t2: 0.0 };
        assert_eq!(thermal_multiplier(&shape, after(0.0)), 1.0);
    }
}
