use super::*;

fn origin() -> Origin {
    Origin { identity: "0a1b2c".into(), link: Some("http://armwatch.example.org".into()) }
}

fn alarm() -> Alarm {
    let now = "2026-03-01T06:00:00Z".parse().unwrap();
    let event = AlarmEvent { event_id: 7, anomaly_id: 4, ..example(Severity::Critical, now) };
    Alarm::new(event, Some("Turin"), Language::English)
}

fn message(alarms: Vec<Alarm>) -> Message {
    let key = origin().key(7);
    Message {
        key,
        route: "shift".into(),
        origin: origin(),
        is_digest: alarms.len() > 1,
        alarms,
        is_trial: false,
    }
}

#[test]
fn a_message_says_figures_onset_peak_trend_and_urgency() {
    let text = message(vec![alarm()]).text();
    for expected in [
        "critical: TEST (Turin), joint 3: drift opened",
        "  urgency: inspect before the next shift",
        "  latest test: 1.24, expected 1",
        "  smoothed over 3 tests: 1.19",
        "  out by: 24 %, alarm from 5 %",
        "  peak: 1.24, out by 24 %",
        "  odds of this cause: 900 to 1",
        "  onset: 2026-02-25 06:00:00 UTC",
        "  seen: 2026-02-26 06:00:00 UTC to 2026-03-01 06:00:00 UTC",
        "  anomaly: 4",
        "  http://armwatch.example.org/#/alarm/4",
        "key: armwatch-0a1b2c-7",
    ] {
        assert!(text.lines().any(|line| line == expected), "{expected}\nnot in\n{text}");
    }
    assert!(text.contains("  trend: +1.65 in 30 days"), "{text}");
}

#[test]
fn an_alarm_that_ended_keeps_its_peak_and_asks_for_nothing() {
    for (what, name) in [
        (EventKind::Ended, "ended"),
        (EventKind::Resolved, "resolved"),
        (EventKind::Withdrawn, "withdrawn"),
        (EventKind::FalseAlarm, "false alarm"),
    ] {
        let mut ended = alarm();
        ended.event.what = what;
        ended.event.value = Some(0.9964);
        ended.event.message = "joint 2: friction jumped by +25 % between two tests; friction at equal speed and \
                               temperature is 12 % above the joint's baseline (limit 5 %); latest test: friction index \
                               0.996; check lubrication, gearbox and brake"
            .into();
        let message = message(vec![ended]);
        assert_eq!(message.title(), format!("{name}: TEST (Turin), joint 3: drift"));
        let text = message.text();
        for expected in [
            "  was: joint 2: friction jumped by +25 % between two tests",
            "  urgency: nothing to do",
            "  latest test that shows it: 0.9964, expected 1",
            "  was out by: 24 %, alarm from 5 %",
            "  peak: 1.24, out by 24 %",
            "  seen: 2026-02-26 06:00:00 UTC to 2026-03-01 06:00:00 UTC",
        ] {
            assert!(text.lines().any(|line| line == expected), "{expected}\nnot in\n{text}");
        }
        for advice in ["check", "latest test:", "in 30 days"] {
            assert!(!text.contains(advice), "{advice} in\n{text}");
        }
        let json = message.json();
        assert_eq!(json["status"], "resolved");
        assert_eq!(json["alarms"][0]["peak_value"], 1.24);
        assert_eq!(json["alarms"][0]["message"], "was: joint 2: friction jumped by +25 % between two tests");
    }
}

#[test]
fn a_finding_ends_where_figures_and_advice_begin() {
    for (message, found) in [
        (
            "the torque signal has 2.5 times the usual noise; check sensor",
            "the torque signal has 2.5 times the usual noise",
        ),
        (
            "varies (joint 3 by 4 %; correlation +0.90); one cause is likelier",
            "varies (joint 3 by 4 %; correlation +0.90)",
        ),
        (
            "the test gave no result: the signal stands still",
            "the test gave no result: the signal stands still",
        ),
        ("", ""),
    ] {
        assert_eq!(clauses(message)[0], found);
    }
}

#[test]
fn a_limit_and_figures_that_there_are_not_are_left_out() {
    let mut offset = alarm();
    offset.event.quantity = Quantity::TorqueOffset;
    offset.event.kind = AnomalyKind::Sensor;
    (offset.event.value, offset.event.baseline) = (Some(-3.25), Some(0.0));
    (offset.event.score, offset.event.threshold) = (Some(3.25), Some(0.0));
    let text = message(vec![offset.clone()]).text();
    for expected in ["  latest test: -3.25 Nm, expected 0 Nm", "  out by: 3.25 Nm"] {
        assert!(text.lines().any(|line| line == expected), "{expected}\nnot in\n{text}");
    }
    let mut stuck = offset;
    (stuck.event.value, stuck.event.baseline, stuck.event.peak_value) = (None, None, None);
    (stuck.event.score, stuck.event.threshold) = (Some(1.0), Some(1.0));
    let text = message(vec![stuck]).text();
    assert!(!text.contains("out by") && !text.contains("latest test"), "{text}");
}

#[test]
fn a_load_is_told_in_kg_and_standard_errors_and_its_odds_in_words() {
    let mut load = alarm();
    (load.event.quantity, load.event.kind) = (Quantity::Load, AnomalyKind::Payload);
    (load.event.value, load.event.baseline) = (Some(0.7974), Some(0.0));
    (load.event.score, load.event.threshold, load.event.odds) = (Some(151.0), Some(5.0), Some(1e9));
    let text = message(vec![load]).text();
    for expected in [
        "  latest test: 0.7974 kg, expected 0 kg",
        "  out by: 151 standard errors, alarm from 5 standard errors",
        "  odds of this cause: more than a million to 1",
    ] {
        assert!(text.lines().any(|line| line == expected), "{expected}\nnot in\n{text}");
    }
}

#[test]
fn names_and_notes_make_no_line_and_stay_the_same_in_json() {
    let mut hostile = alarm();
    hostile.event.robot = "R\n\u{202e}01\u{1b}[31m".into();
    hostile.event.message = "joint 3\r\nSubject: forged\u{200b}".into();
    hostile.event.why = Some("seen\nurgency: none\u{2028}".into());
    let plain = message(vec![alarm()]).text().lines().count();
    let message = message(vec![hostile.clone()]);
    let text = message.text();
    assert_eq!(text.lines().count(), plain + 1, "the reason is one line more\n{text}");
    assert!(!text.replace('\n', "").contains(text::is_hidden), "{text:?}");
    assert!(!message.title().contains(text::is_hidden), "{}", message.title());
    let json = message.json_text();
    assert!(!json.contains(text::is_hidden), "{json:?}");
    let read: Value = serde_json::from_str(&json).unwrap();
    assert_eq!(read["alarms"][0]["robot"], hostile.event.robot);
}

#[test]
fn a_digest_counts_alarms_by_their_last_word_and_not_events() {
    let of = |anomaly_id: i64, what: EventKind| {
        let mut alarm = alarm();
        (alarm.event.anomaly_id, alarm.event.what) = (anomaly_id, what);
        alarm
    };
    let digest = message(vec![of(4, EventKind::Opened), of(5, EventKind::Opened), of(5, EventKind::Ended)]);
    assert_eq!(digest.title(), "digest: 1 alarm, 1 ended, worst critical");
    assert_eq!((digest.status(), digest.json()["alarms"].as_array().unwrap().len()), ("firing", 3));
    let mut reminded = Vec::new();
    for _ in 0..5 {
        reminded.extend((1..=4).map(|anomaly_id| of(anomaly_id, EventKind::Overdue)));
    }
    assert_eq!(message(reminded).title(), "digest: 4 alarms, 0 ended, worst critical");
    let over = message(vec![of(4, EventKind::Opened), of(4, EventKind::Ended)]);
    assert_eq!((over.title().as_str(), over.status()), ("digest: 0 alarms, 1 ended", "resolved"));
}
