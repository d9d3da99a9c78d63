//! Built-in objects with typical materials.

use super::finish::Finish;
use super::model::Model;
use super::procedural::ProceduralTexture;
use gripcast_base::error::Result;
use gripcast_base::random::SeedStream;
use gripcast_geometry::builtin;

/// Finishes that suit a built-in mesh, most common first.
///
/// | mesh | finishes |
/// | --- | --- |
/// | `mug` | ceramic, glass, steel, plastic |
/// | `box` | print, wood, plastic |
/// | `sphere` | plastic, wood, glass, steel |
/// | `cylinder` | print, steel, ceramic, glass, aluminium |
/// | `wedge` | wood, plastic, stone |
/// | `bar` | brushed metal, wood, copper, plastic |
/// | `spike` | aluminium, glass, plastic |
/// | `ball` | plastic, wood, steel |
/// | `bottle` | plastic, glass, aluminium |
pub fn typical_finishes(name: &str) -> &'static [Finish] {
    use Finish::{Aluminium, Copper, Glass, Steel, Textured};
    const CERAMIC: Finish = Textured(ProceduralTexture::Ceramic);
    const METAL: Finish = Textured(ProceduralTexture::BrushedMetal);
    const PLASTIC: Finish = Textured(ProceduralTexture::Plastic);
    const PRINT: Finish = Textured(ProceduralTexture::Print);
    const STONE: Finish = Textured(ProceduralTexture::Stone);
    const WOOD: Finish = Textured(ProceduralTexture::Wood);
    match name.strip_prefix("builtin:").unwrap_or(name) {
        "mug" => &[CERAMIC, Glass, Steel, PLASTIC],
        "box" => &[PRINT, WOOD, PLASTIC],
        "sphere" => &[PLASTIC, WOOD, Glass, Steel],
        "cylinder" => &[PRINT, Steel, CERAMIC, Glass, Aluminium],
        "wedge" => &[WOOD, PLASTIC, STONE],
        "bar" => &[METAL, WOOD, Copper, PLASTIC],
        "spike" => &[Aluminium, Glass, PLASTIC],
        "ball" => &[PLASTIC, WOOD, Steel],
        "bottle" => &[PLASTIC, Glass, Aluminium],
        _ => &[PLASTIC, WOOD, CERAMIC, STONE],
    }
}

/// Builds a built-in mesh with one of its typical finishes, picked by the seed.
///
/// # Errors
/// `NotFound` for an unknown name; the remedy lists the names.
pub fn demo_model(name: &str, seed: u64) -> Result<Model> {
    let shape = builtin(name)?;
    let finishes = typical_finishes(name);
    let mut stream = SeedStream::named(seed, "finish");
    let finish = finishes[stream.index(finishes.len())];
    Model::with_finish(&shape, finish, stream.bits())
}

/// Picks a finish for an unknown shape.
pub fn random_finish(seed: u64) -> Finish {
    let finishes = typical_finishes("");
    finishes[SeedStream::named(seed, "finish").index(finishes.len())]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::material::Material;
    use gripcast_geometry::BUILTIN_NAMES;

    #[test]
    fn every_builtin_mesh_has_a_model() {
        let mut glass = 0;
        for name in BUILTIN_NAMES {
            for seed in 0..3 {
                let model = demo_model(name, seed).unwrap();
                assert_eq!((model.meshes.len(), model.materials.len()), (1, 1));
                glass += usize::from(matches!(model.materials[0], Material::Dielectric { .. }));
            }
            assert!(typical_finishes(name).len() >= 3, "{name}");
        }
        assert!(glass > 0);
        assert!(demo_model("builtin:mugg", 0).is_err());
    }
}
