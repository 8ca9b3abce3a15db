//! The inverse of a layout: columns that the simulator writes and the reader understands.

use nalgebra::DMatrix;

use crate::cli::context::CliError;
use armwatch_config::{
    Channel, Column, DecimalMark, Layout, StageCells, TemperatureUnit, TextEncoding, TimeSource,
};
use armwatch_model::robot::Robot;
use armwatch_simulate::files::format::{
    ColumnContent, ExportColumn, ExportFormat, JointWeights, TemperatureScale,
};
use armwatch_simulate::run::temperatures::TemperatureColumns;

/// The columns that `layout` reads in exports of `robot`: columns by number at their places, all others in the order
/// time, position, velocity, torque, stage, cycle, friction joint and level. Temperatures in the layout are included if
/// they are recorded.
pub(in crate::cli) fn export_format(
    layout: &Layout,
    robot: &Robot,
    recorded: TemperatureColumns,
) -> Result<ExportFormat, CliError> {
    refuse_text(layout)?;
    let mut cells = cells(layout, robot)?;
    cells.extend(temperature_cells(layout, robot, recorded));
    let place = |column: &Column| match column {
        Column::Number(number) => Some(*number),
        Column::Name(name) if !layout.header => name.parse().ok(),
        Column::Name(_) => None,
    };
    let width = cells.iter().filter_map(|(column, _)| place(column)).max().unwrap_or(0).max(cells.len());
    let unused = |at: usize| ExportColumn { name: format!("unused_{}", at + 1), cell: ColumnContent::Unused };
    let mut columns: Vec<ExportColumn> = (0..width).map(unused).collect();
    let (numbered, named): (Vec<_>, Vec<_>) =
        cells.into_iter().partition(|(column, _)| place(column).is_some());
    for (column, cell) in numbered {
        let free = place(&column).and_then(|number| columns.get_mut(number.checked_sub(1)?));
        match free {
            Some(slot) if slot.cell == ColumnContent::Unused => {
                *slot = ExportColumn { name: format!("column_{column}"), cell };
            }
            _ => {
                return Err(CliError::Usage(format!(
                    "layout \"{}\" reads column {column} twice",
                    layout.name
                )));
            }
        }
    }
    let mut named = named.into_iter();
    for slot in columns.iter_mut().filter(|slot| slot.cell == ColumnContent::Unused) {
        let Some((column, cell)) = named.next() else { break };
        *slot = ExportColumn { name: column.to_string(), cell };
    }
    Ok(ExportFormat { delimiter: layout.delimiter, header: layout.header, columns })
}

/// Refuses other text formats: the simulator writes UTF-8 with decimal points, and nothing before or below the header.
fn refuse_text(layout: &Layout) -> Result<(), CliError> {
    let text = &layout.text;
    let is_plain = matches!(text.encoding, TextEncoding::Auto | TextEncoding::Utf8)
        && text.decimal == DecimalMark::Point
        && text.skip_lines == 0
        && text.skip_after_header == 0;
    if is_plain {
        return Ok(());
    }
    Err(CliError::Usage(format!(
        "layout \"{}\" has another encoding, decimal commas or skipped lines, which the simulator does not support",
        layout.name
    )))
}

fn cells(layout: &Layout, robot: &Robot) -> Result<Vec<(Column, ColumnContent)>, CliError> {
    let n = robot.joint_count();
    let factors = layout
        .factors(robot)
        .map_err(|misfit| CliError::Usage(format!("{}; {}", misfit.problem, misfit.remedy)))?;
    let motor = layout.motor_side;
    let positions = motor.position.then(|| robot.transmission.clone());
    let torques =
        match motor.torque {
            true => Some(robot.transmission.transpose().try_inverse().ok_or_else(|| {
                CliError::Usage(format!("the transmission of {} has no inverse", robot.model))
            })?),
            false => None,
        };
    let mut cells = Vec::new();
    match &layout.time {
        TimeSource::Column(time)
        | TimeSource::Restarting(time)
        | TimeSource::Counter { column: time, .. } => {
            cells.push((time.column.clone(), ColumnContent::Time(time.to_si.recip())));
        }
        TimeSource::Text { .. } => {
            return Err(CliError::Usage(format!(
                "layout \"{}\" has times as text, which the simulator does not support",
                layout.name
            )));
        }
        TimeSource::SampleRate(_) => {}
    }
    let mut channel = |channel: &Channel,
                       side: &Option<DMatrix<f64>>,
                       factors: &[f64],
                       cell: fn(JointWeights) -> ColumnContent| {
        for (j, factor) in factors.iter().enumerate() {
            let weights: Vec<f64> = (0..n)
                .map(|k| match side {
                    Some(side) => side[(j, k)] / factor,
                    None => f64::from(u8::from(j == k)) / factor,
                })
                .collect();
            if let Some(column) = channel.columns.of_joint(j + 1) {
                cells.push((column, cell(JointWeights(weights))));
            }
        }
    };
    channel(&layout.position, &positions, &factors.position, ColumnContent::Position);
    if let Some(velocity) = &layout.velocity {
        channel(velocity, &positions, &factors.velocity, ColumnContent::Velocity);
    }
    channel(&layout.torque, &torques, &factors.torque, ColumnContent::Torque);
    cells.extend(signals(layout)?);
    Ok(cells)
}

fn temperature_cells(
    layout: &Layout,
    robot: &Robot,
    recorded: TemperatureColumns,
) -> Vec<(Column, ColumnContent)> {
    let scale = |unit: TemperatureUnit| {
        let at_zero = unit.of_kelvin(0.0);
        TemperatureScale { at_zero, per_kelvin: unit.of_kelvin(1.0) - at_zero }
    };
    let motor = layout.motor_temperature.as_ref().filter(|_| recorded.motor);
    let motors = motor.into_iter().flat_map(|motor| {
        let cell = move |joint| ColumnContent::MotorTemperature { joint, scale: scale(motor.unit) };
        (0..robot.joint_count())
            .filter_map(move |joint| Some((motor.columns.of_joint(joint + 1)?, cell(joint))))
    });
    let ambient = layout.ambient_temperature.as_ref().filter(|_| recorded.ambient);
    let ambient = ambient
        .map(|ambient| (ambient.column.clone(), ColumnContent::AmbientTemperature(scale(ambient.unit))));
    motors.chain(ambient).collect()
}

fn signals(layout: &Layout) -> Result<Vec<(Column, ColumnContent)>, CliError> {
    let mut cells = Vec::new();
    cells.extend(stage_cells(layout)?);
    let optional = [
        (&layout.cycle, ColumnContent::Cycle),
        (&layout.friction_joint, ColumnContent::FrictionJoint),
        (&layout.friction_level, ColumnContent::FrictionLevel),
    ];
    cells.extend(optional.into_iter().filter_map(|(column, cell)| Some((column.clone()?, cell))));
    Ok(cells)
}

/// The columns of the stage signal; none if the layout has none.
fn stage_cells(layout: &Layout) -> Result<Vec<(Column, ColumnContent)>, CliError> {
    let lacking = || {
        CliError::Usage(format!(
            "layout \"{}\" has no value for some stage, and a simulated run has all of them",
            layout.name
        ))
    };
    let columns = layout.stage.kind().cells().ok_or_else(lacking)?;
    let cell = |cells| match cells {
        StageCells::Texts(texts) => ColumnContent::StageWord(texts),
        StageCells::Levels { levels, narrowest } => {
            ColumnContent::StageLevel { levels, noise: NOISE_OF_RANGE * narrowest }
        }
    };
    Ok(columns.into_iter().map(|(column, cells)| (column.clone(), cell(cells))).collect())
}

/// Largest noise of an analogue stage signal, as a fraction of its narrowest range.
const NOISE_OF_RANGE: f64 = 0.3;

#[cfg(test)]
mod tests {
    use std::path::{Path, PathBuf};

    use super::*;
    use crate::pipeline::take::cycles::read_cycle;
    use armwatch_config::{JointColumns, read_layout, read_robot};
    use armwatch_model::run::{Samples, Stage};
    use armwatch_simulate::plan::trajectory::ExcitationParts;
    use armwatch_simulate::run::recording::RecordedRow;
    use armwatch_simulate::{SimulationSettings, rows_of_run, simulate_run};

    /// Tolerance of rounding. Numbers are written with every digit; motor sides and units take some multiplications,
    /// and motor angles of a hundred turns have two digits less.
    const ROUNDING: f64 = 1e-11;

    fn shipped(name: &str) -> PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("config").join(name)
    }

    /// The largest difference of a channel, relative to its largest number.
    fn difference(found: &[Vec<f64>], rows: &[RecordedRow], of: impl Fn(&RecordedRow, usize) -> f64) -> f64 {
        let joint = |(j, found): (usize, &Vec<f64>)| {
            let largest = rows.iter().map(|row| of(row, j).abs()).fold(f64::MIN_POSITIVE, f64::max);
            let each = found.iter().zip(rows).map(|(found, row)| (found - of(row, j)).abs() / largest);
            each.fold(0.0, f64::max)
        };
        found.iter().enumerate().map(joint).fold(0.0, f64::max)
    }

    fn assert_same(name: &str, samples: &Samples, rows: &[RecordedRow], layout: &Layout) {
        assert!(samples.time.len() > 100 && samples.time.len() <= rows.len(), "{name}");
        let whole = samples.time.len() == rows.len();
        assert!(
            whole || layout.stage.kind().run_kind() == armwatch_model::run::RunKind::Production,
            "{name}"
        );
        let rows = &rows[..samples.time.len()];
        let late = |row: &RecordedRow| row.time - rows[0].time;
        let off = samples.time.iter().zip(rows).map(|(time, row)| (time - samples.time[0] - late(row)).abs());
        assert!(off.fold(0.0, f64::max) < 1e-9, "{name}");
        let position = difference(&samples.position, rows, |row, j| row.position[j]);
        let torque = difference(&samples.torque, rows, |row, j| row.torque[j]);
        assert!(position < ROUNDING && torque < ROUNDING, "{name}: {position:e} {torque:e}");
        assert_eq!(samples.velocity.is_some(), layout.velocity.is_some(), "{name}");
        if let Some(velocity) = &samples.velocity {
            let velocity = difference(velocity, rows, |row, j| row.velocity[j]);
            assert!(velocity < ROUNDING, "{name}: {velocity:e}");
        }
        let says_stages = layout.stage.kind().cells().is_some_and(|cells| !cells.is_empty());
        if says_stages {
            assert!(samples.stage.iter().zip(rows).all(|(stage, row)| *stage == row.stage), "{name}");
            assert!(samples.stage.contains(&Stage::Friction), "{name}");
        }
    }

    /// The ER3A with a coupled wrist, offsets of positions, and gains of drives that report currents.
    #[test]
    fn every_shipped_layout_is_read_back_to_the_numbers_that_were_simulated() {
        let mut robot = read_robot(&shipped("robots/er3a.toml")).expect("the ER3A");
        (robot.transmission[(5, 4)], robot.transmission[(4, 3)]) = (7.0, -3.0);
        for (joint, gain) in robot.joints.iter_mut().zip([21.0, -33.0, 17.0, 11.0, 9.0, 7.0]) {
            joint.drive_gain = Some(gain);
            joint.position_offset = 0.01 * gain;
        }
        let mut names = Vec::new();
        for entry in std::fs::read_dir(shipped("exports")).expect("layouts") {
            let path = entry.expect("a layout").path();
            let Ok(layout) = read_layout(&path) else {
                let text = std::fs::read_to_string(&path).expect("a layout");
                assert!(text.contains("# ?"), "{path:?} does not load and asks nothing");
                continue;
            };
            if matches!(&layout.position.columns, JointColumns::Each(columns) if columns.len() != robot.joint_count())
            {
                continue;
            }
            let mut settings =
                SimulationSettings { cycles: 1, warming_s: 0.0, ..SimulationSettings::default() };
            if let TimeSource::SampleRate(rate) = layout.time {
                // an export without time has the sample rate of its layout
                settings.sample_rate_hz = rate;
                settings.levels = Some(Vec::new());
                settings.excitation = ExcitationParts { series: false, ..ExcitationParts::default() };
            }
            settings.format =
                Some(export_format(&layout, &robot, settings.temperatures.columns).expect("a format"));
            let folder = tempfile::tempdir().expect("a folder");
            let files = simulate_run(&robot, &settings, 0, folder.path(), &mut |_| ()).expect("an export");
            let mut rows = Vec::new();
            rows_of_run(&robot, &settings, 0, |row| rows.push(*row)).expect("rows");
            let read = read_cycle(&files.export, &layout, &robot, 1)
                .unwrap_or_else(|rejection| panic!("{}: {rejection}", layout.name));
            assert_same(&layout.name, &read.expect("a cycle").samples, &rows, &layout);
            names.push(layout.name.clone());
        }
        names.sort();
        assert_eq!(
            names,
            [
                "kuka_trace",
                "motor_side",
                "native",
                "production",
                "ros_joint_states",
                "ros_topic_echo",
                "ur10e_current",
                "ur_rtde"
            ]
        );
    }
}
