//! Path-traced pictures of the scene of a grasp.
//!
//! A [`Scene`] (meshes, materials, textures, dome of light) is prepared once as a [`Renderer`],
//! which then makes pictures of it from any [`Camera`]. Light is linear RGB with the primaries of
//! sRGB; [`Picture::to_srgb8`] makes the 8-bit picture.
//!
//! World: z up, metres. Camera: OpenCV optical frame. Pixel (0, 0) is the centre of the top-left
//! pixel.

mod bsdf;
mod bvh;
mod camera;
mod denoise;
mod dome;
mod environment;
mod film;
mod integrator;
mod material;
mod picture;
mod renderer;
mod sampler;
mod scene;
mod settings;
mod surface;
mod texture;
mod trigonometry;

pub use camera::Camera;
pub use denoise::{DenoiseSettings, denoise};
pub use environment::Environment;
pub use material::{Colour, Material};
pub use picture::Picture;
pub use renderer::{Renderer, Rendering};
pub use scene::{Mesh, Scene};
pub use settings::{PixelFilter, RenderSettings, Watch};
pub use texture::{Bitmap, ProceduralTexture, Texture};
