//! The same mesh as another program might have written it.

/// Puts vertices and triangles into a random order and starts each triangle at a random corner;
/// `index(n)` draws a number below `n`.
pub fn shuffle_mesh<V: Copy>(
    vertices: &mut [V],
    triangles: &mut [[u32; 3]],
    mut index: impl FnMut(usize) -> usize,
) {
    let mut order: Vec<usize> = (0..vertices.len()).collect();
    shuffle(&mut order, &mut index);
    let old = vertices.to_vec();
    let mut place = vec![0_u32; order.len()];
    for (new, &from) in order.iter().enumerate() {
        vertices[new] = old[from];
        place[from] = u32::try_from(new).expect("fewer than 2^32 vertices");
    }
    for triangle in triangles.iter_mut() {
        *triangle = triangle.map(|v| place[v as usize]);
        triangle.rotate_left(index(3));
    }
    shuffle(triangles, &mut index);
}

fn shuffle<T>(items: &mut [T], index: &mut impl FnMut(usize) -> usize) {
    for i in (1..items.len()).rev() {
        items.swap(i, index(i + 1));
    }
}
