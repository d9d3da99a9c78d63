//! Restores the simulator that a plan was made with.

use std::path::Path;

use serde::Deserialize as _;
use serde_json::Value;

use super::plan::{Plan, check_parameters};
use gripcast_base::error::{Error, Result};
use gripcast_base::files::Root;
use gripcast_sim::fem::{GelPad, GelResolution};
use gripcast_sim::grasp::{GraspSettings, Preset};
use gripcast_sim::rigid::{RigidEngine, RigidSettings};
use gripcast_sim::{Engine, EngineKind, FemEngine};

/// Folder of cached convex pieces beside the results.
const PIECES: &str = "convex-pieces";

/// Returns the engine of a plan; convex pieces are cached in `folder`.
///
/// # Errors
/// `Input` if this build has other parameters than the plan; errors of the folder.
pub fn planned_engine(plan: &Plan, folder: &Path) -> Result<Box<dyn Engine>> {
    let parameters = &plan.header.parameters;
    let engine: Box<dyn Engine> = match plan.header.engine {
        EngineKind::Fem => Box::new(FemEngine {
            settings: fem_settings(parameters)?,
        }),
        EngineKind::Rigid => {
            let settings: RigidSettings = serde_json::from_value(parameters.clone())
                .map_err(|e| unreadable("parameters").because(e))?;
            let pieces = Root::new(folder).top().join(PIECES);
            Box::new(RigidEngine::new(settings).with_cache(pieces)?)
        }
    };
    check_parameters(plan, engine.as_ref())?;
    Ok(engine)
}

fn fem_settings(parameters: &Value) -> Result<GraspSettings> {
    let preset = parameters["preset"].as_str();
    let preset = Preset::ALL.into_iter().find(|p| Some(p.name()) == preset);
    let mut settings = GraspSettings::new(preset.ok_or_else(|| unreadable("preset"))?);
    let mesh = parameters["gel"]["mesh"].as_str();
    settings.resolution = GelResolution::from_name(mesh.ok_or_else(|| unreadable("gel.mesh"))?)?;
    if let Some(pad) = parameters["gel"].get("pad") {
        settings.pad = GelPad::deserialize(pad).map_err(|e| unreadable("gel.pad").because(e))?;
    }
    settings.solver.max_grasp_iterations = parameters["solver"]["max_grasp_iterations"]
        .as_u64()
        .ok_or_else(|| unreadable("solver.max_grasp_iterations"))?;
    settings.protocol.early_end = parameters["protocol"]["early_end"] == true;
    Ok(settings)
}

fn unreadable(name: &str) -> Error {
    Error::input(format!("cannot read `{name}` of the plan"))
        .remedy("make a new plan with this version of gripcast")
}
