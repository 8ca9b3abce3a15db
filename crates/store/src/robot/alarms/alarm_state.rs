//! The states of an alarm, what happens to it, and how its state goes on when the history is judged again. Pure: the
//! clock is an argument.

use jiff::Timestamp;

use armwatch_model::anomaly::Severity;

/// Where an anomaly stands for people.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AlarmState {
    /// Nobody has looked at it.
    Open,
    /// A person knows of it.
    Acknowledged,
    /// Quiet until a time, or until it gets worse.
    Shelved,
    /// Its place was worked on, and no run has shown since then whether it is gone.
    Maintenance,
    /// It ended, or a person says that its cause is gone.
    Resolved,
    /// A person says that nothing was wrong.
    FalseAlarm,
}

armwatch_model::serialize_by_name!(AlarmState, EventKind);

impl AlarmState {
    /// All of them.
    pub const ALL: [Self; 6] =
        [Self::Open, Self::Acknowledged, Self::Shelved, Self::Maintenance, Self::Resolved, Self::FalseAlarm];

    /// Name as in the view `anomalies`.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Open => "open",
            Self::Acknowledged => "acknowledged",
            Self::Shelved => "shelved",
            Self::Maintenance => "maintenance",
            Self::Resolved => "resolved",
            Self::FalseAlarm => "false_alarm",
        }
    }

    /// Whether nobody has to do anything about it.
    #[must_use]
    pub fn is_closed(self) -> bool {
        matches!(self, Self::Resolved | Self::FalseAlarm)
    }
}

/// What can happen to an anomaly.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum EventKind {
    /// It was found.
    Opened,
    /// Its severity rose, or its score by half.
    Worse,
    /// More of the history gave it another kind.
    Corrected,
    /// Later runs no longer show it.
    Ended,
    /// It is open again.
    Reopened,
    /// More of the history has taken it back.
    Withdrawn,
    /// Nobody has answered it for too long.
    Overdue,
    /// A person knows of it.
    Acknowledged,
    /// A person wants to hear nothing of it for a time.
    Shelved,
    /// That time is over, or the severity rose.
    Unshelved,
    /// Work on its place was entered.
    Maintenance,
    /// A person says that its cause is gone.
    Resolved,
    /// A person says that nothing was wrong.
    FalseAlarm,
    /// A person wrote something about it, which changes nothing.
    Commented,
    /// It is in the hands of another person, or of none.
    Assigned,
}

impl EventKind {
    /// All of them.
    pub const ALL: [Self; 15] = [
        Self::Opened,
        Self::Worse,
        Self::Corrected,
        Self::Ended,
        Self::Reopened,
        Self::Withdrawn,
        Self::Overdue,
        Self::Acknowledged,
        Self::Shelved,
        Self::Unshelved,
        Self::Maintenance,
        Self::Resolved,
        Self::FalseAlarm,
        Self::Commented,
        Self::Assigned,
    ];

    /// Name as in the view `anomaly_history`.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Opened => "opened",
            Self::Worse => "worse",
            Self::Corrected => "corrected",
            Self::Ended => "ended",
            Self::Reopened => "reopened",
            Self::Withdrawn => "withdrawn",
            Self::Overdue => "overdue",
            Self::Acknowledged => "acknowledged",
            Self::Shelved => "shelved",
            Self::Unshelved => "unshelved",
            Self::Maintenance => "maintenance",
            Self::Resolved => "resolved",
            Self::FalseAlarm => "false_alarm",
            Self::Commented => "commented",
            Self::Assigned => "assigned",
        }
    }

    /// Whether it says that somebody should look.
    #[must_use]
    pub fn calls(self) -> bool {
        matches!(self, Self::Opened | Self::Reopened | Self::Worse | Self::Overdue | Self::Unshelved)
    }

    /// Whether nobody has to look any more.
    #[must_use]
    pub fn closes(self) -> bool {
        matches!(self, Self::Ended | Self::Withdrawn | Self::Resolved | Self::FalseAlarm)
    }
}

/// An alarm is told again when its score is so many times the one told last. Half as much again is beyond the scatter
/// of a smoothed score, and steps that grow so keep the number of messages of a slow wear small: from a limit of 5 %
/// they come at 7.5, 11 and 17 %.
const WORSE_BY: f64 = 1.5;

/// What people were told of an anomaly since it was opened last.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::robot) struct Announcement {
    pub(in crate::robot) severity: Severity,
    /// Magnitude of the score; `None` without any.
    pub(in crate::robot) score: Option<f64>,
}

impl Announcement {
    /// Takes what was told later into account.
    pub(in crate::robot) fn and(&mut self, later: Self) {
        self.severity = self.severity.max(later.severity);
        self.score = match (self.score, later.score) {
            (Some(before), Some(later)) => Some(before.max(later)),
            (before, later) => before.or(later),
        };
    }

    /// Whether `now` is worse by so much that it is told.
    fn is_surpassed(self, now: Self) -> bool {
        now.severity > self.severity
            || matches!((self.score, now.score), (Some(told), Some(now)) if told > 0.0 && now >= WORSE_BY * told)
    }
}

/// What is stored of an alarm's life.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::robot) struct Life {
    pub(in crate::robot) state: AlarmState,
    /// Until when it is shelved, or held by a maintenance window.
    pub(in crate::robot) shelved_until: Option<Timestamp>,
    /// Start of the latest run that showed it when a person resolved it.
    pub(in crate::robot) resolved_seen_at: Option<Timestamp>,
}

impl Life {
    /// A state without more to know of it.
    pub(in crate::robot) fn of(state: AlarmState) -> Self {
        Self { state, shelved_until: None, resolved_seen_at: None }
    }
}

/// An alarm before the history is judged again.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::robot) struct Before {
    pub(in crate::robot) life: Life,
    pub(in crate::robot) withdrawn: bool,
    /// Since it was opened last; `None` if nobody was told of it.
    pub(super) told: Option<Announcement>,
    /// Severity when it was shelved last.
    pub(super) shelved_severity: Option<Severity>,
}

/// What the history says of it now.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::robot) struct Now {
    pub(in crate::robot) shown: Announcement,
    pub(in crate::robot) ended: bool,
    pub(in crate::robot) last_seen_at: Timestamp,
    /// Whether it has another kind than before.
    pub(in crate::robot) corrected: bool,
    /// Whether that kind is another fault, so that what people said of the first does not close it.
    pub(in crate::robot) is_another_fault: bool,
}

/// How an alarm goes on, and what has happened to it: nothing, where the history says what it said before.
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
