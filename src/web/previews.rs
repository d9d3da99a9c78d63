//! Newest preview of each camera, encoded once for all clients and only on demand.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};

use axum::body::Bytes;
use tokio::sync::watch;

use super::slots::Slots;
use crate::daemon::{EngineStatus, lock};
use gripcast_imaging::{Role, encode_jpeg};

/// JPEG quality.
const QUALITY: u8 = 75;
/// Maximum image streams over TCP and over the socket; a browser opens one per camera.
pub(super) const MAX_STREAMS: usize = 32;

/// Cache of the newest preview of each camera as JPEG.
pub(crate) struct Previews {
    status: watch::Receiver<Arc<EngineStatus>>,
    encoded: Mutex<BTreeMap<Role, Encoded>>,
    /// Slots of image streams.
    pub(crate) streams: Slots,
}

struct Encoded {
    /// Source image, kept so that its address stays unique.
    source: Arc<image::RgbImage>,
    jpeg: Bytes,
}

impl Previews {
    /// Creates previews of the engine's status.
    pub(crate) fn new(status: watch::Receiver<Arc<EngineStatus>>) -> Self {
        Self {
            status,
            encoded: Mutex::new(BTreeMap::new()),
            streams: Slots::new(MAX_STREAMS, MAX_STREAMS),
        }
    }

    /// Returns the newest image; `None` before the first.
    pub(crate) fn jpeg(&self, role: Role) -> Option<Bytes> {
        let status = Arc::clone(&self.status.borrow());
        let image = Arc::clone(&status.previews.get(&role)?.image);
        let mut encoded = lock(&self.encoded);
        if let Some(cached) = encoded
            .get(&role)
            .filter(|e| Arc::ptr_eq(&e.source, &image))
        {
            return Some(cached.jpeg.clone());
        }
        let jpeg = Bytes::from(encode_jpeg(&image, QUALITY).ok()?);
        let entry = Encoded {
            source: image,
            jpeg: jpeg.clone(),
        };
        encoded.insert(role, entry);
        Some(jpeg)
    }
}
