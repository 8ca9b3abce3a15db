//! Faults in the notation of the command line, such as `wear:joint=3,from=5,rate=0.03`.

use std::collections::BTreeMap;
use std::fmt;
use std::str::FromStr;

use super::{DEFAULT_CAP, Fault, FaultKind, WornPart};
use armwatch_model::robot::JointIndex;

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
            Self::Delay { .. } => "delay",
            Self::Backlash { .. } => "backlash",
            Self::Ripple { .. } => "ripple",
            Self::Contact { .. } => "contact",
        }
    }

    /// Keys and values in this notation.
    fn keys(self) -> Vec<(&'static str, String)> {
        let one = |key, value: f64| vec![(key, value.to_string())];
        match self {
            Self::Wear { part, rate_per_run, cap } => {
                let own = (part != WornPart::All).then(|| ("part", part.name().to_owned()));
                own.into_iter()
                    .chain([("rate", rate_per_run.to_string()), ("cap", cap.to_string())])
                    .collect()
            }
            Self::Step { size, cycle } => vec![("size", size.to_string()), ("cycle", cycle.to_string())],
            Self::Jitter { size } | Self::Gain { size } => one("size", size),
            Self::WarmUp { factor } | Self::Noise { factor } => one("factor", factor),
            Self::Load { mass, centre: [x, y, z] } => {
                vec![("kg", mass.to_string()), ("centre", format!("{x}/{y}/{z}"))]
            }
            Self::Offset { torque } | Self::Saturation { torque } => one("nm", torque),
            Self::Zero { position } => one("rad", position),
            Self::Delay { seconds } => one("s", seconds),
            Self::Backlash { play } => one("rad", play),
            Self::Ripple { rate_per_run } => one("rate", rate_per_run),
            Self::Stuck => Vec::new(),
            Self::Contact { torque, cycle } => vec![("nm", torque.to_string()), ("cycle", cycle.to_string())],
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

    fn worn_part(&mut self, key: &str) -> Result<WornPart, String> {
        let Some(value) = self.0.remove(key) else { return Ok(WornPart::All) };
        let found = WornPart::ALL.into_iter().find(|part| part.name() == value);
        found.ok_or_else(|| not_a(key, value, "part of friction: all, coulomb, viscous, linear, load"))
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
            FaultKind::Wear { part: keys.worn_part("part")?, rate_per_run: keys.fraction("rate")?, cap }
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
        "delay" => FaultKind::Delay { seconds: keys.number("s", "time of 0 s or more", |of| of >= 0.0)? },
        "backlash" => {
            FaultKind::Backlash { play: keys.number("rad", "angle of 0 rad or more", |of| of >= 0.0)? }
        }
        "ripple" => FaultKind::Ripple { rate_per_run: keys.fraction("rate")? },
        "stuck" => FaultKind::Stuck,
        "contact" => FaultKind::Contact {
            torque: keys.number("nm", "torque", any)?,
            cycle: keys.count("cycle", "cycle")?.unwrap_or(1),
        },
        other => {
            return Err(format!(
                "there is no kind \"{other}\", only wear, step, jitter, warm-up, load, offset, gain, noise, zero, \
                 saturation, delay, backlash, ripple, stuck, contact"
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
            "wear:joint=3,from=5,part=linear,rate=0.04,cap=0.6",
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
            "delay:joint=4,from=6,s=0.02",
            "backlash:joint=3,from=6,rad=0.002",
            "ripple:joint=2,from=7,rate=0.15",
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
            ("wear:joint=1,from=2,rate=1,part=seal", "part=seal is not a part of friction"),
            ("load:joint=2,from=1,kg=1", "has no joint"),
            ("load:from=1,kg=1,centre=1/2", "X/Y/Z"),
            ("step:joint=1,from=1,size=-2", "above -1"),
        ] {
            let message = text.parse::<Fault>().unwrap_err().to_string();
            assert!(message.contains(part), "{text}: {message}");
        }
    }
}
