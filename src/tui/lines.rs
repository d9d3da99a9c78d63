//! Plain lines for logs and terminals without a screen: one a change of the engine's state.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

use tokio::sync::watch;

use super::fault::{place, sentence};
use super::gauge::word;
use crate::daemon::{
    BlackBoxStatus, CameraState, CameraStatus, EngineStatus, MarkerStatus, PredictionStatus,
    verdict_of,
};
use crate::note;
use gripcast_dataset::Outcome;
use gripcast_imaging::Role;
use gripcast_nn::predict::PredictedLabel;
use gripcast_session::{LastGrasp, Message, MessageLevel};

/// Shortest time between two lines on the same camera, or on the live prediction.
const MIN_INTERVAL: Duration = Duration::from_secs(2);

/// Turns statuses into lines; knows what it has said.
#[derive(Debug, Default)]
pub struct LinePrinter {
    cameras: BTreeMap<Role, Said<&'static str>>,
    markers: Said<&'static str>,
    prediction: Said<&'static str>,
    absence: Option<String>,
    black_box: Said<BlackBoxNews>,
    black_box_ended: bool,
    last: Option<LastGrasp>,
    message: Option<Message>,
    started: bool,
}

/// What can be said of the black box.
#[derive(Clone, Copy, Debug, PartialEq)]
enum BlackBoxNews {
    Logging,
    LeftOut(u64),
}

/// What was said on a subject, and when.
#[derive(Clone, Copy, Debug)]
struct Said<T> {
    what: Option<T>,
    at: Option<Instant>,
}

impl<T> Default for Said<T> {
    fn default() -> Self {
        Self {
            what: None,
            at: None,
        }
    }
}

impl<T: PartialEq + Copy> Said<T> {
    /// Whether `what` is news and enough time has passed; if so it counts as said.
    fn is_news(&mut self, what: T, now: Instant) -> bool {
        let quiet = self
            .at
            .is_none_or(|at| now.saturating_duration_since(at) >= MIN_INTERVAL);
        let news = quiet && self.what != Some(what);
        if news {
            *self = Self {
                what: Some(what),
                at: Some(now),
            };
        }
        news
    }
}

impl LinePrinter {
    /// The lines that `status` gives rise to at `now`.
    pub fn lines(&mut self, status: &EngineStatus, now: Instant) -> Vec<String> {
        let mut lines = Vec::new();
        if !std::mem::replace(&mut self.started, true) {
            let (dataset, rig) = (&status.dataset, &status.rig);
            lines.push(format!("collecting into {dataset} with rig {rig}"));
            // What the dataset held before is no news.
            self.last = status.session.last.clone();
        }
        for camera in &status.cameras {
            lines.extend(self.camera(camera, status, now));
            lines.extend(self.markers(camera, now));
        }
        lines.extend(self.prediction(status, now));
        lines.extend(self.black_box(status.black_box.as_ref(), now));
        lines.extend(self.grasp(status.session.last.as_ref()));
        lines.extend(self.message(status.session.message.as_ref()));
        lines
    }

    fn camera(
        &mut self,
        camera: &CameraStatus,
        status: &EngineStatus,
        now: Instant,
    ) -> Option<String> {
        let words = match &camera.state {
            CameraState::Opening => return None,
            CameraState::Live => format!("{}: live ({})", camera.role, place(camera)),
            CameraState::Ended => format!("{}: the recording has ended", camera.role),
            CameraState::Lost { reason } => {
                format!("FAULT {}: {reason}", sentence(camera, status))
            }
            _ => format!("FAULT {}", sentence(camera, status)),
        };
        let said = self.cameras.entry(camera.role).or_default();
        said.is_news(camera.state.word(), now).then_some(words)
    }

    /// Whether sheet and tags can be measured, when that changes.
    fn markers(&mut self, camera: &CameraStatus, now: Instant) -> Option<String> {
        let MarkerStatus { ok, text } = camera.markers.as_ref()?;
        let (state, words) = match ok {
            true => (
                "seen",
                format!("{}: pose can be measured ({text})", camera.role),
            ),
            false => ("not seen", format!("{}: no pose: {text}", camera.role)),
        };
        self.markers.is_news(state, now).then_some(words)
    }

    /// That everything is logged, that some of it is not, or why nothing is any more.
    fn black_box(&mut self, status: Option<&BlackBoxStatus>, now: Instant) -> Option<String> {
        let status = status?;
        if let Some(reason) = &status.stopped {
            // Comes once and must not wait: the collection may end before.
            let told = std::mem::replace(&mut self.black_box_ended, true);
            return (!told).then(|| {
                format!("warning: the black box has ended, the collection goes on: {reason}")
            });
        }
        let (news, words) = match status.dropped {
            0 => (
                BlackBoxNews::Logging,
                format!("black box: logging to {}", status.directory),
            ),
            dropped => (
                BlackBoxNews::LeftOut(dropped),
                format!("warning: the disk is slow: {dropped} frame(s) are not in the black box"),
            ),
        };
        self.black_box.is_news(news, now).then_some(words)
    }

    /// The live prediction when it appears or changes sides.
    fn prediction(&mut self, status: &EngineStatus, now: Instant) -> Option<String> {
        if let Some(prediction) = &status.prediction {
            self.absence = None;
            let verdict = match prediction.verdict {
                PredictedLabel::Unsure => "UNSURE, unlike the training images",
                known => word(known),
            };
            return self
                .prediction
                .is_news(verdict, now)
                .then(|| live(prediction, verdict));
        }
        let absence = status.prediction_absent.clone();
        let news = absence != self.absence;
        self.absence.clone_from(&absence);
        absence
            .filter(|_| news)
            .map(|reason| format!("no prediction: {reason}"))
    }

    /// A new grasp with what was predicted, or a new label of the newest one.
    fn grasp(&mut self, last: Option<&LastGrasp>) -> Vec<String> {
        let before = std::mem::replace(&mut self.last, last.cloned());
        let Some(last) = last else {
            return Vec::new();
        };
        let mut lines = Vec::new();
        let known = before.as_ref().filter(|before| before.id == last.id);
        if known.is_none() {
            let predicted = last.predicted.as_ref().map_or_else(
                || "no prediction".to_owned(),
                |said| format!("predicted {:.2} {}", said.p_stable, word(verdict_of(said))),
            );
            lines.push(format!("saved {} {}: {predicted}", last.id, last.object));
        }
        let label_before = known.map_or(Outcome::Unlabelled, |known| known.outcome);
        if last.outcome != label_before {
            lines.push(format!("labelled {} {}", last.id, last.outcome));
        }
        lines
    }

    /// Warnings and errors; what went well is said by the other lines.
    fn message(&mut self, message: Option<&Message>) -> Option<String> {
        let news = message != self.message.as_ref();
        self.message = message.cloned();
        let message = message.filter(|_| news)?;
        match message.level {
            MessageLevel::Info => None,
            MessageLevel::Warning => Some(format!("warning: {}", message.text)),
            MessageLevel::Error => Some(format!("error: {}", message.text)),
        }
    }
}

fn live(prediction: &PredictionStatus, verdict: &str) -> String {
    let kind = if prediction.heuristic {
        ", a heuristic"
    } else {
        ""
    };
    format!(
        "predicting {:.2} {verdict} ({}{kind})",
        prediction.said.p_stable, prediction.said.model
    )
}

/// Prints lines on standard error until the sender of `status` is dropped.
pub async fn print_lines(mut status: watch::Receiver<Arc<EngineStatus>>) {
    let mut printer = LinePrinter::default();
    loop {
        let newest = Arc::clone(&status.borrow_and_update());
        for line in printer.lines(&newest, Instant::now()) {
            // A closed standard error must not end the collection.
            note!("{line}");
        }
        if status.changed().await.is_err() {
            return;
        }
    }
}
