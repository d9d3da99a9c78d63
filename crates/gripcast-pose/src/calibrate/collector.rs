//! Incremental selection of calibration images.

use std::fmt;

use glam::{DMat3, DVec2};
use image::GrayImage;

use super::board_points::{BoardPoint, BoardPoints, PointFinder};
use super::bundle::error_px;
use super::coverage::{Coverage, Hint};
use super::intrinsics::{CalibrationReport, calibrate_intrinsics, fit_pose};
use super::start::{default_lens, homography, lenses, pose};
use crate::detect::{ApriltagDetector, ApriltagSettings, check_size};
use crate::refine::blur_px;
use crate::{BoardFile, Detection, MarkerDetector as _};
use gripcast_base::error::Result;
use gripcast_base::statistics::median;
use gripcast_geometry::Pose;
use gripcast_imaging::Intrinsics;

/// Minimum number of points of a view.
const MIN_POINTS: usize = 8;
/// Minimum width of the points, relative to the board's diameter.
const MIN_WIDTH: f64 = 0.04;
/// Views are duplicates if rotation (rad), centre (relative to the image diagonal) and log distance
/// differ by less than these: those of a live camera, of which there are many, and given images.
const SAME_LIVE_VIEW: (f64, f64, f64) = (0.14, 0.05, 0.1);
const SAME_VIEW: (f64, f64, f64) = (0.05, 0.02, 0.04);
/// Maximum motion between two images of a static board, px.
const STATIC_PX: f64 = 1.5;
/// Maximum number of views.
const MAX_VIEWS: usize = 60;
/// The focal length is re-estimated up to this many views.
const ESTIMATED_VIEWS: usize = 12;

/// Requirements on images.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CollectorSettings {
    /// Maximum blur of marker edges, standard deviation, px.
    pub blur_px: f64,
    /// Whether the board must not move between images: for live cameras with a rolling shutter.
    pub still: bool,
    /// Required number of views.
    pub wanted: usize,
}

impl Default for CollectorSettings {
    fn default() -> Self {
        Self {
            blur_px: 2.0,
            still: false,
            wanted: 12,
        }
    }
}

/// Why an image is not used.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Rejection {
    /// Width and height of the image differ from those of the previous images.
    Size([u32; 2], [u32; 2]),
    /// No marker of the board was detected.
    NoBoard,
    /// No chessboard with these columns and rows of inner corners was found.
    NoChessboard([u32; 2]),
    /// Too few points: numbers of points and markers.
    TooFew(usize, usize),
    /// The points are almost collinear.
    Narrow,
    /// Blurred by this many px.
    Blurred(f64),
    /// The board moved by this many px since the previous image.
    Moving(f64),
    /// The markers do not match the board file.
    OtherBoard,
    /// Same view as the one with this index.
    Duplicate(usize),
    /// The maximum number of views is reached.
    Full,
}

impl fmt::Display for Rejection {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Size([width, height], [w, h]) => {
                write!(
                    f,
                    "expected an image of {w}×{h} pixels, found {width}×{height}"
                )
            }
            Self::NoBoard => f.write_str("no marker of the board"),
            Self::NoChessboard([columns, rows]) => write!(
                f,
                "no chessboard with {columns}×{rows} inner corners: all of it must be visible, with \
                 a white margin"
            ),
            Self::TooFew(0, markers) => write!(
                f,
                "{markers} markers, but no chessboard corners: too small, or a different layout \
                 (legacy)"
            ),
            Self::TooFew(points, markers) => write!(
                f,
                "only {points} points of the board ({markers} markers), expected at least \
                 {MIN_POINTS}"
            ),
            Self::Narrow => f.write_str("only a narrow strip of the board"),
            Self::Blurred(blur) => write!(f, "blurred by {blur:.1} px"),
            Self::Moving(motion) if motion.is_infinite() => {
                f.write_str("the board has just appeared")
            }
            Self::Moving(motion) => write!(f, "the board moves by {motion:.0} px"),
            Self::OtherBoard => f.write_str("the markers do not match the board file"),
            Self::Duplicate(view) => write!(f, "same view as {}", view + 1),
            Self::Full => write!(f, "the maximum of {MAX_VIEWS} views is reached"),
        }
    }
}

/// Result of [`Collector::add_image`].
#[derive(Clone, Debug, PartialEq)]
pub struct AddedImage {
    /// Why the image is not used; none if it is.
    pub rejection: Option<Rejection>,
    /// Hint for the next view.
    pub hint: Hint,
    /// Number of points of the board.
    pub points: usize,
    /// Number of markers of the board.
    pub markers: usize,
}

/// Selects useful images of a board and calibrates with them. Does no IO.
pub struct Collector {
    finder: PointFinder,
    /// None for a chessboard without markers.
    detector: Option<ApriltagDetector>,
    settings: CollectorSettings,
    size: Option<[u32; 2]>,
    views: Vec<Vec<BoardPoint>>,
    /// Rough intrinsics for comparing views.
    lens: Option<Intrinsics>,
    homographies: Vec<DMat3>,
    poses: Vec<Pose>,
    previous: Vec<BoardPoint>,
}

impl Collector {
    /// Creates a collector for a board.
    ///
    /// # Errors
    /// `Input` for a board that is not planar or that the detector does not support.
    pub fn new(file: &BoardFile, settings: CollectorSettings) -> Result<Self> {
        let ids = file.board.ids();
        let detection = ApriltagSettings::default();
        let detector = || ApriltagDetector::new(&file.dictionary, &ids, detection);
        Ok(Self {
            detector: file.plain().is_none().then(detector).transpose()?,
            finder: PointFinder::new(file)?,
            settings,
            size: None,
            views: Vec::new(),
            lens: None,
            homographies: Vec::new(),
            poses: Vec::new(),
            previous: Vec::new(),
        })
    }

    /// The board.
    pub fn file(&self) -> &BoardFile {
        self.finder.file()
    }

    /// Maps the board frame into its plane frame.
    pub fn t_plane_board(&self) -> Pose {
        self.finder.t_plane_board()
    }

    /// The selected views.
    pub fn views(&self) -> &[Vec<BoardPoint>] {
        &self.views
    }

    /// Image size; none without views.
    pub fn size(&self) -> Option<[u32; 2]> {
        self.size
    }

    /// Adds an image if it is useful.
    ///
    /// # Errors
    /// `Input` for an image that is too small or too large for the detector.
    pub fn add_image(&mut self, image: &GrayImage) -> Result<AddedImage> {
        let detections = match &mut self.detector {
            Some(detector) => detector.detect(image)?,
            None => {
                check_size(image)?;
                Vec::new()
            }
        };
        let found = self.finder.find(image, &detections);
        let rejection = self.check(image, &detections, &found);
        self.previous.clone_from(&found.points);
        if rejection.is_none() {
            self.add_view(image, &found.points);
        }
        Ok(AddedImage {
            rejection,
            hint: self.coverage().hint(),
            points: found.points.len(),
            markers: found.markers,
        })
    }

    /// Coverage of the views.
    pub fn coverage(&self) -> Coverage {
        let views = self.views.iter().map(|points| &points[..]);
        let size = self.size.unwrap_or([1, 1]);
        Coverage::new(size, views.zip(&self.poses), self.settings.wanted)
    }

    /// Calibrates with the selected views.
    ///
    /// # Errors
    /// Those of [`calibrate_intrinsics`].
    pub fn finish(&self) -> Result<CalibrationReport> {
        calibrate_intrinsics(self.size.unwrap_or([1, 1]), &self.views)
    }

    fn check(
        &self,
        image: &GrayImage,
        detections: &[Detection],
        found: &BoardPoints,
    ) -> Option<Rejection> {
        let size = [image.width(), image.height()];
        if let Some(expected) = self.size
            && expected != size
        {
            return Some(Rejection::Size(size, expected));
        }
        let points = &found.points;
        if found.markers == 0 && points.is_empty() {
            return Some(match self.finder.file().plain() {
                Some(chessboard) => Rejection::NoChessboard(chessboard.squares.map(|n| n - 1)),
                None => Rejection::NoBoard,
            });
        }
        let outlines = if detections.is_empty() {
            &found.squares
        } else {
            detections
        };
        let blur = blur_px(image, outlines).unwrap_or(0.0);
        if blur > self.settings.blur_px {
            return Some(Rejection::Blurred(blur));
        }
        if points.len() < MIN_POINTS {
            return Some(Rejection::TooFew(points.len(), found.markers));
        }
        if width(points) < MIN_WIDTH * self.finder.diameter_m() {
            return Some(Rejection::Narrow);
        }
        if self.settings.still {
            match motion(&self.previous, points) {
                Some(motion) if motion <= STATIC_PX => {}
                motion => return Some(Rejection::Moving(motion.unwrap_or(f64::INFINITY))),
            }
        }
        if self.views.len() >= MAX_VIEWS {
            return Some(Rejection::Full);
        }
        let Some(h) = homography(points) else {
            return Some(Rejection::Narrow);
        };
        let lens = self.lens.unwrap_or_else(|| default_lens(size));
        match pose(&lens, &h) {
            None => Some(Rejection::OtherBoard),
            Some(pose) => self.find_duplicate(&lens, &pose).map(Rejection::Duplicate),
        }
    }

    /// Index of a view with nearly the same pose.
    fn find_duplicate(&self, lens: &Intrinsics, pose: &Pose) -> Option<usize> {
        let diagonal = f64::from(lens.width).hypot(f64::from(lens.height));
        let center = |pose: &Pose| {
            let t = pose.translation_m;
            DVec2::new(lens.fx, lens.fy) * t.truncate() / t.z
        };
        let limits = if self.settings.still {
            SAME_LIVE_VIEW
        } else {
            SAME_VIEW
        };
        // A chessboard may be read upside down.
        let is_plain = self.finder.file().plain().is_some();
        let rotation = |other: &Pose| {
            let angle = other.rotation_from(pose).length();
            if is_plain {
                angle.min(std::f64::consts::PI - angle)
            } else {
                angle
            }
        };
        self.poses.iter().position(|other| {
            rotation(other) < limits.0
                && center(other).distance(center(pose)) < limits.1 * diagonal
                && (other.translation_m.z / pose.translation_m.z).ln().abs() < limits.2
        })
    }

    fn add_view(&mut self, image: &GrayImage, points: &[BoardPoint]) {
        let size = [image.width(), image.height()];
        let Some(h) = homography(points) else { return };
        self.size = Some(size);
        self.views.push(points.to_vec());
        self.homographies.push(h);
        if self.lens.is_none() || self.views.len() <= ESTIMATED_VIEWS {
            self.lens = Some(best_lens(size, &self.homographies, &self.views));
        }
        let lens = self.lens.unwrap_or_else(|| default_lens(size));
        self.poses = self
            .homographies
            .iter()
            .map(|h| pose(&lens, h).unwrap_or(Pose::IDENTITY))
            .collect();
    }
}

/// The candidate intrinsics that roughly fit the views best.
fn best_lens(size: [u32; 2], homographies: &[DMat3], views: &[Vec<BoardPoint>]) -> Intrinsics {
    let error = |lens: &Intrinsics| {
        let fits = homographies.iter().zip(views).map(|(h, points)| {
            let pose = fit_pose(lens, pose(lens, h)?, points, 3.0)?;
            let squares = points.iter().map(|p| error_px(lens, &pose, p).powi(2));
            Some(squares.sum::<f64>())
        });
        fits.map(|e| e.unwrap_or(f64::INFINITY)).sum::<f64>()
    };
    let candidates = lenses(size, homographies).into_iter();
    candidates
        .map(|lens| (error(&lens), lens))
        .min_by(|a, b| a.0.total_cmp(&b.0))
        .map_or_else(|| default_lens(size), |(_, lens)| lens)
}

/// Standard deviation of points perpendicular to their principal axis, m.
fn width(points: &[BoardPoint]) -> f64 {
    let count = points.len() as f64;
    let positions = || points.iter().map(|p| p.point_m.truncate());
    let mean = positions().sum::<DVec2>() / count;
    let (mut xx, mut yy, mut xy) = (0.0, 0.0, 0.0);
    for off in positions().map(|p| p - mean) {
        xx += off.x * off.x;
        yy += off.y * off.y;
        xy += off.x * off.y;
    }
    let smaller = 0.5 * (xx + yy - (xx - yy).hypot(2.0 * xy));
    (smaller.max(0.0) / count).sqrt()
}

/// Median displacement of the points common to two images, px.
fn motion(previous: &[BoardPoint], current: &[BoardPoint]) -> Option<f64> {
    median(current.iter().filter_map(|point| {
        let same = previous.iter().find(|p| p.index == point.index)?;
        Some(same.pixel.distance(point.pixel))
    }))
}
