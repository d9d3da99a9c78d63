//! The images of a gel while its camera is measured.

use std::time::Instant;

use gripcast_base::error::Result;
use gripcast_imaging::{CropProfile, Decoder, Frame, GelCells, GelMonitor, GelState};

/// Size of the judged image, pixels.
const SIZE: [u32; 2] = [320, 240];
/// Pause after a decoded frame, multiples of the time that it took: the camera must not lose frames.
const PAUSE: u64 = 3;

/// Follows a gel through as many frames as can be decoded beside the measurement.
pub(crate) struct GelCheck {
    decoder: Decoder,
    monitor: GelMonitor,
    next_ns: u64,
}

impl GelCheck {
    /// # Errors
    /// If the decoder cannot be created.
    pub(crate) fn new() -> Result<Self> {
        Ok(Self {
            decoder: Decoder::new()?,
            monitor: GelMonitor::default(),
            next_ns: 0,
        })
    }

    /// Judges a frame. Damaged and tiny frames are left to the check of the camera.
    pub(crate) fn add(&mut self, frame: &Frame) {
        if frame.received_ns < self.next_ns {
            return;
        }
        let started = Instant::now();
        let [width, height] = SIZE;
        let crop = Some(&CropProfile::GSMINI_SEVENTH);
        if let Ok(image) = self.decoder.decode(frame, crop, width, height)
            && let Ok(cells) = GelCells::new(&image)
        {
            self.monitor.add(cells, frame.driver_time_ns);
        }
        let took_ns = u64::try_from(started.elapsed().as_nanos()).unwrap_or(u64::MAX);
        self.next_ns = frame
            .received_ns
            .saturating_add(took_ns.saturating_mul(PAUSE));
    }

    /// State after the last judged frame; `None` if there was none.
    pub(crate) fn state(&self) -> Option<&GelState> {
        self.monitor.state()
    }
}
