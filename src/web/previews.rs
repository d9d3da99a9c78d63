//! Newest preview of each camera, encoded once for all clients and only on demand.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};

use axum::body::Bytes;
use image::RgbImage;
use tokio::sync::watch;

use super::slots::Slots;
use crate::daemon::{EngineStatus, Preview, lock};
use gripcast_imaging::caption::write_text;
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
    /// Of a gel: what the camera sees, and right of it the difference to the initial frame, 640×240.
    Both,
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
    source: Arc<RgbImage>,
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
            PreviewImage::Both if role.is_tactile() => self.encoded(role, PreviewImage::Both),
            PreviewImage::Both => self.jpeg(role),
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
        // Image and difference change together.
        let image = Arc::clone(match which {
            PreviewImage::Raw | PreviewImage::Both => &preview.image,
            PreviewImage::Difference => preview.difference.as_ref()?,
        });
        let mut encoded = lock(&self.encoded);
        if let Some(cached) = encoded
            .get(&(role, which))
            .filter(|e| Arc::ptr_eq(&e.source, &image))
        {
            return Some(cached.jpeg.clone());
        }
        let jpeg = match which {
            PreviewImage::Both => encode_jpeg(&side_by_side(preview), QUALITY),
            PreviewImage::Raw | PreviewImage::Difference => encode_jpeg(&image, QUALITY),
        };
        let jpeg = Bytes::from(jpeg.ok()?);
        let entry = Encoded {
            source: image,
            jpeg: jpeg.clone(),
        };
        encoded.insert((role, which), entry);
        Some(jpeg)
    }
}

/// Returns image and difference of a gel side by side; without an initial frame words in place of
/// the difference.
fn side_by_side(preview: &Preview) -> RgbImage {
    let (width, height) = preview.image.dimensions();
    let mut both = RgbImage::from_pixel(2 * width, height, image::Rgb([24; 3]));
    image::imageops::replace(&mut both, &*preview.image, 0, 0);
    match &preview.difference {
        Some(difference) => {
            image::imageops::replace(&mut both, &**difference, i64::from(width), 0);
        }
        None => {
            let grey = image::Rgb([170; 3]);
            write_text(&mut both, width + 8, height / 2, "NO INITIAL FRAME", grey);
        }
    }
    both
}

#[cfg(test)]
mod tests {
    use gripcast_imaging::Decoder;
    use gripcast_session::Labels;

    use super::*;

    fn grey(level: u8) -> Arc<RgbImage> {
        Arc::new(RgbImage::from_pixel(320, 240, image::Rgb([level; 3])))
    }

    /// A dead or dirty gel is seen on the raw image only.
    #[test]
    fn raw_image_and_difference_are_both_available() {
        let mut status = EngineStatus::starting("d", "bench", Labels::default());
        let gel = Preview {
            image: grey(40),
            difference: Some(grey(128)),
            levels: None,
            driver_time_ns: 7,
        };
        let rgb = Preview {
            image: grey(90),
            difference: None,
            levels: None,
            driver_time_ns: 8,
        };
        status.previews = BTreeMap::from([(Role::Left, gel), (Role::Rgb, rgb.clone())]);
        let (sender, receiver) = watch::channel(Arc::new(status.clone()));
        let previews = Previews::new(receiver);
        let decoded = |role, which| {
            let jpeg = previews.shown(role, which).unwrap();
            Decoder::new().unwrap().stored_image(&jpeg).unwrap()
        };
        let level = |image: &RgbImage, x| image.get_pixel(x, 10).0[0];
        let raw = decoded(Role::Left, PreviewImage::Raw);
        assert_eq!((raw.width(), level(&raw, 0)), (320, 40));
        let difference = decoded(Role::Left, PreviewImage::Difference);
        assert_eq!((difference.width(), level(&difference, 0)), (320, 128));
        let both = decoded(Role::Left, PreviewImage::Both);
        assert_eq!(
            (both.width(), level(&both, 0), level(&both, 600)),
            (640, 40, 128)
        );
        for which in [
            PreviewImage::Raw,
            PreviewImage::Both,
            PreviewImage::Difference,
        ] {
            let colour = decoded(Role::Rgb, which);
            assert_eq!((colour.width(), level(&colour, 0)), (320, 90));
        }

        // Without an initial frame there is no difference, and it is not made up.
        status.previews.insert(Role::Left, rgb);
        sender.send(Arc::new(status)).unwrap();
        let both = decoded(Role::Left, PreviewImage::Both);
        assert_eq!((both.width(), level(&both, 0)), (640, 90));
        assert_eq!(previews.difference(Role::Left), None);
        let difference = decoded(Role::Left, PreviewImage::Difference);
        assert_eq!((difference.width(), level(&difference, 0)), (320, 90));
    }
}
