//! Eight triangles of a leaf against a ray.

use glam::Vec3;

use super::lanes::{Lanes, WIDTH};
use super::{Hit, NOTHING};
use crate::render::visual::camera::Ray;

/// Corners of up to eight triangles, coordinate by coordinate; absent ones are no numbers and
/// never hit.
#[derive(Clone, Debug)]
#[repr(C, align(64))]
pub(super) struct Triangles {
    /// `corners[c][axis][lane]`.
    corners: [[[f32; WIDTH]; 3]; 3],
    /// Place of the first triangle in the order of the leaves.
    first: u32,
}

/// A ray whose largest component of the direction was made the z axis by shearing.
pub(super) struct Shear<L: Lanes> {
    /// Axes of the world that become x, y, z.
    axes: [usize; 3],
    /// Origin along these axes.
    origin: [f32; 3],
    lanes_origin: [L::F; 3],
    /// Shear of x, of y, and scale of z.
    shear: [f32; 3],
    lanes_shear: [L::F; 3],
}

impl<L: Lanes> Shear<L> {
    #[inline(always)]
    pub(super) fn new(lanes: L, ray: &Ray) -> Self {
        let d = ray.direction.to_array();
        let size = d.map(f32::abs);
        let z = if size[0] > size[1] && size[0] > size[2] {
            0
        } else if size[1] > size[2] {
            1
        } else {
            2
        };
        let axes = [[1, 2, 0], [2, 0, 1], [0, 1, 2]][z];
        let o = ray.origin.to_array();
        let origin = axes.map(|a| o[a]);
        let scale = 1.0 / d[z];
        let shear = [d[axes[0]] * scale, d[axes[1]] * scale, scale];
        Self {
            axes,
            origin,
            lanes_origin: origin.map(|v| lanes.splat(v)),
            shear,
            lanes_shear: shear.map(|v| lanes.splat(v)),
        }
    }
}

/// What the test gives for eight triangles.
struct Tested<L: Lanes> {
    /// Lanes that are hit.
    mask: u32,
    t: L::F,
    /// Weights of the second and third corner, not yet divided by their sum.
    weights: [L::F; 2],
    inverse_sum: L::F,
}

impl Triangles {
    /// At most [`WIDTH`] triangles by their corners.
    pub(super) fn new(first: u32, faces: impl Iterator<Item = [Vec3; 3]>) -> Self {
        let mut corners = [[[f32::NAN; WIDTH]; 3]; 3];
        for (lane, face) in faces.take(WIDTH).enumerate() {
            for (c, corner) in face.iter().enumerate() {
                for axis in 0..3 {
                    corners[c][axis][lane] = corner[axis];
                }
            }
        }
        Self { corners, first }
    }

    #[inline(always)]
    pub(super) fn closest<L: Lanes>(&self, lanes: L, ray: &Shear<L>, reach: f32) -> Option<Hit> {
        let tested = self.test(lanes, ray, reach);
        let mut mask = tested.mask;
        if mask == 0 {
            return None;
        }
        let t = lanes.store(tested.t);
        let mut nearest = mask.trailing_zeros() as usize & (WIDTH - 1);
        mask &= mask - 1;
        while mask != 0 {
            let lane = mask.trailing_zeros() as usize & (WIDTH - 1);
            mask &= mask - 1;
            if t[lane] < t[nearest] {
                nearest = lane;
            }
        }
        let inverse = lanes.store(tested.inverse_sum)[nearest];
        let weights = tested.weights.map(|w| lanes.store(w)[nearest] * inverse);
        debug_assert!(self.first != NOTHING);
        Some(Hit {
            t: t[nearest],
            face: self.first + nearest as u32,
            weights,
        })
    }

    #[inline(always)]
    pub(super) fn any<L: Lanes>(&self, lanes: L, ray: &Shear<L>, reach: f32) -> bool {
        self.test(lanes, ray, reach).mask != 0
    }

    #[inline(always)]
    fn test<L: Lanes>(&self, lanes: L, ray: &Shear<L>, reach: f32) -> Tested<L> {
        let zero = lanes.splat(0.0);
        let [sx, sy, sz] = ray.lanes_shear;
        let sheared = |corner: &[[f32; WIDTH]; 3]| {
            let [x, y, z] = [0, 1, 2].map(|k| {
                let axis = ray.axes[k];
                lanes.sub(lanes.load(&corner[axis]), ray.lanes_origin[k])
            });
            let x = lanes.sub(x, lanes.mul(sx, z));
            let y = lanes.sub(y, lanes.mul(sy, z));
            [x, y, z]
        };
        let [a, b, c] = [0, 1, 2].map(|corner| sheared(&self.corners[corner]));
        let edge =
            |p: [L::F; 3], q: [L::F; 3]| lanes.sub(lanes.mul(p[0], q[1]), lanes.mul(p[1], q[0]));
        let mut edges = [edge(c, b), edge(a, c), edge(b, a)];
        let on_edge = edges.iter().fold(0, |m, &e| m | lanes.eq(e, zero));
        if on_edge != 0 {
            let exact = self.exact_edges(on_edge, ray, edges.map(|e| lanes.store(e)));
            edges = [0, 1, 2].map(|k| lanes.load(&exact[k]));
        }
        let [u, v, w] = edges;
        let sum = lanes.add(u, lanes.add(v, w));
        let inverse_sum = lanes.div(lanes.splat(1.0), sum);
        let scaled = lanes.add(
            lanes.mul(u, a[2]),
            lanes.add(lanes.mul(v, b[2]), lanes.mul(w, c[2])),
        );
        let t = lanes.mul(lanes.mul(scaled, sz), inverse_sum);
        let least = lanes.min(u, lanes.min(v, w));
        let most = lanes.max(u, lanes.max(v, w));
        // Lanes that hold no number fail every comparison, also that of the distance.
        let inside = lanes.le(zero, least) | lanes.le(most, zero);
        let ahead = lanes.lt(zero, t) & lanes.lt(t, lanes.splat(reach));
        let flat = lanes.eq(sum, zero);
        Tested {
            mask: inside & ahead & !flat,
            t,
            weights: [v, w],
            inverse_sum,
        }
    }

    /// Edge functions in double precision for rays that meet an edge exactly, as far as single
    /// precision can tell: the sign must be the same for both triangles at the edge.
    #[cold]
    #[inline(never)]
    fn exact_edges<L: Lanes>(
        &self,
        mut mask: u32,
        ray: &Shear<L>,
        mut edges: [[f32; WIDTH]; 3],
    ) -> [[f32; WIDTH]; 3] {
        while mask != 0 {
            let lane = mask.trailing_zeros() as usize & (WIDTH - 1);
            mask &= mask - 1;
            // The same single-precision coordinates as in the wide test.
            let [a, b, c] = [0, 1, 2].map(|corner| {
                let place = |k: usize| self.corners[corner][ray.axes[k]][lane] - ray.origin[k];
                let z = place(2);
                [0, 1].map(|k| f64::from(place(k) - ray.shear[k] * z))
            });
            let edge = |p: [f64; 2], q: [f64; 2]| (p[0] * q[1] - p[1] * q[0]) as f32;
            edges[0][lane] = edge(c, b);
            edges[1][lane] = edge(a, c);
            edges[2][lane] = edge(b, a);
        }
        edges
    }
}
