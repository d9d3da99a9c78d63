//! Small live pictures: each is encoded once, however many look, and only while somebody does.

use std::collections::BTreeMap;
use std::convert::Infallible;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use axum::Extension;
use axum::body::{Body, Bytes};
use axum::extract::{Path, State as Shared};
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use tokio::sync::watch;

use super::access::{Pass, Peer};
use super::backend::Backend;
use super::failure::{Complaint, Failure};
use super::places::Places;
use super::state::RoleName;
use crate::daemon::EngineStatus;
use gripcast_imaging::{Role, encode_jpeg};

/// Quality of the pictures.
const QUALITY: u8 = 75;
/// Pause between two pictures of a stream.
const PAUSE: Duration = Duration::from_millis(100);
/// Streams at a time, over TCP and over the socket; a browser has one a camera.
const MAX_STREAMS: usize = 32;
/// Text between two pictures of a stream.
const BOUNDARY: &str = "gripcast-frame";

/// The newest picture of each camera as JPEG, made when it is asked for.
pub(crate) struct Previews {
    status: watch::Receiver<Arc<EngineStatus>>,
    encoded: Mutex<BTreeMap<Role, Encoded>>,
    /// Places for streams.
    pub(crate) streams: Places,
}

struct Encoded {
    /// The picture that it was made from; holding it keeps its address its own.
    of: Arc<image::RgbImage>,
    jpeg: Bytes,
}

impl Previews {
    /// Pictures of the status.
    pub(crate) fn new(status: watch::Receiver<Arc<EngineStatus>>) -> Self {
        Self {
            status,
            encoded: Mutex::new(BTreeMap::new()),
            streams: Places::new(MAX_STREAMS, MAX_STREAMS),
        }
    }

    /// The newest picture; `None` before the first.
    pub(crate) fn jpeg(&self, role: Role) -> Option<Bytes> {
        let status = Arc::clone(&self.status.borrow());
        let picture = Arc::clone(&status.previews.get(&role)?.image);
        let mut encoded = self.encoded.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(known) = encoded.get(&role).filter(|e| Arc::ptr_eq(&e.of, &picture)) {
            return Some(known.jpeg.clone());
        }
        let jpeg = Bytes::from(encode_jpeg(&picture, QUALITY).ok()?);
        let made = Encoded {
            of: picture,
            jpeg: jpeg.clone(),
        };
        encoded.insert(role, made);
        Some(jpeg)
    }
}

fn known(backend: &Backend, role: RoleName) -> Result<Role, Failure> {
    let role = Role::from(role);
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
    params(("role" = RoleName, Path)),
    responses((status = 200, content_type = "image/jpeg", body = [u8]), (status = 400, body = Complaint),
        (status = 404, body = Complaint), (status = 503, body = Complaint)))]
pub(crate) async fn still(
    Shared(backend): Shared<Arc<Backend>>,
    Segment(role): Segment<RoleName>,
) -> Result<Response, Failure> {
    let role = known(&backend, role)?;
    let jpeg = backend.previews.jpeg(role).ok_or_else(|| {
        Failure::new(
            StatusCode::SERVICE_UNAVAILABLE,
            format!("{role} has not shown anything yet"),
        )
    })?;
    Ok(([(header::CONTENT_TYPE, "image/jpeg")], jpeg).into_response())
}

/// What a camera shows, as it goes on
///
/// `multipart/x-mixed-replace`, ten pictures a second at most. A reader that is slow misses
/// pictures.
#[utoipa::path(get, path = "/api/cameras/{role}/preview.mjpg", tag = "cameras",
    params(("role" = RoleName, Path)),
    responses((status = 200, content_type = "multipart/x-mixed-replace", body = [u8]),
        (status = 400, body = Complaint), (status = 404, body = Complaint), (status = 503, body = Complaint)))]
pub(crate) async fn stream(
    Shared(backend): Shared<Arc<Backend>>,
    Extension(peer): Extension<Peer>,
    Extension(pass): Extension<Pass>,
    Segment(role): Segment<RoleName>,
) -> Result<Response, Failure> {
    let role = known(&backend, role)?;
    let place = backend.previews.streams.take(peer).ok_or_else(|| {
        Failure::new(
            StatusCode::SERVICE_UNAVAILABLE,
            format!("{MAX_STREAMS} picture streams are open already"),
        )
        .remedy("close another page")
    })?;
    // The next picture is made when the one before has been taken: nothing queues for a slow reader.
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
    let pictures = futures_util::stream::unfold(start, next);
    let kind = format!("multipart/x-mixed-replace; boundary={BOUNDARY}");
    Ok(([(header::CONTENT_TYPE, kind)], Body::from_stream(pictures)).into_response())
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
