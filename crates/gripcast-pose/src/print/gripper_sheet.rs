//! Sheet of the gripper's tags, to cut out and fold.

use glam::DVec2;

use super::drawing::{Drawing, TextAnchor};
use super::gripper_board::{GripperTags, fold_rad, gripper_board};
use super::notes::{LABEL_MM, MARGIN_MM, footer};
use super::paper::Paper;
use gripcast_base::error::Result;

/// Width of a glue tab, mm.
const TAB_MM: f64 = 8.0;
/// Distance between cards, mm.
const GAP_MM: f64 = 12.0;

/// Draws the tags of a gripper in portrait: the roof as a strip to fold into a prism of the
/// correct angle, two cards for the rail's ends, and a flag for each finger. Solid lines are cut,
/// dashed lines folded.
///
/// # Errors
/// Those of [`gripper_board`].
pub fn gripper_sheet(tags: &GripperTags, paper: Paper) -> Result<Drawing> {
    let nominal = GripperTags {
        measured_mm: [super::RULER_MM; 2],
        ..tags.clone()
    };
    let board = gripper_board(&nominal)?.board;
    let title = format!("{} {}", board.name, board.hash());
    let mut sheet = TagSheet {
        drawing: Drawing::new(paper.portrait_mm(), &title),
        tags,
    };
    let body = tags.card_mm(tags.body_m);
    let finger = tags.card_mm(tags.finger_m);
    let left = MARGIN_MM + 14.0;
    let mut at = DVec2::new(left, MARGIN_MM + 6.0);
    let [plus, minus] = [1, 0].map(|k| tags.first_id + k);
    let roof = format!(
        "{plus} (+x) and {minus} (-x), on top of the camera: fold backwards to a prism, glue the \
         tab inside"
    );
    sheet.label(at, &roof);
    sheet.roof(at, body);
    at.y += body + GAP_MM;
    sheet.label(at, "in front of the rail's ends");
    for k in [0, 1] {
        let corner = at + DVec2::new(f64::from(k) * (body + GAP_MM), 0.0);
        sheet.card(corner, body, tags.body_m, 2 + k);
    }
    at.y += body + GAP_MM;
    sheet.label(
        at,
        "flags at the fingers' plates: fold the tab backwards, glue it to the outer side",
    );
    // From the front, the left finger (−x) is on the right, with its tab left of its flag.
    sheet.flag(at, finger, 4, true);
    sheet.flag(
        at + DVec2::new(2.0 * finger + GAP_MM, 0.0),
        finger,
        5,
        false,
    );
    let mut drawing = sheet.drawing;
    let lines = [
        format!(
            "gripper tags {}, hash {}, {}, {}",
            board.name,
            board.hash(),
            board.dictionary,
            paper
        ),
        "cut solid lines, fold dashed lines".to_owned(),
        "print at 100 %: both rulers must measure 100 mm, else give --measured-mm X,Y".to_owned(),
    ];
    footer(&mut drawing, DVec2::new(16.0, -2.0), &lines);
    Ok(drawing)
}

struct TagSheet<'a> {
    drawing: Drawing,
    tags: &'a GripperTags,
}

impl TagSheet<'_> {
    fn label(&mut self, at: DVec2, text: &str) {
        let above = at - DVec2::new(0.0, 2.0);
        self.drawing.text(above, LABEL_MM, TextAnchor::Start, text);
    }

    /// A strip of two faces, the prism's back and a tab. From the front, the −x face is on the
    /// right.
    fn roof(&mut self, at: DVec2, card: f64) {
        let back = 2.0 * card * (0.5 * (std::f64::consts::PI - fold_rad())).sin();
        let folds = [card, 2.0 * card, 2.0 * card + back];
        self.outline(at, DVec2::new(folds[2] + TAB_MM, card));
        for x in folds {
            self.fold(at + DVec2::new(x, 0.0), card);
        }
        self.marker(at, card, self.tags.body_m, 1);
        self.marker(at + DVec2::new(card, 0.0), card, self.tags.body_m, 0);
        let middle = at + DVec2::new(2.0 * card + 0.5 * back, 0.5 * card);
        self.drawing
            .text(middle, LABEL_MM, TextAnchor::Middle, "back");
    }

    fn card(&mut self, at: DVec2, card: f64, side_m: f64, number: u32) {
        self.outline(at, DVec2::splat(card));
        self.marker(at, card, side_m, number);
        let side = if number.is_multiple_of(2) { "-x" } else { "+x" };
        self.number(at, card, number, side);
    }

    fn flag(&mut self, at: DVec2, card: f64, number: u32, tab_at_left: bool) {
        let (tab, face) = if tab_at_left {
            (at, at + DVec2::new(TAB_MM, 0.0))
        } else {
            (at + DVec2::new(card, 0.0), at)
        };
        self.outline(at, DVec2::new(card + TAB_MM, card));
        self.fold(if tab_at_left { face } else { tab }, card);
        self.marker(face, card, self.tags.finger_m, number);
        let side = if number.is_multiple_of(2) {
            "left, -x"
        } else {
            "right, +x"
        };
        self.number(face, card, number, side);
    }

    /// Label with id and position below a card.
    fn number(&mut self, at: DVec2, card: f64, number: u32, position: &str) {
        let below = at + DVec2::new(0.5 * card, card + 1.3 * LABEL_MM);
        let text = format!("{} ({position})", self.tags.first_id + number);
        self.drawing
            .text(below, LABEL_MM, TextAnchor::Middle, &text);
    }

    fn marker(&mut self, at: DVec2, card: f64, side_m: f64, number: u32) {
        let side = 1e3 * side_m;
        let corner = at + 0.5 * (card - side);
        let dictionary = &self.tags.dictionary;
        if let Some(cells) = dictionary.marker(self.tags.first_id + number) {
            self.drawing.marker(dictionary, &cells, corner, side);
        }
    }

    /// Cutting line.
    fn outline(&mut self, at: DVec2, size: DVec2) {
        let corners = [
            at,
            at + DVec2::new(size.x, 0.0),
            at + size,
            at + DVec2::new(0.0, size.y),
        ];
        for k in 0..4 {
            self.drawing.thin_line(corners[k], corners[(k + 1) % 4]);
        }
    }

    fn fold(&mut self, top: DVec2, length: f64) {
        let bottom = top + DVec2::new(0.0, length);
        self.drawing.dashed_line(vec![top, bottom], false);
    }
}

#[cfg(test)]
mod tests {
    use super::super::drawing::Shape;
    use super::super::layout::is_outside_quiet_zones;
    use super::*;
    use crate::Dictionary;

    fn tags(dictionary: &str) -> GripperTags {
        GripperTags {
            name: "g".into(),
            dictionary: Dictionary::by_name(dictionary).unwrap(),
            first_id: 40,
            body_m: 0.03,
            finger_m: 0.018,
            measured_mm: [100.0; 2],
        }
    }

    #[test]
    fn shapes_fit_on_all_papers_outside_the_quiet_zones() {
        for paper in Paper::ALL {
            for dictionary in ["DICT_4X4_50", "36h11"] {
                let tags = tags(dictionary);
                let sheet = gripper_sheet(&tags, paper).unwrap();
                assert_eq!(sheet.markers().count(), 6);
                let [width, height] = paper.portrait_mm();
                for shape in &sheet.shapes {
                    let (low, high) = match shape {
                        Shape::Marker { outer, .. } => {
                            let low = DVec2::new(outer[0], outer[1]);
                            (low, low + DVec2::new(outer[2], outer[3]))
                        }
                        Shape::Line { points, .. } => {
                            let (low, high) = (points[0].min(points[1]), points[0].max(points[1]));
                            let cell = 30.0 / tags.dictionary.cells_per_side() as f64;
                            let of = |m: [f64; 4]| m[2] / 30.0 * cell;
                            for marker in sheet.markers() {
                                let mut one = Drawing::new([width, height], "");
                                one.shapes.push(Shape::Marker {
                                    outer: marker,
                                    holes: Vec::new(),
                                });
                                assert!(
                                    is_outside_quiet_zones(&one, low, high, of(marker)),
                                    "{shape:?}"
                                );
                            }
                            (low, high)
                        }
                        Shape::Text { at, .. } => (*at, *at),
                    };
                    assert!(low.min_element() >= MARGIN_MM - 1e-9, "{paper}: {shape:?}");
                    let page = DVec2::new(width, height) - MARGIN_MM + 1e-9;
                    assert!(high.cmple(page).all(), "{paper}: {shape:?}");
                }
            }
        }
    }

    #[test]
    fn prism_has_the_angle_of_the_faces() {
        let tags = tags("DICT_6X6_250");
        let sheet = gripper_sheet(&tags, Paper::A4).unwrap();
        // The first lines are the roof's outline and its three folds.
        let lines = sheet.shapes.iter().filter_map(|shape| match shape {
            Shape::Line {
                points, dash_mm, ..
            } => Some((points[0].x, dash_mm.is_some())),
            _ => None,
        });
        let lines: Vec<(f64, bool)> = lines.collect();
        let left = lines[0].0;
        let folds: Vec<f64> = lines.iter().filter(|l| l.1).map(|l| l.0 - left).collect();
        let (card, back) = (folds[0], folds[2] - folds[1]);
        assert!((folds[1] - 2.0 * card).abs() < 1e-9);
        // Apex angle of the triangle of two faces and the back.
        let apex = (1.0 - back * back / (2.0 * card * card)).acos();
        let board = gripper_board(&tags).unwrap().board;
        let normal = |k: usize| board.markers[k].normal();
        let between = normal(0).angle_between(normal(1));
        assert!((apex + between - std::f64::consts::PI).abs() < 1e-9);
        assert!((card - tags.card_mm(tags.body_m)).abs() < 1e-9);
    }
}
