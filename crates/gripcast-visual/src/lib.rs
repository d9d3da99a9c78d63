//! Path-traced images of the scene of a grasp.
//!
//! Prepare a [`Scene`] (meshes, materials, textures, environment map) once as a [`Renderer`], then
//! render it from any [`Camera`]. Colours are linear RGB with the sRGB primaries;
//! [`Image::to_srgb8`] converts to 8 bits.
//!
//! World: z up, metres. Camera: OpenCV optical frame. Pixel (0, 0) is the centre of the top-left
//! pixel.

mod annotation_markers;
mod appearance;
mod appearance_model;
mod bitmap_file;
mod bsdf;
mod bvh;
mod camera;
mod conditions;
mod d435;
mod demo;
mod denoise;
mod env_map;
mod env_map_sampler;
mod film;
mod finish;
mod grasp_depth;
mod grasp_scene;
mod grasp_state;
mod gripper;
mod hdr;
mod integrator;
mod linear_image;
mod material;
mod model;
mod procedural;
mod renderer;
mod room;
mod sampler;
mod scene;
mod settings;
mod shading;
mod sky;
mod solids;
mod surface;
mod texture;
mod trigonometry;

pub use annotation_markers::{AnnotationMarkers, annotation_camera};
pub use appearance::{Appearance, FinishClass, SurfacePattern};
pub use bitmap_file::{load_bitmap, read_bitmap};
pub use camera::Camera;
pub use conditions::{EnvMapSource, GroundSource, VisualConditions, VisualRandomisation};
pub use d435::{ColourSettings, DepthSettings, colour_camera, develop, measure_depth};
pub use demo::{demo_model, random_finish, typical_finishes};
pub use denoise::{DENOISE_RADIUS_PX, denoise};
pub use env_map::EnvMap;
pub use finish::Finish;
pub use grasp_depth::GraspDepth;
pub use grasp_scene::{View, annotation_scene, eye_in_hand_camera, grasp_scene, sees_gels};
pub use grasp_state::GraspState;
pub use gripper::{GripperPart, GripperSurface, gripper_parts};
pub use hdr::{load_hdr, read_hdr};
pub use linear_image::Image;
pub use material::{Colour, Material};
pub use model::{LoadedModel, Model};
pub use procedural::{GeneratedTexture, ProceduralTexture};
pub use renderer::{Renderer, Rendering};
pub use scene::{Mesh, Scene};
pub use settings::{PixelFilter, RenderControl, RenderSettings};
pub use shading::{Projection, shaded_mesh};
pub use sky::{Sky, normalise_env_map, white_table_luminance};
pub use texture::Bitmap;
