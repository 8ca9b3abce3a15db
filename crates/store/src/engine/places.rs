//! Several values for the places of a statement at once, and statements without an answer.

use std::fmt::Display;

use sqlx::Type;
use sqlx::encode::Encode;
use sqlx::query::{Query, QueryAs, QueryScalar};
use sqlx::query_builder::Separated;

use super::{Engine, EngineArguments, EngineExecutor};

/// A value for a place of a statement, which may borrow for `'q`.
pub(crate) trait Bindable<'q>: 'q + Encode<'q, Engine> + Type<Engine> {}

impl<'q, T: 'q + Encode<'q, Engine> + Type<Engine>> Bindable<'q> for T {}

/// A statement, or a row of one, whose places take values.
pub(crate) trait Bind<'q>: Sized {
    /// Gives the next place a value.
    fn bind_next(self, value: impl Bindable<'q>) -> Self;

    /// Gives the next places the values of a tuple.
    fn bind_all(self, values: impl BindableTuple<'q>) -> Self {
        values.bind_to(self)
    }
}

/// A tuple of values for places that follow each other.
pub(crate) trait BindableTuple<'q> {
    fn bind_to<B: Bind<'q>>(self, places: B) -> B;
}

macro_rules! tuples_are_values {
    ($($name:ident)*) => {
        impl<'q, $($name: Bindable<'q>),*> BindableTuple<'q> for ($($name,)*) {
            #[expect(non_snake_case, reason = "a value has the name of its type")]
            fn bind_to<B: Bind<'q>>(self, places: B) -> B {
                let ($($name,)*) = self;
                places$(.bind_next($name))*
            }
        }
    };
}

tuples_are_values!(V1 V2);
tuples_are_values!(V1 V2 V3);
tuples_are_values!(V1 V2 V3 V4);
tuples_are_values!(V1 V2 V3 V4 V5);
tuples_are_values!(V1 V2 V3 V4 V5 V6);
tuples_are_values!(V1 V2 V3 V4 V5 V6 V7);
tuples_are_values!(V1 V2 V3 V4 V5 V6 V7 V8);

impl<'q> Bind<'q> for Query<'_, Engine, EngineArguments> {
    fn bind_next(self, value: impl Bindable<'q>) -> Self {
        self.bind(value)
    }
}

impl<'q, O> Bind<'q> for QueryAs<'q, Engine, O, EngineArguments> {
    fn bind_next(self, value: impl Bindable<'q>) -> Self {
        self.bind(value)
    }
}

impl<'q, O> Bind<'q> for QueryScalar<'q, Engine, O, EngineArguments> {
    fn bind_next(self, value: impl Bindable<'q>) -> Self {
        self.bind(value)
    }
}

impl<'q, S: Display> Bind<'q> for &mut Separated<'_, Engine, S> {
    fn bind_next(self, value: impl Bindable<'q>) -> Self {
        self.push_bind(value)
    }
}

/// A statement without an answer.
pub(crate) trait Run {
    /// Executes the statement; the number of changed rows is of no interest.
    async fn run<'c>(self, executor: impl EngineExecutor<'c>) -> sqlx::Result<()>;
}

impl Run for Query<'_, Engine, EngineArguments> {
    async fn run<'c>(self, executor: impl EngineExecutor<'c>) -> sqlx::Result<()> {
        self.execute(executor).await.map(drop)
    }
}

/// Reads rows into a type whose fields are the columns of the same names.
macro_rules! row_of {
    ($name:ident { $($field:ident),+ }) => {
        impl ::sqlx::FromRow<'_, $crate::engine::EngineRow> for $name {
            fn from_row(row: &$crate::engine::EngineRow) -> ::sqlx::Result<Self> {
                Ok(Self { $($field: ::sqlx::Row::try_get(row, stringify!($field))?),+ })
            }
        }
    };
}

pub(crate) use row_of;
