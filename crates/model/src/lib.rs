//! The nouns of armwatch: a robot makes runs, a run has an analysis, analyses yield anomalies. [`text`] makes names and
//! other text from outside safe to show.
//!
//! Angles are in rad, positions in m, torques in Nm, times in s; joints count from 0 ([`robot::JointIndex`]).

/// Implements `Serialize` for types with a `name`, so that JSON has the names of the views.
#[macro_export]
macro_rules! serialize_by_name {
    ($($named:ty),* $(,)?) => {
        $(impl ::serde::Serialize for $named {
            fn serialize<S: ::serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
                serializer.serialize_str(self.name())
            }
        })*
    };
}

pub mod robot;
pub mod run;
pub mod analysis;
pub mod anomaly;
pub mod text;
