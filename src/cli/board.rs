//! `gripcast board`: boards of markers, to print and to look at.
//!
//! ```text
//! gripcast board make --object builtin:mug --out board.pdf
//! gripcast board make --object cup.stl --unit mm --paper a3 --out cup.pdf --out cup.png --dpi 600
//! gripcast board make --object builtin:mug --out board.pdf --measured-mm 99.6,99.8
//! gripcast board gripper --out tags.pdf
//! gripcast board charuco --squares 8x6 --square-mm 30 --out charuco.pdf
//! gripcast board show board.toml
//! gripcast board import board_descriptions.yaml --dictionary 4X4_50 --name table --out table.toml
//! gripcast board import target.yaml --out grid.toml
//! gripcast board import own_dictionary.yml
//! ```
//!
//! `make` draws the sheet that an object stands on and writes the board file beside it: the
//! markers' corners in the object's frame. `gripper` does the same for the gripper's tags, `charuco`
//! for a chessboard with markers that cameras are calibrated with. After
//! printing, the rulers of the sheet are measured and the command is run again with
//! `--measured-mm`: the drawing stays the same, the board file is corrected. `show` checks a board
//! file and says what is in it. `import` reads descriptions of ROS `aruco_opencv`, Kalibr and
//! OpenCV. docs/boards.md has the format and how to print, measure and glue.
//!
//! Exit codes: 0 done · 1 the object, a board or a file is refused · 2 usage.

use std::fs;
use std::path::{Path, PathBuf};

use clap::Subcommand;
use serde::Serialize;

use super::{Context, print, print_json};
use super::{board_charuco, board_make};
use gripcast_base::error::{Error, Result};
use gripcast_base::files::save;
use gripcast_pose::{
    BoardFile, BoardFormat, Body, Chessboard, Dictionary, import_kalibr, import_ros,
};

/// Arguments.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(subcommand)]
    kind: Kind,
}

#[derive(Debug, Subcommand)]
enum Kind {
    /// Draw the sheet that an object stands on
    Make(board_make::MakeArgs),
    /// Draw the tags of the gripper
    Gripper(board_make::GripperArgs),
    /// Draw a chessboard with markers, for calibrating cameras
    Charuco(board_charuco::Args),
    /// Check a board file and say what is in it
    Show(ShowArgs),
    /// Read a board of ROS or Kalibr, or a dictionary of OpenCV
    Import(ImportArgs),
}

/// Runs the verb.
pub(crate) fn run(context: &Context, args: Args) -> Result<()> {
    match args.kind {
        Kind::Make(args) => board_make::make(context, &args),
        Kind::Gripper(args) => board_make::gripper(&args),
        Kind::Charuco(args) => board_charuco::run(&args),
        Kind::Show(args) => show(&args),
        Kind::Import(args) => import(&args),
    }
}

/// The folder that a file lies in.
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
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

fn show(args: &ShowArgs) -> Result<()> {
    let file = BoardFile::load(&args.file)?;
    if args.json {
        return print_json(&Summary::of(&file));
    }
    print(&describe(&file))
}

/// What is said about a board.
#[derive(Serialize)]
struct Summary {
    name: String,
    hash: String,
    dictionary: String,
    ids: Vec<u32>,
    parts: Vec<PartSummary>,
    markers: Vec<MarkerSummary>,
    sheet: Option<SheetSummary>,
    chessboard: Option<Chessboard>,
}

#[derive(Serialize)]
struct PartSummary {
    part: &'static str,
    markers: usize,
    planar: bool,
}

#[derive(Serialize)]
struct MarkerSummary {
    id: u32,
    part: &'static str,
    side_m: f64,
    center_m: [f64; 3],
    front: [f64; 3],
}

#[derive(Serialize)]
struct SheetSummary {
    object: String,
    object_sha256: String,
    paper: String,
    printed_hash: String,
    measured_mm: [f64; 2],
}

impl Summary {
    fn of(file: &BoardFile) -> Self {
        let board = &file.board;
        let part = |part: Body| PartSummary {
            part: part.name(),
            markers: board.markers_on(part).count(),
            planar: board.is_planar(part),
        };
        let markers = board.markers.iter().map(|marker| MarkerSummary {
            id: marker.id,
            part: marker.body.name(),
            side_m: marker.side_m(),
            center_m: marker.center_m().to_array(),
            front: marker.normal().to_array(),
        });
        let parts = Body::ALL.into_iter().map(part);
        Self {
            name: board.name.clone(),
            hash: board.hash(),
            dictionary: board.dictionary.clone(),
            ids: board.ids(),
            parts: parts.filter(|p| p.markers > 0).collect(),
            markers: markers.collect(),
            sheet: file.sheet.as_ref().map(|sheet| SheetSummary {
                object: sheet.object.clone(),
                object_sha256: sheet.object_sha256.clone(),
                paper: sheet.paper.clone(),
                printed_hash: sheet.printed_hash.clone(),
                measured_mm: sheet.measured_mm,
            }),
            chessboard: file.chessboard.clone(),
        }
    }
}

/// The same for people.
fn describe(file: &BoardFile) -> String {
    let board = &file.board;
    let mut lines = vec![
        format!("board       {}", board.name),
        format!("hash        {}", board.hash()),
        format!("dictionary  {}", board.dictionary),
    ];
    for part in Body::ALL {
        let markers: Vec<_> = board.markers_on(part).collect();
        if markers.is_empty() {
            continue;
        }
        let sides = || markers.iter().map(|m| 1e3 * m.side_m());
        let (least, most) = (
            sides().fold(f64::INFINITY, f64::min),
            sides().fold(0.0, f64::max),
        );
        let shape = if board.is_planar(part) {
            "in one plane"
        } else {
            "not in one plane"
        };
        let ids: Vec<String> = markers.iter().map(|m| m.id.to_string()).collect();
        lines.push(format!(
            "{:<11} {} markers of {} mm, {shape}: {}",
            part.name(),
            markers.len(),
            span(least, most),
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

fn span(least: f64, most: f64) -> String {
    if most - least < 0.005 {
        format!("{least:.2}")
    } else {
        format!("{least:.2} to {most:.2}")
    }
}

#[derive(Debug, clap::Args)]
struct ImportArgs {
    /// board_descriptions.yaml of ROS aruco_opencv, target.yaml of Kalibr, or a dictionary of
    /// OpenCV
    #[arg(value_name = "FILE")]
    file: PathBuf,
    /// Dictionary of the board's markers; Kalibr's is 36h11_border2 unless this is given
    #[arg(long, value_name = "NAME|FILE.yml")]
    dictionary: Option<String>,
    /// Which board of several, or what a Kalibr target is to be called
    #[arg(long)]
    name: Option<String>,
    /// Board file to write
    #[arg(long, value_name = "FILE.toml")]
    out: Option<PathBuf>,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

fn import(args: &ImportArgs) -> Result<()> {
    let text = fs::read_to_string(&args.file)
        .map_err(|e| Error::io("cannot read the board", e).at(args.file.display()))?;
    let here = |e: Error| e.at(args.file.display());
    let kind = BoardFormat::detect(&text).map_err(here)?;
    let board = match kind {
        BoardFormat::OpencvDictionary => {
            let name = args.file.to_string_lossy();
            let dictionary = Dictionary::from_opencv(&name, &text).map_err(here)?;
            return say_dictionary(args, &dictionary);
        }
        BoardFormat::Kalibr => {
            let dictionary = args.dictionary()?;
            let stem = args.file.file_stem().unwrap_or_default().to_string_lossy();
            let name = args.name.clone().unwrap_or_else(|| stem.into_owned());
            import_kalibr(&text, &name, dictionary.as_ref()).map_err(here)?
        }
        BoardFormat::Ros => {
            let dictionary = args.dictionary()?.ok_or_else(|| {
                Error::usage(
                    "the file of aruco_opencv does not say which dictionary its boards have",
                )
                .remedy("give --dictionary, the marker_dict of the ROS node, such as 4X4_50")
            })?;
            let boards = import_ros(&text, &dictionary).map_err(here)?;
            chosen(boards, args.name.as_deref())?
        }
    };
    if let Some(out) = &args.out {
        save(out, board.to_toml().as_bytes())?;
    }
    if args.json {
        return print_json(&Summary::of(&board));
    }
    match &args.out {
        Some(out) => print(&format!(
            "{}\nfile        {}",
            describe(&board),
            out.display()
        )),
        None => print(&board.to_toml()),
    }
}

impl ImportArgs {
    fn dictionary(&self) -> Result<Option<Dictionary>> {
        let folder = self.out.as_deref().map_or(Path::new("."), folder);
        let name = self.dictionary.as_deref();
        name.map(|name| Dictionary::open(name, folder)).transpose()
    }
}

/// The only board, or that of a name.
fn chosen(mut boards: Vec<BoardFile>, name: Option<&str>) -> Result<BoardFile> {
    let names: Vec<String> = boards.iter().map(|b| b.board.name.clone()).collect();
    let known: Vec<&str> = names.iter().map(|n| &**n).collect();
    let place = match name {
        Some(name) => known.iter().position(|n| *n == name),
        None => Some(0).filter(|_| known.len() == 1),
    };
    match (place, name) {
        (Some(place), _) => Ok(boards.swap_remove(place)),
        (None, Some(name)) => Err(gripcast_base::error::unknown_name("board", name, &known)),
        (None, None) => Err(Error::usage(format!("the file has {} boards", known.len()))
            .remedy(format!("choose one with --name: {}", known.join(", ")))),
    }
}

#[derive(Serialize)]
struct DictionarySummary<'a> {
    dictionary: &'a str,
    markers: usize,
    bits_per_side: usize,
    min_distance: u32,
}

fn say_dictionary(args: &ImportArgs, dictionary: &Dictionary) -> Result<()> {
    if args.out.is_some() {
        let what = "a dictionary is no board: there is nothing to write";
        return Err(Error::usage(what)
            .remedy("boards name it by its file: --dictionary FILE.yml, beside the board file"));
    }
    let said = DictionarySummary {
        dictionary: dictionary.name(),
        markers: dictionary.len(),
        bits_per_side: dictionary.bits_per_side(),
        min_distance: dictionary.min_distance(),
    };
    if args.json {
        return print_json(&said);
    }
    print(&format!(
        "dictionary  {}\nmarkers     {} of {2} × {2} cells\ndistance    {3} cells between any two",
        said.dictionary, said.markers, said.bits_per_side, said.min_distance
    ))
}
