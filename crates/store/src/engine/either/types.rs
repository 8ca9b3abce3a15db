//! Rust's types as values of either engine.

use sqlx::encode::{Encode, IsNull};
use sqlx::error::BoxDynError;
use sqlx::postgres::{PgTypeInfo, PgValueRef, Postgres};
use sqlx::sqlite::Sqlite;
use sqlx::{Decode, Type, TypeInfo, ValueRef};

use super::arguments::Argument;
use super::name::Engine;
use super::type_info::{EngineTypeInfo, ValueKind};
use super::value::EngineValueRef;

/// True if a value of a type can be read as `T`; `kinds` are those of PostgreSQL.
fn compatible<T: Type<Sqlite>>(of: &EngineTypeInfo, kinds: &[ValueKind]) -> bool {
    match of {
        EngineTypeInfo::Own(kind) => kinds.contains(kind),
        EngineTypeInfo::Sqlite(of) => T::compatible(of),
        EngineTypeInfo::Postgres(of) => {
            EngineTypeInfo::kind_of_postgres(of).is_some_and(|kind| kinds.contains(&kind))
        }
    }
}

/// An integer of PostgreSQL, of any width; a truth value is 0 or 1, as in SQLite.
fn integer(value: PgValueRef<'_>) -> Result<i64, BoxDynError> {
    match EngineTypeInfo::kind_of_postgres(&value.type_info()) {
        Some(ValueKind::Flag) => <bool as Decode<Postgres>>::decode(value).map(i64::from),
        _ => <i64 as Decode<Postgres>>::decode(value),
    }
}

macro_rules! integers {
    ($($type:ty),*) => {$(
        impl Type<Engine> for $type {
            fn type_info() -> EngineTypeInfo {
                EngineTypeInfo::Own(ValueKind::Integer)
            }

            fn compatible(of: &EngineTypeInfo) -> bool {
                compatible::<Self>(of, &[ValueKind::Integer])
            }
        }

        impl Encode<'_, Engine> for $type {
            fn encode_by_ref(&self, buffer: &mut Vec<Argument>) -> Result<IsNull, BoxDynError> {
                buffer.push(Argument::Integer(Some(i64::from(*self))));
                Ok(IsNull::No)
            }
        }

        impl<'r> Decode<'r, Engine> for $type {
            fn decode(value: EngineValueRef<'r>) -> Result<Self, BoxDynError> {
                match value {
                    EngineValueRef::Sqlite(value) => <Self as Decode<Sqlite>>::decode(value),
                    EngineValueRef::Postgres(value) => Ok(Self::try_from(integer(value)?)?),
                }
            }
        }
    )*};
}

integers!(i8, i16, i32, i64, u8, u16, u32);

// read only: no column is wide enough for all of them
impl Type<Engine> for u64 {
    fn type_info() -> EngineTypeInfo {
        EngineTypeInfo::Own(ValueKind::Integer)
    }

    fn compatible(of: &EngineTypeInfo) -> bool {
        compatible::<Self>(of, &[ValueKind::Integer])
    }
}

impl<'r> Decode<'r, Engine> for u64 {
    fn decode(value: EngineValueRef<'r>) -> Result<Self, BoxDynError> {
        match value {
            EngineValueRef::Sqlite(value) => <Self as Decode<Sqlite>>::decode(value),
            EngineValueRef::Postgres(value) => Ok(Self::try_from(integer(value)?)?),
        }
    }
}

impl Type<Engine> for bool {
    fn type_info() -> EngineTypeInfo {
        EngineTypeInfo::Own(ValueKind::Flag)
    }

    fn compatible(of: &EngineTypeInfo) -> bool {
        compatible::<Self>(of, &[ValueKind::Flag, ValueKind::Integer])
    }
}

impl Encode<'_, Engine> for bool {
    fn encode_by_ref(&self, buffer: &mut Vec<Argument>) -> Result<IsNull, BoxDynError> {
        buffer.push(Argument::Flag(Some(*self)));
        Ok(IsNull::No)
    }
}

impl<'r> Decode<'r, Engine> for bool {
    fn decode(value: EngineValueRef<'r>) -> Result<Self, BoxDynError> {
        match value {
            EngineValueRef::Sqlite(value) => <Self as Decode<Sqlite>>::decode(value),
            EngineValueRef::Postgres(value) => Ok(integer(value)? != 0),
        }
    }
}

impl Type<Engine> for f64 {
    fn type_info() -> EngineTypeInfo {
        EngineTypeInfo::Own(ValueKind::Real)
    }

    fn compatible(of: &EngineTypeInfo) -> bool {
        compatible::<Self>(of, &[ValueKind::Real])
    }
}

impl Encode<'_, Engine> for f64 {
    fn encode_by_ref(&self, buffer: &mut Vec<Argument>) -> Result<IsNull, BoxDynError> {
        buffer.push(Argument::Real(Some(*self)));
        Ok(IsNull::No)
    }
}

impl<'r> Decode<'r, Engine> for f64 {
    fn decode(value: EngineValueRef<'r>) -> Result<Self, BoxDynError> {
        match value {
            EngineValueRef::Sqlite(value) => <Self as Decode<Sqlite>>::decode(value),
            EngineValueRef::Postgres(value) if value.type_info().name() == "FLOAT4" => {
                <f32 as Decode<Postgres>>::decode(value).map(Self::from)
            }
            EngineValueRef::Postgres(value) => <Self as Decode<Postgres>>::decode(value),
        }
    }
}

/// Texts and bytes: the type, its argument, and its kind.
macro_rules! sequences {
    ($($type:ty, $kind:ident, $owned:expr;)*) => {$(
        impl Encode<'_, Engine> for $type {
            fn encode_by_ref(&self, buffer: &mut Vec<Argument>) -> Result<IsNull, BoxDynError> {
                let owned: fn(&$type) -> _ = $owned;
                buffer.push(Argument::$kind(Some(owned(self))));
                Ok(IsNull::No)
            }
        }
    )*};
}

sequences! {
    &'_ str, Text, |text| (*text).to_owned();
    &'_ [u8], Blob, |bytes| bytes.to_vec();
}

macro_rules! owned {
    ($($type:ty, $kind:ident;)*) => {$(
        impl Encode<'_, Engine> for $type {
            fn encode(self, buffer: &mut Vec<Argument>) -> Result<IsNull, BoxDynError> {
                buffer.push(Argument::$kind(Some(self)));
                Ok(IsNull::No)
            }

            fn encode_by_ref(&self, buffer: &mut Vec<Argument>) -> Result<IsNull, BoxDynError> {
                buffer.push(Argument::$kind(Some(self.clone())));
                Ok(IsNull::No)
            }
        }
    )*};
}

owned! {
    String, Text;
    Vec<u8>, Blob;
}

macro_rules! types {
    ($($type:ty, $kind:ident;)*) => {$(
        impl Type<Engine> for $type {
            fn type_info() -> EngineTypeInfo {
                EngineTypeInfo::Own(ValueKind::$kind)
            }

            fn compatible(of: &EngineTypeInfo) -> bool {
                match of {
                    EngineTypeInfo::Sqlite(of) => <$type as Type<Sqlite>>::compatible(of),
                    EngineTypeInfo::Own(kind) => *kind == ValueKind::$kind,
                    EngineTypeInfo::Postgres(of) => {
                        EngineTypeInfo::kind_of_postgres(of) == Some(ValueKind::$kind)
                    }
                }
            }
        }
    )*};
}

types! {
    str, Text;
    String, Text;
    [u8], Blob;
    Vec<u8>, Blob;
}

macro_rules! decoded {
    ($($type:ty),*) => {$(
        impl<'r> Decode<'r, Engine> for $type {
            fn decode(value: EngineValueRef<'r>) -> Result<Self, BoxDynError> {
                match value {
                    EngineValueRef::Sqlite(value) => <$type as Decode<'r, Sqlite>>::decode(value),
                    EngineValueRef::Postgres(value) => {
                        refuse_unknown(&value.type_info())?;
                        <$type as Decode<'r, Postgres>>::decode(value)
                    }
                }
            }
        }
    )*};
}

decoded!(&'r str, String, &'r [u8], Vec<u8>);

/// Refuses a value of another type, whose bytes from the server are no text.
fn refuse_unknown(of: &PgTypeInfo) -> Result<(), BoxDynError> {
    match EngineTypeInfo::kind_of_postgres(of) {
        Some(_) => Ok(()),
        None => {
            Err(format!("a column of type {}, which is not supported; cast it to text", of.name()).into())
        }
    }
}

sqlx_core::impl_encode_for_option!(Engine);
