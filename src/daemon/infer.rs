//! Inference on every new tactile image, on its own thread.

use std::collections::{BTreeMap, VecDeque};
use std::ops::ControlFlow;
use std::sync::mpsc::{Receiver, Sender};
use std::sync::{Arc, Mutex, MutexGuard};
use std::thread::JoinHandle;
use std::time::Instant;

use image::RgbImage;
use serde::Serialize;
use utoipa::ToSchema;

#[cfg(test)]
use super::black_box::Tap;
use super::black_box::Topic;
use super::decision::{decided, limits_of, with_doubt};
use super::gels::GelJudge;
use super::histogram::LatencyHistogram;
use super::hub::{Decoded, Hub};
use super::live_lift::{LiveLift, draw_outline};
use super::shear::{GelForces, GelScale, GelTrackers, draw_markers};
use super::status::{LiftStatus, LiveMarkers, PredictionStatus, Preview, ShearStatus};
use super::tasks::{Heartbeat, Tasks};
use super::thread::lock;
use gripcast_base::error::Result;
use gripcast_capture::camera::monotonic_ns;
use gripcast_dataset::PredictionRecord;
use gripcast_imaging::{
    Depth, DepthView, GelChange, GelState, ObjectTracker, Role, TactileDifference,
};
use gripcast_nn::predict::{
    Adaptation, ConformalLimits, LivePrediction, LivePredictor, Model, Smoothing,
};
use gripcast_shear::{FingerForce, GelMotion, MarkerField, ShearFrame};

/// Gain of the displayed difference.
const PREVIEW_GAIN: f32 = 1.5;

/// How predictions are made.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct PredictionRules {
    /// Limits of the prediction sets.
    pub(super) limits: Option<ConformalLimits>,
    /// View of the depth images; a model does not get those of an unknown one.
    pub(super) depth_view: Option<DepthView>,
}

/// Requests to the inference thread.
#[derive(Debug)]
pub(super) enum InferRequest {
    /// A camera has a new decoded image.
    NewImage(Role),
    /// Use these images as the initial frame.
    SetInitial {
        /// Revision of the initial frame.
        revision: u64,
        /// Left gel, open gripper.
        left: Arc<RgbImage>,
        /// Right gel, open gripper.
        right: Arc<RgbImage>,
    },
    /// Until the first initial frame (revision 1), compare the gels with these images of the
    /// dataset's newest one (revision 0).
    SetReference {
        /// Left gel, open gripper.
        left: Arc<RgbImage>,
        /// Right gel, open gripper.
        right: Arc<RgbImage>,
    },
    /// Adapt predictions to this base rate from now on.
    SetAdaptation(Adaptation),
    /// Stop predicting, for this reason. Contact is still measured against the last initial frame.
    ClearInitial(String),
    /// Predict and measure shear on exactly these images and the current initial frame.
    Analyse {
        /// Images by role.
        images: BTreeMap<Role, RgbImage>,
        /// Depth image.
        depth: Option<Depth>,
        /// Receives the results.
        reply: Sender<SavedAnalysis>,
    },
    /// End the thread.
    Stop,
}

/// What the images of a saved frame say.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct SavedAnalysis {
    /// The prediction, if there is one.
    pub(super) prediction: Option<PredictionRecord>,
    /// Shear by gel.
    pub(super) shear: BTreeMap<Role, ShearFrame>,
    /// Force by gel.
    pub(super) force: BTreeMap<Role, FingerForce>,
}

/// The model used for predictions.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub struct ModelInfo {
    /// Name.
    pub name: String,
    /// SHA-256 of the ONNX file.
    pub sha256: String,
    /// Minimum probability of a stable grasp.
    pub threshold: f64,
    /// Whether the model is a heuristic rather than trained.
    pub heuristic: bool,
}

impl ModelInfo {
    /// Reads the description of a model.
    pub fn new(model: &Model) -> Self {
        Self {
            name: model.contract().name.clone(),
            sha256: model.sha256().to_owned(),
            threshold: model.contract().threshold,
            heuristic: model.contract().is_heuristic(),
        }
    }

    fn record(&self, prediction: &LivePrediction, latency_ms: f64) -> PredictionRecord {
        PredictionRecord {
            p_stable: prediction.p_stable,
            ood_score: prediction.ood_score,
            unsure_reason: None,
            adapted: None,
            set: None,
            threshold: prediction.threshold,
            inputs: Some(prediction.modality.name().to_owned()),
            geometry: prediction.geometry,
            model_sha256: self.sha256.clone(),
            model: self.name.clone(),
            latency_ms,
            engine_ms: prediction.engine_ms,
        }
    }
}

/// Contact of one gel relative to the initial frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Contact {
    /// Mean absolute difference, grey levels.
    pub(super) mean_abs: f64,
    /// Driver time of the compared frame, ns.
    pub(super) frame_time_ns: u64,
    /// Contact or illumination.
    pub(super) change: GelChange,
}

/// Newest results of inference.
#[derive(Debug, Default)]
pub(super) struct InferenceState {
    /// Newest prediction; `None` without an initial frame.
    pub(super) live: Option<PredictionStatus>,
    /// Verdict in the lift of the last saved grasp.
    pub(super) lift: Option<LiftStatus>,
    /// Reason why there is no prediction.
    pub(super) unavailable: Option<String>,
    /// Contact by gel, relative to the initial frame of `revision`.
    pub(super) contact: BTreeMap<Role, Contact>,
    /// Revision of the initial frame in use. Not its id: after an undo the same frame returns, and
    /// earlier comparisons with it are stale.
    pub(super) revision: Option<u64>,
    /// State of each gel.
    pub(super) gels: BTreeMap<Role, GelState>,
    /// Time to judge a tactile image, ms.
    pub(super) judge_time: LatencyHistogram,
    /// Shear of each gel, relative to the initial frame of `revision`.
    pub(super) shear: BTreeMap<Role, ShearStatus>,
    /// Force on each gel, relative to the initial frame of `revision`.
    pub(super) force: BTreeMap<Role, FingerForce>,
    /// Gel markers in the newest image of each gel that has them.
    pub(super) marker_fields: BTreeMap<Role, LiveMarkers>,
    /// Time to measure the shear of a tactile image, ms.
    pub(super) shear_time: LatencyHistogram,
    /// Preview images.
    pub(super) previews: BTreeMap<Role, Preview>,
    /// Number of predictions.
    pub(super) predictions: u64,
    /// Number of failed predictions.
    pub(super) failures: u64,
    /// Latency from frame to prediction, ms.
    pub(super) latency: LatencyHistogram,
    /// Latency from the newest frame of a gel to the verdict in the lift, ms.
    pub(super) lift_latency: LatencyHistogram,
    /// Number of verdicts in the lift: all, those with the motion of the object.
    pub(super) lift_verdicts: [u64; 2],
}

impl InferenceState {
    /// Returns the change of a gel relative to the initial frame of `revision`, in a frame newer
    /// than `since_ns`, or `None` before the first such frame.
    pub(super) fn change(
        &self,
        role: Role,
        revision: Option<u64>,
        since_ns: u64,
    ) -> Option<GelChange> {
        let contact = self
            .contact
            .get(&role)
            .filter(|_| self.revision == revision)?;
        (contact.frame_time_ns > since_ns).then_some(contact.change)
    }

    /// Returns the mean absolute difference of each gel, grey levels.
    pub(super) fn contact_levels(&self) -> BTreeMap<Role, f64> {
        let contacts = self.contact.iter();
        contacts.map(|(role, c)| (*role, c.mean_abs)).collect()
    }
}

/// The inference thread.
#[derive(Debug)]
pub(super) struct Inference {
    state: Arc<Mutex<InferenceState>>,
    /// Request channel.
    pub(super) requests: Sender<InferRequest>,
    thread: JoinHandle<()>,
    /// Name of the model.
    pub(super) model: Option<String>,
}

impl Inference {
    /// Starts the thread. Without a model it measures contact and makes previews; with `limits` it
    /// predicts sets of outcomes.
    ///
    /// # Errors
    /// Errors of loading the model or starting the thread.
    pub(super) fn start(
        hub: &Hub,
        model: Option<Model>,
        rules: PredictionRules,
        (scales, forces): (BTreeMap<Role, GelScale>, GelForces),
        (requests, inbox): (Sender<InferRequest>, Receiver<InferRequest>),
        tasks: &Tasks,
    ) -> Result<Self> {
        let info = model.as_ref().map(ModelInfo::new);
        let state = Arc::new(Mutex::new(InferenceState {
            unavailable: Some(if model.is_some() {
                "no initial frame".into()
            } else {
                "no model".into()
            }),
            ..InferenceState::default()
        }));
        let name = info.as_ref().map(|info| info.name.clone());
        let predictor = model.map(LivePredictor::new).transpose()?;
        let trackers = GelTrackers::new(scales, forces);
        let mut worker = Worker::new(hub, predictor.zip(info), trackers, &state);
        worker.rules = rules;
        let thread = tasks.spawn("inference", move |heartbeat| worker.run(&inbox, heartbeat))?;
        Ok(Self {
            state,
            requests,
            thread,
            model: name,
        })
    }

    /// Returns the newest results.
    pub(super) fn state(&self) -> MutexGuard<'_, InferenceState> {
        lock(&self.state)
    }

    /// Ends the thread and returns its last results.
    pub(super) fn stop(self) -> Arc<Mutex<InferenceState>> {
        // Both fail only if the thread has already ended.
        let _ = self.requests.send(InferRequest::Stop);
        let _ = self.thread.join();
        self.state
    }
}

struct Worker {
    hub: Hub,
    predictor: Option<(LivePredictor, ModelInfo)>,
    rules: PredictionRules,
    /// Base rate that predictions are adapted to.
    adaptation: Option<Adaptation>,
    initial: BTreeMap<Role, Arc<RgbImage>>,
    gels: GelJudge,
    trackers: GelTrackers,
    predicting: bool,
    /// Whether the images have been compared with an initial frame of this session.
    has_initial: bool,
    smoothing: Smoothing,
    /// The lift of the last saved grasp.
    lift: Option<LiveLift>,
    /// Serial of the newest image used, by role.
    seen: BTreeMap<Role, u64>,
    state: Arc<Mutex<InferenceState>>,
}

impl Worker {
    fn new(
        hub: &Hub,
        predictor: Option<(LivePredictor, ModelInfo)>,
        trackers: GelTrackers,
        state: &Arc<Mutex<InferenceState>>,
    ) -> Self {
        Self {
            hub: hub.clone(),
            predictor,
            rules: PredictionRules::default(),
            adaptation: None,
            initial: BTreeMap::new(),
            gels: GelJudge::default(),
            trackers,
            predicting: false,
            has_initial: false,
            smoothing: Smoothing::default(),
            lift: None,
            seen: BTreeMap::new(),
            state: Arc::clone(state),
        }
    }

    /// Handles requests before new images; of each camera only the newest image is used.
    fn run(&mut self, inbox: &Receiver<InferRequest>, heartbeat: &Heartbeat) {
        let mut new_images = VecDeque::new();
        loop {
            if new_images.is_empty() {
                heartbeat.idle();
                let Ok(request) = inbox.recv() else { return };
                heartbeat.busy();
                if self.handle(request, &mut new_images).is_break() {
                    return;
                }
            }
            for request in inbox.try_iter() {
                if self.handle(request, &mut new_images).is_break() {
                    return;
                }
            }
            heartbeat.busy();
            if let Some(role) = new_images.pop_front() {
                self.on_new_image(role);
            }
        }
    }

    /// Handles a request; new images are queued.
    fn handle(
        &mut self,
        request: InferRequest,
        new_images: &mut VecDeque<Role>,
    ) -> ControlFlow<()> {
        match request {
            InferRequest::NewImage(role) if new_images.contains(&role) => {}
            InferRequest::NewImage(role) => new_images.push_back(role),
            InferRequest::SetInitial {
                revision,
                left,
                right,
            } => self.set_initial(revision, left, right),
            InferRequest::SetReference { left, right } => self.compare_with(0, left, right),
            InferRequest::SetAdaptation(adaptation) => self.adaptation = Some(adaptation),
            InferRequest::ClearInitial(reason) => self.clear_initial(reason),
            InferRequest::Analyse {
                images,
                depth,
                reply,
            } => {
                // The requester may have timed out.
                let _ = reply.send(self.analyse_saved(images, depth.as_ref()));
            }
            InferRequest::Stop => return ControlFlow::Break(()),
        }
        ControlFlow::Continue(())
    }

    fn set_initial(&mut self, revision: u64, left: Arc<RgbImage>, right: Arc<RgbImage>) {
        if let Some((predictor, _)) = &mut self.predictor {
            predictor.set_initial((*left).clone(), (*right).clone());
        }
        self.compare_with(revision, left, right);
        self.predicting = true;
        self.lift = None;
        lock(&self.state).lift = None;
        self.has_initial = true;
        self.smoothing.clear();
        lock(&self.state).live = None;
    }

    /// Compares the gels with these images from now on.
    fn compare_with(&mut self, revision: u64, left: Arc<RgbImage>, right: Arc<RgbImage>) {
        self.gels.set_initial([&left, &right]);
        self.trackers
            .set_initial([(Role::Left, &*left), (Role::Right, &*right)]);
        self.initial = BTreeMap::from([(Role::Left, left), (Role::Right, right)]);
        let mut state = lock(&self.state);
        state.contact.clear();
        state.shear = self.trackers.unavailable().collect();
        state.force.clear();
        state.marker_fields.clear();
        state.revision = Some(revision);
    }

    fn clear_initial(&mut self, reason: String) {
        self.predicting = false;
        let mut state = lock(&self.state);
        state.live = None;
        if let Some((predictor, _)) = &mut self.predictor {
            predictor.clear_initial();
            state.unavailable = Some(reason);
        }
    }

    fn on_new_image(&mut self, role: Role) {
        let Some(decoded) = self.hub.slot(role).and_then(|slot| slot.latest()) else {
            return;
        };
        if self.seen.insert(role, decoded.serial) == Some(decoded.serial) {
            return;
        }
        let difference = self
            .initial
            .get(&role)
            .and_then(|initial| TactileDifference::between(initial, &decoded.image).ok());
        let change = role
            .is_tactile()
            .then(|| self.judge(role, &decoded))
            .flatten();
        let contact = difference
            .as_ref()
            .zip(change)
            .map(|(difference, change)| Contact {
                mean_abs: f64::from(difference.mean_abs()),
                frame_time_ns: decoded.driver_time_ns,
                change,
            });
        if let Some(contact) = contact {
            lock(&self.state).contact.insert(role, contact);
        }
        if let Some((predictor, _)) = &mut self.predictor {
            show(predictor, role, &decoded, self.rules);
            if role.is_tactile() {
                self.predict();
            }
        }
        if let Some((lift, depth, view)) = self.lift_depth(&decoded) {
            lift.add_depth(depth, view, decoded.driver_time_ns);
        }
        // After the prediction, which does not wait for the shear.
        let level = difference.as_ref().map(TactileDifference::mean_abs);
        let field = self.measure_shear(role, &decoded, level);
        // Also while the object is lifted, when there is no prediction.
        let levels = difference.filter(|_| self.has_initial).map(Arc::new);
        let difference = levels.as_ref().map(|levels| {
            let mut image = levels.to_image(PREVIEW_GAIN);
            if let Some(field) = &field {
                draw_markers(&mut image, field);
            }
            Arc::new(image)
        });
        let preview = Preview {
            image: self.with_outline(role, &decoded),
            difference,
            levels,
            driver_time_ns: decoded.driver_time_ns,
        };
        lock(&self.state).previews.insert(role, preview);
    }

    /// The image of a camera for people: that of the colour camera with an outline of the object
    /// where the model sees it.
    fn with_outline(&self, role: Role, decoded: &Decoded) -> Arc<RgbImage> {
        let geometry = match role {
            Role::Rgb => lock(&self.state)
                .live
                .as_ref()
                .and_then(|l| l.record.geometry),
            _ => None,
        };
        let Some(geometry) = geometry else {
            return Arc::clone(&decoded.image);
        };
        let mut image = (*decoded.image).clone();
        draw_outline(&mut image, &geometry);
        Arc::new(image)
    }

    /// The lift, and an image of the depth camera for it.
    fn lift_depth<'a>(
        &'a mut self,
        decoded: &'a Decoded,
    ) -> Option<(&'a mut LiveLift, &'a Depth, DepthView)> {
        let depth = decoded.depth.as_ref()?;
        Some((self.lift.as_mut()?, depth, self.rules.depth_view?))
    }

    /// Updates the verdict in the lift once both gels have a new image.
    fn follow_lift(&mut self, role: Role, motion: GelMotion, time_ns: u64) {
        let head = self.predictor.as_ref();
        let head = head.and_then(|(predictor, _)| predictor.model().lift_head());
        let (Some(lift), Some(head)) = (&mut self.lift, head) else {
            return;
        };
        if let Some(status) = lift.add(head, role, motion, time_ns) {
            self.hub.tap.json(
                Topic::Prediction,
                || serde_json::json!({ "lift": status, "frame_time_ns": time_ns }),
            );
            let mut state = lock(&self.state);
            let latency_ns = monotonic_ns().saturating_sub(time_ns);
            state.lift_latency.add(latency_ns as f64 * 1e-6);
            state.lift_verdicts[0] += 1;
            state.lift_verdicts[1] += u64::from(status.object.is_some());
            state.lift = Some(status);
        }
    }

    /// Measures shear and force of a gel, whose image differs from the initial one by `level`, and
    /// returns its markers, if it has them.
    fn measure_shear(
        &mut self,
        role: Role,
        decoded: &Decoded,
        level: Option<f32>,
    ) -> Option<Arc<MarkerField>> {
        let started = Instant::now();
        let frame = self.trackers.update(role, &decoded.image)?;
        if let Some(level) = level {
            let motion = GelMotion::new(f64::from(level), &frame);
            self.follow_lift(role, motion, decoded.driver_time_ns);
        }
        let initial = self.initial.get(&role);
        let force =
            initial.and_then(|initial| self.trackers.force(role, initial, &decoded.image, &frame));
        let status = ShearStatus::from(&frame);
        let field = frame.field.map(Arc::new);
        self.hub.tap.json(Topic::Shear, || {
            let markers = field.as_ref().map(|field| field.to_array());
            serde_json::json!({
                "role": role,
                "frame_time_ns": decoded.driver_time_ns,
                "summary": status.summary,
                "force": force,
                "problems": frame.problems,
                "markers": markers.map(|(values, shape)| MarkerMessage::new(&values, shape)),
            })
        });
        let mut state = lock(&self.state);
        state.shear_time.add(started.elapsed().as_secs_f64() * 1e3);
        state.shear.insert(role, status);
        match force {
            Some(force) => drop(state.force.insert(role, force)),
            None => drop(state.force.remove(&role)),
        }
        match &field {
            Some(field) => {
                let markers = LiveMarkers {
                    field: Arc::clone(field),
                    driver_time_ns: decoded.driver_time_ns,
                };
                state.marker_fields.insert(role, markers);
            }
            None => drop(state.marker_fields.remove(&role)),
        }
        field
    }

    /// Updates the state of a gel and returns its change since the initial frame, if any.
    fn judge(&mut self, role: Role, decoded: &Decoded) -> Option<GelChange> {
        let started = Instant::now();
        let (image, time_ns) = (&decoded.image, decoded.driver_time_ns);
        let (gel, change) = self.gels.judge(role, image, time_ns, !self.predicting)?;
        let mut state = lock(&self.state);
        state.gels.insert(role, gel);
        state.judge_time.add(started.elapsed().as_secs_f64() * 1e3);
        change
    }

    fn predict(&mut self) {
        let Some((predictor, model)) = &mut self.predictor else {
            return;
        };
        let result = predictor.predict();
        let missing = predictor.missing_input();
        let now_ns = monotonic_ns();
        let mut state = lock(&self.state);
        match result {
            None => {
                state.live = None;
                state.unavailable = missing.map(str::to_owned);
            }
            Some(Err(error)) => {
                state.live = None;
                state.failures += 1;
                state.unavailable = Some(error.what().to_owned());
            }
            Some(Ok(prediction)) => {
                let frame_time_ns = prediction.newest_frame_ns;
                let latency_ms = now_ns.saturating_sub(frame_time_ns) as f64 * 1e-6;
                state.latency.add(latency_ms);
                state.predictions += 1;
                state.unavailable = None;
                let record = PredictionRecord {
                    p_stable: self.smoothing.add(prediction.p_stable, frame_time_ns),
                    ..model.record(&prediction, latency_ms)
                };
                let limits = limits_of(predictor, &record, self.rules.limits);
                let record = decided(record, limits, self.adaptation);
                let changes = [Role::Left, Role::Right].map(|role| state.contact.get(&role));
                let changes = changes.map(|contact| contact.map(|contact| contact.change));
                let record = with_doubt(record, predictor, changes);
                let message = serde_json::json!({
                    "p_stable": record.p_stable,
                    "p_stable_frame": prediction.p_stable,
                    "p_stable_adapted": record.adapted.map(|adapted| adapted.p_stable),
                    "set": record.set,
                    "ood_score": record.ood_score,
                    "unsure_reason": record.unsure_reason,
                    "frame_time_ns": frame_time_ns,
                    "latency_ms": latency_ms,
                    "engine_ms": record.engine_ms,
                });
                state.live = Some(PredictionStatus {
                    frame_time_ns,
                    ..PredictionStatus::new(record, model.heuristic)
                });
                drop(state);
                self.hub.tap.json(Topic::Prediction, || message);
            }
        }
    }

    /// Predicts and measures shear and force on the images of a saved grasp, then restores the live ones.
    /// The lift begins here.
    fn analyse_saved(
        &mut self,
        images: BTreeMap<Role, RgbImage>,
        depth: Option<&Depth>,
    ) -> SavedAnalysis {
        let shear = images.iter().filter(|(role, _)| role.is_tactile());
        let shear: BTreeMap<Role, ShearFrame> = shear
            .filter_map(|(role, image)| Some((*role, self.trackers.measure(*role, image)?)))
            .collect();
        let motion = [Role::Left, Role::Right].map(|role| {
            let (initial, image) = (self.initial.get(&role)?, images.get(&role)?);
            let level = TactileDifference::between(initial, image).ok()?.mean_abs();
            Some(GelMotion::new(f64::from(level), shear.get(&role)?))
        });
        let saved_gels: BTreeMap<Role, RgbImage> = images
            .iter()
            .filter(|(role, _)| role.is_tactile())
            .map(|(role, image)| (*role, image.clone()))
            .collect();
        let prediction = self.predict_saved(images, depth);
        let p_before = prediction.as_ref().map(|record| record.p_stable);
        self.lift = match (motion, p_before) {
            ([Some(left), Some(right)], Some(p)) => {
                let depth = depth.zip(self.rules.depth_view);
                let tracker = depth.and_then(|(depth, view)| ObjectTracker::new(depth, view));
                Some(LiveLift::new(p, [left, right], tracker))
            }
            _ => None,
        };
        lock(&self.state).lift = None;
        let force = shear.iter().filter_map(|(role, frame)| {
            let (initial, image) = (self.initial.get(role)?, saved_gels.get(role)?);
            Some((*role, self.trackers.force(*role, initial, image, frame)?))
        });
        SavedAnalysis {
            force: force.collect(),
            shear,
            prediction,
        }
    }

    fn predict_saved(
        &mut self,
        images: BTreeMap<Role, RgbImage>,
        depth: Option<&Depth>,
    ) -> Option<PredictionRecord> {
        let changes =
            [Role::Left, Role::Right].map(|role| self.gels.change(role, images.get(&role)?));
        let (predictor, model) = self.predictor.as_mut().filter(|_| self.predicting)?;
        for (role, image) in images {
            predictor.update(role, image, 0);
        }
        match depth.zip(self.rules.depth_view) {
            Some((depth, view)) => predictor.update_depth(depth, view, 0),
            None => predictor.clear(Role::Depth),
        }
        let result = predictor.predict();
        for role in [Role::Left, Role::Right, Role::Rgb, Role::Depth] {
            match self.hub.slot(role).and_then(|slot| slot.latest()) {
                Some(live) => show(predictor, role, &live, self.rules),
                None => predictor.clear(role),
            }
        }
        // The store sets the latency to that of the live prediction at the trigger.
        let record = model.record(&result?.ok()?, 0.0);
        let limits = limits_of(predictor, &record, self.rules.limits);
        let record = decided(record, limits, self.adaptation);
        Some(with_doubt(record, predictor, changes))
    }
}

/// Gel markers as JSON, which has no NaN: null.
#[derive(Serialize)]
struct MarkerMessage {
    /// Rows, columns, values.
    shape: [usize; 3],
    /// Row-major; null where there is no value.
    values: Vec<Option<f32>>,
}

impl MarkerMessage {
    fn new(values: &[f32], shape: [usize; 3]) -> Self {
        Self {
            shape,
            values: values.iter().map(|v| v.is_finite().then_some(*v)).collect(),
        }
    }
}

/// Gives a predictor the newest image of a camera.
fn show(predictor: &mut LivePredictor, role: Role, decoded: &Decoded, rules: PredictionRules) {
    match (&decoded.depth, rules.depth_view) {
        (Some(depth), Some(view)) => {
            predictor.update_depth(depth, view, decoded.driver_time_ns);
        }
        (Some(_), None) => predictor.clear(role),
        (None, _) => predictor.update(role, (*decoded.image).clone(), decoded.driver_time_ns),
    }
}

#[cfg(test)]
#[path = "infer_test.rs"]
mod infer_test;
