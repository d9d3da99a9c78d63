//! Corner refinement: corners as intersections of lines fitted to the marker's sides.
//!
//! A line fitted to many points of a side is accurate to a few hundredths of a pixel. Refining the
//! corner itself is biased by the marker's bits and by blur.
//!
//! The lens blurs light, but the image has sRGB levels, in which the centre of a blurred edge lies
//! on its dark side: at a blur of 0.7 px, corners move inwards by 0.3 px. Edges are therefore
//! located in linear light.

use std::cmp::Ordering;

use glam::DVec2;
use image::GrayImage;

use gripcast_base::statistics::median;

use super::Detection;
use gripcast_imaging::srgb_decode;

/// Maximum number of iterations.
const MAX_ITERATIONS: usize = 10;
/// Iteration ends when no corner moves farther, px.
const TOLERANCE_PX: f64 = 0.005;
/// Maximum number of samples of a profile.
const MAX_SAMPLES: usize = 15;
/// Fraction of a side at each end that is not sampled: the adjacent side blurs it.
const ENDS: f64 = 0.12;
/// Minimum number of sampled and of fitted profiles of a side.
const MIN_PROFILES: usize = 8;
const MIN_FITTED: usize = 5;
/// Half-width of a profile: fraction of the side, and its limits, px.
const HALF_OF_SIDE: f64 = 1.0 / 12.0;
const HALF_WIDTH_PX: (f64, f64) = (1.5, 3.0);
/// Distance of samples across an edge, px.
const STEP_PX: f64 = 0.5;
/// Range on both sides of an edge whose light is summed: ratio to the blur, and minimum, samples.
const RANGE_OF_BLUR: f64 = 1.3;
const MIN_RANGE: usize = 2;
/// Minimum contrast of a profile relative to the median.
const MIN_CONTRAST: f64 = 0.3;
/// Maximum residual of an inlier, robust standard deviations.
const MAX_DEVIATIONS: f64 = 3.0;
/// Minimum standard deviation of the residuals, px.
const MIN_DEVIATION_PX: f64 = 0.02;
/// Maximum displacement of a corner, px.
const MAX_PX: f64 = 4.0;
/// Light of sRGB level 254, from which white counts as clipped.
const CLIPPED_LIGHT: f64 = 0.991;
/// Maximum clipped fraction of a marker's surround without a note.
const MAX_CLIPPED: f64 = 0.5;
/// Maximum blur without a note, px: corners are unbiased up to about this.
const MAX_BLUR_PX: f64 = 1.3;
/// Minimum contrast without a note, linear light.
const MIN_LIGHT_CONTRAST: f64 = 0.02;

/// Refines the corners of a marker with a dark border on a bright background. Returns the
/// detection unchanged if the image has no four lines near its corners.
#[must_use]
pub fn refine_corners(image: &GrayImage, detection: &Detection) -> Detection {
    let mut corners = detection.corners_px;
    for _ in 0..MAX_ITERATIONS {
        let Some(next) = refine_once(image, &corners) else {
            return detection.clone();
        };
        let step = max_distance(&next, &corners);
        corners = next;
        if step < TOLERANCE_PX {
            break;
        }
    }
    let is_near = max_distance(&corners, &detection.corners_px) < MAX_PX;
    if !(is_near && corners.iter().all(|c| c.is_finite())) {
        return detection.clone();
    }
    Detection {
        corners_px: corners,
        ..detection.clone()
    }
}

fn max_distance(a: &[DVec2; 4], b: &[DVec2; 4]) -> f64 {
    let distances = a.iter().zip(b).map(|(a, b)| a.distance(*b));
    distances.fold(0.0, f64::max)
}

/// [`refine_corners`] for all detections.
#[must_use]
pub fn refine_all(image: &GrayImage, detections: &[Detection]) -> Vec<Detection> {
    detections
        .iter()
        .map(|detection| refine_corners(image, detection))
        .collect()
}

/// Quality of a marker's edges.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EdgeQuality {
    /// Standard deviation of the blur across the more blurred pair of sides, px. Sampling adds
    /// about a third of a pixel.
    pub blur_px: f64,
    /// Contrast of the edges, linear light from 0 to 1.
    pub contrast: f64,
    /// Fraction of the surround that is at the highest level: light beyond it is lost.
    pub clipped: f64,
}

/// Median blur of the markers of an image, px.
#[must_use]
pub fn blur_px(image: &GrayImage, detections: &[Detection]) -> Option<f64> {
    let mut all: Vec<f64> = detections
        .iter()
        .filter_map(|d| edge_quality(image, &d.corners_px))
        .map(|quality| quality.blur_px)
        .collect();
    all.sort_by(f64::total_cmp);
    all.get(all.len() / 2).copied()
}

/// Notes on what in the image impairs the corners of its markers.
#[must_use]
pub fn image_notes(image: &GrayImage, detections: &[Detection]) -> Vec<String> {
    let all: Vec<EdgeQuality> = detections
        .iter()
        .filter_map(|d| edge_quality(image, &d.corners_px))
        .collect();
    let mut notes = Vec::new();
    let clipped = all.iter().filter(|q| q.clipped > MAX_CLIPPED).count();
    if clipped > 0 {
        notes.push(format!(
            "the white around {clipped} of {} markers is overexposed, which moves their corners: \
             reduce exposure or light",
            all.len()
        ));
    }
    if let Some(blur) = median(all.iter().map(|q| q.blur_px)).filter(|blur| *blur > MAX_BLUR_PX) {
        notes.push(format!(
            "the markers' edges are blurred by {blur:.1} px, which impairs the pose: check the \
             focus, avoid motion, shorten the exposure"
        ));
    }
    if let Some(contrast) = median(all.iter().map(|q| q.contrast))
        && contrast < MIN_LIGHT_CONTRAST
    {
        notes.push(format!(
            "the markers' contrast is {:.1} % of the range: use more light or exposure",
            100.0 * contrast
        ));
    }
    notes
}

/// Quality of the edges of a marker; `None` where it cannot be measured, as at the image's border.
#[must_use]
pub fn edge_quality(image: &GrayImage, corners: &[DVec2; 4]) -> Option<EdgeQuality> {
    let mut sides = [EdgeQuality {
        blur_px: 0.0,
        contrast: 0.0,
        clipped: 0.0,
    }; 4];
    for (i, side) in sides.iter_mut().enumerate() {
        let sampled = Side::sample(image, Edge::new(corners, i)?)?;
        *side = EdgeQuality {
            blur_px: sampled.blur_px()?,
            contrast: sampled.contrast(),
            clipped: sampled.clipped(),
        };
    }
    let clipped = 0.25 * sides.iter().map(|side| side.clipped).sum::<f64>();
    // Motion blurs one pair of opposite sides.
    let pair = |a: usize, b: usize| EdgeQuality {
        blur_px: 0.5 * (sides[a].blur_px + sides[b].blur_px),
        contrast: 0.5 * (sides[a].contrast + sides[b].contrast),
        clipped,
    };
    let (first, second) = (pair(0, 2), pair(1, 3));
    Some(if first.blur_px > second.blur_px {
        first
    } else {
        second
    })
}

/// Corners as intersections of the lines fitted along the sides.
fn refine_once(image: &GrayImage, corners: &[DVec2; 4]) -> Option<[DVec2; 4]> {
    let mut sides = Vec::with_capacity(4);
    for i in 0..4 {
        sides.push(Side::sample(image, Edge::new(corners, i)?)?);
    }
    let mut lines = [(DVec2::ZERO, DVec2::ZERO); 4];
    for (line, side) in lines.iter_mut().zip(&sides) {
        *line = side.line()?;
    }
    let mut next = *corners;
    for (i, corner) in next.iter_mut().enumerate() {
        *corner = intersection(lines[(i + 3) % 4], lines[i])?;
    }
    Some(next)
}

/// Intersection of two lines given by point and direction.
fn intersection((p, d): (DVec2, DVec2), (q, e): (DVec2, DVec2)) -> Option<DVec2> {
    let sine = d.perp_dot(e);
    (sine.abs() > 0.05 * d.length() * e.length()).then(|| p + d * ((q - p).perp_dot(e) / sine))
}

/// Linear light (0 to 1) across a side, from inside to outside.
type Profile = [f64; MAX_SAMPLES];

/// A side of a marker.
struct Edge {
    midpoint: DVec2,
    direction: DVec2,
    /// Unit normal away from the marker's centre.
    outward: DVec2,
    length: f64,
    half_width: f64,
}

impl Edge {
    fn new(corners: &[DVec2; 4], side: usize) -> Option<Self> {
        let (a, b) = (corners[side], corners[(side + 1) % 4]);
        let centre = 0.25 * corners.iter().sum::<DVec2>();
        let direction = (b - a).try_normalize()?;
        let length = a.distance(b);
        let midpoint = 0.5 * (a + b);
        let normal = direction.perp();
        let is_usable = length.is_finite() && length > 4.0;
        is_usable.then(|| Self {
            midpoint,
            direction,
            outward: if normal.dot(midpoint - centre) < 0.0 {
                -normal
            } else {
                normal
            },
            length,
            half_width: (length * HALF_OF_SIDE).clamp(HALF_WIDTH_PX.0, HALF_WIDTH_PX.1),
        })
    }

    /// Positions of the profiles along the side, px from its midpoint.
    fn positions(&self) -> impl Iterator<Item = f64> {
        let count = MIN_PROFILES.max(self.length as usize);
        let span = (1.0 - 2.0 * ENDS) * self.length;
        (0..count).map(move |i| span * (i as f64 / (count - 1) as f64 - 0.5))
    }

    fn samples(&self) -> usize {
        (2 * ((self.half_width + 0.5) / STEP_PX) as usize + 1).min(MAX_SAMPLES)
    }

    /// Distance of sample `i` from the side, outwards, px.
    fn offset(&self, i: usize) -> f64 {
        (i as f64 - 0.5 * (self.samples() - 1) as f64) * STEP_PX
    }

    /// Samples across the side, from inside to outside. `None`: beyond the image.
    fn profile(&self, image: &GrayImage, along: f64) -> Option<Profile> {
        let on_side = self.midpoint + self.direction * along;
        let mut profile = [0.0; MAX_SAMPLES];
        for (i, light) in profile.iter_mut().enumerate().take(self.samples()) {
            *light = bilinear(image, on_side + self.outward * self.offset(i))?;
        }
        Some(profile)
    }

    fn mean<'a>(&self, profiles: impl Iterator<Item = &'a Profile>) -> Vec<f64> {
        let mut sums = vec![0.0; self.samples()];
        let mut count = 0.0;
        for profile in profiles {
            count += 1.0;
            for (sum, level) in sums.iter_mut().zip(profile) {
                *sum += level;
            }
        }
        sums.iter().map(|sum| sum / count).collect()
    }
}

/// A sampled edge.
struct Side {
    edge: Edge,
    /// Positions along the edge, px from its midpoint, with their profiles.
    profiles: Vec<(f64, Profile)>,
    /// Mean of the profiles' light.
    light: Vec<f64>,
}

impl Side {
    /// `None`: too few profiles.
    fn sample(image: &GrayImage, edge: Edge) -> Option<Self> {
        let at = |along| Some((along, edge.profile(image, along)?));
        let profiles: Vec<_> = edge.positions().filter_map(at).collect();
        let light = edge.mean(profiles.iter().map(|p| &p.1));
        (profiles.len() >= MIN_FITTED).then_some(Self {
            edge,
            profiles,
            light,
        })
    }

    /// Point and direction of the line fitted to the edge.
    fn line(&self) -> Option<(DVec2, DVec2)> {
        let edge = &self.edge;
        let last = self.light.len() - 1;
        let range = (RANGE_OF_BLUR * self.blur_px()? / STEP_PX).round() as usize;
        let range = range.clamp(MIN_RANGE, last / 2);
        let within = last / 2 - range..=last / 2 + range;
        let (dark, bright) = (self.light[*within.start()], self.light[*within.end()]);
        let contrast = bright - dark;
        // Difference to an ideal step at 0.
        let shifts = self.profiles.iter().map(|(along, profile)| {
            let light = &profile[within.clone()];
            let missing = |(i, l): (usize, &f64)| {
                let step = match i.cmp(&range) {
                    Ordering::Less => dark,
                    Ordering::Equal => 0.5 * (dark + bright),
                    Ordering::Greater => bright,
                };
                step - l
            };
            let missing: f64 = light.iter().enumerate().map(missing).sum();
            let own_contrast = light[2 * range] - light[0];
            [*along, STEP_PX * missing / contrast, own_contrast]
        });
        let mut points: Vec<[f64; 3]> = shifts.collect();
        let median_contrast = median(points.iter().map(|p| p[2]))?;
        points.retain(|p| p[2] > MIN_CONTRAST * median_contrast);
        let [offset, slope] = robust_line(points)?;
        (contrast > 0.0).then_some((
            edge.midpoint + edge.outward * offset,
            edge.direction + edge.outward * slope,
        ))
    }

    fn contrast(&self) -> f64 {
        let low = self.light.iter().copied().fold(f64::INFINITY, f64::min);
        self.light.iter().copied().fold(0.0, f64::max) - low
    }

    /// Fraction of the profiles that end at the highest level.
    fn clipped(&self) -> f64 {
        let last = self.light.len() - 1;
        let is_clipped = |(_, profile): &&(f64, Profile)| profile[last] >= CLIPPED_LIGHT;
        self.profiles.iter().filter(is_clipped).count() as f64 / self.profiles.len() as f64
    }

    /// Standard deviation σ of the blur: the maximum slope of an edge with contrast c after
    /// Gaussian blur is c/(σ √(2π)). `None`: no positive slope.
    fn blur_px(&self) -> Option<f64> {
        let slopes = self.light.windows(2).map(|w| (w[1] - w[0]) / STEP_PX);
        let max_slope = slopes.fold(0.0, f64::max);
        (max_slope > 0.0).then(|| self.contrast() / (max_slope * std::f64::consts::TAU.sqrt()))
    }
}

/// Offset at 0 and slope of the line fitted to (x, y, …), refitted three times to the inliers.
fn robust_line(mut points: Vec<[f64; 3]>) -> Option<[f64; 2]> {
    let mut line = fit_line(&points)?;
    for _ in 0..3 {
        let residual = |p: &[f64; 3], line: &[f64; 2]| (p[1] - line[0] - line[1] * p[0]).abs();
        let deviation = 1.4826 * median(points.iter().map(|p| residual(p, &line)))?;
        let limit = MAX_DEVIATIONS * deviation.max(MIN_DEVIATION_PX);
        points.retain(|p| residual(p, &line) < limit);
        line = fit_line(&points)?;
    }
    Some(line)
}

fn fit_line(points: &[[f64; 3]]) -> Option<[f64; 2]> {
    if points.len() < MIN_FITTED {
        return None;
    }
    let count = points.len() as f64;
    let mean = |axis: usize| points.iter().map(|p| p[axis]).sum::<f64>() / count;
    let (x, y) = (mean(0), mean(1));
    let xx: f64 = points.iter().map(|p| (p[0] - x).powi(2)).sum();
    let xy: f64 = points.iter().map(|p| (p[0] - x) * (p[1] - y)).sum();
    let slope = xy / xx;
    slope.is_finite().then_some([y - slope * x, slope])
}

/// Bilinearly interpolated linear light from 0 to 1. `None`: outside the image.
pub(crate) fn bilinear(image: &GrayImage, at: DVec2) -> Option<f64> {
    let (width, height) = (image.width() as usize, image.height() as usize);
    // False for NaN.
    let inside =
        at.x >= 0.0 && at.y >= 0.0 && at.x <= (width as f64) - 1.0 && at.y <= (height as f64) - 1.0;
    if !inside {
        return None;
    }
    let (x, y) = (at.x as usize, at.y as usize);
    let (fx, fy) = (at.x - x as f64, at.y - y as f64);
    let (right, below) = ((x + 1).min(width - 1), (y + 1).min(height - 1));
    let pixels = image.as_raw();
    let [a, b, c, d] = [(x, y), (right, y), (x, below), (right, below)]
        .map(|(x, y)| f64::from(srgb_decode(pixels[y * width + x])));
    let top = a * (1.0 - fx) + b * fx;
    let bottom = c * (1.0 - fx) + d * fx;
    Some(top * (1.0 - fy) + bottom * fy)
}
