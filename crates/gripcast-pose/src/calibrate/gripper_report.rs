//! Assembly of the gripper calibration's result.

use glam::DVec3;

use super::gripper_bundle::{Bundle, Free, MARKER_PARAMETERS, Marker, Observation, Solution, View};
use super::gripper_check::Moved;
use super::gripper_frame::{FrameSources, frame_sigma};
use super::gripper_result::{
    CalibratedMarker, FrameSource, GripperCalibration, GripperImage, MarkerState,
};
use super::gripper_start::{Selection, framed};
use crate::least_squares::{angle_between, rms};
use crate::{Board, BoardFile, BoardMarker, Body};
use gripcast_base::error::Result;
use gripcast_base::linear::Symmetric;
use gripcast_geometry::Pose;

/// Standard deviations above which a marker is reported as uncertain, m and rad.
const UNCERTAIN: (f64, f64) = (3e-4, 0.0052);
/// Huber loss of the fit of a loose marker's last pose, px.
const LOOSE_LOSS_PX: f64 = 2.0;

/// A marker that moved during the image sequence.
pub(super) struct LooseMarker {
    marker: Marker,
    moved: Option<Moved>,
    /// By image.
    observations: Vec<(usize, Observation)>,
}

impl LooseMarker {
    pub(super) fn new(bundle: &Bundle, index: usize, moved: Option<Moved>) -> Self {
        let own = |v: &View| {
            let own = v.observations.iter().find(|o| o.marker == index)?;
            Some((v.image, own.clone()))
        };
        Self {
            marker: bundle.markers[index].clone(),
            moved,
            observations: bundle.views.iter().filter_map(own).collect(),
        }
    }

    fn state(&self, images: &[GripperImage]) -> MarkerState {
        let named = |m: Moved| {
            let names = m.images.map(|i| images[i].name.clone());
            (names, m.shift_m, m.rotation_rad)
        };
        MarkerState::Loose {
            moved: self.moved.map(named),
        }
    }

    /// `t_body_marker` after the move, in the frame of `bundle`. None if it moved more than once.
    fn last_pose(&self, bundle: &Bundle) -> Option<Pose> {
        let since = self.moved?.images[1];
        let mut alone = Bundle {
            markers: vec![self.marker.clone()],
            ..bundle.clone()
        };
        alone.views.retain(|v| v.image >= since);
        for view in &mut alone.views {
            let mut observations = self.observations.iter();
            let own = observations.find(|(image, _)| *image == view.image);
            let own = own.map(|(_, o)| Observation {
                marker: 0,
                used: true,
                ..o.clone()
            });
            view.observations = own.into_iter().collect();
        }
        alone.minimise(Free::Markers, LOOSE_LOSS_PX, &[])?;
        alone.markers.first().map(|m| m.pose)
    }
}

/// Data of the report.
pub(super) struct ReportInput<'a> {
    pub(super) nominal: &'a BoardFile,
    pub(super) images: &'a [GripperImage],
    pub(super) selection: Selection,
    pub(super) solution: Solution,
    pub(super) loose: Vec<LooseMarker>,
    pub(super) left_out_rms: Vec<Option<f64>>,
    pub(super) covariance: Symmetric,
    pub(super) sources: FrameSources,
    pub(super) line: Option<(f64, f64)>,
    pub(super) holdout_rms_px: Option<f64>,
    pub(super) described_rms_px: Option<f64>,
}

impl ReportInput<'_> {
    fn state(&self, id: u32) -> MarkerState {
        if let Some(loose) = self.loose.iter().find(|l| l.marker.id == id) {
            return loose.state(self.images);
        }
        let selection = &self.selection;
        for (ids, reason) in [
            (&selection.unobserved, "not in any image"),
            (
                &selection.rare,
                "in fewer than 4 images together with others",
            ),
            (
                &selection.unlinked,
                "not in any image together with the others",
            ),
        ] {
            if ids.contains(&id) {
                return MarkerState::Nominal(reason);
            }
        }
        MarkerState::Calibrated
    }

    fn marker(&self, marker: &BoardMarker) -> (CalibratedMarker, [DVec3; 4]) {
        let bundle = &self.solution.bundle;
        let mut framed = framed(marker);
        let index = bundle.markers.iter().position(|m| m.id == marker.id);
        if let Some(index) = index {
            framed.pose = bundle.markers[index].pose;
        } else if let Some(loose) = self.loose.iter().find(|l| l.marker.id == marker.id) {
            framed.pose = loose.last_pose(bundle).unwrap_or(framed.nominal);
        }
        let observations = bundle.views.iter().flat_map(|v| {
            let own = v.observations.iter().filter(|o| Some(o.marker) == index);
            own.map(move |o| (v, o))
        });
        let (inliers, outliers): (Vec<_>, Vec<_>) = observations.partition(|(_, o)| o.used);
        let errors: Vec<f64> = inliers.iter().map(|(v, o)| bundle.rms_px(v, o)).collect();
        let calibrated = CalibratedMarker {
            id: marker.id,
            body: marker.body,
            state: self.state(marker.id),
            images: inliers.len(),
            outliers: outliers.len(),
            shift_m: framed.pose.translation_m - framed.nominal.translation_m,
            rotation_rad: angle_between(&framed.pose, &framed.nominal),
            covariance: index.map(|index| self.marker_covariance(index)),
            rms_px: (!errors.is_empty()).then(|| rms(&errors)),
            left_out_rms_px: index.and_then(|index| self.left_out_rms[index]),
        };
        (calibrated, framed.corners())
    }

    fn marker_covariance(&self, index: usize) -> [[f64; 6]; 6] {
        let first = MARKER_PARAMETERS * index;
        let variance = self.solution.sigma_px.powi(2);
        let entry = |i, j| variance * self.covariance.at(first + i, first + j);
        std::array::from_fn(|i| std::array::from_fn(|j| entry(i, j)))
    }

    fn notes(&self, markers: &[CalibratedMarker]) -> Vec<String> {
        let mut notes = Vec::new();
        for m in markers {
            match &m.state {
                MarkerState::Calibrated => {}
                MarkerState::Nominal(reason) => notes.push(format!(
                    "marker {} keeps its pose of the board file: {reason}",
                    m.id
                )),
                MarkerState::Loose {
                    moved: Some(([a, b], shift, rotation)),
                } => notes.push(format!(
                    "marker {} moved between {a} and {b}, by {:.2} mm and {:.1}°: glue it again \
                     and repeat the images; the result has its last pose",
                    m.id,
                    1e3 * shift,
                    rotation.to_degrees()
                )),
                MarkerState::Loose { moved: None } => notes.push(format!(
                    "marker {} is loose: glue it again and repeat the images; the result has its \
                     pose of the board file",
                    m.id
                )),
            }
            if m.sigma()
                .is_some_and(|(t, r)| t > UNCERTAIN.0 || r > UNCERTAIN.1)
            {
                notes.push(format!(
                    "marker {} is uncertain: add close images of it from several sides, together \
                     with others",
                    m.id
                ));
            }
        }
        if self.has_fingers() && !self.sources.zero_from_closed {
            notes.push(
                "no image with closed fingers (--closed): the zero of the opening is taken from \
                 the board file"
                    .into(),
            );
        }
        if self.has_fingers() && !self.sources.x_from_fingers {
            notes.push(
                "the fingers moved too little to determine the x axis: it is taken from the board \
                 file; add images at openings 30 mm apart or more"
                    .into(),
            );
        }
        notes
    }

    fn has_fingers(&self) -> bool {
        let mut markers = self.solution.bundle.markers.iter();
        markers.any(|m| m.slide != 0.0)
    }
}

/// Assembles the result.
///
/// # Errors
/// `Input` for an invalid board, for instance overlapping tags.
pub(super) fn report(input: ReportInput<'_>) -> Result<GripperCalibration> {
    let nominal = &input.nominal.board;
    let mut markers = Vec::new();
    let mut board = Board {
        name: format!("{}-calibrated", nominal.name),
        ..nominal.clone()
    };
    for marker in &mut board.markers {
        if marker.body == Body::Object {
            continue;
        }
        let (calibrated, corners) = input.marker(marker);
        marker.corners_m = corners;
        markers.push(calibrated);
    }
    let bundle = &input.solution.bundle;
    let shows_finger = |v: &&View| {
        let mut observations = v.observations.iter();
        v.frees_opening || observations.any(|o| bundle.markers[o.marker].slide != 0.0)
    };
    let views = bundle.views.iter().filter(shows_finger);
    let openings = views.map(|v| v.opening_m);
    let span = openings.fold([f64::INFINITY, f64::NEG_INFINITY], |[min, max], opening| {
        [min.min(opening), max.max(opening)]
    });
    let source = |from_fingers: bool| match from_fingers {
        true => FrameSource::Fingers,
        false => FrameSource::Description,
    };
    let zero_from = match (input.has_fingers(), input.sources.zero_from_closed) {
        (false, false) => FrameSource::Nothing,
        (_, from_closed) => source(from_closed),
    };
    let frame = frame_sigma(bundle, input.sources);
    let name = |i: usize| input.images[i].name.clone();
    let left_out = input.selection.left_out.iter();
    Ok(GripperCalibration {
        board: BoardFile::new(board, input.nominal.dictionary.clone(), None)?,
        notes: input.notes(&markers),
        markers,
        images: bundle.views.len(),
        rms_px: input.solution.rms_px,
        described_rms_px: input.described_rms_px,
        holdout_rms_px: input.holdout_rms_px,
        corner_sigma_px: input.solution.sigma_px,
        openings_m: input.has_fingers().then_some(span),
        x_from: source(input.sources.x_from_fingers),
        line_off_rad: input.line,
        zero_from,
        frame_sigma_m: frame.map(|f| f.0),
        frame_sigma_rad: frame.map(|f| f.1),
        left_out: left_out
            .map(|(i, why)| (name(*i), (*why).to_owned()))
            .collect(),
    })
}
