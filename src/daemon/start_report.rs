//! Start report: what the operator should know before the first grasp. Compares rig, cameras, model
//! and clock with the grasps that the dataset has.

use jiff::{SignedDuration, Timestamp};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::infer::ModelInfo;
use super::status::CameraStatus;
use gripcast_base::files::ObjectName;
use gripcast_capture::calibration::{CameraConfig, RigFile, SourceKind};
use gripcast_dataset::Provenance;
use gripcast_session::MessageLevel;

/// Time before which no clock of this version can be right.
const RELEASED: &str = "2026-11-01T00:00:00Z";
/// Largest change of the wall clock against the monotonic one that is no jump: NTP slews.
const MAX_CLOCK_JUMP: SignedDuration = SignedDuration::from_secs(2);
/// Number of grasps below which free space is a warning.
const FEW_GRASPS: u64 = 200;

/// Subject of a finding.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum StartSubject {
    /// Grasps of a virtual rig, of recordings and of cameras in one dataset.
    MixedSources,
    /// The wall clock is wrong.
    Clock,
    /// Records that cannot be read.
    Unreadable,
    /// What opening the dataset found: leftovers of a crash, an earlier format.
    Opening,
    /// Another rig than that of the newest grasp.
    Rig,
    /// Other cameras than those of the newest grasp.
    Cameras,
    /// Another model than that of the newest prediction.
    Model,
    /// The object has the default name.
    Object,
    /// Number of grasps that fit on the disk.
    FreeSpace,
}

/// A finding of the start report.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct StartFinding {
    /// Its subject; at most one finding each.
    pub subject: StartSubject,
    /// Severity.
    pub level: MessageLevel,
    /// One or two sentences: what was found, and what to do.
    pub text: String,
}

/// What the report compares with the dataset.
pub(super) struct StartFacts<'a> {
    /// The existing grasps.
    pub(super) dataset: &'a Provenance,
    /// What opening the dataset found, one sentence each.
    pub(super) opening: &'a [String],
    /// Source of the newest grasp's frames.
    pub(super) newest_source: Option<SourceKind>,
    /// The rig.
    pub(super) rig: &'a RigFile,
    /// Its cameras; product and serial are known once a camera was opened.
    pub(super) cameras: &'a [CameraStatus],
    /// The model.
    pub(super) model: Option<&'a ModelInfo>,
    /// Object of the next grasps.
    pub(super) object: &'a ObjectName,
    /// Wall clock.
    pub(super) now: Timestamp,
    /// Change of the wall clock against the monotonic one since the start.
    pub(super) clock_jump: SignedDuration,
    /// Free space on the dataset's disk, bytes.
    pub(super) disk_free_bytes: Option<u64>,
    /// Number of grasps that still fit on it; none before the first grasp.
    pub(super) grasps_left: Option<u64>,
}

/// Returns the findings, the most important first.
pub(super) fn start_report(facts: &StartFacts<'_>) -> Vec<StartFinding> {
    let warning = |subject, text: Option<String>| {
        let level = MessageLevel::Warning;
        text.map(|text| StartFinding {
            subject,
            level,
            text,
        })
    };
    let mixed = mixed_sources(facts);
    let is_mixed = mixed.is_some();
    [
        warning(StartSubject::MixedSources, mixed),
        warning(StartSubject::Clock, clock(facts)),
        warning(StartSubject::Unreadable, unreadable(facts)),
        warning(StartSubject::Opening, opening(facts)),
        // A virtual rig differs from a real one in everything.
        warning(StartSubject::Rig, rig(facts).filter(|_| !is_mixed)),
        warning(StartSubject::Cameras, cameras(facts).filter(|_| !is_mixed)),
        warning(StartSubject::Model, model(facts)),
        warning(StartSubject::Object, default_object(facts)),
        free_space(facts),
    ]
    .into_iter()
    .flatten()
    .collect()
}

fn opening(facts: &StartFacts<'_>) -> Option<String> {
    (!facts.opening.is_empty()).then(|| facts.opening.join(". "))
}

fn mixed_sources(facts: &StartFacts<'_>) -> Option<String> {
    let (simulated, all) = (facts.dataset.simulated, facts.dataset.grasps);
    let source = source(facts.rig);
    let (others, old) = match source {
        SourceKind::Virtual => (all - simulated, "not simulated"),
        _ => (simulated, "simulated"),
    };
    let old = if others > 0 {
        format!("{others} of the dataset's {all} grasps are {old}")
    } else {
        let newest = facts.newest_source.filter(|newest| *newest != source)?;
        format!("the dataset's newest grasp is {}", words(newest))
    };
    Some(format!(
        "the next grasps are {}, but {old}: use another --dataset, or filter by `rig`",
        words(source).to_uppercase()
    ))
}

/// Source of the tactile cameras' frames.
fn source(rig: &RigFile) -> SourceKind {
    let mut tactile = rig.cameras.iter().filter(|(role, _)| role.is_tactile());
    tactile
        .next()
        .map(|(_, camera)| camera.source)
        .unwrap_or_default()
}

fn words(source: SourceKind) -> &'static str {
    match source {
        SourceKind::V4l2 => "from cameras",
        SourceKind::Replay => "from a recording",
        SourceKind::Virtual => "simulated",
    }
}

fn clock(facts: &StartFacts<'_>) -> Option<String> {
    let now = facts.now;
    let remedy = "set the clock: ids and times of the grasps follow it";
    if RELEASED
        .parse()
        .is_ok_and(|released: Timestamp| now < released)
    {
        return Some(format!(
            "the clock says {now:.0}, before this version was made: {remedy}"
        ));
    }
    if let Some(newest) = facts.dataset.captured_at
        && now < newest
    {
        return Some(format!(
            "the clock says {now:.0}, before the dataset's newest grasp ({newest:.0}): {remedy}"
        ));
    }
    (facts.clock_jump.abs() > MAX_CLOCK_JUMP).then(|| {
        format!(
            "the clock jumped by {:.0} s since the start: {remedy}",
            facts.clock_jump.as_secs_f64()
        )
    })
}

fn unreadable(facts: &StartFacts<'_>) -> Option<String> {
    let count = facts.dataset.unreadable;
    (count > 0).then(|| {
        format!(
            "{count} of the dataset's records cannot be read and are not counted: run `gripcast \
             dataset verify` after the session"
        )
    })
}

fn rig(facts: &StartFacts<'_>) -> Option<String> {
    let (before, now) = (facts.dataset.rig.as_ref()?, &facts.rig.id);
    (before != now).then(|| {
        format!("rig {now}, but the dataset's newest grasp is from rig {before}: check --dataset")
    })
}

fn cameras(facts: &StartFacts<'_>) -> Option<String> {
    let before = &facts.dataset.cameras;
    if before.is_empty() {
        return None;
    }
    let mut differences = Vec::new();
    for (role, record) in before {
        let Some(config) = facts.rig.cameras.get(role) else {
            differences.push(format!("no {role} camera (before: {})", record.product));
            continue;
        };
        let mut of_role = Vec::new();
        let mut compare = |what: &str, before: &str, now: &str| {
            if before != now {
                of_role.push(format!("{what} {now} (before: {before})"));
            }
        };
        let opened = facts.cameras.iter().find(|camera| camera.role == *role);
        if let Some(camera) = opened.filter(|camera| !camera.product.is_empty()) {
            compare("product", &record.product, &camera.product);
        }
        if let Some(camera) = opened.filter(|camera| !camera.serial.is_empty()) {
            compare("serial", &record.serial, &camera.serial);
        }
        compare("size", &size(record.width, record.height), &size_of(config));
        if let (Some(before), Some(now)) = (&record.crop_profile, &config.crop_profile) {
            compare("crop profile", before, now);
        }
        if !of_role.is_empty() {
            differences.push(format!("{role}: {}", of_role.join(", ")));
        }
    }
    for role in facts.rig.cameras.keys() {
        if !before.contains_key(role) {
            differences.push(format!("{role}: new"));
        }
    }
    (!differences.is_empty()).then(|| {
        format!(
            "other cameras than those of the dataset's newest grasp: {}",
            differences.join("; ")
        )
    })
}

fn size(width: u32, height: u32) -> String {
    format!("{width}×{height}")
}

fn size_of(camera: &CameraConfig) -> String {
    size(camera.width, camera.height)
}

fn model(facts: &StartFacts<'_>) -> Option<String> {
    let before = facts.dataset.prediction.as_ref()?;
    let before_key = before.model_sha256.get(..12).unwrap_or_default();
    let Some(now) = facts.model else {
        return Some(format!(
            "no model, but the dataset's newest grasps have predictions by {}",
            before.model
        ));
    };
    (now.sha256 != before.model_sha256).then(|| {
        format!(
            "model {} ({}), but the dataset's newest prediction is by {} ({before_key})",
            now.name,
            now.sha256.get(..12).unwrap_or_default(),
            before.model
        )
    })
}

fn default_object(facts: &StartFacts<'_>) -> Option<String> {
    (*facts.object == ObjectName::default()).then(|| {
        format!(
            "the object still has the default name `{}`: name it before the first grasp (o)",
            facts.object
        )
    })
}

fn free_space(facts: &StartFacts<'_>) -> Option<StartFinding> {
    let left = facts.grasps_left?;
    let gigabytes = facts.disk_free_bytes? as f64 * 1e-9;
    Some(StartFinding {
        subject: StartSubject::FreeSpace,
        level: match left < FEW_GRASPS {
            true => MessageLevel::Warning,
            false => MessageLevel::Info,
        },
        text: format!("{left} more grasps fit on the disk ({gigabytes:.1} GB free)"),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_capture::camera::{CameraCounters, CameraState};
    use gripcast_dataset::sample::{capture, meta, new_dataset};
    use gripcast_dataset::{DatasetWriter, PredictionRecord};
    use gripcast_imaging::{PixelFormat, Role};

    /// Dataset of one grasp of both gels, colour and depth by rig `bench`.
    fn bench() -> Provenance {
        let dir = tempfile::tempdir().unwrap();
        let (mut writer, _) = DatasetWriter::open_or_create(dir.path(), &new_dataset()).unwrap();
        let pending = writer.save_initial(&capture(1), Vec::new()).unwrap();
        writer
            .save_grasp(&pending, &capture(2), meta("mug"))
            .unwrap();
        drop(writer);
        DatasetWriter::open(dir.path()).unwrap().1.provenance
    }

    fn rig_of(dataset: &Provenance, source: SourceKind) -> RigFile {
        let camera = |(role, record): (&Role, &gripcast_dataset::CameraRecord)| {
            let format = match role {
                Role::Depth => PixelFormat::Z16,
                _ => PixelFormat::Mjpg,
            };
            let mut camera = CameraConfig::new(source, format, record.width, record.height, 25.0);
            camera.crop_profile.clone_from(&record.crop_profile);
            (*role, camera)
        };
        RigFile {
            id: "bench".into(),
            cameras: dataset.cameras.iter().map(camera).collect(),
            ..RigFile::virtual_rig()
        }
    }

    fn opened(dataset: &Provenance) -> Vec<CameraStatus> {
        let status = |(role, record): (&Role, &gripcast_dataset::CameraRecord)| CameraStatus {
            role: *role,
            product: record.product.clone(),
            serial: record.serial.clone(),
            port: String::new(),
            state: CameraState::Live,
            measured_fps: 25.0,
            nominal_fps: 25.0,
            frame_age_ms: None,
            counters: CameraCounters::default(),
            markers: None,
        };
        dataset.cameras.iter().map(status).collect()
    }

    struct Scene {
        dataset: Provenance,
        newest_source: Option<SourceKind>,
        rig: RigFile,
        cameras: Vec<CameraStatus>,
        model: Option<ModelInfo>,
        object: ObjectName,
        now: Timestamp,
        clock_jump: SignedDuration,
        disk_free_bytes: Option<u64>,
        grasps_left: Option<u64>,
        opening: Vec<String>,
    }

    impl Scene {
        /// Everything as in the dataset.
        fn same() -> Self {
            let dataset = bench();
            let record: &PredictionRecord = dataset.prediction.as_ref().unwrap();
            Self {
                newest_source: Some(SourceKind::V4l2),
                rig: rig_of(&dataset, SourceKind::V4l2),
                cameras: opened(&dataset),
                model: Some(ModelInfo {
                    name: record.model.clone(),
                    sha256: record.model_sha256.clone(),
                    threshold: 0.5,
                    heuristic: false,
                }),
                object: "mug".parse().unwrap(),
                now: "2026-11-21T08:00:00Z".parse().unwrap(),
                clock_jump: SignedDuration::ZERO,
                disk_free_bytes: Some(500_000_000_000),
                grasps_left: Some(50_000),
                opening: Vec::new(),
                dataset,
            }
        }

        fn report(&self) -> Vec<StartFinding> {
            start_report(&StartFacts {
                dataset: &self.dataset,
                newest_source: self.newest_source,
                rig: &self.rig,
                cameras: &self.cameras,
                model: self.model.as_ref(),
                object: &self.object,
                now: self.now,
                clock_jump: self.clock_jump,
                disk_free_bytes: self.disk_free_bytes,
                opening: &self.opening,
                grasps_left: self.grasps_left,
            })
        }

        /// The warnings, and the text of the only one about `subject`.
        fn warning(&self, subject: StartSubject) -> String {
            let found: Vec<StartFinding> = self
                .report()
                .into_iter()
                .filter(|finding| finding.level == MessageLevel::Warning)
                .collect();
            assert_eq!(found.len(), 1, "{found:?}");
            assert_eq!(found[0].subject, subject);
            found[0].text.clone()
        }
    }

    #[test]
    fn same_rig_model_and_clock_give_only_the_free_space() {
        let report = Scene::same().report();
        assert_eq!(report.len(), 1, "{report:?}");
        assert_eq!(report[0].subject, StartSubject::FreeSpace);
        assert_eq!(report[0].level, MessageLevel::Info);
        assert!(report[0].text.contains("more grasps fit"), "{report:?}");
    }

    #[test]
    fn new_dataset_has_nothing_to_compare_with() {
        let mut scene = Scene::same();
        scene.dataset = Provenance::default();
        scene.newest_source = None;
        scene.grasps_left = None;
        scene.rig.id = "other".into();
        assert_eq!(scene.report(), []);
    }

    #[test]
    fn simulated_recorded_and_real_grasps_are_not_mixed_silently() {
        let mut scene = Scene::same();
        scene.rig = RigFile::virtual_rig();
        let text = scene.warning(StartSubject::MixedSources);
        assert!(
            text.contains("SIMULATED") && text.contains("1 of the dataset's 1"),
            "{text}"
        );
        let mut scene = Scene::same();
        scene.dataset.simulated = 1;
        let text = scene.warning(StartSubject::MixedSources);
        assert!(text.contains("FROM CAMERAS, but 1 of"), "{text}");
        scene.rig = rig_of(&scene.dataset, SourceKind::Virtual);
        scene.newest_source = Some(SourceKind::Virtual);
        assert_eq!(scene.report().len(), 1, "virtual again");
        let mut scene = Scene::same();
        scene.rig = rig_of(&scene.dataset, SourceKind::Replay);
        let text = scene.warning(StartSubject::MixedSources);
        assert!(text.contains("FROM A RECORDING"), "{text}");
        assert!(text.contains("newest grasp is from cameras"), "{text}");
    }

    #[test]
    fn what_opening_found_is_told() {
        let mut scene = Scene::same();
        scene.opening = vec!["completed A after a crash".into(), "earlier format".into()];
        let text = scene.warning(StartSubject::Opening);
        assert_eq!(text, "completed A after a crash. earlier format");
    }

    #[test]
    fn other_rig_is_named() {
        let mut scene = Scene::same();
        scene.rig.id = "bench-2".into();
        let text = scene.warning(StartSubject::Rig);
        assert!(
            text.contains("bench-2") && text.contains("rig bench:"),
            "{text}"
        );
    }

    #[test]
    fn other_cameras_are_named_with_both_values() {
        let mut scene = Scene::same();
        scene.cameras[0].serial = "S-9".into();
        let text = scene.warning(StartSubject::Cameras);
        assert!(text.contains("left: serial S-9 (before: S-left)"), "{text}");
        let mut scene = Scene::same();
        let left = scene.rig.cameras.get_mut(&Role::Left).unwrap();
        left.width = 640;
        left.crop_profile = Some("gsrobotics-2025".into());
        let text = scene.warning(StartSubject::Cameras);
        assert!(text.contains("size 640×8 (before: 16×8)"), "{text}");
        assert!(text.contains("crop profile gsrobotics-2025"), "{text}");
        let mut scene = Scene::same();
        scene.rig.cameras.remove(&Role::Rgb);
        let text = scene.warning(StartSubject::Cameras);
        assert!(text.contains("no rgb camera"), "{text}");
        // Before a camera is opened its serial is unknown.
        let mut scene = Scene::same();
        for camera in &mut scene.cameras {
            camera.serial.clear();
            camera.product.clear();
        }
        assert_eq!(scene.report().len(), 1);
    }

    #[test]
    fn wrong_clocks_are_found() {
        for (now, expected) in [
            ("1970-01-01T00:10:00Z", "before this version was made"),
            ("2026-11-20T10:15:01Z", "before the dataset's newest grasp"),
        ] {
            let mut scene = Scene::same();
            scene.now = now.parse().unwrap();
            let text = scene.warning(StartSubject::Clock);
            assert!(text.contains(expected), "{text}");
        }
        for seconds in [-3600, 60] {
            let mut scene = Scene::same();
            scene.clock_jump = SignedDuration::from_secs(seconds);
            let text = scene.warning(StartSubject::Clock);
            assert!(text.contains(&format!("jumped by {seconds} s")), "{text}");
        }
    }

    #[test]
    fn model_object_records_and_space_are_reported() {
        let mut scene = Scene::same();
        scene.model.as_mut().unwrap().sha256 = "f".repeat(64);
        assert!(scene.warning(StartSubject::Model).contains("ffffffffffff"));
        scene.model = None;
        assert!(scene.warning(StartSubject::Model).contains("no model"));
        let mut scene = Scene::same();
        scene.object = ObjectName::default();
        assert!(scene.warning(StartSubject::Object).contains("`object`"));
        let mut scene = Scene::same();
        scene.dataset.unreadable = 3;
        assert!(scene.warning(StartSubject::Unreadable).starts_with("3 of"));
        let mut scene = Scene::same();
        scene.grasps_left = Some(10);
        let text = scene.warning(StartSubject::FreeSpace);
        assert!(text.starts_with("10 more grasps"), "{text}");
        scene.grasps_left = None;
        assert_eq!(scene.report(), []);
    }
}
