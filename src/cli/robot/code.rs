//! `armwatch robot code`: the torque function of a model as source of another language.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use clap::builder::PossibleValue;
use clap::{ArgGroup, Args, ValueEnum};
use serde_json::json;

use super::sources::{described, recorded, source_lines};
use crate::cli::context::{CliError, EXIT_DONE, Global, open_to_read, runtime};
use crate::cli::shared::output;
use crate::cli::shared::paths::not_written;
use crate::cli::shared::selection::{cycle_numbers, note_cycles};
use crate::pipeline::stored::chosen_cycles::{RunCycles, StoredError, identify_taken, take};
use crate::robot_code::code::TorqueCode;
use crate::robot_code::language::{CodeLanguage, SourceFile};
use crate::robot_code::origin::{CodeOrigin, GENERATED_BY};
use crate::robot_code::torque::CodeParameter;
use crate::robot_code::vectors::{ROUNDING, VECTOR_STATES};
use crate::robot_code::warm_up::{WarmUpCurves, scale_friction};
use armwatch_config::{Config, read_robot};
use armwatch_method::model::base_parameters::base_parameters;
use armwatch_method::pooled::nominal_prior::nominal_value;
use armwatch_model::analysis::FrictionPoint;
use armwatch_model::robot::{FrictionLaw, FrictionModel, JointIndex, ParameterId, Robot};
use armwatch_store::{ParameterSet, SourceCycle, Store};

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  armwatch robot code --run 3 --cycles 6-24 --language c -o left
  armwatch robot code --parameters left-warm --language rust -o left
  armwatch robot code --run 3 --friction-minute 0 --language python -o cold
  armwatch robot code --description-only --language c -o nominal \\
      --description config/robots/er3a.toml

The command writes the function torque(q, qd, qdd) of the identified model with its constants, as source that
needs no library: rigid links, gravity, motor inertia, friction, coupled motors; SI units. A comment has
equations, signs, recordings and thermal state. Two more files are vectors.csv, states with the torques of
armwatch, and self_check.*, which prints the largest difference from them and the nanoseconds per call:
  C       cc -std=c99 -O2 -o self_check self_check.c *_torque.c -lm && ./self_check
  Rust    rustc --edition 2021 -O self_check.rs && ./self_check
  Python  python3 self_check.py

Friction is that of the chosen cycles. --friction-minute scales it to another minute of the recording with the
warm-up curves of its friction stages. The same input gives the same bytes. Before the command writes anything, it
compares the formulas with its own at all test vectors. If a file of the same name exists that this command did
not write, the command writes nothing, unless --force is given.")]
#[command(group(ArgGroup::new("model").args(["runs", "parameters", "description_only"]).required(true)))]
pub(in crate::cli) struct RobotCodeArgs {
    /// Run whose cycles are used; may be repeated
    #[arg(help_heading = "Model", long = "run", value_name = "RUN")]
    runs: Vec<i64>,
    /// Saved parameter set
    #[arg(help_heading = "Model", long, value_name = "SET", conflicts_with_all = ["runs", "cycles"])]
    parameters: Option<String>,
    /// Use the nominal parameters of the description, with warm friction; needs no database
    #[arg(help_heading = "Model", long, requires = "description", conflicts_with_all = ["cycles", "friction_minute"])]
    description_only: bool,
    /// Cycles of each run, such as 10,15,20 or 6-24 [default: all]
    #[arg(help_heading = "Model", long, value_name = "CYCLES")]
    cycles: Option<String>,
    /// Robot description [default: the configured one, used for the analysis of the cycles]
    #[arg(help_heading = "Model", long, value_name = "FILE")]
    description: Option<PathBuf>,
    /// Scale friction to this minute since the start of the recording
    #[arg(help_heading = "Model", long, value_name = "MINUTE")]
    friction_minute: Option<f64>,
    /// Language; may be repeated
    #[arg(help_heading = "Code", long = "language", value_name = "LANGUAGE", value_enum, required = true)]
    languages: Vec<LanguageArg>,
    /// Name of the files and functions, changed to an identifier [default: the model of the description]
    #[arg(help_heading = "Code", long, value_name = "NAME")]
    name: Option<String>,
    /// Folder to write to; created if missing
    #[arg(help_heading = "Code", short, long, value_name = "DIR")]
    output: PathBuf,
    /// Replace files that this command did not write
    #[arg(help_heading = "Code", long)]
    force: bool,
}

/// A language as an argument.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct LanguageArg(CodeLanguage);

impl ValueEnum for LanguageArg {
    fn value_variants<'a>() -> &'a [Self] {
        const ALL: [LanguageArg; CodeLanguage::ALL.len()] = {
            let [first, second, third] = CodeLanguage::ALL;
            [LanguageArg(first), LanguageArg(second), LanguageArg(third)]
        };
        &ALL
    }

    fn to_possible_value(&self) -> Option<PossibleValue> {
        Some(PossibleValue::new(self.0.name()))
    }
}

/// Parameters of an arm with their origin.
struct CodeModel {
    robot: Arc<Robot>,
    parameters: Vec<CodeParameter>,
    origin: CodeOrigin,
    sources: Vec<SourceCycle>,
    /// Factor of each joint's friction, if it was scaled.
    friction_factors: Option<Vec<f64>>,
}

pub(in crate::cli) fn code(global: &Global, args: &RobotCodeArgs) -> Result<u8, CliError> {
    let model = match (&args.description, args.description_only) {
        (Some(path), true) => nominal(Arc::new(read_robot(path)?))?,
        _ => {
            let config = global.read_config()?;
            let cycles = args.cycles.as_deref().map(cycle_numbers).transpose().map_err(CliError::Usage)?;
            runtime()?.block_on(async {
                let store = open_to_read(&config).await?;
                let done = identified(&config, args, cycles, &store).await;
                store.close().await?;
                done
            })?
        }
    };
    let name = args.name.as_deref().unwrap_or(&model.robot.model);
    let code = TorqueCode::new(&model.robot, &model.parameters, name, &model.origin);
    let difference = code.largest_difference();
    if !difference.is_finite() {
        return Err(CliError::Usage(
            "the torques of this model are not finite; check parameters and description".into(),
        ));
    }
    if difference > ROUNDING {
        return Err(CliError::Internal(format!(
            "the code's formulas differ from the regressor by {difference:.1e} of a joint's torque scale, more than \
             rounding ({ROUNDING:.0e}); nothing is written"
        )));
    }
    let mut files: Vec<SourceFile> = Vec::new();
    for language in &args.languages {
        files.extend(
            code.files(language.0).into_iter().filter(|file| !files.contains(file)).collect::<Vec<_>>(),
        );
    }
    write(&args.output, &files, args.force)?;
    if global.json {
        output::json(&as_value(&model, &code, difference, args, &files));
    } else {
        output::block(&as_text(&model, &code, difference));
        files.iter().for_each(|file| {
            output::print_hint(&format!("wrote {}", args.output.join(&file.name).display()));
        });
    }
    Ok(EXIT_DONE)
}

async fn identified(
    config: &Config,
    args: &RobotCodeArgs,
    cycles: Option<Vec<u32>>,
    store: &Store,
) -> Result<CodeModel, CliError> {
    let set = match &args.parameters {
        Some(name) => store.parameter_set(name).await?.ok_or_else(|| {
            CliError::Usage(format!(
                "\"{name}\" is not a saved parameter set; `armwatch identify --save {name}` creates one, \
                --run uses a run"
            ))
        })?,
        None => {
            let of_run = |&run_id| RunCycles { run_id, cycles: cycles.clone(), named: true };
            let taken = take(store, &args.runs.iter().map(of_run).collect::<Vec<_>>()).await?;
            note_cycles(&taken.passed_over, &taken.in_spite);
            identify_taken(taken, config.analysis.estimator).await?
        }
    };
    let robot = match &args.description {
        Some(path) => Arc::new(read_robot(path)?),
        None => described(config, &set.model)?,
    };
    if !set.model.describes(&robot) {
        return Err(CliError::Usage(format!(
            "the description {} is not the one that the cycles were analysed with ({}): geometry, gravity, \
            friction columns or couplings differ; give the right one with --description",
            robot.model, set.model.name
        )));
    }
    let warm_up = warm_up(store, &set.sources).await?;
    let mut parameters = with_groupings(&robot, &set)?;
    let friction_factors = match args.friction_minute {
        Some(minute) => Some(factors_at(&robot, &warm_up, minute)?),
        None => None,
    };
    if let Some(factors) = &friction_factors {
        scale_friction(&robot, &mut parameters, factors);
    }
    let mut lines = vec![format!(
        "Base parameters identified from excitation rows, estimator {}, of",
        set.estimator.name()
    )];
    let recorded = recorded(store, &set.sources).await?;
    lines.extend(source_lines(&set.sources, &recorded).into_iter().map(|line| format!("  {line}")));
    lines.push(
        "Each is a sum of link parameters, listed in its comment: a single one is not a property of a body, \
        and missing masses are part of others. Together they give the torque of the arm."
            .to_owned(),
    );
    let friction = warm_up_lines(&robot, &warm_up, args.friction_minute, friction_factors.as_deref());
    let origin = CodeOrigin { program: program(), parameters: lines, friction };
    Ok(CodeModel { robot, parameters, origin, sources: set.sources, friction_factors })
}

fn program() -> String {
    format!("armwatch {}", env!("CARGO_PKG_VERSION"))
}

/// The values of a set with their errors and the sums that they represent.
fn with_groupings(robot: &Robot, set: &ParameterSet) -> Result<Vec<CodeParameter>, CliError> {
    let base = base_parameters(robot).map_err(|error| CliError::from(StoredError::Numerics(error)))?;
    let stands_for = |id: ParameterId| {
        let at = base.kept.iter().position(|kept| *kept == id)?;
        (!base.grouping[at].is_empty()).then(|| base.grouping_formula(at))
    };
    let of = set.identification.parameters.iter();
    Ok(of
        .map(|of| CodeParameter {
            id: of.id,
            value: of.value,
            std_error: Some(of.std_error),
            stands_for: stands_for(of.id),
        })
        .collect())
}

/// Warm-up curves of the runs, and the middles of the chosen cycles.
pub(super) async fn warm_up(store: &Store, sources: &[SourceCycle]) -> Result<WarmUpCurves, CliError> {
    let mut runs: Vec<i64> = sources.iter().map(|source| source.run_id).collect();
    runs.sort_unstable();
    runs.dedup();
    let (mut points, mut minutes) = (Vec::<FrictionPoint>::new(), Vec::new());
    for run_id in runs {
        let measured = store.run_measurements(run_id).await?;
        let is_chosen = |cycle: u32| sources.iter().any(|of| (of.run_id, of.cycle) == (run_id, cycle));
        points.extend(measured.friction_points.iter().map(|of| of.point));
        minutes.extend(measured.parameters.iter().filter(|of| is_chosen(of.cycle)).map(|of| of.minute));
    }
    Ok(WarmUpCurves::new(&points, minutes))
}

/// Factors of each joint's friction at a minute of the recording.
pub(super) fn factors_at(robot: &Robot, warm_up: &WarmUpCurves, minute: f64) -> Result<Vec<f64>, CliError> {
    let last = warm_up.last_minute().unwrap_or(0.0);
    if last > 0.0 && !(0.0..=last).contains(&minute) {
        return Err(CliError::Usage(format!(
            "--friction-minute {minute}: friction was measured until minute {last:.1}; give a minute from 0 to this"
        )));
    }
    let of_joint = |joint: JointIndex| {
        warm_up.relative_friction(joint, minute).ok_or_else(|| {
            CliError::Usage(format!(
                "joint {joint} has no warm-up curve, so that its friction at minute {minute} is unknown: \
                its friction stages show none; omit --friction-minute to use the friction of the chosen \
                cycles"
            ))
        })
    };
    robot.joint_indices().map(of_joint).collect()
}

/// Text on the temperature for which the friction holds.
pub(super) fn warm_up_lines(
    robot: &Robot,
    warm_up: &WarmUpCurves,
    minute: Option<f64>,
    factors: Option<&[f64]>,
) -> Vec<String> {
    let when = match warm_up.minutes() {
        None => "as in the excitation of these cycles, minutes since the start of the recording unknown"
            .to_owned(),
        Some([first, last]) if last - first < 0.05 => {
            format!("as in the excitation of this cycle, whose middle is minute {first:.1} of the recording")
        }
        Some([first, last]) => format!(
            "the mean over the excitation of these cycles, whose middles are minutes {first:.1} to {last:.1} of the recording"
        ),
    };
    if let (Some(minute), Some(factors)) = (minute, factors) {
        let factors: Vec<String> = factors.iter().map(|factor| format!("{factor:.3}")).collect();
        return vec![format!(
            "at minute {minute} of the recording: {when}, times {} (joints 1 to {}) by the warm-up curves of its friction \
             stages",
            factors.join(", "),
            robot.joint_count()
        )];
    }
    let Some(last) = warm_up.last_minute() else {
        return vec![when, "thermal state unknown: the recording has no warm-up curves".to_owned()];
    };
    let at_end = |joint| warm_up.relative_friction(joint, last);
    let ends = robot.joint_indices().map(at_end);
    let shown =
        |at_end: Option<f64>| at_end.map_or_else(|| "unknown".to_owned(), |at| format!("{:.3}", 1.0 / at));
    let shares: Vec<String> = ends.map(shown).collect();
    vec![
        when,
        format!(
            "as a multiple of friction at minute {last:.0}, the end of the recording: {} (joints 1 to {})",
            shares.join(", "),
            robot.joint_count()
        ),
    ]
}

/// The model of a description's nominal parameters. Its friction is the given polynomial, regardless of the columns
/// that identify the arm; a joint without friction in the measured torque has none.
fn nominal(robot: Arc<Robot>) -> Result<CodeModel, CliError> {
    let mut robot = Robot::clone(&robot);
    let missing: Vec<String> = robot
        .joint_indices()
        .filter(|j| robot.joints[j.index()].nominal.is_none())
        .map(|j| j.to_string())
        .collect();
    if !missing.is_empty() {
        return Err(CliError::Usage(format!(
            "the description {} has no nominal parameters of joints {}: add [joint.nominal], or use the \
            identified ones with --run",
            robot.model,
            missing.join(", ")
        )));
    }
    for joint in robot.joint_indices() {
        let law = robot.friction_of(joint).law;
        let own = if law == FrictionLaw::None { robot.friction_of(joint) } else { FrictionModel::POLYNOMIAL };
        robot.joints[joint.index()].friction = Some(own);
    }
    let parameters = ParameterId::natural_order(&robot)
        .iter()
        .filter_map(|id| {
            Some(CodeParameter {
                id: *id,
                value: nominal_value(&robot, *id)?,
                std_error: None,
                stands_for: None,
            })
        })
        .collect();
    let mut lines = vec!["Nominal parameters of the description: nothing here was identified.".to_owned()];
    if !robot.couplings.is_empty() {
        lines.push("Coupled motors have no nominal parameters: their effect is omitted.".to_owned());
    }
    if robot.springs.iter().any(|spring| spring.nominal.is_none())
        || robot.parallelograms.iter().any(|of| of.nominal.is_none())
    {
        lines.push("Springs and cranks without nominal parameters are omitted.".to_owned());
    }
    let origin = CodeOrigin {
        program: program(),
        parameters: lines,
        friction: vec!["warm, from the description".to_owned()],
    };
    let robot = Arc::new(robot);
    Ok(CodeModel { robot, parameters, origin, sources: Vec::new(), friction_factors: None })
}

/// Writes all files, or none if one of them would replace a file from another origin.
fn write(folder: &Path, files: &[SourceFile], force: bool) -> Result<(), CliError> {
    for file in files.iter().filter(|_| !force) {
        let path = folder.join(&file.name);
        let known = match std::fs::read(&path) {
            Ok(known) => known,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => continue,
            Err(error) => return Err(not_written(&path, &error)),
        };
        if !is_generated(&known, file) {
            return Err(CliError::Usage(format!(
                "{} was not written by this command, so nothing is written; name another folder with -o, or \
                replace it with --force",
                path.display()
            )));
        }
    }
    std::fs::create_dir_all(folder).map_err(|error| not_written(folder, &error))?;
    for file in files {
        let path = folder.join(&file.name);
        std::fs::write(&path, &file.text).map_err(|error| not_written(&path, &error))?;
    }
    Ok(())
}

/// Returns true if a file was written by this command: sources contain a mark in their first lines, the test vectors
/// have the header of such a table.
fn is_generated(known: &[u8], file: &SourceFile) -> bool {
    const FIRST_LINES: usize = 3;
    let text = String::from_utf8_lossy(known);
    match file.name.ends_with(".csv") {
        true => text.lines().next().is_some_and(|header| {
            header.starts_with("q_1_") && header.contains(",qdd_1_") && header.contains(",tau_1_")
        }),
        false => text.lines().take(FIRST_LINES).any(|line| line.contains(GENERATED_BY)),
    }
}

fn as_text(model: &CodeModel, code: &TorqueCode, difference: f64) -> String {
    format!(
        "{}: {} joints, {} parameters, {} sums and products per call\n{VECTOR_STATES} test vectors; the \
        formulas differ from the regressor by at most {difference:.1e} of a joint's torque scale",
        code.name,
        model.robot.joint_count(),
        model.parameters.iter().filter(|of| of.value != 0.0).count(),
        code.operations()
    )
}

fn as_value(
    model: &CodeModel,
    code: &TorqueCode,
    difference: f64,
    args: &RobotCodeArgs,
    files: &[SourceFile],
) -> serde_json::Value {
    json!({
        "name": code.name,
        "model": model.robot.model,
        "joints": model.robot.joint_count(),
        "languages": args.languages.iter().map(|language| language.0.name()).collect::<Vec<_>>(),
        "files": files.iter().map(|file| args.output.join(&file.name).display().to_string()).collect::<Vec<_>>(),
        "nominal": args.description_only,
        "sources": model.sources,
        "parameters": model.parameters.len(),
        "friction_factors": model.friction_factors,
        "operations": code.operations(),
        "states": VECTOR_STATES,
        "torque_scales_nm": code.vectors.torque_scales(),
        "largest_relative_difference": difference,
    })
}
