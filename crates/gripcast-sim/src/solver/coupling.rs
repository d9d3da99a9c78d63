//! Generalised forces and stiffness of contact on the object's 12 unknowns, and the stiffness
//! between these and the nodes of one gel.
//!
//! Order of the unknowns: p, then the columns of A, so that a material point X moves by
//! `dx = Σ s_k dq_k` with `s = (1, X)` and four blocks of three unknowns.

use glam::{DMat3, DVec3};

use crate::affine::{Matrix12, Vector12, add_point_gradient, add_point_hessian, axis_weights};

/// Degrees of freedom of the object.
pub(super) const OBJECT_DOF: usize = 12;

/// Gradient with respect to the object's unknowns.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct GeneralisedForce(pub(super) Vector12);

impl GeneralisedForce {
    /// Adds a gradient with respect to the world position of a material point.
    #[inline]
    pub(super) fn add(&mut self, gradient: DVec3, material: DVec3) {
        add_point_gradient(material, gradient, &mut self.0);
    }

    /// Adds a gradient with respect to a vector that is `material` in the object's frame.
    #[inline]
    pub(super) fn add_edge(&mut self, gradient: DVec3, material: DVec3) {
        self.add(gradient, material);
        self.0[0] -= gradient.x;
        self.0[1] -= gradient.y;
        self.0[2] -= gradient.z;
    }

    pub(super) fn add_all(&mut self, other: &Self) {
        for (a, b) in self.0.iter_mut().zip(other.0) {
            *a += b;
        }
    }
}

/// Stiffness of the object's own unknowns.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct ObjectStiffness(pub(super) Matrix12);

impl Default for ObjectStiffness {
    fn default() -> Self {
        Self([[0.0; OBJECT_DOF]; OBJECT_DOF])
    }
}

impl ObjectStiffness {
    /// Adds a stiffness with respect to the position of a material point.
    pub(super) fn add_block(&mut self, block: &DMat3, material: DVec3) {
        add_point_hessian(material, material, block, &mut self.0);
    }

    /// Adds a stiffness with respect to a vector that is `material` in the object's frame.
    pub(super) fn add_edge_block(&mut self, block: &DMat3, material: DVec3) {
        let columns = block.to_cols_array_2d();
        for k in 0..3 {
            for l in 0..3 {
                let s = material[k] * material[l];
                for (c, column) in columns.iter().enumerate() {
                    for (r, value) in column.iter().enumerate() {
                        self.0[3 + 3 * k + r][3 + 3 * l + c] += s * value;
                    }
                }
            }
        }
    }
}

/// Stiffness that the contact of one gel adds outside the gel's own block.
#[derive(Clone, Debug, Default)]
pub(super) struct Coupling {
    /// Rows of the gel's unknowns against the object's.
    pub(super) rows: Vec<[f64; OBJECT_DOF]>,
    /// Contribution to the object's own block.
    pub(super) object: ObjectStiffness,
}

impl Coupling {
    /// Resets to zero for a gel of `unknowns` unknowns.
    pub(super) fn clear(&mut self, unknowns: usize) {
        self.rows.clear();
        self.rows.resize(unknowns, [0.0; OBJECT_DOF]);
        self.object = ObjectStiffness::default();
    }

    /// Adds the stiffness between a node and a material point.
    pub(super) fn add_gel_block(&mut self, node: usize, block: &DMat3, material: DVec3) {
        let columns = block.to_cols_array_2d();
        for (k, s) in axis_weights(material).into_iter().enumerate() {
            for (c, column) in columns.iter().enumerate() {
                for (r, value) in column.iter().enumerate() {
                    self.rows[3 * node + r][3 * k + c] += s * value;
                }
            }
        }
    }
}
