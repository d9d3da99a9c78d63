//! Printable sheets: object board, gripper tags, chessboard for calibration.
//!
//! A sheet is a [`Drawing`], written by [`svg`], [`pdf`] and [`png`]. Lengths are mm on paper, x to
//! the right and y down from the top left corner, unless named otherwise.

mod charuco_sheet;
mod contour;
mod drawing;
mod flat;
mod gripper_board;
mod gripper_sheet;
mod layout;
mod notes;
mod object_sheet;
mod paper;
mod pdf;
mod png;
mod silhouette;
mod svg;

pub use self::pdf::pdf;
pub use self::png::{png, raster};
pub use self::svg::svg;
pub use charuco_sheet::{CharucoSettings, CharucoSheet, charuco_sheet};
pub use drawing::{Colour, Drawing, Shape, TextAnchor};
pub use gripper_board::{GripperTags, gripper_board};
pub use gripper_sheet::gripper_sheet;
pub use object_sheet::{
    ObjectSheet, SheetObject, SheetSettings, default_object_sheet, object_sheet,
};
pub use paper::Paper;

use gripcast_base::error::{Error, Result};

/// Length of the rulers, mm.
pub const RULER_MM: f64 = 100.0;

/// Checks what the two rulers measure, mm.
///
/// # Errors
/// `Input` if a printer cannot be that wrong.
pub fn check_ruler_lengths(measured_mm: [f64; 2]) -> Result<()> {
    if measured_mm
        .iter()
        .all(|m| (m / RULER_MM - 1.0).abs() <= 0.1)
    {
        return Ok(());
    }
    Err(Error::input(format!(
        "the printed rulers must measure about 100 mm, found {} and {} mm",
        measured_mm[0], measured_mm[1]
    ))
    .remedy("print at 100 % (no fitting to the page) and give their lengths in millimetres"))
}
