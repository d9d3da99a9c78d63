//! What objects are made of.

use super::coat::{self, Coat};
use super::look::FinishClass;
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
    pub name: &'static str,
    /// Density of the solid, kg/m³.
    pub density_kg_m3: f64,
    /// Lowest and highest coefficient of friction against dry soft silicone.
    pub friction: [f64; 2],
    /// What its surface can look like; the first is the bare material.
    pub(super) coats: &'static [&'static Coat],
}

impl Material {
    /// All materials, in the order of the table.
    pub const ALL: &'static [Self] = &TABLE;

    /// Material by name. Case does not matter; spaces and hyphens are underscores.
    ///
    /// # Errors
    /// `Usage` for an unknown name; the remedy has the nearest name and all of them.
    pub fn named(name: &str) -> Result<&'static Self> {
        let wanted = name.trim().to_lowercase().replace([' ', '-'], "_");
        TABLE.iter().find(|m| m.name == wanted).ok_or_else(|| {
            let known: Vec<&str> = TABLE.iter().map(|m| m.name).collect();
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

const fn row(
    name: &'static str,
    density_kg_m3: f64,
    friction: [f64; 2],
    coats: &'static [&'static Coat],
) -> Material {
    Material {
        name,
        density_kg_m3,
        friction,
        coats,
    }
}

const WOODEN: &[&Coat] = &[&coat::WOOD, &coat::PAINTED_WOOD];
const STEELY: &[&Coat] = &[&coat::STEEL, &coat::ENAMEL, &coat::POWDER_COAT];
const PLASTIC: &[&Coat] = &[&coat::PLASTIC];
const CLEAR: &[&Coat] = &[&coat::CLEAR_PLASTIC, &coat::PLASTIC];

static TABLE: [Material; 40] = [
    row("wood", 650.0, [0.50, 0.95], WOODEN),
    row("pine", 500.0, [0.50, 0.95], WOODEN),
    row("balsa", 160.0, [0.45, 0.85], WOODEN),
    row("plywood", 600.0, [0.50, 0.90], WOODEN),
    row("bamboo", 700.0, [0.45, 0.90], &[&coat::BAMBOO]),
    row("cork", 200.0, [0.60, 1.00], &[&coat::CORK]),
    row("steel", 7850.0, [0.60, 1.00], STEELY),
    row("stainless_steel", 7900.0, [0.60, 1.00], &[&coat::STEEL]),
    row(
        "cast_iron",
        7200.0,
        [0.55, 0.90],
        &[&coat::IRON, &coat::ENAMEL],
    ),
    row(
        "aluminium",
        2700.0,
        [0.60, 1.00],
        &[&coat::ALUMINIUM, &coat::POWDER_COAT],
    ),
    row(
        "zinc",
        7100.0,
        [0.55, 0.95],
        &[&coat::STEEL, &coat::POWDER_COAT],
    ),
    row("brass", 8500.0, [0.60, 1.00], &[&coat::BRASS]),
    row("copper", 8900.0, [0.60, 1.00], &[&coat::COPPER]),
    row("abs", 1050.0, [0.50, 1.00], PLASTIC),
    row("pla", 1240.0, [0.50, 0.95], PLASTIC),
    row("polypropylene", 905.0, [0.40, 0.80], PLASTIC),
    row("polyethylene", 950.0, [0.30, 0.70], PLASTIC),
    row("pvc", 1380.0, [0.50, 1.00], PLASTIC),
    row("nylon", 1140.0, [0.40, 0.80], PLASTIC),
    row("ptfe", 2180.0, [0.10, 0.30], &[&coat::PTFE]),
    row("pet", 1380.0, [0.50, 1.00], CLEAR),
    row("polycarbonate", 1200.0, [0.60, 1.10], CLEAR),
    row("acrylic", 1190.0, [0.60, 1.10], CLEAR),
    row("ceramic", 2300.0, [0.60, 1.10], &[&coat::GLAZE]),
    row("porcelain", 2400.0, [0.65, 1.20], &[&coat::GLAZE]),
    row("glass", 2500.0, [0.80, 1.50], &[&coat::GLASS]),
    row("rubber", 1150.0, [0.80, 1.40], &[&coat::RUBBER]),
    row("silicone", 1130.0, [0.80, 1.50], &[&coat::RUBBER]),
    row("foam", 40.0, [0.50, 0.95], &[&coat::FOAM]),
    row(
        "cardboard",
        690.0,
        [0.45, 0.80],
        &[&coat::KRAFT, &coat::CARTON],
    ),
    row("paper", 800.0, [0.40, 0.75], &[&coat::PAPER, &coat::CARTON]),
    row("fabric", 400.0, [0.40, 0.85], &[&coat::CLOTH]),
    row("leather", 900.0, [0.50, 0.95], &[&coat::LEATHER]),
    row("wax", 930.0, [0.25, 0.55], &[&coat::WAX]),
    row("soap", 1050.0, [0.20, 0.50], &[&coat::SOAP]),
    row("plasticine", 1700.0, [0.50, 1.00], &[&coat::CLAY]),
    row("stone", 2650.0, [0.50, 0.95], &[&coat::STONE]),
    row("concrete", 2300.0, [0.60, 1.00], &[&coat::CONCRETE]),
    row("fruit_flesh", 900.0, [0.35, 0.75], &[&coat::PEEL]),
    row("chocolate", 1300.0, [0.30, 0.60], &[&coat::CHOCOLATE]),
];

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_base::error::ErrorKind;

    #[test]
    fn every_row_can_be_used() {
        for material in Material::ALL {
            let name = material.name;
            assert!(std::ptr::eq(Material::named(name).unwrap(), material));
            assert!((20.0..9000.0).contains(&material.density_kg_m3), "{name}");
            let [low, high] = material.friction;
            assert!(0.1 <= low && low < high && high <= 1.5, "{name}");
            assert!(!material.coats.is_empty(), "{name}");
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
