//! Output of `armwatch identify` for combined cycles.

use std::collections::{BTreeSet, HashMap};

use serde_json::{Value, json};

use crate::cli::shared::output;
use crate::pipeline::stored::chosen_cycles::PooledCycles;
use crate::pipeline::stored::reestimate::{PooledOutcome, PooledResult};
use armwatch_method::NumericsError;
use armwatch_method::least_squares::conditioning::FLAGGED_RELATIVE_ERROR;
use armwatch_method::pooled::estimate::{ErrorBasis, PooledEstimate};
use armwatch_method::pooled::per_joint::PerJointEstimate;
use armwatch_model::analysis::estimator_kind::EstimatorKind;
use armwatch_model::analysis::{Identification, IdentifiedParameter, TorqueRmsd};
use armwatch_model::robot::{JointIndex, ParameterId};
use armwatch_store::ModelParameter;

/// All data of the output.
pub(in crate::cli) struct Report<'a> {
    pub(in crate::cli) taken: &'a PooledCycles,
    pub(in crate::cli) estimator: EstimatorKind,
    pub(in crate::cli) together: &'a PooledResult,
    pub(in crate::cli) parameters: &'a HashMap<ParameterId, ModelParameter>,
    pub(in crate::cli) rmsd: &'a [TorqueRmsd],
    /// RMSD before parameters were removed.
    pub(in crate::cli) rmsd_full: Option<&'a [TorqueRmsd]>,
    pub(in crate::cli) groupings: bool,
    pub(in crate::cli) saved: Option<&'a str>,
}

pub(in crate::cli) fn print(report: &Report<'_>, as_json: bool) {
    if as_json {
        output::json(&report.as_value());
    } else {
        output::block(&report.as_text());
    }
}

/// Standard error over value; infinite for a value of zero.
fn relative_error(parameter: &IdentifiedParameter) -> f64 {
    if parameter.value == 0.0 { f64::INFINITY } else { parameter.std_error / parameter.value.abs() }
}

fn is_flagged(parameter: &IdentifiedParameter) -> bool {
    relative_error(parameter) > FLAGGED_RELATIVE_ERROR
}

/// Returns true if the table marks the error of a parameter.
fn has_star(parameter: &IdentifiedParameter) -> bool {
    is_flagged(parameter) && known(100.0 * relative_error(parameter)).is_some()
}

/// Returns true if a parameter has no separate value, because the motion does not identify it. Others without an error
/// were removed as not essential.
fn is_unshown(parameter: &IdentifiedParameter, found: &PooledEstimate) -> bool {
    let removed = found.essential.as_ref().is_some_and(|of| of.removed.contains(&parameter.id));
    !parameter.is_shown() && !removed
}

/// A number, or null if it is not finite.
fn known(value: f64) -> Option<f64> {
    value.is_finite().then_some(value)
}

/// One parameter as `identify --json` prints it.
pub(in crate::cli) fn parameter_value(
    parameter: &IdentifiedParameter,
    half_width: f64,
    parameters: &HashMap<ParameterId, ModelParameter>,
) -> Value {
    let of = parameters.get(&parameter.id);
    json!({
        "joint": parameter.id.joint.number(),
        "parameter": parameter.id.name(),
        "value": parameter.value,
        "std_error": known(parameter.std_error),
        "relative_std_error": known(relative_error(parameter)),
        "interval_low": known(parameter.value - half_width),
        "interval_high": known(parameter.value + half_width),
        "flagged": is_flagged(parameter),
        "unit": of.map(|of| &of.unit),
        "grouping": of.and_then(|of| of.grouping.as_ref()),
    })
}

impl Report<'_> {
    fn id(&self, column: usize) -> ParameterId {
        self.taken.union.columns().kept()[column]
    }

    fn as_text(&self) -> String {
        let runs: BTreeSet<i64> = self.taken.sources.iter().map(|source| source.run_id).collect();
        let mut text = format!(
            "{} of {}, model {}, estimator {}\n",
            output::counted(self.taken.sources.len(), "cycle"),
            output::counted(runs.len(), "run"),
            self.taken.model.name,
            self.estimator.name()
        );
        match &self.together.outcome {
            PooledOutcome::Set(found) => text.push_str(&self.set_text(found)),
            PooledOutcome::Views(views) => {
                views.iter().for_each(|(joint, view)| text.push_str(&self.view_text(*joint, view)));
            }
            PooledOutcome::TooPoor => text.push_str(&self.poor_text()),
        }
        if !self.rmsd.is_empty() {
            text.push_str(&format!("\n\n{}", rmsd_table(self.rmsd)));
        }
        if let Some(full) = self.rmsd_full {
            text.push_str(&format!("\n\nwith all parameters\n{}", rmsd_table(full)));
        }
        text
    }

    fn set_text(&self, found: &PooledEstimate) -> String {
        let mut text = format!("{}\n{}\n", figures_text(&found.identification), errors_text(found.errors));
        if !found.settled {
            text.push_str("weights did not converge; the last ones are used\n");
        }
        text.push_str(&self.weights_text(found));
        if let Some(prior) = &found.prior {
            text.push_str(&format!("standard deviations of the prior times {:.4}\n", prior.spread));
        }
        text.push_str(&self.unshown_text(found));
        let share = found.prior.as_ref().map(|prior| prior.data_share.as_slice());
        let parameters = &found.identification.parameters;
        text.push_str(&format!(
            "\n{}",
            self.parameter_table(parameters, &found.half_width, share, |of| is_unshown(of, found))
        ));
        if let Some(report) = &found.essential {
            let removed: Vec<String> = report.removed.iter().map(ToString::to_string).collect();
            text.push_str(&format!(
                "\n\n{} of {} parameters omitted, the least certain first: {}\nF = {:.3}, not worse up to {:.3}",
                removed.len(),
                report.full.len(),
                if removed.is_empty() { "none".to_owned() } else { removed.join(" ") },
                report.f_statistic,
                report.f_limit
            ));
        }
        text
    }

    /// Noise of the joints and cycles with less weight, if there are weights.
    fn weights_text(&self, found: &PooledEstimate) -> String {
        if self.estimator == EstimatorKind::Ordinary {
            return String::new();
        }
        let noise: Vec<String> =
            noise(found).iter().zip(1..).map(|(sigma, j)| format!("J{j} {sigma:.4}")).collect();
        let mut text = format!("noise of the joints, Nm: {}\n", noise.join(", "));
        let less: Vec<String> = self
            .lighter_cycles(found)
            .map(|(place, joint, weight)| {
                let source = &self.taken.sources[place];
                format!("run {} cycle {} joint {joint}: weight {weight:.3}\n", source.run_id, source.cycle)
            })
            .collect();
        if self.estimator == EstimatorKind::Huber {
            text.push_str(if less.is_empty() {
                "all cycles have full weight\n"
            } else {
                "cycles with less weight:\n"
            });
        }
        text + &less.concat()
    }

    /// Index of the cycle, joint, weight.
    fn lighter_cycles<'a>(
        &self,
        found: &'a PooledEstimate,
    ) -> impl Iterator<Item = (usize, JointIndex, f64)> + use<'a> {
        let cycles = found.weights.kept.iter().flatten().enumerate();
        cycles.flat_map(|(place, of_joint)| {
            let joints = of_joint.iter().zip((0..).map(JointIndex::new));
            joints.filter(|(weight, _)| **weight < 1.0).map(move |(weight, joint)| (place, joint, *weight))
        })
    }

    fn view_text(&self, joint: JointIndex, view: &Result<PerJointEstimate, NumericsError>) -> String {
        let view = match view {
            Ok(view) => view,
            Err(error) => return format!("\n\njoint {joint} gives no parameters: {error}"),
        };
        let names = |ids: &[ParameterId]| ids.iter().map(ToString::to_string).collect::<Vec<_>>().join(" ");
        let mut text = format!(
            "\n\njoint {joint}: {}\n{}\n\n{}",
            figures_text(&view.identification),
            errors_text(view.errors),
            self.parameter_table(&view.identification.parameters, &view.half_width, None, |of| !of
                .is_shown())
        );
        if !view.within_others.is_empty() {
            text.push_str(&format!("\nseen only in sums with others: {}", names(&view.within_others)));
        }
        if !view.unseen.is_empty() {
            text.push_str(&format!("\nnot seen by joint {joint}: {}", names(&view.unseen)));
        }
        text
    }

    fn poor_text(&self) -> String {
        let shown = &self.together.shown;
        format!(
            "condition number {}, columns scaled {}\nthe motion of these cycles shows too few parameters; \
            no values are given\n{}use more cycles with other motion, or --estimator prior with a prior for \
            the arm",
            four_digits(shown.condition_number),
            four_digits(shown.scaled_condition_number),
            self.indistinct_text()
        )
    }

    /// Parameters without a separate value, and the reason.
    fn unshown_text(&self, found: &PooledEstimate) -> String {
        let parameters = found.identification.parameters.iter();
        let unshown: Vec<String> =
            parameters.filter(|of| is_unshown(of, found)).map(|of| of.id.to_string()).collect();
        match unshown.is_empty() {
            true => String::new(),
            false => format!(
                "the motion of these cycles does not show {} on {} own; no value is given (-), and cycles with other \
                 motion may show {}\n{}",
                unshown.join(" "),
                if unshown.len() == 1 { "its" } else { "their" },
                if unshown.len() == 1 { "it" } else { "them" },
                self.indistinct_text()
            ),
        }
    }

    fn indistinct_text(&self) -> String {
        let shown = &self.together.shown;
        let mut text = String::new();
        for &column in &shown.unseen {
            text.push_str(&format!("  {} never changes a torque\n", self.id(column)));
        }
        for of in &shown.indistinct {
            let from: Vec<String> = of.from.iter().map(|&k| self.id(k).to_string()).collect();
            let from = if from.is_empty() { "all others".to_owned() } else { from.join(" ") };
            text.push_str(&format!("  {} cannot be separated from {from}\n", self.id(of.column)));
        }
        text
    }

    fn parameter_table(
        &self,
        parameters: &[IdentifiedParameter],
        half_width: &[f64],
        data_share: Option<&[f64]>,
        unshown: impl Fn(&IdentifiedParameter) -> bool,
    ) -> String {
        let mut header = vec!["joint", "parameter", "value", "std_error", "std_error_%", "low_95", "high_95"];
        header.extend(data_share.map(|_| "data_share"));
        header.push("unit");
        header.extend(self.groupings.then_some("grouping"));
        let row = |(k, p): (usize, &IdentifiedParameter)| {
            let mark = if has_star(p) { "*" } else { "" };
            let mut row = vec![
                p.id.joint.to_string(),
                p.id.name().to_string(),
                if unshown(p) { "-".to_owned() } else { format!("{:.6}", p.value) },
                figure(p.std_error),
                known(100.0 * relative_error(p)).map_or("-".into(), |percent| format!("{percent:.1}{mark}")),
                figure(p.value - half_width[k]),
                figure(p.value + half_width[k]),
            ];
            row.extend(data_share.map(|share| format!("{:.3}", share[k])));
            let of = self.parameters.get(&p.id);
            row.push(of.map_or_else(String::new, |of| of.unit.clone()));
            if self.groupings {
                row.push(of.and_then(|of| of.grouping.clone()).unwrap_or_else(|| "-".into()));
            }
            row
        };
        let rows: Vec<Vec<String>> = parameters.iter().enumerate().map(row).collect();
        let table = output::table(&header, &rows);
        match parameters.iter().any(has_star) {
            true => format!(
                "{table}\n* standard error above {:.0} % of the value",
                100.0 * FLAGGED_RELATIVE_ERROR
            ),
            false => table,
        }
    }

    fn as_value(&self) -> Value {
        let shown = &self.together.shown;
        let name = |column: usize| self.id(column).to_string();
        let mut value = json!({
            "model": self.taken.model.name,
            "parameter_set": self.saved,
            "estimator": self.estimator.name(),
            "sources": self.taken.sources,
            "motion": {
                "condition_number": known(shown.condition_number),
                "scaled_condition_number": known(shown.scaled_condition_number),
                "unseen": shown.unseen.iter().map(|&k| name(k)).collect::<Vec<_>>(),
                "indistinct": shown.indistinct.iter().map(|of| json!({
                    "parameter": name(of.column),
                    "from": of.from.iter().map(|&k| name(k)).collect::<Vec<_>>(),
                })).collect::<Vec<_>>(),
            },
            "rmsd": self.rmsd,
            "parameters": [],
        });
        match &self.together.outcome {
            PooledOutcome::Set(found) => self.add_set(&mut value, found),
            PooledOutcome::Views(views) => {
                value["joint_views"] =
                    views.iter().map(|(joint, view)| self.view_value(*joint, view)).collect();
            }
            PooledOutcome::TooPoor => {}
        }
        value
    }

    fn add_set(&self, value: &mut Value, found: &PooledEstimate) {
        add_figures(value, &found.identification, found.errors);
        value["settled"] = json!(found.settled);
        let parameters = found.identification.parameters.iter().zip(&found.half_width);
        let mut listed: Vec<Value> =
            parameters.map(|(p, half)| parameter_value(p, *half, self.parameters)).collect();
        let unshown = found.identification.parameters.iter().map(|of| is_unshown(of, found));
        for (of, unshown) in listed.iter_mut().zip(unshown).filter(|(_, unshown)| *unshown) {
            of["value"] = Value::Null;
            of["shown"] = json!(!unshown);
        }
        if let Some(prior) = &found.prior {
            listed.iter_mut().zip(&prior.data_share).for_each(|(of, share)| of["data_share"] = json!(share));
            value["prior_spread"] = json!(prior.spread);
        }
        value["parameters"] = json!(listed);
        if self.estimator != EstimatorKind::Ordinary {
            value["joint_noise_nm"] = json!(noise(found));
        }
        if self.estimator == EstimatorKind::Huber {
            let lighter = self.lighter_cycles(found).map(|(place, joint, weight)| {
                let source = &self.taken.sources[place];
                json!({
                    "run_id": source.run_id, "cycle": source.cycle, "joint": joint.number(), "weight": weight,
                })
            });
            value["lighter_cycles"] = lighter.collect();
        }
        if let Some(report) = &found.essential {
            value["essential"] = json!({
                "removed": report.removed.iter().map(ToString::to_string).collect::<Vec<_>>(),
                "f_statistic": report.f_statistic,
                "f_limit": known(report.f_limit),
                "rmsd_with_all": self.rmsd_full,
            });
        }
    }

    fn view_value(&self, joint: JointIndex, view: &Result<PerJointEstimate, NumericsError>) -> Value {
        let view = match view {
            Ok(view) => view,
            Err(error) => return json!({"joint": joint.number(), "reason": error.to_string()}),
        };
        let names = |ids: &[ParameterId]| ids.iter().map(ToString::to_string).collect::<Vec<_>>();
        let parameters = view.identification.parameters.iter().zip(&view.half_width);
        let mut value = json!({
            "joint": joint.number(),
            "parameters": parameters.map(|(p, half)| parameter_value(p, *half, self.parameters)).collect::<Vec<_>>(),
            "within_others": names(&view.within_others),
            "unseen": names(&view.unseen),
        });
        add_figures(&mut value, &view.identification, view.errors);
        value
    }
}

fn add_figures(value: &mut Value, found: &Identification, errors: ErrorBasis) {
    value["samples"] = json!(found.samples);
    value["condition_number"] = json!(known(found.condition_number));
    value["scaled_condition_number"] = json!(known(found.scaled_condition_number));
    value["residual_std_nm"] = json!(known(found.residual_std));
    value["error_basis"] = match errors {
        ErrorBasis::Cycles { count, repeated } => {
            json!({"from": "cycles", "cycles": count, "repeated_fraction": repeated})
        }
        ErrorBasis::IndependentRows { fraction, repeated } => json!({
            "from": "independent_rows",
            "independent_fraction": fraction,
            "repeated_fraction": repeated,
        }),
    };
}

/// Standard deviation of each joint's residual, Nm, by the weights.
fn noise(found: &PooledEstimate) -> Vec<f64> {
    found.weights.by_joint.iter().map(|weight| 1.0 / weight.sqrt()).collect()
}

fn figures_text(found: &Identification) -> String {
    format!(
        "{} samples, condition number {}, columns scaled {}; residual {:.4} Nm",
        found.samples,
        four_digits(found.condition_number),
        four_digits(found.scaled_condition_number),
        found.residual_std,
    )
}

fn errors_text(errors: ErrorBasis) -> String {
    let (text, repeated) = match errors {
        ErrorBasis::Cycles { count, repeated } => {
            (format!("standard errors from the scatter between {count} cycles"), repeated)
        }
        ErrorBasis::IndependentRows { fraction, repeated } => (
            format!(
                "standard errors from the residual, {:.1} % of the rows independent; 8 cycles would show their own \
                 scatter",
                100.0 * fraction
            ),
            repeated,
        ),
    };
    if repeated == 0.0 {
        return text;
    }
    format!(
        "{text}\n{:.0} % of the error variance within cycles repeats in each cycle; intervals contain it in full",
        100.0 * repeated
    )
}

fn figure(value: f64) -> String {
    known(value).map_or_else(|| "-".to_owned(), |value| format!("{value:.6}"))
}

/// The logarithm of a condition number is the number of lost digits; more than four digits of the condition number are
/// meaningless.
fn four_digits(value: f64) -> String {
    let text = |value: f64| match value.abs() {
        size if size >= 1e6 => format!("{value:.3e}"),
        size if size >= 1e3 => format!("{value:.0}"),
        size if size >= 1e2 => format!("{value:.1}"),
        size if size >= 1e1 => format!("{value:.2}"),
        _ => format!("{value:.3}"),
    };
    known(value).map_or_else(|| "-".to_owned(), text)
}

fn rmsd_table(rmsd: &[TorqueRmsd]) -> String {
    let figure = |samples: usize, value: f64| match samples {
        0 => "-".to_string(),
        _ => format!("{value:.4}"),
    };
    let row = |r: &TorqueRmsd| {
        vec![
            r.joint.to_string(),
            r.scope.name().to_string(),
            figure(r.all_rows.samples, r.all_rows.value),
            figure(r.all_rows.samples, r.all_rows.relative),
            figure(r.moving_rows.samples, r.moving_rows.value),
            figure(r.moving_rows.samples, r.moving_rows.relative),
        ]
    };
    let rows: Vec<Vec<String>> = rmsd.iter().map(row).collect();
    output::table(&["joint", "stage", "rmsd_nm", "relative", "moving_rmsd_nm", "moving_relative"], &rows)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn condition_numbers_have_four_digits() {
        let shown = [1.0, 29.64159, 161.647, 1616.472852, 2.5e9, f64::INFINITY].map(four_digits);
        assert_eq!(shown, ["1.000", "29.64", "161.6", "1616", "2.500e9", "-"]);
    }
}
