//! Processor time, memory and files of this process, under the names that client libraries of Prometheus give them.

use std::fs;

use prometheus_client::collector::Collector;
use prometheus_client::encoding::{DescriptorEncoder, NoLabelSet};
use prometheus_client::metrics::MetricType;
use rustix::param::{clock_ticks_per_second, page_size};
use rustix::process::{Resource, getrlimit};

/// The process, from `/proc/self` (proc(5)). Systems other than Linux have no such files, and no metrics.
#[derive(Debug)]
pub(super) struct Process;

impl Collector for Process {
    fn encode(&self, mut encoder: DescriptorEncoder<'_>) -> std::fmt::Result {
        let Some(state) = ProcessState::read() else { return Ok(()) };
        encoder
            .encode_descriptor(
                "process_cpu_seconds",
                "Total user and system CPU time spent in seconds.",
                None,
                MetricType::Counter,
            )?
            .encode_counter::<NoLabelSet, _, f64>(&state.cpu_s, None)?;
        let gauges = [
            ("process_open_fds", "Number of open file descriptors.", state.open_files),
            ("process_max_fds", "Maximum number of open file descriptors.", state.most_files),
            ("process_virtual_memory_bytes", "Virtual memory size in bytes.", Some(state.virtual_bytes)),
            ("process_resident_memory_bytes", "Resident memory size in bytes.", Some(state.resident_bytes)),
            (
                "process_start_time_seconds",
                "Start time of the process since unix epoch in seconds.",
                Some(state.start_s),
            ),
            ("process_threads", "Number of OS threads in the process.", Some(state.threads)),
        ];
        for (name, help, value) in gauges {
            if let Some(value) = value {
                encoder.encode_descriptor(name, help, None, MetricType::Gauge)?.encode_gauge(&value)?;
            }
        }
        Ok(())
    }
}

struct ProcessState {
    cpu_s: f64,
    start_s: u64,
    threads: u64,
    virtual_bytes: u64,
    resident_bytes: u64,
    open_files: Option<u64>,
    /// `None` without a limit.
    most_files: Option<u64>,
}

impl ProcessState {
    fn read() -> Option<Self> {
        let stat = fs::read_to_string("/proc/self/stat").ok()?;
        // the second field, the name of the program in parentheses, may have spaces
        let fields: Vec<&str> = stat.rsplit_once(')')?.1.split_ascii_whitespace().collect();
        let field = |number: usize| fields.get(number - 3)?.parse::<u64>().ok();
        let system = fs::read_to_string("/proc/stat").ok()?;
        let boot_s: u64 = system.lines().find_map(|line| line.strip_prefix("btime ")?.parse().ok())?;
        let ticks_per_s = clock_ticks_per_second();
        Some(Self {
            cpu_s: (field(14)? + field(15)?) as f64 / ticks_per_s as f64,
            start_s: boot_s + field(22)? / ticks_per_s,
            threads: field(20)?,
            virtual_bytes: field(23)?,
            resident_bytes: field(24)? * page_size() as u64,
            open_files: fs::read_dir("/proc/self/fd").ok().map(|files| files.count() as u64),
            most_files: getrlimit(Resource::Nofile).current,
        })
    }
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use std::time::{Duration, UNIX_EPOCH};

    use super::*;

    #[test]
    fn the_process_is_told_as_the_system_shows_it() {
        let state = ProcessState::read().unwrap();
        let status = fs::read_to_string("/proc/self/status").unwrap();
        let size = |name: &str| -> u64 {
            let line = status.lines().find_map(|line| line.strip_prefix(name)).unwrap();
            line.trim_end_matches("kB").trim().parse().unwrap()
        };
        // both were read at slightly different times
        let close = |one: u64, other: u64| one.abs_diff(other) < one / 2;
        assert!(close(state.virtual_bytes, 1024 * size("VmSize:")), "{}", state.virtual_bytes);
        assert!(close(state.resident_bytes, 1024 * size("VmRSS:")), "{}", state.resident_bytes);
        assert!(state.threads >= 2 && state.open_files >= Some(3) && state.open_files < state.most_files);
        let age = UNIX_EPOCH.elapsed().unwrap() - Duration::from_secs(state.start_s);
        assert!(state.cpu_s >= 0.0 && age < Duration::from_secs(86_400), "{} {age:?}", state.cpu_s);
    }
}
