//! Predicts from live images.

use std::time::Instant;

use image::RgbImage;

use super::contract::{InputName, Modality};
use super::engine::Model;
use super::input::ModelInput;
use super::points::PointMap;
use gripcast_base::error::Result;
use gripcast_geometry::GraspGeometry;
use gripcast_imaging::{Depth, DepthView, Role, TactileDifference};

/// A model with the initial images and the newest image of each role.
///
/// All images are 320×240, already cropped with the model's crop profile. The probability is not
/// smoothed.
#[derive(Debug)]
pub struct LivePredictor {
    model: Model,
    input: ModelInput,
    left: Tactile,
    right: Tactile,
    rgb: Option<Image>,
    depth: Option<DepthFrame>,
}

#[derive(Debug)]
struct DepthFrame {
    points: PointMap,
    driver_time_ns: u64,
}

#[derive(Debug, Default)]
struct Tactile {
    initial: Option<RgbImage>,
    newest: Option<Image>,
}

#[derive(Debug)]
struct Image {
    image: RgbImage,
    driver_time_ns: u64,
}

/// A prediction and the times of its frames.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LivePrediction {
    /// Probability that the grasp is stable.
    pub p_stable: f64,
    /// The inputs that it is made from.
    pub modality: Modality,
    /// Minimum probability of a stable grasp.
    pub threshold: f64,
    /// Geometry of the grasp as the model sees it; none without camera images.
    pub geometry: Option<GraspGeometry>,
    /// OOD score of the tactile images (see [`PredictedLabel`](super::PredictedLabel)); none for a
    /// model without OOD detector or touch.
    pub ood_score: Option<f64>,
    /// Inference time of the model, ms.
    pub engine_ms: f64,
    /// Preprocessing time, ms.
    pub preprocess_ms: f64,
    /// Driver time of the newest frame used, `CLOCK_MONOTONIC`, ns.
    pub newest_frame_ns: u64,
    /// Driver time of the oldest frame used, `CLOCK_MONOTONIC`, ns.
    pub oldest_frame_ns: u64,
}

impl LivePredictor {
    /// A predictor without images.
    ///
    /// # Errors
    /// `Internal`: the input tensors cannot be allocated.
    pub fn new(model: Model) -> Result<Self> {
        Ok(Self {
            input: ModelInput::new(model.contract())?,
            model,
            left: Tactile::default(),
            right: Tactile::default(),
            rgb: None,
            depth: None,
        })
    }

    /// The model.
    #[must_use]
    pub fn model(&self) -> &Model {
        &self.model
    }

    /// Sets the initial images, which tactile differences refer to.
    pub fn set_initial(&mut self, left: RgbImage, right: RgbImage) {
        self.left.initial = Some(left);
        self.right.initial = Some(right);
    }

    /// Clears the initial images; a model with touch does not predict until new ones are set.
    pub fn clear_initial(&mut self) {
        self.left.initial = None;
        self.right.initial = None;
    }

    /// Sets the newest image of a camera. Roles without an input are ignored.
    pub fn update(&mut self, role: Role, image: RgbImage, driver_time_ns: u64) {
        let image = Some(Image {
            image,
            driver_time_ns,
        });
        self.set_newest(role, image);
    }

    /// Sets the newest depth image of a view.
    pub fn update_depth(&mut self, depth: &Depth, view: DepthView, driver_time_ns: u64) {
        if self.model.contract().modality.has_depth() {
            self.depth = Some(DepthFrame {
                points: PointMap::new(depth, view),
                driver_time_ns,
            });
        }
    }

    /// Clears the newest image of a lost camera, so that no stale image is used.
    pub fn clear(&mut self, role: Role) {
        self.set_newest(role, None);
    }

    fn set_newest(&mut self, role: Role, image: Option<Image>) {
        match role {
            Role::Left => self.left.newest = image,
            Role::Right => self.right.newest = image,
            Role::Rgb => self.rgb = image,
            Role::Depth => self.depth = None,
            Role::External => {}
        }
    }

    fn is_available(&self, name: InputName) -> bool {
        let both = |t: &Tactile| t.initial.is_some() && t.newest.is_some();
        match name {
            InputName::TactileLeft => both(&self.left),
            InputName::TactileRight => both(&self.right),
            InputName::Rgb => self.rgb.is_some(),
            InputName::Depth => self.depth.is_some(),
        }
    }

    /// Short description of the missing input without which the model cannot predict, if any. A
    /// model with touch does not predict without it: what the cameras show is little.
    #[must_use]
    pub fn missing_input(&self) -> Option<&'static str> {
        let contract = self.model.contract();
        if contract.modality.has_touch() {
            if self.left.initial.is_none() || self.right.initial.is_none() {
                return Some("no initial frame");
            }
            if self.left.newest.is_none() {
                return Some("no left frame");
            }
            if self.right.newest.is_none() {
                return Some("no right frame");
            }
        }
        match contract.output_from(|name| self.is_available(name)) {
            Some(_) => None,
            None if self.rgb.is_none() && contract.modality.has_vision() => Some("no rgb frame"),
            None => Some("no depth frame"),
        }
    }

    /// Predicts from the newest images; `None` while there is a [missing
    /// input](LivePredictor::missing_input).
    pub fn predict(&mut self) -> Option<Result<LivePrediction>> {
        self.missing_input()
            .is_none()
            .then(|| self.predict_newest())
    }

    fn predict_newest(&mut self) -> Result<LivePrediction> {
        let started = Instant::now();
        let (mut newest_frame_ns, mut oldest_frame_ns) = (0, u64::MAX);
        let mut used_time = |driver_time_ns: u64| {
            newest_frame_ns = driver_time_ns.max(newest_frame_ns);
            oldest_frame_ns = driver_time_ns.min(oldest_frame_ns);
        };
        let mut differences = Vec::with_capacity(2);
        let uses = self.model.contract().modality.inputs();
        self.input.clear();
        for (name, tactile) in [
            (InputName::TactileLeft, &self.left),
            (InputName::TactileRight, &self.right),
        ] {
            if let (true, Some(initial), Some(image)) =
                (uses.contains(&name), &tactile.initial, &tactile.newest)
            {
                let difference = TactileDifference::between(initial, &image.image)?;
                self.input.set_tactile(name, &difference)?;
                differences.push(difference);
                used_time(image.driver_time_ns);
            }
        }
        let detector = self.model.ood_detector();
        let ood_score = detector.and_then(|detector| detector.max_score(&differences));
        if let (true, Some(image)) = (uses.contains(&InputName::Rgb), &self.rgb) {
            self.input.set_rgb(&image.image)?;
            used_time(image.driver_time_ns);
        }
        if let (true, Some(depth)) = (uses.contains(&InputName::Depth), &self.depth) {
            self.input.set_depth(&depth.points)?;
            used_time(depth.driver_time_ns);
        }
        let preprocess_ms = started.elapsed().as_secs_f64() * 1e3;
        let prediction = self.model.predict(&self.input)?;
        Ok(LivePrediction {
            p_stable: prediction.p_stable,
            modality: prediction.modality,
            threshold: prediction.threshold,
            geometry: prediction.geometry,
            ood_score,
            engine_ms: prediction.engine_ms,
            preprocess_ms,
            newest_frame_ns,
            oldest_frame_ns,
        })
    }
}

#[cfg(test)]
mod tests {
    use image::Rgb;

    use super::*;
    use crate::predict::contract::{IMAGE_HEIGHT, IMAGE_WIDTH};

    /// Stripes with `contrast` grey levels above the gel's grey.
    fn image(contrast: u8) -> RgbImage {
        RgbImage::from_fn(IMAGE_WIDTH, IMAGE_HEIGHT, |x, _| {
            Rgb([100 + if x / 32 % 2 == 0 { contrast } else { 0 }; 3])
        })
    }

    fn predictor() -> LivePredictor {
        LivePredictor::new(Model::baseline().unwrap()).unwrap()
    }

    #[test]
    fn missing_input_is_reported() {
        let mut live = predictor();
        assert!(live.predict().is_none());
        assert_eq!(live.missing_input(), Some("no initial frame"));
        live.set_initial(image(0), image(0));
        assert_eq!(live.missing_input(), Some("no left frame"));
        live.update(Role::Left, image(0), 10);
        live.update(Role::External, image(0), 11);
        assert_eq!(live.missing_input(), Some("no right frame"));
        live.update(Role::Right, image(0), 12);
        assert_eq!(
            live.missing_input(),
            None,
            "a touch model needs no colour image"
        );
        live.clear_initial();
        assert_eq!(live.missing_input(), Some("no initial frame"));
    }

    #[test]
    fn newest_images_are_used_with_their_times() {
        let mut live = predictor();
        live.set_initial(image(0), image(0));
        live.update(Role::Left, image(0), 40);
        live.update(Role::Right, image(0), 50);
        let open = live.predict().unwrap().unwrap();
        live.update(Role::Left, image(60), 80);
        live.update(Role::Right, image(60), 70);
        live.update(Role::Rgb, image(60), 900);
        let closed = live.predict().unwrap().unwrap();
        assert!(open.p_stable < 0.2 && closed.p_stable > 0.6);
        assert_eq!((closed.newest_frame_ns, closed.oldest_frame_ns), (80, 70));
        live.set_initial(image(60), image(60));
        let again = live.predict().unwrap().unwrap();
        assert_eq!(
            again.p_stable, open.p_stable,
            "difference to the new initial"
        );
        live.clear(Role::Right);
        assert!(live.predict().is_none());
    }

    #[test]
    fn image_of_wrong_size_is_an_error() {
        let mut live = predictor();
        live.set_initial(image(0), image(0));
        live.update(Role::Left, image(0), 1);
        live.update(Role::Right, RgbImage::new(640, 480), 2);
        let error = live.predict().unwrap().unwrap_err();
        assert!(error.to_string().contains("640×480"), "{error}");
    }

    #[test]
    fn live_predictor_is_send() {
        fn assert_send<T: Send>() {}
        assert_send::<LivePredictor>();
    }
}
