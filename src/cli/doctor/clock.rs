//! Checks the clock of the machine, which determines rests between tests, silence and retention.

use std::path::Path;
use std::process::{Command, Stdio};

use super::finding::DoctorFinding;
use super::machine::Machine;
use armwatch_config::Config;

const CHECK: &str = "clock";

/// Created by systemd-timesyncd once the clock was set.
const SYNCHRONISED: &str = "/run/systemd/timesync/synchronized";

pub(super) fn check(_config: &Config, _machine: &Machine) -> Vec<DoctorFinding> {
    vec![judged(is_synchronised())]
}

fn judged(synchronised: Option<bool>) -> DoctorFinding {
    match synchronised {
        Some(true) => DoctorFinding::ok(CHECK, "set by the network (NTP)"),
        Some(false) => DoctorFinding::warning(
            CHECK,
            "not set by the network (NTP)",
            "`timedatectl set-ntp true`, with systemd-timesyncd or chrony installed",
        ),
        None => DoctorFinding::warning(
            CHECK,
            "unknown if set by the network (NTP): this system has no timedatectl",
            "check that it is right",
        ),
    }
}

fn is_synchronised() -> Option<bool> {
    if Path::new(SYNCHRONISED).exists() {
        return Some(true);
    }
    let mut timedatectl = Command::new("timedatectl");
    timedatectl
        .args(["show", "--property=NTPSynchronized", "--value"])
        .stdin(Stdio::null())
        .stderr(Stdio::null());
    match String::from_utf8_lossy(&timedatectl.output().ok()?.stdout).trim() {
        "yes" => Some(true),
        "no" => Some(false),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::super::finding::CheckLevel;
    use super::*;

    #[test]
    fn what_is_not_known_is_not_ok() {
        let levels = [Some(true), Some(false), None].map(|of| judged(of).level);
        assert_eq!(levels, [CheckLevel::Ok, CheckLevel::Warning, CheckLevel::Warning]);
    }
}
