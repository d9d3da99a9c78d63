//! Bounding volume hierarchy for ray intersection in single precision: eight boxes per node and
//! eight triangles per leaf.
//!
//! The ray–triangle test is watertight: Woop, Benthin, Wald, *Watertight ray/triangle intersection*
//! (2013). Boxes are hit conservatively, so no ray slips through an edge shared by two triangles.
//!
//! `obvhs` 0.3 is not used: for triangles that share an edge, the order of traversal decides
//! between equal distances and thus the normal and material of the hit. Another tree would change
//! images, and its nodes leave the triangle test to the caller.

mod build;
mod lanes;
mod triangles;

use glam::Vec3;

use self::build::{Bounds, Child, Tree};
use self::lanes::WIDTH;
pub(super) use self::lanes::{Lanes, WithLanes, dispatch};
use self::triangles::{Shear, Triangles};
use super::camera::Ray;

/// Flag of leaf references.
const LEAF: u32 = 1 << 31;
/// Reference of an empty slot.
const EMPTY: u32 = u32::MAX;
/// Conservative factor on the far distances of boxes (3 ulps).
const SAFETY: f32 = 1.000_000_6;
/// Minimum component of a direction, so that its inverse is finite.
const MIN_COMPONENT: f32 = 1e-18;

/// Boxes and references of eight children.
#[derive(Clone, Debug)]
#[repr(C, align(64))]
struct Node {
    /// Minimum x, y, z and maximum x, y, z of the children; empty slots are never hit.
    planes: [[f32; WIDTH]; 6],
    /// Node indices, or leaf indices with [`LEAF`].
    children: [u32; WIDTH],
}

/// Closest hit of a ray.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Hit {
    /// Distance in units of the ray direction.
    pub(super) t: f32,
    /// Triangle index in [`Bvh::order`].
    pub(super) face: u32,
    /// Barycentric weights of the second and third vertex.
    pub(super) weights: [f32; 2],
}

/// Traversal stack.
#[derive(Clone, Debug)]
pub(super) struct Stack(Vec<(u32, f32)>);

/// BVH over triangles.
#[derive(Debug)]
pub(super) struct Bvh {
    nodes: Vec<Node>,
    leaves: Vec<Triangles>,
    order: Vec<u32>,
    depth: usize,
}

/// A ray prepared for the intersection tests.
struct PreparedRay<L: Lanes> {
    origin: [L::F; 3],
    inverse: [L::F; 3],
    /// Index of the near plane of a box for each axis.
    near: [usize; 3],
    far: [usize; 3],
    shear: Shear<L>,
}

impl<L: Lanes> PreparedRay<L> {
    #[inline(always)]
    fn new(lanes: L, ray: &Ray) -> Self {
        // Unrolled: the compiler does not vectorise across closures.
        let [ix, iy, iz] = [
            inverse(ray.direction.x),
            inverse(ray.direction.y),
            inverse(ray.direction.z),
        ];
        let [ux, uy, uz] = [upper(ix), upper(iy), upper(iz)];
        let o = ray.origin;
        Self {
            origin: [lanes.splat(o.x), lanes.splat(o.y), lanes.splat(o.z)],
            inverse: [lanes.splat(ix), lanes.splat(iy), lanes.splat(iz)],
            near: [ux, 1 + uy, 2 + uz],
            far: [3 - ux, 4 - uy, 5 - uz],
            shear: Shear::new(lanes, ray),
        }
    }
}

/// Finite inverse of a direction component.
#[inline(always)]
fn inverse(component: f32) -> f32 {
    if component.abs() < MIN_COMPONENT {
        1.0 / MIN_COMPONENT.copysign(component)
    } else {
        1.0 / component
    }
}

/// Offset to the upper planes if they are the near ones.
#[inline(always)]
fn upper(inverse: f32) -> usize {
    if inverse < 0.0 { 3 } else { 0 }
}

impl Bvh {
    /// Builds the BVH of triangles with finite vertices. Triangles without area are never hit.
    pub(super) fn build(corners: &[[Vec3; 3]]) -> Self {
        let boxes: Vec<Bounds> = corners.iter().map(|&c| Bounds::of(c)).collect();
        let tree = Tree::build(&boxes);
        let mut bvh = Self {
            nodes: Vec::with_capacity(tree.nodes.len()),
            leaves: Vec::new(),
            order: tree.order,
            depth: tree.depth,
        };
        for wide in &tree.nodes {
            let mut node = Node {
                planes: [[f32::INFINITY; WIDTH]; 6],
                children: [EMPTY; WIDTH],
            };
            node.planes[3..].fill([f32::NEG_INFINITY; WIDTH]);
            for (slot, (bounds, child)) in wide.children.iter().enumerate() {
                for axis in 0..3 {
                    node.planes[axis][slot] = bounds.min[axis];
                    node.planes[3 + axis][slot] = bounds.max[axis];
                }
                node.children[slot] = match *child {
                    Child::Node(index) => index,
                    Child::Leaf { first, count } => {
                        let range = first as usize..(first + count) as usize;
                        let faces = bvh.order[range].iter().map(|&f| corners[f as usize]);
                        bvh.leaves.push(Triangles::new(first, faces));
                        LEAF | (bvh.leaves.len() - 1) as u32
                    }
                };
            }
            bvh.nodes.push(node);
        }
        bvh
    }

    /// Triangle indices in leaf order.
    pub(super) fn order(&self) -> &[u32] {
        &self.order
    }

    /// Returns a stack that is large enough for this BVH.
    pub(super) fn stack(&self) -> Stack {
        Stack(vec![(EMPTY, 0.0); (WIDTH - 1) * self.depth + WIDTH])
    }

    /// Returns the closest hit at a positive distance.
    #[inline(always)]
    pub(super) fn intersect<L: Lanes>(
        &self,
        lanes: L,
        ray: &Ray,
        stack: &mut Stack,
    ) -> Option<Hit> {
        if self.nodes.is_empty() {
            return None;
        }
        let prepared = PreparedRay::new(lanes, ray);
        let stack = stack.0.as_mut_slice();
        let mut best = Hit {
            t: f32::INFINITY,
            face: EMPTY,
            weights: [0.0; 2],
        };
        let mut height = 0;
        let mut current = 0u32;
        loop {
            if current & LEAF == 0 {
                let node = &self.nodes[current as usize];
                let (mut mask, near) = node.intersect_children(lanes, &prepared, best.t);
                if mask != 0 {
                    let first = mask.trailing_zeros() as usize & (WIDTH - 1);
                    mask &= mask - 1;
                    current = node.children[first];
                    if mask == 0 {
                        continue;
                    }
                    let near = lanes.store(near);
                    let mut distance = near[first];
                    let floor = height;
                    while mask != 0 {
                        let slot = mask.trailing_zeros() as usize & (WIDTH - 1);
                        mask &= mask - 1;
                        let mut entry = (node.children[slot], near[slot]);
                        if entry.1 < distance {
                            (current, distance, entry) = (entry.0, entry.1, (current, distance));
                        }
                        // Nearest on top.
                        let mut slot = height;
                        while slot > floor && stack[slot - 1].1 < entry.1 {
                            stack[slot] = stack[slot - 1];
                            slot -= 1;
                        }
                        stack[slot] = entry;
                        height += 1;
                    }
                    continue;
                }
            } else {
                let leaf = &self.leaves[(current & !LEAF) as usize];
                if let Some(hit) = leaf.intersect(lanes, &prepared.shear, best.t) {
                    best = hit;
                }
            }
            loop {
                if height == 0 {
                    return (best.face != EMPTY).then_some(best);
                }
                height -= 1;
                let (next, distance) = stack[height];
                if distance < best.t {
                    current = next;
                    break;
                }
            }
        }
    }

    /// Whether any triangle is hit at a positive distance.
    #[inline(always)]
    pub(super) fn occluded<L: Lanes>(&self, lanes: L, ray: &Ray, stack: &mut Stack) -> bool {
        if self.nodes.is_empty() {
            return false;
        }
        let prepared = PreparedRay::new(lanes, ray);
        let stack = stack.0.as_mut_slice();
        let mut height = 0;
        let mut current = 0u32;
        loop {
            if current & LEAF == 0 {
                let node = &self.nodes[current as usize];
                let (mut mask, _) = node.intersect_children(lanes, &prepared, f32::INFINITY);
                while mask != 0 {
                    let slot = mask.trailing_zeros() as usize & (WIDTH - 1);
                    mask &= mask - 1;
                    stack[height].0 = node.children[slot];
                    height += 1;
                }
            } else if self.leaves[(current & !LEAF) as usize].occluded(lanes, &prepared.shear) {
                return true;
            }
            if height == 0 {
                return false;
            }
            height -= 1;
            current = stack[height].0;
        }
    }
}

impl Node {
    /// Returns a mask of the children hit before `t_max`, and their entry distances.
    #[inline(always)]
    fn intersect_children<L: Lanes>(
        &self,
        lanes: L,
        ray: &PreparedRay<L>,
        t_max: f32,
    ) -> (u32, L::F) {
        let nx = self.distance(lanes, ray, ray.near[0], 0);
        let ny = self.distance(lanes, ray, ray.near[1], 1);
        let nz = self.distance(lanes, ray, ray.near[2], 2);
        let fx = self.distance(lanes, ray, ray.far[0], 0);
        let fy = self.distance(lanes, ray, ray.far[1], 1);
        let fz = self.distance(lanes, ray, ray.far[2], 2);
        let near = lanes.max(lanes.max(nx, ny), lanes.max(nz, lanes.splat(0.0)));
        let far = lanes.mul(lanes.min(fx, lanes.min(fy, fz)), lanes.splat(SAFETY));
        let far = lanes.min(far, lanes.splat(t_max));
        (lanes.le(near, far), near)
    }

    /// Distances to one plane of each box.
    #[inline(always)]
    fn distance<L: Lanes>(
        &self,
        lanes: L,
        ray: &PreparedRay<L>,
        plane: usize,
        axis: usize,
    ) -> L::F {
        let from = lanes.sub(lanes.load(&self.planes[plane]), ray.origin[axis]);
        lanes.mul(from, ray.inverse[axis])
    }
}

#[cfg(test)]
#[path = "bvh_test.rs"]
mod tests;
