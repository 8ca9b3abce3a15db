//! Faults that a simulated arm develops over its runs.

use std::fmt;
use std::str::FromStr;

use crate::robot::JointIndex;

/// Largest wear unless said otherwise: friction doubled.
const DEFAULT_CAP: f64 = 1.0;

/// A fault. Runs count from 1, as people read them.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum Fault {
    /// Coulomb and viscous friction of a joint grow by a fraction a run.
    Wear {
        /// The joint.
        joint: JointIndex,
        /// First run that shows it.
        start_run: u32,
        /// Growth of friction per run, as a fraction of healthy friction.
        rate_per_run: f64,
        /// Largest growth, as a fraction of healthy friction.
        cap: f64,
    },
}

impl Fault {
    /// The joint that has the fault.
    #[must_use]
    pub fn joint(&self) -> JointIndex {
        match self {
            Self::Wear { joint, .. } => *joint,
        }
    }

    /// How large the fault is in run `run`, counted from 1: for wear, the fraction by which friction
    /// has grown. The first run that shows wear has grown by one step.
    #[must_use]
    pub fn size(&self, run: u32) -> f64 {
        match *self {
            Self::Wear { start_run, rate_per_run, cap, .. } => match run.checked_sub(start_run) {
                Some(before) => (rate_per_run * (f64::from(before) + 1.0)).min(cap),
                None => 0.0,
            },
        }
    }
}

/// Growth of friction of `joint` in run `run` over all its wear.
#[must_use]
pub fn wear(faults: &[Fault], joint: JointIndex, run: u32) -> f64 {
    // A sum over nothing is -0.0, which looks odd in a truth file.
    faults.iter().filter(|f| f.joint() == joint).fold(0.0, |total, fault| match fault {
        Fault::Wear { .. } => total + fault.size(run),
    })
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

    /// Reads `wear:joint=3,from=5,rate=0.03` with an optional `cap=0.5`.
    fn from_str(text: &str) -> Result<Self, Self::Err> {
        parse(text).map_err(|reason| FaultParseError { text: text.to_owned(), reason })
    }
}

fn parse(text: &str) -> Result<Fault, String> {
    let (kind, keys) = text.trim().split_once(':').ok_or("a kind and a colon are missing")?;
    match kind.trim() {
        "wear" => parse_wear(keys),
        other => Err(format!("there is no kind \"{other}\", only wear")),
    }
}

fn parse_wear(keys: &str) -> Result<Fault, String> {
    let (mut joint, mut start_run, mut rate, mut cap) = (None, None, None, DEFAULT_CAP);
    for pair in keys.split(',') {
        let (key, value) = pair.split_once('=').ok_or_else(|| format!("\"{pair}\" is not key=value"))?;
        let (key, value) = (key.trim(), value.trim());
        match key {
            "joint" => joint = Some(value.parse().map_err(|_| not_a(key, value, "joint number from 1"))?),
            "from" => start_run = Some(value.parse().map_err(|_| not_a(key, value, "run number from 1"))?),
            "rate" => rate = Some(fraction(key, value)?),
            "cap" => cap = fraction(key, value)?,
            other => return Err(format!("there is no key \"{other}\", only joint, from, rate, cap")),
        }
    }
    let joint: usize = joint.ok_or("joint= is missing")?;
    let start_run: u32 = start_run.ok_or("from= is missing")?;
    let rate_per_run = rate.ok_or("rate= is missing")?;
    let joint = JointIndex::from_number(joint).ok_or("joints count from 1")?;
    if start_run == 0 {
        return Err("runs count from 1".into());
    }
    Ok(Fault::Wear { joint, start_run, rate_per_run, cap })
}

fn fraction(key: &str, value: &str) -> Result<f64, String> {
    match value.parse::<f64>() {
        Ok(number) if number.is_finite() && number >= 0.0 => Ok(number),
        _ => Err(not_a(key, value, "fraction of 0 or more")),
    }
}

fn not_a(key: &str, value: &str, what: &str) -> String {
    format!("{key}={value} is not a {what}")
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Wear { joint, start_run, rate_per_run, cap } => {
                write!(f, "wear:joint={joint},from={start_run},rate={rate_per_run},cap={cap}")
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wear_is_read_and_written() {
        let fault: Fault = "wear:joint=3,from=5,rate=0.03".parse().unwrap();
        let Fault::Wear { joint, start_run, rate_per_run, cap } = fault;
        assert_eq!((joint.number(), start_run, rate_per_run, cap), (3, 5, 0.03, 1.0));
        assert_eq!(fault.to_string().parse::<Fault>().unwrap(), fault);
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
    fn each_mistake_is_named() {
        for (text, part) in [
            ("wear", "colon"),
            ("rust:joint=1", "no kind \"rust\""),
            ("wear:joint=0,from=1,rate=0.1", "count from 1"),
            ("wear:joint=1,from=0,rate=0.1", "runs count from 1"),
            ("wear:joint=1,rate=0.1", "from= is missing"),
            ("wear:joint=1,from=2,rate=-1", "rate=-1"),
            ("wear:joint=1,from=2,rate=nan", "rate=nan"),
            ("wear:joint=1,from=2,speed=3", "no key \"speed\""),
            ("wear:joint=x,from=2,rate=1", "joint=x"),
        ] {
            let message = text.parse::<Fault>().unwrap_err().to_string();
            assert!(message.contains(part), "{text}: {message}");
        }
    }
}
