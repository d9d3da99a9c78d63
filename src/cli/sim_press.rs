//! `gripcast sim press`: simulates an indentation test of a gel.
//!
//! ```text
//! gripcast sim press --indenter sphere --radius-m 0.01 --depth-m 2e-4,4e-4,6e-4
//! gripcast sim press --indenter sphere --radius-m 0.01 --gel refined --friction 0.4 \
//!     --depth-m 6e-4 --shift-m 2e-4,5e-4 --json
//! gripcast sim press --indenter mesh --mesh part.stl --unit mm --depth-m 5e-4
//! ```
//!
//! The back of the gel moves quasi-statically towards the fixed indenter; the depth counts from
//! first contact. A mesh indenter points down in the gel's frame (x along 25 mm, y along 20 mm);
//! its lowest point above the gel touches first.
//!
//! Exit codes: 0 simulated · 1 invalid indenter · 2 usage · 4 a point did not converge · 130
//! interrupted.

use std::path::{Path, PathBuf};
use std::time::Instant;

use serde::Serialize;

use super::flags::{above_zero, check_output, number};
use super::mesh_repair::RepairFlags;
use super::working::interruptible;
use super::{Context, print_report};
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_base::files::save;
use gripcast_base::number::NumberRange;
use gripcast_geometry::{LengthUnit, MeshOptions, TriangleMesh, load_object_mesh};
use gripcast_sim::fem::{GelResolution, Grading};
use gripcast_sim::fields::{FieldSampling, FieldSeries};
use gripcast_sim::grasp::{Trace, TraceFile};
use gripcast_sim::press::{Indenter, PressGel, PressPoint, PressSetup, points_without_force};

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct Args {
    /// Indenter shape; long indenters lie along the gel's 20 mm side
    #[arg(long, value_enum, value_name = "SHAPE")]
    indenter: Shape,
    /// Radius of the sphere, cylinder or edge
    #[arg(long, value_name = "M", required_if_eq_any = [
        ("indenter", "sphere"), ("indenter", "cylinder"), ("indenter", "edge"),
    ], value_parser = above_zero)]
    radius_m: Option<f64>,
    /// Mesh file (obj, stl, ply, glb, gltf)
    #[arg(long, value_name = "FILE", required_if_eq("indenter", "mesh"))]
    mesh: Option<PathBuf>,
    /// Unit of the mesh coordinates: mm, cm, m, in
    #[arg(long, default_value_t = LengthUnit::Metre)]
    unit: LengthUnit,
    #[command(flatten)]
    repair: RepairFlags,
    /// Indentation depths, comma-separated
    #[arg(long, value_name = "M", value_delimiter = ',',
        default_values_t = PressSetup::DEPTHS_M,
        value_parser = number(NumberRange::FINITE))]
    depth_m: Vec<f64>,
    /// Shear displacements along the gel's x axis at the last depth, comma-separated
    #[arg(long, value_name = "M", value_delimiter = ',',
        value_parser = number(NumberRange::FINITE))]
    shift_m: Vec<f64>,
    /// Gel mesh
    #[arg(long, value_enum, default_value_t = Mesh::Default)]
    gel: Mesh,
    /// Mesh grading towards the middle of the face (1: uniform); not for refined
    #[arg(long, value_name = "EXPONENT", default_value_t = 1.0, value_parser = above_zero)]
    grade_middle: f64,
    /// Mesh grading towards the face (1: uniform); not for refined
    #[arg(long, value_name = "EXPONENT", default_value_t = 1.0, value_parser = above_zero)]
    grade_face: f64,
    /// Coulomb friction coefficient
    #[arg(long, value_name = "MU", default_value_t = 0.0,
        value_parser = number(NumberRange::NOT_NEGATIVE))]
    friction: f64,
    /// Young's modulus of the gel
    #[arg(long, value_name = "PA", default_value_t = 1e6, value_parser = above_zero)]
    young_pa: f64,
    /// Poisson's ratio of the gel
    #[arg(long, value_name = "NU", default_value_t = 0.3,
        value_parser = number(NumberRange::above(-1.0, 0.5)))]
    poisson: f64,
    /// Barrier activation distance d̂ (5e-4 in grasps)
    #[arg(long, value_name = "M", default_value_t = 2e-5, value_parser = above_zero)]
    d_hat_m: f64,
    /// Barrier stiffness κ
    #[arg(long, value_name = "PA", default_value_t = 3e6, value_parser = above_zero)]
    kappa_pa: f64,
    /// Face size of the indenter mesh
    #[arg(long, value_name = "M", default_value_t = 2e-4, value_parser = above_zero)]
    face_m: f64,
    /// Write the fields of the gel's face, in the binary form of a trace
    #[arg(long, value_name = "FILE.bin")]
    trace: Option<PathBuf>,
    /// Time steps with fields: every:N, at the targets (stages), or all
    #[arg(long, value_name = "every:N|stages|all", requires = "trace",
        default_value_t = FieldSampling::Stages)]
    fields: FieldSampling,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Shape {
    /// Sphere
    Sphere,
    /// Cylinder longer than the gel, axis parallel to the face
    Cylinder,
    /// Flat plate larger than the gel
    Plate,
    /// Straight 90° edge with a rounded tip
    Edge,
    /// Mesh file
    Mesh,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Mesh {
    /// 13 × 11 × 3 nodes
    Coarse,
    /// 19 × 16 × 4 nodes
    Default,
    /// 26 × 21 × 5 nodes
    Fine,
    /// A quarter (with shear: half) of the gel by symmetry, refined towards the middle; not for
    /// mesh indenters
    Refined,
}

#[derive(Debug, Serialize)]
struct Report {
    gel_nodes: [usize; 3],
    wall_s: f64,
    points: Vec<PressPoint>,
    /// Reasons to doubt the result.
    warnings: Vec<String>,
}

/// Runs the command.
pub(crate) fn run(context: &Context, args: Args) -> Result<()> {
    if let Some(path) = &args.trace {
        check_output("--trace", path, &["bin"])?;
    }
    let (press, goals) = setup(context, &args)?.build()?;
    let gel_nodes = press.grid.nodes();
    let sampling = args.trace.as_ref().map(|_| args.fields);
    let (pressed, wall_s) = interruptible(context, "pressing", move |_| {
        let started = Instant::now();
        let pressed = press.run_with_fields(&goals, sampling);
        (pressed, started.elapsed().as_secs_f64())
    })?;
    let (points, fields) = pressed?;
    let warnings = points_without_force(&points);
    context.warn(&warnings);
    let report = Report {
        gel_nodes,
        wall_s,
        points,
        warnings,
    };
    if let Some(path) = &args.trace {
        write_trace(path, &args, &report, fields)?;
    }
    print_report(args.json, &report, |_| text(&report.points))?;
    let unconverged = report.points.iter().filter(|p| !p.converged).count();
    if unconverged == 0 {
        return Ok(());
    }
    let total = report.points.len();
    let what = format!("{unconverged} of {total} points did not converge");
    Err(Error::new(ErrorKind::Check, what).remedy("pass a larger --d-hat-m or a coarser --gel"))
}

fn write_trace(
    path: &Path,
    args: &Args,
    report: &Report,
    fields: Option<FieldSeries>,
) -> Result<()> {
    let header = serde_json::json!({
        "press": report,
        "friction": args.friction,
        "material": {"young_pa": args.young_pa, "poisson": args.poisson},
    });
    let trace = Trace {
        fields,
        ..Trace::default()
    };
    save(path, &TraceFile { header, trace }.to_bytes()?)
}

fn load(context: &Context, path: &Path, args: &Args) -> Result<TriangleMesh> {
    let options = MeshOptions {
        prepare: args.repair.surface_options(),
        ..MeshOptions::new(args.unit, 1.0)
    };
    let prepared = load_object_mesh(&path.to_string_lossy(), &options)?;
    let file = path.display();
    context.warn(prepared.warnings.iter().map(|w| format!("{file}: {w}")));
    Ok(prepared.mesh)
}

fn setup(context: &Context, args: &Args) -> Result<PressSetup> {
    let radius_m = args.radius_m.unwrap_or(0.0);
    let indenter = match (args.indenter, &args.mesh) {
        (Shape::Sphere, _) => Indenter::Sphere { radius_m },
        (Shape::Cylinder, _) => Indenter::Cylinder { radius_m },
        (Shape::Edge, _) => Indenter::Edge { radius_m },
        (Shape::Mesh, Some(path)) => Indenter::Mesh(load(context, path, args)?),
        (Shape::Plate | Shape::Mesh, _) => Indenter::Plate,
    };
    Ok(PressSetup {
        gel: match args.gel {
            Mesh::Coarse => PressGel::Whole(GelResolution::Coarse),
            Mesh::Default => PressGel::Whole(GelResolution::Default),
            Mesh::Fine => PressGel::Whole(GelResolution::Fine),
            Mesh::Refined => PressGel::Refined,
        },
        grading: Grading {
            front: args.grade_face,
            plane: args.grade_middle,
            ..Grading::default()
        },
        depths_m: args.depth_m.clone(),
        shifts_m: args.shift_m.clone(),
        friction: args.friction,
        young_pa: args.young_pa,
        poisson: args.poisson,
        d_hat_m: args.d_hat_m,
        kappa_pa: args.kappa_pa,
        face_m: args.face_m,
        indenter,
    })
}

fn text(points: &[PressPoint]) -> String {
    let mut lines = vec!["depth mm   shift mm   normal N   shear N   gap um".to_owned()];
    lines.extend(points.iter().map(|p| {
        format!(
            "{:>8.4} {:>10.4} {:>10.4} {:>9.4} {:>8.2}{}",
            1e3 * p.depth_m,
            1e3 * p.shift_m,
            p.normal_n,
            p.shear_n,
            1e6 * p.gap_m,
            if p.converged { "" } else { "  not converged" }
        )
    }));
    lines.join("\n")
}
