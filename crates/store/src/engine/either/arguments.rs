//! Values bound to the places of a statement, before the engine is known.

use std::fmt::{self, Write};

use sqlx::encode::{Encode, IsNull};
use sqlx::error::BoxDynError;
use sqlx::postgres::PgArguments;
use sqlx::sqlite::SqliteArguments;
use sqlx::{Arguments, Type};

use super::name::Engine;
use super::type_info::{EngineTypeInfo, ValueKind};

/// A value, or NULL of a type: PostgreSQL needs the type of every place when it prepares a statement.
#[derive(Debug)]
pub(crate) enum Argument {
    Flag(Option<bool>),
    Integer(Option<i64>),
    Real(Option<f64>),
    Text(Option<String>),
    Blob(Option<Vec<u8>>),
}

impl Argument {
    fn null(kind: ValueKind) -> Self {
        match kind {
            ValueKind::Flag => Self::Flag(None),
            ValueKind::Integer => Self::Integer(None),
            ValueKind::Real => Self::Real(None),
            ValueKind::Text => Self::Text(None),
            ValueKind::Blob => Self::Blob(None),
        }
    }
}

/// Values in the order of their places.
#[derive(Debug, Default)]
pub(crate) struct EngineArguments(Vec<Argument>);

impl EngineArguments {
    pub(super) fn into_sqlite(self) -> Result<SqliteArguments, BoxDynError> {
        let mut arguments = SqliteArguments::default();
        arguments.reserve(self.0.len(), 0);
        for argument in self.0 {
            match argument {
                Argument::Flag(value) => arguments.add(value)?,
                Argument::Integer(value) => arguments.add(value)?,
                Argument::Real(value) => arguments.add(value)?,
                Argument::Text(value) => arguments.add(value)?,
                Argument::Blob(value) => arguments.add(value)?,
            }
        }
        Ok(arguments)
    }

    pub(super) fn into_postgres(self) -> Result<PgArguments, BoxDynError> {
        let mut arguments = PgArguments::default();
        for argument in self.0 {
            match argument {
                Argument::Flag(value) => Arguments::add(&mut arguments, value)?,
                Argument::Integer(value) => Arguments::add(&mut arguments, value)?,
                Argument::Real(value) => Arguments::add(&mut arguments, value)?,
                Argument::Text(value) => Arguments::add(&mut arguments, value.map(without_nul))?,
                Argument::Blob(value) => Arguments::add(&mut arguments, value)?,
            }
        }
        Ok(arguments)
    }
}

/// Replaces each character 0, which damaged exports contain and PostgreSQL's texts cannot, by the replacement
/// character.
fn without_nul(text: String) -> String {
    if text.contains('\0') { text.replace('\0', "\u{fffd}") } else { text }
}

impl Arguments for EngineArguments {
    type Database = Engine;

    fn reserve(&mut self, additional: usize, _size: usize) {
        self.0.reserve(additional);
    }

    fn add<'t, T>(&mut self, value: T) -> Result<(), BoxDynError>
    where
        T: Encode<'t, Engine> + Type<Engine>,
    {
        let type_info = value.produces().unwrap_or_else(T::type_info);
        if let IsNull::Yes = value.encode(&mut self.0)? {
            let EngineTypeInfo::Own(kind) = type_info else {
                return Err("a NULL of a type that the store does not use".into());
            };
            self.0.push(Argument::null(kind));
        }
        Ok(())
    }

    fn len(&self) -> usize {
        self.0.len()
    }

    fn format_placeholder<W: Write>(&self, writer: &mut W) -> fmt::Result {
        write!(writer, "${}", self.0.len())
    }
}

sqlx_core::impl_into_arguments_for_arguments!(EngineArguments);
