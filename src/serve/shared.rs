//! What requests share.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::{Duration, Instant};

use tokio::sync::{OnceCell, Semaphore, watch};
use tokio_util::sync::CancellationToken;

use super::access::Access;
use super::answer::Refusal;
use super::network::Proxies;
use super::rates::RequestRates;
use super::reserve::Reserve;
use super::spool::Spool;
use super::unread_answers::UnreadAnswers;
use crate::metrics::Metrics;
use armwatch_config::{Config, UploadSettings};
use armwatch_model::run::ContentHash;
use armwatch_store::Store;

/// What requests share.
#[derive(Debug)]
pub(super) struct Shared {
    pub(super) store: Store,
    pub(super) access: Access,
    pub(super) uploads: Option<Uploads>,
    /// Requests by network.
    pub(super) rates: RequestRates,
    /// Reverse proxies that name the client.
    pub(super) proxies: Proxies,
    /// Large answers that clients have not read yet.
    pub(super) unread: UnreadAnswers,
    /// Turns of statements of people and programs: their work takes cores from the pipeline.
    pub(super) statements: Arc<Semaphore>,
    /// Turns of answers that are compressed.
    pub(super) compressions: Arc<Semaphore>,
    /// The turn of requests that read an export again: one at a time. The task that reads holds it.
    pub(super) replays: Arc<Semaphore>,
    pub(super) stop: CancellationToken,
    /// What `/ready` said last.
    pub(super) readiness: tokio::sync::Mutex<Option<Readiness>>,
    /// As it is in force now.
    pub(super) config: watch::Receiver<Arc<Config>>,
    /// What `/v1/openapi.json` says, once the routes are known.
    pub(super) description: OnceLock<String>,
    /// The handle of those who only look, opened by the first of them.
    pub(super) looking: OnceCell<Store>,
    /// Figures of the process.
    pub(super) metrics: Metrics,
    /// Counts changes of the database while anybody listens.
    pub(super) changes: watch::Sender<u64>,
}

impl Shared {
    /// The handle of those who only look.
    ///
    /// # Errors
    /// 500 where the database cannot be opened, or is no longer the file at its path.
    pub async fn looking(&self) -> Result<&Store, Refusal> {
        self.store.check_files().map_err(|error| Refusal::internal(&error))?;
        let open = async || match self.store.open_for_looking().await {
            Ok(Some(store)) => Ok(store),
            Ok(None) => Err(Refusal::internal(&"the database file is gone")),
            Err(error) => Err(Refusal::internal(&error)),
        };
        self.looking.get_or_try_init(open).await
    }
}

/// Statements of people and programs at once.
pub(super) const STATEMENTS: usize = 2;

/// What the last look said, and when it was.
#[derive(Debug, Clone)]
pub struct Readiness {
    pub(super) at: Instant,
    /// Why the database cannot be used.
    pub(super) database: Result<(), &'static str>,
    /// Why no uploads are taken, although they are on.
    pub(super) obstacle: Option<String>,
}

/// Uploads remembered, so that a client can ask at once: those that the ledger may not know yet, and names of contents that
/// it knew by another one.
const REMEMBERED: usize = 1024;

/// Time between two looks at the spool: for space, and for uploads that nobody goes on with.
pub(super) const CLEANING_INTERVAL: Duration = Duration::from_secs(60);

/// What uploads share.
#[derive(Debug)]
pub struct Uploads {
    pub(super) settings: UploadSettings,
    pub(super) spool: Spool,
    /// As it is in force now.
    pub(super) config: watch::Receiver<Arc<Config>>,
    pub(super) places: Semaphore,
    /// Held while a whole upload gets its name, so that of two under one name the second sees the first.
    pub(super) placing: tokio::sync::Mutex<()>,
    /// Uploads that got their name, the latest last.
    pub(super) waiting: Mutex<VecDeque<SentContent>>,
    /// Uploads that were not taken, since their content was here or stored already; the latest last.
    pub(super) known: Mutex<VecDeque<SentContent>>,
    /// Whether the last look at the spool found an obstacle.
    is_refusing: AtomicBool,
}

/// A content as it was sent.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct SentContent {
    name: String,
    hash: ContentHash,
}

impl Uploads {
    /// Uploads into the spool of robots that `config` knows.
    pub fn new(settings: UploadSettings, config: watch::Receiver<Arc<Config>>) -> Self {
        let reserve = Reserve::new(&settings.spool, config.borrow().database_file(), settings.reserve_bytes);
        // a slow client leaves a place to others
        let spool = Spool::new(&settings.spool, reserve, settings.at_once.saturating_sub(1).max(1));
        let places = Semaphore::new(settings.at_once);
        Self {
            settings,
            spool,
            config,
            places,
            placing: tokio::sync::Mutex::default(),
            waiting: Mutex::default(),
            known: Mutex::default(),
            is_refusing: AtomicBool::new(false),
        }
    }

    /// Whether a content was taken that the ledger may not know yet.
    pub fn is_waiting(&self, hash: &ContentHash) -> bool {
        let waiting = self.waiting.lock().unwrap_or_else(PoisonError::into_inner);
        waiting.iter().any(|sent| sent.hash == *hash)
    }

    /// The content that was taken last under this name, which the ledger may not know yet.
    pub fn waiting_as(&self, name: &str) -> Option<ContentHash> {
        latest(&self.waiting, name)
    }

    /// The content that was sent last under this name and not taken, since it was here already.
    pub fn known_as(&self, name: &str) -> Option<ContentHash> {
        latest(&self.known, name)
    }

    /// Why no upload can be taken now: the spool cannot be written, or its disk or that of the database has no space
    /// beyond the reserve. The log says so when it begins and ends.
    pub async fn obstacle(&self) -> Option<String> {
        let spool = self.spool.clone();
        let obstacle = match tokio::task::spawn_blocking(move || spool.check()).await {
            Ok(Ok(())) => None,
            Ok(Err(error)) => Some(error.to_string()),
            Err(error) => Some(error.to_string()),
        };
        let was_refusing = self.is_refusing.swap(obstacle.is_some(), Ordering::Relaxed);
        let spool = self.settings.spool.display();
        match &obstacle {
            Some(error) if !was_refusing => {
                tracing::error!(%error, %spool, "uploads are refused until their folder can be written; all else goes on");
            }
            None if was_refusing => tracing::info!(%spool, "uploads are taken again"),
            _ => {}
        }
        obstacle
    }

    /// Remembers a content that got this name.
    pub(super) fn remember(&self, name: &str, hash: ContentHash) {
        remember(&self.waiting, name, hash);
    }

    /// Remembers the name of a content that was not taken.
    pub(super) fn remember_known(&self, name: &str, hash: ContentHash) {
        remember(&self.known, name, hash);
    }
}

fn latest(sent: &Mutex<VecDeque<SentContent>>, name: &str) -> Option<ContentHash> {
    let sent = sent.lock().unwrap_or_else(PoisonError::into_inner);
    sent.iter().rfind(|sent| sent.name == name).map(|sent| sent.hash)
}

/// Puts an upload last; the oldest goes where there are too many.
fn remember(sent: &Mutex<VecDeque<SentContent>>, name: &str, hash: ContentHash) {
    let mut sent = sent.lock().unwrap_or_else(PoisonError::into_inner);
    let new = SentContent { name: name.to_owned(), hash };
    sent.retain(|sent| *sent != new);
    if sent.len() >= REMEMBERED {
        sent.pop_front();
    }
    sent.push_back(new);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_latest_content_of_a_name_is_remembered_and_few_are() {
        let sent = Mutex::default();
        let content = |number: u8| ContentHash([number; 32]);
        remember(&sent, "a.csv", content(1));
        remember(&sent, "a.csv", content(2));
        remember(&sent, "b.csv", content(1));
        assert_eq!((latest(&sent, "a.csv"), latest(&sent, "c.csv")), (Some(content(2)), None));
        // sent again, it is the latest and takes no second place
        remember(&sent, "a.csv", content(1));
        assert_eq!((latest(&sent, "a.csv"), sent.lock().unwrap().len()), (Some(content(1)), 3));
        (0..REMEMBERED).for_each(|number| remember(&sent, &format!("{number}.csv"), content(7)));
        assert_eq!((latest(&sent, "a.csv"), sent.lock().unwrap().len()), (None, REMEMBERED));
    }
}
