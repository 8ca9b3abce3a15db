//! Writes the body of a request to a file, within limits of memory, size and time.

use std::future::poll_fn;
use std::io;
use std::pin::Pin;
use std::time::Duration;

use axum::body::{Body, Bytes, HttpBody};
use axum::http::StatusCode;
use tokio::sync::mpsc;
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;

use super::answer::Refusal;
use super::spool::{Claim, PartialFile};

/// Pieces between the connection and the disk. Each has about 16 to 400 kilobytes.
const PIECES_IN_FLIGHT: usize = 2;

/// Bytes that a client must send within the idle time. A client that sends fewer counts as idle.
const LEAST_BYTES: u64 = 16 << 10;

/// Average speed that a client must reach from the second minute on, bytes per second: that of a slow line of
/// 64 kbit/s. Each upload thus ends after a bounded time, and slow clients cannot occupy all places.
const LEAST_RATE: u64 = 8 << 10;

/// Time limit of an upload that is slower than [`LEAST_RATE`].
pub const SLOW_START: Duration = Duration::from_secs(60);

/// Limits of one body.
#[derive(Debug, Clone, Copy)]
pub struct BodyBounds {
    /// Most bytes.
    pub bytes: u64,
    /// Time limit of a client that sends almost nothing.
    pub idle: Duration,
    /// Time limit of a client that is slower than [`LEAST_RATE`].
    pub slow_start: Duration,
    /// Time after which an upload ends at any speed.
    pub total: Duration,
}

/// Writes a body to the upload, from its start or after the bytes that have arrived, and returns the claim. Bytes that
/// arrived before a failure stay on disk, so that the client can continue.
///
/// # Errors
/// 408 for a client that sends almost nothing, 413 above the limit, 503 at a stop, 507 on a full disk, and 400 for a
/// body that ends early (the client is then usually disconnected).
pub async fn receive(
    claim: Claim,
    from_start: bool,
    body: Body,
    bounds: BodyBounds,
    stop: &CancellationToken,
) -> Result<Claim, Refusal> {
    let (pieces, to_write) = mpsc::channel(PIECES_IN_FLIGHT);
    // the writer owns the claim, because this function is dropped early if the client disconnects
    let writer = tokio::task::spawn_blocking(move || {
        let written = claim.open(from_start).and_then(|file| write(file, to_write));
        (written, claim)
    });
    let received = hand_on(body, pieces, bounds, stop).await;
    let (written, claim) = writer.await.map_err(Refusal::internal)?;
    match (written, received) {
        (Err(error), _) => {
            if is_full(&error) {
                // otherwise it would keep the disk full, for the database too
                claim.remove();
            }
            Err(of_disk(&error))
        }
        (Ok(()), Ok(())) => Ok(claim),
        (Ok(()), Err(refusal)) if refusal.status == StatusCode::PAYLOAD_TOO_LARGE => {
            claim.remove();
            Err(refusal)
        }
        (Ok(()), Err(refusal)) => {
            let offset = claim.length().map_err(Refusal::internal)?;
            Err(refusal.at(offset))
        }
    }
}

/// Refusal after a failed write.
pub fn of_disk(error: &io::Error) -> Refusal {
    if is_full(error) {
        tracing::warn!(%error, "no space for uploads");
        no_uploads(&format!("no space left for uploads: {error}"))
    } else {
        Refusal::internal(error)
    }
}

/// Refusal while uploads are impossible.
pub fn no_uploads(reason: &str) -> Refusal {
    let sentence =
        format!("{reason}; on the daemon's machine, free space or mend the spool, then send again");
    Refusal::new(StatusCode::INSUFFICIENT_STORAGE, sentence).after(60)
}

fn is_full(error: &io::Error) -> bool {
    use io::ErrorKind::{FileTooLarge, QuotaExceeded, StorageFull};
    matches!(error.kind(), FileTooLarge | QuotaExceeded | StorageFull)
}

fn write(mut file: PartialFile, mut pieces: mpsc::Receiver<Bytes>) -> io::Result<()> {
    while let Some(piece) = pieces.blocking_recv() {
        file.append(&piece)?;
    }
    file.sync()
}

async fn hand_on(
    mut body: Body,
    pieces: mpsc::Sender<Bytes>,
    bounds: BodyBounds,
    stop: &CancellationToken,
) -> Result<(), Refusal> {
    let (mut received, mut lately) = (0_u64, 0_u64);
    let begun = Instant::now();
    let mut deadline = begun + bounds.idle;
    loop {
        let next = poll_fn(|context| Pin::new(&mut body).poll_frame(context));
        let frame = tokio::select! {
            () = stop.cancelled() => {
                return Err(Refusal::new(StatusCode::SERVICE_UNAVAILABLE, "stopping; go on later").after(10));
            }
            frame = tokio::time::timeout_at(deadline.min(begun + bounds.time_for(received)), next) => frame,
        };
        let piece = match frame {
            Err(_) => {
                return Err(Refusal::new(
                    StatusCode::REQUEST_TIMEOUT,
                    "too slow, or over its time; go on from where it is",
                ));
            }
            Ok(None) => return Ok(()),
            Ok(Some(Err(_))) => {
                return Err(Refusal::new(
                    StatusCode::BAD_REQUEST,
                    "the body broke off; go on from where it is",
                ));
            }
            Ok(Some(Ok(frame))) => frame.into_data().unwrap_or_default(),
        };
        let length = piece.len() as u64;
        (received, lately) = (received + length, lately + length);
        if received > bounds.bytes {
            return Err(too_large(bounds.bytes));
        }
        if lately >= LEAST_BYTES {
            (lately, deadline) = (0, Instant::now() + bounds.idle);
        }
        if pieces.send(piece).await.is_err() {
            // the writer returns the error
            return Ok(());
        }
    }
}

impl BodyBounds {
    /// Time limit, from its start, for an upload that has sent `received` bytes so far.
    fn time_for(&self, received: u64) -> Duration {
        self.slow_start.max(Duration::from_secs(received / LEAST_RATE)).min(self.total)
    }
}

/// Refusal of an upload that is longer than allowed.
pub fn too_large(most: u64) -> Refusal {
    let sentence = format!(
        "larger than {most} bytes; compress the export, or raise serve.upload.max_bytes in the configuration"
    );
    Refusal::new(StatusCode::PAYLOAD_TOO_LARGE, sentence)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::serve::reserve::Reserve;
    use crate::serve::spool::Spool;

    const BOUNDS: BodyBounds = BodyBounds {
        bytes: 10,
        idle: Duration::from_secs(5),
        slow_start: SLOW_START,
        total: Duration::from_secs(3600),
    };

    fn upload() -> (tempfile::TempDir, Spool, Claim) {
        let folder = tempfile::tempdir().unwrap();
        let spool = Spool::new(folder.path(), Reserve::new(folder.path(), None, Some(0)), 4);
        spool.prepare().unwrap();
        let mut claim = spool.claim("A.csv", None, "").unwrap().unwrap();
        claim.begin(true, None).unwrap();
        (folder, spool, claim)
    }

    #[tokio::test]
    async fn a_body_is_written_and_one_that_is_too_long_leaves_nothing() {
        let (_folder, spool, claim) = upload();
        let stop = CancellationToken::new();
        let claim = receive(claim, true, Body::from("01234"), BOUNDS, &stop).await.unwrap();
        let claim = receive(claim, false, Body::from("56789"), BOUNDS, &stop).await.unwrap();
        assert_eq!(claim.length().unwrap(), 10);
        let refusal = receive(claim, true, Body::from("0123456789x"), BOUNDS, &stop).await.unwrap_err();
        assert_eq!(refusal.status, StatusCode::PAYLOAD_TOO_LARGE);
        assert_eq!(spool.offset("A.csv", None).unwrap(), None);
    }

    #[tokio::test]
    async fn a_stop_keeps_what_arrived() {
        let (_folder, _spool, claim) = upload();
        claim.open(true).unwrap().append(b"0123").unwrap();
        let stop = CancellationToken::new();
        stop.cancel();
        // the first byte arrives at once and may be read before the stop takes effect; no later byte is read
        let drips = Body::new(Drips(tokio::time::interval(Duration::from_secs(600))));
        let refusal = receive(claim, false, drips, BOUNDS, &stop).await.unwrap_err();
        assert_eq!(refusal.status, StatusCode::SERVICE_UNAVAILABLE);
        assert!(matches!(refusal.offset, Some(4 | 5)), "{:?}", refusal.offset);
    }

    /// An endless body that sends one byte per tick.
    struct Drips(tokio::time::Interval);

    impl HttpBody for Drips {
        type Data = Bytes;
        type Error = std::convert::Infallible;

        fn poll_frame(
            mut self: Pin<&mut Self>,
            context: &mut std::task::Context<'_>,
        ) -> std::task::Poll<Option<Result<hyper::body::Frame<Bytes>, Self::Error>>> {
            let frame = || Some(Ok(hyper::body::Frame::data(Bytes::from_static(b"1"))));
            self.0.poll_tick(context).map(|_| frame())
        }
    }

    #[tokio::test]
    async fn a_client_that_drips_is_cut_and_can_go_on() {
        let (_folder, _spool, claim) = upload();
        let drips = Body::new(Drips(tokio::time::interval(Duration::from_millis(10))));
        let (short, long) = (Duration::from_millis(300), Duration::from_secs(600));
        let bounds = BodyBounds { bytes: 1 << 30, idle: long, slow_start: short, total: long };
        let refusal = receive(claim, true, drips, bounds, &CancellationToken::new()).await.unwrap_err();
        assert_eq!(refusal.status, StatusCode::REQUEST_TIMEOUT);
        assert!(refusal.offset.is_some_and(|offset| offset > 0), "{:?}", refusal.offset);
    }

    #[tokio::test]
    async fn an_upload_ends_after_its_total_time() {
        let (_folder, _spool, claim) = upload();
        let drips = Body::new(Drips(tokio::time::interval(Duration::from_millis(10))));
        let (short, long) = (Duration::from_millis(300), Duration::from_secs(600));
        let bounds = BodyBounds { bytes: 1 << 30, idle: long, slow_start: long, total: short };
        let refusal = receive(claim, true, drips, bounds, &CancellationToken::new()).await.unwrap_err();
        assert_eq!(refusal.status, StatusCode::REQUEST_TIMEOUT);
        assert!(refusal.offset.is_some_and(|offset| offset > 0), "{:?}", refusal.offset);
    }

    #[test]
    fn a_steady_client_has_time_in_proportion() {
        assert_eq!(BOUNDS.time_for(0), SLOW_START);
        assert_eq!(BOUNDS.time_for(1 << 20), Duration::from_secs(128));
    }

    #[test]
    fn a_full_disk_is_told_as_such() {
        for kind in [io::ErrorKind::StorageFull, io::ErrorKind::QuotaExceeded, io::ErrorKind::FileTooLarge] {
            assert_eq!(of_disk(&kind.into()).status, StatusCode::INSUFFICIENT_STORAGE);
        }
        assert_eq!(of_disk(&io::ErrorKind::Other.into()).status, StatusCode::INTERNAL_SERVER_ERROR);
    }
}
