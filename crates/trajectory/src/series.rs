//! Finite Fourier series at evenly spaced instants of their period [4.19-4.21].
//!
//! With `w = 2 pi f` and `l = 1..N`, for each joint:
//!
//! ```text
//! q   = centre + sum a_l / (w l) sin(w l t) - b_l / (w l) cos(w l t)
//! qd  =          sum a_l         cos(w l t) + b_l         sin(w l t)
//! qdd =      w * sum l (b_l      cos(w l t) - a_l         sin(w l t))
//! ```
//!
//! The source prints the last line without the factor `l`; its own coefficients start without acceleration only with
//! it. A series starts and ends at rest if `sum a_l = 0`, and without acceleration if `sum l b_l = 0`.

use std::f64::consts::TAU;

use armwatch_method::lanes::{LANES, Lanes};
use armwatch_method::model::regressor_lanes::LaneStates;
use armwatch_model::robot::FourierExcitation;

/// Sines and cosines of all harmonics at evenly spaced instants of one period.
#[derive(Debug, Clone)]
pub struct Basis {
    base_frequency: f64,
    harmonics: usize,
    instants: usize,
    /// Sine and cosine for each group of [`LANES`] instants and harmonic.
    waves: Vec<[Lanes; 2]>,
}

impl Basis {
    /// A basis of `instants` instants from 0 on over one period of the base frequency, Hz.
    pub fn new(base_frequency: f64, harmonics: usize, instants: usize) -> Self {
        let angle = |k: usize, l: usize| TAU * ((k * l) % instants) as f64 / instants as f64;
        let waves = (0..instants.div_ceil(LANES))
            .flat_map(|group| (1..=harmonics).map(move |l| (group, l)))
            .map(|(group, l)| {
                // an instant beyond the last repeats the first
                let of = |wave: fn(f64) -> f64| {
                    Lanes(std::array::from_fn(|lane| wave(angle((group * LANES + lane) % instants, l))))
                };
                [of(f64::sin), of(f64::cos)]
            })
            .collect();
        Self { base_frequency, harmonics, instants, waves }
    }

    /// Harmonics `N`.
    pub fn harmonics(&self) -> usize {
        self.harmonics
    }

    /// Instants of a period.
    pub fn instants(&self) -> usize {
        self.instants
    }

    /// Base frequency, Hz.
    pub fn base_frequency(&self) -> f64 {
        self.base_frequency
    }

    /// Angular frequency of harmonic `l`, rad/s.
    pub fn angular_frequency(&self, l: usize) -> f64 {
        TAU * self.base_frequency * l as f64
    }

    /// Groups of [`LANES`] instants; the last may be incomplete.
    pub fn groups(&self) -> usize {
        self.instants.div_ceil(LANES)
    }

    /// 1 in each lane of a group that is an instant, 0 in those beyond the last.
    pub fn present(&self, group: usize) -> Lanes {
        Lanes(std::array::from_fn(|lane| f64::from(u8::from(group * LANES + lane < self.instants))))
    }

    /// Sine and cosine of harmonics 1 to `N` at a group's instants.
    pub fn waves(&self, group: usize) -> &[[Lanes; 2]] {
        &self.waves[group * self.harmonics..][..self.harmonics]
    }

    /// Positions, velocities and accelerations at a group's instants.
    ///
    /// # Panics
    /// If the series has other harmonics than the basis or more joints than
    /// [`MAX_JOINTS`](armwatch_model::robot::MAX_JOINTS).
    pub fn states(&self, series: &FourierExcitation, group: usize) -> LaneStates {
        let mut states = LaneStates::default();
        for (j, (a, b)) in series.a.iter().zip(&series.b).enumerate() {
            let (mut q, mut qd, mut qdd) = (Lanes::splat(series.centre[j]), Lanes::ZERO, Lanes::ZERO);
            for (l, &[sine, cosine]) in self.waves(group).iter().enumerate() {
                let w = self.angular_frequency(l + 1);
                let (a, b) = (a[l], b[l]);
                q += sine * (a / w) - cosine * (b / w);
                qd += cosine * a + sine * b;
                qdd += (cosine * b - sine * a) * w;
            }
            (states.q[j], states.qd[j], states.qdd[j]) = (q, qd, qdd);
        }
        states
    }
}

impl Basis {
    /// Jerk of one joint at a group's instants, rad/s³ (m/s³).
    pub fn jerk(&self, a: &[f64], b: &[f64], group: usize) -> Lanes {
        let mut jerk = Lanes::ZERO;
        for (l, &[sine, cosine]) in self.waves(group).iter().enumerate() {
            let squared = self.angular_frequency(l + 1).powi(2);
            jerk += (cosine * a[l] + sine * b[l]) * -squared;
        }
        jerk
    }
}

/// Jerk of a joint at the time `t`, s: `-w² sum l² (a_l cos(w l t) + b_l sin(w l t))`, rad/s³ (m/s³).
///
/// # Panics
/// If the series has no such joint.
pub fn jerk_at(series: &FourierExcitation, joint: usize, t: f64) -> f64 {
    let harmonics = (1..).zip(series.a[joint].iter().zip(&series.b[joint]));
    harmonics
        .map(|(l, (a, b)): (u32, _)| {
            let w = TAU * series.base_frequency * f64::from(l);
            let (sine, cosine) = (w * t).sin_cos();
            -w * w * (a * cosine + b * sine)
        })
        .sum()
}

/// Position, velocity and acceleration of all joints at the time `t`, s.
pub fn state_at(series: &FourierExcitation, t: f64) -> Vec<[f64; 3]> {
    let of_joint = |((a, b), centre): ((&Vec<f64>, &Vec<f64>), &f64)| {
        let mut state = [*centre, 0.0, 0.0];
        for (l, (a, b)) in (1..).zip(a.iter().zip(b)) {
            let w = TAU * series.base_frequency * f64::from(l);
            let (sine, cosine) = (w * t).sin_cos();
            state[0] += (a * sine - b * cosine) / w;
            state[1] += a * cosine + b * sine;
            state[2] += w * (b * cosine - a * sine);
        }
        state
    };
    series.a.iter().zip(&series.b).zip(&series.centre).map(of_joint).collect()
}

/// Upper bound of the largest magnitude of a series of `harmonics` harmonics, relative to that at `instants` evenly
/// spaced instants of its period: `1 / cos(pi N / M)` for `M > 2 N` (Ehlich & Zeller 1964, Schwankung von Polynomen
/// zwischen Gitterpunkten). Infinite if there are too few instants.
pub fn between_instants(harmonics: usize, instants: usize) -> f64 {
    if instants <= 2 * harmonics {
        return f64::INFINITY;
    }
    1.0 / (std::f64::consts::PI * harmonics as f64 / instants as f64).cos()
}

#[cfg(test)]
mod tests {
    use super::*;
    use armwatch_testing::er3a;

    /// Rounding of a few sums.
    const ROUNDING: f64 = 1e-12;
    /// Error of central differences over 1 ms of motions whose third derivatives are some hundred rad/s³.
    const DIFFERENCES: f64 = 1e-4;

    #[test]
    fn velocities_and_accelerations_are_derivatives_and_lanes_are_instants() {
        let series = er3a().excitation.expect("Table 4.1");
        let basis = Basis::new(series.base_frequency, 5, 250);
        for (group, lane) in [(0, 0), (17, 3), (62, 1)] {
            let t = (group * LANES + lane) as f64 / 25.0;
            let states = basis.states(&series, group);
            let (before, at, after) =
                (state_at(&series, t - 1e-3), state_at(&series, t), state_at(&series, t + 1e-3));
            for j in 0..6 {
                let found = [states.q[j].0[lane], states.qd[j].0[lane], states.qdd[j].0[lane]];
                for k in 0..3 {
                    assert!((found[k] - at[j][k]).abs() < ROUNDING * 100.0, "{group} {j} {k}");
                }
                let jerk = jerk_at(&series, j, t);
                let lanes = basis.jerk(&series.a[j], &series.b[j], group);
                assert!((lanes.0[lane] - jerk).abs() < ROUNDING * 1e3, "{group} {j}");
                for k in 0..3 {
                    let slope = (after[j][k] - before[j][k]) / 2e-3;
                    let derivative = if k < 2 { at[j][k + 1] } else { jerk };
                    assert!((slope - derivative).abs() < DIFFERENCES, "{slope} {derivative}");
                }
            }
        }
        assert_eq!(basis.groups(), 63);
        assert_eq!(basis.present(62).0, [1.0, 1.0, 0.0, 0.0]);
    }

    /// A single harmonic whose crest is midway between two of its instants reaches the bound.
    #[test]
    fn a_crest_between_instants_is_within_the_bound_and_can_reach_it() {
        let instants = 12;
        for harmonics in 1..=5 {
            let phase = std::f64::consts::PI * harmonics as f64 / f64::from(instants);
            let wave = |k: f64| (TAU * harmonics as f64 * k / f64::from(instants) - phase).cos();
            let largest = (0..instants).map(|k| wave(f64::from(k)).abs()).fold(0.0, f64::max);
            assert!(largest * between_instants(harmonics, instants as usize) >= 1.0 - ROUNDING);
        }
        let phase = std::f64::consts::PI / 12.0;
        assert!((phase.cos() * between_instants(1, 12) - 1.0).abs() < ROUNDING);
        assert!(between_instants(6, 12).is_infinite());
    }
}
