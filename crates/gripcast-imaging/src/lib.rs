//! Frames and images: pixel formats, decoding, crops, differences.
//!
//! Colour order is RGB in memory and in files. Pixel (0,0) is the centre of the top-left pixel.
//! A [`Frame`] is the raw data of a camera; a [`Decoder`] converts frames to cropped and resized
//! images; a [`TactileDifference`] is the change between two tactile images, and a [`GelChange`] tells
//! whether it is contact or light.
//!
//! ```
//! use gripcast_imaging::TactileDifference;
//! use image::{Rgb, RgbImage};
//!
//! let initial = RgbImage::from_pixel(320, 240, Rgb([90, 100, 110]));
//! let mut grasp = initial.clone();
//! grasp.put_pixel(160, 120, Rgb([120, 100, 80]));
//! let difference = TactileDifference::between(&initial, &grasp)?;
//! assert!(difference.changed_fraction(10) > 0.0);
//! # Ok::<(), gripcast_base::error::Error>(())
//! ```

pub mod caption;
mod crop;
mod damage;
mod decode;
mod depth;
mod depth_preview;
mod difference;
mod drawing;
mod flat_print;
mod frame;
mod gel;
mod gel_pattern;
mod intrinsics;
pub mod jpeg;
mod object_motion;
mod png;
mod resample;
mod srgb;
mod yuyv;
mod z16;

pub use crop::{CropProfile, CropWindow};
pub use damage::FrameDamage;
pub use decode::{Decoder, check_structure};
pub use depth::{Depth, DepthView};
pub use depth_preview::DEPTH_RANGE_M;
pub use difference::TactileDifference;
pub use drawing::{draw_arrow, draw_line};
pub use flat_print::FlatPrint;
pub use frame::{Frame, FrameBytes, FramePool, MAX_SIDE, PixelFormat, Role};
pub use gel::{
    ChangeKind, GelCells, GelChange, GelMonitor, GelProblem, GelState, MIN_CONTACT_FRACTION,
    ViewProblem,
};
pub use gel_pattern::{GelContact, gel_image, synthetic_gel};
pub use intrinsics::{DistortionModel, Intrinsics};
pub use jpeg::{JpegDamage, JpegDecoder, JpegRepairs, encode_jpeg, whole_file};
pub use object_motion::{ObjectMotion, ObjectTracker};
pub use png::{
    decode_png, decode_png_grey16, decode_png_rgb, encode_png_grey8, encode_png_grey16,
    encode_png_rgb,
};
pub use resample::{RgbScaler, crop_and_resize};
pub use srgb::{linear_to_srgb, srgb_decode, srgb_encode, srgb_to_linear};
pub use z16::{DepthImage, valid_depth_fraction};
