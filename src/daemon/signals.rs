//! Signals that the daemon and long commands handle.

use std::io::IsTerminal;

use tokio::signal::unix::{SignalKind, signal};
use tokio::sync::mpsc;
use tokio_util::sync::CancellationToken;

/// Handles SIGHUP: requests that the configuration is read again, or, if the program's terminal was closed, a stop.
///
/// # Errors
/// If the handler cannot be installed.
pub fn reload_on_hangup(stop: &CancellationToken) -> std::io::Result<mpsc::Receiver<()>> {
    let mut hangup = signal(SignalKind::hangup())?;
    let (sender, receiver) = mpsc::channel(1);
    let had_terminal = std::io::stdin().is_terminal();
    let stop = stop.clone();
    tokio::spawn(async move {
        while hangup.recv().await.is_some() {
            // a closed terminal gives no more answers
            if had_terminal && !std::io::stdin().is_terminal() {
                tracing::info!("SIGHUP, the terminal is closed: finishing the current cycle");
                return stop.cancel();
            }
            tracing::info!("SIGHUP: reading the configuration again");
            // a full channel already contains the request
            let _ = sender.try_send(());
        }
    });
    Ok(receiver)
}

/// A token that SIGINT and SIGTERM cancel. A second signal ends the process at once, which is safe: finished work is
/// committed.
///
/// # Errors
/// If the handlers cannot be installed.
#[expect(clippy::exit, reason = "the second signal ends the process at once")]
pub fn stop_on_signal() -> std::io::Result<CancellationToken> {
    let stop = CancellationToken::new();
    let mut terminate = signal(SignalKind::terminate())?;
    let mut interrupt = signal(SignalKind::interrupt())?;
    let token = stop.clone();
    tokio::spawn(async move {
        for first in [true, false] {
            let name = tokio::select! {
                _ = terminate.recv() => "SIGTERM",
                _ = interrupt.recv() => "SIGINT",
            };
            if first {
                tracing::info!("{name}: finishing the current cycle; send it again to stop at once");
                token.cancel();
            } else {
                std::process::exit(130);
            }
        }
    });
    Ok(stop)
}
