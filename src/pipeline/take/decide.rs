//! Decides how to treat an export from the known facts. It has no side effects, so a command that only inspects exports
//! decides like the commands that store them.

use crate::pipeline::context::Retry;
use armwatch_config::RewritePolicy;
use armwatch_ingest::bytes::fingerprint;
use armwatch_model::run::{ContentPrefix, RunStatus};
use armwatch_store::KnownRun;

/// An earlier run, compared with the file under decision.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Compared {
    /// The run.
    pub run: KnownRun,
    /// First bytes of the file that its stored cycles were read from.
    pub read: ContentPrefix,
    /// True if the file begins with these bytes.
    pub begins_alike: bool,
    /// True if the run was read from the same path.
    pub same_path: bool,
    /// True if the run was read from a file with the same number (inode). The file system reuses the numbers of deleted
    /// files.
    pub same_file: bool,
    /// True if the file's name gives the run's robot.
    pub same_robot: bool,
    /// True if both names give the same robot and time, and the configuration assigns the same kind of recording to
    /// both.
    pub same_recording: bool,
}

/// The known facts about an export when it is decided on.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Facts {
    /// The run with exactly this content; `None` too for a file that still grows.
    pub known: Option<KnownRun>,
    /// True if an export of that run is being read now.
    pub known_is_open: bool,
    /// The run of this very file, if another program reads it now.
    pub read_elsewhere: Option<i64>,
    /// True if the file's name gives the robot and the time of the recording.
    pub names_recording: bool,
    /// Earlier runs: the run of the file's path first, then the newest.
    pub earlier: Vec<Compared>,
    /// The policy for a run whose recording arrives again.
    pub on_rewrite: RewritePolicy,
    /// Selects the decided exports that are read again.
    pub retry: Retry,
}

impl Facts {
    /// Adjusts the facts for a file that was cut, if `is_cut`: its rows continue the earlier run and do not replace it.
    #[must_use]
    pub fn of_cut_file(self, is_cut: bool) -> Self {
        let on_rewrite = if is_cut { RewritePolicy::KeepBoth } else { self.on_rewrite };
        Self { on_rewrite, ..self }
    }

    /// The complete run that contains everything of the file, which has this size in bytes.
    #[must_use]
    pub fn stored_whole(&self, bytes: u64) -> Option<i64> {
        let is_whole = |of: &Compared| {
            let is_here = of.same_path || of.same_file;
            is_here && of.run.status == RunStatus::Complete && of.begins_alike && of.read.bytes == bytes
        };
        self.earlier.iter().find(|of| is_whole(of)).map(|of| of.run.run_id)
    }
}

/// How an export is treated.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Decision {
    /// Nothing is done: a run has its content.
    Known {
        /// The run.
        run: KnownRun,
        /// An unfinished run that must not continue, because another run has this file's content.
        unfinished: Option<Unfinished>,
    },
    /// Nothing is done now: the content is being read under another name, or another program reads the file.
    InWork {
        /// The run that the export becomes.
        run_id: i64,
    },
    /// The export is read.
    Read(Start),
}

/// How the run of a file starts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Start {
    /// The run to continue; `None` starts a new one.
    pub continues: Option<i64>,
    /// The run that this one supersedes.
    pub replaces: Option<i64>,
    /// First bytes of the file that the stored cycles were read from.
    pub read: ContentPrefix,
    /// True if the stored part is read again.
    pub afresh: bool,
    /// An unfinished run of this file, which the continued run makes superfluous.
    pub merges: Option<i64>,
}

/// An unfinished run of a file whose content is stored as another run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Unfinished {
    /// Its cycles come from the first bytes of this file.
    Prefix(i64),
    /// This file overwrote the content that the run was read from.
    Rewritten(i64),
}

/// Decides how to treat an export.
pub fn decide(facts: &Facts) -> Decision {
    let chosen = chosen(&facts.earlier, facts.on_rewrite);
    if let Some(known) = &facts.known {
        let as_this_recording = |of: &Compared| of.run.run_id == known.run_id && of.same_recording;
        let renamed = facts.names_recording && !facts.earlier.iter().any(as_this_recording);
        // a superseded content has returned to its path, or this or a renamed file now counts as another recording
        let returns = match known.status {
            RunStatus::Superseded => chosen.replaces_here || renamed,
            RunStatus::SetAside => renamed,
            RunStatus::Complete | RunStatus::Quarantined | RunStatus::Streaming => false,
        };
        if !returns && is_decided(known, facts.retry) {
            let unfinished = chosen.unfinished.filter(|unfinished| unfinished.run_id() != known.run_id);
            return Decision::Known { run: known.clone(), unfinished };
        }
        if !returns && facts.known_is_open {
            return Decision::InWork { run_id: known.run_id };
        }
    }
    if let Some(run_id) = facts.read_elsewhere {
        return Decision::InWork { run_id };
    }
    let continues = facts.known.as_ref().map(|known| known.run_id).or(chosen.start.continues);
    let replaces = chosen.start.replaces.filter(|old| Some(*old) != continues);
    let afresh = facts.known.is_some() && facts.retry == Retry::Complete;
    let merges = match chosen.unfinished {
        Some(Unfinished::Prefix(own)) if Some(own) != continues => Some(own),
        _ => None,
    };
    Decision::Read(Start { continues, replaces, afresh, merges, ..chosen.start })
}

/// Returns true if the treatment of a known export is final, so that it is not read.
pub fn is_decided(known: &KnownRun, retry: Retry) -> bool {
    match known.status {
        RunStatus::Complete => retry != Retry::Complete,
        RunStatus::Superseded | RunStatus::SetAside => true,
        RunStatus::Quarantined => retry == Retry::Never && !known.retry_asked,
        RunStatus::Streaming => false,
    }
}

impl Unfinished {
    fn run_id(self) -> i64 {
        let (Self::Prefix(run_id) | Self::Rewritten(run_id)) = self;
        run_id
    }
}

/// The choice among earlier runs.
struct ChosenRun {
    start: Start,
    /// True if the superseded run was read from this path.
    replaces_here: bool,
    unfinished: Option<Unfinished>,
}

/// Chooses among earlier runs.
///
/// Only the same recording supersedes a run; an unfinished run is superseded only at its own path. A file whose name
/// gives no time, such as `current.csv`, contains one recording after another; such a file supersedes only an
/// unfinished run that was read from the very file that was overwritten. A file number counts only together with the
/// robot.
fn chosen(earlier: &[Compared], policy: RewritePolicy) -> ChosenRun {
    let start =
        Start { continues: None, replaces: None, read: fingerprint::nothing(), afresh: false, merges: None };
    let mut chosen = ChosenRun { start, replaces_here: false, unfinished: None };
    for Compared { run, read, begins_alike, same_path, same_file, same_robot, same_recording } in earlier {
        let (unfinished, complete) = (run.status == RunStatus::Streaming, run.status == RunStatus::Complete);
        let moved_here = *same_file && *same_robot;
        let here = *same_path || moved_here;
        // no stored data could be wrong
        let empty = *same_path && *same_file && unfinished && run.cycles_stored == 0;
        // every file may begin with the same header
        let faulty = run.status == RunStatus::Quarantined && (*same_path || run.cycles_stored > 0);
        // a complete run keeps its state if the recording appears in another file
        let goes_on = (*same_path || *same_robot) && (unfinished || (complete && here) || faulty);
        // every file begins with no bytes
        let begins_alike = *begins_alike && (read.bytes > 0 || here);
        let rewritten = match run.status {
            RunStatus::Streaming => (*same_recording && *same_path) || moved_here,
            RunStatus::Complete => *same_recording && policy == RewritePolicy::Supersede,
            RunStatus::Quarantined | RunStatus::Superseded | RunStatus::SetAside => false,
        };
        if chosen.start.continues.is_none() && goes_on && (begins_alike || empty) {
            chosen.start.continues = Some(run.run_id);
            if begins_alike && run.cycles_stored > 0 {
                chosen.start.read = *read;
            }
            chosen.unfinished = unfinished.then_some(Unfinished::Prefix(run.run_id));
        } else if chosen.start.replaces.is_none() && rewritten {
            chosen.start.replaces = Some(run.run_id);
            chosen.replaces_here = *same_path;
            if unfinished && chosen.unfinished.is_none() {
                chosen.unfinished = Some(Unfinished::Rewritten(run.run_id));
            }
        }
    }
    chosen
}

#[cfg(test)]
mod tests {
    use super::*;
    use armwatch_model::run::ContentHash;

    const READ: ContentPrefix = ContentPrefix { bytes: 9, hash: ContentHash([9; 32]) };

    fn known(run_id: i64, status: RunStatus) -> KnownRun {
        KnownRun { run_id, status, reason: None, cycles_stored: 2, retry_asked: false }
    }

    /// A run with two stored cycles, of another recording of this robot at another path; `of` lists the other facts.
    fn earlier(run_id: i64, status: RunStatus, of: &str) -> Compared {
        let is = |word| of.split(' ').any(|found| found == word);
        Compared {
            run: KnownRun { cycles_stored: if is("empty") { 0 } else { 2 }, ..known(run_id, status) },
            read: if is("empty") { fingerprint::nothing() } else { READ },
            begins_alike: is("alike") || is("empty"),
            same_path: is("path"),
            same_file: is("file"),
            same_robot: !is("other_robot"),
            same_recording: is("recording"),
        }
    }

    fn facts(known: Option<KnownRun>, earlier: Vec<Compared>) -> Facts {
        Facts {
            known,
            known_is_open: false,
            read_elsewhere: None,
            names_recording: true,
            earlier,
            on_rewrite: RewritePolicy::Supersede,
            retry: Retry::Never,
        }
    }

    fn reads(continues: Option<i64>, replaces: Option<i64>, read: ContentPrefix) -> Decision {
        Decision::Read(Start { continues, replaces, read, afresh: false, merges: None })
    }

    #[test]
    fn one_earlier_run_and_a_content_that_is_not_stored() {
        use RunStatus::{Complete, Quarantined, Streaming, Superseded};
        let none = fingerprint::nothing();
        for (status, of, continues, replaces) in [
            // the beginning of this file is stored: the run continues
            (Streaming, "path file alike", Some(1), None),
            (Streaming, "path file alike recording", Some(1), None),
            (Complete, "path file alike recording", Some(1), None),
            (Complete, "file alike", Some(1), None),
            (Quarantined, "path file alike recording", Some(1), None),
            (Quarantined, "alike", Some(1), None),
            (Superseded, "path file alike recording", None, None),
            // a longer file at another path is another file; a file that continues an interrupted read is the same
            (Complete, "alike recording", None, Some(1)),
            (Streaming, "alike recording", Some(1), None),
            // overwritten: only the same recording supersedes the run
            (Complete, "path file recording", None, Some(1)),
            (Complete, "path file", None, None),
            (Complete, "recording", None, Some(1)),
            (Complete, "", None, None),
            (Streaming, "path recording", None, Some(1)),
            (Streaming, "recording", None, None),
            (Streaming, "path", None, None),
            (Streaming, "path file", None, Some(1)),
            (Quarantined, "recording", None, None),
            // no cycle is stored
            (Streaming, "path file empty", Some(1), None),
            (Streaming, "path empty", Some(1), None),
            (Streaming, "file empty", Some(1), None),
            (Streaming, "recording empty", None, None),
            // the number of a deleted file was reused for another robot's file
            (Streaming, "file other_robot", None, None),
            (Streaming, "file empty other_robot", None, None),
            (Streaming, "file alike other_robot", None, None),
            (Complete, "file alike other_robot", None, None),
        ] {
            let earlier = earlier(1, status, of);
            let read = if continues.is_some() && !of.contains("empty") { READ } else { none };
            let decision = decide(&facts(None, vec![earlier]));
            assert_eq!(decision, reads(continues, replaces, read), "{status:?} {of}");
        }
    }

    #[test]
    fn both_stand_where_the_configuration_says_so() {
        let keeps = |of| Facts {
            on_rewrite: RewritePolicy::KeepBoth,
            ..facts(None, vec![earlier(1, RunStatus::Complete, of)])
        };
        for of in ["path file recording", "recording"] {
            assert_eq!(decide(&keeps(of)), reads(None, None, fingerprint::nothing()), "{of}");
        }
    }

    #[test]
    fn a_file_that_was_renamed_while_its_old_name_has_got_another() {
        let runs =
            |of| vec![earlier(2, RunStatus::Complete, of), earlier(1, RunStatus::Streaming, "file alike")];
        assert_eq!(decide(&facts(None, runs("path"))), reads(Some(1), None, READ));
        assert_eq!(decide(&facts(None, runs("path recording"))), reads(Some(1), Some(2), READ));
    }

    #[test]
    fn a_content_that_has_its_run() {
        use RunStatus::{Complete, Quarantined, Streaming, Superseded};
        let none = fingerprint::nothing();
        let stands = |run: KnownRun, unfinished| Decision::Known { run, unfinished };
        let of = |status, earlier| facts(Some(known(7, status)), earlier);
        for status in [Complete, Superseded, RunStatus::SetAside, Quarantined] {
            let itself = vec![earlier(7, status, "path recording")];
            assert_eq!(decide(&of(status, itself)), stands(known(7, status), None), "{status:?}");
            let without_start = Facts { names_recording: false, ..of(status, vec![]) };
            assert_eq!(decide(&without_start), stands(known(7, status), None), "{status:?}");
        }
        // a copy with another name is not another recording, unless it was superseded by one
        for status in [Complete, Quarantined] {
            assert_eq!(decide(&of(status, vec![])), stands(known(7, status), None), "{status:?}");
        }
        for status in [Superseded, RunStatus::SetAside] {
            assert_eq!(decide(&of(status, vec![])), reads(Some(7), None, none), "{status:?}");
        }
        assert_eq!(decide(&of(Streaming, vec![])), reads(Some(7), None, none));
        let again = Facts { retry: Retry::Quarantined, ..of(Quarantined, vec![]) };
        assert_eq!(decide(&again), reads(Some(7), None, none));
        // a complete run that is requested by its number is read from the start; a superseded one stays superseded
        let anew = |of: Facts| decide(&Facts { retry: Retry::Complete, ..of });
        let start = Start { continues: Some(7), replaces: None, read: none, afresh: true, merges: None };
        for status in [Complete, Quarantined] {
            assert_eq!(anew(of(status, vec![])), Decision::Read(start), "{status:?}");
            let itself = vec![earlier(7, status, "path file alike recording")];
            let Decision::Read(found) = anew(of(status, itself)) else { panic!("{status:?}") };
            assert_eq!((found.continues, found.replaces, found.afresh), (Some(7), None, true), "{status:?}");
        }
        let lost = vec![earlier(7, Superseded, "path recording")];
        assert_eq!(anew(of(Superseded, lost)), stands(known(7, Superseded), None));
        let asked = KnownRun { retry_asked: true, ..known(7, Quarantined) };
        assert_eq!(decide(&facts(Some(asked), vec![])), reads(Some(7), None, none));
        let open = Facts { known_is_open: true, ..of(Streaming, vec![]) };
        assert_eq!(decide(&open), Decision::InWork { run_id: 7 });
        // another program continues the run of this file; no run has its content yet
        let elsewhere = Facts { read_elsewhere: Some(5), ..facts(None, vec![]) };
        assert_eq!(decide(&elsewhere), Decision::InWork { run_id: 5 });
        let stored = Facts { read_elsewhere: Some(5), ..of(Complete, vec![]) };
        assert_eq!(decide(&stored), stands(known(7, Complete), None));

        // a run superseded by a file at another path stays superseded, unless its content has returned to the path of
        // the run that superseded it
        let elsewhere = vec![earlier(8, Complete, "recording"), earlier(7, Superseded, "recording")];
        assert_eq!(decide(&of(Superseded, elsewhere)), stands(known(7, Superseded), None));
        let here = vec![earlier(8, Complete, "path file recording"), earlier(7, Superseded, "recording")];
        assert_eq!(decide(&of(Superseded, here)), reads(Some(7), Some(8), none));

        // the unfinished run of this content under another number is removed
        let begun = vec![earlier(9, Streaming, "path file alike")];
        assert_eq!(decide(&of(Complete, begun)), stands(known(7, Complete), Some(Unfinished::Prefix(9))));
        let other = vec![earlier(9, Streaming, "path file")];
        assert_eq!(decide(&of(Complete, other)), stands(known(7, Complete), Some(Unfinished::Rewritten(9))));
        let itself = vec![earlier(7, Streaming, "path file alike")];
        assert_eq!(decide(&of(Streaming, itself)), reads(Some(7), None, READ));
        // also when the content returns from a superseded run
        let grown = vec![earlier(9, Streaming, "path file alike")];
        let Decision::Read(found) = decide(&of(Superseded, grown)) else { panic!("not read") };
        assert_eq!((found.continues, found.merges), (Some(7), Some(9)));
    }
}
