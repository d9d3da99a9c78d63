//! Analytic cases of gels and object: force balance, creep, lift, gap, drive.

use glam::DVec3;

use super::pinch::{GRAVITY, Pinch};
use super::report::Recorder;
use crate::contact::barrier::Barrier;
use crate::fem::{GelGrid, GelPad, GelResolution};
use crate::grasp::{ForceRule, GelSpec, GraspOutcome, Protocol, Scene, simulate};
use crate::press::{Indenter, Press, PressTarget};
use crate::solver::{Drive, SolverParameters};
use gripcast_base::error::Result;
use gripcast_geometry::{Pose, builtin};

/// Contact and friction on the gels, the object's weight and its momentum change sum to zero in
/// every step: while the gels close, while they lift and while the object swings.
pub(super) fn balance(recorder: &mut Recorder) -> Result<()> {
    let parameters = SolverParameters {
        newton_tolerance_m_s: 1e-9,
        ..SolverParameters::default()
    };
    for name in ["box", "mug"] {
        let mesh = builtin(name)?;
        let mut pinch = Pinch::new(&mesh, (0.06, 0.4), 4.9e-4, parameters)?;
        let mut max_residual = 0.0_f64;
        for step in 0..30 {
            let before = pinch.system.object().rate().p;
            let (closing, up) = if step < 10 { (5e-5, 0.0) } else { (0.0, 2e-4) };
            pinch.step(closing, DVec3::Z * up);
            let now = pinch.system.object().rate().p;
            let change = (now - before) * (pinch.mass_kg / parameters.dt_s);
            let weight = DVec3::Z * (parameters.gravity_m_s2 * pinch.mass_kg);
            max_residual = max_residual.max((pinch.force_on_gels() + change - weight).length());
        }
        let pair = (0.0, max_residual);
        recorder.absolute(format!("{name}: residual"), pair, "N", 1e-6);
        recorder.require(format!("{name}: converged"), pinch.unconverged == 0);
    }
    Ok(())
}

/// A gripped box creeps down at eps_v (1 - sqrt(1 - T / µN)), by the mollified friction law.
pub(super) fn creep(recorder: &mut Recorder) -> Result<()> {
    let parameters = SolverParameters {
        newton_tolerance_m_s: 1e-7,
        ..SolverParameters::default()
    };
    for (mass, gap) in [(0.02, 4.95e-4), (0.06, 4.85e-4), (0.2, 4.7e-4)] {
        let mut pinch = Pinch::new(&builtin("box")?, (mass, 0.4), gap, parameters)?;
        for _ in 0..100 {
            pinch.step(0.0, DVec3::ZERO);
        }
        // Nodes slide over the faces of the box, so the normal force varies slightly.
        let steps = 50_u32;
        let (mut expected, mut found, mut fraction) = (0.0, 0.0, 0.0);
        for _ in 0..steps {
            pinch.step(0.0, DVec3::ZERO);
            let [left, right] = pinch.normal_forces();
            fraction = mass * GRAVITY / (0.4 * (left + right));
            expected += parameters.eps_v_m_s * (1.0 - (1.0 - fraction).sqrt());
            found -= pinch.system.object().rate().p.z;
        }
        let (expected, found) = (expected / f64::from(steps), found / f64::from(steps));
        let name = format!("{mass} kg at T/muN {fraction:.2}");
        recorder.relative(name, (expected, found), "m/s", 0.01);
    }
    Ok(())
}

/// Two fingers lift a box if and only if 2 µ F exceeds its weight.
pub(super) fn lift(recorder: &mut Recorder, is_quick: bool) -> Result<()> {
    let all = [
        (0.057, 0.4),
        (0.2, 0.4),
        (0.057, 0.1),
        (0.07, 0.8),
        (1.0, 0.4),
    ];
    let cases = if is_quick { &all[..1] } else { &all[..] };
    for &(mass, mu) in cases {
        let critical = mass * GRAVITY / (2.0 * mu);
        for fraction in [0.8, 1.2] {
            let outcome = lift_box(mass, mu, fraction * critical)?;
            let lifts = outcome == GraspOutcome::Success;
            let name = format!("{mass} kg, mu {mu}, {fraction} of {critical:.3} N");
            recorder.require(
                name,
                lifts == (fraction > 1.0) && outcome != GraspOutcome::NotConverged,
            );
        }
    }
    Ok(())
}

fn lift_box(mass_kg: f64, friction: f64, force_n: f64) -> Result<GraspOutcome> {
    let mesh = builtin("box")?;
    let half = 0.5 * mesh.bounds().extent();
    let down = glam::DMat3::from_cols(DVec3::X, DVec3::NEG_Y, DVec3::NEG_Z);
    let scene = Scene {
        mass_kg,
        friction,
        t_world_object: Pose::from_translation(DVec3::Z * half.z),
        t_world_gripper: Pose::new(glam::DQuat::from_mat3(&down), DVec3::Z * half.z),
        opening_m: 2.0 * half.x + 0.00105,
        gel: GelSpec::standard(GelResolution::Coarse)?,
        mesh,
    };
    let protocol = Protocol {
        // Slow enough that the force does not overshoot in one step.
        closing_speed_m_s: 2e-4,
        stop_force_n: force_n,
        rule: ForceRule::Proportional { gain_m_per_n: 2e-6 },
        adjust_s: 0.5,
        ..Protocol::default()
    };
    let result = simulate(&scene, &protocol, &SolverParameters::default())?;
    Ok(result.outcome)
}

/// Barrier pressure at a distance for contacts with a total weight, Pa.
fn pressure(barrier: &Barrier, weight: f64, distance: f64) -> f64 {
    let squared = distance * distance;
    -weight * barrier.d_hat * barrier.squared(squared).to_linear(squared).first
}

fn gap_at(barrier: &Barrier, weight: f64, target_pa: f64) -> f64 {
    let (mut low, mut high) = (0.0, barrier.d_hat);
    for _ in 0..100 {
        let middle = 0.5 * (low + high);
        if pressure(barrier, weight, middle) > target_pa {
            low = middle;
        } else {
            high = middle;
        }
    }
    0.5 * (low + high)
}

/// Weight of a node inside one face; vertices and edges of a flat face do not contribute.
const NODE_WEIGHT: f64 = 0.25;

/// The gap under a plate of one face matches the barrier's formula.
pub(super) fn gap(recorder: &mut Recorder) -> Result<()> {
    let barrier = SolverParameters::default().barrier();
    let grid = GelPad::default().grid(GelResolution::Coarse)?;
    let mut press = Press::new(grid, Indenter::Mesh(single_face()));
    press.d_hat_m = barrier.d_hat;
    press.kappa_pa = barrier.kappa;
    let targets = [5e-5, 2e-4, 6e-4].map(|depth_m| PressTarget {
        depth_m,
        shift_m: 0.0,
    });
    for point in press.run(&targets)? {
        // The pressure of a plate is nearly uniform, so the mean gap is that of the mean pressure
        // to second order.
        let mean = point.normal_n / (0.025 * 0.02);
        let expected = gap_at(&barrier, NODE_WEIGHT, mean);
        let name = format!("{:.1} kPa", 1e-3 * mean);
        recorder.relative(name, (expected, point.gap_m), "m", 0.01);
    }
    Ok(())
}

/// A triangle that covers the whole pad.
fn single_face() -> gripcast_geometry::TriangleMesh {
    gripcast_geometry::TriangleMesh {
        vertices: vec![
            DVec3::new(-0.1, -0.1, 0.0),
            DVec3::new(0.0, 0.2, 0.0),
            DVec3::new(0.1, -0.1, 0.0),
        ],
        triangles: vec![[0, 1, 2]],
    }
}

/// The default drive has 5e9 N/m³ on every mesh; Taccel's stiffness w m_back / dt² decreases with
/// mesh refinement.
pub(super) fn drive(recorder: &mut Recorder) -> Result<()> {
    let area = 0.025 * 0.02;
    for nodes in [[13, 11, 3], [19, 16, 4], [13, 11, 5], [13, 11, 9]] {
        let grid = GelGrid::uniform(nodes, [0.025, 0.02, 0.004])?;
        let name = format!("{}x{}x{}", nodes[0], nodes[1], nodes[2]);
        let found = drive_stiffness(&grid, Drive::PerArea(5e9))?;
        let pair = (5e9 * area, found);
        recorder.relative(format!("area {name}"), pair, "N/m", 1e-3);
        let dt = SolverParameters::default().dt_s;
        let back_mass = 1000.0 * area * 0.5 * 0.004 / (nodes[2] - 1) as f64;
        let found = drive_stiffness(&grid, Drive::PerMass(5e4))?;
        let pair = (5e4 * back_mass / (dt * dt), found);
        recorder.relative(format!("taccel {name}"), pair, "N/m", 1e-2);
    }
    Ok(())
}

/// Force over the lag of the back behind its drive under a plate, N/m.
fn drive_stiffness(grid: &GelGrid, drive: Drive) -> Result<f64> {
    let mut press = Press::new(grid.clone(), Indenter::Plate);
    press.drive = drive;
    press.dt_s = SolverParameters::default().dt_s;
    press.along_m = 0.005;
    press.d_hat_m = 1e-4;
    let target = PressTarget {
        depth_m: 1e-4,
        shift_m: 0.0,
    };
    let points = press.run(&[target; 6])?;
    Ok(points.last().map_or(f64::NAN, |p| p.normal_n / p.lag_m))
}
