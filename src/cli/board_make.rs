//! `gripcast board make` and `gripcast board gripper`: printed sheets.

use std::path::{Path, PathBuf};

use glam::DQuat;
use serde_json::json;

use super::board::folder;
use super::flags::{above_zero, degrees, millimetres, numbers, suffix};
use super::sim_object::MeshFlags;
use super::{Context, print_report};
use gripcast_base::error::{Error, Result, nearest_name};
use gripcast_base::files::save;
use gripcast_geometry::Pose;
use gripcast_pose::print::{
    Drawing, GripperTags, Paper, SheetObject, SheetSettings, gripper_board, gripper_sheet,
    object_sheet, pdf, png, svg,
};
use gripcast_pose::{BoardFile, Dictionary};
use gripcast_sim::grasp::resting_pose;

/// Arguments of `make`.
#[derive(Debug, clap::Args)]
pub(super) struct MakeArgs {
    #[command(flatten)]
    mesh: MeshFlags,
    /// Stable pose of the object, 0 being the most probable [default: the nearest within 5°, else
    /// 0]
    #[arg(long, value_name = "INDEX")]
    stable_pose: Option<usize>,
    /// Rotation of the object on the sheet, counter-clockwise
    #[arg(long, value_name = "DEG", default_value_t = 0.0, value_parser = degrees)]
    yaw_deg: f64,
    /// Marker side length
    #[arg(long, value_name = "MM", default_value_t = 30.0, value_parser = millimetres)]
    marker_mm: f64,
    /// ID of the first marker
    #[arg(long, value_name = "ID", default_value_t = 0)]
    first_id: u32,
    #[command(flatten)]
    sheet: SheetFlags,
}

/// Arguments of `gripper`.
#[derive(Debug, clap::Args)]
pub(super) struct GripperArgs {
    /// Side length of the body markers
    #[arg(long, value_name = "MM", default_value_t = 30.0, value_parser = millimetres)]
    body_mm: f64,
    /// Side length of the finger markers
    #[arg(long, value_name = "MM", default_value_t = 18.0, value_parser = millimetres)]
    finger_mm: f64,
    /// ID of the first of six markers [default: the tenth from the end of the dictionary]
    #[arg(long, value_name = "ID")]
    first_id: Option<u32>,
    #[command(flatten)]
    sheet: SheetFlags,
}

#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Output")]
pub(super) struct SheetFlags {
    /// Sheet to write (.pdf, .svg or .png); repeatable
    #[arg(long, value_name = "FILE", required = true)]
    out: Vec<PathBuf>,
    /// Board file to write [default: beside the first sheet]
    #[arg(long, value_name = "FILE.toml")]
    board: Option<PathBuf>,
    /// Name of the board [default: name of the board file]
    #[arg(long)]
    name: Option<String>,
    /// Marker dictionary; an OpenCV dictionary file must lie beside the board file
    #[arg(long, value_name = "NAME|FILE.yml", default_value = "DICT_6X6_250")]
    dictionary: String,
    /// Paper size: A4, A3, Letter
    #[arg(long, value_name = "SIZE", default_value = "A4")]
    pub(super) paper: Paper,
    /// Resolution of a .png, dots per inch
    #[arg(long, value_name = "DPI", default_value_t = 300.0, value_parser = above_zero)]
    dpi: f64,
    /// Measured lengths of the printed 100 mm rulers along x and y; corrects the board file
    #[arg(long, value_name = "X,Y", default_value = "100,100", value_parser = measured)]
    pub(super) measured_mm: [f64; 2],
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

fn measured(text: &str) -> Result<[f64; 2], String> {
    numbers(text, &[',']).ok_or_else(|| "expected two lengths in mm, as in 99.6,99.8".to_owned())
}

/// Refuses a sheet that is not a .pdf, .svg or .png.
fn check_format(path: &Path) -> Result<()> {
    const FORMATS: [&str; 3] = ["pdf", "svg", "png"];
    let suffix = suffix(path);
    if FORMATS.contains(&&*suffix) {
        return Ok(());
    }
    let nearest = nearest_name(&suffix, FORMATS);
    let hint = nearest.map_or(String::new(), |n| format!("did you mean .{n}? "));
    Err(Error::usage("`--out` must end in .pdf, .svg or .png")
        .at(path.display())
        .remedy(format!("{hint}the board file is named with --board")))
}

impl SheetFlags {
    fn board_path(&self) -> PathBuf {
        let beside = || {
            let sheet = self.out.first().cloned().unwrap_or_default();
            sheet.with_extension("toml")
        };
        self.board.clone().unwrap_or_else(beside)
    }

    /// Returns the name of the board and its dictionary.
    pub(super) fn board(&self) -> Result<(String, Dictionary)> {
        let path = self.board_path();
        for out in &self.out {
            check_format(out)?;
        }
        if suffix(&path) != "toml" {
            let what = "`--board` must name a file that ends in .toml";
            return Err(Error::usage(what).at(path.display()));
        }
        let stem = path.file_stem().unwrap_or_default().to_string_lossy();
        let name = self.name.clone().unwrap_or_else(|| stem.into_owned());
        let dictionary = Dictionary::open(&self.dictionary, folder(&path))?;
        Ok((name, dictionary))
    }

    /// Writes sheets and board file and prints a report.
    pub(super) fn write(
        &self,
        drawing: &Drawing,
        printed_hash: &str,
        file: &BoardFile,
    ) -> Result<()> {
        let encode = |out: &PathBuf| {
            Ok(match &*suffix(out) {
                "pdf" => pdf(drawing),
                "svg" => svg(drawing).into_bytes(),
                _ => png(drawing, self.dpi)?,
            })
        };
        // All sheets are encoded before the first is written: an error leaves no files.
        let sheets: Vec<Vec<u8>> = self.out.iter().map(encode).collect::<Result<_>>()?;
        for (out, bytes) in self.out.iter().zip(&sheets) {
            save(out, bytes)?;
        }
        let board = self.board_path();
        save(&board, file.to_toml().as_bytes())?;
        let (hash, ids, paper) = (file.board.hash(), file.board.ids(), self.paper.name());
        let report = json!({
            "name": file.board.name,
            "hash": hash,
            "printed_hash": printed_hash,
            "dictionary": file.board.dictionary,
            "ids": ids,
            "paper": paper,
            "size_mm": drawing.size_mm,
            "measured_mm": self.measured_mm,
            "sheets": self.out,
            "board": board,
        });
        print_report(self.json, &report, |_| {
            let [width, height] = drawing.size_mm;
            let sheets = self.out.iter().map(|s| s.display().to_string());
            let sheets: Vec<String> = sheets.collect();
            [
                format!(
                    "markers     {} of {}, ids {} to {}",
                    ids.len(),
                    file.board.dictionary,
                    ids.first().copied().unwrap_or_default(),
                    ids.last().copied().unwrap_or_default()
                ),
                format!("paper       {paper}, {width} × {height} mm"),
                format!("printed     hash {printed_hash}"),
                format!("sheets      {}", sheets.join(" ")),
                format!("board       {}, hash {hash}", board.display()),
                "print at 100 % and measure both rulers; if they are not 100 mm long, rerun with \
                 --measured-mm X,Y"
                    .to_owned(),
            ]
            .join("\n")
        })
    }
}

/// Runs `board make`.
pub(super) fn make(context: &Context, args: &MakeArgs) -> Result<()> {
    let flags = &args.sheet;
    let (name, dictionary) = flags.board()?;
    let object = args.mesh.load_surface()?;
    context.warn(&object.warnings);
    let (_, pose) = resting_pose(&object.mesh, args.stable_pose)?;
    let yaw = Pose::from_rotation(DQuat::from_rotation_z(args.yaw_deg.to_radians()));
    let placed = SheetObject {
        mesh: &object.mesh,
        source: &args.mesh.object,
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
