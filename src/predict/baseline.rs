//! A hand-written contact-strength heuristic, for use until a trained model exists.
//!
//! It asks one question: do *both* gels show a clear contact, and about the same one? Per sensor:
//! block means of the tactile difference over [`BLOCK_PX`] pixels (averages camera noise out),
//! minus the picture's own mean (cancels an even change of brightness), absolute value, largest
//! channel, the part above [`NOISE_LEVELS`] grey levels, mean over the picture. That excess `s` is
//! squeezed into a strength `s / (s + HALF_EXCESS)` in [0, 1), and
//!
//! `p_stable = sigmoid(BIAS + WEAKER·min(left, right) − IMBALANCE·|left − right|)`.
//!
//! The constants separate no contact from contact on real GelSight pictures; nothing was fitted to
//! the outcome of a lift.

use super::contract::{
    ANY_CROP, INPUT_SHAPE, InputName, InputSpec, ModelContract, OUTPUT, OUTPUT_SHAPE, Origin,
    Variant,
};
use super::onnx::{Attribute, OnnxGraphBuilder, Value};
use crate::error::Result;

/// Side of a block, pixels; averages 64 pixels, so noise falls to an eighth.
const BLOCK_PX: i64 = 8;
/// Change of a block that still counts as noise, grey levels of 255.
const NOISE_LEVELS: f32 = 3.0;
/// Excess at which the strength is one half. The faintest real press at hand (a small ball on a
/// GelSight Mini) has 0.0032, the largest 0.066; camera noise of 4 grey levels has 0.
const HALF_EXCESS: f32 = 0.002;
/// Log-odds without contact: p = 0.05.
const BIAS: f32 = -3.0;
/// Log-odds of a full contact on the weaker side.
const WEAKER: f32 = 6.5;
/// Log-odds taken away by a contact on one side only.
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

/// What the heuristic promises.
#[must_use]
pub fn contract() -> ModelContract {
    ModelContract {
        name: "baseline-contact".to_owned(),
        origin: Origin::Heuristic,
        variant: Variant::T,
        inputs: [InputName::TactileLeft, InputName::TactileRight]
            .map(InputSpec::tactile)
            .to_vec(),
        threshold: 0.5,
        temperature: 1.0,
        crop_profile: ANY_CROP.to_owned(),
        card: CARD.to_owned(),
        other: [("gripcast.licence", "MIT OR Apache-2.0")]
            .map(|(key, value)| (key.to_owned(), value.to_owned()))
            .into(),
    }
}

/// The bytes of `models/baseline-contact.onnx`.
///
/// # Errors
/// A defect of gripcast.
pub fn onnx_bytes() -> Result<Vec<u8>> {
    let mut graph = OnnxGraphBuilder::new("baseline-contact");
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
    let reduce = |axes: &[i64], keepdims: i64| {
        [
            Attribute::ints("axes", axes),
            Attribute::int("keepdims", keepdims),
        ]
    };
    let pool = [
        Attribute::ints("kernel_shape", &[BLOCK_PX; 2]),
        Attribute::ints("strides", &[BLOCK_PX; 2]),
    ];
    let x = graph.input(input.name(), &INPUT_SHAPE)?;
    let blocks = graph.node("AveragePool", &named("blocks"), &[&x], pool)?;
    let over_picture = reduce(&[2, 3], 1);
    let mean = graph.node("ReduceMean", &named("mean"), &[&blocks], over_picture)?;
    let centred = graph.node("Sub", &named("centred"), &[&blocks, &mean], [])?;
    let change = graph.node("Abs", &named("change"), &[&centred], [])?;
    let largest = reduce(&[1], 1);
    let change = graph.node("ReduceMax", &named("largest"), &[&change], largest)?;
    let above = graph.node("Sub", &named("above"), &[&change, &constants.noise], [])?;
    let above = graph.node("Relu", &named("above_noise"), &[&above], [])?;
    let over_picture = reduce(&[2, 3], 0);
    let excess = graph.node("ReduceMean", &named("excess"), &[&above], over_picture)?;
    let sum = [&excess, &constants.half_excess];
    let sum = graph.node("Add", &named("excess_plus_half"), &sum, [])?;
    graph.node("Div", &named("strength"), &[&excess, &sum], [])
}

#[cfg(test)]
mod tests {
    use image::{Rgb, RgbImage};
    use rand::{RngExt as _, SeedableRng as _};
    use rand_pcg::Pcg64Mcg;

    use super::*;
    use crate::predict::contract::{IMAGE_HEIGHT, IMAGE_WIDTH};
    use crate::predict::{Model, ModelInput};

    /// A grey gel with noise; `offset` grey levels brighter than at rest.
    fn gel(seed: u64, noise: i32, offset: i32) -> RgbImage {
        let mut random = Pcg64Mcg::seed_from_u64(seed);
        RgbImage::from_fn(IMAGE_WIDTH, IMAGE_HEIGHT, |_, _| {
            Rgb([110, 120, 130].map(|level: i32| {
                let level = level + offset + random.random_range(-noise..=noise);
                u8::try_from(level).unwrap()
            }))
        })
    }

    /// A ball of `radius` pixels pressed into the gel: shaded red one way, green another.
    fn pressed(mut gel: RgbImage, radius: f32, depth: f32) -> RgbImage {
        for (x, y, pixel) in gel.enumerate_pixels_mut() {
            let (dx, dy) = (x as f32 - 150.0, y as f32 - 118.0);
            if dx.hypot(dy) < radius {
                let shade = |slope: f32, level: u8| {
                    (f32::from(level) + depth * slope / radius).clamp(0.0, 255.0) as u8
                };
                *pixel = Rgb([
                    shade(dx, pixel[0]),
                    shade(dy, pixel[1]),
                    shade(-dx - dy, pixel[2]),
                ]);
            }
        }
        gel
    }

    fn p_stable(left: &RgbImage, right: &RgbImage) -> f64 {
        let model = Model::baseline().unwrap();
        let mut input = ModelInput::zeros(model.contract()).unwrap();
        for (name, grasp, seed) in [
            (InputName::TactileLeft, left, 1),
            (InputName::TactileRight, right, 2),
        ] {
            input.set_tactile(name, &gel(seed, 4, 0), grasp).unwrap();
        }
        model.predict(&input).unwrap().p_stable
    }

    #[test]
    fn the_shipped_file_is_what_this_code_writes() {
        let shipped = include_bytes!("../../models/baseline-contact.onnx");
        assert!(
            shipped == onnx_bytes().unwrap().as_slice(),
            "run `gripcast predict baseline --out models/baseline-contact.onnx`"
        );
    }

    #[test]
    fn the_card_names_the_shipped_file() {
        let card: toml::Table = include_str!("../../models/baseline-contact.toml")
            .parse()
            .unwrap();
        let model = Model::baseline().unwrap();
        assert_eq!(card["sha256"].as_str(), Some(model.sha256()));
        let contract = model.contract();
        assert_eq!(card["threshold"].as_float(), Some(contract.threshold));
        assert_eq!(card["variant"].as_str(), Some(contract.variant.name()));
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
    fn noise_alone_is_no_contact() {
        let p = p_stable(&gel(3, 4, 0), &gel(4, 4, 0));
        assert!(p < 0.06, "{p}");
    }

    #[test]
    fn an_even_change_of_brightness_is_no_contact() {
        let p = p_stable(&gel(3, 4, 12), &gel(4, 4, -12));
        assert!(p < 0.06, "{p}");
    }

    #[test]
    fn contact_on_both_sides_is_stable() {
        let press = |seed| pressed(gel(seed, 4, 0), 40.0, 45.0);
        let p = p_stable(&press(3), &press(4));
        assert!(p > 0.6, "{p}");
    }

    #[test]
    fn contact_on_one_side_is_below_the_threshold() {
        let press = |seed| pressed(gel(seed, 4, 0), 90.0, 80.0);
        for (left, right) in [(press(3), gel(4, 4, 0)), (gel(3, 4, 0), press(4))] {
            let p = p_stable(&left, &right);
            assert!(p < contract().threshold / 2.0, "{p}");
        }
    }

    #[test]
    fn a_stronger_contact_is_never_worse() {
        let press = |seed, depth| pressed(gel(seed, 4, 0), 40.0, depth);
        let mut last = 0.0;
        for depth in [0.0, 15.0, 30.0, 60.0] {
            let p = p_stable(&press(3, depth), &press(4, depth));
            assert!(p >= last, "{depth}: {p} after {last}");
            last = p;
        }
    }
}
