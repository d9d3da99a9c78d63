//! Internals of a gel for tests.

use super::super::coupling::OBJECT_DOF;
use super::Gel;

impl Gel {
    /// Adds the assembled stiffness of the gel and of its contact times `(x, q)` to `(y, p)`.
    pub(in super::super) fn add_product(
        &self,
        (x, q): (&[f64], &[f64]),
        y: &mut [f64],
        p: &mut [f64],
    ) {
        let mut own = vec![0.0; x.len()];
        self.elastic
            .pattern()
            .multiply(&self.stiffness, x, &mut own);
        for ((y, own), (row, x)) in y.iter_mut().zip(&own).zip(self.coupling.rows.iter().zip(x)) {
            *y += own;
            for k in 0..OBJECT_DOF {
                *y += row[k] * q[k];
                p[k] += row[k] * x;
            }
        }
        for (p, row) in p.iter_mut().zip(&self.coupling.object.0) {
            *p += row.iter().zip(q).map(|(h, q)| h * q).sum::<f64>();
        }
    }
}
