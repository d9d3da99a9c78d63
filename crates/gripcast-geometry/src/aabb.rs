//! Axis-aligned bounding box.

use glam::DVec3;

/// Axis-aligned box in the frame of its points, m. A box with `min > max` is empty.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Aabb {
    /// Corner with the smallest coordinates.
    pub min: DVec3,
    /// Corner with the largest coordinates.
    pub max: DVec3,
}

impl Aabb {
    /// The empty box: the neutral element of [`Aabb::union`].
    pub const EMPTY: Self = Self {
        min: DVec3::INFINITY,
        max: DVec3::NEG_INFINITY,
    };

    /// Bounding box of the points; [`Aabb::EMPTY`] without points.
    pub fn from_points(points: impl IntoIterator<Item = DVec3>) -> Self {
        points.into_iter().fold(Self::EMPTY, |bounds, point| Self {
            min: bounds.min.min(point),
            max: bounds.max.max(point),
        })
    }

    /// Bounding box of both.
    #[must_use]
    pub fn union(&self, other: &Self) -> Self {
        Self {
            min: self.min.min(other.min),
            max: self.max.max(other.max),
        }
    }

    /// The box enlarged by `radius` (m) on every side.
    #[must_use]
    pub fn inflated(&self, radius: f64) -> Self {
        Self {
            min: self.min - radius,
            max: self.max + radius,
        }
    }

    /// Whether both boxes share a point, including touching boxes.
    #[inline]
    pub fn intersects(&self, other: &Self) -> bool {
        self.min.cmple(other.max).all() && other.min.cmple(self.max).all()
    }

    /// Whether the point lies inside or on the boundary.
    #[inline]
    pub fn contains(&self, point: DVec3) -> bool {
        self.min.cmple(point).all() && point.cmple(self.max).all()
    }

    /// Whether the box is empty.
    pub fn is_empty(&self) -> bool {
        !self.min.cmple(self.max).all()
    }

    /// Centre of the box, m.
    pub fn center(&self) -> DVec3 {
        0.5 * (self.min + self.max)
    }

    /// Edge lengths, m; zero for an empty box.
    pub fn extent(&self) -> DVec3 {
        (self.max - self.min).max(DVec3::ZERO)
    }

    /// Length of the diagonal, m.
    pub fn diagonal(&self) -> f64 {
        self.extent().length()
    }

    /// Half of the surface area, m²: the cost measure of the surface area heuristic.
    pub fn half_area(&self) -> f64 {
        let e = self.extent();
        e.x * e.y + e.y * e.z + e.z * e.x
    }

    /// Squared distance from the point to the box, m²; zero inside.
    #[inline]
    pub fn distance_squared(&self, point: DVec3) -> f64 {
        (point - point.clamp(self.min, self.max)).length_squared()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn union_inflation_and_intersection() {
        let a = Aabb::from_points([DVec3::ZERO, DVec3::ONE]);
        let b = Aabb::from_points([DVec3::new(1.5, 0.0, 0.0), DVec3::new(2.0, 1.0, 1.0)]);
        assert!(!a.intersects(&b));
        assert!(a.inflated(0.5).intersects(&b), "touching boxes intersect");
        assert!(!a.inflated(0.499).intersects(&b));
        assert_eq!(a.union(&b).extent(), DVec3::new(2.0, 1.0, 1.0));
        assert_eq!(a.union(&Aabb::EMPTY), a);
        assert!(Aabb::EMPTY.is_empty() && !a.is_empty());
        assert!(!a.intersects(&Aabb::EMPTY));
        assert_eq!(a.half_area(), 3.0);
    }

    #[test]
    fn distance_is_zero_inside() {
        let a = Aabb::from_points([DVec3::ZERO, DVec3::ONE]);
        assert_eq!(a.distance_squared(DVec3::splat(0.5)), 0.0);
        assert_eq!(a.distance_squared(DVec3::new(2.0, 0.5, -2.0)), 5.0);
        assert!(a.contains(DVec3::ONE) && !a.contains(DVec3::splat(1.1)));
    }
}
