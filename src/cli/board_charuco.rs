//! `gripcast board charuco`: a chessboard with markers, for calibrating cameras.

use super::board_make::SheetFlags;
use gripcast_base::error::Result;
use gripcast_pose::print::{CharucoSettings, charuco_sheet};

/// Markers relative to squares: enough white around a marker for its detection and for the
/// corner of the chessboard beside it.
const MARKER_OF_SQUARE: f64 = 0.7;

/// Arguments.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Columns and rows of squares
    #[arg(long, value_name = "COLUMNSxROWS", default_value = "8x6", value_parser = squares)]
    squares: [u32; 2],
    /// Side of a square
    #[arg(long, value_name = "MM", default_value_t = 30.0)]
    square_mm: f64,
    /// Side of a marker [default: 0.7 of a square]
    #[arg(long, value_name = "MM")]
    marker_mm: Option<f64>,
    /// Id of the first marker
    #[arg(long, value_name = "ID", default_value_t = 0)]
    first_id: u32,
    /// The layout of OpenCV before 4.6 for even numbers of rows: white square at the top left
    #[arg(long)]
    legacy: bool,
    #[command(flatten)]
    sheet: SheetFlags,
}

fn squares(text: &str) -> Result<[u32; 2], String> {
    let numbers: Option<Vec<u32>> = text
        .split(['x', 'X', '×'])
        .map(|t| t.trim().parse().ok())
        .collect();
    let pair = numbers.and_then(|numbers| <[u32; 2]>::try_from(numbers).ok());
    pair.ok_or_else(|| "must be columns and rows, as 8x6".to_owned())
}

/// Runs the verb.
pub(super) fn run(args: &Args) -> Result<()> {
    let (name, dictionary) = args.sheet.board()?;
    let settings = CharucoSettings {
        name,
        dictionary,
        first_id: args.first_id,
        squares: args.squares,
        square_mm: args.square_mm,
        marker_mm: args.marker_mm.unwrap_or(MARKER_OF_SQUARE * args.square_mm),
        legacy: args.legacy,
        paper: args.sheet.paper,
        measured_mm: args.sheet.measured_mm,
    };
    let sheet = charuco_sheet(&settings)?;
    args.sheet
        .write(&sheet.drawing, &sheet.printed_hash, &sheet.file)
}
