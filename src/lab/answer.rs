//! What the server answers: JSON, bytes, or a refusal in words.

use axum::body::Body;
use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde_json::{Value, json};

use crate::Error;

/// A refusal: what was expected, what was found, what to do.
#[derive(Clone, Debug)]
pub struct Refusal {
    status: StatusCode,
    words: String,
    more: Value,
}

/// What work comes to.
pub type Answer = Result<Value, Refusal>;

impl Refusal {
    /// A request that cannot be served as it is.
    pub fn bad(words: impl Into<String>) -> Self {
        Self::new(StatusCode::BAD_REQUEST, words)
    }

    /// Something that is not there.
    pub fn missing(words: impl Into<String>) -> Self {
        Self::new(StatusCode::NOT_FOUND, words)
    }

    /// Something that stands in the way and that the person can decide about.
    pub fn conflict(words: impl Into<String>) -> Self {
        Self::new(StatusCode::CONFLICT, words)
    }

    /// With any status.
    pub fn new(status: StatusCode, words: impl Into<String>) -> Self {
        Self { status, words: words.into(), more: Value::Null }
    }

    /// With something for the page to work with.
    pub fn with(mut self, more: Value) -> Self {
        self.more = more;
        self
    }

    /// A newer request took the place of this one.
    pub fn replaced() -> Self {
        Self::conflict("a newer request took its place").with(json!({ "replaced": true }))
    }

    /// Ended by the person.
    pub fn cancelled() -> Self {
        Self::conflict("cancelled; everything is as it was before").with(json!({ "cancelled": true }))
    }

    /// With the name of a file in place of where it lies.
    pub fn hiding(mut self, path: &std::path::Path, name: &str) -> Self {
        self.words = self.words.replace(&path.display().to_string(), name);
        self
    }

    /// In words.
    #[cfg(test)]
    pub fn words(&self) -> &str {
        &self.words
    }
}

impl<E: Into<Error>> From<E> for Refusal {
    fn from(error: E) -> Self {
        let error: Error = error.into();
        let lines: Vec<String> = error.to_string().lines().map(|l| l.trim().to_string()).collect();
        Self::bad(lines.join(" "))
    }
}

impl IntoResponse for Refusal {
    fn into_response(self) -> Response {
        let mut body = json!({ "error": self.words });
        if let (Some(body), Value::Object(more)) = (body.as_object_mut(), self.more) {
            body.extend(more);
        }
        (self.status, axum::Json(body)).into_response()
    }
}

/// Bytes of a kind.
pub fn bytes(kind: &'static str, bytes: impl Into<Body>) -> Response {
    ([(header::CONTENT_TYPE, HeaderValue::from_static(kind))], bytes.into()).into_response()
}

/// A file for the browser to keep, under a plain name.
pub fn file(name: &str, kind: &'static str, text: String) -> Response {
    let safe = |c: char| c.is_ascii_alphanumeric() || matches!(c, '.' | '-' | '_');
    let name: String = name.chars().map(|c| if safe(c) { c } else { '_' }).collect();
    let mut response = bytes(kind, text);
    if let Ok(value) = HeaderValue::from_str(&format!("attachment; filename=\"{name}\"")) {
        response.headers_mut().insert(header::CONTENT_DISPOSITION, value);
    }
    response
}
