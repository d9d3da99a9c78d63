//! Matrix product kernels of all layers, accumulating in registers.
//!
//! Computes C = A·B with B packed into panels. Rows of A are read from an image in place: a row is
//! the window of a convolution at one pixel, a few runs of consecutive floats.

use std::hint;

use super::lanes::{Isa, Lanes};

/// Location of the rows of A in a slice.
#[derive(Clone, Copy, Debug)]
pub(super) struct Rows {
    /// Distance between rows, floats.
    pub(super) step: usize,
    /// Runs per row.
    pub(super) runs: usize,
    /// Length of a run, floats.
    pub(super) run: usize,
    /// Distance between runs, floats.
    pub(super) run_step: usize,
}

impl Rows {
    /// Length of a row, floats.
    pub(super) fn len(&self) -> usize {
        self.runs * self.run
    }
}

/// A matrix packed into panels of two vectors, the last one possibly of one vector, padded with
/// zero columns.
#[derive(Clone, Debug, Default)]
pub(super) struct Packed {
    values: Vec<f32>,
    rows: usize,
    columns: usize,
    lanes: usize,
}

impl Packed {
    /// Packs the values of `at(row, column)`.
    pub(super) fn pack(&mut self, sizes: [usize; 2], at: impl Fn(usize, usize) -> f32) {
        self.pack_for(Isa::best(), sizes, at);
    }

    /// Packs for a given instruction set.
    pub(super) fn pack_for(
        &mut self,
        isa: Isa,
        [rows, columns]: [usize; 2],
        at: impl Fn(usize, usize) -> f32,
    ) {
        let lanes = isa.lanes();
        self.rows = rows;
        self.columns = columns;
        self.lanes = lanes;
        self.values.clear();
        self.values.reserve(rows * columns.next_multiple_of(lanes));
        for (first, width) in panels(columns, lanes) {
            for row in 0..rows {
                let values = (first..first + width).map(|column| {
                    if column < columns {
                        at(row, column)
                    } else {
                        0.0
                    }
                });
                self.values.extend(values);
            }
        }
    }

    /// Packs a row-major matrix.
    pub(super) fn pack_rows(&mut self, [rows, columns]: [usize; 2], values: &[f32]) {
        self.pack([rows, columns], |row, column| {
            values[row * columns + column]
        });
    }

    /// Packs a column-major matrix.
    pub(super) fn pack_columns(&mut self, [rows, columns]: [usize; 2], values: &[f32]) {
        self.pack([rows, columns], |row, column| values[column * rows + row]);
    }

    pub(super) fn columns(&self) -> usize {
        self.columns
    }

    /// First column, number of vectors and values of each panel.
    #[inline(always)]
    fn panels(&self) -> impl Iterator<Item = (usize, usize, &[f32])> {
        let mut rest = &self.values[..];
        panels(self.columns, self.lanes).map(move |(first, width)| {
            let (panel, after) = rest.split_at(self.rows * width);
            rest = after;
            (first, width / self.lanes, panel)
        })
    }
}

/// First column and width of each panel.
fn panels(columns: usize, lanes: usize) -> impl Iterator<Item = (usize, usize)> {
    (0..columns.div_ceil(lanes)).step_by(2).map(move |vector| {
        let first = vector * lanes;
        let vectors = (columns - first).div_ceil(lanes).min(2);
        (first, vectors * lanes)
    })
}

/// Operations on a sum before it is stored.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Finish<'a> {
    /// Bias of each column.
    pub(super) bias: Option<&'a [f32]>,
    /// Whether to apply ReLU.
    pub(super) relu: bool,
}

/// Location of the rows of C.
#[derive(Debug)]
pub(super) struct Output<'a> {
    pub(super) values: &'a mut [f32],
    /// Distance between lines of rows, floats; rows of a line are contiguous.
    pub(super) line_step: usize,
    pub finish: Finish<'a>,
}

/// Computes `c[row][column] = finish(Σ a[row][k]·b[k][column])` for lines of rows: line `i` starts
/// at `a[i·line_step]` and has `count` rows.
#[inline(always)]
pub(super) fn multiply<S: Lanes>(
    lanes: S,
    a: &[f32],
    rows: Rows,
    [lines, line_step, count]: [usize; 3],
    b: &Packed,
    c: Output<'_>,
) {
    for (first, vectors, panel) in b.panels() {
        for line in 0..lines {
            let a = &a[line * line_step..];
            let mut done = 0;
            while done < count {
                // The last block overlaps the previous one; the results are equal.
                let at_once = if count >= S::ROWS { S::ROWS } else { 1 };
                let from = done.min(count - at_once);
                let a = &a[from * rows.step..];
                let to = Target {
                    c: &mut c.values[line * c.line_step + from * b.columns..],
                    columns: b.columns,
                    first,
                    finish: c.finish,
                };
                match (at_once, vectors) {
                    (10, 2) => block::<S, 10, 2>(lanes, a, rows, panel, to),
                    (10, _) => block::<S, 10, 1>(lanes, a, rows, panel, to),
                    (5, 2) => block::<S, 5, 2>(lanes, a, rows, panel, to),
                    (5, _) => block::<S, 5, 1>(lanes, a, rows, panel, to),
                    (_, 2) => single::<S, 2>(lanes, a, rows, panel, to),
                    _ => single::<S, 1>(lanes, a, rows, panel, to),
                }
                done = from + at_once;
            }
        }
    }
}

/// [`multiply`] for adjacent windows of `SIDE`×`SIDE` pixels in planes of `height`×`width` pixels,
/// one per channel. Rows of B are ordered by plane, row and column of a window.
#[inline(always)]
pub(super) fn multiply_patches<S: Lanes, const SIDE: usize>(
    lanes: S,
    planes: &[f32],
    [height, width]: [usize; 2],
    b: &Packed,
    c: Output<'_>,
) {
    let count = width / SIDE;
    for (first, vectors, panel) in b.panels() {
        for line in 0..height / SIDE {
            let lines = &planes[line * SIDE * width..];
            let mut done = 0;
            while done < count {
                let at_once = if count >= S::ROWS { S::ROWS } else { 1 };
                let from = done.min(count - at_once);
                let a = &lines[from * SIDE..];
                let to = Target {
                    c: &mut c.values[line * c.line_step + from * b.columns..],
                    columns: b.columns,
                    first,
                    finish: c.finish,
                };
                let size = [height * width, width];
                match (at_once, vectors) {
                    (10, 2) => patches::<S, SIDE, 10, 2>(lanes, a, size, panel, to),
                    (10, _) => patches::<S, SIDE, 10, 1>(lanes, a, size, panel, to),
                    (5, 2) => patches::<S, SIDE, 5, 2>(lanes, a, size, panel, to),
                    (5, _) => patches::<S, SIDE, 5, 1>(lanes, a, size, panel, to),
                    (_, 2) => patches::<S, SIDE, 1, 2>(lanes, a, size, panel, to),
                    _ => patches::<S, SIDE, 1, 1>(lanes, a, size, panel, to),
                }
                done = from + at_once;
            }
        }
    }
}

/// Destination of a block of sums.
struct Target<'a> {
    c: &'a mut [f32],
    columns: usize,
    /// Column of the first sum.
    first: usize,
    finish: Finish<'a>,
}

impl Target<'_> {
    #[inline(always)]
    fn store<S: Lanes, const M: usize, const V: usize>(self, lanes: S, sums: &[[S::Vector; V]; M]) {
        // With more work in this loop the compiler spills the sums to memory.
        let mut tile = [[[0.0; 16]; V]; M];
        for row in 0..M {
            for v in 0..V {
                lanes.store(sums[row][v], &mut tile[row][v]);
            }
        }
        let zero = lanes.splat(0.0);
        for v in 0..V {
            let column = self.first + v * S::COUNT;
            let width = self.columns.saturating_sub(column).min(S::COUNT);
            let mut bias = [0.0; 16];
            if let Some(from) = self.finish.bias {
                bias[..width].copy_from_slice(&from[column..column + width]);
            }
            let bias = lanes.load(&bias);
            for (row, sums) in tile.iter_mut().enumerate() {
                let mut sum = lanes.add(lanes.load(&sums[v]), bias);
                if self.finish.relu {
                    sum = lanes.max(sum, zero);
                }
                let c = &mut self.c[row * self.columns + column..];
                if width == S::COUNT {
                    lanes.store(sum, c);
                } else {
                    lanes.store(sum, &mut sums[v]);
                    c[..width].copy_from_slice(&sums[v][..width]);
                }
            }
        }
    }
}

#[inline(always)]
fn block<S: Lanes, const M: usize, const V: usize>(
    lanes: S,
    a: &[f32],
    rows: Rows,
    panel: &[f32],
    to: Target<'_>,
) {
    let mut sums = [[lanes.splat(0.0); V]; M];
    let mut panel = panel;
    // Hides the equal distances, which the compiler would turn into a chain of additions.
    let starts: [usize; M] = hint::black_box(std::array::from_fn(|row| row * rows.step));
    for run in 0..rows.runs {
        let a: [&[f32]; M] =
            std::array::from_fn(|row| &a[run * rows.run_step + starts[row]..][..rows.run]);
        let (of_run, rest) = panel.split_at(rows.run * V * S::COUNT);
        panel = rest;
        for (k, b) in of_run.chunks_exact(V * S::COUNT).enumerate().take(rows.run) {
            let b: [S::Vector; V] = std::array::from_fn(|v| lanes.load(&b[v * S::COUNT..]));
            for row in 0..M {
                let factor = lanes.splat(a[row][k]);
                for v in 0..V {
                    sums[row][v] = lanes.mul_add(factor, b[v], sums[row][v]);
                }
            }
        }
    }
    to.store(lanes, &sums);
}

/// Independent sums of a single row.
const INTERLEAVED: usize = 4;

/// [`block`] of a single row with four interleaved sums, to hide the latency of additions.
#[inline(always)]
fn single<S: Lanes, const V: usize>(
    lanes: S,
    a: &[f32],
    rows: Rows,
    panel: &[f32],
    to: Target<'_>,
) {
    let mut sums = [[lanes.splat(0.0); V]; INTERLEAVED];
    let width = V * S::COUNT;
    let mut panel = panel;
    for run in 0..rows.runs {
        let a = &a[run * rows.run_step..][..rows.run];
        let (of_run, rest) = panel.split_at(rows.run * width);
        panel = rest;
        let whole = rows.run / INTERLEAVED * INTERLEAVED;
        let some = of_run.chunks_exact(INTERLEAVED * width);
        for (a, b) in a.as_chunks::<INTERLEAVED>().0.iter().zip(some) {
            for k in 0..INTERLEAVED {
                let factor = lanes.splat(a[k]);
                for v in 0..V {
                    let b = lanes.load(&b[k * width + v * S::COUNT..]);
                    sums[k][v] = lanes.mul_add(factor, b, sums[k][v]);
                }
            }
        }
        for k in whole..rows.run {
            let factor = lanes.splat(a[k]);
            for v in 0..V {
                let b = lanes.load(&of_run[k * width + v * S::COUNT..]);
                sums[0][v] = lanes.mul_add(factor, b, sums[0][v]);
            }
        }
    }
    let [mut sum, second, third, fourth] = sums;
    for v in 0..V {
        let pair = lanes.add(third[v], fourth[v]);
        sum[v] = lanes.add(lanes.add(sum[v], second[v]), pair);
    }
    to.store(lanes, &[sum]);
}

#[inline(always)]
fn patches<S: Lanes, const SIDE: usize, const M: usize, const V: usize>(
    lanes: S,
    a: &[f32],
    [plane, row_step]: [usize; 2],
    panel: &[f32],
    to: Target<'_>,
) {
    let mut sums = [[lanes.splat(0.0); V]; M];
    for (run, of_run) in panel.chunks_exact(SIDE * V * S::COUNT).enumerate() {
        let a = &a[run / SIDE * plane + run % SIDE * row_step..][..M * SIDE];
        for k in 0..SIDE {
            let b = &of_run[k * V * S::COUNT..][..V * S::COUNT];
            let b: [S::Vector; V] = std::array::from_fn(|v| lanes.load(&b[v * S::COUNT..]));
            for row in 0..M {
                let factor = lanes.splat(a[row * SIDE + k]);
                for v in 0..V {
                    sums[row][v] = lanes.mul_add(factor, b[v], sums[row][v]);
                }
            }
        }
    }
    to.store(lanes, &sums);
}

/// Operands of [`multiply_transposed`].
#[derive(Debug)]
pub(super) struct Transposed<'a> {
    pub(super) a: &'a [f32],
    pub(super) rows: Rows,
    /// Number of lines, distance between lines, rows per line, as in [`multiply`].
    pub(super) lines: [usize; 3],
    /// One row of `columns` floats per row of `a`.
    pub(super) b: &'a [f32],
    pub(super) columns: usize,
}

/// Computes `c[k][column] += Σ a[row][k]·b[row][column]` over lines of rows as in [`multiply`].
#[inline(always)]
pub(super) fn multiply_transposed<S: Lanes>(lanes: S, terms: &Transposed<'_>, c: &mut [f32]) {
    let rows = terms.rows;
    for run in 0..rows.runs {
        let mut k = 0;
        while k < rows.run {
            let a = &terms.a[run * rows.run_step + k..];
            let c = &mut c[(run * rows.run + k) * terms.columns..];
            k += match rows.run - k {
                12.. if S::ROWS == 10 => transposed::<S, 12>(lanes, a, terms, c),
                6.. => transposed::<S, 6>(lanes, a, terms, c),
                3.. => transposed::<S, 3>(lanes, a, terms, c),
                _ => transposed::<S, 1>(lanes, a, terms, c),
            };
        }
    }
}

/// The first `M` rows of `c`, from the floats that `a` starts with; gives `M`.
#[inline(always)]
fn transposed<S: Lanes, const M: usize>(
    lanes: S,
    a: &[f32],
    terms: &Transposed<'_>,
    c: &mut [f32],
) -> usize {
    let columns = terms.columns;
    let mut column = 0;
    while column + 2 * S::COUNT <= columns {
        transposed_block::<S, M, 2>(lanes, a, terms, column, c);
        column += 2 * S::COUNT;
    }
    while column + S::COUNT <= columns {
        transposed_block::<S, M, 1>(lanes, a, terms, column, c);
        column += S::COUNT;
    }
    let [lines, line_step, count] = terms.lines;
    for column in column..columns {
        for m in 0..M {
            let mut sum = 0.0;
            for line in 0..lines {
                for row in 0..count {
                    let b = terms.b[(line * count + row) * columns + column];
                    sum += a[line * line_step + row * terms.rows.step + m] * b;
                }
            }
            c[m * columns + column] += sum;
        }
    }
    M
}

#[inline(always)]
fn transposed_block<S: Lanes, const M: usize, const V: usize>(
    lanes: S,
    a: &[f32],
    terms: &Transposed<'_>,
    column: usize,
    c: &mut [f32],
) {
    let (step, columns) = (terms.rows.step, terms.columns);
    let [lines, line_step, count] = terms.lines;
    let (b, c) = (&terms.b[column..], &mut c[column..]);
    let mut sums = [[lanes.splat(0.0); V]; M];
    for line in 0..lines {
        let a = &a[line * line_step..];
        let b = &b[line * count * columns..];
        for row in 0..count {
            let a = &a[row * step..][..M];
            let b = &b[row * columns..];
            let b: [S::Vector; V] = std::array::from_fn(|v| lanes.load(&b[v * S::COUNT..]));
            for m in 0..M {
                let factor = lanes.splat(a[m]);
                for v in 0..V {
                    sums[m][v] = lanes.mul_add(factor, b[v], sums[m][v]);
                }
            }
        }
    }
    for m in 0..M {
        for v in 0..V {
            let c = &mut c[m * columns + v * S::COUNT..];
            lanes.store(lanes.add(lanes.load(c), sums[m][v]), c);
        }
    }
}
