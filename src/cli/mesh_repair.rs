//! Options of the commands that read a mesh: what is done about its defects.

use super::flags::{millimetres, named};
use gripcast_geometry::{PrepareOptions, Repair};

/// Options that repair a mesh.
#[derive(Clone, Copy, Debug, clap::Args)]
pub(super) struct RepairFlags {
    /// What to do about defects of the mesh
    #[arg(long, value_name = "HOW", default_value = "auto", value_parser = repair())]
    pub(super) repair: Repair,
    /// Wall that an open surface gets, inwards: a cup or a box modelled without thickness
    #[arg(long, value_name = "MM", value_parser = millimetres)]
    pub(super) wall_thickness_mm: Option<f64>,
}

fn repair() -> impl clap::builder::TypedValueParser<Value = Repair> {
    named([
        (
            "none",
            "Take the mesh as it is, if contact permits",
            Repair::None,
        ),
        (
            "auto",
            "Repair with a warning; pieces may overlap, holes be small",
            Repair::Auto,
        ),
        (
            "strict",
            "Refuse what is open or intersects itself",
            Repair::Strict,
        ),
    ])
}

impl RepairFlags {
    /// For a mesh with a mass.
    pub(super) fn options(&self) -> PrepareOptions {
        PrepareOptions {
            repair: self.repair,
            wall_thickness_m: self.wall_thickness_mm.map(|mm| 1e-3 * mm),
            ..PrepareOptions::default()
        }
    }

    /// For a mesh of which only the surface is used.
    pub(super) fn surface_options(&self) -> PrepareOptions {
        PrepareOptions {
            needs_inside: false,
            ..self.options()
        }
    }
}
