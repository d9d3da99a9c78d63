//! Path tracing: next-event estimation towards the environment map and BSDF sampling, combined by
//! multiple importance sampling (power heuristic), with Russian roulette.
//!
//! The paths of a pixel advance together, bounce by bounce, so that environment-map lookups, which
//! miss the cache, overlap.
//!
//! Sources: Kajiya, *The rendering equation* (1986); Veach and Guibas, *Optimally combining
//! sampling techniques for Monte Carlo rendering* (1995).

use glam::Vec3;

use super::bsdf::Bsdf;
use super::bvh::{Hit, Lanes, Stack};
use super::camera::Ray;
use super::env_map_sampler::EnvSample;
use super::film::PathSample;
use super::renderer::Renderer;
use super::sampler::PixelSampler;
use super::surface::{Frame, SurfaceInteraction};

/// Minimum survival probability of Russian roulette.
const MIN_SURVIVAL: f32 = 0.05;
/// Sample dimensions, in pairs: one for the pixel position, then these for each bounce.
const PAIRS_PER_BOUNCE: usize = 3;
const LIGHT_PAIR: usize = 1;
const DIRECTION_PAIR: usize = 2;
const CHOICE_PAIR: usize = 3;

/// Light sampling strategy. All have the same expected value.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(
    not(test),
    expect(dead_code, reason = "tests compare the single strategies")
)]
pub(super) enum LightSampling {
    /// Multiple importance sampling with the power heuristic.
    #[default]
    Mis,
    /// Next-event estimation only (except for mirrors and clear glass).
    Light,
    /// BSDF sampling only.
    Bsdf,
}

/// The prepared scene and the limits of a path.
#[derive(Clone, Copy, Debug)]
pub(super) struct Integrator<'a> {
    pub(super) scene: &'a Renderer,
    pub(super) max_bounces: u32,
    pub(super) rr_depth: u32,
}

/// State of a path.
#[derive(Clone, Copy, Debug)]
struct Path<'a> {
    ray: Ray,
    throughput: Vec3,
    /// Sampling density of the ray's direction; infinite for a delta BSDF and for camera rays.
    pdf: f32,
    sampler: PixelSampler<'a>,
    /// Index in [`Batch::samples`].
    index: usize,
}

/// Paths that advance together, with scratch space.
#[derive(Debug)]
pub(super) struct Batch<'a> {
    paths: Vec<Path<'a>>,
    hits: Vec<Hit>,
    lights: Vec<EnvSample>,
    escaped: Vec<Path<'a>>,
    stack: Stack,
    /// Contribution of each path, in the order of [`Batch::push`].
    pub(super) samples: Vec<PathSample>,
}

impl<'a> Batch<'a> {
    pub(super) fn new(capacity: usize, stack: Stack) -> Self {
        Self {
            paths: Vec::with_capacity(capacity),
            hits: Vec::with_capacity(capacity),
            lights: Vec::with_capacity(capacity),
            escaped: Vec::with_capacity(capacity),
            stack,
            samples: Vec::with_capacity(capacity),
        }
    }

    pub(super) fn clear(&mut self) {
        self.paths.clear();
        self.samples.clear();
    }

    /// Adds a path that starts with a camera ray.
    #[inline(always)]
    pub(crate) fn push(&mut self, ray: Ray, sampler: PixelSampler<'a>) {
        self.paths.push(Path {
            ray,
            throughput: Vec3::ONE,
            pdf: f32::INFINITY,
            sampler,
            index: self.samples.len(),
        });
        self.samples.push(PathSample::default());
    }
}

/// A surface interaction with its BSDF and shading frame.
struct Vertex<'a> {
    bsdf: Bsdf<'a>,
    interaction: SurfaceInteraction,
    frame: Frame,
    /// Local direction back along the path.
    outgoing: Vec3,
}

impl Vertex<'_> {
    /// Whether a direction lies on the same side of the shading frame and of the triangle.
    #[inline(always)]
    fn sides_agree(&self, world: Vec3, local: Vec3) -> bool {
        world.dot(self.interaction.normal) * local.z > 0.0
    }
}

/// Weight of the first of two strategies with the given densities (power heuristic).
#[inline(always)]
fn power_heuristic(first: f32, second: f32) -> f32 {
    if first.is_infinite() {
        return 1.0;
    }
    let (a, b) = (first * first, second * second);
    if a + b > 0.0 { a / (a + b) } else { 0.0 }
}

impl<'a> Integrator<'a> {
    /// Traces all paths of a batch until they end.
    #[inline(always)]
    pub(super) fn trace<L: Lanes>(&self, lanes: L, batch: &mut Batch<'_>) {
        let mut bounce = 0;
        while !batch.paths.is_empty() {
            self.intersect_scene(lanes, batch);
            self.add_env_light(batch, bounce);
            self.sample_env_light(batch, bounce);
            self.scatter(lanes, batch, bounce);
            bounce += 1;
        }
    }

    /// Intersects the rays with the scene; separates paths that hit a surface from those that
    /// escape.
    #[inline(always)]
    fn intersect_scene<L: Lanes>(&self, lanes: L, batch: &mut Batch<'_>) {
        batch.hits.clear();
        batch.escaped.clear();
        let mut kept = 0;
        for i in 0..batch.paths.len() {
            let path = batch.paths[i];
            match self.scene.bvh.intersect(lanes, &path.ray, &mut batch.stack) {
                Some(hit) => {
                    batch.hits.push(hit);
                    batch.paths[kept] = path;
                    kept += 1;
                }
                None => batch.escaped.push(path),
            }
        }
        batch.paths.truncate(kept);
    }

    /// Adds the environment light of the escaped paths.
    #[inline(always)]
    fn add_env_light(&self, batch: &mut Batch<'_>, bounce: u32) {
        for path in &batch.escaped {
            let light = self.scene.env_map.eval(path.ray.direction);
            let fraction = match self.scene.strategy {
                LightSampling::Mis => power_heuristic(path.pdf, light.pdf),
                LightSampling::Bsdf => 1.0,
                LightSampling::Light => f32::from(u8::from(path.pdf.is_infinite())),
            };
            let sample = &mut batch.samples[path.index];
            sample.radiance += path.throughput * light.radiance * fraction;
            if bounce == 0 {
                sample.albedo = light.radiance.min(Vec3::ONE);
            }
        }
    }

    /// Samples a direction of the environment map for each path.
    #[inline(always)]
    fn sample_env_light(&self, batch: &mut Batch<'_>, bounce: u32) {
        batch.lights.clear();
        let pair = bounce as usize * PAIRS_PER_BOUNCE + LIGHT_PAIR;
        let wanted = self.scene.strategy != LightSampling::Bsdf && bounce < self.max_bounces;
        for (path, hit) in batch.paths.iter().zip(&batch.hits) {
            let material = self.scene.faces[hit.face as usize].material;
            let light = match wanted && !self.scene.materials[material as usize].is_delta() {
                true => self.scene.env_map.sample(path.sampler.get_2d(pair)),
                false => EnvSample::NONE,
            };
            batch.lights.push(light);
        }
    }

    /// Adds the direct light and extends the paths.
    #[inline(always)]
    fn scatter<L: Lanes>(&self, lanes: L, batch: &mut Batch<'_>, bounce: u32) {
        let mut kept = 0;
        for i in 0..batch.paths.len() {
            let path = batch.paths[i];
            let vertex = self.vertex(&batch.hits[i], path.ray.direction);
            let sample = &mut batch.samples[path.index];
            if bounce == 0 {
                sample.albedo = vertex.bsdf.albedo();
                sample.normal = vertex.interaction.shading_normal;
            }
            if bounce == self.max_bounces {
                continue;
            }
            let light = &batch.lights[i];
            if light.pdf > 0.0 {
                let direct = self.direct_light(lanes, &vertex, light, &mut batch.stack);
                sample.radiance += path.throughput * direct;
            }
            if let Some(next) = self.scattered_path(&path, &vertex, bounce) {
                batch.paths[kept] = next;
                kept += 1;
            }
        }
        batch.paths.truncate(kept);
    }

    /// Samples the BSDF; returns the extended path, or `None` if it ends.
    #[inline(always)]
    fn scattered_path<'b>(
        &self,
        path: &Path<'b>,
        vertex: &Vertex<'_>,
        bounce: u32,
    ) -> Option<Path<'b>> {
        let pairs = bounce as usize * PAIRS_PER_BOUNCE;
        let [choice, survival] = path.sampler.get_2d(pairs + CHOICE_PAIR);
        let u = path.sampler.get_2d(pairs + DIRECTION_PAIR);
        let scattered = vertex.bsdf.sample(vertex.outgoing, choice, u)?;
        let direction = vertex.frame.to_world(scattered.direction);
        if !vertex.sides_agree(direction, scattered.direction) {
            return None;
        }
        let mut throughput = path.throughput * scattered.weight;
        let largest = throughput.max_element();
        if largest <= 0.0 {
            return None;
        }
        if bounce + 1 >= self.rr_depth && largest < 1.0 {
            let chance = largest.max(MIN_SURVIVAL);
            if survival >= chance {
                return None;
            }
            throughput /= chance;
        }
        Some(Path {
            ray: Ray {
                origin: vertex.interaction.ray_origin(direction),
                direction,
            },
            throughput,
            pdf: match scattered.delta {
                true => f32::INFINITY,
                false => scattered.pdf,
            },
            ..*path
        })
    }

    #[inline(always)]
    fn vertex(&self, hit: &Hit, direction: Vec3) -> Vertex<'a> {
        let face = &self.scene.faces[hit.face as usize];
        let material = &self.scene.materials[face.material as usize];
        let mut interaction = face.interaction(hit);
        let outgoing = -direction;
        let side = outgoing.dot(interaction.normal);
        if side < 0.0 && !material.transmits() {
            interaction.normal = -interaction.normal;
            interaction.shading_normal = -interaction.shading_normal;
        }
        let side = outgoing.dot(interaction.normal);
        // A back-facing shading normal would render the surface black.
        if outgoing.dot(interaction.shading_normal) * side <= 0.0 {
            interaction.shading_normal = interaction.normal;
        }
        let frame = Frame::around(interaction.shading_normal);
        let local = frame.to_local(outgoing);
        Vertex {
            bsdf: material.at(&self.scene.textures, interaction.uv, local),
            interaction,
            frame,
            outgoing: local,
        }
    }

    /// Estimates the direct light scattered at a vertex from one sampled direction.
    #[inline(always)]
    fn direct_light<L: Lanes>(
        &self,
        lanes: L,
        vertex: &Vertex<'_>,
        light: &EnvSample,
        stack: &mut Stack,
    ) -> Vec3 {
        let incoming = vertex.frame.to_local(light.direction);
        let opaque = !vertex.bsdf.transmits();
        if (opaque && incoming.z <= 0.0) || !vertex.sides_agree(light.direction, incoming) {
            return Vec3::ZERO;
        }
        let scattered = vertex.bsdf.value(vertex.outgoing, incoming);
        let fraction = match self.scene.strategy {
            LightSampling::Mis => power_heuristic(light.pdf, scattered.pdf),
            _ => 1.0,
        };
        let contribution = scattered.value * light.radiance * (fraction / light.pdf);
        if contribution.max_element() <= 0.0 {
            return Vec3::ZERO;
        }
        let ray = Ray {
            origin: vertex.interaction.ray_origin(light.direction),
            direction: light.direction,
        };
        match self.scene.bvh.occluded(lanes, &ray, stack) {
            true => Vec3::ZERO,
            false => contribution,
        }
    }
}
