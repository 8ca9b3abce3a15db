use super::*;

fn day(date: &str) -> Timestamp {
    format!("{date}T08:47:00Z").parse().expect("a time")
}

fn after(start: Timestamp, days: i64) -> Timestamp {
    start + SignedDuration::from_hours(24 * days)
}

/// Files that are copied into one folder long after their recordings, without their times.
fn copied(starts: &[Timestamp]) -> Vec<Arrival<'static>> {
    let arrived = day("2026-11-28");
    let of = |(at, start): (usize, &Timestamp)| Arrival {
        started_at: *start,
        arrived_at: arrived + SignedDuration::from_secs(3 * at as i64),
        file_time: Some(arrived),
        folder: "/inbox",
        is_confirmed: false,
    };
    starts.iter().enumerate().map(of).collect()
}

/// Recordings that arrive on the day of their test, with the wrong starts in between.
fn live(starts: &[Timestamp]) -> Vec<Arrival<'static>> {
    let of = |(at, start): (usize, &Timestamp)| {
        let arrived_at = after(day("2026-01-05"), at as i64) + SignedDuration::from_hours(3);
        Arrival {
            started_at: *start,
            arrived_at,
            file_time: Some(arrived_at),
            folder: "/inbox",
            is_confirmed: false,
        }
    };
    starts.iter().enumerate().map(of).collect()
}

/// Eighteen daily tests; those from `from` to before `until` have starts that `wrong` computes from their position.
fn with_wrong(from: usize, until: usize, wrong: impl Fn(usize) -> Timestamp) -> Vec<Timestamp> {
    let right = |at: usize| after(day("2026-01-05"), at as i64);
    (0..18).map(|at| if (from..until).contains(&at) { wrong(at) } else { right(at) }).collect()
}

fn left_out(arrivals: &[Arrival<'_>]) -> Vec<usize> {
    let found = implausible_dates(arrivals);
    (0..arrivals.len()).filter(|at| found[*at].is_some_and(|of| !of.is_in_order)).collect()
}

#[test]
fn wrong_dates_are_found_whenever_their_files_are_read() {
    let (six_to_nine, at_end): (Vec<usize>, Vec<usize>) = ((6..9).collect(), (10..18).collect());
    let from = |date: &'static str| move |at: usize| after(day(date), at as i64);
    for (name, from_to, wrong) in [
        ("the next year", (6, 9), "2027-03-01"),
        ("2099", (6, 9), "2099-03-01"),
        ("the epoch of network time", (6, 9), "2036-02-07"),
        ("December for January", (6, 9), "2026-12-01"),
        ("a battery that is dead", (10, 18), "2000-01-01"),
        ("a battery that is dead, of a PC", (10, 18), "1980-01-01"),
        ("the time of a file from 1901", (10, 18), "1901-12-13"),
        ("the time of a file from 2106", (6, 9), "2106-02-07"),
        ("the past year", (10, 18), "2025-01-06"),
        ("months ahead of the others, still before the arrival", (6, 9), "2026-04-07"),
    ] {
        let starts = with_wrong(from_to.0, from_to.1, from(wrong));
        let expected = if from_to.0 == 6 { &six_to_nine } else { &at_end };
        assert_eq!(&left_out(&copied(&starts)), expected, "{name}, copied");
        assert_eq!(&left_out(&live(&starts)), expected, "{name}, live");
    }
}

#[test]
fn a_date_two_days_ahead_is_found_where_tests_come_daily() {
    let ahead = |at: usize| after(day("2026-01-05"), at as i64 + 3);
    assert_eq!(left_out(&live(&with_wrong(6, 9, ahead))), [6, 7, 8]);
}

#[test]
fn eight_dates_ahead_of_the_few_before_them_are_found_with_the_first_test_behind_them() {
    let ahead = |at: usize| after(day("2026-04-07"), at as i64);
    let starts = with_wrong(6, 14, ahead);
    assert_eq!(left_out(&copied(&starts[..14])), [0_usize; 0], "a pause of three months");
    assert_eq!(left_out(&copied(&starts[..15])), (6..14).collect::<Vec<_>>());
    assert_eq!(left_out(&copied(&starts)), (6..14).collect::<Vec<_>>());
}

#[test]
fn day_and_month_that_were_swapped_are_found() {
    // 5 to 12 January as 1 May to 1 December, and back again from the 13th on
    let swapped = |at: usize| day(&format!("2026-{:02}-01", at + 5));
    assert_eq!(left_out(&copied(&with_wrong(6, 8, swapped))), [6, 7]);
    let back: Vec<Timestamp> = (0..8).map(|at| day(&format!("2026-05-{:02}", at + 1))).collect();
    let back: Vec<Timestamp> = back.into_iter().chain([day("2026-01-05"), day("2026-05-10")]).collect();
    assert_eq!(left_out(&copied(&back)), [8]);
}

#[test]
fn one_start_for_all_is_named_and_the_order_of_arrival_counts() {
    for at in ["2000-01-01T00:05:00Z", "2000-01-01T00:00:00Z"] {
        let same: Timestamp = at.parse().expect("a time");
        let found = implausible_dates(&copied(&[same; 9]));
        assert!(
            found
                .iter()
                .all(|of| of.is_some_and(|of| { of.is_in_order && of.problem == DateProblem::SameStart(8) })),
            "{at}: {found:?}"
        );
    }
    // names with a date alone
    let midnight: Timestamp = "2026-01-05T00:00:00Z".parse().expect("a time");
    assert_eq!(implausible_dates(&copied(&[midnight; 3])), [None; 3]);
}

#[test]
fn an_arrival_by_a_clock_that_is_wrong_is_no_evidence() {
    let starts = with_wrong(0, 0, |_| Timestamp::UNIX_EPOCH);
    for clock in ["1970-01-01", "2000-01-01", "2087-05-05"] {
        let arrived = |of: Arrival<'static>| Arrival { arrived_at: day(clock), file_time: None, ..of };
        let arrivals: Vec<_> = copied(&starts).into_iter().map(arrived).collect();
        assert_eq!(implausible_dates(&arrivals), vec![None; 18], "{clock}");
    }
    // a jump is found without it
    let starts = with_wrong(6, 9, |at| after(day("2099-03-01"), at as i64));
    let arrived = |of: Arrival<'static>| Arrival { arrived_at: day("1970-01-01"), ..of };
    let arrivals: Vec<_> = copied(&starts).into_iter().map(arrived).collect();
    assert_eq!(left_out(&arrivals), [6, 7, 8]);
    // months slow: all arrivals are equally ahead of it, are reported, and count
    let behind =
        |of: Arrival<'static>| Arrival { arrived_at: of.arrived_at - SignedDuration::from_hours(2400), ..of };
    let arrivals: Vec<_> = live(&with_wrong(0, 0, day_of)).into_iter().map(behind).collect();
    assert_eq!(left_out(&arrivals), [0_usize; 0]);
    let found = implausible_dates(&live(&with_wrong(0, 0, day_of)));
    assert_eq!(found, vec![None; 18]);
}

fn day_of(_: usize) -> Timestamp {
    day("2026-01-05")
}

#[test]
fn exports_of_an_archive_are_right_in_any_order() {
    let year: Vec<Timestamp> = (0..365).map(|at| after(day("2025-01-01"), at)).collect();
    assert_eq!(left_out(&copied(&year)), [0_usize; 0], "in order");
    let reversed: Vec<Timestamp> = year.iter().rev().copied().collect();
    assert_eq!(left_out(&copied(&reversed)), [0_usize; 0], "the newest first");
    let scattered: Vec<Timestamp> = (0..365).map(|at| year[at * 149 % 365]).collect();
    assert_eq!(left_out(&copied(&scattered)), [0_usize; 0], "in any order");
    let mut by_day = year.clone();
    by_day.sort_by_key(|start| start.strftime("%d%m%Y").to_string());
    assert_eq!(left_out(&copied(&by_day)), [0_usize; 0], "by names that begin with the day");
    let strides: Vec<Timestamp> = (0..52).map(|at| after(day("2026-01-05"), (at * 17 + 5) % 52)).collect();
    assert_eq!(left_out(&copied(&strides)), [0_usize; 0], "in three strides");
    let old: Vec<Timestamp> = (0..9).map(|at| after(day("2019-01-01"), at)).collect();
    assert_eq!(left_out(&copied(&old)), [0_usize; 0], "an old archive of a new robot");
}

#[test]
fn late_files_are_right_where_their_times_or_their_folder_speak_for_them() {
    let now: Vec<Timestamp> = (0..12).map(|at| after(day("2026-03-01"), at)).collect();
    let late: Vec<Timestamp> = (0..12).map(|at| after(day("2025-08-01"), at)).collect();
    let all = [now, late].concat();
    let second_folder = |(at, of): (usize, Arrival<'static>)| {
        if at < 12 { of } else { Arrival { folder: "/archive", ..of } }
    };
    let arrivals: Vec<_> = copied(&all).into_iter().enumerate().map(second_folder).collect();
    assert_eq!(left_out(&arrivals), [0_usize; 0], "a second folder");
    assert_eq!(left_out(&copied(&all)), (12..24).collect::<Vec<_>>(), "the same folder, no witness");
    let with_times = |of: Arrival<'static>| Arrival {
        file_time: Some(of.started_at + SignedDuration::from_hours(2)),
        ..of
    };
    let mut arrivals: Vec<_> = copied(&all).into_iter().map(with_times).collect();
    assert_eq!(left_out(&arrivals), [0_usize; 0], "times of files");
    for of in &mut arrivals[12..] {
        of.started_at -= SignedDuration::from_hours(24 * 365 * 6);
        of.file_time = Some(of.started_at + SignedDuration::from_hours(2));
    }
    assert_eq!(left_out(&arrivals), [0_usize; 0], "years before, with times of files");
    // one straggler of a week, and a backlog that the next tests follow
    let mut starts: Vec<Timestamp> = (0..12).map(|at| after(day("2026-03-01"), at)).collect();
    starts.insert(9, starts[3]);
    starts.remove(3);
    assert_eq!(left_out(&copied(&starts)), [0_usize; 0], "a straggler");
}

#[test]
fn a_start_that_a_person_has_confirmed_is_right() {
    let mut arrivals = copied(&with_wrong(10, 18, |at| after(day("2000-01-01"), at as i64)));
    arrivals[10..].iter_mut().for_each(|of| of.is_confirmed = true);
    assert_eq!(left_out(&arrivals), [0_usize; 0]);
}

#[test]
fn a_simulated_fleet_may_run_past_today() {
    let starts: Vec<Timestamp> = (0..40).map(|at| after(day("2026-01-05"), 14 * at)).collect();
    let found = implausible_dates(&copied(&starts));
    assert!(found.iter().all(|of| of.is_none_or(|of| of.is_in_order)));
    assert!(found[39].is_some_and(|of| of.to_string().contains("after the file arrived")), "{:?}", found[39]);
}
