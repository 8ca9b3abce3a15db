//! Types of values.

use std::fmt;

use sqlx::TypeInfo;
use sqlx::postgres::PgTypeInfo;
use sqlx::sqlite::SqliteTypeInfo;

/// Kinds of the store's values, independent of the engine.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum ValueKind {
    Flag,
    Integer,
    Real,
    Text,
    Blob,
}

impl ValueKind {
    fn name(self) -> &'static str {
        match self {
            Self::Flag => "BOOLEAN",
            Self::Integer => "INTEGER",
            Self::Real => "REAL",
            Self::Text => "TEXT",
            Self::Blob => "BLOB",
        }
    }
}

/// The type of a value: that of an engine, or that of a value of the program.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum EngineTypeInfo {
    Own(ValueKind),
    Sqlite(SqliteTypeInfo),
    Postgres(PgTypeInfo),
}

impl EngineTypeInfo {
    /// Kind of a value of this type of PostgreSQL; `None` for one that the store does not use.
    pub(super) fn kind_of_postgres(of: &PgTypeInfo) -> Option<ValueKind> {
        match of.name() {
            "BOOL" => Some(ValueKind::Flag),
            "INT2" | "INT4" | "INT8" => Some(ValueKind::Integer),
            "FLOAT4" | "FLOAT8" => Some(ValueKind::Real),
            "TEXT" | "VARCHAR" | "CHAR" | "BPCHAR" | "NAME" | "UNKNOWN" => Some(ValueKind::Text),
            "BYTEA" => Some(ValueKind::Blob),
            _ => None,
        }
    }
}

impl fmt::Display for EngineTypeInfo {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl TypeInfo for EngineTypeInfo {
    fn is_null(&self) -> bool {
        match self {
            Self::Own(_) => false,
            Self::Sqlite(of) => of.is_null(),
            Self::Postgres(of) => of.is_null(),
        }
    }

    /// Name as in SQLite.
    fn name(&self) -> &str {
        match self {
            Self::Own(kind) => kind.name(),
            Self::Sqlite(of) => of.name(),
            Self::Postgres(of) => match Self::kind_of_postgres(of) {
                Some(kind) => kind.name(),
                None => of.name(),
            },
        }
    }
}
