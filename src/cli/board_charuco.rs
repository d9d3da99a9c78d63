//! `gripcast board charuco`: draws a ChArUco board for camera calibration.

use super::board_make::SheetFlags;
use super::flags::{millimetres, size};
use gripcast_base::error::Result;
use gripcast_pose::print::{CharucoSettings, charuco_sheet};

/// Marker side relative to the square: leaves enough white for detection and chessboard corners.
const MARKER_RATIO: f64 = 0.7;

/// Arguments.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Columns and rows of squares
    #[arg(long, value_name = "COLUMNSxROWS", default_value = "8x6",
        value_parser = |text: &str| size(text, 0..=1000))]
    squares: [u32; 2],
    /// Side length of a square
    #[arg(long, value_name = "MM", default_value_t = 30.0, value_parser = millimetres)]
    square_mm: f64,
    /// Side length of a marker [default: 0.7 of a square]
    #[arg(long, value_name = "MM", value_parser = millimetres)]
    marker_mm: Option<f64>,
    /// ID of the first marker
    #[arg(long, value_name = "ID", default_value_t = 0)]
    first_id: u32,
    /// Use the layout of OpenCV before 4.6 for even numbers of rows: white square at the top left
    #[arg(long)]
    legacy: bool,
    #[command(flatten)]
    sheet: SheetFlags,
}

/// Runs the command.
pub(super) fn run(args: &Args) -> Result<()> {
    let (name, dictionary) = args.sheet.board()?;
    let settings = CharucoSettings {
        name,
        dictionary,
        first_id: args.first_id,
        squares: args.squares,
        square_mm: args.square_mm,
        marker_mm: args.marker_mm.unwrap_or(MARKER_RATIO * args.square_mm),
        legacy: args.legacy,
        paper: args.sheet.paper,
        measured_mm: args.sheet.measured_mm,
    };
    let sheet = charuco_sheet(&settings)?;
    args.sheet
        .write(&sheet.drawing, &sheet.printed_hash, &sheet.file)
}
