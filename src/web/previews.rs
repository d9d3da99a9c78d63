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

/// Which image of a camera.
#[derive(
    Clone,
    Copy,
    Debug,
    Default,
    PartialEq,
    Eq,
    PartialOrd,
    Ord,
    serde::Deserialize,
    utoipa::ToSchema,
)]
#[serde(rename_all = "snake_case")]
pub(crate) enum PreviewImage {
    /// As the camera sees it.
    Raw,
    /// Of a gel the difference to the initial frame, once there is one; else as the camera sees it.
    #[default]
    Difference,
}

/// Cache of the newest preview of each camera as JPEG.
pub(crate) struct Previews {
    status: watch::Receiver<Arc<EngineStatus>>,
    encoded: Mutex<BTreeMap<(Role, PreviewImage), Encoded>>,
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

    /// Returns the newest image of a camera; `None` before the first.
    pub(crate) fn jpeg(&self, role: Role) -> Option<Bytes> {
        self.encoded(role, PreviewImage::Raw)
    }

    /// Returns the newest image of a camera of this kind; for a gel without an initial frame its
    /// image. `None` before the first.
    pub(crate) fn shown(&self, role: Role, which: PreviewImage) -> Option<Bytes> {
        match which {
            PreviewImage::Raw => self.jpeg(role),
            PreviewImage::Difference => self.difference(role).or_else(|| self.jpeg(role)),
        }
    }

    /// Returns the newest difference of a gel; `None` without an initial frame.
    pub(crate) fn difference(&self, role: Role) -> Option<Bytes> {
        self.encoded(role, PreviewImage::Difference)
    }

    fn encoded(&self, role: Role, which: PreviewImage) -> Option<Bytes> {
        let status = Arc::clone(&self.status.borrow());
        let preview = status.previews.get(&role)?;
        let image = Arc::clone(match which {
            PreviewImage::Raw => &preview.image,
            PreviewImage::Difference => preview.difference.as_ref()?,
        });
        let mut encoded = lock(&self.encoded);
        if let Some(cached) = encoded
            .get(&(role, which))
            .filter(|e| Arc::ptr_eq(&e.source, &image))
        {
            return Some(cached.jpeg.clone());
        }
        let jpeg = Bytes::from(encode_jpeg(&image, QUALITY).ok()?);
        let entry = Encoded {
            source: image,
            jpeg: jpeg.clone(),
        };
        encoded.insert((role, which), entry);
        Some(jpeg)
    }
}
