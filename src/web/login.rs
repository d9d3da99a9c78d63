//! Login and logout of browsers.

use std::sync::Arc;

use axum::extract::State as Shared;
use axum::http::{HeaderMap, StatusCode, header};
use axum::{Extension, Json};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::access::{Authorisation, Peer};
use super::backend::Backend;
use super::commands::Body;
use super::failure::{ErrorResponse, Failure};

/// Login with a token.
#[derive(Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct Login {
    token: String,
}

/// Whether a login is required and present.
#[derive(Serialize, ToSchema)]
pub(crate) struct LoginState {
    /// Whether the daemon has a token.
    needs_token: bool,
    /// Whether the request has the cookie of an open session.
    logged_in: bool,
}

/// Login state of this browser
#[utoipa::path(get, path = "/api/login", tag = "daemon", responses((status = 200, body = LoginState)))]
pub(crate) async fn login_state(
    Shared(backend): Shared<Arc<Backend>>,
    Extension(authorisation): Extension<Authorisation>,
) -> Json<LoginState> {
    Json(LoginState {
        needs_token: backend.access.needs_token(),
        logged_in: authorisation.is_session(),
    })
}

/// Log a browser in
///
/// Opens a session and sets its cookie; no cookie without a token.
#[utoipa::path(post, path = "/api/login", tag = "daemon", request_body = Login,
    responses((status = 204), (status = 400, body = ErrorResponse), (status = 401, body = ErrorResponse),
        (status = 408, body = ErrorResponse), (status = 413, body = ErrorResponse), (status = 415, body = ErrorResponse),
        (status = 422, body = ErrorResponse),
        (status = 429, body = ErrorResponse, description = "too many wrong tokens from this address")))]
pub(crate) async fn login(
    Shared(backend): Shared<Arc<Backend>>,
    Extension(peer): Extension<Peer>,
    Body(login): Body<Login>,
) -> Result<(StatusCode, HeaderMap), Failure> {
    let cookie = backend.access.log_in(peer, &login.token)?;
    let cookie = cookie.map(|cookie| (header::SET_COOKIE, cookie));
    Ok((StatusCode::NO_CONTENT, cookie.into_iter().collect()))
}

/// Log this browser out
///
/// Ends the session and its open connections.
#[utoipa::path(post, path = "/api/logout", tag = "daemon", responses((status = 204)))]
pub(crate) async fn logout(
    Extension(authorisation): Extension<Authorisation>,
) -> (StatusCode, HeaderMap) {
    let headers = [(header::SET_COOKIE, authorisation.log_out())];
    (StatusCode::NO_CONTENT, headers.into_iter().collect())
}
