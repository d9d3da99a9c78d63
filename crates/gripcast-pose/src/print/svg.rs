//! SVG output.

use std::fmt::Write as _;

use glam::DVec2;

use super::drawing::{Drawing, Shape, TextAnchor};

/// Writes a drawing as SVG; one user unit is one millimetre.
pub fn svg(drawing: &Drawing) -> String {
    let [width, height] = drawing.size_mm.map(number);
    let mut out = format!(
        "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n\
         <svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}mm\" height=\"{height}mm\" \
         viewBox=\"0 0 {width} {height}\">\n<title>{}</title>\n\
         <rect width=\"{width}\" height=\"{height}\" fill=\"#fff\"/>\n",
        escaped(&drawing.title)
    );
    for shape in &drawing.shapes {
        push(&mut out, shape);
    }
    out + "</svg>\n"
}

fn push(out: &mut String, shape: &Shape) {
    match shape {
        Shape::Marker { outer, holes } => {
            let path: String = std::iter::once(outer).chain(holes).map(rectangle).collect();
            // A single path avoids seams between cells.
            let _ = writeln!(out, "<path fill-rule=\"evenodd\" d=\"{path}\"/>");
        }
        Shape::Line {
            points,
            closed,
            width_mm,
            dash_mm,
            colour: [r, g, b],
        } => {
            let dash = dash_mm.map_or(String::new(), |[on, off]| {
                format!(" stroke-dasharray=\"{} {}\"", number(on), number(off))
            });
            let end = if *closed { "Z" } else { "" };
            let _ = writeln!(
                out,
                "<path fill=\"none\" stroke=\"#{r:02x}{g:02x}{b:02x}\" stroke-width=\"{}\"{dash} \
                 d=\"{}{end}\"/>",
                number(*width_mm),
                polyline(points)
            );
        }
        Shape::Text {
            at,
            size_mm,
            anchor,
            text,
        } => {
            let anchor = match anchor {
                TextAnchor::Start => "start",
                TextAnchor::Middle => "middle",
            };
            let _ = writeln!(
                out,
                "<text x=\"{}\" y=\"{}\" font-family=\"Helvetica, Arial, sans-serif\" \
                 font-size=\"{}\" text-anchor=\"{anchor}\">{}</text>",
                number(at.x),
                number(at.y),
                number(*size_mm),
                escaped(text)
            );
        }
    }
}

fn rectangle([x, y, width, height]: &[f64; 4]) -> String {
    let [x, y, right, bottom] = [*x, *y, x + width, y + height].map(number);
    format!("M{x} {y}H{right}V{bottom}H{x}Z")
}

fn polyline(points: &[DVec2]) -> String {
    let positions: Vec<String> = points
        .iter()
        .map(|p| format!("{} {}", number(p.x), number(p.y)))
        .collect();
    format!("M{}", positions.join("L"))
}

/// Millimetres, rounded to 0.1 µm.
fn number(value: f64) -> String {
    let rounded = (value * 1e4).round() / 1e4;
    format!("{}", rounded + 0.0)
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Dictionary;

    #[test]
    fn user_units_are_millimetres() {
        let mut drawing = Drawing::new([210.0, 297.0], "a <b> & ü");
        drawing.thin_line(DVec2::new(10.0, 20.0), DVec2::new(110.0, 20.0));
        drawing.dashed_line(vec![DVec2::ZERO, DVec2::X, DVec2::Y], true);
        drawing.text(DVec2::ONE, 3.0, TextAnchor::Middle, "100 mm < 1 m");
        let text = svg(&drawing);
        assert!(text.contains("width=\"210mm\" height=\"297mm\" viewBox=\"0 0 210 297\""));
        assert!(text.contains("d=\"M10 20L110 20\""), "{text}");
        assert!(text.contains("stroke-dasharray=\"2 1.5\" d=\"M0 0L1 0L0 1Z\""));
        assert!(text.contains("<title>a &lt;b&gt; &amp; ?</title>"));
        assert!(text.contains(">100 mm &lt; 1 m</text>"));
    }

    #[test]
    fn marker_is_a_single_path_with_holes() {
        let dictionary = Dictionary::by_name("DICT_4X4_50").unwrap();
        let mut drawing = Drawing::new([100.0, 100.0], "m");
        let cells = dictionary.marker(0).unwrap();
        drawing.marker(&dictionary, &cells, DVec2::new(10.0, 20.0), 30.0);
        let text = svg(&drawing);
        // Rows of id 0: 1011 0101 0011 0010; cells of 5 mm.
        assert!(
            text.contains("M10 20H40V50H10ZM15 25H20V30H15ZM25 25H35V30H25Z"),
            "{text}"
        );
    }
}
