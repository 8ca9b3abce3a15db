//! State shared by all requests.

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

/// State shared by all requests.
#[derive(Debug)]
pub(super) struct Shared {
    pub(super) store: Store,
    pub(super) access: Access,
    pub(super) uploads: Option<Uploads>,
    /// Request counts by network.
    pub(super) rates: RequestRates,
    /// Reverse proxies that name the client.
    pub(super) proxies: Proxies,
    /// Large answers that clients have not read yet.
    pub(super) unread: UnreadAnswers,
    /// Limits concurrent statements of people and programs. Their work uses cores that the pipeline needs.
    pub(super) statements: Arc<Semaphore>,
    /// Limits concurrent compression of answers.
    pub(super) compressions: Arc<Semaphore>,
    /// Limits requests that read an export again to one at a time. The reading task holds the permit.
    pub(super) replays: Arc<Semaphore>,
    pub(super) stop: CancellationToken,
    /// Last answer of `/ready`.
    pub(super) readiness: tokio::sync::Mutex<Option<Readiness>>,
    /// The configuration now in force.
    pub(super) config: watch::Receiver<Arc<Config>>,
    /// Answer of `/v1/openapi.json`, set once the routes are known.
    pub(super) description: OnceLock<String>,
    /// The handle for requests that only read, opened by the first such request.
    pub(super) looking: OnceCell<Store>,
    /// Metrics of the process.
    pub(super) metrics: Metrics,
    /// Counts changes of the database while a client listens.
    pub(super) changes: watch::Sender<u64>,
}

impl Shared {
    /// The handle for requests that only read.
    ///
    /// # Errors
    /// 500 if the database cannot be opened, or is no longer the file at its path.
    pub async fn looking(&self) -> Result<&Store, Refusal> {
        self.store.check_files().map_err(Refusal::internal)?;
        let open = async || match self.store.open_for_looking().await {
            Ok(Some(store)) => Ok(store),
            Ok(None) => Err(Refusal::internal("the database file is gone")),
            Err(error) => Err(Refusal::internal(error)),
        };
        self.looking.get_or_try_init(open).await
    }
}

/// Maximum number of concurrent statements of people and programs.
pub(super) const STATEMENTS: usize = 2;

/// Result of the last check, and its time.
#[derive(Debug, Clone)]
pub struct Readiness {
    pub(super) at: Instant,
    /// Reason why the database is not usable.
    pub(super) database: Result<(), &'static str>,
    /// Reason why the daemon refuses uploads, although they are on.
    pub(super) obstacle: Option<String>,
}

/// Maximum number of remembered uploads in each list, so that a client can ask for their status at once. One list has
/// uploads perhaps still unknown to the ledger. The other has new names of contents known by another name.
const REMEMBERED: usize = 1024;

/// Time between two checks of the spool: for free space, and for abandoned uploads.
pub(super) const CLEANING_INTERVAL: Duration = Duration::from_secs(60);

/// State shared by all uploads.
#[derive(Debug)]
pub struct Uploads {
    pub(super) settings: UploadSettings,
    pub(super) spool: Spool,
    /// The configuration now in force.
    pub(super) config: watch::Receiver<Arc<Config>>,
    pub(super) places: Semaphore,
    /// Locked while a whole upload gets its name. The second of two uploads with one name then sees the first.
    pub(super) placing: tokio::sync::Mutex<()>,
    /// Uploads that have their name, the latest last.
    pub(super) waiting: Mutex<VecDeque<SentContent>>,
    /// Uploads refused because their content was here or stored already; the latest last.
    pub(super) known: Mutex<VecDeque<SentContent>>,
    /// True if the last check of the spool found an obstacle.
    is_refusing: AtomicBool,
}

/// A content under its upload name.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct SentContent {
    name: String,
    hash: ContentHash,
}

impl Uploads {
    /// Creates the state for uploads into the spool, from robots that `config` knows.
    pub fn new(settings: UploadSettings, config: watch::Receiver<Arc<Config>>) -> Self {
        let reserve = Reserve::new(&settings.spool, config.borrow().database_file(), settings.reserve_bytes);
        // a slow client leaves one slot free for others
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

    /// True if the daemon accepted this content, perhaps still unknown to the ledger.
    pub fn is_waiting(&self, hash: &ContentHash) -> bool {
        let waiting = self.waiting.lock().unwrap_or_else(PoisonError::into_inner);
        waiting.iter().any(|sent| sent.hash == *hash)
    }

    /// The last accepted content under this name, perhaps still unknown to the ledger.
    pub fn waiting_as(&self, name: &str) -> Option<ContentHash> {
        latest(&self.waiting, name)
    }

    /// The last content sent under this name and not accepted, since it was here already.
    pub fn known_as(&self, name: &str) -> Option<ContentHash> {
        latest(&self.known, name)
    }

    /// Reason why no upload is possible now: the spool cannot be written, or its disk or the database's disk has no
    /// space beyond the reserve. The log reports the beginning and the end of this state.
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

    /// Remembers the name of a content that was not accepted.
    pub(super) fn remember_known(&self, name: &str, hash: ContentHash) {
        remember(&self.known, name, hash);
    }
}

fn latest(sent: &Mutex<VecDeque<SentContent>>, name: &str) -> Option<ContentHash> {
    let sent = sent.lock().unwrap_or_else(PoisonError::into_inner);
    sent.iter().rfind(|sent| sent.name == name).map(|sent| sent.hash)
}

/// Puts an upload last, and drops the oldest if there are too many.
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
        // a repeated upload becomes the latest and has only one entry
        remember(&sent, "a.csv", content(1));
        assert_eq!((latest(&sent, "a.csv"), sent.lock().unwrap().len()), (Some(content(1)), 3));
        (0..REMEMBERED).for_each(|number| remember(&sent, &format!("{number}.csv"), content(7)));
        assert_eq!((latest(&sent, "a.csv"), sent.lock().unwrap().len()), (None, REMEMBERED));
    }
}
