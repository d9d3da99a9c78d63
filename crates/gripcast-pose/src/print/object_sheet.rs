//! Sheet of markers that an object is placed on.

use glam::{DVec2, DVec3};

use super::contour::{Outline, section, simplify};
use super::drawing::{BLACK, Colour, Drawing, Shape, TextAnchor};
use super::layout::{Layout, MarkerSize, is_outside_quiet_zones, layout};
use super::notes::{LABEL_MM, footer};
use super::paper::Paper;
use super::silhouette::Silhouette;
use super::{RULER_MM, check_ruler_lengths};
use crate::{Board, BoardFile, BoardMarker, Body, Dictionary, PrintedSheet};
use gripcast_base::error::{Error, Result};
use gripcast_geometry::{Pose, TriangleMesh};

/// Height of the section drawn as the bottom, m: above rounded edges of scanned and printed
/// objects.
const SECTION_M: f64 = 0.3e-3;
/// Maximum distance of an object's lowest point from the sheet, m.
const ON_SHEET_M: f64 = 1e-4;
/// Width of the bottom's outline, mm.
const CONTOUR_MM: f64 = 0.35;
/// Length of a drawn axis, mm.
const AXIS_MM: f64 = 20.0;
/// Names and colours of the axes.
const AXES: [(&str, Colour); 3] = [
    ("x", [190, 20, 20]),
    ("y", [20, 120, 20]),
    ("z", [30, 30, 190]),
];

/// The object of a sheet.
#[derive(Clone, Debug)]
pub struct SheetObject<'a> {
    /// Mesh, m; its frame is the frame of the board.
    pub mesh: &'a TriangleMesh,
    /// Source of the mesh, recorded in the board file.
    pub source: &'a str,
    /// Stable pose of the object on the sheet (z = 0, z up, x to the right).
    pub t_world_object: Pose,
}

/// Settings of an object sheet.
#[derive(Clone, Debug)]
pub struct SheetSettings {
    /// Name of the board.
    pub name: String,
    /// Dictionary of the markers.
    pub dictionary: Dictionary,
    /// Id of the first marker.
    pub first_id: u32,
    /// Side of a marker, m.
    pub marker_m: f64,
    /// Paper.
    pub paper: Paper,
    /// Measured lengths of the 100 mm rulers on the printed sheet, x and y, mm. They scale the
    /// board, not the drawing.
    pub measured_mm: [f64; 2],
}

/// Draws the sheet of an object with 30 mm markers of `DICT_6X6_250`, on A4 if it fits, else A3.
///
/// # Errors
/// Those of [`object_sheet`] on A3.
pub fn default_object_sheet(name: &str, object: &SheetObject<'_>) -> Result<ObjectSheet> {
    let on = |paper: Paper| {
        let settings = SheetSettings {
            name: name.to_owned(),
            dictionary: Dictionary::by_name("DICT_6X6_250")?,
            first_id: 0,
            marker_m: 0.030,
            paper,
            measured_mm: [RULER_MM; 2],
        };
        object_sheet(object, &settings)
    };
    on(Paper::A4).or_else(|_| on(Paper::A3))
}

/// A sheet and its board.
#[derive(Clone, Debug)]
pub struct ObjectSheet {
    /// The drawing to print.
    pub drawing: Drawing,
    /// The board, in the object frame.
    pub file: BoardFile,
    /// Origin of the world frame on the drawing, mm.
    origin_mm: DVec2,
}

impl ObjectSheet {
    /// Maps a point of the drawing (mm), printed to scale, to the world frame (m).
    #[must_use]
    pub fn to_world(&self, drawn_mm: DVec2) -> DVec3 {
        let off = 1e-3 * (drawn_mm - self.origin_mm);
        DVec3::new(off.x, -off.y, 0.0)
    }
}

/// Draws the sheet of an object: a ring of markers around its silhouette (dashed), the outline of
/// its bottom (solid), the axes of its frame, rulers, and the board's hash.
///
/// The board frame is the frame of the mesh; (x, y) of the sheet, y up, is (x, y, 0) in the world
/// frame. The printer's scale is applied about the centre of the bottom's outline, to which the
/// object is aligned.
///
/// # Errors
/// `Input` if the object does not stand on the sheet, a size is implausible, ids are outside the
/// dictionary, or the object does not fit; the remedy then names a paper that is large enough.
pub fn object_sheet(object: &SheetObject<'_>, settings: &SheetSettings) -> Result<ObjectSheet> {
    check_ruler_lengths(settings.measured_mm)?;
    let t_world_object = object.t_world_object;
    let standing = object.mesh.transformed(&t_world_object);
    check_standing(&standing)?;
    let silhouette = Silhouette::new(&standing);
    let marker = MarkerSize {
        side: 1e3 * settings.marker_m,
        cell: 1e3 * settings.marker_m / settings.dictionary.cells_per_side() as f64,
    };
    crate::board_check::check_side(settings.marker_m)?;
    let layout = layout(settings.paper, marker, &silhouette)
        .ok_or_else(|| does_not_fit(settings.paper, marker, &silhouette))?;
    let ids = settings
        .dictionary
        .check_ids(settings.first_id, layout.corners.len());
    ids.map_err(|e| e.remedy("choose a smaller first id, larger markers or a larger dictionary"))?;
    let bottom: Vec<Outline> = section(&standing, SECTION_M)
        .iter()
        .map(millimetres)
        .map(|outline| simplify(&outline, 0.01))
        .collect();
    let placed = PlacedBoard {
        layout,
        marker,
        object_centre: 0.5 * (silhouette.low + silhouette.high),
        aligned_centre: centre(&bottom).unwrap_or(0.5 * (silhouette.low + silhouette.high)),
        t_world_object,
    };
    let nominal = placed.board(settings, [RULER_MM; 2]);
    let sheet = PrintedSheet {
        object: object.source.to_owned(),
        object_sha256: object.mesh.content_hash(),
        paper: settings.paper.name().to_owned(),
        printed_hash: nominal.hash(),
        measured_mm: settings.measured_mm,
        t_world_object,
    };
    let drawing = placed.draw(&nominal, settings, object, &silhouette, &bottom);
    let board = placed.board(settings, settings.measured_mm);
    let file = BoardFile::new(board, settings.dictionary.clone(), Some(sheet))?;
    Ok(ObjectSheet {
        drawing,
        file,
        origin_mm: placed.to_sheet(DVec2::ZERO),
    })
}

/// Checks that the object stands on the sheet.
fn check_standing(standing: &TriangleMesh) -> Result<()> {
    standing.validate()?;
    let lowest = standing.bounds().min.z;
    if lowest.abs() <= ON_SHEET_M {
        return Ok(());
    }
    let what = format!(
        "the object must stand on the sheet, its lowest point is at {:.3} mm",
        1e3 * lowest
    );
    Err(Error::input(what).remedy("give one of its stable poses"))
}

fn millimetres(outline: &Outline) -> Outline {
    Outline {
        points: outline.points.iter().map(|p| 1e3 * *p).collect(),
        closed: outline.closed,
    }
}

/// Centre of the bounding box of outlines.
fn centre(outlines: &[Outline]) -> Option<DVec2> {
    let points = || outlines.iter().flat_map(|o| &o.points).copied();
    let low = points().reduce(DVec2::min)?;
    let high = points().reduce(DVec2::max)?;
    Some(0.5 * (low + high))
}

fn does_not_fit(paper: Paper, marker: MarkerSize, silhouette: &Silhouette) -> Error {
    let size = silhouette.high - silhouette.low;
    let fits = |other: &Paper| layout(*other, marker, silhouette).is_some();
    let other = Paper::ALL.into_iter().find(fits);
    let remedy = other.map_or_else(
        || {
            "no paper is large enough: choose smaller markers, rotate the object, or choose \
             another stable pose"
                .to_owned()
        },
        |paper| format!("{paper} is large enough; smaller markers or a rotation may help as well"),
    );
    Error::input(format!(
        "the object covers {:.0} × {:.0} mm: no ring of {} mm markers fits around it on {paper}",
        size.x, size.y, marker.side
    ))
    .remedy(remedy)
}

/// Object and markers on the sheet.
struct PlacedBoard {
    layout: Layout,
    marker: MarkerSize,
    /// Point of the table at the layout's centre, mm.
    object_centre: DVec2,
    /// Fixed point of the printer's scale, mm.
    aligned_centre: DVec2,
    t_world_object: Pose,
}

impl PlacedBoard {
    /// Maps a point of the table to the sheet, mm.
    fn to_sheet(&self, table: DVec2) -> DVec2 {
        let off = table - self.object_centre;
        self.layout.centre + DVec2::new(off.x, -off.y)
    }

    /// Inverse of [`Self::to_sheet`].
    fn to_table(&self, sheet: DVec2) -> DVec2 {
        let off = sheet - self.layout.centre;
        self.object_centre + DVec2::new(off.x, -off.y)
    }

    fn board(&self, settings: &SheetSettings, measured_mm: [f64; 2]) -> Board {
        let scale = DVec2::from_array(measured_mm) / RULER_MM;
        let t_object_world = self.t_world_object.inverse();
        let to_object = |sheet: DVec2| {
            let drawn = self.to_table(sheet) - self.aligned_centre;
            let printed = self.aligned_centre + drawn * scale;
            t_object_world.transform_point(1e-3 * printed.extend(0.0))
        };
        let side = self.marker.side;
        let square = [
            DVec2::ZERO,
            DVec2::new(side, 0.0),
            DVec2::splat(side),
            DVec2::new(0.0, side),
        ];
        let marker = |(corner, id): (&DVec2, u32)| BoardMarker {
            id,
            body: Body::Object,
            corners_m: square.map(|off| to_object(*corner + off)),
        };
        let corners = self.layout.corners.iter();
        Board {
            name: settings.name.clone(),
            dictionary: settings.dictionary.name().to_owned(),
            markers: corners.zip(settings.first_id..).map(marker).collect(),
        }
    }

    fn draw(
        &self,
        board: &Board,
        settings: &SheetSettings,
        object: &SheetObject<'_>,
        silhouette: &Silhouette,
        bottom: &[Outline],
    ) -> Drawing {
        let title = format!("{} {}", board.name, board.hash());
        let mut drawing = Drawing::new(self.layout.size_mm, &title);
        self.draw_markers(&mut drawing, board, &settings.dictionary);
        for outline in silhouette.outlines() {
            drawing.dashed_line(self.on_sheet(&outline), true);
        }
        for outline in bottom {
            drawing.shapes.push(Shape::Line {
                points: self.on_sheet(outline),
                closed: outline.closed,
                width_mm: CONTOUR_MM,
                dash_mm: None,
                colour: BLACK,
            });
        }
        self.draw_axes(&mut drawing);
        self.draw_notes(&mut drawing, board, settings, object);
        drawing
    }

    fn on_sheet(&self, outline: &Outline) -> Vec<DVec2> {
        outline.points.iter().map(|p| self.to_sheet(*p)).collect()
    }

    fn draw_markers(&self, drawing: &mut Drawing, board: &Board, dictionary: &Dictionary) {
        let MarkerSize { side, cell } = self.marker;
        for (corner, marker) in self.layout.corners.iter().zip(&board.markers) {
            if let Some(cells) = dictionary.marker(marker.id) {
                drawing.marker(dictionary, &cells, *corner, side);
            }
            let below = *corner + DVec2::new(0.5 * side, side + cell + LABEL_MM);
            let number = marker.id.to_string();
            drawing.text(below, LABEL_MM, TextAnchor::Middle, &number);
        }
    }

    /// Origin and axes of the object frame from above, if they do not touch the markers.
    fn draw_axes(&self, drawing: &mut Drawing) {
        let origin = self.to_sheet(1e3 * self.t_world_object.translation_m.truncate());
        let half = DVec2::splat(AXIS_MM + 4.0);
        let [width, height] = drawing.size_mm;
        let page = DVec2::new(width, height);
        let is_inside = (origin - half).min_element() > 0.0 && (origin + half).cmplt(page).all();
        if !is_inside
            || !is_outside_quiet_zones(drawing, origin - half, origin + half, self.marker.cell)
        {
            return;
        }
        for arm in [DVec2::X, DVec2::Y] {
            drawing.thin_line(origin - 3.0 * arm, origin + 3.0 * arm);
        }
        let axes = [DVec3::X, DVec3::Y, DVec3::Z];
        for (axis, (name, colour)) in axes.into_iter().zip(AXES) {
            let direction = self.t_world_object.transform_vector(axis);
            let along = DVec2::new(direction.x, -direction.y);
            if along.length() < 0.2 {
                continue;
            }
            let tip = origin + AXIS_MM * along;
            let barb = along.normalize() * 2.0;
            drawing.line(vec![origin, tip], 0.4, colour);
            let side = barb.perp() * 0.5;
            drawing.line(vec![tip - barb + side, tip, tip - barb - side], 0.4, colour);
            let label = tip + barb + DVec2::new(0.0, 0.35 * LABEL_MM);
            drawing.text(label, LABEL_MM, TextAnchor::Middle, name);
        }
    }

    fn draw_notes(
        &self,
        drawing: &mut Drawing,
        board: &Board,
        settings: &SheetSettings,
        object: &SheetObject<'_>,
    ) {
        let ids = board.ids();
        let lines = [
            format!(
                "board {}, hash {}, {}, ids {}-{}, markers {} mm, {}",
                board.name,
                board.hash(),
                board.dictionary,
                ids.first().copied().unwrap_or_default(),
                ids.last().copied().unwrap_or_default(),
                (1e3 * settings.marker_m * 1e4).round() / 1e4,
                settings.paper,
            ),
            format!(
                "object {}: stand it on the solid line; dashed is all it covers",
                object.source
            ),
            "print at 100 %: both rulers must measure 100 mm, else give --measured-mm X,Y"
                .to_owned(),
        ];
        footer(drawing, DVec2::new(16.0, 1.0), &lines);
    }
}

#[cfg(test)]
#[path = "object_sheet_test.rs"]
mod tests;
