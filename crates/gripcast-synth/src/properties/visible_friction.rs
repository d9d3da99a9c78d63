//! Friction that a camera can see: a function of category and appearance alone, as in the paper.

use super::material::Material;
use super::physical::FRICTION_RANGE;
use crate::family::Category;
use gripcast_visual::Appearance;

/// Returns the coefficient of friction of a surface that looks like `appearance` on an object of
/// `category`, against the dry gel, in [`FRICTION_RANGE`].
///
/// As in the paper (A.1), friction follows from the category and its texture: the language model
/// there is asked for the friction of "*texture category*". Here the appearance's finish selects,
/// among the typical materials of the category, those that can look like it (all materials of the
/// table, if the category is unknown or none of its materials can). The mean of their limits is the
/// range, and the appearance's roughness is the position in it: a smooth surface has the upper
/// limit, since soft silicone touches all of it, and a rough one the lower limit:
///
/// μ = high − roughness · (high − low).
///
/// Materials that look alike have the same friction; contamination, which is invisible, is left
/// out.
pub fn visible_friction(category: &str, appearance: &Appearance) -> f64 {
    let has_finish = |material: &&Material| {
        let finish = appearance.finish;
        material.surfaces.iter().any(|s| s.finish == finish)
    };
    let typical = typical_materials(category);
    let mut alike: Vec<&Material> = typical.into_iter().filter(has_finish).collect();
    if alike.is_empty() {
        alike = Material::all().iter().filter(has_finish).collect();
    }
    let mean = |bound: usize| {
        let sum: f64 = alike.iter().map(|material| material.friction[bound]).sum();
        sum / alike.len().max(1) as f64
    };
    let (low, high) = (mean(0), mean(1));
    let roughness = f64::from(appearance.roughness).clamp(0.0, 1.0);
    let [min, max] = FRICTION_RANGE;
    (high - roughness * (high - low)).clamp(min, max)
}

/// Returns [`visible_friction`] of an image on an object: the finish of its material, half rough.
pub fn visible_friction_of_image(category: &str, material: &Material) -> f64 {
    let appearance = Appearance {
        finish: material.finish(),
        base_colour: [1.0; 3],
        roughness: 0.5,
        pattern: gripcast_visual::SurfacePattern::Plain,
    };
    visible_friction(category, &appearance)
}

fn typical_materials(category: &str) -> Vec<&'static Material> {
    let names = Category::parse(category).map(Category::materials);
    let names = names.unwrap_or_default().into_iter();
    names
        .filter_map(|name| Material::named(name).ok())
        .collect()
}

#[cfg(test)]
mod tests {
    use super::super::builtin_appearances;
    use super::*;
    use gripcast_visual::{FinishClass, SurfacePattern};

    fn appearance(finish: FinishClass, roughness: f32) -> Appearance {
        Appearance {
            finish,
            base_colour: [0.5; 3],
            roughness,
            pattern: SurfacePattern::Plain,
        }
    }

    #[test]
    fn friction_falls_with_roughness_within_the_materials_of_the_category() {
        let mug = |roughness| visible_friction("mug", &appearance(FinishClass::Ceramic, roughness));
        assert!(mug(0.1) > mug(0.5) && mug(0.5) > mug(0.9));
        let materials = Category::parse("mug").unwrap().materials();
        let materials = materials.into_iter().map(|m| Material::named(m).unwrap());
        let ceramic = materials.filter(|m| m.finish() == FinishClass::Ceramic);
        let limits: Vec<[f64; 2]> = ceramic.map(|m| m.friction).collect();
        let low = limits.iter().map(|l| l[0]).fold(f64::MAX, f64::min);
        let high = limits.iter().map(|l| l[1]).fold(0.0, f64::max);
        assert!((low..=high).contains(&mug(0.0)) && (low..=high).contains(&mug(1.0)));
    }

    #[test]
    fn category_matters_and_colour_does_not() {
        let plastic = appearance(FinishClass::Plastic, 0.4);
        let frictions: Vec<f64> = Category::all()
            .map(|category| visible_friction(category.name(), &plastic))
            .collect();
        assert!(frictions.iter().any(|f| (f - frictions[0]).abs() > 0.02));
        let red = Appearance {
            base_colour: [0.9, 0.0, 0.0],
            ..plastic
        };
        assert_eq!(
            visible_friction("bottle", &red),
            visible_friction("bottle", &plastic)
        );
        // A category that is unknown uses all materials.
        let glass = appearance(FinishClass::Glass, 0.0);
        assert!((1.0..=1.5).contains(&visible_friction("spaceship", &glass)));
    }

    #[test]
    fn every_builtin_appearance_has_a_friction_in_range() {
        let [min, max] = FRICTION_RANGE;
        for material in Material::all() {
            for drawn in builtin_appearances("thing", material, 3) {
                let friction = visible_friction("tool", &drawn.appearance);
                assert!((min..=max).contains(&friction), "{}", drawn.description);
            }
            let image = visible_friction_of_image("tool", material);
            assert!((min..=max).contains(&image), "{}", material.name);
        }
    }
}
