//! Plays a recorded directory as if it were a camera.
//!
//! The directory of a rig file is either one that the recorder wrote (itself or its `<role>`
//! folder holds `stream.json`), or a plain folder of pictures of one size. Plain pictures are
//! played in the order of their names at the configured rate: `.jpg` and `.jpeg` as they are,
//! `.png` encoded once, when the folder is opened, as JPEG of quality 98.

use std::collections::BTreeSet;
use std::fs;
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
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_base::files::{BeneathPath, FileKind, Root};
use gripcast_imaging::{Frame, FrameBytes, PixelFormat, Role};

const PNG_JPEG_QUALITY: i32 = 98;

/// How a recording is played.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ReplayPace {
    /// As fast as it is read, instead of with the recording's own timing.
    pub unpaced: bool,
    /// From the beginning again at the end, with sequence numbers that go on.
    pub looped: bool,
}

/// Opens a recorded directory.
pub struct ReplayOpener {
    role: Role,
    dir: PathBuf,
    config: CameraConfig,
    pace: ReplayPace,
    clock: Arc<dyn Clock>,
}

impl ReplayOpener {
    /// A replay of `config.path` with the pace of `config`, not looped.
    ///
    /// # Errors
    /// [`ErrorKind::Config`] when the configuration names no directory.
    pub fn new(role: Role, config: &CameraConfig, clock: Arc<dyn Clock>) -> Result<Self> {
        let dir = config.path.clone().ok_or_else(|| {
            Error::new(ErrorKind::Config, "a replay camera needs a directory")
                .at(role)
                .remedy("add `path = \"DIRECTORY\"` to the camera in the rig file")
        })?;
        Ok(Self {
            role,
            dir,
            config: config.clone(),
            pace: ReplayPace {
                unpaced: config.unpaced,
                looped: false,
            },
            clock,
        })
    }

    /// The same replay with another pace.
    #[must_use]
    pub fn with_pace(mut self, pace: ReplayPace) -> Self {
        self.pace = pace;
        self
    }

    /// Reads the directory's index; returns what had to be skipped, for people.
    ///
    /// # Errors
    /// [`ErrorKind::NotFound`] when the directory is missing, [`ErrorKind::Input`] when it holds
    /// nothing that can be played or another format or size than the rig file asks for.
    pub fn load(&self) -> Result<(ReplaySource, Vec<String>)> {
        let load = || {
            if !self.dir.is_dir() {
                return Err(
                    Error::new(ErrorKind::NotFound, "there is no such directory")
                        .remedy("correct the camera's `path` in the rig file"),
                );
            }
            let of_role = self.dir.join(self.role.name());
            for dir in [&of_role, &self.dir] {
                if dir.join(STREAM_FILE).is_file() {
                    return load_recording(dir);
                }
            }
            let dir = if of_role.is_dir() {
                &of_role
            } else {
                &self.dir
            };
            load_pictures(dir, &self.config)
        };
        let recording = load()
            .and_then(|recording| self.checked(recording))
            .map_err(|error| error.at(self.dir.display()).at(self.role))?;
        let source = ReplaySource {
            info: recording.info,
            frames: recording.frames,
            pace: self.pace,
            clock: self.clock.clone(),
            start_ns: None,
            next: 0,
        };
        Ok((source, recording.warnings))
    }

    fn checked(&self, recording: Recording) -> Result<Recording> {
        let (info, config) = (&recording.info, &self.config);
        let found = (info.format, info.width, info.height);
        let wanted = (config.format, config.width, config.height);
        if found == wanted {
            return Ok(recording);
        }
        let mode = |(format, width, height)| format!("{format} {width}×{height}");
        Err(Error::new(
            ErrorKind::Input,
            format!(
                "the recording is {}, expected {}",
                mode(found),
                mode(wanted)
            ),
        )
        .remedy("set format, width and height of the camera in the rig file to the recording's"))
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

struct Recorded {
    payload: Payload,
    sequence: u32,
    /// Since the first frame, ns.
    offset_ns: u64,
}

struct Recording {
    info: StreamInfo,
    frames: Vec<Recorded>,
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
    let stream: StreamRecord = serde_json::from_slice(&read(STREAM_FILE)?).map_err(|error| {
        Error::new(
            ErrorKind::Input,
            format!("{STREAM_FILE} is no stream description"),
        )
        .because(error)
    })?;
    if stream.schema != StreamRecord::SCHEMA {
        return Err(Error::new(
            ErrorKind::Input,
            format!(
                "{STREAM_FILE} has schema {}, expected {}",
                stream.schema,
                StreamRecord::SCHEMA
            ),
        )
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
                "{FRAMES_FILE}:{}: the last line is torn and was skipped: {error}",
                index + 1
            )),
            Err(error) => {
                return Err(Error::new(
                    ErrorKind::Input,
                    format!("{FRAMES_FILE}:{}: no frame: `{line}`", index + 1),
                )
                .because(error));
            }
        }
    }
    let Some(first_ns) = records.first().map(|record| record.driver_time_ns) else {
        return Err(Error::new(ErrorKind::Input, "the recording has no frames"));
    };
    let mut frames = Vec::with_capacity(records.len());
    for record in records {
        frames.push(Recorded {
            payload: Payload::File(root.top().join(&record.file)),
            sequence: record.sequence,
            offset_ns: record.driver_time_ns.saturating_sub(first_ns),
        });
    }
    Ok(Recording {
        info: stream.info(dir),
        frames,
        warnings,
    })
}

fn load_pictures(dir: &Path, config: &CameraConfig) -> Result<Recording> {
    let entries =
        fs::read_dir(dir).map_err(|error| Error::io("cannot read the directory", error))?;
    let mut pictures = BTreeSet::new();
    for entry in entries {
        let path = entry
            .map_err(|error| Error::io("cannot read the directory", error))?
            .path();
        if picture_kind(&path).is_some() {
            pictures.insert(path);
        }
    }
    if pictures.is_empty() {
        return Err(Error::new(
            ErrorKind::Input,
            format!("there is neither {STREAM_FILE} nor a .jpg, .jpeg or .png picture"),
        )
        .remedy("record one with `gripcast rig check --record DIRECTORY`"));
    }
    if config.fps.is_nan() || config.fps <= 0.0 {
        let fps = config.fps;
        return Err(Error::new(
            ErrorKind::Config,
            format!("frame rate {fps}, expected above 0"),
        ));
    }
    let mut size = None;
    let mut frames = Vec::with_capacity(pictures.len());
    for (number, path) in pictures.into_iter().enumerate() {
        let name = path.file_name().map_or_else(
            || path.display().to_string(),
            |name| name.to_string_lossy().into(),
        );
        let (payload, found) = open_picture(&path).map_err(|error| error.at(&name))?;
        let expected = *size.get_or_insert(found);
        if found != expected {
            return Err(Error::new(
                ErrorKind::Input,
                format!(
                    "the picture is {}×{}, those before are {}×{}",
                    found.0, found.1, expected.0, expected.1
                ),
            )
            .at(name));
        }
        frames.push(Recorded {
            payload,
            sequence: number as u32,
            offset_ns: (number as f64 * 1e9 / config.fps) as u64,
        });
    }
    let (width, height) = size.unwrap_or_default();
    Ok(Recording {
        info: StreamInfo {
            identity: CameraIdentity {
                product: "pictures".to_owned(),
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
enum PictureKind {
    Jpeg,
    Png,
}

fn picture_kind(path: &Path) -> Option<PictureKind> {
    match path.extension()?.to_str()?.to_ascii_lowercase().as_str() {
        "jpg" | "jpeg" => Some(PictureKind::Jpeg),
        "png" => Some(PictureKind::Png),
        _ => None,
    }
}

fn open_picture(path: &Path) -> Result<(Payload, (u32, u32))> {
    let place = BeneathPath::given(path);
    let bytes = place
        .read(FileKind::Image)
        .map_err(|error| Error::io("cannot read the picture", error))?;
    if picture_kind(path) == Some(PictureKind::Jpeg) {
        let header = turbojpeg::read_header(&bytes)
            .map_err(|error| Error::new(ErrorKind::Input, "this is no JPEG").because(error))?;
        let size = (header.width as u32, header.height as u32);
        return Ok((Payload::File(place), size));
    }
    let picture = image::load_from_memory_with_format(&bytes, image::ImageFormat::Png)
        .map_err(|error| Error::new(ErrorKind::Input, "this is no PNG").because(error))?
        .into_rgb8();
    let (width, height) = picture.dimensions();
    let rgb = Image {
        pixels: picture.as_raw().as_slice(),
        width: width as usize,
        pitch: 3 * width as usize,
        height: height as usize,
        format: JpegPixels::RGB,
    };
    let jpeg = turbojpeg::compress(rgb, PNG_JPEG_QUALITY, Subsamp::None).map_err(|error| {
        Error::new(ErrorKind::Input, "cannot encode the picture as JPEG").because(error)
    })?;
    Ok((Payload::Bytes(jpeg.to_vec().into()), (width, height)))
}

/// An open recording.
pub struct ReplaySource {
    info: StreamInfo,
    frames: Vec<Recorded>,
    pace: ReplayPace,
    clock: Arc<dyn Clock>,
    start_ns: Option<u64>,
    next: usize,
}

impl ReplaySource {
    /// Number of frames of one pass.
    pub fn frame_count(&self) -> usize {
        self.frames.len()
    }

    /// Length of one pass, ns: the last frame is shown as long as a nominal frame.
    fn length_ns(&self) -> u64 {
        let last_ns = self.frames.last().map_or(0, |frame| frame.offset_ns);
        let nominal_ns = if self.info.nominal_fps > 0.0 {
            (1e9 / self.info.nominal_fps) as u64
        } else {
            0
        };
        last_ns + nominal_ns
    }
}

impl FrameSource for ReplaySource {
    fn info(&self) -> &StreamInfo {
        &self.info
    }

    fn next_frame(&mut self, timeout: Duration) -> Result<Frame, CaptureError> {
        let count = self.frames.len();
        let (pass, at) = (self.next / count.max(1), self.next % count.max(1));
        let Some(recorded) = self.frames.get(at) else {
            return Err(CaptureError::Ended);
        };
        if pass > 0 && !self.pace.looped {
            return Err(CaptureError::Ended);
        }
        let now_ns = self.clock.now_ns();
        let start_ns = *self.start_ns.get_or_insert(now_ns);
        let due_ns = if self.pace.unpaced {
            now_ns
        } else {
            start_ns + pass as u64 * self.length_ns() + recorded.offset_ns
        };
        let timeout_ns = u64::try_from(timeout.as_nanos()).unwrap_or(u64::MAX);
        let patience_ns = now_ns.saturating_add(timeout_ns);
        if due_ns > patience_ns {
            self.clock.sleep_until(patience_ns);
            return Err(CaptureError::Timeout);
        }
        self.clock.sleep_until(due_ns);
        self.next += 1;

        let first = self.frames.first().map_or(0, |frame| frame.sequence);
        let last = self.frames.last().map_or(0, |frame| frame.sequence);
        let pass_length = last.wrapping_sub(first).wrapping_add(1);
        let sequence = recorded
            .sequence
            .wrapping_add((pass as u32).wrapping_mul(pass_length));
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
            let reason = format!("{expected} bytes expected, the file has {}", data.len());
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
mod tests {
    use std::collections::BTreeMap;
    use std::io::Write;

    use super::*;
    use crate::calibration::SourceKind;
    use crate::camera::{ManualClock, Recorder};

    const MS: u64 = 1_000_000;
    const TIMEOUT: Duration = Duration::from_millis(100);

    fn config(dir: &Path, format: PixelFormat, width: u32, height: u32) -> CameraConfig {
        CameraConfig {
            source: SourceKind::Replay,
            product: String::new(),
            serial: None,
            interface: None,
            port: None,
            path: Some(dir.to_owned()),
            unpaced: false,
            format,
            width,
            height,
            fps: 25.0,
            crop_profile: None,
            depth_unit_m: None,
            intrinsics: None,
            controls: BTreeMap::new(),
        }
    }

    fn opener(dir: &Path, format: PixelFormat) -> (ReplayOpener, Arc<ManualClock>) {
        let clock = Arc::new(ManualClock::at(1_000 * MS));
        let config = config(dir, format, 2, 1);
        let opener = ReplayOpener::new(Role::Left, &config, clock.clone()).unwrap();
        (opener, clock)
    }

    /// Three GREY frames at 0, 40 and 95 ms with sequences 7, 8 and 10.
    fn record(dir: &Path) {
        let info = StreamInfo {
            identity: CameraIdentity {
                product: "GelSight Mini".to_owned(),
                serial: "2BNN4ZE7".to_owned(),
                ..CameraIdentity::default()
            },
            format: PixelFormat::Grey,
            width: 2,
            height: 1,
            nominal_fps: 25.0,
            depth_unit_m: None,
        };
        let mut recorder = Recorder::create(dir, Role::Left, &info).unwrap();
        for (sequence, at_ms) in [(7, 500), (8, 540), (10, 595)] {
            recorder
                .write(&Frame {
                    format: PixelFormat::Grey,
                    width: 2,
                    height: 1,
                    data: vec![sequence as u8, 1].into(),
                    sequence,
                    driver_time_ns: at_ms * MS,
                    received_ns: 0,
                })
                .unwrap();
        }
        recorder.finish().unwrap();
    }

    fn read_all(source: &mut ReplaySource) -> Vec<(u32, u64, u8)> {
        let mut frames = Vec::new();
        while let Ok(frame) = source.next_frame(TIMEOUT) {
            frames.push((frame.sequence, frame.driver_time_ns / MS, frame.data[0]));
        }
        frames
    }

    #[test]
    fn a_recording_comes_back_with_its_timing_and_ends() {
        let dir = tempfile::tempdir().unwrap();
        record(dir.path());
        let (opener, _) = opener(dir.path(), PixelFormat::Grey);
        let (mut source, warnings) = opener.load().unwrap();
        assert!(warnings.is_empty());
        assert_eq!(source.info().identity.serial, "2BNN4ZE7");
        assert_eq!(
            read_all(&mut source),
            [(7, 1000, 7), (8, 1040, 8), (10, 1095, 10)]
        );
        let end = source.next_frame(TIMEOUT);
        assert!(matches!(end, Err(CaptureError::Ended)));
    }

    #[test]
    fn an_unpaced_recording_does_not_wait() {
        let dir = tempfile::tempdir().unwrap();
        record(dir.path());
        let (opener, clock) = opener(dir.path(), PixelFormat::Grey);
        let pace = ReplayPace {
            unpaced: true,
            looped: false,
        };
        let (mut source, _) = opener.with_pace(pace).load().unwrap();
        assert_eq!(read_all(&mut source).len(), 3);
        assert_eq!(clock.now_ns(), 1_000 * MS);
    }

    #[test]
    fn a_loop_goes_on_counting_without_a_gap() {
        let dir = tempfile::tempdir().unwrap();
        record(dir.path());
        let (opener, _) = opener(dir.path(), PixelFormat::Grey);
        let pace = ReplayPace {
            unpaced: false,
            looped: true,
        };
        let (mut source, _) = opener.with_pace(pace).load().unwrap();
        let frames: Vec<_> = (0..5)
            .map(|_| source.next_frame(TIMEOUT).unwrap())
            .map(|frame| (frame.sequence, frame.driver_time_ns / MS))
            .collect();
        let expected = [(7, 1000), (8, 1040), (10, 1095), (11, 1135), (12, 1175)];
        assert_eq!(frames, expected);
    }

    #[test]
    fn a_torn_last_line_is_skipped_and_told() {
        let dir = tempfile::tempdir().unwrap();
        record(dir.path());
        let index = dir.path().join("left").join(FRAMES_FILE);
        let mut file = fs::OpenOptions::new().append(true).open(&index).unwrap();
        file.write_all(b"{\"file\":\"0000").unwrap();
        let (opener, _) = opener(dir.path(), PixelFormat::Grey);
        let (source, warnings) = opener.load().unwrap();
        assert_eq!(source.frame_count(), 3);
        assert!(warnings[0].starts_with("frames.jsonl:4: the last line is torn"));

        let text = fs::read_to_string(&index).unwrap();
        fs::write(&index, format!("rubbish\n{text}")).unwrap();
        let error = opener.load().err().unwrap();
        assert!(
            error
                .to_string()
                .contains("frames.jsonl:1: no frame: `rubbish`")
        );
    }

    #[test]
    fn short_and_missing_payloads_are_damaged_frames() {
        let dir = tempfile::tempdir().unwrap();
        record(dir.path());
        fs::write(dir.path().join("left/000001.grey"), [1]).unwrap();
        fs::remove_file(dir.path().join("left/000002.grey")).unwrap();
        let (opener, _) = opener(dir.path(), PixelFormat::Grey);
        let (mut source, _) = opener.load().unwrap();
        assert!(source.next_frame(TIMEOUT).is_ok());
        for wanted in [8, 10] {
            match source.next_frame(TIMEOUT) {
                Err(CaptureError::Damaged { sequence, .. }) => assert_eq!(sequence, wanted),
                other => panic!("expected damage, got {other:?}"),
            }
        }
    }

    #[test]
    fn wrong_directories_are_explained() {
        let dir = tempfile::tempdir().unwrap();
        let fail = |dir: &Path, format| opener(dir, format).0.load().err().unwrap();
        let missing = fail(&dir.path().join("absent"), PixelFormat::Mjpg);
        assert_eq!(missing.kind(), ErrorKind::NotFound);
        let empty = fail(dir.path(), PixelFormat::Mjpg);
        assert_eq!(empty.kind(), ErrorKind::Input);
        assert!(
            empty.to_string().contains("neither stream.json nor"),
            "{empty}"
        );
        record(dir.path());
        let other = fail(dir.path(), PixelFormat::Yuyv);
        assert!(
            other
                .to_string()
                .contains("the recording is GREY 2×1, expected YUYV 2×1"),
            "{other}"
        );
        let index = dir.path().join("left").join(FRAMES_FILE);
        let outside = r#"{"file":"../../passwd","sequence":0,"driver_time_ns":0}"#;
        fs::write(index, outside).unwrap();
        let escape = fail(dir.path(), PixelFormat::Grey);
        assert!(escape.to_string().contains("invalid file name"), "{escape}");
    }

    #[test]
    fn plain_pictures_play_in_the_order_of_their_names() {
        let dir = tempfile::tempdir().unwrap();
        for (name, level) in [("b.png", 200), ("a.png", 40)] {
            image::RgbImage::from_pixel(16, 8, image::Rgb([level; 3]))
                .save(dir.path().join(name))
                .unwrap();
        }
        fs::write(dir.path().join("notes.txt"), "not a picture").unwrap();
        let clock = Arc::new(ManualClock::default());
        let config = config(dir.path(), PixelFormat::Mjpg, 16, 8);
        let opener = ReplayOpener::new(Role::Left, &config, clock.clone()).unwrap();
        let (mut source, _) = opener.load().unwrap();
        let levels: Vec<_> = (0..2)
            .map(|_| source.next_frame(TIMEOUT).unwrap())
            .map(|frame| {
                let picture =
                    turbojpeg::decompress(&frame.data, turbojpeg::PixelFormat::RGB).unwrap();
                (frame.driver_time_ns / MS, picture.pixels[0])
            })
            .collect();
        assert_eq!(levels, [(0, 40), (40, 200)]);

        image::RgbImage::new(16, 9)
            .save(dir.path().join("c.png"))
            .unwrap();
        let error = opener.load().err().unwrap();
        assert!(
            error.to_string().contains("c.png: the picture is 16×9"),
            "{error}"
        );
        fs::write(dir.path().join("0.jpg"), "no").unwrap();
        let error = opener.load().err().unwrap();
        assert!(
            error.to_string().contains("0.jpg: this is no JPEG"),
            "{error}"
        );
    }
}
