//! Printed ArUco board and gripper markers in a scene, and the camera that observes them.

use glam::{DQuat, DVec3};
use image::{Rgb, RgbImage};

use super::camera::Camera;
use super::grasp_state::GraspState;
use super::material::{Colour, Material};
use super::model::Model;
use super::scene::{Mesh, Scene};
use super::texture::Bitmap;
use gripcast_base::error::Result;
use gripcast_base::random::SeedStream;
use gripcast_geometry::Pose;
use gripcast_imaging::{DistortionModel, FlatPrint, Intrinsics, srgb_encode};

/// Albedo of paper and ink.
const PAPER: f32 = 0.8;
const INK: f32 = 0.02;
/// Gap between the table and the board, m, so that the board is visible.
pub(super) const PRINT_LIFT_M: f64 = 1e-4;
/// Camera pose relative to the gripper's front: azimuth, elevation, distance.
const MAX_AZIMUTH_RAD: f64 = 0.3;
const ELEVATION_RAD: [f64; 2] = [0.42, 0.56];
const DISTANCE_M: [f64; 2] = [0.62, 0.70];
/// Height of the image centre as a fraction of the height of the gripper's top.
const TARGET_FRACTION: f64 = 0.42;
/// Thickness of a marker card, m.
const CARD_M: f64 = 5e-4;

/// Printed plane with paper and ink colours.
#[derive(Clone, Debug)]
struct PrintedPlane {
    image: Bitmap,
    /// Top left, top right, bottom right, bottom left, seen from the front.
    corners_m: [DVec3; 4],
}

/// ArUco board and gripper markers of a grasp.
#[derive(Clone, Debug)]
pub struct AnnotationMarkers {
    /// In the world.
    board: PrintedPlane,
    /// In the gripper frame at opening 0, each with its displacement along x per metre of opening.
    markers: Vec<(f64, PrintedPlane)>,
}

impl AnnotationMarkers {
    /// `board` is the board in the world; `markers` are the gripper's markers in its frame at
    /// opening 0, each with its displacement along x per metre of opening.
    ///
    /// # Errors
    /// `Input` if an image is invalid.
    pub fn new(board: &FlatPrint, markers: &[(f64, FlatPrint)]) -> Result<Self> {
        let marker = |(slide, print): &(f64, FlatPrint)| Ok((*slide, PrintedPlane::new(print)?));
        Ok(Self {
            board: PrintedPlane::new(board)?,
            markers: markers.iter().map(marker).collect::<Result<_>>()?,
        })
    }

    /// Adds the board and the markers to a scene whose table lies below z = 0.
    pub(super) fn add_to(&self, scene: &mut Scene, t_world_gripper: &Pose, opening_m: f64) {
        self.board.model().add_to(scene, &Pose::IDENTITY);
        for (slide, marker) in &self.markers {
            let slid = Pose::from_translation(DVec3::X * (slide * opening_m));
            marker.card().add_to(scene, &(*t_world_gripper * slid));
        }
    }
}

/// sRGB level of a pixel with the given fraction of bare paper.
fn printed(white: f32) -> u8 {
    srgb_encode(INK + white * (PAPER - INK))
}

impl PrintedPlane {
    fn new(print: &FlatPrint) -> Result<Self> {
        let paper = &print.paper;
        let image = RgbImage::from_fn(paper.width(), paper.height(), |x, y| {
            Rgb([printed(f32::from(paper.get_pixel(x, y)[0]) / 255.0); 3])
        });
        Ok(Self {
            image: Bitmap::from_srgb8(&image)?,
            corners_m: print.corners_m.map(DVec3::from_array),
        })
    }

    fn model(&self) -> Model {
        let paper = Material::Principled {
            base_colour: Colour::Texture(0),
            metallic: 0.0,
            roughness: 0.8,
            ior: 1.45,
        };
        let mesh = Mesh {
            positions: self.corners_m.iter().map(|c| c.as_vec3()).collect(),
            normals: Vec::new(),
            // Both ends of the texture are paper, so that it may repeat.
            uvs: vec![[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]],
            triangles: vec![[0, 2, 1], [0, 3, 2]],
            material: 0,
        };
        Model {
            meshes: vec![mesh],
            materials: vec![paper],
            textures: vec![self.image.clone()],
        }
    }

    /// With a white back.
    fn card(&self) -> Model {
        let mut model = self.model();
        let [a, b, _, d] = self.corners_m;
        let back = (d - a).cross(b - a).normalize_or_zero() * -CARD_M;
        model.meshes.push(Mesh {
            positions: self
                .corners_m
                .iter()
                .map(|c| (*c + back).as_vec3())
                .collect(),
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            material: 1,
            ..Mesh::default()
        });
        model.materials.push(Material::grey(0.75));
        model
    }
}

/// Returns a camera beside the table that observes the board and the markers of a downward-pointing
/// gripper from its front (−y side), varied by the seed.
///
/// Focal length and principal point are those of a calibrated D435 colour camera, slightly
/// off-centre.
pub fn annotation_camera(state: &GraspState, [width, height]: [usize; 2], seed: u64) -> Camera {
    let mut draw = SeedStream::named(seed, "annotation camera");
    let gripper = &state.t_world_gripper;
    let approach = gripper.transform_vector(DVec3::Z);
    let flat = |v: DVec3| (v * DVec3::new(1.0, 1.0, 0.0)).normalize_or_zero();
    let front = flat(gripper.transform_vector(DVec3::NEG_Y)).normalize_or(DVec3::NEG_Y);
    let azimuth = draw.between(-MAX_AZIMUTH_RAD, MAX_AZIMUTH_RAD);
    let elevation = draw.between(ELEVATION_RAD[0], ELEVATION_RAD[1]);
    let distance = draw.between(DISTANCE_M[0], DISTANCE_M[1]);
    let side = DQuat::from_rotation_z(azimuth) * front;
    let direction = elevation.cos() * side + elevation.sin() * DVec3::Z;
    // Between the board and the markers on top of the gripper.
    let mut target = gripper.translation_m - 0.09 * approach + 0.02 * front;
    target.z = TARGET_FRACTION * (gripper.translation_m.z + 0.22);
    let eye = target + distance * direction;
    let pose = Camera::look_at(eye, target).unwrap_or(state.t_world_gripper);
    let scale = width as f64 / 1280.0;
    Camera {
        width,
        height,
        focal_px: [915.3 * scale, 914.6 * scale],
        principal_px: [
            0.5 * (width as f64 - 1.0) + 3.3 * scale,
            0.5 * (height as f64 - 1.0) - 2.1 * scale,
        ],
        t_world_camera: pose,
    }
}

impl Camera {
    /// Returns the intrinsics; the model has no distortion.
    pub fn intrinsics(&self) -> Intrinsics {
        Intrinsics {
            width: self.width as u32,
            height: self.height as u32,
            fx: self.focal_px[0],
            fy: self.focal_px[1],
            cx: self.principal_px[0],
            cy: self.principal_px[1],
            model: DistortionModel::None,
            coefficients: [0.0; 5],
        }
    }
}
