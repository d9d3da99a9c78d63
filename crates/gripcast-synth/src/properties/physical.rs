//! Mass and friction of an object, with their source.

use serde::{Deserialize, Serialize};

use super::material::Material;
use super::surface::SURFACES;
use gripcast_base::error::{Error, Result};
use gripcast_base::random::SeedStream;

/// Range of friction coefficients in the paper's prompt (A.1).
pub const FRICTION_RANGE: [f64; 2] = [0.1, 1.5];
/// Maximum mass in the paper's dataset before mapping (A.1), kg.
pub const MAX_MASS_KG: f64 = 1.0;
/// Mass range of the paper's real objects, the target of the mapping (A.1), kg.
pub const MASS_RANGE_KG: [f64; 2] = [0.01, 0.2];

/// Maximum relative variation of the fill between objects of a category.
const FILL_CHANGE: f64 = 0.15;

/// Source of a property.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", tag = "from", deny_unknown_fields)]
pub enum PropertySource {
    /// The table of materials.
    Table,
    /// A language model.
    Llm {
        /// Name of the model at the endpoint.
        model: String,
    },
    /// The table of materials, because the language model failed.
    Fallback {
        /// Why it failed.
        #[serde(rename = "why")]
        reason: String,
    },
    /// The user.
    Given,
}

/// Mass and friction of an object.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PhysicalProperties {
    /// Mass, kg; before [`map_masses`], that of a real object.
    pub mass_kg: f64,
    /// Coefficient of friction against the dry gel, in [`FRICTION_RANGE`].
    pub friction: f64,
    /// Source of both.
    pub source: PropertySource,
}

/// Fill of categories that are not in the table: solid.
const DEFAULT_FILL: f64 = 1.0;

/// Estimates mass and friction from the table of materials: density × volume × fill, and friction
/// uniform in the material's range.
///
/// `fill` in (0, 1] is the fraction of `volume_m3` that is material; the default is that of the
/// category, varied by up to 15 % with the seed. Meshes with modelled walls (a mug with its cavity)
/// have fill 1.
///
/// # Errors
/// `Input` for a volume that is not positive and finite, or a fill outside (0, 1].
pub fn estimate(
    category: &str,
    material: &Material,
    volume_m3: f64,
    fill: Option<f64>,
    seed: u64,
) -> Result<PhysicalProperties> {
    if !(volume_m3 > 0.0 && volume_m3.is_finite()) {
        return Err(Error::input(format!(
            "the volume must be positive and finite, found {volume_m3} m³"
        ))
        .remedy("use a closed mesh whose triangles are counter-clockwise seen from outside"));
    }
    if let Some(fill) = fill
        && !(fill > 0.0 && fill <= 1.0)
    {
        return Err(Error::input(format!(
            "the fill must be above 0 and at most 1, found {fill}"
        ))
        .remedy("set the fraction of the volume that is material: 1 for a solid object"));
    }
    let name = format!("physical/{category}/{}", material.name);
    let mut stream = SeedStream::named(seed, &name);
    let change = stream.between(1.0 - FILL_CHANGE, 1.0 + FILL_CHANGE);
    let fill = fill.unwrap_or_else(|| (default_fill(category) * change).min(1.0));
    let [low, high] = material.friction;
    Ok(PhysicalProperties {
        mass_kg: material.density_kg_m3 * volume_m3 * fill,
        friction: stream.between(low, high),
        source: PropertySource::Table,
    })
}

fn default_fill(category: &str) -> f64 {
    let lower = category.to_lowercase();
    let noun = lower
        .split(|c: char| !c.is_alphanumeric())
        .rfind(|w| !w.is_empty());
    let noun = noun.unwrap_or_default();
    let fills = &SURFACES.fills;
    let singular = || noun.strip_suffix('s').and_then(|noun| fills.get(noun));
    let fill = fills.get(noun).or_else(singular);
    fill.copied().unwrap_or(DEFAULT_FILL)
}

/// How masses of real objects are mapped to masses of a dataset.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum MassMap {
    /// As in the paper (A.1): linearly to [`MASS_RANGE_KG`].
    Linear,
    /// Linearly in the logarithm of the mass. Most objects are light, and [`Linear`](Self::Linear)
    /// leaves nearly all of them at the lower end.
    #[default]
    Logarithmic,
    /// Not at all.
    None,
}

/// Maps the masses of a set of objects: they are clamped to 1 kg, then the lightest is mapped to
/// 0.01 kg and the heaviest to 0.2 kg. Linear mapping (A.1):
///
/// m → 0.01 + 0.19 (min(m, 1) − low) / (high − low), with low and high the minimum and maximum
/// of min(m, 1).
///
/// Equal masses (or a single one) are only clamped to [0.01, 0.2] kg. The mapping depends on the
/// whole list: another object changes all masses.
///
/// # Errors
/// `Input` for a mass that is not positive and finite.
pub fn map_masses(masses_kg: &[f64], map: MassMap) -> Result<Vec<f64>> {
    if let Some((i, mass)) = (masses_kg.iter().enumerate()).find(|(_, m)| !is_mass(**m)) {
        return Err(Error::input(format!(
            "mass {i} must be positive and finite, found {mass} kg"
        )));
    }
    let transform = match map {
        MassMap::None => return Ok(masses_kg.to_vec()),
        MassMap::Linear => |m: f64| m,
        MassMap::Logarithmic => f64::ln,
    };
    let scale: Vec<f64> = masses_kg
        .iter()
        .map(|m| transform(m.min(MAX_MASS_KG)))
        .collect();
    let low = scale.iter().copied().fold(f64::INFINITY, f64::min);
    let high = scale.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let [to_low, to_high] = MASS_RANGE_KG;
    let mapped = |(value, mass): (&f64, &f64)| {
        if high <= low {
            return mass.clamp(to_low, to_high);
        }
        let fraction = (value - low) / (high - low);
        match map {
            MassMap::Logarithmic => to_low.powf(1.0 - fraction) * to_high.powf(fraction),
            // Exact at both ends despite rounding.
            _ => to_low * (1.0 - fraction) + to_high * fraction,
        }
    };
    Ok(scale.iter().zip(masses_kg).map(mapped).collect())
}

pub(super) fn is_mass(mass_kg: f64) -> bool {
    mass_kg > 0.0 && mass_kg.is_finite()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn solid_object_weighs_its_volume() {
        for material in Material::all() {
            let found = estimate("block", material, 1e-4, Some(1.0), 3).unwrap();
            let expected = material.density_kg_m3 * 1e-4;
            assert!(
                (found.mass_kg - expected).abs() < 1e-12,
                "{}",
                material.name
            );
            let [low, high] = material.friction;
            assert!((low..=high).contains(&found.friction));
            assert_eq!(found.source, PropertySource::Table);
        }
    }

    #[test]
    fn hollow_categories_are_lighter_and_vary_by_seed() {
        let pet = Material::named("pet").unwrap();
        let mass =
            |category: &str, seed| estimate(category, pet, 5e-4, None, seed).unwrap().mass_kg;
        let solid = 1380.0 * 5e-4;
        for category in ["bottle", "Water Bottles", "spray_bottle"] {
            let fraction = mass(category, 1) / solid;
            assert!(
                (0.12 * 0.85..=0.12 * 1.15).contains(&fraction),
                "{category} {fraction}"
            );
        }
        assert!(mass("hammer", 1) / solid > 0.84);
        assert_eq!(mass("bottle", 1), mass("bottle", 1));
        assert_ne!(mass("bottle", 1), mass("bottle", 2));
        assert!(mass("", 1) <= solid);
    }

    #[test]
    fn invalid_volumes_and_fills_are_refused() {
        let abs = Material::named("abs").unwrap();
        for volume in [0.0, -1e-4, f64::NAN, f64::INFINITY] {
            let error = estimate("toy", abs, volume, None, 0).unwrap_err();
            assert!(error.to_string().contains("volume"), "{error}");
        }
        for fill in [0.0, -0.5, 1.1, f64::NAN] {
            let error = estimate("toy", abs, 1e-4, Some(fill), 0).unwrap_err();
            assert!(error.to_string().contains("fill"), "{error}");
        }
    }

    #[test]
    fn masses_are_clamped_and_mapped_linearly() {
        let mapped = map_masses(&[0.02, 0.51, 500.0, 1.0], MassMap::Linear).unwrap();
        let expected = [0.01, 0.105, 0.2, 0.2];
        for (found, wanted) in mapped.iter().zip(expected) {
            assert!((found - wanted).abs() < 1e-12, "{mapped:?}");
        }
        assert_eq!(mapped[0], 0.01);
        assert_eq!(mapped[2], 0.2);
    }

    #[test]
    fn logarithmic_map_spreads_light_masses() {
        let masses = [0.001, 0.01, 0.1, 1.0];
        let mapped = map_masses(&masses, MassMap::Logarithmic).unwrap();
        let steps: Vec<f64> = mapped.windows(2).map(|w| w[1] / w[0]).collect();
        assert!((mapped[0] - 0.01).abs() < 1e-12 && (mapped[3] - 0.2).abs() < 1e-12);
        assert!(steps.iter().all(|step| (step - steps[0]).abs() < 1e-9));
        assert_eq!(map_masses(&masses, MassMap::None).unwrap(), masses);
    }

    #[test]
    fn equal_masses_are_clamped() {
        let map = |masses: &[f64]| map_masses(masses, MassMap::Linear);
        assert_eq!(map(&[]).unwrap(), Vec::<f64>::new());
        assert_eq!(map(&[0.1]).unwrap(), [0.1]);
        assert_eq!(map(&[0.001, 0.001]).unwrap(), [0.01, 0.01]);
        assert_eq!(map(&[3.0, 7.0]).unwrap(), [0.2, 0.2]);
        let near = map(&[0.1, 0.1 + 1e-17, f64::MIN_POSITIVE]).unwrap();
        assert!(near.iter().all(|m| (0.01..=0.2).contains(m)), "{near:?}");
        for bad in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(map(&[0.1, bad]).is_err());
        }
    }

    #[test]
    fn property_sources_are_tagged() {
        let source = PropertySource::Llm {
            model: "gpt-4o".to_owned(),
        };
        let text = serde_json::to_string(&source).unwrap();
        assert_eq!(text, r#"{"from":"llm","model":"gpt-4o"}"#);
        assert_eq!(
            serde_json::from_str::<PropertySource>(&text).unwrap(),
            source
        );
        let table: PropertySource = serde_json::from_str(r#"{"from":"table"}"#).unwrap();
        assert_eq!(table, PropertySource::Table);
    }
}
