//! Error for an unknown robot.

use crate::cli::context::CliError;
use armwatch_store::Store;

/// Most robots that are listed instead of an unknown one.
const LISTED: usize = 12;

/// Most different letters between a name and the one that was probably meant.
const FAR: usize = 2;

/// The error of a command for a robot without runs, with the robots that have some. The database error if these cannot
/// be read.
pub(in crate::cli) async fn unknown_robot(store: &Store, name: &str) -> CliError {
    match robots(store).await {
        Ok(known) => CliError::Usage(in_words(name, &known)),
        Err(error) => error,
    }
}

/// Refuses a robot without runs.
///
/// # Errors
/// [`CliError::Usage`], with the robots that have runs, and those of the database.
pub(in crate::cli) async fn require_robot(store: &Store, name: &str) -> Result<(), CliError> {
    let known = robots(store).await?;
    match known.iter().any(|robot| robot == name) {
        true => Ok(()),
        false => Err(CliError::Usage(in_words(name, &known))),
    }
}

/// Robots with a run, by name.
pub(in crate::cli) async fn robots(store: &Store) -> Result<Vec<String>, CliError> {
    let mut reader = store.read_views().await?;
    Ok(reader.robots().await?)
}

fn in_words(name: &str, known: &[String]) -> String {
    if known.is_empty() {
        return format!(
            "there is no robot {name}: no run is stored yet; `armwatch ingest FILE` reads an export"
        );
    }
    let distance = |robot: &String| strsim::osa_distance(&robot.to_lowercase(), &name.to_lowercase());
    // in a short name, most letters would differ
    let far = FAR.min(name.chars().count() / 2);
    let near = known.iter().filter(|robot| distance(robot) <= far).min_by_key(|robot| distance(robot));
    let meant = near.map(|robot| format!("did you mean {robot}? ")).unwrap_or_default();
    let listed = known[..LISTED.min(known.len())].join(", ");
    let more = match known.len().saturating_sub(LISTED) {
        0 => String::new(),
        more => format!(" and {more} more, which `armwatch robots` lists"),
    };
    format!("there is no robot {name}; {meant}there are runs of {listed}{more}")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn robots(names: &[&str]) -> Vec<String> {
        names.iter().map(|name| (*name).to_owned()).collect()
    }

    #[test]
    fn a_robot_that_is_not_there_is_answered_with_those_that_are() {
        let known = robots(&["Left", "Middle", "Right"]);
        assert_eq!(
            in_words("left", &known),
            "there is no robot left; did you mean Left? there are runs of Left, Middle, Right"
        );
        assert!(in_words("Lfet", &known).contains("did you mean Left?"));
        assert_eq!(in_words("Nope", &known), "there is no robot Nope; there are runs of Left, Middle, Right");
        assert!(in_words("Left", &[]).ends_with("`armwatch ingest FILE` reads an export"));
        let many: Vec<String> = (0..20).map(|number| format!("R{number:02}")).collect();
        assert!(in_words("Nope", &many).ends_with("R11 and 8 more, which `armwatch robots` lists"));
    }
}
