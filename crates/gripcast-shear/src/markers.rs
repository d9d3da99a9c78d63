//! Tracks the gel markers of one gel.
//!
//! Every frame is measured anew and only identities are carried over, so that errors do not add up.

use std::ops::RangeInclusive;

use image::RgbImage;

use crate::association::{Grid, Known, associate};
use crate::contact::{ContactArea, SkinCells};
use crate::darkness::Brightness;
use crate::dots::{Dot, distance};
use crate::lattice::{Lattice, median};
use crate::slip::SlipMeter;
use crate::tracker::decimal;
use crate::{GelMarker, MarkerField, ShearFrame, ShearProblem, ShearSource, ShearSummary};

/// Fraction of lost gel markers that is a problem.
const MANY_LOST: f32 = 0.2;
/// Median displacement of a gel without contact from which the identities are checked, pitches.
const SUSPICIOUS_REST: f32 = 0.25;
/// Maximum displacement that a gel allows, m: the pad is about 4 mm thick.
const MAX_DISPLACEMENT_M: f64 = 3.0e-3;
/// Minimum for a coarse lattice, pitches.
const MAX_DISPLACEMENT_PITCHES: f32 = 1.2;
/// Width of the edges of the dots for their darkness, relative to the initial image, from which an
/// image is blurred.
const BLURRED_EDGE: f32 = 1.5;
/// Median area of the dots outside the contact, relative to the initial image, of the same gel:
/// 0.90 to 1.06 in 72 recorded clips.
const SAME_AREA: RangeInclusive<f32> = 0.75..=1.33;
/// Minimum dots outside the contact for their area; with fewer, all count.
const MIN_OUTSIDE: usize = 6;
/// Darkness of a dot relative to the initial image: none and full confidence.
const DEPTH_RANGE: [f32; 2] = [0.4, 0.8];
/// Area of a dot relative to the initial image: none and full confidence, for smaller and for
/// larger dots.
const AREA_RANGE: [f32; 2] = [0.45, 0.85];
/// Distance to the edge of the image from which a gel marker is expected to be seen, diameters.
const MARGIN: f32 = 0.3;

/// Follows the gel markers of one gel.
#[derive(Clone, Debug)]
pub(crate) struct MarkerTracker {
    lattice: Lattice,
    grid: Grid,
    m_per_px: f64,
    rest_cells: SkinCells,
    known: Vec<Option<Known>>,
    slip: SlipMeter,
}

impl MarkerTracker {
    pub(crate) fn new(image: &RgbImage, lattice: Lattice, m_per_px: f64) -> Self {
        let rest = |dot: &Option<Dot>| {
            dot.map(|dot| Known {
                rest: dot.position,
                position: dot.position,
            })
        };
        let positions = lattice.present().map(|dot| dot.position);
        Self {
            grid: Grid {
                columns: lattice.columns,
                rows: lattice.rows,
                pitch: lattice.pitch(),
                size: [image.width(), image.height()],
            },
            m_per_px,
            rest_cells: SkinCells::new(image, positions, lattice.filter.diameter),
            known: lattice.dots.iter().map(rest).collect(),
            slip: SlipMeter::default(),
            lattice,
        }
    }

    pub(crate) fn update(&mut self, image: &RgbImage) -> ShearFrame {
        let dots = self.lattice.filter.find(&Brightness::new(image));
        let contact = self.contact(image, &dots);
        let mut found = associate(self.grid, &self.known, &dots);
        if contact.is_none() && self.is_far_from_rest(&found, &dots) {
            let rest = |known: &Known| Known {
                position: known.rest,
                ..*known
            };
            let rest: Vec<_> = self.known.iter().map(|k| k.as_ref().map(rest)).collect();
            let again = associate(self.grid, &rest, &dots);
            let count = |found: &[Option<usize>]| found.iter().flatten().count();
            if 10 * count(&again) >= 9 * count(&found) {
                found = again;
            }
        }
        let is_blurred = self.is_blurred(&found, &dots);
        let area = self.relative_area(&found, &dots, contact.as_ref());
        if let Some(area) = area.filter(|area| !is_blurred && !SAME_AREA.contains(area)) {
            let ratio = area.sqrt();
            return ShearFrame {
                problems: vec![ShearProblem::OtherMarkerSize { ratio }],
                ..ShearFrame::default()
            };
        }
        let field = self.field(&found, &dots);
        self.remember(&field);
        let mut problems = Vec::new();
        let summary = self.summary(&field, contact.as_ref());
        let (tracked, expected) = self.counts(&field);
        if (expected - tracked) as f32 > MANY_LOST * expected as f32 {
            problems.push(ShearProblem::ManyLost {
                lost: expected - tracked,
                total: expected,
            });
        }
        if is_blurred {
            problems.push(ShearProblem::Blurred);
        }
        let summary = summary.map(|summary| ShearSummary {
            confidence: summary.confidence * if is_blurred { 0.5 } else { 1.0 },
            ..summary
        });
        ShearFrame {
            summary,
            field: Some(field),
            problems,
        }
    }

    pub(crate) fn pitch_px(&self) -> f32 {
        self.grid.pitch
    }

    fn contact(&self, image: &RgbImage, dots: &[Dot]) -> Option<ContactArea> {
        let positions = dots.iter().map(|dot| dot.position);
        let now = SkinCells::new(image, positions, self.lattice.filter.diameter);
        ContactArea::between(&self.rest_cells, &now)
    }

    fn is_far_from_rest(&self, found: &[Option<usize>], dots: &[Dot]) -> bool {
        let displacements = found
            .iter()
            .zip(&self.known)
            .filter_map(|(dot, known)| Some(distance(dots.get((*dot)?)?.position, (*known)?.rest)));
        median(displacements.collect()).is_some_and(|d| d > SUSPICIOUS_REST * self.grid.pitch)
    }

    fn field(&self, found: &[Option<usize>], dots: &[Dot]) -> MarkerField {
        let limit = (MAX_DISPLACEMENT_M / self.m_per_px) as f32;
        let limit = limit.max(MAX_DISPLACEMENT_PITCHES * self.grid.pitch);
        let marker = |at: usize| {
            let (rest, known) = (self.lattice.dots[at]?, self.known[at]?);
            let dot = found[at].and_then(|dot| dots.get(dot));
            let dot = dot.filter(|dot| distance(dot.position, known.rest) <= limit);
            Some(GelMarker {
                rest_px: known.rest,
                position_px: dot.map_or(known.position, |dot| dot.position),
                confidence: dot.map_or(0.0, |dot| confidence(&rest, dot)),
            })
        };
        MarkerField {
            columns: self.grid.columns,
            rows: self.grid.rows,
            m_per_px: self.m_per_px,
            markers: (0..self.known.len()).map(marker).collect(),
        }
    }

    /// Keeps the positions for the next frame; a lost gel marker is expected where its neighbours are.
    fn remember(&mut self, field: &MarkerField) {
        let common = mean(
            field
                .markers
                .iter()
                .flatten()
                .filter(|m| m.confidence > 0.0),
        );
        for at in 0..self.known.len() {
            let Some(known) = &mut self.known[at] else {
                continue;
            };
            known.position = match field.tracked(at) {
                Some(marker) => marker.position_px,
                None => {
                    let around = self.grid.neighbours(at).filter_map(|i| field.tracked(i));
                    match mean(around).or(common) {
                        Some(moved) => [0, 1].map(|a| known.rest[a] + moved[a]),
                        None => known.position,
                    }
                }
            };
        }
    }

    /// Gel markers that are tracked, and those that should be: the others are outside the image.
    fn counts(&self, field: &MarkerField) -> (usize, usize) {
        let margin = MARGIN * self.lattice.filter.diameter;
        let is_inside = |position: [f32; 2]| {
            (0..2)
                .all(|a| (margin..=self.grid.size[a] as f32 - 1.0 - margin).contains(&position[a]))
        };
        let tracked = (0..self.known.len()).filter(|at| field.tracked(*at).is_some());
        let lost = (0..self.known.len()).filter(|at| {
            let is_lost = field.tracked(*at).is_none();
            is_lost && self.known[*at].is_some_and(|known| is_inside(known.position))
        });
        let tracked = tracked.count();
        (tracked, tracked + lost.count())
    }

    /// Dots that are whole now and in the initial image, as they were there and as they are.
    fn whole_dots<'a>(
        &'a self,
        found: &'a [Option<usize>],
        dots: &'a [Dot],
    ) -> impl Iterator<Item = (Dot, Dot)> + 'a {
        found
            .iter()
            .zip(&self.lattice.dots)
            .filter_map(|(dot, rest)| {
                let (rest, dot) = ((*rest)?, *dots.get((*dot)?)?);
                (rest.visible >= 1.0 && dot.visible >= 1.0).then_some((rest, dot))
            })
    }

    /// Whether the dots have wider edges, for their darkness, than in the initial image.
    fn is_blurred(&self, found: &[Option<usize>], dots: &[Dot]) -> bool {
        let width = |dot: &Dot| dot.edge / dot.depth.max(f32::MIN_POSITIVE);
        let ratios = self
            .whole_dots(found, dots)
            .map(|(rest, dot)| width(&dot) / width(&rest).max(f32::MIN_POSITIVE));
        median(ratios.collect()).is_some_and(|ratio| ratio > BLURRED_EDGE)
    }

    /// Median area of the dots where nothing touches the gel, relative to the initial image; `None`
    /// with too few dots.
    fn relative_area(
        &self,
        found: &[Option<usize>],
        dots: &[Dot],
        contact: Option<&ContactArea>,
    ) -> Option<f32> {
        let ratio = |(rest, dot): (Dot, Dot)| dot.area / rest.area.max(f32::MIN_POSITIVE);
        let is_outside =
            |(_, dot): &(Dot, Dot)| contact.is_none_or(|contact| !contact.contains(dot.position));
        let all = || self.whole_dots(found, dots);
        let outside: Vec<f32> = all().filter(is_outside).map(ratio).collect();
        let counted = if outside.len() < MIN_OUTSIDE {
            all().map(ratio).collect()
        } else {
            outside
        };
        (counted.len() >= MIN_OUTSIDE).then(|| median(counted))?
    }

    fn summary(
        &mut self,
        field: &MarkerField,
        contact: Option<&ContactArea>,
    ) -> Option<ShearSummary> {
        let (tracked, expected) = self.counts(field);
        let slip_ratio = self.slip.measure(field, contact);
        if tracked == 0 {
            return None;
        }
        let all = || (0..field.markers.len()).filter(|at| field.tracked(*at).is_some());
        let touched: Vec<usize> = match contact {
            Some(contact) => all()
                .filter(|at| {
                    field
                        .tracked(*at)
                        .is_some_and(|m| contact.contains(m.position_px))
                })
                .collect(),
            None => Vec::new(),
        };
        let counted = if touched.is_empty() {
            all().collect()
        } else {
            touched
        };
        let markers = || counted.iter().filter_map(|at| field.tracked(*at));
        let gradients: Vec<[[f32; 2]; 2]> = counted
            .iter()
            .filter_map(|at| field.gradient(at % field.columns, at / field.columns))
            .collect();
        let average = |value: fn(&[[f32; 2]; 2]) -> f32| {
            gradients.iter().map(value).sum::<f32>() / gradients.len().max(1) as f32
        };
        let mm_per_px = (1e3 * self.m_per_px) as f32;
        let lengths = all().filter_map(|at| field.tracked(at));
        let lengths = lengths.map(|marker| distance(marker.position_px, marker.rest_px));
        let confidence: f32 = all()
            .filter_map(|at| field.tracked(at))
            .map(|m| m.confidence)
            .sum();
        Some(ShearSummary {
            source: ShearSource::Markers,
            confidence: decimal(confidence / expected as f32),
            tracked_fraction: decimal(tracked as f32 / expected as f32),
            mean_displacement_mm: mean(markers())
                .unwrap_or_default()
                .map(|d| decimal(mm_per_px * d)),
            max_displacement_mm: decimal(mm_per_px * lengths.fold(0.0, f32::max)),
            divergence: decimal(average(|g| g[0][0] + g[1][1])),
            curl: decimal(average(|g| g[1][0] - g[0][1])),
            contact_fraction: decimal(contact.map_or(0.0, ContactArea::fraction)),
            slip_ratio: slip_ratio.map(decimal),
        })
    }
}

/// Mean displacement, px; `None` for no gel markers.
pub(crate) fn mean<'a>(markers: impl Iterator<Item = &'a GelMarker>) -> Option<[f32; 2]> {
    let (mut sum, mut count) = ([0.0; 2], 0.0);
    for marker in markers {
        let displacement = marker.displacement_px();
        sum = [0, 1].map(|a| sum[a] + displacement[a]);
        count += 1.0;
    }
    (count > 0.0).then(|| sum.map(|s| s / count))
}

/// Confidence that a dot is the gel marker that was seen in the initial image, above 0 to 1.
fn confidence(rest: &Dot, dot: &Dot) -> f32 {
    let within =
        |value: f32, [none, full]: [f32; 2]| ((value - none) / (full - none)).clamp(0.0, 1.0);
    let whole = |dot: &Dot| dot.area / dot.visible;
    let area = whole(dot) / whole(rest).max(f32::MIN_POSITIVE);
    let area = within(area.min(1.0 / area.max(f32::MIN_POSITIVE)), AREA_RANGE);
    let depth = within(dot.depth / rest.depth.max(f32::MIN_POSITIVE), DEPTH_RANGE);
    (area * depth * dot.visible).max(0.01)
}
