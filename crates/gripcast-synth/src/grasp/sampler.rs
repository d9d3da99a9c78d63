//! Draws grasps: two opposite places approached from above, then what goes wrong in practice.

use glam::{DVec2, DVec3};

use serde::{Deserialize, Serialize};

use gripcast_base::error::Result;
use gripcast_base::random::SeedStream;
use gripcast_geometry::{Aabb, MeshQuery, Pose, TriangleMesh};
use gripcast_sim::fem::PAD_SIZE_M;
use gripcast_sim::grasp::{GripperState, Placement};

/// Distance between the places that the fingers are to meet, m.
const WIDTH_M: [f64; 2] = [0.008, 0.075];
/// Widest opening of the gripper, m.
const WIDEST_M: f64 = 0.085;
/// Free space between the gels and the ground, m.
const CLEARANCE_M: f64 = 1e-3;
/// Largest angle between the closing direction and the surface's normals, as a cosine: 35°.
const MIN_FACING: f64 = 0.82;
/// Attempts at a pair of places.
const ATTEMPTS: usize = 400;
/// Longer than any way from outside of an object to its surface, m.
const FAR_M: f64 = 0.2;

/// A grasp to try.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Candidate {
    /// Its number among those of its sampler.
    pub number: usize,
    /// How it departs from opposite places.
    pub fault: GraspFault,
    /// Where the gripper is and how far it is open.
    pub placed: GripperState,
    /// How hard a person squeezes, between the least (0) and the most (1).
    pub squeeze: f64,
}

/// How a grasp departs from a pair of opposite places.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum GraspFault {
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

impl GraspFault {
    /// Its name in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::OffCentre => "off_centre",
            Self::Tilted => "tilted",
            Self::Leaned => "leaned",
            Self::Shallow => "shallow",
            Self::Edge => "edge",
        }
    }
}

/// How far grasps depart from opposite places.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FaultRanges {
    /// Shift of the contacts towards the gels' side, m.
    pub across_m: [f64; 2],
    /// One finger higher than the other, rad.
    pub tilt_rad: [f64; 2],
    /// Approach off the vertical, rad.
    pub lean_rad: [f64; 2],
    /// Turn of the closing direction away from the normals, rad.
    pub turn_rad: [f64; 2],
    /// Height of the gels' middle above the contacts, m.
    pub raised_m: [f64; 2],
    /// Where given: off-centre and shallow grasps are moved until the gels overlap the object by
    /// only this much, m, instead of by the shifts above.
    pub overlap_m: Option<[f64; 2]>,
    /// What is drawn from, each item as often as any other. Many tilted and leaned grasps hit
    /// something and are drawn again.
    pub faults: &'static [GraspFault],
}

impl FaultRanges {
    /// What goes wrong while a dataset is collected.
    pub const COLLECTED: Self = Self {
        across_m: [0.005, 0.013],
        tilt_rad: [0.12, 0.35],
        lean_rad: [0.15, 0.45],
        turn_rad: [0.2, 0.6],
        raised_m: [0.006, 0.012],
        overlap_m: None,
        faults: &[
            GraspFault::None,
            GraspFault::OffCentre,
            GraspFault::Tilted,
            GraspFault::Leaned,
            GraspFault::Shallow,
            GraspFault::Edge,
        ],
    };
    /// More of it, so that about as many grasps are lost as are held.
    pub const WIDE: Self = Self {
        tilt_rad: [0.15, 0.45],
        lean_rad: [0.2, 0.7],
        turn_rad: [0.4, 1.1],
        overlap_m: Some([0.0035, 0.009]),
        faults: &[
            GraspFault::None,
            GraspFault::OffCentre,
            GraspFault::OffCentre,
            GraspFault::OffCentre,
            GraspFault::OffCentre,
            GraspFault::Tilted,
            GraspFault::Tilted,
            GraspFault::Tilted,
            GraspFault::Leaned,
            GraspFault::Leaned,
            GraspFault::Shallow,
            GraspFault::Shallow,
            GraspFault::Shallow,
            GraspFault::Shallow,
            GraspFault::Edge,
            GraspFault::Edge,
        ],
        ..Self::COLLECTED
    };
}

/// Draws grasps of an object that lies on the ground, from above.
pub struct GraspSampler<'a> {
    name: &'a str,
    seed: u64,
    ranges: FaultRanges,
    /// The object in its own frame, m.
    object: &'a TriangleMesh,
    t_world_object: Pose,
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
    /// Distance between them, m.
    width_m: f64,
}

impl<'a> GraspSampler<'a> {
    /// A sampler of `object` (m, its own frame) lying at `t_world_object` on the ground z = 0. Seed
    /// and name say what is drawn.
    pub fn new(
        name: &'a str,
        object: &'a TriangleMesh,
        t_world_object: Pose,
        ranges: FaultRanges,
        seed: u64,
    ) -> Self {
        let mesh = object.transformed(&t_world_object);
        let areas = mesh.triangle_areas();
        let running = areas.iter().scan(0.0, |sum, area| {
            *sum += area;
            Some(*sum)
        });
        Self {
            name,
            seed,
            ranges,
            object,
            t_world_object,
            query: MeshQuery::new(&mesh),
            areas: running.collect(),
            mesh,
        }
    }

    /// The candidate of a number; the same on every call. None where no pair of places was found.
    ///
    /// # Errors
    /// `Input` for an object without extent.
    pub fn candidate(&self, number: usize) -> Result<Option<Candidate>> {
        let name = format!("grasp {} {number}", self.name);
        let mut draw = SeedStream::named(self.seed, &name);
        let pair = (0..ATTEMPTS).find_map(|_| self.pair(&mut draw));
        let Some(pair) = pair else {
            return Ok(None);
        };
        let squeeze = draw.uniform();
        let (fault, placed) = self.placed(&pair, &mut draw)?;
        Ok(Some(Candidate {
            number,
            fault,
            placed,
            squeeze,
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
            let faces = -normal.dot(direction) > MIN_FACING;
            faces.then_some(start + hit.t * direction)
        };
        let (left, right) = (seen_from(closing)?, seen_from(-closing)?);
        let width = (right - left).dot(closing);
        (WIDTH_M[0]..=WIDTH_M[1]).contains(&width).then_some(Pair {
            middle: 0.5 * (left + right),
            closing,
            width_m: width,
        })
    }

    /// Height that both gels can touch over their width, m.
    fn top(&self, pair: &Pair) -> Option<f64> {
        let across = pair.closing.cross(DVec3::Z);
        let sides = [-0.4, 0.0, 0.4].map(|fraction| fraction * PAD_SIZE_M[1] * across);
        let height = |place: DVec3| {
            let start = place.with_z(FAR_M);
            let hit = self.query.ray_cast(start, -DVec3::Z, FAR_M)?;
            Some(FAR_M - hit.t)
        };
        Self::of_both(pair, &sides, height)
    }

    /// How far both gels can touch the object from two places along their width, m: to the left or
    /// the right of the gripper as `side` is −1 or 1.
    fn reach(&self, pair: &Pair, side: f64) -> Option<f64> {
        let outwards = side * DVec3::Z.cross(-pair.closing);
        let heights = [-0.2, 0.0, 0.2].map(|fraction| fraction * PAD_SIZE_M[0] * DVec3::Z);
        let reach = |place: DVec3| {
            let start = place + FAR_M * outwards;
            let hit = self.query.ray_cast(start, -outwards, 2.0 * FAR_M)?;
            Some(FAR_M - hit.t)
        };
        Self::of_both(pair, &heights, reach)
    }

    /// The most that `felt` finds at each of two places and around it; the lesser of both.
    fn of_both(pair: &Pair, around: &[DVec3], felt: impl Fn(DVec3) -> Option<f64>) -> Option<f64> {
        let depth_m = TOUCHED_M.min(pair.width_m / 3.0);
        let most = |sign: f64| {
            let inside = sign * (0.5 * pair.width_m - depth_m) * pair.closing;
            let places = around.iter().map(|offset| pair.middle + inside + *offset);
            places.filter_map(&felt).reduce(f64::max)
        };
        Some(most(-1.0)?.min(most(1.0)?))
    }

    /// The gripper at a pair of places, and off it by what a person does wrong.
    fn placed(&self, pair: &Pair, draw: &mut SeedStream) -> Result<(GraspFault, GripperState)> {
        let ranges = &self.ranges;
        let fault = ranges.faults[draw.index(ranges.faults.len())];
        let mut off = |is: GraspFault, [least, most]: [f64; 2], usual: f64| {
            let (sign, size) = (draw.pick([-1.0, 1.0]), draw.uniform());
            sign * if fault == is {
                least + (most - least) * size
            } else {
                usual * size
            }
        };
        let mut across = off(GraspFault::OffCentre, ranges.across_m, 0.002);
        let tilt = off(GraspFault::Tilted, ranges.tilt_rad, 0.03);
        let lean = off(GraspFault::Leaned, ranges.lean_rad, 0.03);
        let turn = off(GraspFault::Edge, ranges.turn_rad, 0.04);
        let mut raised = off(GraspFault::Shallow, ranges.raised_m, 0.002);
        if fault == GraspFault::Shallow {
            raised = raised.abs();
        }
        let along = off(GraspFault::None, [0.0, 0.001], 0.002);
        if let Some([least, most]) = ranges.overlap_m {
            let overlap = draw.between(least, most);
            match fault {
                GraspFault::OffCentre => {
                    let side = across.signum();
                    let reach = self.reach(pair, side).unwrap_or_default();
                    across = side * (reach + 0.5 * PAD_SIZE_M[1] - overlap);
                }
                GraspFault::Shallow => {
                    let top = self.top(pair).unwrap_or(pair.middle.z);
                    raised = top + 0.5 * PAD_SIZE_M[0] - overlap - pair.middle.z;
                }
                _ => {}
            }
        }
        let bounds = Aabb::from_points(self.mesh.vertices.iter().copied());
        let yaw = pair.closing.y.atan2(pair.closing.x) + turn;
        let from_center = (pair.middle - bounds.center()).truncate();
        let axis = DVec2::from_angle(yaw);
        let mut placement = Placement {
            yaw_rad: yaw,
            roll_rad: tilt,
            pitch_rad: lean,
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
                .place(self.object, &self.t_world_object)?
                .opening_m
                .min(WIDEST_M),
        );
        placement.height_m = Some(pair.middle.z + raised);
        let placed = placement.place(self.object, &self.t_world_object)?;
        let low = lowest(&placed);
        placement.height_m = Some(pair.middle.z + raised + (CLEARANCE_M - low).max(0.0));
        Ok((fault, placement.place(self.object, &self.t_world_object)?))
    }
}

/// How deep gels reach into the space between two places, m: what lies deeper is not touched.
const TOUCHED_M: f64 = 0.0015;

/// Height of the lowest corner of the gels above the ground, m.
fn lowest(placed: &GripperState) -> f64 {
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
    use gripcast_geometry::{builtin, stable_poses};

    #[test]
    fn candidates_clear_the_ground_fit_the_gripper_and_are_drawn_again_alike() {
        for shape in ["jack", "star", "dented", "saddle", "lump"] {
            let mesh = builtin(shape).unwrap();
            let t_world_object = stable_poses(&mesh, 0.0).unwrap()[0].t_world_object;
            let sampler =
                GraspSampler::new(shape, &mesh, t_world_object, FaultRanges::COLLECTED, 4);
            let (mut found, mut tilts, mut faults) = (0, 0, Vec::new());
            for number in 0..12 {
                let Some(candidate) = sampler.candidate(number).unwrap() else {
                    continue;
                };
                found += 1;
                assert_eq!(sampler.candidate(number).unwrap(), Some(candidate));
                let placed = candidate.placed;
                assert!((0.0..1.0).contains(&candidate.squeeze));
                assert!(placed.opening_m <= WIDEST_M, "{shape}");
                assert!(lowest(&placed) > 0.9 * CLEARANCE_M, "{shape}");
                let axes = placed.t_world_gripper.rotation_matrix();
                assert!(axes.z_axis.z < -0.7, "{shape}");
                tilts += usize::from(axes.z_axis.z > -0.99);
                faults.push(candidate.fault);
            }
            assert!(found >= 8, "{shape}: {found}");
            assert!((1..found).contains(&tilts), "{shape}: {tilts}");
            faults.sort_unstable();
            faults.dedup();
            assert!(faults.len() > 2, "{shape}: {faults:?}");
        }
    }

    #[test]
    fn off_centre_and_shallow_grasps_overlap_the_object_as_they_should() {
        let mesh = builtin("box").unwrap();
        let t_world_object = stable_poses(&mesh, 0.0).unwrap()[0].t_world_object;
        let overlaps = |ranges: FaultRanges, fault: GraspFault, axis: usize| -> Vec<f64> {
            let sampler = GraspSampler::new("box", &mesh, t_world_object, ranges, 2);
            let drawn = (0..60).filter_map(|number| sampler.candidate(number).unwrap());
            let of_fault = drawn.filter(|candidate| candidate.fault == fault);
            let overlap = |candidate: Candidate| {
                let t_gripper_object = candidate.placed.t_world_gripper.inverse() * t_world_object;
                let places = mesh
                    .vertices
                    .iter()
                    .map(|v| t_gripper_object.transform_point(*v));
                let bounds = Aabb::from_points(places);
                // Gels span half of their size on both sides of the origin.
                let half = 0.5 * [0.0, PAD_SIZE_M[1], PAD_SIZE_M[0]][axis];
                bounds.max[axis].min(half) - bounds.min[axis].max(-half)
            };
            of_fault.map(overlap).collect()
        };
        for (fault, axis) in [(GraspFault::OffCentre, 1), (GraspFault::Shallow, 2)] {
            let wide = overlaps(FaultRanges::WIDE, fault, axis);
            assert!(wide.len() > 4, "{fault:?}: {wide:?}");
            // Small turns of the gripper add up to a millimetre and a half.
            let [least, most] = FaultRanges::WIDE.overlap_m.unwrap();
            let near = least - 1.5e-3..most + 1.5e-3;
            assert!(wide.iter().all(|m| near.contains(m)), "{fault:?}: {wide:?}");
            let collected = overlaps(FaultRanges::COLLECTED, fault, axis);
            assert!(
                collected.iter().any(|m| !near.contains(m)),
                "{fault:?}: {collected:?}"
            );
        }
    }
}
