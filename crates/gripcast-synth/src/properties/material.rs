//! Materials.

use super::surface::{SURFACES, Surface};
use gripcast_base::error::{Result, unknown_name};
use gripcast_visual::FinishClass;

/// A material.
///
/// Densities are round values within the ranges of the *CRC Handbook of Chemistry and Physics*
/// (Density of Various Solids), the *Wood Handbook* of the USDA (woods at 12 % moisture),
/// datasheets of polymers without filler, and the *FAO/INFOODS Density Database* 2.0 (food).
///
/// Friction is that of a dry, clean surface against soft silicone. Published values against
/// rubber are few and wide: steel 0.64–0.86, concrete 0.6–1.0, glass above 2 (Engineering
/// ToolBox, *Friction coefficients*). Ranges are estimated from these: smooth stiff
/// surfaces have high friction; waxy, powdery and fibrous ones have low friction.
#[derive(Debug, PartialEq)]
pub struct Material {
    /// Name in tables and commands.
    pub name: String,
    /// Density of the solid, kg/m³.
    pub density_kg_m3: f64,
    /// Minimum and maximum coefficient of friction against dry soft silicone.
    pub friction: [f64; 2],
    /// Possible surfaces; the first is the bare material.
    pub(super) surfaces: Vec<Surface>,
}

impl Material {
    /// All materials, in the order of the table.
    pub fn all() -> &'static [Self] {
        &SURFACES.materials
    }

    /// Finds a material by name. Case is ignored; spaces and hyphens count as underscores.
    ///
    /// # Errors
    /// `Usage` for an unknown name; the remedy lists the nearest name and all names.
    pub fn named(name: &str) -> Result<&'static Self> {
        let name = name.trim().to_lowercase().replace([' ', '-'], "_");
        Self::all().iter().find(|m| m.name == name).ok_or_else(|| {
            let names: Vec<&str> = Self::all().iter().map(|m| &*m.name).collect();
            unknown_name("material", &name, &names)
        })
    }

    /// Finish of the bare material.
    pub fn finish(&self) -> FinishClass {
        self.surfaces
            .first()
            .map_or(FinishClass::Plastic, |c| c.finish)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_base::error::ErrorKind;

    #[test]
    fn every_row_is_valid() {
        assert_eq!(Material::all().len(), 40);
        for material in Material::all() {
            let name = &material.name;
            assert!(std::ptr::eq(Material::named(name).unwrap(), material));
            assert!((20.0..9000.0).contains(&material.density_kg_m3), "{name}");
            let [low, high] = material.friction;
            assert!(0.1 <= low && low < high && high <= 1.5, "{name}");
            assert!(!material.surfaces.is_empty(), "{name}");
            let usable =
                |surface: &Surface| !surface.states.is_empty() && !surface.shades().is_empty();
            assert!(material.surfaces.iter().all(usable), "{name}");
        }
    }

    #[test]
    fn names_are_normalised_and_errors_suggest_the_nearest() {
        assert_eq!(
            Material::named(" Stainless-Steel").unwrap().name,
            "stainless_steel"
        );
        assert_eq!(Material::named("fruit flesh").unwrap().name, "fruit_flesh");
        let error = Material::named("alluminium").unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Usage);
        assert!(
            error.to_string().contains("did you mean aluminium?"),
            "{error}"
        );
        assert!(Material::named("").is_err());
    }
}
