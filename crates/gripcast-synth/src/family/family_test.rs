use std::collections::BTreeSet;
use std::sync::LazyLock;

use super::shape::{MAX_SIDE_M, MAX_TRIANGLES, SIZE_M, relative_height};
use super::*;
use gripcast_base::files::sha256_hex;
use gripcast_geometry::{MassProperties, PrepareOptions, prepare};
use gripcast_sim::rigid::{Decomposition, DecompositionSettings};

const SEEDS: u64 = 3;

struct Shape {
    category: Category,
    seed: u64,
    mesh: TriangleMesh,
}

static SHAPES: LazyLock<Vec<Shape>> = LazyLock::new(|| {
    let shape = |category, seed| Shape {
        category,
        seed,
        mesh: family_shape(category, seed).unwrap(),
    };
    Category::all()
        .flat_map(|category| (0..SEEDS).map(move |seed| shape(category, seed)))
        .collect()
});

fn name(shape: &Shape) -> String {
    format!("{} {}", shape.category.name(), shape.seed)
}

#[test]
fn shapes_need_no_preparation() {
    for shape in SHAPES.iter() {
        assert!(shape.mesh.edges().is_closed(), "{}", name(shape));
        let prepared = prepare(&shape.mesh, &PrepareOptions::default()).unwrap();
        assert!(
            prepared.warnings.is_empty(),
            "{}: {:?}",
            name(shape),
            prepared.warnings
        );
        assert_eq!(prepared.mesh, shape.mesh, "{}", name(shape));
    }
}

#[test]
fn sizes_and_faces_are_within_their_limits() {
    for shape in SHAPES.iter() {
        let bounds = shape.mesh.bounds();
        let size = bounds.extent();
        assert!(
            (SIZE_M.0..=SIZE_M.1).contains(&size.max_element()),
            "{}",
            name(shape)
        );
        assert!(bounds.center().length() < 2e-7, "{}", name(shape));
        assert!(
            shape.mesh.triangles.len() <= MAX_TRIANGLES,
            "{}",
            name(shape)
        );
        assert!(shape.mesh.triangles.len() >= 150, "{}", name(shape));
        let sides: Vec<f64> = shape
            .mesh
            .all_corners()
            .flat_map(|[a, b, c]| [a.distance(b), b.distance(c), c.distance(a)])
            .collect();
        let longest = sides.iter().copied().fold(0.0, f64::max);
        assert!(longest <= MAX_SIDE_M, "{}: {longest}", name(shape));
        let mean = sides.iter().sum::<f64>() / sides.len() as f64;
        assert!((1.2e-3..4.5e-3).contains(&mean), "{}: {mean}", name(shape));
        let min = shape
            .mesh
            .all_corners()
            .map(relative_height)
            .fold(1.0, f64::min);
        assert!(min > 0.02, "{}: {min}", name(shape));
    }
}

#[test]
fn most_shapes_fit_between_the_fingers() {
    let fit = |shape: &&Shape| shape.mesh.bounds().extent().min_element() < 0.08;
    let fraction = SHAPES.iter().filter(fit).count() as f64 / SHAPES.len() as f64;
    assert!(fraction > 0.95, "{fraction}");
}

#[test]
fn mass_properties_are_plausible() {
    for shape in SHAPES.iter() {
        let solid = MassProperties::from_mesh(&shape.mesh).unwrap();
        let bounds = shape.mesh.bounds();
        let fraction = solid.volume_m3 / bounds.extent().element_product();
        assert!(
            (0.02..=1.0).contains(&fraction),
            "{}: {fraction}",
            name(shape)
        );
        let inside = (solid.center_of_mass_m.abs() - 0.5 * bounds.extent()).max_element();
        assert!(inside < 0.0, "{}", name(shape));
        let inertia = solid.inertia_m5();
        assert!(inertia.determinant() > 0.0, "{}", name(shape));
    }
}

#[test]
fn shapes_are_reproducible_and_distinct() {
    let tool = Category::parse("tool").unwrap();
    let again = family_shape(tool, 1).unwrap();
    let is_same = |s: &&Shape| s.category == tool && s.seed == 1;
    assert_eq!(SHAPES.iter().find(is_same).unwrap().mesh, again);
    let hashes: BTreeSet<String> = SHAPES.iter().map(|s| s.mesh.content_hash()).collect();
    assert_eq!(hashes.len(), SHAPES.len());
    for (k, shape) in SHAPES.iter().enumerate() {
        for other in &SHAPES[..k] {
            let [a, b] = [shape, other].map(|s| s.mesh.bounds().extent());
            assert!(a.distance(b) > 1e-5, "{} {}", name(shape), name(other));
        }
    }
}

#[test]
fn categories_are_found_by_name() {
    for category in Category::all() {
        assert_eq!(Category::parse(category.name()).unwrap(), category);
        let (low, high) = category.fill();
        assert!(0.0 < low && low <= high && high <= 1.0);
        assert!(category.materials().len() >= 3);
    }
    let text = Category::parse("bracet").unwrap_err().to_string();
    assert!(text.contains("did you mean bracket"), "{text}");
}

/// Plans refer to shapes by category and seed.
#[test]
fn shapes_match_existing_plans() {
    let hashes: Vec<String> = SHAPES.iter().map(|s| s.mesh.content_hash()).collect();
    assert_eq!(
        sha256_hex(hashes.concat()),
        "c22e7c1f3b89a2ac2abfdf2aad41b93eba90229bf29b67d94e45cc97c522f4e4"
    );
}

/// V-HACD's own convex hull panics on the voxels of this ring at a resolution of 64.
#[test]
fn ring_on_which_v_hacd_panics_has_convex_pieces() {
    let ring = Category::all().find(|category| category.name() == "ring");
    let mesh = family_shape(ring.unwrap(), 922_240_332_454_601).unwrap();
    let found = Decomposition::compute(&mesh, &DecompositionSettings::default()).unwrap();
    assert!(found.pieces().len() > 3, "{} pieces", found.pieces().len());
    let volumes = found.pieces().iter();
    let sum: f64 = volumes
        .map(|piece| MassProperties::from_mesh(piece).unwrap().volume_m3)
        .sum();
    let exact = MassProperties::from_mesh(&mesh).unwrap().volume_m3;
    assert!((0.95..1.3).contains(&(sum / exact)), "{sum} {exact}");
}
