//! Binary BVH by binned surface area heuristic, collapsed to eight children per node.
//!
//! Sources: Wald, *On fast construction of SAH-based bounding volume hierarchies* (2007); Wald,
//! Benthin, Boulos, *Getting rid of packets* (2008) for wide nodes.

use glam::Vec3;

use super::WIDTH;

const BINS: usize = 16;
/// Depth from which splits have equal count, to bound the depth of the tree.
const MAX_SAH_DEPTH: u32 = 48;

/// Axis-aligned bounding box.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Bounds {
    pub(super) min: Vec3,
    pub(super) max: Vec3,
}

impl Bounds {
    pub(super) const EMPTY: Self = Self {
        min: Vec3::INFINITY,
        max: Vec3::NEG_INFINITY,
    };

    pub(super) fn of(points: [Vec3; 3]) -> Self {
        points.into_iter().fold(Self::EMPTY, Self::with)
    }

    fn with(self, point: Vec3) -> Self {
        Self {
            min: self.min.min(point),
            max: self.max.max(point),
        }
    }

    fn union(self, other: Self) -> Self {
        Self {
            min: self.min.min(other.min),
            max: self.max.max(other.max),
        }
    }

    /// Half the surface area; 0 for an empty box.
    fn half_area(&self) -> f32 {
        let d = (self.max - self.min).max(Vec3::ZERO);
        d.x * d.y + d.y * d.z + d.z * d.x
    }

    fn centre(&self) -> Vec3 {
        0.5 * (self.min + self.max)
    }
}

/// Node of the binary BVH.
struct BinaryNode {
    bounds: Bounds,
    /// Inner node: index of the left child. Leaf: first of its boxes in the order.
    first: u32,
    /// Inner node: index of the right child.
    right: u32,
    /// Number of boxes of a leaf; 0 for an inner node.
    count: u32,
}

/// Child of a wide node.
#[derive(Clone, Copy, Debug)]
pub(super) enum Child {
    /// Index of a node.
    Node(u32),
    /// First box in the order and number of boxes, at most [`WIDTH`].
    Leaf { first: u32, count: u32 },
}

/// Node with up to eight children.
#[derive(Clone, Debug)]
pub(super) struct WideNode {
    pub(super) children: Vec<(Bounds, Child)>,
}

/// BVH over boxes. Node 0 is the root; parents precede their children.
#[derive(Debug, Default)]
pub(super) struct Tree {
    pub(super) nodes: Vec<WideNode>,
    /// Box indices in leaf order.
    pub(super) order: Vec<u32>,
    /// Number of nodes on the longest path from the root.
    pub(super) depth: usize,
}

impl Tree {
    pub(super) fn build(boxes: &[Bounds]) -> Self {
        let mut order: Vec<u32> = (0..boxes.len() as u32).collect();
        if boxes.is_empty() {
            return Self::default();
        }
        let mut binary = Vec::with_capacity(boxes.len() / 2);
        let mut builder = Builder {
            boxes,
            centres: boxes.iter().map(Bounds::centre).collect(),
            nodes: &mut binary,
        };
        let root = builder.split(&mut order, 0, 0);
        let mut tree = Self {
            nodes: Vec::with_capacity(binary.len() / 4 + 1),
            order,
            depth: 0,
        };
        tree.collapse(&binary, root, 1);
        tree
    }

    /// Appends the wide node of a binary one and all its descendants.
    fn collapse(&mut self, binary: &[BinaryNode], root: u32, depth: usize) -> u32 {
        self.depth = self.depth.max(depth);
        let mut chosen = vec![root];
        loop {
            // The inner node with the largest area is the most likely to be hit.
            let inner = |&(_, &node): &(usize, &u32)| binary[node as usize].count == 0;
            let area = |node: u32| binary[node as usize].bounds.half_area();
            let largest = chosen
                .iter()
                .enumerate()
                .filter(inner)
                .max_by(|a, b| area(*a.1).total_cmp(&area(*b.1)))
                .map(|(at, &node)| (at, node));
            let Some((at, node)) = largest.filter(|_| chosen.len() < WIDTH) else {
                break;
            };
            let node = &binary[node as usize];
            chosen[at] = node.first;
            chosen.push(node.right);
        }
        let index = self.nodes.len();
        self.nodes.push(WideNode {
            children: Vec::with_capacity(chosen.len()),
        });
        for node in chosen {
            let BinaryNode {
                bounds,
                first,
                count,
                ..
            } = binary[node as usize];
            let child = match count {
                0 => Child::Node(self.collapse(binary, node, depth + 1)),
                _ => Child::Leaf { first, count },
            };
            self.nodes[index].children.push((bounds, child));
        }
        index as u32
    }
}

struct Builder<'a> {
    boxes: &'a [Bounds],
    centres: Vec<Vec3>,
    nodes: &'a mut Vec<BinaryNode>,
}

impl Builder<'_> {
    /// Appends the node of `order`, which starts at index `first` of all boxes, and its
    /// descendants.
    fn split(&mut self, order: &mut [u32], first: u32, depth: u32) -> u32 {
        let bounds = order
            .iter()
            .fold(Bounds::EMPTY, |all, &i| all.union(self.boxes[i as usize]));
        let index = self.nodes.len();
        self.nodes.push(BinaryNode {
            bounds,
            first,
            right: 0,
            count: order.len() as u32,
        });
        if order.len() <= WIDTH {
            return index as u32;
        }
        let middle = self.partition(order, depth);
        let (left, right) = order.split_at_mut(middle);
        let left = self.split(left, first, depth + 1);
        let right = self.split(right, first + middle as u32, depth + 1);
        let node = &mut self.nodes[index];
        (node.first, node.right, node.count) = (left, right, 0);
        index as u32
    }

    /// Partitions the boxes; returns the size of the first group, neither 0 nor all.
    fn partition(&self, order: &mut [u32], depth: u32) -> usize {
        let centres = order
            .iter()
            .fold(Bounds::EMPTY, |all, &i| all.with(self.centres[i as usize]));
        let found = match depth < MAX_SAH_DEPTH {
            true => self.best_split(order, &centres),
            false => None,
        };
        if let Some(plane) = found {
            let mut middle = 0;
            for at in 0..order.len() {
                if plane.bin(self.centres[order[at] as usize]) < plane.split {
                    order.swap(at, middle);
                    middle += 1;
                }
            }
            if middle > 0 && middle < order.len() {
                return middle;
            }
        }
        // All centres coincide, or too deep: halves of equal count along the longest axis.
        let axis = (centres.max - centres.min).max_position();
        let middle = order.len() / 2;
        order.select_nth_unstable_by(middle, |&a, &b| {
            let [ca, cb] = [a, b].map(|i| self.centres[i as usize][axis]);
            ca.total_cmp(&cb).then(a.cmp(&b))
        });
        middle
    }

    /// Returns the split of minimum expected cost, unless all centres coincide.
    fn best_split(&self, order: &[u32], centres: &Bounds) -> Option<SplitPlane> {
        let mut best: Option<(f32, SplitPlane)> = None;
        for axis in 0..3 {
            let extent = centres.max[axis] - centres.min[axis];
            let mut plane = SplitPlane {
                axis,
                start: centres.min[axis],
                scale: BINS as f32 / extent,
                split: 0,
            };
            if extent <= 0.0 || !plane.scale.is_finite() {
                continue;
            }
            let mut bins = [(Bounds::EMPTY, 0u32); BINS];
            for &i in order {
                let (bounds, count) = &mut bins[plane.bin(self.centres[i as usize])];
                *bounds = bounds.union(self.boxes[i as usize]);
                *count += 1;
            }
            let (split, cost) = cheapest_split(&bins);
            if cost < best.as_ref().map_or(f32::INFINITY, |b| b.0) {
                plane.split = split;
                best = Some((cost, plane));
            }
        }
        best.map(|(_, plane)| plane)
    }
}

/// Split plane between bins along an axis.
struct SplitPlane {
    axis: usize,
    start: f32,
    scale: f32,
    /// First bin of the second group.
    split: usize,
}

impl SplitPlane {
    #[inline]
    fn bin(&self, centre: Vec3) -> usize {
        (((centre[self.axis] - self.start) * self.scale) as usize).min(BINS - 1)
    }
}

/// Returns the first bin of the second group of the cheapest split, and its cost: areas times the
/// number of leaves of the groups.
fn cheapest_split(bins: &[(Bounds, u32); BINS]) -> (usize, f32) {
    let cost =
        |bounds: &Bounds, count: u32| bounds.half_area() * (count as usize).div_ceil(WIDTH) as f32;
    let mut right = [0.0; BINS];
    let mut all = (Bounds::EMPTY, 0);
    for split in (1..BINS).rev() {
        all = (all.0.union(bins[split].0), all.1 + bins[split].1);
        right[split] = match all.1 {
            0 => f32::INFINITY,
            count => cost(&all.0, count),
        };
    }
    let mut best = (0, f32::INFINITY);
    let mut all = (Bounds::EMPTY, 0);
    for split in 1..BINS {
        all = (all.0.union(bins[split - 1].0), all.1 + bins[split - 1].1);
        let total = cost(&all.0, all.1) + right[split];
        if all.1 > 0 && total < best.1 {
            best = (split, total);
        }
    }
    best
}
