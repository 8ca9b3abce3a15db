//! What the service manager is told, where one has started the daemon: that it works, at what, that it is alive, and that
//! it ends. Without `NOTIFY_SOCKET`, as in a terminal, nothing is said.

use std::time::{Duration, Instant};

use sd_notify::NotifyState;

/// The service manager, after the daemon has told it that it works.
#[derive(Debug)]
pub(super) struct ServiceManager {
    /// How often it wants to hear that the daemon is alive, at the least; `None`: not at all.
    beat: Option<Duration>,
    next_beat: Instant,
    status: String,
}

impl ServiceManager {
    /// Says that the daemon works.
    pub(super) fn ready(now: Instant) -> Self {
        tell(NotifyState::Ready);
        // twice as often as asked for
        let beat = sd_notify::watchdog_enabled().map(|within| within / 2);
        Self { beat, next_beat: now, status: String::new() }
    }

    /// When it is to hear of the daemon.
    pub(super) fn next_beat(&self) -> Option<Instant> {
        self.beat.map(|_| self.next_beat)
    }

    /// Says that the daemon is alive.
    pub(super) fn beat(&mut self, now: Instant) {
        if let Some(beat) = self.beat {
            tell(NotifyState::Watchdog);
            self.next_beat = now + beat;
        }
    }

    /// Says what the daemon is at, where that has changed.
    pub(super) fn status(&mut self, status: String) {
        if status != self.status {
            tell(NotifyState::Status(&status));
            self.status = status;
        }
    }

    /// Says that the daemon ends.
    pub(super) fn stopping(self) {
        tell(NotifyState::Stopping);
    }
}

fn tell(state: NotifyState<'_>) {
    if let Err(error) = sd_notify::notify(&[state]) {
        tracing::debug!(%error, "the service manager was not notified");
    }
}
