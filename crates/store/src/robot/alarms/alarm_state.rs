//! States and events of an alarm, and its next state after a conclusion. Pure: the clock is an argument.

use jiff::Timestamp;

use armwatch_model::anomaly::Severity;

armwatch_model::named_enum! {
    /// State of an anomaly.
    #[derive(Debug, Clone, Copy, PartialEq, Eq)]
    pub enum AlarmState {
        /// No one has acknowledged it.
        Open = "open",
        /// A person has acknowledged it.
        Acknowledged = "acknowledged",
        /// Silent until a time, or until its severity rises.
        Shelved = "shelved",
        /// Maintenance was done at its place, and no run since then has shown if it is gone.
        Maintenance = "maintenance",
        /// It ended, or a person reports that its cause is gone.
        Resolved = "resolved",
        /// A person reports that nothing was wrong.
        FalseAlarm = "false_alarm",
    }
}

armwatch_model::serialize_by_name!(AlarmState, EventKind);

impl AlarmState {
    /// True if no one has to act.
    pub fn is_closed(self) -> bool {
        matches!(self, Self::Resolved | Self::FalseAlarm)
    }
}

armwatch_model::named_enum! {
    /// Kind of an event of an anomaly.
    #[derive(Debug, Clone, Copy, PartialEq, Eq)]
    pub enum EventKind {
        /// It was found.
        Opened = "opened",
        /// Its severity rose, or its score by half.
        Worse = "worse",
        /// A conclusion from more of the history gave it another kind.
        Corrected = "corrected",
        /// Later runs no longer show it.
        Ended = "ended",
        /// It is open again.
        Reopened = "reopened",
        /// A conclusion from more of the history no longer contains it.
        Withdrawn = "withdrawn",
        /// No one has answered it for too long.
        Overdue = "overdue",
        /// A person acknowledged it.
        Acknowledged = "acknowledged",
        /// A person silenced it for a time.
        Shelved = "shelved",
        /// Its shelving ended, or the severity rose.
        Unshelved = "unshelved",
        /// Maintenance at its place was entered.
        Maintenance = "maintenance",
        /// A person reports that its cause is gone.
        Resolved = "resolved",
        /// A person reports that nothing was wrong.
        FalseAlarm = "false_alarm",
        /// A person commented on it; its state stays.
        Commented = "commented",
        /// It was assigned to another person, or to no one.
        Assigned = "assigned",
    }
}

impl EventKind {
    /// True if someone should look.
    pub fn calls(self) -> bool {
        matches!(self, Self::Opened | Self::Reopened | Self::Worse | Self::Overdue | Self::Unshelved)
    }

    /// True if no one has to look any more.
    pub fn closes(self) -> bool {
        matches!(self, Self::Ended | Self::Withdrawn | Self::Resolved | Self::FalseAlarm)
    }
}

/// Ratio of the score to the last announced one that causes another announcement. Half as much again exceeds the
/// scatter of a smoothed score. Steps that grow by a factor keep the number of messages about slow wear small: from a
/// limit of 5 % the messages are sent at 7.5, 11 and 17 %.
const WORSE_BY: f64 = 1.5;

/// Largest announced severity and score of an anomaly since it was last opened.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::robot) struct Announcement {
    pub(in crate::robot) severity: Severity,
    /// Magnitude of the score; `None` if it has none.
    pub(in crate::robot) score: Option<f64>,
}

impl Announcement {
    /// Includes a later announcement.
    pub(in crate::robot) fn and(&mut self, later: Self) {
        self.severity = self.severity.max(later.severity);
        self.score = match (self.score, later.score) {
            (Some(before), Some(later)) => Some(before.max(later)),
            (before, later) => before.or(later),
        };
    }

    /// True if `now` is so much worse that it has to be announced.
    fn is_surpassed(self, now: Self) -> bool {
        now.severity > self.severity
            || matches!((self.score, now.score), (Some(told), Some(now)) if told > 0.0 && now >= WORSE_BY * told)
    }
}

/// Stored state of an alarm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::robot) struct Life {
    pub(in crate::robot) state: AlarmState,
    /// End of its shelving, or of a planned maintenance window.
    pub(in crate::robot) shelved_until: Option<Timestamp>,
    /// Start of the latest run that showed it when a person resolved it.
    pub(in crate::robot) resolved_seen_at: Option<Timestamp>,
}

impl Life {
    /// A state without further data.
    pub(in crate::robot) fn of(state: AlarmState) -> Self {
        Self { state, shelved_until: None, resolved_seen_at: None }
    }
}

/// An alarm before a conclusion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::robot) struct Before {
    pub(in crate::robot) life: Life,
    pub(in crate::robot) withdrawn: bool,
    /// Since it was last opened; `None` if it was never announced.
    pub(super) told: Option<Announcement>,
    /// Severity when it was last shelved.
    pub(super) shelved_severity: Option<Severity>,
}

/// An alarm as the history shows it now.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::robot) struct Now {
    pub(in crate::robot) shown: Announcement,
    pub(in crate::robot) ended: bool,
    pub(in crate::robot) last_seen_at: Timestamp,
    /// True if it has another kind than before.
    pub(in crate::robot) corrected: bool,
    /// True if that kind is another fault, so that an earlier answer of a person does not close it.
    pub(in crate::robot) is_another_fault: bool,
}

/// Next state of an alarm, and its events; no events if the history shows the same as before.
pub(in crate::robot) fn go_on(before: &Before, now: &Now, clock: Timestamp) -> (Life, Vec<EventKind>) {
    use AlarmState::{FalseAlarm, Open, Resolved, Shelved};
    let mut events = Vec::new();
    if now.corrected {
        events.push(EventKind::Corrected);
    }
    let again = if before.told.is_some() { EventKind::Reopened } else { EventKind::Opened };
    let life = before.life;
    let is_seen_later = life.resolved_seen_at.is_none_or(|seen| now.last_seen_at > seen);
    let next = match (life.state, now.ended) {
        (FalseAlarm, false) if now.is_another_fault => Life::of(Open),
        (FalseAlarm, _) | (Resolved, true) => life,
        (_, true) => {
            events.push(EventKind::Ended);
            Life::of(Resolved)
        }
        (Resolved, false) if is_seen_later || now.is_another_fault => Life::of(Open),
        (Shelved, false) => {
            let is_over = life.shelved_until.is_none_or(|until| until <= clock);
            if is_over || before.shelved_severity.is_some_and(|then| now.shown.severity > then) {
                events.push(EventKind::Unshelved);
                Life::of(Open)
            } else {
                life
            }
        }
        (_, false) => life,
    };
    let returns = before.withdrawn && !next.state.is_closed();
    if returns || (life.state.is_closed() && next.state == Open) {
        events.push(again);
    } else if matches!(next.state, Open | AlarmState::Acknowledged)
        && before.told.is_some_and(|told| told.is_surpassed(now.shown))
    {
        events.push(EventKind::Worse);
    }
    (next, events)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(second: i64) -> Timestamp {
        Timestamp::from_second(second).expect("a time")
    }

    fn shown(severity: Severity, score: f64) -> Announcement {
        Announcement { severity, score: Some(score) }
    }

    fn before(state: AlarmState) -> Before {
        let told = Some(shown(Severity::Warning, 0.06));
        Before { life: Life::of(state), withdrawn: false, told, shelved_severity: None }
    }

    fn now(severity: Severity, score: f64) -> Now {
        Now {
            shown: shown(severity, score),
            ended: false,
            last_seen_at: at(100),
            corrected: false,
            is_another_fault: false,
        }
    }

    #[test]
    fn a_history_that_says_the_same_makes_no_event_in_any_state() {
        for state in AlarmState::ALL {
            let mut known = before(state);
            known.life.shelved_until = (state == AlarmState::Shelved).then(|| at(1000));
            known.life.resolved_seen_at = (state == AlarmState::Resolved).then(|| at(100));
            let (life, events) = go_on(&known, &now(Severity::Warning, 0.07), at(500));
            assert_eq!((life, events), (known.life, vec![]), "{state:?}");
        }
    }

    #[test]
    fn what_gets_worse_is_told_once_a_step_and_only_where_somebody_listens() {
        let known = before(AlarmState::Acknowledged);
        let events = |now: Now| go_on(&known, &now, at(0)).1;
        assert_eq!(events(now(Severity::Warning, 0.089)), []);
        assert_eq!(events(now(Severity::Warning, 0.09)), [EventKind::Worse]);
        assert_eq!(events(now(Severity::Critical, 0.06)), [EventKind::Worse]);
        let (life, events) = go_on(&before(AlarmState::Maintenance), &now(Severity::Critical, 9.0), at(0));
        assert_eq!((life.state, events), (AlarmState::Maintenance, vec![]));
    }

    #[test]
    fn shelving_ends_with_its_time_or_a_step_of_severity() {
        let mut known = before(AlarmState::Shelved);
        known.life.shelved_until = Some(at(50));
        known.shelved_severity = Some(Severity::Warning);
        let (life, events) = go_on(&known, &now(Severity::Warning, 0.5), at(49));
        assert_eq!((life.state, events), (AlarmState::Shelved, vec![]), "a larger score is no step");
        let (life, events) = go_on(&known, &now(Severity::Warning, 0.06), at(50));
        assert_eq!((life, events), (Life::of(AlarmState::Open), vec![EventKind::Unshelved]));
        let (life, events) = go_on(&known, &now(Severity::Critical, 0.06), at(0));
        assert_eq!((life.state, events), (AlarmState::Open, vec![EventKind::Unshelved, EventKind::Worse]));
    }

    #[test]
    fn what_a_person_resolved_opens_with_a_later_run_and_what_ended_with_any() {
        let mut known = before(AlarmState::Resolved);
        assert_eq!(go_on(&known, &now(Severity::Warning, 0.06), at(0)).1, [EventKind::Reopened]);
        known.life.resolved_seen_at = Some(at(100));
        assert_eq!(go_on(&known, &now(Severity::Critical, 0.2), at(0)), (known.life, vec![]));
        let later = Now { last_seen_at: at(101), ..now(Severity::Warning, 0.06) };
        assert_eq!(go_on(&known, &later, at(0)), (Life::of(AlarmState::Open), vec![EventKind::Reopened]));
        let untold = Before { told: None, ..before(AlarmState::Resolved) };
        assert_eq!(go_on(&untold, &later, at(0)).1, [EventKind::Opened], "an ended one was no news");
    }

    #[test]
    fn a_false_alarm_stays_closed_until_it_is_another_fault() {
        let known = before(AlarmState::FalseAlarm);
        for ended in [false, true] {
            let found = Now { ended, last_seen_at: at(900), corrected: true, ..now(Severity::Critical, 2.0) };
            assert_eq!(go_on(&known, &found, at(0)), (known.life, vec![EventKind::Corrected]), "{ended}");
        }
        let other = Now { corrected: true, is_another_fault: true, ..now(Severity::Critical, 2.0) };
        let (life, events) = go_on(&known, &other, at(0));
        assert_eq!((life.state, events), (AlarmState::Open, vec![EventKind::Corrected, EventKind::Reopened]));
    }

    #[test]
    fn what_was_withdrawn_comes_back_as_people_had_left_it() {
        let known = Before { withdrawn: true, ..before(AlarmState::Acknowledged) };
        let (life, events) = go_on(&known, &now(Severity::Critical, 0.06), at(0));
        assert_eq!((life.state, events), (AlarmState::Acknowledged, vec![EventKind::Reopened]));
        let closed = Before { withdrawn: true, ..before(AlarmState::FalseAlarm) };
        assert_eq!(go_on(&closed, &now(Severity::Warning, 0.06), at(0)).1, []);
    }

    #[test]
    fn an_end_resolves_whatever_people_had_said() {
        use AlarmState::{Acknowledged, Maintenance, Open, Shelved};
        for state in [Open, Acknowledged, Shelved, Maintenance] {
            let ended = Now { ended: true, ..now(Severity::Warning, 0.06) };
            let (life, events) = go_on(&before(state), &ended, at(0));
            assert_eq!((life.state, events), (AlarmState::Resolved, vec![EventKind::Ended]), "{state:?}");
        }
    }
}
