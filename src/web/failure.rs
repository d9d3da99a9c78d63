//! Errors as answers of the API.

use std::time::Duration;

use axum::Json;
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use utoipa::ToSchema;

use gripcast_base::error::{Error, ErrorKind};

/// What went wrong, as every answer from 400 on tells it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, ToSchema)]
pub(crate) struct Complaint {
    error: ComplaintText,
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize, ToSchema)]
struct ComplaintText {
    /// `input`, `not_found`, `busy`, `unauthorised`, `forbidden`, `failed`.
    kind: &'static str,
    what: String,
    #[serde(rename = "where")]
    place: Option<String>,
    remedy: Option<String>,
}

/// An answer that says no.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Failure {
    status: StatusCode,
    complaint: Complaint,
    retry_after: Option<Duration>,
}

impl Failure {
    /// A failure with what went wrong.
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
            complaint: Complaint {
                error: ComplaintText {
                    kind,
                    what: what.into(),
                    place: None,
                    remedy: None,
                },
            },
            retry_after: None,
        }
    }

    /// Says when to ask again.
    pub(crate) fn retry_after(mut self, wait: Duration) -> Self {
        self.retry_after = Some(wait);
        self
    }

    /// Adds what helps.
    pub(crate) fn remedy(mut self, remedy: impl Into<String>) -> Self {
        self.complaint.error.remedy = Some(remedy.into());
        self
    }

    /// What went wrong.
    pub(crate) fn what(&self) -> &str {
        &self.complaint.error.what
    }

    /// There is nothing of that name.
    pub(crate) fn not_found(what: impl Into<String>) -> Self {
        Self::new(StatusCode::NOT_FOUND, what)
    }

    /// Not now.
    pub(crate) fn busy(what: impl Into<String>) -> Self {
        Self::new(StatusCode::SERVICE_UNAVAILABLE, what)
    }

    /// What the client sent cannot be used.
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
        failure.complaint.error.place = error.location().map(str::to_owned);
        failure.complaint.error.remedy = error.remedy_text().map(str::to_owned);
        failure
    }
}

impl IntoResponse for Failure {
    fn into_response(self) -> Response {
        let wait = self.retry_after.map(|wait| {
            // Whole seconds, rounded up.
            let seconds = wait.as_secs() + u64::from(wait.subsec_nanos() > 0);
            [(header::RETRY_AFTER, seconds.to_string())]
        });
        (self.status, wait, Json(self.complaint)).into_response()
    }
}
