//! `armwatch robot drive-gains`: the errors of the gains between current and torque.

use clap::Args;
use serde_json::json;

use crate::cli::context::{CliError, EXIT_DONE, EXIT_FOUND, Global, open_to_read, runtime};
use crate::cli::shared::load::LoadArgs;
use crate::cli::shared::output;
use crate::cli::shared::selection::{cycle_numbers, no_run};
use crate::pipeline::stored::chosen_cycles::RunCycles;
use crate::pipeline::stored::drive_gain::stored_drive_gains;
use armwatch_config::{Config, FleetEntry};
use armwatch_method::pooled::drive_gain::{GainEstimate, JointGain, Unseen};
use armwatch_model::robot::StandardParameters;
use armwatch_store::Store;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  armwatch robot drive-gains --without 1 --with 2 --load-mass-kg 5 \\
      --load-centre-m 0,0,0.08
  armwatch robot drive-gains --without 1 --with 2 --cycles 3-8 --json \\
      --load-mass-kg 5 --load-centre-m 0,0,0.08 \\
      --load-inertia-kg-m2 0.02,0,0,0.02,0,0.01

Record the same test twice, without and with a load whose mass and centre of mass are known. Ingest both
recordings with one configuration. The command uses factors stored with the cycles and reads no export. The true
gain of a joint is the one in the description times the correction. A joint whose torque hardly depends on the
load gets a reason and no value. The load must be rigidly attached. Its frame is [tool] of the description, or the
frame of the last joint if there is no [tool]. Exit status 1 if no joint has a result. See docs/exports.md.")]
pub(in crate::cli) struct DriveGainsArgs {
    /// Run without the load; may be repeated
    #[arg(long = "without", value_name = "RUN", required = true)]
    without: Vec<i64>,
    /// Run with the load; may be repeated
    #[arg(long = "with", value_name = "RUN", required = true)]
    with: Vec<i64>,
    #[command(flatten)]
    load: LoadArgs,
    /// Cycles of each run, such as 3,10-15 [default: all]
    #[arg(long, value_name = "CYCLES")]
    cycles: Option<String>,
}

pub(in crate::cli) fn drive_gains(global: &Global, args: &DriveGainsArgs) -> Result<u8, CliError> {
    let config = global.read_config()?;
    let load = args.load.given()?.ok_or_else(|| {
        CliError::Usage("the load is missing: give --load-mass-kg and --load-centre-m".into())
    })?;
    let load = StandardParameters::from_centre_of_mass(load.mass, &load.centre, &load.inertia);
    let cycles = args.cycles.as_deref().map(cycle_numbers).transpose().map_err(CliError::Usage)?;
    if let Some(run) = args.without.iter().find(|run| args.with.contains(run)) {
        return Err(CliError::Usage(format!("run {run} cannot be both without and with the load")));
    }
    runtime()?.block_on(async {
        let store = open_to_read(&config).await?;
        let done = from_store(global, args, &config, load, cycles, &store).await;
        store.close().await?;
        done
    })
}

async fn from_store(
    global: &Global,
    args: &DriveGainsArgs,
    config: &Config,
    load: StandardParameters,
    cycles: Option<Vec<u32>>,
    store: &Store,
) -> Result<u8, CliError> {
    let entry = entry_of(args, config, store).await?;
    let robot = &entry.description;
    let chosen = |runs: &[i64]| -> Vec<RunCycles> {
        runs.iter().map(|&run_id| RunCycles { run_id, cycles: cycles.clone(), named: true }).collect()
    };
    let load = load.seen_from(&robot.tool);
    let gains = stored_drive_gains(store, robot, &chosen(&args.without), &chosen(&args.with), load).await?;
    if global.json {
        output::json(&as_value(entry, &gains));
    } else {
        output::block(&as_text(entry, &gains));
    }
    Ok(if gains.iter().any(|gain| gain.estimate.is_ok()) { EXIT_DONE } else { EXIT_FOUND })
}

/// Description and layout of the one robot that made the runs.
async fn entry_of<'c>(
    args: &DriveGainsArgs,
    config: &'c Config,
    store: &Store,
) -> Result<&'c FleetEntry, CliError> {
    let known = store.runs().await?;
    let mut robot: Option<&str> = None;
    for run in args.without.iter().chain(&args.with) {
        let row = known.iter().find(|row| row.run_id == *run);
        let row = row.ok_or_else(|| no_run(&known, *run))?;
        match robot {
            Some(other) if other != row.robot => {
                return Err(CliError::Usage(format!(
                    "run {run} is of robot {}, another run of {other}: choose runs of one robot",
                    row.robot
                )));
            }
            _ => robot = Some(&row.robot),
        }
    }
    let robot = robot.unwrap_or_default();
    config
        .robot_entry(robot)
        .ok_or_else(|| CliError::Usage(format!("the configuration has no [[robot]] for {robot}")))
}

/// Returns true if several motors contribute to a joint's torque, so that one factor mixes their gains.
fn is_blend(entry: &FleetEntry, gain: &JointGain) -> bool {
    let motors = entry.description.transmission.column(gain.joint.index());
    entry.layout.motor_side.torque && motors.iter().filter(|ratio| **ratio != 0.0).count() > 1
}

fn reason(unseen: &Unseen) -> String {
    match unseen {
        Unseen::NoRows => "a recording has too few rows with motion of the joint".into(),
        Unseen::NoTorque => {
            "the load gives this joint no torque: its axis is vertical, or the load is on it".into()
        }
        Unseen::NotApart => {
            "the joint moved differently without and with the load, so the torque of the load cannot be \
            separated from that of the arm; record the same motion twice"
                .into()
        }
        Unseen::TooWeak { load_rms, residual_std, std_error } => format!(
            "the effect of the load is too small: {load_rms:.3} Nm rms with a residual of {residual_std:.3} \
            Nm, standard error {:.0} % of the gain; use a heavier load on a longer lever, or more cycles",
            100.0 * std_error
        ),
    }
}

fn as_text(entry: &FleetEntry, gains: &[JointGain]) -> String {
    let now = entry.layout.drive_values(&entry.description);
    let found = gains.iter().filter_map(|gain| Some((gain, gain.estimate.as_ref().ok()?)));
    let row = |(gain, found): (&JointGain, &GainEstimate)| {
        let [low, high] = found.correction_interval();
        let key = now.as_ref().and_then(|values| values.get(gain.joint.index()));
        let (before, after) = key.map_or(("-".into(), "-".into()), |(_, value)| {
            (format!("{value:.6}"), format!("{:.6}", value * found.correction()))
        });
        vec![
            gain.joint.to_string(),
            format!("{:.5}", found.correction()),
            format!("{:.5}", found.correction_std_error()),
            format!("{low:.5}"),
            format!("{high:.5}"),
            before,
            after,
            format!("{:.3}", found.load_rms),
            format!("{:.3}", found.residual_std),
            format!("{} of {}+{}", found.error_from.name(), found.cycles[0], found.cycles[1]),
        ]
    };
    let rows: Vec<Vec<String>> = found.map(row).collect();
    let key = now.as_ref().and_then(|values| values.first()).map_or("gain", |(key, _)| *key);
    let after = format!("{key} then");
    let header = [
        "joint",
        "correction",
        "std_error",
        "95_%_from",
        "95_%_to",
        key,
        &after,
        "load_rms_nm",
        "residual_nm",
        "error_from",
    ];
    let mut text = output::table(&header, &rows);
    for gain in gains {
        if let Err(unseen) = &gain.estimate {
            text += &format!("\njoint {}: no result: {}", gain.joint, reason(unseen));
        } else if is_blend(entry, gain) {
            text += &format!(
                "\njoint {}: several motors make its torque; the correction is a mean of their gains, not \
                the gain of one motor",
                gain.joint
            );
        }
    }
    text
}

fn as_value(entry: &FleetEntry, gains: &[JointGain]) -> serde_json::Value {
    let now = entry.layout.drive_values(&entry.description);
    let of_joint = |gain: &JointGain| {
        let joint = gain.joint.number();
        match &gain.estimate {
            Err(unseen) => json!({ "joint": joint, "correction": null, "reason": reason(unseen) }),
            Ok(found) => {
                let key = now.as_ref().and_then(|values| values.get(gain.joint.index()));
                json!({
                    "joint": joint,
                    "scale": found.scale,
                    "scale_std_error": found.std_error,
                    "correction": found.correction(),
                    "correction_std_error": found.correction_std_error(),
                    "correction_interval": found.correction_interval(),
                    "key": key.map(|(key, _)| key),
                    "value": key.map(|(_, value)| value),
                    "corrected_value": key.map(|(_, value)| value * found.correction()),
                    "blend_of_motors": is_blend(entry, gain),
                    "load_rms_nm": found.load_rms,
                    "residual_std_nm": found.residual_std,
                    "error_from": found.error_from.name(),
                    "cycles_without": found.cycles[0],
                    "cycles_with": found.cycles[1],
                })
            }
        }
    };
    json!({ "model": entry.description.model, "joints": gains.iter().map(of_joint).collect::<Vec<_>>() })
}
