//! Chooses the images that a calibration needs, one after the other.

use std::fmt;

use glam::{DMat3, DVec2, DVec3};
use image::GrayImage;

use super::board_points::{BoardPoint, BoardPoints, PointFinder};
use super::bundle::{Bundle, error_px, minimise};
use super::coverage::{Coverage, Hint};
use super::intrinsics::{CalibrationReport, calibrate_intrinsics};
use super::start::{homography, lenses, plain_lens, pose};
use crate::detect::{ApriltagDetector, ApriltagSettings};
use crate::refine::sharpness;
use crate::{BoardFile, Detection, MarkerDetector as _};
use gripcast_base::error::Result;
use gripcast_base::statistics::median;
use gripcast_geometry::Pose;
use gripcast_imaging::Intrinsics;

/// Fewest points of a view.
const MIN_POINTS: usize = 8;
/// Least extent of the points across, relative to the board.
const MIN_WIDTH: f64 = 0.04;
/// Views are the same if the board's normal, its middle (relative to the image's diagonal) and
/// its distance differ by less than these.
const SAME_VIEW: (f64, f64, f64) = (0.14, 0.05, 0.1);
/// With more motion between two images the board is not held still, px.
const STILL_PX: f64 = 1.5;
/// Most views; more cost time and add nothing.
const MAX_VIEWS: usize = 60;
/// The focal length is estimated again up to this many views.
const ESTIMATED_VIEWS: usize = 12;

/// What a collector asks of images.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CollectorSettings {
    /// Largest blur of the markers' edges, standard deviation, px.
    pub blur_px: f64,
    /// Whether the board has to be where it was in the image before: for a live camera, whose
    /// lines are exposed one after the other.
    pub still: bool,
    /// Views that are enough if they cover everything.
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
pub enum Refusal {
    /// It has another size than those before: its width and height, then theirs.
    Size([u32; 2], [u32; 2]),
    /// No marker of the board is in it.
    NoBoard,
    /// So many points of the board are in it, which is too few; the second number is how many
    /// markers were seen.
    TooFew(usize, usize),
    /// Its points are almost on one line.
    Narrow,
    /// It is blurred by so many px.
    Blurred(f64),
    /// The board moves by so many px from image to image.
    Moving(f64),
    /// The markers are not where the board's description has them.
    OtherBoard,
    /// It shows what another one shows; the number of that view.
    Duplicate(usize),
    /// There are as many views as are used.
    Full,
}

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Size([width, height], [w, h]) => write!(
                f,
                "the image has {width}×{height} pixels, those before {w}×{h}"
            ),
            Self::NoBoard => f.write_str("no marker of the board"),
            Self::TooFew(0, markers) => write!(
                f,
                "{markers} markers, but no corner of the chessboard where they put it: too small, \
                 or the layout is another one (legacy)"
            ),
            Self::TooFew(points, markers) => write!(
                f,
                "only {points} points of the board ({markers} markers), needed are {MIN_POINTS}"
            ),
            Self::Narrow => f.write_str("only a narrow strip of the board"),
            Self::Blurred(blur) => write!(f, "blurred by {blur:.1} px"),
            Self::Moving(motion) if motion.is_infinite() => f.write_str("the board has just come"),
            Self::Moving(motion) => write!(f, "the board moves by {motion:.0} px"),
            Self::OtherBoard => {
                f.write_str("the markers are not where the board's description has them")
            }
            Self::Duplicate(view) => write!(f, "the same view as {}", view + 1),
            Self::Full => write!(f, "there are {MAX_VIEWS} views already"),
        }
    }
}

/// What a collector says to an image.
#[derive(Clone, Debug, PartialEq)]
pub struct Offer {
    /// Why it is not used; none if it is.
    pub refused: Option<Refusal>,
    /// What to do next.
    pub hint: Hint,
    /// Points of the board in it.
    pub points: usize,
    /// Markers of the board in it.
    pub markers: usize,
}

/// Takes images of a board as they come and calibrates with those that are of use. Does no IO.
pub struct Collector {
    finder: PointFinder,
    detector: ApriltagDetector,
    settings: CollectorSettings,
    size: Option<[u32; 2]>,
    views: Vec<Vec<BoardPoint>>,
    /// A rough lens, for judging views.
    lens: Option<Intrinsics>,
    homographies: Vec<DMat3>,
    poses: Vec<Pose>,
    before: Vec<BoardPoint>,
}

impl Collector {
    /// A collector for one board.
    ///
    /// # Errors
    /// `Input` for a board that is not flat, or that the detector cannot search for.
    pub fn new(file: &BoardFile, settings: CollectorSettings) -> Result<Self> {
        let ids = file.board.ids();
        let search = ApriltagSettings::default();
        Ok(Self {
            detector: ApriltagDetector::new(&file.dictionary, &ids, search)?,
            finder: PointFinder::new(file)?,
            settings,
            size: None,
            views: Vec::new(),
            lens: None,
            homographies: Vec::new(),
            poses: Vec::new(),
            before: Vec::new(),
        })
    }

    /// The board.
    pub fn file(&self) -> &BoardFile {
        self.finder.file()
    }

    /// Maps the board's frame into that of its plane.
    pub fn t_plane_board(&self) -> Pose {
        self.finder.t_plane_board()
    }

    /// The views that are used.
    pub fn views(&self) -> &[Vec<BoardPoint>] {
        &self.views
    }

    /// Size of the images; none before the first view.
    pub fn size(&self) -> Option<[u32; 2]> {
        self.size
    }

    /// Takes an image if it is of use.
    ///
    /// # Errors
    /// `Input` for an image that is too small or too large to be searched.
    pub fn offer(&mut self, image: &GrayImage) -> Result<Offer> {
        let detections = self.detector.detect(image)?;
        let found = self.finder.find(image, &detections);
        let refused = self.judge(image, &detections, &found);
        self.before.clone_from(&found.points);
        if refused.is_none() {
            self.take(image, &found.points);
        }
        Ok(Offer {
            refused,
            hint: self.coverage().hint(),
            points: found.points.len(),
            markers: found.markers,
        })
    }

    /// What the views cover.
    pub fn coverage(&self) -> Coverage {
        let views = self.views.iter().map(|points| &points[..]);
        let size = self.size.unwrap_or([1, 1]);
        Coverage::of(size, views.zip(&self.poses), self.settings.wanted)
    }

    /// Calibrates with the views.
    ///
    /// # Errors
    /// Those of [`calibrate_intrinsics`].
    pub fn finish(&self) -> Result<CalibrationReport> {
        calibrate_intrinsics(self.size.unwrap_or([1, 1]), &self.views)
    }

    fn judge(
        &self,
        image: &GrayImage,
        detections: &[Detection],
        found: &BoardPoints,
    ) -> Option<Refusal> {
        let size = [image.width(), image.height()];
        if let Some(known) = self.size
            && known != size
        {
            return Some(Refusal::Size(size, known));
        }
        if found.markers == 0 {
            return Some(Refusal::NoBoard);
        }
        let points = &found.points;
        let blur = sharpness(image, detections).map_or(0.0, |s| s.blur_px);
        if blur > self.settings.blur_px {
            return Some(Refusal::Blurred(blur));
        }
        if points.len() < MIN_POINTS {
            return Some(Refusal::TooFew(points.len(), found.markers));
        }
        if width(points) < MIN_WIDTH * self.finder.extent_m() {
            return Some(Refusal::Narrow);
        }
        if self.settings.still {
            match motion(&self.before, points) {
                Some(motion) if motion <= STILL_PX => {}
                motion => return Some(Refusal::Moving(motion.unwrap_or(f64::INFINITY))),
            }
        }
        if self.views.len() >= MAX_VIEWS {
            return Some(Refusal::Full);
        }
        let Some(h) = homography(points) else {
            return Some(Refusal::Narrow);
        };
        let lens = self.lens.unwrap_or_else(|| guess(size));
        match pose(&lens, &h) {
            None => Some(Refusal::OtherBoard),
            Some(pose) => self.twin(&lens, &pose).map(Refusal::Duplicate),
        }
    }

    /// The view that shows the board as a pose does.
    fn twin(&self, lens: &Intrinsics, pose: &Pose) -> Option<usize> {
        let diagonal = f64::from(lens.width).hypot(f64::from(lens.height));
        let middle = |pose: &Pose| {
            let t = pose.translation_m;
            DVec2::new(lens.fx, lens.fy) * t.truncate() / t.z
        };
        let normal = |pose: &Pose| pose.transform_vector(DVec3::Z);
        self.poses.iter().position(|other| {
            normal(other).angle_between(normal(pose)) < SAME_VIEW.0
                && middle(other).distance(middle(pose)) < SAME_VIEW.1 * diagonal
                && (other.translation_m.z / pose.translation_m.z).ln().abs() < SAME_VIEW.2
        })
    }

    fn take(&mut self, image: &GrayImage, points: &[BoardPoint]) {
        let size = [image.width(), image.height()];
        let Some(h) = homography(points) else { return };
        self.size = Some(size);
        self.views.push(points.to_vec());
        self.homographies.push(h);
        if self.lens.is_none() || self.views.len() <= ESTIMATED_VIEWS {
            self.lens = Some(best_lens(size, &self.homographies, &self.views));
        }
        let lens = self.lens.unwrap_or_else(|| guess(size));
        self.poses = self
            .homographies
            .iter()
            .map(|h| pose(&lens, h).unwrap_or(Pose::IDENTITY))
            .collect();
    }
}

/// Focal length as long as the image is wide: an angle of view of 53°.
fn guess(size: [u32; 2]) -> Intrinsics {
    let side = f64::from(size[0].max(size[1]));
    plain_lens(size, side, side)
}

/// The lens that fits some views best, roughly.
fn best_lens(size: [u32; 2], homographies: &[DMat3], views: &[Vec<BoardPoint>]) -> Intrinsics {
    let error = |lens: &Intrinsics| {
        let fits = homographies.iter().zip(views).map(|(h, points)| {
            let start = Bundle {
                lens: *lens,
                poses: vec![pose(lens, h)?],
            };
            let fit = minimise(std::slice::from_ref(points), start, &[false; 9], 3.0)?;
            let pose = fit.bundle.poses[0];
            Some(
                points
                    .iter()
                    .map(|p| error_px(lens, &pose, p).powi(2))
                    .sum(),
            )
        });
        fits.map(|e: Option<f64>| e.unwrap_or(f64::INFINITY))
            .sum::<f64>()
    };
    let found = lenses(size, homographies).into_iter();
    let best = found.map(|lens| (error(&lens), lens));
    best.min_by(|a, b| a.0.total_cmp(&b.0))
        .map_or_else(|| guess(size), |(_, lens)| lens)
}

/// Standard deviation of points across the line that fits them best, m.
fn width(points: &[BoardPoint]) -> f64 {
    let count = points.len() as f64;
    let at = || points.iter().map(|p| p.place_m.truncate());
    let mean = at().sum::<DVec2>() / count;
    let (mut xx, mut yy, mut xy) = (0.0, 0.0, 0.0);
    for off in at().map(|p| p - mean) {
        xx += off.x * off.x;
        yy += off.y * off.y;
        xy += off.x * off.y;
    }
    let smaller = 0.5 * (xx + yy - (xx - yy).hypot(2.0 * xy));
    (smaller.max(0.0) / count).sqrt()
}

/// Median way of the points that two images fraction, px.
fn motion(before: &[BoardPoint], now: &[BoardPoint]) -> Option<f64> {
    median(now.iter().filter_map(|point| {
        let same = before.iter().find(|b| b.number == point.number)?;
        Some(same.pixel.distance(point.pixel))
    }))
}
