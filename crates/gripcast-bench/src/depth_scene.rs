//! Timing of the tactile depth of a bumpy ball of 100k triangles, by z-buffer and by ray casting.

use std::time::Instant;

use glam::DQuat;
use gripcast_base::error::Result;
use gripcast_geometry::{MeshQuery, Pose, TriangleMesh};
use gripcast_tactile::rays::{bumpy_ball, depth_by_rays};
use gripcast_tactile::{
    PressDepth, Rasteriser, SceneRenderer, SensorGeometry, TactileScene, object_depth,
};

use crate::timing::{Timing, ms_since, timed};

/// Everything in front of the sensor, m.
const EVERYTHING_M: [f64; 2] = [-0.01, 1.0];

/// Timings of [`DepthScene::measure`], one thread.
#[derive(Clone, Copy, Debug)]
pub(crate) struct DepthTiming {
    /// Triangles of the object.
    pub(crate) triangles: usize,
    /// Depth of the press by the z-buffer.
    pub(crate) depth_ms: Timing,
    /// The visible surface over 80 × 60 mm, which holds the whole object, by the z-buffer.
    pub(crate) whole_object_ms: Timing,
    /// Depth of the press by ray casting, without building the tree.
    pub(crate) rays_ms: Timing,
    /// Building the tree for ray casting.
    pub(crate) tree_ms: f64,
    /// Largest difference between the press by z-buffer and by rays, m.
    pub(crate) largest_difference_m: f64,
}

/// A bumpy ball of 25 mm, pressed 1 mm into the gel of a GelSight Mini.
pub(crate) struct DepthScene {
    object: TriangleMesh,
    t_sensor_object: Pose,
    pub(crate) grid: SensorGeometry,
}

impl DepthScene {
    /// Creates the scene with 99 904 triangles on the grid of a sensor.
    pub(crate) fn new(grid: SensorGeometry) -> Self {
        let turn = DQuat::from_rotation_x(1.1) * DQuat::from_rotation_y(0.4);
        Self {
            object: bumpy_ball(0.025, 5e-4, 224, 224),
            t_sensor_object: Pose::from_rotation(turn),
            grid,
        }
    }

    fn pressed(&self) -> Result<TactileScene<'_>> {
        TactileScene::pressed(&self.object, &self.t_sensor_object, 1e-3, &self.grid)
    }

    /// Computes the depth of the press by z-buffer.
    pub(crate) fn depth(&self) -> Result<PressDepth> {
        let mut rasteriser = Rasteriser::new();
        Ok(object_depth(&self.pressed()?, &self.grid, &mut rasteriser))
    }

    /// Times complete images of a renderer.
    pub(crate) fn measure_images(
        &self,
        renderer: &mut dyn SceneRenderer,
        runs: usize,
    ) -> Result<Timing> {
        let scene = self.pressed()?;
        renderer.render(&scene, Some(0))?;
        Ok(timed(runs, || renderer.render(&scene, Some(1)).is_ok()))
    }

    /// Times each method.
    pub(crate) fn measure(&self, runs: usize) -> Result<DepthTiming> {
        let scene = self.pressed()?;
        let mut rasteriser = Rasteriser::new();
        let wide = SensorGeometry {
            pixel_m: 2.5e-4,
            ..self.grid
        };
        let t_sensor_object = &scene.t_sensor_object;
        let whole_object_ms = timed(runs, || {
            let seen = rasteriser.nearest(scene.object, t_sensor_object, &wide, EVERYTHING_M);
            seen.len()
        });
        let depth_ms = timed(runs, || object_depth(&scene, &self.grid, &mut rasteriser));
        let started = Instant::now();
        let query = MeshQuery::new(&scene.object.transformed(t_sensor_object));
        let tree_ms = ms_since(started);
        let rays_ms = timed(runs, || depth_by_rays(&scene, &query, &self.grid));
        let z_buffer = object_depth(&scene, &self.grid, &mut rasteriser);
        let rays = depth_by_rays(&scene, &query, &self.grid);
        let differences = z_buffer.depth_m.iter().zip(&rays.depth_m);
        Ok(DepthTiming {
            triangles: self.object.triangles.len(),
            depth_ms,
            whole_object_ms,
            rays_ms,
            tree_ms,
            largest_difference_m: differences
                .map(|(a, b)| f64::from((a - b).abs()))
                .fold(0.0, f64::max),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_tactile::{ObjectDepthRenderer, SensorProfile};

    #[test]
    fn z_buffer_and_rays_agree() {
        let profile = SensorProfile::gelsight_mini().unwrap();
        let whole = DepthScene::new(profile.geometry);
        assert_eq!(whole.object.triangles.len(), 99_904);
        let scene = DepthScene {
            object: bumpy_ball(0.025, 5e-4, 100, 100),
            ..whole
        };
        let timing = scene.measure(1).unwrap();
        assert!(timing.largest_difference_m < 1e-7, "{timing:?}");
        let mut renderer = ObjectDepthRenderer::new(&profile).unwrap();
        let images = scene.measure_images(&mut renderer, 1).unwrap();
        assert!(images.min > 0.0);
    }
}
