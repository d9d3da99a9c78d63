//! Tetrahedral mesh of a gel on a tensor-product grid.
//!
//! Local frame: x and y in the plane of the faces, z from the back face (z = 0, driven) to the
//! front face (z = thickness, in contact). Each cell has five tetrahedra; the two possible cuts
//! alternate with the parity of the cell, so that neighbours share diagonals. Five tetrahedra per
//! cell are closer to the reference forces of a pressed gel than six (26 x 21 x 5 nodes: flat plate
//! +0.9 against +1.1 %, 10 mm sphere at 0.4 mm +0.7 against +5.7 %) with a sixth fewer elements,
//! except where the contact patch is one element wide (13 x 11 x 3, 0.2 mm).

use glam::DVec3;

use super::pad::GelPad;
use super::surface::{Surface, boundary_triangles};
use gripcast_base::error::{Error, Result, unknown_name};

/// Smallest number of cells along an axis of a pad.
const MIN_CELLS: f64 = 2.0;

/// Uniform meshes of a pad by their node spacing; the numbers are those of the default pad, 25 x 20
/// x 4 mm.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum GelResolution {
    /// 13 x 11 x 3 nodes, 1200 tetrahedra.
    Coarse,
    /// 19 x 16 x 4 nodes, 4050 tetrahedra.
    #[default]
    Default,
    /// 26 x 21 x 5 nodes, 10,000 tetrahedra.
    Fine,
}

impl GelResolution {
    /// Nodes along x, y, z of a pad: about as far apart as on the default one, at least three.
    pub fn nodes(self, pad: &GelPad) -> [usize; 3] {
        let cells: [f64; 3] = match self {
            Self::Coarse => [12.0, 10.0, 2.0],
            Self::Default => [18.0, 15.0, 3.0],
            Self::Fine => [25.0, 20.0, 4.0],
        };
        let (size, usual) = (pad.box_m(), GelPad::default().box_m());
        let nodes = |axis: usize| {
            (cells[axis] * (size[axis] / usual[axis]))
                .round()
                .max(MIN_CELLS)
        };
        [0, 1, 2].map(|axis| nodes(axis) as usize + 1)
    }

    /// Name on the command line and in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Coarse => "coarse",
            Self::Default => "default",
            Self::Fine => "fine",
        }
    }

    /// Parses the name of a mesh.
    ///
    /// # Errors
    /// `Usage` for an unknown name, with the nearest one.
    pub fn from_name(name: &str) -> Result<Self> {
        let all = [Self::Coarse, Self::Default, Self::Fine];
        let found = all.into_iter().find(|resolution| resolution.name() == name);
        found.ok_or_else(|| unknown_name("gel mesh", name, &all.map(Self::name)))
    }
}

/// A side of the gel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// z = thickness.
    Front,
    /// Smallest x.
    XMin,
    /// Largest x.
    XMax,
    /// Smallest y.
    YMin,
    /// Largest y.
    YMax,
    /// z = 0.
    Back,
}

impl Side {
    const ALL: [Self; 6] = [
        Self::Front,
        Self::XMin,
        Self::XMax,
        Self::YMin,
        Self::YMax,
        Self::Back,
    ];

    /// Axis normal to the side, and whether the side lies at its upper end.
    fn axis(self) -> (usize, bool) {
        match self {
            Self::Front => (2, true),
            Self::XMin => (0, false),
            Self::XMax => (0, true),
            Self::YMin => (1, false),
            Self::YMax => (1, true),
            Self::Back => (2, false),
        }
    }
}

/// Node spacing of [`GelGrid::graded`].
///
/// An exponent g maps a uniform parameter s in 0..1, measured from the fine end, to s^g: 1 is
/// uniform, 1.4 makes the first of 12 cells 0.37 of the mean.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Grading {
    /// Exponent towards the front face, >= 1.
    pub front: f64,
    /// Exponent towards `centre_m` in the face plane, >= 1.
    pub plane: f64,
    /// Point of the face plane with the finest spacing, x and y from the middle of the face, m.
    pub centre_m: [f64; 2],
}

impl Default for Grading {
    fn default() -> Self {
        Self {
            front: 1.0,
            plane: 1.0,
            centre_m: [0.0; 2],
        }
    }
}

/// Tetrahedral mesh of a gel at rest, in its local frame, m.
///
/// Node (i, j, k) has index i + nx (j + ny k).
#[derive(Clone, Debug)]
pub struct GelGrid {
    axes: [Vec<f64>; 3],
    positions: Vec<DVec3>,
    tets: Vec<[u32; 4]>,
    triangles: Vec<[u32; 3]>,
    side_ends: [usize; 6],
    contact: Surface,
    back: Surface,
}

impl GelGrid {
    /// Equally spaced nodes over a box of `size_m` = [x, y, thickness], x and y centred on 0.
    ///
    /// # Errors
    /// As [`GelGrid::graded`].
    pub fn uniform(nodes: [usize; 3], size_m: [f64; 3]) -> Result<Self> {
        Self::graded(nodes, size_m, Grading::default())
    }

    /// Nodes that lie closer towards the front face and towards one point of the face plane.
    ///
    /// # Errors
    /// `Input` when an axis has fewer than two nodes, a size is not positive, an exponent is
    /// below 1, or the centre is outside the face.
    pub fn graded(nodes: [usize; 3], size_m: [f64; 3], grading: Grading) -> Result<Self> {
        for axis in 0..3 {
            if nodes[axis] < 2 || !(size_m[axis] > 0.0 && size_m[axis].is_finite()) {
                return Err(invalid_grid(format!(
                    "axis {axis} has {} nodes over {} m",
                    nodes[axis], size_m[axis]
                )));
            }
        }
        let inside = (0..2).all(|a| grading.centre_m[a].abs() <= 0.5 * size_m[a]);
        let exponents = [grading.front, grading.plane];
        if !inside || !exponents.iter().all(|g| *g >= 1.0 && g.is_finite()) {
            return Err(invalid_grid(format!(
                "exponents must be >= 1 and the centre on the face, found {grading:?}"
            )));
        }
        let [x, y] = [0, 1].map(|a| {
            let half = 0.5 * size_m[a];
            towards_point(nodes[a], half, grading.centre_m[a], grading.plane)
        });
        let z = towards_end(nodes[2], size_m[2], grading.front);
        Self::new([x, y, z])
    }

    /// A grid on the given node coordinates in m, strictly increasing along x, y, z; z starts at 0.
    ///
    /// # Errors
    /// `Input` when an axis has fewer than two nodes, a coordinate is not finite or not larger
    /// than the one before it, z does not start at 0, or there are 2^31 nodes or more.
    pub fn new(axes: [Vec<f64>; 3]) -> Result<Self> {
        for (name, axis) in ["x", "y", "z"].iter().zip(&axes) {
            let rising = axis.windows(2).all(|w| w[1] > w[0]);
            if axis.len() < 2 || !rising || !axis.iter().all(|c| c.is_finite()) {
                return Err(invalid_grid(format!(
                    "the {name} coordinates must be two or more finite, rising numbers"
                )));
            }
        }
        if axes[2][0] != 0.0 {
            return Err(invalid_grid(format!(
                "z must start at 0, found {}",
                axes[2][0]
            )));
        }
        let count = axes
            .iter()
            .map(Vec::len)
            .try_fold(1_usize, usize::checked_mul);
        if count.is_none_or(|n| n >= 1 << 31) {
            return Err(invalid_grid("2^31 nodes or more".to_owned()));
        }
        Ok(Self::build(axes))
    }

    fn build(axes: [Vec<f64>; 3]) -> Self {
        let positions = node_positions(&axes);
        let tets = cell_tets([axes[0].len(), axes[1].len(), axes[2].len()], &positions);
        let boundary = boundary_triangles(&tets);
        let mut triangles = Vec::with_capacity(boundary.len());
        let mut side_ends = [0; 6];
        for (end, side) in side_ends.iter_mut().zip(Side::ALL) {
            let (axis, upper) = side.axis();
            let plane = if upper {
                axes[axis].last()
            } else {
                axes[axis].first()
            };
            let on_plane = |t: &&[u32; 3]| {
                t.iter()
                    .all(|&v| Some(&positions[v as usize][axis]) == plane)
            };
            triangles.extend(boundary.iter().filter(on_plane));
            *end = triangles.len();
        }
        let contact = Surface::new(&triangles[..side_ends[4]], &positions);
        let back = Surface::new(&triangles[side_ends[4]..], &positions);
        Self {
            axes,
            positions,
            tets,
            triangles,
            side_ends,
            contact,
            back,
        }
    }

    /// Number of nodes along x, y, z.
    pub fn nodes(&self) -> [usize; 3] {
        [self.axes[0].len(), self.axes[1].len(), self.axes[2].len()]
    }

    /// Node coordinates in m along x, y, z.
    pub fn axes(&self) -> &[Vec<f64>; 3] {
        &self.axes
    }

    /// Index of grid node (i, j, k).
    pub fn node(&self, i: usize, j: usize, k: usize) -> usize {
        i + self.axes[0].len() * (j + self.axes[1].len() * k)
    }

    /// Size of the pad.
    pub fn pad(&self) -> GelPad {
        let extent = |axis: &[f64]| match axis {
            [first, .., last] => last - first,
            _ => 0.0,
        };
        GelPad {
            size_m: [extent(&self.axes[0]), extent(&self.axes[1])],
            thickness_m: self.thickness_m(),
        }
    }

    /// Thickness in m.
    pub fn thickness_m(&self) -> f64 {
        self.axes[2].last().copied().unwrap_or(0.0)
    }

    /// Rest positions of the nodes in m.
    pub fn positions(&self) -> &[DVec3] {
        &self.positions
    }

    /// Nodes of each tetrahedron; (x1 - x0) x (x2 - x0) . (x3 - x0) > 0 at rest.
    pub fn tets(&self) -> &[[u32; 4]] {
        &self.tets
    }

    /// Triangles of one side, counter-clockwise seen from outside.
    pub fn triangles(&self, side: Side) -> &[[u32; 3]] {
        let index = Side::ALL.iter().position(|s| *s == side).unwrap_or(0);
        let start = index.checked_sub(1).map_or(0, |i| self.side_ends[i]);
        &self.triangles[start..self.side_ends[index]]
    }

    /// Surface that can touch the object: front and four sides, without the back.
    pub fn contact_surface(&self) -> &Surface {
        &self.contact
    }

    /// Nodes of the back face, ascending.
    pub fn driven(&self) -> &[u32] {
        self.back.vertices()
    }

    /// Area of the back face that each of [`GelGrid::driven`] stands for, m².
    pub fn driven_areas(&self) -> &[f64] {
        self.back.vertex_areas()
    }

    /// Lumped node masses (kg) for a density in kg/m³: a quarter of each adjacent tetrahedron.
    ///
    /// # Errors
    /// `Input` when the density is not positive and finite.
    pub fn lumped_masses(&self, density: f64) -> Result<Vec<f64>> {
        if !(density > 0.0 && density.is_finite()) {
            return Err(Error::input(format!(
                "gel density must be positive and finite, found {density} kg/m3"
            )));
        }
        let mut masses = vec![0.0; self.positions.len()];
        for tet in &self.tets {
            let quarter = density * tet_volume(tet, &self.positions) / 4.0;
            for &v in tet {
                masses[v as usize] += quarter;
            }
        }
        Ok(masses)
    }
}

fn invalid_grid(what: String) -> Error {
    Error::input(format!("invalid gel grid: {what}"))
}

/// Nodes over 0..length, finer towards `length`.
fn towards_end(nodes: usize, length: f64, exponent: f64) -> Vec<f64> {
    let cells = nodes - 1;
    (0..nodes)
        .map(|k| {
            let s = (cells - k) as f64 / cells as f64;
            length * (1.0 - s.powf(exponent))
        })
        .collect()
}

/// Nodes over -half..half, finer towards `centre`; uniform when the exponent is 1.
fn towards_point(nodes: usize, half: f64, centre: f64, exponent: f64) -> Vec<f64> {
    let cells = nodes - 1;
    if exponent == 1.0 {
        let position = |i: usize| half * ((2.0 * i as f64 - cells as f64) / cells as f64);
        return (0..nodes).map(position).collect();
    }
    // Uniform parameter of the centre; it need not be a node.
    let split = cells as f64 * (centre + half) / (2.0 * half);
    (0..nodes)
        .map(|i| {
            let t = i as f64 - split;
            if i == 0 {
                -half
            } else if i == cells {
                half
            } else if t < 0.0 {
                centre - (centre + half) * (-t / split).powf(exponent)
            } else {
                centre + (half - centre) * (t / (cells as f64 - split)).powf(exponent)
            }
        })
        .collect()
}

fn node_positions(axes: &[Vec<f64>; 3]) -> Vec<DVec3> {
    let mut positions = Vec::with_capacity(axes.iter().map(Vec::len).product());
    for &z in &axes[2] {
        for &y in &axes[1] {
            positions.extend(axes[0].iter().map(|&x| DVec3::new(x, y, z)));
        }
    }
    positions
}

/// Corners of a cell are numbered by bits: 1 = +x, 2 = +y, 4 = +z.
const EVEN_CELL: [[usize; 4]; 5] = [
    [0, 3, 5, 6],
    [1, 0, 3, 5],
    [2, 0, 3, 6],
    [4, 0, 5, 6],
    [7, 3, 5, 6],
];
const ODD_CELL: [[usize; 4]; 5] = [
    [1, 2, 4, 7],
    [0, 1, 2, 4],
    [3, 1, 2, 7],
    [5, 1, 4, 7],
    [6, 2, 4, 7],
];

fn cell_tets(n: [usize; 3], positions: &[DVec3]) -> Vec<[u32; 4]> {
    let mut tets = Vec::with_capacity(5 * (n[0] - 1) * (n[1] - 1) * (n[2] - 1));
    for k in 0..n[2] - 1 {
        for j in 0..n[1] - 1 {
            for i in 0..n[0] - 1 {
                let cuts = if (i + j + k) % 2 == 0 {
                    &EVEN_CELL
                } else {
                    &ODD_CELL
                };
                let corner = |c: usize| {
                    let (i, j, k) = (i + (c & 1), j + (c >> 1 & 1), k + (c >> 2));
                    (i + n[0] * (j + n[1] * k)) as u32
                };
                tets.extend(cuts.iter().map(|cut| oriented(cut.map(corner), positions)));
            }
        }
    }
    tets
}

fn oriented(mut tet: [u32; 4], positions: &[DVec3]) -> [u32; 4] {
    if tet_volume(&tet, positions) < 0.0 {
        tet.swap(2, 3);
    }
    tet
}

/// Signed volume in m³.
fn tet_volume(tet: &[u32; 4], positions: &[DVec3]) -> f64 {
    let [a, b, c, d] = tet.map(|v| positions[v as usize]);
    (b - a).cross(c - a).dot(d - a) / 6.0
}

#[cfg(test)]
#[path = "grid_test.rs"]
mod tests;
