//! `gripcast render calibrate`: fits a sensor profile to ball presses.
//!
//! ```text
//! gripcast render calibrate --presses ball --ball-mm 4.7 --out calib/sensors/2BKC.toml
//! gripcast render calibrate --presses ball --train 1-14 --test 15-28 --out 2BKC.toml
//! gripcast render calibrate --presses ball --profile calib/sensors/2BKC.toml --json
//! ```
//!
//! `--presses` is a folder with one image without contact (`no_contact.png`) and images of a ball
//! pressed into the gel at several positions. Contacts are read from its `presses.json`, or else
//! detected in the images (format: docs/how-to/rendering.md). By default half of the presses is
//! fitted and the other half scored; `--train` and `--test` name them. `--profile` fits nothing: it
//! scores an existing profile.
//!
//! `FILE.background.png`, the gel without contact, and `FILE.fit.png`, the real, rendered and
//! residual images of scored presses, are written beside `--out FILE.toml`.
//!
//! Exit codes: 0 done · 1 nothing fitted or scored · 2 usage · 3 done, but some presses were
//! unusable · 130 interrupted.

use std::path::{Path, PathBuf};

use serde::Serialize;

use super::flags::{BallFlags, check_output, fraction, millimetres, named, size};
use super::working::interruptible;
use super::{Context, print_report};
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_base::files::save;
use gripcast_imaging::{CropProfile, encode_png_rgb};
use gripcast_tactile::calibrate::{
    self, CalibrateOptions, CalibrationReport, ModelChoice, ReadOptions, Role, ScaleSource, Split,
    Terms,
};
use gripcast_tactile::{NormalOrder, PositionOrder, SensorProfile};

/// Options of the random split.
const RANDOM_FLAGS: [&str; 3] = ["train_fraction", "max_fitted", "seed"];
/// Options of the fit.
const FIT_FLAGS: [&str; 13] = [
    "train",
    "train_fraction",
    "max_fitted",
    "seed",
    "name",
    "serial",
    "model",
    "normal",
    "position",
    "pixel_mm",
    "fit_scale",
    "size",
    "crop_profile",
];

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct Args {
    /// Folder of the presses
    #[arg(long, value_name = "DIR")]
    presses: PathBuf,
    #[command(flatten)]
    ball: BallFlags,
    /// Sensor profile to write; with --profile, the image of scored presses
    #[arg(
        long,
        value_name = "FILE.toml|FILE.png",
        required_unless_present = "profile"
    )]
    out: Option<PathBuf>,
    /// Score this sensor profile instead of fitting one
    #[arg(long, value_name = "NAME|FILE.toml", conflicts_with_all = FIT_FLAGS)]
    profile: Option<String>,
    /// Presses to fit: files, numbers from 1 or ranges as 1-14 [default: all but --test]
    #[arg(long, value_name = "PRESS", value_delimiter = ',', num_args = 1..,
        conflicts_with_all = RANDOM_FLAGS)]
    train: Vec<String>,
    /// Presses to score [default: all but --train]
    #[arg(long, value_name = "PRESS", value_delimiter = ',', num_args = 1..,
        conflicts_with_all = RANDOM_FLAGS)]
    test: Vec<String>,
    /// Name of the profile [default: the file name]
    #[arg(long)]
    name: Option<String>,
    /// Serial number of the sensor
    #[arg(long, default_value = "")]
    serial: String,
    /// Fraction of the presses to fit; the others are scored
    #[arg(long, value_name = "FRACTION", default_value_t = 0.5, value_parser = fraction)]
    train_fraction: f64,
    /// Maximum number of presses to fit
    #[arg(long, value_name = "N")]
    max_fitted: Option<usize>,
    /// Random seed of the split
    #[arg(long, value_name = "SEED", default_value_t = 0)]
    seed: u64,
    /// Shading model
    #[arg(long, value_enum, default_value_t = Model::Polynomial)]
    model: Model,
    /// Polynomial order in the normal [default: chosen by cross-validation]
    #[arg(long, value_name = "ORDER", value_parser = named([
        ("linear", "3 terms", NormalOrder::Linear),
        ("quadratic", "8 terms", NormalOrder::Quadratic),
        ("cubic", "12 terms", NormalOrder::Cubic),
    ]))]
    normal: Option<NormalOrder>,
    /// Polynomial order in the position [default: chosen by cross-validation]
    #[arg(long, value_name = "ORDER", value_parser = named([
        ("constant", "1 term", PositionOrder::Constant),
        ("linear", "3 terms", PositionOrder::Linear),
        ("quadratic", "6 terms", PositionOrder::Quadratic),
    ]))]
    position: Option<PositionOrder>,
    /// Pixel size of the stored images [default: from presses.json]
    #[arg(long, value_name = "MM", value_parser = millimetres)]
    pixel_mm: Option<f64>,
    /// Search the pixel size within ±15 %
    #[arg(long)]
    fit_scale: bool,
    /// Crop of the stored images before fitting
    #[arg(long, value_name = "PROFILE", default_value = "full-v1",
        value_parser = CropProfile::by_name)]
    crop: CropProfile,
    /// Image size after the crop, px [default: as stored]
    #[arg(long, value_name = "WxH", value_parser = |text: &str| size(text, 16..=4096))]
    size: Option<[u32; 2]>,
    /// Crop profile of the sensor on the rig
    #[arg(long, value_name = "PROFILE", default_value = "gsmini-seventh-v1",
        value_parser = CropProfile::by_name)]
    crop_profile: CropProfile,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum Model {
    /// Polynomial in normal and position
    Polynomial,
    /// Three near point lights
    Leds,
}

impl Args {
    fn read_options(&self) -> ReadOptions {
        ReadOptions {
            pixel_m: self.pixel_mm.map(|mm| 1e-3 * mm),
            crop: self.crop,
            size: self.size.map(Into::into),
            ..self.ball.read_options(&self.presses)
        }
    }

    fn split(&self) -> Split {
        if self.train.is_empty() && self.test.is_empty() {
            return Split::Random {
                train_fraction: self.train_fraction,
                max_fitted: self.max_fitted,
                seed: self.seed,
            };
        }
        Split::Named {
            train: self.train.clone(),
            test: self.test.clone(),
        }
    }

    fn options(&self, out: &Path) -> CalibrateOptions {
        let stem = out.file_stem().unwrap_or_default();
        let name = self.name.clone();
        CalibrateOptions {
            read: self.read_options(),
            split: self.split(),
            fit_scale: self.fit_scale,
            crop_profile: self.crop_profile,
            model: match self.model {
                Model::Leds => ModelChoice::Leds,
                Model::Polynomial => ModelChoice::Polynomial(Terms {
                    normal: self.normal,
                    position: self.position,
                }),
            },
            name: name.unwrap_or_else(|| stem.to_string_lossy().into_owned()),
            serial: self.serial.clone(),
            ..CalibrateOptions::from_folder(&self.presses)
        }
    }
}

#[derive(Serialize)]
struct Report<'a> {
    #[serde(flatten)]
    calibration: &'a CalibrationReport,
    /// Profile that was written or scored.
    profile: &'a Path,
    /// Image of scored presses.
    image: Option<&'a Path>,
}

/// Runs the command.
pub(crate) fn run(context: &Context, args: Args) -> Result<()> {
    match (args.profile.clone(), args.out.clone()) {
        (Some(profile), out) => score(context, args, &profile, out.as_deref()),
        (None, Some(out)) => fit(context, &args, &out),
        (None, None) => Err(Error::usage("`--out` or `--profile` is missing")),
    }
}

fn fit(context: &Context, args: &Args, out: &Path) -> Result<()> {
    check_output("--out", out, &["toml"])?;
    let options = args.options(out);
    let calibration = interruptible(context, "fitting", move |_| calibrate::run(&options))??;
    calibration.profile.save(out)?;
    let image = out.with_extension("fit.png");
    save(&image, &encode_png_rgb(&calibration.image)?)?;
    let report = Report {
        calibration: &calibration.report,
        profile: out,
        image: Some(&image),
    };
    finish(context, args.json, &report)
}

fn score(context: &Context, args: Args, profile: &str, out: Option<&Path>) -> Result<()> {
    if let Some(out) = out {
        check_output("--out", out, &["png"])?;
    }
    let json = args.json;
    let path = profile.to_owned();
    let (calibration, image) = interruptible(context, "scoring", move |_| {
        let profile = SensorProfile::named_or_load(&path)?;
        calibrate::score_profile(&profile, &args.read_options(), &args.test)
    })??;
    if let Some(out) = out {
        save(out, &encode_png_rgb(&image)?)?;
    }
    let report = Report {
        calibration: &calibration,
        profile: Path::new(profile),
        image: out,
    };
    finish(context, json, &report)
}

/// Prints warnings and the report.
fn finish(context: &Context, json: bool, report: &Report<'_>) -> Result<()> {
    let skipped = &report.calibration.skipped;
    context.warn(
        skipped
            .iter()
            .map(|press| format!("{} is not used: {}", press.file, press.reason)),
    );
    context.warn(&report.calibration.notes);
    print_report(json, report, |report| {
        text(report.calibration, report.profile)
    })?;
    match skipped.len() {
        0 => Ok(()),
        count => Err(Error::new(
            ErrorKind::Partial,
            format!("{count} of the presses are unusable"),
        )),
    }
}

fn text(report: &CalibrationReport, profile: &Path) -> String {
    let score = &report.score;
    let fitted = match report.train.as_ref().filter(|_| report.held_out > 0) {
        Some(train) => format!("; fitted {:.3}", train.fve),
        None => String::new(),
    };
    let scale = match report.scale {
        ScaleSource::Given => "as given",
        ScaleSource::Nominal => "assumed",
        ScaleSource::Fitted => "fitted",
        ScaleSource::Profile => "of the profile",
    };
    let mut lines = vec![format!(
        "{:<24} {:<8} {:>12} {:>7} {:>8} {:>7} {:>6} {:>5}",
        "press", "use", "centre px", "radius", "depth mm", "FVE", "dB", "L1"
    )];
    lines.extend(report.presses.iter().map(|row| {
        let [x, y] = row.center_px;
        format!(
            "{:<24} {:<8} {:>12} {:>7.1} {:>8.3} {:>7.3} {:>6.1} {:>5.1}",
            row.score.file,
            role(row.role),
            format!("{x:.1}, {y:.1}"),
            row.radius_px,
            1e3 * row.indentation_m,
            row.score.fve,
            row.score.patch_psnr_db,
            row.score.patch_l1,
        )
    }));
    lines.extend([
        String::new(),
        format!(
            "{} fitted, {} scored only, {} unusable, {} not used",
            report.fitted,
            report.held_out,
            report.skipped.len(),
            report.unused.len()
        ),
        format!(
            "FVE         {:.3} in the contact ({} presses{fitted})",
            score.fve,
            role(report.scored_on)
        ),
        format!(
            "error       {:.1} dB, {:.1} grey levels; without contact {:.1} dB, {:.1}",
            score.patch_psnr_db, score.patch_l1, score.no_contact_psnr_db, score.no_contact_l1
        ),
        format!(
            "scale       {:.5} mm a pixel, {scale}; ball {:.3} mm",
            1e3 * report.pixel_m,
            1e3 * report.ball_diameter_m
        ),
        format!("profile     {}", profile.display()),
    ]);
    lines.join("\n")
}

fn role(role: Role) -> &'static str {
    match role {
        Role::Fitted => "fitted",
        Role::HeldOut => "held out",
        Role::Unknown => "scored",
    }
}
