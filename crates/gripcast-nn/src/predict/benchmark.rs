//! Measures loading, preprocessing and prediction times on this machine.

use std::time::Instant;

use image::{Rgb, RgbImage};
use serde::Serialize;

use super::contract::{IMAGE_HEIGHT, IMAGE_WIDTH, InputName};
use super::engine::Model;
use super::input::ModelInput;
use super::points::PointMap;
use gripcast_base::error::Result;
use gripcast_imaging::{Depth, DepthImage, DepthView, TactileDifference};

/// Number of loads per measurement.
const LOADS: usize = 5;
/// Number of warm-up predictions.
const WARM_UP: usize = 3;

/// Number of predictions of a self-check.
const SELF_CHECKS: usize = 9;

/// Timings of a model, wall time on one thread.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct PredictTimings {
    /// Median inference time, ms.
    pub engine_ms_median: f64,
    /// Minimum inference time, ms.
    pub engine_ms_min: f64,
    /// Median time from the file's bytes to the first prediction, ms.
    pub load_ms_median: f64,
    /// Minimum time from the file's bytes to the first prediction, ms.
    pub load_ms_min: f64,
    /// Median preprocessing time of all inputs, ms.
    pub preprocess_ms_median: f64,
    /// Minimum preprocessing time of all inputs, ms.
    pub preprocess_ms_min: f64,
}

/// Measures a model, given as bytes, over `runs` predictions (at least one).
///
/// # Errors
/// When the model does not load or run.
pub fn measure(model: &[u8], runs: usize) -> Result<PredictTimings> {
    let loads = (0..LOADS)
        .map(|_| Ok(Model::from_bytes(model)?.load_ms()))
        .collect::<Result<Vec<_>>>()?;
    let model = Model::from_bytes(model)?;
    let mut input = ModelInput::zeros(model.contract())?;
    let (initial, grasp) = (pattern(0), pattern(40));
    let mut preprocess = Vec::with_capacity(runs);
    for run in 0..WARM_UP + runs.max(1) {
        let started = Instant::now();
        fill(&mut input, &model, &initial, &grasp)?;
        if run >= WARM_UP {
            preprocess.push(started.elapsed().as_secs_f64() * 1e3);
        }
    }
    // Constant input, as for the baseline engine.
    let mut engine = Vec::with_capacity(runs);
    for run in 0..WARM_UP + runs.max(1) {
        let prediction = model.predict(&input)?;
        if run >= WARM_UP {
            engine.push(prediction.engine_ms);
        }
    }
    let (engine_ms_min, engine_ms_median) = min_and_median(engine);
    let (load_ms_min, load_ms_median) = min_and_median(loads);
    let (preprocess_ms_min, preprocess_ms_median) = min_and_median(preprocess);
    Ok(PredictTimings {
        engine_ms_median,
        engine_ms_min,
        load_ms_median,
        load_ms_min,
        preprocess_ms_median,
        preprocess_ms_min,
    })
}

/// Result of a self-check.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SelfCheck {
    /// Prediction of the network for a synthetic grasp, without the grasp head: the engines round
    /// differently, and a tree may take another branch.
    pub p_stable: f64,
    /// Prediction of the tract engine, if the native engine runs the model.
    pub reference: Option<f64>,
    /// Median inference time, ms.
    pub engine_ms: f64,
    /// Time from the file's bytes to the first prediction, ms.
    pub load_ms: f64,
}

/// Predicts a synthetic grasp, with both engines if possible.
///
/// # Errors
/// When the model does not load or run.
pub fn self_check(model: &[u8]) -> Result<SelfCheck> {
    let bytes = model;
    let model = Model::from_bytes(bytes)?.without_grasp_head();
    let input = synthetic_input(&model)?;
    let reference = if model.is_native() {
        let tract = Model::with_tract(bytes)?.without_grasp_head();
        Some(tract.predict(&input)?.p_stable)
    } else {
        None
    };
    let runs = (0..SELF_CHECKS)
        .map(|_| model.predict(&input))
        .collect::<Result<Vec<_>>>()?;
    let (_, engine_ms) = min_and_median(runs.iter().map(|run| run.engine_ms).collect());
    Ok(SelfCheck {
        p_stable: runs.first().map_or(f64::NAN, |run| run.p_stable),
        reference,
        engine_ms,
        load_ms: model.load_ms(),
    })
}

fn synthetic_input(model: &Model) -> Result<ModelInput> {
    let mut input = ModelInput::zeros(model.contract())?;
    fill(&mut input, model, &pattern(0), &pattern(40))?;
    Ok(input)
}

/// Sets all inputs of a model.
fn fill(input: &mut ModelInput, model: &Model, initial: &RgbImage, grasp: &RgbImage) -> Result<()> {
    for name in model.contract().modality.inputs() {
        match name {
            InputName::Rgb => input.set_rgb(grasp)?,
            InputName::Depth => {
                let image = DepthImage::from_fn(IMAGE_WIDTH, IMAGE_HEIGHT, |x, y| {
                    image::Luma([(150 + (x + y) % 100) as u16])
                });
                let unit_m = 1e-3;
                let points = PointMap::new(&Depth { image, unit_m }, DepthView::Colour);
                input.set_depth(&points)?;
            }
            tactile => {
                let difference = TactileDifference::between(initial, grasp)?;
                input.set_tactile(tactile, &difference)?;
            }
        }
    }
    Ok(())
}

fn pattern(shift: u32) -> RgbImage {
    RgbImage::from_fn(IMAGE_WIDTH, IMAGE_HEIGHT, |x, y| {
        Rgb([x + shift, y + shift, x * y + shift].map(|v| (v % 256) as u8))
    })
}

/// Minimum and (lower) median.
fn min_and_median(mut values: Vec<f64>) -> (f64, f64) {
    values.sort_by(f64::total_cmp);
    let value = |index: usize| values.get(index).copied().unwrap_or(f64::NAN);
    (value(0), value(values.len().saturating_sub(1) / 2))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn minimum_and_median() {
        assert_eq!(min_and_median(vec![3.0, 1.0, 2.0]), (1.0, 2.0));
        assert_eq!(min_and_median(vec![4.0, 1.0, 3.0, 2.0]), (1.0, 2.0));
        assert_eq!(min_and_median(vec![5.0]), (5.0, 5.0));
    }

    #[test]
    fn timings_are_positive_with_stable_keys() {
        let figures = measure(&crate::predict::baseline::onnx_bytes().unwrap(), 3).unwrap();
        let json = serde_json::to_value(figures).unwrap();
        let keys: Vec<_> = json.as_object().unwrap().keys().cloned().collect();
        assert_eq!(
            keys,
            [
                "engine_ms_median",
                "engine_ms_min",
                "load_ms_median",
                "load_ms_min",
                "preprocess_ms_median",
                "preprocess_ms_min"
            ]
        );
        for (key, value) in json.as_object().unwrap() {
            assert!(value.as_f64().is_some_and(|ms| ms > 0.0), "{key}: {value}");
        }
    }
}
