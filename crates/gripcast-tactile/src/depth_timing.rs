//! Times of the tactile depth of a bumpy ball of 100k triangles, by z-buffer and by rays.

use std::f64::consts::{PI, TAU};
use std::time::Instant;

use glam::{DQuat, DVec3};
use serde::Serialize;

use super::depth::{IMAGE_PLANE_M, depth_below, object_depth};
use super::press_depth::{PressDepth, SensorGeometry};
use super::rasteriser::Rasteriser;
use super::scene::TactileScene;
use super::scene_renderer::SceneRenderer;
use gripcast_base::error::Result;
use gripcast_geometry::{MeshQuery, Pose, TriangleMesh};

/// Shortest and median wall time, ms.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct DepthMs {
    /// Shortest.
    pub min: f64,
    /// Median, of two the lower.
    pub median: f64,
}

/// What [`DepthLoad::measure`] found, one thread.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct DepthTiming {
    /// Triangles of the object.
    pub triangles: usize,
    /// Columns and rows.
    pub pixels: [usize; 2],
    /// Depth of the press by the z-buffer.
    pub depth_ms: DepthMs,
    /// The whole visible surface over the gel, not only what is pressed in, by the z-buffer.
    pub surface_ms: DepthMs,
    /// The same over 80 × 60 mm, which holds the whole object.
    pub whole_object_ms: DepthMs,
    /// Depth of the press by rays, with the tree at hand.
    pub rays_ms: DepthMs,
    /// The visible surface by rays.
    pub surface_rays_ms: DepthMs,
    /// Building the tree that the rays need.
    pub tree_ms: f64,
    /// Largest difference between the press by z-buffer and by rays, m.
    pub largest_difference_m: f64,
}

/// A ball of 25 mm with bumps, pressed 1 mm into a Mini's gel.
#[derive(Clone, Debug)]
pub struct DepthLoad {
    object: TriangleMesh,
    t_sensor_object: Pose,
    grid: SensorGeometry,
}

impl Default for DepthLoad {
    /// On 320 × 240 pixels of 0.0634 mm.
    fn default() -> Self {
        Self::on(SensorGeometry {
            width: 320,
            height: 240,
            pixel_m: 6.34e-5,
            gel_thickness_m: 4e-3,
        })
    }
}

impl DepthLoad {
    /// 99 904 triangles on a sensor's grid.
    pub fn on(grid: SensorGeometry) -> Self {
        let turn = DQuat::from_rotation_x(1.1) * DQuat::from_rotation_y(0.4);
        Self {
            object: bumpy_ball(0.025, 5e-4, 224, 224),
            t_sensor_object: Pose::from_rotation(turn),
            grid,
        }
    }

    /// The object pressed in.
    ///
    /// # Errors
    /// None.
    pub fn scene(&self) -> Result<TactileScene<'_>> {
        TactileScene::pressed(&self.object, &self.t_sensor_object, 1e-3, &self.grid)
    }

    /// The sensor's grid.
    pub fn grid(&self) -> &SensorGeometry {
        &self.grid
    }

    /// Times whole pictures of a renderer on the load's grid, `runs` times.
    ///
    /// # Errors
    /// Those of the renderer.
    pub fn measure_pictures(
        &self,
        renderer: &mut dyn SceneRenderer,
        runs: usize,
    ) -> Result<DepthMs> {
        let scene = self.scene()?;
        let first = renderer.render(&scene, Some(0)).map(|_| ());
        let took = timed(runs, || renderer.render(&scene, Some(1)).is_ok());
        first.map(|()| took)
    }

    /// Times each way of the depth `runs` times.
    ///
    /// # Errors
    /// None.
    pub fn measure(&self, runs: usize) -> Result<DepthTiming> {
        let scene = self.scene()?;
        let mut rasteriser = Rasteriser::new();
        let wide = SensorGeometry {
            pixel_m: 2.5e-4,
            ..self.grid
        };
        let everything = [IMAGE_PLANE_M, 1.0];
        let mut surface = |grid| {
            timed(runs, || {
                rasteriser
                    .nearest(scene.object, &scene.t_sensor_object, grid, everything)
                    .len()
            })
        };
        let (surface_ms, whole_object_ms) = (surface(&self.grid), surface(&wide));
        let depth_ms = timed(runs, || object_depth(&scene, &self.grid, &mut rasteriser));
        let started = Instant::now();
        let query = MeshQuery::new(&scene.object.transformed(&scene.t_sensor_object));
        let tree_ms = ms(started);
        let rays_ms = timed(runs, || depth_by_rays(&scene, &query, &self.grid));
        let surface_rays_ms = timed(runs, || nearest_by_rays(&query, &self.grid, everything));
        let z_buffer = object_depth(&scene, &self.grid, &mut rasteriser);
        let rays = depth_by_rays(&scene, &query, &self.grid);
        let differences = z_buffer.depth_m.iter().zip(&rays.depth_m);
        Ok(DepthTiming {
            triangles: self.object.triangles.len(),
            pixels: [self.grid.width, self.grid.height],
            depth_ms,
            surface_ms,
            whole_object_ms,
            rays_ms,
            surface_rays_ms,
            tree_ms,
            largest_difference_m: differences
                .map(|(a, b)| f64::from((a - b).abs()))
                .fold(0.0, f64::max),
        })
    }
}

fn ms(since: Instant) -> f64 {
    since.elapsed().as_secs_f64() * 1e3
}

fn timed<T>(runs: usize, mut work: impl FnMut() -> T) -> DepthMs {
    let mut took: Vec<f64> = (0..runs.max(1))
        .map(|_| {
            let started = Instant::now();
            std::hint::black_box(work());
            ms(started)
        })
        .collect();
    took.sort_unstable_by(f64::total_cmp);
    DepthMs {
        min: took[0],
        median: took[(took.len() - 1) / 2],
    }
}

/// [`object_depth`] by one ray a pixel; the mesh of `query` is in the sensor's frame.
pub(super) fn depth_by_rays(
    scene: &TactileScene<'_>,
    query: &MeshQuery,
    grid: &SensorGeometry,
) -> PressDepth {
    let touch = scene.face_m + scene.gap_m;
    let nearest = nearest_by_rays(query, grid, [IMAGE_PLANE_M, touch]);
    depth_below(&nearest, touch, grid)
}

/// [`Rasteriser::nearest`] by one ray a pixel; the mesh of `query` is in the sensor's frame.
pub(super) fn nearest_by_rays(
    query: &MeshQuery,
    grid: &SensorGeometry,
    [near, far]: [f64; 2],
) -> Vec<f32> {
    (0..grid.width * grid.height)
        .map(|pixel| {
            let (column, row) = (pixel % grid.width, pixel / grid.width);
            let [x, y] = grid.pixel_to_gel_m(column as f64, row as f64);
            let hit = query.ray_cast(DVec3::new(x, y, near), DVec3::Z, far - near);
            hit.map_or(far, |hit| near + hit.t) as f32
        })
        .collect()
}

/// Closed ball with bumps (m) of `rings` parts from pole to pole.
pub(super) fn bumpy_ball(radius: f64, bump: f64, rings: u32, segments: u32) -> TriangleMesh {
    let at = |ring: u32, segment: u32| {
        let polar = PI * f64::from(ring) / f64::from(rings);
        let around = TAU * f64::from(segment) / f64::from(segments);
        let (sin, cos) = polar.sin_cos();
        let direction = DVec3::new(sin * around.cos(), sin * around.sin(), cos);
        let wave = (16.0 * around).sin() * (16.0 * polar).sin() * sin * sin;
        direction * (radius + bump * wave)
    };
    let mut mesh = TriangleMesh::default();
    mesh.vertices.push(at(0, 0));
    for ring in 1..rings {
        mesh.vertices
            .extend((0..segments).map(|segment| at(ring, segment)));
    }
    mesh.vertices.push(at(rings, 0));
    let last = mesh.vertices.len() as u32 - 1;
    let node = |ring: u32, segment: u32| 1 + (ring - 1) * segments + segment % segments;
    for segment in 0..segments {
        mesh.triangles
            .push([0, node(1, segment), node(1, segment + 1)]);
        for ring in 1..rings - 1 {
            let [a, b] = [node(ring, segment), node(ring, segment + 1)];
            let [c, d] = [node(ring + 1, segment + 1), node(ring + 1, segment)];
            mesh.triangles.extend([[a, d, c], [a, c, b]]);
        }
        let [a, b] = [node(rings - 1, segment), node(rings - 1, segment + 1)];
        mesh.triangles.push([a, last, b]);
    }
    mesh
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{ObjectDepthRenderer, SensorProfile};
    use gripcast_geometry::MassProperties;

    #[test]
    fn the_ball_is_closed_and_as_large_as_said() {
        let ball = bumpy_ball(0.01, 0.0, 60, 60);
        assert!(ball.edges().is_closed());
        let volume = MassProperties::of(&ball).unwrap().volume_m3;
        let sphere = 4.0 / 3.0 * PI * 1e-6;
        assert!((volume / sphere - 1.0).abs() < 0.01, "{volume}");
    }

    #[test]
    fn both_ways_agree() {
        let load = DepthLoad {
            object: bumpy_ball(0.025, 5e-4, 100, 100),
            ..DepthLoad::default()
        };
        let timing = load.measure(1).unwrap();
        assert!(timing.largest_difference_m < 1e-7, "{timing:?}");
        let load = DepthLoad::default();
        assert_eq!(load.object.triangles.len(), 99_904);
        let profile = SensorProfile::gelsight_mini().unwrap();
        let mut renderer = ObjectDepthRenderer::new(&profile).unwrap();
        let whole = load.measure_pictures(&mut renderer, 1).unwrap();
        assert!(whole.min > 0.0);
    }
}
