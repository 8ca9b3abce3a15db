//! Report on a designed motion: condition numbers, limits, and the predicted results of a recording.

use serde_json::{Value, json};

use crate::cli::context::CliError;
use crate::cli::shared::output;
use crate::cli::trajectory::beside::{Precision, ProductionPrecision};
use crate::cli::trajectory::limit_texts::{nearness, print_nearness, without_numbers};
use crate::cli::trajectory::motion_check::MotionCheck;
use armwatch_method::detect::rate::budget::Budget;
use armwatch_method::model::base_parameters::BaseParameters;
use armwatch_method::pooled::nominal_prior::nominal_base;
use armwatch_method::statistics::distributions::{normal_probability, normal_quantile};
use armwatch_model::robot::{FourierExcitation, JointKind, Robot};
use armwatch_trajectory::prediction::{Conditioning, Prediction, predict};
use armwatch_trajectory::programme::Programme;
use armwatch_trajectory::recorded_rows::RecordingPlan;

/// Probability that a test detects the smallest change.
const DETECTION: f64 = 0.9;

/// A designed motion, with all data of the report.
pub(super) struct DesignReport<'a> {
    pub robot: &'a Robot,
    pub base: &'a BaseParameters,
    pub programme: &'a Programme,
    pub conditions: &'a Conditioning,
    pub judged: &'a MotionCheck<'a>,
    /// Predicted results of a recording, if the noise is known.
    pub prediction: Option<PredictedRecording<'a>>,
    /// Growth of a joint's friction, a fraction, and a load, kg; their probability of detection is reported.
    pub wear: f64,
    pub load_kg: f64,
    pub beside: Option<(&'a ProductionPrecision, &'a Precision)>,
}

/// Predicted results of a recording of one period.
pub(super) struct PredictedRecording<'a> {
    recording: &'a RecordingPlan,
    found: Prediction,
    /// Share of the false alarms that a test may use.
    budget: Budget,
    /// Standard deviations relative to those of the description's own excitation at equal time: smallest, median and
    /// largest.
    against_own: Option<[f64; 3]>,
}

impl<'a> PredictedRecording<'a> {
    pub fn new(
        robot: &Robot,
        base: &BaseParameters,
        series: &FourierExcitation,
        recording: &'a RecordingPlan,
        budget: Budget,
    ) -> Result<Self, CliError> {
        let found = predict(robot, base, series, recording)
            .map_err(|error| without_numbers(&robot.model, series, &error))?;
        let own =
            robot.excitation.as_ref().and_then(|own| Some((own, predict(robot, base, own, recording).ok()?)));
        let against_own = own.map(|(own, of_own)| {
            let equal_time = (own.base_frequency / series.base_frequency).sqrt();
            let pairs = found.standard_deviations.iter().zip(&of_own.standard_deviations);
            let mut ratios: Vec<f64> = pairs.map(|(found, own)| equal_time * found / own).collect();
            ratios.sort_by(f64::total_cmp);
            [ratios[0], ratios[ratios.len() / 2], ratios[ratios.len() - 1]]
        });
        Ok(Self { recording, found, budget, against_own })
    }

    /// Change in standard deviations that is significant, in either direction.
    fn limit(&self) -> f64 {
        normal_quantile(1.0 - 0.5 * self.budget.alpha())
    }

    /// Smallest change that one test detects with probability [`DETECTION`], in standard deviations.
    fn smallest(&self) -> f64 {
        self.limit() + normal_quantile(DETECTION)
    }

    /// Probability that one test detects a change of this many standard deviations.
    fn chance(&self, change: f64) -> f64 {
        let limit = self.limit();
        normal_probability(change - limit) + normal_probability(-change - limit)
    }
}

impl DesignReport<'_> {
    pub fn print(&self) {
        let Self { robot, base, conditions, .. } = *self;
        let series = &self.programme.series;
        let search = self.programme.search.as_ref();
        output::line(&format!(
            "Condition number {:.3}, with scaled columns {:.3} (parameters: {}; {} Hz, {:.1} s); start {} of {}, {} \
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
        output::line("");
        output::line("Distance of the motion from the limits");
        print_nearness(robot, series);
        self.judged.print();
        if let Some((beside, precision)) = self.beside {
            beside.print(base, precision, 1.0 / series.base_frequency);
        }
        let Some(predicted) = &self.prediction else { return };
        let PredictedRecording { recording, found: prediction, against_own, .. } = predicted;
        output::line("");
        output::line(&format!(
            "Standard deviations from a recording of one period at {} Hz with white noise",
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
            output::line("");
            output::line(&format!(
                "They are {median:.2} of those of the description's own excitation at equal time (median; {smallest:.2} \
                 to {largest:.2})"
            ));
        }
        self.print_changes(predicted);
    }

    /// Prints the detection of the selected faults with one period.
    fn print_changes(&self, predicted: &PredictedRecording<'_>) {
        let PredictedRecording { recording, found, budget, .. } = predicted;
        output::line("");
        output::line(&format!(
            "Detection in one period if only noise differs, with {} per robot and year, shared among {:.0} \
            tests of {} channels (probability {:.1e} each): the smallest change detected with probability \
            {DETECTION}, and the probability to detect a given change in one test",
            output::counted(budget.per_robot_year, "false alarm"),
            budget.tests_per_year,
            budget.channels,
            budget.alpha(),
        ));
        let row = |change: String, noise: String, std: Option<f64>, size: f64, unit: &str, scale: f64| {
            let smallest = |std: f64| predicted.smallest() * std;
            let number = |value: f64| format!("{:.3} {unit}", scale * value);
            let told = |of: &dyn Fn(f64) -> String| std.map_or_else(|| "-".to_owned(), of);
            vec![
                change,
                noise,
                told(&number),
                told(&|std| number(smallest(std))),
                told(&|std| percent(predicted.chance(size / std))),
            ]
        };
        let mut rows: Vec<Vec<String>> = self
            .robot
            .joint_indices()
            .map(|joint| {
                let unit =
                    if self.robot.joints[joint.index()].kind == JointKind::Revolute { "Nm" } else { "N" };
                let noise = format!("{} {unit}", recording.noise[joint.index()]);
                let change = format!("wear of joint {joint} by {} %", round(100.0 * self.wear));
                row(change, noise, found.friction_change[joint.index()], self.wear, "%", 100.0)
            })
            .collect();
        let load = format!("{} kg more load", self.load_kg);
        rows.push(row(load, String::new(), found.load_change, self.load_kg, "kg", 1.0));
        output::print_table(
            &[
                "what changes",
                "torque noise",
                "standard deviation",
                "smallest change",
                "detected in one test",
            ],
            &rows,
            &[],
        );
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
        let changes = |predicted: &PredictedRecording<'_>| {
            let found = &predicted.found;
            let each = |of: &dyn Fn(f64) -> f64| -> Vec<Option<f64>> {
                found.friction_change.iter().map(|std| std.map(of)).collect()
            };
            json!({
                "false_alarms_per_robot_year": predicted.budget.per_robot_year,
                "tests_per_year": predicted.budget.tests_per_year,
                "channels": predicted.budget.channels,
                "false_alarm_probability": predicted.budget.alpha(),
                "detection_probability": DETECTION,
                "friction_fraction": each(&|std| predicted.smallest() * std),
                "friction_standard_deviation": found.friction_change,
                "load_kg": found.load_change.map(|std| predicted.smallest() * std),
                "load_standard_deviation_kg": found.load_change,
                "wear": {
                    "size": self.wear,
                    "seen_in_one_test": each(&|std| predicted.chance(self.wear / std)),
                },
                "load": {
                    "size_kg": self.load_kg,
                    "seen_in_one_test": found.load_change.map(|std| predicted.chance(self.load_kg / std)),
                },
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
            "smallest_changes": self.prediction.as_ref().map(changes),
            "beside": self.beside.map(|(beside, precision)| beside.as_value(base, precision)),
        })
    }
}

/// A probability in per cent, never rounded to 0 or 100.
fn percent(probability: f64) -> String {
    match 100.0 * probability {
        of if of > 99.9 => "above 99.9 %".to_owned(),
        of if of < 0.1 => "below 0.1 %".to_owned(),
        of => format!("{of:.1} %"),
    }
}

/// Removes spurious digits of decimal products.
fn round(value: f64) -> f64 {
    (1e9 * value).round() / 1e9
}
