//! `armwatch trajectory design`: an excitation trajectory for an arm, with its predicted results.

mod options;
mod settings;
mod report;

use std::io::IsTerminal;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};

pub(in crate::cli) use self::options::DesignArgs;
use self::report::{DesignReport, PredictedRecording};
use self::settings::sizes;
use super::arm::arm;
use super::beside::{Precision, ProductionPrecision};
use super::limit_texts::{slower, without_numbers};
use super::motion_check::MotionCheck;
use crate::cli::context::{CliError, EXIT_DONE, EXIT_FOUND, Global};
use crate::cli::shared::output;
use crate::cli::shared::programme::programme;
use crate::cli::shared::result_file::write_lines;
use armwatch_method::model::base_parameters::{BaseParameters, base_parameters};
use armwatch_method::pooled::nominal_prior::nominal_base;
use armwatch_model::robot::Robot;
use armwatch_trajectory::clearance::{Nearest, nearest_of_postures};
use armwatch_trajectory::limits::MotionLimits;
use armwatch_trajectory::prediction::{Conditioning, conditioning};
use armwatch_trajectory::problem::{INSTANTS_PER_HARMONIC, SearchProblem, SearchSettings};
use armwatch_trajectory::programme::{BesideRecord, Programme, SearchRecord};
use armwatch_trajectory::recorded_rows::RecordingPlan;
use armwatch_trajectory::search::{Earlier, SearchBudget, SearchResult, search};

/// Default number of starts of a search.
const STARTS: u64 = 12;

pub(in crate::cli) fn design(global: &Global, args: &DesignArgs) -> Result<u8, CliError> {
    let robot = arm(global, &args.robot)?;
    args.check()?;
    let refused = |error: armwatch_method::NumericsError| CliError::Usage(format!("{}: {error}", args.robot));
    let base = base_parameters(&robot).map_err(refused)?;
    let limit = args.surroundings.limit(&robot)?;
    let recording = args.recording(&robot)?;
    let all: Vec<usize> = (0..base.kept.len()).collect();
    let sizes = sizes(&base, &all, &nominal_base(&robot, &base));
    let beside = args.beside.read(global, &robot, &base, recording.as_ref(), sizes)?;
    let settings = SearchSettings { clearance: limit.clone(), ..args.settings(&robot, &base)? };
    let (chosen, limits) = (settings.parameters.clone(), settings.limits.clone());
    let (found, precision) = match (&beside, &recording) {
        (Some(beside), Some(recording)) => {
            let (found, precision) = args.least_addition(&robot, &base, settings, beside, recording)?;
            (found, Some(precision))
        }
        _ => {
            let problem = SearchProblem::new(&robot, &base, settings).map_err(refused)?;
            (args.search(&problem, args.earlier(&robot, &base, &chosen)?.as_ref())?, None)
        }
    };
    let conditions = conditioning(&robot, &base, &chosen, &found.series, args.rate_hz)
        .map_err(|error| without_numbers(&args.robot, &found.series, &error))?;
    let programme = Programme {
        model: robot.model.clone(),
        kinds: robot.joints.iter().map(|joint| joint.kind).collect(),
        series: found.series.clone(),
        search: Some(args.record(&base, &chosen, &found, &conditions, beside.as_ref())),
    };
    let judged = MotionCheck::of_series(&robot, &found.series, limit.as_ref())?;
    let told = DesignReport {
        robot: &robot,
        base: &base,
        programme: &programme,
        conditions: &conditions,
        judged: &judged,
        prediction: recording
            .as_ref()
            .map(|of| PredictedRecording::new(&robot, &base, &found.series, of, args.budget(global, &robot)?))
            .transpose()?,
        wear: args.wear,
        load_kg: args.load_kg,
        beside: beside.as_ref().zip(precision.as_ref()),
    };
    match global.json {
        true => output::json(&told.as_value()),
        false => told.print(),
    }
    judged.print_unchecked();
    judged.torque_hints().iter().for_each(|hint| output::print_hint(hint));
    let slower = slower(&robot, &limits, &found.series, args.reached());
    slower.iter().for_each(|sentence| output::print_hint(sentence));
    let broken = judged.broken();
    if !broken.is_empty() {
        broken.iter().for_each(|sentence| output::print_hint(sentence));
        output::print_hint(
            "nothing is written: the best motion found breaks limits; try more --starts, or wider limits",
        );
        return Ok(EXIT_FOUND);
    }
    match &args.output {
        Some(path) => {
            let text = programme.json().map_err(CliError::Internal)?;
            write_lines(path, text.lines().map(str::to_owned))?;
        }
        None if !global.json => output::print_hint("nothing is written; -o FILE saves the programme"),
        None => {}
    }
    if slower.is_empty() {
        return Ok(EXIT_DONE);
    }
    output::print_hint(&format!(
        "the motion does not reach the required speeds: allow more harmonics per second of duration (more --harmonics than {} or \
         fewer --seconds than {}) or more --starts, or require less (--reach-speed-share)",
        args.harmonics,
        1.0 / found.series.base_frequency
    ));
    Ok(EXIT_FOUND)
}

impl DesignArgs {
    /// The search of --resume, whose settings must be the same.
    fn earlier(
        &self,
        robot: &Robot,
        base: &BaseParameters,
        chosen: &[usize],
    ) -> Result<Option<Earlier>, CliError> {
        let Some(path) = &self.resume else { return Ok(None) };
        let found = programme(path, robot)?;
        let other = |what: &str| {
            Err(CliError::Usage(format!(
                "--resume {}: its search had another {what}; give the same options, or start a new search",
                path.display()
            )))
        };
        let Some(search) = found.search else { return other("origin: unknown") };
        let near = |a: f64, b: f64| (a - b).abs() <= 1e-9 * b.abs();
        let names: Vec<String> = chosen.iter().map(|&k| base.kept[k].to_string()).collect();
        let harmonics = found.series.a.first().map_or(0, Vec::len);
        let same = [
            ("objective", search.objective == self.objective().name()),
            ("choice of parameters", search.parameters == names),
            ("seed", search.seed == self.seed),
            ("duration", near(1.0 / found.series.base_frequency, self.seconds)),
            ("number of harmonics", harmonics == usize::from(self.harmonics)),
            ("form", search.form == self.form.recorded()),
            ("fraction of the range", near(search.position_share, self.position_share)),
            ("fraction of the speeds", near(search.speed_share, self.speed_share)),
            ("fraction of the accelerations", near(search.acceleration_share, self.acceleration_share)),
        ];
        if let Some((what, _)) = same.iter().find(|(_, same)| !same) {
            return other(what);
        }
        Ok(Some(Earlier {
            series: found.series,
            best_start: search.best_start,
            values: search.values.iter().map(|value| value.unwrap_or(f64::INFINITY)).collect(),
            evaluations: search.evaluations,
        }))
    }

    fn search(
        &self,
        problem: &SearchProblem<'_>,
        earlier: Option<&Earlier>,
    ) -> Result<SearchResult, CliError> {
        let begin = Instant::now();
        let budget = match self.budget_s {
            Some(seconds) => SearchBudget::Until(begin + Duration::from_secs_f64(seconds)),
            None => SearchBudget::Starts(self.starts.unwrap_or(STARTS)),
        };
        let processors = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
        let threads = self.threads.map_or(processors, usize::from);
        let bar = match budget {
            SearchBudget::Starts(starts) => ProgressBar::new(starts),
            SearchBudget::Until(_) => ProgressBar::no_length(),
        };
        if !std::io::stderr().is_terminal() {
            bar.set_draw_target(indicatif::ProgressDrawTarget::hidden());
        }
        let template = match budget {
            SearchBudget::Starts(_) => "[{bar:30}] {pos}/{len} starts, {msg}, {elapsed}, eta {eta}",
            SearchBudget::Until(_) => "{spinner} {pos} starts, {msg}, {elapsed}",
        };
        if let Ok(style) = ProgressStyle::with_template(template) {
            bar.set_style(style.progress_chars("=> "));
        }
        bar.set_message("nothing yet");
        bar.enable_steady_tick(Duration::from_millis(200));
        let found = search(problem, self.seed, budget, threads, earlier, &|progress| {
            bar.set_position(progress.starts);
            bar.set_message(format!("best {:.4}", progress.best));
        });
        bar.finish_and_clear();
        found.ok_or_else(|| CliError::Usage(nothing_found(problem)))
    }

    /// The shortest motion that identifies every parameter well enough, or the longest allowed one.
    fn least_addition(
        &self,
        robot: &Robot,
        base: &BaseParameters,
        settings: SearchSettings,
        beside: &ProductionPrecision,
        recording: &RecordingPlan,
    ) -> Result<(SearchResult, Precision), CliError> {
        let refused =
            |error: armwatch_method::NumericsError| CliError::Usage(format!("{}: {error}", self.robot));
        let durations = ProductionPrecision::durations(self.seconds);
        for (k, &duration) in durations.iter().enumerate() {
            let settings = SearchSettings { period: duration, ..settings.clone() };
            let instants = INSTANTS_PER_HARMONIC * settings.harmonics;
            let known = Some(beside.known(recording, duration, instants));
            let problem =
                SearchProblem::new(robot, base, SearchSettings { known, ..settings }).map_err(refused)?;
            let found = self.search(&problem, None)?;
            let precision = beside.precision(robot, base, &found.series, recording)?;
            if beside.missed(&precision) == 0 || k + 1 == durations.len() {
                return Ok((found, precision));
            }
        }
        Err(CliError::Internal("no duration to try".into()))
    }

    fn record(
        &self,
        base: &BaseParameters,
        chosen: &[usize],
        found: &SearchResult,
        conditions: &Conditioning,
        beside: Option<&ProductionPrecision>,
    ) -> SearchRecord {
        SearchRecord {
            armwatch: env!("CARGO_PKG_VERSION").to_owned(),
            objective: self.objective().name(),
            parameters: chosen.iter().map(|&k| base.kept[k].to_string()).collect(),
            form: self.form.recorded(),
            seed: self.seed,
            starts: found.values.len() as u64,
            best_start: found.best_start,
            evaluations: found.evaluations,
            values: found.values.iter().map(|value| value.is_finite().then_some(*value)).collect(),
            position_share: self.position_share,
            speed_share: self.speed_share,
            acceleration_share: self.acceleration_share,
            condition_number: conditions.condition_number,
            scaled_condition_number: conditions.scaled_condition_number,
            sample_rate_hz: self.rate_hz,
            beside: beside.map(|of| BesideRecord { run: of.run, seconds: of.seconds }),
        }
    }
}

/// Why a search may have found no motion, and the remedy.
fn nothing_found(problem: &SearchProblem<'_>) -> String {
    let robot = problem.robot();
    let middle: Vec<f64> = problem.settings().limits.iter().map(MotionLimits::middle).collect();
    let nearest = problem.settings().clearance.as_ref().map(|limit| {
        let mut near = nearest_of_postures(robot, &limit.clearance, std::iter::once((0.0, middle)));
        near.retain(|near| near.at_least < limit.distance);
        near.sort_by(|a, b| a.at_least.total_cmp(&b.at_least));
        let of = |of: &Nearest| format!("{} ({:.1} mm)", limit.clearance.name(of.pair), 1e3 * of.at_least);
        (near.iter().map(of).collect::<Vec<_>>(), limit.distance)
    });
    match nearest {
        Some((near, distance)) if !near.is_empty() => format!(
            "no motion tried avoids every collision. Even with all joints at the middles of their ranges, \
            these are nearer than {:.1} mm: {}. Check capsules and obstacles, or use less of the range \
            (--position-share)",
            1e3 * distance,
            near.join(", ")
        ),
        Some(_) => "no motion tried keeps the limits, avoids every collision and shows every parameter; try \
            more --starts, or use less of the range (--position-share)"
            .to_owned(),
        None => "no motion within the limits shows every parameter; check the ranges of the joints, or allow more harmonics \
                 and seconds"
            .to_owned(),
    }
}
