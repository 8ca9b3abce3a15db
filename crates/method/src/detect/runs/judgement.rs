//! What is found in the cycles of a test, as numbers that can be kept: causes of its friction curves, and what it shows of the
//! arm.
//!
//! It follows from the test, from what is usual of the tests that it is compared with ([`Frame`]), and from the parameters of
//! the few tests before it. A hash of all that says whether one that was kept still holds. The rate of false alarms is no
//! part of it: how clear a cause must be is asked of what is found.

use std::fmt::{self, Write};
use std::hash::{DefaultHasher, Hash, Hasher};

use super::arm::cause::{ArmCause, Load, SignalFault};
use super::arm::{ArmJudgement, UsualArm};
use super::curve::causes::{RunCauses, UsualCurves};
use super::curve::hypothesis::Cause;
use super::curve::run_cause::{Kind, RunCause, WarmUpOfRun};
use armwatch_model::analysis::Estimate;
use armwatch_model::anomaly::RunSummary;
use armwatch_model::anomaly::brief::content;
use armwatch_model::robot::JointIndex;

/// Changes whenever the program finds something else in the same cycles, or keeps it in another form. What another version
/// of the program has kept is not believed either.
const METHOD: (u64, &str) = (11, env!("CARGO_PKG_VERSION"));

/// What is found in the cycles of a test.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Judgement {
    pub(super) causes: RunCauses,
    pub(super) arm: ArmJudgement,
}

/// What is usual of the tests that are compared with each other.
#[derive(Debug)]
pub(super) struct Frame {
    pub(super) curves: UsualCurves,
    /// Of the tests of each length, by group.
    pub(super) arms: Vec<UsualArm>,
}

impl Frame {
    /// Hash of all of it, by group.
    pub(super) fn hashes(&self) -> Vec<u64> {
        let mut of_curves = Hashed(DefaultHasher::new());
        METHOD.hash(&mut of_curves.0);
        // to write into a hash does not fail
        _ = self.curves.write(&mut of_curves);
        let of_arm = |arm: &UsualArm| {
            let mut hashed = Hashed(of_curves.0.clone());
            _ = write!(hashed, "{arm:?}");
            hashed.0.finish()
        };
        self.arms.iter().map(of_arm).collect()
    }
}

struct Hashed(DefaultHasher);

impl Write for Hashed {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        self.0.write(text.as_bytes());
        Ok(())
    }
}

/// Hash of what a test's judgement follows from: what is usual, the test, and the tests whose parameters are looked at
/// together with its own.
pub(super) fn key(frame: u64, run: &RunSummary, together: &[&RunSummary]) -> u64 {
    let content = |run: &RunSummary| match &run.brief {
        Some(brief) => brief.content,
        None => content(run),
    };
    let mut hasher = DefaultHasher::new();
    frame.hash(&mut hasher);
    content(run).hash(&mut hasher);
    for of in &run.joints {
        let figures = [of.relative_rmsd, of.relative_noise, of.torque_rms];
        (of.joint, figures.map(|figure| figure.map(f64::to_bits))).hash(&mut hasher);
    }
    together.iter().for_each(|run| content(run).hash(&mut hasher));
    hasher.finish()
}

/// Numbers one after the other.
#[derive(Default)]
struct Packed(Vec<u8>);

impl Packed {
    fn byte(&mut self, byte: usize) {
        self.0.push(u8::try_from(byte).unwrap_or(u8::MAX));
    }

    fn numbers<const N: usize>(&mut self, numbers: [f64; N]) {
        numbers.iter().for_each(|number| self.0.extend(number.to_le_bytes()));
    }

    fn cycle(&mut self, cycle: u32) {
        self.0.extend(cycle.to_le_bytes());
    }

    fn cause(&mut self, cause: &Cause) {
        match *cause {
            Cause::None => self.byte(0),
            Cause::Scale(size) => self.sized(1, size),
            Cause::Start(size) => self.sized(2, size),
            Cause::TimeConstant(factor) => self.sized(3, factor),
            Cause::Scatter(size) => self.sized(4, size),
            Cause::Unknown => self.byte(5),
            Cause::Step { cycle, size } => {
                self.sized(6, size);
                self.cycle(cycle);
            }
            Cause::OddCycle { cycle, size } => {
                self.sized(7, size);
                self.cycle(cycle);
            }
        }
    }

    fn sized(&mut self, kind: usize, size: f64) {
        self.byte(kind);
        self.numbers([size]);
    }

    fn run_cause(&mut self, cause: Option<&RunCause>) {
        let Some(RunCause { kinds, advantage, lead, slowing, warm_up, effect, cycles, .. }) = cause else {
            return self.byte(0);
        };
        // no change, and nothing that comes near it
        let is_quiet = matches!(kinds[..], [Kind { cause: Cause::None, .. }]);
        let form = [slowing.is_some(), !is_quiet, warm_up.is_some()];
        self.byte(1 + form.iter().rev().fold(0, |sum, is| 2 * sum + usize::from(*is)));
        self.cycle(u32::try_from(*cycles).unwrap_or(u32::MAX));
        self.numbers([*lead]);
        if let Some((factor, gain)) = *slowing {
            self.numbers([factor, gain]);
        }
        if let Some(WarmUpOfRun { ln_factor: Estimate { value, std_error }, common }) = *warm_up {
            self.numbers([value, std_error, common]);
        }
        if !is_quiet {
            self.numbers([*advantage, *effect]);
            self.byte(kinds.len());
            for of in kinds {
                self.cause(&of.cause);
                self.numbers([of.weight]);
            }
        }
    }

    fn arm_causes(&mut self, causes: &[(ArmCause, f64)]) {
        self.byte(causes.len());
        for (cause, cost) in causes {
            match *cause {
                ArmCause::None => self.byte(0),
                ArmCause::Unknown => self.byte(1),
                ArmCause::Load(Load { mass, std_error, centre: [x, y, z] }) => {
                    self.byte(2);
                    self.numbers([mass, std_error, x, y, z]);
                }
                ArmCause::PositionSignal { joint, offset } => self.of_joint(3, joint, offset),
                ArmCause::TorqueSignal { joint, fault } => match fault {
                    SignalFault::Offset(torque) => self.of_joint(4, joint, torque),
                    SignalFault::Noise(ratio) => self.of_joint(5, joint, ratio),
                    SignalFault::Gain(part) => self.of_joint(6, joint, part),
                },
                ArmCause::UnexplainedTorque { joint, ratio } => self.of_joint(7, joint, ratio),
                ArmCause::NoiseOfAll(ratio) => self.sized(8, ratio),
            }
            self.numbers([*cost]);
        }
    }

    fn of_joint(&mut self, kind: usize, joint: JointIndex, size: f64) {
        self.byte(kind);
        self.byte(joint.index());
        self.numbers([size]);
    }
}

/// Numbers that are read from the front.
struct Reader<'b>(&'b [u8]);

impl Reader<'_> {
    fn take<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (first, rest) = self.0.split_first_chunk::<N>()?;
        self.0 = rest;
        Some(*first)
    }

    fn byte(&mut self) -> Option<usize> {
        self.take::<1>().map(|[byte]| usize::from(byte))
    }

    fn number(&mut self) -> Option<f64> {
        self.take().map(f64::from_le_bytes)
    }

    fn numbers<const N: usize>(&mut self) -> Option<[f64; N]> {
        let mut found = [0.0; N];
        for number in &mut found {
            *number = self.number()?;
        }
        Some(found)
    }

    fn cycle(&mut self) -> Option<u32> {
        self.take().map(u32::from_le_bytes)
    }

    fn joint(&mut self) -> Option<JointIndex> {
        self.byte().map(JointIndex::new)
    }

    fn cause(&mut self) -> Option<Cause> {
        Some(match self.byte()? {
            0 => Cause::None,
            1 => Cause::Scale(self.number()?),
            2 => Cause::Start(self.number()?),
            3 => Cause::TimeConstant(self.number()?),
            4 => Cause::Scatter(self.number()?),
            5 => Cause::Unknown,
            6 => Cause::Step { size: self.number()?, cycle: self.cycle()? },
            7 => Cause::OddCycle { size: self.number()?, cycle: self.cycle()? },
            _ => return None,
        })
    }

    /// The outer `None` is the end of the numbers.
    fn run_cause(
        &mut self,
        scatter: impl Fn(usize) -> f64,
        least_advantage: f64,
    ) -> Option<Option<RunCause>> {
        let form = match self.byte()? {
            0 => return Some(None),
            form @ 1..=8 => form - 1,
            _ => return None,
        };
        let cycles = self.cycle()? as usize;
        let lead = self.number()?;
        let slowing = match form % 2 {
            0 => None,
            _ => Some((self.number()?, self.number()?)),
        };
        let warm_up = match form & 4 {
            0 => None,
            _ => Some(WarmUpOfRun {
                ln_factor: Estimate { value: self.number()?, std_error: self.number()? },
                common: self.number()?,
            }),
        };
        let (mut advantage, mut effect) = (0.0, 0.0);
        let mut kinds = vec![Kind { cause: Cause::None, weight: 1.0 }];
        if form & 2 != 0 {
            [advantage, effect] = self.numbers()?;
            let count = self.byte()?;
            let kind = |_| Some(Kind { cause: self.cause()?, weight: self.number()? });
            kinds = (0..count).map(kind).collect::<Option<_>>()?;
        }
        let scatter = scatter(cycles);
        Some(Some(RunCause {
            kinds,
            advantage,
            lead,
            slowing,
            warm_up,
            scatter,
            effect,
            cycles,
            least_advantage,
        }))
    }

    fn arm_causes(&mut self) -> Option<Vec<(ArmCause, f64)>> {
        let count = self.byte()?;
        let signal = |joint: JointIndex, fault: SignalFault| ArmCause::TorqueSignal { joint, fault };
        let one = |_| {
            let cause = match self.byte()? {
                0 => ArmCause::None,
                1 => ArmCause::Unknown,
                2 => {
                    let [mass, std_error, x, y, z] = self.numbers()?;
                    ArmCause::Load(Load { mass, std_error, centre: [x, y, z] })
                }
                3 => ArmCause::PositionSignal { joint: self.joint()?, offset: self.number()? },
                4 => signal(self.joint()?, SignalFault::Offset(self.number()?)),
                5 => signal(self.joint()?, SignalFault::Noise(self.number()?)),
                6 => signal(self.joint()?, SignalFault::Gain(self.number()?)),
                7 => ArmCause::UnexplainedTorque { joint: self.joint()?, ratio: self.number()? },
                8 => ArmCause::NoiseOfAll(self.number()?),
                _ => return None,
            };
            Some((cause, self.number()?))
        };
        (0..count).map(one).collect()
    }
}

impl Judgement {
    /// As bytes; a quiet test of six joints takes some 300.
    pub(super) fn packed(&self) -> Vec<u8> {
        let Self { causes, arm: ArmJudgement { plain, together } } = self;
        let mut packed = Packed::default();
        packed.byte(causes.of_joints.len());
        causes.of_joints.iter().for_each(|cause| packed.run_cause(cause.as_ref()));
        packed.run_cause(causes.of_arm.as_ref());
        packed.byte(usize::from(plain.is_some()));
        plain.iter().for_each(|causes| packed.arm_causes(causes));
        packed.byte(together.len());
        for (ratio, causes) in together {
            packed.numbers([*ratio]);
            packed.arm_causes(causes);
        }
        packed.0
    }

    /// What [`Self::packed`] made; `None` for other bytes. `curves` are those that the test was held against.
    pub(super) fn unpacked(bytes: &[u8], curves: &UsualCurves) -> Option<Self> {
        let mut reader = Reader(bytes);
        let joints = reader.byte()?;
        let least = curves.least_advantage;
        let of_joint = |joint| reader.run_cause(|cycles| curves.scatter(joint, cycles), least);
        let of_joints = (0..joints).map(of_joint).collect::<Option<_>>()?;
        let of_arm = reader.run_cause(|_| curves.scatter_of_arm(), least)?;
        let causes = RunCauses { of_joints, of_arm };
        let plain = match reader.byte()? {
            0 => None,
            _ => Some(reader.arm_causes()?),
        };
        let count = reader.byte()?;
        let one = |_| Some((reader.number()?, reader.arm_causes()?));
        let together = (0..count).map(one).collect::<Option<_>>()?;
        reader.0.is_empty().then_some(Self { causes, arm: ArmJudgement { plain, together } })
    }
}
