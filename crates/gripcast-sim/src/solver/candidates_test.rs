//! The candidates miss no pair that acts.

use glam::{DMat3, DQuat, DVec3};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use super::super::gel_contact::Obstacle;
use super::super::test_scene::{centred, near_distances, random_point, small_pad};
use super::super::{Collider, Drive, Gel, GelMaterial, SolverParameters};
use crate::affine::AffineState;

const PARAMETERS: fn() -> SolverParameters = SolverParameters::default;

fn random_rotation(rng: &mut Pcg64, angle: f64) -> DMat3 {
    DMat3::from_quat(DQuat::from_scaled_axis(random_point(rng, angle)))
}

/// A pad whose face is near a vertex of the object.
fn pad_near(collider: &Collider, object: &AffineState, rng: &mut Pcg64) -> Gel {
    let vertex = rng.random_range(0..collider.vertices.len());
    let rotation = random_rotation(rng, 3.0);
    let face = object.point(collider.vertices[vertex]) + random_point(rng, 4e-4);
    let shift = DVec3::new(
        rng.random_range(-4e-3..4e-3),
        rng.random_range(-3e-3..3e-3),
        -4e-3,
    );
    let to_world = |p: DVec3| face + rotation * (p + shift);
    let material = GelMaterial::default();
    Gel::new(
        &small_pad(),
        &material,
        Drive::default(),
        &PARAMETERS(),
        to_world,
    )
    .unwrap()
}

#[test]
fn candidates_cover_all_active_pairs_within_the_margin() {
    let parameters = PARAMETERS();
    let barrier = parameters.barrier();
    let margin = parameters.candidate_margin_m;
    let mut rng = Pcg64::seed_from_u64(4);
    let mut totals = [0; 3];
    for name in ["mug", "wedge", "spike", "sphere"] {
        let mesh = centred(name, DMat3::IDENTITY);
        let collider = Collider::new(&mesh);
        for _ in 0..4 {
            let object =
                AffineState::rigid(random_point(&mut rng, 0.1), random_rotation(&mut rng, 3.0));
            let mut gel = pad_near(&collider, &object, &mut rng);
            assert!(gel.ensure_candidates(&object, &collider, &parameters));
            // Common rigid motion of gel and object; the gel's nodes move by most of the margin.
            let (rotation, shift) = (random_rotation(&mut rng, 1.0), random_point(&mut rng, 0.05));
            let moved = object.moved(rotation, shift);
            for x in &mut gel.x {
                let fraction = rng.random_range(0.0..0.99);
                let by = random_point(&mut rng, 1.0).normalize() * (fraction * margin);
                *x = rotation * (*x + by) + shift;
            }
            assert!(
                !gel.ensure_candidates(&moved, &collider, &parameters),
                "still covered"
            );
            gel.find_contacts(Obstacle {
                barrier: &barrier,
                now: &moved,
                start: &moved,
            });
            let found = gel.contact.distances();
            let expected = near_distances(&gel, &moved, &collider, barrier.d_hat);
            for (kind, (mut found, mut expected)) in found.into_iter().zip(expected).enumerate() {
                totals[kind] += expected.len();
                found.sort_by(f64::total_cmp);
                expected.sort_by(f64::total_cmp);
                assert_eq!(found.len(), expected.len(), "{name}, kind {kind}");
                for (found, expected) in found.iter().zip(&expected) {
                    assert!(
                        (found - expected).abs() < 1e-14,
                        "{name}: {found} {expected}"
                    );
                }
            }
        }
    }
    assert!(totals.iter().all(|n| *n > 30), "{totals:?}");
}

#[test]
fn motion_beyond_the_margin_rebuilds_candidates() {
    let parameters = PARAMETERS();
    let collider = Collider::new(&centred("sphere", DMat3::IDENTITY));
    let object = AffineState::rigid(DVec3::ZERO, DMat3::IDENTITY);
    let mut gel = pad_near(&collider, &object, &mut Pcg64::seed_from_u64(5));
    assert!(gel.ensure_candidates(&object, &collider, &parameters));
    let node = gel.surface().vertices()[0] as usize;
    gel.x[node] += DVec3::X * (1.01 * parameters.candidate_margin_m);
    assert!(gel.ensure_candidates(&object, &collider, &parameters));
}
