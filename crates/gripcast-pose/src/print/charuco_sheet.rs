//! Sheet of a ChArUco board.

use glam::DVec2;

use super::drawing::{Drawing, Shape};
use super::layout::NOTES_MM;
use super::notes::{MARGIN_MM, notes, ruler};
use super::paper::Paper;
use super::{RULER_MM, check_ruler_lengths};
use crate::{Board, BoardFile, Chessboard, Dictionary};
use gripcast_base::error::{Error, Result};

/// White border around the squares, mm.
const BORDER_MM: f64 = 4.0;
/// Height of the strip of the horizontal ruler below the squares, mm.
const RULER_STRIP_MM: f64 = 6.0;
/// Width of the strip of the vertical ruler and the notes beside the squares, mm.
const SIDE_MM: f64 = 34.0;

/// Settings of a ChArUco sheet.
#[derive(Clone, Debug)]
pub struct CharucoSettings {
    /// Name of the board.
    pub name: String,
    /// Dictionary of the markers.
    pub dictionary: Dictionary,
    /// Id of the first marker; the others follow row by row.
    pub first_id: u32,
    /// Columns and rows of squares.
    pub squares: [u32; 2],
    /// Side of a square, mm.
    pub square_mm: f64,
    /// Side of a marker, mm.
    pub marker_mm: f64,
    /// Layout of OpenCV before 4.6 for even numbers of rows.
    pub legacy: bool,
    /// Paper, in portrait or landscape.
    pub paper: Paper,
    /// Measured lengths of the 100 mm rulers on the printed sheet, x and y, mm. They scale the
    /// board, not the drawing.
    pub measured_mm: [f64; 2],
}

/// A sheet and its board.
#[derive(Clone, Debug)]
pub struct CharucoSheet {
    /// The drawing to print.
    pub drawing: Drawing,
    /// Hash of the drawn board.
    pub printed_hash: String,
    /// The board, in a frame at the chessboard's centre.
    pub file: BoardFile,
}

/// Draws a ChArUco board with rulers and the board's hash.
///
/// # Errors
/// `Input` for implausible sizes, ids outside the dictionary, or a board larger than the paper;
/// the remedy names sizes that fit.
pub fn charuco_sheet(settings: &CharucoSettings) -> Result<CharucoSheet> {
    check_ruler_lengths(settings.measured_mm)?;
    let (nominal, board) = settings.board([RULER_MM; 2])?;
    let layout = layout(settings).ok_or_else(|| does_not_fit(settings))?;
    let printed_hash = board.hash();
    let drawing = draw(settings, &nominal, &board, &layout);
    let (mut chessboard, board) = settings.board(settings.measured_mm)?;
    chessboard.printed_hash = Some(printed_hash.clone());
    let file = BoardFile::new(board, settings.dictionary.clone(), None)?;
    Ok(CharucoSheet {
        drawing,
        printed_hash,
        file: file.with_chessboard(chessboard)?,
    })
}

impl CharucoSettings {
    /// Chessboard and markers scaled by the measured rulers.
    fn board(&self, measured_mm: [f64; 2]) -> Result<(Chessboard, Board)> {
        let scaled = |length: f64| measured_mm.map(|mm| length * mm / RULER_MM);
        let chessboard = Chessboard {
            squares: self.squares,
            square_mm: scaled(self.square_mm),
            legacy: self.legacy,
            printed_hash: None,
        };
        let marker_mm = scaled(self.marker_mm);
        let board = chessboard.board(&self.name, &self.dictionary, self.first_id, marker_mm)?;
        Ok((chessboard, board))
    }

    /// Width and height of the squares, mm.
    fn extent_mm(&self) -> DVec2 {
        DVec2::from_array(self.squares.map(f64::from)) * self.square_mm
    }
}

/// Positions on the sheet, mm.
struct Layout {
    size_mm: [f64; 2],
    /// Centre of the chessboard.
    centre: DVec2,
    /// Left end of the horizontal ruler, lower end of the vertical one.
    rulers: [DVec2; 2],
    /// Top left corner and width of the notes.
    notes: (DVec2, f64),
}

/// Prefers notes below the squares to notes beside them, and portrait to landscape.
fn layout(settings: &CharucoSettings) -> Option<Layout> {
    let sizes = [settings.paper.portrait_mm(), settings.paper.landscape_mm()];
    let below = sizes.iter().find_map(|size| notes_below(settings, *size));
    below.or_else(|| sizes.iter().find_map(|size| notes_beside(settings, *size)))
}

/// Corners of the printable area.
fn area([width, height]: [f64; 2]) -> [DVec2; 2] {
    [
        DVec2::splat(MARGIN_MM),
        DVec2::new(width - MARGIN_MM, height - MARGIN_MM),
    ]
}

fn notes_below(settings: &CharucoSettings, size_mm: [f64; 2]) -> Option<Layout> {
    let [low, mut high] = area(size_mm);
    let floor = high.y;
    high.y -= NOTES_MM + BORDER_MM;
    // The vertical ruler is at the left border.
    let left = low.x + 8.0;
    let extent = settings.extent_mm();
    let room = high - DVec2::new(left, low.y);
    let fits = extent.cmple(room).all() && floor - NOTES_MM - RULER_MM > low.y;
    fits.then(|| Layout {
        size_mm,
        centre: 0.5 * (DVec2::new(left, low.y) + high),
        rulers: [
            DVec2::new(low.x, floor),
            DVec2::new(low.x, floor - NOTES_MM),
        ],
        notes: (
            DVec2::new(low.x + RULER_MM + 16.0, floor - NOTES_MM + 1.0),
            high.x - low.x - RULER_MM - 16.0,
        ),
    })
}

fn notes_beside(settings: &CharucoSettings, size_mm: [f64; 2]) -> Option<Layout> {
    let [low, high] = area(size_mm);
    let extent = settings.extent_mm();
    let room = high - low - DVec2::new(SIDE_MM, RULER_STRIP_MM);
    let fits = extent.cmple(room).all();
    fits.then(|| {
        let side = high.x - SIDE_MM + BORDER_MM;
        Layout {
            size_mm,
            centre: low + DVec2::new(0.5 * (room.x - BORDER_MM).max(extent.x), 0.5 * extent.y),
            rulers: [DVec2::new(low.x, high.y), DVec2::new(side, high.y)],
            notes: (DVec2::new(side, low.y), high.x - side),
        }
    })
}

fn does_not_fit(settings: &CharucoSettings) -> Error {
    let extent = settings.extent_mm();
    let fits = |square_mm, paper| {
        let other = CharucoSettings {
            square_mm,
            paper,
            ..settings.clone()
        };
        layout(&other).is_some()
    };
    let smaller = (1..200).map(|k| settings.square_mm - 0.5 * f64::from(k));
    let mut smaller = smaller.take_while(|s| *s > 5.0);
    let square_mm = smaller.find(|s| fits(*s, settings.paper));
    let mut papers = Paper::ALL.into_iter();
    let paper = papers.find(|paper| fits(settings.square_mm, *paper));
    let remedies = [
        square_mm.map(|mm| format!("squares of {mm} mm fit on {}", settings.paper)),
        paper.map(|paper| format!("{paper} is large enough")),
    ];
    let remedies: Vec<String> = remedies.into_iter().flatten().collect();
    let remedy = if remedies.is_empty() {
        "choose fewer squares".to_owned()
    } else {
        remedies.join("; ")
    };
    Error::input(format!(
        "the squares cover {} × {} mm, which does not fit on {} beside the rulers",
        extent.x, extent.y, settings.paper
    ))
    .remedy(remedy)
}

fn draw(
    settings: &CharucoSettings,
    chessboard: &Chessboard,
    board: &Board,
    layout: &Layout,
) -> Drawing {
    let hash = board.hash();
    let mut drawing = Drawing::new(layout.size_mm, &format!("{} {hash}", board.name));
    let on_sheet = |point_m: DVec2| layout.centre + 1e3 * DVec2::new(point_m.x, -point_m.y);
    for [top_left, ..] in chessboard.black_squares_m() {
        let at = on_sheet(top_left);
        let side = settings.square_mm;
        drawing.shapes.push(Shape::Marker {
            outer: [at.x, at.y, side, side],
            holes: Vec::new(),
        });
    }
    for marker in &board.markers {
        if let Some(cells) = settings.dictionary.marker(marker.id) {
            let corner = on_sheet(marker.corners_m[0].truncate());
            drawing.marker(&settings.dictionary, &cells, corner, settings.marker_mm);
        }
    }
    let [along, up] = layout.rulers;
    ruler(&mut drawing, along, false);
    ruler(&mut drawing, up, true);
    let [columns, rows] = settings.squares;
    let ids = board.ids();
    let legacy = if settings.legacy { ", legacy" } else { "" };
    let lines = [
        format!(
            "chessboard {}, hash {hash}, {columns} x {rows} squares of {} mm{legacy}, {}, ids \
             {}-{}, markers {} mm, {}",
            board.name,
            settings.square_mm,
            board.dictionary,
            ids.first().copied().unwrap_or_default(),
            ids.last().copied().unwrap_or_default(),
            (1e4 * settings.marker_mm).round() / 1e4,
            settings.paper,
        ),
        "print at 100 %: both rulers must measure 100 mm, else give --measured-mm X,Y".to_owned(),
    ];
    let (corner, width) = layout.notes;
    notes(&mut drawing, corner, width, &lines);
    drawing
}

#[cfg(test)]
mod tests {
    use super::super::png::raster;
    use super::*;
    use crate::MarkerDetector as _;
    use crate::calibrate::{BoardPoint, PointFinder};
    use crate::detect::{ApriltagDetector, ApriltagSettings};

    fn settings(squares: [u32; 2], square_mm: f64, paper: Paper) -> CharucoSettings {
        CharucoSettings {
            name: "c".into(),
            dictionary: Dictionary::by_name("DICT_6X6_250").unwrap(),
            first_id: 10,
            squares,
            square_mm,
            marker_mm: 0.7 * square_mm,
            legacy: false,
            paper,
            measured_mm: [100.0; 2],
        }
    }

    #[test]
    fn rastered_sheet_is_detected() {
        for (squares, square_mm) in [([8, 6], 30.0), ([5, 7], 30.0), ([4, 4], 30.0)] {
            let sheet = charuco_sheet(&settings(squares, square_mm, Paper::A4)).unwrap();
            let dpi = 100.0;
            // Like a camera: blurred, in sRGB levels.
            let mut image = image::imageops::blur(&raster(&sheet.drawing, dpi).unwrap(), 0.7);
            for level in image.iter_mut() {
                *level = gripcast_imaging::srgb_encode(f32::from(*level) / 255.0);
            }
            let ids = sheet.file.board.ids();
            let mut detector =
                ApriltagDetector::new(&sheet.file.dictionary, &ids, ApriltagSettings::default())
                    .unwrap();
            let detections = detector.detect(&image).unwrap();
            let finder = PointFinder::new(&sheet.file).unwrap();
            let found = finder.find(&image, &detections);
            assert_eq!(
                (found.markers, found.points.len()),
                (
                    ids.len(),
                    sheet.file.chessboard.as_ref().unwrap().corner_count()
                )
            );
            let layout = layout(&settings(squares, square_mm, Paper::A4)).unwrap();
            let on_image = |point: &BoardPoint| {
                let mm = 1e3 * point.point_m.truncate();
                (layout.centre + DVec2::new(mm.x, -mm.y)) * dpi / 25.4 - 0.5
            };
            let error = |point: &BoardPoint| point.pixel.distance(on_image(point));
            let max_error = found.points.iter().map(error).fold(0.0, f64::max);
            // Measured: 0.053 to 0.065 px.
            assert!(max_error < 0.075, "{max_error}");
        }
    }

    #[test]
    fn shapes_are_on_the_paper_and_do_not_overlap() {
        for (squares, square_mm, paper) in [
            ([8, 6], 30.0, Paper::A4),
            ([5, 7], 34.0, Paper::A4),
            ([9, 6], 40.0, Paper::A3),
            ([8, 6], 28.0, Paper::Letter),
        ] {
            let sheet = charuco_sheet(&settings(squares, square_mm, paper)).unwrap();
            let page = DVec2::from_array(sheet.drawing.size_mm) - MARGIN_MM + 1e-9;
            let squares: Vec<[f64; 4]> = sheet.drawing.markers().collect();
            let is_clear = |low: DVec2, high: DVec2| {
                squares.iter().all(|[x, y, w, h]| {
                    high.x < x - 0.5
                        || low.x > x + w + 0.5
                        || high.y < y - 0.5
                        || low.y > y + h + 0.5
                })
            };
            for shape in &sheet.drawing.shapes {
                let (low, high) = match shape {
                    Shape::Marker { outer, .. } => {
                        let low = DVec2::new(outer[0], outer[1]);
                        (low, low + DVec2::new(outer[2], outer[3]))
                    }
                    Shape::Line { points, .. } => {
                        let (a, b) = (points[0], points[points.len() - 1]);
                        assert!(is_clear(a.min(b), a.max(b)), "{shape:?}");
                        (a.min(b), a.max(b))
                    }
                    Shape::Text {
                        at, size_mm, text, ..
                    } => {
                        let width = 0.56 * size_mm * text.len() as f64;
                        let (low, high) = (
                            *at - DVec2::new(0.0, *size_mm),
                            *at + DVec2::new(width, 0.5),
                        );
                        assert!(is_clear(low, high), "{shape:?}");
                        (low, high)
                    }
                };
                assert!(low.min_element() >= MARGIN_MM - 1e-9, "{paper}: {shape:?}");
                assert!(
                    high.x <= page.x && high.y <= page.y + 0.5,
                    "{paper}: {shape:?}"
                );
            }
        }
    }

    #[test]
    fn printer_scale_changes_the_board_only() {
        let nominal = charuco_sheet(&settings([5, 7], 30.0, Paper::A4)).unwrap();
        let measured = CharucoSettings {
            measured_mm: [99.0, 101.0],
            ..settings([5, 7], 30.0, Paper::A4)
        };
        let scaled = charuco_sheet(&measured).unwrap();
        assert_eq!(nominal.drawing, scaled.drawing);
        assert_eq!(nominal.printed_hash, scaled.printed_hash);
        let chessboard = scaled.file.chessboard.unwrap();
        assert_eq!(chessboard.square_mm, [29.7, 30.3]);
        assert_eq!(chessboard.printed_hash, Some(nominal.file.board.hash()));
    }

    #[test]
    fn sizes_that_fit_are_named() {
        let error_of = |squares, square_mm, paper| {
            let error = charuco_sheet(&settings(squares, square_mm, paper)).unwrap_err();
            error.to_string()
        };
        let text = error_of([8, 6], 40.0, Paper::A4);
        assert!(
            text.contains("320 × 240 mm") && text.contains("A3 is large enough"),
            "{text}"
        );
        assert!(text.contains("squares of 30.5 mm fit on A4"), "{text}");
        assert!(error_of([30, 30], 30.0, Paper::A4).contains("ends with id 249"));
    }
}
