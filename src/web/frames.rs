//! Images of cameras for programs: without loss, and each image once.

use std::sync::Arc;
use std::time::Duration;

use axum::extract::State as Shared;
use axum::http::{HeaderName, StatusCode, header};
use axum::response::{IntoResponse, Response};
use tokio::sync::watch;

use super::backend::Backend;
use super::cameras::{Parameters, Segment, check_role, parameters};
use super::failure::{ErrorResponse, Failure};
use crate::daemon::{EngineStatus, Preview};
use gripcast_capture::camera::monotonic_ns;
use gripcast_imaging::{Role, encode_png_rgb};

/// Maximum wait for another image.
const WAIT: Duration = Duration::from_secs(1);
/// Driver time of an image's frame, `CLOCK_MONOTONIC` of this machine, ns.
const DRIVER_TIME: HeaderName = HeaderName::from_static("gripcast-driver-time-ns");
/// Age of a frame when it is sent, ms.
const AGE: HeaderName = HeaderName::from_static("gripcast-age-ms");

/// Which image of a camera.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub(crate) enum FrameImage {
    /// As the camera sees it.
    #[default]
    Raw,
    /// Of a gel: the difference to the initial frame, 128 for no change, gain 1.
    Difference,
}

impl FrameImage {
    fn png(self, preview: &Preview) -> Result<Vec<u8>, Failure> {
        let png = match (self, &preview.levels) {
            (Self::Raw, _) => encode_png_rgb(&preview.image),
            (Self::Difference, Some(levels)) => encode_png_rgb(&levels.to_image(1.0)),
            (Self::Difference, None) => return Err(Failure::busy("no initial frame")),
        };
        Ok(png?)
    }
}

/// Query of an image.
#[derive(Clone, Copy, Debug, Default, serde::Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(crate) struct FrameQuery {
    /// Which image of the camera.
    #[serde(default)]
    #[param(inline, default = "raw")]
    image: FrameImage,
    /// Driver time of the image that the reader has, ns.
    #[serde(default)]
    after: Option<u64>,
}

/// Query of gel markers.
#[derive(Clone, Copy, Debug, Default, serde::Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(crate) struct MarkersQuery {
    /// Driver time of the gel markers that the reader has, ns.
    #[serde(default)]
    pub(super) after: Option<u64>,
}

/// Newest image of a camera, without loss
///
/// 320×240, as models see it. With `after`, waits for an image of another driver time, a second at
/// most, then 204. The headers `Gripcast-Driver-Time-Ns` (CLOCK_MONOTONIC of the daemon's machine) and
/// `Gripcast-Age-Ms` say when the camera took it. At most 20 images per second.
#[utoipa::path(get, path = "/api/cameras/{role}/image.png", tag = "cameras",
    params(("role" = Role, Path), FrameQuery),
    responses((status = 200, content_type = "image/png", body = [u8]), (status = 204),
        (status = 400, body = ErrorResponse), (status = 404, body = ErrorResponse),
        (status = 503, body = ErrorResponse)))]
pub(crate) async fn image(
    Shared(backend): Shared<Arc<Backend>>,
    Segment(role): Segment<Role>,
    query: Parameters<FrameQuery>,
) -> Result<Response, Failure> {
    let FrameQuery { image, after } = parameters(query)?;
    let role = check_role(&backend.status.borrow(), role)?;
    if image == FrameImage::Difference && !role.is_tactile() {
        let what = format!("`{role}` is not a gel, so it has no difference");
        return Err(Failure::new(StatusCode::BAD_REQUEST, what));
    }
    let newest = |status: &EngineStatus| {
        let preview = status.previews.get(&role).cloned();
        let preview = preview.ok_or_else(|| Failure::busy(format!("{role} has no image yet")))?;
        Ok((preview.driver_time_ns, preview))
    };
    let Some((driver_time_ns, preview)) = other_than(&backend.status, after, newest).await? else {
        return Ok(StatusCode::NO_CONTENT.into_response());
    };
    let png = image.png(&preview)?;
    Ok(timed(
        driver_time_ns,
        ([(header::CONTENT_TYPE, "image/png")], png),
    ))
}

/// Returns what `newest` finds, once it has another driver time than `after`; `None` without one in
/// [`WAIT`].
///
/// # Errors
/// Those of `newest`; 503 when the engine ends.
pub(super) async fn other_than<T>(
    status: &watch::Receiver<Arc<EngineStatus>>,
    after: Option<u64>,
    newest: impl Fn(&EngineStatus) -> Result<(u64, T), Failure>,
) -> Result<Option<(u64, T)>, Failure> {
    let mut status = status.clone();
    let is_other = |status: &Arc<EngineStatus>| match newest(status) {
        Ok((driver_time_ns, _)) => Some(driver_time_ns) != after,
        Err(_) => true,
    };
    let found = match tokio::time::timeout(WAIT, status.wait_for(is_other)).await {
        Ok(Ok(status)) => Arc::clone(&status),
        Ok(Err(_)) => return Err(Failure::busy("the daemon is shutting down")),
        Err(_) => return Ok(None),
    };
    newest(&found).map(Some)
}

/// Adds driver time and age of a frame to its response.
pub(super) fn timed(driver_time_ns: u64, body: impl IntoResponse) -> Response {
    let age_ms = monotonic_ns().saturating_sub(driver_time_ns) as f64 * 1e-6;
    let headers = [
        (DRIVER_TIME, driver_time_ns.to_string()),
        (AGE, format!("{age_ms:.3}")),
    ];
    (headers, body).into_response()
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use image::{Rgb, RgbImage};

    use super::*;
    use gripcast_imaging::{Decoder, TactileDifference};
    use gripcast_session::Labels;

    fn preview(driver_time_ns: u64) -> Preview {
        let initial = RgbImage::from_pixel(6, 4, Rgb([100, 50, 200]));
        let image = RgbImage::from_fn(6, 4, |x, y| Rgb([100 + x as u8, 50 - y as u8, 200]));
        let levels = TactileDifference::between(&initial, &image).unwrap();
        Preview {
            difference: Some(Arc::new(levels.to_image(1.5))),
            levels: Some(Arc::new(levels)),
            image: Arc::new(image),
            driver_time_ns,
        }
    }

    fn status(preview: Preview) -> Arc<EngineStatus> {
        Arc::new(EngineStatus {
            previews: BTreeMap::from([(Role::Left, preview)]),
            ..EngineStatus::starting("d", "bench", Labels::default())
        })
    }

    #[test]
    fn image_and_difference_keep_every_level() {
        let preview = preview(1);
        let decoded = |which: FrameImage| {
            let png = which.png(&preview).unwrap();
            Decoder::new().unwrap().stored_image(&png).unwrap()
        };
        assert_eq!(decoded(FrameImage::Raw), *preview.image);
        let difference = decoded(FrameImage::Difference);
        assert_eq!(difference.get_pixel(5, 3), &Rgb([133, 125, 128]));
        let untouched = Preview {
            levels: None,
            ..preview
        };
        let failure = FrameImage::Difference.png(&untouched).unwrap_err();
        assert_eq!(
            failure.into_response().status(),
            StatusCode::SERVICE_UNAVAILABLE
        );
    }

    #[test]
    fn reader_with_the_newest_image_waits_for_another() {
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_time()
            .build()
            .unwrap();
        let (sender, receiver) = watch::channel(status(preview(7)));
        let time = |status: &EngineStatus| Ok((status.previews[&Role::Left].driver_time_ns, ()));
        runtime.block_on(async {
            for after in [None, Some(6), Some(8)] {
                let found = other_than(&receiver, after, time).await.unwrap();
                assert_eq!(found, Some((7, ())), "{after:?}");
            }
            let (found, ()) = tokio::join!(other_than(&receiver, Some(7), time), async {
                sender.send(status(preview(7))).unwrap();
                tokio::task::yield_now().await;
                sender.send(status(preview(9))).unwrap();
            });
            assert_eq!(found.unwrap(), Some((9, ())));
            drop(sender);
            let failure = other_than(&receiver, Some(9), time).await.unwrap_err();
            assert_eq!(
                failure.into_response().status(),
                StatusCode::SERVICE_UNAVAILABLE
            );
        });
    }
}
