//! Error responses of the API.

use std::time::Duration;

use axum::Json;
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use utoipa::ToSchema;

use gripcast_base::error::{Error, ErrorKind};

/// Body of every response with a status of 400 or above.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, ToSchema)]
pub(crate) struct ErrorResponse {
    error: ErrorDetail,
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize, ToSchema)]
struct ErrorDetail {
    /// `input`, `not_found`, `busy`, `unauthorised`, `forbidden`, `failed`.
    kind: &'static str,
    what: String,
    #[serde(rename = "where")]
    location: Option<String>,
    remedy: Option<String>,
}

/// A failed request.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Failure {
    status: StatusCode,
    body: ErrorResponse,
    retry_after: Option<Duration>,
}

impl Failure {
    /// Creates a failure with a description.
    pub(crate) fn new(status: StatusCode, what: impl Into<String>) -> Self {
        let kind = match status {
            StatusCode::BAD_REQUEST
            | StatusCode::UNPROCESSABLE_ENTITY
            | StatusCode::PAYLOAD_TOO_LARGE
            | StatusCode::UNSUPPORTED_MEDIA_TYPE
            | StatusCode::REQUEST_TIMEOUT => "input",
            StatusCode::NOT_FOUND | StatusCode::METHOD_NOT_ALLOWED => "not_found",
            StatusCode::UNAUTHORIZED => "unauthorised",
            StatusCode::FORBIDDEN | StatusCode::MISDIRECTED_REQUEST => "forbidden",
            StatusCode::SERVICE_UNAVAILABLE
            | StatusCode::CONFLICT
            | StatusCode::TOO_MANY_REQUESTS => "busy",
            _ => "failed",
        };
        Self {
            status,
            body: ErrorResponse {
                error: ErrorDetail {
                    kind,
                    what: what.into(),
                    location: None,
                    remedy: None,
                },
            },
            retry_after: None,
        }
    }

    /// Sets the delay after which to retry.
    pub(crate) fn retry_after(mut self, wait: Duration) -> Self {
        self.retry_after = Some(wait);
        self
    }

    /// Sets the remedy.
    pub(crate) fn remedy(mut self, remedy: impl Into<String>) -> Self {
        self.body.error.remedy = Some(remedy.into());
        self
    }

    /// Returns the description.
    pub(crate) fn what(&self) -> &str {
        &self.body.error.what
    }

    /// Creates a "not found" failure.
    pub(crate) fn not_found(what: impl Into<String>) -> Self {
        Self::new(StatusCode::NOT_FOUND, what)
    }

    /// Creates a "busy" failure.
    pub(crate) fn busy(what: impl Into<String>) -> Self {
        Self::new(StatusCode::SERVICE_UNAVAILABLE, what)
    }

    /// Creates an "invalid input" failure.
    pub(crate) fn input(what: impl Into<String>) -> Self {
        Self::new(StatusCode::UNPROCESSABLE_ENTITY, what)
    }
}

impl From<Error> for Failure {
    fn from(error: Error) -> Self {
        let status = match error.kind() {
            ErrorKind::NotFound => StatusCode::NOT_FOUND,
            ErrorKind::Input | ErrorKind::Usage | ErrorKind::Config => {
                StatusCode::UNPROCESSABLE_ENTITY
            }
            ErrorKind::Busy => StatusCode::SERVICE_UNAVAILABLE,
            _ => StatusCode::INTERNAL_SERVER_ERROR,
        };
        let mut failure = Self::new(status, error.what());
        failure.body.error.location = error.location().map(str::to_owned);
        failure.body.error.remedy = error.remedy_text().map(str::to_owned);
        failure
    }
}

impl IntoResponse for Failure {
    fn into_response(self) -> Response {
        let retry_after = self.retry_after.map(|wait| {
            // Whole seconds, rounded up.
            let seconds = wait.as_secs() + u64::from(wait.subsec_nanos() > 0);
            [(header::RETRY_AFTER, seconds.to_string())]
        });
        (self.status, retry_after, Json(self.body)).into_response()
    }
}
