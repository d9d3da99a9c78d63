//! Which grasps of a dataset can be replayed, and why the others cannot.

use std::collections::BTreeMap;
use std::path::Path;

use glam::{DMat3, DQuat, DVec3};
use sha2::{Digest as _, Sha256};

use super::object_file::ReplayObject;
use super::report::LeftOut;
use gripcast_base::error::{Error, Result, nearest_name};
use gripcast_base::files::{ContentKey, ObjectName};
use gripcast_base::linear::Cholesky;
use gripcast_base::random::SeedStream;
use gripcast_dataset::{Dataset, GraspRecord, Outcome};
use gripcast_geometry::{MeshQuery, Pose};
use gripcast_pose::{BoardFile, PrintedSheet};
use gripcast_sim::GraspSetup;
use gripcast_sim::grasp::GraspPose;

/// Widest opening of a start that the record does not tell, m.
const MAX_OPENING_M: f64 = 0.09;
/// The gripper's origin lies at most this far from the object's surface, m: further away nothing
/// could be grasped, and millimetres were taken for metres.
const MAX_DISTANCE_M: f64 = 0.1;
/// Digits of the hash of all records.
const HASH_DIGITS: usize = 12;

/// A grasp that can be replayed.
#[derive(Clone, Debug)]
pub struct RecordedGrasp {
    /// Its record.
    pub record: GraspRecord,
    /// Whether it held in reality.
    pub stable: bool,
    /// The gripper in the object's frame.
    pub t_object_gripper: Pose,
    /// Covariance of [δt, δθ], m and rad, along the object's axes: t = t̂ + δt, R = exp(δθ) R̂.
    pub covariance: Option<[[f64; 6]; 6]>,
    /// Where everything is before the fingers close.
    pub setup: GraspSetup,
}

/// What of a dataset can be replayed.
#[derive(Clone, Debug)]
pub struct Recording {
    /// By object and id.
    pub grasps: Vec<RecordedGrasp>,
    /// The others.
    pub left_out: Vec<LeftOut>,
    /// Grasps of the dataset, of the wanted objects.
    pub all: usize,
    /// Hash of the records in [`Self::grasps`].
    pub sha256: String,
}

impl Recording {
    /// Reads the grasps of a dataset; `wanted` objects only, where given.
    ///
    /// # Errors
    /// Those of opening the dataset. What is wrong with a single grasp is in
    /// [`Self::left_out`].
    pub fn read(
        dataset: &Dataset,
        objects: &BTreeMap<ObjectName, Result<ReplayObject>>,
        wanted: Option<&[String]>,
    ) -> Result<Self> {
        let mut grasps = Vec::new();
        let mut left_out = Vec::new();
        let mut sheets = BTreeMap::new();
        let mut unwanted = 0;
        let ids = dataset.ids()?;
        for id in &ids {
            let record = match dataset.grasp(id) {
                Ok(record) => record,
                Err(error) => {
                    left_out.push(LeftOut {
                        grasp: id.to_string(),
                        object: String::new(),
                        reason: error.to_string(),
                    });
                    continue;
                }
            };
            if wanted.is_some_and(|wanted| !wanted.iter().any(|name| record.object == **name)) {
                unwanted += 1;
                continue;
            }
            let object = record.object.clone();
            match recorded(dataset, record, objects, &mut sheets) {
                Ok(grasp) => grasps.push(grasp),
                Err(error) => left_out.push(LeftOut {
                    grasp: id.to_string(),
                    object: object.into(),
                    reason: error.to_string(),
                }),
            }
        }
        grasps.sort_by(|a, b| {
            let key = |g: &RecordedGrasp| (g.record.object.clone(), g.record.id.clone());
            key(a).cmp(&key(b))
        });
        Ok(Self {
            sha256: hash(&grasps)?,
            grasps,
            left_out,
            all: ids.len() - unwanted,
        })
    }
}

fn recorded(
    dataset: &Dataset,
    record: GraspRecord,
    objects: &BTreeMap<ObjectName, Result<ReplayObject>>,
    sheets: &mut BTreeMap<ContentKey, Option<PrintedSheet>>,
) -> Result<RecordedGrasp> {
    let wrong = |what: String| Error::input(what);
    let stable = match record.outcome {
        Outcome::Stable => true,
        Outcome::Slip => false,
        Outcome::Unlabelled => {
            return Err(wrong("it has no label".to_owned())
                .remedy("say stable or slip after the lift, in `gripcast collect`"));
        }
    };
    let Some(pose) = &record.pose else {
        return Err(
            wrong("it has no pose".to_owned()).remedy("run `gripcast annotate` on the dataset")
        );
    };
    let t_object_gripper = pose.t_object_gripper()?;
    let object = match objects.get(record.object.as_str()) {
        Some(Ok(object)) => object,
        Some(Err(error)) => {
            return Err(wrong(format!("its object cannot be simulated: {error}")));
        }
        None => return Err(unknown(&record.object, objects)),
    };
    check_distance(object, &t_object_gripper)?;
    let sheet = match &record.boards {
        Some(boards) => match sheets.get(&boards.sheet) {
            Some(sheet) => sheet.clone(),
            None => {
                let sheet = stored_sheet(dataset, &boards.sheet)?;
                sheets.insert(boards.sheet.clone(), sheet.clone());
                sheet
            }
        },
        None => None,
    };
    let t_world_object = object.t_world_object(sheet.as_ref())?;
    let seen = pose.quality.as_ref().and_then(|quality| quality.opening_m);
    let placed = GraspPose {
        t_object_gripper,
        t_world_object: Some(t_world_object),
        opening_m: seen,
    }
    .place(&object.mesh, &t_world_object);
    let opening_m = if seen.is_some() {
        placed.opening_m
    } else {
        placed.opening_m.min(MAX_OPENING_M)
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

/// The printed sheet of a board that is stored with the dataset.
fn stored_sheet(dataset: &Dataset, key: &ContentKey) -> Result<Option<PrintedSheet>> {
    let text = dataset.calibration(key)?;
    Ok(BoardFile::parse(&text, Path::new(""))?.sheet)
}

fn unknown(name: &str, objects: &BTreeMap<ObjectName, Result<ReplayObject>>) -> Error {
    let nearest = nearest_name(name, objects.keys().map(ObjectName::as_str));
    let hint = nearest.map_or(String::new(), |n| format!("; the nearest name is {n}"));
    Error::input(format!("there is no object file for {name:?}{hint}"))
        .remedy(format!("write {name}.toml into the folder of the objects"))
}

/// Refuses poses from which nothing could be grasped; they are mostly a matter of units.
fn check_distance(object: &ReplayObject, t_object_gripper: &Pose) -> Result<()> {
    let origin = t_object_gripper.translation_m;
    let closest = MeshQuery::new(&object.mesh).closest_point(origin);
    let apart = closest.map_or(f64::INFINITY, |closest| closest.distance_m);
    if apart <= MAX_DISTANCE_M {
        return Ok(());
    }
    let length = object.mesh.bounds().extent().max_element();
    Err(Error::input(format!(
        "the gripper is {apart:.3} m away from {}, which is {length:.3} m long: nothing could \
             be grasped",
        object.name
    ))
    .remedy("check the units: t_m is in metres, and so is the mesh after `unit` and `scale`"))
}

fn covariance(numbers: &[f64]) -> Result<[[f64; 6]; 6]> {
    let mut out = [[0.0; 6]; 6];
    if numbers.len() != 36 || numbers.iter().any(|n| !n.is_finite()) {
        return Err(Error::input(format!(
            "the covariance of its pose must be 36 finite numbers, found {}",
            numbers.len()
        )));
    }
    for (row, values) in out.iter_mut().zip(numbers.chunks_exact(6)) {
        row.copy_from_slice(values);
    }
    Ok(out)
}

impl RecordedGrasp {
    /// Standard deviations of position (m) and rotation (rad) along the gripper's axes.
    pub fn pose_sd(&self) -> Option<[[f64; 3]; 2]> {
        let covariance = self.covariance.as_ref()?;
        let turn = self.t_object_gripper.rotation_matrix();
        Some([0, 3].map(|first| {
            let block = |column: usize| {
                DVec3::from_array([0, 1, 2].map(|row| covariance[first + row][first + column]))
            };
            let turned = turn.transpose() * DMat3::from_cols(block(0), block(1), block(2)) * turn;
            [turned.x_axis.x, turned.y_axis.y, turned.z_axis.z].map(|v| v.max(0.0).sqrt())
        }))
    }

    /// The setup with the gripper at a pose drawn from the covariance; none without one.
    ///
    /// Draw `number` of a `seed` is always the same.
    pub fn drawn(&self, seed: u64, number: usize) -> Option<GraspSetup> {
        // Directions without variance stay at zero.
        let covariance = self.covariance.as_ref()?;
        let factor = Cholesky::with_pivots(covariance, |rest, _| Some(rest.max(0.0)))?;
        let name = format!("pose {} {number}", self.record.id);
        let mut stream = SeedStream::named(seed, &name);
        let normal: [f64; 6] = std::array::from_fn(|_| deviate(&mut stream));
        let error: [f64; 6] =
            std::array::from_fn(|row| (0..=row).map(|k| factor.lower()[row][k] * normal[k]).sum());
        let turn = DVec3::new(error[3], error[4], error[5]);
        let off = Pose::new(
            DQuat::from_scaled_axis(turn) * self.t_object_gripper.rotation,
            self.t_object_gripper.translation_m + DVec3::new(error[0], error[1], error[2]),
        );
        Some(GraspSetup {
            t_world_gripper: self.setup.t_world_object * off,
            ..self.setup.clone()
        })
    }
}

/// Standard normal deviate (Box and Muller 1958).
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
    let digest = hasher.finalize();
    let digits: String = digest.iter().map(|b| format!("{b:02x}")).collect();
    Ok(digits[..HASH_DIGITS].to_owned())
}
