//! The newest small image of each camera: encoded once, however many look, and only while
//! somebody does.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

use axum::body::Bytes;
use tokio::sync::watch;

use super::slots::Slots;
use crate::daemon::EngineStatus;
use gripcast_imaging::{Role, encode_jpeg};

/// Quality of the images.
const QUALITY: u8 = 75;
/// Streams at a time, over TCP and over the socket; a browser has one a camera.
pub(super) const MAX_STREAMS: usize = 32;

/// The newest image of each camera as JPEG, made when it is asked for.
pub(crate) struct Previews {
    status: watch::Receiver<Arc<EngineStatus>>,
    encoded: Mutex<BTreeMap<Role, Encoded>>,
    /// Slots for streams.
    pub(crate) streams: Slots,
}

struct Encoded {
    /// The image that it was made from; holding it keeps its address its own.
    of: Arc<image::RgbImage>,
    jpeg: Bytes,
}

impl Previews {
    /// Images of the status.
    pub(crate) fn new(status: watch::Receiver<Arc<EngineStatus>>) -> Self {
        Self {
            status,
            encoded: Mutex::new(BTreeMap::new()),
            streams: Slots::new(MAX_STREAMS, MAX_STREAMS),
        }
    }

    /// The newest image; `None` before the first.
    pub(crate) fn jpeg(&self, role: Role) -> Option<Bytes> {
        let status = Arc::clone(&self.status.borrow());
        let image = Arc::clone(&status.previews.get(&role)?.image);
        let mut encoded = self.encoded.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(known) = encoded.get(&role).filter(|e| Arc::ptr_eq(&e.of, &image)) {
            return Some(known.jpeg.clone());
        }
        let jpeg = Bytes::from(encode_jpeg(&image, QUALITY).ok()?);
        let made = Encoded {
            of: image,
            jpeg: jpeg.clone(),
        };
        encoded.insert(role, made);
        Some(jpeg)
    }
}
