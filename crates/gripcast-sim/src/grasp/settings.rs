//! Parameters of a grasp besides the scene, and their presets.

use serde::ser::SerializeStruct as _;
use serde::{Deserialize, Serialize, Serializer};

use super::protocol::Protocol;
use super::scene::GelSpec;
use crate::fem::{GelPad, GelResolution};
use crate::solver::{Drive, GelMaterial, SolverParameters};
use gripcast_base::error::Result;

/// A named set of parameters.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Preset {
    /// The paper (§3.1): E = 1 MPa, ν = 0.3.
    #[default]
    Paper,
    /// The paper's protocol with the gel stiffness of FEATS (arXiv 2411.03315).
    Feats,
}

/// Young's modulus of [`Preset::Feats`], Pa: 6 C10 of an incompressible neo-Hookean gel with
/// C10 = 0.0725 MPa, as in FEATS' finite-element model of the GelSight Mini.
const FEATS_YOUNG_PA: f64 = 0.435e6;

/// Poisson's ratio of [`Preset::Feats`]. FEATS gives no compressibility; its solver then uses
/// 0.475. Linear tetrahedra lock towards 0.5, so 0.45 is used with the same Young's modulus, which
/// puts the shear modulus 3 % above 2 C10.
const FEATS_POISSON: f64 = 0.45;

impl Preset {
    /// All presets.
    pub const ALL: [Self; 2] = [Self::Paper, Self::Feats];

    /// Name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Paper => "paper",
            Self::Feats => "feats",
        }
    }

    /// Material of the gels.
    pub fn material(self) -> GelMaterial {
        match self {
            Self::Paper => GelMaterial::default(),
            Self::Feats => GelMaterial {
                young_pa: FEATS_YOUNG_PA,
                poisson: FEATS_POISSON,
                ..GelMaterial::default()
            },
        }
    }
}

/// Weight of the paper's drive by nodal mass.
pub const TACCEL_DRIVE_WEIGHT: f64 = 5e4;

/// Parameters of a grasp besides the scene.
///
/// As JSON: `{"preset", "gel": {"mesh", "nodes"}, "material", "drive", "protocol", "solver"}`; `gel`
/// also has the `pad`, unless that is the default one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GraspSettings {
    /// Preset that the parameters are based on.
    pub preset: Preset,
    /// Size of the gels.
    pub pad: GelPad,
    /// Mesh of the gels.
    pub resolution: GelResolution,
    /// Material of the gels.
    pub material: GelMaterial,
    /// Boundary drive of the gels.
    pub drive: Drive,
    /// Stages and forces of the protocol.
    pub protocol: Protocol,
    /// Parameters of the solver.
    pub solver: SolverParameters,
}

impl Default for GraspSettings {
    fn default() -> Self {
        Self::new(Preset::default())
    }
}

impl GraspSettings {
    /// The parameters of a preset.
    pub fn new(preset: Preset) -> Self {
        Self {
            preset,
            pad: GelPad::default(),
            resolution: GelResolution::default(),
            material: preset.material(),
            drive: Drive::default(),
            protocol: Protocol::default(),
            solver: SolverParameters::default(),
        }
    }

    /// Mesh, material and drive of the gels.
    ///
    /// # Errors
    /// `Config` for a pad whose size is out of range.
    pub fn gel(&self) -> Result<GelSpec> {
        Ok(GelSpec {
            grid: self.pad.grid(self.resolution)?,
            material: self.material,
            drive: self.drive,
        })
    }
}

impl Serialize for GraspSettings {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut gel = serde_json::json!({
            "mesh": self.resolution.name(),
            "nodes": self.resolution.nodes(&self.pad),
        });
        if !self.pad.is_default() {
            gel["pad"] = serde_json::json!(self.pad);
        }
        let material = serde_json::json!({
            "young_pa": self.material.young_pa,
            "poisson": self.material.poisson,
            "density_kg_m3": self.material.density_kg_m3,
        });
        let drive = match self.drive {
            Drive::PerArea(stiffness) => {
                serde_json::json!({"kind": "area", "stiffness_n_m3": stiffness})
            }
            Drive::PerMass(weight) => serde_json::json!({"kind": "taccel", "weight": weight}),
        };
        let mut out = serializer.serialize_struct("GraspSettings", 6)?;
        out.serialize_field("preset", &self.preset)?;
        out.serialize_field("gel", &gel)?;
        out.serialize_field("material", &material)?;
        out.serialize_field("drive", &drive)?;
        out.serialize_field("protocol", &self.protocol)?;
        out.serialize_field("solver", &self.solver)?;
        out.end()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn presets_have_the_documented_stiffness() {
        let paper = GraspSettings::new(Preset::Paper);
        assert_eq!(
            (paper.material.young_pa, paper.material.poisson),
            (1e6, 0.3)
        );
        assert_eq!(paper.protocol.stop_force_n, 40.0);
        let feats = GraspSettings::new(Preset::Feats);
        assert_eq!(feats.protocol, paper.protocol);
        let shear = feats.material.young_pa / (2.0 * (1.0 + feats.material.poisson));
        assert!((shear / (2.0 * 0.0725e6) - 1.0345).abs() < 1e-3, "{shear}");
        assert_eq!(feats.gel().unwrap().material, feats.material);
    }

    #[test]
    fn json_has_all_parameters() {
        let settings = GraspSettings {
            drive: Drive::PerMass(TACCEL_DRIVE_WEIGHT),
            resolution: GelResolution::Coarse,
            ..GraspSettings::new(Preset::Feats)
        };
        let value = serde_json::to_value(settings).unwrap();
        assert_eq!(value["preset"], "feats");
        assert_eq!(value["gel"]["nodes"], serde_json::json!([13, 11, 3]));
        assert_eq!(value["drive"]["kind"], "taccel");
        assert_eq!(value["material"]["young_pa"], 435_000.0);
        assert_eq!(value["solver"]["d_hat_m"], 5e-4);
    }
}
