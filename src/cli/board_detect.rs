//! `gripcast board detect`: markers in any image.

use std::path::{Path, PathBuf};

use image::imageops::grayscale;
use image::{GrayImage, RgbImage};
use serde::Serialize;

use super::image_folder::{file_name, images};
use super::{create_folder, print_report};
use gripcast_annotate::{draw_axes, draw_markers};
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_base::files::{FileKind, read_regular, save};
use gripcast_geometry::Pose;
use gripcast_imaging::{Decoder, Intrinsics, encode_jpeg};
use gripcast_pose::detect::{ApriltagDetector, ApriltagSettings, FullSearch, diagnose, identify};
use gripcast_pose::levels::{Levels, with_levels};
use gripcast_pose::refine::{edge_quality, image_notes, refine_all};
use gripcast_pose::solve::{BodyPose, solve_body_pose, solve_gripper};
use gripcast_pose::{
    BoardFile, Body, Detection, Dictionary, MarkerDetector as _, load_intrinsics, require_size,
};

const OVERLAY_JPEG_QUALITY: u8 = 90;
/// Marker side below which a note says that its corners are inexact, px.
const MIN_SIDE_PX: f64 = 20.0;

/// Arguments.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// JPEG or PNG images, or folders of them
    #[arg(value_name = "IMAGE|DIR", required = true)]
    images: Vec<PathBuf>,
    /// Marker dictionary [default: that of the image's markers]
    #[arg(long, value_name = "NAME|FILE.yml", conflicts_with = "board")]
    dictionary: Option<String>,
    /// Board file: only its markers are searched for
    #[arg(long, value_name = "FILE.toml")]
    board: Option<PathBuf>,
    /// Intrinsics of the camera: gives the pose of the board
    #[arg(long, value_name = "FILE", requires = "board")]
    camera: Option<PathBuf>,
    /// How the image's levels encode light [default: what fits the board better, else srgb]
    #[arg(long, value_enum, value_name = "LEVELS")]
    levels: Option<LevelsFlag>,
    /// Folder for the images with the markers drawn over them
    #[arg(long, value_name = "DIR")]
    overlay: Option<PathBuf>,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum LevelsFlag {
    /// Most cameras
    Srgb,
    /// Machine-vision cameras with a gamma of 1
    Linear,
}

#[derive(Debug, Serialize)]
struct Report {
    images: Vec<ImageReport>,
    /// Convention of all positions in pixels.
    pixel_origin: &'static str,
}

#[derive(Debug, Default, Serialize)]
struct ImageReport {
    image: String,
    width: u32,
    height: u32,
    levels: &'static str,
    markers: Vec<Marker>,
    /// Ids that are in the image more than once.
    repeated_ids: Vec<u32>,
    pose: Option<BoardPose>,
    notes: Vec<String>,
    /// Why there are no markers or no pose.
    error: Option<String>,
    overlay: Option<PathBuf>,
}

#[derive(Debug, Serialize)]
struct Marker {
    id: u32,
    dictionary: String,
    /// Top left, top right, bottom right, bottom left of the marker read upright.
    corners_px: [[f64; 2]; 4],
    /// Top, right, bottom, left.
    sides_px: [f64; 4],
    corrected_bits: u32,
    /// Mean difference of the bits from the threshold, grey levels.
    decision_margin: f32,
    blur_px: Option<f64>,
    /// Linear light, 0 to 1.
    contrast: Option<f64>,
    /// Fraction of the white surround that is overexposed.
    clipped: Option<f64>,
}

#[derive(Debug, Serialize)]
struct BoardPose {
    t_camera_board: Pose,
    rms_px: f64,
    used_markers: usize,
    ambiguous: bool,
    /// Opening of a gripper with tags on its fingers, m.
    opening_m: Option<f64>,
}

/// What is searched for.
struct Search {
    dictionary: Option<Dictionary>,
    board: Option<BoardFile>,
    intrinsics: Option<Intrinsics>,
    levels: Option<Levels>,
}

/// Runs the command.
pub(super) fn run(args: &Args) -> Result<()> {
    let here = Path::new(".");
    let name = args.dictionary.as_deref();
    let search = Search {
        dictionary: name.map(|name| Dictionary::open(name, here)).transpose()?,
        board: args.board.as_deref().map(BoardFile::load).transpose()?,
        intrinsics: args.camera.as_deref().map(load_intrinsics).transpose()?,
        levels: args.levels.map(|levels| match levels {
            LevelsFlag::Srgb => Levels::Srgb,
            LevelsFlag::Linear => Levels::Linear,
        }),
    };
    let mut files = Vec::new();
    for path in &args.images {
        match path.is_dir() {
            true => files.extend(images(path)?),
            false => files.push(path.clone()),
        }
    }
    if let Some(folder) = &args.overlay {
        create_folder(folder)?;
    }
    let mut decoder = Decoder::new()?;
    let mut reports = Vec::new();
    for file in &files {
        reports.push(search.image(&mut decoder, file, args.overlay.as_deref())?);
    }
    let without = reports.iter().filter(|r| r.markers.is_empty()).count();
    let report = Report {
        images: reports,
        pixel_origin: "(0, 0) is the centre of the top left pixel",
    };
    print_report(args.json, &report, |report| report.text())?;
    match without {
        0 => Ok(()),
        count if count == files.len() => Err(Error::input("no marker in any image")),
        count => Err(Error::new(
            ErrorKind::Partial,
            format!("no marker in {count} of {} images", files.len()),
        )),
    }
}

impl Search {
    fn image(
        &self,
        decoder: &mut Decoder,
        file: &Path,
        overlay: Option<&Path>,
    ) -> Result<ImageReport> {
        let bytes = read_regular(file, FileKind::Image)
            .map_err(|e| Error::io("cannot read the image", e).at(file.display()))?;
        let colour = decoder
            .stored_image(&bytes)
            .map_err(|e| e.at(file.display()))?;
        let image = grayscale(&colour);
        let mut report = ImageReport {
            image: file.display().to_string(),
            width: image.width(),
            height: image.height(),
            ..ImageReport::default()
        };
        let found = self.detect(&image).map_err(|e| e.at(file.display()))?;
        let detections: Vec<Detection> = found.iter().map(|(_, d)| d.clone()).collect();
        let solved = with_levels(&image, self.levels, |image| {
            let refined = refine_all(image, &detections);
            let pose = self.pose(image, &refined);
            let residual_px = match &pose {
                Some(Ok((body, _))) => body.rms_px,
                _ => 0.0,
            };
            Ok(((refined, pose), residual_px))
        })?;
        let (refined, pose) = solved.measured;
        let encoded = solved.levels.to_srgb(&image);
        report.levels = solved.levels.name();
        report.notes.extend(solved.note);
        report.notes.extend(image_notes(&encoded, &refined));
        report.markers = found
            .iter()
            .zip(&refined)
            .map(|((dictionary, _), detection)| Marker::new(&encoded, dictionary, detection))
            .collect();
        report.add_notes();
        let mut drawn = None;
        match pose {
            Some(Ok((body, opening_m))) => {
                drawn = Some(body.t_camera_body);
                report.add_pose(&body, opening_m);
            }
            Some(Err(error)) => report.error = Some(error.to_string()),
            None => {}
        }
        if found.is_empty() {
            report.error = Some(self.missing(&image)?);
        }
        if let Some(folder) = overlay {
            report.overlay = Some(self.draw(colour, &refined, drawn, folder, file)?);
        }
        Ok(report)
    }

    /// Detected markers with the names of their dictionaries.
    fn detect(&self, image: &GrayImage) -> Result<Vec<(String, Detection)>> {
        let settings = ApriltagSettings {
            full: FullSearch::Always,
            ..ApriltagSettings::default()
        };
        let own = match (&self.board, &self.dictionary) {
            (Some(board), _) => Some((board.dictionary.clone(), board.board.ids())),
            (None, Some(dictionary)) => {
                let ids = (0..dictionary.len() as u32).collect();
                Some((dictionary.clone(), ids))
            }
            (None, None) => None,
        };
        let searched = match own {
            Some(own) => vec![own],
            None => identify(image, settings)?
                .into_iter()
                .map(|identified| {
                    let dictionary = identified.dictionary;
                    let ids = (0..dictionary.len() as u32).collect();
                    (dictionary, ids)
                })
                .collect(),
        };
        let mut found = Vec::new();
        for (dictionary, ids) in searched {
            let mut detector = ApriltagDetector::new(&dictionary, &ids, settings)?;
            let detections = detector.detect(image)?;
            found.extend(
                detections
                    .into_iter()
                    .map(|d| (dictionary.name().to_owned(), d)),
            );
        }
        Ok(found)
    }

    /// Pose of the board and opening of the gripper; none without board or camera, or without
    /// markers.
    fn pose(
        &self,
        image: &GrayImage,
        detections: &[Detection],
    ) -> Option<Result<(BodyPose, Option<f64>)>> {
        let (board, intrinsics) = (&self.board.as_ref()?.board, self.intrinsics.as_ref()?);
        if detections.is_empty() {
            return None;
        }
        let solve = || {
            require_size(intrinsics, image.width(), image.height())?;
            if board.markers_on(Body::Object).next().is_some() {
                let body = solve_body_pose(board, Body::Object, detections, intrinsics)?;
                return Ok((body, None));
            }
            let gripper = solve_gripper(board, detections, intrinsics, None)?;
            let opening = gripper.opening.map(|opening| opening.opening_m);
            Ok((gripper.body, opening))
        };
        Some(solve())
    }

    /// Why no marker was detected.
    fn missing(&self, image: &GrayImage) -> Result<String> {
        let (dictionary, ids, what) = match (&self.board, &self.dictionary) {
            (Some(board), _) => (&board.dictionary, board.board.ids(), &*board.board.name),
            (None, Some(dictionary)) => {
                let ids = (0..dictionary.len() as u32).collect();
                (dictionary, ids, dictionary.name())
            }
            (None, None) => {
                return Ok(
                    "no markers of any known dictionary: one marker of a small dictionary \
                           is not told from chance; name it with --dictionary"
                        .to_owned(),
                );
            }
        };
        Ok(diagnose(image, dictionary, &ids)?
            .to_error(what)
            .to_string())
    }

    fn draw(
        &self,
        mut image: RgbImage,
        detections: &[Detection],
        t_camera_board: Option<Pose>,
        folder: &Path,
        file: &Path,
    ) -> Result<PathBuf> {
        draw_markers(&mut image, detections);
        if let (Some(pose), Some(intrinsics)) = (t_camera_board, &self.intrinsics) {
            draw_axes(&mut image, intrinsics, &pose);
        }
        let path = folder.join(format!("{}.jpg", file_name(file)));
        save(&path, &encode_jpeg(&image, OVERLAY_JPEG_QUALITY)?)?;
        Ok(path)
    }
}

impl Marker {
    fn new(image: &GrayImage, dictionary: &str, detection: &Detection) -> Self {
        let quality = edge_quality(image, &detection.corners_px);
        Self {
            id: detection.id,
            dictionary: dictionary.to_owned(),
            corners_px: detection.corners_px.map(|corner| corner.to_array()),
            sides_px: detection.sides_px(),
            corrected_bits: detection.hamming,
            decision_margin: detection.margin,
            blur_px: quality.map(|q| q.blur_px),
            contrast: quality.map(|q| q.contrast),
            clipped: quality.map(|q| q.clipped),
        }
    }

    fn min_side_px(&self) -> f64 {
        self.sides_px.into_iter().fold(f64::INFINITY, f64::min)
    }
}

impl ImageReport {
    fn add_pose(&mut self, body: &BodyPose, opening_m: Option<f64>) {
        self.notes.extend(body.notes.iter().cloned());
        self.notes.extend(body.residual_note("board"));
        if body.ambiguous {
            self.notes
                .push("the pose is ambiguous: another fits as well".to_owned());
        }
        self.pose = Some(BoardPose {
            t_camera_board: body.t_camera_body,
            rms_px: body.rms_px,
            used_markers: body.used_markers(),
            ambiguous: body.ambiguous,
            opening_m,
        });
    }

    fn add_notes(&mut self) {
        let markers = &self.markers;
        let same = |a: &Marker, b: &Marker| (&a.dictionary, a.id) == (&b.dictionary, b.id);
        let copies = |marker: &Marker| markers.iter().filter(|m| same(m, marker)).count();
        let mut repeated: Vec<u32> = markers
            .iter()
            .filter(|m| copies(m) > 1)
            .map(|m| m.id)
            .collect();
        repeated.sort_unstable();
        repeated.dedup();
        for id in &repeated {
            self.notes
                .push(format!("marker {id} is in the image more than once"));
        }
        let small = markers
            .iter()
            .filter(|m| m.min_side_px() < MIN_SIDE_PX)
            .count();
        if small > 0 {
            self.notes.push(format!(
                "{small} of {} markers are smaller than {MIN_SIDE_PX} px: their corners are less \
                 accurate",
                markers.len()
            ));
        }
        self.repeated_ids = repeated;
    }
}

impl Report {
    fn text(&self) -> String {
        let mut lines = Vec::new();
        for image in &self.images {
            lines.push(format!(
                "{}  {}×{}  {} markers",
                image.image,
                image.width,
                image.height,
                image.markers.len()
            ));
            if !image.markers.is_empty() {
                lines.push(format!(
                    "  {:<21} {:>5}  {:>17}  {:>7}  {:>5}  {:>8}",
                    "dictionary", "id", "centre px", "side px", "blur", "contrast"
                ));
            }
            lines.extend(image.markers.iter().map(Marker::line));
            if let Some(pose) = &image.pose {
                let [x, y, z] = pose
                    .t_camera_board
                    .translation_m
                    .to_array()
                    .map(|m| 1e3 * m);
                let opening = pose.opening_m.map_or(String::new(), |opening| {
                    format!(", opening {:.2} mm", 1e3 * opening)
                });
                lines.push(format!(
                    "  board at {x:.2} {y:.2} {z:.2} mm, residual {:.3} px, {} markers{opening}",
                    pose.rms_px, pose.used_markers
                ));
            }
            lines.extend(image.error.iter().map(|error| format!("  error: {error}")));
            lines.extend(image.notes.iter().map(|note| format!("  note: {note}")));
        }
        lines.join("\n")
    }
}

impl Marker {
    fn line(&self) -> String {
        let mean = |k: usize| 0.25 * self.corners_px.iter().map(|c| c[k]).sum::<f64>();
        let shown = |value: Option<f64>| value.map_or("-".to_owned(), |v| format!("{v:.2}"));
        format!(
            "  {:<21} {:>5}  {:>8.2} {:>8.2}  {:>7.1}  {:>5}  {:>8}",
            self.dictionary,
            self.id,
            mean(0),
            mean(1),
            0.25 * self.sides_px.iter().sum::<f64>(),
            shown(self.blur_px),
            shown(self.contrast)
        )
    }
}
