//! Adaptation of predictions to the labels of the rig.

use super::Engine;
use crate::daemon::infer::InferRequest;
use gripcast_dataset::GraspIndex;
use gripcast_nn::predict::{Adaptation, Model, training_base_rate};

/// Base rate of the rig's labels in the dataset. It is computed from the labels alone, so a label
/// that is undone or changed, and a grasp in the trash, have no effect, and a restart continues.
#[derive(Debug)]
pub(super) struct RigAdaptation {
    index: GraspIndex,
    rig: String,
    model_base_rate: f64,
    strength: f64,
    newest: Option<Adaptation>,
}

impl RigAdaptation {
    /// Adapts the predictions of a model with a prior of this strength, in labels.
    pub(super) fn new(index: GraspIndex, rig: &str, model: &Model, strength: f64) -> Self {
        Self {
            index,
            rig: rig.to_owned(),
            model_base_rate: training_base_rate(model.contract()),
            strength,
            newest: None,
        }
    }

    /// Returns the adaptation if it has changed.
    fn update(&mut self) -> Option<Adaptation> {
        let labels = self.index.labels_of_rig(&self.rig);
        let now = Adaptation::new(self.model_base_rate, self.strength, labels);
        (self.newest.replace(now) != Some(now)).then_some(now)
    }
}

impl Engine {
    /// Adapts predictions to the labels of the dataset, if that is enabled.
    pub(super) fn adapt(&mut self) {
        let Some(now) = self.adaptation.as_mut().and_then(RigAdaptation::update) else {
            return;
        };
        // Fails only if the thread has ended.
        let _ = self
            .inference
            .requests
            .send(InferRequest::SetAdaptation(now));
        self.log("adaptation", &now);
    }

    /// The adaptation of the newest predictions.
    pub(super) fn adaptation(&self) -> Option<Adaptation> {
        self.adaptation.as_ref()?.newest
    }
}
