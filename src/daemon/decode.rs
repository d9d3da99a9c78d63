//! Decoding off the capture path: one thread per camera, always the newest frame.

use std::sync::Arc;
use std::sync::mpsc::Sender;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use super::hub::{CameraSlot, Hub};
use super::infer::InferRequest;
use super::tasks::{Heartbeat, Tasks};
use gripcast_base::error::Result;
use gripcast_imaging::{CropProfile, Decoder, Depth, Frame, PixelFormat, Role};
use gripcast_nn::predict::contract::{IMAGE_HEIGHT, IMAGE_WIDTH};

/// Wait for a frame before the decoder checks whether the hub is closed.
const FRAME_TIMEOUT: Duration = Duration::from_millis(200);

/// Interval between previews of cameras with raw frames.
const PREVIEW_PAUSE: Duration = Duration::from_millis(100);

/// Decodes a frame to the model's input size, with the crop profile of a tactile camera.
pub(super) fn model_image(
    decoder: &mut Decoder,
    frame: &Frame,
    crop: Option<&CropProfile>,
) -> Result<image::RgbImage, gripcast_imaging::FrameDamage> {
    decoder.decode(frame, crop, IMAGE_WIDTH, IMAGE_HEIGHT)
}

/// Starts a decoding thread per camera; they end when the hub is closed.
///
/// # Errors
/// Errors of creating a decoder or starting a thread.
pub(super) fn start(
    hub: &Hub,
    crop_of: impl Fn(Role) -> Option<CropProfile>,
    infer: &Sender<InferRequest>,
    tasks: &Tasks,
) -> Result<Vec<JoinHandle<()>>> {
    hub.slots()
        .map(|slot| {
            let (slot, infer) = (Arc::clone(slot), infer.clone());
            let crop = crop_of(slot.role);
            let mut decoder = Decoder::new()?;
            let name = format!("decode-{}", slot.role);
            tasks.spawn(&name, move |heartbeat| {
                run(&slot, crop.as_ref(), &mut decoder, &infer, heartbeat);
            })
        })
        .collect()
}

/// Decodes a frame for inference and previews; that of a depth camera also to depths.
fn shown_image(
    slot: &CameraSlot,
    decoder: &mut Decoder,
    frame: &Frame,
    crop: Option<&CropProfile>,
) -> Result<(image::RgbImage, Option<Depth>), gripcast_imaging::FrameDamage> {
    let unit_m = slot.with_info(|info| info.stream.as_ref()?.depth_unit_m);
    match (frame.format, unit_m) {
        (PixelFormat::Z16, Some(unit_m)) => {
            let preview = decoder.depth_preview(frame, unit_m, IMAGE_WIDTH, IMAGE_HEIGHT)?;
            let image = decoder.depth(frame)?;
            Ok((preview, Some(Depth { image, unit_m })))
        }
        _ => Ok((model_image(decoder, frame, crop)?, None)),
    }
}

fn run(
    slot: &CameraSlot,
    crop: Option<&CropProfile>,
    decoder: &mut Decoder,
    infer: &Sender<InferRequest>,
    heartbeat: &Heartbeat,
) {
    while !slot.is_closed() {
        let Some(frame) = slot.take_newest(FRAME_TIMEOUT) else {
            continue;
        };
        let started = Instant::now();
        heartbeat.busy();
        match shown_image(slot, decoder, &frame, crop) {
            Ok((image, depth)) => {
                slot.on_decoded(&frame, image, depth);
                if infer.send(InferRequest::NewImage(slot.role)).is_err() {
                    return;
                }
            }
            Err(damage) => slot.on_damaged(&frame, damage.to_string()),
        }
        heartbeat.idle();
        // Compressed frames are decoded to validate them; raw ones only for previews.
        if frame.format != PixelFormat::Mjpg {
            slot.wait_closed(PREVIEW_PAUSE.saturating_sub(started.elapsed()));
        }
    }
}
