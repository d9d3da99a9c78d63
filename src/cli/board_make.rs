//! `gripcast board make` and `gripcast board gripper`: what is printed.

use std::path::{Path, PathBuf};

use glam::DQuat;
use serde::Serialize;

use super::board::folder;
use super::sim_object::{SimObject, unit};
use super::{Context, print_report};
use crate::note;
use gripcast_base::error::{Error, Result, nearest_name};
use gripcast_base::files::save;
use gripcast_geometry::{LengthUnit, Pose};
use gripcast_pose::print::{
    Drawing, GripperTags, Paper, SheetObject, SheetSettings, gripper_board, gripper_sheet,
    object_sheet, pdf, png, svg,
};
use gripcast_pose::{BoardFile, Dictionary};
use gripcast_sim::grasp::resting_pose;

/// Arguments of `make`.
#[derive(Debug, clap::Args)]
#[command(allow_negative_numbers = true)]
pub(super) struct MakeArgs {
    /// Mesh file (obj, stl, ply, glb, gltf) or builtin:NAME (box, sphere, cylinder, mug, wedge,
    /// bar, spike)
    #[arg(long, value_name = "MESH|builtin:NAME")]
    object: String,
    /// Unit of the coordinates in the mesh file: mm, cm, m, in
    #[arg(long, default_value_t = LengthUnit::Metre, value_parser = unit)]
    unit: LengthUnit,
    /// Factor on the size of the mesh
    #[arg(long, default_value_t = 1.0)]
    scale: f64,
    /// Which stable pose the object stands in, the most probable being 0 [default: as the mesh
    /// stands]
    #[arg(long, value_name = "N")]
    stable_pose: Option<usize>,
    /// Turn of the object on the sheet, counter-clockwise
    #[arg(long, value_name = "DEG", default_value_t = 0.0)]
    yaw_deg: f64,
    /// Side of a marker
    #[arg(long, value_name = "MM", default_value_t = 30.0)]
    marker_mm: f64,
    /// Id of the first marker
    #[arg(long, value_name = "ID", default_value_t = 0)]
    first_id: u32,
    #[command(flatten)]
    sheet: SheetFlags,
}

/// Arguments of `gripper`.
#[derive(Debug, clap::Args)]
pub(super) struct GripperArgs {
    /// Side of the body's markers
    #[arg(long, value_name = "MM", default_value_t = 30.0)]
    body_mm: f64,
    /// Side of the fingers' markers
    #[arg(long, value_name = "MM", default_value_t = 18.0)]
    finger_mm: f64,
    /// Id of the first of six markers [default: the last ten of the dictionary begin there]
    #[arg(long, value_name = "ID")]
    first_id: Option<u32>,
    #[command(flatten)]
    sheet: SheetFlags,
}

#[derive(Debug, clap::Args)]
#[command(next_help_heading = "What is written")]
pub(super) struct SheetFlags {
    /// Sheet to write: .pdf, .svg or .png; may be given several times
    #[arg(long, value_name = "FILE", required = true)]
    out: Vec<PathBuf>,
    /// Board file to write [default: beside the first sheet, .toml]
    #[arg(long, value_name = "FILE.toml")]
    board: Option<PathBuf>,
    /// Name of the board [default: that of the board file]
    #[arg(long)]
    name: Option<String>,
    /// Dictionary of the markers; a file of OpenCV's format lies beside the board file
    #[arg(long, value_name = "NAME|FILE.yml", default_value = "DICT_6X6_250")]
    dictionary: String,
    /// Paper: A4, A3, Letter
    #[arg(long, default_value = "A4", value_parser = paper)]
    pub(super) paper: Paper,
    /// Dots per inch of a .png
    #[arg(long, default_value_t = 300.0)]
    dpi: f64,
    /// What the printed rulers of 100 mm measure along x and y; corrects the board file
    #[arg(long, value_name = "X,Y", default_value = "100,100", value_parser = measured)]
    pub(super) measured_mm: [f64; 2],
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

fn paper(text: &str) -> Result<Paper, String> {
    text.parse().map_err(|e: Error| e.to_string())
}

fn measured(text: &str) -> Result<[f64; 2], String> {
    let numbers: Option<Vec<f64>> = text.split(',').map(|t| t.trim().parse().ok()).collect();
    let pair = numbers.and_then(|numbers| <[f64; 2]>::try_from(numbers).ok());
    pair.ok_or_else(|| "must be two lengths in millimetres, as 99.6,99.8".to_owned())
}

/// A format of sheets, by the suffix of a file.
#[derive(Clone, Copy)]
enum SheetFormat {
    Pdf,
    Svg,
    Png,
}

impl SheetFormat {
    fn of(path: &Path) -> Result<Self> {
        let suffix = path.extension().unwrap_or_default().to_string_lossy();
        match &*suffix.to_ascii_lowercase() {
            "pdf" => Ok(Self::Pdf),
            "svg" => Ok(Self::Svg),
            "png" => Ok(Self::Png),
            other => {
                let nearest = nearest_name(other, ["pdf", "svg", "png"]);
                let hint = nearest.map_or(String::new(), |n| format!("did you mean .{n}? "));
                let what = "`--out` must end in .pdf, .svg or .png";
                Err(Error::usage(what)
                    .at(path.display())
                    .remedy(format!("{hint}the board file is named with --board")))
            }
        }
    }
}

impl SheetFlags {
    fn board_path(&self) -> PathBuf {
        let beside = || {
            let sheet = self.out.first().cloned().unwrap_or_default();
            sheet.with_extension("toml")
        };
        self.board.clone().unwrap_or_else(beside)
    }

    /// Name of the board, and its dictionary.
    pub(super) fn board(&self) -> Result<(String, Dictionary)> {
        let path = self.board_path();
        for out in &self.out {
            SheetFormat::of(out)?;
        }
        if !path
            .extension()
            .is_some_and(|e| e.eq_ignore_ascii_case("toml"))
        {
            let what = "`--board` must name a file that ends in .toml";
            return Err(Error::usage(what).at(path.display()));
        }
        let stem = path.file_stem().unwrap_or_default().to_string_lossy();
        let name = self.name.clone().unwrap_or_else(|| stem.into_owned());
        let dictionary = Dictionary::open(&self.dictionary, folder(&path))?;
        Ok((name, dictionary))
    }

    /// Writes sheets and board, and says so.
    pub(super) fn write(
        &self,
        drawing: &Drawing,
        printed_hash: &str,
        file: &BoardFile,
    ) -> Result<()> {
        let encode = |out: &PathBuf| {
            Ok(match SheetFormat::of(out)? {
                SheetFormat::Pdf => pdf(drawing),
                SheetFormat::Svg => svg(drawing).into_bytes(),
                SheetFormat::Png => png(drawing, self.dpi)?,
            })
        };
        // All are made before the first is written: a mistake leaves nothing behind.
        let sheets: Vec<Vec<u8>> = self.out.iter().map(encode).collect::<Result<_>>()?;
        for (out, bytes) in self.out.iter().zip(&sheets) {
            save(out, bytes)?;
        }
        let board = self.board_path();
        save(&board, file.to_toml().as_bytes())?;
        let made = Made {
            name: &file.board.name,
            hash: file.board.hash(),
            printed_hash,
            dictionary: &file.board.dictionary,
            ids: file.board.ids(),
            paper: self.paper.name(),
            size_mm: drawing.size_mm,
            measured_mm: self.measured_mm,
            sheets: &self.out,
            board: &board,
        };
        print_report(self.json, &made, |made| made.text())
    }
}

#[derive(Serialize)]
struct Made<'a> {
    name: &'a str,
    hash: String,
    printed_hash: &'a str,
    dictionary: &'a str,
    ids: Vec<u32>,
    paper: &'a str,
    size_mm: [f64; 2],
    measured_mm: [f64; 2],
    sheets: &'a [PathBuf],
    board: &'a Path,
}

impl Made<'_> {
    fn text(&self) -> String {
        let [width, height] = self.size_mm;
        let sheets = self.sheets.iter().map(|s| s.display().to_string());
        let sheets: Vec<String> = sheets.collect();
        [
            format!(
                "markers     {} of {}, ids {} to {}",
                self.ids.len(),
                self.dictionary,
                self.ids.first().copied().unwrap_or_default(),
                self.ids.last().copied().unwrap_or_default()
            ),
            format!("paper       {}, {width} × {height} mm", self.paper),
            format!("printed     hash {}", self.printed_hash),
            format!("sheets      {}", sheets.join(" ")),
            format!("board       {}, hash {}", self.board.display(), self.hash),
            "print at 100 %, measure both rulers; where they are not 100 mm long, run this again \
             with --measured-mm X,Y"
                .to_owned(),
        ]
        .join("\n")
    }
}

/// Runs `board make`.
pub(super) fn make(context: &Context, args: &MakeArgs) -> Result<()> {
    let flags = &args.sheet;
    let (name, dictionary) = flags.board()?;
    let object = SimObject::read(&args.object, args.unit, args.scale)?;
    if !context.quiet {
        for warning in &object.warnings {
            note!("gripcast: {warning}");
        }
    }
    let (_, pose) = resting_pose(&object.mesh, args.stable_pose)?;
    if !args.yaw_deg.is_finite() {
        let what = format!("`--yaw-deg` must be an angle, found {}", args.yaw_deg);
        return Err(Error::usage(what));
    }
    let yaw = Pose::from_rotation(DQuat::from_rotation_z(args.yaw_deg.to_radians()));
    let placed = SheetObject {
        mesh: &object.mesh,
        source: &args.object,
        t_world_object: yaw * pose.t_world_object,
    };
    let settings = SheetSettings {
        name,
        dictionary,
        first_id: args.first_id,
        marker_m: 1e-3 * args.marker_mm,
        paper: flags.paper,
        measured_mm: flags.measured_mm,
    };
    let sheet = object_sheet(&placed, &settings)?;
    let record = sheet.file.sheet.as_ref();
    let printed = record.map_or(String::new(), |s| s.printed_hash.clone());
    flags.write(&sheet.drawing, &printed, &sheet.file)
}

/// Runs `board gripper`.
pub(super) fn gripper(args: &GripperArgs) -> Result<()> {
    let flags = &args.sheet;
    let (name, dictionary) = flags.board()?;
    let last_ten = (dictionary.len() as u32).saturating_sub(10);
    let tags = GripperTags {
        name,
        first_id: args.first_id.unwrap_or(last_ten),
        dictionary,
        body_m: 1e-3 * args.body_mm,
        finger_m: 1e-3 * args.finger_mm,
        measured_mm: flags.measured_mm,
    };
    let drawing = gripper_sheet(&tags, flags.paper)?;
    let nominal = GripperTags {
        measured_mm: [100.0; 2],
        ..tags.clone()
    };
    let printed = gripper_board(&nominal)?.board.hash();
    flags.write(&drawing, &printed, &gripper_board(&tags)?)
}
