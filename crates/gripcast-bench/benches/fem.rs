//! The element sums that every Newton iteration of the simulator runs, on the standard gels.

#![allow(
    missing_docs,
    clippy::unwrap_used,
    reason = "a bench that cannot set up must stop"
)]

use std::hint::black_box;

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use glam::DVec3;
use gripcast_sim::fem::{Elastic, GelGrid, GelPad, GelResolution, NeoHookean, Projection};

/// A gel pressed to three quarters of its thickness, sheared and wavy.
fn pressed(grid: &GelGrid) -> Vec<DVec3> {
    let place = |p: &DVec3| {
        let depth = 0.75 + 0.03 * (700.0 * p.y).cos();
        DVec3::new(
            p.x * 1.02 + 0.1 * p.z,
            p.y + 1e-4 * (900.0 * p.x).sin(),
            p.z * depth,
        )
    };
    grid.positions().iter().map(place).collect()
}

fn element_sums(c: &mut Criterion) {
    for resolution in [
        GelResolution::Coarse,
        GelResolution::Default,
        GelResolution::Fine,
    ] {
        let grid = GelPad::default().grid(resolution).unwrap();
        let law = NeoHookean::new(1e6, 0.3).unwrap();
        let elastic = Elastic::new(grid.positions(), grid.tets(), law).unwrap();
        let x = pressed(&grid);
        let dx: Vec<DVec3> = x
            .iter()
            .map(|p| DVec3::new(1e-3 * p.y, 0.0, -5e-3 * p.z))
            .collect();
        let tets = grid.tets().len();
        let mut gradient = vec![DVec3::ZERO; x.len()];
        let mut values = elastic.pattern().zeros();

        let mut group = c.benchmark_group("fem");
        group.bench_function(BenchmarkId::new("energy", tets), |b| {
            b.iter(|| elastic.energy(black_box(&x)));
        });
        group.bench_function(BenchmarkId::new("gradient", tets), |b| {
            b.iter(|| elastic.gradient(black_box(&x), &mut gradient));
        });
        group.bench_function(BenchmarkId::new("hessian", tets), |b| {
            b.iter(|| elastic.hessian(black_box(&x), Projection::None, &mut values));
        });
        group.bench_function(BenchmarkId::new("projected_hessian", tets), |b| {
            b.iter(|| elastic.hessian(black_box(&x), Projection::Clamp, &mut values));
        });
        group.bench_function(BenchmarkId::new("inversion_free_step", tets), |b| {
            b.iter(|| elastic.inversion_free_step(black_box(&x), black_box(&dx)));
        });
        group.finish();
    }
}

criterion_group!(benches, element_sums);
criterion_main!(benches);
