//! Merges pieces that are convex together, as in the last step of V-HACD.

use glam::DVec3;

use gripcast_geometry::{MassProperties, TriangleMesh, convex_hull};

/// The common hull of two pieces.
struct Pair {
    /// Volume of the hull beyond that of the pieces, m³.
    excess_m3: f64,
    hull: TriangleMesh,
}

/// Repeatedly merges the two convex pieces whose common hull has the smallest excess volume, while
/// that is below `max_excess_m3`.
pub(super) fn merged(pieces: Vec<TriangleMesh>, max_excess_m3: f64) -> Vec<TriangleMesh> {
    let mut pieces: Vec<(TriangleMesh, f64)> = pieces
        .into_iter()
        .filter_map(|piece| Some((volume_m3(&piece)?, piece)))
        .map(|(volume, piece)| (piece, volume))
        .collect();
    // pairs[b][a] for a < b.
    let mut pairs: Vec<Vec<Option<Pair>>> = (0..pieces.len())
        .map(|b| (0..b).map(|a| pair(&pieces[a], &pieces[b])).collect())
        .collect();
    while let Some((a, b)) = cheapest(&pairs, max_excess_m3) {
        let Some(joined) = pairs[b][a].take() else {
            break;
        };
        pieces.remove(b);
        pairs.remove(b);
        for row in pairs.iter_mut().skip(b) {
            row.remove(b);
        }
        let volume = volume_m3(&joined.hull).unwrap_or(0.0);
        pieces[a] = (joined.hull, volume);
        for other in 0..pieces.len() {
            let (low, high) = (a.min(other), a.max(other));
            if low != high {
                pairs[high][low] = pair(&pieces[low], &pieces[high]);
            }
        }
    }
    pieces.into_iter().map(|(piece, _)| piece).collect()
}

/// Indices of the pair with the smallest excess, the first of ties.
fn cheapest(pairs: &[Vec<Option<Pair>>], max_excess_m3: f64) -> Option<(usize, usize)> {
    let mut best = None;
    let mut min_excess = max_excess_m3;
    for (b, row) in pairs.iter().enumerate() {
        for (a, pair) in row.iter().enumerate() {
            if let Some(pair) = pair.as_ref().filter(|pair| pair.excess_m3 < min_excess) {
                min_excess = pair.excess_m3;
                best = Some((a, b));
            }
        }
    }
    best
}

fn pair(a: &(TriangleMesh, f64), b: &(TriangleMesh, f64)) -> Option<Pair> {
    let corners: Vec<DVec3> = [&a.0, &b.0]
        .into_iter()
        .flat_map(|m| &m.vertices)
        .copied()
        .collect();
    let hull = convex_hull(&corners).ok()?.without_unused_vertices();
    let excess_m3 = volume_m3(&hull)? - a.1 - b.1;
    Some(Pair { excess_m3, hull })
}

fn volume_m3(mesh: &TriangleMesh) -> Option<f64> {
    MassProperties::of_closed(mesh)
        .ok()
        .map(|properties| properties.volume_m3)
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_geometry::{Pose, builtin};

    #[test]
    fn adjacent_boxes_merge_and_separate_ones_do_not() {
        let half = convex_hull(&builtin("box").unwrap().vertices).unwrap();
        let at = |x: f64| half.transformed(&Pose::from_translation(DVec3::X * x));
        let volume = 0.04 * 0.04 * 0.06;
        let found = merged(vec![at(0.0), at(0.2), at(0.04), at(0.08)], 0.01 * volume);
        assert_eq!(found.len(), 2);
        let volumes: Vec<f64> = found
            .iter()
            .map(|m| volume_m3(m).unwrap() / volume)
            .collect();
        assert!((volumes[0] - 3.0).abs() < 1e-9 && (volumes[1] - 1.0).abs() < 1e-9);
    }
}
