//! Options, value parsers and checks that several commands share.

use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};

use crate::config::FlagValue;
use gripcast_base::error::{Error, Result};
use gripcast_base::number::NumberRange;
use gripcast_base::workers::cores;
use gripcast_imaging::DepthView;
use gripcast_nn::predict::contract::Modality;
use gripcast_sim::EngineKind;
use gripcast_sim::fem::GelResolution;
use gripcast_sim::grasp::Preset;
use gripcast_tactile::Moment;
use gripcast_tactile::calibrate::ReadOptions;

/// Parser of named values, given as name, help and value.
pub(super) fn named<T: Clone + Send + Sync + 'static, const N: usize>(
    values: [(&'static str, &'static str, T); N],
) -> impl TypedValueParser<Value = T> {
    let names = values
        .clone()
        .map(|(name, help, _)| PossibleValue::new(name).help(help));
    PossibleValuesParser::new(names).try_map(move |name| {
        let value = values.iter().find(|value| value.0 == name);
        value.map(|value| value.2.clone()).ok_or("unknown value")
    })
}

/// Parser of a gel mesh.
pub(super) fn gel_resolution() -> impl TypedValueParser<Value = GelResolution> {
    named([
        ("coarse", "13 × 11 × 3 nodes", GelResolution::Coarse),
        ("default", "19 × 16 × 4 nodes", GelResolution::Default),
        ("fine", "26 × 21 × 5 nodes", GelResolution::Fine),
    ])
}

/// Parser of a set of gel parameters.
pub(super) fn preset() -> impl TypedValueParser<Value = Preset> {
    named([
        ("paper", "E = 1 MPa, ν = 0.3", Preset::Paper),
        ("feats", "E = 0.435 MPa, ν = 0.45", Preset::Feats),
    ])
}

/// Parser of a simulation engine.
pub(super) fn engine() -> impl TypedValueParser<Value = EngineKind> {
    let fem = "Finite-element gels, incremental potential contact";
    named([
        ("fem", fem, EngineKind::Fem),
        (
            "rigid",
            "Rigid fingers and convex pieces",
            EngineKind::Rigid,
        ),
    ])
}

/// Parser of a moment of a simulated grasp.
pub(super) fn moment() -> impl TypedValueParser<Value = Moment> {
    named([
        ("initial", "Before closing (initial frame)", Moment::Initial),
        ("closure", "End of the closure", Moment::Closure),
        (
            "grasp",
            "End of the force adjustment (grasp frame)",
            Moment::Grasp,
        ),
        ("lift", "End of the lift", Moment::Lift),
    ])
}

/// Parser of a model's modality.
pub(super) fn modality() -> impl TypedValueParser<Value = Modality> {
    named([
        ("v", "Colour image", Modality::V),
        ("t", "Both tactile differences", Modality::T),
        ("d", "Depth image", Modality::D),
        ("vt", "Colour image and tactile differences", Modality::Vt),
        ("vd", "Colour and depth image", Modality::Vd),
        ("td", "Tactile differences and depth image", Modality::Td),
        ("vtd", "All of them", Modality::Vtd),
    ])
}

/// Parser of the view of a depth image.
pub(super) fn depth_view() -> impl TypedValueParser<Value = DepthView> {
    named(DepthView::ALL.map(|view| {
        let help = match view {
            DepthView::Colour => "Aligned to the colour image",
            DepthView::LeftImager => "As a RealSense D435 streams it",
        };
        (view.name(), help, view)
    }))
}

/// Parser of a number in a range.
pub(super) fn number(
    range: NumberRange,
) -> impl Fn(&str) -> Result<f64, String> + Clone + Send + Sync + 'static {
    move |text| range.parse(text).map_err(|e| e.what().to_owned())
}

/// Parses a finite number above 0.
pub(super) fn above_zero(text: &str) -> Result<f64, String> {
    number(NumberRange::POSITIVE)(text)
}

/// Error rates of prediction sets.
pub(super) const ERROR_RATE: NumberRange = NumberRange::above(0.0, 0.5);

/// Parses a fraction.
pub(super) fn fraction(text: &str) -> Result<f64, String> {
    number(NumberRange::FRACTION)(text)
}

/// Parses an angle, degrees.
pub(super) fn degrees(text: &str) -> Result<f64, String> {
    number(NumberRange::between(-360.0, 360.0).unit("degrees"))(text)
}

/// Parses the side of something that is printed, mm.
pub(super) fn millimetres(text: &str) -> Result<f64, String> {
    number(NumberRange::above(0.0, 10_000.0).unit("mm"))(text)
}

/// Parses a measuring time, s.
pub(super) fn seconds(text: &str) -> Result<f64, String> {
    number(NumberRange::between(0.1, 3600.0).unit("s"))(text)
}

/// Parses `WIDTHxHEIGHT`; both numbers must lie in `range`.
pub(super) fn size(text: &str, range: RangeInclusive<u32>) -> Result<[u32; 2], String> {
    let pair = numbers(text, &['x', 'X', '×']);
    pair.filter(|sides| sides.iter().all(|side| range.contains(side)))
        .ok_or_else(|| {
            format!(
                "expected two numbers from {} to {}, as in 640x480",
                range.start(),
                range.end()
            )
        })
}

/// Parses the size of a rendered image, px.
pub(super) fn image_size(text: &str) -> Result<[usize; 2], String> {
    size(text, 1..=8192).map(|sides| sides.map(|side| side as usize))
}

/// Parses two numbers with one of `separators` between them.
pub(super) fn numbers<T: FromStr>(text: &str, separators: &[char]) -> Option<[T; 2]> {
    let numbers: Option<Vec<T>> = text
        .split(separators)
        .map(|t| t.trim().parse().ok())
        .collect();
    <[T; 2]>::try_from(numbers?).ok()
}

/// Number of parallel jobs.
#[derive(Clone, Debug, clap::Args)]
pub(super) struct JobsFlag {
    /// Number of parallel jobs; results do not depend on it [default: all cores]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=256))]
    jobs: Option<u16>,
}

impl JobsFlag {
    /// Returns the number of jobs.
    pub(super) fn count(&self) -> usize {
        self.jobs.map_or_else(cores, usize::from)
    }
}

/// Number of threads of one computation.
#[derive(Clone, Debug, clap::Args)]
pub(super) struct ThreadsFlag {
    /// Number of threads; results do not depend on it [default: all cores]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=256))]
    threads: Option<u16>,
}

impl ThreadsFlag {
    /// Starts the threads.
    pub(super) fn pool(&self) -> Result<rayon::ThreadPool> {
        rayon::ThreadPoolBuilder::new()
            .num_threads(self.threads.map_or(0, usize::from))
            .build()
            .map_err(|e| Error::internal("cannot start threads").because(e))
    }
}

/// How ball presses are read.
#[derive(Clone, Debug, clap::Args)]
pub(super) struct BallFlags {
    /// Diameter of the ball [default: from presses.json]
    #[arg(long, value_name = "MM", value_parser = millimetres)]
    ball_mm: Option<f64>,
    /// Detect contacts in the images even if presses.json has them
    #[arg(long)]
    find_contacts: bool,
}

impl BallFlags {
    /// Returns the options for a folder of presses.
    pub(super) fn read_options(&self, folder: &Path) -> ReadOptions {
        ReadOptions {
            ball_diameter_m: self.ball_mm.map(|mm| 1e-3 * mm),
            find_contacts: self.find_contacts,
            ..ReadOptions::from_folder(folder)
        }
    }
}

/// Returns the lower-case suffix of a file, without the dot.
pub(super) fn suffix(path: &Path) -> String {
    let suffix = path.extension().unwrap_or_default();
    suffix.to_string_lossy().to_ascii_lowercase()
}

/// Refuses an output file with another suffix than `suffixes` (if any are given) or in a folder
/// that does not exist.
pub(super) fn check_output(flag: &str, path: &Path, suffixes: &[&str]) -> Result<()> {
    if !suffixes.is_empty() && !suffixes.contains(&suffix(path).as_str()) {
        return Err(Error::usage(format!(
            "`{flag}` must name a file that ends in .{}",
            suffixes.join(" or .")
        ))
        .at(path.display()));
    }
    match path
        .parent()
        .filter(|folder| !folder.as_os_str().is_empty())
    {
        Some(folder) if !folder.is_dir() => Err(Error::not_found(format!(
            "the folder for `{flag}` does not exist"
        ))
        .at(folder.display())
        .remedy("create it first")),
        _ => Ok(()),
    }
}

/// Reads a text file; `what` names it in an error.
pub(super) fn read_text(path: &Path, what: &str) -> Result<String> {
    std::fs::read_to_string(path)
        .map_err(|e| Error::io(format!("cannot read the {what}"), e).at(path.display()))
}

/// Returns the configuration values of the options that were given: (option, key, value).
pub(super) fn given<const N: usize>(
    values: [(&'static str, &'static str, Option<String>); N],
) -> Vec<FlagValue> {
    let given = values.into_iter();
    given
        .filter_map(|(flag, key, value)| Some((flag, key, value?)))
        .collect()
}

/// Returns a path as the text of a configuration value.
pub(super) fn path_text(path: Option<&PathBuf>) -> Option<String> {
    path.map(|path| path.display().to_string())
}
