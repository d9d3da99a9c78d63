//! Simulates a part of a plan and takes the images.

use std::collections::{BTreeMap, BTreeSet};
use std::panic::AssertUnwindSafe;
use std::path::Path;
use std::sync::Arc;

use super::object_mesh::planned_mesh;
use super::plan::{Plan, PlannedObject, PlannedSimulation, Shard, check_parameters};
use super::sample_images::{Grasped, Photographer, before_lift, rendering_seed, seen_surface};
use super::store::{ResultStore, SimulationResult};
use gripcast_base::catch_panic::catch_panic;
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_base::files::{Root, SimulationId};
use gripcast_base::random::SeedStream;
use gripcast_base::workers::{par_map_single_threaded, thread_cpu_s};
use gripcast_dataset::shard::{
    ShardEngine, ShardFacts, ShardImages, ShardOutcome, ShardRow, to_bytes,
};
use gripcast_geometry::TriangleMesh;
use gripcast_sim::grasp::{GraspOutcome, GraspResult, Snapshot, StageName};
use gripcast_sim::{Engine, EngineKind, GraspSetup};
use gripcast_tactile::SimulatedGel;
use gripcast_visual::Model;

/// Normal force on each finger before the lift under which nobody would lift, N: the object was
/// squeezed out, or lies beside the gels.
const MIN_FORCE_N: f64 = 0.5;

/// How far a run is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RunProgress {
    /// Simulations of the part with a result.
    pub done: usize,
    /// Of those, simulated by this run.
    pub simulated: usize,
    /// Simulations of the part.
    pub all: usize,
}

/// What a run did.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RunSummary {
    /// Simulations of the part.
    pub all: usize,
    /// Of those, simulated by this run.
    pub simulated: usize,
    /// Simulations without a usable result, with the reason.
    pub failed: Vec<(String, String)>,
}

/// Which simulations get images.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Images {
    /// Those with a label.
    All,
    /// None: labels are there sooner, and tell which images a dataset needs.
    None,
    /// Those with a label that are named.
    Of(BTreeSet<SimulationId>),
}

impl Images {
    fn are_taken(&self, id: &SimulationId) -> bool {
        match self {
            Self::All => true,
            Self::None => false,
            Self::Of(ids) => ids.contains(id),
        }
    }
}

/// Which simulations of a plan are run, and how.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RunSettings {
    /// Part of the plan.
    pub shard: Shard,
    /// Simulations at a time; the results do not depend on it.
    pub jobs: usize,
    /// Whether simulations that could not be done are tried again, as after a missing file came
    /// back.
    pub is_failed_retried: bool,
    /// Whether simulations without a result are done; else only images are taken.
    pub is_open_simulated: bool,
    /// Which of them get images. Results do not depend on when they got them.
    pub images: Images,
}

/// Simulates what of a part has no result yet, each simulation in one thread. Every result is kept
/// at once: a run that is cut off goes on where it was. A simulation that cannot be done is a result
/// as well.
///
/// # Errors
/// `Input` where the plan was made with other parameters than the engine has, or a result is of
/// another plan; those of keeping results.
pub fn run(
    plan: &Plan,
    folder: &Path,
    settings: &RunSettings,
    engine: &dyn Engine,
    on_progress: &(dyn Fn(RunProgress) + Sync),
) -> Result<RunSummary> {
    check_parameters(plan, engine)?;
    let store = ResultStore::beside(folder);
    let mut part = settings.shard.of(plan);
    if !settings.is_open_simulated {
        let found: Vec<bool> = part
            .iter()
            .map(|simulation| Ok(store.find(plan, &simulation.id)?.is_some()))
            .collect::<Result<_>>()?;
        let mut found = found.into_iter();
        part.retain(|_| found.next() == Some(true));
    }
    let mut open = Vec::new();
    let mut failed = BTreeMap::new();
    for simulation in &part {
        match store.find(plan, &simulation.id)? {
            None => open.push((*simulation, None)),
            Some(result) if settings.is_failed_retried && result.is_failed() => {
                open.push((*simulation, None));
            }
            Some(result) if result.lacks_images() && settings.images.are_taken(&simulation.id) => {
                open.push((*simulation, Some(result)));
            }
            Some(result) => note_failure(&result, &mut failed),
        }
    }
    let found = part.len() - open.len();
    let tell = |simulated| {
        on_progress(RunProgress {
            done: found + simulated,
            simulated,
            all: part.len(),
        });
    };
    tell(0);
    let workshop = Workshop::new(plan, folder, engine)?;
    let work = |(simulation, earlier): &(&PlannedSimulation, Option<SimulationResult>)| {
        let id = &simulation.id;
        let labelled = earlier.clone();
        let earlier = labelled.and_then(|result| Some((result, store.state(plan, id)?)));
        let is_taken = settings.images.are_taken(id);
        let (result, beside) = workshop.make(simulation, earlier, is_taken)?;
        // A result that is there has what belongs to it.
        match beside {
            Beside::State(snapshot) => {
                store.keep_state(plan, id, &snapshot)?;
                store.keep(result.clone(), None)?;
            }
            Beside::Images(rows, bytes) => {
                store.keep(result.clone(), Some((rows, &bytes)))?;
                store.drop_state(id);
            }
            Beside::Nothing => store.keep(result.clone(), None)?,
        }
        Ok(result)
    };
    let made = par_map_single_threaded(settings.jobs, &open, &work, &tell)?;
    for result in &made {
        note_failure(result, &mut failed);
    }
    Ok(RunSummary {
        all: part.len(),
        simulated: made.len(),
        failed: failed.into_iter().collect(),
    })
}

/// Whether each simulation of a plan holds with another engine, without images; none where it has
/// no outcome.
///
/// # Errors
/// Those of the meshes and of the engine.
pub fn simulate_labels(
    plan: &Plan,
    folder: &Path,
    engine: &dyn Engine,
    jobs: usize,
    on_progress: &(dyn Fn(usize) + Sync),
) -> Result<Vec<Option<bool>>> {
    let root = Root::new(folder);
    let label = |simulation: &PlannedSimulation| -> Result<Option<bool>> {
        let object = plan.object(simulation)?;
        let setup = setup(simulation, object, &root)?;
        let force_n = simulation.stop_force_n;
        let grasp = engine.simulate(&setup, object.friction, force_n)?;
        Ok(stable(grasp.outcome))
    };
    par_map_single_threaded(jobs, &plan.simulations, &label, on_progress)
}

fn setup(
    simulation: &PlannedSimulation,
    object: &PlannedObject,
    root: &Root,
) -> Result<GraspSetup> {
    Ok(GraspSetup {
        mesh: Arc::new(planned_mesh(object, root)?),
        mass_kg: object.mass_kg,
        t_world_object: simulation.t_world_object,
        t_world_gripper: simulation.t_world_gripper,
        opening_m: simulation.opening_m,
    })
}

fn note_failure(result: &SimulationResult, failed: &mut BTreeMap<String, String>) {
    if result.is_failed() {
        let why = result.detail.clone().unwrap_or_default();
        failed.insert(result.id.to_string(), why);
    }
}

/// What is kept beside a result.
enum Beside {
    /// Nothing is to be seen.
    Nothing,
    /// Rows and the file of them.
    Images(usize, Vec<u8>),
    /// What images can be taken of later.
    State(Snapshot),
}

/// A label without images and what they are to be taken of.
type Earlier = Option<(SimulationResult, Snapshot)>;

/// Everything that all simulations fraction.
struct Workshop<'a> {
    plan: &'a Plan,
    root: Root,
    engine: &'a dyn Engine,
    gel: Option<SimulatedGel>,
    photographer: Photographer,
}

impl<'a> Workshop<'a> {
    fn new(plan: &'a Plan, folder: &Path, engine: &'a dyn Engine) -> Result<Self> {
        let gel = engine.gel()?;
        Ok(Self {
            plan,
            root: Root::new(folder),
            engine,
            gel: gel.map(|(grid, d_hat_m)| SimulatedGel { grid, d_hat_m }),
            photographer: Photographer::new(plan.header.rendering)?,
        })
    }

    /// The result of a simulation. What goes wrong in it is in the result: one bad object does not
    /// end a night's work.
    fn make(
        &self,
        simulation: &PlannedSimulation,
        earlier: Earlier,
        is_taken: bool,
    ) -> Result<(SimulationResult, Beside)> {
        let object = self.plan.object(simulation)?;
        let mut result = SimulationResult::of(self.plan, simulation);
        let tried = catch_panic(AssertUnwindSafe(|| {
            self.tried(simulation, object, earlier, is_taken)
        }));
        let why = match tried {
            Ok(Ok(made)) => return Ok(made),
            Ok(Err(error)) if error.kind() == ErrorKind::DiskFull => return Err(error),
            Ok(Err(error)) => error.to_string(),
            Err(message) => format!("a defect of gripcast ended it: {message}"),
        };
        result.detail = Some(why);
        Ok((result, Beside::Nothing))
    }

    fn tried(
        &self,
        simulation: &PlannedSimulation,
        object: &PlannedObject,
        earlier: Earlier,
        is_taken: bool,
    ) -> Result<(SimulationResult, Beside)> {
        let mut clock = Clock::new();
        let setup = setup(simulation, object, &self.root)?;
        let prepare = clock.lap();
        let (mut result, snapshot) = match earlier {
            Some(earlier) => earlier,
            None => {
                let force_n = simulation.stop_force_n;
                let grasp = self.engine.simulate(&setup, object.friction, force_n)?;
                let mut result = facts(SimulationResult::of(self.plan, simulation), &grasp);
                result.cpu_s.simulate = clock.lap();
                let Some(snapshot) = seen_before_lift(&grasp) else {
                    result.stable = None;
                    result.cpu_s.prepare = prepare;
                    return Ok((result, Beside::Nothing));
                };
                (result, snapshot.clone())
            }
        };
        result.cpu_s.prepare += prepare;
        if !is_taken {
            return Ok((result, Beside::State(snapshot)));
        }
        let seen = seen_surface(&setup.mesh);
        let grasped = Grasped {
            setup: &setup,
            seen: &seen,
            snapshot: &snapshot,
            gel: self.gel.as_ref(),
            force_n: result.force_n.unwrap_or_default(),
        };
        let rows = self.rows(simulation, object, &grasped, &mut result, &mut clock)?;
        let info = format!("{{\"plan_sha256\":\"{}\"}}", self.plan.sha256);
        let count = rows.len();
        Ok((result, Beside::Images(count, to_bytes(rows, &info)?)))
    }

    /// The renderings of a grasp that has an outcome and held something before the lift.
    fn rows(
        &self,
        simulation: &PlannedSimulation,
        object: &PlannedObject,
        grasped: &Grasped<'_>,
        result: &mut SimulationResult,
        clock: &mut Clock,
    ) -> Result<Vec<ShardRow>> {
        let (setup, snapshot, force_n) = (grasped.setup, grasped.snapshot, grasped.force_n);
        let stable = result.stable == Some(true);
        let count = self.plan.header.rendering.renderings;
        let mut rows = Vec::with_capacity(count as usize);
        for rendering in 0..count {
            let seed = rendering_seed(simulation.seed, rendering);
            let [initial, pressed] = self.photographer.tactile(grasped, seed)?;
            result.cpu_s.tactile += clock.lap();
            let (words, model) = appearance(object, &self.root, &setup.mesh, seed)?;
            let rgb = self.photographer.rgb(grasped, &model, seed)?;
            result.cpu_s.visual += clock.lap();
            let [initial_left, initial_right] = initial;
            let [grasp_left, grasp_right] = pressed;
            rows.push(ShardRow {
                facts: ShardFacts {
                    id: format!("{}-r{rendering}", simulation.id),
                    simulation: simulation.id.to_string(),
                    object: object.name.to_string(),
                    category: object.category.clone(),
                    engine: match simulation.engine {
                        EngineKind::Fem => ShardEngine::Fem,
                        EngineKind::Rigid => ShardEngine::Rigid,
                    },
                    outcome: if stable {
                        ShardOutcome::Stable
                    } else {
                        ShardOutcome::Slip
                    },
                    outcome_detail: result.outcome.clone(),
                    stop_force_n: Some(simulation.stop_force_n),
                    friction: Some(object.friction),
                    mass_kg: Some(object.mass_kg),
                    lifted_m: Some(result.lifted_m),
                    force_left_n: Some(force_n[0]),
                    force_right_n: Some(force_n[1]),
                    opening_m: Some(snapshot.opening_m),
                    t_object_gripper: Some(
                        snapshot.t_world_object.inverse() * snapshot.t_world_gripper,
                    ),
                    fault: simulation.fault.map(|fault| fault.name().to_owned()),
                    appearance: words,
                    rendering,
                    seed: seed >> 1,
                    crop_profile: self.photographer.crop_profile().to_owned(),
                },
                images: ShardImages {
                    initial_left,
                    initial_right,
                    grasp_left,
                    grasp_right,
                    grasp_rgb: rgb,
                    initial_rgb: None,
                    grasp_depth: None,
                },
            });
        }
        Ok(rows)
    }
}

/// What an object looks like in a rendering, in words and as a model.
fn appearance(
    object: &PlannedObject,
    root: &Root,
    mesh: &TriangleMesh,
    seed: u64,
) -> Result<(String, Model)> {
    let mut draw = SeedStream::named(seed, "appearance");
    let (looks, textures) = (&object.looks, &object.textures);
    let which = draw.index(looks.len() + textures.len());
    if let Some(look) = looks.get(which) {
        let model = Model::coated(mesh, &look.look, draw.bits())?;
        return Ok((look.words.clone(), model));
    }
    let texture = textures.get(which - looks.len()).ok_or_else(|| {
        let what = format!("{} has no appearance", object.name);
        Error::input(what)
    })?;
    let model = Model::textured(mesh, &texture.load(root)?, texture.width_m)?;
    Ok((texture.words.to_string(), model))
}

/// Whether the object was held; none where there is no outcome, or no contact.
fn stable(outcome: GraspOutcome) -> Option<bool> {
    match outcome {
        GraspOutcome::Success => Some(true),
        GraspOutcome::Slip | GraspOutcome::Eject => Some(false),
        GraspOutcome::Closed
        | GraspOutcome::Miss
        | GraspOutcome::PenetratingStart
        | GraspOutcome::NotConverged => None,
    }
}

/// The state before the lift of a grasp that has an outcome and held something by then.
fn seen_before_lift(grasp: &GraspResult) -> Option<&Snapshot> {
    stable(grasp.outcome)?;
    let is_held = |force_n: [f64; 2]| force_n.iter().all(|force| *force >= MIN_FORCE_N);
    forces(grasp)
        .filter(|force_n| is_held(*force_n))
        .and_then(|_| before_lift(&grasp.trace.snapshots))
}

/// Normal force on each finger before the lift, N.
fn forces(grasp: &GraspResult) -> Option<[f64; 2]> {
    let last = grasp.trace.stage(StageName::Adjustment).next_back()?;
    // A gel that swings back is below zero by less than a millinewton.
    Some(last.force.map(|force| force.normal_n.max(0.0)))
}

fn facts(mut result: SimulationResult, grasp: &GraspResult) -> SimulationResult {
    let iterations = grasp.trace.steps.iter().filter_map(|step| step.solver);
    result.outcome = grasp.outcome.name().to_owned();
    result.detail = grasp.detail.clone();
    result.stable = stable(grasp.outcome);
    result.lifted_m = grasp.lifted_m;
    result.force_n = forces(grasp);
    result.steps = grasp.trace.steps.len();
    result.newton_iterations = iterations.map(|step| u64::from(step.iterations)).sum();
    result.unconverged_steps = grasp.unconverged_steps;
    result
}

/// CPU time of this thread between laps.
struct Clock(f64);

impl Clock {
    fn new() -> Self {
        Self(thread_cpu_s())
    }

    fn lap(&mut self) -> f64 {
        let began = std::mem::replace(&mut self.0, thread_cpu_s());
        self.0 - began
    }
}
