//! `gripcast calibrate intrinsics`: intrinsics of a camera from views of a flat board.
//!
//! ```text
//! gripcast board charuco --out charuco.pdf
//! gripcast calibrate intrinsics --board charuco.toml --rig bench --camera external --out external.toml
//! gripcast calibrate intrinsics --board charuco.toml --images shots/ --out external.toml
//! ```
//!
//! With `--images` the JPEG and PNG files of a folder are taken in the order of their names.
//! With `--rig` a camera of the rig is opened, hints say which view is still missing, and it ends
//! when there are enough. On a terminal Enter ends it with the views so far, and `q` or Ctrl-C
//! leaves without writing. docs/calibration.md says what the numbers mean.
//!
//! Exit codes: 0 done · 1 the views do not give a calibration, or a file is refused · 2 usage ·
//! 3 done, but images could not be read or did not show the board · 69 no such camera ·
//! 130 interrupted; nothing was written.

use std::path::{Path, PathBuf};

use image::GrayImage;
use serde_json::{Value, json};

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
use gripcast_pose::detect::{Diagnosis, builtin_dictionaries, diagnose};

/// Errors above which a person should look for the cause, px.
const LARGE_RMS_PX: f64 = 0.5;
/// Ratio of the error of left out views to that of the others that shows overfitting.
const LARGE_HOLDOUT: f64 = 1.5;
/// Uncertainty of the image's corners that is told, px.
const LARGE_CORNER_PX: f64 = 1.0;

/// Arguments.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Board file: a chessboard of `board charuco`, or any flat board of markers
    #[arg(long, value_name = "FILE.toml")]
    board: PathBuf,
    /// Folder of JPEG and PNG images of one camera
    #[arg(
        long,
        value_name = "DIR",
        required_unless_present = "rig",
        conflicts_with_all = ["rig", "keep"]
    )]
    images: Option<PathBuf>,
    /// Rig whose camera is calibrated live: its name or file
    #[arg(long, value_name = "NAME|FILE")]
    rig: Option<String>,
    /// Role of the camera in the rig
    #[arg(long, value_name = "ROLE", default_value = "external", value_parser = role)]
    camera: Role,
    /// Views that are enough if they cover everything
    #[arg(long, value_name = "N", default_value_t = 12, value_parser = clap::value_parser!(u16).range(3..=60))]
    views: u16,
    /// Keep the images that were used, live
    #[arg(long, value_name = "DIR")]
    keep: Option<PathBuf>,
    /// Intrinsics file to write
    #[arg(long, value_name = "FILE.toml")]
    out: PathBuf,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

fn role(text: &str) -> Result<Role, String> {
    let role: Role = text.parse().map_err(|e: Error| e.to_string())?;
    if role == Role::Depth {
        return Err("the depth camera gives no images of markers".to_owned());
    }
    Ok(role)
}

/// What a calibration is made of.
pub(super) struct Taken {
    pub(super) collector: Collector,
    /// Names of the views, in their order.
    pub(super) names: Vec<String>,
    /// Images that are not used, and why.
    pub(super) left_out: Vec<(String, String)>,
    /// How many of these should have been usable.
    pub(super) lost: usize,
}

/// Runs the verb.
pub(super) fn run(context: &Context, args: &Args) -> Result<()> {
    let board = BoardFile::load(&args.board)?;
    if let Some(folder) = args.out.parent().filter(|f| !f.as_os_str().is_empty())
        && !folder.is_dir()
    {
        let what = "there is no folder to write the intrinsics to";
        return Err(Error::not_found(what).at(folder.display()));
    }
    let settings = CollectorSettings {
        wanted: usize::from(args.views),
        still: args.images.is_none(),
        ..CollectorSettings::default()
    };
    let collector = Collector::new(&board, settings).map_err(|e| e.at(args.board.display()))?;
    let taken = match (&args.images, &args.rig) {
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
    let report = taken
        .collector
        .finish()
        .map_err(|e| e.at(board.board.name.clone()))?;
    let warnings = warnings(&taken, &report);
    report.intrinsics.save(&args.out)?;
    if args.json {
        print_json(&as_json(args, &taken, &report, &warnings))?;
    } else {
        print(&as_text(args, &taken, &report))?;
        for warning in &warnings {
            note!("warning: {warning}");
        }
    }
    if taken.lost > 0 {
        return Err(Error::new(
            ErrorKind::Partial,
            format!(
                "{} image(s) could not be used; the calibration is of the others",
                taken.lost
            ),
        ));
    }
    Ok(())
}

fn from_folder(collector: Collector, folder: &Path, say: &dyn Fn(String)) -> Result<Taken> {
    let mut decoder = Decoder::new()?;
    let mut taken = Taken {
        collector,
        names: Vec::new(),
        left_out: Vec::new(),
        lost: 0,
    };
    let mut sizes: Vec<String> = Vec::new();
    let mut without_board: Option<GrayImage> = None;
    for path in images(folder)? {
        let name = file_name(&path);
        let offered = read_grey(&mut decoder, &path)
            .and_then(|image| Ok((taken.collector.add_image(&image)?, image)));
        let reason = match offered {
            Err(error) => {
                taken.lost += 1;
                Some(error.to_string())
            }
            Ok((offer, image)) => {
                match offer.rejection {
                    Some(Rejection::Size([width, height], _)) => {
                        sizes.push(format!("{name} ({width}×{height})"));
                    }
                    Some(Rejection::NoBoard) => {
                        taken.lost += 1;
                        without_board.get_or_insert(image);
                    }
                    _ => {}
                }
                offer.rejection.map(|r| r.to_string())
            }
        };
        match reason {
            None => taken.names.push(name),
            Some(reason) => {
                say(format!("{name}: {reason}"));
                taken.left_out.push((name, reason));
            }
        }
    }
    if !sizes.is_empty() {
        return Err(other_sizes(&taken, &sizes).at(folder.display()));
    }
    if let Some(image) = without_board {
        let diagnosis = diagnosed(&taken.collector, &image)?;
        let explained = diagnosis.to_error(&taken.collector.file().board.name);
        if taken.names.is_empty() {
            return Err(explained.at(folder.display()));
        }
        say(explained.to_string());
    }
    if taken.names.is_empty() {
        return Err(none_usable(&taken).at(folder.display()));
    }
    Ok(taken)
}

/// What is in an image in place of the board.
pub(super) fn diagnosed(collector: &Collector, image: &GrayImage) -> Result<Diagnosis> {
    let file = collector.file();
    let others = builtin_dictionaries();
    diagnose(image, &file.dictionary, &file.board.ids(), &others)
}

fn other_sizes(taken: &Taken, sizes: &[String]) -> Error {
    const MAX: usize = 8;
    let [width, height] = taken.collector.size().unwrap_or_default();
    let more = sizes.len().saturating_sub(MAX);
    let more = if more > 0 {
        format!(" and {more} more")
    } else {
        String::new()
    };
    Error::input(format!(
        "the images have different sizes: {width}×{height} first, then {}{more}",
        sizes[..sizes.len().min(MAX)].join(", ")
    ))
    .remedy("intrinsics are those of one size: keep the images of one camera in one mode")
}

fn none_usable(taken: &Taken) -> Error {
    let first = taken.left_out.first();
    let reason = first.map_or(String::new(), |(name, reason)| {
        format!(": {name}: {reason}")
    });
    Error::input(format!("no image is usable{reason}"))
        .remedy("docs/calibration.md says how to take them")
}

/// What a person should know.
fn warnings(taken: &Taken, report: &CalibrationReport) -> Vec<String> {
    let mut said = Vec::new();
    if report.rms_px > LARGE_RMS_PX {
        said.push(format!(
            "the reprojection error of {:.2} px is large: is the board flat, were the images \
             sharp, is the focus fixed?",
            report.rms_px
        ));
    }
    if let Some(holdout) = &report.holdout
        && holdout.rms_px > LARGE_HOLDOUT * report.rms_px
    {
        said.push(format!(
            "views that were left out fit much worse ({:.2} px) than the others ({:.2} px): take \
             more views",
            holdout.rms_px, report.rms_px
        ));
    }
    if report.corner_sigma_px > LARGE_CORNER_PX {
        said.push(format!(
            "the lens is known to {:.1} px only in the corners of the image: hold the board \
             there too",
            report.corner_sigma_px
        ));
    }
    for view in report.views.iter().filter(|v| v.points == 0) {
        said.push(format!(
            "{} fits no other view ({:.1} px) and was left out",
            taken.names[view.view], view.rms_px
        ));
    }
    let coverage = taken.collector.coverage();
    let hint = coverage.hint();
    if hint != Hint::Enough {
        said.push(format!("it could be better with more views: {hint}"));
    }
    said
}

fn as_text(args: &Args, taken: &Taken, report: &CalibrationReport) -> String {
    let lens = &report.intrinsics;
    let [k1, k2, p1, p2, k3] = lens.coefficients;
    let values = [lens.fx, lens.fy, lens.cx, lens.cy, k1, k2, p1, p2, k3];
    let mut lines = vec![format!(
        "camera      {}×{} pixels, {} views, {} left out",
        lens.width,
        lens.height,
        report.views.iter().filter(|v| v.points > 0).count(),
        taken.left_out.len() + report.views.iter().filter(|v| v.points == 0).count()
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
            "left out    {:.3} px rms of views that the calibration had not seen; without them \
             fx, fy, cx, cy spread by {fx:.2}, {fy:.2}, {cx:.2}, {cy:.2} px",
            holdout.rms_px
        ));
    }
    lines.push(format!(
        "corners     known to {:.2} px",
        report.corner_sigma_px
    ));
    lines.push(format!("intrinsics  {}", args.out.display()));
    lines.join("\n")
}

fn as_json(args: &Args, taken: &Taken, report: &CalibrationReport, warnings: &[String]) -> Value {
    let file = taken.collector.file();
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
    let t_plane_board = taken.collector.t_plane_board();
    let view = |view: &gripcast_pose::calibrate::ViewFit| {
        json!({
            "outliers": view.outliers,
            "image": taken.names[view.view],
            "points": view.points,
            "rms_px": view.rms_px,
            "t_camera_board": view.t_camera_plane * t_plane_board,
        })
    };
    let left_out = |(image, reason): &(String, String)| json!({ "image": image, "reason": reason });
    json!({
        "board": { "hash": file.board.hash(), "name": file.board.name },
        "corner_sigma_px": report.corner_sigma_px,
        "fitted": fitted,
        "holdout": report.holdout.map(|h| json!({
            "folds": h.folds,
            "rms_px": h.rms_px,
            "spread_px": by_name(&h.spread_px),
        })),
        "intrinsics": report.intrinsics,
        "left_out": taken.left_out.iter().map(left_out).collect::<Vec<_>>(),
        "out": args.out,
        "point_sigma_px": report.point_sigma_px,
        "rms_px": report.rms_px,
        "sigma": by_name(&report.sigma),
        "views": report.views.iter().map(view).collect::<Vec<_>>(),
        "warnings": warnings,
    })
}
