//! Selects the grasps of a dataset that can be replayed.

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::path::Path;

use glam::{DMat3, DQuat, DVec3};
use sha2::{Digest as _, Sha256};

use super::object_file::ReplayObject;
use super::report::ExcludedGrasp;
use gripcast_base::error::{Error, Result, nearest_name};
use gripcast_base::files::{ContentKey, ObjectName, hex};
use gripcast_base::linear::Cholesky;
use gripcast_base::random::SeedStream;
use gripcast_base::statistics::median;
use gripcast_dataset::{Dataset, GraspRecord, Outcome};
use gripcast_geometry::{MeshQuery, Pose};
use gripcast_pose::{BoardFile, PrintedSheet};
use gripcast_sim::GraspSetup;
use gripcast_sim::grasp::{GRIPPER_OPENING_M, GraspPose};

/// Maximum distance of the gripper's origin from the object's surface, m; more usually means
/// millimetres instead of metres.
const MAX_DISTANCE_M: f64 = 0.1;
/// Bytes of the hash of all records.
const HASH_BYTES: usize = 6;

/// A grasp that can be replayed.
#[derive(Clone, Debug)]
pub struct RecordedGrasp {
    /// Record in the dataset.
    pub record: GraspRecord,
    /// Label in reality: stable or slip.
    pub stable: bool,
    /// Pose of the gripper in the object's frame.
    pub t_object_gripper: Pose,
    /// Covariance of [δt, δθ], m and rad, along the object's axes: t = t̂ + δt, R = exp(δθ) R̂.
    pub covariance: Option<[[f64; 6]; 6]>,
    /// Setup before the fingers close.
    pub setup: GraspSetup,
}

/// Minimum normal force that a grasp can be replayed with, N.
const MIN_FORCE_N: f64 = 0.5;

/// Normal force that was measured on a grasp.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeasuredForce {
    /// Mean of the gels, N.
    pub normal_n: f64,
    /// Whether known weights calibrated all of their sensors.
    pub is_calibrated: bool,
}

impl MeasuredForce {
    /// The force in a record: the mean of both gels, else that of the only one that has it.
    #[must_use]
    pub fn of(record: &GraspRecord) -> Option<Self> {
        let forces = &record.grasp.force;
        let sum: f64 = forces.values().map(|force| force.normal_n).sum();
        (!forces.is_empty()).then(|| Self {
            normal_n: sum / forces.len() as f64,
            is_calibrated: forces.values().all(|force| force.is_calibrated),
        })
    }
}

/// The replayable grasps of a dataset.
#[derive(Clone, Debug)]
pub struct Recording {
    /// Grasps, sorted by object and id.
    pub grasps: Vec<RecordedGrasp>,
    /// Grasps that cannot be replayed.
    pub left_out: Vec<ExcludedGrasp>,
    /// Number of grasps of the selected objects in the dataset.
    pub total: usize,
    /// Hash of the records in [`Self::grasps`].
    pub sha256: String,
}

impl Recording {
    /// Reads the grasps of a dataset, of all or only some objects.
    ///
    /// # Errors
    /// Errors of opening the dataset. Invalid grasps are listed in [`Self::left_out`].
    pub fn read(
        dataset: &Dataset,
        objects: &BTreeMap<ObjectName, Result<ReplayObject>>,
        only: Option<&[String]>,
    ) -> Result<Self> {
        let mut grasps = Vec::new();
        let mut left_out = Vec::new();
        let mut sheets = BTreeMap::new();
        let mut other_objects = 0;
        let ids = dataset.ids()?;
        for id in &ids {
            let excluded = |object: String, error: Error| ExcludedGrasp {
                grasp: id.to_string(),
                object,
                reason: error.to_string(),
            };
            let record = match dataset.grasp(id) {
                Ok(record) => record,
                Err(error) => {
                    left_out.push(excluded(String::new(), error));
                    continue;
                }
            };
            if only.is_some_and(|only| !only.iter().any(|name| record.object == **name)) {
                other_objects += 1;
                continue;
            }
            let object = record.object.clone();
            match recorded(dataset, record, objects, &mut sheets) {
                Ok(grasp) => grasps.push(grasp),
                Err(error) => left_out.push(excluded(object.into(), error)),
            }
        }
        grasps.sort_by_cached_key(|g| (g.record.object.clone(), g.record.id.clone()));
        Ok(Self {
            sha256: hash(&grasps)?,
            grasps,
            left_out,
            total: ids.len() - other_objects,
        })
    }
}

impl Recording {
    /// Keeps the grasps whose force was measured and returns their median force, N; the others are
    /// left out with the reason.
    ///
    /// # Errors
    /// `Input` if no grasp has a measured force.
    pub fn with_measured_forces(mut self) -> Result<(Self, f64)> {
        let mut forces = Vec::new();
        let mut kept = Vec::new();
        for grasp in std::mem::take(&mut self.grasps) {
            let found = MeasuredForce::of(&grasp.record);
            let reason = match found {
                Some(force) if force.normal_n >= MIN_FORCE_N => {
                    forces.push(force.normal_n);
                    kept.push(grasp);
                    continue;
                }
                Some(force) => format!(
                    "its measured force of {:.2} N is below {MIN_FORCE_N} N",
                    force.normal_n
                ),
                None => "it has no measured force".to_owned(),
            };
            self.left_out.push(ExcludedGrasp {
                grasp: grasp.record.id.to_string(),
                object: grasp.record.object.to_string(),
                reason,
            });
        }
        let Some(median_n) = median(forces.iter().copied()) else {
            let first = self.left_out.first();
            let first = first.map_or(String::new(), |l| format!("; {}: {}", l.grasp, l.reason));
            return Err(Error::input(format!("no grasp has a measured force{first}")).remedy(
                "forces are stored by `collect` and `daemon` with a GelSight Mini; replay older \
                 grasps without `--force measured`",
            ));
        };
        self.sha256 = hash(&kept)?;
        self.grasps = kept;
        Ok((self, median_n))
    }

    /// Number of grasps whose measured force is not calibrated with known weights.
    #[must_use]
    pub fn uncalibrated(&self) -> usize {
        let forces = self
            .grasps
            .iter()
            .map(|grasp| MeasuredForce::of(&grasp.record));
        forces
            .flatten()
            .filter(|force| !force.is_calibrated)
            .count()
    }
}

fn recorded(
    dataset: &Dataset,
    record: GraspRecord,
    objects: &BTreeMap<ObjectName, Result<ReplayObject>>,
    sheets: &mut BTreeMap<ContentKey, Option<PrintedSheet>>,
) -> Result<RecordedGrasp> {
    let stable = match record.outcome {
        Outcome::Stable => true,
        Outcome::Slip => false,
        Outcome::Unlabelled => {
            return Err(Error::input("the grasp has no label")
                .remedy("label it as stable or slip, for instance in `gripcast collect`"));
        }
    };
    let Some(pose) = &record.pose else {
        return Err(
            Error::input("the grasp has no pose").remedy("run `gripcast annotate` on the dataset")
        );
    };
    let t_object_gripper = pose.t_object_gripper()?;
    let object = match objects.get(record.object.as_str()) {
        Some(Ok(object)) => object,
        Some(Err(error)) => {
            let what = format!("the object cannot be simulated: {error}");
            return Err(Error::input(what));
        }
        None => return Err(unknown_object(&record.object, objects)),
    };
    check_distance(object, &t_object_gripper)?;
    let sheet = match &record.boards {
        Some(boards) => printed_sheet(dataset, &boards.sheet, sheets)?,
        None => None,
    };
    let t_world_object = object.t_world_object(sheet)?;
    let measured_m = pose.quality.as_ref().and_then(|quality| quality.opening_m);
    let placed = GraspPose {
        t_object_gripper,
        t_world_object: Some(t_world_object),
        opening_m: measured_m,
    }
    .place(&object.mesh, &t_world_object);
    let opening_m = match measured_m {
        Some(_) => placed.opening_m,
        None => placed.opening_m.min(GRIPPER_OPENING_M),
    };
    let covariance = pose.covariance.as_deref().map(covariance).transpose()?;
    Ok(RecordedGrasp {
        stable,
        t_object_gripper,
        covariance,
        setup: GraspSetup {
            mesh: object.mesh.clone(),
            mass_kg: object.file.mass_kg,
            t_world_object,
            t_world_gripper: placed.t_world_gripper,
            opening_m,
        },
        record,
    })
}

/// Reads the printed sheet of a board that is stored with the dataset, once.
fn printed_sheet<'a>(
    dataset: &Dataset,
    key: &ContentKey,
    sheets: &'a mut BTreeMap<ContentKey, Option<PrintedSheet>>,
) -> Result<Option<&'a PrintedSheet>> {
    let sheet = match sheets.entry(key.clone()) {
        Entry::Occupied(entry) => entry.into_mut(),
        Entry::Vacant(entry) => {
            let text = dataset.calibration(key)?;
            entry.insert(BoardFile::parse(&text, Path::new(""))?.sheet)
        }
    };
    Ok(sheet.as_ref())
}

fn unknown_object(name: &str, objects: &BTreeMap<ObjectName, Result<ReplayObject>>) -> Error {
    let nearest = nearest_name(name, objects.keys().map(ObjectName::as_str));
    let hint = nearest.map_or(String::new(), |n| format!("; the nearest name is {n}"));
    Error::input(format!("no object file for {name:?}{hint}"))
        .remedy(format!("write {name}.toml into the folder of object files"))
}

/// Refuses poses too far from the object, which usually have a wrong unit.
fn check_distance(object: &ReplayObject, t_object_gripper: &Pose) -> Result<()> {
    let origin = t_object_gripper.translation_m;
    let closest = MeshQuery::new(&object.mesh).closest_point(origin);
    let distance_m = closest.map_or(f64::INFINITY, |closest| closest.distance_m);
    if distance_m <= MAX_DISTANCE_M {
        return Ok(());
    }
    let length = object.mesh.bounds().extent().max_element();
    Err(Error::input(format!(
        "the gripper is {distance_m:.3} m away from {}, which is {length:.3} m long",
        object.name
    ))
    .remedy(
        "check the units: t_m is in metres, and so is the mesh after applying `unit` and `scale`",
    ))
}

fn covariance(numbers: &[f64]) -> Result<[[f64; 6]; 6]> {
    let mut out = [[0.0; 6]; 6];
    if numbers.len() != 36 || numbers.iter().any(|n| !n.is_finite()) {
        return Err(Error::input(format!(
            "the pose covariance must be 36 finite numbers, found {}",
            numbers.len()
        )));
    }
    for (row, values) in out.iter_mut().zip(numbers.chunks_exact(6)) {
        row.copy_from_slice(values);
    }
    Ok(out)
}

impl RecordedGrasp {
    /// Returns the standard deviations of position (m) and rotation (rad) along the gripper's axes.
    pub fn pose_sd(&self) -> Option<[[f64; 3]; 2]> {
        let covariance = self.covariance.as_ref()?;
        let rotation = self.t_object_gripper.rotation_matrix();
        Some([0, 3].map(|first| {
            let block = |column: usize| {
                DVec3::from_array([0, 1, 2].map(|row| covariance[first + row][first + column]))
            };
            let block = DMat3::from_cols(block(0), block(1), block(2));
            let rotated = rotation.transpose() * block * rotation;
            [rotated.x_axis.x, rotated.y_axis.y, rotated.z_axis.z].map(|v| v.max(0.0).sqrt())
        }))
    }

    /// Returns the setup with a gripper pose drawn from the covariance; none without a covariance.
    /// Equal `seed` and `number` give the same pose.
    pub fn with_drawn_pose(&self, seed: u64, number: usize) -> Option<GraspSetup> {
        // Directions without variance stay zero.
        let covariance = self.covariance.as_ref()?;
        let factor = Cholesky::with_pivots(covariance, |rest, _| Some(rest.max(0.0)))?;
        let name = format!("pose {} {number}", self.record.id);
        let mut stream = SeedStream::named(seed, &name);
        let normal: [f64; 6] = std::array::from_fn(|_| deviate(&mut stream));
        let error: [f64; 6] =
            std::array::from_fn(|row| (0..=row).map(|k| factor.lower()[row][k] * normal[k]).sum());
        let rotation = DVec3::new(error[3], error[4], error[5]);
        let t_object_gripper = Pose::new(
            DQuat::from_scaled_axis(rotation) * self.t_object_gripper.rotation,
            self.t_object_gripper.translation_m + DVec3::new(error[0], error[1], error[2]),
        );
        Some(GraspSetup {
            t_world_gripper: self.setup.t_world_object * t_object_gripper,
            ..self.setup.clone()
        })
    }
}

/// Draws a standard normal deviate (Box and Muller 1958).
fn deviate(stream: &mut SeedStream) -> f64 {
    let radius = (-2.0 * (1.0 - stream.uniform()).ln()).sqrt();
    radius * (std::f64::consts::TAU * stream.uniform()).cos()
}

fn hash(grasps: &[RecordedGrasp]) -> Result<String> {
    let mut hasher = Sha256::new();
    for grasp in grasps {
        let text = serde_json::to_vec(&grasp.record)
            .map_err(|e| Error::internal("cannot write JSON").because(e))?;
        hasher.update(text);
    }
    Ok(hex(&hasher.finalize()[..HASH_BYTES]))
}
