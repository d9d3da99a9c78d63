//! Frames and pictures: pixel formats, decoding, crops, differences.
//!
//! Colour order is RGB in memory and in files. Pixel (0,0) is the centre of the top-left pixel.

mod frame;

pub use frame::{Frame, FrameBytes, FramePool, PixelFormat, Role};
