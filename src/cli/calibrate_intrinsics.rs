//! `gripcast calibrate intrinsics`: calibrates camera intrinsics with a planar board.
//!
//! ```text
//! gripcast board charuco --out charuco.pdf
//! gripcast calibrate intrinsics --board charuco.toml --rig bench --camera external --out external.toml
//! gripcast calibrate intrinsics --board charuco.toml --images shots/ --out external.toml
//! gripcast calibrate intrinsics --chessboard 9x6 --square-mm 25 --images shots/ --out external.toml
//! ```
//!
//! `--images` uses the JPEG and PNG files of a folder, sorted by name. `--rig` opens a camera of
//! the rig, shows which views are missing, and ends when there are enough. On a terminal, Enter
//! ends with the current views and `q` or Ctrl-C quits without writing. The results are explained
//! in docs/how-to/calibration.md.
//!
//! Exit codes: 0 done · 1 calibration failed or invalid file · 2 usage · 3 done, but some images
//! were unreadable or did not show the board · 69 no such camera · 130 interrupted, nothing
//! written.

use std::path::{Path, PathBuf};

use image::GrayImage;
use serde_json::{Value, json};

use super::flags::{check_output, millimetres, size};
use super::image_folder::{file_name, images, read_grey};
use super::working::interruptible;
use super::{Context, calibrate_live, print, print_json};
use crate::note;
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_imaging::{Decoder, Role};
use gripcast_pose::BoardFile;
use gripcast_pose::calibrate::{
    CalibrationReport, Collector, CollectorSettings, Hint, PARAMETERS, Rejection,
};
use gripcast_pose::detect::{Diagnosis, diagnose};

/// Reprojection error that causes a warning, px.
const MAX_RMS_PX: f64 = 0.5;
/// Ratio of held-out to training error that causes a warning of overfitting.
const MAX_HOLDOUT_RATIO: f64 = 1.5;
/// Uncertainty in the image corners that causes a warning, px.
const MAX_CORNER_SIGMA_PX: f64 = 1.0;

/// Arguments.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Board file: a ChArUco board, any planar marker board or a chessboard
    #[arg(long, value_name = "FILE.toml", required_unless_present = "chessboard")]
    board: Option<PathBuf>,
    /// Columns and rows of inner corners of a chessboard without markers
    #[arg(long, value_name = "COLUMNSxROWS", conflicts_with = "board", requires = "square_mm",
        value_parser = |text: &str| size(text, 2..=59))]
    chessboard: Option<[u32; 2]>,
    /// Side length of a square of the chessboard
    #[arg(long, value_name = "MM", requires = "chessboard", value_parser = millimetres)]
    square_mm: Option<f64>,
    /// Folder of JPEG and PNG images of one camera
    #[arg(
        long,
        value_name = "DIR",
        required_unless_present = "rig",
        conflicts_with_all = ["rig", "keep"]
    )]
    images: Option<PathBuf>,
    /// Rig with the camera to calibrate live: its name or file
    #[arg(long, value_name = "NAME|FILE")]
    rig: Option<String>,
    /// Intrinsics file to write
    #[arg(long, value_name = "FILE.toml")]
    out: PathBuf,
    /// Role of the camera in the rig
    #[arg(long, value_name = "ROLE", default_value = "external", value_parser = role)]
    camera: Role,
    /// Number of views to collect, given full coverage
    #[arg(long, value_name = "N", default_value_t = 12,
        value_parser = clap::value_parser!(u16).range(3..=60))]
    views: u16,
    /// Save the images used in a live calibration
    #[arg(long, value_name = "DIR")]
    keep: Option<PathBuf>,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

fn role(text: &str) -> Result<Role, String> {
    let role: Role = text.parse().map_err(|e: Error| e.to_string())?;
    if role == Role::Depth {
        return Err("the depth camera cannot see markers".to_owned());
    }
    Ok(role)
}

impl Args {
    fn board_file(&self) -> Result<BoardFile> {
        match (&self.board, self.chessboard, self.square_mm) {
            (Some(path), _, _) => BoardFile::load(path),
            (None, Some([columns, rows]), Some(square_mm)) => {
                let name = format!("chessboard of {columns}×{rows} corners");
                BoardFile::plain_chessboard(&name, [columns, rows], [square_mm; 2])
            }
            _ => Err(Error::usage(
                "give --board, or --chessboard and --square-mm",
            )),
        }
    }
}

/// Collected views.
pub(super) struct Views {
    pub(super) collector: Collector,
    /// Image names of the views.
    pub(super) names: Vec<String>,
    /// Unused images with the reason.
    pub(super) left_out: Vec<(String, String)>,
    /// Number of unreadable images and of images without the board.
    pub(super) unusable: usize,
}

impl Views {
    pub(super) fn new(collector: Collector) -> Self {
        Self {
            collector,
            names: Vec::new(),
            left_out: Vec::new(),
            unusable: 0,
        }
    }
}

/// Runs the command.
pub(super) fn run(context: &Context, args: &Args) -> Result<()> {
    let board = args.board_file()?;
    check_output("--out", &args.out, &[])?;
    let settings = CollectorSettings {
        wanted: usize::from(args.views),
        still: args.images.is_none(),
        ..CollectorSettings::default()
    };
    let collector = Collector::new(&board, settings).map_err(|e| e.at(&board.board.name))?;
    let views = match (&args.images, &args.rig) {
        (Some(folder), _) => {
            let folder = folder.clone();
            interruptible(context, "calibrating", move |progress| {
                from_folder(collector, &folder, &|line| progress.line(line))
            })??
        }
        (None, Some(rig)) => {
            calibrate_live::collect(context, collector, rig, args.camera, args.keep.as_deref())?
        }
        (None, None) => return Err(Error::usage("give --images or --rig")),
    };
    let report = views
        .collector
        .finish()
        .map_err(|e| e.at(board.board.name.clone()))?;
    let warnings = warnings(&views, &report);
    report.intrinsics.save(&args.out)?;
    if args.json {
        print_json(&as_json(args, &views, &report, &warnings))?;
    } else {
        print(&as_text(args, &views, &report))?;
        for warning in &warnings {
            note!("warning: {warning}");
        }
    }
    match views.unusable {
        0 => Ok(()),
        count => Err(Error::new(
            ErrorKind::Partial,
            format!("{count} image(s) were unusable; the calibration uses the others"),
        )),
    }
}

fn from_folder(collector: Collector, folder: &Path, on_progress: &dyn Fn(String)) -> Result<Views> {
    let mut decoder = Decoder::new()?;
    let mut views = Views::new(collector);
    let mut sizes: Vec<String> = Vec::new();
    let mut without_board: Option<GrayImage> = None;
    for path in images(folder)? {
        let name = file_name(&path);
        let offered = read_grey(&mut decoder, &path)
            .and_then(|image| Ok((views.collector.add_image(&image)?, image)));
        let reason = match offered {
            Err(error) => {
                views.unusable += 1;
                Some(error.to_string())
            }
            Ok((offer, image)) => {
                match offer.rejection {
                    Some(Rejection::Size([width, height], _)) => {
                        sizes.push(format!("{name} ({width}×{height})"));
                    }
                    Some(Rejection::NoBoard | Rejection::NoChessboard(_)) => {
                        views.unusable += 1;
                        without_board.get_or_insert(image);
                    }
                    _ => {}
                }
                offer.rejection.map(|r| r.to_string())
            }
        };
        match reason {
            None => views.names.push(name),
            Some(reason) => {
                on_progress(format!("{name}: {reason}"));
                views.left_out.push((name, reason));
            }
        }
    }
    if !sizes.is_empty() {
        return Err(other_sizes(&views, &sizes).at(folder.display()));
    }
    if let Some(image) = without_board {
        let explained = explained(&views.collector, &image)?;
        if views.names.is_empty() {
            return Err(explained.at(folder.display()));
        }
        on_progress(explained.to_string());
    }
    if views.names.is_empty() {
        return Err(none_usable(&views).at(folder.display()));
    }
    Ok(views)
}

/// The error for an image without the board.
fn explained(collector: &Collector, image: &GrayImage) -> Result<Error> {
    if let Some(chessboard) = collector.file().plain() {
        let rejection = Rejection::NoChessboard(chessboard.squares.map(|n| n - 1));
        return Ok(Error::input(rejection.to_string())
            .remedy("count the corners between black squares, not the squares"));
    }
    let diagnosis = diagnosed(collector, image)?;
    Ok(diagnosis.to_error(&collector.file().board.name))
}

/// Diagnoses an image without the board.
pub(super) fn diagnosed(collector: &Collector, image: &GrayImage) -> Result<Diagnosis> {
    let file = collector.file();
    diagnose(image, &file.dictionary, &file.board.ids())
}

fn other_sizes(views: &Views, sizes: &[String]) -> Error {
    const MAX: usize = 8;
    let [width, height] = views.collector.size().unwrap_or_default();
    let more = match sizes.len().saturating_sub(MAX) {
        0 => String::new(),
        count => format!(" and {count} more"),
    };
    Error::input(format!(
        "the images have different sizes: {width}×{height} first, then {}{more}",
        sizes[..sizes.len().min(MAX)].join(", ")
    ))
    .remedy("intrinsics depend on the image size: use the images of one camera in one mode")
}

fn none_usable(views: &Views) -> Error {
    let first = views.left_out.first();
    let reason = first.map_or(String::new(), |(name, reason)| {
        format!(": {name}: {reason}")
    });
    Error::input(format!("no usable image{reason}"))
        .remedy("docs/how-to/calibration.md explains how to take them")
}

fn warnings(views: &Views, report: &CalibrationReport) -> Vec<String> {
    let mut warnings = Vec::new();
    if report.rms_px > MAX_RMS_PX {
        warnings.push(format!(
            "the reprojection error of {:.2} px is large: check that the board is flat, the images \
             are sharp and the focus is fixed",
            report.rms_px
        ));
    }
    if let Some(holdout) = &report.holdout
        && holdout.rms_px > MAX_HOLDOUT_RATIO * report.rms_px
    {
        warnings.push(format!(
            "held-out views fit much worse ({:.2} px) than the others ({:.2} px): add views",
            holdout.rms_px, report.rms_px
        ));
    }
    if report.corner_sigma_px.is_infinite() {
        warnings.push(
            "the fitted distortion has no inverse in the image corners: add views of the board there"
                .to_owned(),
        );
    } else if report.corner_sigma_px > MAX_CORNER_SIGMA_PX {
        warnings.push(format!(
            "the uncertainty in the image corners is {:.1} px: add views of the board there",
            report.corner_sigma_px
        ));
    }
    for view in report.views.iter().filter(|v| v.points == 0) {
        warnings.push(format!(
            "{} is inconsistent with the other views ({:.1} px) and was left out",
            views.names[view.view], view.rms_px
        ));
    }
    let hint = views.collector.coverage().hint();
    if hint != Hint::Enough {
        warnings.push(format!("more views would improve the calibration: {hint}"));
    }
    warnings
}

fn as_text(args: &Args, views: &Views, report: &CalibrationReport) -> String {
    let lens = &report.intrinsics;
    let [k1, k2, p1, p2, k3] = lens.coefficients;
    let values = [lens.fx, lens.fy, lens.cx, lens.cy, k1, k2, p1, p2, k3];
    let mut lines = vec![format!(
        "camera      {}×{} pixels, {} views, {} left out",
        lens.width,
        lens.height,
        report.views.iter().filter(|v| v.points > 0).count(),
        views.left_out.len() + report.views.iter().filter(|v| v.points == 0).count()
    )];
    for (i, name) in PARAMETERS.iter().enumerate() {
        let digits = if i < 4 { 2 } else { 5 };
        lines.push(if report.fitted[i] {
            format!(
                "{name:<11} {:.digits$} ± {:.digits$}",
                values[i], report.sigma[i]
            )
        } else {
            format!("{name:<11} 0 (not determined)")
        });
    }
    lines.push(format!("error       {:.3} px rms", report.rms_px));
    if let Some(holdout) = &report.holdout {
        let [fx, fy, cx, cy] = holdout.spread_px;
        lines.push(format!(
            "held out    {:.3} px rms; fx, fy, cx, cy vary by {fx:.2}, {fy:.2}, {cx:.2}, {cy:.2} \
             px over the folds",
            holdout.rms_px
        ));
    }
    lines.push(match report.corner_sigma_px {
        sigma if sigma.is_finite() => format!("corners     ± {sigma:.2} px"),
        _ => "corners     not known".to_owned(),
    });
    lines.push(format!("intrinsics  {}", args.out.display()));
    lines.join("\n")
}

fn as_json(args: &Args, views: &Views, report: &CalibrationReport, warnings: &[String]) -> Value {
    let file = views.collector.file();
    let by_name = |values: &[f64]| -> Value {
        PARAMETERS
            .iter()
            .zip(values)
            .map(|(name, value)| ((*name).to_owned(), json!(value)))
            .collect::<serde_json::Map<String, Value>>()
            .into()
    };
    let fitted: Vec<&str> = PARAMETERS
        .iter()
        .zip(report.fitted)
        .filter_map(|(name, is_fitted)| is_fitted.then_some(*name))
        .collect();
    let t_plane_board = views.collector.t_plane_board();
    let view = |view: &gripcast_pose::calibrate::ViewFit| {
        json!({
            "outliers": view.outliers,
            "image": views.names[view.view],
            "points": view.points,
            "rms_px": view.rms_px,
            "t_camera_board": view.t_camera_plane * t_plane_board,
        })
    };
    let left_out = |(image, reason): &(String, String)| json!({ "image": image, "reason": reason });
    json!({
        "board": {
            "hash": file.plain().is_none().then(|| file.board.hash()),
            "name": file.board.name,
        },
        "corner_sigma_px": report.corner_sigma_px,
        "fitted": fitted,
        "holdout": report.holdout.map(|h| json!({
            "folds": h.folds,
            "rms_px": h.rms_px,
            "spread_px": by_name(&h.spread_px),
        })),
        "intrinsics": report.intrinsics,
        "left_out": views.left_out.iter().map(left_out).collect::<Vec<_>>(),
        "out": args.out,
        "point_sigma_px": report.point_sigma_px,
        "rms_px": report.rms_px,
        "sigma": by_name(&report.sigma),
        "views": report.views.iter().map(view).collect::<Vec<_>>(),
        "warnings": warnings,
    })
}
