//! `armwatch payload`: mass, centre and inertia of the load of an arm.

use clap::Args;

use super::context::{CliError, EXIT_DONE, EXIT_FOUND, Global, open_to_read, runtime};
use super::shared::output;
use crate::pipeline::stored::payload::{PayloadQuantity, RunPayload, payload_of_runs};

#[derive(Debug, Clone, Args)]
#[command(after_help = "\
Examples:
  armwatch payload --empty 1 --loaded 2
  armwatch payload --empty R01_2026-01-05.csv --loaded R01_2026-01-06.csv --json

The command prints mass, centre of mass and inertia of a load that the arm carries in one test but not in the
other, with 95 % intervals. Record the same motion twice and ingest both recordings with one configuration. The
command reads stored factors and no export. Intervals include the error of the model without the load and the
error of the drive gains: gain_uncertainty in [[robot]], 0.15 by default. The frame is [tool] of the description,
or the frame of the last joint if there is no [tool]. A dash marks a quantity that the motion does not show. Exit
status 1 if the motion does not show the mass. See docs/exports.md.")]
pub(super) struct PayloadArgs {
    /// Test without the load: number of the run or name of its export
    #[arg(long, value_name = "RUN")]
    empty: String,
    /// Test with the load: number of the run or name of its export
    #[arg(long, value_name = "RUN")]
    loaded: String,
}

pub(super) fn payload(global: &Global, args: &PayloadArgs) -> Result<u8, CliError> {
    let config = global.read_config()?;
    let found = runtime()?.block_on(async {
        let store = open_to_read(&config).await?;
        let found = payload_of_runs(&config, &store, &args.empty, &args.loaded).await;
        store.close().await?;
        found.map_err(CliError::from)
    })?;
    if global.json {
        output::json(&found);
    } else {
        output::block(&as_text(&found));
    }
    Ok(if found.has_mass() { EXIT_DONE } else { EXIT_FOUND })
}

fn as_text(found: &RunPayload) -> String {
    let number = |value: Option<f64>| value.map_or_else(|| "-".to_owned(), |value| format!("{value:.4}"));
    let row = |of: &PayloadQuantity| {
        vec![of.quantity.to_owned(), number(of.value), number(of.interval_low), number(of.interval_high)]
    };
    let rows: Vec<Vec<String>> = found.quantities.iter().map(row).collect();
    let [empty, loaded] = found.cycles;
    let mut text = format!(
        "{}: run {} ({loaded} cycles) compared with run {} ({empty} cycles)\n{}\ndrive gains: error up to {:.0} %",
        found.robot,
        found.loaded_run_id,
        found.empty_run_id,
        output::table(&["quantity", "value", "95_%_from", "95_%_to"], &rows),
        100.0 * found.gain_uncertainty,
    );
    if found.gain_uncertainty > found.stated_gain_uncertainty {
        text += &format!(
            "; the joints contradict gain_uncertainty = {} of the configuration",
            found.stated_gain_uncertainty
        );
    }
    let unseen = found.unseen();
    if !unseen.is_empty() {
        text += &format!(
            "\nthe motion does not show {}: move the joints that turn the load faster and through more \
            orientations, or use a heavier load",
            unseen.join(", ")
        );
    }
    text
}
