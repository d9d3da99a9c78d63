//! `gripcast tactile track`: the motion of a gel in any recording of its images.
//!
//! ```text
//! gripcast tactile track finger.avi --initial 6 --out finger.csv --overlay finger.png
//! gripcast tactile track frames/ --initial last --m-per-px 3e-5 --out finger.parquet
//! gripcast tactile track demo/grasps/ID --role left --out left.npy --json
//! ```
//!
//! A recording is a video, which the system's ffmpeg decodes, a folder of PNG or JPEG images, which
//! are sorted by name with numbers by their value, or the folder of a grasp in a dataset. The
//! initial frame shows the untouched gel; frames before it are tracked from it backwards, without a
//! slip ratio. Columns of the output: `docs/how-to/tracking.md`.
//!
//! Exit codes: 0 tracked · 1 nothing tracked · 2 usage · 3 done, but some frames were left out · 130
//! interrupted.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::PathBuf;
use std::str::FromStr;

use image::RgbImage;
use serde::Serialize;

use super::dataset_text::counted;
use super::flags::{above_zero, check_output, named};
use super::tactile_overlay::Overlay;
use super::tactile_recording::{NamedFrame, Recording, initial_image};
use super::tactile_table::{SUFFIXES, Scale, TrackedFrame, write};
use super::working::{Progress, interruptible};
use super::{Context, print_report};
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_imaging::{CropProfile, Role};
use gripcast_shear::{ExpectedMarkers, ShearFrame, ShearSource, ShearTracker, USUAL_M_PER_PX};
use gripcast_tactile::SensorProfile;

/// Maximum size of the frames before the initial one, bytes.
const MAX_BEFORE_BYTES: usize = 2 << 30;
/// Contact of a released gel, at most, as a fraction of the largest contact: light and pigment are
/// seldom quite as in the initial image.
const MAX_RELEASED: f64 = 0.25;
/// Left-out frames that are listed.
const LISTED: usize = 20;

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct Args {
    /// Video, folder of images, or folder of a grasp in a dataset
    #[arg(value_name = "VIDEO|DIR")]
    recording: PathBuf,
    /// Frame with the untouched gel: its number from 0, `last`, or an image file
    #[arg(long, value_name = "N|last|FILE", default_value = "0")]
    initial: Initial,
    /// File to write: .csv, .parquet or .npy
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Sensor of a grasp in a dataset
    #[arg(long, value_name = "ROLE", default_value = "left", value_parser = named([
        ("left", "Left finger", Role::Left),
        ("right", "Right finger", Role::Right),
    ]))]
    role: Role,
    /// Sensor profile, a shipped name or a file: gives the scale and what markers are expected
    #[arg(long, value_name = "NAME|FILE.toml", conflicts_with = "m_per_px")]
    profile: Option<String>,
    /// Scale of the (cropped) image, m/px; without it, lengths are in px only
    #[arg(long, value_name = "SCALE", value_parser = above_zero)]
    m_per_px: Option<f64>,
    /// Crop profile of the frames of a video or folder [default: not cropped]
    #[arg(long, value_name = "PROFILE")]
    crop: Option<String>,
    /// Drawn frames: a strip (.png), a video (.mp4, needs ffmpeg) or a folder; displacements are
    /// four times as long as they are
    #[arg(long, value_name = "PATH")]
    overlay: Option<PathBuf>,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

/// Which frame is the initial one.
#[derive(Clone, Debug)]
enum Initial {
    Number(usize),
    Last,
    File(PathBuf),
}

impl FromStr for Initial {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text == "last" {
            return Ok(Self::Last);
        }
        if text.starts_with('-') {
            return Err("expected a number from 0, `last` or an image file".to_owned());
        }
        Ok(text
            .parse()
            .map_or_else(|_| Self::File(text.into()), Self::Number))
    }
}

/// A frame that was left out.
#[derive(Debug, Serialize)]
struct LeftOut {
    frame: usize,
    name: String,
    why: String,
}

/// Frames with a problem.
#[derive(Debug, Serialize)]
struct ProblemFrames {
    text: String,
    /// First and last frame of each range.
    frames: Vec<[usize; 2]>,
}

/// What was tracked.
#[derive(Debug, Serialize)]
struct Report {
    recording: PathBuf,
    out: PathBuf,
    source: ShearSource,
    frames: usize,
    left_out: usize,
    left_out_frames: Vec<LeftOut>,
    /// What the decoder of the video says of damage.
    damage: Option<String>,
    columns: Option<usize>,
    rows: Option<usize>,
    markers: Option<usize>,
    pitch_px: Option<f32>,
    /// Mean over the frames.
    tracked_fraction: f64,
    max_displacement_px: f64,
    max_displacement_mm: Option<f64>,
    /// Median displacement in the last frame with at most a quarter of the largest contact, px.
    return_drift_px: Option<f32>,
    /// Number of that frame.
    return_frame: Option<usize>,
    max_slip_ratio: Option<f64>,
    problems: Vec<ProblemFrames>,
}

/// Runs the command.
pub(crate) fn run(context: &Context, args: Args) -> Result<()> {
    check_output("--out", &args.out, &SUFFIXES)?;
    let json = args.json;
    let report = interruptible(context, "tracking", move |progress| track(&args, progress))??;
    print_report(json, &report, text)?;
    let left_out = report.left_out;
    if left_out == 0 && report.damage.is_none() {
        return Ok(());
    }
    let what = match (&report.damage, left_out) {
        (Some(damage), 0) => damage.clone(),
        _ => format!("{} left out", counted(left_out, "frame")),
    };
    Err(Error::new(ErrorKind::Partial, what))
}

fn track(args: &Args, progress: &Progress) -> Result<Report> {
    let crop = args.crop.as_deref().map(CropProfile::by_name).transpose()?;
    let profile = args.profile.as_deref().map(SensorProfile::named_or_load);
    let profile = profile.transpose()?;
    let m_per_px = args
        .m_per_px
        .or(profile.as_ref().map(|profile| profile.geometry.pixel_m));
    let expected = profile.as_ref().map(SensorProfile::expected_markers);
    let expected = expected.unwrap_or(ExpectedMarkers::Unknown);
    let scale = Scale {
        m_per_px: m_per_px.unwrap_or(USUAL_M_PER_PX),
        is_known: m_per_px.is_some(),
    };
    let mut recording = Recording::open(&args.recording, args.role, crop)?;
    let start = |image: &RgbImage| {
        ShearTracker::new(image, scale.m_per_px, expected)
            .map_err(|e| e.at(args.recording.display()))
    };
    let mut run = Run {
        frames: Vec::new(),
        left_out: Vec::new(),
        overlay: Overlay::new(args.overlay.as_deref())?,
        next: 0,
        first: 0,
    };
    let mut tracker = match &args.initial {
        Initial::File(path) => start(&initial_image(path, crop.as_ref())?)?,
        Initial::Number(_) | Initial::Last => {
            let (before, initial) = match frames_before(args, &mut recording) {
                Ok(frames) => frames,
                Err(error) => {
                    // What the decoder of a video says is the cause.
                    recording.close()?;
                    return Err(error);
                }
            };
            let tracker = start(&initial)?;
            run.backwards(tracker.clone(), before)?;
            let mut tracker = tracker;
            run.first = run.next;
            run.add(&mut tracker, (run.next.to_string(), Ok(initial)))?;
            tracker
        }
    };
    let total = recording.left().map(|left| run.next + left);
    for frame in &mut recording {
        run.add(&mut tracker, frame)?;
        if let Some(total) = total {
            progress.count(run.next, total);
        }
    }
    let damage = recording.close().err();
    if run.frames.is_empty() {
        let why = run.left_out.first().map(|frame| format!(": {}", frame.why));
        let what = format!("no frame could be tracked{}", why.unwrap_or_default());
        return Err(damage.unwrap_or_else(|| Error::input(what).at(args.recording.display())));
    }
    run.overlay.finish()?;
    write(&args.out, &run.frames, scale)?;
    let after: Vec<&TrackedFrame> = run
        .frames
        .iter()
        .filter(|frame| frame.number >= run.first)
        .collect();
    let returned = returned(&after);
    let mut report = Report::new(args, &tracker, &run.frames, run.left_out, scale);
    report.return_drift_px = returned.map(|(_, drift)| drift);
    report.return_frame = returned.map(|(number, _)| number);
    report.damage = damage.map(|e| e.to_string());
    Ok(report)
}

/// Reads up to the initial frame: the frames before it, and the image.
fn frames_before(args: &Args, recording: &mut Recording) -> Result<(Vec<NamedFrame>, RgbImage)> {
    let mut frames: Vec<NamedFrame> = Vec::new();
    let mut bytes = 0;
    let number = match args.initial {
        Initial::Number(number) => number,
        Initial::Last | Initial::File(_) => usize::MAX,
    };
    for frame in recording {
        bytes += frame.1.as_ref().map_or(0, |image| image.as_raw().len());
        frames.push(frame);
        if frames.len() > number {
            break;
        }
        if bytes > MAX_BEFORE_BYTES {
            let what = "the frames before the initial one are larger than 2 GiB";
            return Err(Error::input(what)
                .at(args.recording.display())
                .remedy("give an image of the untouched gel (`--initial FILE`) or split it"));
        }
    }
    let found = frames.len();
    match (args.initial.clone(), frames.pop()) {
        (_, None) => Err(Error::input("the recording has no frames")
            .at(args.recording.display())
            .remedy("check that it is a video or a folder of .png or .jpg images")),
        (Initial::Number(number), Some(_)) if found <= number => Err(Error::usage(format!(
            "frame {number} does not exist: there are {found} frames"
        ))
        .at(args.recording.display())
        .remedy(format!("`--initial` takes 0 to {}, or `last`", found - 1))),
        (_, Some((name, image))) => {
            let image = image.map_err(|e| e.at(format!("initial frame {name}")))?;
            Ok((frames, image))
        }
    }
}

/// What a run collects.
struct Run {
    frames: Vec<TrackedFrame>,
    left_out: Vec<LeftOut>,
    overlay: Overlay,
    /// Number of the next frame.
    next: usize,
    /// Number of the initial frame; 0 for one that is not in the recording.
    first: usize,
}

impl Run {
    fn add(&mut self, tracker: &mut ShearTracker, frame: NamedFrame) -> Result<()> {
        let tracked = match &frame.1 {
            Ok(image) => Some(tracker.update(image)),
            Err(_) => None,
        };
        self.keep(frame, tracked)
    }

    /// Tracks frames from the last to the first, and keeps them in their order.
    fn backwards(&mut self, tracker: ShearTracker, frames: Vec<NamedFrame>) -> Result<()> {
        let tracked = tracker.backwards(frames.iter().map(|(_, image)| image.as_ref().ok()));
        for (frame, tracked) in frames.into_iter().zip(tracked) {
            self.keep(frame, tracked)?;
        }
        Ok(())
    }

    fn keep(&mut self, (name, image): NamedFrame, tracked: Option<ShearFrame>) -> Result<()> {
        let number = self.next;
        self.next += 1;
        let why = match (&image, tracked) {
            (Ok(image), Some(shear)) => match shear.problems.iter().find(|p| p.excludes_image()) {
                Some(problem) => problem.text(),
                None => {
                    self.overlay.add(number, image, &shear)?;
                    self.frames.push(TrackedFrame { number, shear });
                    return Ok(());
                }
            },
            (Err(error), _) => error.to_string(),
            (Ok(_), None) => "not tracked".to_owned(),
        };
        self.left_out.push(LeftOut {
            frame: number,
            name,
            why,
        });
        Ok(())
    }
}

impl Report {
    fn new(
        args: &Args,
        tracker: &ShearTracker,
        frames: &[TrackedFrame],
        mut left_out_frames: Vec<LeftOut>,
        scale: Scale,
    ) -> Self {
        let field = frames.iter().find_map(|frame| frame.shear.field.as_ref());
        let summaries = || {
            frames
                .iter()
                .filter_map(|frame| frame.shear.summary.as_ref())
        };
        let tracked = summaries().fold(0.0, |sum, s| sum + s.tracked_fraction);
        let max_mm = summaries()
            .map(|s| s.max_displacement_mm)
            .fold(0.0, f64::max);
        let slips = summaries().filter_map(|s| s.slip_ratio);
        let left_out = left_out_frames.len();
        left_out_frames.truncate(LISTED);
        Self {
            recording: args.recording.clone(),
            out: args.out.clone(),
            source: tracker.source(),
            frames: frames.len(),
            left_out,
            left_out_frames,
            damage: None,
            columns: field.map(|field| field.columns),
            rows: field.map(|field| field.rows),
            markers: field.map(|field| field.markers.iter().flatten().count()),
            pitch_px: tracker.pitch_px(),
            tracked_fraction: tracked / frames.len().max(1) as f64,
            max_displacement_px: max_mm / (1e3 * scale.m_per_px),
            max_displacement_mm: scale.is_known.then_some(max_mm),
            return_drift_px: None,
            return_frame: None,
            max_slip_ratio: slips.reduce(f64::max),
            problems: problem_frames(frames),
        }
    }
}

/// The last frame with at most a quarter of the largest contact before it, and the median
/// displacement in it, px.
fn returned(frames: &[&TrackedFrame]) -> Option<(usize, f32)> {
    let contact = |frame: &&TrackedFrame| Some(frame.shear.summary?.contact_fraction);
    let largest = frames.iter().filter_map(contact).fold(0.0, f64::max);
    let closed = frames
        .iter()
        .position(|frame| contact(frame) == Some(largest))
        .filter(|_| largest > 0.0)?;
    let is_released = |frame: &&&TrackedFrame| {
        contact(frame).is_some_and(|contact| contact <= MAX_RELEASED * largest)
    };
    let last = frames[closed..].iter().rev().find(is_released)?;
    let markers = last.shear.field.as_ref()?.markers.iter().flatten();
    let lengths = markers
        .filter(|marker| marker.confidence > 0.0)
        .map(|marker| {
            let [dx, dy] = marker.displacement_px();
            dx.hypot(dy)
        });
    let mut lengths: Vec<f32> = lengths.collect();
    lengths.sort_by(f32::total_cmp);
    Some((last.number, *lengths.get(lengths.len() / 2)?))
}

/// The ranges of frames of each kind of problem, with the text of its first frame.
fn problem_frames(frames: &[TrackedFrame]) -> Vec<ProblemFrames> {
    let mut problems: BTreeMap<String, ProblemFrames> = BTreeMap::new();
    for frame in frames {
        for problem in &frame.shear.problems {
            // Numbers differ from frame to frame.
            let kind = problem.remedy().to_owned();
            let entry = problems.entry(kind).or_insert_with(|| ProblemFrames {
                text: problem.text(),
                frames: Vec::new(),
            });
            match entry.frames.last_mut() {
                Some(range) if range[1] + 1 == frame.number => range[1] = frame.number,
                _ => entry.frames.push([frame.number; 2]),
            }
        }
    }
    problems.into_values().collect()
}

fn text(report: &Report) -> String {
    let mut text = String::new();
    let what = match (
        report.source,
        report.markers,
        report.columns.zip(report.rows),
    ) {
        (ShearSource::Markers, Some(markers), Some((columns, rows))) => {
            format!("{markers} gel markers on {columns}×{rows}")
        }
        _ => "texture of the contact".to_owned(),
    };
    let _ = writeln!(
        text,
        "{}: {}, {what}",
        report.out.display(),
        counted(report.frames, "frame")
    );
    let _ = writeln!(
        text,
        "tracked       {:.1} %",
        100.0 * report.tracked_fraction
    );
    let mm = report
        .max_displacement_mm
        .map(|mm| format!(" = {mm:.2} mm"));
    let _ = writeln!(
        text,
        "displacement  at most {:.1} px{}",
        report.max_displacement_px,
        mm.unwrap_or_default()
    );
    if let Some((drift, frame)) = report.return_drift_px.zip(report.return_frame) {
        let _ = writeln!(text, "after release {drift:.2} px (median, frame {frame})");
    }
    for problem in &report.problems {
        let ranges = problem
            .frames
            .iter()
            .take(LISTED)
            .map(|[first, last]| match first == last {
                true => first.to_string(),
                false => format!("{first}–{last}"),
            });
        let ranges: Vec<String> = ranges.collect();
        let more = problem.frames.len().saturating_sub(LISTED);
        let more = if more > 0 {
            format!(" and {more} more ranges")
        } else {
            String::new()
        };
        let _ = writeln!(text, "frames {}{more}: {}", ranges.join(", "), problem.text);
    }
    for frame in &report.left_out_frames {
        let _ = writeln!(
            text,
            "left out      frame {} ({}): {}",
            frame.frame, frame.name, frame.why
        );
    }
    let more = report.left_out - report.left_out_frames.len();
    if more > 0 {
        let _ = writeln!(text, "left out      {more} more");
    }
    if let Some(damage) = &report.damage {
        let _ = writeln!(text, "damage        {damage}");
    }
    text
}
