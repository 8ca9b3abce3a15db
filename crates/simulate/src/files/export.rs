//! Writes rows to a CSV file, in the native layout or any other, in bounded memory, visible only when complete.

use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::{fs, io};

use flate2::Compression;
use flate2::write::GzEncoder;

use super::fixed_point::{push_fixed, push_whole};
use super::format::ExportFormat;
use crate::plan::motion::PerJoint;
use crate::run::recording::RecordedRow;
use crate::run::temperatures::TemperatureColumns;
use armwatch_model::robot::{MAX_JOINTS, Robot};
use armwatch_model::run::temperature::ZERO_CELSIUS;

/// Text collected before it is written: some hundred rows, few system calls.
const CHUNK_BYTES: usize = 1 << 16;
const TIME_DECIMALS: usize = 4;
const MOTION_DECIMALS: usize = 6;
const TORQUE_DECIMALS: usize = 4;
const TEMPERATURE_DECIMALS: usize = 2;

/// Number of columns for `joint_count` joints.
pub fn column_count(joint_count: usize) -> usize {
    3 * joint_count + 5
}

/// Header line of the native layout, without its end; temperatures are the last columns.
pub fn header(joint_count: usize, temperatures: TemperatureColumns) -> String {
    let mut columns = vec!["time".to_owned()];
    for channel in ["pos", "vel", "trq"] {
        columns.extend((1..=joint_count).map(|j| format!("{channel}_{j}")));
    }
    columns.extend(["stage", "cycle", "joint", "level"].map(str::to_owned));
    if temperatures.motor {
        columns.extend((1..=joint_count).map(|j| format!("motor_temperature_{j}_degc")));
    }
    if temperatures.ambient {
        columns.push("ambient_temperature_degc".to_owned());
    }
    columns.join(",")
}

/// An export that is being written with a hidden name next to its final one.
///
/// If it is dropped before [`finish`](Self::finish), it leaves no file behind.
#[derive(Debug)]
pub struct ExportWriter {
    joint_count: usize,
    temperatures: TemperatureColumns,
    format: Option<ExportFormat>,
    /// Model's positions minus the controller's, rad (m).
    position_offsets: PerJoint,
    part: PartFile,
    output: Output,
    text: Vec<u8>,
}

#[derive(Debug)]
enum Output {
    Plain(File),
    Gzip(GzEncoder<File>),
}

impl ExportWriter {
    /// Starts the export `path` in the native layout, compressed if its name ends in `.gz`, and writes the header.
    ///
    /// # Errors
    /// Those of creating the file.
    pub fn create(path: &Path, joint_count: usize) -> io::Result<Self> {
        Self::create_with(path, joint_count, TemperatureColumns::default())
    }

    /// The same with columns of temperatures.
    ///
    /// # Errors
    /// Those of creating the file.
    pub fn create_with(
        path: &Path,
        joint_count: usize,
        temperatures: TemperatureColumns,
    ) -> io::Result<Self> {
        Self::start(path, joint_count, temperatures, None)
    }

    /// The same with the columns of `format`.
    ///
    /// # Errors
    /// Those of creating the file.
    pub fn create_in(path: &Path, format: ExportFormat) -> io::Result<Self> {
        Self::start(path, 0, TemperatureColumns::default(), Some(format))
    }

    fn start(
        path: &Path,
        joint_count: usize,
        temperatures: TemperatureColumns,
        format: Option<ExportFormat>,
    ) -> io::Result<Self> {
        let part = PartFile::beside(path)?;
        let file = File::create(&part.hidden)?;
        let output = if path.extension().is_some_and(|e| e == "gz") {
            Output::Gzip(GzEncoder::new(file, Compression::fast()))
        } else {
            Output::Plain(file)
        };
        let mut text = Vec::with_capacity(CHUNK_BYTES + 1024);
        match &format {
            Some(format) => format.push_header(&mut text),
            None => {
                text.extend_from_slice(header(joint_count, temperatures).as_bytes());
                text.push(b'\n');
            }
        }
        let position_offsets = [0.0; MAX_JOINTS];
        Ok(Self { joint_count, temperatures, format, position_offsets, part, output, text })
    }

    /// Makes the export contain positions as the controller of `robot` counts them: those of the rows minus the
    /// position offsets. Without this, the arm has no offsets.
    #[must_use]
    pub fn with_offsets_of(mut self, robot: &Robot) -> Self {
        let joints = self.position_offsets.iter_mut().zip(&robot.joints);
        joints.for_each(|(offset, joint)| *offset = joint.position_offset);
        self
    }

    /// Appends a row.
    ///
    /// # Errors
    /// Those of writing.
    pub fn push(&mut self, row: &RecordedRow) -> io::Result<()> {
        let mut row = *row;
        row.position.iter_mut().zip(&self.position_offsets).for_each(|(q, offset)| *q -= offset);
        match &self.format {
            Some(format) => format.push_row(&mut self.text, &row),
            None => push_row(&mut self.text, &row, self.joint_count, self.temperatures),
        }
        if self.text.len() >= CHUNK_BYTES { self.write_text() } else { Ok(()) }
    }

    /// Gives the file its final name now, so that it visibly grows.
    ///
    /// # Errors
    /// Those of writing or renaming.
    pub fn show(&mut self) -> io::Result<()> {
        self.write_out()?;
        self.part.reveal()
    }

    /// Writes the pushed rows to the file.
    ///
    /// # Errors
    /// Those of writing.
    pub fn write_out(&mut self) -> io::Result<()> {
        self.write_text()
    }

    /// Writes the rest and gives the file its final name.
    ///
    /// # Errors
    /// Those of writing or renaming.
    pub fn finish(mut self) -> io::Result<()> {
        self.write_text()?;
        match self.output {
            Output::Plain(mut file) => file.flush()?,
            Output::Gzip(encoder) => encoder.finish()?.flush()?,
        }
        self.part.reveal()
    }

    fn write_text(&mut self) -> io::Result<()> {
        match &mut self.output {
            Output::Plain(file) => file.write_all(&self.text)?,
            Output::Gzip(encoder) => encoder.write_all(&self.text)?,
        }
        self.text.clear();
        Ok(())
    }
}

fn push_row(text: &mut Vec<u8>, row: &RecordedRow, joint_count: usize, temperatures: TemperatureColumns) {
    push_fixed(text, row.time, TIME_DECIMALS);
    push_channel(text, &row.position, joint_count, MOTION_DECIMALS);
    push_channel(text, &row.velocity, joint_count, MOTION_DECIMALS);
    push_channel(text, &row.torque, joint_count, TORQUE_DECIMALS);
    let stage = u32::from(row.stage.number());
    let (joint, level) = row.signal.map_or((0, 0), |s| (s.joint.number() as u32, u32::from(s.level)));
    for value in [stage, row.cycle, joint, level] {
        text.push(b',');
        push_whole(text, value);
    }
    if temperatures.motor {
        let celsius = row.motor_temperature.map(|kelvin| kelvin - ZERO_CELSIUS);
        push_channel(text, &celsius, joint_count, TEMPERATURE_DECIMALS);
    }
    if temperatures.ambient {
        text.push(b',');
        push_fixed(text, row.ambient_temperature - ZERO_CELSIUS, TEMPERATURE_DECIMALS);
    }
    text.push(b'\n');
}

fn push_channel(text: &mut Vec<u8>, values: &PerJoint, joint_count: usize, decimals: usize) {
    for value in &values[..joint_count] {
        text.push(b',');
        push_fixed(text, *value, decimals);
    }
}

/// A file under a hidden name, removed unless it is revealed.
#[derive(Debug)]
struct PartFile {
    hidden: PathBuf,
    target: PathBuf,
    revealed: bool,
}

impl PartFile {
    fn beside(target: &Path) -> io::Result<Self> {
        let name = target.file_name().ok_or_else(|| {
            io::Error::new(io::ErrorKind::InvalidInput, format!("{} names no file", target.display()))
        })?;
        let hidden = target.with_file_name(format!(".{}.part", name.to_string_lossy()));
        Ok(Self { hidden, target: target.to_owned(), revealed: false })
    }

    fn reveal(&mut self) -> io::Result<()> {
        if !self.revealed {
            fs::rename(&self.hidden, &self.target)?;
            self.revealed = true;
        }
        Ok(())
    }
}

impl Drop for PartFile {
    fn drop(&mut self) {
        if !self.revealed {
            // Nothing needs the partial file; if it cannot be removed, its name still hides it.
            let _ = fs::remove_file(&self.hidden);
        }
    }
}

#[cfg(test)]
mod tests {
    use std::io::Read;

    use flate2::read::GzDecoder;

    use super::*;
    use armwatch_model::robot::JointIndex;
    use armwatch_model::run::FrictionSignal;
    use armwatch_model::run::Stage;

    fn row() -> RecordedRow {
        let mut position = [0.0; MAX_JOINTS];
        position[1] = -1.234_567_8;
        RecordedRow {
            time: 12.34,
            position,
            velocity: [0.5; MAX_JOINTS],
            torque: [-7.123_46; MAX_JOINTS],
            stage: Stage::Friction,
            cycle: 3,
            signal: Some(FrictionSignal { joint: JointIndex::new(1), level: 6 }),
            motor_temperature: [ZERO_CELSIUS + 41.3; MAX_JOINTS],
            ambient_temperature: ZERO_CELSIUS - 0.5,
        }
    }

    #[test]
    fn temperatures_stand_behind_everything_else_and_the_native_layout_reads_them() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.csv");
        let columns = TemperatureColumns { motor: true, ambient: true };
        let mut writer = ExportWriter::create_with(&path, 2, columns).unwrap();
        writer.push(&row()).unwrap();
        writer.finish().unwrap();
        let text = fs::read_to_string(&path).unwrap();
        let lines: Vec<&str> =
            text.lines().zip(TEXT.lines()).map(|(line, plain)| line.strip_prefix(plain).unwrap()).collect();
        let names = ",motor_temperature_1_degc,motor_temperature_2_degc,ambient_temperature_degc";
        assert_eq!(lines, [names, ",41.30,41.30,-0.50"]);
        assert_eq!(columns.count(2), 3);
    }

    const TEXT: &str = "time,pos_1,pos_2,vel_1,vel_2,trq_1,trq_2,stage,cycle,joint,level\n\
        12.3400,0.000000,-1.234568,0.500000,0.500000,-7.1235,-7.1235,2,3,2,6\n";

    #[test]
    fn plain_and_compressed_exports_hold_the_same_text() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["a.csv", "a.csv.gz"] {
            let path = folder.path().join(name);
            let mut writer = ExportWriter::create(&path, 2).unwrap();
            writer.push(&row()).unwrap();
            assert!(!path.exists(), "an export must not show before it is complete");
            assert!(folder.path().join(format!(".{name}.part")).exists());
            writer.finish().unwrap();
            let mut text = String::new();
            if name.ends_with("gz") {
                GzDecoder::new(File::open(&path).unwrap()).read_to_string(&mut text).unwrap();
            } else {
                text = fs::read_to_string(&path).unwrap();
            }
            assert_eq!(text, TEXT);
            assert_eq!(TEXT.lines().next().unwrap().split(',').count(), column_count(2));
        }
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 2, "no part stays behind");
    }

    #[test]
    fn an_abandoned_export_leaves_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let mut writer = ExportWriter::create(&folder.path().join("a.csv"), 2).unwrap();
        writer.push(&row()).unwrap();
        drop(writer);
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
    }
}
