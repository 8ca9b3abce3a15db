//! Values of labels: stages, disks, queues and ends of exports.

armwatch_model::named_enum! {
    /// Work on an export.
    #[derive(Debug, Clone, Copy, PartialEq, Eq)]
    pub enum WorkStage {
        /// Its rows are read and cut into a cycle.
        Read = "read",
        /// A cycle is analysed.
        Analyse = "analyse",
        /// A cycle is stored.
        Record = "record",
        /// The results of the whole run are computed and stored.
        Finish = "finish",
        /// The conclusions from the robot's history are drawn and stored.
        Conclude = "conclude",
    }
}

armwatch_model::named_enum! {
    /// A disk that the daemon writes to.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
    pub enum Disk {
        /// The disk of the database.
        Database = "database",
        /// The disk of the copy for readers.
        Snapshot = "snapshot",
        /// The disk of uploads.
        Spool = "spool",
    }
}

impl Disk {
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

armwatch_model::named_enum! {
    /// Queue that files wait in.
    #[derive(Debug, Clone, Copy, PartialEq, Eq)]
    pub enum Queue {
        /// Files that are read as they grow.
        Growing = "growing",
        /// Settled files that are read within seconds.
        Small = "small",
        /// Larger settled files.
        Large = "large",
    }
}

armwatch_model::named_enum! {
    /// Outcome of an export.
    #[derive(Debug, Clone, Copy, PartialEq, Eq)]
    pub enum ExportEnd {
        /// Every cycle is stored.
        Stored = "stored",
        /// Its content was known before, as stored or as not understood.
        Known = "known",
        /// It was not understood.
        Quarantined = "quarantined",
        /// It is examined again later: it changed, could not be read, or the program stops.
        Later = "later",
        /// The program failed over it.
        Failed = "failed",
    }
}
