//! Joint least squares over views and markers of a gripper.
//!
//! Unknowns of a view: `t_camera_gripper` and the opening; of a marker: its pose on its part; of
//! all together: the direction in which the fingers slide. The views are eliminated from the
//! normal equations (B. Triggs et al., *Bundle adjustment: a modern synthesis*, 2000), which
//! leaves a small dense system for the markers.

use glam::{DVec2, DVec3};

use crate::Part;
use crate::camera::{project, project_with_jacobian};
use crate::least_squares::{Search, Trial, huber, moved};
use gripcast_base::linear::{Factor, Symmetric};
use gripcast_geometry::Pose;
use gripcast_imaging::Intrinsics;

const SEARCH: Search = Search {
    max_iterations: 50,
    min_decrease: 1e-10,
    largest_damping: None,
};
/// Steps below this (m, rad) change nothing.
const CONVERGED: f64 = 1e-10;
/// Unknowns of a view: shift and turn along the camera's axes, opening.
const OF_VIEW: usize = 7;
/// Unknowns of a marker: shift of its middle and turn along the gripper's axes.
pub(super) const OF_MARKER: usize = 6;
/// Unknowns of the sliding direction.
pub(super) const OF_SLIDE: usize = 2;
/// The sliding direction is x within about 5°, against corners of 0.1 px: decides only where the
/// images say nothing, px²/rad².
const SLIDE_PRIOR: f64 = 1.3;
/// Weight of the frame's conditions, times the largest entry of the matrix: they are exact.
const FRAME_WEIGHT: f64 = 1e3;

/// A marker that is solved for.
#[derive(Clone, Debug)]
pub(super) struct Marker {
    pub(super) id: u32,
    pub(super) part: Part,
    /// Its corners in its own frame: origin in the middle, x right, y up; m.
    pub(super) local: [DVec3; 4],
    /// `t_part_marker` of the description.
    pub(super) nominal: Pose,
    /// `t_part_marker`.
    pub(super) pose: Pose,
    /// How far it moves along the sliding direction per metre of opening.
    pub(super) slide: f64,
}

/// A marker in an image.
#[derive(Clone, Debug)]
pub(super) struct Sight {
    /// Its place in the list of markers.
    pub(super) marker: usize,
    pub(super) pixels: [DVec2; 4],
    /// False for one that was left out as an outlier.
    pub(super) used: bool,
}

/// An image.
#[derive(Clone, Debug)]
pub(super) struct View {
    /// Its place in the list of images.
    pub(super) image: usize,
    /// `t_camera_gripper`.
    pub(super) pose: Pose,
    pub(super) opening_m: f64,
    /// The opening is not known, and the image shows it.
    pub(super) frees_opening: bool,
    pub(super) sights: Vec<Sight>,
}

/// Whether some of the sights are of parts that move against each other.
pub(super) fn slides_differ(markers: &[Marker], sights: &[Sight]) -> bool {
    let slide = |s: &Sight| markers[s.marker].slide;
    let mut pairs = sights.windows(2);
    pairs.any(|pair| slide(&pair[0]) != slide(&pair[1]))
}

/// Everything that is solved for.
#[derive(Clone, Debug)]
pub(super) struct Bundle {
    pub(super) camera: Intrinsics,
    pub(super) markers: Vec<Marker>,
    /// Unit vector in the gripper's frame.
    pub(super) slide: DVec3,
    pub(super) views: Vec<View>,
}

/// A minimum.
pub(super) struct Solved {
    pub(super) bundle: Bundle,
    pub(super) loss_px: f64,
    pub(super) sigma_px: f64,
    pub(super) rms_px: f64,
}

/// What moves in a search.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Free {
    All,
    Views,
    Markers,
}

/// A condition on a step of the markers that the images leave open; its entries are not zero.
pub(super) type Condition = Vec<(usize, f64)>;

impl Marker {
    /// Its corners on its part, at opening 0, m.
    pub(super) fn corners(&self) -> [DVec3; 4] {
        self.local.map(|c| self.pose.transform_point(c))
    }
}

impl Bundle {
    /// Number of unknowns that are not of a view.
    pub(super) fn globals(&self) -> usize {
        OF_MARKER * self.markers.len() + OF_SLIDE
    }

    /// Two unit vectors across the sliding direction: the axes of its step.
    pub(super) fn across(&self) -> [DVec3; 2] {
        let first = self.slide.cross(DVec3::Z).normalize_or(DVec3::Y);
        [first, self.slide.cross(first)]
    }

    /// Distances of a marker's corners from where they are predicted, px; infinite behind the
    /// camera.
    pub(super) fn errors_px(&self, view: &View, sight: &Sight) -> [f64; 4] {
        let marker = &self.markers[sight.marker];
        let slid = self.slide * (marker.slide * view.opening_m);
        let corners = marker.corners();
        std::array::from_fn(|k| {
            let point = view.pose.transform_point(corners[k] + slid);
            project(&self.camera, point).map_or(f64::INFINITY, |p| p.distance(sight.pixels[k]))
        })
    }

    /// Root mean square of [`Self::errors_px`].
    pub(super) fn sight_rms_px(&self, view: &View, sight: &Sight) -> f64 {
        let squares = self.errors_px(view, sight).map(|e| e * e);
        (squares.iter().sum::<f64>() / 4.0).sqrt()
    }

    /// Errors of all corners that are used, px.
    pub(super) fn all_errors_px(&self) -> Vec<f64> {
        let used = |view| {
            let view: &View = view;
            let sights = view.sights.iter().filter(|s| s.used);
            sights
                .flat_map(|s| self.errors_px(view, s))
                .collect::<Vec<f64>>()
        };
        self.views.iter().flat_map(used).collect()
    }

    /// Searches the nearest minimum of the Huber loss; the conditions keep the frame where it is.
    /// The cost (px²); none where the images do not determine the unknowns.
    pub(super) fn minimise(
        &mut self,
        free: Free,
        loss_px: f64,
        conditions: &[Condition],
    ) -> Option<f64> {
        let found = SEARCH.minimise(
            self.clone(),
            |bundle| bundle.linearise(loss_px),
            |bundle, system, damping| {
                let step = system.step(free, damping, conditions)?;
                Some(Trial {
                    state: bundle.stepped(&step),
                    is_small: step.is_small(),
                })
            },
        )?;
        *self = found.state;
        Some(found.cost)
    }

    /// Covariance of the unknowns that are not of a view, for corners of 1 px, under the
    /// conditions.
    pub(super) fn covariance(&self, loss_px: f64, conditions: &[Condition]) -> Option<Symmetric> {
        let (system, _) = self.linearise(loss_px)?;
        let (matrix, _, _) = system.reduced(0.0, conditions)?;
        Some(matrix.factor()?.inverse())
    }

    fn stepped(&self, step: &Step) -> Self {
        let mut next = self.clone();
        for (view, step) in next.views.iter_mut().zip(&step.views) {
            view.pose = moved(&view.pose, step);
            view.opening_m += step.get(6).copied().unwrap_or(0.0);
        }
        for (marker, step) in next.markers.iter_mut().zip(step.globals.chunks(OF_MARKER)) {
            marker.pose = moved(&marker.pose, step);
        }
        let turned = self
            .across()
            .into_iter()
            .zip(&step.globals[self.globals() - OF_SLIDE..]);
        let turned = turned.map(|(axis, by)| axis * *by).sum::<DVec3>();
        next.slide = (self.slide + turned).normalize_or(DVec3::X);
        next
    }

    /// Normal equations of the step and the cost; none if a corner falls behind the camera.
    fn linearise(&self, loss_px: f64) -> Option<(System, f64)> {
        let mut system = System::new(self.globals(), self.views.len());
        let mut cost = 0.0;
        for (i, view) in self.views.iter().enumerate() {
            for sight in view.sights.iter().filter(|s| s.used) {
                cost += self.add_sight(i, sight, loss_px, &mut system)?;
            }
            let block = &mut system.views[i];
            // What an image does not show stays as it is.
            let shows = view.frees_opening && block.matrix.at(6, 6) > 0.0;
            if !shows {
                block.pin_opening();
            }
            if view.sights.iter().all(|s| !s.used) {
                (0..6).for_each(|i| block.matrix.pin(i));
            }
        }
        let first = self.globals() - OF_SLIDE;
        for (k, axis) in self.across().into_iter().enumerate() {
            let off = axis.dot(DVec3::X);
            system.matrix.add(first + k, first + k, SLIDE_PRIOR);
            system.vector[first + k] += SLIDE_PRIOR * off;
            cost += SLIDE_PRIOR * off * off;
        }
        cost.is_finite().then_some((system, cost))
    }

    fn add_sight(
        &self,
        number: usize,
        sight: &Sight,
        loss_px: f64,
        system: &mut System,
    ) -> Option<f64> {
        let (view, marker) = (&self.views[number], &self.markers[sight.marker]);
        let back = view.pose.rotation.conjugate();
        let across = self.across();
        let first = OF_MARKER * sight.marker;
        let last = self.globals() - OF_SLIDE;
        let mut cost = 0.0;
        for (local, seen) in marker.local.into_iter().zip(sight.pixels) {
            let on_marker = marker.pose.transform_vector(local);
            let on_part = on_marker + marker.pose.translation_m;
            let in_gripper = on_part + self.slide * (marker.slide * view.opening_m);
            let arm = view.pose.transform_vector(in_gripper);
            let (pixel, gradients) =
                project_with_jacobian(&self.camera, arm + view.pose.translation_m)?;
            let residual = seen - pixel;
            let (weight, own_cost) = huber(residual.length(), loss_px);
            cost += own_cost;
            for (gradient, value) in gradients.into_iter().zip(residual.to_array()) {
                let turn = arm.cross(gradient);
                let inner = back * gradient;
                let opening = inner.dot(self.slide) * marker.slide;
                let of_view = [
                    gradient.x, gradient.y, gradient.z, turn.x, turn.y, turn.z, opening,
                ];
                let turn = on_marker.cross(inner);
                let slid = across.map(|a| a.dot(inner) * marker.slide * view.opening_m);
                let row = [
                    (first, inner.x),
                    (first + 1, inner.y),
                    (first + 2, inner.z),
                    (first + 3, turn.x),
                    (first + 4, turn.y),
                    (first + 5, turn.z),
                    (last, slid[0]),
                    (last + 1, slid[1]),
                ];
                system.matrix.add_outer(&row, weight);
                for (i, entry) in row {
                    system.vector[i] += weight * entry * value;
                }
                system.views[number].add(&of_view, &row, value, weight);
            }
        }
        Some(cost)
    }
}

/// The equations of one view.
struct Block {
    matrix: Symmetric,
    vector: [f64; OF_VIEW],
    /// View's unknowns × those that are not of a view.
    coupling: [Vec<f64>; OF_VIEW],
}

impl Block {
    fn add(&mut self, own: &[f64; OF_VIEW], other: &[(usize, f64)], value: f64, weight: f64) {
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
        all.into_iter().all(|s| s.abs() < CONVERGED)
    }
}

impl System {
    fn new(globals: usize, views: usize) -> Self {
        let block = || Block {
            matrix: Symmetric::zero(OF_VIEW),
            vector: [0.0; OF_VIEW],
            coupling: std::array::from_fn(|_| vec![0.0; globals]),
        };
        Self {
            matrix: Symmetric::zero(globals),
            vector: vec![0.0; globals],
            views: (0..views).map(|_| block()).collect(),
        }
    }

    fn step(&self, free: Free, damping: f64, conditions: &[Condition]) -> Option<Step> {
        let still = vec![0.0; self.vector.len()];
        let (globals, factors) = match free {
            Free::All => {
                let (matrix, vector, factors) = self.reduced(damping, conditions)?;
                (matrix.factor()?.solve(&vector), Some(factors))
            }
            Free::Views => (still, Some(self.factors(damping)?)),
            Free::Markers => {
                let mut matrix = self.matrix.clone();
                matrix.damp(1.0 + damping);
                let mut vector = self.vector.clone();
                let size = matrix.size();
                (size - OF_SLIDE..size).for_each(|i| matrix.pin(i));
                vector[size - OF_SLIDE..].fill(0.0);
                (matrix.factor()?.solve(&vector), None)
            }
        };
        let views = self.views.iter().enumerate().map(|(i, block)| {
            let Some(factors) = &factors else {
                return vec![0.0; OF_VIEW];
            };
            let coupled =
                |row: &Vec<f64>| row.iter().zip(&globals).map(|(a, b)| a * b).sum::<f64>();
            let right: Vec<f64> = (0..OF_VIEW)
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

    /// The equations of what is not of a view, the conditions added: matrix and right-hand side,
    /// and the factors of the views.
    fn reduced(
        &self,
        damping: f64,
        conditions: &[Condition],
    ) -> Option<(Symmetric, Vec<f64>, Vec<Factor>)> {
        let factors = self.factors(damping)?;
        let mut matrix = self.matrix.clone();
        let scale = FRAME_WEIGHT * matrix.largest();
        matrix.damp(1.0 + damping);
        let mut vector = self.vector.clone();
        let size = matrix.size();
        for (block, factor) in self.views.iter().zip(&factors) {
            let touched: Vec<usize> = (0..size)
                .filter(|j| block.coupling.iter().any(|row| row[*j] != 0.0))
                .collect();
            let column =
                |j: usize| -> [f64; OF_VIEW] { std::array::from_fn(|k| block.coupling[k][j]) };
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
        for condition in conditions {
            matrix.add_outer(condition, scale);
        }
        Some((matrix, vector, factors))
    }
}
