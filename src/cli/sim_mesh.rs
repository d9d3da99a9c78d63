//! `gripcast sim mesh`: checks the mesh of an object.
//!
//! ```text
//! gripcast sim mesh --object part.stl --unit mm
//! gripcast sim mesh --object cup.obj --wall-thickness-mm 2 --json
//! ```
//!
//! Does what `sim grasp` does before the simulation: repairs the mesh, finds its inside and its
//! stable poses.
//!
//! Exit codes: 0 usable, perhaps with warnings · 1 unusable, with the reason · 2 usage.

use serde::Serialize;

use super::sim_object::{MeshFlags, MeshRecord};
use super::{Context, print_report};
use gripcast_base::error::Result;
use gripcast_geometry::stable_poses;

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
#[command(allow_negative_numbers = true)]
pub(crate) struct Args {
    #[command(flatten)]
    mesh: MeshFlags,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

#[derive(Serialize)]
struct Report {
    #[serde(flatten)]
    mesh: MeshRecord,
    /// Number of stable poses.
    stable_poses: usize,
    warnings: Vec<String>,
}

/// Runs the command.
pub(crate) fn run(context: &Context, args: &Args) -> Result<()> {
    let prepared = args.mesh.load()?;
    let name = &args.mesh.object;
    context.warn(prepared.warnings.iter().map(|w| format!("{name}: {w}")));
    let poses = stable_poses(&prepared.mesh, 0.0).map_err(|e| e.at(name))?;
    let report = Report {
        mesh: MeshRecord::new(&args.mesh, &prepared),
        stable_poses: poses.len(),
        warnings: prepared.warnings,
    };
    print_report(args.json, &report, text)
}

fn text(report: &Report) -> String {
    let mesh = &report.mesh;
    let mm = |[x, y, z]: [f64; 3]| format!("{:.2} × {:.2} × {:.2} mm", 1e3 * x, 1e3 * y, 1e3 * z);
    let mut lines = vec![
        format!("triangles   {}", mesh.triangles),
        format!("size        {}", mm(mesh.size_m)),
    ];
    if let Some(solid) = &mesh.solid {
        let [x, y, z] = solid.center_of_mass_m.map(|c| 1e3 * c);
        lines.push(format!(
            "volume      {:.3} cm³ ± {:.2} %",
            1e6 * solid.volume_m3,
            100.0 * solid.volume_uncertainty
        ));
        lines.push(format!("mass centre ({x:.2}, {y:.2}, {z:.2}) mm"));
    }
    lines.push(format!("poses       {} stable", report.stable_poses));
    lines.join("\n")
}
