//! Finds the shortest addition to a motion that a robot performs anyway.

use clap::Args;
use serde_json::{Value, json};

use crate::cli::context::{CliError, Global, open_to_read, runtime};
use crate::cli::shared::output;
use crate::cli::trajectory::limit_texts::without_numbers;
use crate::pipeline::stored::run_information::run_information;
use armwatch_method::NumericsError;
use armwatch_method::model::base_parameters::BaseParameters;
use armwatch_model::robot::{FourierExcitation, Robot};
use armwatch_trajectory::information::Information;
use armwatch_trajectory::recorded_rows::RecordingPlan;

/// Durations that are tried, s, up to that of the requested motion.
const DURATIONS_S: [f64; 9] = [1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 9.0, 13.0, 20.0];

#[derive(Debug, Clone, Args)]
pub(super) struct BesideArgs {
    /// Run of a production log: find the shortest motion that shows the parameters that this log does not show
    #[arg(help_heading = "Addition to production", long, value_name = "RUN")]
    beside_run: Option<i64>,
    /// Duration of that log's motion that counts as known, s
    #[arg(
        help_heading = "Addition to production",
        long,
        default_value_t = 60.0,
        value_name = "S",
        requires = "beside_run"
    )]
    beside_s: f64,
    /// Largest allowed standard deviation of every parameter, as a fraction of its nominal size
    #[arg(
        help_heading = "Addition to production",
        long,
        default_value_t = 0.1,
        value_name = "FRACTION",
        requires = "beside_run"
    )]
    precision: f64,
}

/// Information of production about the parameters.
pub(super) struct ProductionPrecision {
    pub run: i64,
    pub seconds: f64,
    precision: f64,
    /// At the rate and noise of the requested recording.
    information: Information,
    /// Reference values of the standard deviations, `[b]`.
    sizes: Vec<f64>,
}

/// Standard deviations with and without an addition, `[b]`; `None` if the parameter is not identified.
pub(super) struct Precision {
    alone: Vec<Option<f64>>,
    together: Vec<Option<f64>>,
}

impl BesideArgs {
    /// Returns true if the information of production is used.
    pub fn is_asked(&self) -> bool {
        self.beside_run.is_some()
    }

    /// The information of the recording; `None` if none is named. `sizes` are for all base parameters.
    pub fn read(
        &self,
        global: &Global,
        robot: &Robot,
        base: &BaseParameters,
        recording: Option<&RecordingPlan>,
        sizes: Vec<f64>,
    ) -> Result<Option<ProductionPrecision>, CliError> {
        let Some(run) = self.beside_run else { return Ok(None) };
        let possible =
            [("--beside-s", self.beside_s, 1.0, 86_400.0), ("--precision", self.precision, 1e-6, 1.0)];
        if let Some((option, value, low, high)) =
            possible.into_iter().find(|(_, value, low, high)| !(value >= low && value <= high))
        {
            return Err(CliError::Usage(format!("{option} {value}: {low} to {high} is possible")));
        }
        let Some(recording) = recording else {
            return Err(CliError::Usage(
                "--beside-run needs the noise of every torque signal; give --noise-nm".into(),
            ));
        };
        if robot.joints.iter().any(|joint| joint.nominal.is_none()) {
            return Err(CliError::Usage(
                "--beside-run needs nominal parameters of all joints, as the reference of precision".into(),
            ));
        }
        let config = global.read_config()?;
        let shown = runtime()?.block_on(async {
            let store = open_to_read(&config).await?;
            let shown = run_information(&store, run, robot, base, &recording.noise).await;
            store.close().await?;
            shown.map_err(|error| CliError::Usage(error.to_string()))
        })?;
        // all rows of a recording would count model errors as noise that averages out
        let share = self.beside_s * recording.sample_rate_hz / shown.rows as f64;
        let information = shown.information.times(share);
        Ok(Some(ProductionPrecision {
            run,
            seconds: self.beside_s,
            precision: self.precision,
            information,
            sizes,
        }))
    }
}

impl ProductionPrecision {
    /// Durations to try, s, in increasing order; the last is `longest`.
    pub fn durations(longest: f64) -> Vec<f64> {
        let shorter = DURATIONS_S.into_iter().filter(|duration| *duration < longest);
        shorter.chain([longest]).collect()
    }

    /// The known information, scaled for a search with `instants` instants in `duration`, s.
    pub fn known(&self, recording: &RecordingPlan, duration: f64, instants: usize) -> Information {
        self.information.times(instants as f64 / (recording.sample_rate_hz * duration))
    }

    /// Standard deviations of the recording alone, and with one period of `series`.
    pub fn precision(
        &self,
        robot: &Robot,
        base: &BaseParameters,
        series: &FourierExcitation,
        recording: &RecordingPlan,
    ) -> Result<Precision, CliError> {
        let fault = |error: NumericsError| without_numbers(&robot.model, series, &error);
        let addition = Information::of_series(robot, base, series, recording).map_err(fault)?;
        let together = self.information.with(&addition);
        Ok(Precision {
            alone: self.information.standard_deviations(&self.sizes).map_err(fault)?,
            together: together.standard_deviations(&self.sizes).map_err(fault)?,
        })
    }

    /// Number of parameters whose standard deviation is at most the requested precision.
    fn precise(&self, standard_deviations: &[Option<f64>]) -> usize {
        let is_precise =
            |(std, size): &(&Option<f64>, &f64)| std.is_some_and(|std| std <= self.precision * *size);
        standard_deviations.iter().zip(&self.sizes).filter(is_precise).count()
    }

    /// Number of parameters that miss the requested precision with the addition.
    pub fn missed(&self, precision: &Precision) -> usize {
        self.sizes.len() - self.precise(&precision.together)
    }

    /// Prints a table of all parameters, and the result in a sentence.
    pub fn print(&self, base: &BaseParameters, precision: &Precision, seconds: f64) {
        let number = |(std, size): (&Option<f64>, &f64)| {
            std.map_or_else(|| "not seen".to_owned(), |std| format!("{:.2} %", 100.0 * std / size))
        };
        let rows: Vec<Vec<String>> = base
            .kept
            .iter()
            .zip(precision.alone.iter().zip(&self.sizes))
            .zip(precision.together.iter().zip(&self.sizes))
            .map(|((id, alone), together)| vec![id.to_string(), number(alone), number(together)])
            .collect();
        output::line("");
        output::line(&format!(
            "Standard deviations as fractions of nominal sizes, for {} s of run {} and with the addition of \
            {seconds} s",
            self.seconds, self.run
        ));
        output::print_table(&["parameter", "production only", "with the addition"], &rows, &[]);
        let (missed, all) = (self.missed(precision), self.sizes.len());
        let before = all - self.precise(&precision.alone);
        output::line(&match missed {
            0 => format!(
                "{before} of {all} parameters are not known to {:.3} % from production; with {seconds} s \
                more, all are",
                100.0 * self.precision
            ),
            _ => format!(
                "{missed} of {all} parameters are not known to {:.3} % even with {seconds} s more; allow a \
                longer motion (--seconds), or allow a larger standard deviation (--precision)",
                100.0 * self.precision
            ),
        });
    }

    /// The same for scripts.
    pub fn as_value(&self, base: &BaseParameters, precision: &Precision) -> Value {
        let each = base.kept.iter().zip(&self.sizes).zip(precision.alone.iter().zip(&precision.together));
        let parameters: Vec<Value> = each
            .map(|((id, size), (alone, together))| {
                json!({
                    "parameter": id.to_string(), "size": size, "standard_deviation_alone": alone,
                    "standard_deviation_together": together,
                })
            })
            .collect();
        json!({
            "run": self.run, "seconds": self.seconds, "precision": self.precision,
            "missed": self.missed(precision), "parameters": parameters,
        })
    }
}
