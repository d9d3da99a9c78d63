//! Plan presets, and drafts from the built-in families.

use super::{MeshSource, ObjectDraft, RenderingPlan};
use crate::family::{Category, family_shape};
use crate::properties::Material;
use gripcast_base::error::Result;
use gripcast_base::files::SimulationId;
use gripcast_base::random::SeedStream;
use gripcast_base::workers::par_map_single_threaded;
use gripcast_sim::fem::GelResolution;
use gripcast_tactile::SensorName;

/// Size of a plan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlanPreset {
    /// Name on the command line and in the plan.
    pub name: &'static str,
    /// Number of objects.
    pub objects: usize,
    /// Grasps of each object.
    pub grasps: usize,
    /// Mesh of the gels. Coarse gels hold some grasps that finer ones lose
    /// (docs/reference/performance.md).
    pub gel: GelResolution,
    /// How images are rendered.
    pub rendering: RenderingPlan,
}

impl PlanPreset {
    /// A first try.
    pub const TINY: Self = Self {
        name: "tiny",
        objects: 10,
        grasps: 2,
        gel: GelResolution::Coarse,
        rendering: RenderingPlan {
            renderings: 1,
            ..Self::SMALL.rendering
        },
    };
    /// A small balanced dataset.
    pub const SMALL: Self = Self {
        name: "small",
        objects: 60,
        grasps: 6,
        gel: GelResolution::Default,
        rendering: RenderingPlan {
            renderings: 3,
            samples_per_pixel: 4,
            sensor_spread: 1.0,
            visual_spread: 1.0,
            sensor: SensorName::GELSIGHT_MINI,
        },
    };
    /// The size of the paper: 453 objects, more than 10,000 grasps at two forces.
    pub const FULL: Self = Self {
        name: "full",
        objects: 453,
        grasps: 24,
        ..Self::SMALL
    };
}

/// Generates the first `count` objects of a seed, cycling through the categories.
///
/// # Errors
/// `Internal` for a shape that cannot be generated.
pub fn family_drafts(
    count: usize,
    seed: u64,
    jobs: usize,
    on_progress: &(dyn Fn(usize) + Sync),
) -> Result<Vec<ObjectDraft>> {
    let numbers: Vec<usize> = (0..count).collect();
    par_map_single_threaded(jobs, &numbers, &|number| draft(*number, seed), on_progress)
}

fn draft(number: usize, seed: u64) -> Result<ObjectDraft> {
    let category = Category::cycled(number);
    let of_category = number / Category::COUNT;
    let name = SimulationId::parse(&format!("{}-{of_category:04}", category.name()))?;
    let mut draw = SeedStream::named(seed, &format!("shape {name}"));
    // Below 2⁵³, so that every JSON reader preserves it.
    let shape_seed = draw.bits() >> 11;
    let mesh = family_shape(category, shape_seed)?;
    let materials = category.materials();
    let material = Material::named(materials[draw.index(materials.len())])?;
    let (low, high) = category.fill();
    Ok(ObjectDraft {
        name,
        category: category.name().to_owned(),
        source: MeshSource::Family {
            category: category.name().to_owned(),
            seed: shape_seed,
        },
        mesh,
        material,
        fill: Some(draw.between(low, high)),
        mass_kg: None,
        friction: None,
        appearances: Vec::new(),
        textures: Vec::new(),
        grasps: None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn materials_of_every_category_exist() {
        for category in Category::all() {
            for name in category.materials() {
                Material::named(name).unwrap();
            }
        }
    }

    #[test]
    fn drafts_cycle_through_categories_reproducibly() {
        let count = Category::COUNT + 1;
        let drafts = family_drafts(count, 3, 2, &|_| ()).unwrap();
        assert_eq!(drafts[0].category, drafts[count - 1].category);
        assert_ne!(drafts[0].mesh, drafts[count - 1].mesh);
        let again = family_drafts(count, 3, 1, &|_| ()).unwrap();
        let hash = |d: &ObjectDraft| (d.name.clone(), d.mesh.content_hash(), d.fill);
        assert!(drafts.iter().map(hash).eq(again.iter().map(hash)));
    }
}
