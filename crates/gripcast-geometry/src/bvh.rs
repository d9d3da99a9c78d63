//! Static bounding volume hierarchy (BVH) of boxes, built by the surface area heuristic.

use super::aabb::Aabb;

/// Maximum number of boxes in a leaf.
const MAX_LEAF_SIZE: usize = 4;
/// Number of bins for the search of a split plane.
const BINS: usize = 16;
/// Depth below which nodes are split into equal halves, which bounds the depth of the tree.
const MAX_SAH_DEPTH: u32 = 40;
/// Maximum stack size of a traversal: `MAX_SAH_DEPTH` plus the halvings of 2³² boxes.
const MAX_STACK: usize = 80;

/// A node; the left child of an inner node follows it directly.
#[derive(Clone, Debug)]
struct Node {
    bounds: Aabb,
    /// Inner node: index of the right child. Leaf: first entry in `order`.
    right_or_first: u32,
    /// Number of boxes of a leaf; 0 for an inner node.
    count: u32,
}

/// Static hierarchy over a slice of boxes; queries return indices into that slice.
///
/// The tree, and thus the order of the results, depends on the boxes alone.
#[derive(Clone, Debug, Default)]
pub struct Bvh {
    nodes: Vec<Node>,
    /// Index of the box behind each slot of a leaf.
    order: Vec<u32>,
    /// The boxes in the order of the slots.
    leaf_boxes: Vec<Aabb>,
}

impl Bvh {
    /// Builds the hierarchy. Boxes must not contain NaN; an empty slice gives an empty tree.
    pub fn build(boxes: &[Aabb]) -> Self {
        let mut order: Vec<u32> = (0..boxes.len() as u32).collect();
        let mut nodes = Vec::with_capacity(boxes.len());
        if !boxes.is_empty() {
            build_node(boxes, &mut order, 0, 0, &mut nodes);
        }
        let leaf_boxes = order.iter().map(|&i| boxes[i as usize]).collect();
        Self {
            nodes,
            order,
            leaf_boxes,
        }
    }

    /// Number of boxes.
    pub fn len(&self) -> usize {
        self.order.len()
    }

    /// Whether there are no boxes.
    pub fn is_empty(&self) -> bool {
        self.order.is_empty()
    }

    /// Bounding box of all boxes.
    pub fn bounds(&self) -> Aabb {
        self.nodes.first().map_or(Aabb::EMPTY, |root| root.bounds)
    }

    /// Indices of the boxes in leaf order: queries read data stored in this order sequentially.
    pub fn leaf_order(&self) -> &[u32] {
        &self.order
    }

    /// Calls `visit` with the index of each box that overlaps or touches `query`.
    #[inline]
    pub fn for_each_overlap(&self, query: &Aabb, mut visit: impl FnMut(u32)) {
        self.search(
            |bounds| bounds.intersects(query),
            |slot| {
                if self.leaf_boxes[slot].intersects(query) {
                    visit(self.order[slot]);
                }
                false
            },
        );
    }

    /// Depth-first traversal of the nodes that `enter` accepts. `visit` receives positions in
    /// [`Bvh::leaf_order`] and stops the traversal by returning true. Returns whether it stopped.
    pub fn search(
        &self,
        mut enter: impl FnMut(&Aabb) -> bool,
        visit: impl FnMut(usize) -> bool,
    ) -> bool {
        self.search_nodes(|_, bounds| enter(bounds), visit)
    }

    /// [`Bvh::search`] with the index of the node, as in the result of [`Bvh::summaries`].
    pub(super) fn search_nodes(
        &self,
        mut enter: impl FnMut(usize, &Aabb) -> bool,
        mut visit: impl FnMut(usize) -> bool,
    ) -> bool {
        if self.nodes.is_empty() {
            return false;
        }
        let mut stack = [0u32; MAX_STACK];
        let mut depth = 1;
        while depth > 0 {
            depth -= 1;
            let index = stack[depth];
            let node = &self.nodes[index as usize];
            if !enter(index as usize, &node.bounds) {
                continue;
            }
            if node.count == 0 {
                stack[depth] = node.right_or_first;
                stack[depth + 1] = index + 1;
                depth += 2;
                continue;
            }
            let first = node.right_or_first as usize;
            if (first..first + node.count as usize).any(&mut visit) {
                return true;
            }
        }
        false
    }

    /// A value for each node: of a leaf from its positions in [`Bvh::leaf_order`], of an inner node
    /// from the values of its children.
    pub(super) fn summaries<T: Clone>(
        &self,
        leaf: impl Fn(std::ops::Range<usize>) -> T,
        join: impl Fn(&T, &T) -> T,
    ) -> Vec<T> {
        // Children follow their parent: the list is made from its end.
        let mut from_last: Vec<T> = Vec::with_capacity(self.nodes.len());
        let all = self.nodes.len();
        for (index, node) in self.nodes.iter().enumerate().rev() {
            let first = node.right_or_first as usize;
            let value = if node.count > 0 {
                leaf(first..first + node.count as usize)
            } else {
                let child = |node: usize| &from_last[all - 1 - node];
                join(child(index + 1), child(first))
            };
            from_last.push(value);
        }
        from_last.reverse();
        from_last
    }

    /// Branch and bound: visits near leaves first and skips nodes whose `lower_bound` is not below
    /// the best value so far. `visit` receives a position in [`Bvh::leaf_order`] and the best value
    /// and returns the new best value. Returns the final best value.
    pub fn minimise(
        &self,
        mut best: f64,
        lower_bound: impl Fn(&Aabb) -> f64,
        mut visit: impl FnMut(usize, f64) -> f64,
    ) -> f64 {
        if self.nodes.is_empty() {
            return best;
        }
        let mut stack = [(0u32, 0.0f64); MAX_STACK];
        stack[0] = (0, lower_bound(&self.nodes[0].bounds));
        let mut depth = 1;
        while depth > 0 {
            depth -= 1;
            let (index, bound) = stack[depth];
            if bound >= best {
                continue;
            }
            let node = &self.nodes[index as usize];
            if node.count > 0 {
                let first = node.right_or_first as usize;
                for slot in first..first + node.count as usize {
                    best = visit(slot, best);
                }
                continue;
            }
            let left = (
                index + 1,
                lower_bound(&self.nodes[index as usize + 1].bounds),
            );
            let right = (
                node.right_or_first,
                lower_bound(&self.nodes[node.right_or_first as usize].bounds),
            );
            let (near, far) = if left.1 <= right.1 {
                (left, right)
            } else {
                (right, left)
            };
            stack[depth] = far;
            stack[depth + 1] = near;
            depth += 2;
        }
        best
    }
}

/// Appends the subtree over `order`, whose first entry has position `first` in the leaf order.
fn build_node(boxes: &[Aabb], order: &mut [u32], first: u32, depth: u32, nodes: &mut Vec<Node>) {
    let bounds = order
        .iter()
        .fold(Aabb::EMPTY, |all, &i| all.union(&boxes[i as usize]));
    let index = nodes.len();
    nodes.push(Node {
        bounds,
        right_or_first: first,
        count: order.len() as u32,
    });
    if order.len() <= MAX_LEAF_SIZE {
        return;
    }
    let middle = split(boxes, order, depth);
    let (left, right) = order.split_at_mut(middle);
    build_node(boxes, left, first, depth + 1, nodes);
    nodes[index].right_or_first = nodes.len() as u32;
    nodes[index].count = 0;
    build_node(boxes, right, first + middle as u32, depth + 1, nodes);
}

/// Partitions `order`; returns the size of the left part, which is never 0 nor all.
fn split(boxes: &[Aabb], order: &mut [u32], depth: u32) -> usize {
    let centers = Aabb::from_points(order.iter().map(|&i| boxes[i as usize].center()));
    let extent = centers.extent();
    let axis = extent.max_position();
    if depth < MAX_SAH_DEPTH && extent[axis] > 0.0 {
        let scale = BINS as f64 / extent[axis];
        let bin = |i: u32| {
            let offset = boxes[i as usize].center()[axis] - centers.min[axis];
            ((offset * scale) as usize).min(BINS - 1)
        };
        if let Some(plane) = cheapest_plane(boxes, order, &bin) {
            let left = partition(order, |i| bin(i) <= plane);
            if left > 0 && left < order.len() {
                return left;
            }
        }
    }
    // Equal halves; the index breaks ties to keep the tree deterministic.
    let middle = order.len() / 2;
    order.select_nth_unstable_by(middle, |&a, &b| {
        let key = |i: u32| boxes[i as usize].center()[axis];
        key(a).total_cmp(&key(b)).then(a.cmp(&b))
    });
    middle
}

/// The bin after which a split minimises Σ area · count.
fn cheapest_plane(boxes: &[Aabb], order: &[u32], bin: &impl Fn(u32) -> usize) -> Option<usize> {
    let mut bounds = [Aabb::EMPTY; BINS];
    let mut counts = [0usize; BINS];
    for &i in order {
        let b = bin(i);
        bounds[b] = bounds[b].union(&boxes[i as usize]);
        counts[b] += 1;
    }
    let mut right_cost = [0.0; BINS];
    let (mut area, mut count) = (Aabb::EMPTY, 0);
    for b in (1..BINS).rev() {
        area = area.union(&bounds[b]);
        count += counts[b];
        right_cost[b - 1] = area.half_area() * count as f64;
    }
    let (mut area, mut count) = (Aabb::EMPTY, 0);
    let mut best = None;
    for b in 0..BINS - 1 {
        area = area.union(&bounds[b]);
        count += counts[b];
        let cost = area.half_area() * count as f64 + right_cost[b];
        if count > 0 && count < order.len() && best.is_none_or(|(min, _)| cost < min) {
            best = Some((cost, b));
        }
    }
    best.map(|(_, b)| b)
}

/// Moves the entries that satisfy `is_left` to the front, preserving order; returns their number.
fn partition(order: &mut [u32], is_left: impl Fn(u32) -> bool) -> usize {
    let (left, right): (Vec<u32>, Vec<u32>) = order.iter().partition(|&&i| is_left(i));
    order[..left.len()].copy_from_slice(&left);
    order[left.len()..].copy_from_slice(&right);
    left.len()
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use rand::{Rng, RngExt as _, SeedableRng as _};

    fn random_boxes(count: usize, rng: &mut impl Rng) -> Vec<Aabb> {
        let mut point = |scale: f64| {
            DVec3::from_array([rng.random::<f64>(), rng.random(), rng.random()]) * scale
        };
        (0..count)
            .map(|_| {
                let corner = point(1.0);
                Aabb::from_points([corner, corner + point(0.1)])
            })
            .collect()
    }

    #[test]
    fn overlaps_match_brute_force() {
        let mut rng = rand_pcg::Pcg64Mcg::seed_from_u64(1);
        for count in [0, 1, 4, 5, 300] {
            let boxes = random_boxes(count, &mut rng);
            let bvh = Bvh::build(&boxes);
            for query in random_boxes(50, &mut rng) {
                let mut found = Vec::new();
                bvh.for_each_overlap(&query, |i| found.push(i));
                found.sort_unstable();
                let expected: Vec<u32> = (0..count as u32)
                    .filter(|&i| boxes[i as usize].intersects(&query))
                    .collect();
                assert_eq!(found, expected);
            }
        }
    }

    #[test]
    fn minimise_finds_the_nearest_box() {
        let mut rng = rand_pcg::Pcg64Mcg::seed_from_u64(2);
        let boxes = random_boxes(200, &mut rng);
        let bvh = Bvh::build(&boxes);
        for query in random_boxes(50, &mut rng) {
            let p = query.min * 2.0;
            let found = bvh.minimise(
                f64::INFINITY,
                |bounds| bounds.distance_squared(p),
                |slot, best| {
                    let i = bvh.leaf_order()[slot] as usize;
                    best.min(boxes[i].distance_squared(p))
                },
            );
            let expected = boxes.iter().map(|b| b.distance_squared(p));
            assert_eq!(found, expected.fold(f64::INFINITY, f64::min));
        }
    }

    #[test]
    fn coincident_boxes_make_a_balanced_tree() {
        let boxes = vec![Aabb::from_points([DVec3::ZERO]); 10_000];
        let bvh = Bvh::build(&boxes);
        let mut found = 0;
        bvh.for_each_overlap(&boxes[0], |_| found += 1);
        assert_eq!(found, boxes.len());
    }

    #[test]
    fn geometric_series_does_not_overflow_the_stack() {
        // Each box lies at half the distance of the previous one: splits peel off one bin at a
        // time.
        let boxes: Vec<Aabb> = (0..1000)
            .map(|i| Aabb::from_points([DVec3::X * 0.5f64.powi(i)]))
            .collect();
        let bvh = Bvh::build(&boxes);
        let mut found = 0;
        bvh.for_each_overlap(&bvh.bounds(), |_| found += 1);
        assert_eq!(found, boxes.len());
    }
}
