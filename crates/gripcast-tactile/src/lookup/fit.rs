//! Fits a Taxim table to presses of a ball (Si & Yuan 2022, §III-A).
//!
//! The slope at a pixel is that of the ball. Each press assigns to every bin the mean change and
//! position of its pixels; empty bins copy the nearest filled one. Each bin then has one sample per
//! press, to which its polynomial is fitted.

use std::collections::VecDeque;

use super::table::{Coefficients, SampleRange, TaximTable, bin, terms};
use gripcast_base::error::{Error, Result};
use gripcast_base::linear::Cholesky;

/// Ridge per press towards a change independent of the position; regularises few presses at similar
/// positions.
const RIDGE: f64 = 1e-3;

/// A press of a ball.
#[derive(Clone, Debug)]
pub struct BallPress<'a> {
    /// Change of red, green, blue relative to the untouched gel, grey levels, row-major.
    pub change: &'a [[f32; 3]],
    /// Contact centre: column, row, px.
    pub center_px: [f64; 2],
    /// Contact radius, px.
    pub contact_radius_px: f64,
    /// Ball radius, px.
    pub ball_radius_px: f64,
}

/// Sample of a bin from one press.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Sample {
    /// Column and row, px.
    position: [f64; 2],
    change: [f64; 3],
}

impl TaximTable {
    /// Fits a table of `bins` × `bins` to presses on images of `image_size` (columns, rows).
    ///
    /// # Errors
    /// `Input` without presses, with fewer than 2 bins, for a press of another size or without a
    /// contact pixel in the image.
    pub fn fit(presses: &[BallPress<'_>], image_size: [usize; 2], bins: usize) -> Result<Self> {
        let refused = |what: String| Error::input(what);
        if presses.is_empty() || bins < 2 {
            return Err(refused(format!(
                "a table requires at least 1 press and 2 bins, found {} and {bins}",
                presses.len()
            )));
        }
        let mut binned = Vec::with_capacity(presses.len());
        for (index, press) in presses.iter().enumerate() {
            let expected = image_size[0] * image_size[1];
            if press.change.len() != expected {
                return Err(refused(format!(
                    "press {index}: expected {expected} pixels, found {}",
                    press.change.len()
                )));
            }
            let filled = press.binned(image_size[0], bins).ok_or_else(|| {
                refused(format!(
                    "press {index}: no pixel of the contact lies in the image"
                ))
            })?;
            binned.push(filled);
        }
        let mut channels = [0; 3].map(|_| Vec::with_capacity(bins * bins));
        let mut ranges = Vec::with_capacity(bins * bins);
        let mut samples = Vec::with_capacity(binned.len());
        for bin in 0..bins * bins {
            samples.clear();
            samples.extend(binned.iter().map(|filled| filled[bin]));
            let fitted = polynomial(&samples, image_size);
            for (channel, coefficients) in channels.iter_mut().zip(fitted) {
                channel.push(coefficients);
            }
            let mut range = SampleRange::EMPTY;
            samples.iter().for_each(|s| range.add(s.position, s.change));
            ranges.push(range);
        }
        Ok(Self::new(bins, image_size, channels, ranges))
    }
}

impl BallPress<'_> {
    /// Returns the mean position and change of each bin; `None` if no pixel is in contact.
    fn binned(&self, width: usize, bins: usize) -> Option<Vec<Sample>> {
        let mut sums = vec![(0.0, Sample::default()); bins * bins];
        let reach = self.contact_radius_px.min(self.ball_radius_px);
        for (pixel, change) in self.change.iter().enumerate() {
            let position = [(pixel % width) as f64, (pixel / width) as f64];
            let [x, y] = [0, 1].map(|axis| position[axis] - self.center_px[axis]);
            let radius = x.hypot(y);
            if radius >= reach {
                continue;
            }
            // The height decreases away from the centre.
            let angle = (radius / self.ball_radius_px).asin();
            let (count, sum) = &mut sums[bin(bins, angle, (-y).atan2(-x))];
            *count += 1.0;
            for (sum, coordinate) in sum.position.iter_mut().zip(position) {
                *sum += coordinate;
            }
            for (sum, change) in sum.change.iter_mut().zip(change) {
                *sum += f64::from(*change);
            }
        }
        let mut queue: VecDeque<usize> = (0..sums.len()).filter(|b| sums[*b].0 > 0.0).collect();
        if queue.is_empty() {
            return None;
        }
        let mut filled: Vec<Sample> = sums.iter().map(|(count, sum)| sum.over(*count)).collect();
        let mut is_filled: Vec<bool> = sums.iter().map(|(count, _)| *count > 0.0).collect();
        while let Some(from) = queue.pop_front() {
            for to in neighbours(from, bins).into_iter().flatten() {
                if !is_filled[to] {
                    is_filled[to] = true;
                    filled[to] = filled[from];
                    queue.push_back(to);
                }
            }
        }
        Some(filled)
    }
}

impl Sample {
    fn over(self, count: f64) -> Self {
        Self {
            position: self.position.map(|v| v / count),
            change: self.change.map(|v| v / count),
        }
    }
}

/// Neighbouring bins: next smaller and larger angle, and both directions (cyclic).
fn neighbours(bin: usize, bins: usize) -> [Option<usize>; 4] {
    let (angle, direction) = (bin / bins, bin % bins);
    [
        angle.checked_sub(1).map(|a| a * bins + direction),
        (angle + 1 < bins).then(|| (angle + 1) * bins + direction),
        Some(angle * bins + (direction + 1) % bins),
        Some(angle * bins + (direction + bins - 1) % bins),
    ]
}

/// Least-squares polynomials of red, green, blue over the samples of a bin.
fn polynomial(samples: &[Sample], [width, height]: [usize; 2]) -> [Coefficients; 3] {
    // Positions are scaled to about ±1 for conditioning.
    let scale = 2.0 / width.max(height) as f64;
    let middle = [0.5 * width as f64, 0.5 * height as f64];
    let mut normal = [[0.0; 6]; 6];
    let mut right = [[0.0; 6]; 3];
    for sample in samples {
        let position = [0, 1].map(|axis| (sample.position[axis] - middle[axis]) * scale);
        let row = terms(position);
        for (i, term) in row.iter().enumerate() {
            for (entry, other) in normal[i].iter_mut().zip(row) {
                *entry += term * other;
            }
            for (right, change) in right.iter_mut().zip(sample.change) {
                right[i] += term * change;
            }
        }
    }
    for (i, row) in normal.iter_mut().enumerate().take(5) {
        row[i] += RIDGE * samples.len() as f64;
    }
    let clamp = |rest: f64, _| Some(rest.max(f64::MIN_POSITIVE));
    let factor = Cholesky::with_pivots(&normal, clamp);
    right.map(|right| {
        let solved = factor.as_ref().map_or(right, |factor| factor.solve(&right));
        unscaled(solved, scale, middle)
    })
}

/// Converts a polynomial of scaled positions to pixels.
fn unscaled(c: Coefficients, s: f64, [mx, my]: [f64; 2]) -> Coefficients {
    let [xx, yy, xy, x, y, one] = [
        c[0] * s * s,
        c[1] * s * s,
        c[2] * s * s,
        c[3] * s,
        c[4] * s,
        c[5],
    ];
    [
        xx,
        yy,
        xy,
        x - 2.0 * xx * mx - xy * my,
        y - 2.0 * yy * my - xy * mx,
        one + xx * mx * mx + yy * my * my + xy * mx * my - x * mx - y * my,
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: [usize; 2] = [120, 90];

    /// A smooth table: the change of a slope at a place.
    fn truth(slope: [f64; 2], [x, y]: [f64; 2]) -> [f32; 3] {
        let [p, q] = slope.map(|s| s / (1.0 + s * s).sqrt());
        let u = (x - 60.0) / 60.0;
        [
            (60.0 * p + 10.0 * q * u) as f32,
            (-40.0 * q + 5.0 * u * u) as f32,
            (30.0 * (p + q) - 8.0 * (y - 45.0) / 60.0) as f32,
        ]
    }

    fn press(center: [f64; 2], ball: f64, contact: f64) -> Vec<[f32; 3]> {
        (0..SIZE[0] * SIZE[1])
            .map(|pixel| {
                let place = [(pixel % SIZE[0]) as f64, (pixel / SIZE[0]) as f64];
                let [x, y] = [place[0] - center[0], place[1] - center[1]];
                let radius = x.hypot(y);
                if radius >= contact {
                    return [0.0; 3];
                }
                let down = (ball * ball - radius * radius).sqrt();
                truth([-x / down, -y / down], place)
            })
            .collect()
    }

    fn fitted(centers: &[[f64; 2]]) -> (TaximTable, Vec<Vec<[f32; 3]>>) {
        let changes: Vec<_> = centers.iter().map(|c| press(*c, 40.0, 30.0)).collect();
        let presses: Vec<_> = centers
            .iter()
            .zip(&changes)
            .map(|(center, change)| BallPress {
                change,
                center_px: *center,
                contact_radius_px: 30.0,
                ball_radius_px: 40.0,
            })
            .collect();
        (TaximTable::fit(&presses, SIZE, 45).unwrap(), changes)
    }

    #[test]
    fn table_does_not_extrapolate_beyond_presses() {
        // Three presses at nearly one spot: the position polynomials are barely determined.
        let (table, changes) = fitted(&[[50.0, 40.0], [52.0, 41.0], [51.0, 43.0]]);
        let largest = changes.iter().flatten().flatten();
        let largest = f64::from(largest.fold(0.0, |most: f32, v| most.max(v.abs())));
        for slope in [[0.0, 0.01], [0.4, -0.3], [-0.7, 0.6], [-5.0, 9.0]] {
            let inside = table.change(slope, [50.0, 41.0]);
            for place in [[0.0, 0.0], [119.0, 0.0], [119.0, 89.0], [-1e6, 1e6]] {
                let change = table.change(slope, place);
                assert!(change.iter().all(|c| c.abs() <= largest), "{change:?}");
                // Three presses hold changes that differ little.
                for (change, inside) in change.iter().zip(inside) {
                    assert!(
                        (change - inside).abs() < 5.0,
                        "{slope:?}: {change} {inside}"
                    );
                }
            }
        }
    }

    #[test]
    fn fit_reproduces_synthetic_table() {
        let centers: Vec<[f64; 2]> = (0..20)
            .map(|i| {
                [
                    35.0 + f64::from(i % 5) * 12.0,
                    32.0 + f64::from(i / 5) * 9.0,
                ]
            })
            .collect();
        let (table, _) = fitted(&centers);
        let mut worst = 0.0f64;
        for slope in [[0.3, 0.1], [-0.5, 0.4], [0.02, -0.7], [0.6, -0.5]] {
            for place in [[45.0, 40.0], [60.0, 45.0], [75.0, 52.0]] {
                let found = table.change(slope.map(|s| s as f32), place);
                let expected = truth(slope, place);
                for (found, expected) in found.iter().zip(expected) {
                    worst = worst.max((found - f64::from(expected)).abs());
                }
            }
        }
        // A bin is 2 degrees of slope by 8 of direction wide: up to 4 grey levels from its middle.
        assert!(worst < 5.0, "{worst}");
    }

    #[test]
    fn unscaled_coefficients_are_equivalent() {
        let c = [1.0, -2.0, 0.5, 3.0, -1.0, 4.0];
        let (scale, middle) = (0.02, [60.0, 45.0]);
        let raw = unscaled(c, scale, middle);
        for place in [[3.0, 80.0], [100.0, 7.0]] {
            let scaled = [0, 1].map(|a| (place[a] - middle[a]) * scale);
            let value =
                |c: Coefficients, p| -> f64 { c.iter().zip(terms(p)).map(|(c, t)| c * t).sum() };
            assert!((value(raw, place) - value(c, scaled)).abs() < 1e-12);
        }
    }

    #[test]
    fn invalid_presses_are_refused() {
        let change = vec![[0.0; 3]; 10];
        let press = BallPress {
            change: &change,
            center_px: [5.0, 5.0],
            contact_radius_px: 3.0,
            ball_radius_px: 4.0,
        };
        let text = TaximTable::fit(std::slice::from_ref(&press), SIZE, 9)
            .unwrap_err()
            .to_string();
        assert!(text.contains("expected 10800"), "{text}");
        let outside = BallPress {
            center_px: [-9.0, 5.0],
            ..press
        };
        let text = TaximTable::fit(&[outside], [5, 2], 9)
            .unwrap_err()
            .to_string();
        assert!(text.contains("no pixel"), "{text}");
        assert!(TaximTable::fit(&[], SIZE, 9).is_err());
    }
}
