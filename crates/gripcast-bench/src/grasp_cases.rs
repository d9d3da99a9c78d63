//! Grasps with known outcomes.

use glam::{DQuat, DVec3};
use gripcast_base::error::Result;
use gripcast_geometry::{Aabb, Pose, TriangleMesh, builtin};
use gripcast_sim::fem::GelResolution;
use gripcast_sim::grasp::{GraspOutcome, GraspSettings, Placement, Scene};
use serde::Serialize;

/// Difficulty of a grasp for the solver.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum CaseClass {
    /// Both gels meet the object squarely.
    Easy,
    /// The object is pushed, rotated, tilted, touched at edges, or slides out.
    Hard,
}

impl CaseClass {
    /// Returns its name in figures.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Easy => "easy",
            Self::Hard => "hard",
        }
    }
}

/// The object of a case.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum CaseObject {
    /// A built-in mesh.
    Builtin(&'static str),
    /// A mesh file of the folder of shared data (not part of the project).
    File {
        /// Path within that folder.
        path: &'static str,
        /// Length of a unit of the file, m.
        unit_m: f64,
    },
}

/// EGAD's B1, scaled from 70 to 42 mm to fit between the fingers in most poses.
const B1: CaseObject = CaseObject::File {
    path: "data/egad_eval/B1.obj",
    unit_m: 0.6e-3,
};

impl CaseObject {
    /// Loads the mesh, m. `shared` loads a file of the shared data with a unit in m, or returns
    /// none.
    pub(crate) fn load(
        &self,
        shared: &dyn Fn(&str, f64) -> Result<Option<TriangleMesh>>,
    ) -> Result<Option<TriangleMesh>> {
        match self {
            Self::Builtin(name) => builtin(name).map(Some),
            Self::File { path, unit_m } => shared(path, *unit_m),
        }
    }
}

/// A test case.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct GraspCase {
    /// Unique name, fit for a JSON key.
    pub(crate) name: &'static str,
    /// Difficulty.
    pub(crate) class: CaseClass,
    /// Object.
    pub(crate) object: CaseObject,
    /// Rotation of the object on the ground: w, x, y, z.
    pub(crate) q_wxyz: [f64; 4],
    /// Gripper placement.
    pub(crate) placement: Placement,
    /// Outcome of the paper's protocol at 40 N on the coarse gel, solved to 1e-6 m/s.
    pub(crate) expected_coarse: GraspOutcome,
    /// The same on the default and the fine gel.
    pub(crate) expected: GraspOutcome,
}

/// Mass of the object in every case, kg.
const MASS_KG: f64 = 0.06;
/// Friction coefficient of every case.
const FRICTION: f64 = 0.4;
const UPRIGHT: [f64; 4] = [1.0, 0.0, 0.0, 0.0];

impl GraspCase {
    fn easy(name: &'static str, object: CaseObject) -> Self {
        Self {
            name,
            class: CaseClass::Easy,
            object,
            q_wxyz: UPRIGHT,
            placement: Placement::default(),
            expected_coarse: GraspOutcome::Success,
            expected: GraspOutcome::Success,
        }
    }

    fn hard(name: &'static str, object: CaseObject, placement: Placement) -> Self {
        Self {
            class: CaseClass::Hard,
            placement,
            ..Self::easy(name, object)
        }
    }

    fn lying(self, q_wxyz: [f64; 4]) -> Self {
        Self { q_wxyz, ..self }
    }

    fn expecting(self, expected: GraspOutcome) -> Self {
        Self {
            expected_coarse: expected,
            expected,
            ..self
        }
    }

    /// For a grasp close to the limit, whose outcome depends on the gel mesh.
    fn expecting_on_finer_gels(self, expected: GraspOutcome) -> Self {
        Self { expected, ..self }
    }

    /// Returns the expected outcome on a gel mesh.
    pub(crate) fn expected_on(&self, resolution: GelResolution) -> GraspOutcome {
        match resolution {
            GelResolution::Coarse => self.expected_coarse,
            GelResolution::Default | GelResolution::Fine => self.expected,
        }
    }

    /// Returns the pose of the object on the ground.
    pub(crate) fn t_world_object(&self, mesh: &TriangleMesh) -> Pose {
        let [w, x, y, z] = self.q_wxyz;
        let rotated = Pose::from_rotation(DQuat::from_xyzw(x, y, z, w));
        let points = mesh.all_corners().flatten();
        let lowest = Aabb::from_points(points.map(|v| rotated.transform_point(v)))
            .min
            .z;
        Pose::new(rotated.rotation, DVec3::Z * -lowest)
    }

    /// Returns the scene with `mesh`, the loaded object of the case.
    pub(crate) fn scene(&self, mesh: TriangleMesh, settings: &GraspSettings) -> Result<Scene> {
        let t_world_object = self.t_world_object(&mesh);
        let placed = self.placement.place(&mesh, &t_world_object)?;
        Ok(Scene {
            mesh,
            mass_kg: MASS_KG,
            friction: FRICTION,
            t_world_object,
            t_world_gripper: placed.t_world_gripper,
            opening_m: placed.opening_m,
            gel: settings.gel()?,
        })
    }
}

fn yaw(degrees: f64) -> Placement {
    Placement {
        yaw_rad: degrees.to_radians(),
        ..Placement::default()
    }
}

fn across(offset_m: f64) -> Placement {
    Placement {
        offset_m: [0.0, offset_m],
        ..Placement::default()
    }
}

/// An offset along the closing direction: one finger arrives first and pushes.
fn pushed(offset_m: f64, opening_m: f64) -> Placement {
    Placement {
        offset_m: [offset_m, 0.0],
        opening_m: Some(opening_m),
        ..Placement::default()
    }
}

/// Returns all cases, easy ones first.
pub(crate) fn cases() -> Vec<GraspCase> {
    use CaseObject::Builtin;
    use GraspOutcome::{Eject, Slip};
    let easy = GraspCase::easy;
    let hard = GraspCase::hard;
    let tilted = Placement {
        roll_rad: 15f64.to_radians(),
        ..across(0.014)
    };
    let high = Placement {
        height_m: Some(0.055),
        ..Placement::default()
    };
    vec![
        easy("box", Builtin("box")),
        easy("sphere", Builtin("sphere")),
        easy("mug", Builtin("mug")),
        easy("b1", B1).lying([0.707218, -0.706996, -0.000014, -0.000014]),
        hard("sphere_off_14mm", Builtin("sphere"), across(0.014)).expecting_on_finer_gels(Slip),
        hard("sphere_off_18mm", Builtin("sphere"), across(0.018)).expecting(Eject),
        hard("box_turned_10deg", Builtin("box"), yaw(10.0)),
        hard("box_turned_20deg", Builtin("box"), yaw(20.0)),
        hard("box_turned_30deg", Builtin("box"), yaw(30.0)),
        hard("box_pushed", Builtin("box"), pushed(0.006, 0.06)),
        hard("wedge_tilted", Builtin("wedge"), tilted),
        hard("mug_beside_handle", Builtin("mug"), yaw(90.0)),
        hard("mug_wall_and_handle", Builtin("mug"), pushed(0.015, 0.08)),
        hard("bar_edge", Builtin("bar"), yaw(45.0)),
        hard("spike_top", Builtin("spike"), high).expecting(Slip),
        hard("spike_off_12mm", Builtin("spike"), across(0.012)).expecting(Eject),
        hard("b1_slips", B1, Placement::default())
            .lying([0.882025, -0.160095, 0.079146, 0.436047])
            .expecting(Slip),
        hard("b1_pushed", B1, Placement::default())
            .lying([0.457807, -0.636000, 0.504186, 0.362924]),
        hard("b1_turned", B1, Placement::default())
            .lying([0.529796, -0.571252, -0.459640, -0.426284]),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_sim::grasp::simulate;

    fn without_shared(_: &str, _: f64) -> Result<Option<TriangleMesh>> {
        Ok(None)
    }

    #[test]
    fn case_names_are_unique_in_both_classes() {
        let all = cases();
        let mut names: Vec<&str> = all.iter().map(|case| case.name).collect();
        names.sort_unstable();
        names.dedup();
        assert_eq!(names.len(), all.len());
        let hard = all.iter().filter(|case| case.class == CaseClass::Hard);
        assert!(hard.count() >= 8);
        assert!(all.iter().all(|case| {
            let norm: f64 = case.q_wxyz.iter().map(|q| q * q).sum();
            (norm - 1.0).abs() < 1e-5
        }));
    }

    #[test]
    fn builtin_cases_start() {
        let mut settings = GraspSettings {
            resolution: GelResolution::Coarse,
            ..GraspSettings::default()
        };
        settings.solver.max_grasp_iterations = 1;
        for case in cases() {
            let Some(mesh) = case.object.load(&without_shared).unwrap() else {
                continue;
            };
            let scene = case.scene(mesh, &settings).unwrap();
            let result = simulate(&scene, &settings.protocol, &settings.solver).unwrap();
            assert_eq!(result.outcome, GraspOutcome::NotConverged, "{}", case.name);
        }
    }

    #[test]
    fn sphere_gripped_off_centre_is_ejected() {
        let mut settings = GraspSettings {
            resolution: GelResolution::Coarse,
            ..GraspSettings::default()
        };
        settings.protocol.adjust_s = 0.1;
        settings.protocol.lift_m = 0.005;
        let all = cases();
        let case = all.iter().find(|case| case.name == "sphere_off_18mm");
        let case = case.unwrap();
        let mesh = case.object.load(&without_shared).unwrap().unwrap();
        let scene = case.scene(mesh, &settings).unwrap();
        let result = simulate(&scene, &settings.protocol, &settings.solver).unwrap();
        assert_eq!(result.outcome, case.expected_coarse);
    }
}
