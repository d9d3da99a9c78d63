//! How everything that the engine joins is started.

use std::collections::{BTreeMap, VecDeque};
use std::sync::mpsc::channel;

use tokio::sync::mpsc;

use super::script::ScriptCommand;
use super::{Engine, EngineLinks, EngineSetup};
use crate::daemon::approach::ApproachWatch;
use crate::daemon::black_box::{BlackBox, Tap};
use crate::daemon::calibration::store_calibration;
use crate::daemon::capture::CaptureThreads;
use crate::daemon::decode;
use crate::daemon::hub::Hub;
use crate::daemon::infer::{Inference, ModelFacts};
use crate::daemon::store::{Store, StoreContext, StoreMessage, pending_frame};
use gripcast_base::error::{Error, Result};
use gripcast_capture::calibration::RigFile;
use gripcast_capture::trigger::ScriptRunner;
use gripcast_dataset::{DatasetWriter, PendingInitial};
use gripcast_imaging::{CropProfile, Role};
use gripcast_nn::predict::Model;
use gripcast_session::{PendingFrame, Session};

impl Engine {
    pub(super) fn start(setup: EngineSetup, links: EngineLinks) -> Result<Self> {
        let crops = crop_profiles(&setup.rig, setup.model.as_ref())?;
        let (mut writer, opened) =
            DatasetWriter::open_or_create(&setup.dataset, &setup.new_dataset)?;
        let calibration = store_calibration(&mut writer, &setup.rig, &setup.intrinsics)?;
        let model = setup.model.as_ref().map(ModelFacts::of);
        if let Some(model) = &model {
            writer.put_model(&model_card(model)?)?;
        }
        let dataset_name = writer.descriptor().name.clone();
        let resumed = opened.pending.as_ref().map(resumed);
        let counts = writer.counts().by_object.clone();
        let session = Session::new(setup.guards.clone(), setup.labels, counts, resumed);

        let black_box = setup
            .black_box
            .map(|settings| {
                let origin = origin(&dataset_name, &setup.rig, model.as_ref());
                BlackBox::start(settings, setup.dataset.clone(), origin)
            })
            .transpose()?;
        let tap = black_box.as_ref().map_or_else(Tap::default, BlackBox::tap);
        let hub = Hub::tapped(setup.rig.cameras.keys().copied(), tap);
        let (infer_requests, infer_inbox) = channel();
        let decoders = decode::start(
            &hub,
            |role| crops.get(&role).copied(),
            &infer_requests,
            &links.tasks,
        )?;
        let infer_channel = (infer_requests.clone(), infer_inbox);
        let inference = Inference::start(&hub, setup.model, infer_channel, &links.tasks)?;
        let external = setup.intrinsics.get(&Role::External).copied();
        let approach = ApproachWatch::start(&hub, setup.boards, external)?;
        let context = StoreContext {
            rig: setup.rig.id.clone(),
            calibration,
            has_model: model.is_some(),
            crops,
        };
        let (answers, replies) = mpsc::unbounded_channel();
        let store = Store::start(
            writer,
            opened.pending,
            context,
            infer_requests,
            answers,
            &links.tasks,
        )?;
        let initial_change = 0;
        if let Some(frame) = session.pending() {
            store.send(StoreMessage::UseInitial {
                id: Some(frame.id.clone()),
                change: initial_change,
            })?;
        }
        let capture = CaptureThreads::start(setup.openers, &hub, &setup.supervision, &links.tasks)?;
        Ok(Self {
            rig: setup.rig,
            dataset: setup.dataset,
            dataset_name,
            guards: setup.guards,
            hand: setup.hand,
            hub,
            capture,
            decoders,
            inference,
            approach,
            black_box,
            store,
            replies,
            links,
            session,
            waiting: VecDeque::new(),
            last_command: 0,
            pending: None,
            script: setup.script.map(ScriptRunner::new),
            script_command: ScriptCommand::default(),
            initial_change,
            grasps: Vec::new(),
            taken_back: BTreeMap::new(),
            disk_free_bytes: None,
            was_live: BTreeMap::new(),
            tasks_were: BTreeMap::new(),
            ticks: 0,
        })
    }
}

/// An initial frame of an earlier run.
fn resumed(pending: &PendingInitial) -> PendingFrame {
    PendingFrame {
        // The monotonic clock may have been another boot's.
        trigger_time_ns: 0,
        ..pending_frame(pending)
    }
}

/// Crop profile of every tactile camera, which has to be the model's.
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

/// What the dataset keeps of a model, keys in alphabetical order.
fn model_card(model: &ModelFacts) -> Result<String> {
    serde_json::to_value(model)
        .and_then(|card| serde_json::to_string_pretty(&card))
        .map_err(|e| Error::internal("cannot write the model card").because(e))
}

/// What the files of the black box say about themselves.
fn origin(dataset: &str, rig: &RigFile, model: Option<&ModelFacts>) -> BTreeMap<String, String> {
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
