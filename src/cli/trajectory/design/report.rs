//! What is said of a motion that was found: conditions, limits, and what a recording of it will tell.

use serde_json::{Value, json};

use crate::cli::context::CliError;
use crate::cli::shared::output;
use crate::cli::trajectory::beside::{Beside, Precision};
use crate::cli::trajectory::motion_check::MotionCheck;
use crate::cli::trajectory::words::{nearness, print_nearness};
use crate::design::programme::Programme;
use crate::numerics::model::base_parameters::BaseParameters;
use crate::numerics::pooled::nominal_prior::nominal_base;
use crate::numerics::statistics::distributions::normal_quantile;
use crate::numerics::trajectory::prediction::{Conditioning, Prediction, Recording, predict};
use crate::robot::{FourierExcitation, JointKind, Robot};

/// Probability that a test without a change shows one, and that a test with the smallest change shows it.
const FALSE_ALARM: f64 = 0.001;
const DETECTION: f64 = 0.9;

/// A motion that was found, with all that is said of it.
pub(super) struct DesignReport<'a> {
    pub robot: &'a Robot,
    pub base: &'a BaseParameters,
    pub programme: &'a Programme,
    pub conditions: &'a Conditioning,
    pub judged: &'a MotionCheck<'a>,
    /// What a recording will tell, where the noise is known.
    pub prediction: Option<Predicted<'a>>,
    pub beside: Option<(&'a Beside, &'a Precision)>,
}

/// What a recording of one period will tell.
pub(super) struct Predicted<'a> {
    recording: &'a Recording,
    found: Prediction,
    /// Standard deviations over those of the description's own excitation at equal time: smallest, median and largest.
    against_own: Option<[f64; 3]>,
}

impl<'a> Predicted<'a> {
    pub fn new(
        robot: &Robot,
        base: &BaseParameters,
        series: &FourierExcitation,
        recording: &'a Recording,
    ) -> Result<Self, CliError> {
        let refused =
            |error: crate::numerics::NumericsError| CliError::Usage(format!("{}: {error}", robot.model));
        let found = predict(robot, base, series, recording).map_err(refused)?;
        let own =
            robot.excitation.as_ref().and_then(|own| Some((own, predict(robot, base, own, recording).ok()?)));
        let against_own = own.map(|(own, of_own)| {
            let equal_time = (own.base_frequency / series.base_frequency).sqrt();
            let pairs = found.standard_deviations.iter().zip(&of_own.standard_deviations);
            let mut ratios: Vec<f64> = pairs.map(|(found, own)| equal_time * found / own).collect();
            ratios.sort_by(f64::total_cmp);
            [ratios[0], ratios[ratios.len() / 2], ratios[ratios.len() - 1]]
        });
        Ok(Self { recording, found, against_own })
    }
}

impl DesignReport<'_> {
    pub fn print(&self) {
        let Self { robot, base, conditions, .. } = *self;
        let series = &self.programme.series;
        let search = self.programme.search.as_ref();
        output::line(&format!(
            "Condition number {:.3}, with scaled columns {:.3} ({} parameters, {} Hz, {:.1} s); start {} of {}, {} \
             evaluations",
            conditions.condition_number,
            conditions.scaled_condition_number,
            search.map_or(0, |search| search.parameters.len()),
            search.map_or(0.0, |search| search.sample_rate_hz),
            1.0 / series.base_frequency,
            search.map_or(0, |search| search.best_start + 1),
            search.map_or(0, |search| search.starts),
            search.map_or(0, |search| search.evaluations),
        ));
        output::line("\nHow near the motion comes to the limits");
        print_nearness(robot, series);
        self.judged.print();
        if let Some((beside, precision)) = self.beside {
            beside.print(base, precision, 1.0 / series.base_frequency);
        }
        let Some(Predicted { recording, found: prediction, against_own }) = &self.prediction else { return };
        output::line(&format!(
            "\nStandard deviations that a recording of one period at {} Hz will have under white noise",
            recording.sample_rate_hz
        ));
        let nominal = nominal_base(robot, base);
        let rows: Vec<Vec<String>> = base
            .kept
            .iter()
            .zip(&prediction.standard_deviations)
            .zip(&nominal)
            .map(|((id, std), nominal)| {
                vec![
                    id.to_string(),
                    id.unit(robot.joints[id.joint.index()].kind).to_owned(),
                    format!("{std:.3e}"),
                    nominal.map_or_else(|| "-".to_owned(), |value| format!("{value:.3e}")),
                ]
            })
            .collect();
        output::print_table(&["parameter", "unit", "standard deviation", "nominal value"], &rows, &[]);
        if let Some([smallest, median, largest]) = against_own {
            output::line(&format!(
                "\nThey are {median:.2} of those of the description's own excitation at equal time (median; {smallest:.2} \
                 to {largest:.2})"
            ));
        }
        output::line(&format!(
            "\nSmallest changes that one period shows with probability {DETECTION}, at a false alarm in {:.0} tests, where \
             noise is all that differs",
            1.0 / FALSE_ALARM
        ));
        let factor = smallest_change();
        let mut rows: Vec<Vec<String>> = robot
            .joint_indices()
            .map(|joint| {
                let change = prediction.friction_change[joint.index()];
                let noise = recording.noise[joint.index()];
                let unit = if robot.joints[joint.index()].kind == JointKind::Revolute { "Nm" } else { "N" };
                vec![
                    format!("friction of joint {joint}"),
                    format!("{noise} {unit}"),
                    change.map_or_else(|| "-".to_owned(), |std| format!("{:.2} %", 100.0 * factor * std)),
                ]
            })
            .collect();
        let load =
            prediction.load_change.map_or_else(|| "-".to_owned(), |std| format!("{:.3} kg", factor * std));
        rows.push(vec!["load at the tool frame".to_owned(), String::new(), load]);
        output::print_table(&["what changes", "torque noise", "smallest change"], &rows, &[]);
    }

    pub fn as_value(&self) -> Value {
        let Self { robot, base, programme, conditions, .. } = *self;
        let prediction = self.prediction.as_ref().map(|of| &of.found);
        let parameters = |prediction: &Prediction| -> Vec<Value> {
            let each = base.kept.iter().zip(&prediction.standard_deviations);
            each.map(|(id, std)| {
                json!({
                    "parameter": id.to_string(),
                    "unit": id.unit(robot.joints[id.joint.index()].kind),
                    "standard_deviation": std,
                })
            })
            .collect()
        };
        let changes = |prediction: &Prediction| {
            let factor = smallest_change();
            let friction: Vec<Option<f64>> =
                prediction.friction_change.iter().map(|of| of.map(|of| factor * of)).collect();
            json!({
                "false_alarm_probability": FALSE_ALARM,
                "detection_probability": DETECTION,
                "friction_fraction": friction,
                "load_kg": prediction.load_change.map(|of| factor * of),
            })
        };
        let against_own = self.prediction.as_ref().and_then(|of| of.against_own);
        json!({
            "robot": robot.model,
            "condition_number": conditions.condition_number,
            "scaled_condition_number": conditions.scaled_condition_number,
            "limits": nearness(robot, &programme.series),
            "torques": self.judged.torque_value(),
            "clearances": self.judged.clearance_value(),
            "search": programme.search,
            "parameters": prediction.map(parameters),
            "against_own_excitation": against_own.map(|[smallest, median, largest]| {
                json!({ "smallest": smallest, "median": median, "largest": largest })
            }),
            "smallest_changes": prediction.map(changes),
            "beside": self.beside.map(|(beside, precision)| beside.as_value(base, precision)),
        })
    }
}

/// Standard deviations of the smallest change that is found with probability [`DETECTION`] at [`FALSE_ALARM`], in both
/// directions.
fn smallest_change() -> f64 {
    normal_quantile(1.0 - 0.5 * FALSE_ALARM) + normal_quantile(DETECTION)
}
