//! Plain text lines without a screen: one per change of the engine's state.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::{Duration, Instant};

use tokio::sync::watch;

use super::fault::{identity, summary};
use super::gauge::word;
use crate::daemon::{
    BlackBoxStatus, CameraState, CameraStatus, EngineStatus, GelStatus, MarkerStatus,
    PredictionStatus, StartSubject, unsure_words, verdict_of,
};
use crate::note;
use gripcast_dataset::{Outcome, PredictionRecord};
use gripcast_imaging::{GelProblem, Role};
use gripcast_nn::predict::{Adaptation, PredictedLabel};
use gripcast_session::{LastGrasp, Message, MessageLevel};

/// Minimum interval between two lines on the same subject.
const MIN_INTERVAL: Duration = Duration::from_secs(2);

/// Converts statuses to lines and remembers what was printed.
#[derive(Debug, Default)]
pub struct LinePrinter {
    cameras: BTreeMap<Role, Printed<&'static str>>,
    gels: BTreeMap<Role, Printed<Option<GelProblem>>>,
    markers: Printed<&'static str>,
    prediction: Printed<&'static str>,
    no_prediction_reason: Option<String>,
    black_box: Printed<BlackBoxNews>,
    black_box_ended: bool,
    adaptation: Option<Adaptation>,
    last: Option<LastGrasp>,
    message: Option<Message>,
    start_findings: BTreeSet<StartSubject>,
    started: bool,
}

/// News about the black box.
#[derive(Clone, Copy, Debug, PartialEq)]
enum BlackBoxNews {
    Logging,
    Dropped(u64),
}

/// Value and time of the last line on a subject.
#[derive(Clone, Copy, Debug)]
struct Printed<T>(Option<(T, Instant)>);

impl<T> Default for Printed<T> {
    fn default() -> Self {
        Self(None)
    }
}

impl<T: PartialEq + Copy> Printed<T> {
    /// Returns whether `value` is to be printed now: it has changed and the interval has passed.
    fn is_news(&mut self, value: T, now: Instant) -> bool {
        let news = self.0.is_none_or(|(last, at)| {
            last != value && now.saturating_duration_since(at) >= MIN_INTERVAL
        });
        if news {
            self.0 = Some((value, now));
        }
        news
    }
}

impl LinePrinter {
    /// Returns the lines for a new status.
    pub fn lines(&mut self, status: &EngineStatus, now: Instant) -> Vec<String> {
        let mut lines = Vec::new();
        if !std::mem::replace(&mut self.started, true) {
            let (dataset, rig) = (&status.dataset, &status.rig);
            lines.push(format!("collecting into {dataset} with rig {rig}"));
            // Earlier grasps of the dataset are not news.
            self.last = status.session.last.clone();
        }
        for finding in &status.start_report {
            if self.start_findings.insert(finding.subject) {
                lines.push(match finding.level {
                    MessageLevel::Info => finding.text.clone(),
                    _ => format!("WARNING {}", finding.text),
                });
            }
        }
        for camera in &status.cameras {
            lines.extend(self.camera(camera, status, now));
            lines.extend(self.markers(camera, now));
        }
        for (role, gel) in &status.gels {
            lines.extend(self.gel(*role, gel, now));
        }
        lines.extend(self.prediction(status, now));
        lines.extend(self.black_box(status.black_box.as_ref(), now));
        lines.extend(self.grasp(status.session.last.as_ref()));
        lines.extend(self.adaptation(status.adaptation));
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
            CameraState::Live => format!("{}: live ({})", camera.role, identity(camera)),
            CameraState::Ended => format!("{}: the recording has ended", camera.role),
            CameraState::NoValidDepth { .. } => {
                let fault = camera.state.fault_text().unwrap_or_default();
                format!("WARNING {}: {fault}", camera.role)
            }
            state => match state.reason() {
                Some(reason) => format!("FAULT {}: {reason}", summary(camera, status)),
                None => format!("FAULT {}", summary(camera, status)),
            },
        };
        let printed = self.cameras.entry(camera.role).or_default();
        printed.is_news(camera.state.word(), now).then_some(words)
    }

    /// Reports the problems of a gel's image, and their end.
    fn gel(&mut self, role: Role, gel: &GelStatus, now: Instant) -> Option<String> {
        let problem = gel.state.problems.first().copied();
        if problem.is_none() && !self.gels.contains_key(&role) {
            return None;
        }
        let printed = self.gels.entry(role).or_default();
        printed.is_news(problem, now).then(|| match problem {
            Some(_) => format!("warning: {role}: {}", gel.messages.join("; ")),
            None => format!("{role}: the image has no more problems"),
        })
    }

    /// Reports changes of the marker detection.
    fn markers(&mut self, camera: &CameraStatus, now: Instant) -> Option<String> {
        let MarkerStatus { ok, text } = camera.markers.as_ref()?;
        let (state, words) = match ok {
            true => (
                "detected",
                format!("{}: pose can be measured ({text})", camera.role),
            ),
            false => ("not detected", format!("{}: no pose: {text}", camera.role)),
        };
        self.markers.is_news(state, now).then_some(words)
    }

    /// Reports start, dropped frames and end of the black box.
    fn black_box(&mut self, status: Option<&BlackBoxStatus>, now: Instant) -> Option<String> {
        let status = status?;
        if let Some(reason) = &status.stopped {
            // Not rate-limited, because the collection may end soon.
            let was_reported = std::mem::replace(&mut self.black_box_ended, true);
            return (!was_reported).then(|| {
                format!("warning: the black box has stopped, the collection continues: {reason}")
            });
        }
        let (news, words) = match status.dropped {
            0 => (
                BlackBoxNews::Logging,
                format!("black box: logging to {}", status.directory),
            ),
            dropped => (
                BlackBoxNews::Dropped(dropped),
                format!("warning: slow disk: the black box dropped {dropped} frame(s)"),
            ),
        };
        self.black_box.is_news(news, now).then_some(words)
    }

    /// Reports the live prediction when its verdict changes.
    fn prediction(&mut self, status: &EngineStatus, now: Instant) -> Option<String> {
        if let Some(prediction) = &status.prediction {
            self.no_prediction_reason = None;
            let verdict = match prediction.verdict {
                PredictedLabel::Unsure => format!("UNSURE, {}", unsure_words(&prediction.record)),
                verdict => word(verdict).to_owned(),
            };
            // The sentence contains measured levels: only a new verdict is news.
            let is_news = self.prediction.is_news(word(prediction.verdict), now);
            return is_news.then(|| live(prediction, &verdict));
        }
        let reason = status.no_prediction_reason.clone();
        let news = reason != self.no_prediction_reason;
        self.no_prediction_reason.clone_from(&reason);
        let reason = reason.filter(|_| news)?;
        Some(format!("no prediction: {reason}"))
    }

    /// Reports a new grasp with its prediction, or a new label of the newest one.
    fn grasp(&mut self, last: Option<&LastGrasp>) -> Vec<String> {
        let before = std::mem::replace(&mut self.last, last.cloned());
        let Some(last) = last else {
            return Vec::new();
        };
        let mut lines = Vec::new();
        let same = before.as_ref().filter(|before| before.id == last.id);
        if same.is_none() {
            let predicted = last.predicted.as_ref().map_or_else(
                || "no prediction".to_owned(),
                |p| format!("predicted {} {}", probability(p), word(verdict_of(p))),
            );
            lines.push(format!("saved {} {}: {predicted}", last.id, last.object));
        }
        let label_before = same.map_or(Outcome::Unlabelled, |grasp| grasp.outcome);
        if last.outcome != label_before {
            lines.push(format!("labelled {} {}", last.id, last.outcome));
        }
        lines
    }

    /// Reports a new base rate of the rig's labels.
    fn adaptation(&mut self, adaptation: Option<Adaptation>) -> Option<String> {
        let news = adaptation != self.adaptation;
        self.adaptation = adaptation;
        adaptation.filter(|_| news).map(|now| now.words())
    }

    /// Reports warnings and errors.
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
    let kind = match prediction.heuristic {
        true => ", heuristic",
        false => "",
    };
    format!(
        "predicting {} {verdict} ({}{kind})",
        probability(&prediction.record),
        prediction.record.model
    )
}

/// `0.62`, or `0.62 (model 0.48)` where it is adapted.
fn probability(record: &PredictionRecord) -> String {
    match &record.adapted {
        Some(adapted) => format!("{:.2} (model {:.2})", adapted.p_stable, record.p_stable),
        None => format!("{:.2}", record.p_stable),
    }
}

/// Prints lines to standard error until the sender of `status` is dropped.
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
