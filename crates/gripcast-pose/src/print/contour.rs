//! Sections of a mesh with horizontal planes.

use std::collections::HashMap;
use std::hash::Hash;

use glam::DVec2;

use gripcast_geometry::TriangleMesh;

/// A polyline.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Outline {
    /// Points in the unit of their source.
    pub(super) points: Vec<DVec2>,
    /// Whether the last point connects to the first.
    pub(super) closed: bool,
}

/// Vertices of a mesh edge in ascending order.
type Edge = [u32; 2];

/// Section of a mesh with the plane z = `height`, m. Outlines of a closed mesh are closed.
/// Vertices in the plane count as above it.
pub(super) fn section(mesh: &TriangleMesh, height: f64) -> Vec<Outline> {
    let is_above = |v: u32| mesh.vertices[v as usize].z >= height;
    // Edges where the section enters and leaves each triangle.
    let mut steps: Vec<(Edge, Edge)> = Vec::new();
    for triangle in &mesh.triangles {
        let [a, b, c] = *triangle;
        let crossed = [(a, b), (b, c), (c, a)].map(|(p, q)| {
            (is_above(p) != is_above(q)).then(|| ([p.min(q), p.max(q)], is_above(p)))
        });
        let edge = |falls: bool| {
            crossed
                .iter()
                .flatten()
                .rfind(|crossing| crossing.1 == falls)
        };
        if let (Some((from, _)), Some((to, _))) = (edge(false), edge(true)) {
            steps.push((*from, *to));
        }
    }
    let intersection = |[p, q]: Edge| {
        let (p, q) = (mesh.vertices[p as usize], mesh.vertices[q as usize]);
        let t = (height - p.z) / (q.z - p.z);
        p.truncate().lerp(q.truncate(), t)
    };
    chain(&steps)
        .into_iter()
        .map(|(edges, closed)| Outline {
            points: edges.into_iter().map(intersection).collect(),
            closed,
        })
        .collect()
}

/// Joins steps to chains of maximum length, each with whether it is closed.
pub(super) fn chain<T: Copy + Eq + Hash>(steps: &[(T, T)]) -> Vec<(Vec<T>, bool)> {
    let mut from: HashMap<T, Vec<usize>> = HashMap::new();
    let mut into: HashMap<T, usize> = HashMap::new();
    for (k, (start, end)) in steps.iter().enumerate().rev() {
        from.entry(*start).or_default().push(k);
        *into.entry(*end).or_default() += 1;
    }
    let mut used = vec![false; steps.len()];
    let mut chains = Vec::new();
    // Open chains start where no step ends; the rest are loops.
    let is_start = |k: &usize| !into.contains_key(&steps[*k].0);
    let order = (0..steps.len()).filter(is_start).chain(0..steps.len());
    for first in order.collect::<Vec<_>>() {
        if used[first] {
            continue;
        }
        used[first] = true;
        let mut edges = vec![steps[first].0, steps[first].1];
        let mut end = steps[first].1;
        while let Some(next) = from
            .get(&end)
            .and_then(|ks| ks.iter().copied().find(|k| !used[*k]))
        {
            used[next] = true;
            end = steps[next].1;
            edges.push(end);
        }
        let closed = edges.len() > 2 && edges[0] == end;
        if closed {
            edges.pop();
        }
        chains.push((edges, closed));
    }
    chains
}

/// Simplifies an outline within `tolerance` (Douglas and Peucker, 1973).
pub(super) fn simplify(outline: &Outline, tolerance: f64) -> Outline {
    let mut points = outline.points.clone();
    if outline.closed {
        // Cut the loop at the point farthest from the first.
        points.extend(outline.points.first());
    }
    let points = if outline.closed && points.len() > 3 {
        let far = |k: &usize| points[*k].distance(points[0]);
        let cut = (0..points.len()).max_by(|a, b| far(a).total_cmp(&far(b)));
        let cut = cut.unwrap_or(0).max(1);
        let mut kept = reduce(&points[..=cut], tolerance);
        kept.pop();
        kept.extend(reduce(&points[cut..], tolerance));
        kept.pop();
        kept
    } else {
        reduce(&outline.points, tolerance)
    };
    Outline {
        points,
        closed: outline.closed,
    }
}

fn reduce(points: &[DVec2], tolerance: f64) -> Vec<DVec2> {
    let mut keep = vec![false; points.len()];
    let Some(last) = points.len().checked_sub(1) else {
        return Vec::new();
    };
    (keep[0], keep[last]) = (true, true);
    let mut open = vec![(0, last)];
    while let Some((a, b)) = open.pop() {
        let off = |k: usize| distance_to_segment(points[k], points[a], points[b]);
        let farthest = (a + 1..b).max_by(|p, q| off(*p).total_cmp(&off(*q)));
        if let Some(k) = farthest.filter(|k| off(*k) > tolerance) {
            keep[k] = true;
            open.extend([(a, k), (k, b)]);
        }
    }
    let kept = points.iter().zip(keep).filter(|(_, keep)| *keep);
    kept.map(|(p, _)| *p).collect()
}

fn distance_to_segment(p: DVec2, a: DVec2, b: DVec2) -> f64 {
    let along = b - a;
    let t = (p - a).dot(along) / along.length_squared().max(f64::MIN_POSITIVE);
    p.distance(a + along * t.clamp(0.0, 1.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_geometry::builtin;

    fn length(outline: &Outline) -> f64 {
        let points = &outline.points;
        let next = |k: usize| points[(k + 1) % points.len()];
        let last = points.len() - usize::from(!outline.closed);
        (0..last).map(|k| points[k].distance(next(k))).sum()
    }

    #[test]
    fn section_of_a_box_is_a_rectangle() {
        let mesh = builtin("box").unwrap();
        // Also through vertices and near the bottom.
        for height in [-0.0297, 0.0, 0.0123] {
            let found = section(&mesh, height);
            assert_eq!(found.len(), 1, "{height}");
            assert!(found[0].closed);
            assert!((length(&found[0]) - 0.16).abs() < 1e-12);
            let plain = simplify(&found[0], 1e-6);
            assert!(plain.points.len() <= 6, "{:?}", plain.points);
            assert!((length(&plain) - 0.16).abs() < 1e-9);
        }
        assert!(section(&mesh, 0.1).is_empty());
    }

    #[test]
    fn section_of_a_hollow_mesh_has_two_outlines() {
        // The wall and the handle of the mug.
        let found = section(&builtin("mug").unwrap(), 0.0);
        assert!(
            found.len() >= 2 && found.iter().all(|o| o.closed),
            "{}",
            found.len()
        );
        let outer = found.iter().map(length).fold(0.0, f64::max);
        assert!(
            (outer - std::f64::consts::TAU * 0.03).abs() < 1e-3,
            "{outer}"
        );
    }

    #[test]
    fn section_of_an_open_mesh_is_open() {
        let mut mesh = builtin("box").unwrap();
        let sum_x = |t: &[u32; 3]| t.iter().map(|v| mesh.vertices[*v as usize].x).sum::<f64>();
        let kept = mesh.triangles.iter().filter(|t| sum_x(t) < 0.0589).copied();
        mesh.triangles = kept.collect();
        let found = section(&mesh, 0.001);
        assert_eq!(found.len(), 1);
        assert!(!found[0].closed);
        assert!(
            (length(&found[0]) - 0.12).abs() < 1e-3,
            "{}",
            length(&found[0])
        );
    }

    #[test]
    fn simplification_stays_within_the_tolerance() {
        let circle: Vec<DVec2> = (0..360)
            .map(|k| DVec2::from_angle(f64::from(k).to_radians()))
            .collect();
        let outline = Outline {
            points: circle.clone(),
            closed: true,
        };
        let plain = simplify(&outline, 0.01);
        assert!(
            plain.closed && plain.points.len() < 60,
            "{}",
            plain.points.len()
        );
        let off = |p: &DVec2| {
            let n = plain.points.len();
            (0..n)
                .map(|k| distance_to_segment(*p, plain.points[k], plain.points[(k + 1) % n]))
                .fold(f64::INFINITY, f64::min)
        };
        assert!(circle.iter().map(off).fold(0.0, f64::max) <= 0.01);
    }
}
