//! Settings of single channels in a layout and a description: delays, missing positions, sensors at the links.

use std::fs;

use crate::bad_input::decompressed;
use crate::support::Workshop;

/// Columns of the torques in the native layout.
const TORQUES: std::ops::Range<usize> = 13..19;

/// A workshop with this layout and this description.
fn workshop(layout: &str, description: &str) -> Workshop {
    let workshop = Workshop::new();
    fs::write(workshop.path("layout.toml"), layout).expect("a layout");
    fs::write(workshop.path("robot.toml"), description).expect("a description");
    workshop.use_file("layout", "layout.toml");
    workshop.use_file("description", "robot.toml");
    workshop
}

fn shipped(name: &str) -> String {
    fs::read_to_string(format!("{}/config/{name}", env!("CARGO_MANIFEST_DIR"))).expect("a shipped file")
}

/// One cycle of the reference export as cells, the header first.
fn cells() -> Vec<Vec<String>> {
    let text = decompressed();
    text.lines().take(1 + 8509).map(|line| line.split(',').map(str::to_owned).collect()).collect()
}

fn joined(rows: &[Vec<String>]) -> String {
    rows.iter().map(|row| row.join(",") + "\n").collect()
}

fn figures(workshop: &Workshop, robot: &str) -> Vec<f64> {
    let sql = format!(
        "SELECT relative_rmsd FROM cycle_rmsd WHERE robot = '{robot}' AND stage = 'excitation' AND verification = 'self'
         ORDER BY joint"
    );
    workshop.query(&sql).iter().map(|row| row.parse().expect("a number")).collect()
}

#[test]
fn torques_that_come_late_are_as_good_as_others_once_the_layout_says_so() {
    const ROWS_LATE: usize = 6;
    let rows = cells();
    let time = |row: usize| rows[row][0].parse::<f64>().expect("a time");
    let step = (time(1001) - time(1)) / 1000.0;
    let mut late = rows.clone();
    for row in (1..late.len()).rev() {
        let source = row.saturating_sub(ROWS_LATE).max(1);
        for column in TORQUES {
            late[row][column].clone_from(&rows[source][column]);
        }
    }
    let native = shipped("exports/native.toml");
    let delay = format!("unit = \"Nm\"\ndelay_s = {:.6}", ROWS_LATE as f64 * step);
    let workshop = workshop(&native.replace("unit = \"Nm\"", &delay), &shipped("robots/er3a.toml"));
    fs::write(workshop.inbox("Late_20260105_0847.csv"), joined(&late)).expect("an export");
    workshop.stdout(&["ingest", "inbox"], 0);
    let found = figures(&workshop, "Late");

    let plain = Workshop::new();
    fs::write(plain.inbox("Plain_20260105_0847.csv"), joined(&rows)).expect("an export");
    plain.stdout(&["ingest", "inbox"], 0);
    let expected = figures(&plain, "Plain");
    assert_eq!((found.len(), expected.len()), (6, 6));
    for (found, expected) in found.iter().zip(&expected) {
        assert!((found - expected).abs() < 0.01 * expected, "{found} {expected}");
    }
}

#[test]
fn a_log_of_currents_and_temperatures_is_kept_and_says_what_it_lacks() {
    let native = shipped("exports/native.toml");
    let layout = native
        .replace("column = \"pos_{joint}\"\nunit = \"rad\"", "recorded = false")
        .replace("[velocity]\ncolumn = \"vel_{joint}\"\nunit = \"rad/s\"\n", "");
    assert!(layout.contains("recorded = false") && !layout.contains("vel_{joint}"), "{layout}");
    let workshop = workshop(&layout, &shipped("robots/er3a.toml"));
    let rows: Vec<Vec<String>> = (cells().into_iter().enumerate())
        .map(|(at, row)| {
            let temperatures = (1..=6).map(|joint| match at {
                0 => format!("motor_temperature_{joint}_degc"),
                _ => format!("{}.5", 30 + joint),
            });
            row[..1].iter().chain(&row[13..]).cloned().chain(temperatures).collect()
        })
        .collect();
    for day in 5..8 {
        let name = format!("Log_2026010{day}_0847.csv");
        let mut rows = rows.clone();
        // the start of another recording
        rows[1][0] = format!("0.000{day}");
        fs::write(workshop.inbox(&name), joined(&rows)).expect("an export");
    }
    workshop.run(&["ingest", "inbox"]);
    assert_eq!(workshop.query("SELECT robot, status, rows FROM runs"), ["Log|complete|8509"; 3]);
    assert_eq!(
        workshop.number("SELECT count(*) FROM anomalies"),
        0,
        "no log can be less accurate than before"
    );
    let cycles = workshop.query("SELECT status, reason, remarks FROM cycles");
    let cycle = &cycles[0];
    assert!(
        cycle.starts_with("refused|the log has no positions: parameters and friction need the position"),
        "{cycle}"
    );
    assert!(cycle.contains("torques, root mean square of each joint: "), "{cycle}");
    let temperatures = "SELECT COUNT(*) FROM temperatures WHERE robot = 'Log'";
    assert!(workshop.number(temperatures) >= 6);
}

#[test]
fn sensors_at_the_links_leave_the_motors_out_of_the_model() {
    let native = shipped("exports/native.toml");
    let er3a = shipped("robots/er3a.toml");
    let with = |keys: &str| er3a.replacen("friction_model = \"polynomial\"", keys, 1);
    let check = |description: &str| {
        let workshop = workshop(&native, description);
        workshop.stdout(&["robot", "check", "robot.toml"], 0)
    };
    let (motor, link) = (check(&er3a), check(&with("torque_sensors = \"link\"")));
    assert!(motor.contains("I_m") && !motor.contains("measured behind the gears"), "{motor}");
    assert!(
        link.contains("measured behind the gears, without motor inertia") && link.contains("f1"),
        "{link}"
    );
    assert!(!link.replace("I_m a", "").contains("I_m"), "{link}");
    let rigid = check(&with("torque_sensors = \"link\"\nfriction_model = \"none\""));
    assert!(rigid.contains("friction of a joint: none"), "{rigid}");

    let currents =
        workshop(&native.replace("unit = \"Nm\"", "unit = \"A\""), &with("torque_sensors = \"link\""));
    let refused = currents.run(&["config", "check"]);
    assert_eq!(refused.status.code(), Some(2));
    let said =
        String::from_utf8_lossy(&refused.stderr).into_owned() + &String::from_utf8_lossy(&refused.stdout);
    assert!(
        said.contains("torque_sensors = \"link\", but the layout native reads torques of the motors"),
        "{said}"
    );
}
