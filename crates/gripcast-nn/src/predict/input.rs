//! Converts images to the input tensors of a model.

use std::sync::Arc;

use image::RgbImage;
use tract_onnx::prelude::{TValue, Tensor};

use super::contract::{
    IMAGE_HEIGHT, IMAGE_WIDTH, InputName, InputSpec, Modality, ModelContract, RgbNormalisation,
};
use super::points::PointMap;
use gripcast_base::error::{Error, Result};
use gripcast_imaging::TactileDifference;

const PIXELS: usize = IMAGE_WIDTH as usize * IMAGE_HEIGHT as usize;

/// Input tensors of a prediction, each `[1, 3, 240, 320]` NCHW f32.
///
/// An input is available once it is set; a model predicts from those that are. Reuse it between
/// predictions: the engine reads the memory without a copy.
#[derive(Clone, Debug)]
pub struct ModelInput {
    planes: Vec<Plane>,
    normalisation: Option<RgbNormalisation>,
}

#[derive(Clone, Debug)]
struct Plane {
    name: InputName,
    tensor: InputTensor,
    is_available: bool,
}

impl ModelInput {
    /// Creates the inputs of a model; none is available.
    ///
    /// # Errors
    /// `Internal`: the memory cannot be allocated.
    pub fn new(contract: &ModelContract) -> Result<Self> {
        let plane = |name| {
            Ok(Plane {
                name,
                tensor: InputTensor::zeros()?,
                is_available: false,
            })
        };
        let inputs = contract.modality.inputs().into_iter();
        Ok(Self {
            planes: inputs.map(plane).collect::<Result<_>>()?,
            normalisation: contract
                .input(InputName::Rgb)
                .and_then(InputSpec::normalisation),
        })
    }

    /// Zeros for every input of the model: no tactile difference, the mean colour, no depth.
    ///
    /// # Errors
    /// `Internal`: the memory cannot be allocated.
    pub fn zeros(contract: &ModelContract) -> Result<Self> {
        let mut input = Self::new(contract)?;
        for plane in &mut input.planes {
            plane.is_available = true;
        }
        Ok(input)
    }

    /// Whether an input is set.
    #[must_use]
    pub fn is_available(&self, name: InputName) -> bool {
        let mut planes = self.planes.iter();
        planes.any(|plane| plane.name == name && plane.is_available)
    }

    /// Marks inputs that a modality does not have as missing.
    pub fn keep(&mut self, inputs: Modality) {
        for plane in &mut self.planes {
            plane.is_available &= inputs.has(plane.name);
        }
    }

    /// Marks all inputs as missing.
    pub fn clear(&mut self) {
        for plane in &mut self.planes {
            plane.is_available = false;
        }
    }

    /// Writes the depth image. Ignored by models without depth.
    ///
    /// # Errors
    /// `Internal`: the memory cannot be written.
    pub fn set_depth(&mut self, points: &PointMap) -> Result<()> {
        match self.tensor_mut(InputName::Depth) {
            Some(tensor) => tensor.write(|planes| {
                points.write_planes(planes);
                Ok(())
            }),
            None => Ok(()),
        }
    }

    /// Writes a tactile difference, (grasp − initial) / 255. Ignored by models without touch.
    ///
    /// # Errors
    /// `Input`: the images are not 320×240.
    pub fn set_tactile(&mut self, name: InputName, difference: &TactileDifference) -> Result<()> {
        check_size(name, difference.width(), difference.height())?;
        match self.tensor_mut(name) {
            Some(tensor) => tensor.write(|planes| difference.write_chw(planes)),
            None => Ok(()),
        }
    }

    /// Writes the colour image, (x / 255 − mean) / std. Ignored by models without vision.
    ///
    /// # Errors
    /// `Input`: the image is not 320×240.
    pub fn set_rgb(&mut self, image: &RgbImage) -> Result<()> {
        check_size(InputName::Rgb, image.width(), image.height())?;
        match (self.normalisation, self.tensor_mut(InputName::Rgb)) {
            (Some(normalisation), Some(tensor)) => tensor.write(|planes| {
                write_normalised(image.as_raw(), normalisation, planes);
                Ok(())
            }),
            _ => Ok(()),
        }
    }

    /// Values of an input, 3·240·320; `None` if it is not available.
    pub fn values(&self, name: InputName) -> Option<&[f32]> {
        self.is_available(name)
            .then(|| self.tensor(name)?.values())
            .flatten()
    }

    /// The tensor of an input, also of one that is not available.
    pub(super) fn tensor(&self, name: InputName) -> Option<&InputTensor> {
        let mut planes = self.planes.iter();
        planes.find_map(|plane| (plane.name == name).then_some(&plane.tensor))
    }

    /// The tensor of an input to write, which makes it available.
    fn tensor_mut(&mut self, name: InputName) -> Option<&mut InputTensor> {
        let plane = self.planes.iter_mut().find(|plane| plane.name == name)?;
        plane.is_available = true;
        Some(&mut plane.tensor)
    }
}

/// A tensor that is shared with the engine while it runs.
#[derive(Clone, Debug)]
pub(super) struct InputTensor(Arc<Tensor>);

impl InputTensor {
    fn zeros() -> Result<Self> {
        let shape = [1, 3, IMAGE_HEIGHT as usize, IMAGE_WIDTH as usize];
        let tensor = Tensor::zero::<f32>(&shape).map_err(defect)?;
        Ok(Self(Arc::new(tensor)))
    }

    pub(super) fn to_tvalue(&self) -> TValue {
        TValue::from_const(self.0.clone())
    }

    fn values(&self) -> Option<&[f32]> {
        self.0.try_as_plain_ram().ok()?.as_slice().ok()
    }

    /// Writes the values; copies the memory first if the engine still uses it.
    fn write(&mut self, fill: impl FnOnce(&mut [f32]) -> Result<()>) -> Result<()> {
        let tensor = Arc::make_mut(&mut self.0);
        let mut view = tensor.try_as_plain_ram_mut().map_err(defect)?;
        fill(view.as_slice_mut().map_err(defect)?)
    }
}

fn defect(cause: impl std::fmt::Display) -> Error {
    Error::internal(format!("cannot create an input tensor: {cause}"))
}

fn check_size(name: InputName, width: u32, height: u32) -> Result<()> {
    if (width, height) == (IMAGE_WIDTH, IMAGE_HEIGHT) {
        return Ok(());
    }
    Err(Error::input(format!(
        "image for `{name}`: expected {IMAGE_WIDTH}×{IMAGE_HEIGHT} pixels, found \
             {width}×{height}"
    ))
    .remedy("crop and resize the image with the model's crop profile first"))
}

/// Converts interleaved 8-bit RGB to normalised planes.
fn write_normalised(pixels: &[u8], normalisation: RgbNormalisation, planes: &mut [f32]) {
    for (channel, plane) in planes.chunks_exact_mut(PIXELS).enumerate() {
        let (mean, std) = (normalisation.mean[channel], normalisation.std[channel]);
        let table: [f32; 256] = std::array::from_fn(|x| (x as f32 / 255.0 - mean) / std);
        for (value, pixel) in plane.iter_mut().zip(pixels.as_chunks::<3>().0) {
            *value = table[usize::from(pixel[channel])];
        }
    }
}

#[cfg(test)]
mod tests {
    use image::Rgb;

    use super::*;
    use crate::predict::baseline;

    fn image(colour: [u8; 3]) -> RgbImage {
        RgbImage::from_pixel(IMAGE_WIDTH, IMAGE_HEIGHT, Rgb(colour))
    }

    fn touch_and_vision() -> ModelContract {
        let normalisation = RgbNormalisation {
            mean: [0.5, 0.25, 0.125],
            std: [0.5, 0.25, 2.0],
        };
        let mut contract = baseline::contract();
        contract.modality = Modality::Vt;
        contract.inputs.push(InputSpec::rgb(normalisation));
        contract
    }

    #[test]
    fn pixel_is_written_as_the_contract_states() {
        let mut initial = image([100, 100, 100]);
        let mut grasp = initial.clone();
        initial.put_pixel(7, 3, Rgb([0, 255, 10]));
        grasp.put_pixel(7, 3, Rgb([255, 0, 61]));
        let mut input = ModelInput::zeros(&baseline::contract()).unwrap();
        let difference = TactileDifference::between(&initial, &grasp).unwrap();
        input
            .set_tactile(InputName::TactileRight, &difference)
            .unwrap();
        let values = input.values(InputName::TactileRight).unwrap();
        let index = 3 * IMAGE_WIDTH as usize + 7;
        assert_eq!(values[index], 1.0, "red, grasp minus initial");
        assert_eq!(values[PIXELS + index], -1.0, "green is the second plane");
        assert_eq!(
            values[2 * PIXELS + index],
            51.0 / 255.0,
            "blue is the third"
        );
        assert_eq!(values.iter().filter(|&&v| v != 0.0).count(), 3);
        let left = input.values(InputName::TactileLeft).unwrap();
        assert!(
            left.iter().all(|&v| v == 0.0),
            "the other sensor is unchanged"
        );
    }

    #[test]
    fn channels_are_not_swapped() {
        let mut input = ModelInput::zeros(&touch_and_vision()).unwrap();
        input.set_rgb(&image([255, 0, 51])).unwrap();
        let values = input.values(InputName::Rgb).unwrap();
        let expected = [
            (1.0 - 0.5) / 0.5,
            (0.0 - 0.25) / 0.25,
            (51.0 / 255.0 - 0.125) / 2.0,
        ];
        for (plane, expected) in values.chunks_exact(PIXELS).zip(expected) {
            assert!(plane.iter().all(|&v| v == expected), "{expected}");
        }
    }

    #[test]
    fn images_of_wrong_size_are_refused() {
        let mut input = ModelInput::zeros(&baseline::contract()).unwrap();
        let rotated = RgbImage::new(240, 320);
        let difference = TactileDifference::between(&rotated, &rotated).unwrap();
        let error = input
            .set_tactile(InputName::TactileLeft, &difference)
            .unwrap_err();
        assert!(
            error
                .to_string()
                .contains("`tactile_left`: expected 320×240 pixels, found 240×320"),
            "{error}"
        );
        assert!(input.set_rgb(&rotated).is_err());
    }

    #[test]
    fn model_without_vision_ignores_the_colour_image() {
        let mut input = ModelInput::zeros(&baseline::contract()).unwrap();
        input.set_rgb(&image([9; 3])).unwrap();
        assert_eq!(input.values(InputName::Rgb), None);
    }

    #[test]
    fn memory_used_by_the_engine_is_not_overwritten() {
        let mut input = ModelInput::zeros(&baseline::contract()).unwrap();
        let held = input.tensor(InputName::TactileLeft).unwrap().to_tvalue();
        let difference = TactileDifference::between(&image([0; 3]), &image([255; 3]));
        input
            .set_tactile(InputName::TactileLeft, &difference.unwrap())
            .unwrap();
        let held = held.try_as_plain_ram().unwrap();
        assert!(held.as_slice::<f32>().unwrap().iter().all(|&v| v == 0.0));
        let written = input.values(InputName::TactileLeft).unwrap();
        assert!(written.iter().all(|&v| v == 1.0));
    }
}
