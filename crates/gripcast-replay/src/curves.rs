//! Forces and heights of a grasp over time, subsampled for a page.

use super::report::Curves;
use gripcast_geometry::{Pose, TriangleMesh};
use gripcast_sim::GraspSetup;
use gripcast_sim::grasp::{StageName, Trace, TraceStep};

/// Maximum points of a curve.
const MAX_POINTS: usize = 160;
/// Start of the curve before the first contact, s.
const LEAD_S: f64 = 0.1;
/// Minimum contact force, N.
const MIN_FORCE: f64 = 1e-3;

/// Returns the height of the object's lowest point, m.
pub(super) fn min_height_m(mesh: &TriangleMesh, t_world_object: &Pose) -> f64 {
    let points = mesh.all_corners().flatten();
    points
        .map(|v| t_world_object.transform_point(v).z)
        .fold(f64::INFINITY, f64::min)
}

/// Extracts the curves of a trace.
pub(super) fn curves(trace: &Trace, setup: &GraspSetup) -> Curves {
    let steps = &trace.steps;
    let touches = |step: &TraceStep| step.force.iter().any(|force| force.normal_n > MIN_FORCE);
    let contact = steps.iter().position(touches).unwrap_or(0);
    let start = steps.get(contact).map_or(0.0, |step| step.t_s - LEAD_S);
    let shown: Vec<&TraceStep> = steps.iter().filter(|step| step.t_s >= start).collect();
    let stride = shown.len().div_ceil(MAX_POINTS).max(1);
    let last = shown.len().saturating_sub(1);
    let kept = shown.iter().enumerate();
    let kept = kept.filter(|(i, _)| i % stride == 0 || *i == last);
    let zero = shown.first().map_or(0.0, |step| step.t_s);
    let start_of = |stage: StageName| {
        let first = trace.stage(stage).next();
        first.map(|step| rounded(step.t_s - zero, 3))
    };
    let end = shown.last().map_or(0.0, |step| rounded(step.t_s - zero, 3));
    let lift = start_of(StageName::Lift).unwrap_or(end);
    let mut out = Curves {
        stages_s: [start_of(StageName::Adjustment).unwrap_or(lift), lift],
        ..Curves::default()
    };
    for (_, step) in kept {
        out.t_s.push(rounded(step.t_s - zero, 3));
        out.left_n.push(rounded(step.force[0].normal_n, 2));
        out.right_n.push(rounded(step.force[1].normal_n, 2));
        out.lifted_m.push(rounded(step.lifted_m, 5));
        let height = min_height_m(&setup.mesh, &step.t_world_object);
        out.min_height_m.push(rounded(height, 5));
    }
    out
}

/// Rounds to the given decimals.
fn rounded(value: f64, decimals: i32) -> f64 {
    let factor = 10f64.powi(decimals);
    // Adding 0 turns -0 into 0.
    (value * factor).round() / factor + 0.0
}
