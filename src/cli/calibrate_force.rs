//! `gripcast calibrate force`: calibrates the force of one tactile sensor with known weights.
//!
//! ```text
//! gripcast calibrate force --rig bench --role left --weights-g 200,500,1000 --out left.force.toml
//! gripcast calibrate force --initial open.png --press a.png,b.png,c.png --force-n 2,5,10 \
//!     --out left.force.toml
//! ```
//!
//! `--rig` opens the sensor's camera and asks for each weight: lay the finger on the table, gel up,
//! and rest the weight on it through something curved. `--initial` and `--press` use image files of
//! the whole camera image or of the cropped one. How to: docs/how-to/calibration.md.
//!
//! Exit codes: 0 done · 1 the presses contradict each other, or show no contact · 2 usage · 69 no
//! such camera · 130 interrupted, nothing written.

use std::io::{self, BufRead as _};
use std::path::{Path, PathBuf};
use std::time::Duration;

use image::RgbImage;
use serde::Serialize;

use super::flags::{above_zero, check_output};
use super::{Context, print_report};
use crate::note;
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_base::files::{FileKind, read_regular, save};
use gripcast_capture::calibration::RigFile;
use gripcast_capture::camera::{CaptureError, FrameSource, RigSources};
use gripcast_capture::device::SystemRoot;
use gripcast_imaging::{Decoder, Role};
use gripcast_shear::ShearTracker;
use gripcast_tactile::SensorProfile;
use gripcast_tactile::force::{
    CalibratedPress, ForceCalibration, ForceModel, ForceSensor, GRAVITY_M_S2, WeightPress,
};
use gripcast_virtual_rig::VirtualSource;

const FRAME_TIMEOUT: Duration = Duration::from_secs(1);
/// Timeouts tolerated before the camera is considered silent.
const MAX_TIMEOUTS: u32 = 5;
/// Frames that are read before the one that is used: earlier ones may be from before the key.
const SKIPPED_FRAMES: u32 = 8;
/// Sensor profile where neither a flag nor the rig names one.
const USUAL_PROFILE: &str = "gelsight-mini";

/// Arguments.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Image of the untouched gel
    #[arg(
        long,
        value_name = "FILE",
        required_unless_present = "rig",
        requires = "press"
    )]
    initial: Option<PathBuf>,
    /// Images of the presses, comma-separated
    #[arg(
        long,
        value_name = "FILE",
        value_delimiter = ',',
        requires = "initial",
        conflicts_with = "rig"
    )]
    press: Vec<PathBuf>,
    /// Rig with the sensor to calibrate live: its name or file
    #[arg(
        long,
        value_name = "NAME|FILE",
        conflicts_with = "initial",
        requires = "role"
    )]
    rig: Option<String>,
    /// Role of the sensor in the rig: left or right
    #[arg(long, value_name = "ROLE", value_parser = tactile_role)]
    role: Option<Role>,
    /// Weights of the presses, comma-separated
    #[arg(long, value_name = "G", value_delimiter = ',', value_parser = above_zero,
        required_unless_present = "force_n")]
    weights_g: Vec<f64>,
    /// Forces of the presses instead of weights, comma-separated
    #[arg(long, value_name = "N", value_delimiter = ',', value_parser = above_zero,
        conflicts_with = "weights_g")]
    force_n: Vec<f64>,
    /// Sensor profile: a shipped name or a file [default: that of the rig, else gelsight-mini]
    #[arg(long, value_name = "NAME|FILE")]
    sensor_profile: Option<String>,
    /// Serial of the sensor [default: that of the rig]
    #[arg(long, value_name = "SERIAL")]
    serial: Option<String>,
    /// Calibration file to write
    #[arg(long, value_name = "FILE.toml")]
    out: PathBuf,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

fn tactile_role(text: &str) -> Result<Role, String> {
    let role: Role = text.parse().map_err(|e: Error| e.to_string())?;
    match role.is_tactile() {
        true => Ok(role),
        false => Err("only left and right are tactile sensors".to_owned()),
    }
}

#[derive(Serialize)]
struct Report<'a> {
    file: &'a Path,
    young_pa: f64,
    poisson: f64,
    std_fraction: f64,
    presses: &'a [CalibratedPress],
}

/// A known force and its name in messages.
struct Load {
    name: String,
    force_n: f64,
}

/// Runs the command.
pub(super) fn run(context: &Context, args: &Args) -> Result<()> {
    check_output("--out", &args.out, &["toml"])?;
    let loads = args.loads();
    let live = args.rig.as_deref().map(RigFile::find).transpose()?;
    let camera = live
        .as_ref()
        .zip(args.role)
        .and_then(|(rig, role)| rig.cameras.get(&role));
    let in_rig = camera.and_then(|camera| camera.sensor_profile.as_deref());
    let name = args
        .sensor_profile
        .as_deref()
        .or(in_rig)
        .unwrap_or(USUAL_PROFILE);
    let profile = SensorProfile::named_or_load(name)?;
    let serial = args.serial.clone();
    let serial = serial.or_else(|| camera.and_then(|camera| camera.serial.clone()));
    let (initial, images) = match (&live, args.role) {
        (Some(rig), Some(role)) => live_images(context, rig, role, &profile, &loads)?,
        _ => args.file_images(&profile)?,
    };
    if images.len() != loads.len() {
        let what = format!(
            "found {} images of presses and {} forces",
            images.len(),
            loads.len()
        );
        return Err(Error::usage(what).remedy("give one weight or force for each press"));
    }
    let sensor = ForceSensor::new(&profile)?;
    let tracker = ShearTracker::new(
        &initial,
        profile.geometry.pixel_m,
        profile.expected_markers(),
    )?;
    let mut presses = Vec::with_capacity(loads.len());
    for (load, image) in loads.iter().zip(&images) {
        let shear = tracker.clone().update(image);
        let (features, _) = sensor
            .features(&initial, image, &shear)
            .map_err(|e| e.at(&load.name))?;
        presses.push(WeightPress {
            name: load.name.clone(),
            features,
            force_n: load.force_n,
        });
    }
    let calibration = ForceCalibration::fit(
        &ForceModel::shipped()?,
        sensor.thickness_m(),
        &profile.name,
        serial.as_deref().unwrap_or_default(),
        &presses,
    )?;
    save(&args.out, calibration.to_toml()?.as_bytes())?;
    let report = Report {
        file: &args.out,
        young_pa: calibration.young_pa,
        poisson: calibration.poisson,
        std_fraction: calibration.std_fraction,
        presses: &calibration.presses,
    };
    print_report(args.json, &report, Report::text)
}

impl Args {
    /// The known forces with names: the images, else the weights.
    fn loads(&self) -> Vec<Load> {
        let of_weight = |g: &f64| (format!("{g} g"), 1e-3 * g * GRAVITY_M_S2);
        let of_force = |n: &f64| (format!("{n} N"), *n);
        let weights = self.weights_g.iter().map(of_weight);
        let forces = self.force_n.iter().map(of_force);
        let names = self
            .press
            .iter()
            .map(|path| Some(path.display().to_string()));
        let names = names.chain(std::iter::repeat(None));
        weights
            .chain(forces)
            .zip(names)
            .map(|((load, force_n), image)| Load {
                name: image.unwrap_or(load),
                force_n,
            })
            .collect()
    }

    fn file_images(&self, profile: &SensorProfile) -> Result<(RgbImage, Vec<RgbImage>)> {
        let Some(initial) = &self.initial else {
            return Err(Error::usage(
                "give --initial and --press, or --rig and --role",
            ));
        };
        let mut decoder = Decoder::new()?;
        let mut read = |path: &PathBuf| {
            let at_file = |e: Error| e.at(path.display());
            let cannot = |e| at_file(Error::io("cannot read the image", e));
            let bytes = read_regular(path, FileKind::Image).map_err(cannot)?;
            let stored = decoder.stored_image(&bytes).map_err(at_file)?;
            let (width, height) = size(profile);
            if stored.dimensions() == (width, height) {
                return Ok(stored);
            }
            let crop = Some(&profile.crop_profile);
            decoder
                .decode_file(&bytes, crop, width, height)
                .map_err(at_file)
        };
        let images = self.press.iter().map(&mut read).collect::<Result<_>>()?;
        Ok((read(initial)?, images))
    }
}

/// Width and height of the cropped image, px.
fn size(profile: &SensorProfile) -> (u32, u32) {
    (
        profile.geometry.width as u32,
        profile.geometry.height as u32,
    )
}

/// Asks for each press and takes an image of it.
fn live_images(
    context: &Context,
    rig: &RigFile,
    role: Role,
    profile: &SensorProfile,
    loads: &[Load],
) -> Result<(RgbImage, Vec<RgbImage>)> {
    let sources = RigSources::new(rig, &SystemRoot::default(), &mut VirtualSource::new(1))?;
    let opener = sources
        .openers
        .into_iter()
        .find(|opener| opener.role() == role);
    let mut opener = opener.ok_or_else(|| {
        Error::usage(format!(
            "the rig {} has no camera with the role {role}",
            rig.id
        ))
    })?;
    let mut source = opener.open().map_err(|e| e.at(opener.describe()))?;
    let mut decoder = Decoder::new()?;
    let mut take = |request: &str| {
        if !context.quiet {
            note!("{request}, then press Enter");
        }
        wait_for_line()?;
        newest(source.as_mut(), &mut decoder, profile)
    };
    let initial = take(&format!("leave the {role} gel untouched"))?;
    let ask = |load: &Load| take(&format!("rest {} on the {role} gel", load.name));
    let images = loads.iter().map(ask).collect::<Result<_>>()?;
    Ok((initial, images))
}

fn wait_for_line() -> Result<()> {
    let mut line = String::new();
    let read = io::stdin().lock().read_line(&mut line);
    match read.map_err(|e| Error::io("cannot read the keyboard", e))? {
        0 => Err(Error::new(
            ErrorKind::Interrupted,
            "the input ended; nothing was written",
        )),
        _ => Ok(()),
    }
}

/// Returns an image from after now.
fn newest(
    source: &mut dyn FrameSource,
    decoder: &mut Decoder,
    profile: &SensorProfile,
) -> Result<RgbImage> {
    let (mut timeouts, mut skipped) = (0, 0);
    let (width, height) = size(profile);
    loop {
        match source.next_frame(FRAME_TIMEOUT) {
            Ok(_) if skipped < SKIPPED_FRAMES => skipped += 1,
            Ok(frame) => {
                let crop = Some(&profile.crop_profile);
                // Damaged frames are skipped.
                if let Ok(image) = decoder.decode(&frame, crop, width, height) {
                    return Ok(image);
                }
            }
            Err(CaptureError::Damaged { .. }) => {}
            Err(CaptureError::Ended) => {
                return Err(Error::input(
                    "the recording ended before all presses were taken",
                ));
            }
            Err(CaptureError::Timeout) if timeouts < MAX_TIMEOUTS => timeouts += 1,
            Err(CaptureError::Failed(error)) => return Err(error),
            Err(error) => {
                return Err(Error::new(ErrorKind::Device, error.to_string())
                    .remedy("check the cable; `gripcast rig check` measures the camera"));
            }
        }
    }
}

impl Report<'_> {
    fn text(&self) -> String {
        let mut lines = vec![format!(
            "{:>10} {:>10} {:>8}  press",
            "weight N", "image N", "off %"
        )];
        lines.extend(self.presses.iter().map(|press| {
            let off = 100.0 * (press.estimate_n / press.force_n - 1.0);
            format!(
                "{:>10.2} {:>10.2} {off:>+8.1}  {}",
                press.force_n, press.estimate_n, press.name
            )
        }));
        lines.push(format!(
            "gel: {:.3} MPa ± {:.0} %, Poisson's ratio {:.2}",
            1e-6 * self.young_pa,
            100.0 * self.std_fraction,
            self.poisson
        ));
        lines.push(format!(
            "wrote {}; name it in the rig file: force_calibration = \"…\" below the sensor's camera",
            self.file.display()
        ));
        lines.join("\n")
    }
}
