//! Values of rows, not decoded yet.

use std::borrow::Cow;

use sqlx::postgres::{PgValue, PgValueRef};
use sqlx::sqlite::{SqliteValue, SqliteValueRef};
use sqlx::{Value, ValueRef};

use super::name::Either;
use super::type_info::EitherTypeInfo;

/// A value that belongs to nobody else.
pub(crate) enum EitherValue {
    Sqlite(SqliteValue),
    Postgres(PgValue),
}

impl Value for EitherValue {
    type Database = Either;

    fn as_ref(&self) -> EitherValueRef<'_> {
        match self {
            Self::Sqlite(value) => EitherValueRef::Sqlite(value.as_ref()),
            Self::Postgres(value) => EitherValueRef::Postgres(value.as_ref()),
        }
    }

    fn type_info(&self) -> Cow<'_, EitherTypeInfo> {
        Cow::Owned(match self {
            Self::Sqlite(value) => EitherTypeInfo::Sqlite(value.type_info().into_owned()),
            Self::Postgres(value) => EitherTypeInfo::Postgres(value.type_info().into_owned()),
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
pub(crate) enum EitherValueRef<'r> {
    Sqlite(SqliteValueRef<'r>),
    Postgres(PgValueRef<'r>),
}

impl<'r> ValueRef<'r> for EitherValueRef<'r> {
    type Database = Either;

    fn to_owned(&self) -> EitherValue {
        match self {
            Self::Sqlite(value) => EitherValue::Sqlite(ValueRef::to_owned(value)),
            Self::Postgres(value) => EitherValue::Postgres(ValueRef::to_owned(value)),
        }
    }

    fn type_info(&self) -> Cow<'_, EitherTypeInfo> {
        Cow::Owned(match self {
            Self::Sqlite(value) => EitherTypeInfo::Sqlite(value.type_info().into_owned()),
            Self::Postgres(value) => EitherTypeInfo::Postgres(value.type_info().into_owned()),
        })
    }

    fn is_null(&self) -> bool {
        match self {
            Self::Sqlite(value) => value.is_null(),
            Self::Postgres(value) => value.is_null(),
        }
    }
}
