//! The press: the gel's back moves towards the indenter in small steps.
//!
//! The indenter stays; the gel's frame is the world at the start, its front face towards +z. A
//! time step is so long that inertia is nothing. Contact acts from `d_hat` on, so the surface that
//! carries the force is the indenter's grown by the gap. A smooth indenter is therefore meshed
//! smaller by `d_hat`, and the depth counts from where the undeformed face would first meet that
//! surface at the gap of the moment: with the mean motion b of the back, the distance c between
//! face and tip at the start and the mean gap g, weighted by the forces, the depth is `b - c + g`.

use glam::{DMat3, DVec2, DVec3};
use serde::Serialize;

use super::indenter::{Fineness, Indenter};
use crate::affine::{AffineBody, AffineState};
use crate::fem::{GelGrid, Side, Surface};
use crate::solver::{
    Collider, Drive, Gel, GelMaterial, Object, SolverParameters, StepStart, System,
};
use gripcast_base::error::{Error, Result};

/// Long enough for inertia to be nothing: 2 g over its square is 2e-5 N/m.
const DT_S: f64 = 10.0;
/// Stiffness of the back's drive, N/m³: it gives by 0.3 µm under 0.3 MPa, and that is measured.
const STIFF_DRIVE: f64 = 1e12;
/// Stiffness that holds a plane of symmetry, N/m for each node.
const PLANE: f64 = 1e7;
/// Newton's iteration ends when nothing moves further than this, m.
const TOLERANCE_M: f64 = 2e-9;
/// A goal is met when the depth is off by less, m.
const CLOSE_M: f64 = 2e-8;
/// Room between contact and the face at the start, as a fraction of `d_hat`.
const CLEARANCE: f64 = 1e-3;

/// A gel and what it is pressed against.
#[derive(Clone, Debug)]
pub struct Press {
    /// The gel; where `symmetric` says so, only its part at positive x or y.
    pub grid: GelGrid,
    /// Whether x = 0 and y = 0 are planes of symmetry that the grid ends at.
    pub symmetric: [bool; 2],
    /// Drive of the back.
    pub drive: Drive,
    /// The gel's material.
    pub material: GelMaterial,
    /// What it meets, above the middle of the whole gel.
    pub indenter: Indenter,
    /// Friction coefficient between them.
    pub friction: f64,
    /// Distance at which contact acts, m.
    pub d_hat_m: f64,
    /// Stiffness of contact, Pa.
    pub kappa_pa: f64,
    /// Slip in one step up to which friction is mollified, m.
    pub slip_m: f64,
    /// Size of the indenter's faces, m.
    pub face_m: f64,
    /// Size of the faces along y where the indenter is straight, m.
    pub along_m: f64,
    /// Longest motion in one step, m.
    pub step_m: f64,
    /// Time of a step, s; by default so long that inertia is nothing.
    pub dt_s: f64,
}

/// Where a press is to be measured.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Goal {
    /// Depth from first touch, m.
    pub depth_m: f64,
    /// Shift of the indenter along x relative to the gel's back, m.
    pub shift_m: f64,
}

/// One measured point of a press, of the whole gel.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct PressPoint {
    /// Depth from first touch of the surface that carries the force, m.
    pub depth_m: f64,
    /// Shift along x, m.
    pub shift_m: f64,
    /// Normal force, N.
    pub normal_n: f64,
    /// Force on the gel along x, N.
    pub shear_n: f64,
    /// Mean contact gap, weighted by the forces, m.
    pub gap_m: f64,
    /// Smallest contact gap, m.
    pub min_gap_m: f64,
    /// Mean motion of the back against the drive, weighted by the drive's stiffness, m.
    pub lag_m: f64,
    /// Steps since the goal before.
    pub steps: u32,
    /// Iterations since the goal before.
    pub iterations: u32,
    /// Whether all steps converged.
    pub converged: bool,
}

impl Press {
    /// A press of the given gel with contact at 10 µm, faces of 0.2 mm and steps of 0.05 mm.
    pub fn new(grid: GelGrid, indenter: Indenter) -> Self {
        Self {
            grid,
            symmetric: [false; 2],
            drive: Drive::PerArea(STIFF_DRIVE),
            material: GelMaterial::default(),
            indenter,
            friction: 0.0,
            d_hat_m: 1e-5,
            kappa_pa: 3e6,
            slip_m: 1e-7,
            face_m: 2e-4,
            along_m: 5e-4,
            step_m: 5e-5,
            dt_s: DT_S,
        }
    }

    /// Goes from goal to goal in order and measures at each.
    ///
    /// # Errors
    /// `Input` where a goal is no number or deeper than half the gel; where the indenter, the
    /// material or a parameter cannot be simulated.
    pub fn run(&self, goals: &[Goal]) -> Result<Vec<PressPoint>> {
        self.validate(goals)?;
        let mut run = self.start(goals)?;
        goals.iter().map(|goal| run.reach(goal)).collect()
    }

    fn validate(&self, goals: &[Goal]) -> Result<()> {
        self.indenter.validate()?;
        let deepest = 0.5 * self.grid.thickness_m();
        for goal in goals {
            let is_fine = goal.depth_m > 0.0 && goal.depth_m <= deepest && goal.shift_m.is_finite();
            if !is_fine {
                let what = format!(
                    "a press goes to depths above 0 and at most {deepest} m, found {goal:?}"
                );
                return Err(Error::input(what));
            }
        }
        let positive = [
            ("friction", self.friction + f64::MIN_POSITIVE),
            ("slip_m", self.slip_m),
            ("face_m", self.face_m),
            ("along_m", self.along_m),
            ("step_m", self.step_m),
        ];
        for (name, value) in positive {
            if !(value.is_finite() && value > 0.0) {
                let what = format!("a press needs a positive `{name}`, found {value}");
                return Err(Error::input(what));
            }
        }
        Ok(())
    }

    fn start(&self, goals: &[Goal]) -> Result<Run> {
        let depth = goals.iter().fold(0.0_f64, |d, goal| d.max(goal.depth_m));
        let [x, y, _] = self.grid.axes();
        let reach = |axis: &[f64]| axis.iter().fold(0.0_f64, |m, c| m.max(c.abs()));
        let fineness = Fineness {
            face_m: self.face_m,
            along_m: self.along_m,
            half: DVec2::new(reach(x), reach(y)),
            depth_m: depth,
        };
        let parameters = SolverParameters {
            dt_s: self.dt_s,
            kappa_pa: self.kappa_pa,
            d_hat_m: self.d_hat_m,
            eps_v_m_s: self.slip_m / self.dt_s,
            newton_tolerance_m_s: TOLERANCE_M / self.dt_s,
            max_iterations: 400,
            gravity_m_s2: 0.0,
            candidate_margin_m: 2.0 * self.step_m + self.d_hat_m,
            max_factor_age: 8,
            ..SolverParameters::default()
        };
        let mesh = self.indenter.surface(&fineness, self.d_hat_m);
        let collider = Collider::new(&mesh);
        let clearance = self.d_hat_m * (1.0 + CLEARANCE);
        // It does not move, so its mass does not matter.
        let body = AffineBody::new(1.0, 1.0, DMat3::IDENTITY, parameters.affine_stiffness_pa)?;
        let place = DVec3::Z * (self.grid.thickness_m() + clearance);
        let state = AffineState::rigid(place, DMat3::IDENTITY);
        let object = Object::new(body, state, &collider).fixed();
        let mut gel = Gel::new(&self.grid, &self.material, self.drive, &parameters, |p| p)?;
        for (axis, direction) in [DVec3::X, DVec3::Y].into_iter().enumerate() {
            if self.symmetric[axis] {
                let nodes = self.grid.positions().iter().enumerate();
                let on_plane = nodes.filter(|(_, p)| p[axis].abs() < 1e-9);
                let on_plane: Vec<u32> = on_plane.map(|(node, _)| node as u32).collect();
                gel = gel.holding(on_plane, direction * PLANE);
            }
        }
        if self.symmetric.contains(&true) {
            let front = self.grid.triangles(Side::Front);
            gel = gel.touching_with(Surface::new(front, self.grid.positions()));
        }
        Ok(Run {
            system: System::new(vec![gel], object, collider, self.friction, parameters)?,
            clearance,
            copies: self
                .symmetric
                .iter()
                .map(|s| if *s { 2.0 } else { 1.0 })
                .product(),
            step_m: self.step_m,
            driven: Goal::default(),
        })
    }
}

/// A press under way.
struct Run {
    system: System,
    clearance: f64,
    /// Copies of the grid in the whole gel.
    copies: f64,
    step_m: f64,
    /// Motion of the drive so far; the depth without clearance.
    driven: Goal,
}

impl Run {
    fn reach(&mut self, goal: &Goal) -> Result<PressPoint> {
        let (mut steps, mut iterations, mut converged) = (0, 0, true);
        for attempt in 0..4 {
            // What the drive has to move for the goal, as far as gap and lag are known.
            let now = self.measure();
            let missing_depth = goal.depth_m - now.depth_m;
            let missing_shift = goal.shift_m - now.shift_m;
            let longest = missing_depth.abs().max(missing_shift.abs());
            if attempt > 0 && longest < CLOSE_M {
                break;
            }
            let count = (longest / self.step_m).ceil().max(1.0);
            for _ in 0..count as u32 {
                let by = DVec3::new(-missing_shift, 0.0, missing_depth) / count;
                self.driven.depth_m += by.z;
                self.driven.shift_m -= by.x;
                for gel in self.system.gels_mut() {
                    gel.move_target(by);
                }
                let report = self.system.step(&StepStart::default());
                steps += 1;
                iterations += report.iterations;
                converged &= report.converged;
            }
        }
        Ok(PressPoint {
            steps,
            iterations,
            converged,
            ..self.measure()
        })
    }

    fn measure(&self) -> PressPoint {
        let gel = &self.system.gels()[0];
        let force: DVec3 = gel.contact_forces().sum();
        let (mut moved, mut whole) = (DVec3::ZERO, 0.0);
        for (&node, stiffness) in gel.driven().iter().zip(gel.drive_stiffness()) {
            let node = node as usize;
            moved += (gel.positions()[node] - gel.rest()[node]) * *stiffness;
            whole += stiffness;
        }
        moved /= whole;
        let d_hat = self.system.parameters().d_hat_m;
        let gap_m = gel.mean_gap().unwrap_or(d_hat);
        PressPoint {
            depth_m: moved.z - self.clearance + gap_m,
            shift_m: -moved.x,
            normal_n: -force.z * self.copies,
            shear_n: force.x * self.copies,
            gap_m,
            min_gap_m: gel.min_gap().unwrap_or(d_hat),
            lag_m: (self.driven.depth_m - moved.z).abs(),
            steps: 0,
            iterations: 0,
            converged: true,
        }
    }
}

/// The quarter at positive x and y of the 25 x 20 x 4 mm pad.
///
/// `cells` along x, y, z; each is `growth` times as long as the one before it, counted from the
/// middle of the front face.
///
/// # Errors
/// `Input` where an axis has no cells or a growth is not a positive number.
pub fn quarter_pad(cells: [usize; 3], growth: [f64; 3]) -> Result<GelGrid> {
    let [x, y, depth] = [(0, 0.0125), (1, 0.01), (2, 0.004)]
        .map(|(axis, length)| growing(cells[axis], growth[axis], length));
    let z = depth.iter().rev().map(|d| 0.004 - d).collect();
    GelGrid::new([x, y, z])
}

/// The half at positive y, finest around the middle: `cells` along half of x, along y and z.
///
/// # Errors
/// As [`quarter_pad`].
pub fn half_pad(cells: [usize; 3], growth: [f64; 3]) -> Result<GelGrid> {
    let quarter = quarter_pad(cells, growth)?;
    let [right, y, z] = quarter.axes().clone();
    let left = right.iter().skip(1).rev().map(|x| -x);
    GelGrid::new([left.chain(right.iter().copied()).collect(), y, z])
}

/// Coordinates from 0 to `length` of cells that grow by a factor.
fn growing(cells: usize, growth: f64, length: f64) -> Vec<f64> {
    let mut at = vec![0.0];
    let (mut end, mut cell) = (0.0, 1.0);
    for _ in 0..cells {
        end += cell;
        cell *= growth;
        at.push(end);
    }
    for coordinate in &mut at {
        *coordinate *= length / end;
    }
    at[cells] = length;
    at
}
