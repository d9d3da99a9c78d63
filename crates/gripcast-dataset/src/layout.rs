//! Names and places inside a dataset.

use std::path::{Path, PathBuf};

use jiff::Timestamp;

use super::grasp::{FileDigest, GraspId};
use gripcast_base::files::{BeneathPath, FileName, Root, sha256_hex};
use gripcast_imaging::{PixelFormat, Role};

/// Beginning of the name of a grasp's directory before the grasp is complete.
const PENDING_PREFIX: &str = ".tmp-";

/// Record of a pending initial frame.
pub(super) const INITIAL_JSON: &str = "initial.json";
/// Record of a complete grasp.
pub(super) const GRASP_JSON: &str = "grasp.json";
/// The index.
pub(super) const METADATA_JSONL: &str = "metadata.jsonl";
/// The dataset's description.
pub(super) const DATASET_TOML: &str = "dataset.toml";
/// The lock of the writer.
pub(super) const LOCK: &str = ".lock";

/// Trigger of the cycle that a frame belongs to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Stage {
    /// Before the gripper closed.
    Initial,
    /// After it closed, before the lift.
    Grasp,
}

impl Stage {
    /// Both, in the order of the cycle.
    pub const ALL: [Self; 2] = [Self::Initial, Self::Grasp];

    /// Name in files and columns.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Initial => "initial",
            Self::Grasp => "grasp",
        }
    }

    /// Whether frames of a role are stored at this stage: depth only with the grasp.
    #[must_use]
    pub fn stores(self, role: Role) -> bool {
        role != Role::Depth || self == Self::Grasp
    }
}

/// Places of a dataset.
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

    /// The lock lies in the root itself: it is opened without following links.
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

    /// Directory of a grasp of which the initial frame alone is there.
    pub(super) fn pending(&self, id: &GraspId) -> BeneathPath {
        self.grasps().join_affixed(PENDING_PREFIX, id, "")
    }

    /// Place of a discarded initial frame or an undone grasp.
    pub(super) fn trashed(&self, id: &GraspId) -> BeneathPath {
        self.trash().join(id)
    }

    /// Directories that a dataset has from the beginning.
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

/// The id in the name of a pending directory.
pub(super) fn pending_id(name: &str) -> Option<GraspId> {
    GraspId::parse(name.strip_prefix(PENDING_PREFIX)?).ok()
}

/// Name of an image file of a grasp.
#[must_use]
pub fn image_name(stage: Stage, role: Role, format: PixelFormat) -> FileName {
    FileName::of_words(&[stage.name(), role.name(), extension(format)])
}

/// Begin of the names of further frames from before the fingers closed.
pub(super) const APPROACH_PREFIX: &str = "approach.";

/// Name of the file of a further frame from before the fingers closed.
#[must_use]
pub fn approach_name(number: usize, format: PixelFormat) -> FileName {
    FileName::of_words(&[
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

/// The id of a trigger at this time: seconds, then 1/65536 s as 4 hex digits, so that ids sort as
/// the triggers came. `later` steps are added where an id is taken.
pub(super) fn id_at(at: Timestamp, later: u64) -> GraspId {
    const STEPS: i128 = 1 << 16;
    const SECOND_NS: i128 = 1_000_000_000;
    let steps = at.as_nanosecond() * STEPS / SECOND_NS + i128::from(later);
    // Stays within what a `Timestamp` holds but for the last second of the year 9999.
    let second = Timestamp::from_nanosecond(steps.div_euclid(STEPS) * SECOND_NS).unwrap_or(at);
    GraspId::of_words(&[
        &second.strftime("%Y-%m-%dT%H-%M-%SZ").to_string(),
        &format!("{:04x}", steps.rem_euclid(STEPS)),
    ])
}

/// Digest of a file's contents.
pub(super) fn digest(bytes: &[u8]) -> FileDigest {
    FileDigest {
        bytes: bytes.len() as u64,
        sha256: sha256_hex(bytes),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_base::files::ContentKey;

    #[test]
    fn ids_sort_as_the_triggers_came() {
        let id = |at: &str, later| id_at(at.parse().unwrap(), later).to_string();
        assert_eq!(
            id("2026-11-20T10:15:03.25Z", 0),
            "2026-11-20T10-15-03Z-4000"
        );
        assert_eq!(id("2026-11-20T10:15:03Z", 0), "2026-11-20T10-15-03Z-0000");
        assert_eq!(id("2026-11-20T10:15:03Z", 1), "2026-11-20T10-15-03Z-0001");
        // The step after the last of a second belongs to the next.
        assert_eq!(
            id("2026-11-20T10:15:03.999999999Z", 1),
            "2026-11-20T10-15-04Z-0000"
        );
        assert!(id("2026-11-20T10:15:03.25Z", 0) < id("2026-11-20T10:15:03.26Z", 0));
    }

    #[test]
    fn digests_agree_with_sha256sum() {
        assert_eq!(
            digest(b"abc"),
            FileDigest {
                bytes: 3,
                sha256: "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad".into(),
            }
        );
        assert_eq!(ContentKey::of(b"abc"), "ba7816bf8f01");
    }

    #[test]
    fn pending_directories_are_told_by_their_name() {
        let layout = Layout::new("/d");
        let id = GraspId::parse("2026-11-20T10-15-03Z-7f3a").unwrap();
        let name = layout.pending(&id).name();
        assert_eq!(pending_id(&name), Some(id.clone()));
        assert_eq!(pending_id(&id), None);
        assert_eq!(pending_id(".tmp-../../x"), None);
    }
}
