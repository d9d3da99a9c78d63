//! Draws grasps: two opposite places approached from above, then what goes wrong in practice.

use glam::{DVec2, DVec3};

use super::object::DemoObject;
use crate::error::Result;
use crate::geometry::{Aabb, MeshQuery, TriangleMesh};
use crate::render::visual::SeedStream;
use crate::sim::fem::PAD_SIZE_M;
use crate::sim::grasp::{Placed, Placement};

/// A person's squeeze, N.
const FORCE_N: [f64; 2] = [25.0, 50.0];
/// Distance between the places that the fingers are to meet, m.
const WIDTH_M: [f64; 2] = [0.008, 0.075];
/// Widest opening of the gripper, m.
const WIDEST_M: f64 = 0.085;
/// Free space between the gels and the ground, m.
const CLEARANCE_M: f64 = 1e-3;
/// Largest angle between the closing direction and the surface's normals, as a cosine: 35°.
const LEAST_FACING: f64 = 0.82;
/// Attempts at a pair of places.
const ATTEMPTS: usize = 400;
/// Longer than any way from outside of an object to its surface, m.
const FAR_M: f64 = 0.2;

/// A grasp to try.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Candidate {
    /// Its number among those of its object.
    pub(super) number: usize,
    /// Where the gripper is and how far it is open.
    pub(super) placed: Placed,
    /// The person's squeeze, N.
    pub(super) stop_force_n: f64,
}

/// How a grasp departs from a pair of opposite places.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Slip {
    /// Hardly.
    None,
    /// The contacts lie off the middle of the gels, towards their side.
    OffCentre,
    /// One finger is higher than the other.
    Tilted,
    /// The approach is not vertical.
    Leaned,
    /// Only the ends of the gels meet the object.
    Shallow,
    /// The closing direction is turned away from the normals.
    Edge,
}

const SLIPS: [Slip; 6] = [
    Slip::None,
    Slip::OffCentre,
    Slip::Tilted,
    Slip::Leaned,
    Slip::Shallow,
    Slip::Edge,
];

/// Draws the candidates of an object.
pub(super) struct Sampler<'a> {
    object: &'a DemoObject,
    seed: u64,
    /// The object as it lies.
    mesh: TriangleMesh,
    query: MeshQuery,
    /// Running sum of the triangles' areas.
    areas: Vec<f64>,
}

/// Two places on opposite sides, in the world.
struct Pair {
    middle: DVec3,
    /// From the left to the right place.
    closing: DVec3,
}

impl<'a> Sampler<'a> {
    pub(super) fn new(object: &'a DemoObject, seed: u64) -> Self {
        let mesh = object.mesh.transformed(&object.t_world_object);
        let areas = mesh.triangle_areas();
        let running = areas.iter().scan(0.0, |sum, area| {
            *sum += area;
            Some(*sum)
        });
        Self {
            object,
            seed,
            query: MeshQuery::new(&mesh),
            areas: running.collect(),
            mesh,
        }
    }

    /// The candidate of a number; the same on every call. None where no pair of places was found.
    ///
    /// # Errors
    /// None for the objects of a plan.
    pub(super) fn candidate(&self, number: usize) -> Result<Option<Candidate>> {
        let name = format!("grasp {} {number}", self.object.name);
        let mut draw = SeedStream::named(self.seed, &name);
        let pair = (0..ATTEMPTS).find_map(|_| self.pair(&mut draw));
        let Some(pair) = pair else {
            return Ok(None);
        };
        let stop_force_n = draw.between(FORCE_N[0], FORCE_N[1]);
        let placed = self.placed(&pair, &mut draw)?;
        Ok(Some(Candidate {
            number,
            placed,
            stop_force_n,
        }))
    }

    /// Places that two fingers would meet first, closing horizontally through a random point of the
    /// surface along its normal.
    fn pair(&self, draw: &mut SeedStream) -> Option<Pair> {
        let total = *self.areas.last()?;
        let at = draw.uniform() * total;
        let triangle = self.areas.partition_point(|sum| *sum < at);
        let corners = self.mesh.corners(*self.mesh.triangles.get(triangle)?);
        let [a, b, c] = corners;
        let normal = (b - a).cross(c - a).normalize_or_zero();
        let closing = (-normal.with_z(0.0)).try_normalize()?;
        let through = (a + b + c) / 3.0;
        let seen_from = |direction: DVec3| {
            let start = through - FAR_M * direction;
            let hit = self.query.ray_cast(start, direction, 2.0 * FAR_M)?;
            let [a, b, c] = self
                .mesh
                .corners(self.mesh.triangles[hit.triangle as usize]);
            let normal = (b - a).cross(c - a).normalize_or_zero();
            let faces = -normal.dot(direction) > LEAST_FACING;
            faces.then_some(start + hit.t * direction)
        };
        let (left, right) = (seen_from(closing)?, seen_from(-closing)?);
        let width = (right - left).dot(closing);
        (WIDTH_M[0]..=WIDTH_M[1]).contains(&width).then_some(Pair {
            middle: 0.5 * (left + right),
            closing,
        })
    }

    /// The gripper at a pair of places, and off it by what a person does wrong.
    fn placed(&self, pair: &Pair, draw: &mut SeedStream) -> Result<Placed> {
        let slip = draw.pick(SLIPS);
        let mut off = |is: Slip, least: f64, most: f64, usual: f64| {
            let (sign, size) = (draw.pick([-1.0, 1.0]), draw.uniform());
            sign * if slip == is {
                least + (most - least) * size
            } else {
                usual * size
            }
        };
        let across = off(Slip::OffCentre, 0.005, 0.013, 0.002);
        let tilt = off(Slip::Tilted, 0.12, 0.35, 0.03);
        let lean = off(Slip::Leaned, 0.15, 0.45, 0.03);
        let turn = off(Slip::Edge, 0.2, 0.6, 0.04);
        let raised = off(Slip::Shallow, 0.006, 0.012, 0.002);
        let raised = if slip == Slip::Shallow {
            raised.abs()
        } else {
            raised
        };
        let along = off(Slip::None, 0.0, 0.001, 0.002);
        let bounds = Aabb::from_points(self.mesh.vertices.iter().copied());
        let yaw = pair.closing.y.atan2(pair.closing.x) + turn;
        let from_center = (pair.middle - bounds.center()).truncate();
        let axis = DVec2::from_angle(yaw);
        let mut placement = Placement {
            yaw_rad: yaw,
            tilt_rad: tilt,
            lean_rad: lean,
            offset_m: [
                from_center.dot(axis) + along,
                // The gripper's y axis is the world's, turned and mirrored.
                from_center.perp_dot(axis) + across,
            ],
            height_m: None,
            opening_m: None,
        };
        placement.opening_m = Some(
            placement
                .place(&self.object.mesh, &self.object.t_world_object)?
                .opening_m
                .min(WIDEST_M),
        );
        placement.height_m = Some(pair.middle.z + raised);
        let placed = placement.place(&self.object.mesh, &self.object.t_world_object)?;
        let low = lowest(&placed);
        placement.height_m = Some(pair.middle.z + raised + (CLEARANCE_M - low).max(0.0));
        placement.place(&self.object.mesh, &self.object.t_world_object)
    }
}

/// Height of the lowest corner of the gels above the ground, m.
fn lowest(placed: &Placed) -> f64 {
    let [approach, across, thickness] = PAD_SIZE_M;
    let half = DVec3::new(
        0.5 * placed.opening_m + thickness,
        0.5 * across,
        0.5 * approach,
    );
    let axes = placed.t_world_gripper.rotation_matrix();
    let up = DVec3::new(axes.x_axis.z, axes.y_axis.z, axes.z_axis.z);
    placed.t_world_gripper.translation_m.z - up.abs().dot(half)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::replay::demo::object::objects;
    use crate::replay::demo::plan::DemoSettings;

    #[test]
    fn candidates_clear_the_ground_fit_the_gripper_and_are_drawn_again_alike() {
        let settings = DemoSettings {
            seed: 4,
            quick: true,
            shared: None,
            jobs: 1,
        };
        for object in objects(&settings).unwrap() {
            let sampler = Sampler::new(&object, 4);
            let mut found = 0;
            let mut tilts = 0;
            for number in 0..12 {
                let Some(candidate) = sampler.candidate(number).unwrap() else {
                    continue;
                };
                found += 1;
                assert_eq!(sampler.candidate(number).unwrap(), Some(candidate));
                let Candidate {
                    placed,
                    stop_force_n,
                    ..
                } = candidate;
                assert!((25.0..=50.0).contains(&stop_force_n));
                assert!(placed.opening_m <= WIDEST_M, "{}", object.name);
                assert!(lowest(&placed) > 0.9 * CLEARANCE_M, "{}", object.name);
                let axes = placed.t_world_gripper.rotation_matrix();
                assert!(axes.z_axis.z < -0.7, "{}", object.name);
                tilts += usize::from(axes.z_axis.z > -0.99);
            }
            assert!(found >= 8, "{}: {found}", object.name);
            assert!((1..found).contains(&tilts), "{}: {tilts}", object.name);
        }
    }
}
