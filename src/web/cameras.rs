//! Live previews over HTTP: single images and streams.

use std::convert::Infallible;
use std::sync::Arc;
use std::time::Duration;

use axum::Extension;
use axum::body::{Body, Bytes};
use axum::extract::rejection::QueryRejection;
use axum::extract::{Path, Query, State as Shared};
use axum::http::{HeaderName, StatusCode, header};
use axum::response::{IntoResponse, Json, Response};

use super::access::{Authorisation, Peer};
use super::backend::Backend;
use super::failure::{ErrorResponse, Failure};
use super::frames::{MarkersQuery, other_than, timed};
use super::previews::{MAX_STREAMS, PreviewImage};
use crate::daemon::EngineStatus;
use gripcast_imaging::Role;
use gripcast_shear::MarkerField;

/// Interval between two images of a stream.
const INTERVAL: Duration = Duration::from_millis(100);
/// Multipart boundary of a stream.
const BOUNDARY: &str = "gripcast-frame";

/// Returns the role of a camera that the rig has.
pub(super) fn check_role(status: &EngineStatus, role: Role) -> Result<Role, Failure> {
    if status.cameras.iter().any(|camera| camera.role == role) {
        return Ok(role);
    }
    if status.cameras.is_empty() {
        return Err(Failure::busy("the cameras are starting"));
    }
    Err(Failure::not_found(format!(
        "the rig has no camera `{role}`"
    )))
}

/// Query of a live preview.
#[derive(Clone, Copy, Debug, Default, serde::Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(crate) struct PreviewQuery {
    /// Which image of the camera.
    #[serde(default)]
    #[param(inline, default = "difference")]
    image: PreviewImage,
    /// Ignored. Browsers load an image again only from another address.
    #[serde(default)]
    #[allow(dead_code, reason = "part of the interface")]
    start: Option<u64>,
}

/// Query parameters whose rejection is a [`Failure`].
pub(crate) type Parameters<T> = Result<Query<T>, QueryRejection>;

/// Returns valid query parameters.
pub(crate) fn parameters<T>(query: Parameters<T>) -> Result<T, Failure> {
    let Query(query) = query.map_err(|e| Failure::new(e.status(), e.body_text()))?;
    Ok(query)
}

/// Newest image of a camera
///
/// At most 320×240; a gel shows the difference to the initial frame once there is one, or with
/// `image=raw` what its camera sees, and with `image=both` both, side by side.
#[utoipa::path(get, path = "/api/cameras/{role}/preview.jpg", tag = "cameras",
    params(("role" = Role, Path), PreviewQuery),
    responses((status = 200, content_type = "image/jpeg", body = [u8]), (status = 400, body = ErrorResponse),
        (status = 404, body = ErrorResponse), (status = 503, body = ErrorResponse)))]
pub(crate) async fn still(
    Shared(backend): Shared<Arc<Backend>>,
    Segment(role): Segment<Role>,
    query: Parameters<PreviewQuery>,
) -> Result<Response, Failure> {
    let PreviewQuery { image, .. } = parameters(query)?;
    let role = check_role(&backend.status.borrow(), role)?;
    let jpeg = backend
        .previews
        .shown(role, image)
        .ok_or_else(|| Failure::busy(format!("{role} has no image yet")))?;
    Ok(([(header::CONTENT_TYPE, "image/jpeg")], jpeg).into_response())
}

/// The gel markers of an image.
#[derive(serde::Serialize, utoipa::ToSchema)]
pub(crate) struct MarkerResponse {
    #[serde(flatten)]
    field: MarkerField,
    /// Driver time of the image, `CLOCK_MONOTONIC` of the daemon's machine, ns.
    driver_time_ns: u64,
}

/// Gel markers of a gel
///
/// In its newest image, since the initial frame: rest and present positions in px of the 320×240
/// image, confidence 0 for a lost one; null where the lattice has no marker. `driver_time_ns` is that
/// of the image. With `after`, waits for those of another driver time, a second at most, then 204.
#[utoipa::path(get, path = "/api/cameras/{role}/markers", tag = "cameras",
    params(("role" = Role, Path), MarkersQuery),
    responses((status = 200, body = MarkerResponse), (status = 204), (status = 400, body = ErrorResponse),
        (status = 404, body = ErrorResponse), (status = 503, body = ErrorResponse)))]
pub(crate) async fn markers(
    Shared(backend): Shared<Arc<Backend>>,
    Segment(role): Segment<Role>,
    query: Parameters<MarkersQuery>,
) -> Result<Response, Failure> {
    let MarkersQuery { after } = parameters(query)?;
    let role = check_role(&backend.status.borrow(), role)?;
    let newest = |status: &EngineStatus| {
        let markers = status.marker_fields.get(&role).ok_or_else(|| {
            let why = match status.shear.get(&role) {
                Some(_) => "no gel markers in its image",
                None => "no initial frame",
            };
            Failure::busy(format!("{role}: {why}"))
        })?;
        let response = MarkerResponse {
            field: (*markers.field).clone(),
            driver_time_ns: markers.driver_time_ns,
        };
        Ok((markers.driver_time_ns, response))
    };
    Ok(match other_than(&backend.status, after, newest).await? {
        Some((driver_time_ns, markers)) => timed(driver_time_ns, Json(markers)),
        None => StatusCode::NO_CONTENT.into_response(),
    })
}

/// Image stream of a camera
///
/// `multipart/x-mixed-replace`, at most ten images per second. Slow readers miss images.
#[utoipa::path(get, path = "/api/cameras/{role}/preview.mjpg", tag = "cameras",
    params(("role" = Role, Path), PreviewQuery),
    responses((status = 200, content_type = "multipart/x-mixed-replace", body = [u8]),
        (status = 400, body = ErrorResponse), (status = 404, body = ErrorResponse), (status = 503, body = ErrorResponse)))]
pub(crate) async fn stream(
    Shared(backend): Shared<Arc<Backend>>,
    Extension(peer): Extension<Peer>,
    Extension(authorisation): Extension<Authorisation>,
    Segment(role): Segment<Role>,
    query: Parameters<PreviewQuery>,
) -> Result<Response, Failure> {
    let PreviewQuery { image, .. } = parameters(query)?;
    let role = check_role(&backend.status.borrow(), role)?;
    let permit = backend.previews.streams.take(peer).ok_or_else(|| {
        Failure::busy(format!("{MAX_STREAMS} image streams are already open"))
            .remedy("close another page")
    })?;
    // The next image is encoded when the previous one has been read, so nothing queues up.
    let start = (backend, authorisation, permit, Bytes::new());
    let next = move |(backend, authorisation, permit, last): (
        Arc<Backend>,
        Authorisation,
        _,
        Bytes,
    )| async move {
        let jpeg = loop {
            tokio::time::sleep(INTERVAL).await;
            // The engine has ended.
            backend.status.has_changed().ok()?;
            // The session has ended.
            if !authorisation.is_valid() {
                return None;
            }
            match backend.previews.shown(role, image) {
                // The same buffer means no new image.
                Some(jpeg) if jpeg.as_ptr() != last.as_ptr() => break jpeg,
                _ => {}
            }
        };
        let part = Ok::<_, Infallible>(multipart_image(&jpeg, last.is_empty()));
        Some((part, (backend, authorisation, permit, jpeg)))
    };
    let images = futures_util::stream::unfold(start, next);
    let kind = format!("multipart/x-mixed-replace; boundary={BOUNDARY}");
    let headers = [
        (header::CONTENT_TYPE, kind.as_str()),
        // nginx would hold images back.
        (HeaderName::from_static("x-accel-buffering"), "no"),
    ];
    Ok((headers, Body::from_stream(images)).into_response())
}

/// An image between two boundaries: a browser shows it once the next boundary has arrived. The
/// boundary before it belongs to the previous image, except for the first.
fn multipart_image(jpeg: &[u8], is_first: bool) -> Bytes {
    let start = if is_first {
        format!("--{BOUNDARY}\r\n")
    } else {
        String::new()
    };
    let head = format!(
        "{start}Content-Type: image/jpeg\r\nContent-Length: {}\r\n\r\n",
        jpeg.len()
    );
    let end = format!("\r\n--{BOUNDARY}\r\n");
    Bytes::from([head.as_bytes(), jpeg, end.as_bytes()].concat())
}

/// Path parameters whose rejection is a [`Failure`].
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

#[cfg(test)]
mod tests {
    use gripcast_session::Labels;

    use super::*;

    /// Whatever follows, an image is complete with the boundary behind it.
    #[test]
    fn every_image_of_a_stream_ends_with_a_boundary() {
        let parts = [
            multipart_image(b"one", true),
            multipart_image(b"three", false),
        ]
        .concat();
        let expected = "--gripcast-frame\r\nContent-Type: image/jpeg\r\nContent-Length: 3\r\n\r\none\r\n\
                        --gripcast-frame\r\nContent-Type: image/jpeg\r\nContent-Length: 5\r\n\r\nthree\r\n\
                        --gripcast-frame\r\n";
        assert_eq!(String::from_utf8(parts).unwrap(), expected);
    }

    #[test]
    fn cameras_are_busy_until_the_engine_has_started() {
        let starting = EngineStatus::starting("kitchen", "virtual", Labels::default());
        let failure = check_role(&starting, Role::Left).unwrap_err();
        assert_eq!(
            failure.into_response().status(),
            StatusCode::SERVICE_UNAVAILABLE
        );
    }
}
