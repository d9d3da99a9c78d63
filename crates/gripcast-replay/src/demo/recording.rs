//! Writes the grasps as a dataset, as if they had been collected on a rig.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::{Mutex, MutexGuard};

use image::imageops::grayscale;
use jiff::{SignedDuration, Timestamp};
use serde::Serialize;

use super::images::{DemoScene, Images, TABLE_CAMERA};
use super::object::DemoObject;
use super::plan::DemoWatch;
use super::reality::{GraspLabel, reality};
use super::selection::SelectedGrasp;
use super::tactile::{Contact, FRAME, sensor, tactile_frames};
use gripcast_annotate::Annotator;
use gripcast_base::error::{Error, Result};
use gripcast_base::files::{ContentKey, Label, ObjectName};
use gripcast_base::random::SeedStream;
use gripcast_dataset::{
    BoardKeys, CapturedCamera, Dataset, DatasetWriter, GraspMeta, NewDataset, Outcome,
    PendingInitial, PoseRecord, SimulatedTruth, Stage, StageCapture, image_name,
};
use gripcast_imaging::{Decoder, Frame, Intrinsics, PixelFormat, Role};
use gripcast_pose::detect::FullSearch;
use gripcast_sim::grasp::Finger;
use gripcast_tactile::{SensorProfile, SimulatedGel};

/// Name of the dataset, its rig and its operator.
const NAME: &str = "gripcast-demo-simulated";
const RIG: &str = "simulated-demo";
const OPERATOR: &str = "simulation";
/// Note of each grasp.
const NOTE: &str = "Simulated, not real: images are rendered, the outcome is that of a simulation.";
/// Time stamp of the first candidate, before such sensors existed; candidates are a minute apart.
const START: &str = "2000-01-01T00:00:00Z";
const INTERVAL_S: i64 = 60;
/// Each object has time stamps for this many candidates.
const MAX_CANDIDATES: i64 = 1000;
/// Time from the initial frame to the grasp frame, and from there to the label, s.
const CLOSING_S: i64 = 5;
const LIFTING_S: i64 = 4;
/// Maximum skew of the cameras at a trigger, ms.
const MAX_SKEW_MS: f64 = 15.0;

/// Calibration file of a demo camera.
#[derive(Serialize)]
struct Calibration<'a> {
    camera: Camera<'a>,
    intrinsics: Option<Intrinsics>,
}

#[derive(Serialize)]
struct Camera<'a> {
    product: &'a str,
    serial: String,
    crop_profile: Option<&'a str>,
    note: &'a str,
}

/// Renders and writes grasps; shared between threads.
pub(super) struct Recorder {
    writer: Mutex<DatasetWriter>,
    /// Names of the grasps that are already recorded.
    recorded: BTreeSet<String>,
    /// Initial frames whose grasp was not saved before the build stopped.
    pending: Mutex<Option<PendingInitial>>,
    sensors: [SensorProfile; 2],
    gel: SimulatedGel,
    seed: u64,
}

impl Recorder {
    /// Opens or creates the dataset; the quick one has other gels.
    ///
    /// # Errors
    /// As [`DatasetWriter::open_or_create`].
    pub(super) fn open(folder: &Path, seed: u64, is_quick: bool) -> Result<Self> {
        let new = NewDataset {
            name: NAME.to_owned(),
            rig: RIG.to_owned(),
            licence: "CC0-1.0".to_owned(),
            label_definition: "SIMULATED, nothing here was measured: stable = in a finite-element \
                simulation every point of the object is 20 mm above the ground after a lift of \
                50 mm; slip = it was touched and is not. Images are rendered."
                .to_owned(),
        };
        let (mut writer, report) = DatasetWriter::open_or_create(folder, &new)?;
        let mut recorded = BTreeSet::new();
        for record in Dataset::open(folder)?.grasps()? {
            let record = record?;
            let Some(truth) = &record.truth else {
                continue;
            };
            if record.outcome == Outcome::Unlabelled {
                let at = time(&record.grasp.captured_at)?;
                set_label(&mut writer, &record.id, truth.stable, at)?;
            }
            recorded.insert(truth.clip.clone());
        }
        let engine = reality(is_quick).settings;
        Ok(Self {
            writer: Mutex::new(writer),
            recorded,
            pending: Mutex::new(report.pending),
            sensors: [sensor(Finger::Left)?, sensor(Finger::Right)?],
            gel: SimulatedGel {
                grid: engine.gel()?.grid,
                d_hat_m: engine.solver.d_hat_m,
            },
            seed,
        })
    }

    /// Finds a recorded grasp that is not among the given names.
    pub(super) fn unexpected_grasp(&self, names: &BTreeSet<String>) -> Option<&String> {
        self.recorded.iter().find(|name| !names.contains(*name))
    }

    /// Renders, annotates and stores a grasp.
    ///
    /// # Errors
    /// Errors of rendering and writing.
    pub(super) fn record(
        &self,
        object: &DemoObject,
        scene: &DemoScene,
        chosen: &SelectedGrasp,
        watch: &DemoWatch<'_>,
    ) -> Result<()> {
        if self.recorded.contains(&grasp_name(object, chosen)) {
            return Ok(());
        }
        let frames = self.render(object, scene, chosen, watch)?;
        let pose = annotate(scene, &frames.images).ok();
        let [initial, grasp] = self.captures(object, chosen, frames, pose)?;
        self.store(object, scene, chosen, &initial, &grasp)
    }

    fn writer(&self) -> MutexGuard<'_, DatasetWriter> {
        self.writer.lock().unwrap_or_else(|e| e.into_inner())
    }

    fn render(
        &self,
        object: &DemoObject,
        scene: &DemoScene,
        chosen: &SelectedGrasp,
        watch: &DemoWatch<'_>,
    ) -> Result<GraspFrames> {
        let pre_lift = chosen
            .simulated
            .pre_lift
            .as_ref()
            .ok_or_else(|| Error::internal("a selected grasp has no state before the lift"))?;
        let mut draw = SeedStream::named(
            self.seed,
            &format!("pictures {}", grasp_name(object, chosen)),
        );
        let placed = &chosen.candidate.placed;
        let contact = Contact {
            mesh: &object.mesh,
            gel: &self.gel,
            t_world_object: object.t_world_object,
            placed,
            pre_lift,
        };
        let mut frames = |finger: Finger| {
            let seeds = [draw.bits(), draw.bits()];
            tactile_frames(&self.sensors[finger as usize], &contact, finger, seeds)
        };
        let tactile = [frames(Finger::Left)?, frames(Finger::Right)?];
        let images = scene.render(placed, pre_lift, &self.gel.grid, draw.bits(), watch)?;
        Ok(GraspFrames { tactile, images })
    }

    fn captures(
        &self,
        object: &DemoObject,
        chosen: &SelectedGrasp,
        frames: GraspFrames,
        pose: Option<PoseRecord>,
    ) -> Result<[StageCapture; 2]> {
        let start = captured_at(chosen)?;
        let GraspFrames {
            tactile: [[left_before, left_after], [right_before, right_after]],
            images,
        } = frames;
        let [hand_before, hand_after] = images.hand;
        let stage = |at: Timestamp, trigger_time_ns: u64, cameras: Vec<(Role, Vec<u8>)>| {
            let camera = |(role, jpeg)| (role, self.camera(role, jpeg, trigger_time_ns));
            StageCapture {
                captured_at: at,
                trigger_time_ns,
                trigger: "script".to_owned(),
                cameras: cameras.into_iter().map(camera).collect(),
                pre_grasp_frames: Vec::new(),
                fields: Vec::new(),
                shear: BTreeMap::new(),
                force: BTreeMap::new(),
                pose: None,
                truth: None,
            }
        };
        let since_boot = 1_000_000_000 * (start.as_second() - time(START)?.as_second() + 60) as u64;
        let initial = stage(
            start,
            since_boot,
            vec![
                (Role::Left, left_before),
                (Role::Right, right_before),
                (Role::Rgb, hand_before),
                (Role::External, images.table),
            ],
        );
        let mut grasp = stage(
            start + SignedDuration::from_secs(CLOSING_S),
            since_boot + 1_000_000_000 * CLOSING_S as u64,
            vec![
                (Role::Left, left_after),
                (Role::Right, right_after),
                (Role::Rgb, hand_after),
            ],
        );
        grasp.pose = pose.map(Box::new);
        grasp.truth = truth(object, chosen).map(Box::new);
        Ok([initial, grasp])
    }

    /// Returns a frame with the metadata of a driver.
    fn camera(&self, role: Role, jpeg: Vec<u8>, trigger_ns: u64) -> CapturedCamera {
        let [width, height] = match role {
            Role::Left | Role::Right => FRAME,
            Role::External => TABLE_CAMERA.map(|n| n as u32),
            Role::Rgb | Role::Depth => super::images::HAND_CAMERA.map(|n| n as u32),
        };
        let mut draw = SeedStream::named(self.seed ^ trigger_ns, role.name());
        let age_ms = draw.between(1.0, MAX_SKEW_MS);
        let driver_time_ns = trigger_ns - (1e6 * age_ms) as u64;
        CapturedCamera {
            frame: Frame {
                format: PixelFormat::Mjpg,
                width,
                height,
                data: jpeg.into(),
                sequence: (driver_time_ns / 40_000_000) as u32,
                driver_time_ns,
                received_ns: driver_time_ns,
            },
            product: product(role).to_owned(),
            serial: format!("DEMO-{role}"),
            interface: 0,
            port: format!("0-{}", role as u8 + 1),
            controls: BTreeMap::new(),
            age_ms,
            crop_profile: self.crop(role).map(str::to_owned),
            depth_unit_m: None,
        }
    }

    fn crop(&self, role: Role) -> Option<&'static str> {
        let finger = match role {
            Role::Left => Finger::Left,
            Role::Right => Finger::Right,
            _ => return None,
        };
        Some(self.sensors[finger as usize].crop_profile.name())
    }

    fn store(
        &self,
        object: &DemoObject,
        scene: &DemoScene,
        chosen: &SelectedGrasp,
        initial: &StageCapture,
        grasp: &StageCapture,
    ) -> Result<()> {
        let mut writer = self.writer();
        let camera = scene.intrinsics();
        let meta = GraspMeta {
            object: ObjectName::parse(&object.name)?,
            scene: Label::nearest("simulated table"),
            operator: Label::nearest(OPERATOR),
            rig: RIG.to_owned(),
            boards: Some(BoardKeys {
                sheet: writer.put_calibration(&scene.sheet.file.to_toml())?,
                tags: writer.put_calibration(&scene.tags.to_toml())?,
            }),
            calibration: self.calibration(&mut writer, camera)?,
            note: NOTE.to_owned(),
            ..GraspMeta::default()
        };
        let pending = match self.take_pending(initial) {
            Some(pending) => pending,
            None => writer.save_initial(initial, Vec::new())?,
        };
        let record = writer.save_grasp(&pending, grasp, meta)?;
        let stable = chosen.simulated.label() == Some(GraspLabel::Stable);
        set_label(&mut writer, &record.id, stable, grasp.captured_at)
    }

    /// Takes the initial frames of this grasp if an earlier run saved them; frames do not depend on
    /// the run.
    fn take_pending(&self, initial: &StageCapture) -> Option<PendingInitial> {
        let mut pending = self.pending.lock().unwrap_or_else(|e| e.into_inner());
        let captured_at = initial.captured_at.to_string();
        pending.take_if(|pending| pending.stage.captured_at == captured_at)
    }

    fn calibration(
        &self,
        writer: &mut DatasetWriter,
        external: Intrinsics,
    ) -> Result<BTreeMap<Role, ContentKey>> {
        [Role::Left, Role::Right, Role::Rgb, Role::External]
            .into_iter()
            .map(|role| {
                let calibration = Calibration {
                    camera: Camera {
                        product: product(role),
                        serial: format!("DEMO-{role}"),
                        crop_profile: self.crop(role),
                        note: NOTE,
                    },
                    intrinsics: (role == Role::External).then_some(external),
                };
                let text = toml::to_string_pretty(&calibration)
                    .map_err(|e| Error::internal("cannot write the calibration").because(e))?;
                Ok((role, writer.put_calibration(&text)?))
            })
            .collect()
    }

    /// Discards pending initial frames and writes the index.
    ///
    /// # Errors
    /// `DiskFull`, `Io`, ….
    pub(super) fn finish(&self) -> Result<()> {
        let pending = self
            .pending
            .lock()
            .unwrap_or_else(|e| e.into_inner())
            .take();
        let mut writer = self.writer();
        if let Some(pending) = pending {
            writer.discard_initial(&pending)?;
        }
        writer.flush_index()
    }
}

/// All frames of a grasp.
struct GraspFrames {
    /// Left and right sensor, each before closing and before the lift.
    tactile: [[Vec<u8>; 2]; 2],
    images: Images,
}

/// Returns the name of a simulated grasp.
pub(super) fn grasp_name(object: &DemoObject, chosen: &SelectedGrasp) -> String {
    format!("{}-{:03}", object.name, chosen.candidate.number)
}

/// Estimates the gripper pose in the object's frame from the images.
fn annotate(scene: &DemoScene, images: &Images) -> Result<PoseRecord> {
    let image = grayscale(&Decoder::new()?.stored_image(&images.table)?);
    let (sheet, tags) = (scene.sheet.file.clone(), scene.tags.clone());
    let mut annotator = Annotator::new(sheet, tags, images.intrinsics, FullSearch::Never)?;
    let name = image_name(Stage::Initial, Role::External, PixelFormat::Mjpg);
    Ok(annotator.annotate([(name.into(), &image)])?.record)
}

fn truth(object: &DemoObject, chosen: &SelectedGrasp) -> Option<SimulatedTruth> {
    let simulated = &chosen.simulated;
    let pre_lift = simulated.pre_lift.as_ref()?;
    let t_object_world = object.t_world_object.inverse();
    let initial = t_object_world * chosen.candidate.placed.t_world_gripper;
    Some(SimulatedTruth {
        clip: grasp_name(object, chosen),
        object: object.source.clone(),
        object_sha256: object.mesh.content_hash(),
        mass_kg: object.mass_kg,
        friction: object.friction,
        outcome: simulated.outcome.name().to_owned(),
        stable: simulated.label() == Some(GraspLabel::Stable),
        lifted_m: simulated.lifted_m,
        t_object_gripper_initial: initial,
        t_object_gripper: pre_lift.t_world_object.inverse() * pre_lift.t_world_gripper,
        opening_m: pre_lift.opening_m,
        force_n: simulated.force_n,
    })
}

fn product(role: Role) -> &'static str {
    match role {
        Role::Left | Role::Right => "Simulated GelSight Mini",
        Role::Rgb | Role::Depth => "Simulated D435",
        Role::External => "Simulated camera beside the table",
    }
}

fn captured_at(chosen: &SelectedGrasp) -> Result<Timestamp> {
    let number = MAX_CANDIDATES * chosen.object as i64 + chosen.candidate.number as i64;
    Ok(time(START)? + SignedDuration::from_secs(INTERVAL_S * number))
}

fn time(text: &str) -> Result<Timestamp> {
    text.parse()
        .map_err(|e: jiff::Error| Error::input(format!("invalid time stamp `{text}`")).because(e))
}

fn set_label(
    writer: &mut DatasetWriter,
    id: &gripcast_dataset::GraspId,
    stable: bool,
    captured_at: Timestamp,
) -> Result<()> {
    let outcome = if stable {
        Outcome::Stable
    } else {
        Outcome::Slip
    };
    let at = captured_at + SignedDuration::from_secs(LIFTING_S);
    writer.set_outcome(id, outcome, at, None).map(|_| ())
}

#[cfg(test)]
#[path = "recording_test.rs"]
mod tests;
