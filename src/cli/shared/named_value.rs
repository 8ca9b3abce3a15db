//! Options whose values are the names of a closed list.

use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};

/// Parses the name of one of `all`. `help` explains a value; it is empty if the name is self-explanatory.
pub(in crate::cli) fn one_of<T: Copy + Send + Sync + 'static, const N: usize>(
    all: [T; N],
    name: fn(T) -> &'static str,
    help: fn(T) -> &'static str,
) -> impl TypedValueParser<Value = T> {
    let value = move |of: T| match help(of) {
        "" => PossibleValue::new(name(of)),
        help => PossibleValue::new(name(of)).help(help),
    };
    PossibleValuesParser::new(all.map(value))
        .try_map(move |text| all.into_iter().find(|of| name(*of) == text).ok_or("no such name"))
}

/// Explains no value.
pub(in crate::cli) fn plain<T>(_: T) -> &'static str {
    ""
}
