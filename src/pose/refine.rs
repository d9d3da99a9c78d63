//! Corners of markers from straight lines along their borders.
//!
//! A marker's sides are long and straight, so that a line fitted to many points of an edge is
//! known to a few hundredths of a pixel, and corners are where the lines meet. Refinement of the
//! corner itself is biased by the marker's inner pattern and by the lens's blur.

use glam::DVec2;
use image::GrayImage;

use super::Detection;

/// Most passes over the four sides; each samples along the lines of the one before.
const MOST_PASSES: usize = 5;
/// Corners that move less than this in a pass have arrived, px.
const ARRIVED_PX: f64 = 0.005;
/// Samples of the widest profile.
const MOST_SAMPLES: usize = 15;
/// Part of a side at each end that the other side's blur reaches.
const ENDS: f64 = 0.12;
/// Fewest profiles of a side, and fewest that its line is fitted to.
const LEAST_PROFILES: usize = 8;
const LEAST_FITTED: usize = 5;
/// Half-width of a profile: a part of the side between two limits, px.
const HALF_OF_SIDE: f64 = 1.0 / 12.0;
const HALF_WIDTH_PX: (f64, f64) = (1.5, 3.0);
/// Distance of samples across an edge, px.
const STEP_PX: f64 = 0.5;
/// Gradients below this part of a profile's largest are noise.
const NOISE: f64 = 0.25;
/// Profiles with less contrast than this part of the median are not of this edge.
const FAINT: f64 = 0.3;
/// Residuals within this many robust deviations are kept.
const KEPT_DEVIATIONS: f64 = 3.0;
/// Residuals of a perfect line, px.
const LEAST_DEVIATION_PX: f64 = 0.02;
/// Corners that move farther than this follow something else, px.
const FARTHEST_PX: f64 = 4.0;

/// The detection with corners where lines along its border meet; unchanged where the border does
/// not show four lines near the corners that were found.
///
/// Expects a dark border on a bright surround.
#[must_use]
pub fn refine_corners(picture: &GrayImage, detection: &Detection) -> Detection {
    let mut corners = detection.corners_px;
    for _ in 0..MOST_PASSES {
        let Some(next) = pass(picture, &corners) else {
            return detection.clone();
        };
        let step = farthest(&next, &corners);
        corners = next;
        if step < ARRIVED_PX {
            break;
        }
    }
    let is_near = farthest(&corners, &detection.corners_px) < FARTHEST_PX;
    if !(is_near && corners.iter().all(|c| c.is_finite())) {
        return detection.clone();
    }
    Detection {
        corners_px: corners,
        ..detection.clone()
    }
}

fn farthest(a: &[DVec2; 4], b: &[DVec2; 4]) -> f64 {
    let distances = a.iter().zip(b).map(|(a, b)| a.distance(*b));
    distances.fold(0.0, f64::max)
}

/// [`refine_corners`] of all detections.
#[must_use]
pub fn refine_all(picture: &GrayImage, detections: &[Detection]) -> Vec<Detection> {
    detections
        .iter()
        .map(|detection| refine_corners(picture, detection))
        .collect()
}

/// How sharp the edges of markers are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sharpness {
    /// Standard deviation of the blur across the more blurred pair of sides, px; the smallest is
    /// the sharpest. Sampling adds about a third of a pixel.
    pub blur_px: f64,
    /// Bright minus dark across an edge, grey levels.
    pub contrast: f64,
}

/// Sharpness of the markers of a picture: the median over them. None without markers.
///
/// The steepest slope s of an edge with contrast c blurred by a Gaussian is c/(σ √(2π)).
#[must_use]
pub fn sharpness(picture: &GrayImage, detections: &[Detection]) -> Option<Sharpness> {
    let mut all: Vec<Sharpness> = detections
        .iter()
        .filter_map(|d| marker_sharpness(picture, &d.corners_px))
        .collect();
    all.sort_by(|a, b| a.blur_px.total_cmp(&b.blur_px));
    all.get(all.len() / 2).copied()
}

fn marker_sharpness(picture: &GrayImage, corners: &[DVec2; 4]) -> Option<Sharpness> {
    let mut sides = [Sharpness {
        blur_px: 0.0,
        contrast: 0.0,
    }; 4];
    for (i, side) in sides.iter_mut().enumerate() {
        let edge = Edge::new(corners, i)?;
        let mut sums = [0.0; MOST_SAMPLES];
        let mut count = 0.0;
        for along in edge.positions() {
            let profile = edge.profile(picture, along)?;
            count += 1.0;
            for (sum, value) in sums.iter_mut().zip(profile) {
                *sum += value;
            }
        }
        let mean: Vec<f64> = sums
            .iter()
            .take(edge.samples())
            .map(|s| s / count)
            .collect();
        let steepest = mean
            .windows(2)
            .map(|w| (w[1] - w[0]) / STEP_PX)
            .fold(0.0, f64::max);
        let low = mean.iter().copied().fold(f64::INFINITY, f64::min);
        let contrast = mean.iter().copied().fold(0.0, f64::max) - low;
        if steepest <= 0.0 {
            return None;
        }
        let blur_px = contrast / (steepest * std::f64::consts::TAU.sqrt());
        *side = Sharpness { blur_px, contrast };
    }
    // Motion blurs one pair of opposite sides.
    let pair = |a: usize, b: usize| Sharpness {
        blur_px: 0.5 * (sides[a].blur_px + sides[b].blur_px),
        contrast: 0.5 * (sides[a].contrast + sides[b].contrast),
    };
    let (first, second) = (pair(0, 2), pair(1, 3));
    Some(if first.blur_px > second.blur_px {
        first
    } else {
        second
    })
}

/// New corners from a line along each side.
fn pass(picture: &GrayImage, corners: &[DVec2; 4]) -> Option<[DVec2; 4]> {
    let mut lines = [(DVec2::ZERO, DVec2::ZERO); 4];
    for (i, line) in lines.iter_mut().enumerate() {
        *line = Edge::new(corners, i)?.line(picture)?;
    }
    let mut next = *corners;
    for (i, corner) in next.iter_mut().enumerate() {
        *corner = intersection(lines[(i + 3) % 4], lines[i])?;
    }
    Some(next)
}

/// Where two lines of a point and a direction meet.
fn intersection((p, d): (DVec2, DVec2), (q, e): (DVec2, DVec2)) -> Option<DVec2> {
    let sine = d.perp_dot(e);
    (sine.abs() > 0.05 * d.length() * e.length()).then(|| p + d * ((q - p).perp_dot(e) / sine))
}

/// A side of a marker, to be sampled across.
struct Edge {
    middle: DVec2,
    direction: DVec2,
    /// Away from the marker's middle.
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
        let middle = 0.5 * (a + b);
        let normal = direction.perp();
        let is_usable = length.is_finite() && length > 4.0;
        is_usable.then(|| Self {
            middle,
            direction,
            outward: if normal.dot(middle - centre) < 0.0 {
                -normal
            } else {
                normal
            },
            length,
            half_width: (length * HALF_OF_SIDE).clamp(HALF_WIDTH_PX.0, HALF_WIDTH_PX.1),
        })
    }

    /// Places of profiles along the side, px from its middle.
    fn positions(&self) -> impl Iterator<Item = f64> {
        let count = LEAST_PROFILES.max(self.length as usize);
        let span = (1.0 - 2.0 * ENDS) * self.length;
        (0..count).map(move |i| span * (i as f64 / (count - 1) as f64 - 0.5))
    }

    fn samples(&self) -> usize {
        (2 * ((self.half_width + 0.5) / STEP_PX) as usize + 1).min(MOST_SAMPLES)
    }

    /// Distance of sample `i` from the side, outwards, px.
    fn across(&self, i: usize) -> f64 {
        (i as f64 - 0.5 * (self.samples() - 1) as f64) * STEP_PX
    }

    /// Grey levels across the side, from inside to outside, [`Self::samples`] of them; none
    /// beyond the picture's border.
    fn profile(&self, picture: &GrayImage, along: f64) -> Option<[f64; MOST_SAMPLES]> {
        let on_side = self.middle + self.direction * along;
        let mut levels = [0.0; MOST_SAMPLES];
        for (i, level) in levels.iter_mut().enumerate().take(self.samples()) {
            *level = bilinear(picture, on_side + self.outward * self.across(i))?;
        }
        Some(levels)
    }

    /// Point and direction of the line that fits the edge.
    fn line(&self, picture: &GrayImage) -> Option<(DVec2, DVec2)> {
        let mut points: Vec<[f64; 3]> = Vec::new();
        for along in self.positions() {
            let Some(profile) = self.profile(picture, along) else {
                continue;
            };
            if let Some((offset, contrast)) = self.crossing(&profile[..self.samples()]) {
                points.push([along, offset, contrast]);
            }
        }
        let contrast = median(points.iter().map(|p| p[2]))?;
        points.retain(|p| p[2] > FAINT * contrast);
        let [offset, slope] = robust_line(points)?;
        Some((
            self.middle + self.outward * offset,
            self.direction + self.outward * slope,
        ))
    }

    /// Mean place of the brightening, weighted by its gradient, and the sum of the gradients.
    fn crossing(&self, profile: &[f64]) -> Option<(f64, f64)> {
        let gradients = || profile.windows(2).map(|w| (w[1] - w[0]).max(0.0));
        let noise = NOISE * gradients().fold(0.0, f64::max);
        let (mut sum, mut moment) = (0.0, 0.0);
        for (i, gradient) in gradients().enumerate() {
            if gradient >= noise {
                sum += gradient;
                moment += gradient * (self.across(i) + 0.5 * STEP_PX);
            }
        }
        (sum > 0.0).then(|| (moment / sum, sum))
    }
}

/// Offset at 0 and slope of the line through (x, y, …), three times without what is far off.
fn robust_line(mut points: Vec<[f64; 3]>) -> Option<[f64; 2]> {
    let mut line = fitted(&points)?;
    for _ in 0..3 {
        let residual = |p: &[f64; 3], line: &[f64; 2]| (p[1] - line[0] - line[1] * p[0]).abs();
        let deviation = 1.4826 * median(points.iter().map(|p| residual(p, &line)))?;
        let limit = KEPT_DEVIATIONS * deviation.max(LEAST_DEVIATION_PX);
        points.retain(|p| residual(p, &line) < limit);
        line = fitted(&points)?;
    }
    Some(line)
}

fn fitted(points: &[[f64; 3]]) -> Option<[f64; 2]> {
    if points.len() < LEAST_FITTED {
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

fn median(values: impl Iterator<Item = f64>) -> Option<f64> {
    let mut sorted: Vec<f64> = values.collect();
    let middle = sorted.len() / 2;
    if sorted.is_empty() {
        return None;
    }
    Some(*sorted.select_nth_unstable_by(middle, f64::total_cmp).1)
}

/// Grey level between pixels; none outside of the picture.
fn bilinear(picture: &GrayImage, at: DVec2) -> Option<f64> {
    let (width, height) = (picture.width() as usize, picture.height() as usize);
    // Written so that NaN is outside as well.
    let inside =
        at.x >= 0.0 && at.y >= 0.0 && at.x <= (width as f64) - 1.0 && at.y <= (height as f64) - 1.0;
    if !inside {
        return None;
    }
    let (x, y) = (at.x as usize, at.y as usize);
    let (fx, fy) = (at.x - x as f64, at.y - y as f64);
    let (right, below) = ((x + 1).min(width - 1), (y + 1).min(height - 1));
    let pixels = picture.as_raw();
    let level = |x: usize, y: usize| f64::from(pixels[y * width + x]);
    let top = level(x, y) * (1.0 - fx) + level(right, y) * fx;
    let bottom = level(x, below) * (1.0 - fx) + level(right, below) * fx;
    Some(top * (1.0 - fy) + bottom * fy)
}
