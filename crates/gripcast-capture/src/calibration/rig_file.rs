//! The rig file (`calib/rigs/<id>.toml`).

use std::collections::BTreeMap;
use std::env;
use std::fs;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::camera::{CONTROLS, FORMER_NAMES};
use crate::device::are_twins;
use gripcast_base::error::{Error, Result, nearest_name};
use gripcast_base::files::is_system_file;
use gripcast_imaging::{DepthView, MAX_SIDE, PixelFormat, Role};

/// Version of the rig file format.
const SCHEMA: u32 = 1;
/// Name of the built-in rig.
const VIRTUAL: &str = "virtual";
/// Name of the built-in rig whose gels have markers, and their sensor profile.
const VIRTUAL_MARKERS: &str = "virtual-markers";
const MARKER_PROFILE: &str = "gelsight-mini-markers";
/// Name of the built-in rig with an external camera, and the frame rate of that camera, 1/s.
const VIRTUAL_EXTERNAL: &str = "virtual-external";
const EXTERNAL_FPS: f64 = 10.0;

/// A rig: cameras by role, pedals.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RigFile {
    /// Version of this file format; 1.
    pub schema: u32,
    /// Name of the rig, stored in datasets.
    pub id: String,
    /// Cameras by role; `left` and `right` are required.
    pub cameras: BTreeMap<Role, CameraConfig>,
    /// Printed markers for the annotation of grasps from the external camera.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub boards: Option<BoardsConfig>,
    /// Foot pedals and presenters.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub pedals: Vec<PedalConfig>,
}

/// Board files of a rig. The virtual rig has built-in ones.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BoardsConfig {
    /// Board file of the gripper's tags.
    pub tags: PathBuf,
    /// Folder with the board files of the objects' sheets, `OBJECT.toml`, or one such file.
    pub sheets: PathBuf,
}

/// Source of a camera's frames.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum SourceKind {
    /// A real camera through V4L2.
    #[default]
    V4l2,
    /// A recorded directory.
    Replay,
    /// The built-in virtual rig.
    Virtual,
}

/// One camera of a rig.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraConfig {
    /// Kind of source.
    #[serde(default)]
    pub source: SourceKind,
    /// USB product string, or a prefix of it (`GelSight Mini`).
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub product: String,
    /// USB serial; distinguishes cameras of the same product.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub serial: Option<String>,
    /// USB video-control interface number; on a D435, 0 is depth and 3 colour.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub interface: Option<u8>,
    /// USB port path (`3-2.1`); decides where the serial is missing or not unique.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub port: Option<String>,
    /// Directory of a `replay` source, or the folder of a `virtual` source's clips (default: the
    /// built-in ones).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub path: Option<PathBuf>,
    /// Whether a `replay` source ignores its recorded timing.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub unpaced: bool,
    /// Requested pixel format.
    pub format: PixelFormat,
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// Nominal frame rate, 1/s.
    pub fps: f64,
    /// Named crop profile of a tactile camera.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub crop_profile: Option<String>,
    /// Sensor profile of a tactile camera: a shipped name, or a file; says which gel it has.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sensor_profile: Option<String>,
    /// Force calibration of a tactile camera's sensor, from known weights.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub force_calibration: Option<PathBuf>,
    /// Depth unit of a depth camera, m.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub depth_unit_m: Option<f64>,
    /// Intrinsics file of a colour camera; default for a D435: its factory intrinsics.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub intrinsics: Option<PathBuf>,
    /// Controls to set, by V4L2 name in snake case.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub controls: BTreeMap<String, i64>,
}

/// A HID pedal or presenter.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PedalConfig {
    /// USB vendor id.
    pub vendor: u16,
    /// USB product id.
    pub product: u16,
    /// Commands (`trigger`, `stable`, `slip`, `undo`, …) by key name (`a`, `b`, `page_down`).
    pub keys: BTreeMap<String, String>,
    /// Debounce time, ms: an edge within this time after the last one is no press. Keyboards repeat
    /// held keys every 25–100 ms.
    #[serde(default = "PedalConfig::default_debounce_ms")]
    pub debounce_ms: u64,
}

impl PedalConfig {
    fn default_debounce_ms() -> u64 {
        150
    }
}

impl CameraConfig {
    /// A camera with a source and a mode.
    #[must_use]
    pub fn new(source: SourceKind, format: PixelFormat, width: u32, height: u32, fps: f64) -> Self {
        Self {
            source,
            product: String::new(),
            serial: None,
            interface: None,
            port: None,
            path: None,
            unpaced: false,
            format,
            width,
            height,
            fps,
            crop_profile: None,
            sensor_profile: None,
            force_calibration: None,
            depth_unit_m: None,
            intrinsics: None,
            controls: BTreeMap::new(),
        }
    }
}

impl RigFile {
    /// Camera whose view the depth images show ([`DepthView::of_camera`]); none without a depth
    /// camera or for one of an unknown product.
    #[must_use]
    pub fn depth_view(&self) -> Option<DepthView> {
        let camera = self.cameras.get(&Role::Depth)?;
        let is_virtual = matches!(camera.source, SourceKind::Virtual);
        DepthView::of_camera(is_virtual, &camera.product)
    }

    /// The built-in rig: two simulated tactile sensors, colour and depth.
    #[must_use]
    pub fn virtual_rig() -> Self {
        let camera = |format, fps| CameraConfig::new(SourceKind::Virtual, format, 640, 480, fps);
        let tactile = CameraConfig {
            crop_profile: Some("gsmini-seventh-v1".to_owned()),
            ..camera(PixelFormat::Mjpg, 25.0)
        };
        let depth = CameraConfig {
            depth_unit_m: Some(0.001),
            ..camera(PixelFormat::Z16, 30.0)
        };
        Self {
            schema: SCHEMA,
            id: VIRTUAL.to_owned(),
            cameras: BTreeMap::from([
                (Role::Left, tactile.clone()),
                (Role::Right, tactile),
                (Role::Rgb, camera(PixelFormat::Yuyv, 30.0)),
                (Role::Depth, depth),
            ]),
            boards: None,
            pedals: Vec::new(),
        }
    }

    /// [`Self::virtual_rig`] with an external camera for the object's sheet and the gripper's tags.
    #[must_use]
    pub fn virtual_rig_with_external() -> Self {
        let external = CameraConfig::new(
            SourceKind::Virtual,
            PixelFormat::Mjpg,
            1280,
            720,
            EXTERNAL_FPS,
        );
        let mut rig = Self::virtual_rig();
        rig.id = VIRTUAL_EXTERNAL.to_owned();
        rig.cameras.insert(Role::External, external);
        rig
    }

    /// [`Self::virtual_rig`] with marker gels.
    #[must_use]
    pub fn virtual_rig_with_markers() -> Self {
        let mut rig = Self::virtual_rig();
        rig.id = VIRTUAL_MARKERS.to_owned();
        for (role, camera) in &mut rig.cameras {
            if role.is_tactile() {
                camera.sensor_profile = Some(MARKER_PROFILE.to_owned());
            }
        }
        rig
    }

    /// Finds a rig by name or path: the built-in `virtual`, `virtual-markers` and `virtual-external`, then
    /// `calib/rigs/NAME.toml` in the working directory, then `gripcast/rigs/NAME.toml` in the
    /// user's configuration directory. Names with a slash or ending in `.toml` are paths.
    ///
    /// # Errors
    /// `NotFound` with the available rigs; `Config` for an invalid file.
    pub fn find(name: &str) -> Result<Self> {
        let configuration = env::var_os("XDG_CONFIG_HOME")
            .map(PathBuf::from)
            .filter(|path| path.is_absolute())
            .or_else(|| env::home_dir().map(|home| home.join(".config")));
        let mut directories = vec![PathBuf::from("calib/rigs")];
        directories.extend(configuration.map(|path| path.join("gripcast/rigs")));
        Self::find_in(name, &directories)
    }

    /// [`Self::find`] in the given directories.
    ///
    /// # Errors
    /// As [`Self::find`].
    pub fn find_in(name: &str, directories: &[PathBuf]) -> Result<Self> {
        match name {
            VIRTUAL => return Ok(Self::virtual_rig()),
            VIRTUAL_MARKERS => return Ok(Self::virtual_rig_with_markers()),
            VIRTUAL_EXTERNAL => return Ok(Self::virtual_rig_with_external()),
            _ => {}
        }
        if name.contains('/') || name.ends_with(".toml") {
            return Self::load(Path::new(name));
        }
        let file = format!("{name}.toml");
        for directory in directories {
            let path = directory.join(&file);
            if path.exists() {
                return Self::load(&path);
            }
        }
        let mut known = [VIRTUAL, VIRTUAL_MARKERS, VIRTUAL_EXTERNAL]
            .map(str::to_owned)
            .to_vec();
        for directory in directories {
            let files = fs::read_dir(directory).into_iter().flatten().flatten();
            let mut names: Vec<String> = files
                .filter_map(|entry| {
                    let name = entry.file_name().into_string().ok()?;
                    let is_rig = !is_system_file(&name);
                    Some(name.strip_suffix(".toml").filter(|_| is_rig)?.to_owned())
                })
                .collect();
            names.sort();
            known.extend(names);
        }
        known.dedup();
        let hint = nearest_name(name, known.iter().map(String::as_str))
            .map(|near| format!("; did you mean `{near}`?"))
            .unwrap_or_default();
        let paths: Vec<String> = directories
            .iter()
            .map(|directory| directory.join(&file).display().to_string())
            .collect();
        Err(Error::not_found(format!(
            "unknown rig `{name}` (not found: {}){hint}",
            paths.join(", ")
        ))
        .remedy(format!(
            "use one of {}, or the path of a rig file; `gripcast rig init` writes one",
            known.join(", ")
        )))
    }

    /// Reads a rig file. Its relative paths (recordings, clips, intrinsics, sensor profiles, boards) are relative to
    /// its directory.
    ///
    /// # Errors
    /// For an unreadable file, or `Config` with the line.
    pub fn load(path: &Path) -> Result<Self> {
        let text = fs::read_to_string(path)
            .map_err(|e| Error::io("cannot read the rig file", e).at(path.display()))?;
        let mut rig = Self::parse(&text).map_err(|error| error.at(path.display()))?;
        let directory = path.parent().unwrap_or(Path::new(""));
        // `join` leaves absolute paths unchanged.
        let resolve = |file: &mut PathBuf| *file = directory.join(&*file);
        for camera in rig.cameras.values_mut() {
            let files = camera.path.iter_mut().chain(&mut camera.intrinsics);
            let files = files.chain(&mut camera.force_calibration);
            files.for_each(resolve);
            if let Some(profile) = &mut camera.sensor_profile
                && (profile.contains('/') || profile.ends_with(".toml"))
            {
                *profile = directory.join(&*profile).to_string_lossy().into_owned();
            }
        }
        if let Some(boards) = &mut rig.boards {
            [&mut boards.tags, &mut boards.sheets]
                .into_iter()
                .for_each(resolve);
        }
        Ok(rig)
    }

    /// Parses and validates the text of a rig file.
    ///
    /// # Errors
    /// `Config` with the line.
    pub fn parse(text: &str) -> Result<Self> {
        // The version first: newer files may have unknown keys.
        #[derive(Deserialize)]
        struct Version {
            schema: Option<u32>,
        }
        if let Ok(Version { schema }) = toml::from_str(text) {
            check_schema(schema)?;
        }
        let rig: Self = toml::from_str(text).map_err(|error| toml_error(text, &error))?;
        rig.validate()?;
        Ok(rig)
    }

    /// Validates roles, camera identities, modes and controls.
    ///
    /// # Errors
    /// `Config` with camera and key.
    pub fn validate(&self) -> Result<()> {
        check_schema(Some(self.schema))?;
        if self.id.is_empty() || self.id.contains(['/', '\\']) || self.id.starts_with('.') {
            return Err(Error::config(format!(
                "`id` must be a plain name such as `bench-1`, found `{}`",
                self.id
            )));
        }
        for role in [Role::Left, Role::Right] {
            if !self.cameras.contains_key(&role) {
                return Err(
                    Error::config(format!("the camera `{role}` is missing")).remedy(format!(
                        "add a section [cameras.{role}]; both tactile sensors are required"
                    )),
                );
            }
        }
        for (role, camera) in &self.cameras {
            camera
                .validate(*role)
                .map_err(|error| error.at(format_args!("[cameras.{role}]")))?;
        }
        if self.boards.is_some() && !self.cameras.contains_key(&Role::External) {
            return Err(Error::config("[boards] requires an external camera")
                .remedy("add a section [cameras.external]"));
        }
        self.validate_distinct()
    }

    /// Roles must have different physical streams.
    fn validate_distinct(&self) -> Result<()> {
        let real: Vec<(&Role, &CameraConfig)> = self
            .cameras
            .iter()
            .filter(|(_, camera)| camera.source == SourceKind::V4l2)
            .collect();
        for (i, (role, camera)) in real.iter().enumerate() {
            for (other_role, other) in &real[..i] {
                let are_twins = are_twins(camera, other);
                let is_named_equally = camera.product == other.product
                    && camera.serial == other.serial
                    && camera.interface == other.interface
                    && camera.format == other.format;
                let has_ports = camera.port.is_some() && other.port.is_some();
                if camera.port == other.port && (is_named_equally || are_twins && has_ports) {
                    return Err(Error::config(format!(
                        "[cameras.{other_role}] and [cameras.{role}] are the same camera"
                    ))
                    .remedy(
                        "give each its own `serial`, or its `port` where the serials are equal \
                         (`gripcast rig list` lists both, `gripcast rig init` writes them)",
                    ));
                }
                if are_twins && !has_ports {
                    let lacking = if camera.port.is_none() {
                        role
                    } else {
                        other_role
                    };
                    return Err(Error::config(format!(
                        "[cameras.{other_role}] and [cameras.{role}] have the same serial number, \
                         and [cameras.{lacking}] names no `port`"
                    ))
                    .remedy(
                        "give both their `port` (`gripcast rig list` lists the ports, `gripcast \
                         rig init` writes them)",
                    ));
                }
            }
        }
        Ok(())
    }
}

impl CameraConfig {
    fn validate(&self, role: Role) -> Result<()> {
        match self.source {
            SourceKind::V4l2 if self.product.is_empty() => {
                return Err(Error::config("`product` is missing")
                    .remedy("give a prefix of the product name listed by `gripcast rig list`"));
            }
            SourceKind::Replay if self.path.is_none() => {
                return Err(Error::config("`path` is missing")
                    .remedy("give the directory of the recording"));
            }
            SourceKind::V4l2 if self.path.is_some() => {
                return Err(Error::config(
                    "`path` is only for source = \"replay\" and \"virtual\"",
                ));
            }
            _ => {}
        }
        let side = 1..=MAX_SIDE;
        if !side.contains(&self.width) || !side.contains(&self.height) {
            return Err(Error::config(format!(
                "the image size must be 1 to {MAX_SIDE} pixels a side, found {}×{}",
                self.width, self.height
            )));
        }
        if !(self.fps.is_finite() && self.fps > 0.0 && self.fps <= 1000.0) {
            return Err(Error::config(format!(
                "`fps` must be above 0 and at most 1000, found {}",
                self.fps
            )));
        }
        if !role.is_tactile() && self.sensor_profile.is_some() {
            return Err(Error::config(
                "`sensor_profile` is only for the roles left and right",
            ));
        }
        if !role.is_tactile() && self.force_calibration.is_some() {
            return Err(Error::config(
                "`force_calibration` is only for the roles left and right",
            ));
        }
        if role.is_tactile() && self.crop_profile.is_none() {
            return Err(Error::config("`crop_profile` is missing")
                .remedy("add it, for instance \"gsmini-seventh-v1\""));
        }
        let fits = match role {
            Role::Left | Role::Right | Role::External | Role::Rgb => {
                self.format != PixelFormat::Z16
            }
            Role::Depth => self.format == PixelFormat::Z16,
        };
        if !fits {
            return Err(Error::config(format!(
                "role {role} does not support format {}",
                self.format
            )));
        }
        if role == Role::Depth {
            match self.depth_unit_m {
                None => {
                    return Err(Error::config("`depth_unit_m` is missing")
                        .remedy("add it; for a D435: depth_unit_m = 0.001"));
                }
                Some(unit) if !(unit.is_finite() && unit > 0.0 && unit <= 1.0) => {
                    return Err(Error::config(format!(
                        "`depth_unit_m` must be above 0 and at most 1, found {unit}"
                    )));
                }
                Some(_) => {}
            }
        }
        for name in self.controls.keys() {
            check_control(name)?;
        }
        Ok(())
    }
}

fn check_control(name: &str) -> Result<()> {
    let known = || CONTROLS.iter().map(|(known, _)| *known);
    if known().any(|control| control == name) {
        return Ok(());
    }
    let former = FORMER_NAMES.iter().find(|(former, _)| *former == name);
    let near = former
        .map(|(_, present)| *present)
        .or_else(|| nearest_name(name, known()));
    let remedy = match near {
        Some(near) => format!("did you mean `{near}`?"),
        None => format!("use one of {}", known().collect::<Vec<_>>().join(", ")),
    };
    Err(Error::config(format!("unknown control `{name}`")).remedy(remedy))
}

fn check_schema(found: Option<u32>) -> Result<()> {
    match found {
        Some(SCHEMA) => Ok(()),
        Some(newer) if newer > SCHEMA => Err(Error::config(format!(
            "expected rig file schema {SCHEMA}, found {newer}"
        ))
        .remedy("update gripcast, or rewrite the file with `gripcast rig init`")),
        other => Err(Error::config(match other {
            Some(old) => format!("expected `schema` {SCHEMA}, found {old}"),
            None => "`schema` is missing".to_owned(),
        })
        .remedy(format!("add `schema = {SCHEMA}` at the top"))),
    }
}

/// Adds the line and the nearest known name to a TOML error.
fn toml_error(text: &str, error: &toml::de::Error) -> Error {
    let message = error.message().trim();
    let place = match error.span() {
        Some(span) => {
            let before = &text.as_bytes()[..span.start.min(text.len())];
            let line = 1 + before.iter().filter(|&&b| b == b'\n').count();
            format!("line {line}")
        }
        None => "rig file".to_owned(),
    };
    let unknown = message.starts_with("unknown ");
    let mut quoted = message.split('`').skip(1).step_by(2);
    let remedy = match (unknown, quoted.next()) {
        (true, Some(name)) => {
            nearest_name(name, quoted).map(|near| format!("did you mean `{near}`?"))
        }
        _ => None,
    };
    let what = match message.split_once(", expected") {
        Some((first, _)) if remedy.is_some() => first.to_owned(),
        _ => message.to_owned(),
    };
    let error = Error::config(what).at(place);
    match remedy {
        Some(remedy) => error.remedy(remedy),
        None => error,
    }
}

#[cfg(test)]
#[path = "rig_file_test.rs"]
mod tests;
