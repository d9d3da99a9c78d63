//! Gradient-boosted trees (Friedman, 2001).

use serde::{Deserialize, Serialize};

/// A node of a tree.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum TreeNode {
    /// Feature, limit, and the nodes for values below the limit and for others.
    Split(u16, f32, u16, u16),
    /// Added to the score.
    Leaf(f32),
}

/// A sum of regression trees on the same features.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BoostedTrees {
    /// Added to the score.
    pub bias: f64,
    /// Nodes of each tree, the root first; children follow their parent.
    pub trees: Vec<Vec<TreeNode>>,
}

impl BoostedTrees {
    /// Score of a sample: the log-odds of a classifier.
    pub fn score(&self, features: &[f64]) -> f64 {
        let leaves = self.trees.iter().map(|tree| leaf(tree, features));
        self.bias + leaves.sum::<f64>()
    }

    /// Whether every sample of this many features has a finite score.
    pub fn is_usable(&self, features: usize) -> bool {
        let is_usable = |tree: &Vec<TreeNode>| {
            let is_usable = |(at, node): (usize, &TreeNode)| match *node {
                TreeNode::Leaf(value) => value.is_finite(),
                TreeNode::Split(feature, limit, below, above) => {
                    let follow = |child: u16| (at + 1..tree.len()).contains(&child.into());
                    usize::from(feature) < features
                        && limit.is_finite()
                        && follow(below)
                        && follow(above)
                }
            };
            !tree.is_empty() && tree.iter().enumerate().all(is_usable)
        };
        self.bias.is_finite() && self.trees.iter().all(is_usable)
    }

    /// One tree with one split.
    #[cfg(test)]
    pub(crate) fn stump(feature: u16, limit: f32, below: f32, above: f32) -> Self {
        let [below, above] = [below, above].map(TreeNode::Leaf);
        Self {
            bias: 0.0,
            trees: vec![vec![TreeNode::Split(feature, limit, 1, 2), below, above]],
        }
    }
}

/// Value of the leaf that a sample falls into; 0 in a tree that has none for it.
fn leaf(tree: &[TreeNode], features: &[f64]) -> f64 {
    let mut at = 0;
    loop {
        match tree.get(at) {
            Some(TreeNode::Leaf(value)) => return f64::from(*value),
            Some(TreeNode::Split(feature, limit, below, above)) => {
                let Some(value) = features.get(usize::from(*feature)) else {
                    return 0.0;
                };
                let next = if *value < f64::from(*limit) {
                    below
                } else {
                    above
                };
                at = usize::from(*next);
            }
            None => return 0.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn score_is_the_sum_of_the_leaves() {
        let mut trees = BoostedTrees::stump(1, 0.5, -1.0, 2.0);
        trees.trees.push(vec![
            TreeNode::Split(0, 0.0, 1, 2),
            TreeNode::Leaf(10.0),
            TreeNode::Split(1, 3.0, 4, 3),
            TreeNode::Leaf(30.0),
            TreeNode::Leaf(20.0),
        ]);
        trees.bias = 0.25;
        assert!(trees.is_usable(2));
        let cases = [
            ([-1.0, 0.4], -1.0 + 10.0),
            ([-1.0, 0.5], 2.0 + 10.0),
            ([0.0, 0.5], 2.0 + 20.0),
            ([0.0, 3.0], 2.0 + 30.0),
        ];
        for (features, expected) in cases {
            assert_eq!(trees.score(&features), 0.25 + expected, "{features:?}");
        }
        let text = serde_json::to_string(&trees).unwrap();
        assert!(text.contains("[[1,0.5,1,2],-1.0,2.0]"), "{text}");
        assert_eq!(serde_json::from_str::<BoostedTrees>(&text).unwrap(), trees);
    }

    #[test]
    fn damage_is_found() {
        assert!(!BoostedTrees::stump(1, 0.5, -1.0, 2.0).is_usable(1));
        assert!(!BoostedTrees::stump(0, f32::NAN, -1.0, 2.0).is_usable(1));
        assert!(!BoostedTrees::stump(0, 0.5, f32::INFINITY, 2.0).is_usable(1));
        let (low, high) = (TreeNode::Leaf(1.0), TreeNode::Leaf(2.0));
        // A loop, a child that is not there, no root.
        for tree in [
            vec![TreeNode::Split(0, 0.0, 0, 1), low],
            vec![TreeNode::Split(0, 0.0, 1, 3), low, high],
            vec![],
        ] {
            let trees = vec![tree];
            assert!(!BoostedTrees { bias: 0.0, trees }.is_usable(1));
        }
    }
}
