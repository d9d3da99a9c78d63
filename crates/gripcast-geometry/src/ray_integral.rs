//! Integrals over the inside of a surface by parallel rays.

use std::f64::consts::{E, FRAC_1_PI};
use std::ops::Range;

use glam::{DMat3, DVec3};
use robust::{Coord, orient2d};

use super::mass_properties::{Moments, outer};
use super::winding_number::WindingNumber;

/// Distance along a ray, as a fraction of the diagonal, up to which crossings coincide.
const COINCIDENT: f64 = 1e-6;
/// Offset of the first ray from the corner of the bounding box, in cells: irrational, so that rays
/// avoid the edges of regular meshes.
const OFFSET: [f64; 2] = [-FRAC_1_PI, -0.1 * E];

/// A surface closed by additional triangles, for integration.
pub(super) struct ClosedSurface<'a> {
    /// Corners of all triangles, m.
    pub(super) triangles: &'a [[DVec3; 3]],
    /// Winding number of the additional triangles; `None` if there are none.
    pub(super) closing: Option<&'a WindingNumber>,
    /// Reference point of the moments, m: the centre of the bounding box.
    pub(super) center: DVec3,
    /// Sides of the bounding box, m.
    pub(super) extent: DVec3,
}

/// What the surface integrals of a closed surface count wrongly.
#[derive(Clone, Copy, Debug)]
pub(super) struct Miscount {
    /// Moments of the surface integral beyond those of the inside, where each point counts once.
    pub(super) excess: Moments,
    /// Volume that is counted more than once, as often as it is, m³.
    pub(super) repeated_m3: f64,
    /// Volume of which it is unclear whether it is inside: its winding number is between 1/4 and
    /// 3/4, or negative; m³.
    pub(super) unclear_m3: f64,
}

/// Where a ray crosses a triangle.
struct Crossing {
    ray: u32,
    /// Position along the ray, m.
    at: f64,
    /// Change of the winding number.
    step: i32,
}

/// Rays along one axis, in the coordinates across (u, v) and along them.
struct Rays {
    axis: usize,
    /// Rays in the directions u and v.
    count: [usize; 2],
    /// Distances of the rays, m.
    pitch: [f64; 2],
    /// Position of the first ray, m.
    first: [f64; 2],
}

impl ClosedSurface<'_> {
    /// Integrates along about `resolution`² rays in the direction of an axis (0, 1, 2). A point is
    /// inside if its generalised winding number is above 1/2.
    pub(super) fn miscount(&self, axis: usize, resolution: usize) -> Miscount {
        let mut found = Miscount {
            excess: Moments::ZERO,
            repeated_m3: 0.0,
            unclear_m3: 0.0,
        };
        if self.extent.min_element() <= 0.0 {
            return found;
        }
        let rays = Rays::new(axis, self.extent, resolution);
        let shortest = COINCIDENT * self.extent.length();
        let longest = self.extent[axis] / resolution as f64;
        let mut crossings = self.crossings(&rays);
        crossings.sort_unstable_by(|a, b| {
            let along = a.at.total_cmp(&b.at);
            a.ray.cmp(&b.ray).then(along).then(a.step.cmp(&b.step))
        });
        for ray in crossings.chunk_by(|a, b| a.ray == b.ray) {
            let mut level = 0;
            for pair in ray.windows(2) {
                level += pair[0].step;
                let (from, to) = (pair[0].at, pair[1].at);
                if to - from <= shortest {
                    continue;
                }
                // Between crossings, the winding number changes only near a hole.
                let parts = match self.closing {
                    Some(_) => ((to - from) / longest).ceil().max(1.0),
                    None => 1.0,
                };
                let step = (to - from) / parts;
                for part in 0..parts as usize {
                    let start = from + step * part as f64;
                    let segment = rays.segment(pair[0].ray, start, start + step);
                    self.count(&segment, level, &mut found);
                }
            }
        }
        found
    }

    /// Adds a segment on which the closed surface has the winding number `level`.
    fn count(&self, segment: &Segment, level: i32, found: &mut Miscount) {
        let closing = self
            .closing
            .map_or(0.0, |closing| closing.at(self.center + segment.middle()));
        let winding = f64::from(level) - closing;
        let inside = i32::from(winding > 0.5);
        let volume = segment.volume();
        if winding < -0.25 || (winding > 0.25 && winding < 0.75) {
            found.unclear_m3 += volume;
        }
        if inside == 1 && level > 1 {
            found.repeated_m3 += volume * f64::from(level - 1);
        }
        if level != inside {
            found
                .excess
                .add(&segment.moments(), f64::from(level - inside));
        }
    }

    fn crossings(&self, rays: &Rays) -> Vec<Crossing> {
        let mut crossings = Vec::new();
        for corners in self.triangles {
            let corners = corners.map(|corner| rays.permuted(corner - self.center));
            rays.cross(&corners, &mut crossings);
        }
        crossings
    }
}

impl Rays {
    fn new(axis: usize, extent: DVec3, resolution: usize) -> Self {
        let sides = [extent[(axis + 1) % 3], extent[(axis + 2) % 3]];
        let pitch = sides.map(|side| side / resolution as f64);
        Self {
            axis,
            count: [resolution + 1; 2],
            first: [0, 1].map(|k| -0.5 * sides[k] + (OFFSET[k] + 0.5) * pitch[k]),
            pitch,
        }
    }

    /// Coordinates (u, v, along the ray); a cyclic permutation, which keeps orientations.
    fn permuted(&self, p: DVec3) -> DVec3 {
        DVec3::new(p[(self.axis + 1) % 3], p[(self.axis + 2) % 3], p[self.axis])
    }

    /// Indices of the rays between two coordinates.
    fn between(&self, k: usize, low: f64, high: f64) -> Range<usize> {
        let index = |at: f64| (at - self.first[k]) / self.pitch[k];
        let last = (self.count[k] - 1) as f64;
        let from = index(low).ceil().max(0.0);
        let to = index(high).floor().min(last);
        if from > to {
            return 0..0;
        }
        from as usize..to as usize + 1
    }

    /// Adds the crossings of a triangle.
    fn cross(&self, corners: &[DVec3; 3], crossings: &mut Vec<Crossing>) {
        let [a, b, c] = corners.map(|p| Coord { x: p.x, y: p.y });
        let area = orient2d(a, b, c);
        if area == 0.0 {
            return;
        }
        let low = corners[0].min(corners[1]).min(corners[2]);
        let high = corners[0].max(corners[1]).max(corners[2]);
        for i in self.between(0, low.x, high.x) {
            for j in self.between(1, low.y, high.y) {
                let at = Coord {
                    x: self.first[0] + self.pitch[0] * i as f64,
                    y: self.first[1] + self.pitch[1] * j as f64,
                };
                let sides = [side(b, c, at), side(c, a, at), side(a, b, at)];
                let is_left = area > 0.0;
                if sides.iter().any(|side| side.1 != is_left) {
                    continue;
                }
                let sum: f64 = sides.iter().map(|side| side.0).sum();
                let weighted = (0..3).map(|k| sides[k].0 * corners[k].z).sum::<f64>() / sum;
                crossings.push(Crossing {
                    ray: (j * self.count[0] + i) as u32,
                    at: if sum == 0.0 {
                        low.z
                    } else {
                        weighted.clamp(low.z, high.z)
                    },
                    // A surface that faces along the ray is left, one that faces against it entered.
                    step: if is_left { -1 } else { 1 },
                });
            }
        }
    }

    fn segment(&self, ray: u32, from: f64, to: f64) -> Segment {
        let (i, j) = (ray as usize % self.count[0], ray as usize / self.count[0]);
        Segment {
            axis: self.axis,
            across: [
                self.first[0] + self.pitch[0] * i as f64,
                self.first[1] + self.pitch[1] * j as f64,
            ],
            pitch: self.pitch,
            from,
            to,
        }
    }
}

/// On which side of the line from `a` to `b` a point lies: twice the area of the three, and whether
/// it lies on the left. A point on the line lies left of it in one direction and right of it in the
/// other, so that it belongs to one of two triangles with this side.
fn side(a: Coord<f64>, b: Coord<f64>, p: Coord<f64>) -> (f64, bool) {
    let area = orient2d(a, b, p);
    let is_left = if area == 0.0 {
        (a.x, a.y) < (b.x, b.y)
    } else {
        area > 0.0
    };
    (area, is_left)
}

/// A cuboid around a part of a ray.
struct Segment {
    axis: usize,
    /// Position of the ray, m.
    across: [f64; 2],
    /// Sides across the ray, m.
    pitch: [f64; 2],
    from: f64,
    to: f64,
}

impl Segment {
    fn volume(&self) -> f64 {
        self.pitch[0] * self.pitch[1] * (self.to - self.from)
    }

    /// Vector of the coordinates (u, v, along the ray).
    fn vector(&self, across: [f64; 2], along: f64) -> DVec3 {
        let mut vector = DVec3::ZERO;
        vector[(self.axis + 1) % 3] = across[0];
        vector[(self.axis + 2) % 3] = across[1];
        vector[self.axis] = along;
        vector
    }

    fn middle(&self) -> DVec3 {
        self.vector(self.across, 0.5 * (self.from + self.to))
    }

    fn moments(&self) -> Moments {
        let (volume, middle) = (self.volume(), self.middle());
        let sides = self.vector(self.pitch, self.to - self.from);
        Moments {
            volume,
            first: middle * volume,
            second: (outer(middle) + DMat3::from_diagonal(sides * sides / 12.0)) * volume,
        }
    }
}
