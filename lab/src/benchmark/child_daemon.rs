//! A daemon in a child process, as a benchmark observes it: its messages to the service manager, its memory and its
//! open files.

use std::os::unix::net::UnixDatagram;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, kill_process};

use super::processor_time::process_cpu_s;
use super::throughput::memory_mb;
use crate::context::LabOptions;
use armwatch::cli::context::CliError;

/// Longest time for a daemon to end on request.
const TO_END: Duration = Duration::from_secs(60);
/// Interval of checks that it has ended.
const LOOK: Duration = Duration::from_millis(20);

/// Settings of glibc's allocator, like those of the service unit and the container. By default, eight arenas per
/// processor keep memory that threads have freed and that is not reused; without fixed thresholds, the allocator keeps
/// ever larger blocks.
const ALLOCATOR: [(&str, &str); 3] =
    [("MALLOC_ARENA_MAX", "2"), ("MALLOC_MMAP_THRESHOLD_", "262144"), ("MALLOC_TRIM_THRESHOLD_", "1000000")];

/// Options for starting a daemon.
pub(super) struct Launch<'l> {
    /// Name of its socket, in its working folder.
    pub(super) name: &'l str,
    /// Its configuration; the shipped one if `None`.
    pub(super) config: Option<&'l Path>,
    /// The only processor that it may use.
    pub(super) processor: Option<usize>,
}

/// A daemon with its inbox in a separate folder.
pub(super) struct ChildDaemon {
    child: Child,
    /// Receives its messages to the service manager.
    said: UnixDatagram,
}

impl ChildDaemon {
    /// Starts `armwatch run` in `folder` on the shipped configuration.
    pub(super) fn start(global: &LabOptions, folder: &Path) -> Result<Self, CliError> {
        Self::launch(global, folder, &Launch { name: "notify", config: None, processor: None })
    }

    /// Starts `armwatch run` in `folder`.
    pub(super) fn launch(global: &LabOptions, folder: &Path, launch: &Launch<'_>) -> Result<Self, CliError> {
        let io = |error: std::io::Error| CliError::Io(format!("{}: {error}", folder.display()));
        let socket = folder.join(launch.name);
        let said = UnixDatagram::bind(&socket).map_err(io)?;
        said.set_nonblocking(true).map_err(io)?;
        let program = global.program()?;
        let mut command = match launch.processor {
            None => Command::new(program),
            Some(processor) => {
                let mut command = Command::new("taskset");
                command.arg("--cpu-list").arg(processor.to_string()).arg(program);
                command
            }
        };
        command.args(["run", "-q"]);
        if let Some(config) = launch.config {
            command.arg("--config").arg(config);
        }
        let unset = ALLOCATOR.into_iter().filter(|(name, _)| std::env::var_os(name).is_none());
        command.envs(unset);
        let child = command
            .env_remove("ARMWATCH_CONFIG")
            .env("NOTIFY_SOCKET", &socket)
            .current_dir(folder)
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .spawn();
        let child = child.map_err(|error| match launch.processor {
            Some(_) => CliError::Io(format!("taskset: {error}; it is part of util-linux")),
            None => io(error),
        })?;
        Ok(Self { child, said })
    }

    /// Processor time of all its threads, s; `None` if the system does not report it.
    pub(super) fn cpu_s(&self) -> Option<f64> {
        process_cpu_s(self.child.id())
    }

    /// Its messages since the last call, in order: lines such as `READY=1` and `STATUS=0 exports ...`.
    pub(super) fn said(&self) -> Vec<String> {
        let mut buffer = [0; 1024];
        let mut lines = Vec::new();
        while let Ok(length) = self.said.recv(&mut buffer) {
            lines.extend(String::from_utf8_lossy(&buffer[..length]).lines().map(str::to_owned));
        }
        lines
    }

    /// Resident memory, MB; `None` if the system does not report it.
    pub(super) fn memory_mb(&self) -> Option<f64> {
        memory_mb(Path::new(&format!("/proc/{}/status", self.child.id())), "VmRSS:")
    }

    /// Open files; `None` if the system does not report them.
    pub(super) fn handles(&self) -> Option<f64> {
        Some(std::fs::read_dir(format!("/proc/{}/fd", self.child.id())).ok()?.count() as f64)
    }

    /// Returns an error if it has ended.
    pub(super) fn check(&mut self) -> Result<(), CliError> {
        let ended = self.child.try_wait().map_err(|error| CliError::Io(error.to_string()))?;
        ended.map_or(Ok(()), |status| Err(CliError::Internal(format!("the daemon ended: {status}"))))
    }

    /// Requests its end, and waits for it.
    pub(super) fn stop(mut self) -> Result<(), CliError> {
        let pid = i32::try_from(self.child.id()).ok().and_then(Pid::from_raw);
        let pid = pid.ok_or_else(|| CliError::Internal("a process without number".into()))?;
        kill_process(pid, Signal::TERM).map_err(|error| CliError::Io(error.to_string()))?;
        let asked = Instant::now();
        while asked.elapsed() < TO_END {
            if let Some(status) = self.child.try_wait().map_err(|error| CliError::Io(error.to_string()))? {
                let failed = || CliError::Internal(format!("the daemon ended with {status}"));
                return if status.success() { Ok(()) } else { Err(failed()) };
            }
            std::thread::sleep(LOOK);
        }
        Err(CliError::Internal(format!("the daemon did not end within {} s", TO_END.as_secs())))
    }
}

impl Drop for ChildDaemon {
    fn drop(&mut self) {
        // has no effect if it has ended
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
