//! Decoding off the capture path: one thread a camera, always the newest frame.

use std::sync::Arc;
use std::sync::mpsc::Sender;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use super::hub::{CameraSlot, Hub};
use super::infer::InferRequest;
use super::tasks::{Beat, Tasks};
use gripcast_base::error::Result;
use gripcast_imaging::{CropProfile, Decoder, Frame, PixelFormat, Role};
use gripcast_nn::predict::contract::{IMAGE_HEIGHT, IMAGE_WIDTH};

/// How long a decoder waits for a frame before it looks whether it has to end.
const PATIENCE: Duration = Duration::from_millis(200);

/// Pause between previews of cameras whose every frame need not be decoded.
const PREVIEW_PAUSE: Duration = Duration::from_millis(100);

/// The image of a frame that models and screens use: the tactile crop profile, or all of a
/// colour camera, at the model's size.
pub(super) fn model_image(
    decoder: &mut Decoder,
    frame: &Frame,
    crop: Option<&CropProfile>,
) -> Result<image::RgbImage, gripcast_imaging::FrameDamage> {
    decoder.decode(frame, crop, IMAGE_WIDTH, IMAGE_HEIGHT)
}

/// Starts a decoding thread for each camera; they end when the hub is closed.
///
/// # Errors
/// When a decoder or a thread cannot be had.
pub(super) fn start(
    hub: &Hub,
    crop_of: impl Fn(Role) -> Option<CropProfile>,
    infer: &Sender<InferRequest>,
    tasks: &Tasks,
) -> Result<Vec<JoinHandle<()>>> {
    hub.slots()
        .map(|slot| {
            let (slot, infer) = (Arc::clone(slot), infer.clone());
            let crop = crop_of(slot.role());
            let mut decoder = Decoder::new()?;
            let name = format!("decode-{}", slot.role());
            tasks.spawn(&name, move |beat| {
                run(&slot, crop.as_ref(), &mut decoder, &infer, beat);
            })
        })
        .collect()
}

fn run(
    slot: &CameraSlot,
    crop: Option<&CropProfile>,
    decoder: &mut Decoder,
    infer: &Sender<InferRequest>,
    beat: &Beat,
) {
    while !slot.is_closed() {
        let Some(frame) = slot.take_newest(PATIENCE) else {
            continue;
        };
        let started = Instant::now();
        beat.busy();
        match model_image(decoder, &frame, crop) {
            Ok(image) => {
                slot.decoded(&frame, image);
                if infer.send(InferRequest::Fresh(slot.role())).is_err() {
                    return;
                }
            }
            Err(_) => slot.damaged(&frame),
        }
        beat.idle();
        // A compressed frame must be decoded to be known as sound; of raw ones a few a second
        // are enough for the screen.
        if frame.format != PixelFormat::Mjpg {
            slot.wait_closed(PREVIEW_PAUSE.saturating_sub(started.elapsed()));
        }
    }
}
