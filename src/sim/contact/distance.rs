//! Closest points of a point and a triangle, and of two edges.
//!
//! Both are the minimum of a convex quadratic over a convex set of parameters. Where the
//! unconstrained minimum lies outside, the answer lies on a side that it violates, so at most two
//! sides are looked at. Degenerate triangles and parallel edges have no such minimum: all their
//! sides are looked at. Finite input never gives NaN.

use glam::DVec3;

/// Below this squared sine a triangle or pair of edges counts as degenerate: only its sides count.
const DEGENERATE: f64 = 1e-20;

/// Above this squared sine the normal is accurate to 1e-12 and the offset is taken along it.
const WELL_SHAPED: f64 = 1e-8;

/// Which features of the stencil hold the closest points; numbers are stencil indices.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Region {
    /// Two points.
    PointPoint(u8, u8),
    /// A point, and the inside of the edge between the second and third index.
    PointEdge(u8, u8, u8),
    /// Point 0, and the inside of triangle 1, 2, 3.
    PointTriangle,
    /// The insides of edges 0, 1 and 2, 3.
    EdgeEdge,
}

/// Closest points of a stencil.
///
/// The offset is `Σ weights[i] x[i]`. The weights of the first feature add up to 1, those of the
/// second to −1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Closest {
    /// Weight of each stencil point: `(1, −b0, −b1, −b2)` for a point and a triangle,
    /// `(1−s, s, −(1−t), −t)` for two edges.
    pub weights: [f64; 4],
    /// From the closest point of the second feature to that of the first, m.
    pub offset: DVec3,
    /// Squared distance, m².
    pub squared: f64,
    /// Features that hold the closest points.
    pub region: Region,
}

impl Closest {
    #[inline]
    fn new(weights: [f64; 4], offset: DVec3, region: Region) -> Self {
        Self {
            weights,
            offset,
            squared: offset.length_squared(),
            region,
        }
    }

    /// Distance, m.
    #[inline]
    pub fn distance(&self) -> f64 {
        self.squared.sqrt()
    }

    /// Derivative of the squared distance with respect to each stencil point, m:
    /// `2 weights[i] offset`, because the closest parameters are at their minimum.
    #[inline]
    pub fn gradient(&self) -> [DVec3; 4] {
        self.weights.map(|weight| self.offset * (2.0 * weight))
    }

    /// `Σ weights[i] vectors[i]`: the motion of the first closest point relative to the second when
    /// the stencil points move by `vectors`.
    #[inline]
    pub fn relative(&self, vectors: &[DVec3; 4]) -> DVec3 {
        let [a, b, c, d] = self.weights;
        vectors[0] * a + vectors[1] * b + vectors[2] * c + vectors[3] * d
    }
}

/// Parameter in [0, 1] of the point of the edge from the origin to `edge` closest to `point`.
#[inline]
fn edge_parameter(point: DVec3, edge: DVec3) -> f64 {
    let squared = edge.length_squared();
    if squared > 0.0 {
        (point.dot(edge) / squared).clamp(0.0, 1.0)
    } else {
        0.0
    }
}

#[inline]
fn on_edge_region(point: u8, start: u8, end: u8, t: f64) -> Region {
    if t <= 0.0 {
        Region::PointPoint(point, start)
    } else if t >= 1.0 {
        Region::PointPoint(point, end)
    } else {
        Region::PointEdge(point, start, end)
    }
}

/// Closest points of a point and an edge, stencil `[p, e0, e1]`; the fourth weight is 0.
#[inline]
pub fn point_edge(p: DVec3, e0: DVec3, e1: DVec3) -> Closest {
    let (edge, from_start) = (e1 - e0, p - e0);
    let t = edge_parameter(from_start, edge);
    Closest::new(
        [1.0, t - 1.0, -t, 0.0],
        from_start - edge * t,
        on_edge_region(0, 1, 2, t),
    )
}

/// Signed distance (m) of a point from the plane through `origin` with unit normal `normal`,
/// positive on the side of the normal.
#[inline]
pub fn point_plane(p: DVec3, origin: DVec3, normal: DVec3) -> f64 {
    (p - origin).dot(normal)
}

/// Differences and products of a point-triangle stencil that the regions share.
struct TrianglePlane {
    ab: DVec3,
    ac: DVec3,
    ap: DVec3,
    normal: DVec3,
    /// `|normal|²`, and `|ab|² |ac|²`.
    area: f64,
    scale: f64,
}

impl TrianglePlane {
    #[inline]
    fn new(p: DVec3, t0: DVec3, t1: DVec3, t2: DVec3) -> Self {
        let (ab, ac, ap) = (t1 - t0, t2 - t0, p - t0);
        let normal = ab.cross(ac);
        Self {
            ab,
            ac,
            ap,
            normal,
            area: normal.length_squared(),
            scale: ab.length_squared() * ac.length_squared(),
        }
    }

    #[inline]
    fn closest(&self) -> Closest {
        let &Self {
            ab,
            ac,
            ap,
            normal,
            area,
            scale,
        } = self;
        if area > DEGENERATE * scale {
            let v = ap.dot(ac.cross(normal));
            let w = ap.dot(normal.cross(ab));
            let u = area - v - w;
            if u >= 0.0 && v >= 0.0 && w >= 0.0 {
                let (v, w) = (v / area, w / area);
                let offset = if area > WELL_SHAPED * scale {
                    normal * (ap.dot(normal) / area)
                } else {
                    ap - ab * v - ac * w
                };
                return Closest::new([1.0, v + w - 1.0, -v, -w], offset, Region::PointTriangle);
            }
            self.sides(w < 0.0, u < 0.0, v < 0.0)
        } else {
            self.sides(true, true, true)
        }
    }

    /// Closest point of the named sides `t0 t1`, `t1 t2`, `t0 t2`; at least one must be named.
    #[inline]
    fn sides(&self, ab_side: bool, bc_side: bool, ac_side: bool) -> Closest {
        let mut best = (f64::INFINITY, DVec3::ZERO, 0.0, 0, 1);
        let mut consider = |start: DVec3, edge: DVec3, i: u8, j: u8| {
            let t = edge_parameter(start, edge);
            let offset = start - edge * t;
            let squared = offset.length_squared();
            if squared < best.0 {
                best = (squared, offset, t, i, j);
            }
        };
        if ab_side {
            consider(self.ap, self.ab, 1, 2);
        }
        if bc_side {
            consider(self.ap - self.ab, self.ac - self.ab, 2, 3);
        }
        if ac_side {
            consider(self.ap, self.ac, 1, 3);
        }
        let (squared, offset, t, i, j) = best;
        let mut weights = [1.0, 0.0, 0.0, 0.0];
        weights[usize::from(i)] = t - 1.0;
        weights[usize::from(j)] = -t;
        Closest {
            weights,
            offset,
            squared,
            region: on_edge_region(0, i, j, t),
        }
    }
}

/// Closest points of a point and a triangle, stencil `[p, t0, t1, t2]`.
#[inline]
pub fn point_triangle(p: DVec3, t0: DVec3, t1: DVec3, t2: DVec3) -> Closest {
    TrianglePlane::new(p, t0, t1, t2).closest()
}

/// [`point_triangle`] where the squared distance is below `limit` (m²), else nothing. Points far
/// from the triangle's plane leave early.
#[inline]
pub fn point_triangle_within(
    p: DVec3,
    t0: DVec3,
    t1: DVec3,
    t2: DVec3,
    limit: f64,
) -> Option<Closest> {
    let plane = TrianglePlane::new(p, t0, t1, t2);
    let height = plane.ap.dot(plane.normal);
    if plane.area > WELL_SHAPED * plane.scale && height * height >= limit * plane.area {
        return None;
    }
    let closest = plane.closest();
    (closest.squared < limit).then_some(closest)
}

/// Differences and products of an edge-edge stencil that the regions share.
struct EdgePair {
    u: DVec3,
    v: DVec3,
    w: DVec3,
    normal: DVec3,
    area: f64,
    scale: f64,
}

impl EdgePair {
    #[inline]
    fn new(a0: DVec3, a1: DVec3, b0: DVec3, b1: DVec3) -> Self {
        let (u, v, w) = (a1 - a0, b1 - b0, a0 - b0);
        let normal = u.cross(v);
        Self {
            u,
            v,
            w,
            normal,
            area: normal.length_squared(),
            scale: u.length_squared() * v.length_squared(),
        }
    }

    #[inline]
    fn closest(&self) -> Closest {
        let &Self {
            u,
            v,
            w,
            normal,
            area,
            scale,
        } = self;
        if area > DEGENERATE * scale {
            let s = w.dot(normal.cross(v));
            let t = w.dot(normal.cross(u));
            let (s_low, s_high) = (s < 0.0, s > area);
            let (t_low, t_high) = (t < 0.0, t > area);
            if !(s_low || s_high || t_low || t_high) {
                let s = s / area;
                if area > WELL_SHAPED * scale {
                    let offset = normal * (w.dot(normal) / area);
                    return Self::inside(s, t / area, offset);
                }
                // The valley is flat: take the partner of s rather than a second inexact quotient.
                let t = edge_parameter(w + u * s, v);
                return Self::inside(s, t, w + u * s - v * t);
            }
            self.sides(s_low, s_high, t_low, t_high)
        } else {
            self.sides(true, true, true, true)
        }
    }

    #[inline]
    fn inside(s: f64, t: f64, offset: DVec3) -> Closest {
        Closest::new([1.0 - s, s, t - 1.0, -t], offset, Region::EdgeEdge)
    }

    /// Closest points with an end of one edge (`a0`, `a1`, `b0`, `b1` as named); at least one must
    /// be named.
    #[inline]
    fn sides(&self, a0: bool, a1: bool, b0: bool, b1: bool) -> Closest {
        let &Self { u, v, w, .. } = self;
        let mut best = (f64::INFINITY, DVec3::ZERO, 0.0, 0.0);
        let mut consider = |s: f64, t: f64, offset: DVec3| {
            let squared = offset.length_squared();
            if squared < best.0 {
                best = (squared, offset, s, t);
            }
        };
        let mut end_of_a = |s: f64, end: DVec3| {
            let t = edge_parameter(end, v);
            consider(s, t, end - v * t);
        };
        if a0 {
            end_of_a(0.0, w);
        }
        if a1 {
            end_of_a(1.0, w + u);
        }
        let mut end_of_b = |t: f64, end: DVec3| {
            let s = edge_parameter(end, u);
            consider(s, t, u * s - end);
        };
        if b0 {
            end_of_b(0.0, -w);
        }
        if b1 {
            end_of_b(1.0, v - w);
        }
        let (squared, offset, s, t) = best;
        Closest {
            weights: [1.0 - s, s, t - 1.0, -t],
            offset,
            squared,
            region: edge_edge_region(s, t),
        }
    }
}

#[inline]
fn edge_edge_region(s: f64, t: f64) -> Region {
    let end = |parameter: f64, low: u8| {
        if parameter <= 0.0 {
            Some(low)
        } else if parameter >= 1.0 {
            Some(low + 1)
        } else {
            None
        }
    };
    match (end(s, 0), end(t, 2)) {
        (Some(a), Some(b)) => Region::PointPoint(a, b),
        (Some(a), None) => Region::PointEdge(a, 2, 3),
        (None, Some(b)) => Region::PointEdge(b, 0, 1),
        (None, None) => Region::EdgeEdge,
    }
}

/// Closest points of two edges, stencil `[a0, a1, b0, b1]`.
#[inline]
pub fn edge_edge(a0: DVec3, a1: DVec3, b0: DVec3, b1: DVec3) -> Closest {
    EdgePair::new(a0, a1, b0, b1).closest()
}

/// [`edge_edge`] where the squared distance is below `limit` (m²), else nothing. Edges on lines
/// far apart leave early.
#[inline]
pub fn edge_edge_within(a0: DVec3, a1: DVec3, b0: DVec3, b1: DVec3, limit: f64) -> Option<Closest> {
    let pair = EdgePair::new(a0, a1, b0, b1);
    let height = pair.w.dot(pair.normal);
    if pair.area > WELL_SHAPED * pair.scale && height * height >= limit * pair.area {
        return None;
    }
    let closest = pair.closest();
    (closest.squared < limit).then_some(closest)
}

#[cfg(test)]
#[path = "distance_test.rs"]
mod tests;
