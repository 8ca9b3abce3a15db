//! Friction of other shapes than the description's law, which must not explain the evidence for a doubt about geometry,
//! units or time.
//!
//! Friction that changes sign late after a reversal resembles a delayed torque, and friction that changes sign smoothly
//! resembles a wrong length. Each joint gets columns that depend only on the motion of this joint, so they cannot
//! represent gravity or inertia: smooth signs, a bump at low speed (Stribeck 1902) and the bristle that bends before a
//! surface slips (Dahl 1968), which is late by a distance.

use crate::signal::filter::FilteredSignals;

/// Speeds of the change of a smooth sign, and of the bump, relative to the joint's RMS speed.
const SMOOTH: [f64; 2] = [0.05, 0.3];
const BUMP: f64 = 0.15;
/// Distances of the change of friction's sign after a reversal, relative to the joint's range of motion; the smallest
/// is that of a stiff gearbox, minutes of arc.
const BRISTLE: [f64; 3] = [0.001, 0.006, 0.04];

/// Number of columns per joint.
pub const SHAPES: usize = SMOOTH.len() + 1 + BRISTLE.len() + 1;

/// Torques of unit friction of each shape, low-passed like the torque, `[n][SHAPES][rows]`; the last is a constant.
#[must_use]
pub fn friction_shapes(filtered: &FilteredSignals) -> Vec<Vec<Vec<f64>>> {
    (0..filtered.joint_count()).map(|joint| of_joint(filtered, joint)).collect()
}

fn of_joint(filtered: &FilteredSignals, joint: usize) -> Vec<Vec<f64>> {
    let (q, qd) = (&filtered.q[joint], &filtered.qd[joint]);
    let usable = || filtered.usable.iter().flat_map(Clone::clone);
    let square = usable().map(|row| qd[row] * qd[row]).sum::<f64>();
    let speed = (square / usable().count().max(1) as f64).sqrt().max(f64::MIN_POSITIVE);
    let bounds = |[low, high]: [f64; 2], row: usize| [low.min(q[row]), high.max(q[row])];
    let [low, high] = usable().fold([f64::INFINITY, f64::NEG_INFINITY], bounds);
    let by_speed = |shape: &dyn Fn(f64) -> f64| -> Vec<f64> { qd.iter().map(|v| shape(v / speed)).collect() };
    let mut shapes: Vec<Vec<f64>> = SMOOTH.iter().map(|turn| by_speed(&|v| (v / turn).tanh())).collect();
    shapes.push(by_speed(&|v| v.signum() * (-(v / BUMP).powi(2)).exp()));
    shapes.extend(BRISTLE.map(|part| bristle(q, part * (high - low).max(f64::MIN_POSITIVE))));
    let mut shapes = filtered.low_passed(&shapes);
    shapes.push(vec![1.0; q.len()]);
    shapes
}

/// Deflection of a bristle relative to its largest, over positions `q`: `dz/dq = (1 - z sign(dq)) / distance`.
fn bristle(q: &[f64], distance: f64) -> Vec<f64> {
    let mut z = 0.0;
    let mut before = q.first().copied().unwrap_or(0.0);
    q.iter()
        .map(|&now| {
            let step = now - before;
            before = now;
            if step != 0.0 {
                z = step.signum() + (z - step.signum()) * (-step.abs() / distance).exp();
            }
            z
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bristle_turns_over_within_its_distance_whatever_the_steps() {
        let path = |step: f64| -> Vec<f64> {
            let up = (0..).map(|k| step * f64::from(k)).take_while(|x| *x <= 1.0 + 1e-9);
            let down = (1..).map(|k| 1.0 - step * f64::from(k)).take_while(|x| *x >= 0.9 - 1e-9);
            up.chain(down).collect()
        };
        let ends = [0.05, 0.01].map(|step| bristle(&path(step), 0.1));
        // one distance after the reversal, 2/e of the change remains
        let exact = -1.0 + 2.0 * (-1.0_f64).exp();
        for z in &ends {
            assert!((z[z.len() - 1] - exact).abs() < 1e-4, "{}", z[z.len() - 1]);
        }
        assert!(ends[0].iter().all(|z| z.abs() < 1.0));
    }
}
