//! Dark dots of a known size in one image.

use crate::darkness::{Brightness, Darkness};

/// Minimum darkness of a dot, fraction of the darkness of the gel's dots.
const MIN_DEPTH_FRACTION: f32 = 0.5;
/// Part of a dot's darkness from which a pixel counts, and from which it counts fully: beyond the
/// noise around a large dot and without the speckles inside it.
const LARGE_WEIGHTS: [f32; 2] = [0.25, 0.7];
/// The same for a dot of few pixels, of which each counts by its darkness.
const SMALL_WEIGHTS: [f32; 2] = [0.15, 1.2];
/// Diameters of small and large dots, px.
const SMALL_TO_LARGE: [f32; 2] = [3.0, 7.0];
/// Maximum steps of a position towards the centroid around it.
const CENTROID_STEPS: usize = 5;
/// Step below which a position has converged, px.
const CONVERGED_PX: f32 = 0.03;
/// Cells of the coarser grid across a dot: enough to find it.
const CELLS_OF_DIAMETER: f32 = 5.0;
/// Minimum fraction of a dot that is inside the image.
const MIN_VISIBLE: f32 = 0.4;

/// A dark dot.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Dot {
    /// Centre, px.
    pub(crate) position: [f32; 2],
    /// Mean darkness of its middle, 0 to 1.
    pub(crate) depth: f32,
    /// Area that is darker than half of the gel's dots, px².
    pub(crate) area: f32,
    /// Pixels of its edge, neither dark nor light, relative to its area.
    pub(crate) edge: f32,
    /// Fraction that is inside the image, 0 to 1.
    pub(crate) visible: f32,
}

/// What the dots of a gel look like.
#[derive(Clone, Copy, Debug)]
pub(crate) struct DotFilter {
    /// Diameter at half of the darkness, px.
    pub(crate) diameter: f32,
    /// Side of the square whose mean is the background, px.
    pub(crate) background: f32,
    /// Minimum distance of two dots, px.
    pub(crate) distance: f32,
    /// Darkness of the middle of the dots, 0 to 1.
    pub(crate) depth: f32,
}

impl DotFilter {
    /// Finds the dots of an image.
    pub(crate) fn find(&self, brightness: &Brightness) -> Vec<Dot> {
        let factor = ((self.diameter / CELLS_OF_DIAMETER) as usize).max(1);
        let darkness = brightness.darkness(self.background, factor);
        let smooth = darkness.smoothed(0.6 * self.diameter);
        let radius = (0.5 * self.distance / factor as f32).max(1.0) as usize;
        let threshold = MIN_DEPTH_FRACTION * self.depth;
        let peaks = local_maxima(&smooth, darkness.size, radius, threshold);
        let dots = peaks.into_iter().filter_map(|cell| {
            let peak = smooth[cell[1] * darkness.size[0] + cell[0]];
            let start = cell.map(|i| (i as f32 + 0.5) * factor as f32 - 0.5);
            self.measure(&darkness, start, peak)
        });
        self.without_doubles(dots.collect())
    }

    /// Measures the dot around a position; `None` where there is none.
    fn measure(&self, darkness: &Darkness<'_>, start: [f32; 2], depth: f32) -> Option<Dot> {
        let size = darkness.image_size();
        let reach = (0.62 * self.diameter + 1.5).min(0.62 * self.distance.max(self.diameter));
        let range = self.weight_range().map(|part| part * depth.min(self.depth));
        let mut position = start;
        let mut moments = Moments::default();
        for _ in 0..CENTROID_STEPS {
            moments = Moments::around(darkness, position, reach, range);
            let centroid = moments.centroid()?;
            let (expected, _) = self.visible_centroid(size, position, reach);
            let step = [0, 1].map(|a| centroid[a] - expected[a]);
            position = [0, 1].map(|a| position[a] + step[a]);
            if distance(position, start) > self.diameter.max(2.0) {
                return None;
            }
            if step[0].abs().max(step[1].abs()) < CONVERGED_PX {
                break;
            }
        }
        let (_, visible) = self.visible_centroid(size, position, reach);
        (visible >= MIN_VISIBLE).then_some(Dot {
            position,
            depth,
            area: moments.sum,
            edge: moments.edge / moments.sum.max(1.0),
            visible,
        })
    }

    /// Parts of a dot's darkness from which a pixel counts, and from which it counts fully.
    fn weight_range(&self) -> [f32; 2] {
        let [small, large] = SMALL_TO_LARGE;
        let part = ((self.diameter - small) / (large - small)).clamp(0.0, 1.0);
        [0, 1].map(|i| SMALL_WEIGHTS[i] + part * (LARGE_WEIGHTS[i] - SMALL_WEIGHTS[i]))
    }

    /// Centroid of the part of a whole disc at `centre` that is inside the image, and its fraction.
    fn visible_centroid(&self, size: [usize; 2], centre: [f32; 2], reach: f32) -> ([f32; 2], f32) {
        let radius = 0.5 * self.diameter;
        let is_inside = |axis: usize| {
            centre[axis] - reach >= -0.5 && centre[axis] + reach <= size[axis] as f32 - 0.5
        };
        if is_inside(0) && is_inside(1) {
            return (centre, 1.0);
        }
        let mut sums = [0.0_f32; 4];
        let steps = reach.ceil() as i32;
        for dy in -steps..=steps {
            for dx in -steps..=steps {
                let at = [centre[0].round() + dx as f32, centre[1].round() + dy as f32];
                let distance = (at[0] - centre[0]).hypot(at[1] - centre[1]);
                let weight = (radius + 0.5 - distance).clamp(0.0, 1.0);
                sums[3] += weight;
                let inside = (0..2).all(|a| at[a] >= 0.0 && at[a] < size[a] as f32);
                if inside {
                    sums[0] += weight * at[0];
                    sums[1] += weight * at[1];
                    sums[2] += weight;
                }
            }
        }
        if sums[2] <= 0.0 {
            return (centre, 0.0);
        }
        ([sums[0] / sums[2], sums[1] / sums[2]], sums[2] / sums[3])
    }

    /// Keeps the darker one of dots that are closer than possible.
    fn without_doubles(&self, mut dots: Vec<Dot>) -> Vec<Dot> {
        dots.sort_by(|a, b| b.depth.total_cmp(&a.depth));
        let mut kept: Vec<Dot> = Vec::with_capacity(dots.len());
        for dot in dots {
            let is_double = kept
                .iter()
                .any(|other| distance(dot.position, other.position) < 0.5 * self.distance);
            if !is_double {
                kept.push(dot);
            }
        }
        kept
    }
}

pub(crate) fn distance(a: [f32; 2], b: [f32; 2]) -> f32 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

/// Sums over the dark pixels around a position.
#[derive(Default)]
struct Moments {
    sum: f32,
    first: [f32; 2],
    edge: f32,
}

impl Moments {
    fn around(
        darkness: &Darkness<'_>,
        centre: [f32; 2],
        reach: f32,
        [low, high]: [f32; 2],
    ) -> Self {
        let scale = 1.0 / (high - low);
        let size = darkness.image_size();
        let range = |middle: f32, reach: f32, size: usize| {
            let last = size as f32 - 1.0;
            [(middle - reach).ceil(), (middle + reach).floor()].map(|i| i.clamp(0.0, last) as usize)
        };
        let inner = (reach - 1.0).max(0.0).powi(2);
        let mut moments = Self::default();
        let [top, bottom] = range(centre[1], reach, size[1]);
        for y in top..=bottom {
            let dy = y as f32 - centre[1];
            let half = (reach * reach - dy * dy).max(0.0).sqrt();
            darkness.row(y, range(centre[0], half, size[0]), |x, darkness| {
                let dx = x as f32 - centre[0];
                let square = dx * dx + dy * dy;
                // The rim of the window fades, so that a pixel does not enter it at once.
                let rim = match square > inner {
                    true => (reach - square.sqrt()).max(0.0),
                    false => 1.0,
                };
                let dark = ((darkness - low) * scale).clamp(0.0, 1.0);
                let weight = dark * rim;
                moments.sum += weight;
                moments.first[0] += weight * dx;
                moments.first[1] += weight * dy;
                if dark > 0.0 && dark < 1.0 {
                    moments.edge += rim;
                }
            });
        }
        moments.first = [0, 1].map(|a| moments.first[a] + centre[a] * moments.sum);
        moments
    }

    fn centroid(&self) -> Option<[f32; 2]> {
        (self.sum > 0.5).then(|| self.first.map(|first| first / self.sum))
    }
}

/// Pixels above `threshold` that are the maximum within `radius` (Neubeck et al., Efficient
/// Non-Maximum Suppression, 2006: the maximum of each block first).
fn local_maxima(
    values: &[f32],
    [width, height]: [usize; 2],
    radius: usize,
    threshold: f32,
) -> Vec<[usize; 2]> {
    let block = radius + 1;
    let mut maxima = Vec::new();
    for top in (0..height).step_by(block) {
        for left in (0..width).step_by(block) {
            let (mut best, mut at) = (threshold, None);
            for y in top..(top + block).min(height) {
                for x in left..(left + block).min(width) {
                    if values[y * width + x] > best {
                        (best, at) = (values[y * width + x], Some([x, y]));
                    }
                }
            }
            let Some([x, y]) = at else { continue };
            let rows = y.saturating_sub(radius)..(y + radius + 1).min(height);
            let columns = x.saturating_sub(radius)..(x + radius + 1).min(width);
            let mut around = rows.flat_map(|row| &values[row * width..][columns.clone()]);
            if around.all(|value| *value <= best) {
                maxima.push([x, y]);
            }
        }
    }
    maxima
}
