//! What a calibration says of each marker, and of the whole.

use glam::DVec3;

use super::gripper_bundle::{Bundle, Free, Marker, OF_MARKER, Sight, Solved, View};
use super::gripper_check::{Moved, angle};
use super::gripper_frame::{Ties, scatter};
use super::gripper_result::{
    CalibratedMarker, FrameSource, GripperCalibration, GripperImage, MarkerState,
};
use super::gripper_start::{Selection, framed};
use crate::{Board, BoardFile, BoardMarker, Part};
use gripcast_base::error::Result;
use gripcast_base::linear::Symmetric;
use gripcast_geometry::Pose;

/// Deviations of a marker that are too large for poses of a tenth of a millimetre, m and rad.
const WEAK: (f64, f64) = (3e-4, 0.0052);
/// Loss with which the last place of a loose marker is found, px.
const LOOSE_LOSS_PX: f64 = 2.0;

/// A marker that did not stay in its place.
pub(super) struct Loosened {
    marker: Marker,
    moved: Option<Moved>,
    /// By image.
    sights: Vec<(usize, Sight)>,
}

impl Loosened {
    pub(super) fn new(bundle: &Bundle, place: usize, moved: Option<Moved>) -> Self {
        let own = |v: &View| {
            let sight = v.sights.iter().find(|s| s.marker == place)?.clone();
            Some((v.image, sight))
        };
        Self {
            marker: bundle.markers[place].clone(),
            moved,
            sights: bundle.views.iter().filter_map(own).collect(),
        }
    }

    fn state(&self, images: &[GripperImage]) -> MarkerState {
        let named = |m: Moved| {
            let names = m.images.map(|i| images[i].name.clone());
            (names, m.shift_m, m.turn_rad)
        };
        MarkerState::Loose {
            moved: self.moved.map(named),
        }
    }

    /// `t_part_marker` after it moved, in the bundle's frame; none if it moved more than once.
    fn last_place(&self, bundle: &Bundle) -> Option<Pose> {
        let since = self.moved?.images[1];
        let mut alone = Bundle {
            markers: vec![self.marker.clone()],
            ..bundle.clone()
        };
        alone.views.retain(|v| v.image >= since);
        for view in &mut alone.views {
            let own = self.sights.iter().find(|(image, _)| *image == view.image);
            let own = own.map(|(_, s)| Sight {
                marker: 0,
                used: true,
                ..s.clone()
            });
            view.sights = own.into_iter().collect();
        }
        alone.minimise(Free::Markers, LOOSE_LOSS_PX, &[])?;
        alone.markers.first().map(|m| m.pose)
    }
}

/// What a report is made of.
pub(super) struct Outcome<'a> {
    pub(super) nominal: &'a BoardFile,
    pub(super) images: &'a [GripperImage],
    pub(super) selection: Selection,
    pub(super) solved: Solved,
    pub(super) loosened: Vec<Loosened>,
    pub(super) left_out_rms: Vec<Option<f64>>,
    pub(super) covariance: Symmetric,
    pub(super) ties: Ties,
    pub(super) line: Option<(f64, f64)>,
    pub(super) holdout_rms_px: Option<f64>,
    pub(super) described_rms_px: Option<f64>,
}

impl Outcome<'_> {
    /// Place of a marker among those that were solved.
    fn solved_place(&self, id: u32) -> Option<usize> {
        self.solved.bundle.markers.iter().position(|m| m.id == id)
    }

    fn state(&self, id: u32) -> MarkerState {
        if let Some(loose) = self.loosened.iter().find(|l| l.marker.id == id) {
            return loose.state(self.images);
        }
        let selection = &self.selection;
        for (ids, reason) in [
            (&selection.unseen, "no image shows it"),
            (
                &selection.rare,
                "fewer than 4 images show it together with others",
            ),
            (
                &selection.apart,
                "no image shows it together with the others",
            ),
        ] {
            if ids.contains(&id) {
                return MarkerState::AsDescribed(reason);
            }
        }
        MarkerState::Calibrated
    }

    fn marker(&self, marker: &BoardMarker) -> (CalibratedMarker, [DVec3; 4]) {
        let mut framed = framed(marker);
        let place = self.solved_place(marker.id);
        if let Some(place) = place {
            framed.pose = self.solved.bundle.markers[place].pose;
        } else if let Some(loose) = self.loosened.iter().find(|l| l.marker.id == marker.id) {
            framed.pose = loose
                .last_place(&self.solved.bundle)
                .unwrap_or(framed.nominal);
        }
        let sights = self.solved.bundle.views.iter().flat_map(|v| {
            let own = v.sights.iter().filter(|s| Some(s.marker) == place);
            own.map(move |s| (v, s))
        });
        let sights: Vec<_> = sights.collect();
        let used = || sights.iter().filter(|(_, s)| s.used);
        let squares: f64 = used()
            .map(|(v, s)| self.solved.bundle.sight_rms_px(v, s).powi(2))
            .sum();
        let count = used().count();
        let found = CalibratedMarker {
            id: marker.id,
            part: marker.part,
            state: self.state(marker.id),
            images: count,
            outliers: sights.len() - count,
            shift_m: framed.pose.translation_m - framed.nominal.translation_m,
            turn_rad: angle(&framed.pose, &framed.nominal),
            covariance: place.map(|place| self.block(place)),
            rms_px: (count > 0).then(|| (squares / count as f64).sqrt()),
            left_out_rms_px: place.and_then(|place| self.left_out_rms[place]),
        };
        (found, framed.corners())
    }

    fn block(&self, place: usize) -> [[f64; 6]; 6] {
        let (first, variance) = (OF_MARKER * place, self.solved.sigma_px.powi(2));
        let entry = |i, j| variance * self.covariance.at(first + i, first + j);
        std::array::from_fn(|i| std::array::from_fn(|j| entry(i, j)))
    }

    fn notes(&self, markers: &[CalibratedMarker]) -> Vec<String> {
        let mut notes = Vec::new();
        for m in markers {
            match &m.state {
                MarkerState::Calibrated => {}
                MarkerState::AsDescribed(reason) => notes.push(format!(
                    "marker {} stays where it is described: {reason}",
                    m.id
                )),
                MarkerState::Loose {
                    moved: Some(([a, b], shift, turn)),
                } => notes.push(format!(
                    "marker {} moved between {a} and {b}, by {:.2} mm and {:.1}°: glue it again \
                     and repeat the images; the file has its last place",
                    m.id,
                    1e3 * shift,
                    turn.to_degrees()
                )),
                MarkerState::Loose { moved: None } => notes.push(format!(
                    "marker {} does not stay in its place: glue it again and repeat the images; \
                     the file has it where it is described",
                    m.id
                )),
            }
            if m.sigma().is_some_and(|(t, r)| t > WEAK.0 || r > WEAK.1) {
                notes.push(format!(
                    "marker {} is known badly: add images that show it large, from several \
                     sides, together with others",
                    m.id
                ));
            }
        }
        let has_fingers = self.solved.bundle.markers.iter().any(|m| m.slide != 0.0);
        if has_fingers && !self.ties.zero_from_closed {
            notes.push(
                "no image with closed fingers was named (--closed): the opening's zero is that \
                 of the description"
                    .into(),
            );
        }
        if has_fingers && !self.ties.x_from_fingers {
            notes.push(
                "the fingers moved too little to show the x axis: it is that of the description; \
                 add images at openings 30 mm apart or more"
                    .into(),
            );
        }
        notes
    }
}

/// The report.
///
/// # Errors
/// `Input` for a board that cannot be, as two tags in one place.
pub(super) fn report(outcome: Outcome<'_>) -> Result<GripperCalibration> {
    let described = &outcome.nominal.board;
    let mut markers = Vec::new();
    let mut board = Board {
        name: format!("{}-calibrated", described.name),
        ..described.clone()
    };
    for marker in &mut board.markers {
        if marker.part == Part::Object {
            continue;
        }
        let (found, corners) = outcome.marker(marker);
        marker.corners_m = corners;
        markers.push(found);
    }
    let notes = outcome.notes(&markers);
    let bundle = &outcome.solved.bundle;
    let shows = |v: &&View| {
        v.frees_opening
            || v.sights
                .iter()
                .any(|s| bundle.markers[s.marker].slide != 0.0)
    };
    let has_fingers = bundle.markers.iter().any(|m| m.slide != 0.0);
    let openings = || bundle.views.iter().filter(shows).map(|v| v.opening_m);
    let span = [
        openings().fold(f64::INFINITY, f64::min),
        openings().fold(f64::NEG_INFINITY, f64::max),
    ];
    let source = |by_fingers: bool| match (has_fingers, by_fingers) {
        (_, true) => FrameSource::Fingers,
        (true, false) => FrameSource::Description,
        (false, false) => FrameSource::Nothing,
    };
    let frame = scatter(bundle, outcome.ties);
    let name = |i: usize| outcome.images[i].name.clone();
    let left_out = outcome.selection.left_out.iter();
    Ok(GripperCalibration {
        board: BoardFile::new(board, outcome.nominal.dictionary.clone(), None)?,
        markers,
        images: bundle.views.len(),
        rms_px: outcome.solved.rms_px,
        described_rms_px: outcome.described_rms_px,
        holdout_rms_px: outcome.holdout_rms_px,
        corner_sigma_px: outcome.solved.sigma_px,
        openings_m: has_fingers.then_some(span),
        x_from: match outcome.ties.x_from_fingers {
            true => FrameSource::Fingers,
            false => FrameSource::Description,
        },
        line_off_rad: outcome.line,
        zero_from: source(outcome.ties.zero_from_closed),
        frame_sigma_m: frame.map(|f| f.0),
        frame_sigma_rad: frame.map(|f| f.1),
        left_out: left_out
            .map(|(i, why)| (name(*i), (*why).to_owned()))
            .collect(),
        notes,
    })
}
