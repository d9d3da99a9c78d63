//! Where a ray meets triangles first: a hierarchy of eight boxes a node and eight triangles a leaf,
//! in single precision.
//!
//! The ray–triangle test is watertight: Woop, Benthin, Wald, *Watertight ray/triangle intersection*
//! (2013). Boxes are hit conservatively, so no ray slips through an edge that two triangles fraction.
//!
//! Not `obvhs` (0.3): where two triangles share an edge, equal distances are decided by the order of
//! traversal, and the winner's normal and material by the bits of the image. Another tree changes
//! images, and its nodes leave the triangle test to the caller anyway.

mod build;
mod lanes;
mod triangles;

use glam::Vec3;

use self::build::{Bounds, Child, Tree};
use self::lanes::WIDTH;
pub(super) use self::lanes::{Lanes, WithLanes, dispatch};
use self::triangles::{Shear, Triangles};
use super::camera::Ray;

/// Bit that tells leaves from nodes in a reference.
const LEAF: u32 = 1 << 31;
/// Reference to nothing.
const EMPTY: u32 = u32::MAX;
/// Farther ends of boxes are moved by the largest error of their distance (3 roundings).
const SAFETY: f32 = 1.000_000_6;
/// Smallest component of a direction, so that its inverse is finite.
const MIN_COMPONENT: f32 = 1e-18;

/// Boxes of eight children and what is in them.
#[derive(Clone, Debug)]
#[repr(C, align(64))]
struct Node {
    /// Lower x, y, z and upper x, y, z of the children; empty ones are never hit.
    planes: [[f32; WIDTH]; 6],
    /// Index of a node, or of triangles with [`LEAF`].
    children: [u32; WIDTH],
}

/// First hit of a ray.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Hit {
    /// Distance in lengths of the ray's direction.
    pub(super) t: f32,
    /// Index of the triangle in the order of [`Bvh::order`].
    pub(super) face: u32,
    /// Weights of the second and third corner.
    pub(super) weights: [f32; 2],
}

/// Scratch space of traversals.
#[derive(Clone, Debug)]
pub(super) struct Stack(Vec<(u32, f32)>);

/// Hierarchy over triangles.
#[derive(Debug)]
pub(super) struct Bvh {
    nodes: Vec<Node>,
    leaves: Vec<Triangles>,
    order: Vec<u32>,
    depth: usize,
}

/// A ray as the tests want it.
struct PreparedRay<L: Lanes> {
    origin: [L::F; 3],
    inverse: [L::F; 3],
    /// Which of the six planes of a box is nearer, for each axis.
    near: [usize; 3],
    far: [usize; 3],
    shear: Shear<L>,
}

impl<L: Lanes> PreparedRay<L> {
    #[inline(always)]
    fn new(lanes: L, ray: &Ray) -> Self {
        // Written out: the compiler does not widen what runs inside closures.
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

/// Inverse of a component of a direction, finite.
#[inline(always)]
fn inverse(component: f32) -> f32 {
    if component.abs() < MIN_COMPONENT {
        1.0 / MIN_COMPONENT.copysign(component)
    } else {
        1.0 / component
    }
}

/// Offset of the upper planes of boxes where they are the nearer ones.
#[inline(always)]
fn upper(inverse: f32) -> usize {
    if inverse < 0.0 { 3 } else { 0 }
}

impl Bvh {
    /// Builds the hierarchy over triangles by their corners, which must be finite. Triangles
    /// without area are never hit.
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

    /// Index of each triangle in the order of the leaves.
    pub(super) fn order(&self) -> &[u32] {
        &self.order
    }

    /// Scratch space that is large enough for this hierarchy.
    pub(super) fn stack(&self) -> Stack {
        Stack(vec![(EMPTY, 0.0); (WIDTH - 1) * self.depth + WIDTH])
    }

    /// First triangle that the ray meets at a distance in (0, `t_max`).
    #[inline(always)]
    pub(super) fn intersect<L: Lanes>(
        &self,
        lanes: L,
        ray: &Ray,
        t_max: f32,
        stack: &mut Stack,
    ) -> Option<Hit> {
        if self.nodes.is_empty() {
            return None;
        }
        let prepared = PreparedRay::new(lanes, ray);
        let stack = stack.0.as_mut_slice();
        let mut best = Hit {
            t: t_max,
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
                        let mut at = height;
                        while at > floor && stack[at - 1].1 < entry.1 {
                            stack[at] = stack[at - 1];
                            at -= 1;
                        }
                        stack[at] = entry;
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

    /// Whether the ray meets any triangle at a distance in (0, `t_max`).
    #[inline(always)]
    pub(super) fn occluded<L: Lanes>(
        &self,
        lanes: L,
        ray: &Ray,
        t_max: f32,
        stack: &mut Stack,
    ) -> bool {
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
                let (mut mask, _) = node.intersect_children(lanes, &prepared, t_max);
                while mask != 0 {
                    let slot = mask.trailing_zeros() as usize & (WIDTH - 1);
                    mask &= mask - 1;
                    stack[height].0 = node.children[slot];
                    height += 1;
                }
            } else if self.leaves[(current & !LEAF) as usize].occluded(
                lanes,
                &prepared.shear,
                t_max,
            ) {
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
    /// Children that the ray enters before `t_max`, and the distances at which it does.
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
