//! Pieces that are convex together become one, as in V-HACD's last step.

use glam::DVec3;

use gripcast_geometry::{MassProperties, TriangleMesh, convex_hull};

/// Two pieces as one.
struct Pair {
    excess_m3: f64,
    hull: TriangleMesh,
}

/// Joins the two convex pieces whose common hull exceeds their volumes least, again and again,
/// while that is below `most_m3`.
pub(super) fn merged(pieces: Vec<TriangleMesh>, most_m3: f64) -> Vec<TriangleMesh> {
    let mut pieces: Vec<(TriangleMesh, f64)> = pieces
        .into_iter()
        .filter_map(|piece| Some((volume_m3(&piece)?, piece)))
        .map(|(volume, piece)| (piece, volume))
        .collect();
    // pairs[b][a] for a < b.
    let mut pairs: Vec<Vec<Option<Pair>>> = (0..pieces.len())
        .map(|b| (0..b).map(|a| pair(&pieces[a], &pieces[b])).collect())
        .collect();
    while let Some((a, b)) = cheapest(&pairs, most_m3) {
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

/// The first of the cheapest pairs.
fn cheapest(pairs: &[Vec<Option<Pair>>], most_m3: f64) -> Option<(usize, usize)> {
    let mut best = None;
    let mut least = most_m3;
    for (b, row) in pairs.iter().enumerate() {
        for (a, pair) in row.iter().enumerate() {
            if let Some(pair) = pair.as_ref().filter(|pair| pair.excess_m3 < least) {
                least = pair.excess_m3;
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
    MassProperties::of(mesh).ok().map(|found| found.volume_m3)
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_geometry::{Pose, builtin};

    #[test]
    fn halves_of_a_box_join_and_boxes_apart_do_not() {
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
