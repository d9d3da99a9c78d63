//! Contact mathematics: nanoseconds a call.
//!
//! `…/near` are stencils of 1–2 mm features within `d_hat` (0.5 mm) of each other, in all regions;
//! `…/candidates` are what a broad phase hands over: bounding boxes grown by `d_hat` overlap.

#![allow(missing_docs, reason = "a bench")]

use std::hint::black_box;

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use glam::DVec3;
use gripcast_sim::contact::barrier::Barrier;
use gripcast_sim::contact::ccd::{edge_edge_toi, point_triangle_toi};
use gripcast_sim::contact::distance::{edge_edge, point_triangle};
use gripcast_sim::contact::friction::Friction;
use gripcast_sim::contact::mollifier::{mollifier, threshold};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

type Points = [DVec3; 4];

const COUNT: usize = 8192;
const BARRIER: Barrier = Barrier {
    kappa: 3e6,
    d_hat: 5e-4,
};

/// Stencils of features about 1.5 mm long that pass `wanted`.
fn stencils(seed: u64, wanted: impl Fn(&Points) -> bool) -> Vec<Points> {
    let mut rng = Pcg64::seed_from_u64(seed);
    let mut point = |size: f64| DVec3::from_array([0; 3].map(|_| rng.random_range(-size..size)));
    let mut found = Vec::with_capacity(COUNT);
    while found.len() < COUNT {
        let x = std::array::from_fn(|_| point(1e-3));
        if wanted(&x) {
            found.push(x);
        }
    }
    found
}

fn boxes_overlap(first: &[DVec3], second: &[DVec3]) -> bool {
    let bounds = |points: &[DVec3]| {
        let low = points.iter().copied().fold(points[0], DVec3::min);
        (low, points.iter().copied().fold(low, DVec3::max))
    };
    let (a, b) = (bounds(first), bounds(second));
    let gap = (a.0 - b.1).max(b.0 - a.1);
    gap.max_element() <= BARRIER.d_hat
}

fn long_enough(x: &Points, pairs: &[(usize, usize)]) -> bool {
    pairs.iter().all(|&(i, j)| x[i].distance(x[j]) > 7e-4)
}

fn point_triangles(near: bool) -> Vec<Points> {
    stencils(1, |x| {
        long_enough(x, &[(1, 2), (2, 3), (1, 3)])
            && boxes_overlap(&x[..1], &x[1..])
            && (!near || point_triangle(x[0], x[1], x[2], x[3]).squared < BARRIER.d_hat_squared())
    })
}

fn edge_edges(near: bool) -> Vec<Points> {
    stencils(2, |x| {
        long_enough(x, &[(0, 1), (2, 3)])
            && boxes_overlap(&x[..2], &x[2..])
            && (!near || edge_edge(x[0], x[1], x[2], x[3]).squared < BARRIER.d_hat_squared())
    })
}

/// One criterion measurement of `call` over all `inputs`.
fn measure<T, R>(c: &mut Criterion, name: &str, set: &str, inputs: &[T], call: impl Fn(&T) -> R) {
    let mut group = c.benchmark_group(name);
    group.throughput(Throughput::Elements(inputs.len() as u64));
    group.bench_with_input(
        BenchmarkId::from_parameter(set),
        inputs,
        |bencher, inputs| {
            bencher.iter(|| {
                for input in inputs {
                    black_box(call(black_box(input)));
                }
            });
        },
    );
    group.finish();
}

fn distances(c: &mut Criterion) {
    for (set, near) in [("near", true), ("candidates", false)] {
        let (pt, ee) = (point_triangles(near), edge_edges(near));
        measure(c, "point_triangle", set, &pt, |x| {
            point_triangle(x[0], x[1], x[2], x[3])
        });
        measure(c, "edge_edge", set, &ee, |x| {
            edge_edge(x[0], x[1], x[2], x[3])
        });
    }
}

fn terms(c: &mut Criterion) {
    let pt = point_triangles(true);
    let ee = edge_edges(true);
    let closest: Vec<_> = pt
        .iter()
        .map(|x| (point_triangle(x[0], x[1], x[2], x[3]), *x))
        .collect();
    measure(c, "barrier_value", "near", &closest, |(at, _)| {
        BARRIER.value_squared(at.squared)
    });
    measure(c, "barrier_derivatives", "near", &closest, |(at, _)| {
        BARRIER.squared(at.squared).to_linear(at.squared)
    });
    measure(c, "mollifier", "near", &ee, |x| {
        let (ea, eb) = (x[1] - x[0], x[3] - x[2]);
        mollifier(ea, eb, threshold(ea, eb))
    });
    let friction: Vec<_> = closest
        .iter()
        .map(|(at, x)| {
            let friction = Friction {
                normal: at.offset.normalize(),
                limit: 0.4,
                epsilon: 1e-5,
            };
            (friction, x[1] * 1e-2)
        })
        .collect();
    measure(c, "friction_gradient", "near", &friction, |(f, u)| {
        f.gradient(*u)
    });
    measure(c, "friction_hessian", "near", &friction, |(f, u)| {
        f.hessian(*u)
    });
}

/// Steps of 0.05 mm, as in a grasp, and of 1 mm, which hit often.
fn collision(c: &mut Criterion) {
    for (set, step) in [("step_0.05mm", 5e-2), ("step_1mm", 1.0)] {
        let moved = |stencils: Vec<Points>, seed| -> Vec<(Points, Points)> {
            let motions = self::stencils(seed, |_| true);
            let end = |x: &Points, m: &Points| std::array::from_fn(|i| x[i] + m[i] * step);
            let pairs = stencils.iter().zip(&motions);
            pairs.map(|(x, m)| (*x, end(x, m))).collect()
        };
        measure(
            c,
            "point_triangle_toi",
            set,
            &moved(point_triangles(true), 3),
            |(x0, x1)| point_triangle_toi(x0, x1, 0.1),
        );
        measure(
            c,
            "edge_edge_toi",
            set,
            &moved(edge_edges(true), 4),
            |(x0, x1)| edge_edge_toi(x0, x1, 0.1),
        );
    }
}

criterion_group!(benches, distances, terms, collision);
criterion_main!(benches);
