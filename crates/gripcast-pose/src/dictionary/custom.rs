//! Custom dictionaries in OpenCV's file format.

use std::collections::BTreeMap;

use crate::yaml;
use gripcast_base::error::{Error, Result};

fn bad(what: String) -> Error {
    Error::input(what).remedy(
        "an OpenCV dictionary has nmarkers, markersize, and marker_0 … with strings of \
         markersize² digits 0 and 1",
    )
}

/// Returns cells along a side, and codes.
pub(super) fn read(text: &str) -> Result<(usize, Vec<u64>)> {
    let entries: BTreeMap<String, String> = yaml::read(text, "the dictionary")?;
    let number = |key: &str| -> Result<usize> {
        let value = entries
            .get(key)
            .ok_or_else(|| bad(format!("the dictionary has no {key}")))?;
        let parsed = value.trim().parse().ok();
        parsed.ok_or_else(|| bad(format!("{key} must be a whole number, found {value:?}")))
    };
    let side = number("markersize")?;
    let count = number("nmarkers")?;
    let present = entries.keys().filter(|k| k.starts_with("marker_")).count();
    if count != present {
        return Err(bad(format!("nmarkers is {count}, found {present} markers")));
    }
    let codes: Result<Vec<u64>> = (0..count)
        .map(|id| {
            let cells = entries.get(&format!("marker_{id}"));
            let cells = cells.ok_or_else(|| bad(format!("the dictionary has no marker_{id}")))?;
            code(cells, side).ok_or_else(|| {
                bad(format!(
                    "marker_{id} must have {side} × {side} digits 0 and 1, found {cells:?}"
                ))
            })
        })
        .collect();
    Ok((side, codes?))
}

/// Parses a string of binary digits, one per cell.
fn code(cells: &str, side: usize) -> Option<u64> {
    let is_binary = cells.bytes().all(|b| matches!(b, b'0' | b'1'));
    if !is_binary || Some(cells.len()) != side.checked_mul(side) {
        return None;
    }
    u64::from_str_radix(cells, 2).ok()
}
