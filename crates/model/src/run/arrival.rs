//! Implausible starts of recordings, from the sequence of their arrival.
//!
//! The order of tests decides every comparison, so dates are checked like channels. The time of the file supports a
//! date; its arrival and the recordings that arrived before and after it may contradict the date. The rule is in
//! docs/method.md.

use std::collections::{BTreeMap, BTreeSet, HashMap, HashSet};
use std::fmt;

use jiff::{SignedDuration, Timestamp};

/// Grace for a start after the arrival: clocks and time zones differ by less.
pub const GRACE: SignedDuration = SignedDuration::from_hours(24);

/// A file is written within this time of its recording, time zones included.
const WRITTEN_WITHIN: SignedDuration = SignedDuration::from_hours(48);

/// Delay after its neighbours within which a recording is an ordinary straggler.
const STRAGGLER: SignedDuration = SignedDuration::from_hours(14 * 24);

/// Distance in time beyond which recordings have no neighbour in common.
const YEAR: SignedDuration = SignedDuration::from_hours(365 * 24);

/// Allowed step of an unknown rhythm.
const FIRST_STEP: SignedDuration = SignedDuration::from_hours(31 * 24);

/// No machine that runs this program has a clock before 2026.
const EARLIEST_ARRIVAL: Timestamp = Timestamp::constant(1_767_225_600, 0);

/// Clocks that lost their battery begin in 1970, 1980 or 2000, and so do the times of files that they write.
const EARLIEST_FILE: Timestamp = Timestamp::constant(978_307_200, 0);

/// Least number of recordings for a meaningful order of arrival.
const ORDERED: usize = 5;

/// Least number of recordings for a meaningful jump ahead.
const KNOWN_RHYTHM: usize = 3;

/// Number of usual steps that a jump ahead exceeds.
const JUMP_STEPS: i32 = 4;

/// Most recordings of one jump ahead, unless more were recorded before it.
const MOST_AHEAD: usize = 12;

/// Most steps back in an order of arrival; a twentieth of the recordings, if that is more.
const STEPS_BACK: usize = 3;

/// Number of recordings with one start that are no coincidence. On a full hour more are needed, since names may have no
/// minutes.
const SAME_START: usize = 3;
const SAME_FULL_HOUR: usize = 5;

/// A recording of a robot, as it arrived.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Arrival<'a> {
    /// Start of the recording, from its name, its rows or its file.
    pub started_at: Timestamp,
    /// Time of its first reading, by the clock of the program's machine.
    pub arrived_at: Timestamp,
    /// Modification time of its file.
    pub file_time: Option<Timestamp>,
    /// Folder of the file.
    pub folder: &'a str,
    /// True if a person has confirmed the start.
    pub is_confirmed: bool,
}

impl Arrival<'_> {
    /// True if the time of the file agrees with the start and is independent of it.
    fn is_supported(&self) -> bool {
        let agrees = |file: Timestamp| {
            file >= EARLIEST_FILE
                && file.duration_since(self.started_at).abs() <= WRITTEN_WITHIN
                && file.as_second() != self.started_at.as_second()
        };
        self.is_confirmed || self.file_time.is_some_and(agrees)
    }

    fn is_after_arrival(&self) -> bool {
        self.arrived_at >= EARLIEST_ARRIVAL && self.started_at.duration_since(self.arrived_at) > GRACE
    }
}

/// Reason why a start is implausible.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DateProblem {
    /// It is later than the arrival of the file.
    AfterArrival(SignedDuration),
    /// It is ahead of later arrivals, which continue the recordings before it.
    AheadOfLater(SignedDuration),
    /// It is years before earlier arrivals, without any recording between them.
    YearsBefore(SignedDuration),
    /// It is before earlier arrivals, by more than any recording of this folder was late.
    OutOfOrder(SignedDuration),
    /// It is the start of this many other recordings.
    SameStart(usize),
}

/// An implausible start.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ImplausibleDate {
    /// The start.
    pub started_at: Timestamp,
    /// Reason.
    pub problem: DateProblem,
    /// True if it is still in the order of arrival, so that the recording counts.
    pub is_in_order: bool,
}

impl fmt::Display for ImplausibleDate {
    /// For example `dated 2036-01-01 08:00Z, 3321 days after the file arrived`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "dated {}, ", self.started_at.strftime("%Y-%m-%d %H:%MZ"))?;
        match self.problem {
            DateProblem::AfterArrival(by) => write!(f, "{} after the file arrived", days(by)),
            DateProblem::AheadOfLater(by) => write!(f, "{} ahead of tests that arrived later", days(by)),
            DateProblem::YearsBefore(by) | DateProblem::OutOfOrder(by) => {
                write!(f, "{} before tests that had arrived earlier", days(by))
            }
            DateProblem::SameStart(others) => write!(f, "the same start as {others} other recordings"),
        }
    }
}

fn days(length: SignedDuration) -> String {
    match length.as_hours() / 24 {
        0 => "less than a day".into(),
        1 => "1 day".into(),
        days => format!("{days} days"),
    }
}

/// Checks the starts of a robot's recordings of one kind, given in the order of their arrival. One entry per recording;
/// `None` for a plausible start.
#[must_use]
pub fn implausible_dates(arrivals: &[Arrival<'_>]) -> Vec<Option<ImplausibleDate>> {
    let isolated = isolated(arrivals);
    let ordered = ordered_folders(arrivals);
    let mut ahead: HashMap<usize, SignedDuration> = HashMap::new();
    // a recording that was ahead must not count for later arrivals
    loop {
        let mut sequence = Sequence::new(arrivals, &isolated, &ordered, &ahead);
        match (0..arrivals.len()).try_for_each(|at| sequence.take(at)) {
            Ok(()) => {
                let mut found = sequence.found;
                same_starts(arrivals, &mut found);
                return found;
            }
            Err(block) => ahead.extend(block),
        }
    }
}

/// The recordings so far, in the order of arrival.
struct Sequence<'a> {
    arrivals: &'a [Arrival<'a>],
    /// By recording, the group of neighbours in time, ascending; `None` if a file supports the group.
    isolated: &'a [Option<usize>],
    ordered: &'a HashSet<&'a str>,
    ahead: &'a HashMap<usize, SignedDuration>,
    /// Those that count, by start.
    counted: BTreeSet<(Timestamp, usize)>,
    /// By folder: the number that count, the latest start, and the largest delay.
    folders: BTreeMap<&'a str, Folder>,
    /// Longest step from one latest start to the next.
    stride: Option<SignedDuration>,
    found: Vec<Option<ImplausibleDate>>,
}

#[derive(Debug, Clone, Copy)]
struct Folder {
    recordings: usize,
    latest: Timestamp,
    lateness: SignedDuration,
}

/// Recordings that were ahead, each with its lead.
type Ahead = Vec<(usize, SignedDuration)>;

impl<'a> Sequence<'a> {
    fn new(
        arrivals: &'a [Arrival<'a>],
        isolated: &'a [Option<usize>],
        ordered: &'a HashSet<&'a str>,
        ahead: &'a HashMap<usize, SignedDuration>,
    ) -> Self {
        Self {
            arrivals,
            isolated,
            ordered,
            ahead,
            counted: BTreeSet::new(),
            folders: BTreeMap::new(),
            stride: None,
            found: vec![None; arrivals.len()],
        }
    }

    /// Judges the next recording. Fails with the recordings that it shows to have been ahead.
    fn take(&mut self, at: usize) -> Result<(), Ahead> {
        let of = self.arrivals[at];
        let after_arrival = DateProblem::AfterArrival(of.started_at.duration_since(of.arrived_at));
        if let Some(by) = self.ahead.get(&at) {
            let is_future = of.is_after_arrival();
            self.doubt(at, if is_future { after_arrival } else { DateProblem::AheadOfLater(*by) }, false);
            return Ok(());
        }
        if of.is_confirmed {
            self.count(at);
            return Ok(());
        }
        if of.is_after_arrival() {
            let goes_on = goes_on(self.latest(), self.counted.len(), self.stride, of.started_at);
            self.doubt(at, after_arrival, goes_on);
            if goes_on {
                self.count(at);
            }
            return Ok(());
        }
        let block = self.ahead_of(at);
        if !block.is_empty() {
            return Err(block);
        }
        if !of.is_supported()
            && let Some(problem) = self.too_early(at)
        {
            self.doubt(at, problem, false);
            return Ok(());
        }
        self.count(at);
        Ok(())
    }

    fn doubt(&mut self, at: usize, problem: DateProblem, is_in_order: bool) {
        let started_at = self.arrivals[at].started_at;
        self.found[at] = Some(ImplausibleDate { started_at, problem, is_in_order });
    }

    fn latest(&self) -> Option<Timestamp> {
        self.counted.last().map(|(start, _)| *start)
    }

    fn count(&mut self, at: usize) {
        let of = &self.arrivals[at];
        if let Some(latest) = self.latest().filter(|latest| of.started_at > *latest) {
            self.stride = self.stride.max(Some(of.started_at.duration_since(latest)));
        }
        let new = Folder { recordings: 0, latest: of.started_at, lateness: SignedDuration::ZERO };
        let folder = self.folders.entry(of.folder).or_insert(new);
        folder.recordings += 1;
        folder.lateness = folder.lateness.max(folder.latest.duration_since(of.started_at));
        folder.latest = folder.latest.max(of.started_at);
        self.counted.insert((of.started_at, at));
    }

    /// Recordings that this one shows to have been ahead, because it continues the recordings before them.
    fn ahead_of(&self, at: usize) -> Ahead {
        let of = &self.arrivals[at];
        let block: Vec<usize> =
            self.counted.range((of.started_at, usize::MAX)..).map(|(_, other)| *other).collect();
        let by = |other: usize| (other, self.arrivals[other].started_at.duration_since(of.started_at));
        // later than their arrival: no further evidence is needed
        let future: Ahead = block.iter().filter(|at| self.found[**at].is_some()).map(|at| by(*at)).collect();
        if !future.is_empty() || block.is_empty() || !self.ordered.contains(of.folder) {
            return future;
        }
        let is_doubtful = |other: &usize| {
            let other = &self.arrivals[*other];
            !other.is_supported() && other.folder == of.folder
        };
        let before = self.counted.len() - block.len();
        let previous = self.counted.range(..=(of.started_at, usize::MAX)).next_back();
        let (Some((previous, _)), Some(first)) = (previous, block.first()) else { return Vec::new() };
        if before < KNOWN_RHYTHM || block.len() > MOST_AHEAD.max(before) || !block.iter().all(is_doubtful) {
            return Vec::new();
        }
        let step = self.step_before(&block).unwrap_or(GRACE).max(GRACE);
        let missed = i32::try_from(block.len()).unwrap_or(i32::MAX).saturating_add(2);
        let jump = self.arrivals[*first].started_at.duration_since(*previous);
        let goes_on = of.started_at.duration_since(*previous) <= step.saturating_mul(missed);
        match goes_on && jump > STRAGGLER.max(step.saturating_mul(JUMP_STEPS)) {
            true => block.into_iter().map(by).collect(),
            false => Vec::new(),
        }
    }

    /// Longest step between neighbours in time outside `block`, which contains the latest ones.
    fn step_before(&self, block: &[usize]) -> Option<SignedDuration> {
        let starts: Vec<Timestamp> =
            self.counted.iter().take(self.counted.len() - block.len()).map(|(start, _)| *start).collect();
        starts.windows(2).map(|pair| pair[1].duration_since(pair[0])).max()
    }

    /// Reason why a recording is too far before earlier arrivals.
    fn too_early(&self, at: usize) -> Option<DateProblem> {
        let of = &self.arrivals[at];
        let (latest, other) = *self.counted.last()?;
        let lateness = latest.duration_since(of.started_at);
        let group = self.isolated[at];
        if lateness > YEAR && group.is_some() && group != self.isolated[other] {
            return Some(DateProblem::YearsBefore(lateness));
        }
        let folder = self.folders.get(of.folder)?;
        let lateness = folder.latest.duration_since(of.started_at);
        let is_known = folder.recordings >= ORDERED && self.ordered.contains(of.folder);
        (is_known && lateness > STRAGGLER.max(folder.lateness)).then_some(DateProblem::OutOfOrder(lateness))
    }
}

/// True if a start continues the rhythm of those before it.
fn goes_on(
    latest: Option<Timestamp>,
    recordings: usize,
    stride: Option<SignedDuration>,
    start: Timestamp,
) -> bool {
    let Some(latest) = latest else { return true };
    let step = start.duration_since(latest);
    let usual = match stride {
        Some(stride) => stride + stride / 2,
        None if recordings == 1 => FIRST_STEP,
        None => GRACE,
    };
    step >= SignedDuration::ZERO && step <= usual.max(GRACE)
}

/// By recording, the number of its group; `None` if a file supports a recording of the group. Groups are more than a
/// year apart.
fn isolated(arrivals: &[Arrival<'_>]) -> Vec<Option<usize>> {
    let mut by_start: Vec<usize> =
        (0..arrivals.len()).filter(|at| !arrivals[*at].is_after_arrival()).collect();
    by_start.sort_by_key(|at| arrivals[*at].started_at);
    let mut groups = vec![None; arrivals.len()];
    let start = |at: usize| arrivals[at].started_at;
    let chunks = by_start.chunk_by(|a, b| start(*b).duration_since(start(*a)) <= YEAR);
    for (number, group) in chunks.enumerate() {
        if !group.iter().any(|at| arrivals[*at].is_supported()) {
            group.iter().for_each(|at| groups[*at] = Some(number));
        }
    }
    groups
}

/// Folders whose recordings mostly arrive in the order of their starts. In other folders, such as an archive read in
/// any order, the order of arrival has no meaning.
fn ordered_folders<'a>(arrivals: &'a [Arrival<'a>]) -> HashSet<&'a str> {
    let mut folders: HashMap<&str, (usize, usize, Timestamp)> = HashMap::new();
    for of in arrivals.iter().filter(|of| !of.is_after_arrival() && !of.is_supported()) {
        let (recordings, back, latest) = folders.entry(of.folder).or_insert((0, 0, of.started_at));
        *recordings += 1;
        *back += usize::from(of.started_at < *latest);
        *latest = of.started_at;
    }
    let is_ordered = |(recordings, back): (usize, usize)| back <= STEPS_BACK.max(recordings / 20);
    let ordered = folders.into_iter().filter(|(_, (recordings, back, _))| is_ordered((*recordings, *back)));
    ordered.map(|(folder, _)| folder).collect()
}

/// Marks recordings with the same start, which count in the order of arrival.
fn same_starts(arrivals: &[Arrival<'_>], found: &mut [Option<ImplausibleDate>]) {
    let mut by_start: BTreeMap<Timestamp, Vec<usize>> = BTreeMap::new();
    for (at, of) in arrivals.iter().enumerate().filter(|(_, of)| !of.is_confirmed) {
        by_start.entry(of.started_at).or_default().push(at);
    }
    for (started_at, same) in by_start {
        let is_full_hour = started_at.as_second() % 3600 == 0;
        let fewest = if is_full_hour { SAME_FULL_HOUR } else { SAME_START };
        if same.len() < fewest {
            continue;
        }
        let problem = DateProblem::SameStart(same.len() - 1);
        for at in same {
            found[at].get_or_insert(ImplausibleDate { started_at, problem, is_in_order: true });
        }
    }
}

#[cfg(test)]
mod tests;
