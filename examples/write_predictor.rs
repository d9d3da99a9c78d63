//! Write a predictor of one's own: an ONNX file under gripcast's model contract, measured on the
//! labelled grasps of a dataset.
//!
//! ```text
//! cargo run --release --example write_predictor -- my-dataset mine.onnx
//! gripcast predict check mine.onnx
//! gripcast collect --model mine.onnx --rig virtual --dataset another
//! ```
//!
//! The model here takes the mean absolute tactile difference of each gel and asks whether the
//! weaker one exceeds a limit. A network goes the same way: `gripcast train` writes such files, and
//! models/README.md lists what the contract demands. Prints, for example, `2 of 3 grasps right`.

use std::path::Path;

use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_base::files::save;
use gripcast_dataset::{Dataset, Outcome, Stage};
use gripcast_imaging::{CropProfile, Decoder, Role, TactileDifference};
use gripcast_nn::predict::contract::{
    INPUT_SHAPE, InputName, InputSpec, Modality, OUTPUT, OUTPUT_SHAPE, Origin,
};
use gripcast_nn::predict::onnx::{Attribute, OnnxGraphBuilder};
use gripcast_nn::predict::{Model, ModelContract, ModelInput};

/// The gels, by their name in a dataset and in a model.
const GELS: [(Role, InputName); 2] = [
    (Role::Left, InputName::TactileLeft),
    (Role::Right, InputName::TactileRight),
];

fn main() -> Result<()> {
    let mut arguments = std::env::args().skip(1);
    let (Some(dataset), Some(out)) = (arguments.next(), arguments.next()) else {
        return Err(Error::new(
            ErrorKind::Usage,
            "name a dataset and the ONNX file to write",
        ));
    };
    save(Path::new(&out), &onnx()?)?;
    let (right, labelled) = accuracy(&Model::load(Path::new(&out))?, &dataset)?;
    println!("{right} of {labelled} grasps right");
    Ok(())
}

/// p_stable = sigmoid(4000·min(left, right) − 20), of differences from 0 to 1.
pub(crate) fn onnx() -> Result<Vec<u8>> {
    let mut graph = OnnxGraphBuilder::new("weaker-gel");
    let contract = ModelContract {
        name: "weaker-gel".into(),
        origin: Origin::Heuristic,
        modality: Modality::T,
        inputs: GELS.map(|(_, name)| InputSpec::tactile(name)).to_vec(),
        threshold: 0.5,
        temperature: 1.0,
        fallbacks: Vec::new(),
        geometry: Vec::new(),
        contact: Vec::new(),
        crop_profile: None,
        card: "Asks whether the weaker contact exceeds a limit. Not trained.".into(),
        other: [("gripcast.licence".into(), "CC0-1.0".into())].into(),
    };
    contract.write(&mut graph)?;
    let mut strengths = Vec::new();
    for (_, gel) in GELS {
        let difference = graph.input(gel.name(), &INPUT_SHAPE)?;
        let change = graph.node("Abs", &format!("{gel}_change"), &[&difference], [])?;
        let flat = [Attribute::int("axis", 1)];
        let flat = graph.node("Flatten", &format!("{gel}_flat"), &[&change], flat)?;
        let over = [Attribute::ints("axes", &[1]), Attribute::int("keepdims", 1)];
        strengths.push(graph.node("ReduceMean", &format!("{gel}_mean"), &[&flat], over)?);
    }
    let weaker = graph.node("Min", "weaker", &[&strengths[0], &strengths[1]], [])?;
    let weight = graph.constant("weight", &[1, 1], &[4000.0])?;
    let bias = graph.constant("bias", &[1], &[-20.0])?;
    let logit = graph.node("Gemm", "logit", &[&weaker, &weight, &bias], [])?;
    let p_stable = graph.node("Sigmoid", OUTPUT, &[&logit], [])?;
    graph.output(&p_stable, &OUTPUT_SHAPE);
    graph.to_bytes()
}

/// How many labelled grasps the model calls right, and how many there are.
pub(crate) fn accuracy(model: &Model, folder: &str) -> Result<(usize, usize)> {
    let dataset = Dataset::open(folder)?;
    let mut decoder = Decoder::new()?;
    let mut input = ModelInput::zeros(model.contract())?;
    let (mut right, mut labelled) = (0, 0);
    for record in dataset.grasps()? {
        let record = record?;
        if record.outcome == Outcome::Unlabelled {
            continue;
        }
        for (role, name) in GELS {
            let crop = record
                .grasp
                .cameras
                .get(&role)
                .and_then(|c| c.crop_profile.as_deref());
            let crop = crop.map(CropProfile::by_name).transpose()?;
            let mut image = |stage| -> Result<_> {
                let frame = dataset.load_frame(&record, stage, role)?;
                Ok(decoder.decode(&frame, crop.as_ref(), 320, 240)?)
            };
            let difference =
                TactileDifference::between(&image(Stage::Initial)?, &image(Stage::Grasp)?)?;
            input.set_tactile(name, &difference)?;
        }
        let says_stable = model.predict(&input)?.p_stable >= model.contract().threshold;
        right += usize::from(says_stable == (record.outcome == Outcome::Stable));
        labelled += 1;
    }
    Ok((right, labelled))
}
