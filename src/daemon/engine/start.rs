//! Start of the engine and its threads.

use std::collections::{BTreeMap, VecDeque};
use std::path::Path;
use std::sync::Arc;
use std::sync::mpsc::channel;

use jiff::Timestamp;
use tokio::sync::mpsc;

use super::adapt::RigAdaptation;
use super::script::ScriptCommand;
use super::{Engine, EngineLinks, EngineSetup};
use crate::daemon::black_box::{BlackBox, Tap};
use crate::daemon::calibration::{store_calibration, stored_source};
use crate::daemon::capture::CaptureThreads;
use crate::daemon::decode;
use crate::daemon::hub::Hub;
use crate::daemon::infer::{Inference, ModelInfo, PredictionRules};
use crate::daemon::pre_grasp::PreGraspRecorder;
use crate::daemon::store::{Store, StoreContext, StoreMessage, pending_frame};
use gripcast_base::error::{Error, Result};
use gripcast_capture::calibration::{RigFile, SourceKind};
use gripcast_capture::camera::monotonic_ns;
use gripcast_capture::trigger::ScriptRunner;
use gripcast_dataset::{Dataset, DatasetWriter, PendingInitial, Provenance};
use gripcast_imaging::{CropProfile, Role};
use gripcast_nn::predict::Model;
use gripcast_session::{PendingFrame, Session};

impl Engine {
    pub(super) fn start(setup: EngineSetup, links: EngineLinks) -> Result<Self> {
        let crops = crop_profiles(&setup.rig, setup.model.as_ref())?;
        let newest_source_of = setup.index.path().to_owned();
        let limits = match (&setup.model, setup.decision.error_rate) {
            (Some(model), Some(error_rate)) => Some(model.conformal_limits(error_rate)?),
            _ => None,
        };
        let strength = setup.decision.adapt_strength;
        let adaptation = setup.model.as_ref().zip(strength).map(|(model, strength)| {
            RigAdaptation::new(setup.index.clone(), &setup.rig.id, model, strength)
        });
        let (mut writer, opened) = DatasetWriter::open_index(setup.index, &setup.new_dataset)?;
        let newest_source = newest_source(&newest_source_of, &opened.provenance);
        let calibration = store_calibration(
            &mut writer,
            &setup.rig,
            &setup.intrinsics,
            &setup.force_calibrations,
        )?;
        let model = setup.model.as_ref().map(ModelInfo::new);
        if let Some(model) = &model {
            writer.put_model(&model_card(model)?)?;
        }
        let dataset_name = writer.descriptor().name.clone();
        let resumed = opened.pending.as_ref().map(resumed);
        let counts = writer.counts().by_object.clone();
        let session = Session::new(setup.guards.clone(), setup.labels, counts, resumed)
            .with_revision(first_revision());

        let black_box = setup
            .black_box
            .map(|settings| {
                let provenance = provenance(&dataset_name, &setup.rig, model.as_ref());
                BlackBox::start(settings, setup.dataset.clone(), provenance)
            })
            .transpose()?;
        let tap = black_box.as_ref().map_or_else(Tap::default, BlackBox::tap);
        let hub = Hub::new(setup.rig.cameras.keys().copied(), tap);
        let (infer_requests, infer_inbox) = channel();
        let decoders = decode::start(
            &hub,
            |role| crops.get(&role).copied(),
            &infer_requests,
            &links.tasks,
        )?;
        let infer_channel = (infer_requests.clone(), infer_inbox);
        let inference = Inference::start(
            &hub,
            setup.model,
            PredictionRules {
                limits,
                depth_view: setup.rig.depth_view(),
            },
            (setup.gel_scales, setup.gel_forces),
            infer_channel,
            &links.tasks,
        )?;
        let external = setup.intrinsics.get(&Role::External).copied();
        let pre_grasp = PreGraspRecorder::start(&hub, setup.boards, external)?;
        let context = StoreContext {
            rig: setup.rig.id.clone(),
            calibration,
            crops,
        };
        let (reply_sender, replies) = mpsc::unbounded_channel();
        let store = Store::start(
            writer,
            opened.pending,
            context,
            infer_requests,
            reply_sender,
            &links.tasks,
        )?;
        let initial_revision = 0;
        if let Some(frame) = session.pending() {
            store.send(StoreMessage::UseInitial {
                id: Some(frame.id.clone()),
                revision: initial_revision,
            })?;
        }
        let capture = CaptureThreads::start(setup.openers, &hub, &setup.supervision, &links.tasks)?;
        let mut engine = Self {
            rig: setup.rig,
            dataset: setup.dataset,
            dataset_name,
            guards: setup.guards,
            hand: setup.hand,
            hub,
            capture,
            decoders,
            inference,
            pre_grasp,
            black_box,
            store,
            replies,
            links,
            session,
            queued: VecDeque::new(),
            ended: None,
            last_command: 0,
            pending: None,
            script: setup.script.map(ScriptRunner::new),
            script_command: ScriptCommand::default(),
            initial_revision,
            grasps: Vec::new(),
            undone: BTreeMap::new(),
            disk_free_bytes: None,
            target_per_object: setup.target_per_object,
            keep_lift: setup.keep_lift,
            lift: None,
            lifted: None,
            objects: Arc::default(),
            newest_source,
            opening: opened.notes,
            provenance: opened.provenance,
            model,
            adaptation,
            started: (Timestamp::now(), monotonic_ns()),
            start_report: Vec::new(),
            start_findings: BTreeMap::new(),
            was_live: BTreeMap::new(),
            last_task_states: BTreeMap::new(),
            ticks: 0,
        };
        // Before the first prediction.
        engine.adapt();
        Ok(engine)
    }
}

/// Returns the source of the newest grasp's frames; none where its calibration is unreadable.
fn newest_source(dataset: &Path, provenance: &Provenance) -> Option<SourceKind> {
    let key = provenance.calibration.as_ref()?;
    let text = Dataset::open(dataset).ok()?.calibration(key).ok()?;
    stored_source(&text)
}

/// First revision of a session: the wall clock, ms, so that revisions increase across restarts.
fn first_revision() -> u64 {
    u64::try_from(Timestamp::now().as_millisecond()).unwrap_or_default()
}

/// Converts a pending initial frame of an earlier run.
fn resumed(pending: &PendingInitial) -> PendingFrame {
    PendingFrame {
        // The monotonic clock may be of an earlier boot.
        trigger_time_ns: 0,
        ..pending_frame(pending)
    }
}

/// Returns the crop profile of every tactile camera after checking it against the model.
fn crop_profiles(rig: &RigFile, model: Option<&Model>) -> Result<BTreeMap<Role, CropProfile>> {
    rig.cameras
        .iter()
        .filter_map(|(role, camera)| Some((*role, camera.crop_profile.as_deref()?)))
        .map(|(role, name)| {
            let at_camera = |e: Error| e.at(format!("camera {role}"));
            let crop = CropProfile::by_name(name).map_err(at_camera)?;
            if let Some(model) = model {
                let contract = model.contract();
                contract
                    .check_crop_profile(crop.name())
                    .map_err(at_camera)?;
            }
            Ok((role, crop))
        })
        .collect()
}

/// Returns the model description stored in the dataset, with sorted keys.
fn model_card(model: &ModelInfo) -> Result<String> {
    serde_json::to_value(model)
        .and_then(|card| serde_json::to_string_pretty(&card))
        .map_err(|e| Error::internal("cannot serialise the model description").because(e))
}

/// Returns the metadata of the black box files.
fn provenance(dataset: &str, rig: &RigFile, model: Option<&ModelInfo>) -> BTreeMap<String, String> {
    let model = model.map(|model| {
        [
            ("model", model.name.clone()),
            ("model_sha256", model.sha256.clone()),
            ("threshold", model.threshold.to_string()),
        ]
    });
    [("dataset", dataset.to_owned()), ("rig", rig.id.clone())]
        .into_iter()
        .chain(model.into_iter().flatten())
        .map(|(key, value)| (key.to_owned(), value))
        .collect()
}
