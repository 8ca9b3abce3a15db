//! Figures of alarms in words, with the unit of their quantity.

/// How a figure of a quantity is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Form {
    /// A pure number.
    Plain,
    /// A fraction, told in percent.
    Percent,
    /// A multiple of what is usual.
    Times,
    /// The logarithm of a multiple.
    LogarithmOfTimes,
    /// Standard errors.
    StandardErrors,
    /// Nm.
    Torque,
    /// kg.
    Mass,
    /// rad, or m of a sliding joint.
    Position,
}

impl Form {
    fn of(self, value: f64) -> String {
        match self {
            Self::Plain => figure(value),
            Self::Percent => format!("{} %", figure(100.0 * value)),
            Self::Times => format!("{} times", figure(value)),
            Self::LogarithmOfTimes => format!("{} times", figure(value.exp())),
            Self::StandardErrors => format!("{} standard errors", figure(value)),
            Self::Torque => format!("{} Nm", figure(value)),
            Self::Mass => format!("{} kg", figure(value)),
            Self::Position => format!("{} rad (m)", figure(value)),
        }
    }
}

/// How values and scores of one anomaly are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Figures {
    value: Form,
    score: Form,
}

impl Figures {
    /// Of a quantity of this kind of anomaly. `baseline` and `threshold` tell an offset of a torque signal, noise and gain
    /// apart, and a step inside a test, which is a ratio by whatever friction the joint is judged.
    pub(super) fn new(quantity: &str, kind: &str, baseline: Option<f64>, threshold: Option<f64>) -> Self {
        let of_torque_signal = match (baseline, threshold) {
            (Some(0.0), _) => (Form::Torque, Form::Torque),
            (_, Some(1.0..)) => (Form::Times, Form::Times),
            _ => (Form::Times, Form::Percent),
        };
        let of_friction = match (kind, baseline) {
            ("step", Some(1.0)) => Form::Plain,
            _ => Form::Torque,
        };
        let (value, score) = match quantity {
            "friction_index" | "common_friction_ratio" => (Form::Plain, Form::Percent),
            "warm_friction_nm" | "excitation_friction_nm" => (of_friction, Form::Percent),
            "friction_swing" | "moving_relative_rmsd" | "production_relative_rmsd" => {
                (Form::Percent, Form::Percent)
            }
            "warm_up_time_ratio" | "common_warm_up_time_ratio" => (Form::Times, Form::LogarithmOfTimes),
            "friction_of_model_nm" => (Form::Torque, Form::LogarithmOfTimes),
            "rmsd_of_model" => (Form::Percent, Form::LogarithmOfTimes),
            "load_kg" | "production_load_kg" => (Form::Mass, Form::StandardErrors),
            "torque_signal" | "production_torque_signal" => of_torque_signal,
            "position_offset_rad" => (Form::Position, Form::Position),
            "unexplained_torque" => (Form::Times, Form::Times),
            "contact" => (Form::Percent, Form::Times),
            "production_friction" => (Form::Times, Form::Percent),
            _ => (Form::Plain, Form::Plain),
        };
        Self { value, score }
    }

    /// A value of the quantity.
    pub(super) fn value(self, value: f64) -> String {
        self.value.of(value)
    }

    /// A value with its sign, as a change of it.
    pub(super) fn change(self, value: f64) -> String {
        if value > 0.0 { format!("+{}", self.value.of(value)) } else { self.value.of(value) }
    }

    /// A score, or the limit of one.
    pub(super) fn score(self, score: f64) -> String {
        self.score.of(score)
    }
}

/// A figure with four digits that count.
fn figure(value: f64) -> String {
    if value == 0.0 || !value.is_finite() {
        return value.to_string();
    }
    // between -300 and 300
    let before_point = value.abs().log10().floor() as i32;
    let decimals = usize::try_from(3 - before_point).unwrap_or(0).min(12);
    let text = format!("{value:.decimals$}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_have_four_digits() {
        let shown: Vec<String> = [1.0, 0.012_345_6, 123.456, 12_345.6, -0.5, 0.0].map(figure).into();
        assert_eq!(shown, ["1", "0.01235", "123.5", "12346", "-0.5", "0"]);
    }

    #[test]
    fn a_figure_has_the_unit_of_its_quantity() {
        let said = |quantity: &str, baseline: f64, threshold: f64, value: f64, score: f64| {
            let figures = Figures::new(quantity, "sensor", Some(baseline), Some(threshold));
            (figures.value(value), figures.score(score))
        };
        for (found, value, score) in [
            (said("load_kg", 0.0, 5.0, 0.7974, 151.0), "0.7974 kg", "151 standard errors"),
            (said("torque_signal", 0.0, 0.0, -3.25, 3.25), "-3.25 Nm", "3.25 Nm"),
            (said("torque_signal", 1.0, 1.5, 2.5, 2.5), "2.5 times", "2.5 times"),
            (said("production_torque_signal", 1.0, 0.03, 1.05, 0.05), "1.05 times", "5 %"),
            (said("contact", 0.05, 1.5, 0.3, 6.183), "30 %", "6.183 times"),
            (said("friction_of_model_nm", 11.0, 0.5, 22.0, 2.0_f64.ln()), "22 Nm", "2 times"),
            (said("friction_index", 1.0, 0.05, 1.24, 0.24), "1.24", "24 %"),
        ] {
            assert_eq!((found.0.as_str(), found.1.as_str()), (value, score));
        }
        let step = Figures::new("warm_friction_nm", "step", Some(1.0), Some(0.05));
        assert_eq!((step.value(1.25), step.change(0.5)), ("1.25".into(), "+0.5".into()));
    }

    /// Quantities that no figure measures: their values are absent, so that they have no unit either.
    const WITHOUT_FIGURE: [&str; 7] = [
        "inertial_parameters",
        "position_signal",
        "velocity_signal",
        "time_stamps",
        "rows",
        "motion",
        "model",
    ];

    #[test]
    fn every_quantity_that_a_detector_names_has_a_form() {
        for name in armwatch_model::anomaly::settled::QUANTITIES {
            let figures = Figures::new(name, "drift", None, None);
            let is_plain = figures == Figures { value: Form::Plain, score: Form::Plain };
            assert_eq!(is_plain, WITHOUT_FIGURE.contains(&name), "{name}");
        }
    }
}
