//! Faults that a simulated arm develops over its runs.

mod backlash;
mod delay;
pub mod in_run;
mod text;

pub use text::FaultParseError;

use armwatch_model::robot::{FRICTION_COUNT, JointIndex};

/// Default of the largest wear: friction doubled.
const DEFAULT_CAP: f64 = 1.0;

/// A fault. Runs and cycles count from 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fault {
    /// Kind and size.
    pub kind: FaultKind,
    /// The joint; `None` for a fault of the whole arm.
    pub joint: Option<JointIndex>,
    /// First run that shows it.
    pub start_run: u32,
    /// Last run that shows it; `None` if it stays.
    pub last_run: Option<u32>,
}

/// Kind and size of a fault.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum FaultKind {
    /// A part of friction grows by the fraction `rate_per_run` of its healthy size per run, up to `cap`.
    Wear {
        /// The part of friction that grows.
        part: WornPart,
        /// Growth per run, as a fraction of the healthy part.
        rate_per_run: f64,
        /// Largest growth, as a fraction of the healthy part.
        cap: f64,
    },
    /// All friction is larger by a fraction at once.
    Step {
        /// The fraction.
        size: f64,
        /// First cycle of the first run that shows it.
        cycle: u32,
    },
    /// All friction changes by a random fraction in each cycle.
    Jitter {
        /// Standard deviation of the fraction.
        size: f64,
    },
    /// The slow time constant of the warm-up is longer.
    WarmUp {
        /// The factor.
        factor: f64,
    },
    /// A point mass at the tool frame.
    Load {
        /// Mass, kg.
        mass: f64,
        /// Its position in the tool frame, m.
        centre: [f64; 3],
    },
    /// A constant in the torque signal.
    Offset {
        /// Nm (N).
        torque: f64,
    },
    /// The torque signal is larger by a fraction.
    Gain {
        /// The fraction.
        size: f64,
    },
    /// The noise of the torque signal is larger.
    Noise {
        /// The factor.
        factor: f64,
    },
    /// A constant in the position signal.
    Zero {
        /// rad (m).
        position: f64,
    },
    /// The torque signal saturates.
    Saturation {
        /// Nm (N).
        torque: f64,
    },
    /// The torque signal keeps its first value of the run.
    Stuck,
    /// The torque signal is delayed.
    Delay {
        /// s
        seconds: f64,
    },
    /// The gear has backlash: if the torque that it carries changes its sign, the driven side is free for a moment.
    Backlash {
        /// Width of the backlash at the joint, rad (m).
        play: f64,
    },
    /// A ripple at the turn of the motor grows: a bearing, a coupling or a gear that is damaged.
    Ripple {
        /// Growth of its amplitude a run, as a fraction of Coulomb friction.
        rate_per_run: f64,
    },
    /// Something outside pushes the joint during a twentieth of one cycle.
    Contact {
        /// Nm (N).
        torque: f64,
        /// The cycle.
        cycle: u32,
    },
}

armwatch_model::named_enum! {
    /// Part of a joint's friction that wears.
    #[derive(Debug, Clone, Copy, PartialEq, Eq)]
    pub enum WornPart {
        /// All of it, in proportion at all speeds.
        All = "all",
        /// The Coulomb part f1: preload, a seal, a dry contact.
        Coulomb = "coulomb",
        /// The part that grows with speed, f2 to f4: the lubricant.
        Viscous = "viscous",
        /// f1 and f2; the curvature f3 and f4 stays, so that friction rises more than in proportion at high speeds.
        Linear = "linear",
        /// The part that grows with the torque that the gear carries: the teeth.
        Load = "load",
    }
}

impl WornPart {
    /// Which of f1 to f4 grow.
    fn coefficients(self) -> [bool; FRICTION_COUNT] {
        match self {
            Self::All => [true; FRICTION_COUNT],
            Self::Coulomb => [true, false, false, false],
            Self::Viscous => [false, true, true, true],
            Self::Linear => [true, true, false, false],
            Self::Load => [false; FRICTION_COUNT],
        }
    }
}

/// Growth of a joint's friction by part, as fractions of healthy friction.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Wear {
    /// Wear of f1 to f4.
    pub coefficients: [f64; FRICTION_COUNT],
    /// Wear of the friction per Nm (N) that the gear carries.
    pub load: f64,
}

impl FaultKind {
    /// Returns true if it concerns the whole arm.
    fn is_of_arm(self) -> bool {
        matches!(self, Self::Load { .. })
    }
}

impl Fault {
    /// Wear of all friction of a joint up to twice its friction.
    pub fn wear(joint: JointIndex, start_run: u32, rate_per_run: f64) -> Self {
        let kind = FaultKind::Wear { part: WornPart::All, rate_per_run, cap: DEFAULT_CAP };
        Self { kind, joint: Some(joint), start_run, last_run: None }
    }

    /// Returns true if run `run` shows it.
    pub fn is_in(&self, run: u32) -> bool {
        run >= self.start_run && self.last_run.is_none_or(|last| run <= last)
    }

    /// Size of the fault in run `run`, in the unit of its kind; 0 if absent. The first run with wear has one step of
    /// growth.
    pub fn size(&self, run: u32) -> f64 {
        if !self.is_in(run) {
            return 0.0;
        }
        match self.kind {
            FaultKind::Wear { rate_per_run, cap, .. } => {
                (rate_per_run * (f64::from(run - self.start_run) + 1.0)).min(cap)
            }
            FaultKind::Step { size, .. } | FaultKind::Jitter { size } | FaultKind::Gain { size } => size,
            FaultKind::WarmUp { factor } | FaultKind::Noise { factor } => factor,
            FaultKind::Load { mass, .. } => mass,
            FaultKind::Offset { torque }
            | FaultKind::Saturation { torque }
            | FaultKind::Contact { torque, .. } => torque,
            FaultKind::Zero { position } => position,
            FaultKind::Delay { seconds } => seconds,
            FaultKind::Backlash { play } => play,
            FaultKind::Ripple { rate_per_run } => rate_per_run * (f64::from(run - self.start_run) + 1.0),
            FaultKind::Stuck => 1.0,
        }
    }

    fn is_of(&self, joint: usize) -> bool {
        self.joint.is_none_or(|of| of.index() == joint)
    }
}

/// Growth of friction of `joint` in run `run` by all its wear faults.
pub fn wear(faults: &[Fault], joint: JointIndex, run: u32) -> Wear {
    let mut worn = Wear::default();
    for fault in faults.iter().filter(|of| of.is_of(joint.index())) {
        let FaultKind::Wear { part, .. } = fault.kind else { continue };
        let size = fault.size(run);
        for (of, grows) in worn.coefficients.iter_mut().zip(part.coefficients()) {
            *of += if grows { size } else { 0.0 };
        }
        if matches!(part, WornPart::All | WornPart::Load) {
            worn.load += size;
        }
    }
    worn
}

/// Amplitude of the ripple at the motor's turn that `joint` has in run `run`, as a fraction of its Coulomb friction.
pub fn ripple(faults: &[Fault], joint: JointIndex, run: u32) -> f64 {
    let of_joint = faults.iter().filter(|of| of.is_of(joint.index()));
    of_joint.filter(|of| matches!(of.kind, FaultKind::Ripple { .. })).map(|of| of.size(run)).sum()
}

/// How many times longer the slow time constant of the warm-up of `joint` is in run `run`.
pub fn warm_up_factor(faults: &[Fault], joint: JointIndex, run: u32) -> f64 {
    let longer = |fault: &Fault| match fault.kind {
        FaultKind::WarmUp { factor } if fault.is_in(run) && fault.is_of(joint.index()) => Some(factor),
        _ => None,
    };
    faults.iter().filter_map(longer).product()
}

/// The point masses of run `run`: mass, kg, and position in the tool frame, m.
pub fn loads(faults: &[Fault], run: u32) -> impl Iterator<Item = (f64, [f64; 3])> {
    faults.iter().filter_map(move |fault| match fault.kind {
        FaultKind::Load { mass, centre } if fault.is_in(run) => Some((mass, centre)),
        _ => None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wear_of_a_part_leaves_the_others() {
        for (part, coefficients, load) in [
            ("coulomb", [0.1, 0.0, 0.0, 0.0], 0.0),
            ("viscous", [0.0, 0.1, 0.1, 0.1], 0.0),
            ("linear", [0.1, 0.1, 0.0, 0.0], 0.0),
            ("load", [0.0; 4], 0.1),
        ] {
            let fault: Fault = format!("wear:joint=1,from=1,part={part},rate=0.1").parse().unwrap();
            assert_eq!(wear(&[fault], JointIndex::new(0), 1), Wear { coefficients, load }, "{part}");
        }
    }

    #[test]
    fn a_ripple_grows_with_every_run() {
        let fault: Fault = "ripple:joint=2,from=4,rate=0.15".parse().unwrap();
        let of = |joint, run| ripple(&[fault], JointIndex::new(joint), run);
        assert_eq!([of(1, 3), of(1, 4), of(1, 6), of(0, 6)], [0.0, 0.15, 0.15 * 3.0, 0.0]);
    }

    #[test]
    fn wear_grows_from_its_run_to_its_cap() {
        let fault: Fault = "wear:joint=2,from=4,rate=0.1,cap=0.25".parse().unwrap();
        let sizes: Vec<f64> = (1..=8).map(|run| fault.size(run)).collect();
        assert_eq!(sizes, [0.0, 0.0, 0.0, 0.1, 0.2, 0.25, 0.25, 0.25]);
        let joint = JointIndex::new(1);
        let all = Wear { coefficients: [0.2; 4], load: 0.2 };
        assert_eq!(wear(&[fault, fault], joint, 4), all, "two faults add");
        assert_eq!(wear(&[fault], JointIndex::new(0), 4), Wear::default(), "another joint is healthy");
    }
}
