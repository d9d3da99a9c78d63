//! Samples of the force model: features of rendered presses beside their simulated forces.

use glam::DVec2;
use gripcast_base::error::Result;
use gripcast_base::random::SeedStream;
use gripcast_shear::ShearTracker;
use gripcast_tactile::force::{ForceFeatures, ForceSensor, SkinMotion};
use gripcast_tactile::{
    FrameNoise, MountingAngle, NodeMotion, PressDepth, SensorName, SensorProfile, SensorVariation,
    Skin, TactileRenderer,
};
use rayon::prelude::*;
use serde::Serialize;

use crate::force_presses::{Place, SimulatedPress, Use, YOUNG_PA, depth_of, is_long, whole_grid};

/// Profiles that are rendered: without gel markers, with gel markers.
const PROFILES: [&str; 2] = ["gelsight-mini", "gelsight-mini-markers"];
/// Sensors of each kind per press.
const SENSORS: usize = 6;
/// Maximum distance of a press from the middle of the gel along x and y, m.
const MAX_SHIFT_M: [f64; 2] = [3e-3, 2e-3];
/// First number of the sensors of held-out presses.
const HELD_OUT_SENSORS: usize = 1_000_000;
/// Frames of the untouched gel that a tracker sees before a press.
const UNTOUCHED_FRAMES: u64 = 5;

/// One rendered state of a press.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Sample {
    /// Press and the sensor that saw it: samples with the same number share both.
    pub(crate) sequence: usize,
    /// Number of the sensor: held-out presses on one gel share their sensors.
    pub(crate) sensor: u64,
    pub(crate) shape: String,
    pub(crate) split: Use,
    pub(crate) poisson: f64,
    pub(crate) has_markers: bool,
    pub(crate) is_sheared: bool,
    pub(crate) depth_m: f64,
    pub(crate) shift_m: f64,
    /// Forces over Young's modulus and the square of the gel's thickness.
    pub(crate) normal: f64,
    pub(crate) shear: f64,
    #[serde(skip)]
    pub(crate) features: ForceFeatures,
    #[serde(skip)]
    pub(crate) motion: Option<SkinMotion>,
    features_array: [f64; 8],
    motion_array: Option<[f64; 2]>,
}

/// Renders all presses with sensors that differ from the profile as real ones do, and measures the
/// features with the profile itself.
///
/// # Errors
/// Those of rendering.
pub(crate) fn samples(presses: &[SimulatedPress], seed: u64) -> Result<Vec<Sample>> {
    let mut jobs = Vec::new();
    for press in 0..presses.len() {
        for profile in 0..PROFILES.len() {
            jobs.extend((0..SENSORS).map(|sensor| (press, profile, sensor)));
        }
    }
    let rendered: Vec<Vec<Sample>> = jobs
        .par_iter()
        .enumerate()
        .map(|(sequence, &(press, profile, sensor))| {
            let name = SensorName::by_name(PROFILES[profile])?;
            let sensor = sensor_of(&presses[press], press, sensor);
            sequence_of(sequence, &presses[press], &name.profile()?, seed, sensor)
        })
        .collect::<Result<_>>()?;
    Ok(rendered.into_iter().flatten().collect())
}

fn sequence_of(
    sequence: usize,
    press: &SimulatedPress,
    nominal: &SensorProfile,
    seed: u64,
    sensor: u64,
) -> Result<Vec<Sample>> {
    let mut of_sensor = SeedStream::named(seed, &format!("force sensor {sensor}"));
    let variation = SensorVariation::sample(of_sensor.bits(), 1.0);
    let mut stream = SeedStream::named(seed, &format!("force press {sequence}"));
    let varied = variation.apply(nominal);
    let mut renderer = TactileRenderer::new(&varied)?;
    let geometry = renderer.geometry();
    let mut frames = SeedStream::named(stream.bits(), "frames");
    let mut noise = || -> FrameNoise { varied.drift.sample(frames.bits()) };
    let untouched = PressDepth::untouched(geometry);
    let initial = renderer.render(&untouched, &noise())?;
    let force_sensor = ForceSensor::new(nominal)?;
    let mut tracker = ShearTracker::new(&initial, geometry.pixel_m, nominal.expected_markers())?;
    for _ in 0..UNTOUCHED_FRAMES {
        tracker.update(&renderer.render(&untouched, &noise())?);
    }
    let grid = whole_grid()?;
    let place = place(press, &mut stream)?;
    let h2 = force_sensor.thickness_m().powi(2);
    let mut samples = Vec::with_capacity(press.states.len());
    for state in &press.states {
        let skin = match press.is_sheared {
            true => {
                let face = state.face_m.iter().map(|u| u.map(f64::from)).collect();
                Skin::Nodes(NodeMotion::new(&grid, face, MountingAngle::default())?)
            }
            false => Skin::default(),
        };
        let shifted = Place {
            at_m: place.at_m + DVec2::X * state.shift_m,
            ..place
        };
        let depth = depth_of(&press.shape, &geometry, state.depth_m, &shifted)?;
        let image = renderer.render_with_skin(&depth, &skin, &noise())?;
        let frame = tracker.update(&image);
        let (features, motion) = force_sensor.features(&initial, &image, &frame)?;
        samples.push(Sample {
            sequence,
            sensor,
            shape: press.shape.clone(),
            split: press.split,
            poisson: press.poisson,
            has_markers: nominal.markers.is_some(),
            is_sheared: press.is_sheared,
            depth_m: state.depth_m,
            shift_m: state.shift_m,
            normal: state.normal_n / (YOUNG_PA * h2),
            // Half or a quarter of a gel is pushed aside by its press, the whole gel is not.
            shear: match press.is_sheared {
                true => state.shear_n / (YOUNG_PA * h2),
                false => 0.0,
            },
            features,
            motion,
            features_array: features.to_array(),
            motion_array: motion.map(|m| m.motion),
        });
    }
    Ok(samples)
}

/// Number of the sensor that sees a press: each fitted press has its own, held-out presses share those
/// of their gel.
fn sensor_of(press: &SimulatedPress, index: usize, sensor: usize) -> u64 {
    let group = match press.split {
        Use::Fit => index,
        Use::HeldOut | Use::Ball => HELD_OUT_SENSORS + (100.0 * press.poisson).round() as usize,
    };
    (SENSORS * group + sensor) as u64
}

/// Place of a press in the image: the simulated contact is in the middle of the gel, where its force
/// hardly depends on a small motion along the face.
fn place(press: &SimulatedPress, stream: &mut SeedStream) -> Result<Place> {
    // A sheared press moves the nodes of the gel where they are.
    if press.is_sheared {
        return Ok(Place::default());
    }
    let at_m = DVec2::new(
        stream.between(-MAX_SHIFT_M[0], MAX_SHIFT_M[0]),
        stream.between(-MAX_SHIFT_M[1], MAX_SHIFT_M[1]),
    );
    let angle = match is_long(&press.shape)? {
        true => 0.0,
        false => stream.between(0.0, std::f64::consts::PI),
    };
    Ok(Place { at_m, angle })
}
