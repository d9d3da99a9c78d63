//! What happens to a grasp: the simulation that stands for reality, and the coarse one that looks
//! for candidates. Each result is a file, so that a build that was stopped goes on.

use std::sync::Arc;

use serde::{Deserialize, Serialize};
use serde_json::json;
use sha2::{Digest as _, Sha256};

use super::object::DemoObject;
use super::sampler::Candidate;
use gripcast_base::error::{Error, Result};
use gripcast_base::files::{BeneathPath, FileKind, FileName};
use gripcast_base::workers::thread_cpu_s;
use gripcast_sim::fem::GelResolution;
use gripcast_sim::grasp::GraspResult;
use gripcast_sim::grasp::{GraspOutcome, GraspSettings, Preset, Snapshot, StageName};
use gripcast_sim::{Engine as _, FemEngine, GraspSetup};

/// A simulated candidate, as it is kept in a file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Simulated {
    /// Hash of everything that it depends on.
    pub(super) key: String,
    /// How it ended.
    pub(super) outcome: GraspOutcome,
    /// Rise of the object's centre of mass, m.
    pub(super) lifted_m: f64,
    /// Normal force on the left and the right gel before the lift, N.
    pub(super) force_n: [f64; 2],
    /// Before the lift; not of screening.
    pub(super) grasped: Option<Snapshot>,
    /// CPU time it took, s.
    pub(super) cpu_s: f64,
}

/// What a grasp counts as.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Class {
    /// The object follows the lift.
    Stable,
    /// It was touched, and is lost.
    Lost,
}

impl Class {
    pub(super) const ALL: [Self; 2] = [Self::Stable, Self::Lost];
}

impl Simulated {
    /// None for a candidate that is no grasp: it missed, could not start, or has no outcome.
    pub(super) fn class(&self) -> Option<Class> {
        match self.outcome {
            GraspOutcome::Success => Some(Class::Stable),
            GraspOutcome::Slip | GraspOutcome::Eject | GraspOutcome::GelsMet => Some(Class::Lost),
            GraspOutcome::Miss | GraspOutcome::PenetratingStart | GraspOutcome::NotConverged => {
                None
            }
        }
    }
}

/// A person holds a grasp this long before the lift, s, and lifts this fast, m/s: sooner and
/// faster than the protocol of the paper.
const HOLD_S: f64 = 0.5;
const LIFT_SPEED_M_S: f64 = 0.04;

/// The simulation that stands for reality: the fine mesh, or the default one for the quick dataset,
/// which is replayed on the coarse one.
pub(super) fn reality(is_quick: bool) -> FemEngine {
    let mut settings = GraspSettings::new(Preset::Feats);
    settings.resolution = if is_quick {
        GelResolution::Default
    } else {
        GelResolution::Fine
    };
    settings.protocol.adjust_s = HOLD_S;
    settings.protocol.lift_speed_m_s = LIFT_SPEED_M_S;
    FemEngine { settings }
}

/// The same with the coarse mesh, which is fast and nearly as good.
pub(super) fn screening() -> FemEngine {
    FemEngine {
        settings: GraspSettings {
            resolution: GelResolution::Coarse,
            ..reality(true).settings
        },
    }
}

/// Simulations of one object's candidates, in a folder.
pub(super) struct Reality<'a> {
    object: &'a DemoObject,
    engine: FemEngine,
    folder: &'a BeneathPath,
    mesh: Arc<gripcast_geometry::TriangleMesh>,
    mesh_sha256: String,
}

impl<'a> Reality<'a> {
    pub(super) fn new(object: &'a DemoObject, engine: FemEngine, folder: &'a BeneathPath) -> Self {
        Self {
            object,
            engine,
            folder,
            mesh: Arc::new(object.mesh.clone()),
            mesh_sha256: object.mesh.content_hash(),
        }
    }

    /// The result of a candidate: from its file, or simulated and kept there.
    ///
    /// # Errors
    /// `Io`, `DiskFull`; `Internal` for a candidate that the engine refuses.
    pub(super) fn simulate(&self, candidate: &Candidate) -> Result<Simulated> {
        let key = self.key(candidate)?;
        let place = self.place(candidate)?;
        if let Some(known) = read(&place, &key) {
            return Ok(known);
        }
        let began = thread_cpu_s();
        let result = self.engine.simulate(
            &self.setup(candidate),
            self.object.friction,
            candidate.stop_force_n,
        )?;
        let done = self.kept(&result, key, thread_cpu_s() - began);
        let text = serde_json::to_vec(&done)
            .map_err(|e| Error::internal("cannot write a result").because(e))?;
        place
            .replace(&text)
            .map_err(|e| Error::io("cannot write a result", e).at(place.display()))?;
        Ok(done)
    }

    fn setup(&self, candidate: &Candidate) -> GraspSetup {
        GraspSetup {
            mesh: self.mesh.clone(),
            mass_kg: self.object.mass_kg,
            t_world_object: self.object.t_world_object,
            t_world_gripper: candidate.placed.t_world_gripper,
            opening_m: candidate.placed.opening_m,
        }
    }

    fn kept(&self, result: &GraspResult, key: String, cpu_s: f64) -> Simulated {
        let trace = &result.trace;
        let last = trace.stage(StageName::Adjustment).next_back();
        let snapshot = trace
            .snapshots
            .iter()
            .find(|s| s.stage == StageName::Adjustment);
        let is_reality = self.engine.settings.resolution != GelResolution::Coarse;
        Simulated {
            key,
            outcome: result.outcome,
            lifted_m: result.lifted_m,
            force_n: last.map_or([0.0; 2], |step| step.force.map(|f| f.normal_n)),
            grasped: snapshot.filter(|_| is_reality).cloned(),
            cpu_s,
        }
    }

    fn place(&self, candidate: &Candidate) -> Result<BeneathPath> {
        let mesh = self.engine.settings.resolution.name();
        let name = format!("{}-{:03}.{mesh}.json", self.object.name, candidate.number);
        Ok(self.folder.join(&FileName::parse(&name)?))
    }

    fn key(&self, candidate: &Candidate) -> Result<String> {
        let all = json!({
            "engine": self.engine.parameters()?,
            "mesh": self.mesh_sha256,
            "mass_kg": self.object.mass_kg,
            "friction": self.object.friction,
            "t_world_object": self.object.t_world_object,
            "placed": candidate.placed,
            "stop_force_n": candidate.stop_force_n,
            "software": env!("CARGO_PKG_VERSION"),
        });
        let digest = Sha256::digest(all.to_string());
        Ok(digest.iter().map(|b| format!("{b:02x}")).collect())
    }
}

/// A result that was kept and still is the one asked for; anything else is simulated again.
fn read(place: &BeneathPath, key: &str) -> Option<Simulated> {
    let text = place.read(FileKind::Mesh).ok()?;
    let found: Simulated = serde_json::from_slice(&text).ok()?;
    (found.key == key).then_some(found)
}
