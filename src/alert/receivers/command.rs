//! A program of the operator: gets the message as JSON on standard input, and ends with status 0 after accepting it.

use std::process::{ExitStatus, Stdio};
use std::time::Duration;

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::process::Command;

use crate::alert::message::Message;
use crate::alert::receiver::{Receiver, SendError, Sending};
use armwatch_config::receivers::CommandSettings;

/// Most bytes that are read of a program's output.
const SAID_BYTES: u64 = 4096;

/// Most characters of it that are reported.
const SHOWN_CHARACTERS: usize = 200;

/// Variables of the daemon that a program sees.
const PASSED_ON: [&str; 4] = ["PATH", "HOME", "LANG", "TZ"];

/// Starts a program for every message.
pub(super) struct CommandReceiver {
    arguments: Vec<String>,
    timeout: Duration,
}

impl CommandReceiver {
    pub(super) fn new(settings: &CommandSettings) -> Self {
        Self { arguments: settings.arguments.clone(), timeout: settings.timeout }
    }

    async fn run(&self, message: &Message) -> Result<(), SendError> {
        let program = self.arguments.first().map(String::as_str).unwrap_or_default();
        let failed = |error: std::io::Error| SendError::unreached(format!("{program}: {error}"));
        let mut child = Command::new(program)
            .args(&self.arguments[1..])
            // secrets of the daemon are not passed on
            .env_clear()
            .envs(PASSED_ON.into_iter().filter_map(|name| Some((name, std::env::var_os(name)?))))
            .env("ARMWATCH_KEY", &message.key)
            .env("ARMWATCH_STATUS", message.status())
            .env("ARMWATCH_SEVERITY", message.severity().name())
            .env("ARMWATCH_TITLE", message.title())
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .kill_on_drop(true)
            .spawn()
            .map_err(failed)?;
        let (stdin, stderr) = (child.stdin.take(), child.stderr.take());
        let text = message.json_text() + "\n";
        let writing = async {
            if let Some(mut stdin) = stdin {
                // a program may ignore the message, for example to ring a bell
                let _ = stdin.write_all(text.as_bytes()).await;
            }
        };
        let reading = async {
            let mut said = Vec::new();
            if let Some(stderr) = stderr {
                let mut start = stderr.take(SAID_BYTES);
                let _ = start.read_to_end(&mut said).await;
                // the rest is read too: a program with much output would otherwise wait for ever
                let _ = tokio::io::copy(&mut start.into_inner(), &mut tokio::io::sink()).await;
            }
            said
        };
        let all = async {
            let ((), said, status) = tokio::join!(writing, reading, child.wait());
            Ok::<_, SendError>((said, status.map_err(failed)?))
        };
        let Ok(ended) = tokio::time::timeout(self.timeout, all).await else {
            let seconds = self.timeout.as_secs_f64();
            return Err(SendError::refused(format!(
                "{program} did not end within {seconds} s and was killed"
            )));
        };
        let (said, status) = ended?;
        if status.success() { Ok(()) } else { Err(refusal(program, status, &said)) }
    }
}

impl Receiver for CommandReceiver {
    fn send<'a>(&'a self, message: &'a Message) -> Sending<'a> {
        Box::pin(self.run(message))
    }
}

fn refusal(program: &str, status: ExitStatus, said: &[u8]) -> SendError {
    let words = String::from_utf8_lossy(said).split_whitespace().collect::<Vec<_>>().join(" ");
    let said: String = words.chars().take(SHOWN_CHARACTERS).collect();
    let said = if said.is_empty() { said } else { format!(": {said}") };
    SendError::refused(format!("{program} ended with {status}{said}"))
}
