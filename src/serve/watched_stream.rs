//! A stream whose client must read its answers.

use std::io::{self, IoSlice};
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll, ready};
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::time::{Instant, Sleep, sleep_until};

use super::connections::ConnectionPhase;

/// Longest pause of a client that reads an answer.
pub(super) const WRITE_STALL: Duration = Duration::from_secs(30);

/// Average speed that a client must read with, bytes per second. A slower client uses up [`WRITE_STALL`]. A line of
/// 9.6 kbit/s is fast enough. Without this limit, a client that reads a little now and then would hold an answer
/// for ever.
const LEAST_RATE: f64 = 1024.0;

/// A stream that fails if its client reads its answers too slowly, and that notes its progress. Limits for
/// reading are those of HTTP: hyper's for headers, and those of requests and uploads for bodies.
#[derive(Debug)]
pub(super) struct WatchedStream<S> {
    stream: S,
    progress: Arc<ConnectionPhase>,
    stall: Duration,
    /// Remaining time to wait for the client.
    patience: Duration,
    /// Start of the current wait.
    blocked: Option<Instant>,
    timer: Pin<Box<Sleep>>,
}

impl<S> WatchedStream<S> {
    /// Watches a stream, whose client may read nothing for the time `stall`.
    pub(super) fn new(stream: S, progress: Arc<ConnectionPhase>, stall: Duration) -> Self {
        let timer = Box::pin(sleep_until(Instant::now()));
        Self { stream, progress, stall, patience: stall, blocked: None, timer }
    }

    /// Updates the remaining time after an attempt to write. Fails if a wait has used it up.
    fn judge(
        &mut self,
        context: &mut Context<'_>,
        attempt: Poll<io::Result<usize>>,
    ) -> Poll<io::Result<usize>> {
        let now = Instant::now();
        match attempt {
            Poll::Ready(Ok(taken)) => {
                let waited = self.blocked.take().map_or(Duration::ZERO, |since| now - since);
                let earned = Duration::from_secs_f64(taken as f64 / LEAST_RATE);
                self.patience = (self.patience.saturating_sub(waited) + earned).min(self.stall);
                self.progress.moved();
                attempt
            }
            Poll::Ready(Err(_)) => attempt,
            Poll::Pending => {
                if self.blocked.is_none() {
                    self.blocked = Some(now);
                    self.timer.as_mut().reset(now + self.patience);
                }
                ready!(self.timer.as_mut().poll(context));
                Poll::Ready(Err(io::Error::new(io::ErrorKind::TimedOut, "the client does not read")))
            }
        }
    }
}

impl<S: AsyncRead + Unpin> AsyncRead for WatchedStream<S> {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        let before = buffer.filled().len();
        let read = Pin::new(&mut self.stream).poll_read(context, buffer);
        if buffer.filled().len() > before {
            self.progress.moved();
        }
        read
    }
}

impl<S: AsyncWrite + Unpin> AsyncWrite for WatchedStream<S> {
    fn poll_write(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        let attempt = Pin::new(&mut self.stream).poll_write(context, bytes);
        self.judge(context, attempt)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        let attempt = Pin::new(&mut self.stream).poll_write_vectored(context, bytes);
        self.judge(context, attempt)
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_flush(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(context)
    }
}

#[cfg(test)]
mod tests {
    use tokio::io::{AsyncReadExt, AsyncWriteExt, DuplexStream, duplex};

    use super::*;
    use crate::serve::connections::Connections;
    use crate::serve::network::{Network, Proxies};

    const STALL: Duration = Duration::from_millis(400);

    /// A stream with a small buffer, and its client's side.
    fn watched() -> (WatchedStream<DuplexStream>, DuplexStream) {
        let (stream, client) = duplex(64);
        let place = Connections::new(Proxies::default()).enter(Network::of([10, 0, 0, 1].into()));
        (WatchedStream::new(stream, Arc::clone(&place.progress), STALL), client)
    }

    /// Reads so many bytes every 20 ms until the stream ends.
    async fn read_steadily(mut client: DuplexStream, bytes: usize) {
        let mut taken = vec![0; bytes];
        while client.read_exact(&mut taken).await.is_ok() {
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    }

    #[tokio::test]
    async fn a_client_that_reads_nothing_is_given_up() {
        let (mut stream, _client) = watched();
        let failed = stream.write_all(&[1; 65]).await.unwrap_err();
        assert_eq!(failed.kind(), io::ErrorKind::TimedOut);
    }

    #[tokio::test]
    async fn a_client_that_reads_a_byte_now_and_then_is_given_up() {
        let (mut stream, client) = watched();
        let reading = tokio::spawn(read_steadily(client, 1));
        let failed = stream.write_all(&[1; 1 << 16]).await.unwrap_err();
        assert_eq!(failed.kind(), io::ErrorKind::TimedOut);
        drop(stream);
        reading.await.unwrap();
    }

    #[tokio::test]
    async fn a_client_that_reads_slowly_and_steadily_gets_everything() {
        let (mut stream, client) = watched();
        let reading = tokio::spawn(read_steadily(client, 64));
        // at most 3200 bytes per second, so that the transfer takes many times `STALL`
        stream.write_all(&[1; 64 * 100]).await.unwrap();
        drop(stream);
        reading.await.unwrap();
    }
}
