//! `armwatch config show`: the configuration in force, and its origin.

use serde_json::json;

use crate::cli::context::{CliError, EXIT_DONE, Global};
use crate::cli::shared::output;
use armwatch_config::{Config, summary};

pub(in crate::cli) fn show(global: &Global) -> Result<u8, CliError> {
    let (mut config, origin) = Config::find(global.config.as_deref())?;
    if let Some(database) = &global.db {
        config.database.clone_from(database);
    }
    let summary = summary(&config);
    if global.json {
        let settings: Vec<&str> = summary.lines().collect();
        output::json(&json!({"origin": origin.to_string(), "settings": settings}));
    } else {
        output::block(&format!("from {origin}\n\n{summary}"));
    }
    Ok(EXIT_DONE)
}
