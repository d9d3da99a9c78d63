//! The force on rendered presses.

#![allow(
    clippy::unwrap_used,
    reason = "a helper of a test fails as a test does"
)]

use image::RgbImage;

use gripcast_shear::{FingerForce, ShearFrame, ShearTracker};
use gripcast_tactile::force::{
    ForceCalibration, ForceEstimator, ForceFeatures, ForceModel, ForceSensor, WeightPress,
};
use gripcast_tactile::{PressDepth, SensorProfile, TactileRenderer};

const BALL_M: f64 = 0.01;

/// Renders a ball of 10 mm radius at a depth, in the middle of the gel, with noise.
struct Bench {
    profile: SensorProfile,
    renderer: TactileRenderer,
    initial: RgbImage,
    tracker: ShearTracker,
}

impl Bench {
    fn new(name: &str) -> Self {
        let profile = SensorProfile::named_or_load(name).unwrap();
        let mut renderer = TactileRenderer::new(&profile).unwrap();
        let untouched = PressDepth::untouched(renderer.geometry());
        let initial = renderer
            .render(&untouched, &profile.drift.sample(1))
            .unwrap();
        let expected = profile.expected_markers();
        let tracker = ShearTracker::new(&initial, profile.geometry.pixel_m, expected).unwrap();
        Self {
            profile,
            renderer,
            initial,
            tracker,
        }
    }

    fn press(&mut self, depth_m: f64) -> (RgbImage, ShearFrame) {
        let geometry = self.renderer.geometry();
        let mut press = PressDepth::untouched(geometry);
        for (at, depth) in press.depth_m.iter_mut().enumerate() {
            let (column, row) = (at % geometry.width, at / geometry.width);
            let [x, y] = geometry.pixel_to_gel_m(column as f64, row as f64);
            let radius = x.hypot(y).min(BALL_M);
            let height = BALL_M - (BALL_M * BALL_M - radius * radius).sqrt();
            *depth = (depth_m - height).max(0.0) as f32;
        }
        let seed = 2 + (1e7 * depth_m) as u64;
        let image = self
            .renderer
            .render(&press, &self.profile.drift.sample(seed))
            .unwrap();
        let shear = self.tracker.update(&image);
        (image, shear)
    }

    fn force(&mut self, estimator: &ForceEstimator, depth_m: f64) -> FingerForce {
        let (image, shear) = self.press(depth_m);
        estimator.estimate(&self.initial, &image, &shear).unwrap()
    }

    fn weight_press(&mut self, depth_m: f64, force_n: f64) -> WeightPress {
        let (image, shear) = self.press(depth_m);
        let sensor = ForceSensor::new(&self.profile).unwrap();
        let (features, _) = sensor.features(&self.initial, &image, &shear).unwrap();
        WeightPress {
            name: format!("{force_n} N"),
            features,
            force_n,
        }
    }
}

/// Forces of a ball of 10 mm radius on a gel of 1 MPa and Poisson's ratio 0.3 by converged finite
/// elements, by depth in mm.
const BALL_N: [[f64; 2]; 5] = [
    [0.2, 0.610],
    [0.4, 2.083],
    [0.6, 4.417],
    [0.8, 7.661],
    [1.0, 11.879],
];

#[test]
fn shipped_model_grows_with_every_feature() {
    let model = ForceModel::shipped().unwrap();
    assert!(model.provenance.len() > 100);
    let middle = ForceFeatures {
        volume: 0.2,
        square: 0.02,
        cube: 0.002,
        slope: 0.5,
        bending: 0.09,
        area: 2.0,
        deep_area: 2.0,
        depth: 0.15,
        has_markers: false,
    };
    for has_markers in [false, true] {
        let features = ForceFeatures {
            has_markers,
            ..middle
        };
        let force = model.normal(&features, 0.4).value;
        assert!(force > 0.0);
        let grown = [
            ForceFeatures {
                volume: 0.21,
                ..features
            },
            ForceFeatures {
                square: 0.021,
                ..features
            },
            ForceFeatures {
                slope: 0.51,
                ..features
            },
            ForceFeatures {
                bending: 0.091,
                ..features
            },
            ForceFeatures {
                deep_area: 2.1,
                ..features
            },
        ];
        assert!(
            grown
                .iter()
                .all(|grown| model.normal(grown, 0.4).value >= force)
        );
        assert!(model.normal(&features, 0.45).value >= force);
    }
    let nothing = ForceFeatures::default();
    assert_eq!(model.normal(&nothing, 0.3).value, 0.0);
}

#[test]
fn invalid_models_are_refused() {
    let model = ForceModel::shipped().unwrap();
    let mut negative = model.clone();
    negative.plain.terms[0].weight = -1.0;
    let text = negative.to_toml().unwrap();
    assert!(
        ForceModel::from_toml(&text)
            .unwrap_err()
            .what()
            .contains("not negative")
    );
    assert_eq!(
        ForceModel::from_toml(&model.to_toml().unwrap()).unwrap(),
        model
    );
}

#[test]
fn force_of_a_ball_is_that_of_the_finite_elements_and_grows_with_the_depth() {
    for name in ["gelsight-mini", "gelsight-mini-markers"] {
        let mut bench = Bench::new(name);
        let presses: Vec<WeightPress> = [1, 2, 4]
            .map(|i| bench.weight_press(1e-3 * BALL_N[i][0], BALL_N[i][1]))
            .into();
        let model = ForceModel::shipped().unwrap();
        let thickness_m = bench.profile.geometry.gel_thickness_m;
        let calibration = ForceCalibration::fit(&model, thickness_m, name, "", &presses).unwrap();
        let estimator = ForceEstimator::new(&bench.profile, Some(&calibration)).unwrap();
        let mut before = 0.0;
        for [depth_mm, expected] in BALL_N {
            let force = bench.force(&estimator, 1e-3 * depth_mm);
            assert!(force.is_calibrated && force.normal_n > before);
            let limit = 0.25 + 0.1 * expected;
            assert!(
                (force.normal_n - expected).abs() < limit,
                "{} {expected}",
                force.normal_n
            );
            before = force.normal_n;
        }
    }
}

#[test]
fn untouched_gel_has_no_force() {
    for name in ["gelsight-mini", "gelsight-mini-markers"] {
        let mut bench = Bench::new(name);
        let estimator = ForceEstimator::new(&bench.profile.clone(), None).unwrap();
        let force = bench.force(&estimator, -1.0);
        assert!(force.normal_n < 0.1, "{force:?}");
        assert!(!force.is_calibrated);
    }
}

#[test]
fn gels_of_other_sizes_have_no_model() {
    let digit = SensorProfile::named_or_load("digit").unwrap();
    let error = ForceEstimator::new(&digit, None).unwrap_err();
    assert!(error.what().contains("digit"), "{}", error.what());
}

#[test]
fn calibration_finds_the_gel_and_round_trips() {
    let mut bench = Bench::new("gelsight-mini");
    let model = ForceModel::shipped().unwrap();
    let soft = 0.4;
    let presses: Vec<WeightPress> = BALL_N[1..]
        .iter()
        .map(|[mm, n]| bench.weight_press(1e-3 * mm, soft * n))
        .collect();
    let fit = |presses: &[WeightPress]| {
        ForceCalibration::fit(&model, 4e-3, "gelsight-mini", "A1", presses)
    };
    let found = fit(&presses).unwrap();
    let unit = |calibration: &ForceCalibration| {
        calibration.young_pa
            * model
                .normal(&presses[2].features, calibration.poisson)
                .value
    };
    let expected = presses[2].force_n / (4e-3 * 4e-3);
    assert!(
        (unit(&found) / expected - 1.0).abs() < 0.1,
        "{} {expected}",
        unit(&found)
    );
    let text = found.to_toml().unwrap();
    assert_eq!(ForceCalibration::from_toml(&text).unwrap(), found);

    let refused = |presses: &[WeightPress], words: &str| {
        let error = fit(presses).unwrap_err();
        assert!(error.to_string().contains(words), "{error}");
    };
    refused(&presses[..2], "at least 3 presses");
    let mut swapped = presses.clone();
    swapped[0].force_n = presses[3].force_n;
    swapped[3].force_n = presses[0].force_n;
    refused(&swapped, "shows less force");
    let mut grams = presses.clone();
    grams.iter_mut().for_each(|press| press.force_n *= 100.0);
    refused(&grams, "must be 0.05 to 200 N");
    let mut heavy = presses.clone();
    heavy.iter_mut().for_each(|press| press.force_n *= 25.0);
    refused(&heavy, "MPa");
    let mut unseen = presses.clone();
    unseen[0].features = ForceFeatures::default();
    refused(&unseen, "shows no contact");
    let mut equal = presses.clone();
    equal.iter_mut().for_each(|press| press.force_n = 3.0);
    refused(&equal, "1.8 times");
    let newer = text.replace("schema = 1", "schema = 9");
    assert!(ForceCalibration::from_toml(&newer).is_err());
}
