use glam::{DQuat, DVec3};

use super::*;
use crate::acronym::AcronymGrasp;
use crate::plan::MeshSource;
use crate::properties::Material;
use gripcast_geometry::{Pose, builtin};
use gripcast_sim::rigid::{RigidEngine, RigidSettings};

fn settings(jobs: usize) -> PlanSettings {
    PlanSettings {
        preset: "test".to_owned(),
        seed: 5,
        grasps: 2,
        stop_forces_n: vec![10.0, 40.0],
        rendering: RenderingPlan {
            renderings: 1,
            samples_per_pixel: 1,
            sensor_spread: 1.0,
            visual_spread: 1.0,
            sensor: gripcast_tactile::SensorName::GELSIGHT_MINI,
        },
        textures: Vec::new(),
        mass_map: MassMap::None,
        friction_from: FrictionFrom::Soiled,
        min_friction_fraction: MIN_FRICTION_FRACTION,
        jobs,
    }
}

fn draft(name: &str, size: f64) -> ObjectDraft {
    ObjectDraft {
        name: SimulationId::parse(name).unwrap(),
        category: "box".to_owned(),
        source: MeshSource::stored(&SimulationId::parse(name).unwrap()).unwrap(),
        mesh: builtin("box").unwrap().scaled(size),
        material: Material::named("wood").unwrap(),
        fill: Some(1.0),
        mass_kg: None,
        friction: None,
        appearances: Vec::new(),
        textures: Vec::new(),
        grasps: None,
    }
}

fn made(drafts: Vec<ObjectDraft>, settings: &PlanSettings) -> Result<PlanBundle> {
    let engine = RigidEngine::new(RigidSettings::default());
    make_plan(settings, drafts.into(), &engine, None, &|_| ())
}

#[test]
fn plan_is_independent_of_threads_and_drops_unusable_objects() {
    let drafts = || vec![draft("a", 1.0), draft("b", 0.8), draft("huge", 9.0)];
    let one = made(drafts(), &settings(1)).unwrap();
    assert_eq!(one, made(drafts(), &settings(3)).unwrap());
    assert_eq!(one.left_out.len(), 1);
    assert!(one.left_out[0].reason.contains("unit and scale"));
    assert_eq!(one.plan.simulations.len(), 2 * 2 * 2);
    let other = PlanSettings {
        seed: 6,
        ..settings(1)
    };
    assert_ne!(made(drafts(), &other).unwrap().plan.sha256, one.plan.sha256);
    let forces = one.plan.simulations.iter().map(|s| s.stop_force_n);
    assert_eq!(forces.filter(|force| *force == 10.0).count(), 4);
    let folder = tempfile::tempdir().unwrap();
    one.write(folder.path()).unwrap();
    let file = std::fs::read(folder.path().join("plan.jsonl")).unwrap();
    assert_eq!(one.plan.sha256, gripcast_base::files::sha256_hex(file));
    assert_eq!(Plan::read(folder.path()).unwrap(), one.plan);
}

#[test]
fn plan_keeps_number_and_outcome_of_given_grasps() {
    let given = |number, z: f64| AcronymGrasp {
        number,
        t_object_gripper: Pose::new(
            DQuat::from_rotation_x(std::f64::consts::PI),
            DVec3::new(0.0, 0.0, z),
        ),
        stable: number == 4,
    };
    let mut object = draft("a", 1.0);
    object.grasps = Some(vec![given(4, 0.0), given(9, 0.01)]);
    let plan = made(vec![object], &settings(1)).unwrap().plan;
    let mut found: Vec<_> = plan
        .simulations
        .iter()
        .map(|s| (s.acronym_grasp, s.acronym_stable, s.fault))
        .collect();
    found.sort_unstable();
    found.dedup();
    let expected = [(4, true), (9, false)].map(|(n, stable)| (Some(n), Some(stable), None));
    assert_eq!(found, expected);
    let text = serde_json::to_string(&plan.simulations[0]).unwrap();
    assert!(text.contains("\"acronym_stable\":"), "{text}");
}

#[test]
fn plan_folder_is_self_contained() {
    use crate::planned_mesh;
    use gripcast_base::files::Root;
    let dir = tempfile::tempdir().unwrap();
    let image = dir.path().join("red label.png");
    image::RgbImage::from_pixel(8, 4, image::Rgb([200, 30, 30]))
        .save(&image)
        .unwrap();
    let texture = TextureDraft::from_file(BeneathPath::from_user_path(&image), 0.05).unwrap();
    let mut labelled = draft("a", 1.0);
    labelled.textures = vec![texture];
    let made = made(vec![labelled, draft("b", 0.8)], &settings(1)).unwrap();
    let [first, second] = ["first", "second"].map(|name| dir.path().join(name));
    made.write(&first).unwrap();
    made.write(&first).unwrap();
    std::fs::remove_file(&image).unwrap();
    // Move the folder, as to a cluster.
    std::fs::rename(&first, &second).unwrap();
    let root = Root::new(&second);
    let plan = Plan::read(&second).unwrap();
    for object in plan.objects.values() {
        planned_mesh(object, &root).unwrap();
    }
    let texture = &plan.objects["a"].textures[0];
    assert_eq!(texture.name, "red label");
    assert_eq!(texture.load(&root).unwrap().size(), [8, 4]);
    // A linked folder inside.
    let elsewhere = dir.path().join("elsewhere");
    std::fs::create_dir_all(&elsewhere).unwrap();
    std::fs::create_dir(dir.path().join("third")).unwrap();
    std::os::unix::fs::symlink(&elsewhere, dir.path().join("third/meshes")).unwrap();
    made.write(&dir.path().join("third")).unwrap_err();
    assert_eq!(std::fs::read_dir(&elsewhere).unwrap().count(), 0);
}

#[test]
fn given_properties_stay_and_estimated_friction_is_reduced() {
    let mut given = draft("given", 1.0);
    (given.mass_kg, given.friction) = (Some(0.42), Some(1.4));
    let mut drafts = vec![given];
    drafts.extend((0..12).map(|number| draft(&format!("n{number}"), 1.0)));
    let mapped = PlanSettings {
        mass_map: MassMap::Logarithmic,
        grasps: 1,
        ..settings(2)
    };
    let plan = made(drafts, &mapped).unwrap().plan;
    let given = &plan.objects["given"];
    assert_eq!((given.mass_kg, given.friction), (0.42, 1.4));
    let wood = Material::named("wood").unwrap().friction;
    let others = plan
        .objects
        .values()
        .filter(|object| object.name != "given");
    let friction: Vec<f64> = others.map(|object| object.friction).collect();
    let possible = MIN_FRICTION_FRACTION * wood[0] - 1e-4..wood[1] + 1e-4;
    assert!(
        friction.iter().all(|f| possible.contains(f)),
        "{friction:?}"
    );
    assert!(friction.iter().any(|f| *f < wood[0]), "{friction:?}");
}

#[test]
fn friction_from_material_follows_from_the_appearance_shown() {
    let mut given = draft("given", 1.0);
    given.friction = Some(1.4);
    let mut drafts = vec![given];
    let metal = |number: usize| ObjectDraft {
        material: Material::named("steel").unwrap(),
        category: "tool".to_owned(),
        ..draft(&format!("n{number}"), 1.0)
    };
    drafts.extend((0..8).map(metal));
    let visible = PlanSettings {
        friction_from: FrictionFrom::Material,
        ..settings(2)
    };
    let plan = made(drafts.clone(), &visible).unwrap().plan;
    assert_eq!(plan.header.friction_from, FrictionFrom::Material);
    let mut of_appearance = BTreeMap::new();
    let mut shown = BTreeSet::new();
    for simulation in &plan.simulations {
        let object = plan.object(simulation).unwrap();
        let friction = simulation.friction_on(object);
        if object.name == "given" {
            assert_eq!((simulation.appearance, friction), (None, 1.4));
            continue;
        }
        let index = simulation.appearance.unwrap() as usize;
        let appearance = &object.appearances[index].appearance;
        let expected = visible_friction("tool", appearance);
        assert!((friction - expected).abs() < 1e-4, "{friction} {expected}");
        shown.insert((&object.name, simulation.grasp, index));
        // The same surface never has another friction.
        let surface = format!("{:?} {:.5}", appearance.finish, appearance.roughness);
        let same = of_appearance.entry(surface).or_insert(friction);
        assert_eq!(*same, friction);
    }
    // The same appearance at both forces, and different ones.
    assert_eq!(shown.len(), 8 * 2);
    assert!(of_appearance.len() > 4, "{of_appearance:?}");
    let soiled = made(drafts, &settings(2)).unwrap().plan;
    assert!(soiled.simulations.iter().all(|s| s.appearance.is_none()));
    let text = serde_json::to_string(&soiled.header).unwrap();
    assert!(!text.contains("friction_from"), "hashes stay: {text}");
}

#[test]
fn invalid_names_and_objects_are_explained() {
    let text = |drafts| made(drafts, &settings(1)).unwrap_err().to_string();
    assert!(text(vec![draft("a", 1.0), draft("a", 0.8)]).contains("two objects"));
    assert!(text(vec![draft(&"n".repeat(75), 1.0)]).contains("shorter name"));
    assert!(text(vec![draft("huge", 9.0)]).contains("unit and scale"));
    assert!(text(Vec::new()).contains("no object was given"));
}

#[test]
fn changed_parameter_is_named() {
    let plan = made(vec![draft("a", 1.0)], &settings(1)).unwrap().plan;
    let same = RigidEngine::new(RigidSettings::default());
    check_parameters(&plan, &same).unwrap();
    let mut changed = plan;
    let parameters = changed.header.parameters.as_object_mut().unwrap();
    let name = parameters.keys().next().unwrap().clone();
    parameters.insert(name.clone(), Value::from("other"));
    let error = check_parameters(&changed, &same).unwrap_err().to_string();
    assert!(error.contains(&name), "{error}");
}
