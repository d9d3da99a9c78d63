//! `gripcast render calibrate`: fits a sensor profile to ball presses.
//!
//! ```text
//! gripcast render calibrate --presses ball --ball-mm 4.7 --out calib/sensors/2BKC.toml
//! gripcast render calibrate --presses ball --train-fraction 1 --serial 2BKC --out 2BKC.toml --json
//! ```
//!
//! `--presses` is a folder with one image without contact (`no_contact.png`) and images of a ball
//! pressed into the gel at several positions. Contacts are read from its `presses.json`, or else
//! detected in the images (format: docs/how-to/rendering.md). By default half of the presses is
//! fitted and the other half scored.
//!
//! `FILE.background.png`, the gel without contact, and `FILE.fit.png`, the real, rendered and
//! residual images of scored presses, are written beside `--out FILE.toml`.
//!
//! Exit codes: 0 fitted · 1 nothing fitted · 2 usage · 3 fitted, but some presses were unusable ·
//! 130 interrupted.

use std::path::{Path, PathBuf};

use serde::Serialize;

use super::flags::{BallFlags, check_output, fraction, millimetres, named, size};
use super::working::interruptible;
use super::{Context, print_report};
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_base::files::save;
use gripcast_imaging::{CropProfile, encode_png_rgb};
use gripcast_tactile::calibrate::{self, CalibrateOptions, CalibrationReport, ModelChoice, Terms};
use gripcast_tactile::{NormalOrder, PositionOrder};

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct Args {
    /// Folder of the presses
    #[arg(long, value_name = "DIR")]
    presses: PathBuf,
    #[command(flatten)]
    ball: BallFlags,
    /// Sensor profile to write
    #[arg(long, value_name = "FILE.toml")]
    out: PathBuf,
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
    fn options(&self) -> CalibrateOptions {
        let mut options = CalibrateOptions::from_folder(&self.presses);
        options.read = self.ball.read_options(&self.presses);
        options.read.pixel_m = self.pixel_mm.map(|mm| 1e-3 * mm);
        options.read.crop = self.crop;
        options.read.size = self.size.map(Into::into);
        options.train_fraction = self.train_fraction;
        options.max_fitted = self.max_fitted;
        options.seed = self.seed;
        options.fit_scale = self.fit_scale;
        options.crop_profile = self.crop_profile;
        options.model = match self.model {
            Model::Leds => ModelChoice::Leds,
            Model::Polynomial => ModelChoice::Polynomial(Terms {
                normal: self.normal,
                position: self.position,
            }),
        };
        let stem = self.out.file_stem().unwrap_or_default();
        let name = self.name.clone();
        options.name = name.unwrap_or_else(|| stem.to_string_lossy().into_owned());
        options.serial.clone_from(&self.serial);
        options
    }
}

#[derive(Serialize)]
struct Report<'a> {
    #[serde(flatten)]
    calibration: &'a CalibrationReport,
    profile: &'a Path,
    image: &'a Path,
}

/// Runs the command.
pub(crate) fn run(context: &Context, args: Args) -> Result<()> {
    check_output("--out", &args.out, &["toml"])?;
    let options = args.options();
    let calibration = interruptible(context, "fitting", move |_| calibrate::run(&options))??;
    calibration.profile.save(&args.out)?;
    let image = args.out.with_extension("fit.png");
    save(&image, &encode_png_rgb(&calibration.image)?)?;
    let skipped = &calibration.report.skipped;
    context.warn(
        skipped
            .iter()
            .map(|press| format!("{} is not used: {}", press.file, press.reason)),
    );
    let report = Report {
        calibration: &calibration.report,
        profile: &args.out,
        image: &image,
    };
    print_report(args.json, &report, |report| {
        text(report.calibration, report.profile)
    })?;
    match skipped.len() {
        0 => Ok(()),
        count => Err(Error::new(
            ErrorKind::Partial,
            format!("{count} presses are unusable"),
        )),
    }
}

fn text(report: &CalibrationReport, out: &Path) -> String {
    let score = &report.score;
    let scored = report.scored_on.replace('_', " ");
    [
        format!(
            "{} fitted, {} held out, {} not used",
            report.fitted,
            report.held_out,
            report.skipped.len()
        ),
        format!(
            "FVE         {:.3} in the contact ({scored} presses)",
            score.fve
        ),
        format!(
            "error       {:.1} dB, {:.1} grey levels; without contact {:.1} dB, {:.1}",
            score.patch_psnr_db, score.patch_l1, score.no_contact_psnr_db, score.no_contact_l1
        ),
        format!("scale       {:.5} mm a pixel", 1e3 * report.pixel_m),
        format!("profile     {}", out.display()),
    ]
    .join("\n")
}
