//! Mass properties of a solid: volume, centre of mass and second moment at unit density.

use glam::{DMat3, DVec3};

use super::aabb::Aabb;
use super::mesh::TriangleMesh;
use super::solid::Solid;
use gripcast_base::error::{Error, Result};
use gripcast_base::number::NumberRange;

/// Masses that a parallel gripper lifts; more usually means grams instead of kilograms.
const MASS_KG: NumberRange = NumberRange::above(0.0, 10.0).unit("kg");
/// Osmium, the densest solid.
const MAX_DENSITY_KG_M3: f64 = 22_600.0;

/// Checks the mass of an object with these bounds. An object may weigh more than its own volume of
/// osmium, since a mesh of a cup has no content, but not more than its bounding box of it.
///
/// # Errors
/// `Input` for a mass that is not above 0 and at most 10 kg, or that is impossible for an object of
/// that size.
pub fn check_mass(mass_kg: f64, bounds: &Aabb) -> Result<()> {
    let remedy = "give the mass in kilograms (70 g are 0.070) and check the unit of the mesh";
    MASS_KG
        .check(mass_kg)
        .map_err(|e| Error::input(format!("`mass_kg`: {}", e.what())).remedy(remedy))?;
    let size = bounds.extent();
    let max = MAX_DENSITY_KG_M3 * size.element_product();
    if mass_kg <= max {
        return Ok(());
    }
    let [x, y, z] = (1e3 * size).to_array();
    Err(Error::input(format!(
        "`mass_kg`: no object of {x:.1} × {y:.1} × {z:.1} mm weighs {mass_kg} kg: osmium of that \
         size weighs {max:.2} kg"
    ))
    .remedy(remedy))
}

/// Integrals over the solid inside a surface, at unit density.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MassProperties {
    /// Volume, m³.
    pub volume_m3: f64,
    /// Centre of mass in the frame of the mesh, m.
    pub center_of_mass_m: DVec3,
    /// ∫ x xᵀ dV about the centre of mass, axes of the mesh, m⁵.
    pub second_moment_m5: DMat3,
}

/// Integrals over a solid at unit density, about a reference point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Moments {
    /// ∫ dV, m³.
    pub(super) volume: f64,
    /// ∫ x dV, m⁴.
    pub(super) first: DVec3,
    /// ∫ x xᵀ dV, m⁵.
    pub(super) second: DMat3,
}

impl Moments {
    /// Those of nothing.
    pub(super) const ZERO: Self = Self {
        volume: 0.0,
        first: DVec3::ZERO,
        second: DMat3::ZERO,
    };

    /// Signed sum of the tetrahedra between the reference point and each triangle (corners in m):
    /// exact for a closed surface, where it counts each point as often as its winding number says.
    ///
    /// For a tetrahedron with one corner in the origin and edges a, b, c: `V = a·(b×c)/6`,
    /// `∫x = V s/4`, `∫x xᵀ = V (a aᵀ + b bᵀ + c cᵀ + s sᵀ)/20`, `s = a + b + c`.
    pub(super) fn of_surface(
        triangles: impl Iterator<Item = [DVec3; 3]>,
        reference: DVec3,
    ) -> Self {
        let mut all = Self::ZERO;
        for corners in triangles {
            let [a, b, c] = corners.map(|corner| corner - reference);
            let v = a.dot(b.cross(c)) / 6.0;
            let s = a + b + c;
            all.volume += v;
            all.first += s * (v / 4.0);
            all.second += (outer(a) + outer(b) + outer(c) + outer(s)) * (v / 20.0);
        }
        all
    }

    /// Adds `factor` times other moments about the same point.
    pub(super) fn add(&mut self, other: &Self, factor: f64) {
        self.volume += factor * other.volume;
        self.first += other.first * factor;
        self.second += other.second * factor;
    }

    /// Mass properties of the solid.
    ///
    /// # Errors
    /// `Input` if the volume is not positive.
    pub(super) fn properties(&self, reference: DVec3) -> Result<MassProperties> {
        let volume = self.volume;
        if !(volume > 0.0 && volume.is_finite()) {
            return Err(Error::input(format!(
                "the mesh must enclose a positive volume, found {volume:e} m³"
            ))
            .remedy("close its holes and orient its triangles outwards"));
        }
        let center = self.first / volume;
        Ok(MassProperties {
            volume_m3: volume,
            center_of_mass_m: reference + center,
            second_moment_m5: self.second - outer(center) * volume,
        })
    }
}

impl MassProperties {
    /// Integrates over the inside of a surface as [`Solid::of`] finds it.
    ///
    /// # Errors
    /// `Input` if the surface has no inside: it is flat or inverted.
    pub fn from_mesh(mesh: &TriangleMesh) -> Result<Self> {
        Ok(Solid::of(mesh)?.properties)
    }

    /// Integrates over the solid bounded by `mesh`, which must be closed and free of overlaps, with
    /// triangles counter-clockwise seen from outside, for instance a convex hull; exact.
    ///
    /// # Errors
    /// `Input` if the volume is not positive: the mesh is flat or inverted.
    pub fn of_closed(mesh: &TriangleMesh) -> Result<Self> {
        // A reference point near the solid reduces cancellation.
        let reference = mesh.bounds().center();
        Moments::of_surface(mesh.all_corners(), reference).properties(reference)
    }

    /// Inertia tensor about the centre of mass at unit density, m⁵:
    /// `tr(S) I − S` with the second moment S.
    pub fn inertia_m5(&self) -> DMat3 {
        let s = self.second_moment_m5;
        let trace = s.x_axis.x + s.y_axis.y + s.z_axis.z;
        DMat3::from_diagonal(DVec3::splat(trace)) - s
    }
}

/// v vᵀ.
pub(super) fn outer(v: DVec3) -> DMat3 {
    DMat3::from_cols(v * v.x, v * v.y, v * v.z)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::builtin::uv_sphere;
    use crate::{Pose, builtin};
    use glam::DQuat;
    use std::f64::consts::PI;

    #[test]
    fn grams_and_millimetres_are_refused() {
        let ball = uv_sphere(0.03, 16, 8).bounds();
        assert!(check_mass(0.07, &ball).is_ok());
        // A cup of thin walls is heavier than its walls of any material, not than its bounds.
        assert!(check_mass(0.5, &ball).is_ok());
        for (mass_kg, words) in [
            (70.0, "at most 10 kg"),
            (7.0, "60.0 × 60.0 × 60.0 mm"),
            (0.0, "above 0"),
            (f64::NAN, "NaN"),
        ] {
            let error = check_mass(mass_kg, &ball).unwrap_err().to_string();
            assert!(error.contains(words) && error.contains("0.070"), "{error}");
        }
    }

    fn assert_close(found: f64, expected: f64, relative: f64) {
        assert!(
            (found - expected).abs() <= relative * expected.abs(),
            "found {found:e}, expected {expected:e}"
        );
    }

    fn largest_entry(m: DMat3) -> f64 {
        m.to_cols_array().iter().fold(0.0, |a, v| v.abs().max(a))
    }

    #[test]
    fn box_matches_its_closed_form() {
        let mesh = builtin("box").unwrap();
        let found = MassProperties::from_mesh(&mesh).unwrap();
        let (a, b, c): (f64, f64, f64) = (0.04, 0.04, 0.06);
        let volume = a * b * c;
        assert_close(found.volume_m3, volume, 1e-12);
        assert!(found.center_of_mass_m.length() < 1e-15);
        let expected = DVec3::new(a * a, b * b, c * c) * (volume / 12.0);
        let difference = found.second_moment_m5 - DMat3::from_diagonal(expected);
        assert!(largest_entry(difference) < 1e-12 * expected.z);
        let inertia = found.inertia_m5();
        assert_close(inertia.z_axis.z, volume * (a * a + b * b) / 12.0, 1e-12);
        assert_close(inertia.x_axis.x, volume * (b * b + c * c) / 12.0, 1e-12);
    }

    #[test]
    fn corner_tetrahedron_matches_its_closed_form() {
        let mesh = TriangleMesh {
            vertices: vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z],
            triangles: vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]],
        };
        let found = MassProperties::from_mesh(&mesh).unwrap();
        assert_close(found.volume_m3, 1.0 / 6.0, 1e-14);
        assert!(found.center_of_mass_m.distance(DVec3::splat(0.25)) < 1e-15);
        // ∫x² = 1/60 and ∫xy = 1/120 about the corner, less V/16 each.
        let s = found.second_moment_m5;
        assert_close(s.x_axis.x, 1.0 / 60.0 - 1.0 / 96.0, 1e-12);
        assert_close(s.x_axis.y, 1.0 / 120.0 - 1.0 / 96.0, 1e-12);
    }

    #[test]
    fn sphere_error_is_quadratic_in_face_size() {
        let r: f64 = 0.025;
        let exact = 4.0 / 3.0 * PI * r.powi(3);
        let error = |segments, stacks| {
            let mesh = uv_sphere(r, segments, stacks);
            1.0 - MassProperties::from_mesh(&mesh).unwrap().volume_m3 / exact
        };
        let (coarse, fine) = (error(36, 19), error(72, 38));
        assert!(coarse > 0.0 && coarse < 0.015, "{coarse}");
        assert!((coarse / fine - 4.0).abs() < 0.1, "{coarse} {fine}");
        let mesh = uv_sphere(r, 144, 76);
        let found = MassProperties::from_mesh(&mesh).unwrap();
        assert_close(found.inertia_m5().x_axis.x, exact * 0.4 * r * r, 3e-3);
    }

    #[test]
    fn integrals_transform_with_the_mesh() {
        let mesh = builtin("box").unwrap();
        let at_rest = MassProperties::from_mesh(&mesh).unwrap();
        let pose = Pose::new(
            DQuat::from_xyzw(0.1, 0.2, -0.5, 0.7),
            DVec3::new(0.3, -2.0, 0.7),
        );
        let moved = MassProperties::from_mesh(&mesh.transformed(&pose)).unwrap();
        assert_close(moved.volume_m3, at_rest.volume_m3, 1e-12);
        assert!(moved.center_of_mass_m.distance(pose.translation_m) < 1e-14);
        let r = pose.rotation_matrix();
        let expected = r * at_rest.second_moment_m5 * r.transpose();
        let difference = largest_entry(moved.second_moment_m5 - expected);
        assert!(difference < 1e-11 * largest_entry(expected), "{difference}");
    }

    #[test]
    fn two_components_add_up() {
        let shift = DVec3::X * 0.1;
        let one = builtin("box").unwrap();
        let single = MassProperties::from_mesh(&one).unwrap();
        let apart = |s: f64| one.transformed(&Pose::from_translation(shift * s));
        let both = MassProperties::from_mesh(&apart(1.0).joined(&apart(-1.0))).unwrap();
        assert_close(both.volume_m3, 2.0 * single.volume_m3, 1e-12);
        assert!(both.center_of_mass_m.length() < 1e-15);
        let expected = 2.0 * (single.second_moment_m5.x_axis.x + single.volume_m3 * 0.01);
        assert_close(both.second_moment_m5.x_axis.x, expected, 1e-12);
    }

    #[test]
    fn inverted_and_empty_meshes_are_rejected() {
        let mut mesh = builtin("box").unwrap();
        for triangle in &mut mesh.triangles {
            triangle.swap(0, 1);
        }
        let text = MassProperties::from_mesh(&mesh).unwrap_err().to_string();
        assert!(text.contains("positive volume"), "{text}");
        assert!(MassProperties::from_mesh(&TriangleMesh::default()).is_err());
    }
}
