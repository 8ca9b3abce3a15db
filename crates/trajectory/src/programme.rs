//! Programmes of test motions as JSON files; `docs/trajectories.md` has their schema.

use serde::{Deserialize, Serialize};
use serde_json::Value;

use armwatch_model::robot::{FourierExcitation, JointKind, MAX_JOINTS, Robot};

/// Value of the key `format`.
const FORMAT: &str = "armwatch-trajectory";
/// The version that is written and accepted.
const VERSION: u32 = 1;

/// A test motion with its origin.
#[derive(Debug, Clone, PartialEq)]
pub struct Programme {
    /// Name of the arm's model.
    pub model: String,
    /// Types of the joints.
    pub kinds: Vec<JointKind>,
    /// The motion.
    pub series: FourierExcitation,
    /// How it was found; `None` if it was written by hand.
    pub search: Option<SearchRecord>,
}

/// How a series was found, so that it can be found again.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SearchRecord {
    /// Version of the program.
    pub armwatch: String,
    /// The minimised objective.
    pub objective: String,
    /// Names of the parameters of the objective.
    pub parameters: Vec<String>,
    /// The kind of waves: `harmonic-sine`, or `None` for sines and cosines.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub form: Option<String>,
    /// Seed of the random starts.
    pub seed: u64,
    /// Starts that were tried.
    pub starts: u64,
    /// The start of this series, from 0.
    pub best_start: u64,
    /// Evaluations of cost and slope.
    pub evaluations: u64,
    /// Value of each start.
    pub values: Vec<Option<f64>>,
    /// Share of the range that was allowed.
    pub position_share: f64,
    /// Share of the largest speeds.
    pub speed_share: f64,
    /// Share of the largest accelerations.
    pub acceleration_share: f64,
    /// Condition number of the observation matrix of `parameters`, SI units.
    pub condition_number: f64,
    /// The same with columns scaled to unit norm.
    pub scaled_condition_number: f64,
    /// Rows per second of that matrix, Hz.
    pub sample_rate_hz: f64,
    /// Run whose motion counts as known, and its duration in seconds; `None` if there was none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub beside: Option<BesideRecord>,
}

/// Motion that a search assumes to be recorded already.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BesideRecord {
    /// The run.
    pub run: i64,
    /// Seconds of its motion.
    pub seconds: f64,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct ProgrammeFile {
    format: String,
    version: u32,
    robot: String,
    base_frequency_hz: f64,
    joints: Vec<FileJoint>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    search: Option<SearchRecord>,
}

#[derive(Serialize, Deserialize)]
#[serde(tag = "type", rename_all = "lowercase", deny_unknown_fields)]
enum FileJoint {
    Revolute { centre_rad: f64, a_rad_s: Vec<f64>, b_rad_s: Vec<f64> },
    Prismatic { centre_m: f64, a_m_s: Vec<f64>, b_m_s: Vec<f64> },
}

impl Programme {
    /// The programme as JSON text.
    ///
    /// # Errors
    /// The message for a number that JSON does not support; a search gives none.
    pub fn json(&self) -> Result<String, String> {
        let joint = |(j, kind): (usize, &JointKind)| {
            let (centre, a, b) = (self.series.centre[j], self.series.a[j].clone(), self.series.b[j].clone());
            match kind {
                JointKind::Revolute => FileJoint::Revolute { centre_rad: centre, a_rad_s: a, b_rad_s: b },
                JointKind::Prismatic => FileJoint::Prismatic { centre_m: centre, a_m_s: a, b_m_s: b },
            }
        };
        let file = ProgrammeFile {
            format: FORMAT.to_owned(),
            version: VERSION,
            robot: self.model.clone(),
            base_frequency_hz: self.series.base_frequency,
            joints: self.kinds.iter().enumerate().map(joint).collect(),
            search: self.search.clone(),
        };
        serde_json::to_string_pretty(&file).map(|text| text + "\n").map_err(|error| error.to_string())
    }

    /// Reads a programme.
    ///
    /// # Errors
    /// The fault in the text, with its line if known.
    pub fn parse(text: &str) -> Result<Self, String> {
        let value: Value = serde_json::from_str(text).map_err(|error| format!("not JSON: {error}"))?;
        let format = value.get("format").and_then(Value::as_str);
        if format != Some(FORMAT) {
            return Err(format!(
                "no programme: its key format is {}, not \"{FORMAT}\"",
                format.map_or_else(|| "missing".to_owned(), |format| format!("\"{format}\""))
            ));
        }
        let version = value.get("version").and_then(Value::as_u64);
        if version != Some(u64::from(VERSION)) {
            return Err(format!(
                "version {} of a programme; this program reads version {VERSION}",
                value.get("version").unwrap_or(&Value::Null)
            ));
        }
        let file: ProgrammeFile = serde_json::from_str(text).map_err(|error| error.to_string())?;
        let mut series = FourierExcitation {
            base_frequency: file.base_frequency_hz,
            a: Vec::new(),
            b: Vec::new(),
            centre: Vec::new(),
        };
        let mut kinds = Vec::new();
        for joint in file.joints {
            let (kind, centre, a, b) = match joint {
                FileJoint::Revolute { centre_rad, a_rad_s, b_rad_s } => {
                    (JointKind::Revolute, centre_rad, a_rad_s, b_rad_s)
                }
                FileJoint::Prismatic { centre_m, a_m_s, b_m_s } => {
                    (JointKind::Prismatic, centre_m, a_m_s, b_m_s)
                }
            };
            kinds.push(kind);
            series.centre.push(centre);
            series.a.push(a);
            series.b.push(b);
        }
        let harmonics = series.a.first().map_or(0, Vec::len);
        if !(file.base_frequency_hz > 0.0 && file.base_frequency_hz <= 100.0) {
            return Err(format!("base_frequency_hz {}: above 0 to 100 Hz", file.base_frequency_hz));
        }
        if kinds.is_empty() || kinds.len() > MAX_JOINTS {
            return Err(format!("{} joints; 1 to {MAX_JOINTS} are possible", kinds.len()));
        }
        for (number, (a, b)) in (1..).zip(series.a.iter().zip(&series.b)) {
            if harmonics == 0 || a.len() != harmonics || b.len() != harmonics {
                return Err(format!(
                    "joint {number} has {} and {} amplitudes; each joint needs as many of both, {harmonics} as the \
                     first one",
                    a.len(),
                    b.len()
                ));
            }
        }
        Ok(Self { model: file.robot, kinds, series, search: file.search })
    }

    /// Checks that this programme fits `robot`.
    ///
    /// # Errors
    /// The reason why it does not.
    pub fn fits(&self, robot: &Robot) -> Result<(), String> {
        let of_robot: Vec<JointKind> = robot.joints.iter().map(|joint| joint.kind).collect();
        if of_robot == self.kinds {
            return Ok(());
        }
        let differs = match of_robot.len() == self.kinds.len() {
            true => "joints of other types".to_owned(),
            false => joints(of_robot.len()),
        };
        Err(format!(
            "a programme of {} for model {}, but model {} has {differs}; give the description that it was designed for with \
             --robot",
            joints(self.kinds.len()),
            self.model,
            robot.model,
        ))
    }
}

fn joints(count: usize) -> String {
    format!("{count} joint{}", if count == 1 { "" } else { "s" })
}

#[cfg(test)]
mod tests {
    use super::*;
    use armwatch_testing::er3a;

    fn programme() -> Programme {
        let robot = er3a();
        Programme {
            model: robot.model.clone(),
            kinds: vec![JointKind::Revolute; 6],
            series: robot.excitation.expect("Table 4.1"),
            search: None,
        }
    }

    #[test]
    fn what_is_written_is_read_with_every_digit() {
        let mut programme = programme();
        programme.series.centre[2] = 0.1 + 0.2;
        programme.kinds[3] = JointKind::Prismatic;
        let text = programme.json().expect("JSON");
        assert!(text.contains("\"centre_m\"") && text.contains("\"a_rad_s\""), "{text}");
        assert_eq!(Programme::parse(&text), Ok(programme.clone()));
        assert!(programme.fits(&er3a()).expect_err("a sliding joint").contains("er3a"));
    }

    #[test]
    fn what_is_no_programme_is_refused_with_the_reason() {
        let text = programme().json().expect("JSON");
        for (changed, said) in [
            (text.replace("armwatch-trajectory", "other"), "its key format is \"other\""),
            (text.replace("\"version\": 1", "\"version\": 2"), "reads version 1"),
            (text.replace("\"base_frequency_hz\": 0.1", "\"base_frequency_hz\": 0"), "above 0 to 100 Hz"),
            (text.replacen("0.2428,", "", 1), "joint 1 has 4 and 5 amplitudes"),
            (text.replace("\"robot\"", "\"robo\""), "robo"),
            ("{}".to_owned(), "its key format is missing"),
            ("[1".to_owned(), "not JSON"),
        ] {
            let error = Programme::parse(&changed).expect_err(said);
            assert!(error.contains(said), "{error}");
        }
    }
}
