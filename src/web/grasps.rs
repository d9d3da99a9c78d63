//! Saved grasps over HTTP: list, records, files, previews, labels and trash.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use axum::extract::{Query, State as Shared};
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::{Extension, Json};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::backend::Backend;
use super::cameras::Segment;
use super::commands::{Body, Reply, SenderBody, execute};
use super::failure::{ErrorResponse, Failure};
use super::grasp_list::{GraspPage, GraspQuery};
use super::sender::{Arrival, Sender};
use crate::daemon::EngineStatus;
use gripcast_base::error::{Error, ErrorKind, Result as CrateResult};
use gripcast_base::files::{FileKind, Label, ObjectName};
use gripcast_dataset::{Dataset, GraspId, GraspRecord, NameChange, Outcome, Stage};
use gripcast_imaging::{
    CropProfile, Decoder, DepthImage, Frame, PixelFormat, Role, TactileDifference,
    decode_png_grey16, encode_jpeg,
};
use gripcast_session::Command;

/// Size of the previews, px.
const PREVIEW_WIDTH: u32 = 320;
const PREVIEW_HEIGHT: u32 = 240;
/// JPEG quality of the previews.
const QUALITY: u8 = 80;
/// Retry delay if all decoders are busy.
const DECODE_RETRY: Duration = Duration::from_secs(1);
/// Gain of the tactile difference, as on the operator's screen.
const DIFFERENCE_GAIN: f32 = 1.5;

/// An outcome for a grasp.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct LabelBody {
    outcome: Outcome,
    #[serde(default)]
    sender: Sender,
}

/// New names of a grasp; an absent name stays, an empty scene or operator removes the name.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct EditBody {
    #[schema(value_type = Option<String>, min_length = 1, max_length = 120)]
    object: Option<ObjectName>,
    #[schema(value_type = Option<String>, max_length = 120)]
    scene: Option<Label>,
    #[schema(value_type = Option<String>, max_length = 120)]
    operator: Option<Label>,
    #[serde(default)]
    sender: Sender,
}

/// Decodes images on blocking threads, at most one per core at a time.
async fn decode<T: Send + 'static>(
    backend: &Backend,
    work: impl FnOnce() -> Result<T, Failure> + Send + 'static,
) -> Result<T, Failure> {
    let permit = Arc::clone(&backend.decodes).acquire_owned();
    let Ok(Ok(permit)) = tokio::time::timeout(backend.decode_timeout, permit).await else {
        return Err(Failure::busy(format!(
            "no image decoder was free within {} s",
            backend.decode_timeout.as_secs_f64()
        ))
        .remedy("try again")
        .retry_after(DECODE_RETRY));
    };
    off_thread(move || {
        // Held until the work ends, even if the client has disconnected.
        let _permit = permit;
        work()
    })
    .await
}

/// Runs file operations on a blocking thread.
async fn off_thread<T: Send + 'static>(
    work: impl FnOnce() -> Result<T, Failure> + Send + 'static,
) -> Result<T, Failure> {
    tokio::task::spawn_blocking(work).await.unwrap_or_else(|_| {
        Err(Failure::new(
            StatusCode::INTERNAL_SERVER_ERROR,
            "the request handler panicked",
        ))
    })
}

fn parse_id(text: &str) -> Result<GraspId, Failure> {
    Ok(GraspId::parse(text)?)
}

fn record_of(dataset: &Dataset, id: &GraspId) -> Result<GraspRecord, Failure> {
    dataset.grasp(id).map_err(|error| match error.kind() {
        ErrorKind::NotFound => Failure::not_found(format!("grasp {id} not found")),
        _ => error.into(),
    })
}

/// Saved grasps, newest first
#[utoipa::path(get, path = "/api/grasps", tag = "grasps", params(GraspQuery),
    responses((status = 200, body = GraspPage), (status = 400, body = ErrorResponse), (status = 404, body = ErrorResponse),
        (status = 422, body = ErrorResponse)))]
pub(crate) async fn list(
    Shared(backend): Shared<Arc<Backend>>,
    query: Result<Query<GraspQuery>, axum::extract::rejection::QueryRejection>,
) -> Result<Json<GraspPage>, Failure> {
    let Query(query) = query.map_err(|e| Failure::new(e.status(), e.body_text()))?;
    off_thread(move || Ok(Json(backend.grasps.page(&query)?))).await
}

/// Number of grasps of an object.
#[derive(Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct ObjectCounts {
    /// Object; empty if unnamed.
    object: String,
    stable: usize,
    slip: usize,
    unlabelled: usize,
}

/// The objects of the dataset.
#[derive(Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct ObjectList {
    /// Labelled grasps wanted per object; 0: no target.
    target_per_object: u32,
    /// Objects with grasps, by name.
    objects: Vec<ObjectCounts>,
}

impl ObjectList {
    fn new(status: &EngineStatus) -> Self {
        let counts = |(object, counts): (&ObjectName, &BTreeMap<Outcome, usize>)| {
            let count = |outcome| counts.get(&outcome).copied().unwrap_or(0);
            ObjectCounts {
                object: object.to_string(),
                stable: count(Outcome::Stable),
                slip: count(Outcome::Slip),
                unlabelled: count(Outcome::Unlabelled),
            }
        };
        Self {
            target_per_object: status.target_per_object,
            objects: status
                .objects
                .iter()
                .map(counts)
                .filter(|each| each.stable + each.slip + each.unlabelled > 0)
                .collect(),
        }
    }
}

/// Objects with their number of grasps
///
/// As of the last second.
#[utoipa::path(get, path = "/api/objects", tag = "grasps", responses((status = 200, body = ObjectList)))]
pub(crate) async fn objects(Shared(backend): Shared<Arc<Backend>>) -> Json<ObjectList> {
    Json(ObjectList::new(&backend.status.borrow()))
}

/// The record of a grasp: its grasp.json
#[utoipa::path(get, path = "/api/grasps/{id}", tag = "grasps", params(("id" = String, Path)),
    responses((status = 200, body = serde_json::Value), (status = 404, body = ErrorResponse), (status = 422, body = ErrorResponse)))]
pub(crate) async fn record(
    Shared(backend): Shared<Arc<Backend>>,
    Segment(id): Segment<String>,
) -> Result<Json<serde_json::Value>, Failure> {
    let id = parse_id(&id)?;
    off_thread(move || {
        let record = record_of(&backend.grasps.dataset()?, &id)?;
        let json = serde_json::to_value(record)
            .map_err(|e| Error::internal("cannot write JSON").because(e))?;
        Ok(Json(json))
    })
    .await
}

/// A file of a grasp as stored on disk
#[utoipa::path(get, path = "/api/grasps/{id}/files/{name}", tag = "grasps",
    params(("id" = String, Path), ("name" = String, Path)),
    responses((status = 200, body = [u8], content_type = "application/octet-stream"),
        (status = 404, body = ErrorResponse), (status = 422, body = ErrorResponse)))]
pub(crate) async fn file(
    Shared(backend): Shared<Arc<Backend>>,
    Segment((id, name)): Segment<(String, String)>,
) -> Result<Response, Failure> {
    let id = parse_id(&id)?;
    off_thread(move || {
        let dataset = backend.grasps.dataset()?;
        let record = record_of(&dataset, &id)?;
        let path = dataset.file(&record, &name).ok_or_else(|| {
            Failure::not_found(format!("{id} has no file `{name}`"))
                .remedy("the record of the grasp lists its files")
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

/// Contents of a preview.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub(crate) enum PreviewKind {
    /// Before the gripper closed.
    Initial,
    /// After it closed.
    Grasp,
    /// Tactile difference, grey for no change.
    Difference,
}

/// Preview of a grasp
///
/// 320×240; tactile images cropped as for the model, depth in colour with its scale.
#[utoipa::path(get, path = "/api/grasps/{id}/preview/{kind}/{file}", tag = "grasps",
    params(("id" = String, Path), ("kind" = PreviewKind, Path),
        ("file" = String, Path, description = "`ROLE.jpg`", pattern = "^(left|right|rgb|depth|external)\\.jpg$")),
    responses((status = 200, body = [u8], content_type = "image/jpeg"), (status = 400, body = ErrorResponse),
        (status = 404, body = ErrorResponse), (status = 422, body = ErrorResponse),
        (status = 503, body = ErrorResponse, description = "all decoders are busy; see `Retry-After`")))]
pub(crate) async fn preview(
    Shared(backend): Shared<Arc<Backend>>,
    Segment((id, kind, file)): Segment<(String, PreviewKind, String)>,
) -> Result<Response, Failure> {
    let id = parse_id(&id)?;
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
        let jpeg = preview_jpeg(&dataset, &record, kind, role)?;
        // Images of a grasp never change.
        let headers = [
            (header::CONTENT_TYPE, "image/jpeg"),
            (header::CACHE_CONTROL, "private, max-age=86400, immutable"),
        ];
        Ok((headers, jpeg).into_response())
    })
    .await
}

fn preview_jpeg(
    dataset: &Dataset,
    record: &GraspRecord,
    kind: PreviewKind,
    role: Role,
) -> CrateResult<Vec<u8>> {
    let mut decoder = Decoder::new()?;
    let mut image = |stage| stored_image(&mut decoder, dataset, record, stage, role);
    let shown = match kind {
        PreviewKind::Initial => image(Stage::Initial)?,
        PreviewKind::Grasp => image(Stage::Grasp)?,
        PreviewKind::Difference if role.is_tactile() => {
            let (initial, grasp) = (image(Stage::Initial)?, image(Stage::Grasp)?);
            TactileDifference::between(&initial, &grasp)?.to_image(DIFFERENCE_GAIN)
        }
        PreviewKind::Difference => {
            return Err(Error::input(format!(
                "only tactile cameras have a difference, found `{role}`"
            )));
        }
    };
    encode_jpeg(&shown, QUALITY)
}

fn stored_image(
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
            // A rebuilt record lacks the unit; nearly all depth cameras count millimetres.
            let unit_m = camera.depth_unit_m.unwrap_or(0.001);
            Ok(decoder.depth_preview(&depth_frame(&depth), unit_m, width, height)?)
        }),
        _ => decoder.decode_file(&bytes, crop.as_ref(), width, height),
    };
    image.map_err(|e| e.at(path.display()))
}

/// Converts a depth image to a Z16 frame.
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

/// Label a grasp
#[utoipa::path(post, path = "/api/grasps/{id}/label", tag = "grasps", params(("id" = String, Path)),
    request_body = LabelBody,
    responses((status = 200, body = super::commands::CommandResponse), (status = 400, body = ErrorResponse),
        (status = 404, body = ErrorResponse), (status = 408, body = ErrorResponse), (status = 413, body = ErrorResponse), (status = 415, body = ErrorResponse),
        (status = 422, body = ErrorResponse), (status = 500, body = super::commands::CommandResponse), (status = 503, body = ErrorResponse)))]
pub(crate) async fn label(
    Shared(backend): Shared<Arc<Backend>>,
    Segment(id): Segment<String>,
    Extension(arrival): Extension<Arrival>,
    Body(request): Body<LabelBody>,
) -> Reply {
    let id = existing(&backend, &id).await?;
    let command = Command::Relabel(id, request.outcome);
    execute(&backend, command, request.sender, arrival).await
}

/// Correct object, scene or operator of a grasp
///
/// Absent names stay; an empty scene or operator removes the name. One undo reverts all names of a
/// request.
#[utoipa::path(patch, path = "/api/grasps/{id}", tag = "grasps", params(("id" = String, Path)),
    request_body = EditBody,
    responses((status = 200, body = super::commands::CommandResponse), (status = 400, body = ErrorResponse),
        (status = 404, body = ErrorResponse), (status = 408, body = ErrorResponse), (status = 413, body = ErrorResponse), (status = 415, body = ErrorResponse),
        (status = 422, body = ErrorResponse), (status = 500, body = super::commands::CommandResponse), (status = 503, body = ErrorResponse)))]
pub(crate) async fn edit(
    Shared(backend): Shared<Arc<Backend>>,
    Segment(id): Segment<String>,
    Extension(arrival): Extension<Arrival>,
    Body(request): Body<EditBody>,
) -> Reply {
    let names = NameChange {
        object: request.object,
        scene: request.scene,
        operator: request.operator,
    };
    if names.is_empty() {
        return Err(Failure::input(
            "expected at least one of object, scene and operator, found none",
        ));
    }
    let id = existing(&backend, &id).await?;
    execute(&backend, Command::Edit(id, names), request.sender, arrival).await
}

/// Move a grasp to the trash
#[utoipa::path(post, path = "/api/grasps/{id}/trash", tag = "grasps", params(("id" = String, Path)),
    request_body = Option<SenderBody>,
    responses((status = 200, body = super::commands::CommandResponse), (status = 404, body = ErrorResponse),
        (status = 422, body = ErrorResponse), (status = 500, body = super::commands::CommandResponse), (status = 503, body = ErrorResponse)))]
pub(crate) async fn trash(
    Shared(backend): Shared<Arc<Backend>>,
    Segment(id): Segment<String>,
    Extension(arrival): Extension<Arrival>,
    body: Option<Body<SenderBody>>,
) -> Reply {
    let id = existing(&backend, &id).await?;
    execute(&backend, Command::Trash(id), sender_of(body), arrival).await
}

/// Restore a grasp from the trash
#[utoipa::path(post, path = "/api/grasps/{id}/restore", tag = "grasps", params(("id" = String, Path)),
    request_body = Option<SenderBody>,
    responses((status = 200, body = super::commands::CommandResponse),
        (status = 404, body = ErrorResponse, description = "not in the trash"), (status = 422, body = ErrorResponse),
        (status = 500, body = super::commands::CommandResponse, description = "damaged, or to be restored with redo"),
        (status = 503, body = ErrorResponse)))]
pub(crate) async fn restore(
    Shared(backend): Shared<Arc<Backend>>,
    Segment(id): Segment<String>,
    Extension(arrival): Extension<Arrival>,
    body: Option<Body<SenderBody>>,
) -> Reply {
    let id = parse_id(&id)?;
    let (trashed, list) = (id.clone(), Arc::clone(&backend));
    let is_in_trash = off_thread(move || Ok(list.grasps.dataset()?.is_in_trash(&trashed))).await?;
    if !is_in_trash {
        return Err(Failure::not_found(format!("{id} is not in the trash")));
    }
    execute(&backend, Command::Restore(id), sender_of(body), arrival).await
}

fn sender_of(body: Option<Body<SenderBody>>) -> Sender {
    body.map(|Body(body)| body.sender).unwrap_or_default()
}

async fn existing(backend: &Arc<Backend>, id: &str) -> Result<GraspId, Failure> {
    let (backend, id) = (Arc::clone(backend), parse_id(id)?);
    off_thread(move || {
        record_of(&backend.grasps.dataset()?, &id)?;
        Ok(id)
    })
    .await
}

#[cfg(test)]
mod tests {
    use gripcast_session::Labels;

    use super::*;

    #[test]
    fn objects_have_their_counts_and_the_target() {
        let name = |text: &str| text.parse::<ObjectName>().unwrap();
        let mut status = EngineStatus::starting("d", "bench", Labels::default());
        status.target_per_object = 20;
        status.objects = Arc::new(BTreeMap::from([
            (
                name("mug"),
                BTreeMap::from([(Outcome::Stable, 3), (Outcome::Unlabelled, 1)]),
            ),
            (name("cup"), BTreeMap::from([(Outcome::Slip, 2)])),
            (name("gone"), BTreeMap::from([(Outcome::Slip, 0)])),
        ]));
        let counts = |object: &str, stable, slip, unlabelled| ObjectCounts {
            object: object.into(),
            stable,
            slip,
            unlabelled,
        };
        let expected = ObjectList {
            target_per_object: 20,
            objects: vec![counts("cup", 0, 2, 0), counts("mug", 3, 0, 1)],
        };
        assert_eq!(ObjectList::new(&status), expected);
    }
}
