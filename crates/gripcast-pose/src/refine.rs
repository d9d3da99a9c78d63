//! Corners of markers from straight lines along their borders.
//!
//! A marker's sides are long and straight, so that a line fitted to many points of an edge is
//! known to a few hundredths of a pixel, and corners are where the lines meet. Refinement of the
//! corner itself is biased by the marker's inner pattern and by the lens's blur.
//!
//! The lens blurs light, the camera then stores sRGB levels, in which the middle of a blurred edge
//! lies on its dark side: markers seem smaller by 0.3 px a corner at a blur of 0.7 px. Edges are
//! found in levels, where noise is even, and moved back by what the same edge would be off if it
//! were symmetric in light.

use std::cmp::Ordering;

use glam::DVec2;
use image::GrayImage;

use gripcast_base::statistics::median;

use super::Detection;
use gripcast_imaging::srgb_decode;

/// Most passes over the four sides; each samples along the lines of the one before.
const MAX_PASSES: usize = 10;
/// Corners that move less than this in a pass have arrived, px.
const ARRIVED_PX: f64 = 0.005;
/// Samples of the widest profile.
const MAX_SAMPLES: usize = 15;
/// Part of a side at each end that the other side's blur reaches.
const ENDS: f64 = 0.12;
/// Fewest profiles of a side, and fewest that its line is fitted to.
const MIN_PROFILES: usize = 8;
const MIN_FITTED: usize = 5;
/// Half-width of a profile: a part of the side between two limits, px.
const HALF_OF_SIDE: f64 = 1.0 / 12.0;
const HALF_WIDTH_PX: (f64, f64) = (1.5, 3.0);
/// Distance of samples across an edge, px.
const STEP_PX: f64 = 0.5;
/// Reach of the light that is summed to both sides of an edge, as a part of the blur, and at least,
/// in samples: what lies beyond is noise or another edge.
const REACH_OF_BLUR: f64 = 1.3;
const MIN_REACH: usize = 2;
/// Profiles with less contrast than this part of the median are not of this edge.
const FAINT: f64 = 0.3;
/// Residuals within this many robust deviations are kept.
const KEPT_DEVIATIONS: f64 = 3.0;
/// Residuals of a perfect line, px.
const MIN_DEVIATION_PX: f64 = 0.02;
/// Corners that move farther than this follow something else, px.
const MAX_PX: f64 = 4.0;

/// The detection with corners where lines along its border meet; unchanged where the border does
/// not show four lines near the corners that were found.
///
/// Expects a dark border on a bright surround.
#[must_use]
pub fn refine_corners(image: &GrayImage, detection: &Detection) -> Detection {
    let mut corners = detection.corners_px;
    for _ in 0..MAX_PASSES {
        let Some(next) = pass(image, &corners) else {
            return detection.clone();
        };
        let step = farthest(&next, &corners);
        corners = next;
        if step < ARRIVED_PX {
            break;
        }
    }
    let is_near = farthest(&corners, &detection.corners_px) < MAX_PX;
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
pub fn refine_all(image: &GrayImage, detections: &[Detection]) -> Vec<Detection> {
    detections
        .iter()
        .map(|detection| refine_corners(image, detection))
        .collect()
}

/// How sharp the edges of markers are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sharpness {
    /// Standard deviation of the blur across the more blurred pair of sides, px; the smallest is
    /// the sharpest. Sampling adds about a third of a pixel.
    pub blur_px: f64,
    /// Bright minus dark across an edge, linear light from 0 to 1.
    pub contrast: f64,
}

/// Sharpness of the markers of an image: the median over them. None without markers.
#[must_use]
pub fn sharpness(image: &GrayImage, detections: &[Detection]) -> Option<Sharpness> {
    let mut all: Vec<Sharpness> = detections
        .iter()
        .filter_map(|d| marker_sharpness(image, &d.corners_px))
        .collect();
    all.sort_by(|a, b| a.blur_px.total_cmp(&b.blur_px));
    all.get(all.len() / 2).copied()
}

fn marker_sharpness(image: &GrayImage, corners: &[DVec2; 4]) -> Option<Sharpness> {
    let mut sides = [Sharpness {
        blur_px: 0.0,
        contrast: 0.0,
    }; 4];
    for (i, side) in sides.iter_mut().enumerate() {
        let edge = Edge::new(corners, i)?;
        let seen = Side::sample(image, edge)?;
        let (blur_px, contrast) = (seen.blur_px()?, seen.contrast());
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
fn pass(image: &GrayImage, corners: &[DVec2; 4]) -> Option<[DVec2; 4]> {
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

/// Where two lines of a point and a direction meet.
fn intersection((p, d): (DVec2, DVec2), (q, e): (DVec2, DVec2)) -> Option<DVec2> {
    let sine = d.perp_dot(e);
    (sine.abs() > 0.05 * d.length() * e.length()).then(|| p + d * ((q - p).perp_dot(e) / sine))
}

/// Samples across a side, from inside to outside.
struct Profile {
    /// Levels as the camera stored them.
    levels: [f64; MAX_SAMPLES],
    /// Light, from 0 to 1; interpolated as light, as an edge is as steep as a pixel is wide.
    light: [f64; MAX_SAMPLES],
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
        let count = MIN_PROFILES.max(self.length as usize);
        let span = (1.0 - 2.0 * ENDS) * self.length;
        (0..count).map(move |i| span * (i as f64 / (count - 1) as f64 - 0.5))
    }

    fn samples(&self) -> usize {
        (2 * ((self.half_width + 0.5) / STEP_PX) as usize + 1).min(MAX_SAMPLES)
    }

    /// Distance of sample `i` from the side, outwards, px.
    fn across(&self, i: usize) -> f64 {
        (i as f64 - 0.5 * (self.samples() - 1) as f64) * STEP_PX
    }

    /// Levels across the side, from inside to outside, [`Self::samples`] of them; none
    /// beyond the image's border.
    fn profile(&self, image: &GrayImage, along: f64) -> Option<Profile> {
        let on_side = self.middle + self.direction * along;
        let mut profile = Profile {
            levels: [0.0; MAX_SAMPLES],
            light: [0.0; MAX_SAMPLES],
        };
        for i in 0..self.samples() {
            [profile.levels[i], profile.light[i]] =
                bilinear(image, on_side + self.outward * self.across(i))?;
        }
        Some(profile)
    }

    fn mean<'a>(&self, profiles: impl Iterator<Item = &'a [f64; MAX_SAMPLES]>) -> Vec<f64> {
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

/// An edge with what the image shows across it.
struct Side {
    edge: Edge,
    /// Places along the edge, px from its middle, and the profile there.
    profiles: Vec<(f64, Profile)>,
    /// Mean of the profiles' light.
    light: Vec<f64>,
}

impl Side {
    /// None where the image shows less than a line needs.
    fn sample(image: &GrayImage, edge: Edge) -> Option<Self> {
        let at = |along| Some((along, edge.profile(image, along)?));
        let profiles: Vec<_> = edge.positions().filter_map(at).collect();
        let light = edge.mean(profiles.iter().map(|p| &p.1.light));
        (profiles.len() >= MIN_FITTED).then_some(Self {
            edge,
            profiles,
            light,
        })
    }

    /// Point and direction of the line that fits the edge.
    fn line(&self) -> Option<(DVec2, DVec2)> {
        let edge = &self.edge;
        let last = self.light.len() - 1;
        let reach = (REACH_OF_BLUR * self.blur_px()? / STEP_PX).round() as usize;
        let reach = reach.clamp(MIN_REACH, last / 2);
        let within = last / 2 - reach..=last / 2 + reach;
        let (dark, bright) = (self.light[*within.start()], self.light[*within.end()]);
        let contrast = bright - dark;
        // What is missing of a step at 0, whose own sample is half.
        let shifts = self.profiles.iter().map(|(along, profile)| {
            let light = &profile.light[within.clone()];
            let missing = |(i, l): (usize, &f64)| {
                let step = match i.cmp(&reach) {
                    Ordering::Less => dark,
                    Ordering::Equal => 0.5 * (dark + bright),
                    Ordering::Greater => bright,
                };
                step - l
            };
            let missing: f64 = light.iter().enumerate().map(missing).sum();
            let own = light[2 * reach] - light[0];
            [*along, STEP_PX * missing / contrast, own]
        });
        let mut points: Vec<[f64; 3]> = shifts.collect();
        let usual = median(points.iter().map(|p| p[2]))?;
        points.retain(|p| p[2] > FAINT * usual);
        let [offset, slope] = robust_line(points)?;
        (contrast > 0.0).then_some((
            edge.middle + edge.outward * offset,
            edge.direction + edge.outward * slope,
        ))
    }

    fn contrast(&self) -> f64 {
        let low = self.light.iter().copied().fold(f64::INFINITY, f64::min);
        self.light.iter().copied().fold(0.0, f64::max) - low
    }

    /// Standard deviation of the blur: the steepest slope s of an edge with contrast c blurred by a
    /// Gaussian is c/(σ √(2π)). None where nothing gets brighter.
    fn blur_px(&self) -> Option<f64> {
        let slopes = self.light.windows(2).map(|w| (w[1] - w[0]) / STEP_PX);
        let steepest = slopes.fold(0.0, f64::max);
        (steepest > 0.0).then(|| self.contrast() / (steepest * std::f64::consts::TAU.sqrt()))
    }
}

/// Offset at 0 and slope of the line through (x, y, …), three times without what is far off.
fn robust_line(mut points: Vec<[f64; 3]>) -> Option<[f64; 2]> {
    let mut line = fitted(&points)?;
    for _ in 0..3 {
        let residual = |p: &[f64; 3], line: &[f64; 2]| (p[1] - line[0] - line[1] * p[0]).abs();
        let deviation = 1.4826 * median(points.iter().map(|p| residual(p, &line)))?;
        let limit = KEPT_DEVIATIONS * deviation.max(MIN_DEVIATION_PX);
        points.retain(|p| residual(p, &line) < limit);
        line = fitted(&points)?;
    }
    Some(line)
}

fn fitted(points: &[[f64; 3]]) -> Option<[f64; 2]> {
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

/// Level, and light from 0 to 1, between pixels; none outside of the image.
fn bilinear(image: &GrayImage, at: DVec2) -> Option<[f64; 2]> {
    let (width, height) = (image.width() as usize, image.height() as usize);
    // Written so that NaN is outside as well.
    let inside =
        at.x >= 0.0 && at.y >= 0.0 && at.x <= (width as f64) - 1.0 && at.y <= (height as f64) - 1.0;
    if !inside {
        return None;
    }
    let (x, y) = (at.x as usize, at.y as usize);
    let (fx, fy) = (at.x - x as f64, at.y - y as f64);
    let (right, below) = ((x + 1).min(width - 1), (y + 1).min(height - 1));
    let pixels = image.as_raw();
    let levels =
        [(x, y), (right, y), (x, below), (right, below)].map(|(x, y)| pixels[y * width + x]);
    let mixed = |[a, b, c, d]: [f64; 4]| {
        let top = a * (1.0 - fx) + b * fx;
        let bottom = c * (1.0 - fx) + d * fx;
        top * (1.0 - fy) + bottom * fy
    };
    Some([
        mixed(levels.map(f64::from)),
        mixed(levels.map(|level| f64::from(srgb_decode(level)))),
    ])
}
