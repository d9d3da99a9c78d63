//! Whether images of a gel are those that a GelSight Mini sends: colour order, orientation, levels.
//!
//! Red shines on a Mini's gel from the bottom of the image, green and blue from the top, green from
//! the right and blue from the left. So red grows downwards relative to the other channels and blue
//! upwards: by 0.20 to 0.45 and −0.15 to −0.32 (change of the logarithm from the middle to the edge)
//! in images of five sources, with and without gel markers, open and in contact. On all
//! of them red is also darker than blue. Left and right look alike until something presses: then
//! green brightens the slopes on the right of a contact. Another sensor has another pattern, and
//! nothing is said of it.

use super::cells::{CELLS, COLUMNS, GelCells, ROWS, quantile};
use super::monitor::{BLACK_LEVEL, DEAD_LAMP_LEVEL, LIT_LEVEL};

/// Minimum gradient of red and of blue, opposite to each other, change of the logarithm.
const MIN_GRADIENT: f64 = 0.06;
/// Minimum ratio of the levels of blue and red, or of red and blue.
const MIN_COLOUR_RATIO: f32 = 1.05;
/// Mean levels of a Mini: images of real ones have 88 to 120. The square root of a level, or its
/// square, as a gamma of 2.2 does, leads beyond.
const USUAL_LEVELS: std::ops::RangeInclusive<f32> = 55.0..=145.0;
/// Change of a cell in contact, grey levels.
const CONTACT_LEVELS: f32 = 4.0;
/// Minimum number of such cells for the orientation of a contact.
const MIN_CELLS: usize = 8;
/// Moment of green about the middle of a contact, from left to right and relative to the change,
/// below which the image looks mirrored. Of 70 real contacts of 35 grasps 54 are above 0.01 and 7
/// below −0.01, never both of a grasp.
const MIRRORED_MOMENT: f32 = -0.01;
/// Offset of the logarithm, grey levels: dark cells are noise.
const LOG_OFFSET: f32 = 5.0;

/// Difference of a turned image from the turned initial one, fraction of that from the initial one as
/// it is: at most 0.3 for recorded contacts, at least 0.69 for contacts of the virtual rig that turn
/// the light.
const MAX_TURNED_DIFFERENCE: f32 = 0.5;

/// Why images are not those that a GelSight Mini sends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ViewProblem {
    /// All channels, or those of some lamps, are dark.
    Dark,
    /// Red and blue are exchanged.
    ColourOrder,
    /// The image is upside down: flipped, or rotated by 180°.
    UpsideDown,
    /// The image is rotated by 90°.
    Rotated,
    /// Left and right look exchanged; certain only if both gels of a grasp look so.
    Mirrored,
    /// The levels are those of another gamma, or far from any exposure that is usual.
    Levels,
}

impl ViewProblem {
    /// Judges an initial image and a later one of the same gel.
    pub(super) fn of(initial: &GelCells, now: &GelCells) -> Option<Self> {
        match (View::of(initial), View::of(now)) {
            (View::Told(problem), _) => Some(problem),
            (_, View::Told(problem)) => {
                // A strong contact may turn the pattern of the light, but not the whole image.
                let is_turn = matches!(problem, Self::UpsideDown | Self::Rotated);
                (!is_turn || is_turned(initial, now)).then_some(problem)
            }
            (View::Mini, View::Mini) => is_mirrored(initial, now).then_some(Self::Mirrored),
            _ => None,
        }
    }

    /// What is wrong with the image of a gel, part of a sentence.
    #[must_use]
    pub fn what(self) -> &'static str {
        match self {
            Self::Dark => "is dark or lacks the light of a lamp",
            Self::ColourOrder => "has red and blue exchanged (BGR instead of RGB)",
            Self::UpsideDown => "is upside down",
            Self::Rotated => "is rotated by 90°",
            Self::Mirrored => "is mirrored",
            Self::Levels => "has the levels of another gamma or exposure",
        }
    }

    /// What to do about it.
    #[must_use]
    pub fn remedy(self) -> &'static str {
        match self {
            Self::Dark => "check plug and lamps of the sensor",
            Self::ColourOrder => "convert the image to RGB (OpenCV reads BGR)",
            Self::UpsideDown | Self::Rotated | Self::Mirrored => {
                "give the image as the camera sends it"
            }
            Self::Levels => "give sRGB images, and set the exposure as at the training",
        }
    }
}

/// What one image looks like.
enum View {
    /// The pattern of a GelSight Mini.
    Mini,
    /// That pattern, changed.
    Told(ViewProblem),
    /// None of these.
    Other,
}

impl View {
    fn of(cells: &GelCells) -> Self {
        let levels = cells.mean_levels();
        let [red, _, blue] = levels;
        let brightest = levels.into_iter().fold(0.0, f32::max);
        let darkest = levels.into_iter().fold(f32::INFINITY, f32::min);
        if brightest < BLACK_LEVEL || (darkest < DEAD_LAMP_LEVEL && brightest > LIT_LEVEL) {
            return Self::Told(ViewProblem::Dark);
        }
        let [across, down] = gradients(cells);
        let grows =
            |gradients: &[f64; 3]| gradients[0] > MIN_GRADIENT && gradients[2] < -MIN_GRADIENT;
        let falls = |gradients: &[f64; 3]| grows(&gradients.map(|gradient| -gradient));
        let is_rgb = blue > MIN_COLOUR_RATIO * red;
        let is_bgr = red > MIN_COLOUR_RATIO * blue;
        let is_upright = grows(&down);
        let is_reversed = falls(&down);
        if is_bgr && (is_upright || is_reversed) {
            return Self::Told(ViewProblem::ColourOrder);
        }
        if is_rgb && is_reversed {
            return Self::Told(ViewProblem::UpsideDown);
        }
        let is_across = grows(&across) || falls(&across);
        if is_rgb && is_across && !is_upright {
            return Self::Told(ViewProblem::Rotated);
        }
        if !(is_rgb && is_upright) {
            return Self::Other;
        }
        let mean = levels.iter().sum::<f32>() / 3.0;
        match USUAL_LEVELS.contains(&mean) {
            true => Self::Mini,
            false => Self::Told(ViewProblem::Levels),
        }
    }
}

/// Whether an image resembles the initial one clearly more once that is turned.
fn is_turned(initial: &GelCells, now: &GelCells) -> bool {
    let difference = |source: &dyn Fn(usize, usize) -> (usize, usize)| -> f32 {
        let of_cell = |i: usize| {
            let (column, row) = source(i % COLUMNS, i / COLUMNS);
            let from = row * COLUMNS + column;
            let channels = now.levels.iter().zip(&initial.levels);
            channels
                .map(|(now, initial)| (now[i] - initial[from]).abs())
                .sum::<f32>()
        };
        (0..COLUMNS * ROWS).map(of_cell).sum()
    };
    let (last_column, last_row) = (COLUMNS - 1, ROWS - 1);
    let as_it_is = difference(&|column, row| (column, row));
    let turned = [
        difference(&|column, row| (column, last_row - row)),
        difference(&|column, row| (last_column - column, last_row - row)),
        difference(&|column, row| (row * COLUMNS / ROWS, last_row - column * ROWS / COLUMNS)),
        difference(&|column, row| (last_column - row * COLUMNS / ROWS, column * ROWS / COLUMNS)),
    ];
    turned
        .into_iter()
        .any(|turned| turned < MAX_TURNED_DIFFERENCE * as_it_is)
}

/// Gradients across and down of the logarithm of each channel relative to their mean, from the middle
/// to the edge.
fn gradients(cells: &GelCells) -> [[f64; 3]; 2] {
    let mut sums = [[0.0; 3]; 2];
    let mut squares = [0.0; 2];
    for i in 0..CELLS {
        let logs = [0, 1, 2].map(|c| f64::from((cells.levels[c][i] + LOG_OFFSET).ln()));
        let mean = logs.iter().sum::<f64>() / 3.0;
        for (axis, at) in position(i).into_iter().enumerate() {
            squares[axis] += at * at;
            for (sum, log) in sums[axis].iter_mut().zip(logs) {
                *sum += (log - mean) * at;
            }
        }
    }
    [0, 1].map(|axis| sums[axis].map(|sum| sum / squares[axis]))
}

/// Whether green brightens the left of a contact.
fn is_mirrored(initial: &GelCells, now: &GelCells) -> bool {
    let changes = [0, 1, 2].map(|c| {
        let pairs = now.levels[c].iter().zip(&initial.levels[c]);
        let changes: Vec<f32> = pairs.map(|(now, before)| now - before).collect();
        let light = quantile(&mut changes.clone(), 0.5);
        changes
            .into_iter()
            .map(|change| change - light)
            .collect::<Vec<f32>>()
    });
    let strength = |i: usize| changes.iter().map(|c| c[i].abs()).fold(0.0, f32::max);
    let contact: Vec<(usize, f32)> = (0..CELLS)
        .map(|i| (i, strength(i)))
        .filter(|(_, strength)| *strength > CONTACT_LEVELS)
        .collect();
    if contact.len() < MIN_CELLS {
        return false;
    }
    let across = |i: usize| position(i)[0] as f32;
    let total: f32 = contact.iter().map(|(_, strength)| strength).sum();
    let middle = contact
        .iter()
        .map(|(i, strength)| strength * across(*i))
        .sum::<f32>()
        / total;
    let moment = contact
        .iter()
        .map(|(i, _)| changes[1][*i] * (across(*i) - middle))
        .sum::<f32>();
    moment < MIRRORED_MOMENT * total
}

/// Position of the middle of a cell, −1 to 1 from left to right and top to bottom.
fn position(cell: usize) -> [f64; 2] {
    let centred = |i: usize, count: usize| (i as f64 + 0.5) / count as f64 * 2.0 - 1.0;
    [
        centred(cell % COLUMNS, COLUMNS),
        centred(cell / COLUMNS, ROWS),
    ]
}

#[cfg(test)]
mod tests {
    use image::RgbImage;
    use image::imageops::{flip_horizontal, flip_vertical, resize, rotate90, rotate180};

    use super::*;
    use crate::{CropProfile, crop_and_resize, decode_png_rgb, synthetic_gel};
    use gripcast_testing::shared;

    type Change = fn(&RgbImage) -> RgbImage;

    fn problem(initial: &RgbImage, now: &RgbImage) -> Option<ViewProblem> {
        let [initial, now] = [initial, now].map(|image| GelCells::new(image).unwrap());
        ViewProblem::of(&initial, &now)
    }

    fn mapped(image: &RgbImage, level: impl Fn([u8; 3]) -> [u8; 3]) -> RgbImage {
        let mut image = image.clone();
        image
            .pixels_mut()
            .for_each(|pixel| pixel.0 = level(pixel.0));
        image
    }

    fn gamma(image: &RgbImage, gamma: f32) -> RgbImage {
        let level = |level: u8| (255.0 * (f32::from(level) / 255.0).powf(gamma) + 0.5) as u8;
        mapped(image, |pixel| pixel.map(level))
    }

    /// What is changed, and what has to be told.
    const CHANGES: [(Change, ViewProblem); 8] = [
        (
            |image| mapped(image, |[r, g, b]| [b, g, r]),
            ViewProblem::ColourOrder,
        ),
        (flip_vertical, ViewProblem::UpsideDown),
        (rotate180, ViewProblem::UpsideDown),
        (
            |image| {
                resize(
                    &rotate90(image),
                    320,
                    240,
                    image::imageops::FilterType::Triangle,
                )
            },
            ViewProblem::Rotated,
        ),
        (|image| mapped(image, |_| [3, 3, 4]), ViewProblem::Dark),
        (
            |image| mapped(image, |[_, g, b]| [2, g, b]),
            ViewProblem::Dark,
        ),
        (|image| gamma(image, 2.2), ViewProblem::Levels),
        (|image| gamma(image, 1.0 / 2.2), ViewProblem::Levels),
    ];

    /// Images of the shared directory: an open gel and the same gel in contact.
    fn recorded() -> Option<Vec<[RgbImage; 2]>> {
        let read = |item: &str| {
            let image = decode_png_rgb(&std::fs::read(shared(item)?).unwrap()).unwrap();
            Some(crop_and_resize(&image, &CropProfile::FULL, 320, 240).unwrap())
        };
        let mut pairs = Vec::new();
        for ball in 0..24 {
            pairs.push([
                read("data/gsmini_taxim_ball/nocontact.png")?,
                read(&format!("data/gsmini_taxim_ball/ball_{ball:02}.png"))?,
            ]);
        }
        for open in [
            "gsmini_ai4ce_bg/background.png",
            "gsmini_normalflow/background.png",
            "gsmini_feats_marker/nocontact_train_sensor.png",
        ] {
            let open = read(&format!("data/{open}"))?;
            pairs.push([open.clone(), open]);
        }
        Some(pairs)
    }

    #[test]
    fn recorded_gels_are_as_they_should_be_and_changed_ones_are_told() {
        let Some(pairs) = recorded() else { return };
        assert_eq!(pairs.len(), 27);
        for (number, [open, pressed]) in pairs.iter().enumerate() {
            assert_eq!(problem(open, pressed), None, "{number}");
            for (change, expected) in CHANGES {
                let found = problem(&change(open), &change(pressed));
                assert_eq!(found, Some(expected), "{number}");
                // Also where only one of the images is changed.
                assert_eq!(problem(open, &change(pressed)), Some(expected), "{number}");
            }
            let mirrored = problem(&flip_horizontal(open), &flip_horizontal(pressed));
            // Only a contact tells left from right.
            let expected = (number < 24).then_some(ViewProblem::Mirrored);
            assert_eq!(mirrored, expected, "{number}");
        }
    }

    #[test]
    fn synthetic_gels_mirrored_in_contact_are_told() {
        for seed in 0..20 {
            let [open, pressed] = [0.0, 0.6].map(|contact| synthetic_gel(320, 240, seed, contact));
            assert_eq!(problem(&open, &pressed), None);
            let found = problem(&flip_horizontal(&open), &flip_horizontal(&pressed));
            assert_eq!(found, Some(ViewProblem::Mirrored));
        }
    }

    #[test]
    fn nothing_is_said_of_other_sensors() {
        let grey = RgbImage::from_pixel(320, 240, image::Rgb([120; 3]));
        assert_eq!(problem(&grey, &flip_horizontal(&grey)), None);
        let Some(folder) = shared("data/fots_ball") else {
            return;
        };
        let read = |name: &str| decode_png_rgb(&std::fs::read(folder.join(name)).unwrap()).unwrap();
        let open = read("no_contact.png");
        for (change, _) in &CHANGES[..4] {
            assert_eq!(problem(&change(&open), &change(&open)), None);
        }
    }
}
