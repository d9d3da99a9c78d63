//! Simulated presses for the force model: shapes, gels, forces and the motion of the face.
//!
//! A shape is a height above the face, symmetric about both axes and pressed into the middle of a
//! GelSight Mini's gel. By symmetry a quarter of the gel is simulated, half of it with shear; its
//! mesh is refined towards the contact.

use std::sync::Mutex;

use glam::DVec2;
use gripcast_base::error::{Error, Result};
use gripcast_geometry::TriangleMesh;
use gripcast_sim::fem::{GelGrid, GelPad};
use gripcast_sim::fields::FieldSampling;
use gripcast_sim::press::{Indenter, Press, PressTarget, half_pad, quarter_pad};
use gripcast_sim::solver::GelMaterial;
use gripcast_tactile::{PressDepth, SensorGeometry, foundation_pa_m};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Depths at which a press is measured, m.
const DEPTHS_M: [f64; 9] = [
    7e-5, 1.4e-4, 2.2e-4, 3.2e-4, 4.5e-4, 6.2e-4, 8.2e-4, 1.1e-3, 1.4e-3,
];
/// Young's modulus of the presses, Pa: forces are proportional to it.
pub(crate) const YOUNG_PA: f64 = 1e6;
/// Force of an elastic foundation beyond which a press is not deepened, N.
const MAX_FORCE_N: f64 = 90.0;
/// The same for the last depth of a sheared press, N.
const MAX_SHEARED_N: f64 = 25.0;
/// Shifts of a sheared press at its last depth, m, and its friction.
const SHIFTS_M: [f64; 4] = [5e-5, 1e-4, 2e-4, 3.5e-4];
const SHEARED_FRICTION: f64 = 0.8;
/// Poisson's ratios of the presses for fitting, and of those held out.
const FITTED_POISSON: [f64; 3] = [0.3, 0.4, 0.48];
const HELD_OUT_POISSON: [f64; 2] = [0.35, 0.45];
/// Every n-th shape is sheared, too.
const SHEARED_STRIDE: usize = 4;
/// Spacing of the indenter's mesh, m.
const SPACING_M: f64 = 3e-4;
/// Height above the tip up to which an indenter is meshed, m.
const MESHED_M: f64 = 2.2e-3;
/// Height of what is not there, m.
const ABSENT_M: f64 = 1.0;
/// Distance at which contact begins in the simulation, m.
const D_HAT_M: f64 = 2e-5;

/// What a press is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Use {
    /// The model is fitted to it.
    Fit,
    /// A shape that the model has not seen.
    HeldOut,
    /// A ball that is compared with the finite elements.
    Ball,
}

/// A shape and its use.
#[derive(Clone, Copy, Debug)]
struct Shape {
    name: &'static str,
    form: Form,
    split: Use,
}

#[derive(Clone, Copy, Debug)]
enum Form {
    /// Paraboloid with these radii of curvature along x and y.
    Bowl([f64; 2]),
    /// Straight 90° edge along y with a rounded tip.
    Edge(f64),
    /// Lying cylinder along y of a radius and a half length, with round ends.
    Capsule(f64, f64),
    /// Flat rounded rectangle: half sides and the radius of its rim.
    Punch([f64; 2], f64),
    /// Lying torus: radii of the ring and of its tube.
    Ring(f64, f64),
    /// Cone with a rounded tip: slope and radius.
    Cone(f64, f64),
    /// Two balls along y: radius and half distance.
    Balls(f64, f64),
}

impl Form {
    /// Height of the shape above the face, m, at a position from its middle.
    fn height(&self, p: DVec2) -> f64 {
        match self {
            Self::Bowl([rx, ry]) => p.x * p.x / (2.0 * rx) + p.y * p.y / (2.0 * ry),
            Self::Edge(radius) => {
                let x = p.x.abs();
                let round = radius * std::f64::consts::FRAC_1_SQRT_2;
                match x < round {
                    true => radius - (radius * radius - x * x).sqrt(),
                    false => x - round + radius * (1.0 - std::f64::consts::FRAC_1_SQRT_2),
                }
            }
            Self::Capsule(radius, half) => {
                let beyond = (p.y.abs() - half).max(0.0);
                cap(*radius, p.x.hypot(beyond))
            }
            Self::Punch([x, y], rim) => {
                let outside = DVec2::new(p.x.abs() - (x - rim), p.y.abs() - (y - rim));
                cap(*rim, outside.max(DVec2::ZERO).length())
            }
            Self::Ring(ring, tube) => cap(*tube, p.length() - ring),
            Self::Cone(slope, radius) => {
                let touch = radius * slope / (1.0 + slope * slope).sqrt();
                let r = p.length();
                match r < touch {
                    true => cap(*radius, r),
                    false => cap(*radius, touch) + slope * (r - touch),
                }
            }
            Self::Balls(radius, half) => {
                let ball = |y: f64| cap(*radius, (p - DVec2::Y * y).length());
                ball(*half).min(ball(-half))
            }
        }
    }
}

/// Height of a ball of a radius at a distance from its axis.
fn cap(radius: f64, distance: f64) -> f64 {
    match distance.abs() < radius {
        true => radius - (radius * radius - distance * distance).sqrt(),
        false => ABSENT_M,
    }
}

impl Shape {
    /// Surface that is pressed in: the part at x and y beyond `from`, tip at the origin.
    fn mesh(&self, from: DVec2) -> TriangleMesh {
        let far = DVec2::new(0.0132, 0.0107);
        let count = ((far - from) / SPACING_M).ceil();
        let [columns, rows] = [count.x as usize + 1, count.y as usize + 1];
        let position =
            |at: usize| from + SPACING_M * DVec2::new((at % columns) as f64, (at / columns) as f64);
        let heights: Vec<f64> = (0..columns * rows)
            .map(|at| self.form.height(position(at)))
            .collect();
        let mut triangles = Vec::new();
        for at in (0..(rows - 1) * columns).filter(|at| (at + 1) % columns != 0) {
            let corners = [at, at + 1, at + columns + 1, at + columns];
            if corners.iter().all(|corner| heights[*corner] < MESHED_M) {
                // Normals point down, towards the gel.
                let [a, b, c, d] = corners.map(|corner| corner as u32);
                triangles.extend([[a, c, b], [a, d, c]]);
            }
        }
        let vertices = heights.iter().enumerate();
        TriangleMesh {
            vertices: vertices
                .map(|(at, height)| position(at).extend(height.min(MESHED_M)))
                .collect(),
            triangles,
        }
        .without_unused_vertices()
    }

    /// Force of the whole gel as an elastic foundation, N.
    fn foundation_n(&self, depth_m: f64, material: &GelMaterial, pad: &GelPad) -> f64 {
        let [half_x, half_y] = pad.half_m();
        let stiffness = foundation_pa_m(material.young_pa, material.poisson, pad.thickness_m);
        let count = |half: f64| (half / SPACING_M) as usize;
        let columns = count(half_x);
        let sunk = (0..columns * count(half_y)).map(|at| {
            let p = DVec2::new((at % columns) as f64, (at / columns) as f64) + 0.5;
            (depth_m - self.form.height(SPACING_M * p)).max(0.0)
        });
        4.0 * stiffness * SPACING_M * SPACING_M * sunk.sum::<f64>()
    }
}

/// Place of a pressed shape in an image.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Place {
    /// Position of its middle on the gel, m.
    pub(crate) at_m: DVec2,
    /// Rotation, radians.
    pub(crate) angle: f64,
}

fn shape(name: &str) -> Result<Shape> {
    let found = shapes().into_iter().find(|shape| shape.name == name);
    found.ok_or_else(|| Error::input(format!("the presses have an unknown shape `{name}`")))
}

/// Whether a shape is longer than the gel, so that its place is known along one axis only.
pub(crate) fn is_long(name: &str) -> Result<bool> {
    let form = shape(name)?.form;
    Ok(form.height(DVec2::new(0.0, 0.01)) < 1e-4 || form.height(DVec2::new(0.0125, 0.0)) < 1e-4)
}

/// Depth per pixel of a sensor under a shape at a place.
///
/// # Errors
/// `Input` for a name that no shape has.
pub(crate) fn depth_of(
    name: &str,
    geometry: &SensorGeometry,
    depth_m: f64,
    place: &Place,
) -> Result<PressDepth> {
    let form = shape(name)?.form;
    let turn = DVec2::from_angle(-place.angle);
    let mut press = PressDepth::untouched(*geometry);
    for (at, depth) in press.depth_m.iter_mut().enumerate() {
        let (column, row) = (at % geometry.width, at / geometry.width);
        let [x, y] = geometry.pixel_to_gel_m(column as f64, row as f64);
        let height = form.height(turn.rotate(DVec2::new(x, y) - place.at_m));
        *depth = (depth_m - height).max(0.0) as f32;
    }
    Ok(press)
}

fn shapes() -> Vec<Shape> {
    use Form::{Balls, Bowl, Capsule, Cone, Edge, Punch, Ring};
    use Use::{Ball, Fit, HeldOut};
    let long = 1e6;
    let ball = |mm: f64| Capsule(1e-3 * mm, 0.0);
    let shape = |name, form, split| Shape { name, form, split };
    vec![
        shape("ball 2", ball(2.0), Fit),
        shape("ball 3.5", ball(3.5), Fit),
        shape("ball 6", ball(6.0), Fit),
        shape("ball 8", ball(8.0), Fit),
        shape("ball 14", ball(14.0), Fit),
        shape("ball 25", ball(25.0), Fit),
        shape("ball 45", ball(45.0), Fit),
        shape("bar 3", Bowl([3e-3, long]), Fit),
        shape("bar 6", Bowl([6e-3, long]), Fit),
        shape("bar 14", Bowl([14e-3, long]), Fit),
        shape("bar 35", Bowl([35e-3, long]), Fit),
        shape("bar across 8", Bowl([long, 8e-3]), Fit),
        shape("bowl 8 40", Bowl([8e-3, 40e-3]), Fit),
        shape("bowl 4 12", Bowl([4e-3, 12e-3]), Fit),
        shape("edge 0.4", Edge(0.4e-3), Fit),
        shape("edge 1", Edge(1e-3), Fit),
        shape("capsule 3 4", Capsule(3e-3, 4e-3), Fit),
        shape("capsule 6 3", Capsule(6e-3, 3e-3), Fit),
        shape("punch 5 5", Punch([2.5e-3, 2.5e-3], 0.8e-3), Fit),
        shape("punch 10 6", Punch([5e-3, 3e-3], 1e-3), Fit),
        shape("punch 3 10", Punch([1.5e-3, 5e-3], 0.5e-3), Fit),
        shape("ring 4 1.5", Ring(4e-3, 1.5e-3), Fit),
        shape("cone 0.4", Cone(0.4, 1e-3), Fit),
        shape("balls 3 3", Balls(3e-3, 3e-3), Fit),
        shape("ball 5", ball(5.0), Ball),
        shape("ball 10", ball(10.0), Ball),
        shape("ball 18", ball(18.0), Ball),
        shape("ball 32", ball(32.0), Ball),
        shape("bar 9", Bowl([9e-3, long]), HeldOut),
        shape("bar across 20", Bowl([long, 20e-3]), HeldOut),
        shape("bowl 6 25", Bowl([6e-3, 25e-3]), HeldOut),
        shape("bowl 15 60", Bowl([15e-3, 60e-3]), HeldOut),
        shape("edge 0.7", Edge(0.7e-3), HeldOut),
        shape("capsule 4 5", Capsule(4e-3, 5e-3), HeldOut),
        shape("capsule 9 4", Capsule(9e-3, 4e-3), HeldOut),
        shape("punch 7 7", Punch([3.5e-3, 3.5e-3], 0.9e-3), HeldOut),
        shape("ring 3 2", Ring(3e-3, 2e-3), HeldOut),
        shape("cone 0.25", Cone(0.25, 2e-3), HeldOut),
        shape("balls 4 4", Balls(4e-3, 4e-3), HeldOut),
    ]
}

/// One state of a press, forces at [`YOUNG_PA`].
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct State {
    pub(crate) depth_m: f64,
    pub(crate) shift_m: f64,
    pub(crate) normal_n: f64,
    pub(crate) shear_n: f64,
    /// Displacement of the nodes of the whole face along x and y, m; only of sheared presses.
    pub(crate) face_m: Vec<[f32; 2]>,
}

/// A simulated press.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct SimulatedPress {
    pub(crate) shape: String,
    pub(crate) split: Use,
    pub(crate) poisson: f64,
    pub(crate) is_sheared: bool,
    pub(crate) states: Vec<State>,
}

struct Job {
    shape: Shape,
    poisson: f64,
    is_sheared: bool,
}

fn jobs() -> Vec<Job> {
    let mut jobs = Vec::new();
    for (index, shape) in shapes().into_iter().enumerate() {
        let poissons: &[f64] = match shape.split {
            Use::Fit => &FITTED_POISSON,
            // Each held-out shape on one of the gels.
            Use::HeldOut => &HELD_OUT_POISSON[index % 2..][..1],
            Use::Ball => &HELD_OUT_POISSON,
        };
        for poisson in poissons {
            let is_sheared = index % SHEARED_STRIDE == 0 && *poisson != 0.4;
            let sheared: &[bool] = if is_sheared { &[false, true] } else { &[false] };
            jobs.extend(sheared.iter().map(|is_sheared| Job {
                shape,
                poisson: *poisson,
                is_sheared: *is_sheared,
            }));
        }
    }
    jobs
}

/// Simulates all presses, or every `stride`-th; `progress` gets the numbers of finished presses and
/// of all.
///
/// # Errors
/// Those of the simulator.
pub(crate) fn simulate(
    stride: usize,
    progress: &(dyn Fn(usize, usize) + Sync),
) -> Result<Vec<SimulatedPress>> {
    let jobs: Vec<Job> = jobs().into_iter().step_by(stride.max(1)).collect();
    let done = Mutex::new(0);
    let run = |job: &Job| {
        let press = job.run().map_err(|e| e.at(job.shape.name))?;
        if let Ok(mut done) = done.lock() {
            *done += 1;
            progress(*done, jobs.len());
        }
        Ok(press)
    };
    jobs.par_iter().map(run).collect()
}

/// Mesh of the half that is simulated with shear: cells along half of x, along y and z.
fn sheared_grid() -> Result<GelGrid> {
    half_pad(&GelPad::default(), [11, 10, 5], [1.13, 1.13, 1.25])
}

/// The whole gel of a sheared press, whose face nodes [`State::face_m`] moves.
///
/// # Errors
/// None for the built-in mesh.
pub(crate) fn whole_grid() -> Result<GelGrid> {
    let [x, y, z] = sheared_grid()?.axes().clone();
    let mirrored = y.iter().skip(1).rev().map(|y| -y);
    GelGrid::new([x, mirrored.chain(y.iter().copied()).collect(), z])
}

/// Displacements of the whole face from those of its half at positive y.
fn mirrored(half: &[[f32; 3]], columns: usize) -> Vec<[f32; 2]> {
    let rows: Vec<&[[f32; 3]]> = half.chunks_exact(columns).collect();
    let row = |row: &[[f32; 3]], sign: f32| -> Vec<[f32; 2]> {
        row.iter().map(|[x, y, _]| [*x, sign * y]).collect()
    };
    let below = rows.iter().skip(1).rev().map(|r| row(r, -1.0));
    let above = rows.iter().map(|r| row(r, 1.0));
    below.chain(above).flatten().collect()
}

impl Job {
    fn run(&self) -> Result<SimulatedPress> {
        let pad = GelPad::default();
        let [half_x, _] = pad.half_m();
        let (grid, from) = match self.is_sheared {
            false => {
                let grid = quarter_pad(&pad, [14, 12, 6], [1.12, 1.12, 1.2])?;
                (grid, DVec2::splat(-2.0 * SPACING_M))
            }
            true => (sheared_grid()?, DVec2::new(-half_x, -2.0 * SPACING_M)),
        };
        let mut press = Press::new(grid, Indenter::Mesh(self.shape.mesh(from)));
        press.symmetric = [!self.is_sheared, true];
        press.friction = if self.is_sheared {
            SHEARED_FRICTION
        } else {
            0.0
        };
        press.material = GelMaterial {
            young_pa: YOUNG_PA,
            poisson: self.poisson,
            ..GelMaterial::default()
        };
        press.d_hat_m = D_HAT_M;
        let targets = self.targets(&press.material, &pad);
        let (points, fields) = press.run_with_fields(&targets, Some(FieldSampling::Stages))?;
        let fields = fields.map(|series| series.steps).unwrap_or_default();
        let columns = press.grid.nodes()[0];
        let states = points
            .iter()
            .zip(&fields)
            .filter(|(point, _)| point.converged);
        let states = states.map(|(point, field)| State {
            depth_m: point.depth_m,
            shift_m: point.shift_m,
            normal_n: point.normal_n,
            shear_n: point.shear_n,
            face_m: match self.is_sheared {
                true => mirrored(&field.gels[0].displacement_m, columns),
                false => Vec::new(),
            },
        });
        Ok(SimulatedPress {
            shape: self.shape.name.to_owned(),
            split: self.shape.split,
            poisson: self.poisson,
            is_sheared: self.is_sheared,
            states: states.collect(),
        })
    }

    /// Depths that a foundation carries with a plausible force; with shear, the last of them and the
    /// shifts there.
    fn targets(&self, material: &GelMaterial, pad: &GelPad) -> Vec<PressTarget> {
        let limit_n = if self.is_sheared {
            MAX_SHEARED_N
        } else {
            MAX_FORCE_N
        };
        let is_within = |d: &&f64| self.shape.foundation_n(**d, material, pad) < limit_n;
        let target = |depth_m: f64, shift_m: f64| PressTarget { depth_m, shift_m };
        let mut depths: Vec<f64> = DEPTHS_M.iter().filter(is_within).copied().collect();
        let last_m = *depths.last().unwrap_or(&DEPTHS_M[0]);
        if self.is_sheared || depths.is_empty() {
            depths = vec![last_m];
        }
        let shifts: &[f64] = if self.is_sheared { &SHIFTS_M } else { &[] };
        let sheared = shifts.iter().map(|shift_m| target(last_m, *shift_m));
        depths
            .iter()
            .map(|d| target(*d, 0.0))
            .chain(sheared)
            .collect()
    }
}
