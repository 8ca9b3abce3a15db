//! Motions from CSV files: positions over time from any origin.

use std::path::Path;

use crate::cli::context::CliError;
use crate::cli::shared::position_columns::{
    ACCELERATIONS, POSITIONS, VELOCITIES, columns, names, no_positions,
};
use armwatch_model::robot::Robot;
use armwatch_trajectory::limits::SampledMotion;

/// Names of the time column.
const TIMES: [&str; 3] = ["time_s", "time", "t"];

/// Reads a CSV file with a header: time and the controller's positions of all joints, perhaps velocities and
/// accelerations. The motion has the positions `q` of the model.
pub(super) fn samples(path: &Path, text: &str, robot: &Robot) -> Result<SampledMotion, CliError> {
    let fault = |problem: String| CliError::Usage(format!("{}: {problem}", path.display()));
    let mut reader = csv::ReaderBuilder::new().trim(csv::Trim::All).from_reader(text.as_bytes());
    let header = names(reader.headers().map_err(|error| fault(error.to_string()))?);
    let time =
        TIMES.iter().find_map(|name| header.iter().position(|known| known == name)).ok_or_else(|| {
            fault(format!(
                "line 1: no column of times, s; a CSV file of a motion needs one of {}, and a programme is JSON",
                TIMES.join(", ")
            ))
        })?;
    let positions = columns(&header, &POSITIONS, robot, 0).ok_or_else(|| fault(no_positions(robot)))?;
    let velocities = columns(&header, &VELOCITIES, robot, 1);
    let accelerations = columns(&header, &ACCELERATIONS, robot, 2);
    let mut motion = SampledMotion {
        positions: vec![Vec::new(); robot.joint_count()],
        velocities: velocities.as_ref().map(|_| vec![Vec::new(); robot.joint_count()]),
        accelerations: accelerations.as_ref().map(|_| vec![Vec::new(); robot.joint_count()]),
        ..SampledMotion::default()
    };
    let mut steps = [0.0_f64; 3];
    for record in reader.records() {
        let record = record.map_err(|error| fault(error.to_string()))?;
        let line = record.position().map_or(0, csv::Position::line);
        let cell = |index: usize| -> Result<(f64, f64), CliError> {
            let text = record.get(index).unwrap_or_default();
            let value = text.parse().ok().filter(|value: &f64| value.is_finite()).ok_or_else(|| {
                fault(format!("line {line}, column {}: \"{text}\" is not a number", header[index]))
            })?;
            Ok((value, last_digit(text)))
        };
        let (now, _) = cell(time)?;
        if motion.times.last().is_some_and(|before| *before >= now) {
            return Err(fault(format!(
                "line {line}: time {now} s does not follow {} s; times must increase",
                motion.times.last().copied().unwrap_or_default()
            )));
        }
        motion.times.push(now);
        for (column, values) in positions.iter().zip(&mut motion.positions) {
            let (value, step) = cell(column.index)?;
            values.push(column.value(value));
            // the coarsest cell counts: 0.5 among 0.4999 is a number that happens to be short
            steps[0] = finest(steps[0], step * column.factor, values.len());
        }
        for (k, (columns, all)) in
            [(&velocities, &mut motion.velocities), (&accelerations, &mut motion.accelerations)]
                .into_iter()
                .enumerate()
        {
            let (Some(columns), Some(all)) = (columns, all) else { continue };
            for (column, values) in columns.iter().zip(all) {
                let (value, step) = cell(column.index)?;
                values.push(column.value(value));
                steps[k + 1] = finest(steps[k + 1], step * column.factor, values.len());
            }
        }
    }
    if motion.times.len() < 3 {
        return Err(fault(format!("{} rows; a motion has at least 3", motion.times.len())));
    }
    [motion.position_step, motion.velocity_step, motion.acceleration_step] = steps;
    Ok(motion)
}

/// Step of the last digit of a number as written: 0.01 for `1.25`.
fn last_digit(text: &str) -> f64 {
    let (mantissa, exponent) = text.split_once(['e', 'E']).unwrap_or((text, "0"));
    let digits = mantissa.split_once('.').map_or(0, |(_, decimals)| decimals.len());
    let exponent: i32 = exponent.parse().unwrap_or(0);
    10_f64.powi(exponent.saturating_sub(i32::try_from(digits).unwrap_or(i32::MAX)))
}

/// The finer of two steps; the first row has only its own.
fn finest(step: f64, own: f64, rows: usize) -> f64 {
    if rows == 1 && step == 0.0 { own } else { step.min(own) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use armwatch_testing::er3a;

    fn header() -> String {
        let joints: Vec<String> = (1..=6).map(|j| format!("pos_{j}")).collect();
        format!("time,{},stage", joints.join(","))
    }

    fn read(text: &str) -> Result<SampledMotion, String> {
        samples(Path::new("a.csv"), text, &er3a()).map_err(|error| error.to_string())
    }

    #[test]
    fn native_columns_are_read_with_their_last_digit() {
        let text = format!(
            "{}\n0,0.1,0,0,0,0,0.1234,1\n0.1,0.2,0,0,0,0,0.1235,1\n0.2,0.3,0,0,0,0,0.1236,1\n",
            header()
        );
        let motion = read(&text).expect("a motion");
        assert_eq!(motion.times, [0.0, 0.1, 0.2]);
        assert_eq!(motion.positions[0], [0.1, 0.2, 0.3]);
        assert!((motion.position_step - 1e-4).abs() < 1e-18 && motion.velocities.is_none());
        let degrees = text.replace("pos_1", "pos_1_deg");
        let motion = read(&degrees).expect("a motion");
        assert!((motion.positions[0][0] - 0.1_f64.to_radians()).abs() < 1e-15);
    }

    #[test]
    fn faults_name_line_and_column() {
        let rows = "0,0,0,0,0,0,0,1\n0.1,0,0,x,0,0,0,1\n";
        let problem = read(&format!("{}\n{rows}", header())).expect_err("a letter");
        assert!(problem.contains("line 3, column pos_3: \"x\""), "{problem}");
        let problem = read(&format!("{}\n0,0,0,0,0,0,0,1\n0,0,0,0,0,0,0,1\n", header())).expect_err("time");
        assert!(problem.contains("line 3: time 0 s does not follow"), "{problem}");
        let problem = read(&header().replace("pos_6", "other")).expect_err("a joint");
        assert!(problem.contains("pos_1 to pos_6"), "{problem}");
        assert!(read(&header()).expect_err("no rows").contains("0 rows"));
        assert!(read("a,b\n1,2\n").expect_err("no time").contains("time_s"));
    }

    #[test]
    fn digits_of_numbers_are_counted_with_their_exponents() {
        assert_eq!([last_digit("1.25"), last_digit("3"), last_digit("1.5e-3")], [0.01, 1.0, 1e-4]);
    }
}
