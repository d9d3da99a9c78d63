//! Flags that `collect` and `daemon` fraction: what is collected, and with what.

use std::path::PathBuf;

use crate::config::FlagValue;
use gripcast_base::files::{Label, ObjectName};

/// The flags; each stands for a key of the configuration.
#[derive(Clone, Debug, clap::Args)]
pub(super) struct CollectionFlags {
    /// Rig: `virtual`, the name of a rig file, or its path
    #[arg(long)]
    rig: Option<String>,
    /// Dataset directory; created when absent
    #[arg(short = 'C', long, value_name = "DIR")]
    dataset: Option<PathBuf>,
    /// Object at the start
    #[arg(long)]
    object: Option<ObjectName>,
    /// Scene at the start
    #[arg(long)]
    scene: Option<Label>,
    /// Who holds the gripper
    #[arg(long)]
    operator: Option<Label>,
    /// ONNX file, `gripcast-vt`, the built-in classifier, `baseline-contact`, a heuristic of touch
    /// alone, or `none` for no prediction [default: gripcast-vt; baseline-contact where the rig's
    /// cameras or crop profile are not those of the classifier]
    #[arg(long, value_name = "MODEL")]
    model: Option<String>,
    /// Log every frame, event and prediction as MCAP beside the grasps (`[black_box]` of the
    /// configuration: place and limits)
    #[arg(long)]
    black_box: bool,
}

impl CollectionFlags {
    /// Those that were given.
    pub(super) fn given(&self) -> Vec<FlagValue> {
        let dataset = self.dataset.as_ref().map(|path| path.display().to_string());
        let black_box = self.black_box.then(|| "true".to_owned());
        [
            ("--rig", "collect.rig", self.rig.clone()),
            ("--dataset", "collect.dataset", dataset),
            (
                "--object",
                "collect.object",
                self.object.clone().map(String::from),
            ),
            (
                "--scene",
                "collect.scene",
                self.scene.clone().map(String::from),
            ),
            (
                "--operator",
                "collect.operator",
                self.operator.clone().map(String::from),
            ),
            ("--model", "collect.model", self.model.clone()),
            ("--black-box", "black_box.enabled", black_box),
        ]
        .into_iter()
        .filter_map(|(flag, key, value)| Some((flag, key, value?)))
        .collect()
    }
}
