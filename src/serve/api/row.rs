//! A row of a view in an answer.

use axum::http::StatusCode;
use serde::Serialize;
use serde_json::{Map, Value};
use utoipa::openapi::RefOr;
use utoipa::openapi::schema::{AdditionalProperties, Object, ObjectBuilder, Schema, SchemaType, Type};
use utoipa::{PartialSchema, ToSchema};

use crate::language::{Language, finding};
use crate::serve::answer::Refusal;

/// A value for each column of the view, by its name.
#[derive(Debug, Clone, Serialize)]
#[serde(transparent)]
pub struct ViewRow(pub Map<String, Value>);

impl ViewRow {
    /// An object as a row; `None` for any other value.
    pub fn of(value: Value) -> Option<Self> {
        match value {
            Value::Object(columns) => Some(Self(columns)),
            _ => None,
        }
    }

    /// The row with what detectors wrote in a language: messages, reasons and the causes that were compared.
    #[must_use]
    pub fn in_language(mut self, language: Language) -> Self {
        for column in ["message", "reason"] {
            if let Some(Value::String(text)) = self.0.get_mut(column) {
                *text = finding(language, text).into_owned();
            }
        }
        if let Some(Value::String(text)) = self.0.get_mut("alternatives")
            && let Ok(mut causes) = serde_json::from_str::<Value>(text)
        {
            for cause in causes.as_array_mut().into_iter().flatten() {
                if let Some(Value::String(cause)) = cause.get_mut("cause") {
                    *cause = finding(language, cause).into_owned();
                }
            }
            *text = causes.to_string();
        }
        self
    }

    /// The text of a column, where it has one.
    pub fn maybe(&self, column: &str) -> Option<String> {
        self.0.get(column)?.as_str().map(str::to_owned)
    }

    /// The number of a column, where it has one.
    pub fn number(&self, column: &str) -> Option<f64> {
        self.0.get(column)?.as_f64()
    }

    /// The whole number of a column, 0 where it has none.
    pub fn whole(&self, column: &str) -> i64 {
        self.0.get(column).and_then(Value::as_i64).unwrap_or_default()
    }

    /// The text of a column, empty where it has none.
    pub fn text(&self, column: &str) -> &str {
        self.0.get(column).and_then(Value::as_str).unwrap_or_default()
    }
}

/// The language that a request asks for.
pub fn language(code: &str) -> Result<Language, Refusal> {
    Language::ALL.into_iter().find(|language| language.code() == code).ok_or_else(|| {
        let codes = Language::ALL.map(Language::code).join(", ");
        Refusal::new(StatusCode::BAD_REQUEST, format!("language = {code}: give one of {codes}"))
    })
}

impl PartialSchema for ViewRow {
    fn schema() -> RefOr<Schema> {
        let cell = Object::builder()
            .schema_type(SchemaType::from_iter([Type::Null, Type::Number, Type::String]))
            .description(Some("null, a number or a text; bytes are hexadecimal digits"));
        ObjectBuilder::new()
            .description(Some("A value for each column of the view, by its name (docs/schema.md)"))
            .additional_properties(Some(AdditionalProperties::RefOr(RefOr::T(Schema::Object(cell.build())))))
            .into()
    }
}

impl ToSchema for ViewRow {}
