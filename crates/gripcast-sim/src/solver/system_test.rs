//! Gradient, search direction and invariants of every iterate.

use std::hash::{DefaultHasher, Hasher};

use glam::{DMat3, DQuat};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use super::super::gel_contact::ContactState;
use super::super::test_scene::{
    Grip, centred, closing, crosses, near_distances, random_point, small_pad,
};
use super::*;
use crate::fem::{GelPad, GelResolution};
use gripcast_geometry::{Pose, TriangleMesh, convex_hull};

/// Both pads over the upper corner of a box, whose ridges run along their grid lines: the left one
/// slides, the right one sticks, and the box slides on the ground.
fn sliding_at_a_corner() -> System {
    let mesh = centred("box", DMat3::IDENTITY);
    let grip = Grip {
        grid: small_pad(),
        pose: Pose::from_translation(DVec3::new(0.0, 0.019, 0.0583)),
        opening_m: 0.04 + 2.0 * 3e-4,
    };
    let parameters = SolverParameters::default();
    let mut system = grip.system(&mesh, &parameters);
    let mut rng = Pcg64::seed_from_u64(1);
    for gel in &mut system.gels {
        for x in &mut gel.x {
            *x += random_point(&mut rng, 2e-5);
        }
        gel.begin_step(parameters.dt_s);
    }
    system
        .object
        .begin_step(parameters.dt_s, parameters.gravity_m_s2);
    system.ensure_candidates();
    system.find_contacts();
    let epsilon = parameters.eps_v_m_s * parameters.dt_s;
    for gel in &mut system.gels {
        gel.contact.lag_friction(system.gel_mu, epsilon);
    }
    let System {
        object,
        collider,
        barrier,
        ..
    } = &mut system;
    object.lag_friction(collider, barrier, epsilon);
    for (gel, slip) in system.gels.iter_mut().zip([3e-5, 1e-6]) {
        for x in &mut gel.x {
            *x += DVec3::new(0.0, slip, -0.5 * slip) + random_point(&mut rng, 2e-6);
        }
        for target in &mut gel.target {
            *target += random_point(&mut rng, 2e-6);
        }
    }
    let step: [f64; OBJECT_DOF] = std::array::from_fn(|k| {
        let size = if k < 3 { 4e-6 } else { 4e-5 };
        rng.random_range(-size..size)
    });
    system.object.state = system.object.state.stepped(&step, 1.0);
    system.ensure_candidates();
    system.find_contacts();
    system
}

/// Slope of the energy with respect to the unknown that `shift` moves, by central differences.
fn slope(system: &mut System, step: f64, shift: impl Fn(&mut System, f64)) -> f64 {
    let mut energies = [0.0; 4];
    let mut position = 0.0;
    for (energy, to) in energies.iter_mut().zip([-2.0, -1.0, 1.0, 2.0]) {
        shift(system, (to - position) * step);
        position = to;
        *energy = system.energy();
    }
    shift(system, -position * step);
    let [far_low, low, high, far_high] = energies;
    (8.0 * (high - low) - (far_high - far_low)) / (12.0 * step)
}

#[test]
fn gradient_is_the_slope_of_the_energy() {
    let mut system = sliding_at_a_corner();
    for (gel, side) in system.gels.iter().zip(["left", "right"]) {
        let counts = gel.contact.counts();
        assert!(
            counts.node_triangle > 5 && counts.vertex_triangle > 2,
            "{counts:?}"
        );
        assert!(
            counts.mollified > 2 && counts.edge_edge > counts.mollified + 5,
            "{counts:?}"
        );
        let state = ContactState {
            obstacle: system.object.as_obstacle(&system.barrier),
            x: &gel.x,
            start: &gel.start,
        };
        let [sticking, sliding] = gel.contact.sticking_and_sliding(&state);
        let some = if side == "left" { sliding } else { sticking };
        assert!(some > 10, "{side}: {sticking} stick, {sliding} slide");
    }
    system.compute_gradient();
    assert!(system.object.ground_gradient.0[2].abs() > 0.1);
    let gradient = system.gradient.clone();
    // Tolerances follow the contact forces, which are far smaller than those of drive and body.
    let forces = |gel: &Gel| gel.contact_forces().map(DVec3::length).fold(0.0, f64::max);
    let largest = system.gels.iter().map(forces).fold(0.0, f64::max);
    let rotations = system
        .gels
        .iter()
        .map(|gel| gel.contact.max_rotation_force_n());
    assert!(rotations.fold(0.0, f64::max) > 1e-3 * largest);

    let check = |k: usize, found: f64, scale: f64| {
        let expected = gradient[k];
        let tolerance = 1e-5 * scale + 1e-7 * expected.abs();
        assert!(
            (found - expected).abs() < tolerance,
            "unknown {k}: {found}, expected {expected}"
        );
    };
    let mut unknown = 0;
    for gel in 0..2 {
        for node in 0..system.gels[gel].x.len() {
            for axis in 0..3 {
                let found = slope(&mut system, 2e-8, |s, by| s.gels[gel].x[node][axis] += by);
                check(unknown, found, largest);
                unknown += 1;
            }
        }
    }
    for k in 0..OBJECT_DOF {
        let step = if k < 3 { 2e-8 } else { 1e-6 };
        let found = slope(&mut system, step, |s, by| {
            let mut unit = [0.0; OBJECT_DOF];
            unit[k] = by;
            s.object.state = s.object.state.stepped(&unit, 1.0);
        });
        // The arm of a force on an entry of A is at most the size of the box.
        check(unknown, found, if k < 3 { largest } else { 0.02 * largest });
        unknown += 1;
    }
    assert_eq!(unknown, gradient.len());
}

/// The assembled stiffness of the system times a vector.
fn product(system: &System, x: &[f64]) -> Vec<f64> {
    let mut y = vec![0.0; x.len()];
    let offset = x.len() - OBJECT_DOF;
    let (flat, object) = y.split_at_mut(offset);
    let mut start = 0;
    for gel in &system.gels {
        let end = start + gel.unknowns();
        gel.add_product(
            (&x[start..end], &x[offset..]),
            &mut flat[start..end],
            object,
        );
        start = end;
    }
    let dt = system.parameters.dt_s;
    let own = system
        .object
        .stiffness(&system.collider, &system.barrier, dt);
    for (y, row) in object.iter_mut().zip(&own.0) {
        *y += row
            .iter()
            .zip(&x[offset..])
            .map(|(h, x)| h * x)
            .sum::<f64>();
    }
    y
}

fn length(x: &[f64]) -> f64 {
    dot(x, x).sqrt()
}

#[test]
fn direction_of_fresh_factor_solves_assembled_system() {
    let mut system = sliding_at_a_corner();
    system.compute_gradient();
    system.factorise();
    assert!(system.schur.is_some());
    system.history.clear();
    system.find_direction();
    let applied = product(&system, &system.direction);
    let residual: Vec<f64> = applied
        .iter()
        .zip(&system.gradient)
        .map(|(h, g)| h + g)
        .collect();
    let fraction = length(&residual) / length(&system.gradient);
    assert!(fraction < 1e-4, "{fraction:e}");
    assert!(dot(&system.gradient, &system.direction) < 0.0);
}

#[test]
fn assembled_stiffness_is_symmetric_positive_definite() {
    let mut system = sliding_at_a_corner();
    system.compute_gradient();
    system.factorise();
    let mut rng = Pcg64::seed_from_u64(2);
    let n = system.gradient.len();
    let mut random = || -> Vec<f64> { (0..n).map(|_| rng.random_range(-1.0..1.0)).collect() };
    for _ in 0..20 {
        let (x, y) = (random(), random());
        let (hx, hy) = (product(&system, &x), product(&system, &y));
        assert!(dot(&x, &hx) > 0.0);
        let (one, other) = (dot(&y, &hx), dot(&x, &hy));
        assert!(
            (one - other).abs() < 1e-12 * length(&y) * length(&hx),
            "{one} {other}"
        );
    }
    // A random vector probes only the stiffest directions: solving shrinks its stiff components.
    for _ in 0..5 {
        system.gradient = random();
        system.find_direction();
        let x = system.direction.clone();
        assert!(dot(&x, &product(&system, &x)) > 0.0);
    }
}

/// A grip by the small pads at a random height and angle, with the faces just outside the barrier.
fn random_grip(mesh: &TriangleMesh, rng: &mut Pcg64) -> Grip {
    let bounds = mesh.bounds();
    let rotation = DQuat::from_rotation_z(rng.random_range(-1.5..1.5))
        * DQuat::from_rotation_x(rng.random_range(-0.3..0.3));
    let size = bounds.extent();
    let center = DVec3::new(
        rng.random_range(-0.1..0.1) * size.x,
        rng.random_range(-0.3..0.3) * size.y,
        rng.random_range(0.4..0.8) * size.z,
    );
    let pose = Pose::new(rotation, center);
    let closing = rotation * DVec3::X;
    let from = center - DVec3::Z * (-bounds.min.z);
    // Half the opening at which the object fits between the planes of the faces.
    let reach = mesh.vertices.iter().map(|v| (*v - from).dot(closing).abs());
    Grip {
        grid: small_pad(),
        pose,
        opening_m: 2.0 * (reach.fold(0.0, f64::max) + 2e-4),
    }
}

/// Closes the fingers for one step, calling `visit` after every iteration.
fn close_with_visitor(
    system: &mut System,
    by: f64,
    pose: &Pose,
    mut visit: impl FnMut(&System),
) -> bool {
    for (gel, closing) in system.gels.iter_mut().zip(closing(pose)) {
        gel.move_target(closing * by);
    }
    let (limit, dt) = (system.parameters.max_iterations, system.parameters.dt_s);
    system.parameters.max_iterations = 1;
    let mut converged = system
        .step(&StepStart {
            refactorize: true,
            ..Default::default()
        })
        .converged;
    visit(system);
    for _ in 1..limit {
        if converged {
            break;
        }
        let energy = system.energy();
        let mut report = StepReport::default();
        system.minimise(energy, &mut report);
        visit(system);
        converged = report.converged;
    }
    for gel in &mut system.gels {
        gel.end_step(dt);
    }
    system.object.end_step(dt);
    system.parameters.max_iterations = limit;
    converged
}

#[test]
fn iterates_of_random_closings_never_penetrate() {
    let mut rng = Pcg64::seed_from_u64(3);
    let parameters = SolverParameters::default();
    let (mut iterates, mut touching) = (0, 0);
    for name in ["box", "wedge", "bar", "spike"] {
        for _ in 0..2 {
            let mesh = centred(name, DMat3::IDENTITY);
            let grip = random_grip(&mesh, &mut rng);
            let mut system = grip.system(&mesh, &parameters);
            // Without collision detection the long moves would carry the gels through the surface.
            for (step, by) in [1e-3, 1.5e-4, 1.5e-4, 8e-4, 1.5e-4, 1.5e-4]
                .into_iter()
                .enumerate()
            {
                close_with_visitor(&mut system, by, &grip.pose, |system| {
                    let (object, collider) = (&system.object.state, &system.collider);
                    iterates += 1;
                    for gel in &system.gels {
                        assert!(!crosses(gel, object, collider), "{name}, step {step}");
                        let near = near_distances(gel, object, collider, 5e-4);
                        touching += usize::from(!near[0].is_empty());
                        let smallest = near.iter().flatten().fold(1.0, |a: f64, b| a.min(*b));
                        assert!(smallest > 1e-6, "{name}, step {step}: {smallest:e} m");
                    }
                    assert!(system.object.lowest(collider) > 0.0);
                });
            }
        }
    }
    assert!(
        touching > iterates / 2,
        "{touching} contacts in {iterates} iterates"
    );
}

/// Closes until both gels press with 15 N, then lifts. Returns how often a gel crosses the object,
/// checked at every fifth step.
fn crossings_in_grasp(mesh: &TriangleMesh, pose: Pose, opening_m: f64) -> usize {
    let grid = GelPad::default().grid(GelResolution::Coarse).unwrap();
    let grip = Grip {
        grid,
        pose,
        opening_m,
    };
    let mut system = grip.system(mesh, &SolverParameters::default());
    let directions = closing(&pose);
    let (mut crossings, mut lifted, mut pressed) = (0, 0, false);
    for step in 0..400 {
        let force: Vec<f64> = system
            .gels
            .iter()
            .zip(directions)
            .map(|(gel, closing)| -gel.contact_forces().sum::<DVec3>().dot(closing))
            .collect();
        pressed |= force.iter().all(|f| *f > 15.0);
        lifted += usize::from(pressed);
        if lifted > 40 {
            break;
        }
        for (gel, closing) in system.gels.iter_mut().zip(directions) {
            gel.move_target(if pressed {
                DVec3::Z * 2e-4
            } else {
                closing * 1e-4
            });
        }
        let start = StepStart {
            refactorize: !pressed,
            ..Default::default()
        };
        assert!(system.step(&start).converged, "step {step}");
        if step % 5 == 0 || lifted == 40 {
            let (object, collider) = (&system.object.state, &system.collider);
            let crossed = |gel: &&Gel| crosses(gel, object, collider);
            crossings += system.gels.iter().filter(crossed).count();
        }
    }
    assert!(lifted > 40, "never pressed with 15 N");
    crossings
}

fn yawed(degrees: f64, y: f64) -> Pose {
    let rotation = DQuat::from_rotation_z(degrees.to_radians());
    Pose::new(rotation, DVec3::new(0.0, y, 0.03))
}

/// A box of 40 x 40 x 60 mm with no vertices but its corners.
fn bare_box(rotation: DMat3) -> TriangleMesh {
    let corners: Vec<DVec3> = (0..8)
        .map(|i| {
            let side = |bit: i32| if i & bit == 0 { -0.5 } else { 0.5 };
            rotation * DVec3::new(0.04 * side(1), 0.04 * side(2), 0.06 * side(4))
        })
        .collect();
    convex_hull(&corners).unwrap()
}

#[test]
fn gels_do_not_cross_flat_edges_without_contacts() {
    let faces = bare_box(DMat3::IDENTITY);
    assert_eq!(crossings_in_grasp(&faces, yawed(0.0, 0.0), 0.0412), 0);
    let mesh = centred("box", DMat3::IDENTITY);
    assert_eq!(crossings_in_grasp(&mesh, yawed(10.0, 0.012), 0.0485), 0);
}

#[test]
fn gels_do_not_cross_a_ridge_between_their_nodes() {
    // Its ends are far from the gels, and no gel node is within 1 mm of it.
    let ridges = bare_box(DMat3::from_rotation_z(std::f64::consts::FRAC_PI_4));
    let opening_m = 0.04 * 2f64.sqrt() + 1.2e-3;
    assert_eq!(crossings_in_grasp(&ridges, yawed(0.0, 1e-3), opening_m), 0);
}

#[test]
fn gels_do_not_cross_the_concave_ring_of_a_handle() {
    let mesh = centred("mug", DMat3::IDENTITY);
    let near = mesh.vertices.iter().filter(|v| v.y.abs() < 0.012);
    let opening_m = 2.0 * (near.map(|v| v.x.abs()).fold(0.0, f64::max) + 6e-4);
    let mut pose = yawed(0.0, 0.0);
    pose.translation_m.z = 0.5 * mesh.bounds().extent().z;
    assert_eq!(crossings_in_grasp(&mesh, pose, opening_m), 0);
}

#[test]
fn step_cut_off_by_iteration_limit_is_not_converged() {
    let mesh = centred("box", DMat3::IDENTITY);
    let grip = Grip {
        grid: small_pad(),
        pose: Pose::from_translation(DVec3::Z * 0.03),
        opening_m: 0.0404,
    };
    let converged = |max_iterations: u32| {
        let parameters = SolverParameters {
            max_iterations,
            ..Default::default()
        };
        let mut system = grip.system(&mesh, &parameters);
        for (gel, closing) in system.gels.iter_mut().zip(closing(&grip.pose)) {
            gel.move_target(closing * 3e-4);
        }
        let report = system.step(&StepStart::default());
        assert!(report.iterations <= max_iterations);
        report.converged
    };
    assert!(converged(200));
    assert!(!converged(1));
}

/// Digest of the bits of all positions and of the object after a short grasp on `threads`.
fn digest(threads: usize) -> u64 {
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build()
        .unwrap();
    pool.install(|| {
        let mesh = centred("box", DMat3::IDENTITY);
        let grip = Grip {
            grid: small_pad(),
            pose: Pose::new(DQuat::from_rotation_z(0.2), DVec3::new(0.0, 0.01, 0.05)),
            opening_m: 0.0466,
        };
        let mut system = grip.system(&mesh, &SolverParameters::default());
        for step in 0..25 {
            for (gel, closing) in system.gels.iter_mut().zip(closing(&grip.pose)) {
                gel.move_target(closing * 1e-4 + DVec3::Z * 1e-5);
            }
            system.step(&StepStart {
                refactorize: step % 3 == 0,
                warm_start_slot: step % 2,
                ..Default::default()
            });
        }
        assert!(system.gels.iter().all(|gel| gel.contacts() > 0));
        let mut hasher = DefaultHasher::new();
        let nodes = system
            .gels
            .iter()
            .flat_map(|gel| &gel.x)
            .flat_map(|x| x.to_array());
        for value in nodes.chain(system.object.state.to_array()) {
            hasher.write_u64(value.to_bits());
        }
        hasher.finish()
    })
}

#[test]
fn results_are_bit_identical_for_any_thread_count() {
    let first = digest(1);
    assert_eq!(first, digest(1));
    assert_eq!(first, digest(2));
    assert_eq!(first, digest(3));
}
