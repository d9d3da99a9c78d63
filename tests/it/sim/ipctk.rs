//! Contact mathematics against the IPC Toolkit.
//!
//! `tests/peers/ipctk_cases.py` writes `tests/data/ipctk_cases.json`. All values agree to 1e-10 of
//! the largest entry; no case lies on a region boundary except one pair of parallel edges.

use glam::{DMat3, DVec3};
use gripcast_sim::affine::Matrix12;
use gripcast_sim::contact::barrier::Barrier;
use gripcast_sim::contact::ccd::{edge_edge_toi, half_space_toi, point_triangle_toi};
use gripcast_sim::contact::distance::{Closest, Region, edge_edge, point_triangle};
use gripcast_sim::contact::friction::{Friction, f0, f1, f1_over_y, f2};
use gripcast_sim::contact::mollifier;
use serde::Deserialize;

const TOLERANCE: f64 = 1e-10;

#[derive(Deserialize)]
struct Cases {
    source: String,
    parameters: Parameters,
    barrier: Vec<BarrierCase>,
    point_triangle: Vec<DistanceCase>,
    edge_edge: Vec<DistanceCase>,
    mollifier: Vec<MollifierCase>,
    friction: Vec<FrictionScalars>,
    potential: Vec<PotentialCase>,
    ccd: Vec<CcdCase>,
    half_space: Vec<HalfSpaceCase>,
}

#[derive(Deserialize)]
struct Parameters {
    d_hat_m: f64,
    kappa_pa: f64,
    mu: f64,
    epsilon_m: f64,
    additive_slack: f64,
}

#[derive(Deserialize)]
struct BarrierCase {
    form: String,
    x: f64,
    b: [f64; 3],
}

#[derive(Deserialize)]
struct DistanceCase {
    name: String,
    x: [[f64; 3]; 4],
    #[serde(rename = "type")]
    region: String,
    squared: f64,
    gradient: [f64; 12],
}

#[derive(Deserialize)]
struct MollifierCase {
    angle: f64,
    x: [[f64; 3]; 4],
    epsilon: f64,
    value: f64,
    gradient: [f64; 12],
}

#[derive(Deserialize)]
struct FrictionScalars {
    y: f64,
    f: [f64; 4],
}

#[derive(Deserialize)]
struct PotentialCase {
    name: String,
    kind: String,
    x: [[f64; 3]; 4],
    energy: f64,
    gradient: [f64; 12],
    friction: Option<FrictionCase>,
}

#[derive(Deserialize)]
struct FrictionCase {
    motion: [[f64; 3]; 4],
    force: f64,
    energy: f64,
    gradient: [f64; 12],
    hessian: Vec<f64>,
}

/// Times of impact; `None` if the whole step is free.
#[derive(Deserialize)]
struct CcdCase {
    kind: String,
    x0: [[f64; 3]; 4],
    x1: [[f64; 3]; 4],
    tight: Option<f64>,
    additive: Option<f64>,
}

#[derive(Deserialize)]
struct HalfSpaceCase {
    d0: f64,
    d1: f64,
    toi: Option<f64>,
}

fn cases() -> Cases {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/ipctk_cases.json");
    let cases: Cases = serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap();
    assert!(cases.source.starts_with("ipctk 1.6.1"), "{}", cases.source);
    cases
}

fn points(x: &[[f64; 3]; 4]) -> [DVec3; 4] {
    x.map(DVec3::from_array)
}

fn closest(kind: &str, x: &[DVec3; 4]) -> Closest {
    match kind {
        "pt" => point_triangle(x[0], x[1], x[2], x[3]),
        "ee" => edge_edge(x[0], x[1], x[2], x[3]),
        other => panic!("unknown stencil {other}"),
    }
}

fn flat(vectors: &[DVec3; 4]) -> [f64; 12] {
    std::array::from_fn(|i| vectors[i / 3][i % 3])
}

fn symmetric(lower: &[f64]) -> Matrix12 {
    assert_eq!(lower.len(), 78);
    let at = |i: usize, j: usize| lower[i * (i + 1) / 2 + j];
    std::array::from_fn(|i| std::array::from_fn(|j| at(i.max(j), i.min(j))))
}

/// Asserts that the error relative to the largest expected entry is within the tolerance.
#[track_caller]
fn assert_close(found: &[f64], expected: &[f64], what: &str) {
    assert_eq!(found.len(), expected.len());
    let scale = expected.iter().fold(0.0_f64, |max, e| max.max(e.abs()));
    let error = found
        .iter()
        .zip(expected)
        .fold(0.0_f64, |max, (a, b)| max.max((a - b).abs()));
    println!(
        "{what}: {:.1e}",
        if error > 0.0 { error / scale } else { 0.0 }
    );
    assert!(
        error <= TOLERANCE * scale,
        "{what}: expected {expected:?}, found {found:?}"
    );
}

#[track_caller]
fn assert_close_matrix(found: &Matrix12, lower: &[f64], what: &str) {
    let expected = symmetric(lower);
    assert_close(found.as_flattened(), expected.as_flattened(), what);
}

#[test]
fn barrier_matches_ipctk() {
    let cases = cases();
    let barrier = Barrier {
        kappa: 1.0,
        d_hat: cases.parameters.d_hat_m,
    };
    for case in &cases.barrier {
        let (found, value) = match case.form.as_str() {
            "squared" => (barrier.squared(case.x), barrier.value_squared(case.x)),
            _ => (barrier.linear(case.x), barrier.value_linear(case.x)),
        };
        for (found, expected) in [found.value, found.first, found.second].iter().zip(case.b) {
            assert_close(&[*found], &[expected], &format!("barrier at {:e}", case.x));
        }
        assert_eq!(found.value, value);
    }
}

#[test]
fn distances_match_ipctk() {
    let cases = cases();
    for (kind, list) in [("pt", &cases.point_triangle), ("ee", &cases.edge_edge)] {
        for case in list {
            let x = points(&case.x);
            let found = closest(kind, &x);
            let what = |part: &str| format!("{kind} {} {part}", case.name);
            assert_close(&[found.squared], &[case.squared], &what("distance"));
            // Parallel edges have many closest pairs; the programs may choose different ones.
            if case.name == "parallel, overlapping" {
                continue;
            }
            assert_eq!(found.region(), region(&case.region), "{}", case.name);
            assert_close(&flat(&found.gradient()), &case.gradient, &what("gradient"));
        }
    }
}

/// Region of an ipctk distance type.
fn region(name: &str) -> Region {
    match name {
        "P_T0" => Region::PointPoint(0, 1),
        "P_T1" => Region::PointPoint(0, 2),
        "P_T2" => Region::PointPoint(0, 3),
        "P_E0" => Region::PointEdge(0, 1, 2),
        "P_E1" => Region::PointEdge(0, 2, 3),
        "P_E2" => Region::PointEdge(0, 1, 3),
        "P_T" => Region::PointTriangle,
        "EA0_EB0" => Region::PointPoint(0, 2),
        "EA0_EB1" => Region::PointPoint(0, 3),
        "EA1_EB0" => Region::PointPoint(1, 2),
        "EA1_EB1" => Region::PointPoint(1, 3),
        "EA_EB0" => Region::PointEdge(2, 0, 1),
        "EA_EB1" => Region::PointEdge(3, 0, 1),
        "EA0_EB" => Region::PointEdge(0, 2, 3),
        "EA1_EB" => Region::PointEdge(1, 2, 3),
        "EA_EB" => Region::EdgeEdge,
        other => panic!("unknown type {other}"),
    }
}

#[test]
fn mollifier_matches_ipctk() {
    for case in &cases().mollifier {
        let x = points(&case.x);
        let (ea, eb) = (x[1] - x[0], x[3] - x[2]);
        let epsilon = mollifier::threshold(ea, eb);
        let found = mollifier::mollifier(ea, eb, epsilon);
        let what = |part: &str| format!("mollifier at {} {part}", case.angle);
        assert_close(&[epsilon], &[case.epsilon], &what("threshold"));
        assert_close(&[found.value], &[case.value], &what("value"));
        assert_close(&flat(&found.gradient()), &case.gradient, &what("gradient"));
    }
}

#[test]
fn friction_scalars_match_ipctk() {
    let cases = cases();
    let epsilon = cases.parameters.epsilon_m;
    for case in &cases.friction {
        let found = [f0, f1, f1_over_y, f2].map(|f| f(case.y, epsilon));
        for (found, expected) in found.iter().zip(case.f) {
            assert_close(&[*found], &[expected], &format!("friction at {:e}", case.y));
        }
    }
}

#[test]
fn barrier_potentials_match_ipctk() {
    let cases = cases();
    let barrier = Barrier {
        kappa: cases.parameters.kappa_pa,
        d_hat: cases.parameters.d_hat_m,
    };
    for case in &cases.potential {
        let x = points(&case.x);
        let closest = closest(&case.kind, &x);
        let b = barrier.squared(closest.squared);
        let slope = flat(&closest.gradient());
        let (m, m_slope) = if case.kind == "ee" {
            let (ea, eb) = (x[1] - x[0], x[3] - x[2]);
            let epsilon = mollifier::threshold(ea, eb);
            let m = mollifier::mollifier(ea, eb, epsilon);
            (m.value, flat(&m.gradient()))
        } else {
            (1.0, [0.0; 12])
        };
        let gradient: [f64; 12] =
            std::array::from_fn(|i| m * b.first * slope[i] + b.value * m_slope[i]);
        let what = |part: &str| format!("{} {part}", case.name);
        assert_close(&[m * b.value], &[case.energy], &what("energy"));
        assert_close(&gradient, &case.gradient, &what("gradient"));
    }
}

#[test]
fn friction_potentials_match_ipctk() {
    let cases = cases();
    let Parameters {
        mu,
        epsilon_m,
        kappa_pa,
        d_hat_m,
        ..
    } = cases.parameters;
    let barrier = Barrier {
        kappa: kappa_pa,
        d_hat: d_hat_m,
    };
    let mut compared = 0;
    for case in &cases.potential {
        let Some(expected) = &case.friction else {
            continue;
        };
        compared += 1;
        let at = closest(&case.kind, &points(&case.x));
        let force = -barrier.squared(at.squared).to_linear(at.squared).first;
        let friction = Friction {
            normal: at.offset / at.distance(),
            limit: mu * force,
            epsilon: epsilon_m,
        };
        let u = at.relative(&points(&expected.motion));
        let gradient = at.weights.map(|w| friction.gradient(u) * w);
        let hessian = spread(&at.weights, &friction.hessian(u));
        let what = |part: &str| format!("friction, {} {part}", case.name);
        assert_close(&[force], &[expected.force], &what("normal force"));
        assert_close(&[friction.value(u)], &[expected.energy], &what("energy"));
        assert_close(&flat(&gradient), &expected.gradient, &what("gradient"));
        assert_close_matrix(&hessian, &expected.hessian, &what("hessian"));
    }
    assert_eq!(compared, 5);
}

/// Hessian of the stencil from the 3×3 block of the relative motion, by the weights.
fn spread(weights: &[f64; 4], block: &DMat3) -> Matrix12 {
    let entry = |i: usize, j: usize| weights[i / 3] * weights[j / 3] * block.col(j % 3)[i % 3];
    std::array::from_fn(|i| std::array::from_fn(|j| entry(i, j)))
}

#[test]
fn times_of_impact_are_safe_and_not_early() {
    let cases = cases();
    let slack = cases.parameters.additive_slack;
    let mut hits = 0;
    for (number, case) in cases.ccd.iter().enumerate() {
        let (x0, x1) = (points(&case.x0), points(&case.x1));
        let found = match case.kind.as_str() {
            "pt" => point_triangle_toi(&x0, &x1, slack),
            _ => edge_edge_toi(&x0, &x1, slack),
        };
        println!(
            "{number}: {found:?}, tight {:?}, additive {:?}",
            case.tight, case.additive
        );
        if let Some(tight) = case.tight {
            hits += 1;
            let found = found.expect("an impact is missed");
            assert!(found <= tight, "case {number}: {found} after {tight}");
            assert!(
                found >= 0.75 * tight,
                "case {number}: {found} far before {tight}"
            );
        }
        // Both preserve a tenth of the distance.
        if let (Some(ours), Some(additive)) = (found, case.additive) {
            assert!(
                ours >= 0.95 * additive,
                "case {number}: {ours}, not {additive}"
            );
        }
    }
    assert!(hits >= 16, "only {hits} impacts");
    for case in &cases.half_space {
        let found = half_space_toi(case.d0, case.d1, slack);
        match case.toi {
            Some(toi) => assert_close(&[found.unwrap()], &[toi], "half-space"),
            None => assert_eq!(found, None),
        }
    }
}
