//! Memory of large answers that their clients have not read yet.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};

use axum::body::{Body, Bytes, HttpBody, to_bytes};
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};

use super::answer::Refusal;
use super::network::Network;

/// Most bytes of large answers that wait for their clients.
const MOST_BYTES: u64 = 64 << 20;

/// Share of one client. Programs of this machine may have all, because a proxy serves many clients.
const MOST_BYTES_OF_ONE: u64 = MOST_BYTES / 4;

/// Larger answers are counted. All connections together hold 16 MiB of smaller ones.
const LARGE_BYTES: u64 = 64 << 10;

/// Bytes of large answers that wait, by client. Clones share them.
#[derive(Debug, Clone, Default)]
pub(super) struct UnreadAnswers(Arc<Mutex<HashMap<Network, u64>>>);

/// Bytes of an answer that are counted until they are dropped.
#[derive(Debug)]
struct Counted {
    answers: UnreadAnswers,
    network: Network,
    length: u64,
}

/// An answer with its count. hyper drops it after the last byte is written.
struct Unread {
    bytes: Bytes,
    _counted: Counted,
}

impl UnreadAnswers {
    /// Counts an answer until its client has read it. Refuses the answer with 503 if too many bytes wait.
    pub(super) async fn count(&self, network: Network, answer: Response) -> Response {
        let Some(length) = answer.body().size_hint().exact().filter(|length| *length > LARGE_BYTES) else {
            return answer;
        };
        let Some(counted) = self.enter(network, length) else {
            let sentence = "earlier answers wait until this client has read them; read them, then ask again";
            return Refusal::new(StatusCode::SERVICE_UNAVAILABLE, sentence).after(5).into_response();
        };
        let (head, body) = answer.into_parts();
        match to_bytes(body, usize::MAX).await {
            Ok(bytes) => {
                let unread = Unread { bytes, _counted: counted };
                Response::from_parts(head, Body::from(Bytes::from_owner(unread)))
            }
            Err(error) => Refusal::internal(error).into_response(),
        }
    }

    /// Counts `length` bytes, or returns `None` if too many wait. A client may always have one answer, so that other
    /// clients cannot block it.
    fn enter(&self, network: Network, length: u64) -> Option<Counted> {
        let mut answers = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let all: u64 = answers.values().sum();
        let own = answers.get(&network).copied().unwrap_or(0);
        let share = if network.is_loopback() { MOST_BYTES } else { MOST_BYTES_OF_ONE };
        if own > 0 && (own.saturating_add(length) > share || all.saturating_add(length) > MOST_BYTES) {
            return None;
        }
        answers.insert(network, own.saturating_add(length));
        Some(Counted { answers: self.clone(), network, length })
    }
}

impl Drop for Counted {
    fn drop(&mut self) {
        let mut answers = self.answers.0.lock().unwrap_or_else(PoisonError::into_inner);
        let left = answers.get(&self.network).copied().unwrap_or(0).saturating_sub(self.length);
        if left == 0 {
            answers.remove(&self.network);
        } else {
            answers.insert(self.network, left);
        }
    }
}

impl AsRef<[u8]> for Unread {
    fn as_ref(&self) -> &[u8] {
        &self.bytes
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn a_client_with_too_many_unread_bytes_gets_no_more_and_others_do() {
        const LENGTH: usize = 3 << 20;
        let answers = UnreadAnswers::default();
        let [one, other] = ["10.0.0.1", "10.0.0.2"].map(|text| Network::of(text.parse().unwrap()));
        let ask = async |network| answers.count(network, vec![7_u8; LENGTH].into_response()).await;
        let mut held = Vec::new();
        for _ in 0..5 {
            held.push(ask(one).await.into_body());
        }
        assert_eq!(held[4].size_hint().exact(), Some(LENGTH as u64));
        assert_eq!(ask(one).await.status(), StatusCode::SERVICE_UNAVAILABLE);
        assert_eq!(ask(other).await.status(), StatusCode::OK);
        assert_eq!(answers.count(one, "small".into_response()).await.status(), StatusCode::OK);
        let read = to_bytes(held.remove(0), LENGTH).await.unwrap();
        assert_eq!(ask(one).await.status(), StatusCode::SERVICE_UNAVAILABLE, "its bytes are still in memory");
        assert!(read.iter().all(|byte| *byte == 7));
        drop(read);
        assert_eq!(ask(one).await.status(), StatusCode::OK);
        drop(held);
        assert!(answers.0.lock().unwrap().is_empty());
    }
}
