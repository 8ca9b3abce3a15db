//! Effects of the faults of one run on its cycles and its signals.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

use super::backlash::LooseGear;
use super::delay::LateSignal;
use super::{Fault, FaultKind};
use crate::arm::dynamics::RigidChain;
use crate::plan::motion::{MotionState, PerJoint};
use armwatch_model::robot::MAX_JOINTS;

/// Stream of random values of cycles; far from those of channels, so that a fault changes no noise.
const CYCLE_STREAM: u64 = 1 << 41;

/// Effects of the faults of one run on its cycles and its signals.
#[derive(Debug, Clone)]
pub struct RunFaults {
    /// Faults of the run.
    faults: Vec<Fault>,
    run: u32,
    rng: ChaCha8Rng,
    /// Factor of the friction of each joint in this cycle.
    friction: PerJoint,
    cycle: u32,
    /// Torque signals of the run's first row, Nm.
    first_torque: Option<PerJoint>,
    /// By fault: delayed signals, and gears with backlash.
    late: Vec<LateSignal>,
    gears: Vec<LooseGear>,
}

impl RunFaults {
    /// Faults of run `run`; `seed` and `stream` select the random values of the cycles.
    pub fn new(faults: &[Fault], run: u32, seed: u64, stream: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(CYCLE_STREAM + stream);
        let faults: Vec<Fault> = faults.iter().copied().filter(|fault| fault.is_in(run)).collect();
        Self {
            late: vec![LateSignal::default(); faults.len()],
            gears: vec![LooseGear::default(); faults.len()],
            faults,
            run,
            rng,
            friction: [1.0; MAX_JOINTS],
            cycle: 0,
            first_torque: None,
        }
    }

    /// Begins cycle `cycle`.
    pub(crate) fn begin_cycle(&mut self, cycle: u32) {
        self.cycle = cycle;
        self.friction = [1.0; MAX_JOINTS];
        for fault in &self.faults {
            let growth = match fault.kind {
                FaultKind::Step { size, cycle: first } if self.run > fault.start_run || cycle >= first => {
                    size
                }
                FaultKind::Jitter { size } => size * self.rng.sample::<f64, _>(StandardNormal),
                _ => continue,
            };
            for joint in (0..MAX_JOINTS).filter(|joint| fault.is_of(*joint)) {
                self.friction[joint] *= (1.0 + growth).max(0.0);
            }
        }
    }

    /// Factor of the friction of each joint.
    pub(crate) fn friction(&self) -> &PerJoint {
        &self.friction
    }

    /// Factor of the noise of a joint's torque signal.
    pub(crate) fn noise(&self, joint: usize) -> f64 {
        let of = |fault: &Fault| match fault.kind {
            FaultKind::Noise { factor } if fault.is_of(joint) => Some(factor),
            _ => None,
        };
        self.faults.iter().filter_map(of).product()
    }

    /// External torque at each joint at `share` of the cycle, 0 to 1, Nm.
    pub(crate) fn push(&self, share: f64, torque: &mut PerJoint) {
        for fault in &self.faults {
            if let FaultKind::Contact { torque: outside, cycle } = fault.kind
                && cycle == self.cycle
                && (0.1..0.15).contains(&share)
            {
                torque
                    .iter_mut()
                    .enumerate()
                    .filter(|(j, _)| fault.is_of(*j))
                    .for_each(|(_, t)| *t += outside);
            }
        }
    }

    /// Changes the torques of gears with backlash; `time` in s since the start of the run increases from row to row.
    pub(crate) fn loosen(
        &mut self,
        chain: &RigidChain,
        state: &MotionState,
        time: f64,
        torque: &mut PerJoint,
    ) {
        for (fault, gear) in self.faults.iter().zip(&mut self.gears) {
            if let (FaultKind::Backlash { play }, Some(joint)) = (fault.kind, fault.joint) {
                torque[joint.index()] += gear.step(chain, state, joint, play, time);
            }
        }
    }

    /// Applies sensor faults to the signals of the row at `time`, s.
    pub(crate) fn distort(&mut self, time: f64, position: &mut PerJoint, torque: &mut PerJoint) {
        let first = *self.first_torque.get_or_insert(*torque);
        for (fault, late) in self.faults.iter().zip(&mut self.late) {
            for joint in (0..MAX_JOINTS).filter(|joint| fault.is_of(*joint)) {
                match fault.kind {
                    FaultKind::Offset { torque: offset } => torque[joint] += offset,
                    FaultKind::Gain { size } => torque[joint] *= 1.0 + size,
                    FaultKind::Zero { position: offset } => position[joint] += offset,
                    FaultKind::Saturation { torque: most } => {
                        torque[joint] = torque[joint].clamp(-most.abs(), most.abs());
                    }
                    FaultKind::Stuck => torque[joint] = first[joint],
                    FaultKind::Delay { seconds } => torque[joint] = late.push(time, torque[joint], seconds),
                    _ => {}
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_step_begins_with_its_cycle_and_stays() {
        let fault: Fault = "step:joint=2,from=4,to=5,size=0.25,cycle=3".parse().unwrap();
        let factor = |run, cycle| {
            let mut faults = RunFaults::new(&[fault], run, 1, 0);
            faults.begin_cycle(cycle);
            (faults.friction()[1], faults.friction()[0])
        };
        let found = [(3, 9), (4, 2), (4, 3), (4, 8), (5, 1), (6, 1)].map(|(run, cycle)| factor(run, cycle));
        assert_eq!(found.map(|of| of.0), [1.0, 1.0, 1.25, 1.25, 1.25, 1.0]);
        assert_eq!(found.map(|of| of.1), [1.0; 6], "another joint is healthy");
    }

    #[test]
    fn signals_are_distorted_as_said() {
        let faults: Vec<Fault> = [
            "offset:joint=1,from=1,nm=2",
            "gain:joint=2,from=1,size=0.1",
            "saturation:joint=3,from=1,nm=5",
            "stuck:joint=4,from=1",
            "delay:joint=5,from=1,s=0.5",
            "zero:joint=1,from=1,rad=0.5",
        ]
        .iter()
        .map(|text| text.parse().unwrap())
        .collect();
        let mut of_run = RunFaults::new(&faults, 1, 1, 0);
        let mut rows = [[7.0; MAX_JOINTS], [-9.0; MAX_JOINTS]];
        let mut position = [0.0; MAX_JOINTS];
        for (time, row) in rows.iter_mut().enumerate() {
            of_run.begin_cycle(1);
            position = [0.0; MAX_JOINTS];
            of_run.distort(time as f64, &mut position, row);
        }
        assert_eq!(rows[1][..5], [-7.0, -9.9, -5.0, 7.0, -1.0]);
        assert_eq!(position[..2], [0.5, 0.0]);
    }
}
