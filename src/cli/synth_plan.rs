//! `gripcast synth plan`: what is to be simulated.
//!
//! The same flags give the same plan, byte for byte. Exit codes: 0 a plan was written · 1 it could
//! not be · 2 usage · 3 objects were left out of it, each with its reason · 130 interrupted.

use std::path::{Path, PathBuf};

use serde_json::json;

use super::sim_grasp::{GelName, PresetName, above_zero};
use super::working::{Progress, interruptible};
use super::{Context, print, print_json};
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_base::workers::cores;
use gripcast_sim::fem::GelResolution;
use gripcast_sim::grasp::GraspSettings;
use gripcast_sim::rigid::{RigidEngine, RigidSettings};
use gripcast_sim::{Engine, FemEngine};
use gripcast_synth::plan::{
    Drafts, MIN_FRICTION_FRACTION, PlanBundle, PlanPreset, PlanSettings, RenderingPlan,
    acronym_drafts, family_drafts, load_textures, make_plan, table_drafts,
};
use gripcast_synth::properties::{
    DEFAULT_KEY_VARIABLE, EndpointKey, LlmClient, LlmOptions, MassMap, PropertyEstimator,
};

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct Args {
    /// Size of the plan
    #[arg(long, value_enum, default_value_t = PresetSize::Small)]
    preset: PresetSize,
    /// Folder of the plan and later of its results
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Everything that is drawn follows from it
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Objects of the built-in families [default: that of the preset, none beside --table or
    /// --acronym]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(0..=100_000))]
    objects: Option<u32>,
    #[command(flatten)]
    sources: Sources,
    #[command(flatten)]
    llm: Llm,
    /// Grasps of each object [default: that of the preset]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=10_000))]
    grasps: Option<u32>,
    /// Simulator
    #[arg(long, value_enum, default_value_t = EngineName::Fem)]
    engine: EngineName,
    /// Stopping forces at which each grasp is simulated
    #[arg(long, value_name = "N", value_delimiter = ',', default_values_t = [10.0, 40.0],
        value_parser = above_zero)]
    stop_force_n: Vec<f64>,
    /// Mesh of the gels [default: coarse for the preset tiny, else default]
    #[arg(long, value_enum)]
    gel: Option<GelName>,
    /// Set of parameters of the finite elements
    #[arg(long, value_enum, default_value_t = PresetName::Paper)]
    gel_preset: PresetName,
    /// Iterations after which a simulation is given up
    #[arg(long, value_name = "N", default_value_t = 50_000,
        value_parser = clap::value_parser!(u64).range(1..))]
    max_iterations: u64,
    /// Renderings of each simulation [default: that of the preset]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=100))]
    renderings: Option<u32>,
    /// Paths for each pixel of a colour image
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=4096))]
    samples: Option<u32>,
    /// Spread of the tactile sensors: 0 the shipped profile, 1 as real ones differ
    #[arg(long, value_name = "S", default_value_t = 1.0)]
    sensor_spread: f64,
    /// Spread of the colour camera's place and lens and of the light: 0 the nominal ones, 1 as
    /// usual
    #[arg(long, value_name = "S", default_value_t = 1.0)]
    visual_spread: f64,
    /// How estimated masses become masses of 10 to 200 g; given ones stay
    #[arg(long, value_enum, default_value_t = MassMapName::Log)]
    mass_map: MassMapName,
    /// Fraction of a clean, dry surface's friction that the dirtiest keeps; for friction of the table
    #[arg(long, value_name = "S", default_value_t = MIN_FRICTION_FRACTION)]
    least_friction_fraction: f64,
    /// Objects at a time; the plan does not depend on it [default: all cores]
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=256))]
    jobs: Option<u16>,
    /// Print what was planned as JSON
    #[arg(long)]
    json: bool,
}

/// Objects and images of the user's.
#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "Objects of your own")]
struct Sources {
    /// Table of objects beside their meshes (docs/synth.md)
    #[arg(long, value_name = "FILE")]
    table: Option<PathBuf>,
    /// Folder of ACRONYM's grasps, `.h5` files
    #[arg(long, value_name = "DIR", requires = "meshes")]
    acronym: Option<PathBuf>,
    /// Folder that ACRONYM's mesh paths begin in
    #[arg(long, value_name = "DIR", requires = "acronym")]
    meshes: Option<PathBuf>,
    /// Objects drawn from those of ACRONYM [default: all]
    #[arg(long, value_name = "N", requires = "acronym",
        value_parser = clap::value_parser!(u32).range(1..))]
    acronym_objects: Option<u32>,
    /// Folder of images that objects may wear besides their built-in appearances
    #[arg(long, value_name = "DIR")]
    textures: Option<PathBuf>,
    /// Width of these images on an object, m
    #[arg(long, value_name = "M", default_value_t = 0.1, value_parser = above_zero)]
    texture_width_m: f64,
}

/// The language model that knows masses, friction and appearances.
#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "Properties from a language model")]
struct Llm {
    /// OpenAI-compatible endpoint, such as http://localhost:11434/v1 [default: none is asked; the
    /// built-in table of materials is used]
    #[arg(long, value_name = "URL", requires = "llm_model")]
    llm_url: Option<String>,
    /// Model at the endpoint
    #[arg(long, value_name = "NAME", requires = "llm_url")]
    llm_model: Option<String>,
    /// Environment variable with the endpoint's key
    #[arg(long, value_name = "NAME", default_value = DEFAULT_KEY_VARIABLE)]
    llm_key_variable: String,
    /// Use the table of materials where the endpoint does not answer; the plan says where
    #[arg(long, requires = "llm_url")]
    llm_fallback: bool,
    /// Folder of answers that are not asked for again [default: ~/.cache/gripcast/llm]
    #[arg(long, value_name = "DIR", requires = "llm_url")]
    llm_cache: Option<PathBuf>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum PresetSize {
    /// 10 objects, 2 grasps each: to see that it works
    Tiny,
    /// 60 objects, 6 grasps each
    Small,
    /// 453 objects, 24 grasps each, as in the paper
    Full,
}

impl From<PresetSize> for PlanPreset {
    fn from(size: PresetSize) -> Self {
        match size {
            PresetSize::Tiny => Self::TINY,
            PresetSize::Small => Self::SMALL,
            PresetSize::Full => Self::FULL,
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum EngineName {
    /// Finite-element gels, incremental potential contact
    Fem,
    /// Rigid fingers and convex pieces
    Rigid,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum MassMapName {
    /// As in the paper
    Linear,
    /// By their logarithm: light things are spread over the range
    Log,
    /// As estimated
    None,
}

impl From<MassMapName> for MassMap {
    fn from(name: MassMapName) -> Self {
        match name {
            MassMapName::Linear => Self::Linear,
            MassMapName::Log => Self::Logarithmic,
            MassMapName::None => Self::None,
        }
    }
}

/// Runs the verb.
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
    let mut text = format!("{} objects are not in the plan:", left_out.len());
    for one in left_out {
        text.push_str(&format!("\n  {}: {}", one.name, one.reason));
    }
    Err(Error::new(ErrorKind::Partial, text))
}

impl Args {
    fn make(&self, progress: &Progress) -> Result<PlanBundle> {
        let preset = PlanPreset::from(self.preset);
        for (flag, spread) in [
            ("--sensor-spread", self.sensor_spread),
            ("--visual-spread", self.visual_spread),
        ] {
            if !(0.0..=3.0).contains(&spread) {
                return Err(Error::usage(format!(
                    "`{flag}` must be from 0 to 3, found {spread}"
                )));
            }
        }
        if !(self.least_friction_fraction > 0.0 && self.least_friction_fraction <= 1.0) {
            return Err(Error::usage(format!(
                "`--least-friction-fraction` must be above 0 and at most 1, found {}",
                self.least_friction_fraction
            )));
        }
        let of_preset = preset.rendering;
        let jobs = self.jobs.map_or_else(cores, usize::from);
        let textures = match &self.sources.textures {
            None => Vec::new(),
            Some(folder) => load_textures(folder, self.sources.texture_width_m)?,
        };
        let settings = PlanSettings {
            preset: preset.name.to_owned(),
            seed: self.seed,
            grasps: self.grasps.map_or(preset.grasps, |n| n as usize),
            stop_forces_n: self.stop_force_n.clone(),
            rendering: RenderingPlan {
                renderings: self.renderings.unwrap_or(of_preset.renderings),
                samples_per_pixel: self.samples.unwrap_or(of_preset.samples_per_pixel),
                sensor_spread: self.sensor_spread,
                visual_spread: self.visual_spread,
            },
            textures,
            mass_map: self.mass_map.into(),
            min_friction_fraction: self.least_friction_fraction,
            jobs,
        };
        let drafts = self.drafts(preset, jobs, progress)?;
        let count = drafts.drafts.len() as u64;
        progress.stage("drawing grasps");
        let told = |done: usize| progress.at(done as u64, count);
        let mut asker = self.llm.asker(&self.out)?;
        let engine = self.engine();
        make_plan(&settings, drafts, engine.as_ref(), asker.as_mut(), &told)
    }

    /// Objects of all sources.
    fn drafts(&self, preset: PlanPreset, jobs: usize, progress: &Progress) -> Result<Drafts> {
        let Sources {
            table,
            acronym,
            meshes,
            acronym_objects,
            ..
        } = &self.sources;
        progress.stage("making objects");
        let mut all = Drafts::default();
        if let Some(table) = table {
            all.extend(table_drafts(table, self.seed)?);
        }
        if let (Some(grasps), Some(meshes)) = (acronym, meshes) {
            let most = acronym_objects.map(|n| n as usize);
            all.extend(acronym_drafts(grasps, meshes, most, self.seed)?);
        }
        let usual = if table.is_some() || acronym.is_some() {
            0
        } else {
            preset.objects
        };
        let count = self.objects.map_or(usual, |n| n as usize);
        let told = |done: usize| progress.at(done as u64, count as u64);
        all.drafts
            .extend(family_drafts(count, self.seed, jobs, &told)?);
        Ok(all)
    }

    fn engine(&self) -> Box<dyn Engine> {
        match self.engine {
            EngineName::Fem => {
                let mut settings = GraspSettings::new(self.gel_preset.into());
                let usual = PlanPreset::from(self.preset).gel;
                settings.resolution = self.gel.map_or(usual, GelResolution::from);
                settings.solver.max_grasp_iterations = self.max_iterations;
                Box::new(FemEngine { settings })
            }
            EngineName::Rigid => Box::new(RigidEngine::new(RigidSettings::default())),
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
            .or_else(usual_cache)
            .unwrap_or_else(|| plan_folder.join("llm"));
        let mut options = LlmOptions::new(url, model, cache);
        options.key = EndpointKey::from_env(&self.llm_key_variable)?;
        let client = LlmClient::new(options)?;
        Ok(Some(PropertyEstimator::new(client, self.llm_fallback)))
    }
}

/// Where programs of the desktop keep what can be had again (XDG base directories).
fn usual_cache() -> Option<PathBuf> {
    let set = |name| std::env::var_os(name).filter(|value| !value.is_empty());
    let cache = set("XDG_CACHE_HOME").map(PathBuf::from);
    let cache = cache.or_else(|| set("HOME").map(|home| PathBuf::from(home).join(".cache")));
    cache.map(|cache| cache.join("gripcast").join("llm"))
}
