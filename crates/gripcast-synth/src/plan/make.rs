//! Makes a plan: objects get properties and grasps, grasps get forces and seeds.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;

use serde_json::Value;

use super::file::replace;
use super::{
    Drafts, LeftOutObject, MESHES, MeshSource, ObjectDraft, PLAN_FORMAT, PLAN_VERSION, Plan,
    PlanHeader, PlannedObject, PlannedSimulation, RenderingPlan, TEXTURES, TextureDraft,
};
use crate::grasp::{GraspChoice, choose_given_grasps, choose_grasps};
use crate::properties::{
    APPEARANCES, Appearances, FRICTION_RANGE, MassMap, Modifier, PhysicalProperties, PropertyAsker,
    PropertyQuery, PropertySource, builtin_appearances, estimate, map_masses, oriented_size_m,
};
use gripcast_base::error::{Error, Result};
use gripcast_base::files::{BeneathPath, FileName, Root, SimulationId};
use gripcast_base::random::SeedStream;
use gripcast_base::workers::par_map_single_threaded;
use gripcast_geometry::{MassProperties, TriangleMesh, ply_bytes};
use gripcast_sim::{Engine, EngineKind};

/// Seeds in files are below 2⁵³, so that every JSON reader keeps them.
const SEED_BITS: u32 = 53;
/// Largest side of objects that are believed, m: others are mostly in another unit.
const SIZE_M: [f64; 2] = [0.005, 0.5];
/// Estimated CPU time of finite elements, s: a base and for each node of a gel; of the size that
/// grasps of the built-in families cost with coarse gels.
const FEM_BASE_S: f64 = 0.2;
const FEM_S_PER_NODE: f64 = 1.7e-3;
/// The same of a colour image without a path and for each path of a pixel, of a pair of tactile
/// images and of a rigid grasp.
const VISUAL_S: f64 = 0.25;
const VISUAL_S_PER_SAMPLE: f64 = 0.06;
const TACTILE_S: f64 = 0.06;
const RIGID_S: f64 = 0.1;

/// Usual [`PlanSettings::least_friction_fraction`]: dusty, greasy and worn surfaces.
pub const MIN_FRICTION_FRACTION: f64 = 0.25;

/// What a plan is made by.
#[derive(Clone, Debug)]
pub struct PlanSettings {
    /// Name of the preset.
    pub preset: String,
    /// Everything that is drawn follows from it.
    pub seed: u64,
    /// Grasps of each object.
    pub grasps: usize,
    /// Forces at which each grasp is simulated, N.
    pub stop_forces_n: Vec<f64>,
    /// How simulations become images.
    pub rendering: RenderingPlan,
    /// Images of the user's: objects without appearances of their own may wear them.
    pub textures: Vec<TextureDraft>,
    /// How masses that were not given are mapped to those of the paper's objects (A.1).
    pub mass_map: MassMap,
    /// Fraction of a clean surface's friction that the dirtiest keeps: friction of the table is that
    /// of clean and dry things.
    pub least_friction_fraction: f64,
    /// Objects that are worked on at a time.
    pub jobs: usize,
}

/// A plan and what did not get into it.
#[derive(Clone, Debug, PartialEq)]
pub struct MadePlan {
    /// The plan.
    pub plan: Plan,
    /// Objects without grasps.
    pub left_out: Vec<LeftOutObject>,
    /// Meshes that the plan names.
    meshes: BTreeMap<FileName, TriangleMesh>,
    /// Images that the plan names.
    textures: BTreeMap<FileName, TextureDraft>,
}

impl MadePlan {
    /// Writes the plan with all that it names into a folder, which is made if need be. The same
    /// plan may be there already.
    ///
    /// # Errors
    /// `Input` where another plan is there, or an image changed meanwhile; those of the operating
    /// system.
    pub fn write(&self, folder: &Path) -> Result<()> {
        fs::create_dir_all(folder)
            .map_err(|e| Error::io("cannot make the folder", e).at(folder.display()))?;
        let root = Root::new(folder);
        self.plan.check_free(&root)?;
        if !self.meshes.is_empty() {
            let meshes = folder_at(root.top().join(MESHES))?;
            for (name, mesh) in &self.meshes {
                replace(&meshes.join(name), &ply_bytes(mesh))?;
            }
        }
        if !self.textures.is_empty() {
            let textures = folder_at(root.top().join(TEXTURES))?;
            for (name, texture) in &self.textures {
                replace(&textures.join(name), &texture.read()?)?;
            }
        }
        // Last: a plan that is there is whole.
        self.plan.write(&root)
    }
}

fn folder_at(folder: BeneathPath) -> Result<BeneathPath> {
    match folder.create_dir_all() {
        Ok(()) => Ok(folder),
        Err(e) => Err(Error::io("cannot make the folder", e).at(folder.display())),
    }
}

/// Makes a plan of objects. The same input gives the same plan on any number of threads.
///
/// # Errors
/// `Input` where no object can be grasped or two have one name; those of the asker.
pub fn make_plan(
    settings: &PlanSettings,
    drafts: Drafts,
    engine: &dyn Engine,
    asker: Option<&mut PropertyAsker>,
    on_progress: &(dyn Fn(usize) + Sync),
) -> Result<MadePlan> {
    let Drafts {
        drafts,
        mut left_out,
    } = drafts;
    check_names(&drafts)?;
    let look = |draft: &ObjectDraft| Ok(looked_at(draft, settings));
    let seen = par_map_single_threaded(settings.jobs, &drafts, &look, on_progress)?;
    let mut kept = Vec::new();
    for (draft, seen) in drafts.into_iter().zip(seen) {
        match seen {
            Ok(seen) => kept.push((draft, seen)),
            Err(error) => left_out.push(LeftOutObject {
                name: draft.name.into(),
                reason: error.to_string(),
            }),
        }
    }
    if kept.is_empty() {
        let reason = left_out
            .first()
            .map_or("no object was given", |l| &l.reason);
        return Err(Error::input(format!("no object can be used: {reason}")));
    }
    let objects = described(&kept, settings, asker)?;
    let simulations = simulations(&kept, settings, engine)?;
    let header = PlanHeader {
        format: PLAN_FORMAT.to_owned(),
        version: PLAN_VERSION,
        software: concat!("gripcast ", env!("CARGO_PKG_VERSION")).to_owned(),
        preset: settings.preset.clone(),
        seed: settings.seed,
        engine: engine.kind(),
        parameters: engine.parameters()?,
        rendering: settings.rendering,
    };
    let plan = Plan::new(header, objects, simulations)?;
    let (meshes, textures) = files(kept, settings, &plan);
    Ok(MadePlan {
        plan,
        left_out,
        meshes,
        textures,
    })
}

/// The meshes and images that a plan names.
fn files(
    kept: Vec<(ObjectDraft, Seen)>,
    settings: &PlanSettings,
    plan: &Plan,
) -> (
    BTreeMap<FileName, TriangleMesh>,
    BTreeMap<FileName, TextureDraft>,
) {
    let worn: BTreeSet<&FileName> = plan
        .objects
        .values()
        .flat_map(|object| &object.textures)
        .map(|texture| &texture.file)
        .collect();
    let own = kept.iter().flat_map(|(draft, _)| &draft.textures);
    let textures = own
        .chain(&settings.textures)
        .filter(|texture| worn.contains(&texture.planned.file))
        .map(|texture| (texture.planned.file.clone(), texture.clone()))
        .collect();
    let mesh = |(draft, _): (ObjectDraft, Seen)| match draft.source {
        MeshSource::File { file } => Some((file, draft.mesh)),
        MeshSource::Family { .. } => None,
    };
    (kept.into_iter().filter_map(mesh).collect(), textures)
}

/// What is found by looking at an object alone.
struct Seen {
    choice: GraspChoice,
    volume_m3: f64,
    size_m: f64,
}

fn looked_at(draft: &ObjectDraft, settings: &PlanSettings) -> Result<Seen> {
    let volume_m3 = MassProperties::of(&draft.mesh)?.volume_m3;
    let [size_m, ..] = oriented_size_m(&draft.mesh)?;
    if !(SIZE_M[0]..=SIZE_M[1]).contains(&size_m) {
        let what = format!(
            "the object is {size_m:.3e} m large, expected {} to {} m",
            SIZE_M[0], SIZE_M[1]
        );
        return Err(Error::input(what).remedy("check its unit and scale"));
    }
    let (name, wanted, seed) = (&draft.name, settings.grasps, settings.seed);
    for force_n in &settings.stop_forces_n {
        simulation_id(name, wanted, *force_n)?;
    }
    let choice = match &draft.grasps {
        Some(given) => choose_given_grasps(name, &draft.mesh, given, wanted, seed)?,
        None => choose_grasps(name, &draft.mesh, wanted, seed)?,
    };
    if choice.grasps.is_empty() {
        return Err(Error::input(without_grasps(&choice)));
    }
    Ok(Seen {
        choice,
        volume_m3,
        size_m,
    })
}

fn without_grasps(choice: &GraspChoice) -> String {
    let worst = choice.collisions.iter().max_by_key(|(_, count)| **count);
    let hits = worst.map_or(String::new(), |(part, count)| {
        format!(", {count} would hit it with the {part}")
    });
    format!(
        "the gripper finds no grasp: {} candidates without two opposite places{hits}",
        choice.without_places
    )
}

fn check_names(drafts: &[ObjectDraft]) -> Result<()> {
    let mut names = BTreeSet::new();
    match drafts.iter().find(|draft| !names.insert(&draft.name)) {
        Some(twice) => Err(Error::input(format!(
            "two objects are named {}",
            twice.name
        ))),
        None => Ok(()),
    }
}

/// Objects with mass, friction and looks.
fn described(
    kept: &[(ObjectDraft, Seen)],
    settings: &PlanSettings,
    mut asker: Option<&mut PropertyAsker>,
) -> Result<Vec<PlannedObject>> {
    let mut objects = Vec::with_capacity(kept.len());
    for (draft, seen) in kept {
        let seed = SeedStream::named(settings.seed, &format!("object {}", draft.name)).bits();
        let looks = looks(draft, seed, asker.as_deref_mut())?;
        let physical = physical(draft, seen, &looks, seed, asker.as_deref_mut())?;
        objects.push(PlannedObject {
            name: draft.name.clone(),
            category: draft.category.clone(),
            mesh: draft.source.clone(),
            mesh_sha256: draft.mesh.content_hash(),
            material: draft.material.name.clone(),
            mass_kg: physical.mass_kg,
            friction: draft
                .friction
                .unwrap_or_else(|| soiled(&physical, settings.least_friction_fraction, seed)),
            properties: physical.source,
            textures: textures(draft, seed, settings)
                .into_iter()
                .map(|texture| texture.planned.clone())
                .collect(),
            looks,
        });
    }
    let drafts = kept.iter().map(|(draft, _)| draft);
    let mut estimated: Vec<&mut PlannedObject> = drafts
        .zip(&mut objects)
        .filter(|(draft, _)| draft.mass_kg.is_none())
        .map(|(_, object)| object)
        .collect();
    let masses: Vec<f64> = estimated.iter().map(|object| object.mass_kg).collect();
    let mapped = map_masses(&masses, settings.mass_map)?;
    for (object, mass_kg) in estimated.iter_mut().zip(mapped) {
        object.mass_kg = mass_kg;
    }
    // What JSON readers show, and no last bit of a logarithm.
    for object in &mut objects {
        object.mass_kg = rounded(object.mass_kg, 1e6);
        object.friction = rounded(object.friction, 1e4);
    }
    Ok(objects)
}

/// Friction after dust, grease and wear, where it is not known for the object itself.
fn soiled(physical: &PhysicalProperties, least_fraction: f64, seed: u64) -> f64 {
    if matches!(physical.source, PropertySource::Llm { .. }) {
        return physical.friction;
    }
    let fraction = SeedStream::named(seed, "surface").between(least_fraction, 1.0);
    let [low, high] = FRICTION_RANGE;
    (fraction * physical.friction).clamp(low, high)
}

fn rounded(value: f64, per_unit: f64) -> f64 {
    (value * per_unit).round() / per_unit
}

fn looks(
    draft: &ObjectDraft,
    seed: u64,
    asker: Option<&mut PropertyAsker>,
) -> Result<Vec<Modifier>> {
    if !draft.looks.is_empty() || !draft.textures.is_empty() {
        return Ok(draft.looks.clone());
    }
    let Some(asker) = asker else {
        return Ok(builtin_appearances(&draft.name, draft.material, seed));
    };
    let query = query(draft, "", seed);
    let Appearances { modifiers, .. } = asker.appearances(&query)?;
    Ok(modifiers)
}

/// Images on an object: its own, else as many as it has other appearances.
fn textures<'a>(
    draft: &'a ObjectDraft,
    seed: u64,
    settings: &'a PlanSettings,
) -> Vec<&'a TextureDraft> {
    if !draft.looks.is_empty() || !draft.textures.is_empty() {
        return draft.textures.iter().collect();
    }
    let mut drawn: Vec<&TextureDraft> = settings.textures.iter().collect();
    drawn.sort_by_key(|texture| {
        SeedStream::named(seed, &format!("texture {}", texture.planned.sha256)).bits()
    });
    drawn.truncate(APPEARANCES);
    drawn
}

fn physical(
    draft: &ObjectDraft,
    seen: &Seen,
    looks: &[Modifier],
    seed: u64,
    asker: Option<&mut PropertyAsker>,
) -> Result<PhysicalProperties> {
    if let (Some(mass_kg), Some(friction)) = (draft.mass_kg, draft.friction) {
        return Ok(PhysicalProperties {
            mass_kg,
            friction,
            source: PropertySource::Given,
        });
    }
    let mut found = match asker {
        Some(asker) => {
            let texture = looks.first().map_or("", |look| &look.words);
            asker.physical(&PropertyQuery {
                size_m: seen.size_m,
                volume_m3: seen.volume_m3,
                ..query(draft, texture, seed)
            })?
        }
        None => estimate(
            &draft.category,
            draft.material,
            seen.volume_m3,
            draft.fill,
            seed,
        )?,
    };
    found.mass_kg = draft.mass_kg.unwrap_or(found.mass_kg);
    Ok(found)
}

fn query<'a>(draft: &'a ObjectDraft, texture: &'a str, seed: u64) -> PropertyQuery<'a> {
    PropertyQuery {
        object: &draft.name,
        category: &draft.category,
        texture,
        material: draft.material,
        size_m: 0.0,
        volume_m3: 0.0,
        fill: draft.fill,
        seed,
    }
}

fn simulations(
    kept: &[(ObjectDraft, Seen)],
    settings: &PlanSettings,
    engine: &dyn Engine,
) -> Result<Vec<PlannedSimulation>> {
    let cost_s = cost_s(settings, engine)?;
    let mut all = Vec::new();
    for (draft, seen) in kept {
        for (number, grasp) in seen.choice.grasps.iter().enumerate() {
            for force_n in &settings.stop_forces_n {
                let id = simulation_id(&draft.name, number, *force_n)?;
                // The engine is no part of it: both make images under the same conditions.
                let seed = SeedStream::named(settings.seed, &format!("images {id}")).bits();
                all.push(PlannedSimulation {
                    id,
                    object: draft.name.clone(),
                    grasp: number as u32,
                    fault: grasp.fault,
                    engine: engine.kind(),
                    stop_force_n: *force_n,
                    t_world_object: grasp.t_world_object,
                    t_world_gripper: grasp.placed.t_world_gripper,
                    opening_m: grasp.placed.opening_m,
                    seed: seed >> (u64::BITS - SEED_BITS),
                    cost_s: rounded(cost_s, 1e3),
                });
            }
        }
    }
    all.sort_by(|a, b| (&a.object, a.grasp).cmp(&(&b.object, b.grasp)));
    Ok(all)
}

fn simulation_id(object: &SimulationId, grasp: usize, force_n: f64) -> Result<SimulationId> {
    SimulationId::parse(&format!("{object}-{grasp:03}-{force_n}n"))
        .map_err(|e| e.remedy("give the object a shorter name"))
}

/// Estimated CPU time of a simulation with its images, s.
fn cost_s(settings: &PlanSettings, engine: &dyn Engine) -> Result<f64> {
    let simulate = match engine.kind() {
        EngineKind::Rigid => RIGID_S,
        EngineKind::Fem => {
            let nodes = engine.gel()?.map_or(0, |(grid, _)| grid.positions().len());
            FEM_BASE_S + FEM_S_PER_NODE * nodes as f64
        }
    };
    let RenderingPlan {
        renderings,
        samples,
        ..
    } = settings.rendering;
    let image = TACTILE_S + VISUAL_S + VISUAL_S_PER_SAMPLE * f64::from(samples);
    Ok(simulate + f64::from(renderings) * image)
}

/// Whether an engine has the parameters that a plan was made with.
///
/// # Errors
/// `Input` with the first parameter that differs.
pub fn check_parameters(plan: &Plan, engine: &dyn Engine) -> Result<()> {
    let now = engine.parameters()?;
    match difference("", &plan.header.parameters, &now) {
        None => Ok(()),
        Some((name, planned, now)) => Err(Error::input(format!(
            "the plan was made with {name} = {planned}, this build has {now}"
        ))
        .remedy(format!(
            "run it with {}, or make a new plan",
            plan.header.software
        ))),
    }
}

/// The first place where two values differ.
fn difference(name: &str, a: &Value, b: &Value) -> Option<(String, Value, Value)> {
    match (a, b) {
        (Value::Object(a), Value::Object(b)) => {
            let names: std::collections::BTreeSet<&String> = a.keys().chain(b.keys()).collect();
            names.into_iter().find_map(|key| {
                let inner = format!("{name}{}{key}", if name.is_empty() { "" } else { "." });
                let [a, b] = [a, b].map(|map| map.get(key).unwrap_or(&Value::Null));
                difference(&inner, a, b)
            })
        }
        _ if a == b => None,
        _ => Some((name.to_owned(), a.clone(), b.clone())),
    }
}

#[cfg(test)]
#[path = "make_test.rs"]
mod tests;
