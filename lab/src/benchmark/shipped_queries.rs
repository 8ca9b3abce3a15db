//! The shipped queries, as statements about the first robot of a synthetic history: those of `examples/questions.sql`,
//! of `dashboards/` with their defaults, and of the panels for Grafana over the last 90 days.

use armwatch::cli::context::CliError;

/// A collection: its name, and its files with their text.
type Files = (&'static str, &'static [(&'static str, &'static str)]);

const QUESTIONS: &str = include_str!("../../../examples/questions.sql");

macro_rules! dashboards {
    ($($name:literal),*) => {
        &[$(($name, include_str!(concat!("../../../dashboards/", $name)))),*]
    };
}

/// Queries with optional parameters.
const DASHBOARDS: Files = (
    "dashboards",
    dashboards!(
        "fleet_overview.sql",
        "friction_index_by_run.sql",
        "friction_over_speed.sql",
        "friction_over_time.sql",
        "open_anomalies.sql",
        "parameters_by_cycle.sql",
        "quarantine.sql",
        "rmsd_by_cycle.sql",
        "warm_friction_by_run.sql"
    ),
);

const GRAFANA: Files = (
    "Grafana",
    dashboards!(
        "grafana/dashboards/sqlite/fleet.json",
        "grafana/dashboards/sqlite/ingest.json",
        "grafana/dashboards/sqlite/robot.json"
    ),
);

/// Period of a panel for Grafana, days.
const PANEL_DAYS: i64 = 90;

/// A query.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct ShippedQuery {
    /// Its collection.
    pub(super) collection: &'static str,
    /// Its name in the collection.
    pub(super) name: String,
    /// The statement.
    pub(super) statement: String,
}

/// All queries, about the robot of this name; `until` is the end of its history, RFC 3339.
pub(super) fn shipped_queries(robot: &str, until: jiff::Timestamp) -> Result<Vec<ShippedQuery>, CliError> {
    let mut found: Vec<ShippedQuery> = questions(QUESTIONS)
        .into_iter()
        .map(|(name, statement)| ShippedQuery {
            collection: "questions",
            name: name.to_owned(),
            statement: statement.replace("'Middle'", &format!("'{robot}'")),
        })
        .collect();
    let (collection, files) = DASHBOARDS;
    found.extend(files.iter().map(|(name, text)| ShippedQuery {
        collection,
        name: (*name).to_owned(),
        statement: without_parameters(text),
    }));
    let since = until - jiff::SignedDuration::from_hours(24 * PANEL_DAYS);
    let (collection, files) = GRAFANA;
    for (name, text) in files {
        let dashboard: serde_json::Value =
            serde_json::from_str(text).map_err(|error| CliError::Internal(format!("{name}: {error}")))?;
        for (title, statement) in panels(&dashboard) {
            let statement = statement
                .replace("${robot:sqlstring}", &format!("'{robot}'"))
                .replace("${joint:sqlstring}", "'1','2','3','4','5','6'")
                .replace("${parameter:sqlstring}", "'Izz'");
            let statement = with_time(&statement, since, until);
            found.push(ShippedQuery { collection, name: title, statement });
        }
    }
    Ok(found)
}

/// Questions, which are comments that begin with `-- ##`, with the statement below each.
fn questions(text: &str) -> Vec<(&str, &str)> {
    let sections = text.split("\n-- ## ").skip(1);
    sections.filter_map(|section| section.split_once(";\n")?.0.split_once('\n')).collect()
}

/// The statement with NULL instead of each parameter `:name`.
fn without_parameters(text: &str) -> String {
    let mut parts = text.split(':');
    let mut statement = parts.next().unwrap_or_default().to_owned();
    for part in parts {
        let name = part.find(|c: char| !(c.is_ascii_lowercase() || c == '_')).unwrap_or(part.len());
        match name {
            0 => statement.push(':'),
            _ => statement.push_str("NULL"),
        }
        statement.push_str(&part[name..]);
    }
    statement
}

/// Titles and statements of the panels of a dashboard.
fn panels(dashboard: &serde_json::Value) -> Vec<(String, &str)> {
    let mut found = Vec::new();
    for panel in dashboard["panels"].as_array().into_iter().flatten() {
        let title = panel["title"].as_str().unwrap_or("panel").to_owned();
        for target in panel["targets"].as_array().into_iter().flatten() {
            if let Some(statement) = target["queryText"].as_str() {
                found.push((title.clone(), statement));
            }
        }
    }
    found
}

/// The statement with bounds instead of Grafana's `$__timeFilter(column)`.
fn with_time(statement: &str, since: jiff::Timestamp, until: jiff::Timestamp) -> String {
    let mut parts = statement.split("$__timeFilter(");
    let mut found = parts.next().unwrap_or_default().to_owned();
    for part in parts {
        let (column, rest) = part.split_once(')').unwrap_or((part, ""));
        found.push_str(&format!("{column} >= '{since}' AND {column} < '{until}'{rest}"));
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_statement_is_found_with_its_question() {
        let found = questions(QUESTIONS);
        assert_eq!(found.len(), QUESTIONS.matches(";\n").count());
        assert!(found.iter().all(|(question, statement)| !question.is_empty() && statement.contains("FROM")));
    }

    #[test]
    fn no_parameter_and_no_macro_is_left() {
        let found = shipped_queries("S001", jiff::Timestamp::UNIX_EPOCH).expect("queries");
        for collection in ["questions", "dashboards", "Grafana"] {
            assert!(found.iter().filter(|query| query.collection == collection).count() >= 9, "{collection}");
        }
        for ShippedQuery { name, statement, .. } in &found {
            assert!(!statement.contains('$') && !statement.contains("'Middle'"), "{name}: {statement}");
        }
        let titles = found.iter().filter(|query| query.name.ends_with(".sql")).count();
        let shipped =
            std::fs::read_dir(concat!(env!("CARGO_MANIFEST_DIR"), "/../dashboards")).expect("dashboards");
        let shipped = shipped.filter(|entry| {
            entry.as_ref().is_ok_and(|entry| entry.path().extension().is_some_and(|end| end == "sql"))
        });
        assert_eq!(titles, shipped.count(), "a query is not measured");
    }

    #[test]
    fn parameters_are_null_and_times_of_day_stay() {
        assert_eq!(
            without_parameters(
                "SELECT :run_id, strftime('%H:%M:%S', at) WHERE :joint = 1 OR at > 'T08:47:00'"
            ),
            "SELECT NULL, strftime('%H:%M:%S', at) WHERE NULL = 1 OR at > 'T08:47:00'"
        );
    }
}
