//! What objects are made of.

use super::look::FinishClass;
use super::surface::{Coat, SURFACES};
use gripcast_base::error::{Result, unknown_name};

/// A material by its usual name.
///
/// Densities are round values within the ranges of the *CRC Handbook of Chemistry and Physics*
/// (Density of Various Solids), the *Wood Handbook* of the USDA (woods at 12 % moisture),
/// datasheets of polymers without filler, and the *FAO/INFOODS Density Database* 2.0 (food).
///
/// Friction is that of a dry, clean surface against soft silicone. Published values against
/// rubber are few and wide: steel 0.64–0.86, concrete 0.6–1.0, glass above 2 (Engineering
/// ToolBox, *Friction coefficients*). Ranges are judged between these: smooth stiff surfaces
/// stick, waxy, powdery and fibrous ones slide.
#[derive(Debug, PartialEq)]
pub struct Material {
    /// Name in tables and commands.
    pub name: String,
    /// Density of the solid, kg/m³.
    pub density_kg_m3: f64,
    /// Lowest and highest coefficient of friction against dry soft silicone.
    pub friction: [f64; 2],
    /// What its surface can look like; the first is the bare material.
    pub(super) coats: Vec<Coat>,
}

impl Material {
    /// All materials, in the order of the table.
    pub fn all() -> &'static [Self] {
        &SURFACES.materials
    }

    /// Material by name. Case does not matter; spaces and hyphens are underscores.
    ///
    /// # Errors
    /// `Usage` for an unknown name; the remedy has the nearest name and all of them.
    pub fn named(name: &str) -> Result<&'static Self> {
        let wanted = name.trim().to_lowercase().replace([' ', '-'], "_");
        Self::all()
            .iter()
            .find(|m| m.name == wanted)
            .ok_or_else(|| {
                let known: Vec<&str> = Self::all().iter().map(|m| &*m.name).collect();
                unknown_name("material", &wanted, &known)
            })
    }

    /// What the bare surface is rendered as.
    pub fn finish(&self) -> FinishClass {
        self.coats
            .first()
            .map_or(FinishClass::Plastic, |c| c.finish)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_base::error::ErrorKind;

    #[test]
    fn every_row_can_be_used() {
        assert_eq!(Material::all().len(), 40);
        for material in Material::all() {
            let name = &material.name;
            assert!(std::ptr::eq(Material::named(name).unwrap(), material));
            assert!((20.0..9000.0).contains(&material.density_kg_m3), "{name}");
            let [low, high] = material.friction;
            assert!(0.1 <= low && low < high && high <= 1.5, "{name}");
            assert!(!material.coats.is_empty(), "{name}");
            let usable = |coat: &Coat| !coat.states.is_empty() && !coat.shades.is_empty();
            assert!(material.coats.iter().all(usable), "{name}");
        }
    }

    #[test]
    fn names_are_forgiving_and_errors_name_the_nearest() {
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
