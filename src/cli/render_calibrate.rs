//! `gripcast render calibrate`: fit a sensor's profile to presses of a ball.
//!
//! ```text
//! gripcast render calibrate --presses ball --ball-mm 4.7 --out calib/sensors/2BKC.toml
//! gripcast render calibrate --presses ball --train-fraction 1 --serial 2BKC --out 2BKC.toml --json
//! ```
//!
//! `--presses` is a folder with one image of the untouched gel (`no_contact.png`) and a few of a
//! ball pressed in at different places. Where it has a `presses.json`, contacts are read from it,
//! else they are found in the images; docs/rendering.md has the format. Half of the presses are
//! fitted and the other half scored, unless `--train-fraction` says otherwise.
//!
//! Beside `--out FILE.toml` are written `FILE.background.png`, the untouched gel, and
//! `FILE.fit.png`: real, rendered and residual of scored presses.
//!
//! Exit codes: 0 fitted · 1 nothing could be fitted · 2 usage · 3 fitted, but presses could not be
//! used · 130 interrupted.

use std::path::{Path, PathBuf};

use serde::Serialize;

use super::working::interruptible;
use super::{Context, print, print_json};
use crate::note;
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
    /// Profile to write
    #[arg(long, value_name = "FILE.toml")]
    out: PathBuf,
    /// Fraction of the presses that is fitted; the others are scored
    #[arg(long, value_name = "FRACTION", default_value_t = 0.5)]
    train_fraction: f64,
    /// Most presses that are fitted
    #[arg(long, value_name = "N")]
    max_fitted: Option<usize>,
    /// Seed of the split
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Diameter of the ball [default: that of presses.json]
    #[arg(long, value_name = "MM")]
    ball_mm: Option<f64>,
    /// Size of a pixel of the stored images [default: that of presses.json]
    #[arg(long, value_name = "MM")]
    pixel_mm: Option<f64>,
    /// Try sizes of a pixel up to 15 % around that one
    #[arg(long)]
    fit_scale: bool,
    /// Find contacts in the images although presses.json has them
    #[arg(long)]
    find_contacts: bool,
    /// Crop of the stored images before they are fitted
    #[arg(long, value_name = "PROFILE", default_value = "full-v1", value_parser = crop)]
    crop: CropProfile,
    /// Columns and rows after the crop [default: as stored]
    #[arg(long, value_name = "WxH", value_parser = size)]
    size: Option<(u32, u32)>,
    /// Crop that the rig makes such images with
    #[arg(long, value_name = "PROFILE", default_value = "gsmini-seventh-v1", value_parser = crop)]
    crop_profile: CropProfile,
    /// Shading that is fitted
    #[arg(long, value_enum, default_value_t = Model::Polynomial)]
    model: Model,
    /// Order in the normal [default: chosen by cross-validation]
    #[arg(long, value_enum)]
    normal: Option<Normal>,
    /// Order in the place [default: chosen by cross-validation]
    #[arg(long, value_enum)]
    position: Option<Position>,
    /// Name of the profile [default: that of the file]
    #[arg(long)]
    name: Option<String>,
    /// Serial number of the sensor
    #[arg(long, default_value = "")]
    serial: String,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum Model {
    /// Polynomial of normal and place
    Polynomial,
    /// Three near point lights
    Leds,
}

#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum Normal {
    Linear,
    Quadratic,
    Cubic,
}

#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum Position {
    Constant,
    Linear,
    Quadratic,
}

fn crop(text: &str) -> Result<CropProfile, String> {
    CropProfile::by_name(text).map_err(|e| e.to_string())
}

fn size(text: &str) -> Result<(u32, u32), String> {
    let sides = text.split_once('x').and_then(|(width, height)| {
        let side = |s: &str| s.parse().ok().filter(|n| (16..=4096).contains(n));
        Some((side(width)?, side(height)?))
    });
    sides.ok_or_else(|| "must be two numbers from 16 to 4096, as 320x240".to_owned())
}

impl Args {
    fn options(&self) -> CalibrateOptions {
        let mut options = CalibrateOptions::from_folder(&self.presses);
        let metres = |mm: f64| 1e-3 * mm;
        options.read.ball_diameter_m = self.ball_mm.map(metres);
        options.read.pixel_m = self.pixel_mm.map(metres);
        options.read.crop = self.crop;
        options.read.size = self.size;
        options.read.find_contacts = self.find_contacts;
        options.train_fraction = self.train_fraction;
        options.max_fitted = self.max_fitted;
        options.seed = self.seed;
        options.fit_scale = self.fit_scale;
        options.crop_profile = self.crop_profile;
        options.model = match self.model {
            Model::Leds => ModelChoice::Leds,
            Model::Polynomial => ModelChoice::Polynomial(Terms {
                normal: self.normal.map(|order| match order {
                    Normal::Linear => NormalOrder::Linear,
                    Normal::Quadratic => NormalOrder::Quadratic,
                    Normal::Cubic => NormalOrder::Cubic,
                }),
                position: self.position.map(|order| match order {
                    Position::Constant => PositionOrder::Constant,
                    Position::Linear => PositionOrder::Linear,
                    Position::Quadratic => PositionOrder::Quadratic,
                }),
            }),
        };
        let stem = self.out.file_stem().unwrap_or_default();
        let name = self.name.clone();
        options.name = name.unwrap_or_else(|| stem.to_string_lossy().into_owned());
        options.serial.clone_from(&self.serial);
        options
    }

    fn check(&self) -> Result<()> {
        let suffix = self.out.extension().unwrap_or_default();
        if !suffix.eq_ignore_ascii_case("toml") {
            let what = "`--out` must name a file that ends in .toml";
            return Err(Error::usage(what).at(self.out.display()));
        }
        let folder = self.out.parent().filter(|f| !f.as_os_str().is_empty());
        if let Some(folder) = folder.filter(|folder| !folder.is_dir()) {
            return Err(Error::not_found("the folder for `--out` does not exist")
                .at(folder.display())
                .remedy("create it first"));
        }
        Ok(())
    }
}

#[derive(Serialize)]
struct Report<'a> {
    #[serde(flatten)]
    calibration: &'a CalibrationReport,
    profile: &'a Path,
    image: &'a Path,
}

/// Runs the verb.
pub(crate) fn run(context: &Context, args: Args) -> Result<()> {
    args.check()?;
    let options = args.options();
    let calibration = interruptible(context, "fitting", move |_| calibrate::run(&options))??;
    calibration.profile.save(&args.out)?;
    let image = args.out.with_extension("fit.png");
    save(&image, &encode_png_rgb(&calibration.image)?)?;
    if !context.quiet {
        for press in &calibration.report.skipped {
            note!("gripcast: {} is not used: {}", press.file, press.reason);
        }
    }
    if args.json {
        print_json(&Report {
            calibration: &calibration.report,
            profile: &args.out,
            image: &image,
        })?;
    } else {
        print(&text(&calibration.report, &args.out))?;
    }
    match calibration.report.skipped.len() {
        0 => Ok(()),
        count => Err(Error::new(
            ErrorKind::Partial,
            format!("{count} presses could not be used"),
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
            "explained   {:.3} of the variance in the contact ({scored} presses)",
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
