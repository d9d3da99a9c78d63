use super::*;

/// Pseudo-random numbers between −1 and 1.
fn numbers(seed: usize, count: usize) -> Vec<f32> {
    (0..count)
        .map(|i| ((i * 7919 + seed * 104_729) % 2003) as f32 / 1001.0 - 1.0)
        .collect()
}

/// Calls `visit` with the indices in input, weights and output of every product.
fn each_product(shape: &ConvShape, mut visit: impl FnMut(usize, usize, usize)) {
    let [height, width, inputs] = shape.input;
    let [rows, columns, outputs] = shape.output();
    for (y, x) in (0..rows).flat_map(|y| (0..columns).map(move |x| (y, x))) {
        for (i, j) in (0..shape.kernel).flat_map(|i| (0..shape.kernel).map(move |j| (i, j))) {
            let (Some(v), Some(u)) = (
                (y * shape.stride + i).checked_sub(shape.pad),
                (x * shape.stride + j).checked_sub(shape.pad),
            ) else {
                continue;
            };
            if v >= height || u >= width {
                continue;
            }
            for input in 0..inputs {
                for output in 0..outputs {
                    visit(
                        (v * width + u) * inputs + input,
                        ((i * shape.kernel + j) * inputs + input) * outputs + output,
                        (y * columns + x) * outputs + output,
                    );
                }
            }
        }
    }
}

fn assert_near(found: &[f32], expected: &[f64], what: &str) {
    assert_eq!(found.len(), expected.len());
    for (index, (found, expected)) in found.iter().zip(expected).enumerate() {
        let tolerance = 1e-4 * (1.0 + expected.abs());
        assert!(
            (f64::from(*found) - expected).abs() < tolerance,
            "{what} {index}: {found} {expected}"
        );
    }
}

#[test]
fn convolutions_and_gradients_match_direct_sums() {
    let shape = |input, channels, kernel, stride, pad| ConvShape {
        input,
        channels,
        kernel,
        stride,
        pad,
    };
    for shape in [
        shape([8, 24, 3], 32, 4, 4, 0),
        shape([9, 31, 16], 48, 3, 2, 1),
        shape([6, 7, 5], 16, 3, 1, 1),
        shape([11, 26, 3], 24, 5, 2, 2),
        // Columns on the right and rows at the bottom outside of all windows.
        shape([10, 14, 4], 17, 3, 4, 0),
    ] {
        let inputs = shape.input.iter().product();
        let outputs: usize = shape.output().iter().product();
        let (x, w) = (
            numbers(1, inputs),
            numbers(2, shape.fan_in() * shape.channels),
        );
        let (bias, dy) = (numbers(3, shape.channels), numbers(4, outputs));
        let mut scratch = Scratch::default();
        let mut packed = Packed::default();
        shape.pack(&w, &mut packed);
        let finish = Finish {
            bias: Some(&bias),
            relu: true,
        };
        let mut y = vec![9.0; outputs];
        forward(&shape, &x, &packed, &mut y, finish, &mut scratch);
        let mut expected: Vec<f64> = (0..outputs)
            .map(|at| f64::from(bias[at % shape.channels]))
            .collect();
        each_product(&shape, |i, j, k| {
            expected[k] += f64::from(x[i]) * f64::from(w[j])
        });
        let expected: Vec<f64> = expected.iter().map(|y| y.max(0.0)).collect();
        assert_near(&y, &expected, "output");
        let mut dw = vec![1.0; w.len()];
        backward_weights(&shape, &x, &dy, &mut dw, &mut scratch);
        let mut expected = vec![1.0; w.len()];
        each_product(&shape, |i, j, k| {
            expected[j] += f64::from(x[i]) * f64::from(dy[k])
        });
        assert_near(&dw, &expected, "gradient of weights");
        shape.pack_transposed(&w, &mut packed);
        let mut dx = vec![9.0; inputs];
        backward_input(&shape, &dy, &packed, &mut dx, &mut scratch);
        let mut expected = vec![0.0; inputs];
        each_product(&shape, |i, j, k| {
            expected[i] += f64::from(w[j]) * f64::from(dy[k])
        });
        assert_near(&dx, &expected, "gradient of the input");
    }
}

#[test]
fn all_instruction_sets_agree() {
    let shape = ConvShape {
        input: [12, 43, 3],
        channels: 48,
        kernel: 5,
        stride: 2,
        pad: 0,
    };
    let outputs: usize = shape.output().iter().product();
    let x = numbers(1, shape.input.iter().product());
    let (w, dy) = (
        numbers(2, shape.fan_in() * shape.channels),
        numbers(4, outputs),
    );
    let (rows, lines) = shape.rows();
    let found: Vec<(bool, Vec<f32>)> = Isa::available()
        .into_iter()
        .map(|isa| {
            let mut packed = Packed::default();
            packed.pack_for(isa, [shape.fan_in(), shape.channels], |row, column| {
                w[row * shape.channels + column]
            });
            let mut y = vec![0.0; outputs];
            isa.run(Multiply {
                a: &x,
                rows,
                lines,
                b: &packed,
                c: Output {
                    line_step: lines[2] * shape.channels,
                    values: &mut y,
                    finish: Finish::default(),
                },
            });
            let mut dw = vec![0.0; w.len()];
            isa.run(MultiplyTransposed {
                terms: Transposed {
                    a: &x,
                    rows,
                    lines,
                    b: &dy,
                    columns: shape.channels,
                },
                c: &mut dw,
            });
            y.extend(dw);
            let is_fused = isa != Isa::Portable || cfg!(target_arch = "aarch64");
            (is_fused, y)
        })
        .collect();
    let Some((_, best)) = found.first() else {
        return;
    };
    for (is_fused, other) in &found {
        if *is_fused == found[0].0 {
            assert!(best == other);
        }
        let expected: Vec<f64> = best.iter().map(|x| f64::from(*x)).collect();
        assert_near(other, &expected, "other instruction set");
    }
}
