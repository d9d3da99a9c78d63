//! Saved grasps over HTTP: list, records, files, small images, relabelling and trash.

use std::sync::Arc;
use std::time::Duration;

use axum::Json;
use axum::extract::{Query, State as Shared};
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::Deserialize;
use utoipa::ToSchema;

use super::backend::Backend;
use super::cameras::Segment;
use super::commands::{Body, Reply, carry_out};
use super::failure::{Complaint, Failure};
use super::grasp_list::{GraspPage, Wanted};
use gripcast_base::error::{Error, ErrorKind, Result as CrateResult};
use gripcast_base::files::FileKind;
use gripcast_dataset::{Dataset, GraspId, GraspRecord, Outcome, Stage};
use gripcast_imaging::{
    CropProfile, Decoder, DepthImage, Frame, PixelFormat, Role, TactileDifference,
    decode_png_grey16, encode_jpeg,
};
use gripcast_session::Command;

/// Size of the small images.
const PREVIEW_WIDTH: u32 = 320;
const PREVIEW_HEIGHT: u32 = 240;
/// Quality of the small images.
const QUALITY: u8 = 80;
/// When an image that could not be decoded yet may be asked for again.
const DECODE_RETRY: Duration = Duration::from_secs(1);
/// Gain of a difference, as on the operator's screen.
const DIFFERENCE_GAIN: f32 = 1.5;

/// An outcome for a grasp.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct LabelRequest {
    outcome: Outcome,
}

/// Decodes images off the threads that serve; not more at a time than there are cores.
async fn decode<T: Send + 'static>(
    backend: &Backend,
    work: impl FnOnce() -> Result<T, Failure> + Send + 'static,
) -> Result<T, Failure> {
    let place = Arc::clone(&backend.decodes).acquire_owned();
    let Ok(Ok(place)) = tokio::time::timeout(backend.decode_patience, place).await else {
        return Err(Failure::busy(format!(
            "the image was not decoded within {} s: too many others are",
            backend.decode_patience.as_secs_f64()
        ))
        .remedy("ask again")
        .retry_after(DECODE_RETRY));
    };
    off_thread(move || {
        // Held until the work has ended, even where nobody waits for it any more.
        let _place = place;
        work()
    })
    .await
}

/// Work on files, off the threads that serve.
async fn off_thread<T: Send + 'static>(
    work: impl FnOnce() -> Result<T, Failure> + Send + 'static,
) -> Result<T, Failure> {
    tokio::task::spawn_blocking(work).await.unwrap_or_else(|_| {
        Err(Failure::new(
            StatusCode::INTERNAL_SERVER_ERROR,
            "the answer could not be made",
        ))
    })
}

fn id_of(text: &str) -> Result<GraspId, Failure> {
    Ok(GraspId::parse(text)?)
}

fn record_of(dataset: &Dataset, id: &GraspId) -> Result<GraspRecord, Failure> {
    dataset.grasp(id).map_err(|error| match error.kind() {
        ErrorKind::NotFound => Failure::not_found(format!("there is no grasp {id}")),
        _ => error.into(),
    })
}

/// Saved grasps, newest first
#[utoipa::path(get, path = "/api/grasps", tag = "grasps", params(Wanted),
    responses((status = 200, body = GraspPage), (status = 400, body = Complaint), (status = 404, body = Complaint),
        (status = 422, body = Complaint)))]
pub(crate) async fn list(
    Shared(backend): Shared<Arc<Backend>>,
    query: Result<Query<Wanted>, axum::extract::rejection::QueryRejection>,
) -> Result<Json<GraspPage>, Failure> {
    let Query(wanted) = query.map_err(|e| Failure::new(e.status(), e.body_text()))?;
    off_thread(move || Ok(Json(backend.grasps.page(&wanted)?))).await
}

/// The record of a grasp: its grasp.json
#[utoipa::path(get, path = "/api/grasps/{id}", tag = "grasps", params(("id" = String, Path)),
    responses((status = 200, body = serde_json::Value), (status = 404, body = Complaint), (status = 422, body = Complaint)))]
pub(crate) async fn record(
    Shared(backend): Shared<Arc<Backend>>,
    Segment(id): Segment<String>,
) -> Result<Json<serde_json::Value>, Failure> {
    let id = id_of(&id)?;
    off_thread(move || {
        let record = record_of(&backend.grasps.dataset()?, &id)?;
        let json = serde_json::to_value(record)
            .map_err(|e| Error::internal("cannot write JSON").because(e))?;
        Ok(Json(json))
    })
    .await
}

/// A file of a grasp, as on disk
#[utoipa::path(get, path = "/api/grasps/{id}/files/{name}", tag = "grasps",
    params(("id" = String, Path), ("name" = String, Path)),
    responses((status = 200, body = [u8], content_type = "application/octet-stream"),
        (status = 404, body = Complaint), (status = 422, body = Complaint)))]
pub(crate) async fn file(
    Shared(backend): Shared<Arc<Backend>>,
    Segment((id, name)): Segment<(String, String)>,
) -> Result<Response, Failure> {
    let id = id_of(&id)?;
    off_thread(move || {
        let dataset = backend.grasps.dataset()?;
        let record = record_of(&dataset, &id)?;
        let path = dataset.file(&record, &name).ok_or_else(|| {
            Failure::not_found(format!("{id} has no file of that name"))
                .remedy("`files` in its record lists them")
        })?;
        let bytes = path
            .read(FileKind::Image)
            .map_err(|e| Error::io("cannot read the file", e).at(path.display()))?;
        let kind = match path.name().rsplit_once('.').map(|(_, suffix)| suffix) {
            Some("jpg") => "image/jpeg",
            Some("png") => "image/png",
            _ => "application/octet-stream",
        };
        Ok(([(header::CONTENT_TYPE, kind)], bytes).into_response())
    })
    .await
}

/// What a small image shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub(crate) enum PreviewKind {
    /// Before the gripper closed.
    Initial,
    /// After it closed.
    Grasp,
    /// A gel's change between the two, grey where there is none.
    Difference,
}

/// A small image of a grasp
///
/// 320×240, gels cropped as the model sees them, depth in false colour.
#[utoipa::path(get, path = "/api/grasps/{id}/preview/{kind}/{file}", tag = "grasps",
    params(("id" = String, Path), ("kind" = PreviewKind, Path),
        ("file" = String, Path, description = "`ROLE.jpg`", pattern = "^(left|right|rgb|depth|external)\\.jpg$")),
    responses((status = 200, body = [u8], content_type = "image/jpeg"), (status = 400, body = Complaint),
        (status = 404, body = Complaint), (status = 422, body = Complaint),
        (status = 503, body = Complaint, description = "too many images are decoded; `Retry-After` says when")))]
pub(crate) async fn preview(
    Shared(backend): Shared<Arc<Backend>>,
    Segment((id, kind, file)): Segment<(String, PreviewKind, String)>,
) -> Result<Response, Failure> {
    let id = id_of(&id)?;
    let role = file
        .strip_suffix(".jpg")
        .and_then(|name| Role::ALL.into_iter().find(|role| role.name() == name))
        .ok_or_else(|| {
            Failure::not_found("expected left.jpg, right.jpg, rgb.jpg, depth.jpg or external.jpg")
        })?;
    let list = Arc::clone(&backend);
    decode(&backend, move || {
        let dataset = list.grasps.dataset()?;
        let record = record_of(&dataset, &id)?;
        let jpeg = small_image(&dataset, &record, kind, role)?;
        // A grasp's images never change.
        let headers = [
            (header::CONTENT_TYPE, "image/jpeg"),
            (header::CACHE_CONTROL, "private, max-age=86400, immutable"),
        ];
        Ok((headers, jpeg).into_response())
    })
    .await
}

fn small_image(
    dataset: &Dataset,
    record: &GraspRecord,
    kind: PreviewKind,
    role: Role,
) -> CrateResult<Vec<u8>> {
    let mut decoder = Decoder::new()?;
    let mut image = |stage| stored(&mut decoder, dataset, record, stage, role);
    let shown = match kind {
        PreviewKind::Initial => image(Stage::Initial)?,
        PreviewKind::Grasp => image(Stage::Grasp)?,
        PreviewKind::Difference if role.is_tactile() => {
            let (initial, grasp) = (image(Stage::Initial)?, image(Stage::Grasp)?);
            TactileDifference::between(&initial, &grasp)?.to_image(DIFFERENCE_GAIN)
        }
        PreviewKind::Difference => {
            return Err(Error::input(format!(
                "only gels have a difference, and `{role}` is none"
            )));
        }
    };
    encode_jpeg(&shown, QUALITY)
}

fn stored(
    decoder: &mut Decoder,
    dataset: &Dataset,
    record: &GraspRecord,
    stage: Stage,
    role: Role,
) -> CrateResult<image::RgbImage> {
    let absent = || {
        Error::not_found(format!(
            "{} has no {} image of {role}",
            record.id,
            stage.name()
        ))
    };
    let camera = record.stage(stage).cameras.get(&role).ok_or_else(absent)?;
    let crop = camera
        .crop_profile
        .as_deref()
        .map(CropProfile::by_name)
        .transpose()?;
    let path = dataset.image_path(record, stage, role).ok_or_else(absent)?;
    let bytes = path
        .read(FileKind::Image)
        .map_err(|e| Error::io("cannot read the image", e).at(path.display()))?;
    let (width, height) = (PREVIEW_WIDTH, PREVIEW_HEIGHT);
    let image = match camera.format {
        PixelFormat::Z16 => decode_png_grey16(&bytes).and_then(|depth| {
            Ok(decoder.decode(&depth_frame(&depth), crop.as_ref(), width, height)?)
        }),
        _ => decoder.decode_file(&bytes, crop.as_ref(), width, height),
    };
    image.map_err(|e| e.at(path.display()))
}

/// Depth as its camera sends it, for the image in false colour.
fn depth_frame(depth: &DepthImage) -> Frame {
    let data: Vec<u8> = depth.iter().flat_map(|v| v.to_le_bytes()).collect();
    Frame {
        format: PixelFormat::Z16,
        width: depth.width(),
        height: depth.height(),
        data: data.into(),
        sequence: 0,
        driver_time_ns: 0,
        received_ns: 0,
    }
}

/// Label a grasp, whichever it is
#[utoipa::path(post, path = "/api/grasps/{id}/label", tag = "grasps", params(("id" = String, Path)),
    request_body = LabelRequest,
    responses((status = 200, body = super::commands::CommandAnswer), (status = 400, body = Complaint),
        (status = 404, body = Complaint), (status = 408, body = Complaint), (status = 413, body = Complaint), (status = 415, body = Complaint),
        (status = 422, body = Complaint), (status = 500, body = super::commands::CommandAnswer), (status = 503, body = Complaint)))]
pub(crate) async fn label(
    Shared(backend): Shared<Arc<Backend>>,
    Segment(id): Segment<String>,
    Body(request): Body<LabelRequest>,
) -> Reply {
    let id = existing(&backend, &id).await?;
    carry_out(&backend, Command::Relabel(id, request.outcome)).await
}

/// Move a grasp to the trash
#[utoipa::path(post, path = "/api/grasps/{id}/trash", tag = "grasps", params(("id" = String, Path)),
    responses((status = 200, body = super::commands::CommandAnswer), (status = 404, body = Complaint),
        (status = 422, body = Complaint), (status = 500, body = super::commands::CommandAnswer), (status = 503, body = Complaint)))]
pub(crate) async fn trash(
    Shared(backend): Shared<Arc<Backend>>,
    Segment(id): Segment<String>,
) -> Reply {
    let id = existing(&backend, &id).await?;
    carry_out(&backend, Command::Trash(id)).await
}

/// Take a grasp back from the trash
#[utoipa::path(post, path = "/api/grasps/{id}/restore", tag = "grasps", params(("id" = String, Path)),
    responses((status = 200, body = super::commands::CommandAnswer),
        (status = 404, body = Complaint, description = "it is not in the trash"), (status = 422, body = Complaint),
        (status = 500, body = super::commands::CommandAnswer, description = "it is damaged, or redo has to bring it back"),
        (status = 503, body = Complaint)))]
pub(crate) async fn restore(
    Shared(backend): Shared<Arc<Backend>>,
    Segment(id): Segment<String>,
) -> Reply {
    let id = id_of(&id)?;
    let (asked, list) = (id.clone(), Arc::clone(&backend));
    let is_there = off_thread(move || Ok(list.grasps.dataset()?.is_in_trash(&asked))).await?;
    if !is_there {
        return Err(Failure::not_found(format!("{id} is not in the trash")));
    }
    carry_out(&backend, Command::Restore(id)).await
}

async fn existing(backend: &Arc<Backend>, id: &str) -> Result<GraspId, Failure> {
    let (backend, id) = (Arc::clone(backend), id_of(id)?);
    off_thread(move || {
        record_of(&backend.grasps.dataset()?, &id)?;
        Ok(id)
    })
    .await
}
