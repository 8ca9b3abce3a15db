//! Values of rows that are not decoded yet.

use std::borrow::Cow;

use sqlx::postgres::{PgValue, PgValueRef};
use sqlx::sqlite::{SqliteValue, SqliteValueRef};
use sqlx::{Value, ValueRef};

use super::name::Engine;
use super::type_info::EngineTypeInfo;

/// An owned value.
pub(crate) enum EngineValue {
    Sqlite(SqliteValue),
    Postgres(PgValue),
}

impl Value for EngineValue {
    type Database = Engine;

    fn as_ref(&self) -> EngineValueRef<'_> {
        match self {
            Self::Sqlite(value) => EngineValueRef::Sqlite(value.as_ref()),
            Self::Postgres(value) => EngineValueRef::Postgres(value.as_ref()),
        }
    }

    fn type_info(&self) -> Cow<'_, EngineTypeInfo> {
        Cow::Owned(match self {
            Self::Sqlite(value) => EngineTypeInfo::Sqlite(value.type_info().into_owned()),
            Self::Postgres(value) => EngineTypeInfo::Postgres(value.type_info().into_owned()),
        })
    }

    fn is_null(&self) -> bool {
        match self {
            Self::Sqlite(value) => value.is_null(),
            Self::Postgres(value) => value.is_null(),
        }
    }
}

/// A value of a row.
pub(crate) enum EngineValueRef<'r> {
    Sqlite(SqliteValueRef<'r>),
    Postgres(PgValueRef<'r>),
}

impl<'r> ValueRef<'r> for EngineValueRef<'r> {
    type Database = Engine;

    fn to_owned(&self) -> EngineValue {
        match self {
            Self::Sqlite(value) => EngineValue::Sqlite(ValueRef::to_owned(value)),
            Self::Postgres(value) => EngineValue::Postgres(ValueRef::to_owned(value)),
        }
    }

    fn type_info(&self) -> Cow<'_, EngineTypeInfo> {
        Cow::Owned(match self {
            Self::Sqlite(value) => EngineTypeInfo::Sqlite(value.type_info().into_owned()),
            Self::Postgres(value) => EngineTypeInfo::Postgres(value.type_info().into_owned()),
        })
    }

    fn is_null(&self) -> bool {
        match self {
            Self::Sqlite(value) => value.is_null(),
            Self::Postgres(value) => value.is_null(),
        }
    }
}
