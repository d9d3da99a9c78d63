//! Stable poses of a body on a plane.

use std::collections::BTreeSet;
use std::f64::consts::PI;

use glam::{DQuat, DVec3};

use super::convex_hull::convex_hull;
use super::mass_properties::MassProperties;
use super::mesh::TriangleMesh;
use super::mesh_query::closest_on_triangle;
use super::pose::Pose;
use super::winding_number::solid_angle;
use gripcast_base::error::{Error, Result};

/// Distance from the plane of a facet, relative to the body's diagonal, up to which corners belong
/// to it; also the difference up to which distances are equal. Coordinates rounded to single
/// precision or to micrometres differ by less.
const FLATNESS: f64 = 1e-5;
/// Tip angle up to which the body does not rest on a facet, rad: rounding decides its sign.
const MARGINAL_TIP_RAD: f64 = 1e-5;
/// Relative difference up to which probabilities are equal.
const EQUAL_PROBABILITY: f64 = 1e-3;
/// Difference up to which rotation angles (rad) and components of unit vectors are equal.
const EQUAL_DIRECTION: f64 = 1e-4;
/// Angle from upside down within which a body is turned about the x axis, rad.
const UPSIDE_DOWN_RAD: f64 = 1e-3;

/// A stable pose of a body on the plane z = 0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StablePose {
    /// Lowest point at z = 0, centre of mass at x = y = 0. Rotations about z are equivalent; this
    /// is the smallest rotation, or for an upside-down body the one about x.
    pub t_world_object: Pose,
    /// Probability that a body put down slowly in a uniformly random orientation comes to rest in
    /// this pose; all sum to 1.
    pub probability: f64,
    /// Smallest tilt that tips the body over, rad.
    pub tip_angle_rad: f64,
}

impl StablePose {
    /// Angle by which the pose rotates the body as it stands in its file, rad.
    pub fn rotation_angle_rad(&self) -> f64 {
        self.down().angle_between(DVec3::NEG_Z)
    }

    /// Direction of the mesh's frame that points down.
    fn down(&self) -> DVec3 {
        self.t_world_object.rotation.conjugate() * DVec3::NEG_Z
    }
}

/// Index of the pose that rotates the body least, if by less than `max_angle_rad`; the first of
/// equal ones.
pub fn nearest_pose(poses: &[StablePose], max_angle_rad: f64) -> Option<usize> {
    let angles: Vec<f64> = poses.iter().map(StablePose::rotation_angle_rad).collect();
    let least = angles.iter().copied().fold(f64::INFINITY, f64::min);
    let nearest = angles.iter().position(|a| *a <= least + EQUAL_DIRECTION);
    nearest.filter(|_| least < max_angle_rad)
}

/// Likely stable poses, by falling probability: those that survive a tilt of `min_tip_rad` and have
/// at least `min_probability`. Returns at least the most probable pose, also for round bodies that
/// have no such pose.
///
/// # Errors
/// As [`stable_poses`] with a tilt of 0.
pub fn likely_poses(
    mesh: &TriangleMesh,
    min_tip_rad: f64,
    min_probability: f64,
) -> Result<Vec<StablePose>> {
    let mut poses = stable_poses(mesh, min_tip_rad).or_else(|_| stable_poses(mesh, 0.0))?;
    let first = poses.first().copied();
    poses.retain(|pose| pose.probability >= min_probability);
    if poses.is_empty() {
        poses.extend(first);
    }
    Ok(poses)
}

/// Computes all stable poses of a closed mesh (m, uniform density), by falling probability.
///
/// Each facet of the convex hull is a candidate. Its solid angle from the centre of mass is its
/// fraction of landings (Goldberg et al., *Part pose statistics*, IJRR 1999, without dynamics). If
/// the centre of mass is not above the facet, or a tilt below `min_tip_rad` leaves it, the body
/// tips over the nearest side onto that neighbour, and on to where that one comes to rest; of
/// equally near sides, each takes its share. 0 keeps all stable poses, 0.02 those that survive a
/// nudge.
///
/// The order does not depend on rounding. Of poses with equal probabilities (within 0.1 %), the one
/// that rotates the body least from how it stands in its file comes first; of equal rotations, the
/// one whose downward direction has the larger x, then y, then z component in the axes of the file.
///
/// # Errors
/// `Input` if the mesh encloses no volume, or if it tips over from every facet.
///
/// ```
/// use gripcast_geometry::{builtin, stable_poses};
/// let poses = stable_poses(&builtin("bar")?, 0.0)?;
/// assert_eq!(poses.len(), 6);
/// # Ok::<(), gripcast_base::error::Error>(())
/// ```
pub fn stable_poses(mesh: &TriangleMesh, min_tip_rad: f64) -> Result<Vec<StablePose>> {
    let center = MassProperties::from_mesh(mesh)?.center_of_mass_m;
    let hull = convex_hull(&mesh.without_unused_vertices().vertices)?;
    let facets = facets(&hull, center);
    let landings = landings(&facets, min_tip_rad);
    let total: f64 = landings.iter().sum();
    let mut poses: Vec<StablePose> = facets
        .iter()
        .zip(&landings)
        .filter(|(_, fraction)| **fraction > 0.0)
        .map(|(facet, fraction)| StablePose {
            t_world_object: resting_pose(&hull, center, facet.normal),
            probability: fraction / total,
            tip_angle_rad: facet.tip_angle,
        })
        .collect();
    if poses.is_empty() {
        return Err(Error::input(format!(
            "the body must rest on a facet, but tips over from each within {:.3} degrees",
            min_tip_rad.to_degrees()
        ))
        .remedy("use a smaller minimum tip angle"));
    }
    sort_by_keys(&mut poses, &ORDER);
    Ok(poses)
}

/// A number that orders poses, and the difference up to which it is equal.
type Key = (fn(&StablePose) -> f64, f64);

/// Order of poses: each key decides where those before it are equal.
const ORDER: [Key; 5] = [
    (|pose| -pose.probability.ln(), EQUAL_PROBABILITY),
    (StablePose::rotation_angle_rad, EQUAL_DIRECTION),
    (|pose| -pose.down().x, EQUAL_DIRECTION),
    (|pose| -pose.down().y, EQUAL_DIRECTION),
    (|pose| -pose.down().z, EQUAL_DIRECTION),
];

/// Sorts by the first key, and those within its tolerance of the first of them by the other keys.
fn sort_by_keys(poses: &mut [StablePose], keys: &[Key]) {
    let Some(((key, tolerance), others)) = keys.split_first() else {
        return;
    };
    poses.sort_by(|a, b| key(a).total_cmp(&key(b)));
    let mut rest = poses;
    while let Some(first) = rest.first().map(key) {
        let is_equal = |pose: &&StablePose| key(pose) - first <= *tolerance;
        let count = rest.iter().take_while(is_equal).count().max(1);
        let (equal, after) = rest.split_at_mut(count);
        sort_by_keys(equal, others);
        rest = after;
    }
}

/// Coplanar triangles of the hull.
struct Facet {
    /// Outward unit normal.
    normal: DVec3,
    /// Solid angle seen from the centre of mass, as a fraction of the sphere.
    solid_angle: f64,
    /// Tilt at which the body leaves the facet, rad; negative if unstable.
    tip_angle: f64,
    /// Facets onto which the body tips, each with the same probability.
    tips_to: Vec<usize>,
}

/// Fraction of the landings that come to rest on each facet.
fn landings(facets: &[Facet], min_tip_rad: f64) -> Vec<f64> {
    let rests =
        |facet: &Facet| facet.tip_angle > MARGINAL_TIP_RAD && facet.tip_angle >= min_tip_rad;
    let mut resting = vec![0.0; facets.len()];
    let mut falling: Vec<f64> = facets.iter().map(|facet| facet.solid_angle).collect();
    // Each fall lowers the centre of mass, unless the minimum tip angle excludes all minima.
    for _ in 0..=facets.len() {
        let mut next = vec![0.0; facets.len()];
        for (index, facet) in facets.iter().enumerate() {
            if rests(facet) {
                resting[index] += falling[index];
                continue;
            }
            for &neighbour in &facet.tips_to {
                next[neighbour] += falling[index] / facet.tips_to.len() as f64;
            }
        }
        if next.iter().all(|fraction| *fraction == 0.0) {
            break;
        }
        falling = next;
    }
    resting
}

/// Pose with the given direction of the object pointing down.
fn resting_pose(hull: &TriangleMesh, center: DVec3, down: DVec3) -> Pose {
    // From upside down, rounding decides the axis of the shortest rotation.
    let rotation = if down.angle_between(DVec3::Z) < UPSIDE_DOWN_RAD {
        let turn = DQuat::from_rotation_x(PI);
        DQuat::from_rotation_arc(turn * down, DVec3::NEG_Z) * turn
    } else {
        DQuat::from_rotation_arc(down, DVec3::NEG_Z)
    };
    let rotated = Pose::from_rotation(rotation);
    let heights = hull.vertices.iter().map(|&v| rotated.transform_point(v).z);
    let lowest = heights.fold(f64::INFINITY, f64::min);
    let above = rotated.transform_point(center);
    Pose::new(rotation, DVec3::new(-above.x, -above.y, -lowest))
}

fn facets(hull: &TriangleMesh, center: DVec3) -> Vec<Facet> {
    let tolerance = FLATNESS * hull.bounds().diagonal();
    let (facet_of, planes) = group_by_plane(hull, tolerance);
    let mut triangles: Vec<Vec<[DVec3; 3]>> = vec![Vec::new(); planes.len()];
    for (corners, &facet) in hull.all_corners().zip(&facet_of) {
        triangles[facet].push(corners);
    }
    let mut sides: Vec<Vec<Side>> = vec![Vec::new(); planes.len()];
    let edges = hull.edges();
    for edge in 0..edges.len() {
        if let &[s, t] = edges.triangles(edge) {
            let ends = edges.vertices[edge].map(|v| hull.vertices[v as usize]);
            let pair = [facet_of[s as usize], facet_of[t as usize]];
            if pair[0] != pair[1] {
                sides[pair[0]].push((ends, pair[1]));
                sides[pair[1]].push((ends, pair[0]));
            }
        }
    }
    planes
        .iter()
        .zip(triangles.iter().zip(&sides))
        .map(|(plane, (triangles, sides))| facet(plane, triangles, sides, center, tolerance))
        .collect()
}

/// Ends of a side of a facet and the facet beyond.
type Side = ([DVec3; 2], usize);

/// A plane by a point of it and its unit normal.
struct Plane {
    point: DVec3,
    normal: DVec3,
}

impl Plane {
    /// The plane of a triangle.
    fn through([a, b, c]: [DVec3; 3]) -> Self {
        Self {
            point: a,
            normal: (b - a).cross(c - a).normalize_or_zero(),
        }
    }

    /// Height of a point over the plane, m.
    fn height(&self, p: DVec3) -> f64 {
        (p - self.point).dot(self.normal)
    }

    /// The point of the plane below `p`.
    fn foot(&self, p: DVec3) -> DVec3 {
        p - self.normal * self.height(p)
    }
}

/// A facet of a hull with centre of mass `center`; distances within `tolerance` (m) are equal.
fn facet(
    plane: &Plane,
    triangles: &[[DVec3; 3]],
    sides: &[Side],
    center: DVec3,
    tolerance: f64,
) -> Facet {
    let height = -plane.height(center);
    let foot = plane.foot(center);
    let reach = |corners: &[DVec3; 3]| {
        let flat = corners.map(|c| plane.foot(c));
        closest_on_triangle(foot, &flat).1.distance(foot)
    };
    let outside_by = triangles.iter().map(reach).fold(f64::INFINITY, f64::min);
    let middle = middle_of(triangles);
    // A foot beyond the corner of two sides tips over the one that it is further beyond.
    let beyond = |side: &&Side| {
        let [a, b] = side.0;
        let across = (b - a).cross(plane.normal).normalize_or_zero();
        (foot - a).dot(across) * (a - middle).dot(across).signum()
    };
    let distance = |(ends, _): &Side| distance_to_segment(foot, &ends.map(|p| plane.foot(p)));
    let shortest = sides.iter().map(distance).fold(f64::INFINITY, f64::min);
    let nearest = |side: &&Side| distance(side) <= shortest + tolerance;
    let farthest_beyond = sides.iter().filter(nearest).map(|side| beyond(&side));
    let farthest_beyond = farthest_beyond.fold(f64::NEG_INFINITY, f64::max);
    let tips_over = sides
        .iter()
        .filter(nearest)
        .filter(|side| beyond(side) >= farthest_beyond - tolerance);
    let tips_to: BTreeSet<usize> = tips_over.map(|(_, facet)| *facet).collect();
    let is_above = outside_by <= 1e-9 * height;
    let margin = if is_above { shortest } else { -shortest };
    let seen: f64 = triangles.iter().map(|t| solid_angle(t, center)).sum();
    Facet {
        normal: plane.normal,
        solid_angle: seen / (4.0 * PI),
        tip_angle: margin.atan2(height),
        tips_to: tips_to.into_iter().collect(),
    }
}

/// A point within a facet.
fn middle_of(triangles: &[[DVec3; 3]]) -> DVec3 {
    let count = triangles.len().max(1) as f64;
    triangles.iter().flatten().sum::<DVec3>() / (3.0 * count)
}

fn distance_to_segment(point: DVec3, &[a, b]: &[DVec3; 2]) -> f64 {
    let along = b - a;
    let t = (point - a).dot(along) / along.length_squared();
    point.distance(a + along * t.clamp(0.0, 1.0))
}

/// Index of each triangle's facet, and the plane of each facet. The largest remaining triangle
/// starts a facet with all connected triangles within `tolerance` (m) of its plane; slivers, whose
/// own plane is uncertain, join a neighbour.
fn group_by_plane(hull: &TriangleMesh, tolerance: f64) -> (Vec<usize>, Vec<Plane>) {
    let areas = hull.triangle_areas();
    let is_sliver = |t: usize| {
        let [a, b, c] = hull.corners(hull.triangles[t]);
        let longest = a.distance(b).max(b.distance(c)).max(c.distance(a));
        2.0 * areas[t] <= tolerance * longest
    };
    let mut seeds: Vec<usize> = (0..areas.len()).filter(|&t| !is_sliver(t)).collect();
    seeds.sort_by(|&a, &b| areas[b].total_cmp(&areas[a]).then(a.cmp(&b)));
    let neighbours = neighbours(hull);
    let mut facet_of: Vec<Option<usize>> = vec![None; areas.len()];
    let mut planes = Vec::new();
    for seed in seeds {
        if facet_of[seed].is_some() {
            continue;
        }
        let plane = Plane::through(hull.corners(hull.triangles[seed]));
        let is_flat = |t: u32| {
            let corners = hull.corners(hull.triangles[t as usize]);
            corners.iter().all(|&p| plane.height(p).abs() <= tolerance)
        };
        facet_of[seed] = Some(planes.len());
        let mut open = vec![seed];
        while let Some(t) = open.pop() {
            for &next in &neighbours[t] {
                if facet_of[next as usize].is_none() && is_flat(next) {
                    facet_of[next as usize] = Some(planes.len());
                    open.push(next as usize);
                }
            }
        }
        planes.push(plane);
    }
    let mut open: Vec<usize> = (0..areas.len())
        .filter(|&t| facet_of[t].is_some())
        .collect();
    while let Some(t) = open.pop() {
        for &next in &neighbours[t] {
            if facet_of[next as usize].is_none() {
                facet_of[next as usize] = facet_of[t];
                open.push(next as usize);
            }
        }
    }
    let facet_of = facet_of.into_iter().map(|f| f.unwrap_or(0)).collect();
    (facet_of, planes)
}

/// Triangles across the sides of each triangle.
fn neighbours(hull: &TriangleMesh) -> Vec<Vec<u32>> {
    let mut neighbours = vec![Vec::with_capacity(3); hull.triangles.len()];
    let edges = hull.edges();
    for edge in 0..edges.len() {
        if let &[s, t] = edges.triangles(edge) {
            neighbours[s as usize].push(t);
            neighbours[t as usize].push(s);
        }
    }
    neighbours
}

#[cfg(test)]
#[path = "stable_poses_test.rs"]
mod tests;
