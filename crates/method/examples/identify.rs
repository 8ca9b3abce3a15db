//! Identifies a real arm: a recording in, parameters with their 95 % intervals out.
//!
//! `cargo run -p armwatch-method --example identify` reads four seconds of a Stäubli TX40, recorded at its motors, and
//! prints 61 lines, each with name, value, interval and unit:
//!
//! ```text
//! J1_Izz      1.1784     1.1199 to    1.2370 kg m^2
//! J2_mPx      2.2905     2.0126 to    2.5683 kg m
//! ...
//! J1_fs       6.9828     6.1693 to    7.7964 Nm
//! J1_fv       8.2740     8.0132 to    8.5347 Nm s/rad
//! J1_off      0.4248    -0.0273 to    0.8769 Nm
//! ...
//! ```
//!
//! The offset `J1_off` is not distinguishable from zero. Gautier, Janot and Vandanjon (2011)
//! publish 8.1 Nm s/rad (`fv`) and 7.0 Nm (`fs`) for joint 1 of this arm.

#![expect(clippy::print_stdout, reason = "the results of an example")]

use std::error::Error;
use std::path::Path;

use armwatch_config::{read_layout, read_robot};
use armwatch_ingest::bytes::source::open;
use armwatch_ingest::table::reader::{ExportReader, ReadOptions};
use armwatch_method::analyse::{Method, analyse_cycle};
use armwatch_method::segment::cycles::CycleCutter;
use armwatch_method::segment::joint_side::JointSide;
use armwatch_method::segment::stages::StageFinder;
use armwatch_model::analysis::interval::{LEVEL, half_width};
use armwatch_model::analysis::settings::AnalysisSettings;

fn main() -> Result<(), Box<dyn Error>> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let robot = read_robot(&root.join("config/robots/tx40.toml"))?;
    let layout = read_layout(&root.join("config/exports/motor_side.toml"))?;
    let path = root.join("tests/reference/tx40/TX40_0000-4000ms_5kHz.csv.gz");

    let side = JointSide::new(&robot, layout.motor_side.position, layout.motor_side.torque)?;
    let low_speed = robot.joints.iter().map(|joint| joint.low_speed).collect();
    let mut stages = StageFinder::new(layout.stage.kind().rule(), low_speed);
    let (mut cutter, mut cycles) = (CycleCutter::new(), Vec::new());
    for chunk in ExportReader::new(open(&path)?, &path, &layout, &robot, ReadOptions::default())? {
        let mut rows = chunk?.samples;
        side.apply(&mut rows);
        let (rows, outside) = stages.push(rows);
        cutter.push(rows);
        if let Some(outside) = outside {
            return Err(outside.into());
        }
        while let Some(cycle) = cutter.next_cycle()? {
            cycles.push(cycle);
        }
    }
    cutter.push(stages.finish());
    while let Some(cycle) = cutter.next_cycle()? {
        cycles.push(cycle);
    }
    cycles.extend(cutter.finish()?);

    let method = Method::new(robot, AnalysisSettings::default())?;
    for cycle in &cycles {
        for found in analyse_cycle(&method, cycle).identification?.parameters {
            let (id, value, half) = (found.id, found.value, half_width(&found, LEVEL));
            let (low, high) = (value - half, value + half);
            let unit = id.unit(method.robot.joints[id.joint.index()].kind);
            println!("{:8} {value:9.4}  {low:9.4} to {high:9.4} {unit}", id.to_string());
        }
    }
    Ok(())
}
