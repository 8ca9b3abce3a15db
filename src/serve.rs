//! HTTP: exports come in, and what became of them and of the fleet can be asked and looked at.
//!
//! Uploads go to a folder that is watched like any other (`spool`), so that they come through the same door
//! as files on disk; nothing here reads an export. The database is changed only by what people do with alarms.
//!
//! | request | does |
//! |---|---|
//! | `GET /` | the dashboard, a page that asks what follows (`page`) |
//! | `/v1/fleet`, `/v1/views/VIEW`, `/v1/sql`, `/v1/events`, ... | what is stored, and what people do with alarms (`api`) |
//! | `PUT /v1/exports/NAME` | takes an export, whole or from where an earlier attempt was cut (`upload`) |
//! | `HEAD /v1/exports/NAME` | says in `Upload-Offset` how much of it is there |
//! | `GET /v1/exports/HASH`, `/NAME` | says what became of an export (`status`) |
//! | `GET /v1/openapi.json` | the description of all this (`openapi`) |
//! | `GET /metrics` | figures for Prometheus (`metrics`) |
//! | `GET /health`, `/ready` | whether the process lives, and whether it can work |
//!
//! Everything that a client can make large is bounded: connections, uploads, headers, bytes, time.

mod access;
mod answer;
mod api;
mod metrics;
mod openapi;
mod page;
mod part;
mod rates;
mod receive;
mod requests;
mod shared;
mod spool;
mod status;
mod upload;

use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::future::Future;
use std::net::{IpAddr, SocketAddr};
use std::pin::pin;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::{Duration, Instant};

use axum::Router;
use axum::body::to_bytes;
use axum::extract::{DefaultBodyLimit, Request, State};
use axum::http::header::CONTENT_TYPE;
use axum::http::{Method, StatusCode};
use axum::middleware::{Next, from_fn_with_state};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use hyper::body::Incoming;
use hyper::server::conn::http1;
use hyper::service::{Service, service_fn};
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{OnceCell, Semaphore, watch};
use tokio::task::{JoinHandle, JoinSet};
use tokio_util::sync::CancellationToken;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use crate::metrics::Metrics;
use crate::serve::shared::Shared;

pub use access::TOKEN_VARIABLE;
use access::{Access, AccessError};
use answer::{BODY_BYTES, Refusal};
use armwatch_config::{ClientSettings, Config, ServeSettings};
use armwatch_store::Store;
use rates::{Peer, Rates};
use shared::{STATEMENTS, Uploads};
use spool::Spool;

/// Connections at once; each holds a socket and at most [`HEADER_BYTES`] before its request is understood.
const CONNECTIONS: usize = 256;

/// Most bytes of a request's headers: a name of 255 bytes, percent-encoded, and a dozen usual headers.
const HEADER_BYTES: usize = 16 << 10;

/// Most headers of a request.
const HEADERS: usize = 64;

/// How long a client may take over the headers of a request, and stay connected without one.
const HEADER_TIME: Duration = Duration::from_secs(15);

/// How long a request may take until its answer begins; one that is no upload.
const REQUEST_TIME: Duration = Duration::from_secs(60);

/// How long requests in hand may take when the program stops. Uploads are cut sooner, and resumed later.
const STOP_TIME: Duration = Duration::from_secs(5);

/// Of these, most of one address, so that one client alone cannot keep the others out. Programs of this machine may
/// have all: a proxy stands for many clients.
const CONNECTIONS_OF_ONE: usize = CONNECTIONS / 4;

/// Pause after a failed accept: without file descriptors the next one fails at once.
const ACCEPT_PAUSE: Duration = Duration::from_millis(100);

/// Why nothing is served.
#[derive(Debug, thiserror::Error)]
pub enum ServeError {
    /// Who may ask is not settled.
    #[error(transparent)]
    Access(#[from] AccessError),
    /// The address is taken, or not of this machine.
    #[error("cannot listen on {address}: {detail}; change serve.listen in the configuration")]
    Listen {
        /// The address.
        address: SocketAddr,
        /// What the system says.
        detail: String,
    },
    /// The folder for uploads cannot be used.
    #[error(
        "the folder for uploads {folder}: {detail}; make it writable for this user, or change serve.upload.spool"
    )]
    Spool {
        /// The folder.
        folder: String,
        /// What the system says.
        detail: String,
    },
}

impl ServeError {
    /// Whether a person has to change the configuration, rather than the machine.
    #[must_use]
    pub fn is_configuration(&self) -> bool {
        matches!(self, Self::Access(_))
    }
}

/// A server at work.
#[derive(Debug)]
pub struct Server {
    /// Where it listens; the port is the system's where the configuration says 0.
    pub address: SocketAddr,
    task: JoinHandle<()>,
}

impl Server {
    /// Waits for the end, which comes after the stop was asked for.
    pub async fn ended(self) {
        if let Err(error) = self.task.await {
            tracing::error!(%error, "the HTTP server panicked");
        }
    }
}

/// Sees whether it is settled who may ask, as [`start`] does.
///
/// # Errors
/// [`ServeError::Access`].
pub fn check_access(settings: &ServeSettings, clients: &ClientSettings) -> Result<(), ServeError> {
    Ok(Access::new(settings, clients).map(|_| ())?)
}

/// Listens as `settings` say until `stop` is cancelled, and counts requests in `metrics`. Requests in hand are then
/// finished, uploads cut where they can go on.
///
/// # Errors
/// [`ServeError`]; nothing listens then.
pub async fn start(
    settings: &ServeSettings,
    config: watch::Receiver<Arc<Config>>,
    store: Store,
    metrics: Metrics,
    stop: CancellationToken,
) -> Result<Server, ServeError> {
    let clients = config.borrow().clients.clone();
    let access = Access::new(settings, &clients)?;
    access::warn_if_open(settings, &clients);
    let uploads = match &settings.upload {
        Some(upload) => {
            let spool = Spool::open(&upload.spool).map_err(|error| ServeError::Spool {
                folder: upload.spool.display().to_string(),
                detail: error.to_string(),
            })?;
            Some(Uploads::new(upload.clone(), spool, config.clone()))
        }
        None => None,
    };
    let listening =
        |error: std::io::Error| ServeError::Listen { address: settings.listen, detail: error.to_string() };
    let listener = TcpListener::bind(settings.listen).await.map_err(listening)?;
    let address = listener.local_addr().map_err(listening)?;
    tracing::info!(%address, uploads = uploads.is_some(), "serving HTTP");
    let shared = Arc::new(Shared {
        store,
        access,
        uploads,
        rates: Rates::new(clients.requests_per_s),
        statements: Arc::new(Semaphore::new(STATEMENTS)),
        replays: Arc::new(Semaphore::new(1)),
        description: OnceLock::new(),
        stop: stop.clone(),
        readiness: tokio::sync::Mutex::default(),
        config,
        looking: OnceCell::new(),
        metrics,
        changes: watch::channel(0).0,
    });
    let cleaning = Arc::clone(&shared);
    let task = tokio::spawn(async move {
        let accepting = accept(listener, router(shared), stop);
        tokio::join!(accepting, upload::clean(&cleaning), api::watch(&cleaning));
    });
    Ok(Server { address, task })
}

fn router(shared: Arc<Shared>) -> Router {
    let described = OpenApiRouter::with_openapi(openapi::general())
        .merge(api::routes())
        .routes(routes!(upload::offset, upload::put, status::of_export))
        .routes(routes!(openapi::openapi))
        .routes(routes!(status::health))
        .routes(routes!(status::ready));
    let (router, description) = described.split_for_parts();
    match description.to_json() {
        // a router is made once a server
        Ok(text) => drop(shared.description.set(text)),
        Err(error) => tracing::error!(%error, "the API has no description"),
    }
    router
        .merge(page::routes())
        .route("/metrics", get(metrics::metrics))
        .fallback(status::nothing)
        .method_not_allowed_fallback(status::no_method)
        // uploads are counted where they are taken
        .layer(DefaultBodyLimit::max(BODY_BYTES))
        .layer(from_fn_with_state(Arc::clone(&shared), bounded))
        .layer(from_fn_with_state(Arc::clone(&shared), requests::count))
        .with_state(shared)
}

/// Answers a request within its bounds: how many the address may send, and how long one may take.
async fn bounded(State(shared): State<Arc<Shared>>, request: Request, next: Next) -> Response {
    let path = request.uri().path();
    let costs = path.starts_with("/v1/") || path == "/metrics";
    if costs
        && let Some(peer) = request.extensions().get::<Peer>()
        && let Err(wait) = shared.rates.count(*peer, Instant::now())
    {
        return Refusal::too_many(wait.as_secs() + 1).into_response();
    }
    if *request.method() == Method::PUT {
        // an upload has bounds of its own
        return next.run(request).await;
    }
    match tokio::time::timeout(REQUEST_TIME, next.run(request)).await {
        Ok(answer) => explained(answer).await,
        Err(_) => Refusal::new(StatusCode::REQUEST_TIMEOUT, "the request took too long; send it again")
            .into_response(),
    }
}

/// A refusal of the library, such as that of an address with what is no text, in the form of all others.
async fn explained(answer: Response) -> Response {
    const LONGEST: usize = 4 << 10;
    /// Where requests are described.
    const DESCRIBED: &str = "GET /v1/openapi.json and docs/api.md describe the requests";
    let is_text =
        answer.headers().get(CONTENT_TYPE).is_some_and(|media| media.as_bytes().starts_with(b"text/plain"));
    if !(answer.status().is_client_error() && is_text) {
        return answer;
    }
    let status = answer.status();
    match to_bytes(answer.into_body(), LONGEST).await {
        Ok(text) => {
            let text = String::from_utf8_lossy(&text);
            Refusal::new(status, format!("{text}; {DESCRIBED}")).into_response()
        }
        Err(_) => Refusal::new(status, format!("the request is not understood; {DESCRIBED}")).into_response(),
    }
}

async fn accept(listener: TcpListener, router: Router, stop: CancellationToken) {
    let places = Arc::new(Semaphore::new(CONNECTIONS));
    let clients = Clients::default();
    let mut connections = JoinSet::new();
    loop {
        // a full house leaves further clients to the system's queue
        let place = tokio::select! {
            () = stop.cancelled() => break,
            place = Arc::clone(&places).acquire_owned() => place,
        };
        let accepted = tokio::select! {
            () = stop.cancelled() => break,
            accepted = listener.accept() => accepted,
        };
        match accepted {
            Ok((stream, from)) => {
                if let Some(client) = clients.enter(from.ip()) {
                    let (router, stop) = (router.clone(), stop.clone());
                    connections.spawn(async move {
                        serve(stream, Peer(from.ip()), router, stop).await;
                        drop((place, client));
                    });
                } else {
                    tracing::debug!(%from, "closed: {CONNECTIONS_OF_ONE} connections of one address");
                }
            }
            Err(error) => {
                tracing::warn!(%error, "cannot accept a connection");
                tokio::time::sleep(ACCEPT_PAUSE).await;
            }
        }
        while connections.try_join_next().is_some() {}
    }
    drop(listener);
    let ending = async { while connections.join_next().await.is_some() {} };
    if tokio::time::timeout(STOP_TIME, ending).await.is_err() {
        tracing::warn!("HTTP requests were cut by the stop");
    }
}

/// Connections that are open, by the address that they come from.
#[derive(Debug, Clone, Default)]
struct Clients(Arc<Mutex<HashMap<IpAddr, usize>>>);

/// A connection among them, until it is dropped.
#[derive(Debug)]
struct Client(Clients, IpAddr);

impl Clients {
    /// Counts one more connection; `None` where the address has as many as it may.
    fn enter(&self, address: IpAddr) -> Option<Client> {
        let mut open = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let of_one = open.entry(address).or_insert(0);
        if *of_one >= CONNECTIONS_OF_ONE && !address.is_loopback() {
            return None;
        }
        *of_one += 1;
        Some(Client(self.clone(), address))
    }
}

impl Drop for Client {
    fn drop(&mut self) {
        let mut open = self.0.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Entry::Occupied(mut of_one) = open.entry(self.1) {
            *of_one.get_mut() -= 1;
            if *of_one.get() == 0 {
                of_one.remove();
            }
        }
    }
}

async fn serve(stream: TcpStream, peer: Peer, router: Router, stop: CancellationToken) {
    let mut builder = http1::Builder::new();
    builder
        .timer(TokioTimer::new())
        .header_read_timeout(HEADER_TIME)
        .max_buf_size(HEADER_BYTES)
        .max_headers(HEADERS);
    let router = TowerToHyperService::new(router);
    let service = service_fn(move |mut request: hyper::Request<Incoming>| {
        request.extensions_mut().insert(peer);
        router.call(request)
    });
    let connection = builder.serve_connection(TokioIo::new(stream), service);
    let mut connection = pin!(connection);
    let ended = until_stop(&mut connection, &stop).await;
    let ended = match ended {
        Some(ended) => ended,
        None => {
            connection.as_mut().graceful_shutdown();
            connection.await
        }
    };
    if let Err(error) = ended {
        // a client that went away, or sent what is no HTTP
        tracing::debug!(%error, "HTTP connection ended");
    }
}

async fn until_stop<F: Future + Unpin>(future: &mut F, stop: &CancellationToken) -> Option<F::Output> {
    tokio::select! {
        output = future => Some(output),
        () = stop.cancelled() => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_address_cannot_have_all_connections() {
        let clients = Clients::default();
        let [one, other, here] = ["10.0.0.1", "10.0.0.2", "127.0.0.1"].map(|text| text.parse().unwrap());
        let mut held: Vec<_> = (0..CONNECTIONS_OF_ONE).map(|_| clients.enter(one).unwrap()).collect();
        assert!(clients.enter(one).is_none());
        assert!(clients.enter(other).is_some());
        assert!(
            (0..CONNECTIONS).map(|_| clients.enter(here)).collect::<Vec<_>>().iter().all(Option::is_some)
        );
        held.pop();
        assert!(clients.enter(one).is_some());
        held.clear();
        assert!(clients.0.lock().unwrap().is_empty());
    }
}
