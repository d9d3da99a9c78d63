//! Names and paths inside a dataset.

use std::io;
use std::path::{Path, PathBuf};

use jiff::Timestamp;

use gripcast_base::error::Error;
use gripcast_base::files::{BeneathPath, FileName, GraspId, Root, disk_remedy};
use gripcast_imaging::{PixelFormat, Role};

/// Name prefix of a grasp's directory before the grasp is complete.
const PENDING_PREFIX: &str = ".tmp-";

/// Record of a pending initial frame.
pub(super) const INITIAL_JSON: &str = "initial.json";
/// Record of a complete grasp.
pub(super) const GRASP_JSON: &str = "grasp.json";
/// Index of the grasps.
pub(super) const METADATA_JSONL: &str = "metadata.jsonl";
/// Description of the dataset.
pub(super) const DATASET_TOML: &str = "dataset.toml";
/// Lock of the writer.
pub(super) const LOCK: &str = ".lock";

/// Stage of the grasp cycle at which a frame is taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Stage {
    /// Before the gripper closed.
    Initial,
    /// After the gripper closed, before the lift.
    Grasp,
}

impl Stage {
    /// Both stages, in the order of the cycle.
    pub const ALL: [Self; 2] = [Self::Initial, Self::Grasp];

    /// Name in file names and columns.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Initial => "initial",
            Self::Grasp => "grasp",
        }
    }

    /// Whether frames of a role are stored at this stage; depth only with the grasp.
    #[must_use]
    pub fn stores(self, role: Role) -> bool {
        role != Role::Depth || self == Self::Grasp
    }
}

/// Paths inside a dataset.
#[derive(Clone, Debug)]
pub(super) struct Layout {
    root: Root,
}

impl Layout {
    pub(super) fn new(root: impl Into<PathBuf>) -> Self {
        Self {
            root: Root::new(root),
        }
    }

    pub(super) fn root(&self) -> &Path {
        self.root.path()
    }

    pub(super) fn top(&self) -> BeneathPath {
        self.root.top()
    }

    pub(super) fn dataset_toml(&self) -> BeneathPath {
        self.top().join(DATASET_TOML)
    }

    /// The lock is in the root itself: it is opened without following links.
    pub(super) fn lock(&self) -> PathBuf {
        self.root().join(LOCK)
    }

    pub(super) fn index(&self) -> BeneathPath {
        self.top().join(METADATA_JSONL)
    }

    pub(super) fn grasps(&self) -> BeneathPath {
        self.top().join("grasps")
    }

    pub(super) fn trash(&self) -> BeneathPath {
        self.top().join("trash")
    }

    pub(super) fn logs(&self) -> BeneathPath {
        self.top().join("logs")
    }

    pub(super) fn calibration(&self) -> BeneathPath {
        self.top().join("calibration")
    }

    pub(super) fn models(&self) -> BeneathPath {
        self.top().join("models")
    }

    pub(super) fn splits(&self) -> BeneathPath {
        self.top().join("splits")
    }

    /// Directory of a complete grasp.
    pub(super) fn grasp(&self, id: &GraspId) -> BeneathPath {
        self.grasps().join(id)
    }

    /// Directory of a pending initial frame.
    pub(super) fn pending(&self, id: &GraspId) -> BeneathPath {
        self.grasps().join_affixed(PENDING_PREFIX, id, "")
    }

    /// Directory of a discarded initial frame or an undone grasp.
    pub(super) fn trashed(&self, id: &GraspId) -> BeneathPath {
        self.trash().join(id)
    }

    /// Wraps an IO error of the dataset and adds a remedy.
    pub(super) fn failed(&self, what: &str, error: io::Error) -> Error {
        Self::failed_at(self.root(), what, error)
    }

    /// As [`failed`](Self::failed) for one of its files.
    pub(super) fn failed_at(path: &Path, what: &str, error: io::Error) -> Error {
        let remedy = disk_remedy(&error)
            .unwrap_or("`gripcast doctor --dataset DIR` checks the disk; read `dmesg` as well");
        Error::io(what, error).at(path.display()).remedy(remedy)
    }

    /// Directories of a new dataset.
    pub(super) fn directories(&self) -> [BeneathPath; 5] {
        [
            self.grasps(),
            self.trash(),
            self.logs(),
            self.calibration(),
            self.models(),
        ]
    }
}

/// Parses the id in the name of a pending directory.
pub(super) fn pending_id(name: &str) -> Option<GraspId> {
    GraspId::parse(name.strip_prefix(PENDING_PREFIX)?).ok()
}

/// Returns the file name of an image of a grasp.
#[must_use]
pub fn image_name(stage: Stage, role: Role, format: PixelFormat) -> FileName {
    FileName::from_words(&[stage.name(), role.name(), extension(format)])
}

/// Name prefix of pre-grasp frames.
pub(super) const PRE_GRASP_PREFIX: &str = "approach.";

/// Returns the file name of a pre-grasp frame.
#[must_use]
pub fn pre_grasp_name(number: usize, format: PixelFormat) -> FileName {
    FileName::from_words(&[
        "approach",
        &format!("{number:02}"),
        "external",
        extension(format),
    ])
}

fn extension(format: PixelFormat) -> &'static str {
    match format {
        PixelFormat::Mjpg => "jpg",
        _ => "png",
    }
}

/// Makes the id of a trigger: seconds, then 1/65536 s as 4 hex digits, so that ids sort by time.
/// `offset` steps are added where an id is taken.
pub(super) fn id_at(time: Timestamp, offset: u64) -> GraspId {
    const STEPS: i128 = 1 << 16;
    const SECOND_NS: i128 = 1_000_000_000;
    let steps = time.as_nanosecond() * STEPS / SECOND_NS + i128::from(offset);
    // Out of range only in the last second of the year 9999.
    let second = Timestamp::from_nanosecond(steps.div_euclid(STEPS) * SECOND_NS).unwrap_or(time);
    GraspId::from_words(&[
        &second.strftime("%Y-%m-%dT%H-%M-%SZ").to_string(),
        &format!("{:04x}", steps.rem_euclid(STEPS)),
    ])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ids_sort_by_trigger_time() {
        let id = |time: &str, offset| id_at(time.parse().unwrap(), offset).to_string();
        assert_eq!(
            id("2026-11-20T10:15:03.25Z", 0),
            "2026-11-20T10-15-03Z-4000"
        );
        assert_eq!(id("2026-11-20T10:15:03Z", 0), "2026-11-20T10-15-03Z-0000");
        assert_eq!(id("2026-11-20T10:15:03Z", 1), "2026-11-20T10-15-03Z-0001");
        // The step after the last one of a second is in the next second.
        assert_eq!(
            id("2026-11-20T10:15:03.999999999Z", 1),
            "2026-11-20T10-15-04Z-0000"
        );
        assert!(id("2026-11-20T10:15:03.25Z", 0) < id("2026-11-20T10:15:03.26Z", 0));
    }

    #[test]
    fn pending_directory_is_recognised_by_name() {
        let layout = Layout::new("/d");
        let id = GraspId::parse("2026-11-20T10-15-03Z-7f3a").unwrap();
        let name = layout.pending(&id).name();
        assert_eq!(pending_id(&name), Some(id.clone()));
        assert_eq!(pending_id(&id), None);
        assert_eq!(pending_id(".tmp-../../x"), None);
    }
}
