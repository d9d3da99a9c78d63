//! Creates a plan: objects get properties and grasps, grasps get forces and seeds.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;

use serde_json::Value;

use super::file::replace;
use super::{
    Drafts, FrictionFrom, LeftOutObject, MESHES, MeshSource, ObjectDraft, PLAN_FORMAT,
    PLAN_VERSION, Plan, PlanHeader, PlannedObject, PlannedSimulation, RenderingPlan, TEXTURES,
    TextureDraft,
};
use crate::grasp::{GraspSelection, sample_grasps, select_given_grasps};
use crate::properties::{
    APPEARANCES, DescribedAppearance, FRICTION_RANGE, MassMap, PhysicalProperties,
    PropertyEstimator, PropertyQuery, PropertySource, builtin_appearances, estimate, map_masses,
    oriented_size_m, visible_friction, visible_friction_of_image,
};
use gripcast_base::error::{Error, Result};
use gripcast_base::files::{BeneathPath, FileName, Root, SimulationId};
use gripcast_base::random::SeedStream;
use gripcast_base::workers::par_map_single_threaded;
use gripcast_geometry::{MassProperties, TriangleMesh, ply_bytes};
use gripcast_sim::fem::GelPad;
use gripcast_sim::{Engine, EngineKind};

/// Seeds in files are below 2⁵³ so that every JSON reader preserves them.
const SEED_BITS: u32 = 53;
/// Plausible longest side of an object, m; other sizes usually mean a wrong unit.
const SIZE_M: [f64; 2] = [0.005, 0.5];
/// Estimated CPU time of a finite-element grasp, s: a constant and the cost per gel node, as
/// measured for grasps of the built-in families with coarse gels.
const FEM_BASE_S: f64 = 0.2;
const FEM_S_PER_NODE: f64 = 1.7e-3;
/// The same for a colour image (a constant and the cost per sample per pixel), a pair of tactile
/// images, and a rigid-body grasp.
const VISUAL_S: f64 = 0.25;
const VISUAL_S_PER_SAMPLE: f64 = 0.06;
const TACTILE_S: f64 = 0.06;
const RIGID_S: f64 = 0.1;

/// Default of [`PlanSettings::min_friction_fraction`]: dusty, greasy and worn surfaces.
pub const MIN_FRICTION_FRACTION: f64 = 0.25;

/// Settings of a new plan.
#[derive(Clone, Debug)]
pub struct PlanSettings {
    /// Name of the preset.
    pub preset: String,
    /// Random seed.
    pub seed: u64,
    /// Grasps of each object.
    pub grasps: usize,
    /// Forces at which each grasp is simulated, N.
    pub stop_forces_n: Vec<f64>,
    /// How images are rendered.
    pub rendering: RenderingPlan,
    /// User textures for objects without appearances of their own.
    pub textures: Vec<TextureDraft>,
    /// How estimated masses are mapped to the range of the paper's objects (A.1).
    pub mass_map: MassMap,
    /// What the friction of an object follows from.
    pub friction_from: FrictionFrom,
    /// Minimum fraction of a clean surface's friction with [`FrictionFrom::Soiled`]: the table of
    /// materials lists clean and dry surfaces.
    pub min_friction_fraction: f64,
    /// Objects that are processed in parallel; the plan does not depend on it.
    pub jobs: usize,
}

/// A new plan with its files, not written yet.
#[derive(Clone, Debug, PartialEq)]
pub struct PlanBundle {
    /// The plan.
    pub plan: Plan,
    /// Objects that were left out.
    pub left_out: Vec<LeftOutObject>,
    /// Mesh files of the plan.
    meshes: BTreeMap<FileName, TriangleMesh>,
    /// Texture files of the plan.
    textures: BTreeMap<FileName, TextureDraft>,
}

impl PlanBundle {
    /// Writes the plan and its files into a folder, which is created if necessary. The folder may
    /// already contain the same plan.
    ///
    /// # Errors
    /// `Input` if the folder contains another plan, or an image changed meanwhile; I/O errors.
    pub fn write(&self, folder: &Path) -> Result<()> {
        fs::create_dir_all(folder)
            .map_err(|e| Error::io("cannot create the folder", e).at(folder.display()))?;
        let root = Root::new(folder);
        self.plan.check_output(&root)?;
        if !self.meshes.is_empty() {
            let meshes = created(root.top().join(MESHES))?;
            for (name, mesh) in &self.meshes {
                replace(&meshes.join(name), &ply_bytes(mesh))?;
            }
        }
        if !self.textures.is_empty() {
            let textures = created(root.top().join(TEXTURES))?;
            for (name, texture) in &self.textures {
                replace(&textures.join(name), &texture.read()?)?;
            }
        }
        // Last: a plan that exists is complete.
        self.plan.write(&root)
    }
}

fn created(folder: BeneathPath) -> Result<BeneathPath> {
    match folder.create_dir_all() {
        Ok(()) => Ok(folder),
        Err(e) => Err(Error::io("cannot create the folder", e).at(folder.display())),
    }
}

/// Creates a plan. The same input gives the same plan on any number of threads.
///
/// # Errors
/// `Input` if no object can be grasped or two have the same name; errors of the estimator.
pub fn make_plan(
    settings: &PlanSettings,
    drafts: Drafts,
    engine: &dyn Engine,
    estimator: Option<&mut PropertyEstimator>,
    on_progress: &(dyn Fn(usize) + Sync),
) -> Result<PlanBundle> {
    let Drafts {
        drafts,
        mut left_out,
    } = drafts;
    check_names(&drafts)?;
    let analyse = |draft: &ObjectDraft| Ok(analysed(draft, settings, engine.pad()));
    let analyses = par_map_single_threaded(settings.jobs, &drafts, &analyse, on_progress)?;
    let mut kept = Vec::new();
    for (draft, analysis) in drafts.into_iter().zip(analyses) {
        match analysis {
            Ok(analysis) => kept.push((draft, analysis)),
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
    let (objects, frictions) = planned_objects(&kept, settings, estimator)?;
    let simulations = simulations(&kept, &frictions, settings, engine)?;
    let header = PlanHeader {
        format: PLAN_FORMAT.to_owned(),
        version: PLAN_VERSION,
        software: concat!("gripcast ", env!("CARGO_PKG_VERSION")).to_owned(),
        preset: settings.preset.clone(),
        seed: settings.seed,
        engine: engine.kind(),
        parameters: engine.parameters()?,
        rendering: settings.rendering,
        friction_from: settings.friction_from,
    };
    let plan = Plan::new(header, objects, simulations)?;
    let (meshes, textures) = files(kept, settings, &plan);
    Ok(PlanBundle {
        plan,
        left_out,
        meshes,
        textures,
    })
}

/// Returns the mesh and texture files of a plan.
fn files(
    kept: Vec<(ObjectDraft, Analysis)>,
    settings: &PlanSettings,
    plan: &Plan,
) -> (
    BTreeMap<FileName, TriangleMesh>,
    BTreeMap<FileName, TextureDraft>,
) {
    let used: BTreeSet<&FileName> = plan
        .objects
        .values()
        .flat_map(|object| &object.textures)
        .map(|texture| &texture.file)
        .collect();
    let own = kept.iter().flat_map(|(draft, _)| &draft.textures);
    let textures = own
        .chain(&settings.textures)
        .filter(|texture| used.contains(&texture.planned.file))
        .map(|texture| (texture.planned.file.clone(), texture.clone()))
        .collect();
    let mesh = |(draft, _): (ObjectDraft, Analysis)| match draft.source {
        MeshSource::File { file } => Some((file, draft.mesh)),
        MeshSource::Family { .. } => None,
    };
    (kept.into_iter().filter_map(mesh).collect(), textures)
}

/// Geometry and grasps of one object.
struct Analysis {
    selection: GraspSelection,
    volume_m3: f64,
    size_m: f64,
}

fn analysed(draft: &ObjectDraft, settings: &PlanSettings, pad: GelPad) -> Result<Analysis> {
    let volume_m3 = MassProperties::from_mesh(&draft.mesh)?.volume_m3;
    let [size_m, ..] = oriented_size_m(&draft.mesh)?;
    if !(SIZE_M[0]..=SIZE_M[1]).contains(&size_m) {
        let what = format!(
            "the object is {size_m:.3e} m large, expected {} to {} m",
            SIZE_M[0], SIZE_M[1]
        );
        return Err(Error::input(what).remedy("check its unit and scale"));
    }
    let (name, count, seed) = (&draft.name, settings.grasps, settings.seed);
    for force_n in &settings.stop_forces_n {
        simulation_id(name, count, *force_n)?;
    }
    let selection = match &draft.grasps {
        Some(given) => select_given_grasps(name, &draft.mesh, given, count, seed)?,
        None => sample_grasps(name, &draft.mesh, pad, count, seed)?,
    };
    if selection.grasps.is_empty() {
        return Err(Error::input(no_grasp(&selection)));
    }
    Ok(Analysis {
        selection,
        volume_m3,
        size_m,
    })
}

fn no_grasp(selection: &GraspSelection) -> String {
    let collisions = selection.collisions.iter();
    let most_frequent = collisions.max_by_key(|(_, count)| **count);
    let collisions = most_frequent.map_or(String::new(), |(part, count)| {
        format!(", {count} collide with the {part}")
    });
    format!(
        "no grasp found: {} candidates without antipodal contacts{collisions}",
        selection.without_antipodal_pair
    )
}

fn check_names(drafts: &[ObjectDraft]) -> Result<()> {
    let mut names = BTreeSet::new();
    match drafts.iter().find(|draft| !names.insert(&draft.name)) {
        Some(duplicate) => Err(Error::input(format!(
            "two objects are named {}",
            duplicate.name
        ))),
        None => Ok(()),
    }
}

/// Returns the objects with mass, friction and appearances, and the friction of each appearance and
/// texture of an object; none of them where the object has one friction.
fn planned_objects(
    kept: &[(ObjectDraft, Analysis)],
    settings: &PlanSettings,
    mut estimator: Option<&mut PropertyEstimator>,
) -> Result<(Vec<PlannedObject>, Vec<Vec<f64>>)> {
    let mut objects = Vec::with_capacity(kept.len());
    let mut all_frictions = Vec::with_capacity(kept.len());
    for (draft, analysis) in kept {
        let seed = SeedStream::named(settings.seed, &format!("object {}", draft.name)).bits();
        let appearances = appearances(draft, seed, estimator.as_deref_mut())?;
        let physical = physical(
            draft,
            analysis,
            &appearances,
            seed,
            estimator.as_deref_mut(),
        )?;
        let textures = textures(draft, seed, settings);
        let frictions = match settings.friction_from {
            FrictionFrom::Material if draft.friction.is_none() => {
                let mut frictions = Vec::new();
                for appearance in &appearances {
                    let query = PropertyQuery {
                        size_m: analysis.size_m,
                        volume_m3: analysis.volume_m3,
                        ..query(draft, &appearance.description, seed)
                    };
                    frictions.push(appearance_friction(
                        appearance,
                        &query,
                        estimator.as_deref_mut(),
                    )?);
                }
                let image = visible_friction_of_image(&draft.category, draft.material);
                frictions.extend(textures.iter().map(|_| rounded(image, 1e4)));
                frictions
            }
            FrictionFrom::Material | FrictionFrom::Soiled => Vec::new(),
        };
        let mean = frictions.iter().sum::<f64>() / frictions.len() as f64;
        let friction = draft
            .friction
            .unwrap_or_else(|| match frictions.is_empty() {
                true => contaminated_friction(&physical, settings.min_friction_fraction, seed),
                false => mean,
            });
        all_frictions.push(frictions);
        objects.push(PlannedObject {
            name: draft.name.clone(),
            category: draft.category.clone(),
            mesh: draft.source.clone(),
            mesh_sha256: draft.mesh.content_hash(),
            material: draft.material.name.clone(),
            mass_kg: physical.mass_kg,
            friction,
            properties: physical.source,
            textures: textures
                .into_iter()
                .map(|texture| texture.planned.clone())
                .collect(),
            appearances,
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
    // Short decimals, without the last bits of a logarithm.
    for object in &mut objects {
        object.mass_kg = rounded(object.mass_kg, 1e6);
        object.friction = rounded(object.friction, 1e4);
    }
    Ok((objects, all_frictions))
}

/// Returns the friction of an appearance on an object: that of the language model for "*texture
/// category*", if there is one, else [`visible_friction`].
fn appearance_friction(
    appearance: &DescribedAppearance,
    query: &PropertyQuery<'_>,
    estimator: Option<&mut PropertyEstimator>,
) -> Result<f64> {
    let asked = estimator.map(|estimator| estimator.physical(query));
    let friction = match asked.transpose()? {
        Some(found) if matches!(found.source, PropertySource::Llm { .. }) => found.friction,
        _ => visible_friction(query.category, &appearance.appearance),
    };
    Ok(rounded(friction, 1e4))
}

/// Reduces the friction of a clean surface by dust, grease and wear.
fn contaminated_friction(physical: &PhysicalProperties, min_fraction: f64, seed: u64) -> f64 {
    if matches!(physical.source, PropertySource::Llm { .. }) {
        return physical.friction;
    }
    let fraction = SeedStream::named(seed, "surface").between(min_fraction, 1.0);
    let [low, high] = FRICTION_RANGE;
    (fraction * physical.friction).clamp(low, high)
}

fn rounded(value: f64, per_unit: f64) -> f64 {
    (value * per_unit).round() / per_unit
}

fn appearances(
    draft: &ObjectDraft,
    seed: u64,
    estimator: Option<&mut PropertyEstimator>,
) -> Result<Vec<DescribedAppearance>> {
    if !draft.appearances.is_empty() || !draft.textures.is_empty() {
        return Ok(draft.appearances.clone());
    }
    match estimator {
        Some(estimator) => estimator.appearances(&query(draft, "", seed)),
        None => Ok(builtin_appearances(&draft.name, draft.material, seed)),
    }
}

/// Textures of an object: its own, or as many drawn from the user's as it has appearances.
fn textures<'a>(
    draft: &'a ObjectDraft,
    seed: u64,
    settings: &'a PlanSettings,
) -> Vec<&'a TextureDraft> {
    if !draft.appearances.is_empty() || !draft.textures.is_empty() {
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
    analysis: &Analysis,
    appearances: &[DescribedAppearance],
    seed: u64,
    estimator: Option<&mut PropertyEstimator>,
) -> Result<PhysicalProperties> {
    if let (Some(mass_kg), Some(friction)) = (draft.mass_kg, draft.friction) {
        return Ok(PhysicalProperties {
            mass_kg,
            friction,
            source: PropertySource::Given,
        });
    }
    let mut found = match estimator {
        Some(estimator) => {
            let texture = appearances.first().map_or("", |first| &first.description);
            estimator.physical(&PropertyQuery {
                size_m: analysis.size_m,
                volume_m3: analysis.volume_m3,
                ..query(draft, texture, seed)
            })?
        }
        None => estimate(
            &draft.category,
            draft.material,
            analysis.volume_m3,
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
    kept: &[(ObjectDraft, Analysis)],
    frictions: &[Vec<f64>],
    settings: &PlanSettings,
    engine: &dyn Engine,
) -> Result<Vec<PlannedSimulation>> {
    let cost_s = cost_s(settings, engine)?;
    let mut all = Vec::new();
    for ((draft, analysis), frictions) in kept.iter().zip(frictions) {
        for (number, grasp) in analysis.selection.grasps.iter().enumerate() {
            // One appearance per grasp, at all forces.
            let name = format!("appearance {} {number}", draft.name);
            let mut draw = SeedStream::named(settings.seed, &name);
            let appearance = (!frictions.is_empty()).then(|| draw.index(frictions.len()));
            for force_n in &settings.stop_forces_n {
                let id = simulation_id(&draft.name, number, *force_n)?;
                // Independent of the engine: both engines get images under the same conditions.
                let seed = SeedStream::named(settings.seed, &format!("pictures {id}")).bits();
                all.push(PlannedSimulation {
                    id,
                    object: draft.name.clone(),
                    grasp: number as u32,
                    fault: grasp.fault,
                    acronym_grasp: grasp.given.map(|given| given.number as u32),
                    acronym_stable: grasp.given.map(|given| given.stable),
                    engine: engine.kind(),
                    stop_force_n: *force_n,
                    t_world_object: grasp.t_world_object,
                    t_world_gripper: grasp.placed.t_world_gripper,
                    opening_m: grasp.placed.opening_m,
                    seed: seed >> (u64::BITS - SEED_BITS),
                    appearance: appearance.map(|index| index as u32),
                    friction: appearance.and_then(|index| frictions.get(index).copied()),
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

/// Estimates the CPU time of a simulation with its images, s.
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
        samples_per_pixel,
        ..
    } = settings.rendering;
    let image = TACTILE_S + VISUAL_S + VISUAL_S_PER_SAMPLE * f64::from(samples_per_pixel);
    Ok(simulate + f64::from(renderings) * image)
}

/// Checks that an engine has the parameters that a plan was created with.
///
/// # Errors
/// `Input` with the first parameter that differs.
pub fn check_parameters(plan: &Plan, engine: &dyn Engine) -> Result<()> {
    let now = engine.parameters()?;
    match difference("", &plan.header.parameters, &now) {
        None => Ok(()),
        Some((name, planned, now)) => Err(Error::input(format!(
            "the plan was created with {name} = {planned}, this build has {now}"
        ))
        .remedy(format!(
            "run it with {}, or create a new plan",
            plan.header.software
        ))),
    }
}

/// Finds the first difference of two JSON values: its path and both values.
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
