use super::*;
use crate::architecture::{CONTACT_CHANNELS, ConvSpec};
use crate::predict::contract::InputName;

/// Seeded uniform numbers.
pub(crate) fn uniform(seed: u64) -> impl FnMut() -> f64 {
    let mut state = seed;
    move || {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (state >> 11) as f64 / (1_u64 << 53) as f64
    }
}

pub(crate) fn tiny() -> Architecture {
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
        camera_embedding: 12,
        geometry: true,
        fallbacks: true,
        hidden: 16,
    }
}

pub(crate) fn batch(modality: Modality, count: usize, draw: &mut impl FnMut() -> f64) -> Batch {
    let image: usize = IMAGE.iter().product();
    let mut images = |n: usize| (0..n * image).map(|_| (draw() - 0.5) as f32).collect();
    Batch {
        touch: images(2 * count * usize::from(modality.has_touch())),
        vision: images(count * usize::from(modality.has_vision())),
        depth: images(count * usize::from(modality.has_depth())),
        available: Vec::new(),
        geometry: (0..count * GEOMETRY)
            .map(|i| 0.1 * (i % 7) as f32)
            .collect(),
        contact: match modality.has_touch() {
            true => (0..2 * count * 80 * CONTACT_CHANNELS)
                .map(|i| 0.2 * (i % 11) as f32 - 1.0)
                .collect(),
            false => Vec::new(),
        },
        targets: (0..count).map(|i| (i % 2) as f32).collect(),
        weights: (0..count).map(|i| 0.5 + i as f32).collect(),
    }
}

/// Network, batch and dropout for a step of a scope; the running statistics are not the initial ones.
fn case(scope: Scope) -> (Network, Batch, Step) {
    let mut draw = uniform(5);
    let mut network = Network::new(&tiny(), Modality::Vtd, &mut draw);
    let mut batch = batch(Modality::Vtd, 4, &mut draw);
    // One sample lacks its camera images, another its geometry.
    batch.available = vec![Modality::Vtd, Modality::T, Modality::Vtd, Modality::Vt];
    batch.geometry[2 * GEOMETRY..3 * GEOMETRY].fill(f32::NAN);
    for value in &mut network.running_stats {
        *value += 0.3 * draw() as f32;
    }
    let dropout = (0..4 * 16).map(|i| if i % 5 == 0 { 0.0 } else { 1.25 });
    let step = Step {
        number: 0,
        dropout: dropout.collect(),
        scope,
    };
    (network, batch, step)
}

#[test]
fn gradients_match_finite_differences() {
    for scope in [
        Scope::All,
        Scope::FixedStats,
        Scope::Head,
        Scope::Geometry,
        Scope::Contact,
        Scope::Touch,
    ] {
        let (network, batch, step) = case(scope);
        let mut gradient = vec![0.0; network.parameters.len()];
        network.clone().train_step(&batch, &step, &mut gradient);
        for param in scope.params(network.layout()) {
            let expected = &gradient[param.range()];
            let squares =
                |values: &[f32]| values.iter().map(|x| f64::from(*x).powi(2)).sum::<f64>();
            let norm = squares(expected).sqrt();
            assert!(norm > 1e-3, "{scope:?} {}: {norm}", param.name);
            let size = squares(&network.parameters[param.range()]).sqrt().max(0.1);
            let loss = |way: f64| {
                let mut moved = network.clone();
                for (parameter, slope) in moved.parameters[param.range()].iter_mut().zip(expected) {
                    *parameter += (way * f64::from(*slope) / norm) as f32;
                }
                moved.train_step(&batch, &step, &mut vec![0.0; gradient.len()])
            };
            // Kinks of ReLU and rounding limit the step; one of these sizes is suitable.
            let errors = [1e-2, 3e-3, 1e-3].map(|fraction| {
                let step = fraction * size;
                ((loss(step) - loss(-step)) / (2.0 * step) / norm - 1.0).abs()
            });
            let min = errors.into_iter().fold(f64::INFINITY, f64::min);
            assert!(min < 0.05, "{scope:?} {}: {errors:?}", param.name);
        }
    }
}

#[test]
fn narrower_scopes_leave_statistics_and_encoders() {
    for scope in [Scope::FixedStats, Scope::Head] {
        let (mut network, batch, step) = case(scope);
        let before = network.running_stats.clone();
        let mut gradient = vec![0.0; network.parameters.len()];
        network.train_step(&batch, &step, &mut gradient);
        assert!(network.running_stats == before, "{scope:?}");
        let head = network.layout().heads[0].hidden[0].first;
        let is_encoder_fixed = gradient[..head].iter().all(|slope| *slope == 0.0);
        assert_eq!(is_encoder_fixed, scope == Scope::Head);
        assert!(gradient[head..].iter().any(|slope| *slope != 0.0));
    }
}

#[test]
fn results_do_not_depend_on_the_number_of_threads() {
    let mut draw = uniform(6);
    let network = Network::new(&tiny(), Modality::Vt, &mut draw);
    let batch = batch(Modality::Vt, 5, &mut draw);
    let train = |threads| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        let mut network = network.clone();
        let mut gradient = vec![0.0; network.parameters.len()];
        let loss = pool.install(|| network.train_step(&batch, &Step::default(), &mut gradient));
        (loss, gradient, network.running_stats)
    };
    assert!(train(1) == train(3));
}

#[test]
fn running_stats_converge_to_batch_stats() {
    let mut draw = uniform(7);
    let modality = Modality::V;
    let mut network = Network::new(&tiny(), modality, &mut draw);
    let batch = batch(modality, 4, &mut draw);
    let passes = |network: &Network, is_training| {
        let mut passes = Vec::new();
        let scope = if is_training {
            Scope::All
        } else {
            Scope::FixedStats
        };
        network.forward(&batch, scope, &mut passes);
        passes
    };
    let in_training: Vec<EncoderPass> = passes(&network, true);
    let mut gradient = vec![0.0; network.parameters.len()];
    for _ in 0..200 {
        network.train_step(&batch, &Step::default(), &mut gradient);
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
fn swapping_sensors_swaps_embeddings() {
    let mut draw = uniform(8);
    let modality = Modality::T;
    let network = Network::new(&tiny(), modality, &mut draw);
    let batch = batch(modality, 3, &mut draw);
    assert_eq!(network.heads().collect::<Vec<_>>(), [Modality::T]);
    let half = batch.touch.len() / 2;
    let swapped = Batch {
        touch: [&batch.touch[half..], &batch.touch[..half]].concat(),
        ..batch.clone()
    };
    let [joined, of_swapped] = [&batch, &swapped].map(|batch| {
        let mut passes = Vec::new();
        network.forward(batch, Scope::FixedStats, &mut passes);
        network.join(modality, &passes)
    });
    for (row, other) in joined.chunks(32).zip(of_swapped.chunks(32)) {
        assert_eq!(row[..16], other[16..]);
        assert_eq!(row[16..], other[..16]);
    }
}

#[test]
fn predictions_depend_on_their_inputs_alone() {
    let mut draw = uniform(9);
    let network = Network::new(&tiny(), Modality::Vtd, &mut draw);
    let whole = batch(Modality::Vtd, 3, &mut draw);
    let blind = Batch {
        vision: vec![0.0; whole.vision.len()],
        depth: vec![0.0; whole.depth.len()],
        ..whole.clone()
    };
    let (seen, unseen) = (network.outputs(&whole), network.outputs(&blind));
    let heads = network.heads().zip(seen.logits.iter().zip(&unseen.logits));
    for (head, (seen, unseen)) in heads {
        assert_eq!(seen == unseen, head == Modality::T, "{head}");
    }
    let read: Vec<InputName> = seen.geometry.iter().map(|(input, _)| *input).collect();
    assert_eq!(read, [InputName::Rgb, InputName::Depth]);
    assert!(seen.geometry.iter().all(|(_, g)| g.len() == 3 * GEOMETRY));
}

#[test]
fn geometry_is_learnt_without_touch_and_labels() {
    let (mut network, batch, step) = case(Scope::Geometry);
    let before = network.clone();
    let cameras = Batch {
        touch: Vec::new(),
        targets: Vec::new(),
        weights: Vec::new(),
        ..batch.clone()
    };
    let mut gradient = vec![0.0; network.parameters.len()];
    let loss = network.train_step(&cameras, &step, &mut gradient);
    let mut whole = vec![0.0; gradient.len()];
    assert_eq!(before.clone().train_step(&batch, &step, &mut whole), loss);
    assert!(gradient == whole);
    let layout = network.layout().clone();
    let touched: Vec<&str> = layout
        .params()
        .iter()
        .filter(|param| gradient[param.range()].iter().any(|slope| *slope != 0.0))
        .map(|param| param.name.split('.').next().unwrap())
        .collect();
    assert!(
        touched
            .iter()
            .all(|name| ["vision", "depth"].contains(name))
    );
    assert!(touched.contains(&"depth") && touched.contains(&"vision"));
    let touch = layout.encoders[0].stats[0][0].clone();
    assert_eq!(
        network.running_stats[touch.clone()],
        before.running_stats[touch]
    );
    assert!(network.running_stats != before.running_stats);
}

#[test]
fn missing_inputs_change_no_gradient() {
    let gradient = |noise: f32| {
        let mut draw = uniform(10);
        let mut network = Network::new(&tiny(), Modality::Td, &mut draw);
        let mut batch = batch(Modality::Td, 2, &mut draw);
        batch.available = vec![Modality::Td, Modality::T];
        let half = batch.depth.len() / 2;
        batch.depth[half..].fill(noise);
        let mut gradient = vec![0.0; network.parameters.len()];
        let step = Step {
            scope: Scope::FixedStats,
            ..Step::default()
        };
        let loss = network.train_step(&batch, &step, &mut gradient);
        (loss, gradient)
    };
    assert!(gradient(0.0) == gradient(3.0));
}
