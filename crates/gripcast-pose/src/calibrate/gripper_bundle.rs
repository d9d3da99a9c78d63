//! Bundle adjustment over views and markers of a gripper.
//!
//! Parameters of a view: `t_camera_gripper` and the opening; of a marker: its pose on its body;
//! global: the sliding direction of the fingers. The views are eliminated from the normal equations
//! (B. Triggs et al., *Bundle adjustment: a modern synthesis*, 2000), which leaves a small dense
//! system for the markers.

use glam::{DVec2, DVec3};

use crate::Body;
use crate::camera::{project, project_with_jacobian};
use crate::least_squares::{Search, Trial, huber, moved, pose_row, rms};
use gripcast_base::linear::{Factor, Symmetric};
use gripcast_geometry::Pose;
use gripcast_imaging::Intrinsics;

const SEARCH: Search = Search {
    max_iterations: 50,
    min_decrease: 1e-10,
    max_damping: None,
};
/// Convergence tolerance of steps, m and rad.
const TOLERANCE: f64 = 1e-10;
/// Parameters of a view: translation and rotation along the camera's axes, opening.
const VIEW_PARAMETERS: usize = 7;
/// Parameters of a marker: translation of its centre and rotation along the gripper's axes.
pub(super) const MARKER_PARAMETERS: usize = 6;
/// Parameters of the sliding direction.
pub(super) const SLIDE_PARAMETERS: usize = 2;
/// Prior weight of x as sliding direction, px²/rad²: about 5° against corner noise of 0.1 px, so
/// that it only matters where the images do not determine the direction.
const SLIDE_PRIOR: f64 = 1.3;
/// Weight of the frame constraints, times the largest matrix entry: they hold exactly.
const CONSTRAINT_WEIGHT: f64 = 1e3;

/// A marker whose pose is estimated.
#[derive(Clone, Debug)]
pub(super) struct Marker {
    pub(super) id: u32,
    pub(super) body: Body,
    /// Corners in the marker frame (origin at the centre, x right, y up), m.
    pub(super) local: [DVec3; 4],
    /// Nominal `t_body_marker`, from the board file.
    pub(super) nominal: Pose,
    /// `t_body_marker`.
    pub(super) pose: Pose,
    /// Displacement along the sliding direction per metre of opening.
    pub(super) slide: f64,
}

/// A marker observed in an image.
#[derive(Clone, Debug)]
pub(super) struct Observation {
    /// Index of the marker.
    pub(super) marker: usize,
    pub(super) pixels: [DVec2; 4],
    /// False for an outlier.
    pub(super) used: bool,
}

/// An image.
#[derive(Clone, Debug)]
pub(super) struct View {
    /// Index of the image.
    pub(super) image: usize,
    /// `t_camera_gripper`.
    pub(super) pose: Pose,
    pub(super) opening_m: f64,
    /// Whether the opening is unknown and determined by the image.
    pub(super) frees_opening: bool,
    pub(super) observations: Vec<Observation>,
}

/// Whether the observed markers are on bodies that move relative to each other.
pub(super) fn slides_differ(markers: &[Marker], observations: &[Observation]) -> bool {
    let slide = |o: &Observation| markers[o.marker].slide;
    let mut pairs = observations.windows(2);
    pairs.any(|pair| slide(&pair[0]) != slide(&pair[1]))
}

/// All parameters of the adjustment.
#[derive(Clone, Debug)]
pub(super) struct Bundle {
    pub(super) camera: Intrinsics,
    pub(super) markers: Vec<Marker>,
    /// Unit vector in the gripper's frame.
    pub(super) slide: DVec3,
    pub(super) views: Vec<View>,
}

/// Result of the bundle adjustment.
pub(super) struct Solution {
    pub(super) bundle: Bundle,
    pub(super) loss_px: f64,
    pub(super) sigma_px: f64,
    pub(super) rms_px: f64,
}

/// Which parameters are free.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Free {
    All,
    Views,
    Markers,
}

/// Linear constraint on a step in a direction that the images do not determine: non-zero entries
/// by parameter.
pub(super) type Constraint = Vec<(usize, f64)>;

impl Marker {
    /// Corners on the body at opening 0, m.
    pub(super) fn corners(&self) -> [DVec3; 4] {
        self.local.map(|c| self.pose.transform_point(c))
    }
}

impl Bundle {
    /// Number of global parameters: those of markers and sliding direction.
    pub(super) fn globals(&self) -> usize {
        MARKER_PARAMETERS * self.markers.len() + SLIDE_PARAMETERS
    }

    /// Two unit vectors perpendicular to the sliding direction: the axes of its step.
    pub(super) fn across(&self) -> [DVec3; 2] {
        let first = self.slide.cross(DVec3::Z).normalize_or(DVec3::Y);
        [first, self.slide.cross(first)]
    }

    /// Reprojection errors of a marker's corners, px; infinite behind the camera.
    pub(super) fn errors_px(&self, view: &View, observation: &Observation) -> [f64; 4] {
        let marker = &self.markers[observation.marker];
        let slid = self.slide * (marker.slide * view.opening_m);
        let corners = marker.corners();
        std::array::from_fn(|k| {
            let point = view.pose.transform_point(corners[k] + slid);
            let pixel = observation.pixels[k];
            project(&self.camera, point).map_or(f64::INFINITY, |p| p.distance(pixel))
        })
    }

    /// RMS reprojection error of a marker, px.
    pub(super) fn rms_px(&self, view: &View, observation: &Observation) -> f64 {
        rms(&self.errors_px(view, observation))
    }

    /// Reprojection errors of all inlier corners, px.
    pub(super) fn all_errors_px(&self) -> Vec<f64> {
        let inliers = |view| {
            let view: &View = view;
            let observations = view.observations.iter().filter(|o| o.used);
            observations.flat_map(|o| self.errors_px(view, o))
        };
        self.views.iter().flat_map(inliers).collect()
    }

    /// Minimises the Huber loss under the constraints, which fix the frame. Returns the cost (px²);
    /// none if the images do not determine the parameters.
    pub(super) fn minimise(
        &mut self,
        free: Free,
        loss_px: f64,
        constraints: &[Constraint],
    ) -> Option<f64> {
        let minimum = SEARCH.minimise(
            self.clone(),
            |bundle| bundle.linearise(loss_px),
            |bundle, system, damping| {
                let step = system.step(free, damping, constraints)?;
                Some(Trial {
                    state: bundle.stepped(&step),
                    is_small: step.is_small(),
                })
            },
        )?;
        *self = minimum.state;
        Some(minimum.cost)
    }

    /// Covariance of the global parameters under the constraints, for corner noise of 1 px.
    pub(super) fn covariance(&self, loss_px: f64, constraints: &[Constraint]) -> Option<Symmetric> {
        let (system, _) = self.linearise(loss_px)?;
        let (matrix, _, _) = system.reduced(0.0, constraints)?;
        Some(matrix.factor()?.inverse())
    }

    fn stepped(&self, step: &Step) -> Self {
        let mut next = self.clone();
        for (view, step) in next.views.iter_mut().zip(&step.views) {
            view.pose = moved(&view.pose, step);
            view.opening_m += step.get(6).copied().unwrap_or(0.0);
        }
        for (marker, step) in next
            .markers
            .iter_mut()
            .zip(step.globals.chunks(MARKER_PARAMETERS))
        {
            marker.pose = moved(&marker.pose, step);
        }
        let slide_step = &step.globals[self.globals() - SLIDE_PARAMETERS..];
        let slide_step = self.across().into_iter().zip(slide_step);
        let change = slide_step.map(|(axis, by)| axis * *by).sum::<DVec3>();
        next.slide = (self.slide + change).normalize_or(DVec3::X);
        next
    }

    /// Normal equations of the step and cost. None if a corner does not project.
    fn linearise(&self, loss_px: f64) -> Option<(System, f64)> {
        let mut system = System::new(self.globals(), self.views.len());
        let mut cost = 0.0;
        for (i, view) in self.views.iter().enumerate() {
            for observation in view.observations.iter().filter(|o| o.used) {
                cost += self.add_observation(i, observation, loss_px, &mut system)?;
            }
            let block = &mut system.views[i];
            // Parameters that an image does not determine stay fixed.
            let is_determined = view.frees_opening && block.matrix.at(6, 6) > 0.0;
            if !is_determined {
                block.pin_opening();
            }
            if view.observations.iter().all(|o| !o.used) {
                (0..6).for_each(|i| block.matrix.pin(i));
            }
        }
        let first = self.globals() - SLIDE_PARAMETERS;
        for (k, axis) in self.across().into_iter().enumerate() {
            let off = axis.dot(DVec3::X);
            system.matrix.add(first + k, first + k, SLIDE_PRIOR);
            system.vector[first + k] += SLIDE_PRIOR * off;
            cost += SLIDE_PRIOR * off * off;
        }
        cost.is_finite().then_some((system, cost))
    }

    fn add_observation(
        &self,
        view_index: usize,
        observation: &Observation,
        loss_px: f64,
        system: &mut System,
    ) -> Option<f64> {
        let view = &self.views[view_index];
        let marker = &self.markers[observation.marker];
        let back = view.pose.rotation.conjugate();
        let across = self.across();
        let first = MARKER_PARAMETERS * observation.marker;
        let last = self.globals() - SLIDE_PARAMETERS;
        let mut cost = 0.0;
        for (local, observed) in marker.local.into_iter().zip(observation.pixels) {
            let on_marker = marker.pose.transform_vector(local);
            let on_body = on_marker + marker.pose.translation_m;
            let in_gripper = on_body + self.slide * (marker.slide * view.opening_m);
            let arm = view.pose.transform_vector(in_gripper);
            let (pixel, gradients) =
                project_with_jacobian(&self.camera, arm + view.pose.translation_m)?;
            let residual = observed - pixel;
            let (weight, own_cost) = huber(residual.length(), loss_px);
            cost += own_cost;
            for (gradient, value) in gradients.into_iter().zip(residual.to_array()) {
                let inner = back * gradient;
                let opening = inner.dot(self.slide) * marker.slide;
                let [x, y, z, rx, ry, rz] = pose_row(gradient, arm);
                let view_row = [x, y, z, rx, ry, rz, opening];
                let [x, y, z, rx, ry, rz] = pose_row(inner, on_marker);
                let slid = across.map(|a| a.dot(inner) * marker.slide * view.opening_m);
                let row = [
                    (first, x),
                    (first + 1, y),
                    (first + 2, z),
                    (first + 3, rx),
                    (first + 4, ry),
                    (first + 5, rz),
                    (last, slid[0]),
                    (last + 1, slid[1]),
                ];
                system.matrix.add_outer(&row, weight);
                for (i, entry) in row {
                    system.vector[i] += weight * entry * value;
                }
                system.views[view_index].add(&view_row, &row, value, weight);
            }
        }
        Some(cost)
    }
}

/// Normal equations of a view.
struct Block {
    matrix: Symmetric,
    vector: [f64; VIEW_PARAMETERS],
    /// View parameters × global parameters.
    coupling: [Vec<f64>; VIEW_PARAMETERS],
}

impl Block {
    fn add(
        &mut self,
        own: &[f64; VIEW_PARAMETERS],
        other: &[(usize, f64)],
        value: f64,
        weight: f64,
    ) {
        for (i, a) in own.iter().enumerate() {
            let weighted = weight * a;
            for (j, b) in own.iter().enumerate() {
                self.matrix.add(i, j, weighted * b);
            }
            for (j, b) in other {
                self.coupling[i][*j] += weighted * b;
            }
            self.vector[i] += weighted * value;
        }
    }

    fn pin_opening(&mut self) {
        self.matrix.pin(6);
        self.vector[6] = 0.0;
        self.coupling[6].fill(0.0);
    }
}

struct System {
    matrix: Symmetric,
    vector: Vec<f64>,
    views: Vec<Block>,
}

struct Step {
    views: Vec<Vec<f64>>,
    globals: Vec<f64>,
}

impl Step {
    fn is_small(&self) -> bool {
        let all = self.views.iter().flatten().chain(&self.globals);
        all.into_iter().all(|s| s.abs() < TOLERANCE)
    }
}

impl System {
    fn new(globals: usize, views: usize) -> Self {
        let block = || Block {
            matrix: Symmetric::zero(VIEW_PARAMETERS),
            vector: [0.0; VIEW_PARAMETERS],
            coupling: std::array::from_fn(|_| vec![0.0; globals]),
        };
        Self {
            matrix: Symmetric::zero(globals),
            vector: vec![0.0; globals],
            views: (0..views).map(|_| block()).collect(),
        }
    }

    fn step(&self, free: Free, damping: f64, constraints: &[Constraint]) -> Option<Step> {
        let still = vec![0.0; self.vector.len()];
        let (globals, factors) = match free {
            Free::All => {
                let (matrix, vector, factors) = self.reduced(damping, constraints)?;
                (matrix.factor()?.solve(&vector), Some(factors))
            }
            Free::Views => (still, Some(self.factors(damping)?)),
            Free::Markers => {
                let mut matrix = self.matrix.clone();
                matrix.damp(1.0 + damping);
                let mut vector = self.vector.clone();
                let size = matrix.size();
                (size - SLIDE_PARAMETERS..size).for_each(|i| matrix.pin(i));
                vector[size - SLIDE_PARAMETERS..].fill(0.0);
                (matrix.factor()?.solve(&vector), None)
            }
        };
        let views = self.views.iter().enumerate().map(|(i, block)| {
            let Some(factors) = &factors else {
                return vec![0.0; VIEW_PARAMETERS];
            };
            let coupled =
                |row: &Vec<f64>| row.iter().zip(&globals).map(|(a, b)| a * b).sum::<f64>();
            let right: Vec<f64> = (0..VIEW_PARAMETERS)
                .map(|k| block.vector[k] - coupled(&block.coupling[k]))
                .collect();
            factors[i].solve(&right)
        });
        let views = views.collect();
        Some(Step { views, globals })
    }

    fn factors(&self, damping: f64) -> Option<Vec<Factor>> {
        let damped = |block: &Block| {
            let mut matrix = block.matrix.clone();
            matrix.damp(1.0 + damping);
            matrix.factor()
        };
        self.views.iter().map(damped).collect()
    }

    /// Eliminates the views and adds the constraints. Returns matrix and right-hand side of the
    /// global parameters, and the factors of the views.
    fn reduced(
        &self,
        damping: f64,
        constraints: &[Constraint],
    ) -> Option<(Symmetric, Vec<f64>, Vec<Factor>)> {
        let factors = self.factors(damping)?;
        let mut matrix = self.matrix.clone();
        let scale = CONSTRAINT_WEIGHT * matrix.largest();
        matrix.damp(1.0 + damping);
        let mut vector = self.vector.clone();
        let size = matrix.size();
        for (block, factor) in self.views.iter().zip(&factors) {
            let touched: Vec<usize> = (0..size)
                .filter(|j| block.coupling.iter().any(|row| row[*j] != 0.0))
                .collect();
            let column = |j: usize| -> [f64; VIEW_PARAMETERS] {
                std::array::from_fn(|k| block.coupling[k][j])
            };
            for j in &touched {
                let solved = factor.solve(&column(*j));
                let with =
                    |other: &[f64]| other.iter().zip(&solved).map(|(a, b)| a * b).sum::<f64>();
                for i in &touched {
                    matrix.add(*i, *j, -with(&column(*i)));
                }
                vector[*j] -= with(&block.vector);
            }
        }
        for constraint in constraints {
            matrix.add_outer(constraint, scale);
        }
        Some((matrix, vector, factors))
    }
}
