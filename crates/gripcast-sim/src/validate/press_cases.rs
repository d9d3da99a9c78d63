//! Force-depth curves compared with a converged finite-element reference.

use serde::Deserialize;

use super::report::Recorder;
use crate::fem::{GelGrid, GelPad};
use crate::press::{Indenter, Press, PressTarget, half_pad, quarter_pad};
use gripcast_base::error::{Error, Result};

const REFERENCE: &str = include_str!("../../../../tests/data/press_reference.json");

/// One row of the reference.
#[derive(Clone, Copy, Debug, Deserialize)]
pub(super) struct Row {
    pub(super) depth_m: f64,
    pub(super) force_n: f64,
    #[serde(default)]
    pub(super) shift_m: f64,
    #[serde(default)]
    pub(super) shear_n: f64,
}

impl Row {
    fn target(&self) -> PressTarget {
        PressTarget {
            depth_m: self.depth_m,
            shift_m: self.shift_m,
        }
    }
}

/// Rows of a reference case: A and B spheres of radius 10 and 3 mm, C cylinder, D plate, E rounded
/// edge, F the sphere of A with friction.
///
/// # Errors
/// `Internal` if the built-in file lacks the case.
pub(super) fn reference(case: &str) -> Result<Vec<Row>> {
    #[derive(Deserialize)]
    struct Case {
        rows: Vec<Row>,
    }
    #[derive(Deserialize)]
    struct File {
        cases: std::collections::BTreeMap<String, Case>,
    }
    let mut file: File = serde_json::from_str(REFERENCE)
        .map_err(|e| Error::internal("invalid press reference").because(e))?;
    let case = file.cases.remove(case);
    case.map(|case| case.rows)
        .ok_or_else(|| Error::internal("the press reference lacks a case"))
}

/// Meshing of a press and the depths it is used for.
#[derive(Clone, Copy, Debug)]
pub(super) struct Meshing {
    /// Maximum depth, m.
    pub(super) up_to_m: f64,
    /// Cells of the quarter pad along x, y, z.
    pub(super) cells: [usize; 3],
    /// Growth factor of the cells away from the centre of the face.
    pub(super) growth: [f64; 3],
    /// Face size of the indenter, m.
    pub(super) face_m: f64,
    /// Distance below which contact acts, m.
    pub(super) d_hat_m: f64,
    /// Maximum motion per step, m.
    pub(super) step_m: f64,
}

/// A frictionless force-depth curve.
pub(super) struct Curve {
    pub(super) case: &'static str,
    pub(super) indenter: Indenter,
    /// Meshes of the full validation, by increasing depth.
    pub(super) fine: Vec<Meshing>,
    /// Meshes of the quick validation.
    pub(super) quick: Vec<Meshing>,
    /// Tolerances: maximum depth (m), relative tolerance with the fine and with the quick meshes.
    pub(super) tolerances: Vec<(f64, f64, f64)>,
}

const fn meshing(
    up_to_mm: f64,
    cells: [usize; 3],
    growth: [f64; 3],
    face_mm: f64,
    d_hat_um: f64,
    step_mm: f64,
) -> Meshing {
    Meshing {
        up_to_m: up_to_mm * 1e-3,
        cells,
        growth,
        face_m: face_mm * 1e-3,
        d_hat_m: d_hat_um * 1e-6,
        step_m: step_mm * 1e-3,
    }
}

/// Tolerance of depth comparisons, m.
const DEPTH_TOLERANCE_M: f64 = 1e-9;
/// Minimum depth for the coarse meshes of quick runs, m.
const QUICK_MIN_DEPTH_M: f64 = 1e-4;

impl Curve {
    pub(super) fn run(&self, recorder: &mut Recorder, is_quick: bool) -> Result<()> {
        let rows = reference(self.case)?;
        let meshes = if is_quick { &self.quick } else { &self.fine };
        let mut from = 0.0;
        for mesh in meshes {
            let selected: Vec<&Row> = rows
                .iter()
                .filter(|row| {
                    row.depth_m > from + DEPTH_TOLERANCE_M
                        && row.depth_m < mesh.up_to_m + DEPTH_TOLERANCE_M
                })
                .filter(|row| !is_quick || row.depth_m > QUICK_MIN_DEPTH_M - DEPTH_TOLERANCE_M)
                .collect();
            from = mesh.up_to_m;
            let targets: Vec<PressTarget> = selected.iter().map(|row| row.target()).collect();
            let grid = quarter_pad(&GelPad::default(), mesh.cells, mesh.growth)?;
            let mut press = mesh.press(grid, &self.indenter);
            press.symmetric = [true, true];
            for (point, row) in press.run(&targets)?.iter().zip(selected) {
                let fraction = self.tolerance(row.depth_m, is_quick);
                let name = format!("{} mm", rounded(1e3 * row.depth_m));
                let found = if point.converged {
                    point.normal_n
                } else {
                    f64::NAN
                };
                let pair = (row.force_n, found);
                recorder.relative(name, pair, "N", fraction);
            }
        }
        Ok(())
    }

    fn tolerance(&self, depth: f64, is_quick: bool) -> f64 {
        let found = self
            .tolerances
            .iter()
            .find(|t| depth < t.0 + DEPTH_TOLERANCE_M);
        found.map_or(0.0, |t| if is_quick { t.2 } else { t.1 })
    }
}

/// Rounds a number of millimetres to 6 decimals.
fn rounded(mm: f64) -> f64 {
    (mm * 1e6).round() / 1e6
}

impl Meshing {
    fn press(&self, grid: GelGrid, indenter: &Indenter) -> Press {
        Press {
            face_m: self.face_m,
            d_hat_m: self.d_hat_m,
            step_m: self.step_m,
            ..Press::new(grid, indenter.clone())
        }
    }
}

/// Sphere of radius 10 mm.
pub(super) fn sphere_10() -> Curve {
    Curve {
        case: "A",
        indenter: Indenter::Sphere { radius_m: 0.01 },
        fine: vec![
            meshing(0.1, [36, 34, 20], [1.1, 1.1, 1.13], 0.08, 10.0, 0.05),
            meshing(1.5, [29, 27, 15], [1.08, 1.08, 1.12], 0.15, 20.0, 0.1),
        ],
        quick: vec![meshing(
            0.6,
            [15, 13, 8],
            [1.13, 1.13, 1.15],
            0.2,
            20.0,
            0.1,
        )],
        tolerances: vec![(1e-4, 0.03, 0.12), (1.5e-3, 0.02, 0.06)],
    }
}

/// Sphere of radius 3 mm.
pub(super) fn sphere_3() -> Curve {
    Curve {
        case: "B",
        indenter: Indenter::Sphere { radius_m: 0.003 },
        fine: vec![
            meshing(0.2, [42, 40, 24], [1.1, 1.1, 1.13], 0.05, 10.0, 0.05),
            meshing(1.0, [30, 28, 16], [1.1, 1.1, 1.12], 0.12, 20.0, 0.1),
        ],
        quick: vec![meshing(0.6, [14, 12, 8], [1.2, 1.2, 1.2], 0.15, 20.0, 0.1)],
        // The contact radius spans 2.6 cells of the quick mesh at a depth of 0.1 mm (0.55 mm), and
        // 3.7 at 0.2 mm.
        tolerances: vec![(1e-4, 0.03, 0.18), (2e-4, 0.03, 0.13), (1e-3, 0.02, 0.09)],
    }
}

/// Cylinder of radius 5 mm.
pub(super) fn cylinder() -> Curve {
    Curve {
        case: "C",
        indenter: Indenter::Cylinder { radius_m: 0.005 },
        fine: vec![
            meshing(0.05, [30, 10, 14], [1.12, 1.0, 1.18], 0.06, 10.0, 0.05),
            meshing(1.0, [26, 10, 13], [1.1, 1.0, 1.15], 0.1, 20.0, 0.1),
        ],
        quick: vec![meshing(0.4, [15, 5, 8], [1.15, 1.0, 1.15], 0.2, 20.0, 0.1)],
        tolerances: vec![(5e-5, 0.03, 0.1), (1e-3, 0.02, 0.06)],
    }
}

/// Flat plate.
pub(super) fn plate() -> Curve {
    const MESH: Meshing = meshing(0.8, [14, 12, 10], [0.88, 0.88, 0.92], 1.0, 20.0, 0.1);
    const QUICK: Meshing = meshing(0.4, [8, 7, 6], [0.8, 0.8, 0.85], 1.0, 20.0, 0.1);
    Curve {
        case: "D",
        indenter: Indenter::Plate,
        fine: vec![MESH],
        quick: vec![QUICK],
        tolerances: vec![(8e-4, 0.01, 0.015)],
    }
}

/// Straight 90-degree edge with a tip radius of 0.5 mm.
pub(super) fn edge() -> Curve {
    Curve {
        case: "E",
        indenter: Indenter::Edge { radius_m: 5e-4 },
        fine: vec![meshing(
            0.6,
            [32, 10, 17],
            [1.12, 1.0, 1.18],
            0.03,
            10.0,
            0.05,
        )],
        quick: vec![meshing(0.2, [18, 4, 9], [1.25, 1.0, 1.3], 0.06, 10.0, 0.05)],
        tolerances: vec![(6e-4, 0.03, 0.08)],
    }
}

/// Sphere of radius 10 mm with friction 0.4: pressed by 0.6 mm, then shifted by 1 mm.
pub(super) fn friction(recorder: &mut Recorder, is_quick: bool) -> Result<()> {
    let (mesh, tolerances) = if is_quick {
        let mesh = meshing(0.6, [9, 8, 6], [1.2, 1.2, 1.25], 0.3, 20.0, 0.1);
        // The contact radius of 2.4 mm spans four cells.
        (mesh, [0.12, 0.12])
    } else {
        let mesh = meshing(0.6, [25, 23, 14], [1.09, 1.09, 1.14], 0.15, 20.0, 0.025);
        (mesh, [0.03, 0.04])
    };
    let keep = |row: &Row| !is_quick || row.depth_m > 5e-4 && row.shift_m < 5.5e-4;
    let rows: Vec<Row> = reference("F")?.into_iter().filter(keep).collect();
    let targets: Vec<PressTarget> = rows.iter().map(Row::target).collect();
    let grid = half_pad(&GelPad::default(), mesh.cells, mesh.growth)?;
    let mut press = mesh.press(grid, &Indenter::Sphere { radius_m: 0.01 });
    press.symmetric = [false, true];
    press.friction = 0.4;
    press.slip_m = 2e-7;
    for (point, row) in press.run(&targets)?.iter().zip(&rows) {
        let name = format!(
            "{} mm, shift {} mm",
            rounded(1e3 * row.depth_m),
            rounded(1e3 * row.shift_m)
        );
        let pair = (row.force_n, point.normal_n);
        recorder.relative(format!("{name}: N"), pair, "N", tolerances[0]);
        if row.shift_m > 4.5e-4 {
            let ratio = point.shear_n / point.normal_n;
            recorder.absolute(format!("{name}: T/N"), (0.405, ratio), "", 0.005);
        } else if row.shift_m > 0.0 {
            let pair = (row.shear_n, point.shear_n);
            recorder.relative(format!("{name}: T"), pair, "N", tolerances[1]);
        }
    }
    Ok(())
}
