//! Elastic energy of a gel: sums of the law over the elements.

use glam::DVec3;
use pulp::Arch;

use super::assembly::{Elements, EnergySum, GradientSum, HessianSum};
use super::batch::Batch;
use super::neo_hookean::{NeoHookean, Projection};
use super::pattern::StiffnessPattern;
use super::safe_step::SafeStep;
use gripcast_base::error::{Error, Result};

/// Elastic energy of linear tetrahedra as a function of the node positions.
///
/// Positions are in m, one per node; energies in J, gradients in N, Hessians in N/m. Element sums
/// run in a fixed order on one thread, so results are deterministic.
#[derive(Clone, Debug)]
pub struct Elastic {
    law: NeoHookean,
    batches: Vec<Batch>,
    pattern: StiffnessPattern,
}

impl Elastic {
    /// Creates the energy from rest positions (m) and positively oriented tetrahedra.
    ///
    /// # Errors
    /// `Input` without tetrahedra, for an invalid node index or rest volume, or for a stiffness
    /// matrix with 2^32 entries or more.
    pub fn new(rest: &[DVec3], tets: &[[u32; 4]], law: NeoHookean) -> Result<Self> {
        if tets.is_empty() {
            return Err(invalid_mesh("no tetrahedra".to_owned()));
        }
        for (t, tet) in tets.iter().enumerate() {
            if let Some(v) = tet.iter().find(|v| **v as usize >= rest.len()) {
                let nodes = rest.len();
                return Err(invalid_mesh(format!(
                    "tetrahedron {t} refers to node {v}, but there are only {nodes}"
                )));
            }
            let [a, b, c, d] = tet.map(|v| rest[v as usize]);
            let volume = (b - a).cross(c - a).dot(d - a) / 6.0;
            if !(volume > 0.0 && volume.is_finite()) {
                return Err(invalid_mesh(format!(
                    "the volume of tetrahedron {t} must be above 0, found {volume} m³"
                )));
            }
        }
        let pattern = StiffnessPattern::new(rest.len(), tets);
        if pattern.entries() > u32::MAX as usize {
            return Err(invalid_mesh("2^32 matrix entries or more".to_owned()));
        }
        Ok(Self {
            law,
            batches: Batch::group(tets, rest, &pattern),
            pattern,
        })
    }

    /// Sparsity pattern of the Hessian.
    pub fn pattern(&self) -> &StiffnessPattern {
        &self.pattern
    }

    /// Energy in J; infinite if an element is flat or inverted, or a position is not finite.
    pub fn energy(&self, x: &[DVec3]) -> f64 {
        Arch::new().dispatch(EnergySum {
            elements: self.elements(),
            x,
        })
    }

    /// Adds the gradient in N at a state of finite energy to `gradient`.
    pub fn gradient(&self, x: &[DVec3], gradient: &mut [DVec3]) {
        Arch::new().dispatch(GradientSum {
            elements: self.elements(),
            x,
            gradient,
        });
    }

    /// Adds the Hessian in N/m at a state of finite energy to `values`, which are laid out by
    /// [`Elastic::pattern`]. Projection acts on each element, so the sum is positive semidefinite.
    pub fn hessian(&self, x: &[DVec3], projection: Projection, values: &mut [f64]) {
        let elements = self.elements();
        Arch::new().dispatch(HessianSum {
            elements,
            x,
            projection,
            values,
        });
    }

    fn elements(&self) -> Elements<'_> {
        Elements {
            law: &self.law,
            batches: &self.batches,
        }
    }

    /// Largest step size a in (0, 1] such that no element falls below a tenth of its volume at x on
    /// the way to x + a dx; zero if a position or `dx` is not finite.
    ///
    /// `x` must be a state of finite energy. The result may be slightly below the largest step
    /// size.
    pub fn inversion_free_step(&self, x: &[DVec3], dx: &[DVec3]) -> f64 {
        Arch::new().dispatch(SafeStep {
            batches: &self.batches,
            x,
            dx,
        })
    }
}

fn invalid_mesh(what: String) -> Error {
    Error::input(format!("invalid tetrahedral mesh: {what}"))
}

#[cfg(test)]
#[path = "elastic_test.rs"]
mod tests;
