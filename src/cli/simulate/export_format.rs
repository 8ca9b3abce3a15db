//! A layout the other way round: what the simulator writes for the reader to understand.

use nalgebra::DMatrix;

use crate::cli::context::CliError;
use crate::config::{
    Channel, Column, DecimalMark, Layout, StageCells, TemperatureUnit, TextEncoding, TimeSource,
};
use crate::robot::Robot;
use crate::simulate::format::{Cell, ExportColumn, ExportFormat, TemperatureScale, Weighted};
use crate::simulate::temperatures::TemperatureColumns;

/// The columns with which `layout` reads exports of `robot`: columns by number at their places, all others
/// in the order time, position, velocity, torque, stage, cycle, friction joint and level, and of the temperatures
/// that the layout names those that are recorded.
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
    let unused = |at: usize| ExportColumn { name: format!("unused_{}", at + 1), cell: Cell::Unused };
    let mut columns: Vec<ExportColumn> = (0..width).map(unused).collect();
    let (numbered, named): (Vec<_>, Vec<_>) =
        cells.into_iter().partition(|(column, _)| place(column).is_some());
    for (column, cell) in numbered {
        let free = place(&column).and_then(|number| columns.get_mut(number.checked_sub(1)?));
        match free {
            Some(slot) if slot.cell == Cell::Unused => {
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
    for slot in columns.iter_mut().filter(|slot| slot.cell == Cell::Unused) {
        let Some((column, cell)) = named.next() else { break };
        *slot = ExportColumn { name: column.to_string(), cell };
    }
    Ok(ExportFormat { delimiter: layout.delimiter, header: layout.header, columns })
}

/// The simulator writes UTF-8 with decimal points, and nothing before or under the header.
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
        "layout \"{}\" has another encoding, decimal commas or skipped lines, which the simulator does not write",
        layout.name
    )))
}

fn cells(layout: &Layout, robot: &Robot) -> Result<Vec<(Column, Cell)>, CliError> {
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
    let offsets: Vec<f64> = robot.joints.iter().map(|joint| -joint.position_offset).collect();
    let mut cells = Vec::new();
    match &layout.time {
        TimeSource::Column(time) | TimeSource::Counter { column: time, .. } => {
            cells.push((time.column.clone(), Cell::Time(time.to_si.recip())));
        }
        TimeSource::Timestamp(_) => {
            return Err(CliError::Usage(format!(
                "layout \"{}\" has timestamps, which the simulator does not write",
                layout.name
            )));
        }
        TimeSource::SampleRate(_) => {}
    }
    let still = vec![0.0; n];
    let mut channel = |channel: &Channel,
                       side: &Option<DMatrix<f64>>,
                       added: &[f64],
                       factors: &[f64],
                       cell: fn(Weighted) -> Cell| {
        for (j, factor) in factors.iter().enumerate() {
            let weights: Vec<f64> = (0..n)
                .map(|k| match side {
                    Some(side) => side[(j, k)] / factor,
                    None => f64::from(u8::from(j == k)) / factor,
                })
                .collect();
            let constant = weights.iter().zip(added).map(|(w, x)| w * x).sum();
            if let Some(column) = channel.columns.of_joint(j + 1) {
                cells.push((column, cell(Weighted { weights, constant })));
            }
        }
    };
    channel(&layout.position, &positions, &offsets, &factors.position, Cell::Position);
    if let Some(velocity) = &layout.velocity {
        channel(velocity, &positions, &still, &factors.velocity, Cell::Velocity);
    }
    channel(&layout.torque, &torques, &still, &factors.torque, Cell::Torque);
    cells.extend(signals(layout)?);
    Ok(cells)
}

fn temperature_cells(layout: &Layout, robot: &Robot, recorded: TemperatureColumns) -> Vec<(Column, Cell)> {
    let scale = |unit: TemperatureUnit| {
        let at_zero = unit.of_kelvin(0.0);
        TemperatureScale { at_zero, per_kelvin: unit.of_kelvin(1.0) - at_zero }
    };
    let motor = layout.motor_temperature.as_ref().filter(|_| recorded.motor);
    let motors = motor.into_iter().flat_map(|motor| {
        let cell = move |joint| Cell::MotorTemperature { joint, scale: scale(motor.unit) };
        (0..robot.joint_count())
            .filter_map(move |joint| Some((motor.columns.of_joint(joint + 1)?, cell(joint))))
    });
    let ambient = layout.ambient_temperature.as_ref().filter(|_| recorded.ambient);
    let ambient =
        ambient.map(|ambient| (ambient.column.clone(), Cell::AmbientTemperature(scale(ambient.unit))));
    motors.chain(ambient).collect()
}

fn signals(layout: &Layout) -> Result<Vec<(Column, Cell)>, CliError> {
    let mut cells = Vec::new();
    cells.extend(stage_cells(layout)?);
    let optional = [
        (&layout.cycle, Cell::Cycle),
        (&layout.friction_joint, Cell::FrictionJoint),
        (&layout.friction_level, Cell::FrictionLevel),
    ];
    cells.extend(optional.into_iter().filter_map(|(column, cell)| Some((column.clone()?, cell))));
    Ok(cells)
}

/// The columns of the stage signal, none where the layout has none.
fn stage_cells(layout: &Layout) -> Result<Vec<(Column, Cell)>, CliError> {
    let lacking = || {
        CliError::Usage(format!(
            "layout \"{}\" has no value for some stage, and a simulated run has all of them",
            layout.name
        ))
    };
    let columns = layout.stage.kind().cells().ok_or_else(lacking)?;
    let cell = |cells| match cells {
        StageCells::Texts(texts) => Cell::StageWord(texts),
        StageCells::Levels { levels, narrowest } => {
            Cell::StageLevel { levels, noise: NOISE_OF_RANGE * narrowest }
        }
    };
    Ok(columns.into_iter().map(|(column, cells)| (column.clone(), cell(cells))).collect())
}

/// Largest noise of an analogue stage signal, as a part of its narrowest range.
const NOISE_OF_RANGE: f64 = 0.3;
