//! Values of labels: stages, disks, queues and ends of exports.

/// Work on an export.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WorkStage {
    /// Its rows are read and cut into a cycle.
    Read,
    /// A cycle is analysed.
    Analyse,
    /// A cycle is stored.
    Record,
    /// The results of the whole run are computed and stored.
    Finish,
    /// The conclusions from the robot's history are drawn and stored.
    Conclude,
}

impl WorkStage {
    pub(super) const ALL: [Self; 5] = [Self::Read, Self::Analyse, Self::Record, Self::Finish, Self::Conclude];

    pub(super) const fn name(self) -> &'static str {
        match self {
            Self::Read => "read",
            Self::Analyse => "analyse",
            Self::Record => "record",
            Self::Finish => "finish",
            Self::Conclude => "conclude",
        }
    }
}

/// A disk that the daemon writes to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Disk {
    /// The disk of the database.
    Database,
    /// The disk of the copy for readers.
    Snapshot,
    /// The disk of uploads.
    Spool,
}

impl Disk {
    /// Its name in the metrics.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Database => "database",
            Self::Snapshot => "snapshot",
            Self::Spool => "spool",
        }
    }

    /// Its content, in messages.
    pub const fn words(self) -> &'static str {
        match self {
            Self::Database => "the database",
            Self::Snapshot => "the snapshot",
            Self::Spool => "the spool of uploads",
        }
    }

    /// The consequence while it does not answer, in messages.
    pub const fn consequence(self) -> &'static str {
        match self {
            Self::Database => "nothing is stored until it does",
            Self::Snapshot => "readers have the earlier copy until it does",
            Self::Spool => "no upload is taken until it does",
        }
    }
}

/// Queue that files wait in.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Queue {
    /// Files that are read as they grow.
    Growing,
    /// Settled files that are read within seconds.
    Small,
    /// Larger settled files.
    Large,
}

impl Queue {
    pub(super) const ALL: [Self; 3] = [Self::Growing, Self::Small, Self::Large];

    pub(super) const fn name(self) -> &'static str {
        match self {
            Self::Growing => "growing",
            Self::Small => "small",
            Self::Large => "large",
        }
    }
}

/// Outcome of an export.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ExportEnd {
    /// Every cycle is stored.
    Stored,
    /// Its content was known before, as stored or as not understood.
    Known,
    /// It was not understood.
    Quarantined,
    /// It is examined again later: it changed, could not be read, or the program stops.
    Later,
    /// The program failed over it.
    Failed,
}

impl ExportEnd {
    pub(super) const ALL: [Self; 5] =
        [Self::Stored, Self::Known, Self::Quarantined, Self::Later, Self::Failed];

    pub(super) const fn name(self) -> &'static str {
        match self {
            Self::Stored => "stored",
            Self::Known => "known",
            Self::Quarantined => "quarantined",
            Self::Later => "later",
            Self::Failed => "failed",
        }
    }
}
