//! Any bytes are refused or give a proposal; a proposal without questions is a layout that loads.

use std::path::Path;

use armwatch_config::parse_layout;
use armwatch_ingest::infer::infer;
use armwatch_ingest::infer::proposal::Hints;

/// Checks one input; a failure panics.
pub fn run(data: &[u8]) {
    let Ok(proposed) = infer(data, Path::new("fuzz.csv"), "fuzz", Hints::default()) else { return };
    if proposed.questions == 0 {
        parse_layout("fuzz.toml", &proposed.toml)
            .unwrap_or_else(|errors| panic!("{errors}\n{}", proposed.toml));
    }
}
