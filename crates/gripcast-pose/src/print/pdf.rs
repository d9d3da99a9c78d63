//! PDF output.

use glam::DVec2;
use pdf_writer::{Content, Finish as _, Name, Pdf, Rect, Ref, Str, TextStr};

use super::drawing::{Drawing, Shape, TextAnchor};

/// Points (1/72 in) per millimetre.
const POINTS_PER_MM: f64 = 72.0 / 25.4;
/// Width of Helvetica's digits, relative to the font size.
const LETTER: f64 = 0.556;

/// Writes a drawing as PDF with the standard font Helvetica and print scaling off.
pub fn pdf(drawing: &Drawing) -> Vec<u8> {
    let [catalog, pages, page, font, content, info] = [1, 2, 3, 4, 5, 6].map(Ref::new);
    let [width, height] = drawing.size_mm.map(|mm| (mm * POINTS_PER_MM) as f32);
    let mut file = Pdf::new();
    let mut root = file.catalog(catalog);
    root.pages(pages);
    root.viewer_preferences()
        .pair(Name(b"PrintScaling"), Name(b"None"));
    root.finish();
    file.document_info(info).title(TextStr(&drawing.title));
    file.pages(pages).kids([page]).count(1);
    let mut sheet = file.page(page);
    sheet.media_box(Rect::new(0.0, 0.0, width, height));
    sheet.parent(pages);
    sheet.contents(content);
    sheet.resources().fonts().pair(Name(b"F"), font);
    sheet.finish();
    file.type1_font(font).base_font(Name(b"Helvetica"));
    file.stream(content, &stream(drawing, height));
    file.finish()
}

/// The page's content stream, in mm with y down after the first transform.
fn stream(drawing: &Drawing, height: f32) -> Vec<u8> {
    let scale = POINTS_PER_MM as f32;
    let mut out = Content::new();
    out.transform([scale, 0.0, 0.0, -scale, 0.0, height]);
    for shape in &drawing.shapes {
        push(&mut out, shape);
    }
    out.finish().to_vec()
}

fn push(out: &mut Content, shape: &Shape) {
    match shape {
        Shape::Marker { outer, holes } => {
            out.set_fill_gray(0.0);
            for [x, y, width, height] in std::iter::once(outer).chain(holes) {
                let [x, y, width, height] = [x, y, width, height].map(|v| *v as f32);
                out.rect(x, y, width, height);
            }
            // A single path avoids seams between cells.
            out.fill_even_odd();
        }
        Shape::Line {
            points,
            closed,
            width_mm,
            dash_mm,
            colour,
        } => {
            let [r, g, b] = colour.map(|c| f32::from(c) / 255.0);
            out.set_stroke_rgb(r, g, b);
            out.set_line_width(*width_mm as f32);
            let dash = dash_mm.map(|lengths| lengths.map(|mm| mm as f32));
            out.set_dash_pattern(dash.iter().flatten().copied(), 0.0);
            polyline(out, points);
            if *closed {
                out.close_path();
            }
            out.stroke();
        }
        Shape::Text {
            at,
            size_mm,
            anchor,
            text,
        } => {
            let shift = match anchor {
                TextAnchor::Start => 0.0,
                TextAnchor::Middle => 0.5 * LETTER * size_mm * text.len() as f64,
            };
            out.set_fill_gray(0.0);
            out.begin_text();
            out.set_font(Name(b"F"), *size_mm as f32);
            let [x, y] = [at.x - shift, at.y].map(|v| v as f32);
            out.set_text_matrix([1.0, 0.0, 0.0, -1.0, x, y]);
            out.show(Str(text.as_bytes()));
            out.end_text();
        }
    }
}

fn polyline(out: &mut Content, points: &[DVec2]) {
    for (k, point) in points.iter().enumerate() {
        let [x, y] = point.to_array().map(|v| v as f32);
        if k == 0 {
            out.move_to(x, y);
        } else {
            out.line_to(x, y);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn page_and_lines_are_to_scale() {
        let mut drawing = Drawing::new([297.0, 210.0], "t");
        drawing.thin_line(DVec2::new(12.5, 20.0), DVec2::new(112.5, 20.0));
        drawing.text(DVec2::new(20.0, 30.0), 3.0, TextAnchor::Middle, "(100 mm)");
        let bytes = pdf(&drawing);
        let text = String::from_utf8_lossy(&bytes);
        let numbers = |line: &str| -> Vec<f64> {
            let words = line.split([' ', '[', ']']);
            words.filter_map(|word| word.parse().ok()).collect()
        };
        let line = |end: &str| text.lines().find(|l| l.ends_with(end)).unwrap();
        let media = text.lines().find(|l| l.contains("/MediaBox")).unwrap();
        let size = numbers(media);
        assert!((size[2] - 297.0 * POINTS_PER_MM).abs() < 1e-4, "{media}");
        assert!((size[3] - 210.0 * POINTS_PER_MM).abs() < 1e-4, "{media}");
        // 100 mm are 283.4646 points.
        let transform = numbers(line(" cm"));
        assert!((100.0 * transform[0] - 283.464_566_9).abs() < 1e-4);
        assert!((100.0 * transform[3] + 283.464_566_9).abs() < 1e-4);
        assert_eq!(numbers(line(" m")), [12.5, 20.0]);
        assert_eq!(numbers(line(" l")), [112.5, 20.0]);
        assert!(text.contains("/PrintScaling /None") && text.contains("/Helvetica"));
        assert!(
            text.contains("\\(100 mm\\)") || text.contains("((100 mm)) Tj"),
            "{text}"
        );
    }
}
