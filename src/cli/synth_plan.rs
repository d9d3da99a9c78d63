//! `gripcast synth plan`: plans the simulations of a dataset.
//!
//! The same options give the same plan, byte for byte. Exit codes: 0 plan written · 1 failed ·
//! 2 usage · 3 written, but objects were left out · 130 interrupted.

use std::path::{Path, PathBuf};

use serde_json::json;

use super::flags::{JobsFlag, above_zero, engine, gel_resolution, named, number, preset};
use super::working::{Progress, interruptible};
use super::{Context, print, print_json};
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_base::number::NumberRange;
use gripcast_sim::fem::GelResolution;
use gripcast_sim::grasp::{GraspSettings, Preset};
use gripcast_sim::rigid::{RigidEngine, RigidSettings};
use gripcast_sim::{Engine, EngineKind, FemEngine};
use gripcast_synth::plan::{
    Drafts, FrictionFrom, MIN_FRICTION_FRACTION, PlanBundle, PlanPreset, PlanSettings,
    RenderingPlan, acronym_drafts, family_drafts, load_textures, make_plan, table_drafts,
};
use gripcast_synth::properties::{
    DEFAULT_KEY_VARIABLE, EndpointKey, LlmClient, LlmOptions, MassMap, PropertyEstimator,
};
use gripcast_tactile::SensorName;

/// Scales of randomisation.
const SPREAD: NumberRange = NumberRange::between(0.0, 3.0);

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct Args {
    /// Size of the plan
    #[arg(long, value_name = "SIZE", default_value = "small", value_parser = named([
        ("tiny", "10 objects, 2 grasps each: a smoke test", PlanPreset::TINY),
        ("small", "60 objects, 6 grasps each", PlanPreset::SMALL),
        ("full", "453 objects, 24 grasps each, as in the paper", PlanPreset::FULL),
    ]))]
    preset: PlanPreset,
    /// Output directory of the plan and its results
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Random seed
    #[arg(long, value_name = "SEED", default_value_t = 0)]
    seed: u64,
    #[command(flatten)]
    jobs: JobsFlag,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    simulation: Simulation,
    #[command(flatten)]
    rendering: Rendering,
    #[command(flatten)]
    objects: Objects,
    #[command(flatten)]
    llm: Llm,
}

/// Simulation settings.
#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "Simulation")]
struct Simulation {
    /// Grasps per object [default: from the preset]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=10_000))]
    grasps: Option<u32>,
    /// Simulation engine
    #[arg(long, value_name = "ENGINE", default_value = "fem", value_parser = engine())]
    engine: EngineKind,
    /// Stopping forces at which each grasp is simulated, comma-separated
    #[arg(long, value_name = "NEWTON", value_delimiter = ',', default_values_t = [10.0, 40.0],
        value_parser = above_zero)]
    stop_force_n: Vec<f64>,
    /// Gel mesh [default: coarse for the preset tiny, else default]
    #[arg(long, value_name = "MESH", value_parser = gel_resolution())]
    gel: Option<GelResolution>,
    /// Gel parameters
    #[arg(long, value_name = "PRESET", default_value = "paper", value_parser = preset())]
    gel_preset: Preset,
    /// Newton iteration limit per simulation
    #[arg(long, value_name = "N", default_value_t = 50_000,
        value_parser = clap::value_parser!(u64).range(1..))]
    max_iterations: u64,
    /// Simulate every lift to its end, also when the outcome is certain
    #[arg(long)]
    full_lift: bool,
}

/// Rendering settings.
#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "Rendering")]
struct Rendering {
    /// Renderings per simulation [default: from the preset]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=100))]
    renderings: Option<u32>,
    /// Samples per pixel of a colour image [default: from the preset]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=4096))]
    spp: Option<u32>,
    /// Randomisation of the tactile sensors: 0 = shipped profile, 1 = as real sensors vary
    #[arg(long, value_name = "SCALE", default_value_t = 1.0,
        value_parser = number(SPREAD))]
    sensor_spread: f64,
    /// Randomisation of camera pose, lens and light: 0 = nominal, 1 = full range
    #[arg(long, value_name = "SCALE", default_value_t = 1.0,
        value_parser = number(SPREAD))]
    visual_spread: f64,
    /// Sensor profile: gelsight-mini, gelsight-mini-markers, …
    #[arg(long, value_name = "NAME", default_value = "gelsight-mini",
        value_parser = SensorName::by_name)]
    sensor: SensorName,
}

/// Objects and their properties.
#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "Objects")]
struct Objects {
    /// Number of procedural objects [default: from the preset; 0 with --table or --acronym]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(0..=100_000))]
    objects: Option<u32>,
    /// Table of objects beside their meshes (docs/how-to/synth.md)
    #[arg(long, value_name = "FILE")]
    table: Option<PathBuf>,
    /// Folder of ACRONYM grasps (.h5)
    #[arg(long, value_name = "DIR", requires = "meshes")]
    acronym: Option<PathBuf>,
    /// Root folder of the ACRONYM meshes
    #[arg(long, value_name = "DIR", requires = "acronym")]
    meshes: Option<PathBuf>,
    /// Number of ACRONYM objects to draw [default: all]
    #[arg(long, value_name = "N", requires = "acronym",
        value_parser = clap::value_parser!(u32).range(1..))]
    acronym_objects: Option<u32>,
    /// Directory of texture images
    #[arg(long, value_name = "DIR")]
    textures: Option<PathBuf>,
    /// Width of a texture image on an object
    #[arg(long, value_name = "M", default_value_t = 0.1, value_parser = above_zero)]
    texture_width_m: f64,
    /// Mapping of estimated masses to 10–200 g; given masses are kept
    #[arg(long, value_name = "MAP", default_value = "log", value_parser = named([
        ("linear", "Linear, as in the paper", MassMap::Linear),
        ("log", "Logarithmic: spreads light objects over the range", MassMap::Logarithmic),
        ("none", "Keep estimated masses", MassMap::None),
    ]))]
    mass_map: MassMap,
    /// What the friction of an object follows from; given friction is kept
    #[arg(long, value_name = "SOURCE", default_value = "soiled", value_parser = named([
        ("material", "Category and appearance alone, so that a camera can see it, as in the paper",
            FrictionFrom::Material),
        ("soiled", "Material and contamination, which no image shows", FrictionFrom::Soiled),
    ]))]
    friction_from: FrictionFrom,
    /// Minimum friction of a contaminated surface, as a fraction of the clean, dry one; with
    /// --friction-from soiled and the material table only [default: 0.25]
    #[arg(long, value_name = "FRACTION", value_parser = number(NumberRange::above(0.0, 1.0)))]
    min_friction_fraction: Option<f64>,
}

/// Language model that estimates masses, friction and appearances.
#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "Language model")]
struct Llm {
    /// OpenAI-compatible endpoint, such as http://localhost:11434/v1 [default: none, use the
    /// built-in material table]
    #[arg(long, value_name = "URL", requires = "llm_model")]
    llm_url: Option<String>,
    /// Model name at the endpoint
    #[arg(long, value_name = "NAME", requires = "llm_url")]
    llm_model: Option<String>,
    /// Environment variable with the API key
    #[arg(long, value_name = "NAME", default_value = DEFAULT_KEY_VARIABLE)]
    llm_key_variable: String,
    /// Fall back to the material table if the endpoint fails; recorded in the plan
    #[arg(long, requires = "llm_url")]
    llm_fallback: bool,
    /// Cache directory of the answers [default: ~/.cache/gripcast/llm]
    #[arg(long, value_name = "DIR", requires = "llm_url")]
    llm_cache: Option<PathBuf>,
}

/// Runs the command.
pub(super) fn run(context: &Context, args: Args) -> Result<()> {
    let (out, is_json) = (args.out.clone(), args.json);
    let made = interruptible(context, "planning", move |progress| {
        let made = args.make(progress)?;
        made.write(&args.out)?;
        Ok::<PlanBundle, Error>(made)
    })??;
    let (plan, left_out) = (&made.plan, &made.left_out);
    let cost_h = plan.simulations.iter().map(|s| s.cost_s).sum::<f64>() / 3600.0;
    if is_json {
        print_json(&json!({
            "plan": out,
            "sha256": plan.sha256,
            "objects": plan.objects.len(),
            "simulations": plan.simulations.len(),
            "estimated_cpu_h": cost_h,
            "left_out": left_out
                .iter()
                .map(|one| json!({"object": one.name, "reason": one.reason}))
                .collect::<Vec<_>>(),
        }))?;
    } else {
        print(&format!(
            "{} simulations of {} objects, about {cost_h:.1} CPU hours; plan {}",
            plan.simulations.len(),
            plan.objects.len(),
            &plan.sha256[..12],
        ))?;
    }
    if left_out.is_empty() {
        return Ok(());
    }
    let mut text = format!("{} objects were left out of the plan:", left_out.len());
    for one in left_out {
        text.push_str(&format!("\n  {}: {}", one.name, one.reason));
    }
    Err(Error::new(ErrorKind::Partial, text))
}

impl Args {
    fn make(&self, progress: &Progress) -> Result<PlanBundle> {
        let preset = self.preset;
        let Self {
            simulation,
            rendering,
            objects,
            ..
        } = self;
        let defaults = preset.rendering;
        let jobs = self.jobs.count();
        let textures = match &objects.textures {
            None => Vec::new(),
            Some(folder) => load_textures(folder, objects.texture_width_m)?,
        };
        let settings = PlanSettings {
            preset: preset.name.to_owned(),
            seed: self.seed,
            grasps: simulation.grasps.map_or(preset.grasps, |n| n as usize),
            stop_forces_n: simulation.stop_force_n.clone(),
            rendering: RenderingPlan {
                renderings: rendering.renderings.unwrap_or(defaults.renderings),
                samples_per_pixel: rendering.spp.unwrap_or(defaults.samples_per_pixel),
                sensor_spread: rendering.sensor_spread,
                visual_spread: rendering.visual_spread,
                sensor: rendering.sensor,
            },
            textures,
            mass_map: objects.mass_map,
            friction_from: objects.friction_from,
            min_friction_fraction: objects.min_friction_fraction()?,
            jobs,
        };
        let drafts = self.drafts(jobs, progress)?;
        let count = drafts.drafts.len();
        progress.stage("drawing grasps");
        let on_progress = |done: usize| progress.count(done, count);
        let mut asker = self.llm.asker(&self.out)?;
        let engine = self.engine();
        make_plan(
            &settings,
            drafts,
            engine.as_ref(),
            asker.as_mut(),
            &on_progress,
        )
    }

    /// Generates or reads the objects of all sources.
    fn drafts(&self, jobs: usize, progress: &Progress) -> Result<Drafts> {
        let Objects {
            objects,
            table,
            acronym,
            meshes,
            acronym_objects,
            ..
        } = &self.objects;
        progress.stage("generating objects");
        let mut all = Drafts::default();
        if let Some(table) = table {
            all.extend(table_drafts(table, self.seed)?);
        }
        if let (Some(grasps), Some(meshes)) = (acronym, meshes) {
            let limit = acronym_objects.map(|n| n as usize);
            all.extend(acronym_drafts(grasps, meshes, limit, self.seed)?);
        }
        let default = if table.is_some() || acronym.is_some() {
            0
        } else {
            self.preset.objects
        };
        let count = objects.map_or(default, |n| n as usize);
        let on_progress = |done: usize| progress.count(done, count);
        let drafts = family_drafts(count, self.seed, jobs, &on_progress)?;
        all.drafts.extend(drafts);
        Ok(all)
    }

    fn engine(&self) -> Box<dyn Engine> {
        let flags = &self.simulation;
        match flags.engine {
            EngineKind::Fem => {
                let mut settings = GraspSettings::new(flags.gel_preset);
                settings.resolution = flags.gel.unwrap_or(self.preset.gel);
                settings.solver.max_grasp_iterations = flags.max_iterations;
                settings.protocol.early_end = !flags.full_lift;
                Box::new(FemEngine { settings })
            }
            EngineKind::Rigid => Box::new(RigidEngine::new(RigidSettings::default())),
        }
    }
}

impl Objects {
    /// Returns the minimum friction fraction, which has no effect without contamination.
    fn min_friction_fraction(&self) -> Result<f64> {
        match (self.friction_from, self.min_friction_fraction) {
            (FrictionFrom::Material, Some(_)) => Err(Error::usage(
                "--min-friction-fraction has no effect with --friction-from material: surfaces are \
                 clean",
            )
            .remedy("omit one of them")),
            (_, given) => Ok(given.unwrap_or(MIN_FRICTION_FRACTION)),
        }
    }
}

impl Llm {
    fn asker(&self, plan_folder: &Path) -> Result<Option<PropertyEstimator>> {
        let (Some(url), Some(model)) = (&self.llm_url, &self.llm_model) else {
            return Ok(None);
        };
        let cache = self
            .llm_cache
            .clone()
            .or_else(default_cache)
            .unwrap_or_else(|| plan_folder.join("llm"));
        let mut options = LlmOptions::new(url, model, cache);
        options.key = EndpointKey::from_env(&self.llm_key_variable)?;
        let client = LlmClient::new(options)?;
        Ok(Some(PropertyEstimator::new(client, self.llm_fallback)))
    }
}

/// Returns the cache folder of the XDG base directories.
fn default_cache() -> Option<PathBuf> {
    let set = |name| std::env::var_os(name).filter(|value| !value.is_empty());
    let cache = set("XDG_CACHE_HOME").map(PathBuf::from);
    let cache = cache.or_else(|| set("HOME").map(|home| PathBuf::from(home).join(".cache")));
    cache.map(|cache| cache.join("gripcast").join("llm"))
}
