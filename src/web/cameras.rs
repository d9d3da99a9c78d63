//! Small live images over HTTP: one at a time, or as a stream.

use std::convert::Infallible;
use std::sync::Arc;
use std::time::Duration;

use axum::Extension;
use axum::body::{Body, Bytes};
use axum::extract::{Path, State as Shared};
use axum::http::header;
use axum::response::{IntoResponse, Response};

use super::access::{Pass, Peer};
use super::backend::Backend;
use super::failure::{ErrorResponse, Failure};
use super::previews::MAX_STREAMS;
use gripcast_imaging::Role;

/// Pause between two images of a stream.
const PAUSE: Duration = Duration::from_millis(100);
/// Text between two images of a stream.
const BOUNDARY: &str = "gripcast-frame";

fn known(backend: &Backend, role: Role) -> Result<Role, Failure> {
    let status = backend.status.borrow();
    if status.cameras.iter().any(|camera| camera.role == role) {
        return Ok(role);
    }
    Err(Failure::not_found(format!(
        "the rig has no camera `{role}`"
    )))
}

/// What a camera shows
///
/// At most 320×240; a gel shows the difference to the initial frame once there is one.
#[utoipa::path(get, path = "/api/cameras/{role}/preview.jpg", tag = "cameras",
    params(("role" = Role, Path)),
    responses((status = 200, content_type = "image/jpeg", body = [u8]), (status = 400, body = ErrorResponse),
        (status = 404, body = ErrorResponse), (status = 503, body = ErrorResponse)))]
pub(crate) async fn still(
    Shared(backend): Shared<Arc<Backend>>,
    Segment(role): Segment<Role>,
) -> Result<Response, Failure> {
    let role = known(&backend, role)?;
    let jpeg = backend
        .previews
        .jpeg(role)
        .ok_or_else(|| Failure::busy(format!("{role} has not shown anything yet")))?;
    Ok(([(header::CONTENT_TYPE, "image/jpeg")], jpeg).into_response())
}

/// What a camera shows, as it goes on
///
/// `multipart/x-mixed-replace`, ten images a second at most. A reader that is slow misses
/// images.
#[utoipa::path(get, path = "/api/cameras/{role}/preview.mjpg", tag = "cameras",
    params(("role" = Role, Path)),
    responses((status = 200, content_type = "multipart/x-mixed-replace", body = [u8]),
        (status = 400, body = ErrorResponse), (status = 404, body = ErrorResponse), (status = 503, body = ErrorResponse)))]
pub(crate) async fn stream(
    Shared(backend): Shared<Arc<Backend>>,
    Extension(peer): Extension<Peer>,
    Extension(pass): Extension<Pass>,
    Segment(role): Segment<Role>,
) -> Result<Response, Failure> {
    let role = known(&backend, role)?;
    let place = backend.previews.streams.take(peer).ok_or_else(|| {
        Failure::busy(format!("{MAX_STREAMS} image streams are open already"))
            .remedy("close another page")
    })?;
    // The next image is made when the one before has been taken: nothing queues for a slow reader.
    let start = (backend, pass, place, Bytes::new());
    let next = move |(backend, pass, place, last): (Arc<Backend>, Pass, _, Bytes)| async move {
        let jpeg = loop {
            tokio::time::sleep(PAUSE).await;
            // The engine has gone; so will the connection.
            backend.status.has_changed().ok()?;
            // The session has ended.
            if !pass.holds() {
                return None;
            }
            match backend.previews.jpeg(role) {
                // The same bytes in the same place: the camera shows nothing new.
                Some(jpeg) if jpeg.as_ptr() != last.as_ptr() => break jpeg,
                _ => {}
            }
        };
        let taken = Ok::<_, Infallible>(part(&jpeg));
        Some((taken, (backend, pass, place, jpeg)))
    };
    let images = futures_util::stream::unfold(start, next);
    let kind = format!("multipart/x-mixed-replace; boundary={BOUNDARY}");
    Ok(([(header::CONTENT_TYPE, kind)], Body::from_stream(images)).into_response())
}

fn part(jpeg: &[u8]) -> Bytes {
    let head = format!(
        "--{BOUNDARY}\r\nContent-Type: image/jpeg\r\nContent-Length: {}\r\n\r\n",
        jpeg.len()
    );
    Bytes::from([head.as_bytes(), jpeg, b"\r\n"].concat())
}

/// Segments of a path whose refusal is told like every other failure.
pub(crate) struct Segment<T>(pub(crate) T);

impl<T, S> axum::extract::FromRequestParts<S> for Segment<T>
where
    T: serde::de::DeserializeOwned + Send,
    S: Send + Sync,
{
    type Rejection = Failure;

    async fn from_request_parts(
        parts: &mut axum::http::request::Parts,
        state: &S,
    ) -> Result<Self, Failure> {
        match Path::<T>::from_request_parts(parts, state).await {
            Ok(Path(segment)) => Ok(Self(segment)),
            Err(rejection) => Err(Failure::new(rejection.status(), rejection.body_text())),
        }
    }
}
