//! `armwatch alerts test`: sends a message that is marked as a test over routes.

use clap::Args;
use serde_json::json;

use crate::alert::trial;
use crate::cli::context::{CliError, EXIT_DONE, EXIT_IO, Global};
use crate::cli::shared::named_value::{one_of, plain};
use crate::cli::shared::output;
use armwatch_config::{AlertSettings, Route};
use armwatch_model::anomaly::Severity;
use armwatch_store::Store;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  armwatch alerts test
  armwatch alerts test shift
  armwatch alerts test shift --severity critical

The command sends one message immediately, regardless of the filters, quiet hours and limits of the routes. The
message names the robot TEST and states that it is a test. Its key is that of the database, so the database must
exist: `armwatch run` or `armwatch ingest` creates it. docs/alarms.md has an example of every receiver. The exit
status is 74 if a receiver was not reached.")]
pub(super) struct TestArgs {
    /// Names of routes [default: all]
    #[arg(value_name = "ROUTE")]
    routes: Vec<String>,
    /// Severity of the message
    #[arg(long, value_name = "SEVERITY", value_parser = one_of(Severity::ALL, Severity::name, plain), default_value = "warning")]
    severity: Severity,
}

pub(super) async fn test(
    global: &Global,
    store: &Store,
    settings: &AlertSettings,
    args: &TestArgs,
) -> Result<u8, CliError> {
    let chosen = chosen(settings, &args.routes)?;
    let identity = store.identity().await?;
    let mut status = EXIT_DONE;
    for route in chosen {
        let (receiver, target) = (route.receiver.name(), route.receiver.target());
        let sent = trial::send(settings, route, &identity, args.severity).await;
        let (seconds, error) = match &sent {
            Ok(took) => (Some(took.as_secs_f64()), None),
            Err(error) => {
                status = EXIT_IO;
                (None, Some(error.to_string()))
            }
        };
        if global.json {
            output::json(&json!({
                "route": route.name,
                "receiver": receiver,
                "target": target,
                "sent": sent.is_ok(),
                "took_s": seconds,
                "error": error,
            }));
            continue;
        }
        match error {
            None => output::line(&format!(
                "{}: {receiver} accepted it in {:.2} s ({target})",
                route.name,
                seconds.unwrap_or_default()
            )),
            Some(error) => {
                output::line(&format!("{}: NOT SENT to {receiver} ({target}): {error}", route.name))
            }
        }
    }
    Ok(status)
}

fn chosen<'s>(settings: &'s AlertSettings, names: &[String]) -> Result<Vec<&'s Route>, CliError> {
    if names.is_empty() {
        return Ok(settings.routes.iter().collect());
    }
    let known: Vec<&str> = settings.routes.iter().map(|route| route.name.as_str()).collect();
    let find = |name: &String| {
        settings.routes.iter().find(|route| route.name == *name).ok_or_else(|| {
            CliError::Usage(format!(
                "there is no route {name}; the configuration has {}, write [[alerts.route]] for another",
                known.join(", ")
            ))
        })
    };
    names.iter().map(find).collect()
}
