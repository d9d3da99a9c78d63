//! Turned bodies: rings of vertices along a profile, each with as many vertices as its width asks
//! for, and cross sections that need not be round.

use std::f64::consts::TAU;
use std::ops::Range;

use glam::{DVec2, DVec3};

use gripcast_geometry::TriangleMesh;

/// Points of the table of a [`Section`].
const SAMPLES: usize = 1440;
/// Radius below which a point of a profile lies on the axis, m.
const ON_AXIS_M: f64 = 1e-7;

/// A star-shaped closed curve about the origin for a body of radius 1, by its length from the x axis.
pub(super) struct Section {
    points: Vec<DVec2>,
    along: Vec<f64>,
    /// Rings have a multiple of this many vertices, so that ridges run straight.
    fold: usize,
}

impl Section {
    pub(super) fn circle() -> Self {
        Self::of(1, |_| 1.0)
    }

    /// A circle of so many vertices, in columns from the bottom to the top.
    pub(super) fn columns(count: usize) -> Self {
        Self::of(count, |_| 1.0)
    }

    /// A rectangle with round corners, rounder with less `power` (2 is an ellipse): 1 wide to
    /// each side along y, `aspect` along x.
    pub(super) fn oblong(aspect: f64, power: f64) -> Self {
        Self::of(4, |angle| {
            let part = |x: f64| x.abs().powf(power);
            (part(angle.cos() / aspect) + part(angle.sin())).powf(-1.0 / power)
        })
    }

    /// A regular polygon with the inner radius 1.
    pub(super) fn polygon(sides: usize) -> Self {
        Self::of(sides, |angle| {
            let pitch = TAU / sides as f64;
            1.0 / (angle.rem_euclid(pitch) - 0.5 * pitch).cos()
        })
    }

    /// Waves around the circle; inwards from 1 by twice `depth`.
    pub(super) fn lobes(count: usize, depth: f64) -> Self {
        Self::of(2 * count, |angle| {
            1.0 - depth + depth * (count as f64 * angle).cos()
        })
    }

    fn of(fold: usize, radius: impl Fn(f64) -> f64) -> Self {
        let samples = SAMPLES.div_ceil(fold) * fold;
        let points: Vec<DVec2> = (0..=samples)
            .map(|k| {
                let angle = TAU * (k % samples) as f64 / samples as f64;
                radius(angle) * DVec2::from_angle(angle)
            })
            .collect();
        let mut along = vec![0.0];
        for w in points.windows(2) {
            along.push(along[along.len() - 1] + w[0].distance(w[1]));
        }
        Self {
            points,
            along,
            fold,
        }
    }

    fn length(&self) -> f64 {
        self.along[self.along.len() - 1]
    }

    /// The point at a fraction (0 to 1) of the length.
    fn point(&self, fraction: f64) -> DVec2 {
        let at = fraction * self.length();
        let last = self.points.len() - 1;
        let k = self.along.partition_point(|a| *a <= at).clamp(1, last);
        let step = self.along[k] - self.along[k - 1];
        let part = ((at - self.along[k - 1]) / step).clamp(0.0, 1.0);
        self.points[k - 1].lerp(self.points[k], part)
    }

    /// Vertices of a ring of the given radius.
    fn count(&self, radius: f64, edge: f64) -> usize {
        let wanted = radius * self.length() / edge;
        let fold = self.fold as f64;
        if self.fold == 1 {
            let least = if radius > 0.0025 { 10.0 } else { 6.0 };
            wanted.round().max(least) as usize
        } else if wanted < 0.6 * fold {
            wanted.round().max(6.0) as usize
        } else {
            self.fold * (wanted / fold).round().max(1.0) as usize
        }
    }
}

/// A body that is turned about the z axis.
pub(super) struct Lathe<'a> {
    /// Radius and height (m) of each ring, in the direction that has the body on its left: up on
    /// the outside.
    pub(super) profile: &'a [DVec2],
    /// Whether the profile closes on itself; otherwise it runs from axis to axis.
    pub(super) closed: bool,
    /// Cross section.
    pub(super) section: &'a Section,
    /// Fraction of the cross section (0: round) at a radius and height.
    pub(super) fraction: &'a dyn Fn(DVec2) -> f64,
    /// Width of the faces, m.
    pub(super) edge: f64,
}

/// A ring of vertices: the first and their number. The apex of a cone has one.
struct Ring {
    first: u32,
    count: u32,
    /// Half steps by which it is turned: 0 or 1.
    turn: u32,
}

impl Lathe<'_> {
    pub(super) fn mesh(&self) -> TriangleMesh {
        self.mesh_and_rings().0
    }

    /// The mesh, and for each point of the profile its vertices.
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
        let at = self.profile[row];
        let first = mesh.vertices.len() as u32;
        if at.x < ON_AXIS_M {
            mesh.vertices.push(DVec3::new(0.0, 0.0, at.y));
            return Ring {
                first,
                count: 1,
                turn: 0,
            };
        }
        let count = self.section.count(at.x, self.edge);
        // Turned by half a step in every other row, triangles are nearly equilateral.
        let turn = if self.section.fold == 1 { row % 2 } else { 0 };
        let fraction = (self.fraction)(at);
        for k in 0..count {
            let part = (k as f64 + 0.5 * turn as f64) / count as f64;
            let round = DVec2::from_angle(TAU * part);
            let place = at.x * round.lerp(self.section.point(part), fraction);
            mesh.vertices.push(place.extend(at.y));
        }
        Ring {
            first,
            count: count as u32,
            turn: turn as u32,
        }
    }
}

/// Triangles between two rings.
fn stitch(mesh: &mut TriangleMesh, lower: &Ring, upper: &Ring) {
    let at = |ring: &Ring, k: u32| ring.first + k % ring.count;
    let (mut i, mut j) = (0, 0);
    let ends = [lower, upper].map(|r| if r.count == 1 { 0 } else { r.count });
    while i < ends[0] || j < ends[1] {
        let next = (2 * i + 1 + lower.turn) * upper.count;
        let other = (2 * j + 1 + upper.turn) * lower.count;
        if j >= ends[1] || (i < ends[0] && next <= other) {
            let side = [at(lower, i), at(lower, i + 1), at(upper, j)];
            mesh.triangles.push(side);
            i += 1;
        } else {
            let side = [at(lower, i), at(upper, j + 1), at(upper, j)];
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
    fn a_cylinder_and_a_pipe_have_their_volumes() {
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
