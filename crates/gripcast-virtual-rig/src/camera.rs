//! Cameras of the virtual rig: paced like real ones, with sequence gaps for late readers.

use std::fs;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use image::RgbImage;

use super::gel::GelRenderer;
use super::hand::{SceneState, VirtualHand};
use super::library::ClipLibrary;
use super::view::{ColourRenderer, DepthRenderer, Viewpoint};
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_capture::calibration::CameraConfig;
use gripcast_capture::camera::{
    CameraIdentity, CameraOpener, CaptureError, Clock, ControlValues, FrameSource, StreamInfo,
};
use gripcast_imaging::{Frame, PixelFormat, RgbScaler, Role, encode_jpeg};
use gripcast_tactile::SensorProfile;

/// Maximum rendered width; wider images are upscaled.
const RENDER_WIDTH: u32 = 640;
/// Maximum rendered width of tactile images, which keep finer detail.
const GEL_RENDER_WIDTH: u32 = 820;
/// Maximum rendered width of external images, in which markers are detected.
const EXTERNAL_RENDER_WIDTH: u32 = 1280;
/// Frames buffered for a late reader, as in a driver.
const BUFFERS: u64 = 4;
const DEPTH_UNIT_M: f64 = 0.001;
const JPEG_QUALITY: u8 = 92;

/// A virtual rig: one hand and its cameras.
#[derive(Clone)]
pub struct VirtualRig {
    hand: Arc<VirtualHand>,
    clock: Arc<dyn Clock>,
    seed: u64,
    unplugged: Option<PathBuf>,
}

impl VirtualRig {
    /// Creates a rig that plays `clips`; their order and the noise follow from `seed`.
    pub fn new(clips: ClipLibrary, seed: u64, clock: Arc<dyn Clock>) -> Self {
        Self {
            hand: Arc::new(VirtualHand::new(clips, seed, clock.clone())),
            clock,
            seed,
            unplugged: None,
        }
    }

    /// Unplugs the cameras whose roles `file` lists, for as long as it lists them.
    pub fn with_unplugged(self, file: PathBuf) -> Self {
        Self {
            unplugged: Some(file),
            ..self
        }
    }

    fn is_unplugged(&self, role: Role) -> bool {
        let text = self.unplugged.as_ref().map(fs::read_to_string);
        text.is_some_and(|text| text.is_ok_and(|t| t.split_whitespace().any(|w| w == role.name())))
    }

    /// Returns the hand.
    pub fn hand(&self) -> Arc<VirtualHand> {
        self.hand.clone()
    }

    /// Returns the camera of `role` in the format and size of `config`.
    ///
    /// # Errors
    /// [`ErrorKind::Config`] for a format that the role does not support, or a size or rate out
    /// of range.
    pub fn camera(&self, role: Role, config: &CameraConfig) -> Result<VirtualOpener> {
        let unsupported = |what: String| Error::config(what).at(role);
        let depth = role == Role::Depth;
        if depth != (config.format == PixelFormat::Z16) {
            let expected = match depth {
                true => "Z16",
                false => "MJPG, YUYV, GREY or RGB",
            };
            return Err(unsupported(format!(
                "the virtual camera expected {expected}, found {}",
                config.format
            )));
        }
        let (width, height) = (config.width, config.height);
        if !(16..=4096).contains(&width) || !(16..=4096).contains(&height) || width % 2 != 0 {
            return Err(unsupported(format!(
                "the virtual camera expected 16 to 4096 pixels with an even width, found \
                 {width}×{height}"
            )));
        }
        if !(config.fps > 0.0 && config.fps <= 240.0) {
            let fps = config.fps;
            return Err(unsupported(format!(
                "expected a frame rate above 0 and up to 240, found {fps}"
            )));
        }
        let profile = role
            .is_tactile()
            .then(|| sensor_profile(role, config))
            .transpose()?;
        let (product, serial) = match role {
            Role::Left => ("Virtual GelSight Mini", "VIRT-LEFT"),
            Role::Right => ("Virtual GelSight Mini", "VIRT-RIGHT"),
            Role::Rgb => ("Virtual D435 colour", "VIRT-RGB"),
            Role::Depth => ("Virtual D435 depth", "VIRT-DEPTH"),
            Role::External => ("Virtual scene camera", "VIRT-EXTERNAL"),
        };
        Ok(VirtualOpener {
            rig: self.clone(),
            role,
            info: StreamInfo {
                identity: CameraIdentity {
                    product: product.to_owned(),
                    serial: serial.to_owned(),
                    interface: if role == Role::Rgb { 3 } else { 0 },
                    port: "virtual".to_owned(),
                    node: None,
                },
                format: config.format,
                width,
                height,
                nominal_fps: config.fps,
                depth_unit_m: depth.then(|| config.depth_unit_m.unwrap_or(DEPTH_UNIT_M)),
            },
            controls: control_values(role, &config.controls),
            profile,
        })
    }
}

/// Reads the sensor profile of a tactile camera; sensors of different roles have different gels.
fn sensor_profile(role: Role, config: &CameraConfig) -> Result<Arc<SensorProfile>> {
    let mut profile = match &config.sensor_profile {
        Some(name) => {
            SensorProfile::named_or_load(name).map_err(|e| e.at(format!("camera {role}")))?
        }
        None => SensorProfile::gelsight_mini()?,
    };
    if profile.serial.is_empty() {
        profile.serial = role.name().to_owned();
    }
    Ok(Arc::new(profile))
}

/// Returns typical control values of such a camera, overridden by those of the rig file.
fn control_values(role: Role, configured: &ControlValues) -> ControlValues {
    let typical: &[(&str, i64)] = match role {
        Role::Left | Role::Right => &[
            ("auto_exposure", 1),
            ("exposure_time_absolute", 180),
            ("gain", 0),
            ("white_balance_automatic", 0),
            ("white_balance_temperature", 4500),
        ],
        Role::Rgb | Role::External => &[
            ("auto_exposure", 1),
            ("exposure_time_absolute", 156),
            ("gain", 64),
            ("white_balance_automatic", 0),
            ("white_balance_temperature", 4600),
        ],
        Role::Depth => &[
            ("auto_exposure", 1),
            ("exposure_time_absolute", 85),
            ("gain", 16),
        ],
    };
    let typical = typical
        .iter()
        .map(|(name, value)| ((*name).to_owned(), *value));
    typical.chain(configured.clone()).collect()
}

/// Opener of one virtual camera.
#[derive(Clone)]
pub struct VirtualOpener {
    rig: VirtualRig,
    role: Role,
    info: StreamInfo,
    controls: ControlValues,
    /// Sensor of a tactile camera.
    profile: Option<Arc<SensorProfile>>,
}

impl CameraOpener for VirtualOpener {
    fn role(&self) -> Role {
        self.role
    }

    fn describe(&self) -> String {
        self.info.identity.to_string()
    }

    fn open(&mut self) -> Result<Box<dyn FrameSource>> {
        if self.rig.is_unplugged(self.role) {
            let what = format!("{} is not plugged in", self.info.identity);
            return Err(Error::new(ErrorKind::Device, what));
        }
        let renderer = FrameRenderer::new(self)?;
        Ok(Box::new(VirtualCamera {
            camera: self.clone(),
            renderer,
            start_ns: self.rig.clock.now_ns(),
            interval_ns: 1e9 / self.info.nominal_fps,
            next: 0,
        }))
    }
}

/// An open virtual camera. It does not wait for its reader.
struct VirtualCamera {
    camera: VirtualOpener,
    renderer: FrameRenderer,
    start_ns: u64,
    interval_ns: f64,
    /// Number of the next frame of a timely reader.
    next: u64,
}

impl VirtualCamera {
    fn time_ns(&self, frame: u64) -> u64 {
        // The first frame is complete one interval after the start.
        self.start_ns + ((frame + 1) as f64 * self.interval_ns) as u64
    }

    /// Returns the number of the next frame; a late reader gets the newest buffers only.
    fn upcoming(&self, now_ns: u64) -> u64 {
        let complete = (now_ns.saturating_sub(self.start_ns) as f64 / self.interval_ns) as u64;
        self.next.max(complete.saturating_sub(BUFFERS))
    }
}

impl FrameSource for VirtualCamera {
    fn info(&self) -> &StreamInfo {
        &self.camera.info
    }

    fn next_frame(&mut self, timeout: Duration) -> Result<Frame, CaptureError> {
        let VirtualOpener {
            rig, role, info, ..
        } = &self.camera;
        if rig.is_unplugged(*role) {
            return Err(CaptureError::Gone);
        }
        let number = self.upcoming(rig.clock.now_ns());
        let due_ns = self.time_ns(number);
        if !rig.clock.wait_for(due_ns, timeout) {
            return Err(CaptureError::Timeout);
        }
        self.next = number + 1;
        let scene = rig.hand.scene_at(due_ns);
        let data = self.renderer.render_frame(&scene, number);
        Ok(Frame {
            format: info.format,
            width: info.width,
            height: info.height,
            data: data.map_err(CaptureError::Failed)?.into(),
            sequence: number as u32,
            driver_time_ns: due_ns,
            received_ns: rig.clock.now_ns(),
        })
    }

    fn controls(&mut self) -> Result<ControlValues> {
        Ok(self.camera.controls.clone())
    }
}

enum Scene {
    Gel(Box<GelRenderer>),
    Colour(ColourRenderer),
    Depth(DepthRenderer),
}

/// Renders a scene in the pixel format of a camera.
struct FrameRenderer {
    scene: Scene,
    render_size: (u32, u32),
    info: StreamInfo,
    scaler: RgbScaler,
}

impl FrameRenderer {
    fn new(camera: &VirtualOpener) -> Result<Self> {
        let VirtualOpener {
            rig,
            role,
            info,
            profile,
            ..
        } = camera;
        let limit = match role {
            Role::Left | Role::Right => GEL_RENDER_WIDTH,
            Role::Rgb | Role::Depth => RENDER_WIDTH,
            Role::External => EXTERNAL_RENDER_WIDTH,
        };
        let render_size = if info.width <= limit {
            (info.width, info.height)
        } else {
            (limit, (info.height * limit / info.width).max(1))
        };
        let full = (info.width, info.height);
        let scene = match (role, profile) {
            (_, Some(profile)) => {
                let renderer = GelRenderer::new(*role, rig.seed, render_size, full, profile)?;
                Scene::Gel(Box::new(renderer))
            }
            (Role::Depth, None) => Scene::Depth(DepthRenderer::new(rig.seed, render_size)),
            (Role::External, None) => Scene::Colour(ColourRenderer::new(
                Viewpoint::External,
                rig.seed,
                render_size,
            )),
            (_, None) => Scene::Colour(ColourRenderer::new(Viewpoint::Hand, rig.seed, render_size)),
        };
        Ok(Self {
            scene,
            render_size,
            info: info.clone(),
            scaler: RgbScaler::default(),
        })
    }

    fn render_frame(&mut self, scene: &SceneState, frame: u64) -> Result<Vec<u8>> {
        let render_size = match &mut self.scene {
            Scene::Depth(renderer) => {
                let depth_m = renderer.render_frame_m(scene, frame)?;
                return Ok(self.depth_bytes(&depth_m));
            }
            Scene::Gel(renderer) => renderer.render_frame(scene, frame)?,
            Scene::Colour(renderer) => renderer.render_frame(scene, frame)?,
        };
        let size = (self.info.width, self.info.height);
        let image = if self.render_size == size {
            RgbImage::from_raw(size.0, size.1, render_size)
        } else {
            Some(self.scaler.enlarge(&render_size, self.render_size, size)?)
        };
        let image = image.ok_or_else(|| Error::internal("the rendered image has another size"))?;
        Ok(match self.info.format {
            PixelFormat::Mjpg => encode_jpeg(&image, JPEG_QUALITY)?,
            PixelFormat::Grey => image.chunks_exact(3).map(luminance).collect(),
            PixelFormat::Rgb => image.into_raw(),
            PixelFormat::Yuyv | PixelFormat::Z16 => yuyv_bytes(&image),
        })
    }

    /// Encodes depth in counts of the depth unit, little endian, upscaled by nearest neighbour.
    fn depth_bytes(&self, depth_m: &[f32]) -> Vec<u8> {
        let unit_m = self.info.depth_unit_m.unwrap_or(DEPTH_UNIT_M) as f32;
        let (painted_width, painted_height) =
            (self.render_size.0 as usize, self.render_size.1 as usize);
        let (width, height) = (self.info.width as usize, self.info.height as usize);
        let mut bytes = Vec::with_capacity(2 * width * height);
        for row in 0..height {
            let line = &depth_m[row * painted_height / height * painted_width..][..painted_width];
            for column in 0..width {
                let counts = line[column * painted_width / width] / unit_m;
                bytes.extend_from_slice(&(counts.round() as u16).to_le_bytes());
            }
        }
        bytes
    }
}

/// Returns the BT.601 luminance of an RGB pixel, full range.
fn luminance(rgb: &[u8]) -> u8 {
    let [r, g, b] = [0, 1, 2].map(|n| u32::from(rgb[n]));
    ((299 * r + 587 * g + 114 * b + 500) / 1000) as u8
}

/// Encodes RGB as YUYV: BT.601, limited range; a pixel pair shares its mean chroma.
pub(super) fn yuyv_bytes(rgb: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(rgb.len() / 3 * 2);
    for pair in rgb.chunks_exact(6) {
        let p = |n: usize| i32::from(pair[n]);
        let luma =
            |n: usize| (((66 * p(n) + 129 * p(n + 1) + 25 * p(n + 2) + 128) >> 8) + 16) as u8;
        let [r, g, b] = [0, 1, 2].map(|n| p(n) + p(n + 3));
        let u = ((-38 * r - 74 * g + 112 * b + 256) >> 9) + 128;
        let v = ((112 * r - 94 * g - 18 * b + 256) >> 9) + 128;
        bytes.extend_from_slice(&[luma(0), u as u8, luma(3), v as u8]);
    }
    bytes
}
