use super::*;
use crate::{BUILTIN_NAMES, LengthUnit, PrepareOptions, builtin, load_mesh, prepare};
use gripcast_base::random::SeedStream;
use gripcast_testing::shared;
use gripcast_testing::shuffled_mesh::shuffle_mesh;
use std::path::Path;

/// Object direction that points down in a pose.
fn down(pose: &StablePose) -> DVec3 {
    pose.down()
}

fn total(poses: &[StablePose]) -> f64 {
    poses.iter().map(|p| p.probability).sum()
}

/// Height of the centre of mass above the lowest point, m.
fn height(mesh: &TriangleMesh, center: DVec3, rotation: DQuat) -> f64 {
    let lowest = mesh.vertices.iter().map(|&v| (rotation * v).z);
    (rotation * center).z - lowest.fold(f64::INFINITY, f64::min)
}

/// Height above the lowest vertex below which vertices certainly touch the ground, and above which
/// they certainly do not, m; rounding and nearly coplanar facets decide between them.
const CONTACT_M: [f64; 2] = [1e-9, 3e-6];

/// Distance of the centre of mass's foot inside the support polygon (negative: outside), m: the
/// minimum over all directions across two contacts.
fn support_margin(mesh: &TriangleMesh, center: DVec3, down: DVec3, contact_m: f64) -> f64 {
    let depth = |v: &DVec3| (*v - center).dot(down);
    let lowest = mesh.vertices.iter().map(depth).fold(f64::MIN, f64::max);
    let contacts: Vec<DVec3> = mesh
        .vertices
        .iter()
        .filter(|v| depth(v) > lowest - contact_m)
        .map(|v| (*v - center).reject_from_normalized(down))
        .collect();
    if contacts.len() < 3 {
        return 0.0;
    }
    let mut margin = f64::INFINITY;
    for a in &contacts {
        for b in contacts.iter().filter(|b| a.distance(**b) > 1e-6) {
            let across = (*b - *a).cross(down).normalize();
            let support = contacts.iter().map(|c| c.dot(across));
            margin = margin.min(support.fold(f64::MIN, f64::max));
        }
    }
    margin
}

/// Checks that a mesh rests on z = 0 under its centre of mass, and that each small tilt lifts it.
fn assert_rests(mesh: &TriangleMesh, pose: &StablePose) {
    let center = MassProperties::of_closed(mesh).unwrap().center_of_mass_m;
    let placed = mesh.transformed(&pose.t_world_object);
    assert!(placed.bounds().min.z.abs() < 1e-12);
    let above = pose.t_world_object.transform_point(center);
    assert!(above.truncate().length() < 1e-12);
    let rotation = pose.t_world_object.rotation;
    let at_rest = height(mesh, center, rotation);
    assert!((above.z - at_rest).abs() < 1e-12);
    let tilt = (0.5 * pose.tip_angle_rad).min(1e-3);
    for step in 0..16 {
        let (sin, cos) = (PI * f64::from(step) / 8.0).sin_cos();
        let axis = DVec3::new(cos, sin, 0.0);
        let tilted = height(mesh, center, DQuat::from_axis_angle(axis, tilt) * rotation);
        assert!(
            tilted > at_rest,
            "tilt {tilt} about {axis}: {tilted} {at_rest}"
        );
    }
    let [min, max] = CONTACT_M
        .map(|contact_m| (support_margin(mesh, center, down(pose), contact_m) / at_rest).atan());
    let tip = pose.tip_angle_rad;
    assert!(
        (min - 1e-3..=max + 1e-3).contains(&tip),
        "{min} {max} {pose:?}"
    );
}

#[test]
fn box_rests_on_its_six_sides() {
    let mesh = builtin("box").unwrap();
    let poses = stable_poses(&mesh, 0.0).unwrap();
    assert_eq!(poses.len(), 6);
    assert!((total(&poses) - 1.0).abs() < 1e-12);
    // Solid angle of a side b × c at distance a/2: 4 asin(bc / sqrt((a²+b²)(a²+c²))).
    let fraction =
        |a: f64, b: f64, c: f64| (b * c / ((a * a + b * b) * (a * a + c * c)).sqrt()).asin() / PI;
    for pose in &poses[..4] {
        assert!((pose.probability - fraction(0.04, 0.04, 0.06)).abs() < 1e-12);
        assert!((pose.tip_angle_rad - PI / 4.0).abs() < 1e-12);
        assert!(down(pose).z.abs() < 1e-12);
    }
    for pose in &poses[4..] {
        assert!((pose.probability - fraction(0.06, 0.04, 0.04)).abs() < 1e-12);
        assert!((pose.tip_angle_rad - (2.0f64 / 3.0).atan()).abs() < 1e-12);
        assert!((pose.t_world_object.translation_m.z - 0.03).abs() < 1e-15);
    }
}

#[test]
fn all_poses_of_built_in_shapes_are_stable() {
    for name in BUILTIN_NAMES {
        let mesh = builtin(name).unwrap();
        let poses = stable_poses(&mesh, 0.0).unwrap();
        assert!((total(&poses) - 1.0).abs() < 1e-12, "{name}");
        let is_before = |a: &StablePose, b: &StablePose| {
            a.probability >= b.probability * (1.0 - EQUAL_PROBABILITY)
        };
        assert!(poses.is_sorted_by(is_before), "{name}");
        for pose in &poses {
            assert_rests(&mesh, pose);
        }
        assert_eq!(poses, stable_poses(&mesh, 0.0).unwrap(), "{name}");
    }
    let count = |name| stable_poses(&builtin(name).unwrap(), 0.0).unwrap().len();
    assert_eq!(count("spike"), 8);
    assert_eq!(count("cylinder"), 58);
    assert_eq!(count("sphere"), 36 * 19);
}

#[test]
fn poses_rotate_with_the_mesh() {
    let mesh = builtin("mug").unwrap();
    let t = Pose::new(
        DQuat::from_xyzw(0.2, -0.4, 0.1, 0.8),
        DVec3::new(0.1, 0.2, 0.3),
    );
    let poses = stable_poses(&mesh, 0.0).unwrap();
    let rotated = stable_poses(&mesh.transformed(&t), 0.0).unwrap();
    assert_eq!(poses.len(), rotated.len());
    for pose in &poses {
        let expected = t.transform_vector(down(pose));
        let same = rotated.iter().find(|p| down(p).distance(expected) < 1e-6);
        let same = same.unwrap_or_else(|| panic!("no pose has {expected} downwards"));
        assert!((same.probability - pose.probability).abs() < 1e-9);
        assert!((same.tip_angle_rad - pose.tip_angle_rad).abs() < 1e-6);
    }
}

#[test]
fn oblique_body_tips_onto_a_neighbour() {
    // An oblique prism: its centre of mass lies beyond the edge of its base.
    let mut mesh = builtin("box").unwrap();
    for v in &mut mesh.vertices {
        v.x += 0.8 * v.z;
    }
    let poses = stable_poses(&mesh, 0.0).unwrap();
    assert!(poses.iter().all(|p| down(p).z.abs() < 0.99));
    assert!((total(&poses) - 1.0).abs() < 1e-12);
    let oblique = poses.iter().filter(|p| down(p).y.abs() < 1e-9);
    let direct: f64 = oblique.map(|p| p.probability).sum();
    assert!(direct > 0.5, "{direct}");
    poses.iter().for_each(|p| assert_rests(&mesh, p));
}

#[test]
fn minimum_tip_angle_excludes_unstable_poses() {
    let mesh = builtin("cylinder").unwrap();
    // A polygon of 56 sides tips after 3.2 degrees.
    let poses = stable_poses(&mesh, 4f64.to_radians()).unwrap();
    assert_eq!(poses.len(), 2);
    assert!((total(&poses) - 1.0).abs() < 1e-12);
    let ball = builtin("sphere").unwrap();
    let text = stable_poses(&ball, 0.2).unwrap_err().to_string();
    assert!(text.contains("11.459 degrees"), "{text}");
    assert!(stable_poses(&TriangleMesh::default(), 0.0).is_err());
}

/// Numbers of a `.npy` file of little-endian doubles in C order.
fn read_npy(path: &Path) -> Vec<f64> {
    let bytes = std::fs::read(path).unwrap();
    let header = usize::from(u16::from_le_bytes([bytes[8], bytes[9]]));
    let text = String::from_utf8_lossy(&bytes[10..10 + header]).into_owned();
    assert!(
        text.contains("'<f8'") && text.contains("'fortran_order': False"),
        "{text}"
    );
    let values = bytes[10 + header..].chunks_exact(8);
    values
        .map(|v| f64::from_le_bytes(v.try_into().unwrap()))
        .collect()
}

/// trimesh uses the same solid angles, but tips each triangle over the side that faces the centre
/// of mass from its centroid instead of the nearest side, and does not merge coplanar triangles. So
/// the poses must agree, and the probabilities within caps of 0.2 rad.
#[test]
fn poses_agree_with_trimesh() {
    let Some(folder) = shared("data/egad_eval") else {
        return;
    };
    for name in ["B1", "B4", "C2", "C4"] {
        let file = |suffix: &str| folder.join(format!("{name}{suffix}"));
        let mesh = load_mesh(&file(".obj"), LengthUnit::Millimetre).unwrap();
        let mesh = prepare(&mesh, &PrepareOptions::default()).unwrap().mesh;
        let center = MassProperties::from_mesh(&mesh).unwrap().center_of_mass_m;
        let ours = stable_poses(&mesh, 0.0).unwrap();
        ours.iter().for_each(|pose| assert_rests(&mesh, pose));
        let matrices = read_npy(&file("_stable_poses.npy"));
        let theirs: Vec<(DVec3, f64)> = matrices
            .chunks_exact(16)
            .map(|m| -DVec3::new(m[8], m[9], m[10]))
            .zip(read_npy(&file("_stable_prob.npy")))
            .collect();

        for pose in &ours {
            let near = |(d, _): &&(DVec3, f64)| d.angle_between(down(pose)) < 1e-3;
            assert!(
                theirs.iter().any(|t| near(&t)),
                "{name}: only ours {pose:?}"
            );
        }
        let missing = theirs
            .iter()
            .filter(|(d, _)| ours.iter().all(|pose| down(pose).angle_between(*d) > 2e-3));
        let largest = missing
            .map(|(d, _)| support_margin(&mesh, center, *d, 1e-7))
            .fold(f64::MIN, f64::max);
        let cap = |d: DVec3| {
            let inside = |other: DVec3| other.angle_between(d) < 0.2;
            let ours = ours.iter().filter(|p| inside(down(p)));
            let theirs = theirs.iter().filter(|t| inside(t.0));
            let ours: f64 = ours.map(|p| p.probability).sum();
            (ours - theirs.map(|t| t.1).sum::<f64>()).abs()
        };
        let worst = ours.iter().map(|p| cap(down(p))).fold(0.0, f64::max);
        println!(
            "{name}: {} poses, trimesh {}; those that only trimesh has are off the support by \
             {largest:.1e} m or more; caps differ by up to {worst:.4}",
            ours.len(),
            theirs.len(),
        );
        assert!(
            largest < 1e-6,
            "{name}: a pose with margin {largest} m was missed"
        );
        assert!(worst < 0.03, "{name}: {worst}");
    }
}

#[test]
fn round_body_has_a_likely_pose() {
    let ball = builtin("ball").unwrap();
    assert!(stable_poses(&ball, 0.2).is_err());
    let poses = likely_poses(&ball, 0.2, 0.5).unwrap();
    assert_eq!(poses.len(), 1);
    assert_eq!(poses[0], stable_poses(&ball, 0.0).unwrap()[0]);
    let bar = builtin("bar").unwrap();
    let all = stable_poses(&bar, 0.05).unwrap();
    let likely = likely_poses(&bar, 0.05, 0.3).unwrap();
    assert_eq!(likely, all[..2], "on its two large sides");
}

/// The same body in another file: shuffled, moved, and rounded to single precision.
fn refiled(mesh: &TriangleMesh, t: &Pose, random: &mut SeedStream) -> TriangleMesh {
    let mut moved = mesh.transformed(t);
    for v in &mut moved.vertices {
        *v = v.as_vec3().as_dvec3();
    }
    let index = |count| random.index(count);
    shuffle_mesh(&mut moved.vertices, &mut moved.triangles, index);
    moved
}

fn random_vector(random: &mut SeedStream) -> DVec3 {
    DVec3::from_array([0; 3].map(|_| random.between(-0.3, 0.3)))
}

/// A bent capsule, mirror-symmetric in y: its most probable poses come in pairs.
fn bent_capsule() -> TriangleMesh {
    let mut mesh = builtin("sphere").unwrap();
    let radius = mesh.bounds().max.x;
    for v in &mut mesh.vertices {
        *v *= 0.014 / radius;
        v.x += 0.025 * (v.x / 0.004).clamp(-1.0, 1.0);
        v.z += 0.003 * (60.0 * v.x).sin();
    }
    mesh
}

#[test]
fn order_of_poses_does_not_depend_on_rounding() {
    let mut random = SeedStream::named(35, "order");
    let names = ["box", "bar", "wedge", "spike", "cylinder", "mug"];
    let mut shapes: Vec<(&str, TriangleMesh)> = names
        .iter()
        .map(|name| (*name, builtin(name).unwrap()))
        .collect();
    shapes.push(("bent capsule", bent_capsule()));
    for (name, mesh) in &shapes {
        let poses = stable_poses(mesh, 0.0).unwrap();
        for _ in 0..30 {
            let t = Pose::from_translation(random_vector(&mut random));
            let moved = stable_poses(&refiled(mesh, &t, &mut random), 0.0).unwrap();
            assert!(
                down(&poses[0]).angle_between(down(&moved[0])) < 1e-3,
                "{name}: {:?} {:?}",
                poses[0],
                moved[0]
            );
            assert!(
                (poses[0].probability - moved[0].probability).abs() < 1e-3 * poses[0].probability
            );
            let nearest = |poses: &[StablePose]| nearest_pose(poses, 0.09).map(|i| down(&poses[i]));
            match (nearest(&poses), nearest(&moved)) {
                (Some(a), Some(b)) => assert!(a.angle_between(b) < 1e-3, "{name}"),
                (a, b) => assert_eq!(a.is_some(), b.is_some(), "{name}"),
            }
        }
    }
}

#[test]
fn probabilities_do_not_depend_on_the_frame_of_the_file() {
    let mut random = SeedStream::named(7, "probabilities");
    for name in ["box", "bar", "wedge", "mug", "spike"] {
        let mesh = builtin(name).unwrap();
        let poses = stable_poses(&mesh, 0.0).unwrap();
        for _ in 0..30 {
            let t = Pose::new(
                DQuat::from_scaled_axis(random_vector(&mut random) * 10.0),
                random_vector(&mut random),
            );
            let moved = stable_poses(&refiled(&mesh, &t, &mut random), 0.0).unwrap();
            // Facets between rounding and flat may differ; together they land as often.
            for pose in &poses[..poses.len().min(6)] {
                let expected = t.transform_vector(down(pose));
                let near = |p: &&StablePose, d: DVec3| down(p).angle_between(d) < 0.01;
                let sum = |poses: &[StablePose], d: DVec3| -> f64 {
                    poses
                        .iter()
                        .filter(|p| near(p, d))
                        .map(|p| p.probability)
                        .sum()
                };
                let (before, after) = (sum(&poses, down(pose)), sum(&moved, expected));
                assert!(
                    (before - after).abs() < 1e-3 * before,
                    "{name}: {before} {after}"
                );
            }
            let height = |mesh: &TriangleMesh, pose: &StablePose| {
                let center = MassProperties::from_mesh(mesh).unwrap().center_of_mass_m;
                pose.t_world_object.transform_point(center).z
            };
            let moved_mesh = mesh.transformed(&t);
            let heights = [height(&mesh, &poses[0]), height(&moved_mesh, &moved[0])];
            assert!(
                (heights[0] - heights[1]).abs() < 1e-6,
                "{name}: {heights:?}"
            );
        }
    }
}

#[test]
fn a_tie_between_two_sides_is_shared() {
    // A regular pyramid on its tip: it falls on each of its four sides alike.
    let apex = DVec3::new(0.0, 0.0, -0.03);
    let ring = [(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)];
    let mut points: Vec<DVec3> = ring
        .iter()
        .map(|(x, y)| DVec3::new(0.02 * x, 0.02 * y, 0.03))
        .collect();
    // A truncated tip too small to stand on.
    points.extend(
        ring.iter()
            .map(|(x, y)| apex + DVec3::new(1e-3 * x, 1e-3 * y, 0.0)),
    );
    let mesh = convex_hull(&points).unwrap();
    let poses = stable_poses(&mesh, 0.2).unwrap();
    let sides: Vec<f64> = poses
        .iter()
        .filter(|pose| down(pose).z.abs() < 0.9)
        .map(|pose| pose.probability)
        .collect();
    assert_eq!(sides.len(), 4);
    assert!(
        sides.iter().all(|p| (p - sides[0]).abs() < 1e-9),
        "{sides:?}"
    );
}
