//! Tactile depth of an object of 100k triangles on 320 × 240 pixels, one thread.

use criterion::{Criterion, criterion_group, criterion_main};
use glam::DQuat;
use gripcast_geometry::Pose;
use gripcast_tactile::rays::bumpy_ball;
use gripcast_tactile::{Rasteriser, SensorGeometry, TactileScene, object_depth};

const GRID: SensorGeometry = SensorGeometry {
    width: 320,
    height: 240,
    pixel_m: 6.34e-5,
    gel_thickness_m: 4e-3,
};

fn depth(criterion: &mut Criterion) {
    let ball = bumpy_ball(0.025, 5e-4, 224, 224);
    let turn = DQuat::from_rotation_x(1.1) * DQuat::from_rotation_y(0.4);
    let pose = Pose::from_rotation(turn);
    let Ok(scene) = TactileScene::pressed(&ball, &pose, 1e-3, &GRID) else {
        return;
    };
    let mut rasteriser = Rasteriser::new();
    criterion.bench_function("tactile depth", |bencher| {
        bencher.iter(|| object_depth(&scene, &GRID, &mut rasteriser));
    });
    let far = [-0.01, 1.0];
    criterion.bench_function("visible surface", |bencher| {
        bencher.iter(|| {
            let seen = rasteriser.nearest(scene.object, &scene.t_sensor_object, &GRID, far);
            seen.len()
        });
    });
}

criterion_group!(benches, depth);
criterion_main!(benches);
