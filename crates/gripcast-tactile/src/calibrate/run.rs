//! Runs a calibration.

use image::RgbImage;

use super::led_fit::fit_leds;
use super::press_read::ReadOptions;
use super::press_set::{PressSet, ScaleSource};
use super::report::CalibrationReport;
use super::score::{ChangePlanes, ObservedChange, Score, observe, score};
use super::select::{ChosenModel, Terms, choose};
use super::sheet::{Row, sheet};
use crate::gaussian::{Gaussian, Region};
use crate::{
    Background, BackgroundFit, Drift, PolynomialShading, SensorProfile, ShadingModel,
    TactileRenderer,
};
use gripcast_base::error::{Error, Result};
use gripcast_base::statistics::median;
use gripcast_imaging::CropProfile;

/// Candidate factors on the pixel size.
const SCALES: [f64; 7] = [0.85, 0.9, 0.95, 1.0, 1.05, 1.1, 1.15];
/// Degree of the background fit.
const BACKGROUND_DEGREE: usize = 8;
/// Presses shown in the calibration image.
const MAX_ROWS: usize = 6;
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
    /// Fraction of the presses to fit, above 0, at most 1.
    pub train_fraction: f64,
    /// Maximum number of presses to fit; the rest of the fraction is not used.
    pub max_fitted: Option<usize>,
    /// Seed of the split.
    pub seed: u64,
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
            train_fraction: 0.5,
            max_fitted: None,
            seed: 0,
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
}

/// Calibrates a sensor.
///
/// # Errors
/// Those of [`PressSet::read`]; `Usage` if the fraction is out of range; `Input` if there are fewer
/// than two presses to fit.
pub fn run(options: &CalibrateOptions) -> Result<Calibration> {
    if !(options.train_fraction > 0.0 && options.train_fraction <= 1.0) {
        return Err(Error::usage(format!(
            "the fraction of presses to fit must be above 0 and at most 1, found {}",
            options.train_fraction
        )));
    }
    let folder = options.read.folder.display();
    let mut set = PressSet::read(&options.read)?;
    let (train, held_out) = set.split(options.train_fraction, options.max_fitted, options.seed);
    let fitted = fit(&mut set, &train, options).map_err(|e| e.at(&folder))?;
    let counts = [train.len(), held_out.len()];
    let profile = profile(&set, counts, &fitted, options);
    let scored = if held_out.is_empty() {
        &train
    } else {
        &held_out
    };
    let mut renderer = TactileRenderer::new(&profile)?;
    let mut render = |index: usize| rendered(&mut renderer, &set, index, &profile);
    let mut changes = scored
        .iter()
        .map(|i| render(*i))
        .collect::<Result<Vec<_>>>()?;
    let mut next = changes.iter();
    let scores = score(&set, scored, &mut |_| {
        Ok(next.next().cloned().unwrap_or_default())
    })?;
    changes.truncate(MAX_ROWS);
    let rows: Vec<Row<'_>> = changes
        .into_iter()
        .zip(scored.iter().zip(&scores.presses))
        .map(|(change, (index, score))| Row {
            index: *index,
            change,
            score,
        })
        .collect();
    let image = sheet(&set, &rows);
    let report = report(&set, counts, scores, &fitted, &profile, options);
    Ok(Calibration {
        profile,
        report,
        image,
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

/// Renders the change of a labelled contact.
fn rendered(
    renderer: &mut TactileRenderer,
    set: &PressSet,
    index: usize,
    profile: &SensorProfile,
) -> Result<ChangePlanes> {
    let contact = set.contact(&set.presses[index]);
    let press = contact.press(profile.smoothing.sink_length_m);
    renderer.change(&press).cloned()
}

fn profile(
    set: &PressSet,
    counts: [usize; 2],
    fitted: &Fitted,
    options: &CalibrateOptions,
) -> SensorProfile {
    let pivot = pivot(set);
    let spread =
        |value: &dyn Fn(&ObservedChange) -> f64| standard_deviation(&fitted.observed, value);
    SensorProfile {
        schema: SCHEMA,
        name: options.name.clone(),
        serial: options.serial.clone(),
        crop_profile: options.crop_profile,
        provenance: provenance(set, counts, options),
        noise_std: noise(set, fitted),
        geometry: set.geometry,
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
    }
}

fn provenance(
    set: &PressSet,
    [fitted, held_out]: [usize; 2],
    options: &CalibrateOptions,
) -> String {
    let found = set.presses.iter().filter(|press| press.is_detected).count();
    let text = format!(
        "Fitted on {fitted} presses of a ball of {} mm ({held_out} held out, seed {}, contacts of \
         {found} found in the images). {}",
        set.ball_m * 2e3,
        options.seed,
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

fn report(
    set: &PressSet,
    [train, held_out]: [usize; 2],
    score: Score,
    fitted: &Fitted,
    profile: &SensorProfile,
    options: &CalibrateOptions,
) -> CalibrationReport {
    let pivot = pivot(set);
    CalibrationReport {
        score,
        scored_on: if held_out == 0 { "fitted" } else { "held_out" },
        fitted: train,
        held_out,
        skipped: set.skipped.clone(),
        contacts_found: set.presses.iter().filter(|press| press.is_detected).count(),
        seed: options.seed,
        model: match profile.shading {
            ShadingModel::Polynomial(_) => "polynomial",
            ShadingModel::Leds(_) => "leds",
        },
        chosen: fitted.model,
        ball_diameter_m: 2.0 * set.ball_m,
        pixel_m: set.geometry.pixel_m,
        scale: set.scale,
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
