//! The receivers of routes, one file each: settings, their reader, the target and the secrets.

mod alertmanager;
mod command;
mod email;
mod log;
mod mqtt;
mod shared;
mod webhook;

pub use self::alertmanager::AlertmanagerSettings;
pub use self::command::CommandSettings;
pub use self::email::EmailSettings;
pub use self::log::LogSettings;
pub use self::mqtt::MqttSettings;
pub use self::shared::{Address, Encryption, HttpLogin, Secret, ServerSettings};
pub use self::webhook::WebhookSettings;

use crate::toml::table::{Table, Value};

/// Settings of one kind of receiver.
trait ReceiverKind: Sized {
    /// Reads the table; `None` after a problem.
    fn read(table: &Table<'_>) -> Option<Self>;

    /// Target of messages, without secrets.
    fn target(&self) -> String;

    /// The secrets that the receiver needs.
    fn secrets(&self) -> Vec<&Secret> {
        Vec::new()
    }
}

/// Declares the receivers, one per row: variant, key of its table, settings.
macro_rules! receivers {
    ($($variant:ident $name:literal $settings:ident;)*) => {
        const NAMES: &[&str] = &[$($name),*];

        /// Settings of the receiver of a route.
        #[derive(Debug, Clone, PartialEq, Eq)]
        pub enum ReceiverSettings {
            $(#[doc = concat!("`[alerts.route.", $name, "]`.")] $variant($settings),)*
        }

        impl ReceiverSettings {
            fn read(name: &str, table: &Table<'_>) -> Option<Self> {
                match name {
                    $($name => $settings::read(table).map(Self::$variant),)*
                    _ => None,
                }
            }

            /// Name in the configuration.
            pub fn name(&self) -> &'static str {
                match self {
                    $(Self::$variant(_) => $name,)*
                }
            }

            /// Target of messages, without secrets.
            pub fn target(&self) -> String {
                match self {
                    $(Self::$variant(settings) => settings.target(),)*
                }
            }

            /// The secrets that the receiver needs.
            pub fn secrets(&self) -> Vec<&Secret> {
                match self {
                    $(Self::$variant(settings) => settings.secrets(),)*
                }
            }
        }
    };
}

receivers! {
    Log "log" LogSettings;
    Webhook "webhook" WebhookSettings;
    Alertmanager "alertmanager" AlertmanagerSettings;
    Email "email" EmailSettings;
    Mqtt "mqtt" MqttSettings;
    Command "command" CommandSettings;
}

/// The one receiver of a route; `None` after a problem.
pub(super) fn read_receiver(route: &Table<'_>) -> Option<ReceiverSettings> {
    let mut found: Vec<(&str, Value<'_>)> =
        NAMES.iter().filter_map(|name| Some((*name, route.optional(name)?))).collect();
    if found.len() > 1 {
        let (first, _) = found[0];
        for (_, value) in &found[1..] {
            let hint = "give each receiver its own route".to_owned();
            value.refuse(format!("the route already has the receiver {first}"), Some(hint));
        }
        return None;
    }
    let Some((name, value)) = found.pop() else {
        let hint = format!("write one of [alerts.route.{}]", NAMES.join("], [alerts.route."));
        route.refuse("has no receiver".into(), Some(hint));
        return None;
    };
    ReceiverSettings::read(name, &value.table()?)
}
