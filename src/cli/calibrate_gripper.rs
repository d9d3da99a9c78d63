//! `gripcast calibrate gripper`: where the gripper's tags are, from images.

use std::path::{Path, PathBuf};

use serde::Serialize;

use super::image_folder::{file_name, images, read_grey};
use super::working::{Progress, interruptible};
use super::{Context, print_report};
use crate::note;
use gripcast_base::error::{Error, ErrorKind, Result, unknown_name};
use gripcast_base::files::save;
use gripcast_imaging::{Decoder, Intrinsics};
use gripcast_pose::calibrate::{
    CalibratedMarker, FrameSource, GripperCalibration, GripperImage, MarkerState, calibrate_gripper,
};
use gripcast_pose::detect::{builtin_dictionaries, detectors, diagnose};
use gripcast_pose::refine::refine_all;
use gripcast_pose::{BoardFile, load_intrinsics, require_size};

/// Arguments.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Board file of the gripper's tags as they were designed, with their measured sizes
    #[arg(long, value_name = "FILE.toml")]
    tags: PathBuf,
    /// Intrinsics of the camera, of any format that `calibrate show` reads
    #[arg(long, value_name = "FILE")]
    intrinsics: PathBuf,
    /// Folder of images of the gripper (.png, .jpg), in the order of their names
    #[arg(long, value_name = "FOLDER")]
    images: PathBuf,
    /// Image in which the gel faces touch; may be given several times
    #[arg(long, value_name = "NAME", num_args = 1..)]
    closed: Vec<String>,
    /// Board file to write
    #[arg(long, value_name = "FILE.toml")]
    out: PathBuf,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

/// Images with their markers, and those that could not be read.
struct Seen {
    images: Vec<GripperImage>,
    unreadable: Vec<Skipped>,
}

#[derive(Clone, Serialize)]
struct Skipped {
    image: String,
    reason: String,
}

/// Runs the verb.
pub(super) fn run(context: &Context, args: Args) -> Result<()> {
    let nominal = BoardFile::load(&args.tags)?;
    let intrinsics = load_intrinsics(&args.intrinsics)?;
    let files = images(&args.images)?;
    let closed = closed(&args.closed, &files)?;
    let (folder, board) = (args.images.clone(), nominal.clone());
    let (seen, found) = interruptible(context, "images", move |progress| {
        let seen = look(&board, &intrinsics, &files, &closed, progress)
            .map_err(|e| e.at(folder.display()))?;
        let found = calibrate_gripper(&board, &intrinsics, &seen.images)
            .map_err(|e| e.at(folder.display()))?;
        Ok::<_, Error>((seen, found))
    })??;
    save(&args.out, found.board.to_toml().as_bytes())?;
    let report = Report::new(&found, &seen, &args.out);
    print_report(args.json, &report, |report| report.text())?;
    if !context.quiet {
        for skipped in report.skipped.iter() {
            note!(
                "gripcast: {} is not used: {}",
                skipped.image,
                skipped.reason
            );
        }
        for note in &found.notes {
            note!("gripcast: {note}");
        }
    }
    let is_loose = |m: &CalibratedMarker| matches!(m.state, MarkerState::Loose { .. });
    let loose = found.markers.iter().filter(|m| is_loose(m)).count();
    match (seen.unreadable.len(), loose) {
        (0, 0) => Ok(()),
        (unreadable, loose) => Err(Error::new(
            ErrorKind::Partial,
            format!("{unreadable} images could not be read, {loose} tags were loose"),
        )),
    }
}

/// Whether each image was named as one with closed fingers, by its name with or without suffix.
fn closed(wanted: &[String], files: &[PathBuf]) -> Result<Vec<bool>> {
    let names: Vec<String> = files.iter().map(|f| file_name(f)).collect();
    let known: Vec<&str> = names.iter().map(|n| &**n).collect();
    let mut closed = vec![false; files.len()];
    for wanted in wanted {
        let is_it = |f: &PathBuf| {
            file_name(f) == *wanted
                || f.file_stem()
                    .is_some_and(|stem| stem.to_string_lossy() == *wanted)
        };
        let place = files.iter().position(is_it);
        let place = place.ok_or_else(|| unknown_name("image", wanted, &known))?;
        closed[place] = true;
    }
    Ok(closed)
}

fn look(
    board: &BoardFile,
    intrinsics: &Intrinsics,
    files: &[PathBuf],
    closed: &[bool],
    progress: &Progress,
) -> Result<Seen> {
    let mut all = detectors(&board.dictionary, &board.board.ids())?.into_iter();
    let Some(mut detector) = all.next() else {
        return Err(Error::internal("there is no detector"));
    };
    let mut decoder = Decoder::new()?;
    let mut seen = Seen {
        images: Vec::new(),
        unreadable: Vec::new(),
    };
    let mut first = None;
    for (i, (file, closed)) in files.iter().zip(closed).enumerate() {
        let name = file_name(file);
        match read_grey(&mut decoder, file) {
            Err(error) => seen.unreadable.push(Skipped {
                image: name,
                reason: error.to_string(),
            }),
            Ok(image) => {
                require_size(intrinsics, image.width(), image.height()).map_err(|e| e.at(&name))?;
                let found = detector.detect(&image).map_err(|e| e.at(&name))?;
                seen.images.push(GripperImage {
                    detections: refine_all(&image, &found),
                    closed: *closed,
                    name,
                });
                first.get_or_insert(image);
            }
        }
        progress.at(i as u64 + 1, files.len() as u64);
    }
    let Some(first) = first else {
        let reason = seen.unreadable.first().map_or("", |s| &s.reason);
        let what = format!("none of the images can be read: {reason}");
        return Err(Error::input(what));
    };
    if seen.images.iter().all(|p| p.detections.is_empty()) {
        let others = builtin_dictionaries();
        let why = diagnose(&first, &board.dictionary, &board.board.ids(), &others)?;
        return Err(why.to_error(&board.board.name));
    }
    Ok(seen)
}

#[derive(Serialize)]
struct Report<'a> {
    file: &'a Path,
    name: &'a str,
    hash: String,
    images: usize,
    skipped: Vec<Skipped>,
    rms_px: f64,
    described_rms_px: Option<f64>,
    holdout_rms_px: Option<f64>,
    corner_sigma_px: f64,
    openings_m: Option<[f64; 2]>,
    x_from: &'static str,
    x_off_deg: Option<f64>,
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
    part: &'static str,
    state: &'static str,
    reason: Option<String>,
    images: usize,
    outliers: usize,
    shift_mm: f64,
    shift_xyz_mm: [f64; 3],
    turn_deg: f64,
    sigma_mm: Option<f64>,
    sigma_deg: Option<f64>,
    rms_px: Option<f64>,
    left_out_rms_px: Option<f64>,
}

fn source(source: FrameSource) -> &'static str {
    match source {
        FrameSource::Fingers => "fingers",
        FrameSource::Description => "description",
        FrameSource::Nothing => "nothing",
    }
}

impl MarkerReport {
    fn new(marker: &CalibratedMarker) -> Self {
        let (state, reason) = match &marker.state {
            MarkerState::Calibrated => ("calibrated", None),
            MarkerState::Nominal(reason) => ("as described", Some((*reason).to_owned())),
            MarkerState::Loose { moved: None } => ("loose", None),
            MarkerState::Loose {
                moved: Some(([a, b], ..)),
            } => ("loose", Some(format!("it moved between {a} and {b}"))),
        };
        let sigma = marker.sigma();
        Self {
            id: marker.id,
            part: marker.body.name(),
            state,
            reason,
            images: marker.images,
            outliers: marker.outliers,
            shift_mm: 1e3 * marker.shift_m.length(),
            shift_xyz_mm: (1e3 * marker.shift_m).to_array(),
            turn_deg: marker.rotation_rad.to_degrees(),
            sigma_mm: sigma.map(|s| 1e3 * s.0),
            sigma_deg: sigma.map(|s| s.1.to_degrees()),
            rms_px: marker.rms_px,
            left_out_rms_px: marker.left_out_rms_px,
        }
    }

    fn row(&self) -> String {
        let number = |value: Option<f64>| value.map_or("–".to_owned(), |v| format!("{v:.3}"));
        format!(
            "{:>5}  {:<12} {:>8} {:>9.2} {:>7.2} {:>9} {:>8} {:>7} {:>9}  {}",
            self.id,
            self.part,
            self.images,
            self.shift_mm,
            self.turn_deg,
            number(self.sigma_mm),
            number(self.sigma_deg),
            number(self.rms_px),
            number(self.left_out_rms_px),
            self.state
        )
    }
}

impl<'a> Report<'a> {
    fn new(found: &'a GripperCalibration, seen: &Seen, file: &'a Path) -> Self {
        let without = found.left_out.iter().map(|(image, reason)| Skipped {
            image: image.clone(),
            reason: reason.clone(),
        });
        Self {
            file,
            name: &found.board.board.name,
            hash: found.board.board.hash(),
            images: found.images,
            skipped: seen.unreadable.iter().cloned().chain(without).collect(),
            rms_px: found.rms_px,
            described_rms_px: found.described_rms_px,
            holdout_rms_px: found.holdout_rms_px,
            corner_sigma_px: found.corner_sigma_px,
            openings_m: found.openings_m,
            x_from: source(found.x_from),
            x_off_deg: found.line_off_rad.map(|l| l.0.to_degrees()),
            x_sigma_deg: found.line_off_rad.map(|l| l.1.to_degrees()),
            opening_zero_from: source(found.zero_from),
            frame_sigma_mm: found.frame_sigma_m.map(|s| 1e3 * s),
            frame_sigma_deg: found.frame_sigma_rad.map(f64::to_degrees),
            markers: found.markers.iter().map(MarkerReport::new).collect(),
            notes: &found.notes,
        }
    }

    fn text(&self) -> String {
        let pixels = |value: Option<f64>| value.map_or("–".to_owned(), |v| format!("{v:.3} px"));
        let mut lines = vec![
            format!("board       {} ({})", self.name, self.hash),
            format!("images    {}, {} not used", self.images, self.skipped.len()),
            format!(
                "error       {:.3} px; held-out images {}; tags as described {}",
                self.rms_px,
                pixels(self.holdout_rms_px),
                pixels(self.described_rms_px)
            ),
        ];
        if let Some([least, most]) = self.openings_m {
            lines.push(format!(
                "openings    {:.1} to {:.1} mm, zero from {}",
                1e3 * least,
                1e3 * most,
                match self.opening_zero_from {
                    "fingers" => "closed images",
                    other => other,
                }
            ));
        }
        lines.push(format!("x axis      from {}", self.x_from));
        if let (Some(mm), Some(deg)) = (self.frame_sigma_mm, self.frame_sigma_deg) {
            lines.push(format!(
                "frame       known to about {mm:.1} mm and {deg:.1}° by how the tags scatter"
            ));
        }
        lines.push(
            "   id  part         images  off, mm  off, °  sigma, mm sigma, °  rms px  left out"
                .into(),
        );
        lines.extend(self.markers.iter().map(MarkerReport::row));
        lines.push(format!("file        {}", self.file.display()));
        lines.join("\n")
    }
}
