//! A severity as it is typed.

use clap::builder::{PossibleValuesParser, TypedValueParser};

use armwatch_model::anomaly::Severity;

/// Takes the names of severities.
pub(super) fn severity() -> impl TypedValueParser<Value = Severity> {
    PossibleValuesParser::new(Severity::ALL.map(Severity::name)).try_map(|name| {
        Severity::ALL.into_iter().find(|severity| severity.name() == name).ok_or("no severity of this name")
    })
}
