//! Our own engine for the networks that gripcast trains: a few operators, on the processor's widest
//! vectors. Graphs with anything else in them are left to the general engine.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Mutex, PoisonError};

use tract_onnx::pb::tensor_proto::DataType;
use tract_onnx::pb::{GraphProto, ModelProto, NodeProto, TensorProto};

use super::contract::{IMAGE_HEIGHT, IMAGE_WIDTH, InputName, OUTPUT};
use super::input::ModelInput;
use crate::{ConvShape, Convolution, Dense, Padded};

/// Height, width and channels of an input.
const INPUT: [usize; 3] = [IMAGE_HEIGHT as usize, IMAGE_WIDTH as usize, 3];

/// Widest padding of our networks' convolutions, pixels, and then some.
const MOST_BORDER: usize = 16;

/// What is done, in order.
#[derive(Debug)]
enum Step {
    /// Planes of an input into a picture.
    Convert { from: InputName, to: usize },
    /// A convolution of an input's planes.
    ConvolvePlanes {
        layer: usize,
        from: InputName,
        to: usize,
    },
    /// A convolution of a picture.
    Convolve {
        layer: usize,
        from: usize,
        to: usize,
    },
    /// Means over windows.
    Pool {
        window: [usize; 2],
        from: usize,
        to: usize,
    },
    /// A dense layer of one or more rows of numbers, each into one of its own.
    Dense {
        layer: usize,
        from: Vec<usize>,
        to: Vec<usize>,
    },
    /// Numbers one after the other.
    Join { from: Vec<usize>, to: usize },
}

/// Where a value of the graph is while it runs.
#[derive(Clone, Debug)]
enum Place {
    Input(InputName),
    Picture(usize),
    /// Numbers; those of a pooled picture lie HWC here, CHW in the graph: pixels and channels.
    Numbers {
        at: usize,
        length: usize,
        pooled: Option<[usize; 2]>,
    },
}

/// A network that is ready to run.
#[derive(Debug)]
pub(super) struct Plan {
    steps: Vec<Step>,
    convolutions: Vec<Convolution>,
    layers: Vec<Dense>,
    /// Where the logit is.
    logit: usize,
    empty: Memory,
    /// Memory of runs that have ended.
    free: Mutex<Vec<Memory>>,
}

/// What a run writes.
#[derive(Clone, Debug, Default)]
struct Memory {
    pictures: Vec<Padded>,
    numbers: Vec<Vec<f32>>,
    /// Rows of a dense layer, and what it gives for them.
    joined: Vec<f32>,
    results: Vec<f32>,
}

impl Plan {
    /// The plan of a graph; none where it has an operator, or an operator a form, that is not of
    /// our networks.
    pub(super) fn of(model: &ModelProto) -> Option<Self> {
        let graph = model.graph.as_ref()?;
        Builder::new(graph).build()
    }

    /// The probability that the model gives; none where an input is missing.
    pub(super) fn run(&self, input: &ModelInput) -> Option<f32> {
        let free = || self.free.lock().unwrap_or_else(PoisonError::into_inner);
        let mut memory = free().pop().unwrap_or_else(|| self.empty.clone());
        let logit = self.logit(input, &mut memory);
        free().push(memory);
        logit.map(|x| 1.0 / (1.0 + (-x).exp()))
    }

    fn logit(&self, input: &ModelInput, memory: &mut Memory) -> Option<f32> {
        let Memory {
            pictures,
            numbers,
            joined,
            results,
        } = memory;
        for step in &self.steps {
            match step {
                Step::Convert { from, to } => pictures[*to].set_planes(input.values(*from)?),
                Step::ConvolvePlanes { layer, from, to } => {
                    let planes = input.values(*from)?;
                    self.convolutions[*layer].of_planes(planes, &mut pictures[*to]);
                }
                // Places are handed out in order: what is read lies before what is written.
                Step::Convolve { layer, from, to } => {
                    let (before, after) = pictures.split_at_mut(*to);
                    self.convolutions[*layer].of(&before[*from], &mut after[0]);
                }
                Step::Pool { window, from, to } => {
                    pictures[*from].pooled(*window, &mut numbers[*to]);
                }
                Step::Dense { layer, from, to } => {
                    joined.clear();
                    for at in from {
                        joined.extend_from_slice(&numbers[*at]);
                    }
                    let layer = &self.layers[*layer];
                    layer.of(joined, results);
                    for (at, result) in to.iter().zip(results.chunks_exact(layer.outputs())) {
                        numbers[*at].clear();
                        numbers[*at].extend_from_slice(result);
                    }
                }
                Step::Join { from, to } => {
                    let (before, after) = numbers.split_at_mut(*to);
                    after[0].clear();
                    for at in from {
                        after[0].extend_from_slice(&before[*at]);
                    }
                }
            }
        }
        numbers[self.logit].first().copied()
    }
}

/// Follows the nodes of a graph.
struct Builder<'a> {
    graph: &'a GraphProto,
    constants: BTreeMap<&'a str, &'a TensorProto>,
    places: BTreeMap<&'a str, Place>,
    /// Nodes that read a value.
    readers: BTreeMap<&'a str, Vec<&'a NodeProto>>,
    /// Layers by the constants that they were made of: sensors share their encoder.
    known: BTreeMap<(&'a str, &'a str, bool), usize>,
    skipped: BTreeSet<&'a str>,
    plan: Plan,
}

impl<'a> Builder<'a> {
    fn new(graph: &'a GraphProto) -> Self {
        let constants = graph.initializer.iter().map(|c| (&*c.name, c)).collect();
        let mut readers: BTreeMap<&str, Vec<&NodeProto>> = BTreeMap::new();
        for node in &graph.node {
            for input in &node.input {
                readers.entry(input).or_default().push(node);
            }
        }
        Self {
            graph,
            constants,
            places: BTreeMap::new(),
            readers,
            known: BTreeMap::new(),
            skipped: BTreeSet::new(),
            plan: Plan {
                steps: Vec::new(),
                convolutions: Vec::new(),
                layers: Vec::new(),
                logit: 0,
                empty: Memory::default(),
                free: Mutex::default(),
            },
        }
    }

    fn build(mut self) -> Option<Plan> {
        for input in &self.graph.input {
            let names = [
                InputName::TactileLeft,
                InputName::TactileRight,
                InputName::Rgb,
            ];
            let name = names.into_iter().find(|name| name.name() == input.name)?;
            self.places.insert(&input.name, Place::Input(name));
        }
        let graph = self.graph;
        for node in &graph.node {
            let [output] = &node.output[..] else {
                return None;
            };
            if self.skipped.contains(&**output) {
                continue;
            }
            if node.op_type == "Sigmoid" {
                // The last node: the probability.
                let at = self.numbers(node.input.first()?)?;
                let is_last = output == OUTPUT && !self.readers.contains_key(&**output);
                self.plan.logit = at;
                return is_last.then_some(self.plan);
            }
            let place = match &*node.op_type {
                "Conv" => self.convolution(node)?,
                "AveragePool" => self.pool(node)?,
                "Flatten" => self.flatten(node)?,
                "Gemm" => self.dense(node)?,
                "Concat" => self.join(node)?,
                _ => return None,
            };
            let name = self.rectified(node).unwrap_or(output);
            self.places.insert(name, place);
        }
        None
    }

    /// The output of the ReLU behind a node, if nothing else reads what the node gives.
    fn rectified(&mut self, node: &'a NodeProto) -> Option<&'a str> {
        let [relu] = self.readers.get(node.output.first()?.as_str())?[..] else {
            return None;
        };
        let output = relu.output.first()?;
        let is_layer = matches!(&*node.op_type, "Conv" | "Gemm");
        (is_layer && relu.op_type == "Relu").then(|| {
            self.skipped.insert(output);
            &**output
        })
    }

    fn is_rectified(&self, node: &NodeProto) -> bool {
        let output = node.output.first().map(String::as_str).unwrap_or_default();
        let readers = self.readers.get(output);
        readers.is_some_and(|found| matches!(found[..], [relu] if relu.op_type == "Relu"))
    }

    fn numbers(&self, name: &str) -> Option<usize> {
        match self.places.get(name)? {
            Place::Numbers {
                at, pooled: None, ..
            } => Some(*at),
            _ => None,
        }
    }

    fn new_picture(&mut self, size: [usize; 3], border: usize) -> usize {
        let pictures = &mut self.plan.empty.pictures;
        pictures.push(Padded::new(size, border));
        pictures.len() - 1
    }

    fn new_numbers(&mut self) -> usize {
        let numbers = &mut self.plan.empty.numbers;
        numbers.push(Vec::new());
        numbers.len() - 1
    }

    /// Widest padding of the convolutions that read what a node gives, through a ReLU.
    fn border(&self, name: &str) -> usize {
        let readers = self.readers.get(name).into_iter().flatten();
        let widest = readers.map(|node| match &*node.op_type {
            "Conv" => ints(node, "pads")
                .and_then(|pads| pads.iter().copied().max())
                .unwrap_or(0),
            "Relu" => node.output.first().map_or(0, |output| self.border(output)),
            _ => 0,
        });
        widest.max().unwrap_or(0).min(MOST_BORDER)
    }

    fn convolution(&mut self, node: &'a NodeProto) -> Option<Place> {
        let [x, weight, bias] = &node.input[..] else {
            return None;
        };
        let from = self.places.get(&**x)?.clone();
        let (size, border) = match &from {
            Place::Input(_) => (INPUT, MOST_BORDER),
            Place::Picture(at) => {
                let picture = &self.plan.empty.pictures[*at];
                (picture.size(), picture.border())
            }
            Place::Numbers { .. } => return None,
        };
        let constant = self.constants.get(&**weight)?;
        let &[outputs, inputs, tall, wide] = &dims(constant)?[..] else {
            return None;
        };
        let same = |name: &str, missing: usize| same(node, name, missing);
        let shape = ConvShape {
            input: size,
            channels: outputs,
            kernel: tall,
            stride: same("strides", 1)?,
            pad: same("pads", 0)?,
        };
        let is_plain = tall == wide
            && inputs == size[2]
            && same("dilations", 1)? == 1
            && same("kernel_shape", tall)? == tall
            && only(
                node,
                &["strides", "pads", "dilations", "kernel_shape", "group"],
            )
            && int(node, "group", 1) == 1
            && shape.stride > 0
            && tall * outputs > 0
            && shape.pad <= border
            && size[0] + 2 * shape.pad >= tall
            && size[1] + 2 * shape.pad >= tall;
        if !is_plain {
            return None;
        }
        let key = (&**weight, &**bias, self.is_rectified(node));
        let layer = match self.known.get(&key) {
            Some(layer) if *self.plan.convolutions[*layer].shape() == shape => *layer,
            _ => {
                let values = floats(constant)?;
                let rows = (0..tall * wide).flat_map(|at| (0..inputs).map(move |i| (at, i)));
                let weights: Vec<f32> = rows
                    .flat_map(|(at, input)| {
                        let values = &values;
                        (0..outputs).map(move |o| values[(o * inputs + input) * tall * wide + at])
                    })
                    .collect();
                let bias = floats(self.constants.get(&**bias)?)?;
                if bias.len() != outputs {
                    return None;
                }
                let layers = &mut self.plan.convolutions;
                layers.push(Convolution::new(shape, &weights, bias, key.2));
                self.known.insert(key, layers.len() - 1);
                layers.len() - 1
            }
        };
        let is_planar = self.plan.convolutions[layer].reads_planes();
        let from = match from {
            Place::Input(from) if !is_planar => {
                let to = self.new_picture(INPUT, shape.pad);
                self.plan.steps.push(Step::Convert { from, to });
                Place::Picture(to)
            }
            other => other,
        };
        let border = self.border(node.output.first()?);
        let to = self.new_picture(shape.output(), border);
        self.plan.steps.push(match from {
            Place::Input(from) => Step::ConvolvePlanes { layer, from, to },
            Place::Picture(from) => Step::Convolve { layer, from, to },
            Place::Numbers { .. } => return None,
        });
        Some(Place::Picture(to))
    }

    fn pool(&mut self, node: &'a NodeProto) -> Option<Place> {
        let Place::Picture(from) = *self.places.get(node.input.first()?.as_str())? else {
            return None;
        };
        let &[tall, wide] = &ints(node, "kernel_shape")?[..] else {
            return None;
        };
        let is_plain = ints(node, "strides")? == [tall, wide]
            && same(node, "pads", 0)? == 0
            && int(node, "ceil_mode", 0) == 0
            && tall * wide > 0
            && only(
                node,
                &[
                    "kernel_shape",
                    "strides",
                    "pads",
                    "ceil_mode",
                    "count_include_pad",
                ],
            );
        let [height, width, channels] = self.plan.empty.pictures[from].size();
        let pixels = (height / tall.max(1)) * (width / wide.max(1));
        if !is_plain || pixels == 0 {
            return None;
        }
        let to = self.new_numbers();
        let window = [tall, wide];
        self.plan.steps.push(Step::Pool { window, from, to });
        Some(Place::Numbers {
            at: to,
            length: pixels * channels,
            pooled: Some([pixels, channels]),
        })
    }

    fn flatten(&self, node: &NodeProto) -> Option<Place> {
        let place = self.places.get(node.input.first()?.as_str())?;
        let is_plain = int(node, "axis", 1) == 1 && matches!(place, Place::Numbers { .. });
        is_plain.then(|| place.clone())
    }

    fn dense(&mut self, node: &'a NodeProto) -> Option<Place> {
        let [x, weight, bias] = &node.input[..] else {
            return None;
        };
        let place = self.places.get(&**x)?.clone();
        let Place::Numbers {
            at: from,
            length,
            pooled,
        } = place
        else {
            return None;
        };
        let constant = self.constants.get(&**weight)?;
        let &[rows, columns] = &dims(constant)?[..] else {
            return None;
        };
        let is_turned = int(node, "transB", 0) == 1;
        let [inputs, outputs] = if is_turned {
            [columns, rows]
        } else {
            [rows, columns]
        };
        let is_plain = inputs == length
            && int(node, "transA", 0) == 0
            && float(node, "alpha") == 1.0
            && float(node, "beta") == 1.0
            && only(node, &["alpha", "beta", "transA", "transB"]);
        if !is_plain {
            return None;
        }
        let key = (&**weight, &**bias, self.is_rectified(node));
        let layer = match self.known.get(&key) {
            Some(layer) => *layer,
            None => {
                let values = floats(constant)?;
                // Row of the graph for each of our numbers.
                let row = |at: usize| match pooled {
                    Some([pixels, channels]) => at % channels * pixels + at / channels,
                    None => at,
                };
                let weights: Vec<f32> = (0..inputs)
                    .flat_map(|at| {
                        let (values, row) = (&values, row(at));
                        (0..outputs).map(move |o| {
                            values[if is_turned {
                                o * inputs + row
                            } else {
                                row * outputs + o
                            }]
                        })
                    })
                    .collect();
                let bias = floats(self.constants.get(&**bias)?)?;
                if bias.len() != outputs {
                    return None;
                }
                let layers = &mut self.plan.layers;
                layers.push(Dense::new(inputs, &weights, bias, key.2));
                self.known.insert(key, layers.len() - 1);
                layers.len() - 1
            }
        };
        let to = self.new_numbers();
        self.add_dense(layer, from, to);
        Some(Place::Numbers {
            at: to,
            length: outputs,
            pooled: None,
        })
    }

    /// Adds a dense layer; to the one before where the sensors share it, so that its weights are
    /// read once. Nothing has read what that one gives: its reader is the one that joins both.
    fn add_dense(&mut self, layer: usize, from: usize, to: usize) {
        let steps = &mut self.plan.steps;
        let same = steps
            .iter()
            .position(|step| matches!(step, Step::Dense { layer: other, .. } if *other == layer));
        let reads = |step: &Step, number: usize| match step {
            Step::Dense { from, .. } | Step::Join { from, .. } => from.contains(&number),
            _ => false,
        };
        let free = same.filter(|&at| match &steps[at] {
            Step::Dense { to, .. } => {
                let later = &steps[at + 1..];
                !to.iter()
                    .any(|number| later.iter().any(|step| reads(step, *number)))
                    && !to.contains(&from)
            }
            _ => false,
        });
        let (mut all_from, mut all_to) = (Vec::new(), Vec::new());
        if let Some(at) = free
            && let Step::Dense { from, to, .. } = steps.remove(at)
        {
            (all_from, all_to) = (from, to);
        }
        all_from.push(from);
        all_to.push(to);
        steps.push(Step::Dense {
            layer,
            from: all_from,
            to: all_to,
        });
    }

    fn join(&mut self, node: &'a NodeProto) -> Option<Place> {
        if int(node, "axis", 0) != 1 {
            return None;
        }
        let mut from = Vec::new();
        let mut sum = 0;
        for name in &node.input {
            let Place::Numbers {
                at,
                length,
                pooled: None,
            } = self.places.get(&**name)?
            else {
                return None;
            };
            from.push(*at);
            sum += length;
        }
        let to = self.new_numbers();
        self.plan.steps.push(Step::Join { from, to });
        Some(Place::Numbers {
            at: to,
            length: sum,
            pooled: None,
        })
    }
}

fn dims(tensor: &TensorProto) -> Option<Vec<usize>> {
    let sides = tensor.dims.iter().map(|&side| usize::try_from(side).ok());
    sides.collect()
}

/// The values of an f32 tensor, as many as its dimensions say.
fn floats(tensor: &TensorProto) -> Option<Vec<f32>> {
    let count = dims(tensor)?
        .iter()
        .try_fold(1_usize, |all, side| all.checked_mul(*side))?;
    let values: Vec<f32> = if tensor.data_type != DataType::Float as i32 {
        return None;
    } else if tensor.raw_data.is_empty() {
        tensor.float_data.clone()
    } else {
        let floats = tensor.raw_data.as_chunks::<4>().0.iter();
        floats.map(|bytes| f32::from_le_bytes(*bytes)).collect()
    };
    (values.len() == count).then_some(values)
}

fn ints(node: &NodeProto, name: &str) -> Option<Vec<usize>> {
    let attribute = node.attribute.iter().find(|found| found.name == name)?;
    attribute
        .ints
        .iter()
        .map(|&x| usize::try_from(x).ok())
        .collect()
}

/// The one value of a list; `missing` where there is no list.
fn same(node: &NodeProto, name: &str, missing: usize) -> Option<usize> {
    let Some(values) = ints(node, name) else {
        let is_there = node.attribute.iter().any(|found| found.name == name);
        return (!is_there).then_some(missing);
    };
    let first = *values.first()?;
    values.iter().all(|value| *value == first).then_some(first)
}

fn int(node: &NodeProto, name: &str, missing: i64) -> i64 {
    let found = node.attribute.iter().find(|found| found.name == name);
    found.map_or(missing, |found| found.i)
}

/// A factor; 1 where it is not given.
fn float(node: &NodeProto, name: &str) -> f32 {
    let found = node.attribute.iter().find(|found| found.name == name);
    found.map_or(1.0, |found| found.f)
}

/// Whether a node has no other attributes.
fn only(node: &NodeProto, names: &[&str]) -> bool {
    node.attribute
        .iter()
        .all(|found| names.contains(&&*found.name))
}
