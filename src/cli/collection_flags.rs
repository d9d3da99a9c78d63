//! Options of `collect` and `daemon`: rig, dataset, labels and model.

use std::path::PathBuf;

use super::flags::{given, number, path_text};
use crate::config::{ADAPT_STRENGTH, ERROR_RATE_OR_NONE, FlagValue, KEEP_LIFT_S};
use gripcast_base::files::{Label, ObjectName};

/// The options; each overrides a key of the configuration.
#[derive(Clone, Debug, clap::Args)]
pub(super) struct CollectionFlags {
    /// Rig: virtual, the name of a rig file, or its path
    #[arg(long, value_name = "NAME|FILE")]
    rig: Option<String>,
    /// Folder of the dataset; created if absent
    #[arg(short = 'C', long, value_name = "DIR")]
    dataset: Option<PathBuf>,
    /// Initial object name
    #[arg(long, value_name = "NAME")]
    object: Option<ObjectName>,
    /// Initial scene name
    #[arg(long, value_name = "NAME")]
    scene: Option<Label>,
    /// Name of the operator
    #[arg(long, value_name = "NAME")]
    operator: Option<Label>,
    /// ONNX file, gripcast-vt (built-in classifier), baseline-contact (built-in tactile heuristic)
    /// or none [default: gripcast-vt if it suits the rig's cameras, else baseline-contact]
    #[arg(long, value_name = "MODEL")]
    model: Option<String>,
    /// Predict the set of outcomes that is wrong at most at this rate: stable, slip or can't tell;
    /// 0 disables it
    #[arg(long, value_name = "RATE", value_parser = number(ERROR_RATE_OR_NONE))]
    error_rate: Option<f64>,
    /// Adapt predictions to the base rate of the labels that this rig has in the dataset; the
    /// model's own probability is stored too
    #[arg(long)]
    adapt: bool,
    /// Weight of the model's base rate in the adaptation [default: 10]
    #[arg(long, value_name = "LABELS", value_parser = number(ADAPT_STRENGTH))]
    adapt_strength: Option<f64>,
    /// Log every frame, event and prediction as MCAP (location and limits: `[black_box]` of the
    /// configuration)
    #[arg(long)]
    black_box: bool,
    /// Store the frames of both gels with each grasp for this time after its trigger, at most 10s:
    /// the lift itself
    #[arg(long, value_name = "SECONDS", value_parser = seconds)]
    keep_lift: Option<f64>,
}

/// Parses a time such as `2s` or `0.5`.
fn seconds(text: &str) -> Result<f64, String> {
    number(KEEP_LIFT_S)(text.trim_end_matches('s'))
}

impl CollectionFlags {
    /// Returns the configuration values of the given options.
    pub(super) fn given(&self) -> Vec<FlagValue> {
        let object = self.object.clone().map(String::from);
        let scene = self.scene.clone().map(String::from);
        let operator = self.operator.clone().map(String::from);
        given([
            ("--rig", "collect.rig", self.rig.clone()),
            (
                "--dataset",
                "collect.dataset",
                path_text(self.dataset.as_ref()),
            ),
            ("--object", "collect.object", object),
            ("--scene", "collect.scene", scene),
            ("--operator", "collect.operator", operator),
            ("--model", "collect.model", self.model.clone()),
            (
                "--keep-lift",
                "collect.keep_lift_s",
                self.keep_lift.map(|seconds| seconds.to_string()),
            ),
            (
                "--error-rate",
                "collect.error_rate",
                self.error_rate.map(|rate| rate.to_string()),
            ),
            (
                "--adapt",
                "collect.adapt",
                self.adapt.then(|| "true".to_owned()),
            ),
            (
                "--adapt-strength",
                "collect.adapt_strength",
                self.adapt_strength.map(|labels| labels.to_string()),
            ),
            (
                "--black-box",
                "black_box.enabled",
                self.black_box.then(|| "true".to_owned()),
            ),
        ])
    }
}
