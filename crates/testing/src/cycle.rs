//! A cycle with a torque that no model explains.

use armwatch_model::run::{Cycle, Samples, Stage};

const RATE: f64 = 60.0;

/// All joints swing, in the friction stage one after the other; the torque is not explained by any model.
pub fn cycle(number: u32, rows: usize) -> Cycle {
    let channel = || vec![Vec::new(); 6];
    let (mut position, mut torque) = (channel(), channel());
    let mut samples = Samples::default();
    for i in 0..rows {
        let t = i as f64 / RATE;
        let stage = match 20 * i / rows {
            0..8 => Stage::Excitation,
            8 | 13 => Stage::Between,
            9..13 => Stage::Friction,
            _ => Stage::Warming,
        };
        samples.time.push(t);
        samples.stage.push(stage);
        for j in 0..6 {
            let w = 1.3 + 0.41 * j as f64 + 0.1 * f64::from(number);
            let moves = stage != Stage::Friction || i / 40 % 6 == j;
            let (sine, cosine) = ((w * t).sin(), (2.3 * w * t).cos());
            // noise of the encoder at rest
            let q = if moves { sine + 0.3 * cosine } else { 0.3 + 1e-4 * sine };
            let qd = if moves { w * (w * t).cos() - 0.69 * w * (2.3 * w * t).sin() } else { 0.0 };
            position[j].push(q);
            torque[j].push(10.0 * qd.signum() + 3.0 * qd + 20.0 * q + ((i * 7919 % 101) as f64 - 50.0));
        }
    }
    samples.position = position;
    // rows jump between stages, so velocity is computed from the position
    samples.torque = torque;
    Cycle { number, samples }
}
