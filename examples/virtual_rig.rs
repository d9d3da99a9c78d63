//! Writes one picture of what the virtual rig's cameras see: hand open, closed, lifted.
//!
//! ```text
//! cargo run --release --example virtual_rig -- sheet.png [FIRST_GRASP]
//! ```
//! Rows: three grasps, each open, closed and lifted. Columns: left gel, right gel, colour, depth,
//! from outside.

use std::error::Error;
use std::sync::Arc;
use std::time::{Duration, Instant};

use gripcast_capture::calibration::CameraConfig;
use gripcast_capture::camera::{CameraOpener, FrameSource, ManualClock};
use gripcast_imaging::{Frame, PixelFormat, Role};
use gripcast_virtual_rig::{FilmLibrary, HandGoal, VirtualRig};
use image::{Rgb, RgbImage, imageops};

const WIDTH: u32 = 640;
const HEIGHT: u32 = 480;
const GRASPS: u32 = 3;

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let path = arguments.next().unwrap_or_else(|| "virtual_rig.png".into());
    let first: u32 = arguments.next().map_or(Ok(0), |text| text.parse())?;

    let clock = Arc::new(ManualClock::at(1_000_000_000));
    let rig = VirtualRig::new(FilmLibrary::built_in()?, 1, clock);
    let hand = rig.hand();
    let mut cameras = Vec::new();
    for (role, format) in [
        (Role::Left, "MJPG"),
        (Role::Right, "MJPG"),
        (Role::Rgb, "MJPG"),
        (Role::Depth, "Z16"),
        (Role::External, "MJPG"),
    ] {
        let config: CameraConfig = toml::from_str(&format!(
            "source = 'virtual'\nformat = '{format}'\nwidth = {WIDTH}\nheight = {HEIGHT}\nfps = 1.0"
        ))?;
        cameras.push(rig.camera(role, &config)?.open()?);
    }
    for _ in 0..first {
        hand.next_object();
    }

    let goals = [HandGoal::Open, HandGoal::Closed, HandGoal::Lifted];
    let rows = goals.len() as u32;
    let mut sheet = RgbImage::new(WIDTH * cameras.len() as u32, HEIGHT * rows * GRASPS);
    for grasp in 0..GRASPS {
        for (row, goal) in goals.into_iter().enumerate() {
            hand.go(goal);
            for (column, camera) in cameras.iter_mut().enumerate() {
                let began = Instant::now();
                // The frame after the next is a second later: the hand has come to rest.
                next(camera.as_mut())?;
                let frame = next(camera.as_mut())?;
                eprintln!(
                    "grasp {} {goal:?} column {column}: {:.1} ms a frame, {} bytes",
                    first + grasp,
                    began.elapsed().as_secs_f64() * 500.0,
                    frame.data.len()
                );
                let (x, y) = (column as u32 * WIDTH, (rows * grasp + row as u32) * HEIGHT);
                imageops::replace(&mut sheet, &picture(&frame)?, x.into(), y.into());
            }
        }
        let film = hand.film();
        let number = first + grasp;
        eprintln!("grasp {number}: {}, {}", film.name(), film.outcome().name());
        hand.next_object();
    }
    sheet.save(&path)?;
    println!("{path}");
    Ok(())
}

fn next(camera: &mut dyn FrameSource) -> Result<Frame, Box<dyn Error>> {
    camera
        .next_frame(Duration::from_secs(5))
        .map_err(|error| error.to_string().into())
}

fn picture(frame: &Frame) -> Result<RgbImage, Box<dyn Error>> {
    if frame.format == PixelFormat::Mjpg {
        let decoded = turbojpeg::decompress(&frame.data, turbojpeg::PixelFormat::RGB)?;
        return RgbImage::from_raw(frame.width, frame.height, decoded.pixels)
            .ok_or_else(|| "the picture is too short".into());
    }
    let mut picture = RgbImage::new(frame.width, frame.height);
    for (pixel, counts) in picture.pixels_mut().zip(frame.data.chunks_exact(2)) {
        let depth_mm = u16::from_le_bytes([counts[0], counts[1]]);
        *pixel = match depth_mm {
            0 => Rgb([60, 0, 60]),
            _ => Rgb([255 - (u32::from(depth_mm) * 255 / 550).min(255) as u8; 3]),
        };
    }
    Ok(picture)
}
