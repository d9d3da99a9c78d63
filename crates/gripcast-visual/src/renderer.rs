//! Renders images of a scene.

use std::ops::Range;
use std::sync::atomic::{AtomicUsize, Ordering};

use glam::Vec3;
use rayon::prelude::*;

use super::bsdf::PreparedMaterial;
use super::bvh::{Bvh, Lanes, Stack, WithLanes, dispatch};
use super::camera::{Camera, Ray};
use super::env_map_sampler::EnvMapSampler;
use super::film::{FilterTable, PathSample, PixelMeans, PixelSums};
use super::integrator::{Batch, Integrator, LightSampling};
use super::linear_image::Image;
use super::sampler::SobolSampler;
use super::scene::Scene;
use super::settings::{RenderControl, RenderSettings};
use super::surface::Face;
use super::texture::Bitmap;
use gripcast_base::error::{Error, ErrorKind, Result};

/// Side of a tile, px.
const TILE: usize = 16;
/// Maximum number of paths that advance together.
const BATCH: u32 = 64;

/// Rendered image with auxiliary buffers for the denoiser and the depth camera. Row-major.
#[derive(Clone, Debug, PartialEq)]
pub struct Rendering {
    /// Radiance, linear RGB.
    pub image: Image,
    /// Variance of each pixel value, assuming independent paths.
    pub variance: Image,
    /// Images of the first and second half of the paths; both are the whole image for one path.
    pub halves: [Image; 2],
    /// Albedo of the first surface; for the environment its radiance, clipped to 1.
    pub albedo: Image,
    /// Mean shading normal of the first surface, world; 0 for the environment.
    pub normal: Image,
    /// Depth of the first surface along the optical axis at the pixel centre, m; 0 if there is
    /// none.
    pub depth_m: Vec<f32>,
}

/// A scene prepared for rendering from any camera.
#[derive(Debug)]
pub struct Renderer {
    pub(super) bvh: Bvh,
    pub(super) faces: Vec<Face>,
    pub(super) materials: Vec<PreparedMaterial>,
    pub(super) textures: Vec<Bitmap>,
    pub(super) env_map: EnvMapSampler,
    pub(super) strategy: LightSampling,
}

impl Renderer {
    /// Prepares a scene; its camera is not used.
    ///
    /// # Errors
    /// `Input` if [`Scene::validate`] fails.
    pub fn new(scene: &Scene) -> Result<Self> {
        scene.validate()?;
        let faces = Face::all(scene);
        // Triangle indices share their 32 bits with a flag of the BVH.
        if faces.len() >= 1 << 30 {
            let found = faces.len();
            return Err(Error::input(format!(
                "a scene must have fewer than 2³⁰ triangles, found {found}"
            )));
        }
        let corners: Vec<_> = faces.iter().map(|f| f.corners).collect();
        let bvh = Bvh::build(&corners);
        let ordered = bvh.order().iter().map(|&f| faces[f as usize]).collect();
        Ok(Self {
            bvh,
            faces: ordered,
            materials: scene.materials.iter().map(PreparedMaterial::new).collect(),
            textures: scene.textures.clone(),
            env_map: EnvMapSampler::new(&scene.env_map),
            strategy: LightSampling::default(),
        })
    }

    /// Renders an image. The result depends on the scene, camera and settings alone, not on the
    /// number of threads.
    ///
    /// # Errors
    /// `Input` for an invalid camera, `Usage` for settings out of range, `Interrupted` if
    /// cancelled.
    ///
    /// ```
    /// use gripcast_geometry::{CREASE_RAD, Pose, builtin};
    /// use gripcast_visual::*;
    /// use glam::DVec3;
    ///
    /// let eye = DVec3::new(0.2, -0.2, 0.15);
    /// let pose = Camera::look_at(eye, DVec3::ZERO).unwrap_or_default();
    /// let scene = Scene {
    ///     meshes: vec![shaded_mesh(&builtin("mug")?, CREASE_RAD, Projection::None, 0)],
    ///     materials: vec![Material::grey(0.5)],
    ///     textures: Vec::new(),
    ///     env_map: EnvMap::uniform([1.0; 3]),
    ///     camera: Camera::centred(32, 24, 0.7, pose),
    /// };
    /// let settings = RenderSettings { samples_per_pixel: 4, ..RenderSettings::default() };
    /// let renderer = Renderer::new(&scene)?;
    /// let rendering = renderer.render(&scene.camera, &settings, &RenderControl::default())?;
    /// rendering.image.to_srgb8(1.0);
    /// # Ok::<(), gripcast_base::error::Error>(())
    /// ```
    pub fn render(
        &self,
        camera: &Camera,
        settings: &RenderSettings,
        control: &RenderControl<'_>,
    ) -> Result<Rendering> {
        camera.validate().map_err(|e| e.at("camera"))?;
        settings.validate()?;
        let net = SobolSampler::new(settings.samples_per_pixel, settings.seed);
        let filter = FilterTable::new(settings.filter);
        let job = Job {
            integrator: self.integrator(settings),
            camera: CameraRays::new(camera),
            settings,
            net: &net,
            filter: &filter,
        };
        let across = camera.width.div_ceil(TILE);
        let count = across * camera.height.div_ceil(TILE);
        let done = AtomicUsize::new(0);
        let tiles: Vec<Vec<TilePixel>> = (0..count)
            .into_par_iter()
            .map(|tile| {
                if control.is_cancelled() {
                    return Err(Error::new(
                        ErrorKind::Interrupted,
                        "rendering was cancelled",
                    ));
                }
                let columns = tile % across * TILE..camera.width.min((tile % across + 1) * TILE);
                let rows = tile / across * TILE..camera.height.min((tile / across + 1) * TILE);
                let pixels = dispatch(Tile {
                    job: &job,
                    columns,
                    rows,
                });
                let finished = done.fetch_add(1, Ordering::Relaxed) + 1;
                if let Some(on_progress) = control.on_progress {
                    on_progress(finished, count);
                }
                Ok(pixels)
            })
            .collect::<Result<_>>()?;
        Ok(assemble(camera, tiles.into_iter().flatten()))
    }

    /// Renders the depth of the first surface along the optical axis at the pixel centres, m,
    /// row-major; 0 if there is none.
    ///
    /// # Errors
    /// `Input` for an invalid camera.
    pub fn depth(&self, camera: &Camera) -> Result<Vec<f32>> {
        camera.validate().map_err(|e| e.at("camera"))?;
        let rays = CameraRays::new(camera);
        let rows: Vec<Vec<f32>> = (0..camera.height)
            .into_par_iter()
            .map(|row| {
                dispatch(DepthRow {
                    bvh: &self.bvh,
                    rays: &rays,
                    row,
                    columns: camera.width,
                })
            })
            .collect();
        Ok(rows.concat())
    }

    fn integrator(&self, settings: &RenderSettings) -> Integrator<'_> {
        Integrator {
            scene: self,
            max_bounces: settings.max_bounces,
            rr_depth: settings.rr_depth,
        }
    }
}

/// Camera rays in single precision.
struct CameraRays {
    origin: Vec3,
    /// Optical axes in the world; the first two scaled to one pixel.
    right: Vec3,
    down: Vec3,
    forward: Vec3,
    principal: [f32; 2],
}

impl CameraRays {
    fn new(camera: &Camera) -> Self {
        let axes = camera.t_world_camera.rotation_matrix();
        Self {
            origin: camera.t_world_camera.translation_m.as_vec3(),
            right: (axes.x_axis / camera.focal_px[0]).as_vec3(),
            down: (axes.y_axis / camera.focal_px[1]).as_vec3(),
            forward: axes.z_axis.as_vec3(),
            principal: camera.principal_px.map(|c| c as f32),
        }
    }

    #[inline(always)]
    fn ray(&self, column: f32, row: f32) -> Ray {
        let across = self.right * (column - self.principal[0]);
        let down = self.down * (row - self.principal[1]);
        Ray {
            origin: self.origin,
            direction: (self.forward + across + down).normalize(),
        }
    }

    /// Depth of the first surface at the centre of a pixel; 0 if there is none.
    #[inline(always)]
    fn depth<L: Lanes>(
        &self,
        lanes: L,
        bvh: &Bvh,
        [column, row]: [usize; 2],
        stack: &mut Stack,
    ) -> f32 {
        let ray = self.ray(column as f32, row as f32);
        let hit = bvh.intersect(lanes, &ray, stack);
        hit.map_or(0.0, |h| h.t * ray.direction.dot(self.forward))
    }
}

/// State shared by all tiles.
struct Job<'a> {
    integrator: Integrator<'a>,
    camera: CameraRays,
    settings: &'a RenderSettings,
    net: &'a SobolSampler,
    filter: &'a FilterTable,
}

impl<'a> Job<'a> {
    /// Fills the batch with the paths of some samples of a pixel.
    #[inline(always)]
    fn start(&self, [column, row]: [usize; 2], samples: Range<u32>, batch: &mut Batch<'a>) {
        let pixel = (row as u64) << 16 | column as u64;
        batch.clear();
        for index in samples {
            let numbers = self.net.sample(pixel, index);
            let [u, v] = numbers.get_2d(0);
            let x = column as f32 + self.filter.offset(u);
            let y = row as f32 + self.filter.offset(v);
            batch.push(self.camera.ray(x, y), numbers);
        }
    }

    /// Adds the contributions of some samples of a pixel.
    #[inline(always)]
    fn accumulate(&self, samples: Range<u32>, batch: &Batch<'a>, sums: &mut PixelSums) {
        let ceiling = Vec3::splat(self.settings.clamp.unwrap_or(f32::INFINITY));
        for (index, path) in samples.zip(&batch.samples) {
            let path = PathSample {
                radiance: path.radiance.min(ceiling),
                ..*path
            };
            sums.add(&path, index < self.settings.samples_per_pixel / 2);
        }
    }
}

/// A finished pixel at a column and row.
struct TilePixel {
    position: [usize; 2],
    means: PixelMeans,
    depth_m: f32,
}

/// A tile to render.
struct Tile<'a> {
    job: &'a Job<'a>,
    columns: Range<usize>,
    rows: Range<usize>,
}

impl WithLanes for Tile<'_> {
    type Output = Vec<TilePixel>;

    #[inline(always)]
    fn with_lanes<L: Lanes>(self, lanes: L) -> Self::Output {
        let job = self.job;
        let bvh = &job.integrator.scene.bvh;
        let mut stack = bvh.stack();
        let samples = job.settings.samples_per_pixel;
        let mut batch = Batch::new(samples.min(BATCH) as usize, bvh.stack());
        let mut pixels = Vec::with_capacity(self.columns.len() * self.rows.len());
        for row in self.rows {
            for column in self.columns.clone() {
                let mut sums = PixelSums::default();
                let mut first = 0;
                while first < samples {
                    let range = first..samples.min(first + BATCH);
                    job.start([column, row], range.clone(), &mut batch);
                    job.integrator.trace(lanes, &mut batch);
                    job.accumulate(range, &batch, &mut sums);
                    first += BATCH;
                }
                pixels.push(TilePixel {
                    position: [column, row],
                    means: sums.means(samples, samples / 2),
                    depth_m: job.camera.depth(lanes, bvh, [column, row], &mut stack),
                });
            }
        }
        pixels
    }
}

/// A row of depths to render.
struct DepthRow<'a> {
    bvh: &'a Bvh,
    rays: &'a CameraRays,
    row: usize,
    columns: usize,
}

impl WithLanes for DepthRow<'_> {
    type Output = Vec<f32>;

    #[inline(always)]
    fn with_lanes<L: Lanes>(self, lanes: L) -> Vec<f32> {
        let mut stack = self.bvh.stack();
        let mut depths = Vec::with_capacity(self.columns);
        for column in 0..self.columns {
            let pixel = [column, self.row];
            depths.push(self.rays.depth(lanes, self.bvh, pixel, &mut stack));
        }
        depths
    }
}

fn assemble(camera: &Camera, pixels: impl Iterator<Item = TilePixel>) -> Rendering {
    let (width, height) = (camera.width, camera.height);
    let black = Image::filled(width, height, [0.0; 3]);
    let mut rendering = Rendering {
        image: black.clone(),
        variance: black.clone(),
        halves: [black.clone(), black.clone()],
        albedo: black.clone(),
        normal: black,
        depth_m: vec![0.0; width * height],
    };
    for pixel in pixels {
        let at = pixel.position[1] * width + pixel.position[0];
        rendering.image.pixels[at] = pixel.means.radiance;
        rendering.variance.pixels[at] = pixel.means.variance;
        for half in 0..2 {
            rendering.halves[half].pixels[at] = pixel.means.halves[half];
        }
        rendering.albedo.pixels[at] = pixel.means.albedo;
        rendering.normal.pixels[at] = pixel.means.normal;
        rendering.depth_m[at] = pixel.depth_m;
    }
    rendering
}

#[cfg(test)]
#[path = "renderer_test.rs"]
mod tests;
