//! The simulator that a plan was made with.

use std::path::Path;

use serde_json::Value;

use super::plan::{Plan, check_parameters};
use gripcast_base::error::{Error, Result};
use gripcast_base::files::Root;
use gripcast_sim::fem::GelResolution;
use gripcast_sim::grasp::{GraspSettings, Preset};
use gripcast_sim::rigid::{RigidEngine, RigidSettings};
use gripcast_sim::{Engine, EngineKind, FemEngine};

/// Folder of convex pieces beside the results.
const PIECES: &str = "convex-pieces";

/// The engine of a plan; convex pieces are kept in `folder`.
///
/// # Errors
/// `Input` where this build has other parameters than the plan; those of the folder.
pub fn planned_engine(plan: &Plan, folder: &Path) -> Result<Box<dyn Engine>> {
    let parameters = &plan.header.parameters;
    let engine: Box<dyn Engine> = match plan.header.engine {
        EngineKind::Fem => Box::new(FemEngine {
            settings: fem(parameters)?,
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

fn fem(parameters: &Value) -> Result<GraspSettings> {
    let text = |name: &'static str, value: &'_ Value| -> Result<String> {
        value
            .as_str()
            .map(str::to_owned)
            .ok_or_else(|| unreadable(name))
    };
    let preset = text("preset", &parameters["preset"])?;
    let preset = Preset::ALL.into_iter().find(|p| p.name() == preset);
    let mut settings = GraspSettings::new(preset.ok_or_else(|| unreadable("preset"))?);
    settings.resolution = GelResolution::from_name(&text("gel.mesh", &parameters["gel"]["mesh"])?)?;
    settings.solver.max_grasp_iterations = parameters["solver"]["max_grasp_iterations"]
        .as_u64()
        .ok_or_else(|| unreadable("solver.max_grasp_iterations"))?;
    Ok(settings)
}

fn unreadable(name: &str) -> Error {
    Error::input(format!("the plan's {name} cannot be read"))
        .remedy("make a new plan with this release")
}
