//! Removes degenerate and duplicate triangles.

use std::collections::BTreeMap;

use crate::mesh::TriangleMesh;
use crate::weld::{join, root};

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

/// Drops triangles with the same three vertices: all but one where the surface would otherwise be
/// open, as in a surface with two sides; all where one of them would be a fin or an inner wall.
pub(super) fn drop_duplicates(mesh: &mut TriangleMesh, warnings: &mut Vec<String>) {
    let mut groups: BTreeMap<[u32; 3], Vec<usize>> = BTreeMap::new();
    for (index, triangle) in mesh.triangles.iter().enumerate() {
        let mut key = *triangle;
        key.sort_unstable();
        groups.entry(key).or_default().push(index);
    }
    // Number of distinct triangles at each edge.
    let sides = |[a, b, c]: [u32; 3]| [[a, b], [b, c], [a, c]];
    let mut distinct: BTreeMap<[u32; 2], usize> = BTreeMap::new();
    if groups.values().all(|members| members.len() == 1) {
        return;
    }
    for side in groups.keys().flat_map(|key| sides(*key)) {
        *distinct.entry(side).or_default() += 1;
    }
    groups.retain(|_, members| members.len() > 1);
    let mut drop = vec![false; mesh.triangles.len()];
    for sheet in sheets(groups.keys().copied().collect()) {
        // Edges with an odd number of triangles, if one of each kind stays, and if none does.
        let mut own: BTreeMap<[u32; 2], usize> = BTreeMap::new();
        for side in sheet.iter().flat_map(|key| sides(*key)) {
            *own.entry(side).or_default() += 1;
        }
        let odd = |remaining: &dyn Fn(usize, usize) -> usize| {
            let all = own
                .iter()
                .map(|(side, own)| remaining(distinct[side], *own));
            all.filter(|count| count % 2 == 1).count()
        };
        let is_needed = odd(&|all, _| all) <= odd(&|all, own| all - own);
        for key in &sheet {
            for &member in &groups[key][usize::from(is_needed)..] {
                drop[member] = true;
            }
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

/// Groups triangles that are connected by edges.
fn sheets(keys: Vec<[u32; 3]>) -> Vec<Vec<[u32; 3]>> {
    let mut parent: Vec<u32> = (0..keys.len() as u32).collect();
    let mut first_at: BTreeMap<[u32; 2], u32> = BTreeMap::new();
    for (index, [a, b, c]) in keys.iter().enumerate() {
        for side in [[*a, *b], [*b, *c], [*a, *c]] {
            let other = *first_at.entry(side).or_insert(index as u32);
            join(&mut parent, index as u32, other);
        }
    }
    let mut sheets: BTreeMap<u32, Vec<[u32; 3]>> = BTreeMap::new();
    for (index, key) in keys.into_iter().enumerate() {
        let sheet = root(&mut parent, index as u32);
        sheets.entry(sheet).or_default().push(key);
    }
    sheets.into_values().collect()
}
