//! `armwatch config check`.

use serde_json::json;

use crate::cli::context::{CliError, EXIT_DONE, EXIT_USAGE, Global};
use crate::cli::shared::output;
use crate::daemon::preflight::preflight;
use armwatch_config::{Config, ConfigProblem, summary};

pub(in crate::cli) fn check(global: &Global) -> Result<u8, CliError> {
    match Config::find(global.config.as_deref()) {
        Ok((mut config, origin)) => {
            if let Some(database) = &global.db {
                config.database.clone_from(database);
            }
            let found = preflight(&config);
            if !found.refusals.is_empty() {
                return Ok(refuse(global, &found.refusals));
            }
            let remarks: Vec<_> = found.missing.iter().chain(&found.remarks).collect();
            if global.json {
                let settings = summary(&config);
                output::json(&json!({
                    "origin": origin.to_string(), "problems": [], "warnings": remarks,
                    "settings": settings.lines().collect::<Vec<_>>(),
                }));
            } else {
                output::block(&format!("{origin}: no problems\n\n{}", summary(&config)));
                remarks.into_iter().for_each(|remark| output::line(&format!("warning: {remark}")));
            }
            Ok(EXIT_DONE)
        }
        Err(errors) => Ok(refuse(global, &errors.0)),
    }
}

fn refuse(global: &Global, problems: &[ConfigProblem]) -> u8 {
    for problem in problems {
        if global.json {
            output::json(problem);
        } else {
            output::line(&problem.to_string());
        }
    }
    let count = problems.len();
    output::print_hint(&format!("armwatch: {}", output::counted(count, "problem")));
    EXIT_USAGE
}
