//! A client for webhooks: one POST per connection, HTTP/1.1, plain or over TLS. It follows no redirects and uses no
//! proxies, so that an alarm is sent only to the configured address.

use std::convert::Infallible;
use std::sync::Arc;
use std::time::Duration;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use http_body_util::{BodyExt, Full, Limited};
use hyper::body::Bytes;
use hyper::client::conn::http1;
use hyper::header::{AUTHORIZATION, CONTENT_TYPE, HOST, RETRY_AFTER, USER_AGENT};
use hyper::{Request, StatusCode, Uri};
use hyper_util::rt::TokioIo;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::TcpStream;
use tokio_rustls::TlsConnector;
use tokio_rustls::rustls::ClientConfig;
use tokio_rustls::rustls::pki_types::ServerName;

use super::receiver::SendError;
use super::secret;
use armwatch_config::receivers::HttpLogin;

/// Most bytes that are read of an answer; its text is needed only to explain a refusal.
const ANSWER_BYTES: usize = 16 << 10;

/// Most characters of an answer that are reported.
const SHOWN_CHARACTERS: usize = 200;

/// Longest pause that a receiver may ask for.
const LONGEST_PAUSE: Duration = Duration::from_secs(3600);

/// Posts JSON.
#[derive(Debug, Clone)]
pub struct HttpClient {
    /// Credentials of the client.
    pub login: HttpLogin,
    /// For `https`.
    pub tls: Option<Arc<ClientConfig>>,
    /// Longest time for an answer.
    pub timeout: Duration,
}

impl HttpClient {
    /// Posts `body` with `headers`; returns when the server has answered 2xx.
    ///
    /// # Errors
    /// [`SendError::Refused`] for 4xx except 408, 425 and 429; these, 3xx, 5xx and no answer are
    /// [`SendError::Unreached`].
    pub async fn post(&self, url: &str, headers: &[(&str, String)], body: String) -> Result<(), SendError> {
        match tokio::time::timeout(self.timeout, self.exchange(url, headers, body)).await {
            Ok(done) => done,
            Err(_) => Err(SendError::unreached(format!("no answer within {} s", self.timeout.as_secs_f64()))),
        }
    }

    async fn exchange(&self, url: &str, headers: &[(&str, String)], body: String) -> Result<(), SendError> {
        let uri: Uri = url.parse().map_err(|error| SendError::unreached(format!("address: {error}")))?;
        let host = uri.host().ok_or_else(|| SendError::unreached("the address names no host"))?.to_owned();
        let is_tls = uri.scheme_str() == Some("https");
        let port = uri.port_u16().unwrap_or(if is_tls { 443 } else { 80 });
        let request = self.request(&uri, headers, body)?;
        let bare = host.trim_start_matches('[').trim_end_matches(']').to_owned();
        let stream = TcpStream::connect((bare.as_str(), port))
            .await
            .map_err(|error| SendError::unreached(format!("{host}:{port}: {error}")))?;
        if !is_tls {
            return exchange(stream, request).await;
        }
        let config = self.tls.clone().ok_or_else(|| SendError::unreached("no certificates are trusted"))?;
        let name =
            ServerName::try_from(bare).map_err(|error| SendError::unreached(format!("{host}: {error}")))?;
        let stream = TlsConnector::from(config)
            .connect(name, stream)
            .await
            .map_err(|error| SendError::unreached(format!("{host}:{port}: TLS: {error}")))?;
        exchange(stream, request).await
    }

    fn request(
        &self,
        uri: &Uri,
        headers: &[(&str, String)],
        body: String,
    ) -> Result<Request<Full<Bytes>>, SendError> {
        let path = uri.path_and_query().map_or("/", |path| path.as_str());
        let authority = uri.authority().map_or("", |authority| authority.as_str());
        let mut request = Request::post(path)
            .header(HOST, authority)
            .header(CONTENT_TYPE, "application/json")
            .header(USER_AGENT, concat!("armwatch/", env!("CARGO_PKG_VERSION")));
        for (name, value) in headers {
            request = request.header(*name, value);
        }
        match &self.login {
            HttpLogin::None => {}
            HttpLogin::Bearer(token) => {
                let token = secret::read(token).map_err(SendError::unreached)?;
                request = request.header(AUTHORIZATION, format!("Bearer {token}"));
            }
            HttpLogin::Basic { user, password } => {
                let password = secret::read(password).map_err(SendError::unreached)?;
                let login = STANDARD.encode(format!("{user}:{password}"));
                request = request.header(AUTHORIZATION, format!("Basic {login}"));
            }
        }
        // the error of a header does not reveal its value
        request
            .body(Full::new(Bytes::from(body)))
            .map_err(|error| SendError::unreached(format!("request: {error}")))
    }
}

async fn exchange(
    stream: impl AsyncRead + AsyncWrite + Unpin + Send + 'static,
    request: Request<Full<Bytes>>,
) -> Result<(), SendError> {
    let failed = |error: hyper::Error| SendError::unreached(format!("HTTP: {error}"));
    let (mut sender, connection) =
        http1::handshake::<_, Full<Bytes>>(TokioIo::new(stream)).await.map_err(failed)?;
    let answering = async {
        let response = sender.send_request(request).await.map_err(failed)?;
        let status = response.status();
        let pause = response.headers().get(RETRY_AFTER).and_then(|value| value.to_str().ok()?.parse().ok());
        let pause = pause.map(|seconds| Duration::from_secs(seconds).min(LONGEST_PAUSE));
        if status.is_success() {
            return Ok(());
        }
        let body = Limited::new(response.into_body(), ANSWER_BYTES).collect().await;
        let body = body.map(|body| body.to_bytes()).unwrap_or_default();
        let said: String = String::from_utf8_lossy(&body)
            .split_whitespace()
            .collect::<Vec<_>>()
            .join(" ")
            .chars()
            .take(SHOWN_CHARACTERS)
            .collect();
        let detail =
            if said.is_empty() { format!("HTTP {status}") } else { format!("HTTP {status}: {said}") };
        let is_passing = [StatusCode::REQUEST_TIMEOUT, StatusCode::TOO_EARLY, StatusCode::TOO_MANY_REQUESTS];
        if status.is_client_error() && !is_passing.contains(&status) {
            return Err(SendError::refused(detail));
        }
        Err(SendError::Unreached { detail, retry_after: pause })
    };
    // polled together with the exchange and dropped with it; if a server closes right after its answer, the answer
    // counts
    let driving = async {
        let _ = connection.await;
        std::future::pending::<Infallible>().await
    };
    tokio::select! {
        done = answering => done,
        never = driving => match never {},
    }
}

#[cfg(test)]
mod tests {
    use std::io::{Read, Write};
    use std::net::TcpListener;

    use super::*;

    /// Answers one request and closes; returns the port.
    fn answering(answer: &'static str) -> u16 {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let port = listener.local_addr().unwrap().port();
        std::thread::spawn(move || {
            let (mut stream, _) = listener.accept().unwrap();
            let mut request = Vec::new();
            let mut piece = [0; 1024];
            while !request.ends_with(b"{}") {
                let read = stream.read(&mut piece).unwrap();
                request.extend_from_slice(&piece[..read]);
            }
            stream.write_all(answer.as_bytes()).unwrap();
        });
        port
    }

    async fn post(answer: &'static str) -> Result<(), SendError> {
        let http = HttpClient { login: HttpLogin::None, tls: None, timeout: Duration::from_secs(10) };
        http.post(&format!("http://127.0.0.1:{}/", answering(answer)), &[], "{}".into()).await
    }

    #[tokio::test]
    async fn an_answer_counts_though_the_server_closes_at_once() {
        for _ in 0..50 {
            assert_eq!(
                post("HTTP/1.1 200 OK\r\nContent-Length: 0\r\nConnection: close\r\n\r\n").await,
                Ok(())
            );
            assert_eq!(post("HTTP/1.0 204 No Content\r\n\r\n").await, Ok(()));
        }
    }

    #[tokio::test]
    async fn what_is_no_yes_is_told_apart() {
        let refused = post("HTTP/1.1 400 Bad Request\r\nContent-Length: 3\r\n\r\nno\n").await;
        assert_eq!(refused, Err(SendError::refused("HTTP 400 Bad Request: no")));
        let busy =
            post("HTTP/1.1 503 Service Unavailable\r\nRetry-After: 7\r\nContent-Length: 0\r\n\r\n").await;
        let (detail, retry_after) = ("HTTP 503 Service Unavailable".to_owned(), Some(Duration::from_secs(7)));
        assert_eq!(busy, Err(SendError::Unreached { detail, retry_after }));
        // no answer, and an interrupted one
        for cut in ["", "HTTP/1.1 20"] {
            assert!(matches!(post(cut).await, Err(SendError::Unreached { .. })), "{cut:?}");
        }
        assert!(matches!(
            post("HTTP/1.1 302 Found\r\nContent-Length: 0\r\n\r\n").await,
            Err(SendError::Unreached { .. })
        ));
    }
}
