//! Layers for inference: weights packed once, one image at a time.

use super::conv::{ConvShape, Multiply};
use super::lanes::{Isa, Lanes, WithLanes};
use super::product::{Finish, Output, Packed, multiply_patches};

/// Window sizes supported by [`Patches`].
const PATCH_SIDES: [usize; 3] = [2, 4, 8];

/// An HWC image with a zero border.
#[derive(Clone, Debug)]
pub(crate) struct Padded {
    size: [usize; 3],
    border: usize,
    values: Vec<f32>,
}

impl Padded {
    /// A black image of height, width and channels with a border of `border` pixels.
    pub(crate) fn new(size: [usize; 3], border: usize) -> Self {
        let [height, width, channels] = size;
        let floats = (height + 2 * border) * (width + 2 * border) * channels;
        Self {
            size,
            border,
            values: vec![0.0; floats],
        }
    }

    /// Distance between rows, floats.
    fn row_step(&self) -> usize {
        (self.size[1] + 2 * self.border) * self.size[2]
    }

    /// Index of the top-left pixel of the image extended by `border` pixels.
    fn start(&self, border: usize) -> usize {
        let inset = self.border - border;
        inset * self.row_step() + inset * self.size[2]
    }

    /// Copies CHW planes into the image.
    pub(crate) fn set_planes(&mut self, planes: &[f32]) {
        let [height, width, channels] = self.size;
        let (first, step) = (self.start(0), self.row_step());
        for (channel, plane) in planes.chunks_exact(height * width).enumerate() {
            for (y, from) in plane.chunks_exact(width).enumerate() {
                let row = &mut self.values[first + y * step..][..width * channels];
                for (to, from) in row.chunks_exact_mut(channels).zip(from) {
                    to[channel] = *from;
                }
            }
        }
    }

    /// Sums of the channels at each pixel, one plane for each of `bias`; `weights` are planes ×
    /// channels.
    pub(crate) fn planes_of(&self, weights: &[f32], bias: &[f32]) -> Vec<f32> {
        let [height, width, channels] = self.size;
        let mut planes = Vec::with_capacity(bias.len() * height * width);
        for (weights, bias) in weights.chunks_exact(channels).zip(bias) {
            for y in 0..height {
                let row = &self.values[self.start(0) + y * self.row_step()..][..width * channels];
                let sums = row.chunks_exact(channels).map(|pixel| {
                    let terms = pixel.iter().zip(weights).map(|(x, weight)| x * weight);
                    bias + terms.sum::<f32>()
                });
                planes.extend(sums);
            }
        }
        planes
    }

    /// Appends the average pooling with windows of `window` pixels, HWC.
    pub(crate) fn pool(&self, window: [usize; 2], means: &mut Vec<f32>) {
        let [height, width, channels] = self.size;
        let [tall, wide] = window;
        let fraction = 1.0 / (tall * wide) as f32;
        for y in 0..height / tall {
            for x in 0..width / wide {
                let start = means.len();
                means.resize(start + channels, 0.0);
                for line in y * tall..(y + 1) * tall {
                    let from = self.start(0) + line * self.row_step() + x * wide * channels;
                    let pixels = self.values[from..][..wide * channels].chunks_exact(channels);
                    for pixel in pixels {
                        for (mean, value) in means[start..].iter_mut().zip(pixel) {
                            *mean += fraction * value;
                        }
                    }
                }
            }
        }
    }
}

/// A convolution with bias and optional ReLU.
#[derive(Clone, Debug)]
pub(crate) struct Convolution {
    shape: ConvShape,
    weights: Packed,
    /// Weights for adjacent windows in planes.
    patches: Option<Packed>,
    bias: Vec<f32>,
    relu: bool,
}

impl Convolution {
    /// A convolution; `weights` are outputs × inputs × kernel rows × kernel columns.
    pub(crate) fn new(shape: ConvShape, weights: &[f32], bias: Vec<f32>, relu: bool) -> Self {
        let [height, width, inputs] = shape.input;
        let sizes = [shape.fan_in(), shape.channels];
        let window = shape.kernel * shape.kernel;
        let mut packed = Packed::default();
        packed.pack(sizes, |row, output| {
            weights[(output * inputs + row % inputs) * window + row / inputs]
        });
        let is_patch = shape.stride == shape.kernel
            && shape.pad == 0
            && PATCH_SIDES.contains(&shape.kernel)
            && height % shape.kernel == 0
            && width % shape.kernel == 0;
        let patches = is_patch.then(|| {
            let mut packed = Packed::default();
            packed.pack_columns(sizes, weights);
            packed
        });
        Self {
            shape,
            weights: packed,
            patches,
            bias,
            relu,
        }
    }

    /// Whether it can read planes directly, see [`Convolution::forward_planes`].
    pub(crate) fn reads_planes(&self) -> bool {
        self.patches.is_some()
    }

    fn finish(&self) -> Finish<'_> {
        Finish {
            bias: Some(&self.bias),
            relu: self.relu,
        }
    }

    /// Convolves an image whose border is as wide as the convolution's padding.
    pub(crate) fn forward(&self, x: &Padded, y: &mut Padded) {
        let (rows, [height, _, width]) = self.shape.rows();
        let step = x.row_step();
        let rows = super::product::Rows {
            run_step: step,
            ..rows
        };
        let (first, line_step) = (y.start(0), y.row_step());
        Isa::best().run(Multiply {
            a: &x.values[x.start(self.shape.pad)..],
            rows,
            lines: [height, self.shape.stride * step, width],
            b: &self.weights,
            c: Output {
                values: &mut y.values[first..],
                line_step,
                finish: self.finish(),
            },
        });
    }

    /// Convolves CHW planes; does nothing unless it [reads planes](Convolution::reads_planes).
    pub(crate) fn forward_planes(&self, planes: &[f32], y: &mut Padded) {
        let Some(weights) = &self.patches else { return };
        let [height, width, _] = self.shape.input;
        let (first, line_step) = (y.start(0), y.row_step());
        Isa::best().run(Patches {
            side: self.shape.kernel,
            planes,
            size: [height, width],
            weights,
            output: Output {
                values: &mut y.values[first..],
                line_step,
                finish: self.finish(),
            },
        });
    }
}

struct Patches<'a> {
    side: usize,
    planes: &'a [f32],
    size: [usize; 2],
    weights: &'a Packed,
    output: Output<'a>,
}

impl WithLanes for Patches<'_> {
    type Output = ();

    #[inline(always)]
    fn with_lanes<S: Lanes>(self, lanes: S) {
        let Self {
            planes,
            size,
            weights,
            output,
            ..
        } = self;
        match self.side {
            2 => multiply_patches::<S, 2>(lanes, planes, size, weights, output),
            4 => multiply_patches::<S, 4>(lanes, planes, size, weights, output),
            _ => multiply_patches::<S, 8>(lanes, planes, size, weights, output),
        }
    }
}

/// A dense layer with bias and optional ReLU.
#[derive(Clone, Debug)]
pub(crate) struct Dense {
    inputs: usize,
    weights: Packed,
    bias: Vec<f32>,
    relu: bool,
}

impl Dense {
    /// A layer; `weights` are inputs × outputs, row-major.
    pub(crate) fn new(inputs: usize, weights: &[f32], bias: Vec<f32>, relu: bool) -> Self {
        let mut packed = Packed::default();
        packed.pack_rows([inputs, bias.len()], weights);
        Self {
            inputs,
            weights: packed,
            bias,
            relu,
        }
    }

    /// A layer on HWC pixels whose `weights` have rows in CHW order.
    pub(crate) fn from_planes(
        [pixels, channels]: [usize; 2],
        weights: &[f32],
        bias: Vec<f32>,
    ) -> Self {
        let (inputs, outputs) = (pixels * channels, bias.len());
        let mut packed = Packed::default();
        packed.pack([inputs, outputs], |at, output| {
            weights[(at % channels * pixels + at / channels) * outputs + output]
        });
        Self {
            inputs,
            weights: packed,
            bias,
            relu: false,
        }
    }

    /// Applies the layer to rows of inputs.
    pub(crate) fn forward(&self, x: &[f32], y: &mut Vec<f32>) {
        y.clear();
        y.resize(x.len() / self.inputs * self.bias.len(), 0.0);
        let finish = Finish {
            bias: Some(&self.bias),
            relu: self.relu,
        };
        super::conv::linear_forward(x, &self.weights, self.inputs, y, finish);
    }
}
