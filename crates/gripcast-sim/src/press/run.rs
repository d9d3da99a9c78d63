//! Runs a press: the back of the gel moves towards the indenter in small steps.
//!
//! The indenter is fixed; the gel frame is the world frame at the start, with the front face
//! towards +z. Time steps are long enough for inertia to vanish. Contact acts below `d_hat`, so the
//! surface that carries the force is the indenter's offset by the gap. A smooth indenter is
//! therefore meshed smaller by `d_hat`, and the depth counts from where the undeformed face would
//! first meet the surface offset by the current gap: with the mean motion b of the back, the
//! initial distance c between face and tip and the force-weighted mean gap g, the depth is `b - c +
//! g`.

use std::sync::atomic::{AtomicBool, Ordering};

use glam::{DMat3, DVec2, DVec3};
use serde::Serialize;

use super::indenter::{Indenter, MeshSize};
use crate::affine::{AffineBody, AffineState};
use crate::fem::{GelGrid, GelPad, Side, Surface};
use crate::fields::{FaceField, FieldSampling, FieldSeries, FieldStep};
use crate::solver::{
    Collider, Drive, Gel, GelMaterial, NodeContact, Object, SolverParameters, StepStart, System,
};
use gripcast_base::error::{Error, ErrorKind, Result};

/// Time step, s. Long enough to make inertia vanish: 2 g over its square is 2e-5 N/m.
const DT_S: f64 = 10.0;
/// Stiffness of the boundary drive, N/m³: yields by 0.3 µm under 0.3 MPa, which is measured.
const STIFF_DRIVE: f64 = 1e12;
/// Stiffness per node of the constraint to a plane of symmetry, N/m.
const SYMMETRY_STIFFNESS: f64 = 1e7;
/// Newton convergence tolerance: maximum nodal motion, m.
const TOLERANCE_M: f64 = 2e-9;
/// Tolerance of depth and shift at a target, m.
const TARGET_TOLERANCE_M: f64 = 2e-8;
/// Initial clearance beyond `d_hat`, as a fraction of it.
const CLEARANCE: f64 = 1e-3;

/// A press of a gel against an indenter.
#[derive(Clone, Debug)]
pub struct Press {
    /// Mesh of the gel; with `symmetric`, only its half or quarter at positive x or y.
    pub grid: GelGrid,
    /// Whether the grid ends at a plane of symmetry x = 0, and y = 0.
    pub symmetric: [bool; 2],
    /// Boundary drive of the back face.
    pub drive: Drive,
    /// Material of the gel.
    pub material: GelMaterial,
    /// Indenter above the centre of the whole gel.
    pub indenter: Indenter,
    /// Friction coefficient of gel and indenter.
    pub friction: f64,
    /// Distance below which contact acts, m.
    pub d_hat_m: f64,
    /// Stiffness of the contact barrier, Pa.
    pub kappa_pa: f64,
    /// Slip per step below which friction is mollified, m.
    pub slip_m: f64,
    /// Face size of the indenter, m.
    pub face_m: f64,
    /// Face size along y where the indenter is straight, m.
    pub along_m: f64,
    /// Maximum motion per step, m.
    pub step_m: f64,
    /// Time step, s; the default makes inertia vanish.
    pub dt_s: f64,
}

/// Depth and shift at which a press is measured.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct PressTarget {
    /// Depth from first touch, m.
    pub depth_m: f64,
    /// Shift of the indenter along x relative to the back of the gel, m.
    pub shift_m: f64,
}

/// Measurement at one target of a press, for the whole gel.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct PressPoint {
    /// Depth from first touch of the force-carrying surface, m.
    pub depth_m: f64,
    /// Shift along x, m.
    pub shift_m: f64,
    /// Normal force, N.
    pub normal_n: f64,
    /// Force on the gel along x, N.
    pub shear_n: f64,
    /// Force-weighted mean contact gap, m.
    pub gap_m: f64,
    /// Smallest contact gap, m.
    pub min_gap_m: f64,
    /// Stiffness-weighted mean lag of the back behind its drive, m.
    pub lag_m: f64,
    /// Time steps since the previous target.
    pub steps: u32,
    /// Newton iterations since the previous target.
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

    /// Moves from target to target in order and measures at each.
    ///
    /// # Errors
    /// `Input` for a target that is not finite or deeper than half the gel; `Input` or `Config` for
    /// an invalid indenter, material or parameter.
    pub fn run(&self, targets: &[PressTarget]) -> Result<Vec<PressPoint>> {
        Ok(self.run_with_fields(targets, None)?.0)
    }

    /// Presses as [`Self::run`] does, with the same result, and records the fields of the gel's face:
    /// with [`FieldSampling::Stages`] at each target, else at steps. At a target, stick and slip
    /// are those of the step that led to it; the corrections after it are too short to slide. Each field is that of the
    /// modelled part of the gel.
    ///
    /// # Errors
    /// As [`Self::run`].
    pub fn run_with_fields(
        &self,
        targets: &[PressTarget],
        sampling: Option<FieldSampling>,
    ) -> Result<(Vec<PressPoint>, Option<FieldSeries>)> {
        self.run_until(targets, sampling, &AtomicBool::new(false))
    }

    /// Presses as [`Self::run_with_fields`] does until `is_cancelled` is set: it is read before each
    /// step.
    ///
    /// # Errors
    /// As [`Self::run`]; `Interrupted` once it is cancelled.
    pub fn run_until(
        &self,
        targets: &[PressTarget],
        sampling: Option<FieldSampling>,
        is_cancelled: &AtomicBool,
    ) -> Result<(Vec<PressPoint>, Option<FieldSeries>)> {
        self.validate(targets)?;
        let mut run = self.start(targets)?;
        run.sampling = sampling;
        run.fields = sampling.map(|_| FieldSeries::new(&self.grid, 1, self.slip_m / self.dt_s));
        let points = targets
            .iter()
            .map(|target| run.move_to(target, is_cancelled));
        let points = points.collect::<Result<_>>()?;
        Ok((points, run.fields))
    }

    fn validate(&self, targets: &[PressTarget]) -> Result<()> {
        self.indenter.validate(self.half())?;
        let deepest = 0.5 * self.grid.thickness_m();
        for &PressTarget { depth_m, shift_m } in targets {
            // Also rejects NaN.
            if !(depth_m > 0.0 && depth_m <= deepest) {
                return Err(Error::input(format!(
                    "the press depth must be above 0 and at most {deepest} m, half the gel's \
                     thickness, found {depth_m}"
                ))
                .remedy("pass the depth in metres, for instance 5e-4 for 0.5 mm"));
            }
            if !shift_m.is_finite() {
                return Err(Error::input(format!(
                    "the shift of a press must be a finite number, found {shift_m}"
                )));
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
                let what = format!("`{name}` of a press must be above 0, found {value}");
                return Err(Error::input(what));
            }
        }
        Ok(())
    }

    /// Half extent of the gel along x and y, m.
    fn half(&self) -> DVec2 {
        let [x, y, _] = self.grid.axes();
        let reach = |axis: &[f64]| axis.iter().fold(0.0_f64, |m, c| m.max(c.abs()));
        DVec2::new(reach(x), reach(y))
    }

    fn start(&self, targets: &[PressTarget]) -> Result<Run> {
        let depth = targets
            .iter()
            .fold(0.0_f64, |d, target| d.max(target.depth_m));
        let size = MeshSize {
            face_m: self.face_m,
            along_m: self.along_m,
            half: self.half(),
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
        let mesh = self.indenter.surface(&size, self.d_hat_m);
        let collider = Collider::new(&mesh);
        let clearance = self.d_hat_m * (1.0 + CLEARANCE);
        // The indenter is fixed: its mass has no effect.
        let body = AffineBody::new(1.0, 1.0, DMat3::IDENTITY, parameters.affine_stiffness_pa)?;
        let position = DVec3::Z * (self.grid.thickness_m() + clearance);
        let state = AffineState::rigid(position, DMat3::IDENTITY);
        let object = Object::new(body, state, &collider).fixed();
        let mut gel = Gel::new(&self.grid, &self.material, self.drive, &parameters, |p| p)?;
        for (axis, direction) in [DVec3::X, DVec3::Y].into_iter().enumerate() {
            if self.symmetric[axis] {
                let nodes = self.grid.positions().iter().enumerate();
                let on_plane = nodes.filter(|(_, p)| p[axis].abs() < 1e-9);
                let on_plane: Vec<u32> = on_plane.map(|(node, _)| node as u32).collect();
                gel = gel.with_spring_constraints(on_plane, direction * SYMMETRY_STIFFNESS);
            }
        }
        if self.symmetric.contains(&true) {
            let front = self.grid.triangles(Side::Front);
            gel = gel.with_contact_surface(Surface::new(front, self.grid.positions()));
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
            driven: PressTarget::default(),
            steps: 0,
            sampling: None,
            fields: None,
        })
    }
}

/// A press in progress.
struct Run {
    system: System,
    clearance: f64,
    /// Number of copies of the grid in the whole gel.
    copies: f64,
    step_m: f64,
    /// Motion of the drive so far; its depth includes the initial clearance.
    driven: PressTarget,
    steps: u32,
    sampling: Option<FieldSampling>,
    fields: Option<FieldSeries>,
}

impl Run {
    fn move_to(&mut self, target: &PressTarget, is_cancelled: &AtomicBool) -> Result<PressPoint> {
        let (mut steps, mut iterations, mut converged) = (0, 0, true);
        let mut contacts = Vec::new();
        for attempt in 0..4 {
            // Gap and lag at the target are not known yet: repeat with those found.
            let now = self.measure();
            let missing_depth = target.depth_m - now.depth_m;
            let missing_shift = target.shift_m - now.shift_m;
            let longest = missing_depth.abs().max(missing_shift.abs());
            if attempt > 0 && longest < TARGET_TOLERANCE_M {
                break;
            }
            let count = (longest / self.step_m).ceil().max(1.0);
            for _ in 0..count as u32 {
                if is_cancelled.load(Ordering::Relaxed) {
                    return Err(Error::new(
                        ErrorKind::Interrupted,
                        "the press was interrupted",
                    ));
                }
                let by = DVec3::new(-missing_shift, 0.0, missing_depth) / count;
                self.driven.depth_m += by.z;
                self.driven.shift_m -= by.x;
                for gel in self.system.gels_mut() {
                    gel.move_target(by);
                }
                let report = self.system.step(&StepStart::default());
                self.steps += 1;
                let index = self.steps as usize - 1;
                if self.sampling.is_some_and(|sampling| sampling.takes(index)) {
                    self.record_fields(&self.system.node_contacts());
                }
                steps += 1;
                iterations += report.iterations;
                converged &= report.converged;
            }
            // The corrections are too short to slide: the way to the target decides what sticks.
            if attempt == 0 && self.sampling == Some(FieldSampling::Stages) {
                contacts = self.system.node_contacts();
            }
        }
        if self.sampling == Some(FieldSampling::Stages) {
            self.record_fields(&contacts);
        }
        Ok(PressPoint {
            steps,
            iterations,
            converged,
            ..self.measure()
        })
    }

    /// Records the fields at the end of the last step, with the state of each gel's nodes.
    fn record_fields(&mut self, contacts: &[Vec<NodeContact>]) {
        let (Some(series), Some(contact)) = (&mut self.fields, contacts.first()) else {
            return;
        };
        let gel = &self.system.gels()[0];
        let field = FaceField::new(gel, &series.mesh, contact, &DMat3::IDENTITY);
        let dt_s = self.system.parameters().dt_s;
        series.steps.push(FieldStep {
            step: self.steps.saturating_sub(1),
            stage: None,
            t_s: f64::from(self.steps) * dt_s,
            gels: vec![field],
        });
    }

    fn measure(&self) -> PressPoint {
        let gel = &self.system.gels()[0];
        let force: DVec3 = gel.contact_forces().sum();
        let (mut moved, mut total_stiffness) = (DVec3::ZERO, 0.0);
        for (&node, stiffness) in gel.driven().iter().zip(gel.drive_stiffness()) {
            let node = node as usize;
            moved += (gel.positions()[node] - gel.rest()[node]) * *stiffness;
            total_stiffness += stiffness;
        }
        moved /= total_stiffness;
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

/// Mesh of the quarter at positive x and y of a pad.
///
/// `cells` along x, y, z; each is `growth` times as long as the previous one, counted from the
/// centre of the front face.
///
/// # Errors
/// `Config` for a pad whose size is out of range; `Input` if an axis has no cells or a growth factor
/// is not positive.
pub fn quarter_pad(pad: &GelPad, cells: [usize; 3], growth: [f64; 3]) -> Result<GelGrid> {
    pad.validate()?;
    let ([half_x, half_y], thickness) = (pad.half_m(), pad.thickness_m);
    let [x, y, depth] = [(0, half_x), (1, half_y), (2, thickness)]
        .map(|(axis, length)| graded_coordinates(cells[axis], growth[axis], length));
    let z = depth.iter().rev().map(|d| thickness - d).collect();
    GelGrid::new([x, y, z])
}

/// Mesh of the half at positive y, finest at the centre: `cells` along half of x, along y and z.
///
/// # Errors
/// As [`quarter_pad`].
pub fn half_pad(pad: &GelPad, cells: [usize; 3], growth: [f64; 3]) -> Result<GelGrid> {
    let quarter = quarter_pad(pad, cells, growth)?;
    let [right, y, z] = quarter.axes().clone();
    let left = right.iter().skip(1).rev().map(|x| -x);
    GelGrid::new([left.chain(right.iter().copied()).collect(), y, z])
}

/// Node coordinates from 0 to `length` of cells that grow by a factor.
fn graded_coordinates(cells: usize, growth: f64, length: f64) -> Vec<f64> {
    let mut nodes = vec![0.0];
    let (mut end, mut cell) = (0.0, 1.0);
    for _ in 0..cells {
        end += cell;
        cell *= growth;
        nodes.push(end);
    }
    for coordinate in &mut nodes {
        *coordinate *= length / end;
    }
    nodes[cells] = length;
    nodes
}
