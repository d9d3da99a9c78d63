use super::*;
use crate::architecture::ConvSpec;

/// Uniform numbers from a seed.
fn uniform(seed: u64) -> impl FnMut() -> f64 {
    let mut state = seed;
    move || {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (state >> 11) as f64 / (1_u64 << 53) as f64
    }
}

fn tiny() -> Architecture {
    let conv = |channels, kernel, stride, pad| ConvSpec {
        channels,
        kernel,
        stride,
        pad,
    };
    Architecture {
        name: "tiny".to_owned(),
        convolutions: vec![conv(16, 8, 8, 0), conv(16, 5, 2, 2), conv(32, 3, 2, 1)],
        pool: [2, 3],
        embedding: 16,
        hidden: 16,
    }
}

fn batch(variant: Variant, count: usize, draw: &mut impl FnMut() -> f64) -> Batch {
    let image: usize = IMAGE.iter().product();
    let mut images = |n: usize| (0..n * image).map(|_| (draw() - 0.5) as f32).collect();
    Batch {
        touch: images(2 * count * usize::from(variant.has_touch())),
        vision: images(count * usize::from(variant.has_vision())),
        targets: (0..count).map(|i| (i % 2) as f32).collect(),
        weights: (0..count).map(|i| 0.5 + i as f32).collect(),
    }
}

#[test]
fn every_gradient_is_the_slope_of_the_loss() {
    let mut draw = uniform(5);
    let network = Network::new(&tiny(), Variant::Vt, &mut draw);
    let batch = batch(Variant::Vt, 4, &mut draw);
    let step = Step {
        number: 0,
        dropout: (0..4 * 16)
            .map(|i| if i % 5 == 0 { 0.0 } else { 1.25 })
            .collect(),
    };
    let mut gradient = vec![0.0; network.parameters.len()];
    network.clone().learn(&batch, &step, &mut gradient);
    for part in network.layout().parts() {
        let of_part = &gradient[part.range()];
        let squares = |values: &[f32]| values.iter().map(|x| f64::from(*x).powi(2)).sum::<f64>();
        let norm = squares(of_part).sqrt();
        assert!(norm > 1e-3, "{}: {norm}", part.name);
        let size = squares(&network.parameters[part.range()]).sqrt().max(0.1);
        let loss = |way: f64| {
            let mut moved = network.clone();
            for (parameter, slope) in moved.parameters[part.range()].iter_mut().zip(of_part) {
                *parameter += (way * f64::from(*slope) / norm) as f32;
            }
            moved.learn(&batch, &step, &mut vec![0.0; gradient.len()])
        };
        // ReLUs bend the loss, floats round it: one of the steps is between both.
        let off = [1e-2, 3e-3, 1e-3].map(|fraction| {
            let step = fraction * size;
            ((loss(step) - loss(-step)) / (2.0 * step) / norm - 1.0).abs()
        });
        let least = off.into_iter().fold(f64::INFINITY, f64::min);
        assert!(least < 0.05, "{}: {off:?}", part.name);
    }
}

#[test]
fn results_do_not_depend_on_the_number_of_threads() {
    let mut draw = uniform(6);
    let network = Network::new(&tiny(), Variant::Vt, &mut draw);
    let batch = batch(Variant::Vt, 5, &mut draw);
    let learn = |threads| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        let mut network = network.clone();
        let mut gradient = vec![0.0; network.parameters.len()];
        let loss = pool.install(|| network.learn(&batch, &Step::default(), &mut gradient));
        (loss, gradient, network.moments)
    };
    assert!(learn(1) == learn(3));
}

#[test]
fn running_moments_follow_those_of_batches() {
    let mut draw = uniform(7);
    let senses = Variant::V;
    let mut network = Network::new(&tiny(), senses, &mut draw);
    let batch = batch(senses, 4, &mut draw);
    let passes = |network: &Network, is_training| {
        let mut passes = Vec::new();
        network.encode(&batch, is_training, &mut passes);
        passes
    };
    let in_training: Vec<EncoderPass> = passes(&network, true);
    let mut gradient = vec![0.0; network.parameters.len()];
    for _ in 0..200 {
        network.learn(&batch, &Step::default(), &mut gradient);
    }
    let later = passes(&network, false);
    let pairs = in_training[0].embedding.iter().zip(&later[0].embedding);
    for (now, later) in pairs {
        assert!(
            (now - later).abs() < 0.02 * (1.0 + now.abs()),
            "{now} {later}"
        );
    }
}

#[test]
fn swapped_sensors_swap_their_embeddings() {
    let mut draw = uniform(8);
    let senses = Variant::T;
    let network = Network::new(&tiny(), senses, &mut draw);
    let batch = batch(senses, 3, &mut draw);
    let half = batch.touch.len() / 2;
    let swapped = Batch {
        touch: [&batch.touch[half..], &batch.touch[..half]].concat(),
        ..batch.clone()
    };
    let [joined, of_swapped] = [&batch, &swapped].map(|batch| {
        let mut passes = Vec::new();
        network.encode(batch, false, &mut passes);
        network.join(&passes)
    });
    for (row, other) in joined.chunks(32).zip(of_swapped.chunks(32)) {
        assert_eq!(row[..16], other[16..]);
        assert_eq!(row[16..], other[..16]);
    }
}
