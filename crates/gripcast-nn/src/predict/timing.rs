//! How long loading, preprocessing and predicting take on this machine.

use std::time::Instant;

use image::{Rgb, RgbImage};
use serde::Serialize;

use super::contract::{IMAGE_HEIGHT, IMAGE_WIDTH, InputName};
use super::engine::Model;
use super::input::ModelInput;
use gripcast_base::error::Result;
use gripcast_imaging::TactileDifference;

/// Loads per measurement; a load is far slower than a prediction.
const LOADS: usize = 5;
/// Predictions before the clock starts.
const WARM_UP: usize = 3;

/// Predictions of a self-check.
const SELF_CHECKS: usize = 9;

/// Figures of one model, ms of wall time on one thread.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct PredictFigures {
    /// Model alone, median.
    pub engine_ms_median: f64,
    /// Model alone, minimum.
    pub engine_ms_min: f64,
    /// From the file's bytes to the first answer, median.
    pub load_ms_median: f64,
    /// From the file's bytes to the first answer, minimum.
    pub load_ms_min: f64,
    /// From 320×240 images to tensors, all inputs of the model, median.
    pub preprocess_ms_median: f64,
    /// From 320×240 images to tensors, all inputs of the model, minimum.
    pub preprocess_ms_min: f64,
}

/// Measures a model, given as the bytes of its file, over `runs` predictions (at least one).
///
/// # Errors
/// When the model does not load or run.
pub fn measure(model: &[u8], runs: usize) -> Result<PredictFigures> {
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
    // The same tensors again and again, as the peer gets them.
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
    Ok(PredictFigures {
        engine_ms_median,
        engine_ms_min,
        load_ms_median,
        load_ms_min,
        preprocess_ms_median,
        preprocess_ms_min,
    })
}

/// What a model answers here, and what it should.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SelfCheck {
    /// Answer to a made-up grasp.
    pub p_stable: f64,
    /// The general engine's answer to the same, where our own one runs the model.
    pub other: Option<f64>,
    /// Model alone, median, ms.
    pub engine_ms: f64,
    /// From the file's bytes to the first answer, ms.
    pub load_ms: f64,
}

/// Predicts a made-up grasp, by both engines where both can.
///
/// # Errors
/// When the model does not load or run.
pub fn self_check(model: &[u8]) -> Result<SelfCheck> {
    let bytes = model;
    let model = Model::from_bytes(bytes)?;
    let input = made_up(&model)?;
    let other = if model.is_on_own_engine() {
        Some(Model::on_tract(bytes)?.predict(&input)?.p_stable)
    } else {
        None
    };
    let runs = (0..SELF_CHECKS)
        .map(|_| model.predict(&input))
        .collect::<Result<Vec<_>>>()?;
    let (_, engine_ms) = min_and_median(runs.iter().map(|run| run.engine_ms).collect());
    Ok(SelfCheck {
        p_stable: runs.first().map_or(f64::NAN, |run| run.p_stable),
        other,
        engine_ms,
        load_ms: model.load_ms(),
    })
}

fn made_up(model: &Model) -> Result<ModelInput> {
    let mut input = ModelInput::zeros(model.contract())?;
    fill(&mut input, model, &pattern(0), &pattern(40))?;
    Ok(input)
}

/// Sets all inputs of a model.
fn fill(input: &mut ModelInput, model: &Model, initial: &RgbImage, grasp: &RgbImage) -> Result<()> {
    for &name in model.contract().variant.inputs() {
        match name {
            InputName::Rgb => input.set_rgb(grasp)?,
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

/// The lower of the two middle values where their number is even.
fn min_and_median(mut values: Vec<f64>) -> (f64, f64) {
    values.sort_by(f64::total_cmp);
    let at = |index: usize| values.get(index).copied().unwrap_or(f64::NAN);
    (at(0), at(values.len().saturating_sub(1) / 2))
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
    fn figures_are_positive_and_named_as_promised() {
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
