//! Convolution of one image, forward and backward.
//!
//! Images are HWC, weights are KH·KW·C × output channels, row-major.

use super::lanes::{Isa, Lanes, WithLanes};
use super::product::{Finish, Output, Packed, Rows, Transposed, multiply, multiply_transposed};

/// Output pixels whose gradients are scattered at once, so that their products stay in the cache.
const SPREAD_PIXELS: usize = 80;

/// Shape of a convolution.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ConvShape {
    /// Height, width and channels of the input.
    pub input: [usize; 3],
    /// Output channels.
    pub channels: usize,
    /// Kernel size, pixels.
    pub kernel: usize,
    /// Stride, pixels.
    pub stride: usize,
    /// Zero padding, pixels.
    pub pad: usize,
}

impl ConvShape {
    /// Height, width and channels of the output.
    pub fn output(&self) -> [usize; 3] {
        let [height, width, _] = self.input;
        let side = |side: usize| (side + 2 * self.pad - self.kernel) / self.stride + 1;
        [side(height), side(width), self.channels]
    }

    /// Number of rows of the weights.
    pub fn fan_in(&self) -> usize {
        self.kernel * self.kernel * self.input[2]
    }

    /// Height and width of the padded input that windows cover.
    fn padded(&self) -> [usize; 2] {
        let [height, width, _] = self.output();
        [height, width].map(|side| (side - 1) * self.stride + self.kernel)
    }

    /// Whether the padded input differs from the input.
    fn is_padded(&self) -> bool {
        self.padded() != [self.input[0], self.input[1]]
    }

    /// Location of the windows in the padded input.
    pub(super) fn rows(&self) -> (Rows, [usize; 3]) {
        let [height, width, _] = self.output();
        let row = self.padded()[1] * self.input[2];
        let rows = Rows {
            step: self.stride * self.input[2],
            runs: self.kernel,
            run: self.kernel * self.input[2],
            run_step: row,
        };
        (rows, [height, self.stride * row, width])
    }

    /// Packs weights for [`forward`].
    pub(super) fn pack(&self, weights: &[f32], packed: &mut Packed) {
        packed.pack_rows([self.fan_in(), self.channels], weights);
    }

    /// Packs weights for [`backward_input`].
    pub(super) fn pack_transposed(&self, weights: &[f32], packed: &mut Packed) {
        packed.pack_columns([self.channels, self.fan_in()], weights);
    }

    /// Pads the input; returns `x` itself if no padding is needed.
    fn pad<'a>(&self, x: &'a [f32], padded: &'a mut Vec<f32>) -> &'a [f32] {
        if !self.is_padded() {
            return x;
        }
        let [height, width, channels] = self.input;
        let [padded_height, padded_width] = self.padded();
        padded.clear();
        padded.resize(padded_height * padded_width * channels, 0.0);
        let width = width.min(padded_width - self.pad);
        for row in 0..height.min(padded_height - self.pad) {
            let to = ((row + self.pad) * padded_width + self.pad) * channels;
            padded[to..to + width * channels]
                .copy_from_slice(&x[row * self.input[1] * channels..][..width * channels]);
        }
        padded
    }

    /// Copies the gradient of the input out of a padded gradient.
    fn unpad(&self, padded: &[f32], dx: &mut [f32]) {
        let [height, width, channels] = self.input;
        let [padded_height, padded_width] = self.padded();
        let inside = width.min(padded_width - self.pad);
        for row in 0..height {
            let dx = &mut dx[row * width * channels..][..width * channels];
            if row + self.pad < padded_height {
                let from = ((row + self.pad) * padded_width + self.pad) * channels;
                dx[..inside * channels].copy_from_slice(&padded[from..][..inside * channels]);
                dx[inside * channels..].fill(0.0);
            } else {
                dx.fill(0.0);
            }
        }
    }
}

/// Reusable buffers of a thread.
#[derive(Debug, Default)]
pub(super) struct Scratch {
    padded: Vec<f32>,
    spread: Vec<f32>,
}

/// Computes `y = finish(x ∗ weights)` for one image.
pub(super) fn forward(
    shape: &ConvShape,
    x: &[f32],
    weights: &Packed,
    y: &mut [f32],
    finish: Finish<'_>,
    scratch: &mut Scratch,
) {
    let (rows, lines) = shape.rows();
    Isa::best().run(Multiply {
        a: shape.pad(x, &mut scratch.padded),
        rows,
        lines,
        b: weights,
        c: Output {
            line_step: lines[2] * shape.channels,
            values: y,
            finish,
        },
    });
}

/// Adds the gradient of the weights from one image to `dweights`.
pub(super) fn backward_weights(
    shape: &ConvShape,
    x: &[f32],
    dy: &[f32],
    dweights: &mut [f32],
    scratch: &mut Scratch,
) {
    let (rows, lines) = shape.rows();
    Isa::best().run(MultiplyTransposed {
        terms: Transposed {
            a: shape.pad(x, &mut scratch.padded),
            rows,
            lines,
            b: dy,
            columns: shape.channels,
        },
        c: dweights,
    });
}

/// Computes the gradient of the input of one image.
pub(super) fn backward_input(
    shape: &ConvShape,
    dy: &[f32],
    weights: &Packed,
    dx: &mut [f32],
    scratch: &mut Scratch,
) {
    let (rows, [height, line_step, width]) = shape.rows();
    let [padded_height, padded_width] = shape.padded();
    let Scratch { padded, spread } = scratch;
    padded.clear();
    padded.resize(padded_height * padded_width * shape.input[2], 0.0);
    let lines_at_once = (SPREAD_PIXELS / width).max(1);
    spread.resize(lines_at_once * width * shape.fan_in(), 0.0);
    let mut line = 0;
    while line < height {
        let lines = lines_at_once.min(height - line);
        let pixels = lines * width;
        Isa::best().run(Multiply {
            a: &dy[line * width * shape.channels..],
            rows: rows_of(shape.channels),
            lines: [1, 0, pixels],
            b: weights,
            c: Output {
                values: &mut spread[..pixels * shape.fan_in()],
                line_step: 0,
                finish: Finish::default(),
            },
        });
        Isa::best().run(Spread {
            spread,
            rows,
            lines: [lines, line_step, width],
            dx: &mut padded[line * line_step..],
        });
        line += lines;
    }
    shape.unpad(padded, dx);
}

/// Computes `y = finish(x·weights)` for rows of `x`.
pub(super) fn linear_forward(
    x: &[f32],
    weights: &Packed,
    inputs: usize,
    y: &mut [f32],
    finish: Finish<'_>,
) {
    let count = y.len() / weights.columns();
    Isa::best().run(Multiply {
        a: x,
        rows: rows_of(inputs),
        lines: [1, 0, count],
        b: weights,
        c: Output {
            values: y,
            line_step: 0,
            finish,
        },
    });
}

/// Adds `xᵀ·dy` to `dweights`.
pub(super) fn linear_backward_weights(
    x: &[f32],
    dy: &[f32],
    [inputs, outputs]: [usize; 2],
    dweights: &mut [f32],
) {
    Isa::best().run(MultiplyTransposed {
        terms: Transposed {
            a: x,
            rows: rows_of(inputs),
            lines: [1, 0, x.len() / inputs],
            b: dy,
            columns: outputs,
        },
        c: dweights,
    });
}

fn rows_of(length: usize) -> Rows {
    Rows {
        step: length,
        runs: 1,
        run: length,
        run_step: 0,
    }
}

pub(super) struct Multiply<'a> {
    pub(super) a: &'a [f32],
    pub rows: Rows,
    pub(super) lines: [usize; 3],
    pub(super) b: &'a Packed,
    pub(super) c: Output<'a>,
}

impl WithLanes for Multiply<'_> {
    type Output = ();

    #[inline(always)]
    fn with_lanes<S: Lanes>(self, lanes: S) -> Self::Output {
        multiply(lanes, self.a, self.rows, self.lines, self.b, self.c);
    }
}

struct MultiplyTransposed<'a> {
    terms: Transposed<'a>,
    c: &'a mut [f32],
}

impl WithLanes for MultiplyTransposed<'_> {
    type Output = ();

    #[inline(always)]
    fn with_lanes<S: Lanes>(self, lanes: S) {
        multiply_transposed(lanes, &self.terms, self.c);
    }
}

/// Adds the products of each window to the pixels it covers (col2im).
struct Spread<'a> {
    spread: &'a [f32],
    rows: Rows,
    lines: [usize; 3],
    dx: &'a mut [f32],
}

impl WithLanes for Spread<'_> {
    type Output = ();

    #[inline(always)]
    fn with_lanes<S: Lanes>(self, _: S) {
        let Self {
            spread,
            rows,
            lines: [lines, line_step, count],
            dx,
        } = self;
        let mut windows = spread.chunks_exact(rows.len());
        for line in 0..lines {
            for pixel in 0..count {
                let Some(window) = windows.next() else { return };
                let dx = &mut dx[line * line_step + pixel * rows.step..];
                for (run, values) in window.chunks_exact(rows.run).enumerate() {
                    let dx = &mut dx[run * rows.run_step..][..rows.run];
                    for (dx, value) in dx.iter_mut().zip(values) {
                        *dx += value;
                    }
                }
            }
        }
    }
}

#[cfg(test)]
#[path = "conv_test.rs"]
mod tests;
