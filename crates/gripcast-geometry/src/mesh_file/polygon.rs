//! Triangulation of polygons.

use glam::DVec3;
use robust::{Coord, orient2d};

/// Splits a polygon into triangles with its orientation: a convex one into a fan around its first
/// corner, a concave one by cutting ears (Meisters, *Polygons Have Ears*, 1975). `corners` are
/// indices into `positions`; indices out of range and polygons that cross themselves give a fan.
pub(super) fn triangulate(positions: &[DVec3], corners: &[u32]) -> Vec<[u32; 3]> {
    let order = match flattened(positions, corners) {
        Some(points) if !is_convex(&points) => cut_ears(&points),
        _ => None,
    };
    let order = order.unwrap_or_else(|| fan(corners.len()));
    order
        .into_iter()
        .map(|triangle| triangle.map(|index| corners[index]))
        .collect()
}

fn fan(count: usize) -> Vec<[usize; 3]> {
    (2..count).map(|i| [0, i - 1, i]).collect()
}

/// Projects a polygon of more than three corners along its area-weighted normal (Newell), so that it
/// is counter-clockwise; `None` for a flat or invalid one.
fn flattened(positions: &[DVec3], corners: &[u32]) -> Option<Vec<Coord<f64>>> {
    if corners.len() < 4 {
        return None;
    }
    let points = corners
        .iter()
        .map(|&corner| positions.get(corner as usize).copied())
        .collect::<Option<Vec<_>>>()?;
    let origin = points[0];
    let next = points.iter().cycle().skip(1);
    let normal: DVec3 = points
        .iter()
        .zip(next)
        .map(|(a, b)| (*a - origin).cross(*b - origin))
        .sum();
    let (u, v) = normal.try_normalize()?.any_orthonormal_pair();
    let flat = points.iter().map(|p| {
        let offset = *p - origin;
        Coord {
            x: offset.dot(u),
            y: offset.dot(v),
        }
    });
    Some(flat.collect())
}

fn is_convex(points: &[Coord<f64>]) -> bool {
    let count = points.len();
    (0..count).all(|i| {
        let [a, b, c] = [i, i + 1, i + 2].map(|k| points[k % count]);
        orient2d(a, b, c) >= 0.0
    })
}

/// Triangles of a simple counter-clockwise polygon; `None` if no ear is found.
fn cut_ears(points: &[Coord<f64>]) -> Option<Vec<[usize; 3]>> {
    let mut left: Vec<usize> = (0..points.len()).collect();
    let mut triangles = Vec::with_capacity(points.len() - 2);
    while left.len() > 3 {
        let count = left.len();
        let around = |i: usize| [i + count - 1, i, i + 1].map(|k| left[k % count]);
        let is_ear = |i: &usize| {
            let [a, b, c] = around(*i).map(|k| points[k]);
            let is_inside = |p: Coord<f64>| {
                [(a, b), (b, c), (c, a)]
                    .into_iter()
                    .all(|(from, to)| orient2d(from, to, p) >= 0.0)
            };
            let is_corner = |p: Coord<f64>| p == a || p == b || p == c;
            let mut others = left.iter().map(|&k| points[k]);
            orient2d(a, b, c) > 0.0 && !others.any(|p| !is_corner(p) && is_inside(p))
        };
        // A corner on a straight line has no area: cut it only where nothing else is left.
        let is_straight = |i: &usize| {
            let [a, b, c] = around(*i).map(|k| points[k]);
            orient2d(a, b, c) == 0.0
        };
        let ear = (0..count)
            .find(is_ear)
            .or_else(|| (0..count).find(is_straight))?;
        triangles.push(around(ear));
        left.remove(ear);
    }
    triangles.push([left[0], left[1], left[2]]);
    Some(triangles)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn area(positions: &[DVec3], triangles: &[[u32; 3]]) -> (f64, f64) {
        let doubled = |t: &[u32; 3]| {
            let [a, b, c] = t.map(|i| positions[i as usize]);
            (b - a).cross(c - a)
        };
        let sum: DVec3 = triangles.iter().map(doubled).sum();
        let absolute: f64 = triangles.iter().map(|t| doubled(t).length()).sum();
        (sum.length() / 2.0, absolute / 2.0)
    }

    #[test]
    fn convex_polygons_are_fans() {
        let square = [DVec3::ZERO, DVec3::X, DVec3::X + DVec3::Y, DVec3::Y];
        let found = triangulate(&square, &[0, 1, 2, 3]);
        assert_eq!(found, [[0, 1, 2], [0, 2, 3]]);
    }

    #[test]
    fn invalid_polygons_are_fans() {
        let points = [DVec3::ZERO, DVec3::X, DVec3::Y];
        assert_eq!(triangulate(&points, &[0, 1, 2, 9]).len(), 2);
        assert_eq!(triangulate(&[DVec3::ZERO; 5], &[0, 1, 2, 3, 4]).len(), 3);
        assert_eq!(triangulate(&points, &[0, 1]), Vec::<[u32; 3]>::new());
    }

    proptest! {
        /// Star-shaped polygons with any start, in any plane: triangles do not overlap (their areas
        /// add up to the polygon's) and keep the orientation.
        #[test]
        fn concave_polygons_keep_their_area(
            radii in prop::collection::vec(0.2..1.0_f64, 4..14),
            start in 0_usize..14,
            axis in prop::array::uniform3(-1.0..1.0_f64),
        ) {
            let count = radii.len();
            let Some(normal) = DVec3::from_array(axis).try_normalize() else {
                return Ok(());
            };
            let (u, v) = normal.any_orthonormal_pair();
            let points: Vec<DVec3> = radii.iter().enumerate().map(|(i, r)| {
                let angle = std::f64::consts::TAU * i as f64 / count as f64;
                (u * angle.cos() + v * angle.sin()) * *r
            }).collect();
            let corners: Vec<u32> = (0..count).map(|i| ((i + start) % count) as u32).collect();
            let found = triangulate(&points, &corners);
            prop_assert_eq!(found.len(), count - 2);
            let (_, absolute) = area(&points, &found);
            let exact: f64 = (0..count)
                .map(|i| points[i].cross(points[(i + 1) % count]).dot(normal) / 2.0)
                .sum();
            prop_assert!((absolute - exact.abs()).abs() < 1e-9, "{} {}", absolute, exact);
        }
    }
}
