//! The types of armwatch: a robot makes runs, a run has an analysis, analyses yield anomalies. [`text`] makes names and
//! other text from outside safe to show.
//!
//! Angles are in rad, positions in m, torques in Nm, times in s; joints count from 0 ([`robot::JointIndex`]).

mod named_enum;

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

/// Implements `Deserialize` for types with a list `ALL` and a `name`: the counterpart of [`serialize_by_name`].
#[macro_export]
macro_rules! deserialize_by_name {
    ($($named:ty),* $(,)?) => {
        $(impl<'de> ::serde::Deserialize<'de> for $named {
            fn deserialize<D: ::serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
                let name = <String as ::serde::Deserialize>::deserialize(deserializer)?;
                let found = Self::ALL.into_iter().find(|of| of.name() == name);
                found.ok_or_else(|| ::serde::de::Error::custom(format!("unknown name {name}")))
            }
        })*
    };
}

pub mod robot;
pub mod run;
pub mod analysis;
pub mod anomaly;
pub mod text;
