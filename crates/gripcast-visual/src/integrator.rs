//! Light along paths: next-event estimation towards the env_map and sampling of the materials,
//! combined by the power heuristic; Russian roulette.
//!
//! The paths of a pixel advance together, bounce by bounce, so that look-ups in the env_map, which
//! miss the processor's caches, overlap one another.
//!
//! Sources: Kajiya, *The rendering equation* (1986); Veach and Guibas, *Optimally combining
//! sampling techniques for Monte Carlo rendering* (1995).

use glam::Vec3;

use super::bsdf::{Bsdf, PreparedMaterial};
use super::bvh::{Bvh, Hit, Lanes, Stack};
use super::camera::Ray;
use super::env_map_sampler::{EnvMapSampler, EnvSample};
use super::film::PathSample;
use super::sampler::PixelSampler;
use super::surface::{Face, Frame, SurfaceInteraction};
use super::texture::Bitmap;

/// Least chance to survive the roulette.
const MIN_SURVIVAL: f32 = 0.05;
/// Pairs of sampler: one for the place in the pixel, then these for each bounce.
const PAIRS_PER_BOUNCE: usize = 3;
const LIGHT_PAIR: usize = 1;
const DIRECTION_PAIR: usize = 2;
const CHOICE_PAIR: usize = 3;

/// How light is looked for. All ways have the same mean.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(
    not(test),
    expect(dead_code, reason = "single ways are there to be compared in tests")
)]
pub(super) enum LightSampling {
    /// Both ways, weighted by the power heuristic.
    #[default]
    Mis,
    /// Towards the env_map alone (mirrors and clear glass excepted).
    Light,
    /// By the material alone.
    Bsdf,
}

/// The prepared scene and the limits of paths.
#[derive(Clone, Copy, Debug)]
pub(super) struct Integrator<'a> {
    pub(super) bvh: &'a Bvh,
    /// In the order of the hierarchy.
    pub(super) faces: &'a [Face],
    pub(super) materials: &'a [PreparedMaterial],
    pub(super) textures: &'a [Bitmap],
    pub(super) env_map: &'a EnvMapSampler,
    pub(super) max_bounces: u32,
    pub(super) rr_depth: u32,
    pub(super) strategy: LightSampling,
}

/// A path on its way.
#[derive(Clone, Copy, Debug)]
struct Path<'a> {
    ray: Ray,
    throughput: Vec3,
    /// Density with which the ray's direction was sampled; infinite if nothing else finds it.
    pdf: f32,
    sampler: PixelSampler<'a>,
    /// Where its light is gathered.
    index: usize,
}

/// Paths that advance together, and scratch space for them.
#[derive(Debug)]
pub(super) struct Batch<'a> {
    paths: Vec<Path<'a>>,
    hits: Vec<Hit>,
    lights: Vec<EnvSample>,
    escaped: Vec<Path<'a>>,
    stack: Stack,
    /// What each path gave, in the order of [`Batch::push`].
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

    /// Adds a path that starts with a ray from the camera.
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

/// A surface as a path sees it.
struct Vertex<'a> {
    bsdf: Bsdf<'a>,
    interaction: SurfaceInteraction,
    frame: Frame,
    /// Local direction back along the path.
    outgoing: Vec3,
}

impl Vertex<'_> {
    /// Whether the shading frame and the triangle agree on which side a direction is.
    #[inline(always)]
    fn sides_agree(&self, world: Vec3, local: Vec3) -> bool {
        world.dot(self.interaction.normal) * local.z > 0.0
    }
}

/// Fraction of the first of two densities by the power heuristic.
#[inline(always)]
fn power_heuristic(first: f32, second: f32) -> f32 {
    if first.is_infinite() {
        return 1.0;
    }
    let (a, b) = (first * first, second * second);
    if a + b > 0.0 { a / (a + b) } else { 0.0 }
}

impl<'a> Integrator<'a> {
    /// Follows all paths of a batch to their ends.
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

    /// Parts the paths that meet a surface from those that escape.
    #[inline(always)]
    fn intersect_scene<L: Lanes>(&self, lanes: L, batch: &mut Batch<'_>) {
        batch.hits.clear();
        batch.escaped.clear();
        let mut kept = 0;
        for at in 0..batch.paths.len() {
            let path = batch.paths[at];
            match self
                .bvh
                .intersect(lanes, &path.ray, f32::INFINITY, &mut batch.stack)
            {
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

    /// Adds the light of the env_map to the paths that escaped.
    #[inline(always)]
    fn add_env_light(&self, batch: &mut Batch<'_>, bounce: u32) {
        for path in &batch.escaped {
            let light = self.env_map.eval(path.ray.direction);
            let fraction = match self.strategy {
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

    /// Chooses a direction towards the env_map for each path.
    #[inline(always)]
    fn sample_env_light(&self, batch: &mut Batch<'_>, bounce: u32) {
        batch.lights.clear();
        let pair = bounce as usize * PAIRS_PER_BOUNCE + LIGHT_PAIR;
        let wanted = self.strategy != LightSampling::Bsdf && bounce < self.max_bounces;
        for (path, hit) in batch.paths.iter().zip(&batch.hits) {
            let material = self.faces[hit.face as usize].material;
            let light = match wanted && !self.materials[material as usize].is_delta() {
                true => self.env_map.sample(path.sampler.get_2d(pair)),
                false => EnvSample::NONE,
            };
            batch.lights.push(light);
        }
    }

    /// Adds the light that comes directly from the env_map and sends the paths on.
    #[inline(always)]
    fn scatter<L: Lanes>(&self, lanes: L, batch: &mut Batch<'_>, bounce: u32) {
        let mut kept = 0;
        for at in 0..batch.paths.len() {
            let path = batch.paths[at];
            let vertex = self.vertex(&batch.hits[at], path.ray.direction);
            let sample = &mut batch.samples[path.index];
            if bounce == 0 {
                sample.albedo = vertex.bsdf.albedo();
                sample.normal = vertex.interaction.shading_normal;
            }
            if bounce == self.max_bounces {
                continue;
            }
            let light = &batch.lights[at];
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

    /// The path after a scattering, if it goes on.
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
        let face = &self.faces[hit.face as usize];
        let material = &self.materials[face.material as usize];
        let mut interaction = face.interaction(hit);
        let outgoing = -direction;
        let side = outgoing.dot(interaction.normal);
        if side < 0.0 && !material.transmits() {
            interaction.normal = -interaction.normal;
            interaction.shading_normal = -interaction.shading_normal;
        }
        let side = outgoing.dot(interaction.normal);
        // A shading normal that faces away would leave the surface black.
        if outgoing.dot(interaction.shading_normal) * side <= 0.0 {
            interaction.shading_normal = interaction.normal;
        }
        let frame = Frame::around(interaction.shading_normal);
        let local = frame.to_local(outgoing);
        Vertex {
            bsdf: material.at(self.textures, interaction.uv, local),
            interaction,
            frame,
            outgoing: local,
        }
    }

    /// Light of the env_map that is scattered at a vertex, estimated by one direction towards it.
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
        let fraction = match self.strategy {
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
        match self.bvh.occluded(lanes, &ray, f32::INFINITY, stack) {
            true => Vec3::ZERO,
            false => contribution,
        }
    }
}
