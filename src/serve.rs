//! HTTP server: it receives exports, reports their status, and shows the state of the fleet.
//!
//! Uploads go to a watched folder (`spool`), so the daemon reads them in the same way as files on disk. No code here
//! parses an export. Requests change the database only if a person handles an alarm.
//!
//! | request | does |
//! |---|---|
//! | `GET /` | the dashboard, a page that sends the requests below (`page`) |
//! | `/v1/fleet`, `/v1/views/VIEW`, `/v1/sql`, `/v1/events`, ... | stored data, and actions on alarms (`api`) |
//! | `PUT /v1/exports/NAME` | receives an export, whole or from the end of an interrupted attempt (`upload`) |
//! | `PUT /v1/exports/NAME?explain=true` | says how an export would be treated, and keeps nothing (`explained`) |
//! | `HEAD /v1/exports/NAME` | reports in `Upload-Offset` the number of bytes received |
//! | `GET /v1/exports/HASH`, `/NAME` | reports the status of an export (`status`) |
//! | `GET /v1/openapi.json` | the description of all these requests (`openapi`) |
//! | `GET /metrics` | figures for Prometheus (`metrics`) |
//! | `GET /health`, `/ready` | report if the process lives, and if it can work |
//!
//! Limits apply to everything that a client can make large: connections, uploads, headers, bytes, time.

mod access;
mod answer;
mod api;
mod compression;
mod connections;
mod explained;
mod metrics;
mod network;
mod openapi;
mod page;
mod part;
mod rates;
mod receive;
mod requests;
mod reserve;
mod shared;
mod spool;
mod status;
mod tls;
mod unread_answers;
mod upload;
mod watched_stream;

use std::future::Future;
use std::net::SocketAddr;
use std::pin::pin;
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

use axum::Router;
use axum::body::{HttpBody, to_bytes};
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
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::{TcpListener, TcpSocket, TcpStream};
use tokio::sync::{OnceCell, Semaphore, watch};
use tokio::task::{JoinHandle, JoinSet};
use tokio_rustls::TlsAcceptor;
use tokio_rustls::server::TlsStream;
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
use compression::{AcceptedForm, COMPRESSED_AT_ONCE, in_wanted_form};
use connections::{CONNECTIONS, ConnectionPlace, Connections};
use network::{Network, Proxies};
use rates::RequestRates;
use shared::{STATEMENTS, Uploads};
pub use tls::TlsError;
use unread_answers::UnreadAnswers;
use watched_stream::{WRITE_STALL, WatchedStream};

/// Maximum size of a request's headers in bytes: a name of 255 bytes, percent-encoded, and a dozen usual headers.
const HEADER_BYTES: usize = 16 << 10;

/// Maximum number of headers of a request.
const HEADERS: usize = 64;

/// Time limit for the headers of a request, and for a connection without a request.
const HEADER_TIME: Duration = Duration::from_secs(15);

/// Time limit for a request until its answer begins. Uploads have other limits.
const REQUEST_TIME: Duration = Duration::from_secs(60);

/// Time limit for running requests when the program stops. Uploads stop sooner, and clients resume them later.
const STOP_TIME: Duration = Duration::from_secs(5);

/// Connections that may still be closing while [`CONNECTIONS`] are open. Further ones wait in the system's queue.
const CLOSING: usize = 64;

/// Bytes of an answer that the system may buffer until the client reads them. The system's own choice is up to some
/// megabytes. The client would then have to read a third of them before the daemon sees progress.
const SEND_BUFFER_BYTES: u32 = 32 << 10;

/// Connections that the system accepts before the daemon does.
const BACKLOG: u32 = 1024;

/// Pause after a failed accept. Without file descriptors the next accept fails at once.
const ACCEPT_PAUSE: Duration = Duration::from_millis(100);

/// Reason why the server does not start.
#[derive(Debug, thiserror::Error)]
pub enum ServeError {
    /// The tokens or their settings are not valid.
    #[error(transparent)]
    Access(#[from] AccessError),
    /// The certificate is not usable.
    #[error(transparent)]
    Tls(#[from] TlsError),
    /// The address is in use, or does not belong to this machine.
    #[error("cannot listen on {address}: {detail}; change serve.listen in the configuration")]
    Listen {
        /// The address.
        address: SocketAddr,
        /// The system's message.
        detail: String,
    },
}

impl ServeError {
    /// True if a person must change the configuration, rather than the machine.
    pub fn is_configuration(&self) -> bool {
        matches!(self, Self::Access(_) | Self::Tls(_))
    }
}

/// A running server.
#[derive(Debug)]
pub struct Server {
    /// Its listening address. The system chooses the port if the configuration says 0.
    pub address: SocketAddr,
    task: JoinHandle<()>,
}

impl Server {
    /// Waits until the server ends, after a request to stop.
    pub async fn ended(self) {
        if let Err(error) = self.task.await {
            tracing::error!(%error, "the HTTP server panicked");
        }
    }
}

/// Checks the tokens and the certificate, as [`start`] does.
///
/// # Errors
/// [`ServeError::Access`] and [`ServeError::Tls`].
pub fn check_access(settings: &ServeSettings, clients: &ClientSettings) -> Result<(), ServeError> {
    Access::new(settings, clients)?;
    settings.tls.as_ref().map(tls::acceptor).transpose()?;
    Ok(())
}

/// Listens as `settings` say until `stop` is cancelled, and counts requests in `metrics`. The server then finishes
/// running requests, and cuts uploads that clients can resume.
///
/// # Errors
/// [`ServeError`]; the server does not listen then.
pub async fn start(
    settings: &ServeSettings,
    config: watch::Receiver<Arc<Config>>,
    store: Store,
    metrics: Metrics,
    stop: CancellationToken,
) -> Result<Server, ServeError> {
    let clients = config.borrow().clients.clone();
    let proxies = Proxies::new(&settings.trusted_proxies);
    let access = Access::new(settings, &clients)?;
    access::warn_if_open(settings, &clients);
    let acceptor = settings.tls.as_ref().map(tls::acceptor).transpose()?;
    let uploads = match &settings.upload {
        Some(upload) => {
            let uploads = Uploads::new(upload.clone(), config.clone());
            // an unusable spool stops uploads only
            uploads.obstacle().await;
            Some(uploads)
        }
        None => None,
    };
    let listening =
        |error: std::io::Error| ServeError::Listen { address: settings.listen, detail: error.to_string() };
    let listener = listen(settings.listen).map_err(listening)?;
    let address = listener.local_addr().map_err(listening)?;
    tracing::info!(%address, tls = acceptor.is_some(), uploads = uploads.is_some(), "serving HTTP");
    let (renewed, acceptor) = acceptor.map(watch::channel).unzip();
    let renewing = settings
        .tls
        .clone()
        .zip(renewed)
        .map(|(settings, renewed)| tls::renew(settings, config.clone(), renewed, stop.clone()));
    let shared = Arc::new(Shared {
        store,
        access,
        uploads,
        rates: RequestRates::new(clients.requests_per_s),
        proxies: proxies.clone(),
        unread: UnreadAnswers::default(),
        statements: Arc::new(Semaphore::new(STATEMENTS)),
        compressions: Arc::new(Semaphore::new(COMPRESSED_AT_ONCE)),
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
        let accepting = accept(listener, acceptor, router(shared), proxies, stop);
        let renewing = async {
            if let Some(renewing) = renewing {
                renewing.await
            }
        };
        tokio::join!(accepting, upload::clean(&cleaning), api::watch(&cleaning), renewing);
    });
    Ok(Server { address, task })
}

fn listen(address: SocketAddr) -> std::io::Result<TcpListener> {
    let socket = if address.is_ipv4() { TcpSocket::new_v4() } else { TcpSocket::new_v6() }?;
    socket.set_reuseaddr(true)?;
    // accepted connections inherit this size
    socket.set_send_buffer_size(SEND_BUFFER_BYTES)?;
    socket.bind(address)?;
    socket.listen(BACKLOG)
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
        // each server builds one router
        Ok(text) => drop(shared.description.set(text)),
        Err(error) => tracing::error!(%error, "the API has no description"),
    }
    router
        .merge(page::routes())
        .route("/metrics", get(metrics::metrics))
        .fallback(status::nothing)
        .method_not_allowed_fallback(status::no_method)
        // the upload handler counts the bytes of uploads
        .layer(DefaultBodyLimit::max(BODY_BYTES))
        .layer(from_fn_with_state(Arc::clone(&shared), bounded))
        .layer(from_fn_with_state(Arc::clone(&shared), requests::count))
        .with_state(shared)
}

/// Answers a request within its limits: the number of requests from its network, and the time for one.
async fn bounded(State(shared): State<Arc<Shared>>, request: Request, next: Next) -> Response {
    let path = request.uri().path();
    let costs = path.starts_with("/v1/") || path == "/metrics";
    let network = request.extensions().get::<Network>().copied();
    let network = network.map(|peer| shared.proxies.client(peer, request.headers()));
    if costs
        && let Some(network) = network
        && let Err(wait) = shared.rates.count(network, Instant::now())
    {
        return Refusal::too_many(wait.as_secs() + 1).into_response();
    }
    let wanted = AcceptedForm::by(&request);
    if *request.method() == Method::PUT {
        // an upload has other limits
        return next.run(request).await;
    }
    match tokio::time::timeout(REQUEST_TIME, next.run(request)).await {
        Ok(answer) => {
            let answer = in_wanted_form(&shared.compressions, wanted, explained(answer).await).await;
            match network {
                Some(network) => shared.unread.count(network, answer).await,
                None => answer,
            }
        }
        Err(_) => Refusal::new(StatusCode::REQUEST_TIMEOUT, "the request took too long; send it again")
            .into_response(),
    }
}

/// Gives a refusal of the library the form of all others, such as one of an address that is not valid text.
async fn explained(answer: Response) -> Response {
    const LONGEST: usize = 4 << 10;
    /// Pointer to the description of requests.
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

async fn accept(
    listener: TcpListener,
    tls: Option<watch::Receiver<TlsAcceptor>>,
    router: Router,
    proxies: Proxies,
    stop: CancellationToken,
) {
    let sockets = Arc::new(Semaphore::new(CONNECTIONS + CLOSING));
    let places = Connections::new(proxies);
    let mut connections = JoinSet::new();
    loop {
        let socket = tokio::select! {
            () = stop.cancelled() => break,
            socket = Arc::clone(&sockets).acquire_owned() => socket,
        };
        let accepted = tokio::select! {
            () = stop.cancelled() => break,
            accepted = listener.accept() => accepted,
        };
        match accepted {
            Ok((stream, from)) => {
                let network = Network::of(from.ip());
                let place = places.enter(network);
                let (router, stop) = (router.clone(), stop.clone());
                let acceptor = tls.as_ref().map(|tls| tls.borrow().clone());
                connections.spawn(async move {
                    let evicted = place.progress.evicted.clone();
                    let stream = WatchedStream::new(stream, Arc::clone(&place.progress), WRITE_STALL);
                    let served = async {
                        match acceptor {
                            None => serve(stream, network, &place, router, stop).await,
                            Some(acceptor) => {
                                if let Some(stream) = encrypted(&acceptor, stream, &stop).await {
                                    serve(stream, network, &place, router, stop).await;
                                }
                            }
                        }
                    };
                    tokio::select! {
                        () = evicted.cancelled() => {}
                        () = served => {}
                    }
                    drop((socket, place));
                });
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

/// The stream after the handshake; `None` if the handshake exceeds the time limit for headers.
async fn encrypted(
    acceptor: &TlsAcceptor,
    stream: WatchedStream<TcpStream>,
    stop: &CancellationToken,
) -> Option<TlsStream<WatchedStream<TcpStream>>> {
    let shaken = tokio::select! {
        () = stop.cancelled() => return None,
        shaken = tokio::time::timeout(HEADER_TIME, acceptor.accept(stream)) => shaken,
    };
    match shaken {
        Ok(Ok(stream)) => Some(stream),
        Ok(Err(error)) => {
            tracing::debug!(%error, "no TLS handshake");
            None
        }
        Err(_) => None,
    }
}

async fn serve(
    stream: impl AsyncRead + AsyncWrite + Unpin,
    network: Network,
    place: &ConnectionPlace,
    router: Router,
    stop: CancellationToken,
) {
    let mut builder = http1::Builder::new();
    builder
        .timer(TokioTimer::new())
        .header_read_timeout(HEADER_TIME)
        .max_buf_size(HEADER_BYTES)
        .max_headers(HEADERS);
    let router = TowerToHyperService::new(router);
    let progress = Arc::clone(&place.progress);
    let service = service_fn(move |mut request: hyper::Request<Incoming>| {
        // the daemon may have to wait for a body
        let answering = request.body().is_end_stream().then(|| progress.answering());
        request.extensions_mut().insert(network);
        let answer = router.call(request);
        async move {
            let answer = answer.await;
            drop(answering);
            answer
        }
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
        // a client that disconnected, does not read, or sent invalid HTTP
        tracing::debug!(%error, "HTTP connection ended");
    }
}

async fn until_stop<F: Future + Unpin>(future: &mut F, stop: &CancellationToken) -> Option<F::Output> {
    tokio::select! {
        output = future => Some(output),
        () = stop.cancelled() => None,
    }
}
