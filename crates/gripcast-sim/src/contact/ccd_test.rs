use glam::DVec3;
use proptest::prelude::*;

use super::super::stencil_cases::{self as cases, Points};
use super::*;

const SLACK: f64 = 0.1;

fn at(x0: &Points, x1: &Points, t: f64) -> Points {
    std::array::from_fn(|i| x0[i] + (x1[i] - x0[i]) * t)
}

fn largest_coordinate(x0: &Points, x1: &Points) -> f64 {
    x0.iter()
        .chain(x1)
        .map(|p| p.abs().max_element())
        .fold(0.0, f64::max)
}

/// Checks that the gap remains along the trajectory and that the time is not early.
fn check<S: Stencil>(x0: &Points, x1: &Points) -> Option<f64> {
    let found = time_of_impact::<S>(x0, x1, SLACK);
    let gap = SLACK * S::closest(x0).distance();
    // Below the rounding of positions the features touch.
    if gap < 1e-12 * largest_coordinate(x0, x1) {
        return found;
    }
    let end = found.unwrap_or(1.0);
    for i in 0..=200 {
        let t = end * f64::from(i) / 200.0;
        let distance = S::closest(&at(x0, x1, t)).distance();
        assert!(
            distance >= gap,
            "{distance:e} < {gap:e} at {t} of {found:?}"
        );
    }
    if let Some(t) = found {
        let distance = S::closest(&at(x0, x1, t)).distance();
        assert!(
            distance <= 1.1 * gap,
            "stopped early at {t}: {distance:e}, {gap:e}"
        );
    }
    found
}

#[test]
fn gap_remains_along_the_trajectory() {
    let mut hits = [0, 0];
    for scale in cases::SCALES {
        let (from, to) = (cases::random(500, scale, 31), cases::random(500, scale, 32));
        for (x0, x1) in from.iter().zip(&to) {
            hits[0] += usize::from(check::<PointTriangle>(x0, x1).is_some());
            hits[1] += usize::from(check::<EdgeEdge>(x0, x1).is_some());
        }
    }
    assert!(
        hits.iter().all(|&hits| hits > 100 && hits < 1400),
        "{hits:?}"
    );
}

#[test]
fn head_on_impact_keeps_a_tenth_of_the_gap() {
    let triangle = [DVec3::ZERO, DVec3::X * 1e-3, DVec3::Y * 1e-3];
    let point = DVec3::new(2e-4, 2e-4, 1e-3);
    let x0 = [point, triangle[0], triangle[1], triangle[2]];
    let mut x1 = x0;
    x1[0].z = -1e-3;
    let found = point_triangle_toi(&x0, &x1, SLACK).unwrap();
    assert!((0.449..=0.45).contains(&found), "{found}");
    x1[0].z = 1.1e-4;
    assert_eq!(point_triangle_toi(&x0, &x1, SLACK), None);
}

/// Coplanar faces reach the gap exactly; rounding must not give a time of 0.
#[test]
fn parallel_faces_do_not_stop_early() {
    for k in 1..200 {
        let height = 1e-5 * f64::from(k).sqrt();
        let point = DVec3::new(2e-4, 2e-4, 4e-3 + height);
        let at = |x: f64, y: f64| DVec3::new(x, y, 4e-3);
        let x0 = [point, at(0.0, 0.0), at(1e-3, 0.0), at(0.0, 1e-3)];
        let mut x1 = x0;
        for corner in &mut x1[1..] {
            corner.z += 3.0 * height;
        }
        let found = point_triangle_toi(&x0, &x1, SLACK).unwrap();
        assert!((0.29..=0.3 + 1e-9).contains(&found), "{height}: {found}");
    }
}

#[test]
fn sliding_past_has_no_impact() {
    let over = DVec3::new(0.1, 0.1, 1e-5);
    let x0 = [over, DVec3::ZERO, DVec3::X, DVec3::Y];
    let x1 = [over + DVec3::X * 5.0, x0[1], x0[2], x0[3]];
    assert_eq!(point_triangle_toi(&x0, &x1, SLACK), None);
    let bar = [over - DVec3::Y * 0.5, over + DVec3::Y * 0.5];
    let x0 = [-DVec3::X, DVec3::X, bar[0], bar[1]];
    let x1 = [
        x0[0],
        x0[1],
        bar[0] + DVec3::Y * 5.0,
        bar[1] + DVec3::Y * 5.0,
    ];
    assert_eq!(edge_edge_toi(&x0, &x1, SLACK), None);
}

#[test]
fn common_motion_has_no_impact() {
    for x0 in cases::random(50, 1e-3, 33) {
        let x1 = x0.map(|p| p + DVec3::new(3.0, -2.0, 1.0));
        assert_eq!(point_triangle_toi(&x0, &x1, SLACK), None);
        assert_eq!(edge_edge_toi(&x0, &x1, SLACK), None);
    }
}

#[test]
fn touching_features_cannot_move_against_each_other() {
    let x0 = [DVec3::new(0.2, 0.2, 0.0), DVec3::ZERO, DVec3::X, DVec3::Y];
    let mut x1 = x0;
    assert_eq!(point_triangle_toi(&x0, &x1, SLACK), None);
    x1[0].z = -1.0;
    assert_eq!(point_triangle_toi(&x0, &x1, SLACK), Some(0.0));
}

#[test]
fn half_space_time_is_exact() {
    assert_eq!(half_space_toi(1.0, 0.5, SLACK), None);
    assert_eq!(half_space_toi(1.0, 0.1, SLACK), None);
    let found = half_space_toi(1.0, -1.0, SLACK).unwrap();
    assert!((found - 0.45).abs() < 1e-15);
    assert_eq!(half_space_toi(0.0, -1.0, SLACK), Some(0.0));
    assert_eq!(half_space_toi(-1.0, 1.0, SLACK), None);
}

/// Points on a coarse grid or anywhere, so that features are often coplanar or collinear.
fn stencil() -> impl Strategy<Value = Points> {
    let coordinate = || prop_oneof![-1.0..1.0_f64, (-2_i32..=2).prop_map(|n| f64::from(n) * 0.5)];
    let point = move || [coordinate(), coordinate(), coordinate()].prop_map(DVec3::from_array);
    [point(), point(), point(), point()]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(1000))]

    #[test]
    fn steps_never_pass_through(x0 in stencil(), x1 in stencil()) {
        check::<PointTriangle>(&x0, &x1);
        check::<EdgeEdge>(&x0, &x1);
    }

    #[test]
    fn small_steps_never_pass_through(x0 in stencil(), x1 in stencil(), step in 1e-6..1e-2_f64) {
        let x1 = at(&x0, &x1, step);
        check::<PointTriangle>(&x0, &x1);
        check::<EdgeEdge>(&x0, &x1);
    }
}
