//! Arguments for the parts of a test cycle.

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};

use super::position_columns::{POSITIONS, columns, names, no_positions};
use super::programme::read;
use crate::cli::context::CliError;
use armwatch_model::robot::Robot;
use armwatch_simulate::plan::points::{PointToPoint, Points};
use armwatch_simulate::plan::trajectory::{ExcitationParts, FrictionPosture};

/// Parts of a cycle beside rest and ways home.
#[derive(Debug, Args)]
pub(in crate::cli) struct CycleArgs {
    /// Parts of the cycle in their order, separated by commas
    #[arg(
        help_heading = "Cycle",
        long,
        value_enum,
        value_delimiter = ',',
        value_name = "PARTS",
        default_value = "series,additional,friction,warming"
    )]
    parts: Vec<CyclePart>,
    /// Points of the part `points`: a CSV file with the controller's positions in columns pos_1, pos_2, .. in rad (m)
    /// or pos_1_deg, pos_1_mm [default: random points]
    #[arg(help_heading = "Cycle", long, value_name = "FILE")]
    points: Option<PathBuf>,
    /// Number of random points without a file of points
    #[arg(help_heading = "Cycle", long, default_value_t = 10, value_name = "N", conflicts_with = "points", value_parser = clap::value_parser!(u32).range(2..=10_000))]
    point_count: u32,
    /// Dead time at each point, s
    #[arg(help_heading = "Cycle", long, default_value_t = 0.5, value_name = "S")]
    dead_s: f64,
    /// Posture of the other joints while one joint is tested for friction
    #[arg(help_heading = "Cycle", long, value_enum, default_value = "home")]
    friction_posture: FrictionPostureArg,
    /// Additional rest at the end of the cycle, after the usual 0.6 s, s
    #[arg(help_heading = "Cycle", long, default_value_t = 0.0, value_name = "S")]
    rest_s: f64,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum CyclePart {
    /// Excitation: a period of the Fourier series
    Series,
    /// Excitation: every joint over its range near full speed
    Additional,
    /// Excitation: from point to point, with a dead time at each
    Points,
    /// Friction: each joint alone through its speed levels
    Friction,
    /// Warming: all joints together, to heat the arm
    Warming,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum FrictionPostureArg {
    /// Posture at the start of the cycle
    Home,
    /// Nearest posture with constant gravity on the tested joint; home if there is none
    Still,
}

impl CycleArgs {
    /// Parts of the excitation stage.
    pub(in crate::cli) fn excitation(&self, robot: &Robot) -> Result<ExcitationParts, CliError> {
        let points = match (self.has(CyclePart::Points), &self.points) {
            (true, Some(path)) => Some(Points::Given(points(path, robot)?)),
            (true, None) => Some(Points::Drawn(self.point_count)),
            (false, Some(_)) => {
                return Err(CliError::Usage("--points requires the part points in --parts".into()));
            }
            (false, None) => None,
        };
        if !(0.0..=86_400.0).contains(&self.rest_s) {
            return Err(CliError::Usage(format!("--rest-s {}: 0 to 86400 s is possible", self.rest_s)));
        }
        Ok(ExcitationParts {
            series: self.has(CyclePart::Series),
            additional: self.has(CyclePart::Additional),
            points: points.map(|points| PointToPoint { points, dead_s: self.dead_s }),
        })
    }

    /// The chosen levels; empty if the cycle has no friction stage.
    pub(in crate::cli) fn levels(&self, chosen: Option<Vec<u8>>) -> Option<Vec<u8>> {
        if self.has(CyclePart::Friction) { chosen } else { Some(Vec::new()) }
    }

    /// Duration of warming, s; 0 if the cycle has none.
    pub(in crate::cli) fn warming_s(&self, chosen: f64) -> f64 {
        if self.has(CyclePart::Warming) { chosen } else { 0.0 }
    }

    /// Posture of the friction stage.
    pub(in crate::cli) fn posture(&self) -> FrictionPosture {
        match self.friction_posture {
            FrictionPostureArg::Home => FrictionPosture::Home,
            FrictionPostureArg::Still => FrictionPosture::Still,
        }
    }

    /// Rest at the end of the cycle, s.
    pub(in crate::cli) fn rest_s(&self) -> f64 {
        self.rest_s
    }

    fn has(&self, part: CyclePart) -> bool {
        self.parts.contains(&part)
    }
}

/// Points from a CSV file as positions `q` of the model, `[points][n]`, rad (m).
fn points(path: &Path, robot: &Robot) -> Result<Vec<Vec<f64>>, CliError> {
    let fault = |problem: String| CliError::Usage(format!("{}: {problem}", path.display()));
    let text = read(path)?;
    let mut reader = csv::ReaderBuilder::new().trim(csv::Trim::All).from_reader(text.as_bytes());
    let header = names(reader.headers().map_err(|error| fault(error.to_string()))?);
    let found = columns(&header, &POSITIONS, robot, 0).ok_or_else(|| fault(no_positions(robot)))?;
    let mut points = Vec::new();
    for record in reader.records() {
        let record = record.map_err(|error| fault(error.to_string()))?;
        let line = record.position().map_or(0, csv::Position::line);
        let point = found.iter().map(|column| {
            let cell = record.get(column.index).unwrap_or_default();
            let value = cell.parse().ok().filter(|value: &f64| value.is_finite());
            value.map(|value| column.value(value)).ok_or_else(|| {
                fault(format!("line {line}, column {}: \"{cell}\" is not a number", header[column.index]))
            })
        });
        points.push(point.collect::<Result<_, _>>()?);
    }
    Ok(points)
}

#[cfg(test)]
mod tests {
    use super::*;
    use armwatch_testing::er3a_of;

    #[test]
    fn points_are_read_in_their_units_and_mistakes_are_named() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("points.csv");
        let of = |text: &str| {
            std::fs::write(&path, text).expect("written");
            points(&path, &er3a_of(2)).map_err(|error| error.to_string())
        };
        let found = of("name,pos_1_deg,pos_2\nhome,180,0.5\nup,0,-1e-1\n").expect("points");
        assert_eq!(found, [[std::f64::consts::PI, 0.5], [0.0, -0.1]]);
        let mut offset = er3a_of(2);
        offset.joints[1].position_offset = 0.25;
        let with_offset = points(&path, &offset).expect("points");
        assert_eq!(with_offset, [[std::f64::consts::PI, 0.75], [0.0, 0.15]]);
        assert!(of("pos_1\n0\n").expect_err("one joint").contains("pos_1 to pos_2"));
        assert!(of("pos_1,pos_2\n0,x\n").expect_err("a letter").contains("line 2, column pos_2: \"x\""));
    }
}
