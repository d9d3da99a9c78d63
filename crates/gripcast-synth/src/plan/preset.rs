//! Sizes of plans, and the objects of the built-in families.

use super::{MeshSource, ObjectDraft, RenderingPlan};
use crate::family::{Category, family_shape};
use crate::properties::Material;
use gripcast_base::error::{Result, unknown_name};
use gripcast_base::files::SimulationId;
use gripcast_base::random::SeedStream;
use gripcast_base::workers::par_map_single_threaded;
use gripcast_sim::fem::GelResolution;

/// A size of plan.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PlanPreset {
    /// To see that it works.
    Tiny,
    /// A small balanced dataset.
    Small,
    /// The paper's: 453 objects, more than 10,000 grasps at two forces.
    Full,
}

impl PlanPreset {
    /// All, in the order of the docs.
    pub const ALL: [Self; 3] = [Self::Tiny, Self::Small, Self::Full];

    /// Its name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Tiny => "tiny",
            Self::Small => "small",
            Self::Full => "full",
        }
    }

    /// The preset of a name.
    ///
    /// # Errors
    /// `Usage` with the nearest name.
    pub fn named(name: &str) -> Result<Self> {
        let known = Self::ALL.into_iter().find(|preset| preset.name() == name);
        known.ok_or_else(|| unknown_name("preset", name, &Self::ALL.map(Self::name)))
    }

    /// Objects.
    pub fn objects(self) -> usize {
        match self {
            Self::Tiny => 10,
            Self::Small => 60,
            Self::Full => 453,
        }
    }

    /// Grasps of each object.
    pub fn grasps(self) -> usize {
        match self {
            Self::Tiny => 2,
            Self::Small => 6,
            Self::Full => 24,
        }
    }

    /// Mesh of the gels. Coarse ones hold some grasps that finer ones lose (docs/performance.md).
    pub fn gel(self) -> GelResolution {
        match self {
            Self::Tiny => GelResolution::Coarse,
            Self::Small | Self::Full => GelResolution::Default,
        }
    }

    /// How its simulations become images.
    pub fn rendering(self) -> RenderingPlan {
        RenderingPlan {
            renderings: if self == Self::Tiny { 1 } else { 3 },
            samples: 4,
            sensor_spread: 1.0,
            visual_spread: 1.0,
        }
    }
}

/// The first `count` objects of a seed, category after category.
///
/// # Errors
/// `Internal` for a shape that cannot be made.
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
    let category = Category::ALL[number % Category::ALL.len()];
    let of_category = number / Category::ALL.len();
    let name = SimulationId::parse(&format!("{}-{of_category:04}", category.name()))?;
    let mut draw = SeedStream::named(seed, &format!("shape {name}"));
    // Below 2⁵³, so that every JSON reader keeps it.
    let shape_seed = draw.bits() >> 11;
    let mesh = family_shape(category, shape_seed)?;
    let materials = category.materials();
    let material = Material::named(materials[draw.index(materials.len())])?;
    let (least, most) = category.fill();
    Ok(ObjectDraft {
        name,
        category: category.name().to_owned(),
        source: MeshSource::Family {
            category: category.name().to_owned(),
            seed: shape_seed,
        },
        mesh,
        material,
        fill: Some(draw.between(least, most)),
        mass_kg: None,
        friction: None,
        looks: Vec::new(),
        textures: Vec::new(),
        grasps: None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_materials_of_every_category_are_in_the_table() {
        for category in Category::ALL {
            for name in category.materials() {
                Material::named(name).unwrap();
            }
        }
    }

    #[test]
    fn drafts_go_through_the_categories_and_come_again() {
        let count = Category::ALL.len() + 1;
        let drafts = family_drafts(count, 3, 2, &|_| ()).unwrap();
        assert_eq!(drafts[0].category, drafts[count - 1].category);
        assert_ne!(drafts[0].mesh, drafts[count - 1].mesh);
        let again = family_drafts(count, 3, 1, &|_| ()).unwrap();
        let hash = |d: &ObjectDraft| (d.name.clone(), d.mesh.content_hash(), d.fill);
        assert!(drafts.iter().map(hash).eq(again.iter().map(hash)));
    }
}
