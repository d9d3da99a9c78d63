//! Layout checks for tests: charts are well-formed, within their size, and texts do not overlap.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use super::text::{NORMAL, SMALL, width};

/// Returns the start tags in order and checks that each is closed.
///
/// # Panics
/// If one is not.
pub fn tags(svg: &str) -> Vec<&str> {
    let (mut open, mut all) = (Vec::new(), Vec::new());
    for part in svg.split('<').skip(1) {
        let (tag, _) = part.split_once('>').expect("a tag bounds");
        if let Some(name) = tag.strip_prefix('/') {
            assert_eq!(open.pop(), Some(name), "unexpected end tag");
            continue;
        }
        assert_eq!(tag.matches('"').count() % 2, 0, "{tag}");
        all.push(tag);
        if !tag.ends_with('/') {
            open.push(tag.split(' ').next().unwrap());
        }
    }
    assert!(open.is_empty(), "{open:?}");
    all
}

fn attribute<'a>(tag: &'a str, name: &str) -> Option<&'a str> {
    let (_, rest) = tag.split_once(&format!(" {name}=\""))?;
    rest.split('"').next()
}

/// Returns a numeric attribute.
///
/// # Panics
/// If it is missing or not a number.
pub fn number(tag: &str, name: &str) -> f64 {
    attribute(tag, name).unwrap().parse().unwrap()
}

/// Left, top, right and bottom of a text, and its content.
struct TextBox {
    bounds: [f64; 4],
    text: String,
}

fn text_boxes(svg: &str) -> Vec<TextBox> {
    let parts = svg.split("<text").skip(1);
    let texts = parts.map(|part| {
        let (tag, rest) = part.split_once('>').unwrap();
        (tag, rest.split('<').next().unwrap())
    });
    texts
        .filter(|(_, text)| !text.is_empty())
        .map(|(tag, text)| TextBox {
            bounds: text_bounds(tag, text),
            text: text.to_owned(),
        })
        .collect()
}

fn text_bounds(tag: &str, text: &str) -> [f64; 4] {
    let is_small = attribute(tag, "class").is_some_and(|class| class.contains("small"));
    let size = if is_small { SMALL } else { NORMAL };
    let text = text.replace("&lt;", "<").replace("&gt;", ">");
    let along = width(&text, size);
    let before = match attribute(tag, "text-anchor").unwrap() {
        "start" => 0.0,
        "middle" => 0.5 * along,
        _ => along,
    };
    let (above, below) = (0.75 * size, 0.22 * size);
    if let Some(transform) = attribute(tag, "transform") {
        let inner = transform.strip_prefix("translate(").unwrap();
        let (position, _) = inner.split_once(')').unwrap();
        let (x, y) = position.split_once(' ').unwrap();
        let [x, y] = [x, y].map(|v| v.parse::<f64>().unwrap());
        return [x - above, y + before - along, x + below, y + before];
    }
    let [x, y] = ["x", "y"].map(|name| number(tag, name));
    [x - before, y - above, x - before + along, y + below]
}

/// Returns the contents of all texts.
pub fn texts(svg: &str) -> Vec<String> {
    text_boxes(svg)
        .into_iter()
        .map(|text_box| text_box.text)
        .collect()
}

/// Checks that a chart is well-formed, within its size, and that no texts overlap.
///
/// # Panics
/// If not.
pub fn check(svg: &str) {
    let tags = tags(svg);
    let [page, title, desc, ..] = tags[..] else {
        panic!("too few tags");
    };
    assert!(page.starts_with("svg ") && [title, desc] == ["title", "desc"]);
    for invalid in ["NaN", "inf", "<b>"] {
        assert!(!svg.contains(invalid), "{invalid}");
    }
    assert!(!svg.contains("=\"\""), "an attribute without a value");
    let [right, bottom] = ["width", "height"].map(|name| number(page, name));
    let text_boxes = text_boxes(svg);
    for (i, text_box) in text_boxes.iter().enumerate() {
        let [x1, y1, x2, y2] = text_box.bounds;
        let inside = x1 >= 0.0 && y1 >= 0.0 && x2 <= right && y2 <= bottom;
        assert!(
            inside,
            "{} {:?} leaves {right}×{bottom}",
            text_box.text, text_box.bounds
        );
        for other in text_boxes.iter().skip(i + 1) {
            let [ox1, oy1, ox2, oy2] = other.bounds;
            let apart = x2 <= ox1 || ox2 <= x1 || y2 <= oy1 || oy2 <= y1;
            assert!(
                apart,
                "{} {:?} on {} {:?}",
                text_box.text, text_box.bounds, other.text, other.bounds
            );
        }
    }
}

#[cfg(test)]
#[test]
fn overlapping_texts_are_detected() {
    let svg = |y: f64| {
        format!(
            "<svg width=\"99\" height=\"99\"><title></title><desc></desc>\
             <text x=\"1\" y=\"20\" text-anchor=\"start\">one</text>\
             <text x=\"9\" y=\"{y}\" text-anchor=\"start\">two</text></svg>"
        )
    };
    check(&svg(40.0));
    assert!(std::panic::catch_unwind(|| check(&svg(25.0))).is_err());
    assert!(std::panic::catch_unwind(|| check(&svg(99.0))).is_err());
}
