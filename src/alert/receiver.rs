//! What every receiver does: take a message, or say why not.

use std::future::Future;
use std::pin::Pin;
use std::time::Duration;

use super::message::Message;

/// A message on its way.
pub type Sending<'a> = Pin<Box<dyn Future<Output = Result<(), SendError>> + Send + 'a>>;

/// Takes messages. A message that is sent again has the same key.
pub trait Receiver: Send + Sync {
    /// Sends a message; done when the receiver has said that it has it.
    ///
    /// # Errors
    /// [`SendError`]; the message may have arrived all the same.
    fn send<'a>(&'a self, message: &'a Message) -> Sending<'a>;

    /// Time after which it wants to hear of open alarms again, if it forgets them by itself.
    fn refresh(&self) -> Option<Duration> {
        None
    }
}

/// Why a message has not arrived. It is tried again, unless the receiver says that it will never take it.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum SendError {
    /// Nobody was there, or nobody who could take a message now.
    #[error("{detail}")]
    Unreached {
        /// What happened.
        detail: String,
        /// When it wants to be asked again.
        retry_after: Option<Duration>,
    },
    /// The receiver was there and refused this message; it may take another.
    #[error("{detail}")]
    Refused {
        /// What it said.
        detail: String,
        /// True if the receiver refuses this message every time.
        is_final: bool,
    },
}

impl SendError {
    /// Nobody was there.
    #[must_use]
    pub fn unreached(detail: impl Into<String>) -> Self {
        Self::Unreached { detail: detail.into(), retry_after: None }
    }

    /// The message was refused, and may be taken later.
    #[must_use]
    pub fn refused(detail: impl Into<String>) -> Self {
        Self::Refused { detail: detail.into(), is_final: false }
    }

    /// The message was refused, and will be every time.
    #[must_use]
    pub fn never(detail: impl Into<String>) -> Self {
        Self::Refused { detail: detail.into(), is_final: true }
    }
}

/// A receiver that cannot be used as it is configured.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct Unusable(pub String);
