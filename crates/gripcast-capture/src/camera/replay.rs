//! Replays a directory as a camera.
//!
//! The directory is either a recording (it or its `<role>` folder has a `stream.json`), or a folder
//! of images of one size. Images are played in the order of their names at the configured rate:
//! `.jpg` and `.jpeg` unchanged, `.png` encoded as JPEG of quality 98 when the folder is opened.

use std::collections::BTreeSet;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use turbojpeg::{Image, PixelFormat as JpegPixels, Subsamp};

use super::clock::Clock;
use super::recorder::{FRAMES_FILE, FrameRecord, STREAM_FILE, StreamRecord};
use super::source::{
    CameraIdentity, CameraOpener, CaptureError, ControlValues, FrameSource, StreamInfo,
};
use crate::calibration::CameraConfig;
use gripcast_base::error::{Error, Result};
use gripcast_base::files::{BeneathPath, FileKind, Root, is_system_file};
use gripcast_imaging::{Frame, FrameBytes, PixelFormat, Role, decode_png_rgb};

const PNG_JPEG_QUALITY: i32 = 98;

/// Opens a directory for replay.
pub struct ReplayOpener {
    role: Role,
    dir: PathBuf,
    config: CameraConfig,
    clock: Arc<dyn Clock>,
}

impl ReplayOpener {
    /// A replay of `config.path`.
    ///
    /// # Errors
    /// `Config` for a missing path.
    pub fn new(role: Role, config: &CameraConfig, clock: Arc<dyn Clock>) -> Result<Self> {
        let dir = config.path.clone().ok_or_else(|| {
            Error::config("a replay camera needs a directory")
                .at(role)
                .remedy("add `path = \"DIRECTORY\"` to the camera in the rig file")
        })?;
        Ok(Self {
            role,
            dir,
            config: config.clone(),
            clock,
        })
    }

    /// Reads the directory's index; returns the source and warnings.
    ///
    /// # Errors
    /// `NotFound` for a missing directory, `Input` for one without
    /// frames or with a different format or size than the rig file.
    pub fn load(&self) -> Result<(ReplaySource, Vec<String>)> {
        let load = || {
            if !self.dir.is_dir() {
                return Err(Error::not_found("the directory does not exist")
                    .remedy("correct the camera's `path` in the rig file"));
            }
            let role_dir = self.dir.join(self.role.name());
            for dir in [&role_dir, &self.dir] {
                if dir.join(STREAM_FILE).is_file() {
                    return load_recording(dir);
                }
            }
            let dir = if role_dir.is_dir() {
                &role_dir
            } else {
                &self.dir
            };
            load_images(dir, &self.config)
        };
        let recording = load()
            .and_then(|recording| self.check_mode(recording))
            .map_err(|error| error.at(self.dir.display()).at(self.role))?;
        let source = ReplaySource {
            info: recording.info,
            frames: recording.frames,
            unpaced: self.config.unpaced,
            clock: self.clock.clone(),
            start_ns: None,
            next: 0,
        };
        Ok((source, recording.warnings))
    }

    fn check_mode(&self, recording: Recording) -> Result<Recording> {
        let (info, config) = (&recording.info, &self.config);
        let found = (info.format, info.width, info.height);
        let expected = (config.format, config.width, config.height);
        if found == expected {
            return Ok(recording);
        }
        let mode = |(format, width, height)| format!("{format} {width}×{height}");
        Err(Error::input(format!(
            "the recording is {}, expected {}",
            mode(found),
            mode(expected)
        ))
        .remedy("set format, width and height of the recording in the rig file"))
    }
}

impl CameraOpener for ReplayOpener {
    fn role(&self) -> Role {
        self.role
    }

    fn describe(&self) -> String {
        format!("recording {}", self.dir.display())
    }

    fn open(&mut self) -> Result<Box<dyn FrameSource>> {
        Ok(Box::new(self.load()?.0))
    }
}

enum Payload {
    File(BeneathPath),
    Bytes(FrameBytes),
}

struct RecordedFrame {
    payload: Payload,
    sequence: u32,
    /// Since the first frame, ns.
    offset_ns: u64,
}

struct Recording {
    info: StreamInfo,
    frames: Vec<RecordedFrame>,
    warnings: Vec<String>,
}

fn load_recording(dir: &Path) -> Result<Recording> {
    let root = Root::new(dir);
    let read = |name: &'static str| {
        root.top()
            .join(name)
            .read(FileKind::List)
            .map_err(|error| Error::io(format!("cannot read {name}"), error))
    };
    let stream: StreamRecord = serde_json::from_slice(&read(STREAM_FILE)?)
        .map_err(|error| Error::input(format!("invalid {STREAM_FILE}")).because(error))?;
    if stream.schema != StreamRecord::SCHEMA {
        return Err(Error::input(format!(
            "{STREAM_FILE}: expected schema {}, found {}",
            StreamRecord::SCHEMA,
            stream.schema
        ))
        .remedy("use the version of gripcast that recorded it, or a newer one"));
    }
    let bytes = read(FRAMES_FILE)?;
    let text = String::from_utf8_lossy(&bytes);
    let mut warnings = Vec::new();
    let mut records: Vec<FrameRecord> = Vec::new();
    let lines: Vec<&str> = text.lines().collect();
    for (index, line) in lines.iter().enumerate() {
        match serde_json::from_str(line) {
            Ok(record) => records.push(record),
            Err(error) if index + 1 == lines.len() && !error.is_data() => warnings.push(format!(
                "{FRAMES_FILE}:{}: skipped the incomplete last line: {error}",
                index + 1
            )),
            Err(error) => {
                return Err(Error::input(format!(
                    "{FRAMES_FILE}:{}: invalid frame: `{line}`",
                    index + 1
                ))
                .because(error));
            }
        }
    }
    let Some(first_ns) = records.first().map(|record| record.driver_time_ns) else {
        return Err(Error::input("the recording has no frames"));
    };
    let frames = records.into_iter().map(|record| RecordedFrame {
        payload: Payload::File(root.top().join(&record.file)),
        sequence: record.sequence,
        offset_ns: record.driver_time_ns.saturating_sub(first_ns),
    });
    Ok(Recording {
        info: stream.info(dir),
        frames: frames.collect(),
        warnings,
    })
}

fn load_images(dir: &Path, config: &CameraConfig) -> Result<Recording> {
    let read = || -> io::Result<BTreeSet<PathBuf>> {
        fs::read_dir(dir)?.map(|entry| Ok(entry?.path())).collect()
    };
    let is_foreign = |path: &PathBuf| {
        let name = path.file_name().unwrap_or_default();
        is_system_file(&name.to_string_lossy())
    };
    let mut images = read().map_err(|error| Error::io("cannot read the directory", error))?;
    images.retain(|path| image_kind(path).is_some() && !is_foreign(path));
    if images.is_empty() {
        return Err(Error::input(format!(
            "the directory has neither {STREAM_FILE} nor .jpg, .jpeg or .png images"
        ))
        .remedy("record one with `gripcast rig check --record DIRECTORY`"));
    }
    if config.fps.is_nan() || config.fps <= 0.0 {
        let fps = config.fps;
        return Err(Error::config(format!(
            "the frame rate must be above 0, found {fps}"
        )));
    }
    let mut size = None;
    let mut frames = Vec::with_capacity(images.len());
    for (number, path) in images.into_iter().enumerate() {
        let name = path.file_name().map_or_else(
            || path.display().to_string(),
            |name| name.to_string_lossy().into(),
        );
        let (payload, found) = open_image(&path).map_err(|error| error.at(&name))?;
        let expected = *size.get_or_insert(found);
        if found != expected {
            return Err(Error::input(format!(
                "expected an image of {}×{}, found {}×{}",
                expected.0, expected.1, found.0, found.1
            ))
            .at(name));
        }
        frames.push(RecordedFrame {
            payload,
            sequence: number as u32,
            offset_ns: (number as f64 * 1e9 / config.fps) as u64,
        });
    }
    let (width, height) = size.unwrap_or_default();
    Ok(Recording {
        info: StreamInfo {
            identity: CameraIdentity {
                product: "images".to_owned(),
                port: dir.display().to_string(),
                ..CameraIdentity::default()
            },
            format: PixelFormat::Mjpg,
            width,
            height,
            nominal_fps: config.fps,
            depth_unit_m: None,
        },
        frames,
        warnings: Vec::new(),
    })
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum ImageKind {
    Jpeg,
    Png,
}

fn image_kind(path: &Path) -> Option<ImageKind> {
    match path.extension()?.to_str()?.to_ascii_lowercase().as_str() {
        "jpg" | "jpeg" => Some(ImageKind::Jpeg),
        "png" => Some(ImageKind::Png),
        _ => None,
    }
}

fn open_image(path: &Path) -> Result<(Payload, (u32, u32))> {
    let file = BeneathPath::from_user_path(path);
    let bytes = file
        .read(FileKind::Image)
        .map_err(|error| Error::io("cannot read the image", error))?;
    if image_kind(path) == Some(ImageKind::Jpeg) {
        let header = turbojpeg::read_header(&bytes)
            .map_err(|error| Error::input("invalid JPEG").because(error))?;
        let size = (header.width as u32, header.height as u32);
        return Ok((Payload::File(file), size));
    }
    let image = decode_png_rgb(&bytes)?;
    let (width, height) = image.dimensions();
    let rgb = Image {
        pixels: image.as_raw().as_slice(),
        width: width as usize,
        pitch: 3 * width as usize,
        height: height as usize,
        format: JpegPixels::RGB,
    };
    let jpeg = turbojpeg::compress(rgb, PNG_JPEG_QUALITY, Subsamp::None)
        .map_err(|error| Error::input("cannot encode the image as JPEG").because(error))?;
    Ok((Payload::Bytes(jpeg.to_vec().into()), (width, height)))
}

/// A replayed directory.
pub struct ReplaySource {
    info: StreamInfo,
    frames: Vec<RecordedFrame>,
    unpaced: bool,
    clock: Arc<dyn Clock>,
    start_ns: Option<u64>,
    next: usize,
}

impl FrameSource for ReplaySource {
    fn info(&self) -> &StreamInfo {
        &self.info
    }

    fn next_frame(&mut self, timeout: Duration) -> Result<Frame, CaptureError> {
        let Some(recorded) = self.frames.get(self.next) else {
            return Err(CaptureError::Ended);
        };
        let now_ns = self.clock.now_ns();
        let start_ns = *self.start_ns.get_or_insert(now_ns);
        let due_ns = if self.unpaced {
            now_ns
        } else {
            start_ns + recorded.offset_ns
        };
        if !self.clock.wait_for(due_ns, timeout) {
            return Err(CaptureError::Timeout);
        }
        self.next += 1;

        let sequence = recorded.sequence;
        let data: FrameBytes = match &recorded.payload {
            Payload::Bytes(bytes) => bytes.clone(),
            Payload::File(path) => match path.read(FileKind::Image) {
                Ok(bytes) => bytes.into(),
                Err(error) => {
                    let reason = format!("cannot read {}: {error}", path.display());
                    return Err(CaptureError::Damaged { sequence, reason });
                }
            },
        };
        if let Some(expected) = self
            .info
            .format
            .frame_bytes(self.info.width, self.info.height)
            && data.len() != expected
        {
            let reason = format!("expected {expected} bytes, found {}", data.len());
            return Err(CaptureError::Damaged { sequence, reason });
        }
        Ok(Frame {
            format: self.info.format,
            width: self.info.width,
            height: self.info.height,
            data,
            sequence,
            driver_time_ns: due_ns,
            received_ns: self.clock.now_ns(),
        })
    }

    fn controls(&mut self) -> Result<ControlValues> {
        Ok(ControlValues::new())
    }
}

#[cfg(test)]
#[path = "replay_test.rs"]
mod tests;
