//! Inference at every new tactile image, on a thread of its own.

use std::collections::{BTreeMap, VecDeque};
use std::ops::ControlFlow;
use std::sync::mpsc::{Receiver, Sender};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;

use image::RgbImage;
use serde::Serialize;
use utoipa::ToSchema;

use super::black_box::Topic;
use super::histogram::Histogram;
use super::hub::Hub;
use super::status::{PredictionStatus, Preview};
use super::tasks::{Beat, Tasks};
use gripcast_base::error::Result;
use gripcast_capture::camera::monotonic_ns;
use gripcast_dataset::PredictionRecord;
use gripcast_imaging::{Role, TactileDifference};
use gripcast_nn::predict::{LivePrediction, LivePredictor, Model, Smoothing};

/// Difference from which a pixel counts as touched, grey levels: far above the sensor's noise
/// (1–2 levels), far below a contact's (up to 120).
const TOUCHED_LEVELS: u16 = 10;

/// Gain of the difference on the screen.
const PREVIEW_GAIN: f32 = 1.5;

/// What the inference thread is asked.
#[derive(Debug)]
pub(super) enum InferRequest {
    /// A camera has a new decoded image.
    Fresh(Role),
    /// Subtract these from now on.
    SetInitial {
        /// Number of the change.
        change: u64,
        /// Left gel, open gripper.
        left: Arc<RgbImage>,
        /// Right gel, open gripper.
        right: Arc<RgbImage>,
    },
    /// There is no initial frame any more, or none that can be subtracted, for this reason. Contact
    /// is still told against the last one.
    ClearInitial(String),
    /// Predict on exactly these images, against the present initial frame.
    Judge {
        /// Images by role.
        images: BTreeMap<Role, RgbImage>,
        /// Where the answer goes; `None` when there is no prediction.
        reply: Sender<Option<PredictionRecord>>,
    },
    /// End.
    Stop,
}

/// The model that predicts.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub struct ModelFacts {
    /// Name.
    pub name: String,
    /// Of the ONNX file.
    pub sha256: String,
    /// From this probability on a grasp counts as stable.
    pub threshold: f64,
    /// Whether it is a heuristic and not trained.
    pub heuristic: bool,
}

impl ModelFacts {
    /// What a model says of itself.
    #[must_use]
    pub fn of(model: &Model) -> Self {
        Self {
            name: model.contract().name.clone(),
            sha256: model.sha256().to_owned(),
            threshold: model.contract().threshold,
            heuristic: model.contract().is_heuristic(),
        }
    }

    fn record(&self, said: &LivePrediction, latency_ms: f64) -> PredictionRecord {
        PredictionRecord {
            p_stable: said.p_stable,
            ood_score: said.ood_score,
            threshold: self.threshold,
            model_sha256: self.sha256.clone(),
            model: self.name.clone(),
            latency_ms,
            engine_ms: said.engine_ms,
        }
    }
}

/// Contact of one gel against the initial frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Contact {
    /// Mean absolute difference, grey levels.
    pub(super) mean_abs: f64,
    /// Driver time of the frame that was held against it, ns.
    pub(super) frame_time_ns: u64,
    /// Part of the gel that changed, 0..1.
    pub(super) changed_fraction: f64,
}

/// What inference has found so far.
#[derive(Debug, Default)]
pub(super) struct Findings {
    /// Newest prediction; `None` without an initial frame.
    pub(super) live: Option<PredictionStatus>,
    /// Why there is none.
    pub(super) absent: Option<String>,
    /// Contact by gel, against the initial frame that came with `change`.
    pub(super) contact: BTreeMap<Role, Contact>,
    /// The newest change of the initial frame that brought one. A number and no key: after an undo
    /// the same frame comes back, and what was found against it before is stale.
    pub(super) change: Option<u64>,
    /// Small images.
    pub(super) previews: BTreeMap<Role, Preview>,
    /// Predictions made.
    pub(super) predictions: u64,
    /// Predictions that failed.
    pub(super) failures: u64,
    /// Frame to prediction, ms.
    pub(super) latency: Histogram,
}

impl Findings {
    /// Part of a gel that changed against the initial frame of a change, in a frame newer than
    /// `since_ns`; none while that is not known.
    pub(super) fn changed_fraction(
        &self,
        role: Role,
        change: Option<u64>,
        since_ns: u64,
    ) -> Option<f64> {
        let contact = self.contact.get(&role).filter(|_| self.change == change)?;
        (contact.frame_time_ns > since_ns).then_some(contact.changed_fraction)
    }

    /// Mean absolute difference of each gel, grey levels.
    pub(super) fn contact_levels(&self) -> BTreeMap<Role, f64> {
        let contacts = self.contact.iter();
        contacts.map(|(role, c)| (*role, c.mean_abs)).collect()
    }
}

/// The inference thread.
#[derive(Debug)]
pub(super) struct Inference {
    findings: Arc<Mutex<Findings>>,
    requests: Sender<InferRequest>,
    thread: JoinHandle<()>,
    model: Option<String>,
}

impl Inference {
    /// Starts the thread. Without a model it still tells contact and makes previews.
    ///
    /// # Errors
    /// When the model's tensors or the thread cannot be had.
    pub(super) fn start(
        hub: &Hub,
        model: Option<Model>,
        (requests, inbox): (Sender<InferRequest>, Receiver<InferRequest>),
        tasks: &Tasks,
    ) -> Result<Self> {
        let facts = model.as_ref().map(ModelFacts::of);
        let findings = Arc::new(Mutex::new(Findings {
            absent: Some(if model.is_some() {
                "no initial frame".into()
            } else {
                "no model".into()
            }),
            ..Findings::default()
        }));
        let name = facts.as_ref().map(|facts| facts.name.clone());
        let predictor = model.map(LivePredictor::new).transpose()?;
        let mut worker = Worker::new(hub, predictor.zip(facts), &findings);
        let thread = tasks.spawn("inference", move |beat| worker.run(&inbox, beat))?;
        Ok(Self {
            findings,
            requests,
            thread,
            model: name,
        })
    }

    /// Name of the model, if there is one.
    pub(super) fn model(&self) -> Option<&str> {
        self.model.as_deref()
    }

    /// Where to send requests.
    pub(super) fn requests(&self) -> &Sender<InferRequest> {
        &self.requests
    }

    /// What has been found so far.
    pub(super) fn findings(&self) -> MutexGuard<'_, Findings> {
        lock(&self.findings)
    }

    /// Ends the thread and gives back what it found.
    pub(super) fn stop(self) -> Arc<Mutex<Findings>> {
        // Both fail only when the thread has ended already.
        let _ = self.requests.send(InferRequest::Stop);
        let _ = self.thread.join();
        self.findings
    }
}

fn lock(findings: &Mutex<Findings>) -> MutexGuard<'_, Findings> {
    findings.lock().unwrap_or_else(PoisonError::into_inner)
}

struct Worker {
    hub: Hub,
    predictor: Option<(LivePredictor, ModelFacts)>,
    initial: BTreeMap<Role, Arc<RgbImage>>,
    predicting: bool,
    smoothing: Smoothing,
    /// Serial of the newest image used, by role.
    seen: BTreeMap<Role, u64>,
    findings: Arc<Mutex<Findings>>,
}

impl Worker {
    fn new(
        hub: &Hub,
        predictor: Option<(LivePredictor, ModelFacts)>,
        findings: &Arc<Mutex<Findings>>,
    ) -> Self {
        Self {
            hub: hub.clone(),
            predictor,
            initial: BTreeMap::new(),
            predicting: false,
            smoothing: Smoothing::default(),
            seen: BTreeMap::new(),
            findings: Arc::clone(findings),
        }
    }

    /// What waits for an answer comes first; of each camera only the newest image is looked at.
    fn run(&mut self, inbox: &Receiver<InferRequest>, beat: &Beat) {
        let mut fresh = VecDeque::new();
        loop {
            if fresh.is_empty() {
                beat.idle();
                let Ok(request) = inbox.recv() else { return };
                beat.busy();
                if self.take(request, &mut fresh).is_break() {
                    return;
                }
            }
            for request in inbox.try_iter() {
                if self.take(request, &mut fresh).is_break() {
                    return;
                }
            }
            beat.busy();
            if let Some(role) = fresh.pop_front() {
                self.fresh(role);
            }
        }
    }

    /// Carries out a request, or notes that a camera has a new image.
    fn take(&mut self, request: InferRequest, fresh: &mut VecDeque<Role>) -> ControlFlow<()> {
        match request {
            InferRequest::Fresh(role) if fresh.contains(&role) => {}
            InferRequest::Fresh(role) => fresh.push_back(role),
            InferRequest::SetInitial {
                change,
                left,
                right,
            } => self.set_initial(change, left, right),
            InferRequest::ClearInitial(reason) => self.clear_initial(reason),
            InferRequest::Judge { images, reply } => {
                // The asker has given up when nobody receives.
                let _ = reply.send(self.judge(images));
            }
            InferRequest::Stop => return ControlFlow::Break(()),
        }
        ControlFlow::Continue(())
    }

    fn set_initial(&mut self, change: u64, left: Arc<RgbImage>, right: Arc<RgbImage>) {
        if let Some((predictor, _)) = &mut self.predictor {
            predictor.set_initial((*left).clone(), (*right).clone());
        }
        self.initial = BTreeMap::from([(Role::Left, left), (Role::Right, right)]);
        self.predicting = true;
        self.smoothing.clear();
        let mut findings = lock(&self.findings);
        findings.live = None;
        findings.contact.clear();
        findings.change = Some(change);
    }

    fn clear_initial(&mut self, reason: String) {
        self.predicting = false;
        let mut findings = lock(&self.findings);
        findings.live = None;
        if let Some((predictor, _)) = &mut self.predictor {
            predictor.clear_initial();
            findings.absent = Some(reason);
        }
    }

    fn fresh(&mut self, role: Role) {
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
        let contact = difference.as_ref().map(|difference| Contact {
            mean_abs: f64::from(difference.mean_abs()),
            frame_time_ns: decoded.driver_time_ns,
            changed_fraction: f64::from(difference.changed_fraction(TOUCHED_LEVELS)),
        });
        let shown = difference.filter(|_| self.predicting);
        let preview = Preview {
            is_difference: shown.is_some(),
            image: shown.map_or_else(
                || Arc::clone(&decoded.image),
                |difference| Arc::new(difference.to_image(PREVIEW_GAIN)),
            ),
        };
        {
            let mut findings = lock(&self.findings);
            if let Some(contact) = contact {
                findings.contact.insert(role, contact);
            }
            findings.previews.insert(role, preview);
        }
        if let Some((predictor, _)) = &mut self.predictor {
            predictor.update(role, (*decoded.image).clone(), decoded.driver_time_ns);
            if role.is_tactile() {
                self.predict();
            }
        }
    }

    fn predict(&mut self) {
        let Some((predictor, model)) = &mut self.predictor else {
            return;
        };
        let result = predictor.predict();
        let waiting = predictor.missing_input();
        let now_ns = monotonic_ns();
        let mut findings = lock(&self.findings);
        match result {
            None => {
                findings.live = None;
                findings.absent = waiting.map(str::to_owned);
            }
            Some(Err(error)) => {
                findings.live = None;
                findings.failures += 1;
                findings.absent = Some(error.what().to_owned());
            }
            Some(Ok(prediction)) => {
                let frame_time_ns = prediction.newest_frame_ns;
                let latency_ms = now_ns.saturating_sub(frame_time_ns) as f64 * 1e-6;
                findings.latency.add(latency_ms);
                findings.predictions += 1;
                findings.absent = None;
                let said = PredictionRecord {
                    p_stable: self.smoothing.add(prediction.p_stable, frame_time_ns),
                    ..model.record(&prediction, latency_ms)
                };
                let note = serde_json::json!({
                    "p_stable": said.p_stable,
                    "p_stable_frame": prediction.p_stable,
                    "novelty": said.ood_score,
                    "frame_time_ns": frame_time_ns,
                    "latency_ms": latency_ms,
                    "engine_ms": said.engine_ms,
                });
                findings.live = Some(PredictionStatus {
                    frame_time_ns,
                    ..PredictionStatus::new(said, model.heuristic)
                });
                drop(findings);
                self.hub.tap().note(Topic::Prediction, || note);
            }
        }
    }

    /// Predicts on saved images, then puts the live ones back.
    fn judge(&mut self, images: BTreeMap<Role, RgbImage>) -> Option<PredictionRecord> {
        let (predictor, model) = self.predictor.as_mut().filter(|_| self.predicting)?;
        for (role, image) in images {
            predictor.update(role, image, 0);
        }
        let result = predictor.predict();
        for role in [Role::Left, Role::Right, Role::Rgb] {
            match self.hub.slot(role).and_then(|slot| slot.latest()) {
                Some(live) => predictor.update(role, (*live.image).clone(), live.driver_time_ns),
                None => predictor.clear(role),
            }
        }
        // Its latency is that of the live prediction at the trigger, which the store knows.
        Some(model.record(&result?.ok()?, 0.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_imaging::{Frame, PixelFormat};

    const CHANGED: u64 = 100;

    fn grey(level: u8) -> RgbImage {
        RgbImage::from_pixel(32, 24, image::Rgb([level; 3]))
    }

    #[test]
    fn of_many_images_that_wait_one_a_camera_is_looked_at_after_all_that_is_asked() {
        let hub = Hub::new([Role::Left]);
        let findings = Arc::default();
        let mut worker = Worker::new(&hub, None, &findings);
        let mut fresh = VecDeque::new();
        let (reply, answer) = std::sync::mpsc::channel();
        let images = BTreeMap::new();
        for request in [
            InferRequest::Fresh(Role::Left),
            InferRequest::Fresh(Role::Right),
            InferRequest::Fresh(Role::Left),
            InferRequest::Judge { images, reply },
        ] {
            assert!(worker.take(request, &mut fresh).is_continue());
        }
        assert_eq!(answer.try_recv(), Ok(None), "answered before the images");
        assert_eq!(fresh, [Role::Left, Role::Right]);
        assert!(worker.take(InferRequest::Stop, &mut fresh).is_break());
    }

    #[test]
    fn contact_is_known_only_against_the_frame_of_the_last_change() {
        let hub = Hub::new([Role::Left]);
        let findings = Arc::default();
        let mut worker = Worker::new(&hub, None, &findings);
        let see = |worker: &mut Worker, level: u8, at_ns: u64| {
            let frame = Frame {
                format: PixelFormat::Grey,
                width: 32,
                height: 24,
                data: vec![level; 32 * 24].into(),
                sequence: 1,
                driver_time_ns: at_ns,
                received_ns: at_ns,
            };
            hub.slot(Role::Left).unwrap().decoded(&frame, grey(level));
            worker.fresh(Role::Left);
        };
        let known = |change: u64, since_ns: u64| {
            lock(&findings).changed_fraction(Role::Left, Some(change), since_ns)
        };
        let initial = Arc::new(grey(10));
        let set = |worker: &mut Worker, change: u64| {
            worker.set_initial(change, Arc::clone(&initial), Arc::clone(&initial));
        };

        set(&mut worker, 1);
        assert_eq!(known(1, 0), None, "nothing was seen yet");
        see(&mut worker, 90, CHANGED);
        assert_eq!(known(1, 0), Some(1.0));
        assert_eq!(
            known(1, CHANGED),
            None,
            "the frame is older than the capture"
        );
        assert_eq!(known(2, 0), None, "the next change has not come");
        // An undo: the same image is the initial frame again.
        set(&mut worker, 2);
        assert_eq!(known(2, 0), None, "found before the change");
        assert_eq!(known(1, 0), None);
        see(&mut worker, 10, CHANGED + 1);
        assert_eq!(known(2, 0), Some(0.0));
    }
}
