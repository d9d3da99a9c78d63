//! What objects weigh, how they slide and what they look like.
//!
//! Two sources: an embedded table of materials, and the paper's prompts (A.1) to a language model
//! behind an OpenAI-compatible endpoint. Each value says which one it is from.

mod appearance;
mod bounding_box;
mod llm;
mod look;
mod material;
mod physical;
mod surface;
mod words;

pub use appearance::{APPEARANCES, builtin_appearances};
pub use bounding_box::oriented_size_m;
pub use llm::{
    Appearances, DEFAULT_KEY_VARIABLE, EndpointKey, LlmClient, LlmOptions, PropertyAsker,
    PropertyQuery, Wait, physical_prompt, texture_prompt,
};
pub use look::{Appearance, FinishClass, Modifier, SurfacePattern};
pub use material::Material;
pub use physical::{
    FRICTION_RANGE, MASS_RANGE_KG, MAX_MASS_KG, MassMap, PhysicalProperties, PropertySource,
    estimate, map_masses,
};
