//! Calibration of a sensor's force with known weights.
//!
//! The weights give the modulus of the gel, and with it Poisson's ratio, which changes how the force
//! depends on the shape of the contact. Few weights hardly tell Poisson's ratio: it stays near the
//! usual one unless they do.

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::features::ForceFeatures;
use super::model::{ForceModel, POISSON};
use gripcast_base::error::{Error, Result};
use gripcast_base::files::{FileKind, read_text};

/// Version of the file.
const SCHEMA: u32 = 1;
/// Acceleration of free fall, m/s².
pub const GRAVITY_M_S2: f64 = 9.806_65;
/// Minimum number of presses.
pub const MIN_PRESSES: usize = 3;
/// Plausible forces of a press, N.
const FORCE_N: std::ops::RangeInclusive<f64> = 0.05..=200.0;
/// Plausible Young's moduli of a gel, Pa.
const YOUNG_PA: std::ops::RangeInclusive<f64> = 5e4..=5e6;
/// Minimum ratio of the largest to the smallest force.
const MIN_RATIO: f64 = 1.8;
/// Maximum decrease of the image's force while the weight grows, fraction.
const MAX_DECREASE: f64 = 0.1;
/// Maximum root mean square residual, fraction.
const MAX_RESIDUAL: f64 = 0.35;
/// Error of a press that is always possible, N, and as a fraction.
const ERROR_N: f64 = 0.2;
const ERROR_FRACTION: f64 = 0.08;
/// Usual Poisson's ratio and its spread.
const USUAL_POISSON: f64 = 0.42;
const POISSON_STD: f64 = 0.06;
/// Steps of the search for Poisson's ratio.
const POISSON_STEPS: usize = 36;
/// Minimum force over Young's modulus and the square of the thickness that shows in an image.
const MIN_UNIT_FORCE: f64 = 1e-3;

/// What was pressed and what it showed.
#[derive(Clone, Debug)]
pub struct WeightPress {
    /// Name in messages: the image, or the weight.
    pub name: String,
    /// Features of the image.
    pub features: ForceFeatures,
    /// Force, N.
    pub force_n: f64,
}

/// Force calibration of one sensor.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ForceCalibration {
    /// Version of the file.
    pub schema: u32,
    /// Serial of the sensor, empty if unknown.
    #[serde(default)]
    pub serial: String,
    /// Sensor profile with which the images were read.
    pub sensor_profile: String,
    /// Young's modulus with which the model gives the known forces, Pa.
    pub young_pa: f64,
    /// Poisson's ratio, as far as the weights tell it.
    pub poisson: f64,
    /// Standard deviation of the modulus, fraction.
    pub std_fraction: f64,
    /// Presses.
    pub presses: Vec<CalibratedPress>,
}

/// A press and what the calibrated model says of it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CalibratedPress {
    /// Image or weight.
    pub name: String,
    /// Known force, N.
    pub force_n: f64,
    /// Force by the calibrated model, N.
    pub estimate_n: f64,
}

impl ForceCalibration {
    /// Fits the gel of a sensor of thickness `thickness_m` to presses with known forces.
    ///
    /// # Errors
    /// `Input` for too few presses, impossible or too similar forces, a press that the image does not
    /// show, forces that fall while the weights grow, an implausible modulus, or large residuals;
    /// each names the press.
    pub fn fit(
        model: &ForceModel,
        thickness_m: f64,
        sensor_profile: &str,
        serial: &str,
        presses: &[WeightPress],
    ) -> Result<Self> {
        check_forces(presses)?;
        check_images(model, presses)?;
        let h2 = thickness_m * thickness_m;
        let [low, high] = POISSON;
        let poissons =
            (0..=POISSON_STEPS).map(|i| low + (high - low) * i as f64 / POISSON_STEPS as f64);
        let fits = poissons.map(|poisson| {
            let unit: Vec<f64> = presses
                .iter()
                .map(|press| h2 * model.normal(&press.features, poisson).value)
                .collect();
            let (young_pa, misfit) = modulus(presses, &unit);
            let prior = ((poisson - USUAL_POISSON) / POISSON_STD).powi(2);
            (misfit + prior, poisson, young_pa, unit)
        });
        let best = fits.min_by(|a, b| a.0.total_cmp(&b.0));
        let Some((_, poisson, young_pa, unit)) = best else {
            return Err(Error::internal("no Poisson's ratio was tried"));
        };
        let calibrated = presses
            .iter()
            .zip(&unit)
            .map(|(press, unit)| CalibratedPress {
                name: press.name.clone(),
                force_n: press.force_n,
                estimate_n: young_pa * unit,
            });
        let calibrated: Vec<CalibratedPress> = calibrated.collect();
        if !YOUNG_PA.contains(&young_pa) {
            let what = format!(
                "the forces and images give a gel of {:.3} MPa, expected {:.2} to {:.0} MPa",
                1e-6 * young_pa,
                1e-6 * YOUNG_PA.start(),
                1e-6 * YOUNG_PA.end()
            );
            return Err(Error::input(what).remedy(
                "check the unit of the weights (grams, or newtons with --force-n) and that they \
                 rest on the gel alone",
            ));
        }
        let squares = calibrated
            .iter()
            .map(|p| (p.estimate_n / p.force_n - 1.0).powi(2));
        let rms = (squares.sum::<f64>() / calibrated.len() as f64).sqrt();
        if rms > MAX_RESIDUAL {
            let worst = calibrated.iter().max_by(|a, b| {
                let off = |p: &CalibratedPress| (p.estimate_n / p.force_n).ln().abs();
                off(a).total_cmp(&off(b))
            });
            let worst = worst.map_or(String::new(), |p| {
                format!(
                    "; the worst is {}: {:.2} N by the weight, {:.2} N by the image",
                    p.name, p.force_n, p.estimate_n
                )
            });
            let what = format!("the presses disagree by {:.0} %{worst}", 100.0 * rms);
            return Err(Error::input(what).remedy(
                "repeat them with a ball or a rod of 5 to 20 mm radius in the middle of the gel",
            ));
        }
        let free = (calibrated.len() as f64 - 1.0).max(1.0);
        Ok(Self {
            schema: SCHEMA,
            serial: serial.to_owned(),
            sensor_profile: sensor_profile.to_owned(),
            young_pa,
            poisson,
            std_fraction: (rms * (calibrated.len() as f64 / free).sqrt()).max(0.02)
                / (calibrated.len() as f64).sqrt(),
            presses: calibrated,
        })
    }

    /// Reads a calibration.
    ///
    /// # Errors
    /// `Io`; `Config` for an invalid file.
    pub fn load(path: &Path) -> Result<Self> {
        let cannot = |e| Error::io("cannot read the force calibration", e).at(path.display());
        let text = read_text(path, FileKind::Record).map_err(cannot)?;
        Self::from_toml(&text).map_err(|e| e.at(path.display()))
    }

    /// Parses a calibration.
    ///
    /// # Errors
    /// `Config` for an invalid text.
    pub fn from_toml(text: &str) -> Result<Self> {
        let found: Self = toml::from_str(text)
            .map_err(|e| Error::config(format!("invalid force calibration: {}", e.message())))?;
        if found.schema != SCHEMA {
            let what = format!(
                "expected version {SCHEMA} of a force calibration, found {}",
                found.schema
            );
            return Err(Error::config(what));
        }
        let [low, high] = POISSON;
        let is_valid = YOUNG_PA.contains(&found.young_pa)
            && (low..=high).contains(&found.poisson)
            && (0.0..=1.0).contains(&found.std_fraction);
        if !is_valid {
            return Err(Error::config(format!(
                "`young_pa` must be {:.0} to {:.0}, `poisson` {low} to {high} and `std_fraction` 0 \
                 to 1, found {}, {} and {}",
                YOUNG_PA.start(),
                YOUNG_PA.end(),
                found.young_pa,
                found.poisson,
                found.std_fraction
            ))
            .remedy("run `gripcast calibrate force` again"));
        }
        Ok(found)
    }

    /// The calibration as text.
    ///
    /// # Errors
    /// `Internal` if it cannot be written.
    pub fn to_toml(&self) -> Result<String> {
        toml::to_string(self)
            .map_err(|e| Error::internal("cannot write the force calibration").because(e))
    }
}

/// Modulus that fits the forces best, and the misfit, in squares of the possible error.
fn modulus(presses: &[WeightPress], unit: &[f64]) -> (f64, f64) {
    let std = |press: &WeightPress| ERROR_N.hypot(ERROR_FRACTION * press.force_n);
    let (mut own, mut both) = (0.0, 0.0);
    for (press, unit) in presses.iter().zip(unit) {
        let weight = std(press).powi(-2);
        own += weight * unit * unit;
        both += weight * unit * press.force_n;
    }
    let young_pa = both / own.max(f64::MIN_POSITIVE);
    let misfit = presses
        .iter()
        .zip(unit)
        .map(|(press, unit)| ((young_pa * unit - press.force_n) / std(press)).powi(2));
    (young_pa, misfit.sum())
}

fn check_forces(presses: &[WeightPress]) -> Result<()> {
    if presses.len() < MIN_PRESSES {
        let what = format!(
            "a force calibration needs at least {MIN_PRESSES} presses, found {}",
            presses.len()
        );
        return Err(Error::input(what).remedy("press with 200, 500 and 1000 g, for instance"));
    }
    for press in presses {
        if !FORCE_N.contains(&press.force_n) {
            let what = format!(
                "the force of {} must be {} to {} N, found {}",
                press.name,
                FORCE_N.start(),
                FORCE_N.end(),
                press.force_n
            );
            return Err(Error::input(what).remedy("--weights-g is in grams, --force-n in newtons"));
        }
    }
    let forces = presses.iter().map(|press| press.force_n);
    let (low, high) = (
        forces.clone().fold(f64::INFINITY, f64::min),
        forces.fold(0.0, f64::max),
    );
    if high < MIN_RATIO * low {
        let what = format!(
            "the forces reach from {low:.2} to {high:.2} N; the largest must be at least \
             {MIN_RATIO} times the smallest"
        );
        return Err(Error::input(what).remedy("use weights such as 200, 500 and 1000 g"));
    }
    Ok(())
}

/// Refuses presses that do not show, and images whose force falls while the weight grows.
fn check_images(model: &ForceModel, presses: &[WeightPress]) -> Result<()> {
    let shown = |press: &WeightPress| model.normal(&press.features, USUAL_POISSON).value;
    let unseen = presses.iter().find(|press| shown(press) < MIN_UNIT_FORCE);
    if let Some(press) = unseen {
        let what = format!("the image of {} shows no contact", press.name);
        return Err(Error::input(what).remedy(
            "press with something curved, such as a ball or a rod: a flat face that covers the gel \
             does not show; or use a heavier weight",
        ));
    }
    let mut sorted: Vec<&WeightPress> = presses.iter().collect();
    sorted.sort_by(|a, b| a.force_n.total_cmp(&b.force_n));
    for pair in sorted.windows(2) {
        let [lighter, heavier] = [shown(pair[0]), shown(pair[1])];
        let grows = pair[1].force_n > 1.05 * pair[0].force_n;
        if grows && heavier < (1.0 - MAX_DECREASE) * lighter {
            let what = format!(
                "the image of {} ({:.2} N) shows less force than that of {} ({:.2} N)",
                pair[1].name, pair[1].force_n, pair[0].name, pair[0].force_n
            );
            return Err(Error::input(what).remedy(
                "check the order of the images and the weights, and that nothing but the gel \
                 carries the weight",
            ));
        }
    }
    Ok(())
}
