//! Rigid motion of the texture in contact, for gels without markers.
//!
//! While a contact sticks, the print of the object moves with the skin. The change of the image
//! since the gel was untouched is aligned with that of an earlier frame of the same contact: a
//! translation and a rotation by inverse-compositional Gauss–Newton steps (Baker and Matthews,
//! Lucas-Kanade 20 Years On, 2004), after a search over translations on a coarse grid. The
//! correlation of both is the confidence. A contact that slips moves over the skin, which
//! cannot be told from shear.

use image::RgbImage;

use gripcast_base::linear::NormalEquations;

use crate::contact::{ContactArea, SkinCells};
use crate::tracker::decimal;
use crate::{ShearFrame, ShearProblem, ShearSource, ShearSummary};

/// Pixels of the image per pixel of the compared change.
const FACTOR: usize = 2;
/// Pixels of the compared change per step of the search.
const SEARCH_STEP: i32 = 3;
/// Range of the search, steps.
const SEARCH_RANGE: i32 = 4;
/// Correlation from which an alignment that starts at the last motion needs no search.
const FOUND: f32 = 0.85;
/// Maximum pixels that are compared, and that the search looks at: evenly spread over the contact.
const MAX_PIXELS: usize = 3000;
const MAX_SEARCH_PIXELS: usize = 600;
/// Maximum Gauss–Newton steps.
const STEPS: usize = 12;
/// Step below which the alignment has converged, pixels of the change.
const CONVERGED: f64 = 0.005;
/// Correlation without and with full confidence.
const CORRELATION: [f32; 2] = [0.5, 0.9];
/// Minimum correlation for a new reference of the same contact.
const MIN_RENEWED: f32 = 0.7;
/// Growth of a contact from which its reference is renewed, fraction.
const GROWTH: f32 = 1.1;
/// Minimum root mean square gradient in the direction of the weakest texture, levels per pixel.
const MIN_GRADIENT: f64 = 0.8;
/// Minimum pixels of the change in contact.
const MIN_PIXELS: usize = 60;

/// Follows the texture of the contact of one gel.
#[derive(Clone, Debug)]
pub(crate) struct TextureTracker {
    m_per_px: f64,
    rest: Levels,
    rest_cells: SkinCells,
    reference: Option<Reference>,
}

impl TextureTracker {
    pub(crate) fn new(initial: &RgbImage, m_per_px: f64) -> Self {
        Self {
            m_per_px,
            rest: Levels::new(initial),
            rest_cells: SkinCells::new(initial, std::iter::empty(), 0.0),
            reference: None,
        }
    }

    pub(crate) fn update(&mut self, image: &RgbImage) -> ShearFrame {
        let problem = |problem| ShearFrame {
            problems: vec![problem],
            ..ShearFrame::default()
        };
        let cells = SkinCells::new(image, std::iter::empty(), 0.0);
        let Some(contact) = ContactArea::between(&self.rest_cells, &cells) else {
            self.reference = None;
            return problem(ShearProblem::NoContact);
        };
        let change = Levels::new(image).minus(&self.rest);
        let Some(reference) = &mut self.reference else {
            self.reference = Reference::new(change, &contact, Start::default());
            return match &self.reference {
                Some(reference) => {
                    let motion = Motion::default();
                    summary_frame(reference, motion, 1.0, &contact, self.m_per_px)
                }
                None => problem(ShearProblem::NoTexture),
            };
        };
        let (motion, correlation) = reference.align(&change);
        if correlation <= CORRELATION[0] {
            return problem(ShearProblem::NoTexture);
        }
        reference.last = motion;
        let frame = summary_frame(reference, motion, correlation, &contact, self.m_per_px);
        if contact.fraction() > GROWTH * reference.area && correlation > MIN_RENEWED {
            let start = Start {
                translation: reference.start.translated(motion),
                rotation: reference.start.rotation + motion.rotation,
                confidence: reference.start.confidence * confidence(correlation),
            };
            if let Some(renewed) = Reference::new(change, &contact, start) {
                self.reference = Some(renewed);
            }
        }
        frame
    }
}

fn confidence(correlation: f32) -> f32 {
    let [none, full] = CORRELATION;
    ((correlation - none) / (full - none)).clamp(0.0, 1.0)
}

fn summary_frame(
    reference: &Reference,
    motion: Motion,
    correlation: f32,
    contact: &ContactArea,
    m_per_px: f64,
) -> ShearFrame {
    let mm = (1e3 * m_per_px) as f32 * FACTOR as f32;
    let translation = reference.start.translated(motion);
    let rotation = reference.start.rotation + motion.rotation;
    let lengths = reference.pixels.iter().map(|pixel| {
        let [x, y] = pixel.offset.map(f64::from);
        (translation[0] - rotation * y).hypot(translation[1] + rotation * x)
    });
    let placement = motion.about(reference.centre);
    let inside = reference.pixels.iter().filter(|pixel| {
        let [x, y] = placement.of(pixel.offset);
        let [width, height] = reference.size.map(|side| side as f32 - 1.0);
        (0.0..=width).contains(&x) && (0.0..=height).contains(&y)
    });
    let summary = ShearSummary {
        source: ShearSource::Texture,
        confidence: decimal(reference.start.confidence * confidence(correlation)),
        tracked_fraction: decimal(inside.count() as f32 / reference.pixels.len() as f32),
        mean_displacement_mm: translation.map(|t| decimal(mm * t as f32)),
        max_displacement_mm: decimal(mm * lengths.fold(0.0, f64::max) as f32),
        divergence: 0.0,
        curl: decimal(2.0 * rotation as f32),
        contact_fraction: decimal(contact.fraction()),
        slip_ratio: None,
    };
    ShearFrame {
        summary: Some(summary),
        ..ShearFrame::default()
    }
}

/// Levels of the three channels at a lower resolution.
#[derive(Clone, Debug)]
struct Levels {
    size: [usize; 2],
    values: Vec<[f32; 3]>,
}

impl Levels {
    fn new(image: &RgbImage) -> Self {
        let size = [
            image.width() as usize / FACTOR,
            image.height() as usize / FACTOR,
        ];
        let row_bytes = 3 * image.width() as usize;
        let pixels = image.as_raw();
        let mut values = Vec::with_capacity(size[0] * size[1]);
        for y in 0..size[1] {
            for x in 0..size[0] {
                let mut sums = [0_u32; 3];
                for dy in 0..FACTOR {
                    let first = (y * FACTOR + dy) * row_bytes + 3 * x * FACTOR;
                    for pixel in pixels[first..first + 3 * FACTOR].chunks_exact(3) {
                        for (sum, level) in sums.iter_mut().zip(pixel) {
                            *sum += u32::from(*level);
                        }
                    }
                }
                values.push(sums.map(|sum| sum as f32 / (FACTOR * FACTOR) as f32));
            }
        }
        Self { size, values }
    }

    fn minus(&self, other: &Self) -> Self {
        let pairs = self.values.iter().zip(&other.values);
        Self {
            size: self.size,
            values: pairs.map(|(a, b)| [0, 1, 2].map(|c| a[c] - b[c])).collect(),
        }
    }

    /// Bilinear value; the image is continued by its edges.
    fn at(&self, [x, y]: [f32; 2]) -> [f32; 3] {
        let [width, height] = self.size;
        let x = x.clamp(0.0, width as f32 - 1.001);
        let y = y.clamp(0.0, height as f32 - 1.001);
        let (column, row) = (x as usize, y as usize);
        let (u, v) = (x - column as f32, y - row as f32);
        let value = |dx: usize, dy: usize| {
            let (column, row) = ((column + dx).min(width - 1), (row + dy).min(height - 1));
            self.values[row * width + column]
        };
        let corners = [value(0, 0), value(1, 0), value(0, 1), value(1, 1)];
        [0, 1, 2].map(|c| {
            let [a, b, d, e] = corners.map(|corner| corner[c]);
            (1.0 - v) * ((1.0 - u) * a + u * b) + v * ((1.0 - u) * d + u * e)
        })
    }
}

/// How much stronger a change is than the one with whose product and square it is given.
fn strength(product: f32, own: f32) -> f32 {
    (product / own.max(f32::MIN_POSITIVE)).clamp(0.3, 3.0)
}

/// Translation and rotation about the centre of the reference, pixels of the change.
#[derive(Clone, Copy, Debug, Default)]
struct Motion {
    translation: [f64; 2],
    rotation: f64,
}

impl Motion {
    /// The motion about `centre`, ready for many pixels.
    fn about(self, centre: [f32; 2]) -> Placement {
        let (sin, cos) = self.rotation.sin_cos();
        Placement {
            sin: sin as f32,
            cos: cos as f32,
            middle: [0, 1].map(|a| centre[a] + self.translation[a] as f32),
        }
    }

    /// The motion after undoing a small one that comes first.
    fn without(self, [x, y, rotation]: [f64; 3]) -> Self {
        let turned = self.rotation - rotation;
        let (sin, cos) = turned.sin_cos();
        Self {
            translation: [
                self.translation[0] - (cos * x - sin * y),
                self.translation[1] - (sin * x + cos * y),
            ],
            rotation: turned,
        }
    }
}

/// A motion about a centre.
#[derive(Clone, Copy, Debug)]
struct Placement {
    sin: f32,
    cos: f32,
    middle: [f32; 2],
}

impl Placement {
    /// Position of a pixel at an offset from the centre.
    fn of(&self, [x, y]: [f32; 2]) -> [f32; 2] {
        [
            self.middle[0] + self.cos * x - self.sin * y,
            self.middle[1] + self.sin * x + self.cos * y,
        ]
    }
}

/// Motion of a contact until its reference.
#[derive(Clone, Copy, Debug)]
struct Start {
    translation: [f64; 2],
    rotation: f64,
    confidence: f32,
}

impl Default for Start {
    fn default() -> Self {
        Self {
            translation: [0.0; 2],
            rotation: 0.0,
            confidence: 1.0,
        }
    }
}

impl Start {
    fn translated(&self, motion: Motion) -> [f64; 2] {
        [0, 1].map(|a| self.translation[a] + motion.translation[a])
    }
}

/// A pixel in contact.
#[derive(Clone, Copy, Debug)]
struct Pixel {
    offset: [f32; 2],
    value: [f32; 3],
    /// Derivatives of the channels by x, y and rotation.
    gradient: [[f32; 3]; 3],
}

/// The frame of a contact that later ones are aligned with.
#[derive(Clone, Debug)]
struct Reference {
    size: [usize; 2],
    centre: [f32; 2],
    pixels: Vec<Pixel>,
    /// Pixels in contact, of which `pixels` are some.
    area_pixels: f64,
    area: f32,
    start: Start,
    /// Motion in the frame before.
    last: Motion,
}

impl Reference {
    /// `None` for a contact without texture.
    fn new(change: Levels, contact: &ContactArea, start: Start) -> Option<Self> {
        let [width, height] = change.size;
        let inside = (1..height - 1).flat_map(|y| (1..width - 1).map(move |x| [x, y]));
        let inside: Vec<[usize; 2]> = inside
            .filter(|at| {
                let middle = |i: usize| (FACTOR * i) as f32 + 0.5 * (FACTOR - 1) as f32;
                contact.contains(at.map(middle))
            })
            .collect();
        if inside.len() < MIN_PIXELS {
            return None;
        }
        let mean =
            |a: usize| inside.iter().map(|at| at[a] as f32).sum::<f32>() / inside.len() as f32;
        let centre = [mean(0), mean(1)];
        let value = |x: usize, y: usize| change.values[y * width + x];
        let pixel = |&[x, y]: &[usize; 2]| {
            let offset = [x as f32 - centre[0], y as f32 - centre[1]];
            let half = |a: [f32; 3], b: [f32; 3]| [0, 1, 2].map(|c| 0.5 * (a[c] - b[c]));
            let dx = half(value(x + 1, y), value(x - 1, y));
            let dy = half(value(x, y + 1), value(x, y - 1));
            let rotated = [0, 1, 2].map(|c| offset[0] * dy[c] - offset[1] * dx[c]);
            Pixel {
                offset,
                value: value(x, y),
                gradient: [dx, dy, rotated],
            }
        };
        let reference = Self {
            size: change.size,
            centre,
            pixels: inside
                .iter()
                .step_by(inside.len().div_ceil(MAX_PIXELS))
                .map(pixel)
                .collect(),
            area_pixels: inside.len() as f64,
            area: contact.fraction(),
            start,
            last: Motion::default(),
        };
        (reference.weakest_gradient() >= MIN_GRADIENT).then_some(reference)
    }

    /// Root mean square gradient in the direction in which it is smallest, levels per pixel.
    fn weakest_gradient(&self) -> f64 {
        let sum = |a: usize, b: usize| -> f64 {
            let products = self.pixels.iter().map(|pixel| {
                (0..3)
                    .map(|c| pixel.gradient[a][c] * pixel.gradient[b][c])
                    .sum::<f32>()
            });
            products.map(f64::from).sum::<f64>() / self.pixels.len() as f64
        };
        let (xx, xy, yy) = (sum(0, 0), sum(0, 1), sum(1, 1));
        let root = (0.25 * (xx - yy).powi(2) + xy * xy).sqrt();
        (0.5 * (xx + yy) - root).max(0.0).sqrt()
    }

    /// Motion since the reference, and the correlation after it.
    fn align(&self, change: &Levels) -> (Motion, f32) {
        let (motion, correlation) = self.refine(change, self.last);
        if correlation >= FOUND {
            return (motion, correlation);
        }
        let searched = self.refine(change, self.search(change));
        match searched.1 > correlation {
            true => searched,
            false => (motion, correlation),
        }
    }

    /// The motion with the best alignment near `motion`, and the correlation after it.
    fn refine(&self, change: &Levels, mut motion: Motion) -> (Motion, f32) {
        let mut gain = self.gain(change, motion);
        for _ in 0..STEPS {
            let mut system = NormalEquations::<3>::zero();
            let (mut product, mut own) = (0.0, 0.0);
            let placement = motion.about(self.centre);
            for pixel in &self.pixels {
                let now = change.at(placement.of(pixel.offset));
                for c in 0..3 {
                    let row = pixel.gradient.map(|gradient| f64::from(gain * gradient[c]));
                    system.add(&row, f64::from(now[c] - gain * pixel.value[c]), 1.0);
                    product += pixel.value[c] * now[c];
                    own += pixel.value[c] * pixel.value[c];
                }
            }
            gain = strength(product, own);
            let Some(step) = system.solve() else { break };
            motion = motion.without(step);
            let reach = self.area_pixels;
            if step[0].hypot(step[1]) < CONVERGED && step[2].abs() * reach.sqrt() < CONVERGED {
                break;
            }
        }
        (motion, self.correlation(change, motion, 1))
    }

    /// The translation around the last motion with the best correlation.
    fn search(&self, change: &Levels) -> Motion {
        let every = self.pixels.len().div_ceil(MAX_SEARCH_PIXELS);
        let range = -SEARCH_RANGE..=SEARCH_RANGE;
        let shifts = range
            .clone()
            .flat_map(|y| range.clone().map(move |x| [x, y]));
        let scored = shifts.map(|shift| {
            let [x, y] = shift.map(|steps| f64::from(SEARCH_STEP * steps));
            let [before_x, before_y] = self.last.translation;
            let motion = Motion {
                translation: [before_x + x, before_y + y],
                ..self.last
            };
            (motion, self.correlation(change, motion, every))
        });
        let best = scored.max_by(|a, b| a.1.total_cmp(&b.1));
        best.map_or(self.last, |(motion, _)| motion)
    }

    /// How much stronger the change is than in the reference.
    fn gain(&self, change: &Levels, motion: Motion) -> f32 {
        let (product, [own, _]) = self.products(change, motion, 1);
        strength(product, own)
    }

    fn correlation(&self, change: &Levels, motion: Motion, every: usize) -> f32 {
        let (product, [own, other]) = self.products(change, motion, every);
        product / (own * other).sqrt().max(f32::MIN_POSITIVE)
    }

    /// Sums of the product of both changes and of their squares.
    fn products(&self, change: &Levels, motion: Motion, every: usize) -> (f32, [f32; 2]) {
        let (mut product, mut squares) = (0.0, [0.0; 2]);
        let placement = motion.about(self.centre);
        for pixel in self.pixels.iter().step_by(every) {
            let now = change.at(placement.of(pixel.offset));
            for (before, now) in pixel.value.iter().zip(now) {
                product += before * now;
                squares = [squares[0] + before * before, squares[1] + now * now];
            }
        }
        (product, squares)
    }
}
