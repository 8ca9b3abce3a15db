//! A receiver of webhooks on a local port: records posts and answers as configured.

use std::collections::HashMap;
use std::net::SocketAddr;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use axum::Router;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode};
use axum::routing::post;
use serde_json::Value;
use tokio::sync::oneshot;

/// A received post.
#[derive(Debug, Clone)]
pub struct Posted {
    pub headers: HashMap<String, String>,
    pub text: String,
    /// Status of the answer.
    pub status: u16,
}

impl Posted {
    pub fn json(&self) -> Value {
        serde_json::from_str(&self.text).unwrap_or_else(|error| panic!("{error}: {}", self.text))
    }

    /// Key that identifies repetitions.
    pub fn key(&self) -> String {
        self.headers["webhook-id"].clone()
    }
}

/// Answer to a post, given the previous ones: a status, after a time.
type Answer = dyn Fn(&[Posted], &Posted) -> (u16, Duration) + Send + Sync;

#[derive(Clone)]
struct Shared {
    posted: Arc<Mutex<Vec<Posted>>>,
    answer: Arc<Answer>,
}

pub struct Sink {
    pub address: SocketAddr,
    posted: Arc<Mutex<Vec<Posted>>>,
    stop: Option<oneshot::Sender<()>>,
    thread: Option<std::thread::JoinHandle<()>>,
}

impl Sink {
    /// A receiver that accepts everything.
    pub fn new() -> Self {
        Self::answering(|_, _| (200, Duration::ZERO))
    }

    pub fn answering(answer: impl Fn(&[Posted], &Posted) -> (u16, Duration) + Send + Sync + 'static) -> Self {
        let posted = Arc::new(Mutex::new(Vec::new()));
        let shared = Shared { posted: Arc::clone(&posted), answer: Arc::new(answer) };
        let listener = std::net::TcpListener::bind("127.0.0.1:0").expect("a port");
        listener.set_nonblocking(true).expect("a listener");
        let address = listener.local_addr().expect("an address");
        let (stop, stopped) = oneshot::channel();
        let thread = std::thread::spawn(move || serve(listener, shared, stopped));
        Self { address, posted, stop: Some(stop), thread: Some(thread) }
    }

    pub fn url(&self) -> String {
        format!("http://{}/hook", self.address)
    }

    /// All posts so far.
    pub fn posted(&self) -> Vec<Posted> {
        self.posted.lock().expect("no panic").clone()
    }

    /// Accepted posts so far.
    pub fn taken(&self) -> Vec<Posted> {
        self.posted().into_iter().filter(|posted| posted.status == 200).collect()
    }
}

fn serve(listener: std::net::TcpListener, shared: Shared, stopped: oneshot::Receiver<()>) {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
    runtime.block_on(async {
        let listener = tokio::net::TcpListener::from_std(listener).expect("a listener");
        let router = Router::new().route("/hook", post(take)).with_state(shared);
        let serving = std::future::IntoFuture::into_future(axum::serve(listener, router));
        tokio::select! {
            served = serving => served.expect("served"),
            _ = stopped => {}
        }
    });
}

async fn take(State(shared): State<Shared>, headers: HeaderMap, text: String) -> StatusCode {
    let text_of = |value: &axum::http::HeaderValue| value.to_str().unwrap_or_default().to_owned();
    let headers = headers.iter().map(|(name, value)| (name.to_string(), text_of(value))).collect();
    let mut posted = Posted { headers, text, status: 0 };
    let time = {
        let mut all = shared.posted.lock().expect("no panic");
        let (status, time) = (shared.answer)(&all, &posted);
        posted.status = status;
        all.push(posted.clone());
        time
    };
    // delay of the answer
    let _ = tokio::time::timeout(time, std::future::pending::<()>()).await;
    StatusCode::from_u16(posted.status).expect("a status")
}

impl Drop for Sink {
    fn drop(&mut self) {
        let _ = self.stop.take().map(|stop| stop.send(()));
        let _ = self.thread.take().map(std::thread::JoinHandle::join);
    }
}
