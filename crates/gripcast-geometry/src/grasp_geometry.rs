//! Where the grasped object begins and ends around the gels.

use glam::DVec3;
use serde::{Deserialize, Serialize};

use crate::{MassProperties, Pose, TriangleMesh};
use gripcast_base::error::Result;

/// Half the height of a gel along the approach, m.
const GEL_HALF_HEIGHT_M: f64 = 0.0125;

/// Extents of a grasped object in the gripper frame (x from the left to the right finger, z along
/// the approach, origin between the gels), m.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct GraspGeometry {
    /// Bounds along the closing direction.
    pub x_m: [f64; 2],
    /// Bounds across the fingers.
    pub y_m: [f64; 2],
    /// Bounds along the approach; the camera sees the first.
    pub z_m: [f64; 2],
    /// Bounds across the fingers of the part at the height of the gels; zeros if there is none.
    pub y_at_gels_m: [f64; 2],
    /// y and z of the centre of volume.
    pub centre_m: [f64; 2],
}

impl GraspGeometry {
    /// Number of values.
    pub const LEN: usize = 10;

    /// Measures an object; `t_gripper_object` maps its coordinates into the gripper frame.
    ///
    /// # Errors
    /// `Input` for a mesh without volume.
    pub fn new(mesh: &TriangleMesh, t_gripper_object: &Pose) -> Result<Self> {
        let centre = MassProperties::from_mesh(mesh)?.center_of_mass_m;
        let centre = t_gripper_object.transform_point(centre);
        let mesh = mesh.transformed(t_gripper_object);
        let bounds = mesh.bounds();
        let mut at_gels: Option<[f64; 2]> = None;
        for corners in mesh.all_corners() {
            for y in slab(&corners) {
                let [low, high] = at_gels.unwrap_or([y; 2]);
                at_gels = Some([low.min(y), high.max(y)]);
            }
        }
        Ok(Self {
            x_m: [bounds.min.x, bounds.max.x],
            y_m: [bounds.min.y, bounds.max.y],
            z_m: [bounds.min.z, bounds.max.z],
            y_at_gels_m: at_gels.unwrap_or_default(),
            centre_m: [centre.y, centre.z],
        })
    }

    /// All values in the order of the fields.
    pub fn to_array(&self) -> [f64; Self::LEN] {
        let [[a, b], [c, d], [e, f], [g, h], [i, j]] = [
            self.x_m,
            self.y_m,
            self.z_m,
            self.y_at_gels_m,
            self.centre_m,
        ];
        [a, b, c, d, e, f, g, h, i, j]
    }

    /// Geometry of the values of [`GraspGeometry::to_array`].
    pub fn from_array([a, b, c, d, e, f, g, h, i, j]: [f64; Self::LEN]) -> Self {
        Self {
            x_m: [a, b],
            y_m: [c, d],
            z_m: [e, f],
            y_at_gels_m: [g, h],
            centre_m: [i, j],
        }
    }

    /// The object mirrored between the fingers.
    #[must_use]
    pub fn mirrored(self) -> Self {
        let [low, high] = self.x_m;
        Self {
            x_m: [-high, -low],
            ..self
        }
    }

    /// Corners of the face of its box that the camera sees, in the gripper frame, in order.
    pub fn near_face(&self) -> [DVec3; 4] {
        let [left, right] = self.x_m;
        let [above, below] = self.y_m;
        [[left, above], [right, above], [right, below], [left, below]]
            .map(|[x, y]| DVec3::new(x, y, self.z_m[0]))
    }
}

/// y of the corners of a triangle cut to the height of the gels.
fn slab(corners: &[DVec3; 3]) -> Vec<f64> {
    let mut polygon = corners.to_vec();
    for sign in [1.0, -1.0] {
        let inside = |p: &DVec3| GEL_HALF_HEIGHT_M - sign * p.z;
        let count = polygon.len();
        let mut cut = Vec::with_capacity(count + 1);
        for i in 0..count {
            let (a, b) = (polygon[i], polygon[(i + 1) % count]);
            let (da, db) = (inside(&a), inside(&b));
            if da >= 0.0 {
                cut.push(a);
            }
            if (da > 0.0 && db < 0.0) || (da < 0.0 && db > 0.0) {
                cut.push(a.lerp(b, da / (da - db)));
            }
        }
        polygon = cut;
    }
    polygon.iter().map(|p| p.y).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{PrepareOptions, builtin, prepare};

    #[test]
    fn box_beside_the_gels_has_its_bounds() {
        let mesh = prepare(&builtin("box").unwrap(), &PrepareOptions::default());
        let mesh = mesh.unwrap().mesh;
        let centre = MassProperties::from_mesh(&mesh).unwrap().center_of_mass_m;
        // The box is 40 × 40 × 60 mm.
        let at = |x, y, z| Pose::from_translation(DVec3::new(x, y, z) - centre);
        let found = GraspGeometry::new(&mesh, &at(0.001, 0.01, 0.02)).unwrap();
        let expected = GraspGeometry {
            x_m: [-0.019, 0.021],
            y_m: [-0.01, 0.03],
            z_m: [-0.01, 0.05],
            y_at_gels_m: [-0.01, 0.03],
            centre_m: [0.01, 0.02],
        };
        for (found, expected) in found.to_array().iter().zip(expected.to_array()) {
            assert!((found - expected).abs() < 1e-9, "{found} {expected}");
        }
        let beyond = GraspGeometry::new(&mesh, &at(0.0, 0.0, 0.1)).unwrap();
        assert_eq!(beyond.y_at_gels_m, [0.0; 2]);
        let mirrored = found.mirrored();
        assert!((mirrored.x_m[0] + 0.021).abs() < 1e-9 && mirrored.y_m == found.y_m);
        assert_eq!(GraspGeometry::from_array(found.to_array()), found);
    }

    #[test]
    fn cone_is_cut_at_the_height_of_the_gels() {
        let corners = [
            DVec3::new(0.0, -0.1, 0.1),
            DVec3::new(0.0, 0.1, 0.1),
            DVec3::new(0.0, 0.0, -0.1),
        ];
        let ys = slab(&corners);
        let widest = ys.iter().fold(0.0_f64, |max, y| max.max(y.abs()));
        // Its width grows from 0 to 0.1 m over 0.2 m.
        assert!((widest - 0.05 * (0.1 + GEL_HALF_HEIGHT_M) / 0.1).abs() < 1e-12);
    }
}
