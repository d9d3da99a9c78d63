use glam::{DMat3, DVec3};

use super::{
    Finger, GraspSettings, Placement, Preset, Scene, StageName, resting_pose, simulate,
    simulate_with_fields,
};
use crate::fem::GelResolution;
use crate::fields::{FaceMesh, FieldSampling, FieldSeries, Wrench};
use crate::solver::NodeContact;
use gripcast_geometry::builtin;

const MASS_KG: f64 = 0.2;
const FRICTION: f64 = 0.6;

/// A sphere, gripped off centre, so that the gels carry torque.
fn grasp() -> (Scene, GraspSettings) {
    let mesh = builtin("sphere").unwrap();
    let t_world_object = resting_pose(&mesh, None).unwrap().1.t_world_object;
    let placement = Placement {
        offset_m: [0.0, 0.004],
        ..Placement::default()
    };
    let placed = placement.place(&mesh, &t_world_object).unwrap();
    let mut settings = GraspSettings::new(Preset::Paper);
    settings.resolution = GelResolution::Coarse;
    settings.protocol.stop_force_n = 15.0;
    settings.protocol.adjust_s = 0.2;
    settings.protocol.lift_m = 0.006;
    let scene = Scene {
        mesh,
        mass_kg: MASS_KG,
        friction: FRICTION,
        t_world_object,
        t_world_gripper: placed.t_world_gripper,
        opening_m: placed.opening_m,
        gel: settings.gel().unwrap(),
    };
    (scene, settings)
}

fn sums(mesh: &FaceMesh, field: &crate::fields::FaceField) -> Wrench {
    let (mut force, mut torque) = (DVec3::ZERO, DVec3::ZERO);
    let center = DVec3::Z * mesh.thickness_m;
    for node in 0..mesh.nodes() {
        let vector = |values: &[[f32; 3]]| DVec3::from_array(values[node].map(f64::from));
        let load = vector(&field.traction_pa) * mesh.area_m2[node];
        let at = mesh.position(node) + vector(&field.displacement_m);
        force += load;
        torque += (at - center).cross(load);
    }
    Wrench {
        force_n: force.to_array(),
        torque_n_m: torque.to_array(),
    }
}

fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    DVec3::from_array(a).distance(DVec3::from_array(b))
}

#[test]
fn tractions_sum_to_the_resultant_and_to_the_force_of_the_trace() {
    let (scene, settings) = grasp();
    let (protocol, solver) = (&settings.protocol, &settings.solver);
    let plain = simulate(&scene, protocol, solver).unwrap();
    let recorded = simulate_with_fields(&scene, protocol, solver, Some(FieldSampling::ALL));
    let recorded = recorded.unwrap();
    assert_eq!(recorded.trace.steps, plain.trace.steps);
    assert_eq!(recorded.trace.snapshots, plain.trace.snapshots);
    let series = recorded.trace.fields.unwrap();
    assert_eq!(series.steps.len(), plain.trace.steps.len());
    let axes = scene.t_world_gripper.rotation_matrix();
    for (index, step) in series.steps.iter().enumerate() {
        assert_eq!(step.step as usize, index);
        for (i, field) in step.gels.iter().enumerate() {
            let sum = sums(&series.mesh, field);
            let resultant = field.resultant;
            assert!(distance(sum.force_n, resultant.force_n) < 1e-6, "{index}");
            assert!(
                distance(sum.torque_n_m, resultant.torque_n_m) < 1e-8,
                "{index}"
            );
            // The trace's own sum over front and sides, along the gripper's axes.
            let total = [resultant, field.sides].map(|w| DVec3::from_array(w.force_n));
            let torque = resultant.torque_n_m[2] + field.sides.torque_n_m[2];
            let world = axes * Finger::BOTH[i].rotation() * (total[0] + total[1]);
            let force = &plain.trace.steps[index].force[i];
            let expected = DMat3::from_cols(
                axes * Finger::BOTH[i].closing() * -1.0,
                axes.y_axis,
                axes.z_axis,
            ) * DVec3::new(force.normal_n, force.shear_n[0], force.shear_n[1]);
            assert!(world.distance(expected) < 1e-9, "{index}");
            assert!((torque - force.torque_n_m).abs() < 1e-9, "{index}");
        }
    }
    check_states(&series);
    check_weight(&series, &axes);
}

/// Only nodes in contact carry a load, and the grip of the lifted object sticks.
fn check_states(series: &FieldSeries) {
    let (mut counts, mut stray) = ([0; 3], 0);
    for field in series.steps.iter().flat_map(|step| &step.gels) {
        for (traction, contact) in field.traction_pa.iter().zip(&field.contact) {
            counts[*contact as usize] += 1;
            let carries = *traction != [0.0; 3];
            assert!(carries || *contact == NodeContact::Open);
            // Friction lagged from contacts that ended within the step.
            stray += usize::from(carries && *contact == NodeContact::Open);
        }
    }
    assert!(30 * stray < counts[1] + counts[2], "{stray} of {counts:?}");
    assert!(counts.iter().all(|count| *count > 20), "{counts:?}");
    let lifted = series.last_of(StageName::Lift).unwrap();
    for field in &lifted.gels {
        let pressed = field.displacement_m.iter().map(|d| d[2]);
        assert!(pressed.fold(0.0, f32::min) < -2e-4);
        let stick = field.stick_fraction(&series.mesh).unwrap();
        assert!(stick > 0.5, "{stick}");
    }
}

/// In the lift both gels together carry the object's weight.
fn check_weight(series: &FieldSeries, axes: &DMat3) {
    let last = series.last_of(StageName::Lift).unwrap();
    let force = |i: usize| {
        let field = &last.gels[i];
        let [front, sides] =
            [field.resultant, field.sides].map(|wrench| DVec3::from_array(wrench.force_n));
        (*axes * Finger::BOTH[i].rotation() * (front + sides)).z
    };
    let weight = -(force(0) + force(1));
    let expected = MASS_KG * 9.81;
    assert!(
        (weight / expected - 1.0).abs() < 0.02,
        "{weight} {expected}"
    );
}

#[test]
fn sampling_chooses_steps() {
    let (scene, settings) = grasp();
    let (protocol, solver) = (&settings.protocol, &settings.solver);
    let fields = |sampling: FieldSampling| {
        let result = simulate_with_fields(&scene, protocol, solver, Some(sampling)).unwrap();
        (result.trace.fields.unwrap(), result.trace.steps.len())
    };
    let (stages, count) = fields(FieldSampling::Stages);
    let found: Vec<_> = stages.steps.iter().map(|step| step.stage).collect();
    assert_eq!(found, StageName::ALL.map(Some));
    assert_eq!(stages.steps[2].step as usize, count - 1);
    let (tenth, _) = fields("every:10".parse().unwrap());
    assert_eq!(tenth.steps.len(), count.div_ceil(10));
    assert_eq!(tenth.steps[3].step, 30);
}
