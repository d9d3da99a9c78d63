//! Printed sheets and tags in a scene, and the camera that looks at them.

use glam::{DQuat, DVec2, DVec3};
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
use gripcast_imaging::{DistortionModel, Intrinsics, srgb_encode};
use gripcast_pose::print::{ObjectSheet, raster};
use gripcast_pose::{BoardFile, BoardMarker, Dictionary, MarkerCells, Part};

/// Resolution of a sheet's picture, dots per inch.
const SHEET_DPI: f64 = 300.0;
/// Pixels of a cell of a tag; much finer than any camera sees it.
const CELL_PX: u32 = 24;
/// Reflectances of paper and ink.
const PAPER: f32 = 0.8;
const INK: f32 = 0.02;
/// The table lies this much below a sheet, m, so that the sheet is seen and not the table.
pub(super) const PRINT_LIFT_M: f64 = 1e-4;
/// The camera's place, seen from the gripper's front: turn, angle above the table, distance.
const MOST_TURN_RAD: f64 = 0.3;
const ABOVE_RAD: [f64; 2] = [0.42, 0.56];
const DISTANCE_M: [f64; 2] = [0.62, 0.70];
/// Height of the middle of the picture, as a share of that of the gripper's top.
const TARGET_SHARE: f64 = 0.42;
/// Thickness of a tag's card, m.
const CARD_M: f64 = 5e-4;

/// A flat printed picture.
#[derive(Clone, Debug)]
struct Print {
    picture: Bitmap,
    /// Top left, top right, bottom right, bottom left as seen from the front.
    corners_m: [DVec3; 4],
}

/// Sheet and tags of a grasp.
#[derive(Clone, Debug)]
pub struct GraspPrints {
    /// In the world.
    sheet: Print,
    /// In the frames of their parts, for opening 0.
    tags: Vec<(Part, Print)>,
}

impl GraspPrints {
    /// Pictures of a sheet, whose frame is the world in which its object stands, and of the tags
    /// of a gripper.
    ///
    /// # Errors
    /// `Input` for a sheet that cannot be drawn.
    pub fn new(sheet: &ObjectSheet, tags: &BoardFile) -> Result<Self> {
        let drawn = raster(&sheet.drawing, SHEET_DPI)?;
        let picture = RgbImage::from_fn(drawn.width(), drawn.height(), |x, y| {
            Rgb([printed(f32::from(drawn.get_pixel(x, y)[0]) / 255.0); 3])
        });
        // The picture's size is rounded to whole pixels, the sheet's is not.
        let size_mm = DVec2::new(f64::from(drawn.width()), f64::from(drawn.height()));
        let size_mm = size_mm * 25.4 / SHEET_DPI;
        let corner = |x: f64, y: f64| sheet.to_world(DVec2::new(x, y));
        let sheet = Print {
            picture: Bitmap::from_srgb8(&picture)?,
            corners_m: [
                corner(0.0, 0.0),
                corner(size_mm.x, 0.0),
                corner(size_mm.x, size_mm.y),
                corner(0.0, size_mm.y),
            ],
        };
        let markers = tags.board.markers.iter();
        let tags = markers
            .filter_map(|marker| {
                let cells = tags.dictionary.marker(marker.id)?;
                Some(Print::tag(marker, &cells, &tags.dictionary).map(|tag| (marker.part, tag)))
            })
            .collect::<Result<_>>()?;
        Ok(Self { sheet, tags })
    }

    /// Adds them to a scene whose table is at z = 0: what is on the sheet stays where it is.
    pub(super) fn add_to(&self, scene: &mut Scene, t_world_gripper: &Pose, opening_m: f64) {
        self.sheet.model().add_to(scene, &Pose::IDENTITY);
        for (part, tag) in &self.tags {
            let slide = match part {
                Part::FingerLeft => -0.5 * opening_m,
                Part::FingerRight => 0.5 * opening_m,
                Part::Body | Part::Object => 0.0,
            };
            let slid = Pose::from_translation(DVec3::X * slide);
            tag.card().add_to(scene, &(*t_world_gripper * slid));
        }
    }
}

/// sRGB level of a place of which the share `white` is bare paper.
fn printed(white: f32) -> u8 {
    srgb_encode(INK + white * (PAPER - INK))
}

impl Print {
    /// A marker with a white zone of a cell around it.
    fn tag(marker: &BoardMarker, cells: &MarkerCells, dictionary: &Dictionary) -> Result<Self> {
        let count = dictionary.cells_per_side() as u32;
        let border = dictionary.border_cells();
        let is_white = |x: u32, y: u32| {
            let place = |at: u32| (at / CELL_PX).checked_sub(1).filter(|cell| *cell < count);
            let (Some(column), Some(row)) = (place(x), place(y)) else {
                return true;
            };
            let inner = |at: u32| (at as usize).checked_sub(border);
            match (inner(row), inner(column)) {
                (Some(row), Some(column)) if row.max(column) < cells.side() => {
                    cells.is_white(row, column)
                }
                _ => false,
            }
        };
        let side = (count + 2) * CELL_PX;
        let picture = RgbImage::from_fn(side, side, |x, y| {
            Rgb([printed(f32::from(u8::from(is_white(x, y)))); 3])
        });
        let [top_left, top_right, _, bottom_left] = marker.corners_m;
        let cell = 1.0 / f64::from(count);
        let (right, down) = (top_right - top_left, bottom_left - top_left);
        let at = |x: f64, y: f64| top_left + x * right + y * down;
        Ok(Self {
            picture: Bitmap::from_srgb8(&picture)?,
            corners_m: [
                at(-cell, -cell),
                at(1.0 + cell, -cell),
                at(1.0 + cell, 1.0 + cell),
                at(-cell, 1.0 + cell),
            ],
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
            textures: vec![self.picture.clone()],
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

/// A camera beside the table that sees the sheet and the tags of a gripper that points down: in
/// front of the gripper (its −y side), moved by the seed.
///
/// Focal length and principal point are those of a D435's colour camera as one is calibrated: not
/// quite in the middle.
pub fn annotation_camera(state: &GraspState, [width, height]: [usize; 2], seed: u64) -> Camera {
    let mut draw = SeedStream::named(seed, "annotation camera");
    let gripper = &state.t_world_gripper;
    let approach = gripper.transform_vector(DVec3::Z);
    let flat = |v: DVec3| (v * DVec3::new(1.0, 1.0, 0.0)).normalize_or_zero();
    let front = flat(gripper.transform_vector(DVec3::NEG_Y)).normalize_or(DVec3::NEG_Y);
    let turn = draw.between(-MOST_TURN_RAD, MOST_TURN_RAD);
    let above = draw.between(ABOVE_RAD[0], ABOVE_RAD[1]);
    let distance = draw.between(DISTANCE_M[0], DISTANCE_M[1]);
    let side = DQuat::from_rotation_z(turn) * front;
    let direction = above.cos() * side + above.sin() * DVec3::Z;
    // Between the sheet and the tags on top of the gripper.
    let mut target = gripper.translation_m - 0.09 * approach + 0.02 * front;
    target.z = TARGET_SHARE * (gripper.translation_m.z + 0.22);
    let eye = target + distance * direction;
    let pose = Camera::looking_at(eye, target).unwrap_or(state.t_world_gripper);
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
    /// Its intrinsics; it has no distortion.
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
