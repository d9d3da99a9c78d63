//! Parameters of an indentation test as users give them.

use super::indenter::Indenter;
use super::run::{Press, PressPoint, PressTarget, half_pad, quarter_pad};
use crate::fem::{GelGrid, GelPad, GelResolution, Grading};
use crate::solver::GelMaterial;
use gripcast_base::error::{Error, Result};

/// Gel mesh of a press.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PressGel {
    /// The whole gel.
    Whole(GelResolution),
    /// A quarter (with shear: half) of the gel by symmetry, refined towards the middle; not for mesh
    /// indenters.
    Refined,
}

/// An indentation test of the default pad.
#[derive(Clone, Debug)]
pub struct PressSetup {
    /// Indenter above the centre of the gel.
    pub indenter: Indenter,
    /// Gel mesh.
    pub gel: PressGel,
    /// Grading of a whole gel's mesh; uniform by default.
    pub grading: Grading,
    /// Depths from first touch, in this order, m.
    pub depths_m: Vec<f64>,
    /// Shear displacements along the gel's x axis at the last depth, m.
    pub shifts_m: Vec<f64>,
    /// Coulomb friction coefficient.
    pub friction: f64,
    /// Young's modulus of the gel, Pa.
    pub young_pa: f64,
    /// Poisson's ratio of the gel.
    pub poisson: f64,
    /// Distance below which contact acts, m.
    pub d_hat_m: f64,
    /// Stiffness of the contact barrier, Pa.
    pub kappa_pa: f64,
    /// Face size of the indenter mesh, m.
    pub face_m: f64,
}

impl PressSetup {
    /// Depths of a press unless others are given, m.
    pub const DEPTHS_M: [f64; 6] = [1e-4, 2e-4, 4e-4, 6e-4, 8e-4, 1e-3];

    /// A press without friction and shear at [`Self::DEPTHS_M`].
    #[must_use]
    pub fn new(indenter: Indenter) -> Self {
        let material = GelMaterial::default();
        Self {
            indenter,
            gel: PressGel::Whole(GelResolution::Default),
            grading: Grading::default(),
            depths_m: Self::DEPTHS_M.to_vec(),
            shifts_m: Vec::new(),
            friction: 0.0,
            young_pa: material.young_pa,
            poisson: material.poisson,
            d_hat_m: 2e-5,
            kappa_pa: 3e6,
            face_m: 2e-4,
        }
    }

    /// The press and its targets.
    ///
    /// # Errors
    /// `Usage` without a depth, or for a refined gel under a mesh; `Config` for a grading out of
    /// range.
    pub fn build(self) -> Result<(Press, Vec<PressTarget>)> {
        let Some(&last) = self.depths_m.last() else {
            return Err(Error::usage("a press needs a depth").remedy("pass --depth-m"));
        };
        let goal = |depth_m: f64, shift_m: f64| PressTarget { depth_m, shift_m };
        let normal = self.depths_m.iter().map(|&depth| goal(depth, 0.0));
        let shear = self.shifts_m.iter().map(|&shift| goal(last, shift));
        let targets = normal.chain(shear).collect();
        let (grid, symmetric) = self.grid()?;
        let mut press = Press::new(grid, self.indenter);
        press.symmetric = symmetric;
        press.friction = self.friction;
        press.material = GelMaterial {
            young_pa: self.young_pa,
            poisson: self.poisson,
            ..GelMaterial::default()
        };
        press.d_hat_m = self.d_hat_m;
        press.kappa_pa = self.kappa_pa;
        press.face_m = self.face_m;
        Ok((press, targets))
    }

    fn grid(&self) -> Result<(GelGrid, [bool; 2])> {
        let pad = GelPad::default();
        match self.gel {
            PressGel::Whole(resolution) => {
                let nodes = resolution.nodes(&pad);
                let grid = GelGrid::graded(nodes, pad.box_m(), self.grading)?;
                Ok((grid, [false; 2]))
            }
            PressGel::Refined if matches!(self.indenter, Indenter::Mesh(_)) => Err(Error::usage(
                "`--gel refined` needs a symmetric indenter, found a mesh",
            )),
            PressGel::Refined if self.shifts_m.is_empty() => {
                let grid = quarter_pad(&pad, [27, 25, 14], [1.1, 1.1, 1.13])?;
                Ok((grid, [true; 2]))
            }
            PressGel::Refined => {
                let grid = half_pad(&pad, [19, 17, 12], [1.1, 1.1, 1.15])?;
                Ok((grid, [false, true]))
            }
        }
    }
}

/// Warns of points at which the gel feels no force.
#[must_use]
pub fn points_without_force(points: &[PressPoint]) -> Vec<String> {
    let loose = points.iter().filter(|p| p.converged && p.normal_n <= 0.0);
    let depths: Vec<String> = loose.map(|p| format!("{:.3}", 1e3 * p.depth_m)).collect();
    if depths.is_empty() {
        return Vec::new();
    }
    vec![format!(
        "the gel feels no force at a depth of {} mm: the indenter does not touch it there",
        depths.join(", ")
    )]
}
