//! Scene of a grasp as the cameras see it.

use std::f64::consts::PI;
use std::sync::Arc;

use glam::{DQuat, DVec3, Vec3};

use super::annotation_markers::{AnnotationMarkers, PRINT_LIFT_M};
use super::camera::Camera;
use super::conditions::{GroundSource, VisualConditions};
use super::d435::colour_camera;
use super::finish::STEEL;
use super::grasp_state::GraspState;
use super::gripper::{GripperSurface, gripper_parts};
use super::material::{Colour, Material};
use super::model::Model;
use super::scene::{Mesh, Scene};
use super::shading::{Projection, shaded_mesh};
use super::texture::Bitmap;
use gripcast_base::error::{Error, Result};
use gripcast_geometry::{Aabb, CREASE_RAD, Pose, WristCamera};

/// Half width of the table, m; beyond it the lower hemisphere of the environment map is visible.
const TABLE_HALF_M: f32 = 0.9;
/// Side of a procedural ground texture, px; [`SMALL_GROUND_PX`] for small images.
const GROUND_PX: u32 = 1024;
const SMALL_GROUND_PX: u32 = 512;
/// Maximum width of a small image, px.
const SMALL_WIDTH: usize = 320;
/// Half extent of a gel face along the gripper's y and z, m.
const GEL_HALF_M: [f64; 2] = [0.010, 0.0125];
/// Minimum margin between the gels and the image border, fraction of the image size.
const BORDER_FRACTION: f64 = 0.02;
/// Camera poses tried until both gels are visible, each closer to the nominal pose.
const CAMERA_ATTEMPTS: u32 = 8;

/// Viewpoint; the sizes are columns and rows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum View {
    /// The D435 on the gripper, displaced by the conditions; a centre crop of the colour stream
    /// scaled to the size.
    EyeInHand([usize; 2]),
    /// External three-quarter view of the gripper, the object and the table.
    External([usize; 2]),
}

impl View {
    /// Returns the camera of the view.
    pub fn camera(self, state: &GraspState, conditions: &VisualConditions) -> Camera {
        match self {
            Self::EyeInHand(size) => eye_in_hand_camera(state, conditions, size),
            Self::External(size) => external(state, size),
        }
    }
}

/// Composes the scene of a view.
///
/// # Errors
/// `Input` if the camera is inside the object or below the ground, the opening is out of range or
/// the image has no pixels.
pub fn grasp_scene(
    object: &Model,
    state: &GraspState,
    conditions: &VisualConditions,
    view: View,
) -> Result<Scene> {
    let camera = view.camera(state, conditions);
    let with_camera = matches!(view, View::External(_));
    compose(object, state, conditions, camera, with_camera, 0.0)
}

/// Composes the scene of [`grasp_scene`] for an external camera, with the object on an ArUco board
/// and markers on the gripper.
///
/// # Errors
/// As [`grasp_scene`].
pub fn annotation_scene(
    object: &Model,
    state: &GraspState,
    conditions: &VisualConditions,
    camera: Camera,
    prints: &AnnotationMarkers,
) -> Result<Scene> {
    let mut scene = compose(object, state, conditions, camera, true, PRINT_LIFT_M)?;
    prints.add_to(&mut scene, &state.t_world_gripper, state.opening_m);
    scene.validate()?;
    Ok(scene)
}

fn compose(
    object: &Model,
    state: &GraspState,
    conditions: &VisualConditions,
    camera: Camera,
    with_camera: bool,
    table_below_m: f64,
) -> Result<Scene> {
    let mut scene = Scene::empty(conditions.env_map(), camera);
    object.add_to(&mut scene, &state.t_world_object);
    check_camera(&scene, object)?;
    let table = Pose::from_translation(DVec3::NEG_Z * table_below_m);
    let ground_px = match scene.camera.width {
        0..=SMALL_WIDTH => SMALL_GROUND_PX,
        _ => GROUND_PX,
    };
    ground(conditions, ground_px)?.add_to(&mut scene, &table);
    add_gripper(&mut scene, state, conditions.print_colour, with_camera)?;
    scene.validate()?;
    Ok(scene)
}

/// Adds the gripper and its gels.
pub(super) fn add_gripper(
    scene: &mut Scene,
    state: &GraspState,
    print: [f32; 3],
    with_camera: bool,
) -> Result<()> {
    let body = gripper(state, print, with_camera)?;
    body.add_to(scene, &state.t_world_gripper);
    if let Some(gels) = &state.gels {
        let meshes = gels
            .iter()
            .map(|gel| shaded_mesh(gel, 0.6, Projection::None, 0));
        let deformed = Model {
            meshes: meshes.collect(),
            materials: vec![surface_material(GripperSurface::Gel, [0.0; 3])],
            textures: Vec::new(),
        };
        deformed.add_to(scene, &Pose::IDENTITY);
    }
    Ok(())
}

/// Returns the eye-in-hand camera of the conditions, moved towards its nominal pose until it sees
/// both gel faces.
pub fn eye_in_hand_camera(
    state: &GraspState,
    conditions: &VisualConditions,
    [width, height]: [usize; 2],
) -> Camera {
    let moved = |fraction: f64| {
        let shift = conditions.t_nominal_camera.translation_m * fraction;
        let rotation = DQuat::IDENTITY.slerp(conditions.t_nominal_camera.rotation, fraction);
        let t_gripper_moved = WristCamera::t_gripper_camera() * Pose::new(rotation, shift);
        let mut camera = colour_camera(width, height, state.t_world_gripper * t_gripper_moved);
        let factor = 1.0 + fraction * (conditions.focal_factor - 1.0);
        camera.focal_px = camera.focal_px.map(|f| f * factor);
        camera
    };
    (0..CAMERA_ATTEMPTS)
        .map(|attempt| moved(1.0 - f64::from(attempt) / f64::from(CAMERA_ATTEMPTS)))
        .find(|camera| sees_gels(camera, state))
        .unwrap_or_else(|| moved(0.0))
}

/// Whether the corners of both gel faces lie in the image with a small margin.
pub fn sees_gels(camera: &Camera, state: &GraspState) -> bool {
    let size = [camera.width as f64, camera.height as f64];
    let [y, z] = GEL_HALF_M;
    let half = 0.5 * state.opening_m;
    [-half, half].into_iter().all(|x| {
        [[-y, -z], [-y, z], [y, -z], [y, z]]
            .into_iter()
            .all(|[y, z]| {
                let corner = state.t_world_gripper.transform_point(DVec3::new(x, y, z));
                camera.project(corner).is_some_and(|position| {
                    (0..2).all(|a| {
                        let border = BORDER_FRACTION * size[a];
                        (border..=size[a] - 1.0 - border).contains(&position[a])
                    })
                })
            })
    })
}

/// Three-quarter view from the camera's side, slightly from above.
fn external(state: &GraspState, [width, height]: [usize; 2]) -> Camera {
    let gripper = &state.t_world_gripper;
    let approach = gripper.transform_vector(DVec3::Z);
    let flat = |v: DVec3| (v * DVec3::new(1.0, 1.0, 0.0)).normalize_or_zero();
    let side = flat(gripper.transform_vector(DVec3::NEG_Y)).normalize_or(DVec3::NEG_Y);
    let along = DVec3::Z.cross(side);
    // Midway between the table under the object and the end of the handle.
    let target = gripper.translation_m - 0.105 * approach;
    let horizontal = 0.75 * side + 0.66 * along;
    let direction = (horizontal + DVec3::Z * 0.3).normalize();
    let mut eye = target + 0.62 * direction;
    eye.z = eye.z.max(0.12);
    let pose = Camera::look_at(eye, target).unwrap_or(state.t_world_gripper);
    let wide = width as f64 / height.max(1) as f64;
    let fov = 2.0 * (0.31 * wide.min(1.6)).atan();
    Camera::centred(width, height, fov, pose)
}

/// Refuses a camera inside the object or below the ground; the scene contains only the object so
/// far.
fn check_camera(scene: &Scene, object: &Model) -> Result<()> {
    let bad = |what: String| {
        Error::input(what)
            .at("camera")
            .remedy("move the gripper away, or make the object smaller (is its unit right?)")
    };
    let height = scene.camera.t_world_camera.translation_m.z;
    if height <= 0.0 {
        return Err(bad(format!(
            "the camera would be {:.0} mm below the ground",
            -1e3 * height
        )));
    }
    scene.check_camera_outside(&scene.camera).map_err(|_| {
        let size = Aabb::from_points(object.positions()).extent() * 1e3;
        bad(format!(
            "the camera would be inside the object, which is {:.0} × {:.0} × {:.0} mm large",
            size.x, size.y, size.z
        ))
    })
}

/// Builds the table.
fn ground(conditions: &VisualConditions, size_px: u32) -> Result<Model> {
    let (bitmap, tile_m, roughness, metallic) = match &conditions.ground {
        GroundSource::Procedural(texture, seed) => {
            let generated = texture.generate(size_px, *seed);
            let bitmap = Arc::new(Bitmap::from_srgb8(&generated.image)?);
            (
                bitmap,
                generated.tile_m,
                generated.roughness,
                generated.metallic,
            )
        }
        GroundSource::Image(bitmap, width) => {
            if !(width.is_finite() && *width > 0.0) {
                return Err(Error::input(format!(
                    "the width of the ground's texture must be positive, found {width} m"
                )));
            }
            (
                bitmap.clone(),
                *width,
                conditions.ground_roughness as f32,
                0.0,
            )
        }
    };
    let mut mesh = Mesh::ground(Vec3::ZERO, TABLE_HALF_M, tile_m as f32, 0);
    let [across, down] = conditions.ground_shift_m.map(|s| (s / tile_m) as f32);
    for uv in &mut mesh.uvs {
        *uv = [uv[0] + across, uv[1] + down];
    }
    let yaw = Pose::from_rotation(DQuat::from_rotation_z(
        conditions.ground_yaw_rad % (2.0 * PI),
    ));
    Ok(Model {
        meshes: vec![mesh.transformed(&yaw)],
        materials: vec![Material::glossy(Colour::Texture(0), metallic, roughness)],
        textures: vec![bitmap.as_ref().clone()],
    })
}

/// Builds the gripper in its own frame; the D435 only if `with_camera`, the gels only if no
/// deformed ones are given.
fn gripper(state: &GraspState, print: [f32; 3], with_camera: bool) -> Result<Model> {
    let mut model = Model::default();
    let mut surfaces: Vec<GripperSurface> = Vec::new();
    for part in gripper_parts(state.opening_m)? {
        let is_camera = part.name.starts_with("camera");
        let is_replaced = part.surface == GripperSurface::Gel && state.gels.is_some();
        if is_replaced || (is_camera && !with_camera) {
            continue;
        }
        let found = surfaces.iter().position(|surface| *surface == part.surface);
        let material = found.unwrap_or_else(|| {
            surfaces.push(part.surface);
            model.materials.push(surface_material(part.surface, print));
            surfaces.len() - 1
        });
        let mesh = shaded_mesh(&part.shape, CREASE_RAD, Projection::None, material);
        model.meshes.push(mesh);
    }
    Ok(model)
}

/// Returns the material of a gripper part.
fn surface_material(surface: GripperSurface, print: [f32; 3]) -> Material {
    let plastic = |colour: [f32; 3], roughness: f32| {
        Material::glossy(Colour::Constant(colour), 0.0, roughness)
    };
    match surface {
        GripperSurface::Gel => plastic([0.23, 0.235, 0.24], 0.55),
        GripperSurface::Housing => plastic([0.02; 3], 0.4),
        GripperSurface::Label => plastic([0.82; 3], 0.6),
        GripperSurface::Print => plastic(print, 0.5),
        GripperSurface::Anodised => plastic([0.028, 0.028, 0.032], 0.32),
        GripperSurface::Steel => Material::Conductor {
            eta: STEEL[0],
            k: STEEL[1],
            roughness: 0.4,
        },
        GripperSurface::Rubber => plastic([0.022; 3], 0.7),
        GripperSurface::CameraShell => {
            Material::glossy(Colour::Constant([0.72, 0.72, 0.74]), 1.0, 0.5)
        }
        GripperSurface::CameraWindow => plastic([0.006; 3], 0.1),
    }
}

#[cfg(test)]
#[path = "grasp_scene_test.rs"]
mod tests;
