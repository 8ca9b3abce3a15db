//! Processor times from `/proc` of Linux, in hundredths of a second (proc(5), `USER_HZ`).

const TICKS_A_SECOND: f64 = 100.0;

/// Time of all threads of a running process, user and system, s: fields 14 and 15 of its `stat`; `None` if the system
/// does not report it.
pub(super) fn process_cpu_s(pid: u32) -> Option<f64> {
    fields(&std::fs::read_to_string(format!("/proc/{pid}/stat")).ok()?, 14)
}

/// Time of the ended children of this process, s: fields 16 and 17; zero if the system does not report it.
pub(super) fn children_cpu_s() -> f64 {
    std::fs::read_to_string("/proc/self/stat").ok().and_then(|stat| fields(&stat, 16)).unwrap_or(0.0)
}

/// The sum of two fields, counted from one. The name before them may contain spaces, and ends with a bracket.
fn fields(stat: &str, first: usize) -> Option<f64> {
    let fields = stat.rsplit(')').next()?.split_whitespace();
    let ticks: Vec<f64> = fields.skip(first - 3).take(2).filter_map(|ticks| ticks.parse().ok()).collect();
    (ticks.len() == 2).then(|| ticks.iter().sum::<f64>() / TICKS_A_SECOND)
}

/// Busy time of this machine since it started, without idle time, s; `None` if the system does not report it.
pub(super) fn machine_cpu_s() -> Option<f64> {
    let stat = std::fs::read_to_string("/proc/stat").ok()?;
    let ticks: Vec<f64> =
        stat.lines().next()?.split_whitespace().skip(1).filter_map(|ticks| ticks.parse().ok()).collect();
    // user, nice, system, then idle and waiting, then interrupts of both kinds
    let [user, nice, system, _, _, hard, soft, ..] = ticks[..] else { return None };
    Some((user + nice + system + hard + soft) / TICKS_A_SECOND)
}

#[cfg(test)]
mod tests {
    use super::fields;

    #[test]
    fn fields_are_counted_behind_the_name() {
        let stat = "12 (a (b) c) S 1 12 12 0 -1 4194304 100 0 0 0 150 50 30 20 20 0 3 0";
        assert_eq!(fields(stat, 14), Some(2.0));
        assert_eq!(fields(stat, 16), Some(0.5));
        assert_eq!(fields("12 (a", 14), None);
    }
}
