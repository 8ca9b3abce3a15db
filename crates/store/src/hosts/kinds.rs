//! Kinds of programs that use a database, and kinds of their claims.

armwatch_model::named_enum! {
    /// Work that only one daemon at a time may do.
    #[derive(Debug, Clone, Copy, PartialEq, Eq)]
    pub enum ClaimKind {
        /// An export in a shared folder; its subject is the path.
        Export = "export",
        /// A run that is being read; its subject is its key.
        Run = "run",
        /// Conclusions of a robot; its subject is the name.
        Robot = "robot",
        /// A route of alarms; its subject is the name.
        Route = "route",
    }
}

/// Kind of a program that joins.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SessionKind {
    /// The one daemon of its host.
    Daemon,
    /// A command that reads exports.
    Command,
}
