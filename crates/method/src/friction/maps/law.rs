//! Parameters of the law of warming and cooling of a gear: names, priors and bounds.

use super::thermal_state::{Rates, ThermalDeficit};

/// Prior of the parameters without a sensor and with an ambient temperature.
///
/// Six gearboxes of thesis Table 5.6 have slow time constants of 13 to 57 min, geometric mean 27, and fast ones of 0.3
/// to 7.4 min, geometric mean 1.6. A housing at rest loses heat at about the rate of a moving one; the wind of motion
/// and the losses of the motor change that rate. Only the magnitude of the ambient temperature's effect is known:
/// gearboxes warm by 10 to 40 K, which is a thermal deficit of one.
pub(super) const PRIOR: LawParameters<LawPrior> = LawParameters {
    slow: LawPrior { mean: 7.39, deviation: 0.9 },
    fast: LawPrior { mean: 4.56, deviation: 1.4 },
    share: LawPrior { mean: 0.5, deviation: 0.5 },
    cooling: LawPrior { mean: 0.0, deviation: 1.0 },
    sensor: LawPrior { mean: 0.0, deviation: 0.1 },
};

/// Bounds for [`PRIOR`]: slow time constant of half a minute to ten hours, fast one of two seconds to an hour, any
/// share, cooling five times faster to twenty times slower than warming, and a thermal deficit of one for 2 K or more
/// of ambient temperature, of either sign.
pub(super) const BOUNDS: LawParameters<Bounds> = LawParameters {
    slow: Bounds { low: 3.4, high: 10.5 },
    fast: Bounds { low: 0.7, high: 8.2 },
    share: Bounds { low: 0.0, high: 1.0 },
    cooling: Bounds { low: -1.6, high: 3.0 },
    sensor: Bounds { low: -0.5, high: 0.5 },
};

/// Prior of the parameters if the motor's temperature gives the slow part.
///
/// The fast part is then the temperature difference between winding, housing and teeth, which lasts some minutes. A
/// share above one makes its weight negative: the motor warms by its own losses before the gears. Viscosity falls
/// exponentially, by 1 to 3 % per kelvin over about 25 K, which gives the curvature.
pub(super) const MOTOR_PRIOR: LawParameters<LawPrior> = LawParameters {
    fast: LawPrior { mean: 5.3, deviation: 0.7 },
    share: LawPrior { mean: 1.0, deviation: 0.3 },
    sensor: LawPrior { mean: 0.5, deviation: 0.3 },
    ..PRIOR
};

/// Bounds for [`MOTOR_PRIOR`]: a fast part of two minutes to half an hour, with a weight of at most a half. Plateaus
/// begin a minute after the start of a cycle and do not resolve a faster one.
pub(super) const MOTOR_BOUNDS: LawParameters<Bounds> = LawParameters {
    fast: Bounds { low: 4.8, high: 7.5 },
    share: Bounds { low: 0.5, high: 2.5 },
    sensor: Bounds { low: 0.0, high: 2.0 },
    ..BOUNDS
};

/// Second start of the search with a motor's temperature: within a quarter of an hour, the motor warms by half as much
/// as its gear.
pub(super) const MOTOR_AHEAD: LawParameters =
    LawParameters { slow: PRIOR.slow.mean, fast: 6.8, share: 1.4, cooling: PRIOR.cooling.mean, sensor: 0.5 };

/// Items for each parameter of the fitted thermal law; by default, its value.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::friction) struct LawParameters<T = f64> {
    /// Logarithm of the slow part's time constant in motion, in s.
    pub slow: T,
    /// Logarithm of the fast part's time constant in motion, in s.
    pub fast: T,
    /// Share of the slow part in the mixed thermal deficit, without unit.
    pub share: T,
    /// Logarithm of the cooling ratio: time constants at rest as a multiple of those in motion.
    pub cooling: T,
    /// Parameter of the [`ThermalSensor`](super::record::ThermalSensor): for an ambient temperature, thermal deficit
    /// per kelvin below the usual one, 1/K; for a motor's temperature, curvature of the deficit over it, without unit.
    /// Not used without a sensor.
    pub sensor: T,
}

/// Name of a parameter of [`LawParameters`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::friction) enum LawParameter {
    Slow,
    Fast,
    Share,
    Cooling,
    Sensor,
}

impl LawParameter {
    /// All parameters in the order of the covariance of a map.
    pub(in crate::friction) const ALL: [Self; 5] =
        [Self::Slow, Self::Fast, Self::Share, Self::Cooling, Self::Sensor];

    /// Remark on a parameter whose error is mainly that of its prior; `None` for a parameter without a remark.
    pub(super) fn assumed(self) -> Option<&'static str> {
        match self {
            Self::Slow => {
                Some("slow time constant is assumed: the runs are too short for it, or all began warm")
            }
            Self::Fast => Some("fast time constant is assumed: the first cycles do not resolve it"),
            Self::Share => Some("share of the slow part is assumed: the warm-up does not show two parts"),
            Self::Cooling => Some("cooling is assumed to be as warming: no run began between warm and cold"),
            Self::Sensor => None,
        }
    }
}

impl<T: Copy> LawParameters<T> {
    /// Item of one parameter.
    pub(in crate::friction) fn get(&self, parameter: LawParameter) -> T {
        match parameter {
            LawParameter::Slow => self.slow,
            LawParameter::Fast => self.fast,
            LawParameter::Share => self.share,
            LawParameter::Cooling => self.cooling,
            LawParameter::Sensor => self.sensor,
        }
    }

    /// Replaces the item of one parameter.
    pub(in crate::friction) fn with(mut self, parameter: LawParameter, item: T) -> Self {
        match parameter {
            LawParameter::Slow => self.slow = item,
            LawParameter::Fast => self.fast = item,
            LawParameter::Share => self.share = item,
            LawParameter::Cooling => self.cooling = item,
            LawParameter::Sensor => self.sensor = item,
        }
        self
    }

    /// Applies `of` to the item of each parameter.
    pub(in crate::friction) fn map<U>(self, of: impl Fn(T) -> U) -> LawParameters<U> {
        LawParameters {
            slow: of(self.slow),
            fast: of(self.fast),
            share: of(self.share),
            cooling: of(self.cooling),
            sensor: of(self.sensor),
        }
    }
}

impl LawParameters {
    /// Time constants of the law.
    pub(super) fn rates(&self) -> Rates {
        Rates { heating: [self.slow.exp(), self.fast.exp()], cooling_ratio: self.cooling.exp() }
    }

    /// Parameters at the same distance beyond these as these are beyond `before`: `2 self - before`.
    pub(in crate::friction) fn beyond(&self, before: &Self) -> Self {
        LawParameter::ALL.into_iter().fold(*self, |law, k| law.with(k, 2.0 * self.get(k) - before.get(k)))
    }

    /// Thermal deficit that friction depends on: `share x_slow + (1 - share) x_fast`.
    pub(in crate::friction) fn mixed(&self, x: ThermalDeficit) -> f64 {
        self.share * x[0] + (1.0 - self.share) * x[1]
    }
}

/// Normal prior of a parameter, in the parameter's unit.
#[derive(Debug, Clone, Copy)]
pub(super) struct LawPrior {
    pub(in crate::friction) mean: f64,
    pub(in crate::friction) deviation: f64,
}

/// Values that the search allows for a parameter, ends included.
#[derive(Debug, Clone, Copy)]
pub(super) struct Bounds {
    pub(in crate::friction) low: f64,
    pub(in crate::friction) high: f64,
}

impl Bounds {
    pub(super) fn contain(self, value: f64) -> bool {
        (self.low..=self.high).contains(&value)
    }
}
