//! The slip ratio of tracked gel markers beside the slip of a simulated contact.

use crate::{FrameNoise, NodeMotion, PressDepth, SensorProfile, Skin, TactileRenderer};
use gripcast_shear::{ExpectedMarkers, ShearTracker};
use gripcast_sim::fem::{GelGrid, GelPad};
use gripcast_sim::fields::{FaceField, FaceMesh, FieldSampling};
use gripcast_sim::press::{Indenter, Press, PressPoint, PressTarget, half_pad};
use gripcast_sim::solver::NodeContact;

const SPHERE_M: f64 = 0.01;
const FRICTION: f64 = 0.4;
const DEPTHS_M: [f64; 3] = [3e-4, 6e-4, 8e-4];
/// Shifts of the sphere at the last depth, m; the contact slides as a whole from about 0.3 mm.
const SHIFTS_M: [f64; 6] = [5e-5, 1e-4, 1.5e-4, 2e-4, 2.5e-4, 6e-4];

/// The face of the whole gel, from its half at positive y.
fn whole(half: &GelGrid) -> GelGrid {
    let [x, y, z] = half.axes().clone();
    let mirrored = y.iter().skip(1).rev().map(|y| -y);
    GelGrid::new([x, mirrored.chain(y.iter().copied()).collect(), z]).unwrap()
}

/// Displacements of the whole face from those of its half.
fn mirrored(field: &FaceField, columns: usize) -> Vec<[f64; 2]> {
    let rows: Vec<&[[f32; 3]]> = field.displacement_m.chunks_exact(columns).collect();
    let row = |row: &[[f32; 3]], sign: f64| -> Vec<[f64; 2]> {
        let node = |u: &[f32; 3]| [f64::from(u[0]), sign * f64::from(u[1])];
        row.iter().map(node).collect()
    };
    let below = rows.iter().skip(1).rev().map(|r| row(r, -1.0));
    let above = rows.iter().map(|r| row(r, 1.0));
    below.chain(above).flatten().collect()
}

/// Area of the nodes in one of some states, m².
fn area(mesh: &FaceMesh, field: &FaceField, states: &[NodeContact]) -> f64 {
    let nodes = field.contact.iter().zip(&mesh.area_m2);
    let counted = nodes.filter(|(state, _)| states.contains(state));
    counted.map(|(_, area)| area).sum()
}

fn touched(mesh: &FaceMesh, field: &FaceField) -> f64 {
    area(mesh, field, &[NodeContact::Stick, NodeContact::Slip])
}

/// Fraction of the contact whose nodes slide in the steps to a target.
fn sliding(mesh: &FaceMesh, field: &FaceField) -> f64 {
    area(mesh, field, &[NodeContact::Slip]) / touched(mesh, field)
}

fn depth_of_sphere(renderer: &TactileRenderer, point: &PressPoint) -> PressDepth {
    let geometry = renderer.geometry();
    let mut press = PressDepth::untouched(geometry);
    for row in 0..geometry.height {
        for column in 0..geometry.width {
            let [x, y] = geometry.pixel_to_gel_m(column as f64, row as f64);
            let radius = (x - point.shift_m).hypot(y).min(SPHERE_M);
            let cap = SPHERE_M - (SPHERE_M * SPHERE_M - radius * radius).sqrt();
            press.depth_m[row * geometry.width + column] = (point.depth_m - cap).max(0.0) as f32;
        }
    }
    press
}

/// Prints the table of docs/explanation/shear.md.
#[test]
fn slip_ratio_follows_a_simulated_contact() {
    let half = half_pad(&GelPad::default(), [13, 11, 7], [1.14, 1.14, 1.22]).unwrap();
    let grid = whole(&half);
    let mut press = Press::new(half, Indenter::Sphere { radius_m: SPHERE_M });
    press.symmetric = [false, true];
    press.friction = FRICTION;
    press.d_hat_m = 2e-5;
    let pressed = DEPTHS_M.map(|depth_m| PressTarget {
        depth_m,
        shift_m: 0.0,
    });
    let sheared = SHIFTS_M.map(|shift_m| PressTarget {
        depth_m: DEPTHS_M[2],
        shift_m,
    });
    let targets = [&pressed[..], &sheared[..]].concat();
    let (points, series) = press
        .run_with_fields(&targets, Some(FieldSampling::Stages))
        .unwrap();
    let series = series.unwrap();

    let mut profile = SensorProfile::named_or_load("gelsight-mini-markers").unwrap();
    // The contact of the ball has 6 gel markers of the Mini's pattern, 25 of one twice as dense.
    let pattern = profile.markers.as_mut().unwrap();
    pattern.pitch_m = pattern.pitch_m.map(|pitch| 0.5 * pitch);
    pattern.diameter_m *= 0.5;
    pattern.edge_m *= 0.5;
    let mut renderer = TactileRenderer::new(&profile).unwrap();
    let noise = |seed: u64| FrameNoise {
        noise_seed: Some(seed),
        ..FrameNoise::default()
    };
    let untouched = PressDepth::untouched(renderer.geometry());
    let initial = renderer.render(&untouched, &noise(0)).unwrap();
    let scale = profile.geometry.pixel_m;
    let mut tracker = ShearTracker::new(&initial, scale, ExpectedMarkers::Unknown).unwrap();
    for seed in 1..20 {
        tracker.update(&renderer.render(&untouched, &noise(seed)).unwrap());
    }
    let columns = series.mesh.x_m.len();
    let geometry = renderer.geometry();
    let image_m2 = (geometry.width * geometry.height) as f64 * scale * scale;
    let mut before = 0.0;
    for (index, (point, step)) in points.iter().zip(&series.steps).enumerate() {
        let displacement = mirrored(&step.gels[0], columns);
        let motion = NodeMotion::new(&grid, displacement, Default::default()).unwrap();
        let press = depth_of_sphere(&renderer, point);
        let image = renderer
            .render_with_skin(&press, &Skin::Nodes(motion), &noise(100 + index as u64))
            .unwrap();
        let frame = tracker.update(&image);
        let summary = frame.summary.unwrap();
        let (field, contact) = (&step.gels[0], summary.contact_fraction);
        let load = point.shear_n / (FRICTION * point.normal_n);
        let (slides, ratio) = (sliding(&series.mesh, field), summary.slip_ratio);
        let area = 2.0 * touched(&series.mesh, field) / image_m2;
        println!(
            "depth {:.1} mm, shift {:.2} mm: T/µN {load:.2}, sliding {slides:.2}, slip ratio \
             {ratio:.2?}, contact {area:.3}, measured {contact:.3}",
            1e3 * point.depth_m,
            1e3 * point.shift_m,
        );
        assert_eq!(frame.problems, []);
        let ratio = ratio.expect("enough gel markers in contact");
        if point.shift_m < 1e-6 {
            assert_eq!(ratio, 0.0, "a press without shear");
            continue;
        }
        // Skin that slides by less than a tenth of the motion counts as sticking.
        assert!(
            (0.5 * slides..slides + 0.1).contains(&ratio),
            "{ratio} of {slides}"
        );
        assert!(ratio >= before - 0.1, "{ratio} after {before}");
        before = ratio;
    }
    assert!(before > 0.75, "{before} in full slip");
}
