//! Removes degenerate and duplicate triangles.

use std::collections::BTreeMap;

use crate::mesh::TriangleMesh;

/// Drops triangles with a repeated corner and their unused vertices.
pub(super) fn drop_degenerate(mesh: &mut TriangleMesh, warnings: &mut Vec<String>) {
    let before = mesh.triangles.len();
    mesh.triangles
        .retain(|[a, b, c]| a != b && b != c && c != a);
    let dropped = before - mesh.triangles.len();
    if dropped > 0 {
        *mesh = mesh.without_unused_vertices();
        warnings.push(format!(
            "dropped {dropped} degenerate triangle(s) with coincident corners"
        ));
    }
}

/// Drops triangles with the same three vertices: all but one if the surface would be open without
/// it, else all of them, which enclose nothing.
pub(super) fn drop_duplicates(mesh: &mut TriangleMesh, warnings: &mut Vec<String>) {
    let mut groups: BTreeMap<[u32; 3], Vec<usize>> = BTreeMap::new();
    for (index, triangle) in mesh.triangles.iter().enumerate() {
        let mut key = *triangle;
        key.sort_unstable();
        groups.entry(key).or_default().push(index);
    }
    groups.retain(|_, members| members.len() > 1);
    if groups.is_empty() {
        return;
    }
    let edges = mesh.edges();
    let mut drop = vec![false; mesh.triangles.len()];
    for ([a, b, c], members) in &groups {
        let sides = [[*a, *b], [*b, *c], [*a, *c]];
        let needed = sides.iter().any(|side| {
            let edge = edges.vertices.binary_search(side);
            edge.is_ok_and(|e| (edges.triangles(e).len() - members.len()) % 2 == 1)
        });
        for &member in &members[usize::from(needed)..] {
            drop[member] = true;
        }
    }
    let mut kept = drop.iter().map(|dropped| !dropped);
    mesh.triangles.retain(|_| kept.next().unwrap_or(true));
    *mesh = mesh.without_unused_vertices();
    let dropped = drop.iter().filter(|d| **d).count();
    warnings.push(format!(
        "dropped {dropped} duplicate triangle(s) with the same corners as another"
    ));
}
