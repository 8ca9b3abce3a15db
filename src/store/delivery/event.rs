//! What happens to an anomaly, as far as somebody is told of it.

/// An event of which people are told.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum EventKind {
    /// It was found.
    Opened,
    /// It got worse by a step.
    Worse,
    /// It shows again.
    Reopened,
    /// Nobody answered for too long.
    Overdue,
    /// The time for which it was shelved is over.
    Unshelved,
    /// Later runs no longer show it.
    Ended,
    /// The whole history has it no longer.
    Withdrawn,
    /// A person says that it is mended.
    Resolved,
    /// A person says that it was none.
    FalseAlarm,
}

impl EventKind {
    const ALL: [Self; 9] = [
        Self::Opened,
        Self::Worse,
        Self::Reopened,
        Self::Overdue,
        Self::Unshelved,
        Self::Ended,
        Self::Withdrawn,
        Self::Resolved,
        Self::FalseAlarm,
    ];

    /// Name as stored.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Opened => "opened",
            Self::Worse => "worse",
            Self::Reopened => "reopened",
            Self::Overdue => "overdue",
            Self::Unshelved => "unshelved",
            Self::Ended => "ended",
            Self::Withdrawn => "withdrawn",
            Self::Resolved => "resolved",
            Self::FalseAlarm => "false_alarm",
        }
    }

    /// Whether it ends the alarm for its receiver.
    #[must_use]
    pub fn closes(self) -> bool {
        matches!(self, Self::Ended | Self::Withdrawn | Self::Resolved | Self::FalseAlarm)
    }

    /// The kind of that name; `None` for an event of which nobody is told, such as that a person has acknowledged.
    pub(super) fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.name() == name)
    }
}

/// Kinds of events that say that there is something to see, as a list of SQL.
pub(super) const SPEAKING: &str = "('opened', 'worse', 'reopened', 'overdue', 'unshelved')";

/// All kinds of events of which somebody is told, as a list of SQL.
pub(super) const TOLD: &str =
    "('opened', 'worse', 'reopened', 'overdue', 'unshelved', 'ended', 'withdrawn', 'resolved', 'false_alarm')";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_lists_of_sql_are_those_of_the_kinds() {
        let list = |kinds: &mut dyn Iterator<Item = EventKind>| {
            let names: Vec<String> = kinds.map(|kind| format!("'{}'", kind.name())).collect();
            format!("({})", names.join(", "))
        };
        assert_eq!(list(&mut EventKind::ALL.into_iter().filter(|kind| !kind.closes())), SPEAKING);
        assert_eq!(list(&mut EventKind::ALL.into_iter()), TOLD);
        assert!(EventKind::ALL.iter().all(|kind| EventKind::from_name(kind.name()) == Some(*kind)));
        assert_eq!(EventKind::from_name("acknowledged"), None);
    }
}
