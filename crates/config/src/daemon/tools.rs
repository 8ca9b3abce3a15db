//! `[[tool]]`: bodies that arms carry in some of their exports.

use std::sync::Arc;

use super::daemon_file::read_files;
use crate::pattern::{self, FilePatterns};
use crate::robot::nominal::read_inertial;
use crate::settings::FleetEntry;
use crate::toml::table::Table;
use armwatch_model::robot::{Robot, StandardParameters};

/// A declared tool.
struct Tool {
    robots: String,
    files: FilePatterns,
    /// About the tool frame.
    body: StandardParameters,
}

/// `fleet` with an entry for each tool before each of those that it belongs to. The body is in its description.
pub(super) fn with_tools(root: &Table<'_>, fleet: Option<Vec<FleetEntry>>) -> Option<Vec<FleetEntry>> {
    let items = root.optional("tool").map_or(Some(Vec::new()), |value| value.sections())?;
    let read: Vec<Option<Tool>> = items
        .iter()
        .map(|item| {
            let table = item.table()?;
            let robots = table.text_or("robots", "*");
            let files = table.required("files").and_then(|value| read_files(&value));
            let body = read_inertial(&table);
            let tool = Tool { robots: robots?.to_owned(), files: files?, body: body? };
            let fits = |entry: &FleetEntry| narrower(&tool.robots, &entry.robots).is_some();
            if let Some(fleet) = &fleet
                && !fleet.iter().any(fits)
            {
                let problem = format!("no [[robot]] is for the robots \"{}\"", tool.robots);
                let hint = "write the name of a [[robot]], or a pattern that is narrower or wider than it";
                table.refuse(problem, Some(hint.into()));
                return None;
            }
            Some(tool)
        })
        .collect();
    let tools: Vec<Tool> = read.into_iter().collect::<Option<_>>()?;
    let with_tools = |entry: FleetEntry| {
        let carrying = |tool: &Tool| {
            let robots = narrower(&tool.robots, &entry.robots)?.to_owned();
            let files = match &entry.files {
                Some(files) => files.and(&tool.files),
                None => tool.files.clone(),
            };
            let arm = &entry.description;
            let description =
                Arc::new(Robot { carried: tool.body.seen_from(&arm.tool), ..Robot::clone(arm) });
            Some(FleetEntry { robots, files: Some(files), description, ..entry.clone() })
        };
        let mut entries: Vec<FleetEntry> = tools.iter().filter_map(carrying).collect();
        entries.push(entry);
        entries
    };
    Some(fleet?.into_iter().flat_map(with_tools).collect())
}

/// The narrower of two patterns over robots; `None` if neither covers the other.
fn narrower<'a>(a: &'a str, b: &'a str) -> Option<&'a str> {
    if pattern::covers(b, a) { Some(a) } else { pattern::covers(a, b).then_some(b) }
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::path::Path;

    use crate::settings::Config;

    const TOOL: &str = "[[tool]]\nfiles = [\"*_gripper*\"]\nmass_kg = 0.8\ncentre_of_mass_m = [0, 0, 0.1]\n\
                        inertia_about_centre_of_mass_kg_m2 = { xx = 0, xy = 0, xz = 0, yy = 0, yz = 0, zz = 0 }\n";

    fn read(tools: &str) -> Result<Config, String> {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("armwatch.toml");
        let config = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config");
        let entry = |files: &str, layout: &str| {
            format!(
                "[[robot]]\nname = \"R*\"\n{files}description = '{0}/robots/er3a.toml'\n\
                 layout = '{0}/exports/{layout}.toml'\n",
                config.display()
            )
        };
        let robots = entry("files = \"*_work*\"\n", "production") + &entry("", "native");
        fs::write(&path, format!("{robots}{tools}")).expect("written");
        Config::read(&path).map_err(|errors| errors.to_string())
    }

    #[test]
    fn a_tool_is_carried_in_the_exports_that_its_patterns_match() {
        let config = read(TOOL).expect("sound");
        let found = |robot: &str, file: &str| {
            let entry = config.export_entry(robot, file).expect("an entry");
            (entry.layout.name.as_str(), entry.description.carried.mass())
        };
        assert_eq!(found("R01", "R01_gripper.csv"), ("native", 0.8));
        assert_eq!(found("R01", "R01_work_gripper.csv"), ("production", 0.8));
        assert_eq!(found("R01", "R01_work.csv"), ("production", 0.0));
        assert_eq!(found("R01", "R01.csv"), ("native", 0.0));
        assert_eq!(config.robot_entry("R01").expect("an entry").description.carried.mass(), 0.0);
        let of_one = read(&TOOL.replace("[[tool]]", "[[tool]]\nrobots = \"R02\"")).expect("sound");
        let mass =
            |robot| of_one.export_entry(robot, "a_gripper.csv").map(|of| of.description.carried.mass());
        assert_eq!([mass("R01"), mass("R02")], [Some(0.0), Some(0.8)]);
    }

    #[test]
    fn a_tool_that_cannot_be_is_refused_with_its_key() {
        for (from, to, said) in [
            ("mass_kg = 0.8", "mass_kg = -1", "mass_kg"),
            ("files = [\"*_gripper*\"]\n", "", "files"),
            ("xx = 0,", "xx = 1,", "no body has this inertia"),
            ("[[tool]]", "[[tool]]\nrobots = \"S*\"", "no [[robot]] is for the robots \"S*\""),
            ("[[tool]]", "[tool]", "[[tool]]"),
        ] {
            let errors = read(&TOOL.replace(from, to)).expect_err(to);
            assert!(errors.contains(said), "{errors}");
        }
    }
}
