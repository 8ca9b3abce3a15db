//! `armwatch config check`.

use super::{CliError, EXIT_DONE, EXIT_USAGE, Global, output};
use crate::config::{Config, summary};

pub(super) fn check(global: &Global) -> Result<u8, CliError> {
    match Config::find(global.config.as_deref()) {
        Ok((config, origin)) => {
            if global.json {
                output::json(&serde_json::json!({"origin": origin.to_string(), "problems": []}));
            } else {
                output::line(&format!("{origin}: no problems\n\n{}", summary(&config)));
            }
            Ok(EXIT_DONE)
        }
        Err(errors) => {
            for problem in &errors.0 {
                if global.json {
                    output::json(&serde_json::json!({
                        "file": problem.file, "line": problem.line, "column": problem.column, "key": problem.key,
                        "value": problem.value, "problem": problem.problem, "hint": problem.hint,
                    }));
                } else {
                    output::line(&problem.to_string());
                }
            }
            let count = errors.0.len();
            output::note(&format!("armwatch: {count} problem{}", if count == 1 { "" } else { "s" }));
            Ok(EXIT_USAGE)
        }
    }
}
