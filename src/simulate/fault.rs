//! Faults that a simulated arm develops over its runs.

use std::collections::BTreeMap;
use std::fmt;
use std::str::FromStr;

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

use super::motion::PerJoint;
use crate::robot::{JointIndex, MAX_JOINTS};

/// Largest wear unless said otherwise: friction doubled.
const DEFAULT_CAP: f64 = 1.0;
/// Stream of what is drawn for cycles; far from those of channels, so that a fault changes no noise.
const CYCLE_STREAM: u64 = 1 << 41;

/// A fault. Runs and cycles count from 1, as people read them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fault {
    /// What is wrong.
    pub kind: FaultKind,
    /// The joint; `None` where it is the whole arm's.
    pub joint: Option<JointIndex>,
    /// First run that shows it.
    pub start_run: u32,
    /// Last run that shows it; `None` if it stays.
    pub last_run: Option<u32>,
}

/// What is wrong, and how much.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum FaultKind {
    /// All friction grows by the fraction `rate_per_run` of healthy friction a run, up to `cap`.
    Wear {
        /// Growth a run, as a fraction of healthy friction.
        rate_per_run: f64,
        /// Largest growth, as a fraction of healthy friction.
        cap: f64,
    },
    /// All friction is larger by a fraction at once.
    Step {
        /// The fraction.
        size: f64,
        /// First cycle of the first run that shows it.
        cycle: u32,
    },
    /// All friction of each cycle is larger or smaller by a fraction that is drawn for the cycle.
    Jitter {
        /// Standard deviation of the fraction.
        size: f64,
    },
    /// The slow time constant of the warm-up is longer.
    WarmUp {
        /// How many times.
        factor: f64,
    },
    /// A point mass at the tool frame.
    Load {
        /// Mass, kg.
        mass: f64,
        /// Its place in the tool frame, m.
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
        /// How many times.
        factor: f64,
    },
    /// A constant in the position signal.
    Zero {
        /// rad (m).
        position: f64,
    },
    /// The torque signal goes no further.
    Saturation {
        /// Nm (N).
        torque: f64,
    },
    /// The torque signal keeps its first value of the run.
    Stuck,
    /// Something outside pushes the joint during a twentieth of one cycle.
    Contact {
        /// Nm (N).
        torque: f64,
        /// The cycle.
        cycle: u32,
    },
}

impl FaultKind {
    fn name(self) -> &'static str {
        match self {
            Self::Wear { .. } => "wear",
            Self::Step { .. } => "step",
            Self::Jitter { .. } => "jitter",
            Self::WarmUp { .. } => "warm-up",
            Self::Load { .. } => "load",
            Self::Offset { .. } => "offset",
            Self::Gain { .. } => "gain",
            Self::Noise { .. } => "noise",
            Self::Zero { .. } => "zero",
            Self::Saturation { .. } => "saturation",
            Self::Stuck => "stuck",
            Self::Contact { .. } => "contact",
        }
    }

    /// Keys and values as they are written.
    fn keys(self) -> Vec<(&'static str, String)> {
        let one = |key, value: f64| vec![(key, value.to_string())];
        match self {
            Self::Wear { rate_per_run, cap } => {
                vec![("rate", rate_per_run.to_string()), ("cap", cap.to_string())]
            }
            Self::Step { size, cycle } => vec![("size", size.to_string()), ("cycle", cycle.to_string())],
            Self::Jitter { size } | Self::Gain { size } => one("size", size),
            Self::WarmUp { factor } | Self::Noise { factor } => one("factor", factor),
            Self::Load { mass, centre: [x, y, z] } => {
                vec![("kg", mass.to_string()), ("centre", format!("{x}/{y}/{z}"))]
            }
            Self::Offset { torque } | Self::Saturation { torque } => one("nm", torque),
            Self::Zero { position } => one("rad", position),
            Self::Stuck => Vec::new(),
            Self::Contact { torque, cycle } => vec![("nm", torque.to_string()), ("cycle", cycle.to_string())],
        }
    }

    /// Whether it is the whole arm's.
    fn is_of_arm(self) -> bool {
        matches!(self, Self::Load { .. })
    }
}

impl Fault {
    /// Wear of a joint up to twice its friction.
    #[must_use]
    pub fn wear(joint: JointIndex, start_run: u32, rate_per_run: f64) -> Self {
        let kind = FaultKind::Wear { rate_per_run, cap: DEFAULT_CAP };
        Self { kind, joint: Some(joint), start_run, last_run: None }
    }

    /// Whether run `run` shows it.
    #[must_use]
    pub fn is_in(&self, run: u32) -> bool {
        run >= self.start_run && self.last_run.is_none_or(|last| run <= last)
    }

    /// How large the fault is in run `run`, in the unit of its kind; 0 where it is not there. The first run that
    /// shows wear has grown by one step.
    #[must_use]
    pub fn size(&self, run: u32) -> f64 {
        if !self.is_in(run) {
            return 0.0;
        }
        match self.kind {
            FaultKind::Wear { rate_per_run, cap } => {
                (rate_per_run * (f64::from(run - self.start_run) + 1.0)).min(cap)
            }
            FaultKind::Step { size, .. } | FaultKind::Jitter { size } | FaultKind::Gain { size } => size,
            FaultKind::WarmUp { factor } | FaultKind::Noise { factor } => factor,
            FaultKind::Load { mass, .. } => mass,
            FaultKind::Offset { torque }
            | FaultKind::Saturation { torque }
            | FaultKind::Contact { torque, .. } => torque,
            FaultKind::Zero { position } => position,
            FaultKind::Stuck => 1.0,
        }
    }

    fn is_of(&self, joint: usize) -> bool {
        self.joint.is_none_or(|of| of.index() == joint)
    }
}

/// Growth of friction of `joint` in run `run` over all its wear.
#[must_use]
pub fn wear(faults: &[Fault], joint: JointIndex, run: u32) -> f64 {
    // A sum over nothing is -0.0, which looks odd in a truth file.
    let worn =
        faults.iter().filter(|of| matches!(of.kind, FaultKind::Wear { .. }) && of.is_of(joint.index()));
    worn.fold(0.0, |total, fault| total + fault.size(run))
}

/// How many times longer the slow time constant of the warm-up of `joint` is in run `run`.
#[must_use]
pub fn warm_up_factor(faults: &[Fault], joint: JointIndex, run: u32) -> f64 {
    let longer = |fault: &Fault| match fault.kind {
        FaultKind::WarmUp { factor } if fault.is_in(run) && fault.is_of(joint.index()) => Some(factor),
        _ => None,
    };
    faults.iter().filter_map(longer).product()
}

/// The point masses of run `run`: mass, kg, and place in the tool frame, m.
pub fn loads(faults: &[Fault], run: u32) -> impl Iterator<Item = (f64, [f64; 3])> {
    faults.iter().filter_map(move |fault| match fault.kind {
        FaultKind::Load { mass, centre } if fault.is_in(run) => Some((mass, centre)),
        _ => None,
    })
}

/// What the faults of one run do to its cycles and its signals.
#[derive(Debug, Clone)]
pub struct RunFaults {
    /// Those of the run.
    faults: Vec<Fault>,
    run: u32,
    rng: ChaCha8Rng,
    /// Factor of the friction of each joint in this cycle.
    friction: PerJoint,
    cycle: u32,
    /// Torque signals of the run's first row, Nm.
    first_torque: Option<PerJoint>,
}

impl RunFaults {
    /// Those of run `run`; `seed` and `stream` choose what is drawn for the cycles.
    #[must_use]
    pub fn new(faults: &[Fault], run: u32, seed: u64, stream: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(CYCLE_STREAM + stream);
        let faults = faults.iter().copied().filter(|fault| fault.is_in(run)).collect();
        Self { faults, run, rng, friction: [1.0; MAX_JOINTS], cycle: 0, first_torque: None }
    }

    /// Begins cycle `cycle`.
    pub(super) fn begin_cycle(&mut self, cycle: u32) {
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
    pub(super) fn friction(&self) -> &PerJoint {
        &self.friction
    }

    /// How many times larger the noise of a joint's torque signal is.
    pub(super) fn noise(&self, joint: usize) -> f64 {
        let of = |fault: &Fault| match fault.kind {
            FaultKind::Noise { factor } if fault.is_of(joint) => Some(factor),
            _ => None,
        };
        self.faults.iter().filter_map(of).product()
    }

    /// Torque from outside at each joint at `share` of the cycle, 0 to 1, Nm.
    pub(super) fn push(&self, share: f64, torque: &mut PerJoint) {
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

    /// Changes the signals of a row as its sensors do.
    pub(super) fn distort(&mut self, position: &mut PerJoint, torque: &mut PerJoint) {
        let first = *self.first_torque.get_or_insert(*torque);
        for fault in &self.faults {
            for joint in (0..MAX_JOINTS).filter(|joint| fault.is_of(*joint)) {
                match fault.kind {
                    FaultKind::Offset { torque: offset } => torque[joint] += offset,
                    FaultKind::Gain { size } => torque[joint] *= 1.0 + size,
                    FaultKind::Zero { position: offset } => position[joint] += offset,
                    FaultKind::Saturation { torque: most } => {
                        torque[joint] = torque[joint].clamp(-most.abs(), most.abs());
                    }
                    FaultKind::Stuck => torque[joint] = first[joint],
                    _ => {}
                }
            }
        }
    }
}

/// Why a fault's text was not understood.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("fault \"{text}\": {reason}; write for example wear:joint=3,from=5,rate=0.03")]
pub struct FaultParseError {
    text: String,
    reason: String,
}

impl FromStr for Fault {
    type Err = FaultParseError;

    /// Reads `wear:joint=3,from=5,rate=0.03`: the kind, then keys. Every kind has `from`, the first run, and may have
    /// `to`, the last one.
    fn from_str(text: &str) -> Result<Self, Self::Err> {
        parse(text).map_err(|reason| FaultParseError { text: text.to_owned(), reason })
    }
}

/// Keys that are still to be read.
struct Keys<'a>(BTreeMap<&'a str, &'a str>);

impl<'a> Keys<'a> {
    fn number(&mut self, key: &str, what: &str, is_right: impl Fn(f64) -> bool) -> Result<f64, String> {
        let value = self.0.remove(key).ok_or_else(|| format!("{key}= is missing"))?;
        let number = value.parse::<f64>().ok().filter(|number| number.is_finite() && is_right(*number));
        number.ok_or_else(|| not_a(key, value, what))
    }

    fn fraction(&mut self, key: &str) -> Result<f64, String> {
        self.number(key, "fraction of 0 or more", |number| number >= 0.0)
    }

    fn count(&mut self, key: &str, what: &str) -> Result<Option<u32>, String> {
        let Some(value) = self.0.remove(key) else { return Ok(None) };
        let count: u32 = value.parse().map_err(|_| not_a(key, value, &format!("{what} number from 1")))?;
        if count == 0 { Err(format!("{what}s count from 1")) } else { Ok(Some(count)) }
    }

    fn place(&mut self, key: &str) -> Result<[f64; 3], String> {
        let Some(value) = self.0.remove(key) else { return Ok([0.0; 3]) };
        let numbers: Vec<f64> = value.split('/').filter_map(|of| of.parse().ok()).collect();
        let finite = |of: &[f64; 3]| of.iter().all(|x| x.is_finite());
        numbers.try_into().ok().filter(finite).ok_or_else(|| not_a(key, value, "place X/Y/Z in m"))
    }
}

fn parse(text: &str) -> Result<Fault, String> {
    let (kind, pairs) = text.trim().split_once(':').ok_or("a kind and a colon are missing")?;
    let mut keys = Keys(BTreeMap::new());
    for pair in pairs.split(',') {
        let (key, value) = pair.split_once('=').ok_or_else(|| format!("\"{pair}\" is not key=value"))?;
        keys.0.insert(key.trim(), value.trim());
    }
    let known = keys.0.clone();
    let any = |_: f64| true;
    let kind = match kind.trim() {
        "wear" => {
            let cap = if keys.0.contains_key("cap") { keys.fraction("cap")? } else { DEFAULT_CAP };
            FaultKind::Wear { rate_per_run: keys.fraction("rate")?, cap }
        }
        "step" => FaultKind::Step {
            size: keys.number("size", "fraction above -1", |size| size > -1.0)?,
            cycle: keys.count("cycle", "cycle")?.unwrap_or(1),
        },
        "jitter" => FaultKind::Jitter { size: keys.fraction("size")? },
        "warm-up" => FaultKind::WarmUp { factor: keys.number("factor", "factor above 0", |of| of > 0.0)? },
        "load" => FaultKind::Load {
            mass: keys.number("kg", "mass above 0 kg", |mass| mass > 0.0)?,
            centre: keys.place("centre")?,
        },
        "offset" => FaultKind::Offset { torque: keys.number("nm", "torque", any)? },
        "gain" => FaultKind::Gain { size: keys.number("size", "fraction above -1", |size| size > -1.0)? },
        "noise" => FaultKind::Noise { factor: keys.number("factor", "factor of 0 or more", |of| of >= 0.0)? },
        "zero" => FaultKind::Zero { position: keys.number("rad", "position", any)? },
        "saturation" => FaultKind::Saturation { torque: keys.number("nm", "torque above 0", |of| of > 0.0)? },
        "stuck" => FaultKind::Stuck,
        "contact" => FaultKind::Contact {
            torque: keys.number("nm", "torque", any)?,
            cycle: keys.count("cycle", "cycle")?.unwrap_or(1),
        },
        other => {
            return Err(format!(
                "there is no kind \"{other}\", only wear, step, jitter, warm-up, load, offset, gain, noise, zero, \
                 saturation, stuck, contact"
            ));
        }
    };
    let start_run = keys.count("from", "run")?.ok_or("from= is missing")?;
    let last_run = keys.count("to", "run")?;
    let joint = match keys.0.remove("joint") {
        None if kind.is_of_arm() || matches!(kind, FaultKind::WarmUp { .. }) => None,
        None => return Err("joint= is missing".into()),
        Some(_) if kind.is_of_arm() => return Err("a load is the whole arm's and has no joint=".into()),
        Some(value) => {
            let number = value.parse().map_err(|_| not_a("joint", value, "joint number from 1"))?;
            Some(JointIndex::from_number(number).ok_or("joints count from 1")?)
        }
    };
    match keys.0.keys().next() {
        None => Ok(Fault { kind, joint, start_run, last_run }),
        Some(key) => {
            let used: Vec<&str> = known.keys().filter(|of| !keys.0.contains_key(*of)).copied().collect();
            Err(format!("there is no key \"{key}\" of {}; known are {}", kind.name(), used.join(", ")))
        }
    }
}

fn not_a(key: &str, value: &str, what: &str) -> String {
    format!("{key}={value} is not a {what}")
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:", self.kind.name())?;
        if let Some(joint) = self.joint {
            write!(f, "joint={joint},")?;
        }
        write!(f, "from={}", self.start_run)?;
        if let Some(last) = self.last_run {
            write!(f, ",to={last}")?;
        }
        self.kind.keys().iter().try_for_each(|(key, value)| write!(f, ",{key}={value}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn faults_are_read_and_written() {
        for text in [
            "wear:joint=3,from=5,rate=0.03,cap=1",
            "step:joint=2,from=4,to=9,size=0.25,cycle=5",
            "jitter:joint=5,from=1,size=0.12",
            "warm-up:from=3,factor=2",
            "warm-up:joint=2,from=3,factor=2",
            "load:from=2,to=2,kg=0.8,centre=0/0.01/0.1",
            "offset:joint=1,from=2,nm=-12.5",
            "gain:joint=1,from=2,size=-0.05",
            "noise:joint=6,from=2,factor=4",
            "zero:joint=2,from=2,rad=0.01",
            "saturation:joint=2,from=2,nm=40",
            "stuck:joint=4,from=6",
            "contact:joint=2,from=3,to=3,nm=30,cycle=4",
        ] {
            let fault: Fault = text.parse().unwrap();
            assert_eq!(fault.to_string(), text);
        }
        let fault: Fault = "wear:joint=3,from=5,rate=0.03".parse().unwrap();
        assert_eq!(fault, Fault::wear(JointIndex::new(2), 5, 0.03));
    }

    #[test]
    fn wear_grows_from_its_run_to_its_cap() {
        let fault: Fault = "wear:joint=2,from=4,rate=0.1,cap=0.25".parse().unwrap();
        let sizes: Vec<f64> = (1..=8).map(|run| fault.size(run)).collect();
        assert_eq!(sizes, [0.0, 0.0, 0.0, 0.1, 0.2, 0.25, 0.25, 0.25]);
        let joint = JointIndex::new(1);
        assert_eq!(wear(&[fault, fault], joint, 4), 0.2, "two faults add");
        assert_eq!(wear(&[fault], JointIndex::new(0), 4), 0.0, "another joint is healthy");
        assert!(wear(&[], joint, 4).is_sign_positive(), "a truth file must not say -0.0");
    }

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
            "zero:joint=1,from=1,rad=0.5",
        ]
        .iter()
        .map(|text| text.parse().unwrap())
        .collect();
        let mut of_run = RunFaults::new(&faults, 1, 1, 0);
        let mut rows = [[7.0; MAX_JOINTS], [-9.0; MAX_JOINTS]];
        let mut position = [0.0; MAX_JOINTS];
        for row in &mut rows {
            of_run.begin_cycle(1);
            position = [0.0; MAX_JOINTS];
            of_run.distort(&mut position, row);
        }
        assert_eq!(rows[1][..5], [-7.0, -9.9, -5.0, 7.0, -9.0]);
        assert_eq!(position[..2], [0.5, 0.0]);
    }

    #[test]
    fn each_mistake_is_named() {
        for (text, part) in [
            ("wear", "colon"),
            ("rust:joint=1", "no kind \"rust\""),
            ("wear:joint=0,from=1,rate=0.1", "count from 1"),
            ("wear:joint=1,from=0,rate=0.1", "runs count from 1"),
            ("wear:joint=1,rate=0.1", "from= is missing"),
            ("wear:from=2,rate=0.1", "joint= is missing"),
            ("wear:joint=1,from=2,rate=-1", "rate=-1"),
            ("wear:joint=1,from=2,rate=nan", "rate=nan"),
            ("wear:joint=1,from=2,rate=0.1,speed=3", "no key \"speed\""),
            ("wear:joint=x,from=2,rate=1", "joint=x"),
            ("load:joint=2,from=1,kg=1", "has no joint"),
            ("load:from=1,kg=1,centre=1/2", "X/Y/Z"),
            ("step:joint=1,from=1,size=-2", "above -1"),
        ] {
            let message = text.parse::<Fault>().unwrap_err().to_string();
            assert!(message.contains(part), "{text}: {message}");
        }
    }
}
