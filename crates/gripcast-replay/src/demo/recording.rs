//! Writes the grasps as a dataset, in the form in which a laboratory would have collected them.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::{Mutex, MutexGuard};

use image::imageops::grayscale;
use jiff::{SignedDuration, Timestamp};
use serde::Serialize;

use super::images::{BESIDE, Images, Stand};
use super::object::DemoObject;
use super::plan::DemoWatch;
use super::reality::{Class, reality};
use super::selection::Chosen;
use super::tactile::{Contact, FRAME, Sensors};
use gripcast_annotate::Annotator;
use gripcast_base::error::{Error, Result};
use gripcast_base::files::{ContentKey, Label, ObjectName};
use gripcast_base::random::SeedStream;
use gripcast_dataset::{
    BoardKeys, CapturedCamera, Dataset, DatasetWriter, GraspMeta, NewDataset, Outcome,
    PendingInitial, PoseRecord, SimulatedTruth, Stage, StageCapture, image_name,
};
use gripcast_imaging::{Decoder, Frame, Intrinsics, PixelFormat, Role};
use gripcast_sim::fem::GelGrid;
use gripcast_sim::grasp::Finger;
use gripcast_tactile::SimulatedGel;

/// Name of the dataset, its rig and its operator.
const NAME: &str = "gripcast-demo-simulated";
const RIG: &str = "simulated-demo";
const OPERATOR: &str = "simulation";
/// What each grasp's note says.
const NOTE: &str = "Simulated, not real: images are rendered, the outcome is that of a simulation.";
/// Clock of the first candidate of the first object; candidates are a minute apart. A date on
/// which nobody had such a sensor.
const BEGIN: &str = "2000-01-01T00:00:00Z";
const BETWEEN_S: i64 = 60;
/// Candidates of an object have their own span of time.
const MAX_CANDIDATES: i64 = 1000;
/// From the initial frame to the grasp frame and from there to the label, s.
const CLOSING_S: i64 = 5;
const LIFTING_S: i64 = 4;
/// Largest difference of the cameras' times at a trigger, ms.
const SKEW_MS: f64 = 15.0;

/// A file of `calibration/` of the demo's cameras.
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

/// Writes grasps; shared by the threads that make them.
pub(super) struct Recorder {
    writer: Mutex<DatasetWriter>,
    /// Names of the grasps that were recorded before.
    recorded: BTreeSet<String>,
    /// An initial frame whose grasp was not saved before the building stopped.
    left: Mutex<Option<PendingInitial>>,
    sensors: Sensors,
    gel: SimulatedGel,
    seed: u64,
}

impl Recorder {
    /// Opens the dataset, or begins it; the quick one has other gels.
    ///
    /// # Errors
    /// Those of [`DatasetWriter::open_or_create`].
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
                label(&mut writer, &record.id, truth.held, at)?;
            }
            recorded.insert(truth.clip.clone());
        }
        let engine = reality(is_quick).settings;
        Ok(Self {
            writer: Mutex::new(writer),
            recorded,
            left: Mutex::new(report.pending),
            sensors: Sensors::new()?,
            gel: SimulatedGel {
                grid: engine.gel()?.grid,
                d_hat_m: engine.solver.d_hat_m,
            },
            seed,
        })
    }

    /// Grasps that are not of the plan, from an earlier one of another seed or size.
    pub(super) fn foreign(&self, names: &BTreeSet<String>) -> Option<&String> {
        self.recorded.iter().find(|name| !names.contains(*name))
    }

    /// Photographs a grasp, annotates and stores it.
    ///
    /// # Errors
    /// Those of the renderers and of the writer.
    pub(super) fn record(
        &self,
        object: &DemoObject,
        stand: &Stand,
        chosen: &Chosen,
        watch: &DemoWatch<'_>,
    ) -> Result<()> {
        if self.recorded.contains(&film(object, chosen)) {
            return Ok(());
        }
        let shot = self.shoot(object, stand, chosen, watch)?;
        let pose = annotate(stand, &shot.images).ok();
        let [initial, grasp] = self.captures(object, chosen, shot, pose)?;
        self.store(object, stand, chosen, &initial, &grasp)
    }

    fn writer(&self) -> MutexGuard<'_, DatasetWriter> {
        self.writer.lock().unwrap_or_else(|e| e.into_inner())
    }

    fn shoot(
        &self,
        object: &DemoObject,
        stand: &Stand,
        chosen: &Chosen,
        watch: &DemoWatch<'_>,
    ) -> Result<Shot> {
        let grasped = chosen
            .simulated
            .grasped
            .as_ref()
            .ok_or_else(|| Error::internal("a grasp without its state was chosen"))?;
        let mut draw = SeedStream::named(self.seed, &format!("images {}", film(object, chosen)));
        let placed = &chosen.candidate.placed;
        let contact = Contact {
            mesh: &object.mesh,
            gel: &self.gel,
            t_world_object: object.t_world_object,
            placed,
            grasped,
        };
        let mut frames = |finger| {
            self.sensors
                .frames(&contact, finger, [draw.bits(), draw.bits()])
        };
        let tactile = [frames(Finger::Left)?, frames(Finger::Right)?];
        let grid: &GelGrid = &self.gel.grid;
        let images = stand.photograph(placed, grasped, grid, draw.bits(), watch)?;
        Ok(Shot { tactile, images })
    }

    fn captures(
        &self,
        object: &DemoObject,
        chosen: &Chosen,
        shot: Shot,
        pose: Option<PoseRecord>,
    ) -> Result<[StageCapture; 2]> {
        let begin = captured_at(chosen)?;
        let Shot {
            tactile: [[left_before, left_after], [right_before, right_after]],
            images,
        } = shot;
        let [hand_before, hand_after] = images.hand;
        let stage = |at: Timestamp, trigger_time_ns: u64, cameras: Vec<(Role, Vec<u8>)>| {
            let camera = |(role, jpeg)| (role, self.camera(role, jpeg, trigger_time_ns));
            StageCapture {
                captured_at: at,
                trigger_time_ns,
                trigger: "script".to_owned(),
                cameras: cameras.into_iter().map(camera).collect(),
                pre_grasp_frames: Vec::new(),
                pose: None,
                truth: None,
            }
        };
        let since_boot = 1_000_000_000 * (begin.as_second() - first()?.as_second() + 60) as u64;
        let initial = stage(
            begin,
            since_boot,
            vec![
                (Role::Left, left_before),
                (Role::Right, right_before),
                (Role::Rgb, hand_before),
                (Role::External, images.beside),
            ],
        );
        let mut grasp = stage(
            begin + SignedDuration::from_secs(CLOSING_S),
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

    /// A frame with what a driver would tell of it.
    fn camera(&self, role: Role, jpeg: Vec<u8>, trigger_ns: u64) -> CapturedCamera {
        let [width, height] = match role {
            Role::Left | Role::Right => FRAME,
            Role::External => BESIDE.map(|n| n as u32),
            Role::Rgb | Role::Depth => super::images::HAND.map(|n| n as u32),
        };
        let mut draw = SeedStream::named(self.seed ^ trigger_ns, role.name());
        let age_ms = draw.between(1.0, SKEW_MS);
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
        Some(self.sensors.profile(finger).crop_profile.name())
    }

    fn store(
        &self,
        object: &DemoObject,
        stand: &Stand,
        chosen: &Chosen,
        initial: &StageCapture,
        grasp: &StageCapture,
    ) -> Result<()> {
        let mut writer = self.writer();
        let camera = stand.intrinsics();
        let meta = GraspMeta {
            object: ObjectName::parse(&object.name)?,
            scene: Label::nearest("simulated table"),
            operator: Label::nearest(OPERATOR),
            rig: RIG.to_owned(),
            boards: Some(BoardKeys {
                sheet: writer.put_calibration(&stand.sheet.file.to_toml())?,
                tags: writer.put_calibration(&stand.tags.to_toml())?,
            }),
            calibration: self.calibration(&mut writer, camera)?,
            note: NOTE.to_owned(),
            ..GraspMeta::default()
        };
        let pending = match self.taken_up(initial) {
            Some(pending) => pending,
            None => writer.save_initial(initial, Vec::new())?,
        };
        let record = writer.save_grasp(&pending, grasp, meta)?;
        let held = chosen.simulated.class() == Some(Class::Stable);
        label(&mut writer, &record.id, held, grasp.captured_at)
    }

    /// The initial frame of this very grasp that an earlier run saved. Frames do not depend on the
    /// run.
    fn taken_up(&self, initial: &StageCapture) -> Option<PendingInitial> {
        let mut left = self.left.lock().unwrap_or_else(|e| e.into_inner());
        let is_this = |pending: &mut PendingInitial| {
            pending.stage.captured_at == initial.captured_at.to_string()
        };
        left.take_if(is_this)
    }

    fn calibration(
        &self,
        writer: &mut DatasetWriter,
        beside: Intrinsics,
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
                    intrinsics: (role == Role::External).then_some(beside),
                };
                let text = toml::to_string_pretty(&calibration)
                    .map_err(|e| Error::internal("cannot write the calibration").because(e))?;
                Ok((role, writer.put_calibration(&text)?))
            })
            .collect()
    }

    /// Brings the index up to date.
    ///
    /// # Errors
    /// `DiskFull`, `Io`, ….
    pub(super) fn finish(&self) -> Result<()> {
        let left = self.left.lock().unwrap_or_else(|e| e.into_inner()).take();
        let mut writer = self.writer();
        if let Some(pending) = left {
            writer.discard_initial(&pending)?;
        }
        writer.flush_index()
    }
}

/// All frames of a grasp.
struct Shot {
    /// Left and right sensor, before closing and before the lift.
    tactile: [[Vec<u8>; 2]; 2],
    images: Images,
}

/// Name of a simulated grasp.
pub(super) fn film(object: &DemoObject, chosen: &Chosen) -> String {
    format!("{}-{:03}", object.name, chosen.candidate.number)
}

/// The gripper in the object's frame, as the images tell it.
fn annotate(stand: &Stand, images: &Images) -> Result<PoseRecord> {
    let image = grayscale(&Decoder::new()?.stored_image(&images.beside)?);
    let (sheet, tags) = (stand.sheet.file.clone(), stand.tags.clone());
    let mut annotator = Annotator::new(sheet, tags, images.intrinsics)?;
    let name = image_name(Stage::Initial, Role::External, PixelFormat::Mjpg);
    Ok(annotator.annotate([(name.into(), &image)])?.record)
}

fn truth(object: &DemoObject, chosen: &Chosen) -> Option<SimulatedTruth> {
    let simulated = &chosen.simulated;
    let grasped = simulated.grasped.as_ref()?;
    let t_object_world = object.t_world_object.inverse();
    let initial = t_object_world * chosen.candidate.placed.t_world_gripper;
    Some(SimulatedTruth {
        clip: film(object, chosen),
        object: object.source.clone(),
        object_sha256: object.mesh.content_hash(),
        mass_kg: object.mass_kg,
        friction: object.friction,
        outcome: simulated.outcome.name().to_owned(),
        held: simulated.class() == Some(Class::Stable),
        lifted_m: simulated.lifted_m,
        t_object_gripper_initial: initial,
        t_object_gripper: grasped.t_world_object.inverse() * grasped.t_world_gripper,
        opening_m: grasped.opening_m,
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

fn first() -> Result<Timestamp> {
    time(BEGIN)
}

fn captured_at(chosen: &Chosen) -> Result<Timestamp> {
    let number = MAX_CANDIDATES * chosen.object as i64 + chosen.candidate.number as i64;
    Ok(first()? + SignedDuration::from_secs(BETWEEN_S * number))
}

fn time(text: &str) -> Result<Timestamp> {
    text.parse()
        .map_err(|e: jiff::Error| Error::input(format!("`{text}` is no time")).because(e))
}

fn label(
    writer: &mut DatasetWriter,
    id: &gripcast_dataset::GraspId,
    held: bool,
    captured_at: Timestamp,
) -> Result<()> {
    let outcome = if held { Outcome::Stable } else { Outcome::Slip };
    let at = captured_at + SignedDuration::from_secs(LIFTING_S);
    writer.set_outcome(id, outcome, at).map(|_| ())
}

#[cfg(test)]
#[path = "recording_test.rs"]
mod tests;
