//! Samples grasps: antipodal contacts approached from above, then typical faults of a person.

use glam::{DVec2, DVec3};

use serde::{Deserialize, Serialize};

use gripcast_base::error::Result;
use gripcast_base::random::SeedStream;
use gripcast_geometry::{Aabb, MeshQuery, Pose, TriangleMesh};
use gripcast_sim::fem::GelPad;
use gripcast_sim::grasp::{GripperState, Placement};

/// Distance between the antipodal contacts, m.
const WIDTH_M: [f64; 2] = [0.008, 0.075];
/// Maximum opening of the gripper, m.
pub(super) const MAX_OPENING_M: f64 = 0.085;
/// Clearance between the gels and the ground, m.
const CLEARANCE_M: f64 = 1e-3;
/// Minimum cosine between the closing direction and the surface normals: 35°.
const MIN_FACING: f64 = 0.82;
/// Attempts to find antipodal contacts.
const ATTEMPTS: usize = 400;
/// Start distance of rays, outside of any object, m.
const FAR_M: f64 = 0.2;

/// A sampled grasp.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Candidate {
    /// Number of the sample.
    pub number: usize,
    /// Deviation from an antipodal grasp.
    pub fault: GraspFault,
    /// Pose and opening of the gripper.
    pub placed: GripperState,
    /// Squeezing force of the person, as a fraction of its range.
    pub squeeze: f64,
}

/// Deviation of a grasp from an antipodal one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum GraspFault {
    /// Almost none.
    None,
    /// The contacts are off the centre of the gels, towards their side.
    OffCentre,
    /// One finger is higher than the other (rotation about the gripper's y axis).
    #[serde(rename = "tilted")]
    Roll,
    /// The approach is not vertical.
    #[serde(rename = "leaned")]
    Pitch,
    /// Only the tips of the gels touch the object.
    Shallow,
    /// The closing direction is rotated away from the normals.
    #[serde(rename = "edge")]
    Yaw,
}

impl GraspFault {
    /// All faults, in the order of [`FaultRanges::weights`].
    const ALL: [Self; 6] = [
        Self::None,
        Self::OffCentre,
        Self::Roll,
        Self::Pitch,
        Self::Shallow,
        Self::Yaw,
    ];

    /// Name in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::OffCentre => "off_centre",
            Self::Roll => "tilted",
            Self::Pitch => "leaned",
            Self::Shallow => "shallow",
            Self::Yaw => "edge",
        }
    }
}

/// Ranges of the deviations from antipodal grasps.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FaultRanges {
    /// Lateral offset of the contacts on the gels, m.
    pub lateral_m: [f64; 2],
    /// Roll: one finger higher than the other, rad.
    pub roll_rad: [f64; 2],
    /// Pitch: approach off the vertical, rad.
    pub pitch_rad: [f64; 2],
    /// Yaw: closing direction off the normals, rad.
    pub yaw_rad: [f64; 2],
    /// Height of the gel centres above the contacts, m.
    pub raised_m: [f64; 2],
    /// If given, off-centre and shallow grasps are moved until the gels overlap the object by only
    /// this much, m, instead of by the offsets above.
    pub overlap_m: Option<[f64; 2]>,
    /// Relative frequencies of the faults, in the order of [`GraspFault`]. Many rolled and pitched
    /// grasps collide and are sampled again.
    pub weights: [usize; 6],
}

impl FaultRanges {
    /// Typical faults while a dataset is collected.
    pub const COLLECTED: Self = Self {
        lateral_m: [0.005, 0.013],
        roll_rad: [0.12, 0.35],
        pitch_rad: [0.15, 0.45],
        yaw_rad: [0.2, 0.6],
        raised_m: [0.006, 0.012],
        overlap_m: None,
        weights: [1, 1, 1, 1, 1, 1],
    };
    /// Larger and more frequent faults, so that about half of the grasps slip.
    pub const WIDE: Self = Self {
        roll_rad: [0.15, 0.45],
        pitch_rad: [0.2, 0.7],
        yaw_rad: [0.4, 1.1],
        overlap_m: Some([0.0035, 0.009]),
        weights: [1, 4, 3, 2, 4, 2],
        ..Self::COLLECTED
    };

    /// Draws a fault by the weights.
    fn draw(&self, draw: &mut SeedStream) -> GraspFault {
        let mut index = draw.index(self.weights.iter().sum());
        let chosen = GraspFault::ALL
            .into_iter()
            .zip(self.weights)
            .find(|(_, weight)| {
                let is_chosen = index < *weight;
                index = index.saturating_sub(*weight);
                is_chosen
            });
        chosen.map_or(GraspFault::None, |(fault, _)| fault)
    }
}

/// Samples grasps from above of an object that lies on the ground.
pub struct GraspSampler<'a> {
    name: &'a str,
    seed: u64,
    ranges: FaultRanges,
    /// The object in its own frame, m.
    object: &'a TriangleMesh,
    t_world_object: Pose,
    pad: GelPad,
    /// The object in the world frame, m.
    mesh: TriangleMesh,
    query: MeshQuery,
    /// Cumulative areas of the triangles.
    areas: Vec<f64>,
}

/// Two antipodal contacts in the world frame.
struct AntipodalPair {
    center: DVec3,
    /// Direction from the left to the right contact.
    closing: DVec3,
    /// Distance between them, m.
    width_m: f64,
}

impl<'a> GraspSampler<'a> {
    /// Creates a sampler for `object` (m, its own frame) at `t_world_object` on the ground z = 0.
    /// Samples depend on seed and name.
    pub fn new(
        name: &'a str,
        object: &'a TriangleMesh,
        t_world_object: Pose,
        ranges: FaultRanges,
        seed: u64,
    ) -> Self {
        let mesh = object.transformed(&t_world_object);
        let areas = mesh.triangle_areas();
        let cumulative = areas.iter().scan(0.0, |sum, area| {
            *sum += area;
            Some(*sum)
        });
        Self {
            name,
            seed,
            ranges,
            object,
            t_world_object,
            pad: GelPad::default(),
            query: MeshQuery::new(&mesh),
            areas: cumulative.collect(),
            mesh,
        }
    }

    /// Samples for gels of another size than the default pad's.
    #[must_use]
    pub fn with_pad(self, pad: GelPad) -> Self {
        Self { pad, ..self }
    }

    /// Returns a sample by its number, the same on every call; none without antipodal contacts.
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

    /// Contacts of two fingers that close horizontally through a random point of the surface along
    /// its normal.
    fn pair(&self, draw: &mut SeedStream) -> Option<AntipodalPair> {
        let total = *self.areas.last()?;
        let area = draw.uniform() * total;
        let triangle = self.areas.partition_point(|sum| *sum < area);
        let corners = self.mesh.corners(*self.mesh.triangles.get(triangle)?);
        let [a, b, c] = corners;
        let normal = (b - a).cross(c - a).normalize_or_zero();
        let closing = (-normal.with_z(0.0)).try_normalize()?;
        let through = (a + b + c) / 3.0;
        let first_contact = |direction: DVec3| {
            let start = through - FAR_M * direction;
            let hit = self.query.ray_cast(start, direction, 2.0 * FAR_M)?;
            let [a, b, c] = self
                .mesh
                .corners(self.mesh.triangles[hit.triangle as usize]);
            let normal = (b - a).cross(c - a).normalize_or_zero();
            let faces = -normal.dot(direction) > MIN_FACING;
            faces.then_some(start + hit.t * direction)
        };
        let (left, right) = (first_contact(closing)?, first_contact(-closing)?);
        let width = (right - left).dot(closing);
        (WIDTH_M[0]..=WIDTH_M[1])
            .contains(&width)
            .then_some(AntipodalPair {
                center: 0.5 * (left + right),
                closing,
                width_m: width,
            })
    }

    /// Height up to which both gels can touch the object over their width, m.
    fn top(&self, pair: &AntipodalPair) -> Option<f64> {
        let across = pair.closing.cross(DVec3::Z);
        let sides = [-0.4, 0.0, 0.4].map(|fraction| fraction * self.pad.size_m[1] * across);
        let height = |point: DVec3| {
            let start = point.with_z(FAR_M);
            let hit = self.query.ray_cast(start, -DVec3::Z, FAR_M)?;
            Some(FAR_M - hit.t)
        };
        Self::probe_both(pair, &sides, height)
    }

    /// Lateral extent of the object that both gels can touch, m: to the left (`side` −1) or right
    /// (1) of the gripper.
    fn reach(&self, pair: &AntipodalPair, side: f64) -> Option<f64> {
        let outwards = side * DVec3::Z.cross(-pair.closing);
        let heights = [-0.2, 0.0, 0.2].map(|fraction| fraction * self.pad.size_m[0] * DVec3::Z);
        let reach = |point: DVec3| {
            let start = point + FAR_M * outwards;
            let hit = self.query.ray_cast(start, -outwards, 2.0 * FAR_M)?;
            Some(FAR_M - hit.t)
        };
        Self::probe_both(pair, &heights, reach)
    }

    /// Maximum of `probe` around each contact; the smaller of both.
    fn probe_both(
        pair: &AntipodalPair,
        offsets: &[DVec3],
        probe: impl Fn(DVec3) -> Option<f64>,
    ) -> Option<f64> {
        let depth_m = TOUCHED_M.min(pair.width_m / 3.0);
        let max = |sign: f64| {
            let inside = sign * (0.5 * pair.width_m - depth_m) * pair.closing;
            let points = offsets.iter().map(|offset| pair.center + inside + *offset);
            points.filter_map(&probe).reduce(f64::max)
        };
        Some(max(-1.0)?.min(max(1.0)?))
    }

    /// Places the gripper at a pair of contacts and adds a fault.
    fn placed(
        &self,
        pair: &AntipodalPair,
        draw: &mut SeedStream,
    ) -> Result<(GraspFault, GripperState)> {
        let ranges = &self.ranges;
        let fault = ranges.draw(draw);
        let mut deviation = |kind: GraspFault, [low, high]: [f64; 2], usual: f64| {
            let (sign, size) = (draw.pick([-1.0, 1.0]), draw.uniform());
            sign * if fault == kind {
                low + (high - low) * size
            } else {
                usual * size
            }
        };
        let mut lateral = deviation(GraspFault::OffCentre, ranges.lateral_m, 0.002);
        let roll = deviation(GraspFault::Roll, ranges.roll_rad, 0.03);
        let pitch = deviation(GraspFault::Pitch, ranges.pitch_rad, 0.03);
        let yaw_offset = deviation(GraspFault::Yaw, ranges.yaw_rad, 0.04);
        let mut raised = deviation(GraspFault::Shallow, ranges.raised_m, 0.002);
        if fault == GraspFault::Shallow {
            raised = raised.abs();
        }
        let along = deviation(GraspFault::None, [0.0, 0.001], 0.002);
        if let Some([low, high]) = ranges.overlap_m {
            let overlap = draw.between(low, high);
            match fault {
                GraspFault::OffCentre => {
                    let side = lateral.signum();
                    let reach = self.reach(pair, side).unwrap_or_default();
                    lateral = side * (reach + self.pad.half_m()[1] - overlap);
                }
                GraspFault::Shallow => {
                    let top = self.top(pair).unwrap_or(pair.center.z);
                    raised = top + self.pad.half_m()[0] - overlap - pair.center.z;
                }
                _ => {}
            }
        }
        let bounds = Aabb::from_points(self.mesh.vertices.iter().copied());
        let yaw = pair.closing.y.atan2(pair.closing.x) + yaw_offset;
        let from_center = (pair.center - bounds.center()).truncate();
        let axis = DVec2::from_angle(yaw);
        let mut placement = Placement {
            yaw_rad: yaw,
            roll_rad: roll,
            pitch_rad: pitch,
            offset_m: [
                from_center.dot(axis) + along,
                // The gripper's y axis is the world's, rotated and mirrored.
                from_center.perp_dot(axis) + lateral,
            ],
            height_m: None,
            opening_m: None,
            pad: self.pad,
        };
        placement.opening_m = Some(
            placement
                .place(self.object, &self.t_world_object)?
                .opening_m
                .min(MAX_OPENING_M),
        );
        placement.height_m = Some(pair.center.z + raised);
        let placed = placement.place(self.object, &self.t_world_object)?;
        let low = min_height_m(&placed, &self.pad);
        placement.height_m = Some(pair.center.z + raised + (CLEARANCE_M - low).max(0.0));
        Ok((fault, placement.place(self.object, &self.t_world_object)?))
    }
}

/// How deep the gels reach between the contacts, m.
const TOUCHED_M: f64 = 0.0015;

/// Height of the lowest corner of the gels above the ground, m.
fn min_height_m(placed: &GripperState, pad: &GelPad) -> f64 {
    let half = pad.pair_half_m(placed.opening_m);
    let axes = placed.t_world_gripper.rotation_matrix();
    let up = DVec3::new(axes.x_axis.z, axes.y_axis.z, axes.z_axis.z);
    placed.t_world_gripper.translation_m.z - up.abs().dot(half)
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_geometry::{builtin, stable_poses};

    #[test]
    fn candidates_clear_the_ground_and_are_reproducible() {
        for shape in ["jack", "star", "dented", "saddle", "lump"] {
            let mesh = builtin(shape).unwrap();
            let t_world_object = stable_poses(&mesh, 0.0).unwrap()[0].t_world_object;
            let sampler =
                GraspSampler::new(shape, &mesh, t_world_object, FaultRanges::COLLECTED, 4);
            let (mut found, mut pitched, mut faults) = (0, 0, Vec::new());
            for number in 0..12 {
                let Some(candidate) = sampler.candidate(number).unwrap() else {
                    continue;
                };
                found += 1;
                assert_eq!(sampler.candidate(number).unwrap(), Some(candidate));
                let placed = candidate.placed;
                assert!((0.0..1.0).contains(&candidate.squeeze));
                assert!(placed.opening_m <= MAX_OPENING_M, "{shape}");
                assert!(
                    min_height_m(&placed, &GelPad::default()) > 0.9 * CLEARANCE_M,
                    "{shape}"
                );
                let axes = placed.t_world_gripper.rotation_matrix();
                assert!(axes.z_axis.z < -0.7, "{shape}");
                pitched += usize::from(axes.z_axis.z > -0.99);
                faults.push(candidate.fault);
            }
            assert!(found >= 8, "{shape}: {found}");
            assert!((1..found).contains(&pitched), "{shape}: {pitched}");
            faults.sort_unstable();
            faults.dedup();
            assert!(faults.len() > 2, "{shape}: {faults:?}");
        }
    }

    #[test]
    fn off_centre_and_shallow_grasps_have_the_planned_overlap() {
        let mesh = builtin("box").unwrap();
        let t_world_object = stable_poses(&mesh, 0.0).unwrap()[0].t_world_object;
        let overlaps = |ranges: FaultRanges, fault: GraspFault, axis: usize| -> Vec<f64> {
            let sampler = GraspSampler::new("box", &mesh, t_world_object, ranges, 2);
            let drawn = (0..60).filter_map(|number| sampler.candidate(number).unwrap());
            let of_fault = drawn.filter(|candidate| candidate.fault == fault);
            let overlap = |candidate: Candidate| {
                let t_gripper_object = candidate.placed.t_world_gripper.inverse() * t_world_object;
                let points = mesh
                    .vertices
                    .iter()
                    .map(|v| t_gripper_object.transform_point(*v));
                let bounds = Aabb::from_points(points);
                // Gels span half of their size on both sides of the origin.
                let half = GelPad::default().half_in_gripper_m()[axis];
                bounds.max[axis].min(half) - bounds.min[axis].max(-half)
            };
            of_fault.map(overlap).collect()
        };
        for (fault, axis) in [(GraspFault::OffCentre, 1), (GraspFault::Shallow, 2)] {
            let wide = overlaps(FaultRanges::WIDE, fault, axis);
            assert!(wide.len() > 4, "{fault:?}: {wide:?}");
            // Small rotations of the gripper add up to 1.5 mm.
            let [low, high] = FaultRanges::WIDE.overlap_m.unwrap();
            let near = low - 1.5e-3..high + 1.5e-3;
            assert!(wide.iter().all(|m| near.contains(m)), "{fault:?}: {wide:?}");
            let collected = overlaps(FaultRanges::COLLECTED, fault, axis);
            assert!(
                collected.iter().any(|m| !near.contains(m)),
                "{fault:?}: {collected:?}"
            );
        }
    }
}
