use glam::{DQuat, DVec3};
use proptest::prelude::*;

use super::super::stencil_cases::{self as cases, Points, SCALES, assert_close, difference, flat};
use super::*;

fn closest_pt(x: &Points) -> Closest {
    point_triangle(x[0], x[1], x[2], x[3])
}

fn closest_ee(x: &Points) -> Closest {
    edge_edge(x[0], x[1], x[2], x[3])
}

/// Smallest distance over a fine grid of parameters, never below the true one.
fn sampled(points: &Points, edges: bool) -> f64 {
    const N: i32 = 60;
    let mut best = f64::INFINITY;
    for i in 0..=N {
        for j in 0..=N {
            let (s, t) = (f64::from(i) / f64::from(N), f64::from(j) / f64::from(N));
            let x = points;
            let r = if edges {
                x[0].lerp(x[1], s) - x[2].lerp(x[3], t)
            } else {
                if i + j > N {
                    continue;
                }
                x[0] - x[1] - (x[2] - x[1]) * s - (x[3] - x[1]) * t
            };
            best = best.min(r.length());
        }
    }
    best
}

fn check(points: &Points, closest: &Closest, scale: f64, edges: bool) {
    let w = closest.weights;
    let sum = if edges {
        [w[0] + w[1] - 1.0, w[2] + w[3] + 1.0]
    } else {
        [w[0] - 1.0, w[1] + w[2] + w[3] + 1.0]
    };
    assert_close(&sum, &[0.0; 2], 1.0, 1e-14, "sums of the weights");
    assert!(w.iter().all(|w| w.abs() <= 1.0 + 1e-14), "{closest:?}");
    let signs = if edges {
        [1.0, 1.0, -1.0, -1.0]
    } else {
        [1.0, -1.0, -1.0, -1.0]
    };
    assert!(
        w.iter().zip(signs).all(|(w, sign)| w * sign >= -1e-15),
        "{closest:?}"
    );
    let offset = closest.relative(points).to_array();
    assert_close(&closest.offset.to_array(), &offset, scale, 1e-11, "offset");
    let sampled = sampled(points, edges);
    let distance = closest.distance();
    assert!(
        distance <= sampled + 1e-12 * scale,
        "{distance} above {sampled}"
    );
    assert!(
        distance >= sampled - 0.1 * scale,
        "{distance} below {sampled}"
    );
}

#[test]
fn closest_points_beat_every_sample() {
    for scale in SCALES {
        for points in cases::point_triangle(scale) {
            check(&points, &closest_pt(&points), scale, false);
        }
        for points in cases::edge_edge(scale) {
            check(&points, &closest_ee(&points), scale, true);
        }
    }
}

/// Finite differences across a jump of the second derivative are only first order.
fn tolerance(points: &Points, step: f64, closest: impl Fn(&Points) -> Closest) -> f64 {
    let region = closest(points).region();
    let crossed = (0..12).any(|i| {
        [-step, step]
            .iter()
            .any(|&h| closest(&cases::moved(points, i, h)).region() != region)
    });
    if crossed { 1e-3 } else { 1e-6 }
}

#[test]
fn gradient_matches_finite_differences() {
    for scale in SCALES {
        let step = 1e-6 * scale;
        for points in cases::point_triangle(scale) {
            let expected = difference(&points, step, |x| closest_pt(x).squared);
            let found = flat(&closest_pt(&points).gradient());
            let tolerance = tolerance(&points, step, closest_pt);
            assert_close(&found, &expected, scale, tolerance, "point-triangle");
        }
        for points in cases::edge_edge(scale) {
            let [u, v] = [points[1] - points[0], points[3] - points[2]];
            let sine = u.cross(v).length() / (u.length() * v.length());
            // Closest parameters jump at parallel edges: no gradient there.
            if sine < 1e-3 {
                continue;
            }
            let expected = difference(&points, step, |x| closest_ee(x).squared);
            let found = flat(&closest_ee(&points).gradient());
            let tolerance = tolerance(&points, step, closest_ee);
            assert_close(&found, &expected, scale, tolerance, "edge-edge");
        }
    }
}

#[test]
fn regions_of_a_triangle() {
    let [t0, t1, t2] = [DVec3::ZERO, DVec3::X, DVec3::Y];
    let region = |x, y| point_triangle(DVec3::new(x, y, 0.3), t0, t1, t2).region();
    assert_eq!(region(0.2, 0.2), Region::PointTriangle);
    assert_eq!(region(0.5, -0.2), Region::PointEdge(0, 1, 2));
    assert_eq!(region(0.8, 0.8), Region::PointEdge(0, 2, 3));
    assert_eq!(region(-0.1, 0.5), Region::PointEdge(0, 1, 3));
    assert_eq!(region(-0.1, -0.2), Region::PointPoint(0, 1));
    assert_eq!(region(1.4, -0.2), Region::PointPoint(0, 2));
    assert_eq!(region(-0.2, 1.4), Region::PointPoint(0, 3));
}

#[test]
fn regions_of_two_edges() {
    let region = |x, y| {
        let middle = DVec3::new(x, y, 0.3);
        edge_edge(DVec3::ZERO, DVec3::X, middle - DVec3::Y, middle + DVec3::Y).region()
    };
    assert_eq!(region(0.5, 0.0), Region::EdgeEdge);
    assert_eq!(region(-0.5, 0.0), Region::PointEdge(0, 2, 3));
    assert_eq!(region(1.5, 0.0), Region::PointEdge(1, 2, 3));
    assert_eq!(region(0.5, 2.0), Region::PointEdge(2, 0, 1));
    assert_eq!(region(0.5, -2.0), Region::PointEdge(3, 0, 1));
    assert_eq!(region(-0.5, 2.0), Region::PointPoint(0, 2));
    assert_eq!(region(1.5, -2.0), Region::PointPoint(1, 3));
}

#[test]
fn degenerate_stencils_have_finite_results() {
    let points = [
        DVec3::ZERO,
        DVec3::X,
        DVec3::X * 2.0,
        DVec3::new(0.3, 0.0, 0.0),
        DVec3::new(0.3, 0.4, 0.0),
        DVec3::new(1e-160, 0.0, 0.0),
    ];
    for a in points {
        for b in points {
            for c in points {
                for d in points {
                    let x = [a, b, c, d];
                    check(&x, &closest_pt(&x), 1.0, false);
                    check(&x, &closest_ee(&x), 1.0, true);
                }
            }
        }
    }
}

#[test]
fn thin_triangles_keep_their_interior() {
    for width in [1e-2, 1e-4, 1e-5, 1e-7, 1e-9, 1e-11, 0.0] {
        for (fraction, height) in [
            (0.4, 1e-6),
            (0.4, 0.1),
            (-2.0, 0.1),
            (3.0, 1e-6),
            (0.1, 0.0),
        ] {
            let p = DVec3::new(0.7, fraction * width, height);
            let x = [p, DVec3::ZERO, DVec3::X, DVec3::new(0.8, width, 0.0)];
            for (i, j, k) in [(1, 2, 3), (2, 3, 1), (3, 1, 2), (3, 2, 1)] {
                let permuted = [x[0], x[i], x[j], x[k]];
                let closest = closest_pt(&permuted);
                check(&permuted, &closest, 1.0, false);
                if (0.0..1.0).contains(&fraction) && width > 1e-8 {
                    let error = (closest.distance() - height).abs();
                    assert!(error <= 1e-12 + 1e-17 / width, "{error:e} at {permuted:?}");
                }
            }
        }
    }
}

/// Coordinates that often coincide or align.
fn coordinate() -> impl Strategy<Value = f64> {
    prop_oneof![-1.0..1.0_f64, (-2_i32..=2).prop_map(|n| f64::from(n) * 0.5)]
}

fn stencil() -> impl Strategy<Value = Points> {
    let point = || prop::array::uniform3(coordinate()).prop_map(DVec3::from_array);
    [point(), point(), point(), point()]
}

/// Both squared distances of a stencil.
fn squared(x: &Points) -> [f64; 2] {
    [closest_pt(x).squared, closest_ee(x).squared]
}

fn same_distance(a: f64, b: f64) -> bool {
    (a.sqrt() - b.sqrt()).abs() <= 1e-8
}

proptest! {
    #[test]
    fn distance_is_invariant_to_rigid_motion(
        x in stencil(),
        angles in prop::array::uniform3(-3.0..3.0_f64),
        shift in prop::array::uniform3(-1.0..1.0_f64),
    ) {
        let [a, b, c] = angles;
        let rotation = DQuat::from_euler(glam::EulerRot::XYZ, a, b, c);
        let moved = x.map(|p| rotation * p + DVec3::from_array(shift));
        for (before, after) in squared(&x).into_iter().zip(squared(&moved)) {
            prop_assert!(same_distance(before, after), "{before} became {after}");
        }
    }

    #[test]
    fn distance_does_not_depend_on_the_order_of_points(x in stencil()) {
        let [pt, ee] = squared(&x);
        for order in [[0, 2, 3, 1], [0, 3, 1, 2], [0, 1, 3, 2]] {
            let [other, _] = squared(&order.map(|i: usize| x[i]));
            prop_assert!(same_distance(pt, other), "{pt} became {other}");
        }
        for order in [[1, 0, 2, 3], [0, 1, 3, 2], [2, 3, 0, 1], [3, 2, 1, 0]] {
            let [_, other] = squared(&order.map(|i: usize| x[i]));
            prop_assert!(same_distance(ee, other), "{ee} became {other}");
        }
    }

    #[test]
    fn closest_points_beat_samples_where_points_coincide(x in stencil()) {
        check(&x, &closest_pt(&x), 1.0, false);
        check(&x, &closest_ee(&x), 1.0, true);
    }
}
