use glam::Vec3;

use super::lanes::Portable;
use super::*;
use gripcast_geometry::builtin;

/// Small pseudorandom generator of numbers in [0, 1).
struct Numbers(u64);

impl Numbers {
    fn next(&mut self) -> f32 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1);
        (self.0 >> 40) as f32 / (1u64 << 24) as f32
    }

    fn vector(&mut self) -> Vec3 {
        Vec3::new(self.next(), self.next(), self.next()) * 2.0 - 1.0
    }
}

struct Closest<'a>(&'a Bvh, Ray);

impl WithLanes for Closest<'_> {
    type Output = (Option<Hit>, bool);

    #[inline(always)]
    fn with_lanes<L: Lanes>(self, lanes: L) -> Self::Output {
        let mut stack = self.0.stack();
        let hit = self.0.intersect(lanes, &self.1, &mut stack);
        (hit, self.0.occluded(lanes, &self.1, &mut stack))
    }
}

/// Distance of the nearest triangle in double precision (Möller and Trumbore).
fn brute_force(corners: &[[Vec3; 3]], ray: &Ray) -> Option<f64> {
    let (o, d) = (ray.origin.as_dvec3(), ray.direction.as_dvec3());
    let meet = |[a, b, c]: &[Vec3; 3]| {
        let (a, b, c) = (a.as_dvec3(), b.as_dvec3(), c.as_dvec3());
        let (e, f) = (b - a, c - a);
        let p = d.cross(f);
        let determinant = e.dot(p);
        let s = (o - a) / determinant;
        let u = s.dot(p);
        let q = s.cross(e);
        let (v, t) = (d.dot(q), f.dot(q));
        (u >= 0.0 && v >= 0.0 && u + v <= 1.0 && t > 0.0).then_some(t)
    };
    corners.iter().filter_map(meet).min_by(f64::total_cmp)
}

fn compare(corners: &[[Vec3; 3]], rays: impl Iterator<Item = Ray>) {
    let bvh = Bvh::build(corners);
    let (mut met, mut differ, mut count) = (0, 0, 0);
    for ray in rays {
        count += 1;
        let (hit, any) = dispatch(Closest(&bvh, ray));
        assert_eq!(hit.is_some(), any);
        let (portable, _) = Closest(&bvh, ray).with_lanes(Portable);
        assert_eq!(hit, portable, "wide and plain lanes differ");
        match (hit, brute_force(corners, &ray)) {
            (Some(hit), Some(t)) => {
                met += 1;
                // Single precision against double, at distances of a few units.
                if (f64::from(hit.t) - t).abs() > 1e-5 * t.max(1.0) {
                    differ += 1;
                }
            }
            (None, None) => (),
            _ => differ += 1,
        }
    }
    assert!(met * 50 > count, "{met} of {count}");
    // A ray that touches an edge within rounding may go either way.
    assert!(differ * 500 <= count, "{differ} of {count}");
}

fn rays(count: usize, seed: u64) -> impl Iterator<Item = Ray> {
    let mut numbers = Numbers(seed);
    (0..count).map(move |_| {
        let origin = numbers.vector() * 2.0;
        Ray {
            origin,
            direction: (0.7 * numbers.vector() - origin).normalize_or(Vec3::Z),
        }
    })
}

#[test]
fn random_triangles_agree_with_brute_force() {
    let mut numbers = Numbers(7);
    for count in [1, 7, 8, 9, 300] {
        let corners: Vec<_> = (0..count)
            .map(|_| {
                let centre = numbers.vector();
                let size = 0.3 + f32::from(count < 10);
                [0, 1, 2].map(|_| centre + size * numbers.vector())
            })
            .collect();
        compare(&corners, rays(4000, count));
    }
}

#[test]
fn degenerate_meshes_agree_with_brute_force() {
    // Coincident, axis-aligned and degenerate triangles.
    let triangle = [Vec3::ZERO, Vec3::X, Vec3::Y];
    let same = vec![triangle; 100];
    compare(&same, rays(2000, 1));
    let mut grid: Vec<_> = (0..200)
        .map(|i| {
            let at = Vec3::new((i % 20) as f32 - 10.0, (i / 20) as f32 - 5.0, 0.0) * 0.2;
            triangle.map(|p| at + 0.2 * p)
        })
        .collect();
    grid.push([Vec3::ONE; 3]);
    grid.push([Vec3::ZERO, Vec3::Z, 2.0 * Vec3::Z]);
    // Rays along the axes of the grid.
    let along = (0..500).map(|i| Ray {
        origin: Vec3::new(0.003 * i as f32 - 0.8, 0.11, 1.0),
        direction: -Vec3::Z,
    });
    compare(&grid, rays(2000, 2).chain(along));
    let empty = Bvh::build(&[]);
    let (hit, any) = dispatch(Closest(&empty, rays(1, 3).next().unwrap()));
    assert!(hit.is_none() && !any);
}

#[test]
fn no_ray_slips_through_a_closed_mesh() {
    for name in ["sphere", "mug", "spike"] {
        let mesh = builtin(name).unwrap();
        let corners: Vec<_> = mesh.all_corners().map(|c| c.map(|p| p.as_vec3())).collect();
        let bvh = Bvh::build(&corners);
        let mut numbers = Numbers(11);
        // Slightly below the surface of the solid.
        let [a, b, c] = corners[100];
        let inside = (a + b + c) / 3.0 - 1e-4 * (b - a).cross(c - a).normalize();
        for i in 0..6000 {
            // Half of the rays aim at vertices and edges.
            let [a, b, _] = corners[i % corners.len()];
            let target = match i % 4 {
                0 => a,
                1 => a + (b - a) * numbers.next(),
                _ => inside + numbers.vector(),
            };
            let ray = Ray {
                origin: inside,
                direction: (target - inside).normalize_or(Vec3::Z),
            };
            assert!(dispatch(Closest(&bvh, ray)).1, "{name}, ray {i}: {ray:?}");
        }
    }
}

#[test]
fn hit_has_barycentric_weights() {
    let corners = [[Vec3::ZERO, 2.0 * Vec3::X, Vec3::Y]];
    let ray = Ray {
        origin: Vec3::new(0.6, 0.25, 3.0),
        direction: -Vec3::Z,
    };
    let hit = dispatch(Closest(&Bvh::build(&corners), ray)).0.unwrap();
    assert!((hit.t - 3.0).abs() < 1e-6);
    assert!((hit.weights[0] - 0.3).abs() < 1e-6 && (hit.weights[1] - 0.25).abs() < 1e-6);
}
