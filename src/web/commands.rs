//! Commands over HTTP.

use std::ops::Deref;
use std::str::FromStr;
use std::sync::Arc;

use axum::extract::State as Shared;
use axum::http::{StatusCode, header};
use axum::{Extension, Json};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::answers::Answer;
use super::backend::{Backend, wait_for};
use super::cameras::Segment;
use super::failure::{ErrorResponse, Failure};
use super::sender::{Arrival, RequestId, Sender};
use crate::daemon::EngineStatus;
use gripcast_base::error::Error;
use gripcast_session::{Command, CommandResult};

/// A command in the syntax of scripts and pedals.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct CommandBody {
    /// `trigger`, `initial`, `grasp`, `override`, `stable`, `slip`, `unlabel`, `undo`, `redo`,
    /// `object NAME`, `scene NAME`, `operator NAME`, `relabel ID OUTCOME`, `edit ID object NAME`,
    /// `edit ID scene NAME`, `edit ID operator NAME`, `trash ID`, `restore ID`; `edit last object
    /// NAME` for the newest grasp.
    #[schema(example = "trigger")]
    command: String,
    #[serde(default)]
    sender: Sender,
}

/// A name for the following grasps.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct NameBody {
    #[schema(min_length = 1, max_length = 120, example = "mug-blue")]
    name: String,
    #[serde(default)]
    sender: Sender,
}

/// Body of a command without arguments.
#[derive(Debug, Default, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct SenderBody {
    pub(super) sender: Sender,
}

/// Result of a command.
#[derive(Serialize, ToSchema)]
pub(crate) struct CommandResponse {
    #[serde(flatten)]
    result: CommandResult,
    /// State of the engine after the command.
    state: EngineStatus,
}

/// Response of a command handler.
pub(crate) type Reply = Result<(StatusCode, Json<CommandResponse>), Failure>;

/// Executes a command and returns its result.
pub(crate) async fn execute(
    backend: &Backend,
    command: Command,
    sender: Sender,
    arrival: Arrival,
) -> Reply {
    reply(backend, backend.submit(command, sender, arrival)?).await
}

/// Waits for an answer.
pub(crate) async fn reply(backend: &Backend, answer: Answer) -> Reply {
    let result = wait_for(answer).await?;
    let status = match &result {
        CommandResult::Accepted => StatusCode::OK,
        CommandResult::Refused { .. } => StatusCode::CONFLICT,
        CommandResult::Failed { .. } => StatusCode::INTERNAL_SERVER_ERROR,
    };
    let state = backend.state();
    Ok((status, Json(CommandResponse { result, state })))
}

/// Parses a command from a client.
///
/// # Errors
/// 422 for an invalid command, 403 for `quit`.
pub(crate) fn parse(text: &str) -> Result<Command, Failure> {
    let command: Command = text
        .parse()
        .map_err(|e: gripcast_session::ParseCommandError| Failure::input(e.to_string()))?;
    match &command {
        Command::Quit => Err(Failure::new(
            StatusCode::FORBIDDEN,
            "`quit` is not allowed over the API",
        )
        .remedy("stop the daemon with `systemctl stop gripcast`, or Ctrl-C in its terminal")),
        _ => Ok(command),
    }
}

/// Execute a command
///
/// Responds once all changes are durable.
#[utoipa::path(post, path = "/api/commands", tag = "session", request_body = CommandBody,
    responses((status = 200, body = CommandResponse), (status = 409, body = CommandResponse, description = "refused"),
        (status = 500, body = CommandResponse, description = "write error; nothing changed"),
        (status = 400, body = ErrorResponse), (status = 403, body = ErrorResponse), (status = 408, body = ErrorResponse), (status = 413, body = ErrorResponse),
        (status = 415, body = ErrorResponse), (status = 422, body = ErrorResponse), (status = 503, body = ErrorResponse)))]
pub(crate) async fn command(
    Shared(backend): Shared<Arc<Backend>>,
    Extension(arrival): Extension<Arrival>,
    Body(request): Body<CommandBody>,
) -> Reply {
    let command = parse(&request.command)?;
    execute(&backend, command, request.sender, arrival).await
}

/// Result of a command by its request id
///
/// For a sender whose connection broke before the answer: 404 if the command did not arrive.
#[utoipa::path(get, path = "/api/commands/{request_id}", tag = "session", params(("request_id" = String, Path)),
    responses((status = 200, body = CommandResponse), (status = 409, body = CommandResponse, description = "refused"),
        (status = 500, body = CommandResponse, description = "write error; nothing changed"),
        (status = 404, body = ErrorResponse), (status = 422, body = ErrorResponse), (status = 503, body = ErrorResponse)))]
pub(crate) async fn command_result(
    Shared(backend): Shared<Arc<Backend>>,
    Segment(id): Segment<String>,
) -> Reply {
    reply(&backend, backend.answer_to(&RequestId::parse(id)?)?).await
}

/// Set the object name
#[utoipa::path(put, path = "/api/object", tag = "session", request_body = NameBody,
    responses((status = 200, body = CommandResponse), (status = 400, body = ErrorResponse), (status = 403, body = ErrorResponse),
        (status = 408, body = ErrorResponse), (status = 413, body = ErrorResponse), (status = 415, body = ErrorResponse), (status = 422, body = ErrorResponse),
        (status = 503, body = ErrorResponse)))]
pub(crate) async fn object(
    Shared(backend): Shared<Arc<Backend>>,
    Extension(arrival): Extension<Arrival>,
    Body(request): Body<NameBody>,
) -> Reply {
    set_name(&backend, request, arrival, Command::Object).await
}

/// Set the scene name
#[utoipa::path(put, path = "/api/scene", tag = "session", request_body = NameBody,
    responses((status = 200, body = CommandResponse), (status = 400, body = ErrorResponse), (status = 403, body = ErrorResponse),
        (status = 408, body = ErrorResponse), (status = 413, body = ErrorResponse), (status = 415, body = ErrorResponse), (status = 422, body = ErrorResponse),
        (status = 503, body = ErrorResponse)))]
pub(crate) async fn scene(
    Shared(backend): Shared<Arc<Backend>>,
    Extension(arrival): Extension<Arrival>,
    Body(request): Body<NameBody>,
) -> Reply {
    set_name(&backend, request, arrival, Command::Scene).await
}

/// Set the operator name
#[utoipa::path(put, path = "/api/operator", tag = "session", request_body = NameBody,
    responses((status = 200, body = CommandResponse), (status = 400, body = ErrorResponse), (status = 403, body = ErrorResponse),
        (status = 408, body = ErrorResponse), (status = 413, body = ErrorResponse), (status = 415, body = ErrorResponse), (status = 422, body = ErrorResponse),
        (status = 503, body = ErrorResponse)))]
pub(crate) async fn operator(
    Shared(backend): Shared<Arc<Backend>>,
    Extension(arrival): Extension<Arrival>,
    Body(request): Body<NameBody>,
) -> Reply {
    set_name(&backend, request, arrival, Command::Operator).await
}

async fn set_name<T>(
    backend: &Backend,
    request: NameBody,
    arrival: Arrival,
    make: fn(T) -> Command,
) -> Reply
where
    T: FromStr<Err = Error> + Deref<Target = str>,
{
    let name: T = request.name.parse()?;
    if name.is_empty() {
        return Err(Failure::input("expected a name, found an empty string"));
    }
    execute(backend, make(name), request.sender, arrival).await
}

/// JSON body whose rejection is a [`Failure`].
pub(crate) struct Body<T>(pub(crate) T);

impl<T> axum::extract::FromRequest<Arc<Backend>> for Body<T>
where
    T: serde::de::DeserializeOwned,
{
    type Rejection = Failure;

    async fn from_request(
        request: axum::extract::Request,
        backend: &Arc<Backend>,
    ) -> Result<Self, Failure> {
        let timeout = backend.body_timeout;
        match tokio::time::timeout(timeout, Json::<T>::from_request(request, backend)).await {
            Ok(Ok(Json(body))) => Ok(Self(body)),
            Ok(Err(rejection)) => Err(Failure::new(rejection.status(), rejection.body_text())),
            Err(_) => Err(Failure::new(
                StatusCode::REQUEST_TIMEOUT,
                format!(
                    "the request body did not arrive within {} s",
                    timeout.as_secs_f64()
                ),
            )
            .remedy("send the body at once")),
        }
    }
}

/// An optional body: absent without a `Content-Type`.
impl<T> axum::extract::OptionalFromRequest<Arc<Backend>> for Body<T>
where
    T: serde::de::DeserializeOwned,
{
    type Rejection = Failure;

    async fn from_request(
        request: axum::extract::Request,
        backend: &Arc<Backend>,
    ) -> Result<Option<Self>, Failure> {
        if !request.headers().contains_key(header::CONTENT_TYPE) {
            return Ok(None);
        }
        let body =
            <Self as axum::extract::FromRequest<Arc<Backend>>>::from_request(request, backend);
        body.await.map(Some)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use axum::response::IntoResponse as _;

    fn rejection_status(text: &str) -> u16 {
        match parse(text) {
            Ok(command) => panic!("`{text}` was parsed as {command:?}"),
            Err(failure) => failure.into_response().status().as_u16(),
        }
    }

    #[test]
    fn invalid_and_forbidden_commands_are_rejected() {
        assert_eq!(parse("trigger").unwrap(), Command::Trigger);
        assert_eq!(
            parse("object blue mug").unwrap(),
            Command::Object("blue mug".parse().unwrap())
        );
        assert_eq!(rejection_status("quit"), 403);
        assert_eq!(rejection_status("jump"), 422);
        assert_eq!(rejection_status("object a\u{7}b"), 422);
        assert_eq!(
            rejection_status(&format!("object {}", "x".repeat(121))),
            422
        );
        assert_eq!(rejection_status("trash ../../etc"), 422);
    }
}
