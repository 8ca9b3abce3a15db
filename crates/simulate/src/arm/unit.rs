//! Individual arms of one model, and their differences within a fleet.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

use armwatch_model::robot::{Robot, StandardParameters};

/// Stream of the random values of an individual arm: far from those of its runs.
const STREAM: u64 = 1 << 43;

/// Spread of arms of one model: standard deviations of logarithms, so that 0.1 is about 10 %.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct UnitSpread {
    /// Spread of friction, its growth in the cold and the noise of torque signals, independent for each joint. The two
    /// arms of the source differ by half in the viscous friction of joint 1.
    pub friction: f64,
    /// Spread of mass, first moments and inertia of each link together, and of motor inertia: castings and cables.
    pub bodies: f64,
}

impl UnitSpread {
    /// Returns true if all arms are alike.
    pub fn is_none(&self) -> bool {
        self.friction <= 0.0 && self.bodies <= 0.0
    }
}

/// The individual arm of `model` for `seed`.
pub fn unit(model: &Robot, seed: u64, spread: &UnitSpread) -> Robot {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(STREAM);
    let mut factor = |spread: f64| (spread * rng.sample::<f64, _>(StandardNormal)).exp();
    let mut arm = model.clone();
    for nominal in arm.joints.iter_mut().filter_map(|joint| joint.nominal.as_mut()) {
        // one factor for all ten keeps them physically consistent
        let body = factor(spread.bodies);
        nominal.inertial = StandardParameters(nominal.inertial.0.map(|of| of * body));
        nominal.motor_inertia *= factor(spread.bodies);
        let [coulomb, viscous, cold, slow] = [(); 4].map(|()| factor(spread.friction));
        let [f1, f2, f3, f4] = nominal.friction;
        // f3 and f4 bend the viscous part and are scaled with it
        nominal.friction = [f1 * coulomb, f2 * viscous, f3 * viscous, f4 * viscous];
        nominal.warm_up.b *= cold;
        nominal.warm_up.c *= cold;
        nominal.warm_up.t1 *= slow;
        nominal.warm_up.t2 *= slow;
        nominal.torque_noise *= factor(spread.friction);
    }
    arm
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_arms::er3a;

    #[test]
    fn units_differ_by_the_stated_spread_and_a_seed_gives_one_unit() {
        let model = er3a();
        let spread = UnitSpread { friction: 0.2, bodies: 0.02 };
        assert_eq!(unit(&model, 5, &spread), unit(&model, 5, &spread));
        assert_eq!(unit(&model, 5, &UnitSpread::default()), model);
        let mut logarithms = [Vec::new(), Vec::new()];
        for seed in 0..100 {
            let arm = unit(&model, seed, &spread);
            for (own, of) in arm.joints.iter().zip(&model.joints) {
                let (own, of) = (own.nominal.unwrap(), of.nominal.unwrap());
                logarithms[0].push((own.friction[1] / of.friction[1]).ln());
                logarithms[1].push((own.inertial.0[0] / of.inertial.0[0]).ln());
            }
        }
        for (values, expected) in logarithms.iter().zip([0.2, 0.02]) {
            let count = values.len() as f64;
            let mean = values.iter().sum::<f64>() / count;
            let std = (values.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / count).sqrt();
            // with 600 values the standard deviation is known to 3 %
            assert!((std / expected - 1.0).abs() < 0.12 && mean.abs() < 0.15 * expected, "{mean} {std}");
        }
    }
}
