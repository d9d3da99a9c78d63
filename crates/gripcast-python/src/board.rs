//! Marker boards and their detection.

use std::path::PathBuf;
use std::sync::Arc;

use glam::{DQuat, DVec2};
use image::imageops::grayscale;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use super::arrays::{self, array};
use super::failure::Outcome;
use super::mesh::Mesh;
use super::placement::check;
use super::pose::Pose;
use super::work::{detached, interruptible};
use gripcast_base::error::{Error, nearest_name, unknown_name};
use gripcast_base::files::save;
use gripcast_base::number::NumberRange;
use gripcast_geometry as geometry;
use gripcast_imaging as imaging;
use gripcast_imaging::DistortionModel;
use gripcast_pose::detect::{ApriltagDetector, ApriltagSettings, FullSearch, identify};
use gripcast_pose::levels::Levels;
use gripcast_pose::print::{Drawing, SheetObject, SheetSettings, object_sheet, pdf, png, svg};
use gripcast_pose::refine::refine_all;
use gripcast_pose::solve::{BodyPose, solve_body_pose, solve_gripper};
use gripcast_pose::{
    BoardFile, Body, Detection, Dictionary, MarkerDetector as _, load_intrinsics, require_size,
};
use gripcast_sim::grasp::resting_pose;

/// Formats of a sheet.
const SHEETS: [&str; 3] = ["pdf", "svg", "png"];

/// Pinhole intrinsics of a camera for one image size.
#[pyclass(frozen, module = "gripcast")]
#[derive(Clone)]
pub(crate) struct Intrinsics(imaging::Intrinsics);

#[pymethods]
impl Intrinsics {
    /// `size_px` is width and height, `focal_px` and `center_px` are along x and y; pixel (0, 0) is the
    /// centre of the top-left pixel. `model` is none, brown-conrady (OpenCV) or
    /// inverse-brown-conrady (colour of a D435), with k1, k2, p1, p2, k3.
    #[new]
    #[pyo3(signature = (size_px, focal_px, center_px, *, model = "none", coefficients = [0.0; 5]))]
    #[pyo3(
        text_signature = "(size_px, focal_px, center_px, *, model='none', coefficients=(0.0, 0.0, 0.0, 0.0, 0.0))"
    )]
    fn new(
        size_px: (u32, u32),
        focal_px: (f64, f64),
        center_px: (f64, f64),
        model: &str,
        coefficients: [f64; 5],
    ) -> Outcome<Self> {
        let model = match model {
            "none" => DistortionModel::None,
            "brown-conrady" => DistortionModel::BrownConrady,
            "inverse-brown-conrady" => DistortionModel::InverseBrownConrady,
            other => {
                let known = ["none", "brown-conrady", "inverse-brown-conrady"];
                return Err(unknown_name("model", other, &known).into());
            }
        };
        let intrinsics = imaging::Intrinsics {
            width: size_px.0,
            height: size_px.1,
            fx: focal_px.0,
            fy: focal_px.1,
            cx: center_px.0,
            cy: center_px.1,
            model,
            coefficients,
        };
        Ok(Self(intrinsics.validate()?))
    }

    /// Reads a file of gripcast (.toml), OpenCV, ROS or Kalibr.
    #[staticmethod]
    fn load(py: Python<'_>, path: PathBuf) -> Outcome<Self> {
        Ok(Self(detached(py, || load_intrinsics(&path))?))
    }

    /// Writes a .toml file.
    fn save(&self, py: Python<'_>, path: PathBuf) -> Outcome<()> {
        detached(py, || self.0.save(&path))
    }

    /// Width and height of the image, px.
    #[getter]
    fn size_px(&self) -> (u32, u32) {
        (self.0.width, self.0.height)
    }

    /// Focal length along x and y, px.
    #[getter]
    fn focal_px(&self) -> (f64, f64) {
        (self.0.fx, self.0.fy)
    }

    /// Principal point, px.
    #[getter]
    fn center_px(&self) -> (f64, f64) {
        (self.0.cx, self.0.cy)
    }

    fn __repr__(&self) -> String {
        let (width, height) = self.size_px();
        format!(
            "<Intrinsics {width} × {height}: focal length {:.1} px>",
            self.0.fx
        )
    }
}

/// Markers with known positions: a printed sheet, or the tags of a gripper.
#[pyclass(frozen, module = "gripcast")]
pub(crate) struct Board {
    file: Arc<BoardFile>,
    sheet: Option<Drawing>,
}

#[pymethods]
impl Board {
    /// Draws a sheet that an object stands on, as `gripcast board make` does: a ring of markers around
    /// its outline. `marker_m` is the side of a marker; `stable_pose` and `yaw_deg` say how the object
    /// stands; `paper` is A4, A3 or Letter; `measured_mm` are the measured lengths of the printed
    /// 100 mm rulers. The board's frame is that of the mesh.
    #[staticmethod]
    #[pyo3(signature = (mesh, *, name = "board", dictionary = "DICT_6X6_250", first_id = 0, marker_m = 0.03, paper = "A4", stable_pose = None, yaw_deg = 0.0, measured_mm = (100.0, 100.0)))]
    #[pyo3(
        text_signature = "(mesh, *, name='board', dictionary='DICT_6X6_250', first_id=0, marker_m=0.03, paper='A4', stable_pose=None, yaw_deg=0.0, measured_mm=(100.0, 100.0))"
    )]
    #[allow(clippy::too_many_arguments)]
    fn make(
        py: Python<'_>,
        mesh: &Mesh,
        name: &str,
        dictionary: &str,
        first_id: u32,
        marker_m: f64,
        paper: &str,
        stable_pose: Option<usize>,
        yaw_deg: f64,
        measured_mm: (f64, f64),
    ) -> Outcome<Self> {
        check("marker_m", Some(marker_m), NumberRange::POSITIVE)?;
        check("yaw_deg", Some(yaw_deg), NumberRange::FINITE)?;
        let settings = SheetSettings {
            name: name.to_owned(),
            dictionary: Dictionary::by_name(dictionary)?,
            first_id,
            marker_m,
            paper: paper.parse()?,
            measured_mm: measured_mm.into(),
        };
        let (mesh, source) = (mesh.surface().clone(), mesh.source().to_owned());
        let made = interruptible(py, move |_| {
            let (_, pose) = resting_pose(&mesh, stable_pose)?;
            let yaw = geometry::Pose::from_rotation(DQuat::from_rotation_z(yaw_deg.to_radians()));
            let placed = SheetObject {
                mesh: &mesh,
                source: &source,
                t_world_object: yaw * pose.t_world_object,
            };
            object_sheet(&placed, &settings)
        })?;
        Ok(Self {
            file: Arc::new(made.file),
            sheet: Some(made.drawing),
        })
    }

    /// Reads a board file.
    #[staticmethod]
    fn load(py: Python<'_>, path: PathBuf) -> Outcome<Self> {
        Ok(Self {
            file: Arc::new(detached(py, || BoardFile::load(&path))?),
            sheet: None,
        })
    }

    /// The default tags of a UMI gripper.
    #[staticmethod]
    fn gripper_umi() -> Outcome<Self> {
        Ok(Self {
            file: Arc::new(BoardFile::gripper_umi()?),
            sheet: None,
        })
    }

    /// Writes the board file, a .toml.
    fn save(&self, py: Python<'_>, path: PathBuf) -> Outcome<()> {
        detached(py, || save(&path, self.file.to_toml().as_bytes()))
    }

    /// Writes the sheet of a board that was made: a .pdf, .svg or .png of `dpi` dots per inch. Print it
    /// at 100 %.
    #[pyo3(signature = (path, *, dpi = 300.0))]
    fn save_sheet(&self, py: Python<'_>, path: PathBuf, dpi: f64) -> Outcome<()> {
        check("dpi", Some(dpi), NumberRange::POSITIVE)?;
        let suffix = path.extension().unwrap_or_default().to_string_lossy();
        let suffix = suffix.to_lowercase();
        if !SHEETS.contains(&suffix.as_str()) {
            let nearest = nearest_name(&suffix, SHEETS);
            let hint = nearest.map(|name| format!("did you mean .{name}?"));
            let error = Error::usage("`path` must end in .pdf, .svg or .png").at(path.display());
            return Err(match hint {
                Some(hint) => error.remedy(hint).into(),
                None => error.into(),
            });
        }
        let sheet = self.sheet.as_ref().ok_or_else(|| {
            Error::usage("a board that was read has no sheet")
                .remedy("make it with Board.make, or with `gripcast board make`")
        })?;
        detached(py, || {
            let bytes = match suffix.as_str() {
                "pdf" => pdf(sheet),
                "svg" => svg(sheet).into_bytes(),
                _ => png(sheet, dpi)?,
            };
            save(&path, &bytes)
        })
    }

    /// Name of the board.
    #[getter]
    fn name(&self) -> &str {
        &self.file.board.name
    }

    /// Dictionary of the markers.
    #[getter]
    fn dictionary(&self) -> &str {
        &self.file.board.dictionary
    }

    /// Hash of dictionary, ids and corners.
    #[getter]
    fn hash(&self) -> String {
        self.file.board.hash()
    }

    /// Corners of each marker by its id: 4 × 3, float64, m; top left, top right, bottom right, bottom
    /// left of the marker read upright.
    #[getter]
    fn corners_m<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let corners = PyDict::new(py);
        for marker in &self.file.board.markers {
            let values = marker.corners_m.iter().flat_map(|c| c.to_array()).collect();
            corners.set_item(marker.id, array::<f64>(py, values, &[4, 3])?)?;
        }
        Ok(corners)
    }

    fn __repr__(&self) -> String {
        let count = self.file.board.markers.len();
        format!(
            "<Board {}: {count} markers of {}>",
            self.name(),
            self.dictionary()
        )
    }
}

/// A marker in an image.
#[pyclass(frozen, module = "gripcast")]
#[derive(Clone)]
pub(crate) struct Marker {
    detection: Detection,
    dictionary: Arc<str>,
    size_px: (u32, u32),
}

#[pymethods]
impl Marker {
    /// Id in the dictionary.
    #[getter]
    fn id(&self) -> u32 {
        self.detection.id
    }

    /// Name of the dictionary.
    #[getter]
    fn dictionary(&self) -> &str {
        &self.dictionary
    }

    /// 4 × 2, float64, px: outer corners of the black border, top left, top right, bottom right, bottom
    /// left of the marker read upright; pixel (0, 0) is the centre of the top-left pixel.
    #[getter]
    fn corners_px(&self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        let corners = self.detection.corners_px.iter();
        array::<f64>(py, corners.flat_map(DVec2::to_array).collect(), &[4, 2])
    }

    /// Number of corrected bits.
    #[getter]
    fn corrected_bits(&self) -> u32 {
        self.detection.hamming
    }

    /// Width and height of the image, px.
    #[getter]
    fn size_px(&self) -> (u32, u32) {
        self.size_px
    }

    fn __repr__(&self) -> String {
        let center = self.detection.center_px();
        format!(
            "<Marker {} at {:.1}, {:.1} px>",
            self.id(),
            center.x,
            center.y
        )
    }
}

/// Detects the markers in an image, by id.
///
/// `image` is height × width × 3, uint8, RGB. The markers are those of a `board`, of a `dictionary`
/// (DICT_6X6_250, 36h11, …), or of the dictionaries that are found in the image. `levels` says how the
/// image encodes light: srgb, or linear as machine-vision cameras with a gamma of 1.
#[pyfunction]
#[pyo3(signature = (image, *, board = None, dictionary = None, levels = "srgb"))]
pub(crate) fn detect_markers(
    py: Python<'_>,
    image: &Bound<'_, PyAny>,
    board: Option<&Board>,
    dictionary: Option<&str>,
    levels: &str,
) -> Outcome<Vec<Marker>> {
    let colour = arrays::image(image, "image")?;
    let levels = match levels {
        "srgb" => Levels::Srgb,
        "linear" => Levels::Linear,
        other => return Err(unknown_name("levels", other, &["srgb", "linear"]).into()),
    };
    let wanted = match (board, dictionary) {
        (Some(_), Some(_)) => {
            let error = Error::usage("`board` contradicts `dictionary`");
            return Err(error.remedy("omit one of them").into());
        }
        (Some(board), None) => Some((board.file.dictionary.clone(), board.file.board.ids())),
        (None, Some(name)) => Some(whole(Dictionary::by_name(name)?)),
        (None, None) => None,
    };
    interruptible(py, move |_| {
        let grey = grayscale(&colour);
        let encoded = levels.to_srgb(&grey);
        let settings = ApriltagSettings {
            full: FullSearch::Always,
            ..ApriltagSettings::default()
        };
        let searched = match wanted {
            Some(wanted) => vec![wanted],
            None => identify(&encoded, settings)?
                .into_iter()
                .map(|found| whole(found.dictionary))
                .collect(),
        };
        let mut markers = Vec::new();
        for (dictionary, ids) in searched {
            let mut detector = ApriltagDetector::new(&dictionary, &ids, settings)?;
            let detections = detector.detect(&encoded)?;
            let name: Arc<str> = dictionary.name().into();
            let refined = refine_all(&encoded, &detections).into_iter();
            markers.extend(refined.map(|detection| Marker {
                detection,
                dictionary: Arc::clone(&name),
                size_px: encoded.dimensions(),
            }));
        }
        Ok(markers)
    })
}

/// All markers of a dictionary.
fn whole(dictionary: Dictionary) -> (Dictionary, Vec<u32>) {
    let ids = (0..dictionary.len() as u32).collect();
    (dictionary, ids)
}

/// Solves the pose of a board from its markers in one image.
///
/// For the tags of a gripper also the opening, unless `opening_m` gives it. Outliers are left out.
#[pyfunction]
#[pyo3(signature = (markers, board, intrinsics, *, opening_m = None))]
pub(crate) fn solve_pose(
    py: Python<'_>,
    markers: Vec<Bound<'_, Marker>>,
    board: &Board,
    intrinsics: &Intrinsics,
    opening_m: Option<f64>,
) -> Outcome<BoardPose> {
    check("opening_m", opening_m, NumberRange::NOT_NEGATIVE)?;
    let found: Vec<Marker> = markers.iter().map(|marker| marker.get().clone()).collect();
    let (file, intrinsics) = (Arc::clone(&board.file), intrinsics.0);
    let (pose, opening) = detached(py, move || {
        for marker in &found {
            let (width, height) = marker.size_px;
            require_size(&intrinsics, width, height)?;
        }
        let own = found
            .into_iter()
            .filter(|m| *m.dictionary == *file.board.dictionary);
        let own: Vec<Detection> = own.map(|marker| marker.detection).collect();
        let board = &file.board;
        if board.markers_on(Body::Object).next().is_some() {
            let body = solve_body_pose(board, Body::Object, &own, &intrinsics)?;
            return Ok((body, None));
        }
        let gripper = solve_gripper(board, &own, &intrinsics, opening_m)?;
        let opening = gripper.opening.map(|opening| opening.opening_m);
        Ok((gripper.body, opening))
    })?;
    BoardPose::new(py, &pose, opening)
}

/// Pose of a board in an image.
#[pyclass(frozen, get_all, module = "gripcast")]
pub(crate) struct BoardPose {
    /// Pose of the board in the camera's frame: x right, y down, z forward.
    t_camera_board: Pose,
    /// 6 × 6, float64: covariance of translation (m) and rotation (rad) along the camera's axes.
    covariance: Py<PyAny>,
    /// Root mean square reprojection error of the used markers, px.
    rms_px: f64,
    /// Number of used markers.
    used_markers: usize,
    /// Whether another pose fits as well.
    ambiguous: bool,
    /// Opening of a gripper with tags on its fingers, m; None for other boards.
    opening_m: Option<f64>,
    /// What to check, one sentence each.
    notes: Vec<String>,
}

impl BoardPose {
    fn new(py: Python<'_>, pose: &BodyPose, opening_m: Option<f64>) -> Outcome<Self> {
        let mut notes = pose.notes.clone();
        notes.extend(pose.residual_note("board"));
        Ok(Self {
            t_camera_board: Pose(pose.t_camera_body),
            covariance: array::<f64>(py, pose.covariance.concat(), &[6, 6])?,
            rms_px: pose.rms_px,
            used_markers: pose.used_markers(),
            ambiguous: pose.ambiguous,
            opening_m,
            notes,
        })
    }
}

#[pymethods]
impl BoardPose {
    fn __repr__(&self) -> String {
        format!(
            "<BoardPose: {} markers, {:.2} px>",
            self.used_markers, self.rms_px
        )
    }
}
