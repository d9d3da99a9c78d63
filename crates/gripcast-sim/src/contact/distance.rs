//! Closest points of a point and a triangle, and of two edges.
//!
//! Finite input never gives NaN, even for degenerate or parallel features, and the closest points
//! always lie on the features.

use glam::DVec3;

/// Squared sine of two sides below which a triangle takes the slower, more accurate path.
const THIN: f64 = 1e-4;

/// Squared sine of two sides below which a triangle has no interior.
const DEGENERATE: f64 = 1e-20;

/// Features of a stencil that contain the closest points, by stencil indices.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Region {
    /// Two points.
    PointPoint(u8, u8),
    /// A point, and the interior of the edge between the second and third index.
    PointEdge(u8, u8, u8),
    /// Point 0, and the interior of triangle 1, 2, 3.
    PointTriangle,
    /// The interiors of edges 0, 1 and 2, 3.
    EdgeEdge,
}

/// Closest points of a stencil.
///
/// The offset is `Σ weights[i] x[i]`. The weights of the first feature are non-negative and sum to
/// 1, those of the second are non-positive and sum to −1; uninvolved points have exactly 0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Closest {
    /// Weight of each stencil point: `(1, −b0, −b1, −b2)` for a point and a triangle,
    /// `(1−s, s, −(1−t), −t)` for two edges.
    pub weights: [f64; 4],
    /// From the closest point of the second feature to that of the first, m.
    pub offset: DVec3,
    /// Squared distance, m².
    pub squared: f64,
}

impl Closest {
    #[inline]
    fn new(weights: [f64; 4], offset: DVec3) -> Self {
        Self {
            weights,
            offset,
            squared: offset.length_squared(),
        }
    }

    /// Distance, m.
    #[inline]
    pub fn distance(&self) -> f64 {
        self.squared.sqrt()
    }

    /// Features that contain the closest points: those with non-zero weights.
    pub fn region(&self) -> Region {
        let find = |sign: f64| {
            let mut found = (0..4_u8).filter(move |&i| self.weights[usize::from(i)] * sign > 0.0);
            (found.next().unwrap_or(0), found.next(), found.next())
        };
        match (find(1.0), find(-1.0)) {
            ((a, None, _), (b, None, _)) => Region::PointPoint(a, b),
            ((a, None, _), (b, Some(c), None)) => Region::PointEdge(a, b, c),
            ((a, Some(b), _), (c, None, _)) => Region::PointEdge(c, a, b),
            ((_, None, _), (_, Some(_), Some(_))) => Region::PointTriangle,
            ((_, Some(_), _), (_, Some(_), _)) => Region::EdgeEdge,
        }
    }

    /// Derivative of the squared distance with respect to each stencil point, m:
    /// `2 weights[i] offset`, because the closest parameters are stationary.
    #[inline]
    pub fn gradient(&self) -> [DVec3; 4] {
        self.weights.map(|weight| self.offset * (2.0 * weight))
    }

    /// `Σ weights[i] vectors[i]`: motion of the first closest point relative to the second for
    /// motions `vectors` of the stencil points.
    #[inline]
    pub fn relative(&self, vectors: &[DVec3; 4]) -> DVec3 {
        let [a, b, c, d] = self.weights;
        vectors[0] * a + vectors[1] * b + vectors[2] * c + vectors[3] * d
    }
}

/// `a / b` clamped to [0, 1]; 0 for `0 / 0`. Branch-free.
#[inline]
fn unit_ratio(a: f64, b: f64) -> f64 {
    let ratio = a / b;
    let ratio = if ratio > 0.0 { ratio } else { 0.0 };
    if ratio < 1.0 { ratio } else { 1.0 }
}

/// Closest points of a point and a triangle, stencil `[p, t0, t1, t2]`.
///
/// Tests the Voronoi regions of corners, sides and interior (Ericson 2005, §5.1.5).
#[inline]
pub fn point_triangle(p: DVec3, t0: DVec3, t1: DVec3, t2: DVec3) -> Closest {
    let (ab, ac, ap) = (t1 - t0, t2 - t0, p - t0);
    let (bb, cc, bc) = (ab.length_squared(), ac.length_squared(), ab.dot(ac));
    let area = bb * cc - bc * bc;
    if area <= THIN * bb * cc {
        return thin_triangle(ab, ac, ap);
    }
    let (ap_ab, ap_ac) = (ab.dot(ap), ac.dot(ap));
    if ap_ab <= 0.0 && ap_ac <= 0.0 {
        return Closest::new([1.0, -1.0, 0.0, 0.0], ap);
    }
    let bp = p - t1;
    let (bp_ab, bp_ac) = (ab.dot(bp), ac.dot(bp));
    if bp_ab >= 0.0 && bp_ac <= bp_ab {
        return Closest::new([1.0, 0.0, -1.0, 0.0], bp);
    }
    let w = bb * ap_ac - bc * ap_ab;
    if w <= 0.0 && ap_ab >= 0.0 && bp_ab <= 0.0 {
        let t = unit_ratio(ap_ab, bb);
        return Closest::new([1.0, t - 1.0, -t, 0.0], ap - ab * t);
    }
    let cp = p - t2;
    let (cp_ab, cp_ac) = (ab.dot(cp), ac.dot(cp));
    if cp_ac >= 0.0 && cp_ab <= cp_ac {
        return Closest::new([1.0, 0.0, 0.0, -1.0], cp);
    }
    let v = cc * ap_ab - bc * ap_ac;
    if v <= 0.0 && ap_ac >= 0.0 && cp_ac <= 0.0 {
        let t = unit_ratio(ap_ac, cc);
        return Closest::new([1.0, t - 1.0, 0.0, -t], ap - ac * t);
    }
    let u = area - v - w;
    let (from_b, from_c) = (bp_ac - bp_ab, cp_ab - cp_ac);
    if u <= 0.0 && from_b >= 0.0 && from_c >= 0.0 {
        let t = unit_ratio(from_b, from_b + from_c);
        return Closest::new([1.0, 0.0, t - 1.0, -t], bp - (t2 - t1) * t);
    }
    let inverse = 1.0 / area;
    let (v, w) = (v * inverse, w * inverse);
    Closest::new([1.0, v + w - 1.0, -v, -w], ap - ab * v - ac * w)
}

/// [`point_triangle`] by the triangle's normal, which a cross product gives more accurately than
/// products of lengths; for a degenerate triangle the nearest of the three sides.
#[cold]
#[inline(never)]
fn thin_triangle(ab: DVec3, ac: DVec3, ap: DVec3) -> Closest {
    let normal = ab.cross(ac);
    let area = normal.length_squared();
    let v = ap.dot(ac.cross(normal));
    let w = ap.dot(normal.cross(ab));
    let u = area - v - w;
    let is_degenerate = area <= DEGENERATE * ab.length_squared() * ac.length_squared();
    if !is_degenerate && u >= 0.0 && v >= 0.0 && w >= 0.0 {
        let (v, w) = (v / area, w / area);
        return Closest::new([1.0, v + w - 1.0, -v, -w], ap - ab * v - ac * w);
    }
    let side = |from_start: DVec3, edge: DVec3, weights: fn(f64) -> [f64; 4]| {
        let t = unit_ratio(from_start.dot(edge), edge.length_squared());
        Closest::new(weights(t), from_start - edge * t)
    };
    let mut best = side(ap, ab, |t| [1.0, t - 1.0, -t, 0.0]);
    for other in [
        side(ap, ac, |t| [1.0, t - 1.0, 0.0, -t]),
        side(ap - ab, ac - ab, |t| [1.0, 0.0, t - 1.0, -t]),
    ] {
        if other.squared < best.squared {
            best = other;
        }
    }
    best
}

/// Closest points of two edges, stencil `[a0, a1, b0, b1]`.
///
/// Projects the closest point of line a to line b, clamped to edge a, onto edge b and back onto
/// edge a (Ericson 2005, §5.1.9). For parallel edges any start leads to a closest pair.
/// Branch-free, so the time does not depend on the region.
#[inline]
pub fn edge_edge(a0: DVec3, a1: DVec3, b0: DVec3, b1: DVec3) -> Closest {
    let (u, v, w) = (a1 - a0, b1 - b0, a0 - b0);
    // A cross product, because products of lengths would lose the squared sine.
    let normal = u.cross(v);
    let s = unit_ratio(v.cross(w).dot(normal), normal.length_squared());
    let uv = u.dot(v);
    let t = unit_ratio(uv * s + v.dot(w), v.length_squared());
    let s = unit_ratio(uv * t - u.dot(w), u.length_squared());
    Closest::new([1.0 - s, s, t - 1.0, -t], w + u * s - v * t)
}

#[cfg(test)]
#[path = "distance_test.rs"]
mod tests;
