//! `gripcast board`: prints, inspects and imports marker boards.
//!
//! ```text
//! gripcast board make --object builtin:mug --out board.pdf
//! gripcast board make --object cup.stl --unit mm --paper a3 --out cup.pdf --out cup.png --dpi 600
//! gripcast board make --object builtin:mug --out board.pdf --measured-mm 99.6,99.8
//! gripcast board gripper --out tags.pdf
//! gripcast board charuco --squares 8x6 --square-mm 30 --out charuco.pdf
//! gripcast board show board.toml
//! gripcast board detect photo.png
//! gripcast board detect shots/*.jpg --board table.toml --camera external.yaml --overlay found
//! gripcast board import board_descriptions.yaml --dictionary 4X4_50 --name table --out table.toml
//! gripcast board import target.yaml --out grid.toml
//! gripcast board import own_dictionary.yml
//! ```
//!
//! `make` draws the sheet below an object and writes the board file beside it: the marker corners
//! in the object's frame. `gripper` does the same for the gripper tags, `charuco` for a ChArUco
//! board for camera calibration. After printing, measure the rulers of the sheet and rerun the
//! command with `--measured-mm`: it corrects the board file and keeps the drawing. `show` checks
//! and describes a board file. `detect` finds markers in any image. `import` reads boards of ROS `aruco_opencv`, Kalibr and
//! the aruco library, and dictionaries of OpenCV. Format, printing and gluing: docs/how-to/boards.md.
//!
//! Exit codes: 0 done · 1 invalid object, board or file, no marker in any image · 2 usage · 3 no marker
//! in some images.

use std::path::{Path, PathBuf};

use clap::Subcommand;
use serde_json::{Value, json};

use super::flags::read_text;
use super::{Context, print_report};
use super::{board_charuco, board_detect, board_make};
use gripcast_base::error::{Error, Result, unknown_name};
use gripcast_base::files::save;
use gripcast_pose::{
    BoardFile, BoardFormat, Body, Dictionary, ImportedBoards, import_aruco_map, import_kalibr,
    import_ros,
};

/// Arguments.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(subcommand)]
    kind: Kind,
}

#[derive(Debug, Subcommand)]
enum Kind {
    /// Draw the marker sheet below an object
    Make(board_make::MakeArgs),
    /// Draw the gripper tags
    Gripper(board_make::GripperArgs),
    /// Draw a ChArUco board for camera calibration
    Charuco(board_charuco::Args),
    /// Check and describe a board file
    Show(ShowArgs),
    /// Detect markers in images
    Detect(board_detect::Args),
    /// Import a board of ROS, Kalibr or aruco, or a dictionary of OpenCV
    Import(ImportArgs),
}

/// Runs the command.
pub(crate) fn run(context: &Context, args: Args) -> Result<()> {
    match args.kind {
        Kind::Make(args) => board_make::make(context, &args),
        Kind::Gripper(args) => board_make::gripper(&args),
        Kind::Charuco(args) => board_charuco::run(&args),
        Kind::Show(args) => show(&args),
        Kind::Detect(args) => board_detect::run(&args),
        Kind::Import(args) => import(&args),
    }
}

/// Returns the folder of a file.
pub(super) fn folder(file: &Path) -> &Path {
    match file.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    }
}

#[derive(Debug, clap::Args)]
struct ShowArgs {
    /// Board file
    #[arg(value_name = "FILE.toml")]
    file: PathBuf,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

fn show(args: &ShowArgs) -> Result<()> {
    let file = BoardFile::load(&args.file)?;
    print_report(args.json, &summary(&file), |_| describe(&file))
}

/// Describes a board as JSON.
fn summary(file: &BoardFile) -> Value {
    let board = &file.board;
    let bodies = Body::ALL.into_iter().filter_map(|body| {
        let markers = board.markers_on(body).count();
        let planar = board.is_planar(body);
        (markers > 0).then(|| json!({"body": body.name(), "markers": markers, "planar": planar}))
    });
    let markers = board.markers.iter().map(|marker| {
        json!({
            "id": marker.id,
            "body": marker.body.name(),
            "side_m": marker.side_m(),
            "center_m": marker.center_m().to_array(),
            "front": marker.normal().to_array(),
        })
    });
    let sheet = file.sheet.as_ref().map(|sheet| {
        json!({
            "object": sheet.object,
            "object_sha256": sheet.object_sha256,
            "paper": sheet.paper,
            "printed_hash": sheet.printed_hash,
            "measured_mm": sheet.measured_mm,
        })
    });
    json!({
        "name": board.name,
        "hash": board.hash(),
        "dictionary": board.dictionary,
        "ids": board.ids(),
        "bodies": bodies.collect::<Vec<_>>(),
        "markers": markers.collect::<Vec<_>>(),
        "sheet": sheet,
        "chessboard": file.chessboard,
    })
}

/// Describes a board as text.
fn describe(file: &BoardFile) -> String {
    let board = &file.board;
    let mut lines = vec![
        format!("board       {}", board.name),
        format!("hash        {}", board.hash()),
    ];
    if file.plain().is_none() {
        lines.push(format!("dictionary  {}", board.dictionary));
    }
    for body in Body::ALL {
        let markers: Vec<_> = board.markers_on(body).collect();
        if markers.is_empty() {
            continue;
        }
        let sides = || markers.iter().map(|m| 1e3 * m.side_m());
        let (min, max) = (
            sides().fold(f64::INFINITY, f64::min),
            sides().fold(0.0, f64::max),
        );
        let shape = if board.is_planar(body) {
            "planar"
        } else {
            "not planar"
        };
        let ids: Vec<String> = markers.iter().map(|m| m.id.to_string()).collect();
        lines.push(format!(
            "{:<11} {} markers of {} mm, {shape}: {}",
            body.name(),
            markers.len(),
            span(min, max),
            ids.join(" ")
        ));
    }
    if let Some(sheet) = &file.sheet {
        let [x, y] = sheet.measured_mm;
        lines.push(format!(
            "sheet       {} for {}, printed hash {}, rulers {x} and {y} mm",
            sheet.paper, sheet.object, sheet.printed_hash
        ));
    }
    if let Some(chessboard) = &file.chessboard {
        let [columns, rows] = chessboard.squares;
        let [width, height] = chessboard.square_mm;
        let legacy = if chessboard.legacy { ", legacy" } else { "" };
        let printed = chessboard.printed_hash.as_ref();
        let printed = printed.map_or(String::new(), |h| format!(", printed hash {h}"));
        lines.push(format!(
            "chessboard  {columns}×{rows} squares of {width:.3} × {height:.3} mm{legacy}{printed}"
        ));
    }
    lines.join("\n")
}

fn span(min: f64, max: f64) -> String {
    if max - min < 0.005 {
        format!("{min:.2}")
    } else {
        format!("{min:.2} to {max:.2}")
    }
}

#[derive(Debug, clap::Args)]
struct ImportArgs {
    /// board_descriptions.yaml of ROS aruco_opencv, target.yaml of Kalibr, marker map of aruco, or
    /// dictionary of OpenCV
    #[arg(value_name = "FILE")]
    file: PathBuf,
    /// Marker dictionary [default for Kalibr: its tagFamily with a border of two cells]
    #[arg(long, value_name = "NAME|FILE.yml")]
    dictionary: Option<String>,
    /// Board to choose from several, or name of a board that has none
    #[arg(long)]
    name: Option<String>,
    /// Board file to write
    #[arg(long, value_name = "FILE.toml")]
    out: Option<PathBuf>,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

fn import(args: &ImportArgs) -> Result<()> {
    let text = read_text(&args.file, "board")?;
    let here = |e: Error| e.at(args.file.display());
    let kind = BoardFormat::detect(&text).map_err(here)?;
    let board = match kind {
        BoardFormat::OpencvDictionary => {
            let name = args.file.to_string_lossy();
            let dictionary = Dictionary::from_opencv(&name, &text).map_err(here)?;
            return print_dictionary(args, &dictionary);
        }
        BoardFormat::Kalibr => {
            import_kalibr(&text, &args.name(), args.dictionary()?.as_ref()).map_err(here)?
        }
        BoardFormat::ArucoMap => {
            import_aruco_map(&text, &args.name(), args.dictionary()?.as_ref()).map_err(here)?
        }
        BoardFormat::Ros => {
            let dictionary = args.dictionary()?.ok_or_else(|| {
                Error::usage("the aruco_opencv file does not name its marker dictionary")
                    .remedy("give --dictionary, the marker_dict of the ROS node, such as 4X4_50")
            })?;
            let boards = import_ros(&text, &dictionary).map_err(here)?;
            chosen(boards, args.name.as_deref())?
        }
    };
    if let Some(out) = &args.out {
        save(out, board.to_toml().as_bytes())?;
    }
    print_report(args.json, &summary(&board), |_| match &args.out {
        Some(out) => format!("{}\nfile        {}", describe(&board), out.display()),
        None => board.to_toml(),
    })
}

impl ImportArgs {
    /// Name of the board: that given, else that of the file.
    fn name(&self) -> String {
        let stem = self.file.file_stem().unwrap_or_default().to_string_lossy();
        self.name.clone().unwrap_or_else(|| stem.into_owned())
    }

    fn dictionary(&self) -> Result<Option<Dictionary>> {
        let folder = self.out.as_deref().map_or(Path::new("."), folder);
        let name = self.dictionary.as_deref();
        name.map(|name| Dictionary::open(name, folder)).transpose()
    }
}

/// Returns the only board, or the board with the given name.
fn chosen(imported: ImportedBoards, name: Option<&str>) -> Result<BoardFile> {
    let ImportedBoards {
        mut boards,
        unsupported,
    } = imported;
    let is_only = boards.len() + unsupported.len() == 1;
    let refused = |(other, _): &&(String, String)| name.map_or(is_only, |name| name == other);
    if let Some((name, reason)) = unsupported.iter().find(refused) {
        return Err(Error::input(format!(
            "board {name:?} is not supported: {reason}"
        )));
    }
    let names: Vec<String> = boards.iter().map(|b| b.board.name.clone()).collect();
    let names: Vec<&str> = names.iter().map(|n| &**n).collect();
    let index = match name {
        Some(name) => names.iter().position(|n| *n == name),
        None => Some(0).filter(|_| is_only),
    };
    match (index, name) {
        (Some(index), _) => Ok(boards.swap_remove(index)),
        (None, Some(name)) => Err(unknown_name("board", name, &names)),
        (None, None) => Err(Error::usage(format!(
            "the file has {} boards",
            names.len() + unsupported.len()
        ))
        .remedy(format!("choose one with --name: {}", names.join(", ")))),
    }
}

fn print_dictionary(args: &ImportArgs, dictionary: &Dictionary) -> Result<()> {
    if args.out.is_some() {
        return Err(Error::usage("`--out` is for boards, found a dictionary")
            .remedy("name the dictionary by its file: --dictionary FILE.yml, beside the board"));
    }
    let report = json!({
        "dictionary": dictionary.name(),
        "markers": dictionary.len(),
        "bits_per_side": dictionary.bits_per_side(),
        "min_distance": dictionary.min_distance(),
    });
    print_report(args.json, &report, |_| {
        format!(
            "dictionary  {}\nmarkers     {} of {2} × {2} cells\ndistance    at least {3} cells",
            dictionary.name(),
            dictionary.len(),
            dictionary.bits_per_side(),
            dictionary.min_distance()
        )
    })
}
