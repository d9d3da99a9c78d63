//! Runs a calibration.

use image::RgbImage;

use super::evaluate::evaluate;
use super::led_fit::fit_leds;
use super::no_contact::check_no_contact;
use super::press_read::ReadOptions;
use super::press_set::{LabelledPress, PressSet, ScaleSource};
use super::report::{CalibrationReport, FitReport, Role};
use super::score::{ObservedChange, observe};
use super::select::{ChosenModel, Terms, choose};
use super::split::{Split, SplitPresses};
use crate::gaussian::{Gaussian, Region};
use crate::{
    Background, BackgroundFit, Drift, FittedPress, PolynomialShading, ProfileGel, SensorProfile,
    ShadingModel,
};
use gripcast_base::error::Result;
use gripcast_base::statistics::median;
use gripcast_imaging::CropProfile;

/// Candidate factors on the pixel size.
const SCALES: [f64; 7] = [0.85, 0.9, 0.95, 1.0, 1.05, 1.1, 1.15];
/// Degree of the background fit.
const BACKGROUND_DEGREE: usize = 8;
/// Schema version of the profile.
const SCHEMA: u32 = 1;

/// Shading model to fit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ModelChoice {
    /// Polynomial of normal and position; unset orders are chosen by cross-validation.
    Polynomial(Terms),
    /// Three near point lights.
    Leds,
}

/// Options of a calibration.
#[derive(Clone, Debug)]
pub struct CalibrateOptions {
    /// The presses.
    pub read: ReadOptions,
    /// Presses to fit and to score.
    pub split: Split,
    /// Shading model.
    pub model: ModelChoice,
    /// Also fits the pixel size, within 15 % of the given one.
    pub fit_scale: bool,
    /// Name of the profile.
    pub name: String,
    /// Serial of the sensor; may be empty.
    pub serial: String,
    /// Crop of the sensor's frames that yields such images.
    pub crop_profile: CropProfile,
    /// Origin of the presses, appended to the profile's provenance.
    pub note: String,
}

impl CalibrateOptions {
    /// Fits polynomial shading to half of the presses of a folder.
    pub fn from_folder(folder: impl Into<std::path::PathBuf>) -> Self {
        Self {
            read: ReadOptions::from_folder(folder),
            split: Split::HALF,
            model: ModelChoice::Polynomial(Terms::default()),
            fit_scale: false,
            name: "sensor".to_owned(),
            serial: String::new(),
            crop_profile: CropProfile::GSMINI_SEVENTH,
            note: String::new(),
        }
    }
}

/// Result of a calibration.
#[derive(Clone, Debug)]
pub struct Calibration {
    /// Fitted profile.
    pub profile: SensorProfile,
    /// Scores and chosen model.
    pub report: CalibrationReport,
    /// Real, rendered and residual images of scored presses.
    pub image: RgbImage,
    /// The presses by their use.
    pub presses: SplitPresses,
}

/// Calibrates a sensor.
///
/// # Errors
/// Those of [`SplitPresses::read`]; `Input` if there are fewer than two presses to fit or the
/// no-contact image shows a contact.
pub fn run(options: &CalibrateOptions) -> Result<Calibration> {
    let folder = options.read.folder.display();
    let mut presses = SplitPresses::read(&options.read, &options.split)?;
    check_no_contact(&presses.set).map_err(|e| e.at(&folder))?;
    let train = &presses.train;
    let fitted = fit(&mut presses.set, train, options).map_err(|e| e.at(&folder))?;
    let profile = profile(&presses, &fitted, options);
    let roles = |indices: &[usize], role: Role| -> Vec<(usize, Role)> {
        indices.iter().map(|index| (*index, role)).collect()
    };
    let mut uses = roles(&presses.held_out, Role::HeldOut);
    uses.extend(roles(train, Role::Fitted));
    let (mut report, image) = evaluate(&presses.set, &uses, &profile)?;
    report.unused.clone_from(&presses.unused);
    report.fit = Some(fit_report(&presses.set, &fitted, &profile, options));
    Ok(Calibration {
        profile,
        report,
        image,
        presses,
    })
}

/// Fitted model and observations.
struct Fitted {
    model: ChosenModel,
    shading: ShadingModel,
    scale_scan: Vec<[f64; 2]>,
    observed: Vec<ObservedChange>,
}

fn fit(set: &mut PressSet, train: &[usize], options: &CalibrateOptions) -> Result<Fitted> {
    let terms = match options.model {
        ModelChoice::Polynomial(terms) => terms,
        ModelChoice::Leds => Terms::default(),
    };
    let (mut model, mut polynomial) = choose(set, train, terms)?;
    let mut scale_scan = Vec::new();
    if options.fit_scale {
        (model, polynomial, scale_scan) = scan_scales(set, train, terms, (model, polynomial))?;
    }
    let shading = match options.model {
        ModelChoice::Polynomial(_) => ShadingModel::Polynomial(polynomial),
        ModelChoice::Leds => ShadingModel::Leds(fit_leds(set, train, &model.smoothing)),
    };
    Ok(Fitted {
        model,
        shading,
        scale_scan,
        observed: train
            .iter()
            .map(|i| observe(set, &set.presses[*i]))
            .collect(),
    })
}

type Choice = (ChosenModel, PolynomialShading);

/// Cross-validates candidate pixel sizes; sets the best in `set`.
fn scan_scales(
    set: &mut PressSet,
    train: &[usize],
    terms: Terms,
    start: Choice,
) -> Result<(ChosenModel, PolynomialShading, Vec<[f64; 2]>)> {
    let given = set.geometry.pixel_m;
    let (mut best, mut best_pixel) = (start, given);
    let mut scan = Vec::new();
    for factor in SCALES {
        let pixel_m = factor * given;
        let mut trial = set.clone();
        trial.geometry.pixel_m = pixel_m;
        let found = if factor == 1.0 {
            best.clone()
        } else {
            choose(&trial, train, terms)?
        };
        scan.push([pixel_m, found.0.cv_fve]);
        if found.0.cv_fve > best.0.cv_fve {
            (best, best_pixel) = (found, pixel_m);
        }
    }
    set.geometry.pixel_m = best_pixel;
    set.scale = ScaleSource::Fitted;
    Ok((best.0, best.1, scan))
}

fn profile(presses: &SplitPresses, fitted: &Fitted, options: &CalibrateOptions) -> SensorProfile {
    let set = &presses.set;
    let pivot = pivot(set);
    let spread =
        |value: &dyn Fn(&ObservedChange) -> f64| standard_deviation(&fitted.observed, value);
    SensorProfile {
        schema: SCHEMA,
        name: options.name.clone(),
        serial: options.serial.clone(),
        crop_profile: options.crop_profile,
        provenance: provenance(presses, options),
        noise_std: noise(set, fitted),
        frame_rate_hz: None,
        geometry: set.geometry,
        gel: ProfileGel::default(),
        markers: None,
        smoothing: fitted.model.smoothing,
        drift: Drift {
            gain_std: std::array::from_fn(|c| spread(&|o| o.gain[c])),
            offset_std: std::array::from_fn(|c| spread(&|o| offset_at(o, c, pivot[c]))),
            pivot,
        },
        shading: fitted.shading.clone(),
        background: Background {
            file: None,
            fit: BackgroundFit::from_image(&set.no_contact, BACKGROUND_DEGREE),
            image: Some(set.no_contact.clone()),
        },
        fitted_to: presses
            .train
            .iter()
            .map(|i| record(&set.presses[*i]))
            .collect(),
    }
}

fn record(press: &LabelledPress) -> FittedPress {
    FittedPress {
        file: press.file.clone(),
        sha256: press.sha256.clone(),
    }
}

fn provenance(presses: &SplitPresses, options: &CalibrateOptions) -> String {
    let set = &presses.set;
    let drawn = match &options.split {
        Split::Random { seed, .. } => format!("seed {seed}"),
        Split::Named { .. } => "named".to_owned(),
    };
    let found = set.presses.iter().filter(|press| press.is_detected).count();
    let text = format!(
        "Fitted on {} presses of a ball of {} mm ({} held out, {drawn}, contacts of {found} found \
         in the images). {}",
        presses.train.len(),
        set.ball_m * 2e3,
        presses.held_out.len(),
        options.note
    );
    text.trim_end().to_owned()
}

/// Mean level of the background per channel.
fn pivot(set: &PressSet) -> [f64; 3] {
    std::array::from_fn(|c| {
        let plane = &set.untouched[c];
        plane.iter().map(|v| f64::from(*v)).sum::<f64>() / plane.len() as f64
    })
}

/// Offset caused by the drift at a grey level.
fn offset_at(observed: &ObservedChange, channel: usize, pivot: f64) -> f64 {
    observed.offset[channel] + (observed.gain[channel] - 1.0) * pivot
}

fn mean(observed: &[ObservedChange], value: &dyn Fn(&ObservedChange) -> f64) -> f64 {
    observed.iter().map(value).sum::<f64>() / observed.len().max(1) as f64
}

fn standard_deviation(observed: &[ObservedChange], value: &dyn Fn(&ObservedChange) -> f64) -> f64 {
    let middle = mean(observed, value);
    mean(observed, &|o| (value(o) - middle).powi(2)).sqrt()
}

/// Noise of one frame: robust deviation of the high-pass difference of two frames far from the
/// contact, divided by √2.
fn noise(set: &PressSet, fitted: &Fitted) -> [f64; 3] {
    let width = set.geometry.width;
    std::array::from_fn(|c| {
        let each: Vec<f64> = fitted
            .observed
            .iter()
            .map(|observed| {
                let plane = &observed.change[c];
                let mut slow = plane.clone();
                if let Some(region) = Region::nonzero(plane, width) {
                    Gaussian::new(3.0).apply(&mut slow, width, region);
                }
                let sizes = plane.iter().zip(&slow);
                let sizes = sizes.map(|(value, slow)| f64::from((value - slow).abs()));
                1.4826 * median(sizes).unwrap_or(0.0) / std::f64::consts::SQRT_2
            })
            .collect();
        each.iter().sum::<f64>() / each.len().max(1) as f64
    })
}

fn fit_report(
    set: &PressSet,
    fitted: &Fitted,
    profile: &SensorProfile,
    options: &CalibrateOptions,
) -> FitReport {
    let pivot = pivot(set);
    FitReport {
        seed: match options.split {
            Split::Random { seed, .. } => Some(seed),
            Split::Named { .. } => None,
        },
        chosen: fitted.model,
        scale_scan: fitted.scale_scan.clone(),
        gain_mean: std::array::from_fn(|c| mean(&fitted.observed, &|o| o.gain[c])),
        offset_mean: std::array::from_fn(|c| {
            mean(&fitted.observed, &|o| offset_at(o, c, pivot[c]))
        }),
        noise_std: profile.noise_std,
    }
}

#[cfg(test)]
#[path = "run_test.rs"]
mod tests;
