//! Realised rates and delays of single series, as tables and JSON.

use serde_json::json;

use crate::evaluate::rates::{Delay, LevelDelay, RealisedRate};
use crate::evaluate::score::rate;
use armwatch::cli::shared::output;

fn noise_name(freedom: Option<f64>) -> String {
    freedom.map_or_else(|| "normal".to_owned(), |freedom| format!("t({freedom})"))
}

pub(super) fn print_rates(rates: &[RealisedRate], delays: &[Delay], levels: &[LevelDelay], as_json: bool) {
    if as_json {
        for of in rates {
            let (realised, interval) = rate(of.alarms, of.years as f64);
            output::json(&json!({
                "noise": noise_name(of.freedom), "autocorrelation": of.correlation, "values_learnt": of.learnt,
                "asked_a_year": of.asked, "alarms": of.alarms, "years": of.years,
                "realised_a_year": realised, "realised_a_year_95": interval,
            }));
        }
        for of in delays {
            output::json(&json!({
                "noise": noise_name(of.freedom), "autocorrelation": of.correlation, "values_learnt": of.learnt,
                "channels": of.channels, "run_length": of.run_length, "shift_std": of.shift, "mean_delay": of.mean, "mean_delay_std_error": of.std_error,
                "lorden_bound": of.bound,
            }));
        }
        for of in levels {
            output::json(&json!({
                "level_shift_std": of.shift, "run_length_tests": of.run_length, "mean_delay_tests": of.mean,
                "lorden_bound_tests": of.bound,
            }));
        }
        return;
    }
    let row = |of: &RealisedRate| {
        let (realised, interval) = rate(of.alarms, of.years as f64);
        vec![
            noise_name(of.freedom),
            of.correlation.to_string(),
            of.learnt.to_string(),
            of.asked.to_string(),
            of.alarms.to_string(),
            format!("{:.2}", realised / of.asked),
            interval.map(|end| format!("{:.2}", end / of.asked)).join(" to "),
        ]
    };
    let header =
        ["noise", "autocorrelation", "learnt from", "asked a year", "alarms", "realised / asked", "95 %"];
    output::line(&output::table(&header, &rates.iter().map(row).collect::<Vec<_>>()));
    let row = |of: &Delay| {
        vec![
            noise_name(of.freedom),
            of.correlation.to_string(),
            of.learnt.to_string(),
            of.channels.to_string(),
            format!("{:.0}", of.run_length),
            of.shift.to_string(),
            format!("{:.2}", of.mean),
            format!("{:.2}", of.std_error),
            format!("{:.2}", of.bound),
            format!("{:.2}", of.mean / of.bound),
        ]
    };
    let header = [
        "noise",
        "autocorrelation",
        "learnt from",
        "channels",
        "run length",
        "shift",
        "delay",
        "std error",
        "Lorden's bound",
        "ratio",
    ];
    output::line("");
    output::line(&output::table(&header, &delays.iter().map(row).collect::<Vec<_>>()));
    output::line(
        "\nrun length and delay in values; the value with which a shift comes counts; channels share a false alarm a year\n",
    );
    let row = |of: &LevelDelay| {
        let figures = [of.run_length, of.shift, of.mean, of.bound, of.mean / of.bound];
        figures.map(|figure| format!("{figure:.2}")).to_vec()
    };
    let header = ["run length", "shift", "delay", "Lorden's bound", "ratio"];
    output::line(&output::table(&header, &levels.iter().map(row).collect::<Vec<_>>()));
    output::line(
        "\nthe moving average of the level of friction, in daily tests, beside all other channels of six joints",
    );
}
