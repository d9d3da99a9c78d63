//! Synthetic trace for tests: three stages, with and without contact.

use glam::{DQuat, DVec3};

use super::trace::{GelForce, Snapshot, StageName, Trace, TraceStep};
use crate::solver::StepReport;
use gripcast_geometry::Pose;

/// Two steps of free motion, ten of closing, 30 of adjustment cycling by 1 N around 40 N, 20 of
/// lift.
pub fn sample_trace() -> Trace {
    let mut trace = Trace::default();
    let mut opening_m = 0.042;
    for index in 0..62 {
        let (stage, force, squeeze) = match index {
            0..2 => (StageName::Closure, 0.0, 1e-4),
            2..12 => (StageName::Closure, 4.05 * f64::from(index - 1), 1e-4),
            12..42 if index % 2 == 0 => (StageName::Adjustment, 39.5, -2e-5),
            12..42 => (StageName::Adjustment, 40.5, 2e-5),
            _ => (StageName::Lift, 40.0, 0.0),
        };
        opening_m -= 2.0 * squeeze;
        let lifted_m = 2e-4 * f64::from((index - 41).max(0));
        let solver = (index >= 2).then(|| StepReport {
            converged: index != 5,
            iterations: 3,
            ..StepReport::default()
        });
        trace.steps.push(TraceStep {
            stage,
            t_s: 0.01 * f64::from(index + 1),
            force: [
                GelForce {
                    normal_n: force,
                    shear_n: [0.1, -0.2],
                    torque_n_m: 1e-4,
                },
                GelForce {
                    normal_n: force + 0.01,
                    ..GelForce::default()
                },
            ],
            t_world_object: Pose::new(
                DQuat::from_rotation_z(0.1),
                DVec3::new(0.0, 1e-3, 0.03 + lifted_m),
            ),
            opening_m,
            lifted_m,
            min_gap_m: [(index >= 2).then_some(4.5e-4), None],
            solver,
        });
    }
    for (stage, t_s) in [
        (StageName::Closure, 0.12),
        (StageName::Adjustment, 0.42),
        (StageName::Lift, 0.62),
    ] {
        trace.snapshots.push(Snapshot {
            stage,
            t_s,
            t_world_object: Pose::from_translation(DVec3::Z * t_s),
            t_world_gripper: Pose::from_rotation(DQuat::from_rotation_x(t_s)),
            opening_m,
            gels: [vec![[0.1, 0.2, t_s]; 4], vec![[-0.1, 0.2, t_s]; 5]],
        });
    }
    trace
}
