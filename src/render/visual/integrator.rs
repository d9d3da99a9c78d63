//! Light along one path: next-event estimation towards the dome and sampling of the materials,
//! combined by the power heuristic; Russian roulette.
//!
//! Sources: Kajiya, *The rendering equation* (1986); Veach and Guibas, *Optimally combining
//! sampling techniques for Monte Carlo rendering* (1995).

use glam::Vec3;

use super::bsdf::{Bsdf, Prepared};
use super::bvh::{Bvh, Lanes, Stack};
use super::camera::Ray;
use super::dome::Dome;
use super::film::PathSample;
use super::sampler::PixelSample;
use super::surface::{Face, Frame, Place};
use super::texture::Texture;

/// Least chance to survive the roulette.
const LEAST_SURVIVAL: f32 = 0.05;
/// Pairs of numbers: one for the place in the pixel, then these for each bounce.
const PAIRS_PER_BOUNCE: usize = 3;
const LIGHT_PAIR: usize = 1;
const DIRECTION_PAIR: usize = 2;
const CHOICE_PAIR: usize = 3;

/// How light is looked for. All ways have the same mean.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Strategy {
    /// Both ways, weighted by the power heuristic.
    #[default]
    Both,
    /// Towards the dome alone (mirrors and clear glass excepted).
    Light,
    /// By the material alone.
    Material,
}

/// The prepared scene and the limits of paths.
#[derive(Clone, Copy, Debug)]
pub(super) struct Integrator<'a> {
    pub(super) bvh: &'a Bvh,
    /// In the order of the hierarchy.
    pub(super) faces: &'a [Face],
    pub(super) materials: &'a [Prepared],
    pub(super) textures: &'a [Texture],
    pub(super) dome: &'a Dome,
    pub(super) max_bounces: u32,
    pub(super) roulette_from: u32,
    pub(super) strategy: Strategy,
}

/// A surface as a path sees it.
struct Vertex<'a> {
    bsdf: Bsdf<'a>,
    place: Place,
    frame: Frame,
    /// Local direction back along the path.
    outgoing: Vec3,
}

impl Vertex<'_> {
    /// Whether the shading frame and the triangle agree on which side a direction is.
    #[inline(always)]
    fn sides_agree(&self, world: Vec3, local: Vec3) -> bool {
        world.dot(self.place.normal) * local.z > 0.0
    }
}

/// Share of the first of two densities by the power heuristic.
#[inline(always)]
fn power_heuristic(first: f32, second: f32) -> f32 {
    if first.is_infinite() {
        return 1.0;
    }
    let (a, b) = (first * first, second * second);
    if a + b > 0.0 { a / (a + b) } else { 0.0 }
}

impl<'a> Integrator<'a> {
    /// Radiance that comes along a ray from the camera, and the first surface for a denoiser.
    #[inline(always)]
    pub(super) fn trace<L: Lanes>(
        &self,
        lanes: L,
        mut ray: Ray,
        numbers: &PixelSample<'_>,
        stack: &mut Stack,
    ) -> PathSample {
        let mut sample = PathSample::default();
        let mut throughput = Vec3::ONE;
        // Density with which the ray's direction was sampled; infinite if nothing else finds it.
        let mut density = f32::INFINITY;
        let mut bounce = 0;
        loop {
            let Some(hit) = self.bvh.closest(lanes, &ray, f32::INFINITY, stack) else {
                let light = self.dome.light_from(ray.direction);
                let share = match self.strategy {
                    Strategy::Both => power_heuristic(density, light.pdf),
                    Strategy::Material => 1.0,
                    Strategy::Light => f32::from(u8::from(density.is_infinite())),
                };
                sample.radiance += throughput * light.radiance * share;
                if bounce == 0 {
                    sample.albedo = light.radiance.min(Vec3::ONE);
                }
                return sample;
            };
            let vertex = self.vertex(&hit, ray.direction);
            if bounce == 0 {
                sample.albedo = vertex.bsdf.albedo();
                sample.normal = vertex.place.shading_normal;
            }
            if bounce == self.max_bounces {
                return sample;
            }
            let pairs = bounce as usize * PAIRS_PER_BOUNCE;
            if self.strategy != Strategy::Material
                && !vertex.bsdf.is_delta()
                && !self.dome.is_dark()
            {
                let u = numbers.pair(pairs + LIGHT_PAIR);
                sample.radiance += throughput * self.light_at(lanes, &vertex, u, stack);
            }
            let [choice, survival] = numbers.pair(pairs + CHOICE_PAIR);
            let u = numbers.pair(pairs + DIRECTION_PAIR);
            let Some(scattered) = vertex.bsdf.sample(vertex.outgoing, choice, u) else {
                return sample;
            };
            let direction = vertex.frame.to_world(scattered.direction);
            if !vertex.sides_agree(direction, scattered.direction) {
                return sample;
            }
            throughput *= scattered.weight;
            density = match scattered.delta {
                true => f32::INFINITY,
                false => scattered.pdf,
            };
            let largest = throughput.max_element();
            if largest <= 0.0 {
                return sample;
            }
            bounce += 1;
            if bounce >= self.roulette_from && largest < 1.0 {
                let chance = largest.max(LEAST_SURVIVAL);
                if survival >= chance {
                    return sample;
                }
                throughput /= chance;
            }
            ray = Ray {
                origin: vertex.place.start(direction),
                direction,
            };
        }
    }

    #[inline(always)]
    fn vertex(&self, hit: &super::bvh::Hit, direction: Vec3) -> Vertex<'a> {
        let face = &self.faces[hit.face as usize];
        let material = &self.materials[face.material as usize];
        let mut place = face.place(hit);
        let outgoing = -direction;
        let side = outgoing.dot(place.normal);
        if side < 0.0 && !material.transmits() {
            place.normal = -place.normal;
            place.shading_normal = -place.shading_normal;
        }
        let side = outgoing.dot(place.normal);
        // A shading normal that faces away would leave the surface black.
        if outgoing.dot(place.shading_normal) * side <= 0.0 {
            place.shading_normal = place.normal;
        }
        let frame = Frame::around(place.shading_normal);
        let local = frame.to_local(outgoing);
        Vertex {
            bsdf: material.at(self.textures, place.uv, place.position, local),
            place,
            frame,
            outgoing: local,
        }
    }

    /// Light of the dome that is scattered at a vertex, estimated by one direction towards it.
    #[inline(always)]
    fn light_at<L: Lanes>(
        &self,
        lanes: L,
        vertex: &Vertex<'_>,
        u: [f32; 2],
        stack: &mut Stack,
    ) -> Vec3 {
        let light = self.dome.sample(u);
        let incoming = vertex.frame.to_local(light.direction);
        let opaque = !vertex.bsdf.transmits();
        if light.pdf <= 0.0
            || (opaque && incoming.z <= 0.0)
            || !vertex.sides_agree(light.direction, incoming)
        {
            return Vec3::ZERO;
        }
        let scattered = vertex.bsdf.value(vertex.outgoing, incoming);
        let share = match self.strategy {
            Strategy::Both => power_heuristic(light.pdf, scattered.pdf),
            _ => 1.0,
        };
        let contribution = scattered.value * light.radiance * (share / light.pdf);
        if contribution.max_element() <= 0.0 {
            return Vec3::ZERO;
        }
        let ray = Ray {
            origin: vertex.place.start(light.direction),
            direction: light.direction,
        };
        match self.bvh.any(lanes, &ray, f32::INFINITY, stack) {
            true => Vec3::ZERO,
            false => contribution,
        }
    }
}
