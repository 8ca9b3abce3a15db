//! Events of an anomaly that are announced.

use crate::robot::alarms::alarm_state::EventKind;

/// Kinds of events that call for attention, as a list of SQL.
pub(super) const SPEAKING: &str = "('opened', 'worse', 'reopened', 'overdue', 'unshelved')";

/// All kinds of events that are announced, as a list of SQL.
pub(super) const TOLD: &str = "('opened', 'worse', 'ended', 'reopened', 'withdrawn', 'overdue', 'unshelved', 'resolved', 'false_alarm')";

/// The kind of that name; `None` for an event that is never announced, such as an acknowledgement.
pub(super) fn told(name: &str) -> Option<EventKind> {
    let told = |kind: &EventKind| kind.calls() || kind.closes();
    EventKind::ALL.into_iter().filter(told).find(|kind| kind.name() == name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_lists_of_sql_are_those_of_the_kinds() {
        let names = |list: &str| -> Vec<String> {
            let mut names: Vec<String> = list.split('\'').skip(1).step_by(2).map(str::to_owned).collect();
            names.sort_unstable();
            names
        };
        let kinds = |chosen: fn(&EventKind) -> bool| -> Vec<String> {
            let mut names: Vec<String> =
                EventKind::ALL.into_iter().filter(chosen).map(|kind| kind.name().to_owned()).collect();
            names.sort_unstable();
            names
        };
        assert_eq!(names(SPEAKING), kinds(|kind| kind.calls()));
        assert_eq!(names(TOLD), kinds(|kind| kind.calls() || kind.closes()));
        assert_eq!((told("worse"), told("acknowledged")), (Some(EventKind::Worse), None));
    }
}
