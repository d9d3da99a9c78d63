//! Predicts one grasp from images.

use image::RgbImage;

use super::contract::InputName;
use super::engine::{Model, Prediction};
use super::input::ModelInput;
use super::label::{PredictedLabel, contact_doubt};
use super::points::PointMap;
use gripcast_base::error::Result;
use gripcast_imaging::{Depth, DepthView, GelCells, GelChange, TactileDifference};

/// Images for one input of a model, cropped and at the model's size.
#[derive(Clone, Debug)]
pub enum InputImages {
    /// Tactile images of a gel.
    Tactile {
        /// With the gripper open.
        initial: RgbImage,
        /// With the gripper closed.
        grasp: RgbImage,
    },
    /// Colour image with the gripper closed.
    Rgb(RgbImage),
    /// Depth image with the gripper closed, and the camera whose view it shows.
    Depth(Depth, DepthView),
}

/// What a model says of a grasp.
#[derive(Clone, Debug, PartialEq)]
pub struct GraspPrediction {
    /// Output of the model.
    pub prediction: Prediction,
    /// OOD score of the tactile images, 1 at the threshold; `None` where the model has none.
    pub ood_score: Option<f64>,
    /// Label; [`PredictedLabel::Unsure`] also where the images cannot tell.
    pub label: PredictedLabel,
    /// Why the images cannot tell, one sentence.
    pub unsure_reason: Option<String>,
}

impl Model {
    /// Predicts a grasp from the images that there are; `images` gives those of an input.
    ///
    /// # Errors
    /// Those of `images`; `Input` for images of another size; as [`Model::predict`].
    pub fn predict_grasp(
        &self,
        mut images: impl FnMut(InputName) -> Result<Option<InputImages>>,
    ) -> Result<GraspPrediction> {
        let contract = self.contract();
        let mut input = ModelInput::new(contract)?;
        let mut differences = Vec::new();
        let mut changes = Vec::new();
        let mut gels = Vec::new();
        for name in contract.modality.inputs() {
            match images(name)? {
                None => {}
                Some(InputImages::Rgb(image)) => input.set_rgb(&image)?,
                Some(InputImages::Depth(depth, view)) => {
                    input.set_depth(&PointMap::new(&depth, view))?
                }
                Some(InputImages::Tactile { initial, grasp }) => {
                    let difference = TactileDifference::between(&initial, &grasp)?;
                    let (initial, grasp) = (GelCells::new(&initial)?, GelCells::new(&grasp)?);
                    changes.push(GelChange::between(&initial, &grasp, 0.0));
                    gels.push([initial, grasp]);
                    input.set_tactile(name, &difference)?;
                    differences.push(difference);
                }
            }
        }
        let prediction = self.predict(&input)?;
        let ood_score = self
            .ood_detector()
            .and_then(|reference| reference.max_score(&differences));
        let label = PredictedLabel::new(prediction.p_stable, prediction.threshold, ood_score);
        let unsure_reason = match &changes[..] {
            [left, right] => swapped_doubt(&gels, [left, right])
                .or_else(|| contact_doubt([left, right], label == PredictedLabel::Stable)),
            _ => None,
        };
        let label = match unsure_reason {
            Some(_) => PredictedLabel::Unsure,
            None => label,
        };
        Ok(GraspPrediction {
            prediction,
            ood_score,
            label,
            unsure_reason,
        })
    }
}

/// Why the grasp images are those of the other gel, if both are.
fn swapped_doubt(gels: &[[GelCells; 2]], own: [&GelChange; 2]) -> Option<String> {
    let [left, right] = gels else { return None };
    let crossed = [(left, right), (right, left)]
        .map(|([initial, _], [_, grasp])| GelChange::between(initial, grasp, 0.0));
    let is_swapped = (0..2).all(|side| GelChange::is_swapped(own[side], &crossed[side]));
    is_swapped.then(|| {
        "the grasp images of the two gels are swapped: give each gel its own initial image"
            .to_owned()
    })
}
