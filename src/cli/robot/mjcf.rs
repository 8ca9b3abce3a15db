//! `armwatch robot mjcf`: bodies, armature and friction of an arm as a MuJoCo file.

use std::path::PathBuf;

use clap::Args;
use serde_json::json;

use super::code::{factors_at, warm_up, warm_up_lines};
use super::urdf::{self, BodyCycles};
use crate::cli::context::{CliError, EXIT_DONE, EXIT_FOUND, Global, open_to_read, runtime};
use crate::cli::shared::output;
use crate::cli::shared::result_file::{result_file, write_lines};
use crate::urdf_writer::mjcf::{MjcfFriction, mjcf_friction, mjcf_text};
use armwatch_model::robot::JointIndex;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  armwatch robot mjcf --run 3 -o arm.xml
  armwatch robot mjcf --run 3 --cycles 6-24 -o warm.xml --json
  armwatch robot mjcf --run 3 --friction-minute 0 -o cold.xml

The bodies are those of `armwatch robot urdf`. armature is the rotor inertia at the joint. damping and
frictionloss are the straight line nearest to the friction of the model over both directions up to the largest
speed. The file and the table have the temperature of this friction, and its largest difference from the line, in
Nm (N). The file cannot describe motors that turn with two joints. Positions are q: recorded position plus
position offset. Exit status 1 if the fit did not converge; nothing is then written.")]
pub(in crate::cli) struct RobotMjcfArgs {
    #[command(flatten)]
    cycles: BodyCycles,
    /// Scale friction to this minute since the start of the recording
    #[arg(long, value_name = "MINUTE")]
    friction_minute: Option<f64>,
    /// MuJoCo file to write; an existing file is replaced
    #[arg(short, long, value_name = "FILE", value_parser = result_file())]
    output: PathBuf,
}

pub(in crate::cli) fn mjcf(global: &Global, args: &RobotMjcfArgs) -> Result<u8, CliError> {
    let config = global.read_config()?;
    let (fitted, warm_up, temperatures) = runtime()?.block_on(async {
        let store = open_to_read(&config).await?;
        let done = async {
            let fitted = args.cycles.fit(&config, &store).await?;
            let warm_up = warm_up(&store, &fitted.sources).await?;
            let cycles: Vec<(i64, u32)> = fitted.sources.iter().map(|of| (of.run_id, of.cycle)).collect();
            let temperatures = store.motor_temperatures(&cycles).await?;
            Ok::<_, CliError>((fitted, warm_up, temperatures))
        };
        let done = done.await;
        store.close().await?;
        done
    })?;
    if !fitted.is_settled() {
        return Ok(EXIT_FOUND);
    }
    let (robot, model) = (&fitted.robot, &fitted.fit.estimate.model);
    let factors = args.friction_minute.map(|minute| factors_at(robot, &warm_up, minute)).transpose()?;
    let factor = |joint: JointIndex| factors.as_ref().map_or(1.0, |factors| factors[joint.index()]);
    let friction: Vec<MjcfFriction> =
        robot.joint_indices().map(|joint| mjcf_friction(robot, model, joint, factor(joint))).collect();
    let mut state: Vec<String> = warm_up_lines(robot, &warm_up, args.friction_minute, factors.as_deref());
    state.push(match temperatures.iter().any(Option::is_some) {
        true => {
            let shown = |of: &Option<f64>| of.map_or_else(|| "unknown".to_owned(), |of| format!("{of:.1}"));
            let all: Vec<String> = temperatures.iter().map(shown).collect();
            format!(
                "mean motor temperatures in these cycles, degC: {} (joints 1 to {})",
                all.join(", "),
                all.len()
            )
        }
        false => "no motor temperatures were recorded".to_owned(),
    });
    let differences: Vec<String> =
        friction.iter().map(|of| format!("{:.4}", of.largest_difference)).collect();
    let mut comments = urdf::comments(&fitted);
    comments.extend(state.iter().map(|line| format!("friction: {line}")));
    comments.push(format!(
        "largest difference between friction and its line, Nm (N): {} (joints 1 to {})",
        differences.join(", "),
        robot.joint_count()
    ));
    let text = mjcf_text(robot, model, &friction, &comments);
    write_lines(&args.output, text.lines().map(str::to_owned))?;
    if global.json {
        let mut value = urdf::as_value(&fitted, "mjcf", &args.output);
        value["friction_state"] = json!(state);
        value["motor_temperatures_degc"] = json!(temperatures);
        value["friction_factors"] = json!(factors);
        value["joints"] = robot
            .joint_indices()
            .zip(&friction)
            .map(|(joint, of)| {
                json!({
                    "joint": joint.number(),
                    "armature_kg_m2": model.motor_inertia[joint.index()],
                    "damping_nm_s_rad": of.line.damping,
                    "frictionloss_nm": of.line.friction,
                    "largest_difference_nm": of.largest_difference,
                })
            })
            .collect();
        output::json(&value);
    } else {
        output::block(&urdf::as_text(&fitted));
        output::block(&table(model.motor_inertia.as_slice(), &friction, &state));
    }
    Ok(EXIT_DONE)
}

fn table(armature: &[f64], friction: &[MjcfFriction], state: &[String]) -> String {
    let rows = armature.iter().zip(friction).enumerate().map(|(j, (armature, of))| {
        vec![
            JointIndex::new(j).to_string(),
            format!("{armature:.5}"),
            format!("{:.4}", of.line.damping),
            format!("{:.4}", of.line.friction),
            format!("{:.4}", of.largest_difference),
        ]
    });
    let header = ["joint", "armature_kg_m2", "damping_nm_s_rad", "frictionloss_nm", "largest_difference_nm"];
    let rows = output::table(&header, &rows.collect::<Vec<_>>());
    format!("\nFriction as a straight line; {}\n{rows}", state.join("; "))
}
