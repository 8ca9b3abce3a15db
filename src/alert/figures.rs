//! Values and scores of alarms in words, with the unit of their quantity.

use crate::language::{Language, number, say};
use armwatch_model::anomaly::quantity::{Form, Quantity};

/// Formats values and scores of a quantity.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Figures(pub(super) Quantity, pub(super) Language);

impl Figures {
    /// A value of the quantity.
    pub(super) fn value(self, value: f64) -> String {
        self.written(self.0.value_form(), value)
    }

    /// A value with its sign, as a change of it.
    pub(super) fn change(self, value: f64) -> String {
        if value > 0.0 { format!("+{}", self.value(value)) } else { self.value(value) }
    }

    /// A score, or the limit of one.
    pub(super) fn score(self, score: f64) -> String {
        self.written(self.0.score_form(), score)
    }

    fn written(self, form: Form, value: f64) -> String {
        let figure = |value: f64| number(self.1, figure(value));
        let said = |english: &str, value: f64| say(self.1, english, &[&figure(value)]);
        match form {
            Form::Number | Form::Ratio => figure(value),
            Form::Fraction => format!("{} %", figure(100.0 * value)),
            Form::Times => said("{0} times", value),
            Form::TimesOfLogarithm => said("{0} times", value.exp()),
            Form::StandardErrors => said("{0} standard errors", value),
            Form::WithUnit => format!("{} {}", figure(value), self.0.unit().unwrap_or_default()),
        }
    }
}

/// A value with four significant digits.
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
        for (quantity, value, score, words) in [
            (Quantity::Load, 0.7974, 151.0, ("0.7974 kg", "151 standard errors")),
            (Quantity::TorqueOffset, -3.25, 3.25, ("-3.25 Nm", "3.25 Nm")),
            (Quantity::TorqueNoiseRatio, 2.5, 2.5, ("2.5 times", "2.5 times")),
            (Quantity::ProductionTorqueGainRatio, 1.05, 0.05, ("1.05 times", "5 %")),
            (Quantity::Contact, 0.3, 6.183, ("30 %", "6.183 times")),
            (Quantity::FrictionOfModel, 22.0, 2.0_f64.ln(), ("22 Nm", "2 times")),
            (Quantity::FrictionIndex, 1.24, 0.24, ("1.24", "24 %")),
            (Quantity::FrictionJumpRatio, 1.25, 0.25, ("1.25", "25 %")),
            (Quantity::PositionOffset, 0.002, 0.002, ("0.002 rad (m)", "0.002 rad (m)")),
        ] {
            let figures = Figures(quantity, Language::English);
            assert_eq!((&*figures.value(value), &*figures.score(score)), words, "{quantity}");
        }
        assert_eq!(Figures(Quantity::WarmFriction, Language::German).change(0.5), "+0,5 Nm");
        assert_eq!(Figures(Quantity::TorqueNoiseRatio, Language::Italian).value(2.5), "2,5 volte");
    }
}
