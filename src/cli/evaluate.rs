//! `armwatch evaluate`: how good the detectors are, on simulated fleets.

use std::io::IsTerminal;

use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};
use serde_json::{Value, json};

use crate::cli::context::{CliError, EXIT_DONE, Global};
use crate::cli::shared::output;
use crate::cli::shared::plot::PlotFile;
use crate::evaluate::fleet::{DetectorScore, FleetSettings, evaluate as judge};
use crate::evaluate::rates::{Delay, RateSettings, RealisedRate, delays, rate_pieces, realised_rates};
use crate::evaluate::scenario::Scenario;
use crate::evaluate::score::{ScenarioScore, rate, share_95};
use crate::report::detection::{DetectionCurve, DetectionPoint, detection_figure};
use crate::report::figure::Figure;

#[derive(Debug, Args)]
#[command(after_help = "\
Draws robots, what happens to them and the figures of their tests, and gives them to the detectors. Beside
armwatch stand detectors that alarm always, never, at three standard deviations of the friction index, and
by CUSUM of it. An alarm is an anomaly of severity warning or critical.

With --rates, single series take the place of robots: how often the sequential chart alarms without a shift, against the
rate that it was asked for, and how late with one, against Lorden's bound. A year has 2920 values;
delays are of ten times as many series.

Examples:
  armwatch evaluate
  armwatch evaluate --robots 200 --years 2
  armwatch evaluate --scenario wear --scenario healthy --robots 100 --seed 7
  armwatch evaluate --size payload=0.8 --size step-inside=0.25 --robots 100
  armwatch evaluate --robots 300 --plot detection.svg
  armwatch evaluate --rates --robots 500
  armwatch evaluate --json")]
pub(in crate::cli) struct EvaluateArgs {
    /// Robots of each scenario; with --rates, series of each kind
    #[arg(help_heading = "What is simulated", long, default_value_t = 20, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    robots: u32,
    /// Years that each robot is watched
    #[arg(help_heading = "What is simulated", long, default_value_t = 1.0, value_parser = years)]
    years: f64,
    /// Seed of all that is drawn; the same seed gives the same figures
    #[arg(help_heading = "What is simulated", long, default_value_t = 1)]
    seed: u64,
    /// One scenario, several times for more; all of them unless one is given here or with --size
    #[arg(help_heading = "What is simulated", long, value_name = "NAME", value_parser = scenario)]
    scenario: Vec<Scenario>,
    /// Size that every event of a scenario has, instead of drawn ones, in the unit that `--json` tells;
    /// several times for more
    #[arg(help_heading = "What is simulated", long, value_name = "NAME=SIZE", value_parser = size)]
    size: Vec<(Scenario, f64)>,
    /// Writes probability and delay of detection over size as a picture, .svg or .html
    #[arg(help_heading = "Results", long, value_name = "FILE", value_parser = PlotFile::parse)]
    plot: Option<PlotFile>,
    /// Realised rates and delays of single series
    #[arg(help_heading = "Results", long, conflicts_with_all = ["scenario", "size", "years", "plot"])]
    rates: bool,
}

/// Series whose delay is measured for each that is watched for a year: a delay is a hundredth of the work.
const DELAYS_A_RATE: usize = 10;

fn years(text: &str) -> Result<f64, String> {
    let years: f64 = text.parse().map_err(|_| "takes a number of years, such as 1.5".to_owned())?;
    if (0.5..=20.0).contains(&years) {
        Ok(years)
    } else {
        Err("takes 0.5 to 20 years: a shorter history has no baseline before the event".into())
    }
}

fn scenario(name: &str) -> Result<Scenario, String> {
    Scenario::ALL
        .into_iter()
        .find(|of| of.name() == name)
        .ok_or_else(|| format!("takes one of {}", Scenario::ALL.map(Scenario::name).join(", ")))
}

fn size(text: &str) -> Result<(Scenario, f64), String> {
    let (name, size) = text.split_once('=').ok_or("takes a scenario and a size, such as payload=0.8")?;
    let of = scenario(name)?;
    if of.size().is_empty() {
        return Err(format!("{name} has no size"));
    }
    let size: f64 = size.parse().map_err(|_| format!("{size:?} is no number: {name} takes {}", of.size()))?;
    match size.is_finite() && size != 0.0 {
        true => Ok((of, size)),
        false => Err(format!("takes a number other than zero: {}", of.size())),
    }
}

pub(in crate::cli) fn evaluate(global: &Global, args: &EvaluateArgs) -> Result<u8, CliError> {
    if args.rates {
        let settings = RateSettings {
            series: args.robots as usize,
            seed: args.seed,
            threads: std::thread::available_parallelism().map_or(1, std::num::NonZero::get),
        };
        let bar = progress_bar(rate_pieces(settings.series), "pieces");
        let rates = realised_rates(&settings, &|| bar.inc(1));
        bar.finish_and_clear();
        let late = RateSettings { series: DELAYS_A_RATE * settings.series, ..settings };
        print_rates(&rates, &delays(&late), global.json);
        return Ok(EXIT_DONE);
    }
    let mut scenarios = args.scenario.clone();
    scenarios.extend(args.size.iter().map(|(of, _)| *of));
    if scenarios.is_empty() {
        scenarios = Scenario::ALL.to_vec();
    }
    scenarios.sort_unstable();
    scenarios.dedup();
    let settings = FleetSettings {
        robots: args.robots as usize,
        years: args.years,
        seed: args.seed,
        threads: std::thread::available_parallelism().map_or(1, std::num::NonZero::get),
        scenarios,
        sizes: args.size.clone(),
    };
    let bar = progress_bar(settings.robots * settings.scenarios.len(), "robots");
    let scores = judge(&settings, &|| bar.inc(1))
        .map_err(|error| CliError::Internal(format!("a drawn arm: {error}")))?;
    bar.finish_and_clear();
    if let (Some(file), Some(own)) = (&args.plot, scores.first()) {
        file.write(&figure(own, &settings))?;
    }
    if global.json {
        for score in &scores {
            output::json(&as_json(score, &settings));
        }
    } else {
        output::line(&as_text(&scores));
    }
    Ok(EXIT_DONE)
}

fn noise_name(freedom: Option<f64>) -> String {
    freedom.map_or_else(|| "normal".to_owned(), |freedom| format!("t({freedom})"))
}

fn print_rates(rates: &[RealisedRate], delays: &[Delay], as_json: bool) {
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
                "noise": noise_name(of.freedom), "autocorrelation": of.correlation, "run_length": of.run_length,
                "shift_std": of.shift, "mean_delay": of.mean, "mean_delay_std_error": of.std_error,
                "lorden_bound": of.bound,
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
            format!("{:.0}", of.run_length),
            of.shift.to_string(),
            format!("{:.2}", of.mean),
            format!("{:.2}", of.std_error),
            format!("{:.2}", of.bound),
            format!("{:.2}", of.mean / of.bound),
        ]
    };
    let header =
        ["noise", "autocorrelation", "run length", "shift", "delay", "std error", "Lorden's bound", "ratio"];
    output::line("");
    output::line(&output::table(&header, &delays.iter().map(row).collect::<Vec<_>>()));
    output::line("\nrun length and delay in values; the value with which a shift comes counts");
}

fn figure(own: &DetectorScore, settings: &FleetSettings) -> Figure {
    let curve = |of: &ScenarioScore| DetectionCurve {
        fault: of.scenario.name().into(),
        size: of.scenario.size().into(),
        points: of
            .by_size
            .iter()
            .map(|bin| DetectionPoint {
                size: bin.size,
                detected: bin.detected as f64 / bin.robots as f64,
                detected_95: share_95(bin.detected, bin.robots),
                delay_tests: bin.delay_runs,
            })
            .collect(),
    };
    let faults = own.scenarios.iter().filter(|of| of.scenario.kind().is_some());
    detection_figure(
        &faults.map(curve).collect::<Vec<_>>(),
        "Detection of faults on simulated fleets".into(),
        format!(
            "{} robots a fault, each watched for {}, seed {}",
            settings.robots,
            if settings.years == 1.0 { "one year".into() } else { format!("{} years", settings.years) },
            settings.seed
        ),
    )
}

fn progress_bar(count: usize, of: &str) -> ProgressBar {
    if !std::io::stderr().is_terminal() {
        return ProgressBar::hidden();
    }
    let style = ProgressStyle::with_template(&format!("{{bar:40}} {{pos}}/{{len}} {of}, {{eta}} left"));
    ProgressBar::new(count as u64).with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()))
}

fn as_json(score: &DetectorScore, settings: &FleetSettings) -> Value {
    let scenario = |of: &ScenarioScore| {
        let (rate, interval) = of.rate();
        json!({
            "scenario": of.scenario.name(), "kind": of.scenario.kind().map(|kind| kind.name()),
            "robots": of.robots, "robot_years": of.years,
            "false_alarms": of.false_alarms, "false_alarm_kinds": of.false_kinds,
            "false_alarms_a_robot_year": rate, "false_alarms_a_robot_year_95": interval,
            "detected": of.detected, "right_joint": of.right_joint, "right_kind": of.right_kind,
            "right_kind_at_first_alarm": of.right_first_kind,
            "right_figure": of.right_figure.0, "with_figure": of.right_figure.1,
            "delay_tests_of_95_percent": finite(of.most_delay_runs),
            "median_delay_tests": finite(of.delay_runs), "median_delay_days": finite(of.delay_days),
            "further_alarms_a_robot": of.beside, "said": of.said, "size": of.scenario.size(),
            "by_size": of.by_size.iter().map(|bin| json!({
                "size": bin.size, "robots": bin.robots, "detected": bin.detected,
                "median_delay_tests": finite(bin.delay_runs),
            })).collect::<Vec<_>>(),
        })
    };
    json!({
        "detector": score.detector.name(), "seed": settings.seed, "macro_f1": finite(score.macro_f1),
        "scenarios": score.scenarios.iter().map(scenario).collect::<Vec<_>>(),
    })
}

fn finite(value: f64) -> Option<f64> {
    value.is_finite().then_some(value)
}

fn as_text(scores: &[DetectorScore]) -> String {
    let mut text = String::new();
    let is_event = |of: &&ScenarioScore| of.scenario.kind().is_some();
    if let Some(own) = scores.first() {
        let healthy: Vec<Vec<String>> =
            own.scenarios.iter().filter(|of| !is_event(of)).map(healthy_row).collect();
        if !healthy.is_empty() {
            text += "Robots without a fault: any alarm is a false one\n\n";
            text += &output::table(
                &["scenario", "robot-years", "alarms", "a robot-year", "95 %", "kinds"],
                &healthy,
            );
            text += "\n\n";
        }
        let events: Vec<Vec<String>> = own.scenarios.iter().filter(is_event).map(event_row).collect();
        if !events.is_empty() {
            text += "Robots with a fault\n\n";
            text += &output::table(
                &[
                    "scenario",
                    "right kind",
                    "detected",
                    "joint",
                    "kind",
                    "kind at first",
                    "figure",
                    "tests",
                    "95 %",
                    "days",
                    "further",
                    "first alarm says",
                ],
                &events,
            );
            text += "\n\n";
        }
    }
    text += "Detectors\n\n";
    text += &output::table(
        &[
            "detector",
            "false alarms a robot-year",
            "detected",
            "joint",
            "kind",
            "macro-F1",
            "median delay, tests",
        ],
        &scores.iter().map(detector_row).collect::<Vec<_>>(),
    );
    text += "\n\ndetected, joint and kind in per cent of robots with a fault; figure: the mass of a load to 15 %, the onset of a \
             step to one cycle, of alarms of the right kind; tests, days: median delay; 95 %: tests within which so many \
             robots have an alarm";
    text
}

fn counts(of: &std::collections::BTreeMap<&'static str, usize>) -> String {
    let mut sorted: Vec<(&str, usize)> = of.iter().map(|(name, count)| (*name, *count)).collect();
    sorted.sort_by_key(|(_, count)| std::cmp::Reverse(*count));
    let named: Vec<String> = sorted.iter().map(|(name, count)| format!("{name} {count}")).collect();
    if named.is_empty() { "-".into() } else { named.join(", ") }
}

fn rate_text((rate, [low, high]): (f64, [f64; 2])) -> [String; 2] {
    [format!("{rate:.3}"), format!("{low:.3} to {high:.3}")]
}

fn healthy_row(of: &ScenarioScore) -> Vec<String> {
    let [rate, interval] = rate_text(of.rate());
    vec![
        of.scenario.name().into(),
        format!("{:.0}", of.years),
        of.false_alarms.to_string(),
        rate,
        interval,
        counts(&of.false_kinds),
    ]
}

fn event_row(of: &ScenarioScore) -> Vec<String> {
    let percent = |count: usize| format!("{:.0} %", 100.0 * count as f64 / of.robots.max(1) as f64);
    let delay = |delay: f64| if delay.is_finite() { format!("{delay:.0}") } else { "-".into() };
    vec![
        of.scenario.name().into(),
        of.scenario.kind().map_or("-", |kind| kind.name()).into(),
        percent(of.detected),
        percent(of.right_joint),
        percent(of.right_kind),
        percent(of.right_first_kind),
        match of.right_figure {
            (_, 0) => "-".into(),
            (right, all) => format!("{:.0} %", 100.0 * right as f64 / all as f64),
        },
        delay(of.delay_runs),
        delay(of.most_delay_runs),
        delay(of.delay_days),
        format!("{:.2}", of.beside),
        counts(&of.said),
    ]
}

fn detector_row(score: &DetectorScore) -> Vec<String> {
    let (mut alarms, mut years) = (0, 0.0);
    let (mut robots, mut detected, mut joint, mut kind) = (0, 0, 0, 0);
    let mut delays = Vec::new();
    for of in &score.scenarios {
        if of.scenario.kind().is_none() {
            alarms += of.false_alarms;
            years += of.years;
        } else {
            robots += of.robots;
            detected += of.detected;
            joint += of.right_joint;
            kind += of.right_kind;
            delays.extend(Some(of.delay_runs).filter(|delay| delay.is_finite()));
        }
    }
    let percent = |count: usize| match robots {
        0 => "-".into(),
        _ => format!("{:.0} %", 100.0 * count as f64 / robots as f64),
    };
    delays.sort_by(f64::total_cmp);
    let delay = delays.get(delays.len() / 2).map_or("-".into(), |delay| format!("{delay:.0}"));
    let false_alarms = match years > 0.0 {
        true => rate_text(rate(alarms, years)).join(", "),
        false => "-".into(),
    };
    let f1 = if score.macro_f1.is_finite() { format!("{:.2}", score.macro_f1) } else { "-".into() };
    vec![
        score.detector.name().into(),
        false_alarms,
        percent(detected),
        percent(joint),
        percent(kind),
        f1,
        delay,
    ]
}
