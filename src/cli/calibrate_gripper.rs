//! `gripcast calibrate gripper`: calibrates the poses of the gripper tags from images.

use std::path::{Path, PathBuf};

use serde::Serialize;

use super::image_folder::{file_name, images, read_grey};
use super::working::{Progress, interruptible};
use super::{Context, print_report};
use gripcast_base::error::{Error, ErrorKind, Result, unknown_name};
use gripcast_base::files::save;
use gripcast_imaging::{Decoder, Intrinsics};
use gripcast_pose::calibrate::{
    CalibratedMarker, FrameSource, GripperCalibration, GripperImage, MarkerState, calibrate_gripper,
};
use gripcast_pose::detect::{FullSearch, detectors, diagnose};
use gripcast_pose::refine::refine_all;
use gripcast_pose::{BoardFile, load_intrinsics, require_size};

/// Arguments.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Nominal board file of the gripper tags, with their measured sizes
    #[arg(long, value_name = "FILE.toml")]
    tags: PathBuf,
    /// Intrinsics of the camera, in any format of `calibrate show`
    #[arg(long, value_name = "FILE")]
    intrinsics: PathBuf,
    /// Folder of images of the gripper (.png, .jpg)
    #[arg(long, value_name = "DIR")]
    images: PathBuf,
    /// Images in which the gel faces touch
    #[arg(long, value_name = "NAME", num_args = 1..)]
    closed: Vec<String>,
    /// Board file to write
    #[arg(long, value_name = "FILE.toml")]
    out: PathBuf,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

/// Images with their detected markers, and unreadable images.
struct Detections {
    images: Vec<GripperImage>,
    unreadable: Vec<Skipped>,
}

#[derive(Clone, Serialize)]
struct Skipped {
    image: String,
    reason: String,
}

/// Runs the command.
pub(super) fn run(context: &Context, args: Args) -> Result<()> {
    let nominal = BoardFile::load(&args.tags)?;
    let intrinsics = load_intrinsics(&args.intrinsics)?;
    let files = images(&args.images)?;
    let closed = closed(&args.closed, &files)?;
    let (folder, board) = (args.images.clone(), nominal.clone());
    let (detections, result) = interruptible(context, "detecting tags", move |progress| {
        let detections = detect(&board, &intrinsics, &files, &closed, progress)
            .map_err(|e| e.at(folder.display()))?;
        let result = calibrate_gripper(&board, &intrinsics, &detections.images)
            .map_err(|e| e.at(folder.display()))?;
        Ok::<_, Error>((detections, result))
    })??;
    save(&args.out, result.board.to_toml().as_bytes())?;
    let report = Report::new(&result, &detections, &args.out);
    print_report(args.json, &report, |report| report.text())?;
    let skipped = report.skipped.iter();
    context.warn(skipped.map(|s| format!("{} is not used: {}", s.image, s.reason)));
    context.warn(&result.notes);
    let is_loose = |m: &CalibratedMarker| matches!(m.state, MarkerState::Loose { .. });
    let loose = result.markers.iter().filter(|m| is_loose(m)).count();
    match (detections.unreadable.len(), loose) {
        (0, 0) => Ok(()),
        (unreadable, loose) => Err(Error::new(
            ErrorKind::Partial,
            format!("{unreadable} images were unreadable, {loose} tags were loose"),
        )),
    }
}

/// Returns for each image whether its name, with or without suffix, is in `wanted`.
fn closed(wanted: &[String], files: &[PathBuf]) -> Result<Vec<bool>> {
    let names: Vec<String> = files.iter().map(|f| file_name(f)).collect();
    let names: Vec<&str> = names.iter().map(|n| &**n).collect();
    let mut closed = vec![false; files.len()];
    for wanted in wanted {
        let is_wanted = |f: &PathBuf| {
            file_name(f) == *wanted
                || f.file_stem()
                    .is_some_and(|stem| stem.to_string_lossy() == *wanted)
        };
        let index = files.iter().position(is_wanted);
        let index = index.ok_or_else(|| unknown_name("image", wanted, &names))?;
        closed[index] = true;
    }
    Ok(closed)
}

fn detect(
    board: &BoardFile,
    intrinsics: &Intrinsics,
    files: &[PathBuf],
    closed: &[bool],
    progress: &Progress,
) -> Result<Detections> {
    let mut all =
        detectors(&board.dictionary, &board.board.ids(), FullSearch::IfSmall)?.into_iter();
    let Some(mut detector) = all.next() else {
        return Err(Error::internal("there is no detector"));
    };
    let mut decoder = Decoder::new()?;
    let mut detections = Detections {
        images: Vec::new(),
        unreadable: Vec::new(),
    };
    let mut first = None;
    for (i, (file, closed)) in files.iter().zip(closed).enumerate() {
        let name = file_name(file);
        match read_grey(&mut decoder, file) {
            Err(error) => detections.unreadable.push(Skipped {
                image: name,
                reason: error.to_string(),
            }),
            Ok(image) => {
                require_size(intrinsics, image.width(), image.height()).map_err(|e| e.at(&name))?;
                let markers = detector.detect(&image).map_err(|e| e.at(&name))?;
                detections.images.push(GripperImage {
                    detections: refine_all(&image, &markers),
                    closed: *closed,
                    name,
                });
                first.get_or_insert(image);
            }
        }
        progress.count(i + 1, files.len());
    }
    let Some(first) = first else {
        let reason = detections.unreadable.first().map_or("", |s| &s.reason);
        let what = format!("no readable image: {reason}");
        return Err(Error::input(what));
    };
    if detections.images.iter().all(|p| p.detections.is_empty()) {
        let diagnosis = diagnose(&first, &board.dictionary, &board.board.ids())?;
        return Err(diagnosis.to_error(&board.board.name));
    }
    Ok(detections)
}

#[derive(Serialize)]
struct Report<'a> {
    file: &'a Path,
    name: &'a str,
    hash: String,
    images: usize,
    skipped: Vec<Skipped>,
    rms_px: f64,
    nominal_rms_px: Option<f64>,
    holdout_rms_px: Option<f64>,
    corner_sigma_px: f64,
    openings_m: Option<[f64; 2]>,
    x_from: &'static str,
    x_shift_deg: Option<f64>,
    x_sigma_deg: Option<f64>,
    opening_zero_from: &'static str,
    frame_sigma_mm: Option<f64>,
    frame_sigma_deg: Option<f64>,
    markers: Vec<MarkerReport>,
    notes: &'a [String],
}

#[derive(Serialize)]
struct MarkerReport {
    id: u32,
    body: &'static str,
    state: &'static str,
    reason: Option<String>,
    images: usize,
    outliers: usize,
    shift_mm: f64,
    shift_xyz_mm: [f64; 3],
    rotation_deg: f64,
    sigma_mm: Option<f64>,
    sigma_deg: Option<f64>,
    rms_px: Option<f64>,
    holdout_rms_px: Option<f64>,
}

fn source(source: FrameSource) -> &'static str {
    match source {
        FrameSource::Fingers => "fingers",
        FrameSource::Description => "nominal",
        FrameSource::Nothing => "nothing",
    }
}

impl MarkerReport {
    fn new(marker: &CalibratedMarker) -> Self {
        let (state, reason) = match &marker.state {
            MarkerState::Calibrated => ("calibrated", None),
            MarkerState::Nominal(reason) => ("nominal", Some((*reason).to_owned())),
            MarkerState::Loose { moved: None } => ("loose", None),
            MarkerState::Loose {
                moved: Some(([a, b], ..)),
            } => ("loose", Some(format!("it moved between {a} and {b}"))),
        };
        let sigma = marker.sigma();
        Self {
            id: marker.id,
            body: marker.body.name(),
            state,
            reason,
            images: marker.images,
            outliers: marker.outliers,
            shift_mm: 1e3 * marker.shift_m.length(),
            shift_xyz_mm: (1e3 * marker.shift_m).to_array(),
            rotation_deg: marker.rotation_rad.to_degrees(),
            sigma_mm: sigma.map(|s| 1e3 * s.0),
            sigma_deg: sigma.map(|s| s.1.to_degrees()),
            rms_px: marker.rms_px,
            holdout_rms_px: marker.left_out_rms_px,
        }
    }

    fn row(&self) -> String {
        let number = |value: Option<f64>| value.map_or("–".to_owned(), |v| format!("{v:.3}"));
        format!(
            "{:>5}  {:<12} {:>8} {:>9.2} {:>7.2} {:>9} {:>8} {:>7} {:>9}  {}",
            self.id,
            self.body,
            self.images,
            self.shift_mm,
            self.rotation_deg,
            number(self.sigma_mm),
            number(self.sigma_deg),
            number(self.rms_px),
            number(self.holdout_rms_px),
            self.state
        )
    }
}

impl<'a> Report<'a> {
    fn new(result: &'a GripperCalibration, detections: &Detections, file: &'a Path) -> Self {
        let unused = result.left_out.iter().map(|(image, reason)| Skipped {
            image: image.clone(),
            reason: reason.clone(),
        });
        Self {
            file,
            name: &result.board.board.name,
            hash: result.board.board.hash(),
            images: result.images,
            skipped: detections
                .unreadable
                .iter()
                .cloned()
                .chain(unused)
                .collect(),
            rms_px: result.rms_px,
            nominal_rms_px: result.described_rms_px,
            holdout_rms_px: result.holdout_rms_px,
            corner_sigma_px: result.corner_sigma_px,
            openings_m: result.openings_m,
            x_from: source(result.x_from),
            x_shift_deg: result.line_off_rad.map(|l| l.0.to_degrees()),
            x_sigma_deg: result.line_off_rad.map(|l| l.1.to_degrees()),
            opening_zero_from: source(result.zero_from),
            frame_sigma_mm: result.frame_sigma_m.map(|s| 1e3 * s),
            frame_sigma_deg: result.frame_sigma_rad.map(f64::to_degrees),
            markers: result.markers.iter().map(MarkerReport::new).collect(),
            notes: &result.notes,
        }
    }

    fn text(&self) -> String {
        let pixels = |value: Option<f64>| value.map_or("–".to_owned(), |v| format!("{v:.3} px"));
        let mut lines = vec![
            format!("board       {} ({})", self.name, self.hash),
            format!(
                "images      {}, {} not used",
                self.images,
                self.skipped.len()
            ),
            format!(
                "error       {:.3} px; held-out images {}; nominal tag poses {}",
                self.rms_px,
                pixels(self.holdout_rms_px),
                pixels(self.nominal_rms_px)
            ),
        ];
        if let Some([min, max]) = self.openings_m {
            lines.push(format!(
                "openings    {:.1} to {:.1} mm, zero from {}",
                1e3 * min,
                1e3 * max,
                match self.opening_zero_from {
                    "fingers" => "closed images",
                    other => other,
                }
            ));
        }
        lines.push(format!("x axis      from {}", self.x_from));
        if let (Some(mm), Some(deg)) = (self.frame_sigma_mm, self.frame_sigma_deg) {
            lines.push(format!(
                "frame       ± {mm:.1} mm, ± {deg:.1}° by the scatter of the tags"
            ));
        }
        lines.push(format!(
            "{:>5}  {:<12} {:>8} {:>9} {:>7} {:>9} {:>8} {:>7} {:>9}",
            "id",
            "body",
            "images",
            "shift mm",
            "rot °",
            "sigma mm",
            "sigma °",
            "rms px",
            "held out"
        ));
        lines.extend(self.markers.iter().map(MarkerReport::row));
        lines.push(format!("file        {}", self.file.display()));
        lines.join("\n")
    }
}
