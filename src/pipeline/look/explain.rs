//! Explains how the daemon would treat an export, without storing anything: recognition, reading, cutting and analysis
//! as in ingestion, with read-only access to the database.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::SystemTime;

use jiff::Timestamp;

use crate::pipeline::conclude::windows::too_late;
use crate::pipeline::context::{Pipeline, PipelineError, Retry};
use crate::pipeline::production::{CycleWork, work_alone};
use crate::pipeline::take::cycles::{Filled, RowCutter};
use crate::pipeline::take::decide::{Decision, Start};
use crate::pipeline::take::intake::Recognised;
use crate::pipeline::take::{decide, intake, new_robot, record};
use armwatch_config::{Config, FleetEntry, Layout};
use armwatch_ingest::bytes::{parts, source};
use armwatch_ingest::rejection::Rejection;
use armwatch_ingest::repeated;
use armwatch_ingest::table::cell_reader::PassedOver;
use armwatch_ingest::table::column_map::ColumnMap;
use armwatch_ingest::table::mended::Mended;
use armwatch_ingest::table::reader::{Chunk, ExportReader, LeftOut, ReadOptions};
use armwatch_method::analyse::Method;
use armwatch_model::analysis::settings::AnalysisSettings;
use armwatch_model::analysis::{CycleAnalysis, CycleFactors};
use armwatch_model::robot::Robot;
use armwatch_model::run::arrival::{Arrival, implausible_dates};
use armwatch_model::run::{ContentHash, Cycle, Samples, Stage};
use armwatch_store::{KnownRun, Store};

/// All results about an export before it is stored.
#[derive(Debug, Clone)]
pub struct Explanation {
    /// The file.
    pub path: PathBuf,
    /// Its size on disk, bytes.
    pub bytes: u64,
    /// Time since it was last written, s; negative by a clock that is ahead.
    pub age_s: Option<f64>,
    /// Robot and entry of the export; a rejection if the name does not give them.
    pub recognised: Option<RecognisedAs>,
    /// Contents of the export as far as it is readable; `None` if it belongs to no robot.
    pub reading: Option<ExportReading>,
    /// Why it would be quarantined.
    pub rejection: Option<Rejection>,
    /// Doubts about its robot's name and its start.
    pub doubts: Vec<String>,
    /// The database's record of its content.
    pub ledger: Ledger,
    /// The treatment that it would get.
    pub next: NextAction,
}

/// The robot that an export belongs to, and the reason.
#[derive(Debug, Clone)]
pub struct RecognisedAs {
    /// The individual robot.
    pub robot: String,
    /// Start of the recording.
    pub started_at: Timestamp,
    /// True if the file's name gives the start. Otherwise the start is the file's modification time minus the
    /// recording's duration.
    pub named_start: bool,
    /// Pattern of file names that matched; `None` if the whole name is the robot's.
    pub pattern: Option<String>,
    /// The configuration's entry.
    pub entry: FleetEntry,
}

/// Contents of an export.
#[derive(Debug, Clone)]
pub struct ExportReading {
    /// Identity of the content, if all of it was readable.
    pub content: Option<ContentHash>,
    /// Column of each channel, if the header is understood.
    pub columns: Option<ColumnMap>,
    /// Rows read.
    pub rows: u64,
    /// Time from the first to the last row, s.
    pub duration: f64,
    /// Rows per second, Hz; zero if unknown.
    pub sample_rate: f64,
    /// The last line, omitted because the writer did not complete it.
    pub left_out: Option<LeftOut>,
    /// Bad rows that are skipped.
    pub passed_over: PassedOver,
    /// Deviations from the layout that are understood nevertheless.
    pub mended: Mended,
    /// Rows of slower channels.
    pub filled: Filled,
    /// The cycles, in order.
    pub cycles: Vec<CycleSketch>,
}

/// One cycle of an export.
#[derive(Debug, Clone)]
pub struct CycleSketch {
    /// Number in the run, from 1.
    pub cycle: u32,
    /// Time of the first row, s.
    pub start: f64,
    /// Time from the first to the last row, s.
    pub duration: f64,
    /// Rows.
    pub rows: usize,
    /// Rows and time by stage, those between stages first.
    pub stages: [StagePart; 4],
    /// The result of the analysis, without factors; `None` if no analysis was requested.
    pub analysis: Option<CycleAnalysis>,
}

/// A stage's part of a cycle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StagePart {
    /// The stage.
    pub stage: Stage,
    /// Rows.
    pub rows: usize,
    /// Their time, s.
    pub seconds: f64,
}

/// The database's record of a content.
#[derive(Debug, Clone, PartialEq)]
pub enum Ledger {
    /// There is no database yet.
    NoDatabase,
    /// It cannot be read, for this reason.
    Unreadable(String),
    /// Nothing.
    Unknown,
    /// A run.
    Known(KnownRun),
}

/// The daemon's next action for an export.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum NextAction {
    /// Store it as a run.
    Store {
        /// The unfinished, shorter or corrected run that the export continues.
        continues: Option<i64>,
        /// The run that it supersedes, whose file it overwrote.
        replaces: Option<i64>,
    },
    /// Nothing: this run already has its content.
    Nothing {
        /// The run.
        run_id: i64,
    },
    /// Quarantine it.
    Quarantine,
}

/// Explains exports.
#[derive(Debug)]
pub struct Explainer {
    config: Arc<Config>,
    /// The pipeline on the existing database, or the reason why there is none.
    pipeline: Result<Pipeline, Ledger>,
    methods: Vec<Arc<Method>>,
}

impl Explainer {
    /// Creates an explainer with the database of `config`, if there is one.
    pub async fn new(config: Arc<Config>) -> Self {
        let pipeline = match Store::open_existing_as(&config.database, &config.cluster).await {
            Ok(Some(store)) => Ok(Pipeline::new(Arc::clone(&config), store)),
            Ok(None) => Err(Ledger::NoDatabase),
            Err(error) => Err(Ledger::Unreadable(error.to_string())),
        };
        Self { config, pipeline, methods: Vec::new() }
    }

    /// Creates an explainer with an open database.
    #[must_use]
    pub fn with_store(config: Arc<Config>, store: Store) -> Self {
        let pipeline = Ok(Pipeline::new(Arc::clone(&config), store));
        Self { config, pipeline, methods: Vec::new() }
    }

    /// Explains one export; analyses its cycles unless `quick`.
    ///
    /// # Errors
    /// [`PipelineError`] of the database, or of a task that panicked. A bad export is a result, not an error.
    pub async fn explain(&mut self, path: &Path, quick: bool) -> Result<Explanation, PipelineError> {
        let recognised = intake::recognise(&self.config, path, intake::file_time(path));
        let (mut recognised, mut rejection) = match recognised {
            Ok(recognised) => (Some(self.recognised_as(&recognised, path)), None),
            Err(rejection) => (None, Some(rejection)),
        };
        let mut reading = None;
        if let Some(of) = &mut recognised {
            let method = if quick { None } else { self.method(&of.entry.description).await? };
            let work = method.as_ref().map(|method| work_alone(&of.entry.layout, method));
            let (owned, entry) = (path.to_owned(), of.entry.clone());
            let read = move || read(&owned, &entry.layout, &entry.description, work.as_ref());
            let read = tokio::task::spawn_blocking(read);
            let (found, fault) = read.await?;
            if !of.named_start {
                of.started_at = record::start_before(of.started_at, found.duration);
            }
            (reading, rejection) = (Some(found), fault);
        }
        let mut doubts = Vec::new();
        if let (Ok(pipeline), Some(of)) = (&self.pipeline, &recognised) {
            doubts = doubts_of(pipeline, path, of).await?;
            if rejection.is_none()
                && let Ok(named) = intake::recognise(&self.config, path, intake::file_time(path))
            {
                rejection = new_robot::question(pipeline, path, &named).await?;
            }
        }
        let (ledger, next) = self.ledger(path, rejection.is_some()).await?;
        let state = parts::state(path).ok();
        Ok(Explanation {
            path: path.to_owned(),
            bytes: state.map_or(0, |state| state.bytes),
            age_s: state.map(|state| age(state.modified)),
            recognised,
            reading,
            rejection,
            doubts,
            ledger,
            next,
        })
    }

    fn recognised_as(&self, of: &Recognised<'_>, path: &Path) -> RecognisedAs {
        let recognition = &self.config.recognition;
        let fits = recognition.fits(&intake::file_name(path));
        RecognisedAs {
            robot: of.robot.clone(),
            started_at: of.started_at,
            named_start: of.named_start,
            pattern: fits.then(|| recognition.file_name.to_string()),
            entry: of.entry.clone(),
        }
    }

    /// The structure analysis of a robot; `None` if it has none, and reading does not need one then.
    async fn method(&mut self, robot: &Arc<Robot>) -> Result<Option<Arc<Method>>, PipelineError> {
        if let Some(known) = self.methods.iter().find(|method| method.robot == **robot) {
            return Ok(Some(Arc::clone(known)));
        }
        let (robot, settings) = (Robot::clone(robot), self.config.analysis);
        let made = tokio::task::spawn_blocking(move || Method::new(robot, settings)).await?;
        let made = made.ok().map(Arc::new);
        self.methods.extend(made.clone());
        Ok(made)
    }

    /// The database's record of the content, and the next action.
    async fn ledger(&self, path: &Path, rejected: bool) -> Result<(Ledger, NextAction), PipelineError> {
        let new = NextAction::Store { continues: None, replaces: None };
        let unless_rejected = |next: NextAction| if rejected { NextAction::Quarantine } else { next };
        let pipeline = match &self.pipeline {
            Ok(pipeline) => pipeline,
            Err(ledger) => return Ok((ledger.clone(), unless_rejected(new))),
        };
        let Some(state) = intake::source_state(path) else {
            return Ok((Ledger::Unknown, unless_rejected(new)));
        };
        let owned = path.to_owned();
        let hash =
            tokio::task::spawn_blocking(move || armwatch_ingest::bytes::fingerprint::fingerprint(&owned))
                .await?;
        let content = hash.ok().map(|(hash, _)| hash);
        let recognised = intake::recognise(&self.config, path, intake::file_time(path)).ok();
        let facts =
            intake::facts(pipeline, path, content, state, recognised.as_ref(), Retry::Quarantined).await?;
        let Ok(facts) = facts else { return Ok((Ledger::Unknown, NextAction::Quarantine)) };
        let next = match decide::decide(&facts) {
            Decision::Known { run: KnownRun { run_id, .. }, .. } | Decision::InWork { run_id } => {
                NextAction::Nothing { run_id }
            }
            Decision::Read(Start { continues, replaces, .. }) => {
                unless_rejected(NextAction::Store { continues, replaces })
            }
        };
        Ok((facts.known.map_or(Ledger::Unknown, Ledger::Known), next))
    }
}

/// Doubts about the robot's name and the start of an export, in view of the stored runs.
async fn doubts_of(
    pipeline: &Pipeline,
    path: &Path,
    of: &RecognisedAs,
) -> Result<Vec<String>, PipelineError> {
    let mut doubts = Vec::new();
    if of.pattern.is_none() && !pipeline.store().knows_robot(&of.robot).await? {
        doubts.push(format!(
            "recognition.file_name does not match the name, which becomes that of a new robot \"{}\"",
            of.robot
        ));
    }
    let kind = of.entry.layout.stage.kind().run_kind();
    let name = intake::file_name(path);
    let runs = pipeline.store().dated_runs(&of.robot).await?;
    let others = runs.iter().filter(|run| run.kind == kind && run.source_name != name);
    let mut arrivals: Vec<Arrival<'_>> = others.map(|run| run.arrival()).collect();
    let ledger_path = intake::ledger_path(pipeline.store(), path);
    let stored = runs.iter().find(|run| run.source_path == ledger_path);
    arrivals.push(stored.map_or_else(
        || Arrival {
            started_at: of.started_at,
            arrived_at: Timestamp::now(),
            file_time: of.named_start.then(|| intake::file_time(path)),
            folder: ledger_path.rsplit_once('/').map_or("", |(folder, _)| folder),
            is_confirmed: false,
        },
        |run| run.arrival(),
    ));
    if let Some(date) = implausible_dates(&arrivals).pop().flatten() {
        let effect = if date.is_in_order { "the order of arrival counts" } else { "no conclusion uses it" };
        doubts.push(format!(
            "the start cannot be right: {date}; {effect}, until `armwatch run-date` corrects or confirms it"
        ));
    }
    let boundary = match stored {
        Some(run) => pipeline.store().arrived_too_late(run.run_id).await?,
        None => pipeline.store().settled_after(&of.robot, kind, of.started_at).await?,
    };
    doubts.extend(boundary.map(|boundary| too_late(&of.robot, boundary)));
    Ok(doubts)
}

/// Time since `modified`, s.
fn age(modified: SystemTime) -> f64 {
    match SystemTime::now().duration_since(modified) {
        Ok(age) => age.as_secs_f64(),
        Err(ahead) => -ahead.duration().as_secs_f64(),
    }
}

/// Reads an export with a layout that is not in the configuration yet. Analyses its cycles if `is_analysed` and the
/// robot's description permits it. Returns the contents together with the fault that ended reading, if any.
pub fn try_layout(
    path: &Path,
    layout: &Layout,
    robot: &Robot,
    is_analysed: bool,
) -> (ExportReading, Option<Rejection>) {
    let method = is_analysed.then(|| Method::new(robot.clone(), AnalysisSettings::default()).ok()).flatten();
    let work = method.map(|method| work_alone(layout, &Arc::new(method)));
    read(path, layout, robot, work.as_ref())
}

/// Reads an export to its end or its first fault.
fn read(
    path: &Path,
    layout: &Layout,
    robot: &Robot,
    work: Option<&CycleWork>,
) -> (ExportReading, Option<Rejection>) {
    let mut reading = ExportReading {
        content: None,
        columns: None,
        rows: 0,
        duration: 0.0,
        sample_rate: 0.0,
        left_out: None,
        passed_over: PassedOver::default(),
        mended: Mended::default(),
        filled: Filled::default(),
        cycles: Vec::new(),
    };
    let fault = read_into(&mut reading, path, layout, robot, work).err();
    let fault = fault.map(|fault| repeated::explained(fault, source::MAX_DECOMPRESSED_BYTES));
    (reading, fault)
}

fn read_into(
    reading: &mut ExportReading,
    path: &Path,
    layout: &Layout,
    robot: &Robot,
    work: Option<&CycleWork>,
) -> Result<(), Rejection> {
    let (mut export, hash) =
        ExportReader::open(path, layout, robot, ReadOptions::default(), source::MAX_DECOMPRESSED_BYTES)?;
    reading.columns = Some(export.columns().clone());
    let mut cutter = RowCutter::new(path, layout, robot)?;
    let mut first_time = None;
    while let Some(chunk) = export.next() {
        let Chunk { samples, first_line, .. } = chunk?;
        reading.rows = export.rows();
        if let (Some(first), Some(last)) = (samples.time.first(), samples.time.last()) {
            reading.duration = last - *first_time.get_or_insert(*first);
        }
        cutter.note_line(first_line);
        cutter.push(samples);
        reading.sample_rate = cutter.sample_rate();
        reading.sketch(&mut cutter, work)?;
    }
    reading.left_out = export.left_out();
    reading.passed_over = export.passed_over().clone();
    reading.mended = export.mended().clone();
    reading.content = Some(hash.so_far().0);
    cutter.finish();
    let fault = reading.sketch(&mut cutter, work);
    reading.filled = cutter.filled();
    fault
}

impl ExportReading {
    /// Adds the cycles that end within the rows pushed so far.
    fn sketch(&mut self, cutter: &mut RowCutter, work: Option<&CycleWork>) -> Result<(), Rejection> {
        while let Some(cycle) = cutter.next_cycle()? {
            self.cycles.push(sketch(&cycle, work));
        }
        Ok(())
    }
}

fn sketch(cycle: &Cycle, work: Option<&CycleWork>) -> CycleSketch {
    let samples = &cycle.samples;
    let ends = samples.time.first().zip(samples.time.last());
    // the factors of an hour are not needed here
    let analysis = work.map(|work| CycleAnalysis { factors: CycleFactors::default(), ..work.analyse(cycle) });
    CycleSketch {
        cycle: cycle.number,
        start: ends.map_or(0.0, |(first, _)| *first),
        duration: ends.map_or(0.0, |(first, last)| last - first),
        rows: samples.rows(),
        stages: stage_parts(samples),
        analysis,
    }
}

/// Rows and time by stage; a row lasts until the next one.
fn stage_parts(samples: &Samples) -> [StagePart; 4] {
    let stages = Stage::ALL;
    let mut parts = stages.map(|stage| StagePart { stage, rows: 0, seconds: 0.0 });
    for (row, stage) in samples.stage.iter().enumerate() {
        let part = &mut parts[*stage as usize];
        part.rows += 1;
        part.seconds += samples.time.get(row + 1).map_or(0.0, |next| next - samples.time[row]);
    }
    parts
}
