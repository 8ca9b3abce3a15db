//! `armwatch robot urdf`: bodies of all links from chosen cycles, as a table and as a URDF file.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use clap::{ArgGroup, Args};
use jiff::Timestamp;
use serde_json::json;

use super::sources::{described, recorded, source_lines};
use crate::cli::context::{CliError, EXIT_DONE, EXIT_FOUND, Global, open_to_read, runtime};
use crate::cli::shared::output;
use crate::cli::shared::result_file::{result_file, write_lines};
use crate::cli::shared::selection::{cycle_numbers, note_cycles};
use crate::pipeline::stored::chosen_cycles::{RunCycles, take};
use crate::pipeline::stored::physical::fit_bodies;
use crate::urdf_writer::{straight_friction, urdf_text};
use armwatch_config::{Config, read_robot};
use armwatch_method::physical::data_share::{BodyEstimate, Estimated};
use armwatch_method::physical::fit::PhysicalFit;
use armwatch_method::physical::uniform_bodies::BodySource;
use armwatch_model::robot::{JointIndex, Robot};
use armwatch_store::{SourceCycle, Store};

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  armwatch robot urdf --run 3 -o arm.urdf
  armwatch robot urdf --run 3 --cycles 6-24 -o warm.urdf --json
  armwatch robot urdf --parameters left-warm \\
      --description config/robots/er3a.toml -o left.urdf

The command fits mass, centre of mass and inertia of every link to the stored excitation rows of the chosen
cycles, such that each link is a body of positive density. Quantities that the torques do not show stay near the
nominal inertia of the description, or near cylinders along the links if there is none; a ~ marks them. The fit
includes motor inertia and friction, but the inertial tags do not contain them. Positions in the file are q:
recorded position plus position offset. Exit status 1 if the fit did not converge; nothing is then written.")]
pub(in crate::cli) struct RobotUrdfArgs {
    #[command(flatten)]
    cycles: BodyCycles,
    /// URDF file to write; an existing file is replaced
    #[arg(short, long, value_name = "FILE", value_parser = result_file())]
    output: PathBuf,
}

#[derive(Debug, Args)]
#[command(group(ArgGroup::new("recordings").args(["runs", "parameters"]).required(true)))]
pub(super) struct BodyCycles {
    /// Run whose cycles are used; may be repeated
    #[arg(long = "run", value_name = "RUN")]
    runs: Vec<i64>,
    /// Saved parameter set whose cycles are used
    #[arg(long, value_name = "SET", conflicts_with_all = ["runs", "cycles"])]
    parameters: Option<String>,
    /// Cycles of each run, such as 10,15,20 or 6-24 [default: all]
    #[arg(long, value_name = "CYCLES")]
    cycles: Option<String>,
    /// Robot description [default: the configured one, used for the analysis of the cycles]
    #[arg(long, value_name = "FILE")]
    description: Option<PathBuf>,
}

/// Data of the fit for the report.
pub(super) struct Fitted {
    pub(super) robot: Arc<Robot>,
    pub(super) sources: Vec<SourceCycle>,
    /// Start of each run's recording.
    recorded: BTreeMap<i64, Timestamp>,
    pub(super) fit: PhysicalFit,
}

pub(in crate::cli) fn urdf(global: &Global, args: &RobotUrdfArgs) -> Result<u8, CliError> {
    let config = global.read_config()?;
    let fitted = runtime()?.block_on(async {
        let store = open_to_read(&config).await?;
        let done = args.cycles.fit(&config, &store).await;
        store.close().await?;
        done
    })?;
    if !fitted.is_settled() {
        return Ok(EXIT_FOUND);
    }
    let text = urdf_text(&fitted.robot, &fitted.fit.estimate.model, &comments(&fitted));
    write_lines(&args.output, text.lines().map(str::to_owned))?;
    if global.json {
        output::json(&as_value(&fitted, "urdf", &args.output));
    } else {
        output::block(&as_text(&fitted));
    }
    Ok(EXIT_DONE)
}

impl BodyCycles {
    /// Fits bodies to the stored rows of the chosen cycles.
    pub(super) async fn fit(&self, config: &Config, store: &Store) -> Result<Fitted, CliError> {
        let cycles = self.cycles.as_deref().map(cycle_numbers).transpose().map_err(CliError::Usage)?;
        let of_run = |&run_id| RunCycles { run_id, cycles: cycles.clone(), named: true };
        let chosen = match &self.parameters {
            None => self.runs.iter().map(of_run).collect(),
            Some(name) => cycles_of_set(store, name).await?,
        };
        let taken = take(store, &chosen).await?;
        note_cycles(&taken.passed_over, &taken.in_spite);
        let robot = match &self.description {
            Some(path) => Arc::new(read_robot(path)?),
            None => described(config, &taken.model)?,
        };
        let sources = taken.sources.clone();
        let fit = fit_bodies(taken, Arc::clone(&robot)).await?;
        let recorded = recorded(store, &sources).await?;
        Ok(Fitted { robot, sources, recorded, fit })
    }
}

impl Fitted {
    /// Returns true if there is a result; reports it otherwise.
    pub(super) fn is_settled(&self) -> bool {
        if !self.fit.estimate.settled {
            output::print_error(&format!(
                "the fit did not converge in {} steps, so nothing is written; choose more cycles, or a \
                description with nominal inertia",
                self.fit.estimate.steps
            ));
        }
        self.fit.estimate.settled
    }
}

async fn cycles_of_set(store: &Store, name: &str) -> Result<Vec<RunCycles>, CliError> {
    let set = store.parameter_set(name).await?.ok_or_else(|| {
        CliError::Usage(format!(
            "\"{name}\" is not a saved parameter set; `armwatch identify --save {name}` creates one, --run uses a run"
        ))
    })?;
    let chosen = |source: SourceCycle| RunCycles {
        run_id: source.run_id,
        cycles: Some(vec![source.cycle]),
        named: true,
    };
    Ok(set.sources.into_iter().map(chosen).collect())
}

/// Origin of the numbers, for the head of the file.
pub(super) fn comments(fitted: &Fitted) -> Vec<String> {
    let mut comments = vec![format!(
        "physically consistent parameters identified by armwatch {} with the description {}",
        env!("CARGO_PKG_VERSION"),
        fitted.robot.model
    )];
    comments.extend(source_lines(&fitted.sources, &fitted.recorded));
    comments.push(format!("not decided by data: {}", undecided(&fitted.fit).join(", ")));
    comments
}

/// Names of the numbers that the data do not determine, link by link, or of those that they do if these are fewer.
fn undecided(fit: &PhysicalFit) -> Vec<String> {
    let numbers = || {
        let bodies = fit.estimate.bodies.iter().flat_map(|body| body.values);
        bodies.chain(fit.estimate.motor_inertia.iter().copied())
    };
    let open = numbers().filter(|of| !of.is_decided()).count();
    let decided = 2 * open > numbers().count();
    let listed = named(fit, |of| of.is_decided() == decided);
    match (listed.is_empty(), decided) {
        (true, true) => vec!["everything".into()],
        (true, false) => vec!["nothing".into()],
        (false, true) => vec![format!("all but {}", listed.join(", "))],
        (false, false) => listed,
    }
}

/// The numbers that `of` selects, link by link.
fn named(fit: &PhysicalFit, of: impl Fn(&Estimated) -> bool) -> Vec<String> {
    let of_link = |(j, body): (usize, &BodyEstimate)| {
        let names = BodyEstimate::NAMES.iter().zip(body.values);
        let chosen: Vec<&str> =
            names.filter(|(_, value)| of(value)).map(|(name, _)| short_name(name)).collect();
        (!chosen.is_empty()).then(|| format!("link {} {}", j + 1, chosen.join(" ")))
    };
    let motors = fit.estimate.motor_inertia.iter().enumerate().filter(|(_, value)| of(value));
    let links = fit.estimate.bodies.iter().enumerate().filter_map(of_link);
    links.chain(motors.map(|(j, _)| format!("motor {}", j + 1))).collect()
}

/// Without the unit.
fn short_name(name: &str) -> &str {
    name.trim_end_matches("_kg_m2").trim_end_matches("_kg").trim_end_matches("_m")
}

pub(super) fn as_text(fitted: &Fitted) -> String {
    let fit = &fitted.fit;
    let (estimate, start) = (&fit.estimate, &fit.start);
    let leaned = match start.density {
        None => "the description's nominal inertia".to_owned(),
        Some(density) if start.sources.contains(&BodySource::Description) => {
            format!("nominal inertia and, without it, cylinders of {density:.0} kg/m^3 along the links")
        }
        Some(density) => format!("cylinders of {density:.0} kg/m^3 along the links"),
    };
    format!(
        "{} cycles, model {}; fitted in {} steps, drawn towards {leaned}\n\nLinks: centre of mass in the \
        link's frame, inertia about the centre of mass; ~ not decided by data\n{}\n\n{}\n\nPrice of \
        physics, moving excitation rows\n{}\n\nNot decided by data: {}",
        fitted.sources.len(),
        fitted.robot.model,
        estimate.steps,
        bodies(fit),
        inertias(fit),
        price(fit),
        undecided(fit).join("; "),
    )
}

fn shown(of: &Estimated, digits: usize) -> String {
    let mark = if of.is_decided() { "" } else { "~" };
    format!("{mark}{:.digits$}", of.value)
}

fn bodies(fit: &PhysicalFit) -> String {
    let rows = fit.estimate.bodies.iter().enumerate().map(|(j, body)| {
        let [mass, x, y, z, ..] = &body.values;
        let motor = &fit.estimate.motor_inertia[j];
        vec![
            JointIndex::new(j).to_string(),
            shown(mass, 3),
            format!("{:.3}", mass.std),
            format!("{:.0}", 100.0 * mass.data_share()),
            shown(x, 4),
            shown(y, 4),
            shown(z, 4),
            shown(motor, 5),
            format!("{:.5}", motor.std),
        ]
    });
    output::table(
        &[
            "link",
            "mass_kg",
            "std_kg",
            "by_data_%",
            "centre_x_m",
            "centre_y_m",
            "centre_z_m",
            "motor_inertia_kg_m2",
            "std_kg_m2",
        ],
        &rows.collect::<Vec<_>>(),
    )
}

fn inertias(fit: &PhysicalFit) -> String {
    let rows = fit.estimate.bodies.iter().zip(&fit.estimate.definiteness).enumerate().map(
        |(j, (body, definiteness))| {
            let mut row = vec![JointIndex::new(j).to_string()];
            row.extend(body.values[4..].iter().map(|of| shown(of, 5)));
            row.push(format!("{definiteness:.1e}"));
            row
        },
    );
    let header: Vec<&str> = ["link"]
        .into_iter()
        .chain(BodyEstimate::NAMES[4..].iter().copied())
        .chain(["definiteness"])
        .collect();
    output::table(&header, &rows.collect::<Vec<_>>())
}

fn price(fit: &PhysicalFit) -> String {
    let rows = fit.price.iter().map(|of| {
        vec![
            of.joint.to_string(),
            of.samples.to_string(),
            format!("{:.4}", of.unconstrained_rmsd),
            format!("{:.4}", of.consistent_rmsd),
            format!("{:.2}", 100.0 * (of.consistent_rmsd / of.unconstrained_rmsd - 1.0)),
            format!("{:.4}", of.consistent_rmsd / of.torque_rms),
        ]
    });
    output::table(
        &["joint", "samples", "unconstrained_nm", "consistent_nm", "price_%", "relative"],
        &rows.collect::<Vec<_>>(),
    )
}

fn estimated_value(of: &Estimated) -> serde_json::Value {
    json!({
        "value": of.value, "std_error": of.std, "std_without_data": of.std_without_data,
        "data_share": of.data_share(), "decided_by_data": of.is_decided(),
    })
}

pub(super) fn as_value(fitted: &Fitted, format: &str, output: &Path) -> serde_json::Value {
    let (robot, fit) = (&fitted.robot, &fitted.fit);
    let links = robot.joint_indices().map(|joint| {
        let j = joint.index();
        let named = BodyEstimate::NAMES.iter().zip(&fit.estimate.bodies[j].values);
        let friction = straight_friction(robot, &fit.estimate.model, joint);
        json!({
            "link": joint.number(),
            "assumption": fit.start.sources[j].name(),
            "body": named.map(|(name, of)| ((*name).to_owned(), estimated_value(of)))
                .collect::<serde_json::Map<_, _>>(),
            "definiteness": fit.estimate.definiteness[j],
            "motor_inertia_kg_m2": estimated_value(&fit.estimate.motor_inertia[j]),
            "damping_nm_s_rad": friction.damping,
            "friction_nm": friction.friction,
        })
    });
    json!({
        format: output.display().to_string(),
        "model": robot.model,
        "sources": fitted.sources,
        "steps": fit.estimate.steps,
        "residual_sum_of_squares": fit.estimate.residual_sum_of_squares,
        "unconstrained_sum_of_squares": fit.estimate.unconstrained_sum_of_squares,
        "scaled_condition_number": fit.scaled_condition_number,
        "start_density_kg_m3": fit.start.density,
        "links": links.collect::<Vec<_>>(),
        "price_of_physics": fit.price.iter().map(|of| json!({
            "joint": of.joint.number(), "samples": of.samples, "torque_rms_nm": of.torque_rms,
            "unconstrained_rmsd_nm": of.unconstrained_rmsd, "consistent_rmsd_nm": of.consistent_rmsd,
        })).collect::<Vec<_>>(),
        "not_decided_by_data": undecided(fit),
    })
}
