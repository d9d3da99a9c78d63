//! Turned bodies: rings of vertices along a profile, with a number of vertices that follows the
//! radius and cross sections that need not be circular.

use std::f64::consts::TAU;
use std::ops::Range;

use glam::{DVec2, DVec3};

use super::outline::{arc_lengths, point_at};
use gripcast_geometry::TriangleMesh;

/// Points of a [`Section`].
const SAMPLES: usize = 1440;
/// Radius below which a profile point is on the axis, m.
const ON_AXIS_M: f64 = 1e-7;

/// Cross section of a body of radius 1: a star-shaped closed curve about the origin.
pub(super) struct Section {
    points: Vec<DVec2>,
    /// Arc length at each point.
    lengths: Vec<f64>,
    /// Rings have a multiple of this many vertices, so that ridges are straight.
    fold: usize,
}

impl Section {
    pub(super) fn circle() -> Self {
        Self::new(1, |_| 1.0)
    }

    /// A circle with `count` vertices in each ring.
    pub(super) fn columns(count: usize) -> Self {
        Self::new(count, |_| 1.0)
    }

    /// A superellipse with half widths `aspect` along x and 1 along y; a `power` of 2 is an
    /// ellipse, more is closer to a rectangle.
    pub(super) fn oblong(aspect: f64, power: f64) -> Self {
        Self::new(4, |angle| {
            let term = |x: f64| x.abs().powf(power);
            (term(angle.cos() / aspect) + term(angle.sin())).powf(-1.0 / power)
        })
    }

    /// A regular polygon with inradius 1.
    pub(super) fn polygon(sides: usize) -> Self {
        Self::new(sides, |angle| {
            let pitch = TAU / sides as f64;
            1.0 / (angle.rem_euclid(pitch) - 0.5 * pitch).cos()
        })
    }

    /// `count` waves between the radii 1 and 1 − 2 `depth`.
    pub(super) fn lobes(count: usize, depth: f64) -> Self {
        Self::new(2 * count, |angle| {
            1.0 - depth + depth * (count as f64 * angle).cos()
        })
    }

    fn new(fold: usize, radius: impl Fn(f64) -> f64) -> Self {
        let samples = SAMPLES.div_ceil(fold) * fold;
        let points: Vec<DVec2> = (0..=samples)
            .map(|k| {
                let angle = TAU * (k % samples) as f64 / samples as f64;
                radius(angle) * DVec2::from_angle(angle)
            })
            .collect();
        Self {
            lengths: arc_lengths(&points),
            points,
            fold,
        }
    }

    fn length(&self) -> f64 {
        self.lengths[self.lengths.len() - 1]
    }

    /// Returns the point at a fraction (0 to 1) of the length.
    fn point(&self, fraction: f64) -> DVec2 {
        point_at(&self.points, &self.lengths, fraction * self.length())
    }

    /// Number of vertices of a ring of the given radius.
    fn count(&self, radius: f64, edge: f64) -> usize {
        let wanted = radius * self.length() / edge;
        let fold = self.fold as f64;
        if self.fold == 1 {
            let min = if radius > 0.0025 { 10.0 } else { 6.0 };
            wanted.round().max(min) as usize
        } else if wanted < 0.6 * fold {
            wanted.round().max(6.0) as usize
        } else {
            self.fold * (wanted / fold).round().max(1.0) as usize
        }
    }
}

/// A body turned about the z axis.
pub(super) struct Lathe<'a> {
    /// Radius and height (m) of each ring, with the body on the left: upwards on the outside.
    pub(super) profile: &'a [DVec2],
    /// Whether the profile closes on itself; otherwise it runs from axis to axis.
    pub(super) closed: bool,
    /// Cross section.
    pub(super) section: &'a Section,
    /// Weight of the cross section (0 is round) at a radius and height.
    pub(super) fraction: &'a dyn Fn(DVec2) -> f64,
    /// Edge length, m.
    pub(super) edge: f64,
}

/// A ring of vertices; the apex of a cone has one.
struct Ring {
    first: u32,
    count: u32,
    /// Rotation in half steps: 0 or 1.
    phase: u32,
}

impl Lathe<'_> {
    pub(super) fn mesh(&self) -> TriangleMesh {
        self.mesh_and_rings().0
    }

    /// Returns the mesh, and the vertices of each profile point.
    pub(super) fn mesh_and_rings(&self) -> (TriangleMesh, Vec<Range<u32>>) {
        let mut mesh = TriangleMesh::default();
        let rings: Vec<Ring> = (0..self.profile.len())
            .map(|row| self.ring(&mut mesh, row))
            .collect();
        for pair in rings.windows(2) {
            stitch(&mut mesh, &pair[0], &pair[1]);
        }
        if self.closed {
            stitch(&mut mesh, &rings[rings.len() - 1], &rings[0]);
        }
        let ranges = rings.iter().map(|r| r.first..r.first + r.count).collect();
        (mesh, ranges)
    }

    fn ring(&self, mesh: &mut TriangleMesh, row: usize) -> Ring {
        let point = self.profile[row];
        let first = mesh.vertices.len() as u32;
        if point.x < ON_AXIS_M {
            mesh.vertices.push(DVec3::new(0.0, 0.0, point.y));
            return Ring {
                first,
                count: 1,
                phase: 0,
            };
        }
        let count = self.section.count(point.x, self.edge);
        // Rotating every other row by half a step makes nearly equilateral triangles.
        let phase = if self.section.fold == 1 { row % 2 } else { 0 };
        let fraction = (self.fraction)(point);
        for k in 0..count {
            let around = (k as f64 + 0.5 * phase as f64) / count as f64;
            let round = DVec2::from_angle(TAU * around);
            let vertex = point.x * round.lerp(self.section.point(around), fraction);
            mesh.vertices.push(vertex.extend(point.y));
        }
        Ring {
            first,
            count: count as u32,
            phase: phase as u32,
        }
    }
}

/// Adds the triangles between two rings.
fn stitch(mesh: &mut TriangleMesh, lower: &Ring, upper: &Ring) {
    let vertex = |ring: &Ring, k: u32| ring.first + k % ring.count;
    let (mut i, mut j) = (0, 0);
    let ends = [lower, upper].map(|r| if r.count == 1 { 0 } else { r.count });
    while i < ends[0] || j < ends[1] {
        let next = (2 * i + 1 + lower.phase) * upper.count;
        let other = (2 * j + 1 + upper.phase) * lower.count;
        if j >= ends[1] || (i < ends[0] && next <= other) {
            let side = [vertex(lower, i), vertex(lower, i + 1), vertex(upper, j)];
            mesh.triangles.push(side);
            i += 1;
        } else {
            let side = [vertex(lower, i), vertex(upper, j + 1), vertex(upper, j)];
            mesh.triangles.push(side);
            j += 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::outline::{closed_line, open_line, sharp};
    use super::*;
    use gripcast_geometry::MassProperties;
    use std::f64::consts::PI;

    fn turned(profile: &[DVec2], closed: bool, edge: f64) -> TriangleMesh {
        Lathe {
            profile,
            closed,
            section: &Section::circle(),
            fraction: &|_| 0.0,
            edge,
        }
        .mesh()
    }

    #[test]
    fn cylinder_and_pipe_have_their_volumes() {
        let edge = 0.003;
        let rod = [
            sharp(0.0, 0.0),
            sharp(0.02, 0.0),
            sharp(0.02, 0.05),
            sharp(0.0, 0.05),
        ];
        let mesh = turned(&open_line(&rod, edge), false, edge);
        assert!(mesh.edges().is_closed());
        let volume = MassProperties::from_mesh(&mesh).unwrap().volume_m3;
        assert!((volume / (PI * 4e-4 * 0.05) - 1.0).abs() < 0.01, "{volume}");
        let pipe = [
            sharp(0.015, 0.0),
            sharp(0.02, 0.0),
            sharp(0.02, 0.05),
            sharp(0.015, 0.05),
        ];
        let mesh = turned(&closed_line(&pipe, edge), true, edge);
        assert!(mesh.edges().is_closed());
        let volume = MassProperties::from_mesh(&mesh).unwrap().volume_m3;
        assert!((volume / (PI * 1.75e-4 * 0.05) - 1.0).abs() < 0.01);
    }

    #[test]
    fn sections_have_their_widths() {
        let hexagon = Section::polygon(6);
        assert!((hexagon.length() - 12.0 / 3f64.sqrt()).abs() < 1e-3);
        assert!((hexagon.point(0.0).x - 2.0 / 3f64.sqrt()).abs() < 1e-12);
        assert_eq!(hexagon.count(0.01, 0.003) % 6, 0);
        let oblong = Section::oblong(1.5, 4.0);
        assert!((oblong.point(0.0).x - 1.5).abs() < 1e-12);
        assert!((oblong.point(0.25).y - 1.0).abs() < 1e-3);
    }
}
