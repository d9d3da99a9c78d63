//! Where something touches the gel, gel markers or not.

use image::{Rgb, RgbImage};

use gripcast_base::error::Result;
use gripcast_imaging::{ContactCells, GelCells, GelChange, MIN_CONTACT_FRACTION};

/// Pixels around a gel marker that its colour reaches.
const HALO_PX: f32 = 2.5;

/// The area in contact, by cells.
#[derive(Clone, Debug)]
pub(crate) struct ContactArea {
    /// Cells that are in contact, row-major; holes and flat parts are filled.
    cells: Vec<bool>,
    size: [f32; 2],
}

impl ContactArea {
    /// The area between two images; `None` without contact.
    pub(crate) fn between(initial: &GelCells, now: &GelCells, size: [u32; 2]) -> Option<Self> {
        let (change, contact) = GelChange::with_contact(initial, now, 0.0);
        (change.contact_fraction >= MIN_CONTACT_FRACTION).then(|| Self {
            cells: filled(&contact),
            size: size.map(|side| side as f32),
        })
    }

    /// Whether a pixel is in contact.
    pub(crate) fn contains(&self, position: [f32; 2]) -> bool {
        let [column, row] = [0, 1].map(|axis| {
            let cells = ContactCells::GRID[axis];
            let at = (position[axis] + 0.5) / self.size[axis] * cells as f32;
            (at.max(0.0) as usize).min(cells - 1)
        });
        self.cells[row * ContactCells::GRID[0] + column]
    }

    /// Fraction of the image that is in contact.
    pub(crate) fn fraction(&self) -> f32 {
        self.cells.iter().filter(|cell| **cell).count() as f32 / self.cells.len() as f32
    }
}

/// Contact structure is the rim and the slopes of a contact: a cell with structure on both sides in
/// its row and in its column is inside.
fn filled(contact: &ContactCells) -> Vec<bool> {
    let [columns, rows] = ContactCells::GRID;
    let cells = contact.cells();
    let extent = |line: &mut dyn Iterator<Item = usize>| {
        let mut ends = None;
        for (i, at) in line.enumerate() {
            if cells[at] {
                ends = Some(ends.map_or((i, i), |(first, _)| (first, i)));
            }
        }
        ends
    };
    let across: Vec<_> = (0..rows)
        .map(|row| extent(&mut (0..columns).map(|column| row * columns + column)))
        .collect();
    let down: Vec<_> = (0..columns)
        .map(|column| extent(&mut (0..rows).map(|row| row * columns + column)))
        .collect();
    let is_between =
        |ends: Option<(usize, usize)>, i: usize| ends.is_some_and(|(a, b)| (a..=b).contains(&i));
    let is_inside = |i: usize| {
        let (row, column) = (i / columns, i % columns);
        is_between(across[row], column) && is_between(down[column], row)
    };
    (0..columns * rows)
        .map(|i| cells[i] || is_inside(i))
        .collect()
}

/// Cells of the skin between the gel markers: each row of a gel marker is replaced by the colours
/// at its two ends.
///
/// # Errors
/// As [`GelCells::new`].
pub(crate) fn skin_cells(
    image: &RgbImage,
    dots: impl Iterator<Item = [f32; 2]>,
    diameter: f32,
) -> Result<GelCells> {
    let mut skin = image.clone();
    let (width, height) = (image.width() as i32, image.height() as i32);
    let radius = 0.5 * diameter + HALO_PX;
    for [x, y] in dots {
        for row in ((y - radius).ceil() as i32).max(0)..=((y + radius) as i32).min(height - 1) {
            let half = (radius * radius - (row as f32 - y).powi(2)).max(0.0).sqrt();
            let (left, right) = ((x - half).floor() as i32 - 1, (x + half).ceil() as i32 + 1);
            let pixel = |column: i32| image.get_pixel(column as u32, row as u32).0;
            let ends = match (left >= 0, right < width) {
                (true, true) => [pixel(left), pixel(right)],
                (true, false) if left < width => [pixel(left); 2],
                (false, true) if right >= 0 => [pixel(right); 2],
                _ => continue,
            };
            for column in (left + 1).max(0)..right.min(width) {
                let weight = (column - left) as f32 / (right - left) as f32;
                let colour = [0, 1, 2].map(|c| {
                    let [a, b] = ends.map(|end| f32::from(end[c]));
                    (a + weight * (b - a)).round() as u8
                });
                skin.put_pixel(column as u32, row as u32, Rgb(colour));
            }
        }
    }
    GelCells::new(&skin)
}
