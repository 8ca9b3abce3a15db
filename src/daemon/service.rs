//! Messages to the service manager, if one has started the daemon: ready, current activity, alive, stopping. Without
//! `NOTIFY_SOCKET`, for example in a terminal, nothing is sent.

use std::time::{Duration, Instant};

use sd_notify::NotifyState;

/// The service manager, after the daemon has reported that it is ready.
#[derive(Debug)]
pub(super) struct ServiceManager {
    /// Interval of the messages that the daemon is alive; `None` if they are not required.
    beat: Option<Duration>,
    next_beat: Instant,
    status: String,
}

impl ServiceManager {
    /// Reports that the daemon is ready.
    pub(super) fn ready(now: Instant) -> Self {
        tell(NotifyState::Ready);
        // twice as often as required
        let beat = sd_notify::watchdog_enabled().map(|within| within / 2);
        Self { beat, next_beat: now, status: String::new() }
    }

    /// When the next message is due.
    pub(super) fn next_beat(&self) -> Option<Instant> {
        self.beat.map(|_| self.next_beat)
    }

    /// Reports that the daemon is alive.
    pub(super) fn beat(&mut self, now: Instant) {
        if let Some(beat) = self.beat {
            tell(NotifyState::Watchdog);
            self.next_beat = now + beat;
        }
    }

    /// Reports the daemon's activity if it has changed.
    pub(super) fn status(&mut self, status: String) {
        if status != self.status {
            tell(NotifyState::Status(&status));
            self.status = status;
        }
    }

    /// Reports that the daemon is stopping.
    pub(super) fn stopping(self) {
        tell(NotifyState::Stopping);
    }
}

fn tell(state: NotifyState<'_>) {
    if let Err(error) = sd_notify::notify(&[state]) {
        tracing::debug!(%error, "the service manager was not notified");
    }
}
