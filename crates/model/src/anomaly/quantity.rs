//! Quantities of anomalies: the only list of their names, units, labels and forms.

use std::fmt;

use serde::Serialize;

use self::FaultDirection::{Either, NoValue, Rise};
use self::Form::{Fraction, Number, Ratio, StandardErrors, Times, TimesOfLogarithm, WithUnit};
use crate::run::RunKind::{self, Production, Test};

/// Declares the quantities, one per row: variant, name, unit of its values, history, direction, form of values, form of
/// scores and limits, label.
macro_rules! quantities {
    ($($variant:ident $name:literal $unit:expr, $history:ident $direction:ident $value:ident $score:ident $label:literal;)*) => {
        /// The quantity that an anomaly is about.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub enum Quantity {
            $(#[doc = $label] $variant,)*
        }

        impl Quantity {
            /// All quantities.
            pub const ALL: [Self; [$($name),*].len()] = [$(Self::$variant,)*];

            const fn facts(self) -> QuantityFacts {
                match self {
                    $(Self::$variant => QuantityFacts {
                        name: $name,
                        unit: $unit,
                        history: $history,
                        direction: $direction,
                        value: $value,
                        score: $score,
                        label: $label,
                    },)*
                }
            }
        }
    };
}

const NONE: Option<&str> = None;
const ONE: Option<&str> = Some("1");
const NM: Option<&str> = Some("Nm");
const KG: Option<&str> = Some("kg");
// of a revolute joint, and of a prismatic one
const RAD: Option<&str> = Some("rad (m)");

quantities! {
    FrictionIndex "friction_index" ONE, Test Either Ratio Fraction "friction index";
    FrictionJumpRatio "friction_jump_ratio" ONE, Test Either Ratio Fraction "friction after a jump, relative to before";
    CommonFrictionRatio "common_friction_ratio" ONE, Test Either Ratio Fraction "friction common to all joints, relative to the baseline";
    WarmFriction "warm_friction_nm" NM, Test Either WithUnit Fraction "warm friction";
    ExcitationFriction "excitation_friction_nm" NM, Test Either WithUnit Fraction "friction of the excitation";
    FrictionSwing "friction_swing" ONE, Test Rise Fraction Fraction "swing of friction from cycle to cycle";
    WarmUpTimeRatio "warm_up_time_ratio" ONE, Test Either Times TimesOfLogarithm "warm-up time, relative to the baseline";
    CommonWarmUpTimeRatio "common_warm_up_time_ratio" ONE, Test Either Times TimesOfLogarithm "warm-up time common to all joints, relative to the baseline";
    MovingRelativeRmsd "moving_relative_rmsd" ONE, Test Rise Fraction Fraction "relative RMSD, moving";
    FrictionOfModel "friction_of_model_nm" NM, Test Either WithUnit TimesOfLogarithm "friction compared with other arms";
    RmsdOfModel "rmsd_of_model" ONE, Test Rise Fraction TimesOfLogarithm "RMSD compared with other arms";
    Load "load_kg" KG, Test Either WithUnit StandardErrors "load";
    TorqueOffset "torque_offset_nm" NM, Test Either WithUnit WithUnit "offset of the torque signal";
    TorqueNoiseRatio "torque_noise_ratio" ONE, Test Rise Times Times "noise of the torque signal, relative to the baseline";
    TorqueGainRatio "torque_gain_ratio" ONE, Test Either Times Fraction "gain of the torque signal, relative to the baseline";
    PositionOffset "position_offset_rad" RAD, Test Either WithUnit WithUnit "position offset";
    UnexplainedTorque "unexplained_torque" ONE, Test Rise Times Times "torque that the model leaves unexplained, relative to the baseline";
    InertialParameters "inertial_parameters" NONE, Test NoValue Number Number "inertial parameters";
    ArmIdentity "arm_identity" NONE, Test NoValue Number Number "identity of the arm";
    Contact "contact" ONE, Test Rise Fraction Times "relative RMSD of one cycle, compared with its neighbours";
    TorqueSignal "torque_signal" NONE, Test NoValue Number Number "torque signal";
    PositionSignal "position_signal" NONE, Test NoValue Number Number "position signal";
    VelocitySignal "velocity_signal" NONE, Test NoValue Number Number "velocity signal";
    TimeStamps "time_stamps" NONE, Test NoValue Number Number "time stamps";
    Rows "rows" NONE, Test NoValue Number Number "rows of the export";
    Motion "motion" NONE, Test NoValue Number Number "motion of the test";
    Model "model" NONE, Test NoValue Number Number "model of the arm";
    ImplausibleDate "implausible_date" NONE, Test NoValue Number Number "date of a recording";
    ProductionFriction "production_friction" ONE, Production Either Times Fraction "friction in production, relative to the test";
    ProductionRelativeRmsd "production_relative_rmsd" ONE, Production Rise Fraction Fraction "relative RMSD in production";
    ProductionTorqueOffset "production_torque_offset_nm" NM, Production Either WithUnit WithUnit "offset of the torque signal in production";
    ProductionTorqueGainRatio "production_torque_gain_ratio" ONE, Production Either Times Fraction "gain of the torque signal in production, relative to the test";
    ProductionLoad "production_load_kg" KG, Production Either WithUnit StandardErrors "load in production";
}

/// Quantities that may replace one another in the episodes of one cause: the measurement of friction depends on the
/// test, and several quantities may show a wrong signal.
const OF_ONE_CAUSE: [&[Quantity]; 3] = [
    &[
        Quantity::FrictionIndex,
        Quantity::FrictionJumpRatio,
        Quantity::WarmFriction,
        Quantity::ExcitationFriction,
    ],
    &[Quantity::TorqueSignal, Quantity::TorqueOffset, Quantity::TorqueNoiseRatio, Quantity::TorqueGainRatio],
    &[Quantity::ProductionTorqueOffset, Quantity::ProductionTorqueGainRatio],
];

struct QuantityFacts {
    name: &'static str,
    unit: Option<&'static str>,
    history: RunKind,
    direction: FaultDirection,
    value: Form,
    score: Form,
    label: &'static str,
}

impl Quantity {
    /// Name as in the view `anomalies`.
    #[must_use]
    pub const fn name(self) -> &'static str {
        self.facts().name
    }

    /// Unit of `value`, `baseline` and `peak_value`, `"1"` for a ratio; `None` if the quantity has no values.
    #[must_use]
    pub const fn unit(self) -> Option<&'static str> {
        self.facts().unit
    }

    /// Label for people, which follows "the".
    #[must_use]
    pub const fn label(self) -> &'static str {
        self.facts().label
    }

    /// Its history: tests or production.
    #[must_use]
    pub const fn history(self) -> RunKind {
        self.facts().history
    }

    /// Change of the value that is a fault.
    #[must_use]
    pub const fn direction(self) -> FaultDirection {
        self.facts().direction
    }

    /// Form of its values for people.
    #[must_use]
    pub const fn value_form(self) -> Form {
        self.facts().value
    }

    /// Form of its scores and limits for people.
    #[must_use]
    pub const fn score_form(self) -> Form {
        self.facts().score
    }

    /// The quantity of this name; `None` if there is none.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|known| known.name() == name)
    }

    /// Returns true if an episode of this quantity may continue with the other one.
    #[must_use]
    pub fn is_of_one_cause(self, other: Self) -> bool {
        self == other || OF_ONE_CAUSE.iter().any(|group| group.contains(&self) && group.contains(&other))
    }
}

impl fmt::Display for Quantity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

crate::serialize_by_name!(Quantity);
crate::deserialize_by_name!(Quantity);

/// Change of a value that is a fault.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum FaultDirection {
    /// Only a rise.
    Rise,
    /// A rise or a fall.
    Either,
    /// The quantity has no values.
    NoValue,
}

impl FaultDirection {
    /// The change in words.
    #[must_use]
    pub const fn words(self) -> &'static str {
        match self {
            Self::Rise => "rise",
            Self::Either => "rise or fall",
            Self::NoValue => "-",
        }
    }
}

/// Form of a value for people.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Form {
    /// A number without unit.
    Number,
    /// A multiple of the baseline, near 1.
    Ratio,
    /// A fraction, in percent.
    Fraction,
    /// A multiple, followed by "times".
    Times,
    /// The logarithm of such a multiple.
    TimesOfLogarithm,
    /// A multiple of the standard error.
    StandardErrors,
    /// A number and the unit of the quantity.
    WithUnit,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_say_unit_and_history() {
        for of in Quantity::ALL {
            let unit = match of.name().rsplit_once('_') {
                Some((_, "nm")) => NM,
                Some((_, "kg")) => KG,
                Some((_, "rad")) => RAD,
                _ => of.unit().map(|_| "1"),
            };
            assert_eq!(of.unit(), unit, "{of}");
            assert_eq!(of.history() == Production, of.name().starts_with("production_"), "{of}");
            assert_eq!(of.unit().is_none(), of.direction() == NoValue, "{of}");
            assert_eq!(Quantity::from_name(of.name()), Some(of));
        }
    }

    #[test]
    fn only_quantities_of_one_history_and_one_cause_replace_one_another() {
        use Quantity::{
            ProductionTorqueOffset, TorqueGainRatio, TorqueNoiseRatio, TorqueOffset, WarmFriction,
        };
        assert!(TorqueOffset.is_of_one_cause(TorqueNoiseRatio));
        assert!(WarmFriction.is_of_one_cause(Quantity::FrictionIndex));
        assert!(!TorqueGainRatio.is_of_one_cause(WarmFriction));
        assert!(!TorqueOffset.is_of_one_cause(ProductionTorqueOffset));
    }
}
