//! `gripcast render figure`: the renderers side by side.

use super::calibrate::rendered_presses;
use super::{png, refused, render, trace};
use crate::program::succeed;

#[test]
fn figure_has_three_rows_of_five_images() {
    let dir = tempfile::tempdir().unwrap();
    let presses = rendered_presses(dir.path());
    let out = dir.path().join("figure.png");
    let words = format!(
        "--presses {} --trace {} --spp 1 --out {}",
        presses.display(),
        trace().display(),
        out.display()
    );
    succeed(&mut render("figure", &words));
    let figure = png(out);
    let (width, height) = figure.dimensions();
    assert!(width > 5 * 320 && height > 3 * 240, "{width} x {height}");
    // The middle of every tile is an image, not the background of the sheet.
    for row in 0..3 {
        for column in 0..5 {
            let (x, y) = (
                width / 5 * column + width / 10,
                height / 3 * row + height / 6,
            );
            assert!(figure.get_pixel(x, y).0 != [24; 3], "tile {column}, {row}");
        }
    }
}

#[test]
fn missing_presses_are_reported() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("figure.png");
    let words = format!(
        "--presses {} --trace {} --out {}",
        dir.path().join("nowhere").display(),
        trace().display(),
        out.display()
    );
    let (code, message) = refused(&mut render("figure", &words));
    assert_eq!(code, 1, "{message}");
    assert!(message.contains("nowhere"), "{message}");
}
