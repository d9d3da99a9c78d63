//! A hand-written contact-strength heuristic, the baseline for trained models.
//!
//! It checks whether *both* gels show a clear contact of about equal strength. Per sensor: means of
//! the tactile difference over small patches (reduces camera noise), minus the mean of the channel
//! (cancels uniform brightness changes), absolute value, excess over `NOISE_LEVELS` grey levels,
//! mean over patches and channels. This excess `s` is mapped to a strength `s / (s + HALF_EXCESS)`
//! in
//! [0, 1), and
//!
//! `p_stable = sigmoid(BIAS + WEAKER·min(left, right) − IMBALANCE·|left − right|)`.
//!
//! The constants separate no contact from contact on real GelSight images; they were not fitted to
//! outcomes.

use super::contract::{
    INPUT_SHAPE, InputName, InputSpec, Modality, ModelContract, OUTPUT, OUTPUT_SHAPE, Origin,
};
use super::onnx::{Attribute, OnnxGraphBuilder, Value};
use gripcast_base::error::Result;

/// Name of the heuristic, `models/baseline-contact.onnx`.
pub const BASELINE: &str = "baseline-contact";

/// Patch size, pixels; averaging 16 pixels reduces noise to a quarter.
const PATCH_PX: i64 = 4;
/// Stride of patches, pixels. A contact spans several.
const STRIDE_PX: i64 = 8;
/// Maximum change of a patch that counts as noise, grey levels of 255.
const NOISE_LEVELS: f32 = 4.0;
/// Excess at which the strength is one half. The weakest real press available (a small ball on a
/// GelSight Mini) has 0.0017, the strongest 0.033; camera noise of 4 grey levels has 0.00001.
const HALF_EXCESS: f32 = 0.001;
/// Log-odds without contact: p = 0.05.
const BIAS: f32 = -3.0;
/// Log-odds per contact strength of the weaker side.
const WEAKER: f32 = 6.5;
/// Log-odds subtracted per difference of the contact strengths.
const IMBALANCE: f32 = 1.5;

const CARD: &str = "\
# baseline-contact

A contact-strength HEURISTIC written by hand. It is not trained and was never measured on the outcome \
of a lift: its `p_stable` says how clearly and how evenly both gels are in contact, nothing else.

- Use: a live gauge until a trained model exists; to see that both sensors and the whole path work.
- Not for: claims about stability. It knows neither weight, friction, shape nor pose, and a strong \
contact at the edge of an object scores as high as one at its centre.
- Data: none. Constants separate real ball presses on GelSight sensors from no contact.
- Limits: markers that move and strong uneven light changes look like contact.
- Licence: MIT OR Apache-2.0.
";

/// Contract of the heuristic.
#[must_use]
pub fn contract() -> ModelContract {
    ModelContract {
        name: BASELINE.to_owned(),
        origin: Origin::Heuristic,
        modality: Modality::T,
        inputs: [InputName::TactileLeft, InputName::TactileRight]
            .map(InputSpec::tactile)
            .to_vec(),
        threshold: 0.5,
        temperature: 1.0,
        fallbacks: Vec::new(),
        geometry: Vec::new(),
        contact: Vec::new(),
        crop_profile: None,
        card: CARD.to_owned(),
        other: [("gripcast.licence", "MIT OR Apache-2.0")]
            .map(|(key, value)| (key.to_owned(), value.to_owned()))
            .into(),
    }
}

/// Encodes `models/baseline-contact.onnx`.
///
/// # Errors
/// `Internal`: a defect of gripcast.
pub fn onnx_bytes() -> Result<Vec<u8>> {
    let mut graph = OnnxGraphBuilder::new(BASELINE);
    graph.description("Contact-strength heuristic, not trained");
    contract().write(&mut graph)?;
    let constants = Constants::write(&mut graph)?;
    let left = strength(&mut graph, InputName::TactileLeft, &constants)?;
    let right = strength(&mut graph, InputName::TactileRight, &constants)?;
    let weaker = graph.node("Min", "weaker", &[&left, &right], [])?;
    let difference = graph.node("Sub", "difference", &[&left, &right], [])?;
    let imbalance = graph.node("Abs", "imbalance", &[&difference], [])?;
    let axis = [Attribute::int("axis", 1)];
    let features = graph.node("Concat", "features", &[&weaker, &imbalance], axis)?;
    let weights = graph.constant("logit_weights", &[2, 1], &[WEAKER, -IMBALANCE])?;
    let bias = graph.constant("logit_bias", &[1], &[BIAS])?;
    let logit = graph.node("Gemm", "logit", &[&features, &weights, &bias], [])?;
    let p_stable = graph.node("Sigmoid", OUTPUT, &[&logit], [])?;
    graph.output(&p_stable, &OUTPUT_SHAPE);
    graph.to_bytes()
}

/// Constants shared by both sensors.
struct Constants {
    noise: Value,
    half_excess: Value,
}

impl Constants {
    fn write(graph: &mut OnnxGraphBuilder) -> Result<Self> {
        Ok(Self {
            noise: graph.constant("noise", &[1], &[NOISE_LEVELS / 255.0])?,
            half_excess: graph.constant("half_excess", &[1], &[HALF_EXCESS])?,
        })
    }
}

/// Contact strength of one sensor, `[1, 1]`, in [0, 1).
fn strength(
    graph: &mut OnnxGraphBuilder,
    input: InputName,
    constants: &Constants,
) -> Result<Value> {
    let named = |step: &str| format!("{input}_{step}");
    let over = |axes: &[i64], keepdims: i64| {
        [
            Attribute::ints("axes", axes),
            Attribute::int("keepdims", keepdims),
        ]
    };
    let pool = [
        Attribute::ints("kernel_shape", &[PATCH_PX; 2]),
        Attribute::ints("strides", &[STRIDE_PX; 2]),
    ];
    let x = graph.input(input.name(), &INPUT_SHAPE)?;
    let patches = graph.node("AveragePool", &named("patches"), &[&x], pool)?;
    let mean = graph.node("ReduceMean", &named("mean"), &[&patches], over(&[2, 3], 1))?;
    let centred = graph.node("Sub", &named("centred"), &[&patches, &mean], [])?;
    let change = graph.node("Abs", &named("change"), &[&centred], [])?;
    let above = graph.node("Sub", &named("above"), &[&change, &constants.noise], [])?;
    let above = graph.node("Relu", &named("above_noise"), &[&above], [])?;
    let flat = [Attribute::int("axis", 1)];
    let above = graph.node("Flatten", &named("above_flat"), &[&above], flat)?;
    let excess = graph.node("ReduceMean", &named("excess"), &[&above], over(&[1], 1))?;
    let sum = [&excess, &constants.half_excess];
    let sum = graph.node("Add", &named("excess_plus_half"), &sum, [])?;
    graph.node("Div", &named("strength"), &[&excess, &sum], [])
}

#[cfg(test)]
mod tests {
    use image::RgbImage;

    use super::*;
    use crate::predict::contract::{IMAGE_HEIGHT, IMAGE_WIDTH};
    use crate::predict::{Model, ModelInput};
    use gripcast_imaging::{TactileDifference, synthetic_gel};

    fn gel(seed: u64, contact: f32) -> RgbImage {
        synthetic_gel(IMAGE_WIDTH, IMAGE_HEIGHT, seed, contact)
    }

    fn brighter(mut image: RgbImage, levels: i16) -> RgbImage {
        for level in image.iter_mut() {
            *level = (i16::from(*level) + levels).clamp(0, 255) as u8;
        }
        image
    }

    fn p_stable(left: &RgbImage, right: &RgbImage) -> f64 {
        let model = Model::baseline().unwrap();
        let mut input = ModelInput::zeros(model.contract()).unwrap();
        for (name, grasp, seed) in [
            (InputName::TactileLeft, left, 1),
            (InputName::TactileRight, right, 2),
        ] {
            let difference = TactileDifference::between(&gel(seed, 0.0), grasp).unwrap();
            input.set_tactile(name, &difference).unwrap();
        }
        model.predict(&input).unwrap().p_stable
    }

    #[test]
    fn shipped_file_matches_this_code() {
        let shipped = include_bytes!("../../../../models/baseline-contact.onnx");
        assert!(
            shipped == onnx_bytes().unwrap().as_slice(),
            "run `gripcast predict baseline --out models/baseline-contact.onnx`"
        );
    }

    #[test]
    fn card_matches_the_shipped_file() {
        let card: toml::Table = include_str!("../../../../models/baseline-contact.toml")
            .parse()
            .unwrap();
        let model = Model::baseline().unwrap();
        assert_eq!(card["sha256"].as_str(), Some(model.sha256()));
        let contract = model.contract();
        assert_eq!(card["threshold"].as_float(), Some(contract.threshold));
        assert_eq!(card["modality"].as_str(), Some(contract.modality.name()));
        assert_eq!(card["name"].as_str(), Some(contract.name.as_str()));
        let named: Vec<_> = card["inputs"].as_array().unwrap().iter().collect();
        assert_eq!(named.len(), contract.inputs.len());
        for (input, spec) in named.iter().zip(&contract.inputs) {
            assert_eq!(input["name"].as_str(), Some(spec.name.name()));
            assert_eq!(input["formula"].as_str(), Some(spec.formula.as_str()));
            let shape: Vec<_> = input["shape"].as_array().unwrap().iter().collect();
            let shape: Vec<_> = shape.iter().filter_map(|d| d.as_integer()).collect();
            assert_eq!(shape, spec.shape);
        }
    }

    #[test]
    fn noise_is_not_contact() {
        let p = p_stable(&gel(3, 0.0), &gel(4, 0.0));
        assert!(p < 0.06, "{p}");
    }

    #[test]
    fn uniform_brightness_change_is_not_contact() {
        let p = p_stable(&brighter(gel(3, 0.0), 12), &brighter(gel(4, 0.0), -12));
        assert!(p < 0.06, "{p}");
    }

    #[test]
    fn contact_on_both_sides_is_stable() {
        let p = p_stable(&gel(3, 0.6), &gel(4, 0.6));
        assert!(p > 0.6, "{p}");
    }

    #[test]
    fn contact_on_one_side_is_below_threshold() {
        for (left, right) in [(1.0, 0.0), (0.0, 1.0)] {
            let p = p_stable(&gel(3, left), &gel(4, right));
            assert!(p < contract().threshold / 2.0, "{p}");
        }
    }

    #[test]
    fn p_stable_increases_with_contact() {
        let mut last = 0.0;
        for contact in [0.0, 0.1, 0.3, 0.6, 1.0] {
            let p = p_stable(&gel(3, contact), &gel(4, contact));
            assert!(p >= last, "{contact}: {p} after {last}");
            last = p;
        }
    }
}
