//! Simulates one shard of a plan and renders its images.

use std::collections::{BTreeMap, BTreeSet};
use std::panic::AssertUnwindSafe;
use std::path::Path;
use std::sync::Arc;

use super::object_mesh::planned_mesh;
use super::plan::{Plan, PlannedObject, PlannedSimulation, Shard, check_parameters};
use super::sample_images::{PreLiftGrasp, SampleRenderer, rendering_seed, smooth_surface};
use super::store::{ResultStore, SimulationResult};
use gripcast_base::catch_panic;
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_base::files::{Root, SimulationId};
use gripcast_base::random::SeedStream;
use gripcast_base::workers::{par_map_single_threaded, thread_cpu_s};
use gripcast_dataset::shard::{
    ShardEngine, ShardFacts, ShardImages, ShardOutcome, ShardRow, to_bytes,
};
use gripcast_geometry::{GraspGeometry, TriangleMesh};
use gripcast_shear::LiftMotion;
use gripcast_sim::grasp::{GraspOutcome, GraspRecord, GraspResult, Snapshot, StageName};
use gripcast_sim::{Engine, EngineKind, GraspSetup};
use gripcast_tactile::SimulatedGel;
use gripcast_visual::Model;

/// Minimum normal force on each finger before the lift, N. Below it the object was squeezed out or
/// lies beside the gels, and nobody would lift.
const MIN_FORCE_N: f64 = 0.5;

/// Progress of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RunProgress {
    /// Simulations with a result.
    pub done: usize,
    /// Of those, simulated by this run.
    pub simulated: usize,
    /// Simulations of the shard.
    pub total: usize,
}

/// Summary of a run.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RunSummary {
    /// Simulations of the shard.
    pub total: usize,
    /// Of those, simulated by this run.
    pub simulated: usize,
    /// Simulations without a usable result: id and reason.
    pub failed: Vec<(String, String)>,
}

/// Which labelled simulations get images.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ImageSelection {
    /// All.
    All,
    /// None: labels are available sooner and decide which images a dataset needs.
    None,
    /// Those with one of these ids.
    Only(BTreeSet<SimulationId>),
}

impl ImageSelection {
    fn includes(&self, id: &SimulationId) -> bool {
        match self {
            Self::All => true,
            Self::None => false,
            Self::Only(ids) => ids.contains(id),
        }
    }
}

/// Which simulations of a plan are run, and how.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RunSettings {
    /// Shard of the plan.
    pub shard: Shard,
    /// Simulations that run in parallel; the results do not depend on it.
    pub jobs: usize,
    /// Whether failed simulations are retried, for instance after a missing file was restored.
    pub retry_failed: bool,
    /// Whether simulations without a result are run; otherwise only images are rendered.
    pub simulate_open: bool,
    /// Which simulations get images. Images do not depend on when they are rendered.
    pub images: ImageSelection,
}

/// Runs the simulations of a shard that have no result yet, each in one thread. Every result is
/// stored as soon as it is finished, so an interrupted run can be resumed. A simulation that fails
/// also gets a result.
///
/// # Errors
/// `Input` if the plan was made with other engine parameters, or a stored result belongs to another
/// plan; errors of storing results.
pub fn run(
    plan: &Plan,
    folder: &Path,
    settings: &RunSettings,
    engine: &dyn Engine,
    on_progress: &(dyn Fn(RunProgress) + Sync),
) -> Result<RunSummary> {
    check_parameters(plan, engine)?;
    let store = ResultStore::new(folder);
    let mut total = 0;
    let mut open = Vec::new();
    let mut failed = BTreeMap::new();
    for simulation in settings.shard.select(plan) {
        let stored = store.load(plan, &simulation.id)?;
        if stored.is_none() && !settings.simulate_open {
            continue;
        }
        total += 1;
        match stored {
            None => open.push((simulation, None)),
            Some(result) if settings.retry_failed && result.is_failed() => {
                open.push((simulation, None));
            }
            Some(result) if result.lacks_images() && settings.images.includes(&simulation.id) => {
                open.push((simulation, Some(result)));
            }
            Some(result) => record_failure(&result, &mut failed),
        }
    }
    let finished = total - open.len();
    let report = |simulated| {
        on_progress(RunProgress {
            done: finished + simulated,
            simulated,
            total,
        });
    };
    report(0);
    let runner = SimulationRunner::new(plan, folder, engine)?;
    let work = |(simulation, labelled): &(&PlannedSimulation, Option<SimulationResult>)| {
        let id = &simulation.id;
        let labelled = labelled.clone();
        let labelled = labelled.and_then(|result| Some((result, store.load_record(plan, id)?)));
        let (result, artifacts) = runner.run(simulation, labelled, settings.images.includes(id))?;
        // The result is written last: one that exists is complete.
        if let Some(record) = artifacts.record {
            store.save_record(plan, id, &record)?;
        }
        let images = artifacts.images.as_ref();
        let images = images.map(|(rows, bytes)| (*rows, bytes.as_slice()));
        store.save(result.clone(), images)?;
        Ok(result)
    };
    let results = par_map_single_threaded(settings.jobs, &open, &work, &report)?;
    for result in &results {
        record_failure(result, &mut failed);
    }
    Ok(RunSummary {
        total,
        simulated: results.len(),
        failed: failed.into_iter().collect(),
    })
}

/// Labels all simulations of a plan with another engine, without images. `Some(true)` is stable,
/// `None` has no label.
///
/// # Errors
/// Errors of the meshes and of the engine.
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
        let setup = grasp_setup(simulation, object, &root)?;
        let friction = simulation.friction_on(object);
        let grasp = engine.simulate(&setup, friction, simulation.stop_force_n)?;
        Ok(stable(grasp.outcome))
    };
    par_map_single_threaded(jobs, &plan.simulations, &label, on_progress)
}

fn grasp_setup(
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

fn record_failure(result: &SimulationResult, failed: &mut BTreeMap<String, String>) {
    if result.is_failed() {
        let reason = result.detail.clone().unwrap_or_default();
        failed.insert(result.id.to_string(), reason);
    }
}

/// What is stored beside a result; nothing without a label.
#[derive(Default)]
struct Artifacts {
    /// The record of a new simulation, from which its images are rendered.
    record: Option<Vec<u8>>,
    /// Number of rows, and the Parquet file with them.
    images: Option<(usize, Vec<u8>)>,
}

/// Runs simulations of one plan and renders their images.
struct SimulationRunner<'a> {
    plan: &'a Plan,
    root: Root,
    engine: &'a dyn Engine,
    gel: Option<SimulatedGel>,
    renderer: SampleRenderer,
}

impl<'a> SimulationRunner<'a> {
    fn new(plan: &'a Plan, folder: &Path, engine: &'a dyn Engine) -> Result<Self> {
        let gel = engine.gel()?;
        Ok(Self {
            plan,
            root: Root::new(folder),
            engine,
            gel: gel.map(|(grid, d_hat_m)| SimulatedGel { grid, d_hat_m }),
            renderer: SampleRenderer::new(plan.header.rendering)?,
        })
    }

    /// Runs a simulation, or only renders one that is already `labelled`. Errors and panics become
    /// part of the result, so that one bad object does not end a long run.
    fn run(
        &self,
        simulation: &PlannedSimulation,
        labelled: Option<(SimulationResult, GraspRecord)>,
        with_images: bool,
    ) -> Result<(SimulationResult, Artifacts)> {
        let object = self.plan.object(simulation)?;
        let outcome = catch_panic::catch_panic(AssertUnwindSafe(|| {
            self.try_run(simulation, object, labelled, with_images)
        }));
        let reason = match outcome {
            Ok(Ok(output)) => return Ok(output),
            Ok(Err(error)) if error.kind() == ErrorKind::DiskFull => return Err(error),
            Ok(Err(error)) => error.to_string(),
            Err(message) => format!("internal error of gripcast: {message}"),
        };
        let mut result = SimulationResult::new(self.plan, simulation);
        result.detail = Some(reason);
        Ok((result, Artifacts::default()))
    }

    fn try_run(
        &self,
        simulation: &PlannedSimulation,
        object: &PlannedObject,
        labelled: Option<(SimulationResult, GraspRecord)>,
        with_images: bool,
    ) -> Result<(SimulationResult, Artifacts)> {
        let mut clock = Clock::new();
        let setup = grasp_setup(simulation, object, &self.root)?;
        let prepare = clock.lap();
        let grid = self.gel.as_ref().map(|gel| &gel.grid);
        let mut artifacts = Artifacts::default();
        let (mut result, record) = match labelled {
            Some(labelled) => labelled,
            None => {
                let force_n = simulation.stop_force_n;
                let friction = simulation.friction_on(object);
                let grasp = self.engine.simulate(&setup, friction, force_n)?;
                let mut result = SimulationResult::new(self.plan, simulation);
                record_grasp(&mut result, &grasp);
                result.cpu_s.simulate = clock.lap();
                let record = GraspRecord::new(&grasp.trace, grid)?;
                let Some(record) = record.filter(|_| is_liftable(&grasp)) else {
                    result.stable = None;
                    result.cpu_s.prepare = prepare;
                    return Ok((result, artifacts));
                };
                // Images are those of the stored record, whenever they are rendered.
                let bytes = record.to_bytes()?;
                let stored = GraspRecord::from_bytes(&bytes)?;
                artifacts.record = Some(bytes);
                (result, stored)
            }
        };
        result.cpu_s.prepare += prepare;
        if !with_images {
            return Ok((result, artifacts));
        }
        let states = 0..record.states.len().min(LiftMotion::FRAMES);
        let states = states.map(|state| record.snapshot(state, grid));
        let states: Vec<Snapshot> = states.collect::<Result<_>>()?;
        let surface = smooth_surface(&setup.mesh);
        let grasp = PreLiftGrasp {
            setup: &setup,
            surface: &surface,
            snapshot: states
                .first()
                .ok_or_else(|| Error::input("the record of the grasp has no state"))?,
            lift: states.get(1..).unwrap_or_default(),
            gel: self.gel.as_ref(),
            force_n: result.force_n.unwrap_or_default(),
        };
        let rows = self.rows(simulation, object, &grasp, &mut result, &mut clock)?;
        let info = format!("{{\"plan_sha256\":\"{}\"}}", self.plan.sha256);
        let count = rows.len();
        artifacts.images = Some((count, to_bytes(rows, &info)?));
        Ok((result, artifacts))
    }

    /// Renders a labelled grasp: one row per rendering.
    fn rows(
        &self,
        simulation: &PlannedSimulation,
        object: &PlannedObject,
        grasp: &PreLiftGrasp<'_>,
        result: &mut SimulationResult,
        clock: &mut Clock,
    ) -> Result<Vec<ShardRow>> {
        let (setup, snapshot, force_n) = (grasp.setup, grasp.snapshot, grasp.force_n);
        let count = self.plan.header.rendering.renderings;
        let t_gripper_object = snapshot.t_world_gripper.inverse() * snapshot.t_world_object;
        let geometry = GraspGeometry::new(&setup.mesh, &t_gripper_object)?;
        let mut rows = Vec::with_capacity(count as usize);
        for rendering in 0..count {
            let seed = rendering_seed(simulation.seed, rendering);
            let [initial, pressed] = self.renderer.tactile(grasp, seed)?;
            let mut lift = self.renderer.lift(grasp, seed)?;
            result.cpu_s.tactile += clock.lap();
            let shown = simulation.appearance;
            let (appearance, model) =
                draw_appearance(object, shown, &self.root, &setup.mesh, seed)?;
            let images = self.renderer.wrist(grasp, &model, seed, lift.as_mut())?;
            let [grasp_rgb, grasp_depth] = images;
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
                    outcome: match result.stable {
                        Some(true) => ShardOutcome::Stable,
                        _ => ShardOutcome::Slip,
                    },
                    outcome_detail: result.outcome.clone(),
                    stop_force_n: Some(simulation.stop_force_n),
                    friction: Some(simulation.friction_on(object)),
                    mass_kg: Some(object.mass_kg),
                    lifted_m: Some(result.lifted_m),
                    force_left_n: Some(force_n[0]),
                    force_right_n: Some(force_n[1]),
                    opening_m: Some(snapshot.opening_m),
                    t_object_gripper: Some(
                        snapshot.t_world_object.inverse() * snapshot.t_world_gripper,
                    ),
                    fault: simulation.fault.map(|fault| fault.name().to_owned()),
                    appearance,
                    rendering,
                    seed: seed >> 1,
                    crop_profile: self.renderer.crop_profile().to_owned(),
                    geometry: Some(geometry),
                    lift,
                    // `merge` adds it from the record.
                    contact: None,
                },
                images: ShardImages {
                    initial_left,
                    initial_right,
                    grasp_left,
                    grasp_right,
                    grasp_rgb,
                    initial_rgb: None,
                    grasp_depth: Some(grasp_depth),
                },
            });
        }
        Ok(rows)
    }
}

/// Draws the appearance of an object in one rendering, unless the simulation has the one that is
/// `shown`: its description and the model.
fn draw_appearance(
    object: &PlannedObject,
    shown: Option<u32>,
    root: &Root,
    mesh: &TriangleMesh,
    seed: u64,
) -> Result<(String, Model)> {
    let mut draw = SeedStream::named(seed, "appearance");
    let (appearances, textures) = (&object.appearances, &object.textures);
    let drawn = draw.index(appearances.len() + textures.len());
    let index = shown.map_or(drawn, |index| index as usize);
    if let Some(drawn) = appearances.get(index) {
        let model = Model::with_appearance(mesh, &drawn.appearance, draw.bits())?;
        return Ok((drawn.description.clone(), model));
    }
    let texture = index.checked_sub(appearances.len());
    let texture = texture
        .and_then(|index| textures.get(index))
        .ok_or_else(|| Error::input(format!("{} has no appearance", object.name)))?;
    let model = Model::textured(mesh, &texture.load(root)?, texture.width_m)?;
    Ok((texture.name.to_string(), model))
}

/// Label of an outcome: stable or slip; none without an outcome or without contact.
fn stable(outcome: GraspOutcome) -> Option<bool> {
    match outcome {
        GraspOutcome::Success => Some(true),
        GraspOutcome::Slip | GraspOutcome::Eject => Some(false),
        GraspOutcome::GelsMet
        | GraspOutcome::Miss
        | GraspOutcome::PenetratingStart
        | GraspOutcome::NotConverged => None,
    }
}

/// Whether a grasp has a label and both fingers press with [`MIN_FORCE_N`] before the lift.
fn is_liftable(grasp: &GraspResult) -> bool {
    let presses = |force_n: &[f64; 2]| force_n.iter().all(|force| *force >= MIN_FORCE_N);
    stable(grasp.outcome).is_some() && pre_lift_force_n(grasp).is_some_and(|f| presses(&f))
}

/// Normal force on each finger before the lift, N.
fn pre_lift_force_n(grasp: &GraspResult) -> Option<[f64; 2]> {
    let last = grasp.trace.stage(StageName::Adjustment).next_back()?;
    // An oscillating gel can be below zero by less than a millinewton.
    Some(last.force.map(|force| force.normal_n.max(0.0)))
}

fn record_grasp(result: &mut SimulationResult, grasp: &GraspResult) {
    let iterations = grasp.trace.steps.iter().filter_map(|step| step.solver);
    result.outcome = grasp.outcome.name().to_owned();
    result.detail = grasp.detail.clone();
    result.stable = stable(grasp.outcome);
    result.lifted_m = grasp.lifted_m;
    result.force_n = pre_lift_force_n(grasp);
    result.steps = grasp.trace.steps.len();
    result.newton_iterations = iterations.map(|step| u64::from(step.iterations)).sum();
    result.unconverged_steps = grasp.unconverged_steps;
}

/// CPU time of this thread between laps, s.
struct Clock(f64);

impl Clock {
    fn new() -> Self {
        Self(thread_cpu_s())
    }

    fn lap(&mut self) -> f64 {
        let start = std::mem::replace(&mut self.0, thread_cpu_s());
        self.0 - start
    }
}
