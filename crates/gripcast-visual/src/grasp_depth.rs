//! Exact depth images of the wrist camera in the lift.

use gripcast_base::error::Result;
use gripcast_geometry::{Pose, TriangleMesh};

use super::camera::Camera;
use super::env_map::EnvMap;
use super::grasp_scene::add_gripper;
use super::grasp_state::GraspState;
use super::model::Model;
use super::renderer::Renderer;
use super::scene::Scene;
use super::shading::{Projection, shaded_mesh};

/// Renders what the wrist camera sees while the closed gripper and the object move: the camera moves
/// with the gripper, so that one image of the gripper and one search tree of the object serve all
/// images.
pub struct GraspDepth {
    camera: Camera,
    t_gripper_camera: Pose,
    /// Depths of the gripper, m; 0 elsewhere.
    gripper_m: Vec<f32>,
    object: Renderer,
}

impl GraspDepth {
    /// Prepares the images of a camera that is fixed to the gripper, and whose pose is that in
    /// `state`.
    ///
    /// # Errors
    /// `Input` for an invalid camera or shape, or an opening out of range.
    pub fn new(object: &TriangleMesh, state: &GraspState, camera: Camera) -> Result<Self> {
        let nothing = || Scene::empty(EnvMap::uniform([1.0; 3]), camera);
        let mut gripper = nothing();
        add_gripper(&mut gripper, state, [0.5; 3], false)?;
        let mut alone = nothing();
        let object = Model::plain(shaded_mesh(object, 0.0, Projection::None, 0));
        object.add_to(&mut alone, &Pose::IDENTITY);
        Ok(Self {
            gripper_m: Renderer::new(&gripper)?.depth(&camera)?,
            object: Renderer::new(&alone)?,
            t_gripper_camera: state.t_world_gripper.inverse() * camera.t_world_camera,
            camera,
        })
    }

    /// The camera with the gripper at a pose.
    pub fn camera(&self, t_world_gripper: &Pose) -> Camera {
        Camera {
            t_world_camera: *t_world_gripper * self.t_gripper_camera,
            ..self.camera
        }
    }

    /// Depths of the first surface along the optical axis at the pixel centres, m, row-major: the
    /// gripper, the object, the table. 0 if there is none.
    ///
    /// # Errors
    /// `Input` for a pose that is not finite.
    pub fn render(&self, t_world_gripper: &Pose, t_world_object: &Pose) -> Result<Vec<f32>> {
        let camera = self.camera(t_world_gripper);
        let from_object = Camera {
            t_world_camera: t_world_object.inverse() * camera.t_world_camera,
            ..camera
        };
        let mut depths_m = self.object.depth(&from_object)?;
        let forward = camera.t_world_camera.rotation_matrix().z_axis;
        for (index, (depth_m, gripper_m)) in depths_m.iter_mut().zip(&self.gripper_m).enumerate() {
            let (column, row) = (index % camera.width, index / camera.width);
            let [origin, direction] = camera.ray(column as f64, row as f64);
            let table_m = -origin.z / direction.z * direction.dot(forward);
            let others = [*gripper_m, table_m as f32].into_iter();
            for other_m in others.filter(|m| m.is_finite() && *m > 0.0) {
                if *depth_m == 0.0 || other_m < *depth_m {
                    *depth_m = other_m;
                }
            }
        }
        Ok(depths_m)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{View, VisualRandomisation, grasp_scene};
    use glam::DVec3;
    use gripcast_geometry::builtin;

    #[test]
    fn depths_are_those_of_the_composed_scene() {
        let mesh = builtin("box").unwrap();
        let conditions = VisualRandomisation::default().sample(3);
        let raised = |z: f64| Pose::from_translation(DVec3::Z * z);
        let state = |lift: f64, drop: f64| GraspState {
            t_world_object: raised(0.05 + lift - drop),
            t_world_gripper: raised(0.07 + lift)
                * Pose::from_rotation(glam::DQuat::from_rotation_x(std::f64::consts::PI)),
            opening_m: 0.06,
            gels: None,
        };
        let before = state(0.0, 0.0);
        let camera = View::EyeInHand([80, 60]).camera(&before, &conditions);
        let rendered = GraspDepth::new(&mesh, &before, camera).unwrap();
        for (lift, drop) in [(0.0, 0.0), (0.01, 0.004)] {
            let now = state(lift, drop);
            let plain = Model::plain(shaded_mesh(&mesh, 0.0, Projection::None, 0));
            let view = View::EyeInHand([80, 60]);
            let scene = grasp_scene(&plain, &now, &conditions, view).unwrap();
            let expected = Renderer::new(&scene).unwrap().depth(&scene.camera).unwrap();
            let found = rendered
                .render(&now.t_world_gripper, &now.t_world_object)
                .unwrap();
            let differs = |(a, b): (&f32, &f32)| (a - b).abs() > 1e-4 && *b > 0.0;
            let different = found.iter().zip(&expected).filter(|pair| differs(*pair));
            // Rays at edges may hit either side.
            assert!(different.count() < 20);
            assert!(found.iter().all(|depth| *depth > 0.0));
        }
    }
}
