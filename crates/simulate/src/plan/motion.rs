//! Pieces of motion: position, velocity and acceleration in closed form, acceleration continuous.

use std::f64::consts::{PI, TAU};

use armwatch_model::robot::{FourierExcitation, MAX_JOINTS};

/// One value per joint; zero beyond the arm's joints.
pub type PerJoint = [f64; MAX_JOINTS];

/// Position, velocity and acceleration of every joint at one moment: rad, rad/s, rad/s².
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct MotionState {
    /// Positions.
    pub position: PerJoint,
    /// Velocities.
    pub velocity: PerJoint,
    /// Accelerations.
    pub acceleration: PerJoint,
}

impl MotionState {
    /// At rest in a posture.
    pub fn at_rest(posture: PerJoint) -> Self {
        Self { position: posture, ..Self::default() }
    }

    fn set(&mut self, joint: usize, [q, qd, qdd]: [f64; 3]) {
        self.position[joint] = q;
        self.velocity[joint] = qd;
        self.acceleration[joint] = qdd;
    }
}

/// A piece of motion of all joints; its time runs from 0.
#[derive(Debug, Clone, PartialEq)]
pub enum MotionPiece {
    /// At rest.
    Hold(PerJoint),
    /// Polynomials of fifth degree, `[n][6]`, lowest power first.
    Quintic(Vec<[f64; 6]>),
    /// Finite Fourier series [4.19-4.21].
    Fourier(FourierExcitation),
    /// Each joint back and forth independently, in cycloids [4.22-4.24].
    Shuttle(Vec<Shuttle>),
    /// One joint back and forth through plateaus of constant speed, the others still.
    Plateaus(Plateaus),
}

/// Motion of one joint back and forth in cycloids.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shuttle {
    /// Start position of the joint, rad.
    pub start: f64,
    /// Travel of each stroke, rad.
    pub travel: f64,
    /// Duration of one stroke, s.
    pub stroke_s: f64,
    /// Number of strokes, even, so that the joint returns to its start.
    pub strokes: u32,
}

/// Motion of one joint back and forth through plateaus, from a posture and back to it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Plateaus {
    /// Posture at the start; the other joints hold it.
    pub posture: PerJoint,
    /// The joint that moves, from 0.
    pub joint: usize,
    /// One stroke.
    pub stroke: Stroke,
    /// Number of strokes, even.
    pub strokes: u32,
}

/// From rest over a ramp to constant speed and over a ramp to rest. The ramp's acceleration is a trapezoid over time,
/// so that the acceleration is continuous.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stroke {
    /// Speed of the plateau, rad/s.
    pub speed: f64,
    /// Duration of each ramp, s.
    pub ramp_s: f64,
    /// Duration of the plateau, s.
    pub plateau_s: f64,
}

/// Fraction of a ramp for the increase of its acceleration, and likewise for the decrease.
pub const RAMP_EDGE: f64 = 0.1;

impl Stroke {
    /// Duration of the whole stroke, s.
    pub fn duration(&self) -> f64 {
        self.plateau_s + 2.0 * self.ramp_s
    }

    /// Length of the whole stroke, rad.
    pub fn travel(&self) -> f64 {
        self.speed * (self.plateau_s + self.ramp_s)
    }

    /// Largest acceleration, rad/s².
    pub fn peak_acceleration(&self) -> f64 {
        self.speed / (self.ramp_s * (1.0 - RAMP_EDGE))
    }

    fn at(&self, t: f64) -> [f64; 3] {
        let end = self.ramp_s + self.plateau_s;
        if t < self.ramp_s {
            self.ramp(t)
        } else if t <= end {
            [self.speed * (0.5 * self.ramp_s + t - self.ramp_s), self.speed, 0.0]
        } else {
            let [q, qd, qdd] = self.ramp((self.duration() - t).max(0.0));
            [self.travel() - q, qd, -qdd]
        }
    }

    /// The rising ramp; its second half mirrors the first.
    fn ramp(&self, t: f64) -> [f64; 3] {
        let edge = RAMP_EDGE * self.ramp_s;
        let peak = self.peak_acceleration();
        if t < edge {
            [peak * t.powi(3) / (6.0 * edge), peak * t * t / (2.0 * edge), peak * t / edge]
        } else if t <= self.ramp_s - edge {
            let s = t - edge;
            [peak * (edge * edge / 6.0 + 0.5 * edge * s + 0.5 * s * s), peak * (0.5 * edge + s), peak]
        } else {
            let rest = self.ramp_s - t;
            let [q, qd, qdd] =
                [peak * rest.powi(3) / (6.0 * edge), peak * rest * rest / (2.0 * edge), peak * rest / edge];
            [0.5 * self.speed * self.ramp_s - (self.speed * rest - q), self.speed - qd, qdd]
        }
    }
}

impl Plateaus {
    /// Duration of all strokes, s.
    pub fn duration(&self) -> f64 {
        f64::from(self.strokes) * self.stroke.duration()
    }

    /// Direction of motion at time `t` if the joint moves at constant speed then.
    pub fn plateau_direction(&self, t: f64) -> Option<i8> {
        let (way, within) = way_and_time(t, self.stroke.duration(), self.strokes)?;
        let plateau = self.stroke.ramp_s..=self.stroke.ramp_s + self.stroke.plateau_s;
        plateau.contains(&within).then_some(if way.is_multiple_of(2) { 1 } else { -1 })
    }
}

/// State at time `t` since the start of the piece, s.
pub fn state_at(motion: &MotionPiece, t: f64) -> MotionState {
    let mut state = MotionState::default();
    match motion {
        MotionPiece::Hold(posture) => state.position = *posture,
        MotionPiece::Quintic(polynomials) => {
            for (j, c) in polynomials.iter().enumerate() {
                state.set(j, polynomial(c, t));
            }
        }
        MotionPiece::Fourier(series) => fourier(series, t, &mut state),
        MotionPiece::Shuttle(shuttles) => {
            for (j, shuttle) in shuttles.iter().enumerate() {
                state.set(j, shuttle_at(shuttle, t));
            }
        }
        MotionPiece::Plateaus(plateaus) => {
            state.position = plateaus.posture;
            let stroke = &plateaus.stroke;
            if let Some((way, within)) = way_and_time(t, stroke.duration(), plateaus.strokes) {
                let start = plateaus.posture[plateaus.joint];
                state.set(plateaus.joint, out_or_back(start, stroke.travel(), way, stroke.at(within)));
            }
        }
    }
    state
}

/// Polynomial motion of `duration` seconds that joins two states with all derivatives.
pub fn quintic(from: &MotionState, to: &MotionState, joint_count: usize, duration: f64) -> MotionPiece {
    let t = duration;
    let polynomials = (0..joint_count)
        .map(|j| {
            let (p0, v0, a0) = (from.position[j], from.velocity[j], from.acceleration[j]);
            let gap = to.position[j] - p0 - v0 * t - 0.5 * a0 * t * t;
            let speed_gap = (to.velocity[j] - v0 - a0 * t) * t;
            let acceleration_gap = (to.acceleration[j] - a0) * t * t;
            [
                p0,
                v0,
                0.5 * a0,
                (10.0 * gap - 4.0 * speed_gap + 0.5 * acceleration_gap) / t.powi(3),
                (-15.0 * gap + 7.0 * speed_gap - acceleration_gap) / t.powi(4),
                (6.0 * gap - 3.0 * speed_gap + 0.5 * acceleration_gap) / t.powi(5),
            ]
        })
        .collect();
    MotionPiece::Quintic(polynomials)
}

fn polynomial(c: &[f64; 6], t: f64) -> [f64; 3] {
    [
        c[0] + t * (c[1] + t * (c[2] + t * (c[3] + t * (c[4] + t * c[5])))),
        c[1] + t * (2.0 * c[2] + t * (3.0 * c[3] + t * (4.0 * c[4] + t * 5.0 * c[5]))),
        2.0 * c[2] + t * (6.0 * c[3] + t * (12.0 * c[4] + t * 20.0 * c[5])),
    ]
}

/// [4.19], [4.20] and [4.21], the last with the factor `l` that is missing in print.
fn fourier(series: &FourierExcitation, t: f64, state: &mut MotionState) {
    let base = TAU * series.base_frequency;
    for (j, centre) in series.centre.iter().enumerate() {
        state.position[j] = *centre;
    }
    let harmonics = series.a.first().map_or(0, Vec::len);
    for l in 0..harmonics {
        let w = base * (l + 1) as f64;
        let (sin, cos) = (w * t).sin_cos();
        for (j, (a, b)) in series.a.iter().zip(&series.b).enumerate() {
            let (a, b) = (a[l], b[l]);
            state.position[j] += (a * sin - b * cos) / w;
            state.velocity[j] += a * cos + b * sin;
            state.acceleration[j] += w * (b * cos - a * sin);
        }
    }
}

/// [4.22-4.24], back and forth.
fn shuttle_at(shuttle: &Shuttle, t: f64) -> [f64; 3] {
    let Some((way, within)) = way_and_time(t, shuttle.stroke_s, shuttle.strokes) else {
        return [shuttle.start, 0.0, 0.0];
    };
    let (travel, duration) = (shuttle.travel, shuttle.stroke_s);
    let phase = within / duration;
    let (sin, cos) = (TAU * phase).sin_cos();
    let cycloid = [
        travel * (phase - sin / TAU),
        travel / duration * (1.0 - cos),
        2.0 * PI * travel / (duration * duration) * sin,
    ];
    out_or_back(shuttle.start, travel, way, cycloid)
}

/// Stroke of a back-and-forth motion at `t`, and the time since the start of the stroke.
fn way_and_time(t: f64, stroke_s: f64, strokes: u32) -> Option<(u32, f64)> {
    let way = (t / stroke_s).floor();
    // A joint without travel has no stroke time either; NaN fails the comparison.
    if !(way >= 0.0 && way < f64::from(strokes)) {
        return None;
    }
    Some((way as u32, t - way * stroke_s))
}

fn out_or_back(start: f64, travel: f64, way: u32, [q, qd, qdd]: [f64; 3]) -> [f64; 3] {
    if way.is_multiple_of(2) { [start + q, qd, qdd] } else { [start + travel - q, -qd, -qdd] }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stroke_covers_its_travel_and_keeps_its_peak_acceleration() {
        let stroke = Stroke { speed: 2.0, ramp_s: 0.5, plateau_s: 0.3 };
        let end = stroke.at(stroke.duration());
        assert!((end[0] - stroke.travel()).abs() < 1e-12 && end[1].abs() < 1e-12 && end[2].abs() < 1e-12);
        let peak = (0..=1300).map(|k| stroke.at(f64::from(k) * 1e-3)[2]).fold(0.0, f64::max);
        assert!((peak - stroke.peak_acceleration()).abs() < 1e-12);
        assert!((stroke.at(0.65)[1] - 2.0).abs() < 1e-15);
    }

    #[test]
    fn a_quintic_meets_both_states() {
        let mut from = MotionState::default();
        from.set(0, [0.3, -0.4, 1.1]);
        let mut to = MotionState::default();
        to.set(0, [-0.7, 0.9, -2.0]);
        let motion = quintic(&from, &to, 1, 1.7);
        for (t, expected) in [(0.0, from), (1.7, to)] {
            let reached = state_at(&motion, t);
            assert!((reached.position[0] - expected.position[0]).abs() < 1e-12);
            assert!((reached.velocity[0] - expected.velocity[0]).abs() < 1e-12);
            assert!((reached.acceleration[0] - expected.acceleration[0]).abs() < 1e-11);
        }
    }

    #[test]
    fn a_shuttle_reaches_its_travel_and_comes_back() {
        let shuttle = Shuttle { start: -1.0, travel: 2.5, stroke_s: 0.8, strokes: 2 };
        let motion = MotionPiece::Shuttle(vec![shuttle]);
        assert!((state_at(&motion, 0.8).position[0] - 1.5).abs() < 1e-12);
        assert!((state_at(&motion, 0.4).velocity[0] - 2.0 * 2.5 / 0.8).abs() < 1e-12, "peak of [4.23]");
        assert!((state_at(&motion, 5.0).position[0] + 1.0).abs() < 1e-15);
    }
}
