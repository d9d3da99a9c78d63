//! The simulation that stands in for reality, and the coarse one that screens candidates. Each
//! result is a file, so an interrupted build can be resumed.

use std::sync::Arc;

use serde::{Deserialize, Serialize};
use serde_json::json;

use super::object::DemoObject;
use super::selection::Candidate;
use gripcast_base::error::{Error, Result};
use gripcast_base::files::{BeneathPath, FileKind, FileName, sha256_hex};
use gripcast_base::workers::thread_cpu_s;
use gripcast_sim::fem::GelResolution;
use gripcast_sim::grasp::GraspResult;
use gripcast_sim::grasp::{GraspOutcome, GraspSettings, Preset, Snapshot, StageName};
use gripcast_sim::{Engine as _, FemEngine, GraspSetup};

/// Stored result of a candidate.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SimulatedCandidate {
    /// Hash of all inputs.
    pub(super) key: String,
    /// Simulation outcome.
    pub(super) outcome: GraspOutcome,
    /// Rise of the object's centre of mass, m.
    pub(super) lifted_m: f64,
    /// Normal force on the left and the right gel before the lift, N.
    pub(super) force_n: [f64; 2],
    /// State before the lift; not stored by screening.
    pub(super) pre_lift: Option<Snapshot>,
    /// CPU time, s.
    pub(super) cpu_s: f64,
}

/// Label of a grasp.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum GraspLabel {
    /// The object followed the lift.
    Stable,
    /// It was touched but not lifted.
    Slip,
}

impl GraspLabel {
    pub(super) const ALL: [Self; 2] = [Self::Stable, Self::Slip];
}

impl SimulatedCandidate {
    /// Returns the label; none if the gripper missed, the start was in collision, or there is no
    /// outcome.
    pub(super) fn label(&self) -> Option<GraspLabel> {
        match self.outcome {
            GraspOutcome::Success => Some(GraspLabel::Stable),
            GraspOutcome::Slip | GraspOutcome::Eject | GraspOutcome::GelsMet => {
                Some(GraspLabel::Slip)
            }
            GraspOutcome::Miss | GraspOutcome::PenetratingStart | GraspOutcome::NotConverged => {
                None
            }
        }
    }
}

/// Hold time before the lift, s, and lifting speed, m/s, of a person: shorter and faster than in
/// the paper's protocol.
const HOLD_S: f64 = 0.5;
const LIFT_SPEED_M_S: f64 = 0.04;

/// Returns the engine that stands in for reality: with the fine mesh, or the default mesh for the
/// quick dataset, which is replayed with the coarse mesh.
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

/// Returns the same engine with the coarse mesh, which is fast and similar.
pub(super) fn screening() -> FemEngine {
    FemEngine {
        settings: GraspSettings {
            resolution: GelResolution::Coarse,
            ..reality(true).settings
        },
    }
}

/// Simulates the candidates of one object and stores the results in a folder.
pub(super) struct CandidateSimulator<'a> {
    object: &'a DemoObject,
    engine: FemEngine,
    folder: &'a BeneathPath,
    mesh: Arc<gripcast_geometry::TriangleMesh>,
    mesh_sha256: String,
}

impl<'a> CandidateSimulator<'a> {
    pub(super) fn new(object: &'a DemoObject, engine: FemEngine, folder: &'a BeneathPath) -> Self {
        Self {
            object,
            engine,
            folder,
            mesh: Arc::new(object.mesh.clone()),
            mesh_sha256: object.mesh.content_hash(),
        }
    }

    /// Returns the result of a candidate, from its file or from a simulation.
    ///
    /// # Errors
    /// `Io`, `DiskFull`; errors of the engine.
    pub(super) fn simulate(&self, candidate: &Candidate) -> Result<SimulatedCandidate> {
        let key = self.key(candidate)?;
        let path = self.path(candidate)?;
        if let Some(stored) = read(&path, &key) {
            return Ok(stored);
        }
        let start = thread_cpu_s();
        let result = self.engine.simulate(
            &self.setup(candidate),
            self.object.friction,
            candidate.stop_force_n,
        )?;
        let done = self.summary(&result, key, thread_cpu_s() - start);
        let text = serde_json::to_vec(&done)
            .map_err(|e| Error::internal("cannot write a result").because(e))?;
        path.replace(&text)
            .map_err(|e| Error::io("cannot write a result", e).at(path.display()))?;
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

    fn summary(&self, result: &GraspResult, key: String, cpu_s: f64) -> SimulatedCandidate {
        let trace = &result.trace;
        let last = trace.stage(StageName::Adjustment).next_back();
        let snapshot = trace
            .snapshots
            .iter()
            .find(|s| s.stage == StageName::Adjustment);
        let is_reality = self.engine.settings.resolution != GelResolution::Coarse;
        SimulatedCandidate {
            key,
            outcome: result.outcome,
            lifted_m: result.lifted_m,
            force_n: last.map_or([0.0; 2], |step| step.force.map(|f| f.normal_n)),
            pre_lift: snapshot.filter(|_| is_reality).cloned(),
            cpu_s,
        }
    }

    fn path(&self, candidate: &Candidate) -> Result<BeneathPath> {
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
        Ok(sha256_hex(all.to_string()))
    }
}

/// Reads a stored result with the same inputs.
fn read(path: &BeneathPath, key: &str) -> Option<SimulatedCandidate> {
    let text = path.read(FileKind::Mesh).ok()?;
    let found: SimulatedCandidate = serde_json::from_slice(&text).ok()?;
    (found.key == key).then_some(found)
}
