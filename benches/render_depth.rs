//! Tactile depth of an object of 100k triangles on 320 × 240 pixels, one thread.

use criterion::{Criterion, criterion_group, criterion_main};
use gripcast_tactile::{DepthLoad, Rasteriser, object_depth};

fn depth(criterion: &mut Criterion) {
    let load = DepthLoad::default();
    let Ok(scene) = load.scene() else { return };
    let mut rasteriser = Rasteriser::new();
    criterion.bench_function("tactile depth", |bencher| {
        bencher.iter(|| object_depth(&scene, load.grid(), &mut rasteriser));
    });
    let far = [-0.01, 1.0];
    criterion.bench_function("visible surface", |bencher| {
        bencher.iter(|| {
            let seen = rasteriser.nearest(scene.object, &scene.t_sensor_object, load.grid(), far);
            seen.len()
        });
    });
}

criterion_group!(benches, depth);
criterion_main!(benches);
