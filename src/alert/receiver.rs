//! The interface of all receivers: accept a message, or report why not.

use std::future::Future;
use std::pin::Pin;
use std::time::Duration;

use super::message::Message;

/// A message on its way.
pub type Sending<'a> = Pin<Box<dyn Future<Output = Result<(), SendError>> + Send + 'a>>;

/// Accepts messages. A message that is sent again has the same key.
pub trait Receiver: Send + Sync {
    /// Sends a message; returns when the receiver has confirmed it.
    ///
    /// # Errors
    /// [`SendError`]; the message may have arrived nevertheless.
    fn send<'a>(&'a self, message: &'a Message) -> Sending<'a>;

    /// Time after which open alarms are sent to it again, if it forgets them.
    fn refresh(&self) -> Option<Duration> {
        None
    }
}

/// Why a message was not delivered. It is tried again, unless the receiver refuses it permanently.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum SendError {
    /// The receiver did not answer, or cannot accept a message now.
    #[error("{detail}")]
    Unreached {
        /// The error.
        detail: String,
        /// When it asks to be tried again.
        retry_after: Option<Duration>,
    },
    /// The receiver answered and refused this message; it may accept another.
    #[error("{detail}")]
    Refused {
        /// Its answer.
        detail: String,
        /// True if the receiver refuses this message every time.
        is_final: bool,
    },
}

impl SendError {
    /// The receiver did not answer.
    pub fn unreached(detail: impl Into<String>) -> Self {
        Self::Unreached { detail: detail.into(), retry_after: None }
    }

    /// The message was refused, and may be accepted later.
    pub fn refused(detail: impl Into<String>) -> Self {
        Self::Refused { detail: detail.into(), is_final: false }
    }

    /// The message was refused permanently.
    pub fn never(detail: impl Into<String>) -> Self {
        Self::Refused { detail: detail.into(), is_final: true }
    }
}

/// A receiver that cannot be used as it is configured.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct Unusable(pub String);
