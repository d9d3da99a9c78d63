//! Mass, friction and appearance of objects.
//!
//! There are two sources: an embedded table of materials, and the paper's prompts (A.1) to a
//! language model behind an OpenAI-compatible endpoint. Physical properties carry their source.

mod appearance;
mod bounding_box;
mod llm;
mod material;
mod physical;
mod surface;
mod visible_friction;
mod words;

pub use appearance::{APPEARANCES, DescribedAppearance, builtin_appearances};
pub use bounding_box::oriented_size_m;
pub use llm::{
    DEFAULT_KEY_VARIABLE, EndpointKey, LlmClient, LlmOptions, PropertyEstimator, PropertyQuery,
    Wait, physical_prompt, texture_prompt,
};
pub use material::Material;
pub use physical::{
    FRICTION_RANGE, MASS_RANGE_KG, MAX_MASS_KG, MassMap, PhysicalProperties, PropertySource,
    estimate, map_masses,
};
pub use visible_friction::{visible_friction, visible_friction_of_image};
