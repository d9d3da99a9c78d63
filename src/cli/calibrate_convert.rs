//! `gripcast calibrate convert` and `gripcast calibrate show`: intrinsics files.

use std::path::PathBuf;

use glam::DVec2;
use serde::Serialize;

use super::flags::size;
use super::{Context, print, print_report};
use gripcast_base::error::{Error, Result};
use gripcast_base::files::save;
use gripcast_imaging::{DistortionModel, Intrinsics};
use gripcast_pose::camera::undistort;
use gripcast_pose::{CameraFile, CameraReadOptions, to_opencv, to_ros};

#[derive(Debug, clap::Args)]
struct Source {
    /// Intrinsics file of gripcast (TOML), ROS (camera_info), OpenCV (YAML) or Kalibr
    /// (camchain.yaml)
    #[arg(value_name = "FILE")]
    file: PathBuf,
    /// Image size, px, for files without it
    #[arg(long, value_name = "WxH", value_parser = |text: &str| size(text, 1..=65_535))]
    size: Option<[u32; 2]>,
    /// Camera to choose from a camchain; camera name in a camera_info [default: external]
    #[arg(long, value_name = "NAME")]
    camera_name: Option<String>,
}

/// Arguments of `convert`.
#[derive(Debug, clap::Args)]
pub(super) struct ConvertArgs {
    #[command(flatten)]
    source: Source,
    /// Output format
    #[arg(long, value_enum, value_name = "FORMAT")]
    to: Target,
    /// Output file
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Target {
    /// gripcast TOML
    Toml,
    /// ROS camera_info YAML
    Ros,
    /// OpenCV FileStorage YAML
    Opencv,
}

/// Arguments of `show`.
#[derive(Debug, clap::Args)]
pub(super) struct ShowArgs {
    #[command(flatten)]
    source: Source,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

impl Source {
    fn read(&self) -> Result<CameraFile> {
        let choice = CameraReadOptions {
            size: self.size,
            camera: self.camera_name.as_deref(),
        };
        CameraFile::load(&self.file, choice)
    }
}

/// Runs `convert`.
pub(super) fn convert(context: &Context, args: &ConvertArgs) -> Result<()> {
    let read = args.source.read()?;
    let text = match args.to {
        Target::Toml => toml::to_string(&read.intrinsics)
            .map_err(|e| Error::internal("cannot write intrinsics as TOML").because(e))?,
        Target::Ros => {
            let chosen = args.source.camera_name.as_deref();
            let name = chosen.or(read.camera_name.as_deref()).unwrap_or("external");
            to_ros(&read.intrinsics, name)?
        }
        Target::Opencv => to_opencv(&read.intrinsics, read.rms_px)?,
    };
    save(&args.out, text.as_bytes())?;
    let file = args.source.file.display();
    context.warn(read.notes.iter().map(|note| format!("{file}: {note}")));
    print(&format!(
        "{}\nfile        {}",
        describe(&read),
        args.out.display()
    ))
}

#[derive(Serialize)]
struct Summary<'a> {
    format: &'static str,
    #[serde(flatten)]
    intrinsics: Intrinsics,
    field_of_view_deg: Option<[f64; 2]>,
    camera_name: Option<&'a str>,
    rms_px: Option<f64>,
    notes: &'a [String],
}

/// Runs `show`.
pub(super) fn show(args: &ShowArgs) -> Result<()> {
    let read = args.source.read()?;
    let summary = Summary {
        format: read.format.name(),
        intrinsics: read.intrinsics,
        field_of_view_deg: field_of_view_deg(&read.intrinsics),
        camera_name: read.camera_name.as_deref(),
        rms_px: read.rms_px,
        notes: &read.notes,
    };
    print_report(args.json, &summary, |_| describe(&read))
}

/// Returns the horizontal and vertical field of view through the principal point; none if the lens
/// model does not reach an edge.
fn field_of_view_deg(camera: &Intrinsics) -> Option<[f64; 2]> {
    let (right, below) = (
        f64::from(camera.width) - 0.5,
        f64::from(camera.height) - 0.5,
    );
    let ideal = |x: f64, y: f64| undistort(camera, DVec2::new(x, y));
    let across = ideal(right, camera.cy)?.x.atan() - ideal(-0.5, camera.cy)?.x.atan();
    let down = ideal(camera.cx, below)?.y.atan() - ideal(camera.cx, -0.5)?.y.atan();
    Some([across.to_degrees(), down.to_degrees()])
}

fn describe(read: &CameraFile) -> String {
    let camera = &read.intrinsics;
    let model = match camera.model {
        DistortionModel::None => "none".to_owned(),
        DistortionModel::BrownConrady => format!("brown-conrady {:?}", camera.coefficients),
        DistortionModel::InverseBrownConrady => {
            format!("inverse-brown-conrady {:?}", camera.coefficients)
        }
    };
    let mut lines = vec![
        format!("format      {}", read.format.name()),
        format!("size        {} × {}", camera.width, camera.height),
        format!("focal       {} {} px", camera.fx, camera.fy),
        format!("centre      {} {} px", camera.cx, camera.cy),
        format!("distortion  {model}"),
    ];
    if let Some([across, down]) = field_of_view_deg(camera) {
        lines.push(format!("view        {across:.1}° × {down:.1}°"));
    }
    if let Some(name) = &read.camera_name {
        lines.push(format!("camera      {name}"));
    }
    if let Some(rms) = read.rms_px {
        lines.push(format!("error       {rms:.3} px"));
    }
    lines.extend(read.notes.iter().map(|note| format!("note        {note}")));
    lines.join("\n")
}
