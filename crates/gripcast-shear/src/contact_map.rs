//! Displacement of the skin of the gels in view.

/// Displacement of the skin of both gels at the centres of equal cells of their images, m.
#[derive(Clone, Debug, PartialEq)]
pub struct ContactMaps(Vec<f64>);

impl ContactMaps {
    /// Rows and columns of cells.
    pub const CELLS: [usize; 2] = [8, 10];
    /// Numbers of a cell: displacement right and down in the image, and into the gel.
    pub const COMPONENTS: usize = 3;
    /// Numbers of one gel, row by row.
    pub const GEL_LEN: usize = Self::CELLS[0] * Self::CELLS[1] * Self::COMPONENTS;
    /// Numbers of both.
    pub const LEN: usize = 2 * Self::GEL_LEN;

    /// Maps of the left and then the right gel; none for another number of values or one that is not
    /// finite.
    pub fn new(values: Vec<f64>) -> Option<Self> {
        let is_whole = values.len() == Self::LEN && values.iter().all(|value| value.is_finite());
        is_whole.then_some(Self(values))
    }

    /// All numbers: left gel, right gel; each by row, column and component.
    pub fn values(&self) -> &[f64] {
        &self.0
    }

    /// Numbers of the left and the right gel.
    pub fn gels(&self) -> [&[f64]; 2] {
        let (left, right) = self.0.split_at(Self::GEL_LEN);
        [left, right]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_of_both_gels_are_finite() {
        let values: Vec<f64> = (0..ContactMaps::LEN).map(|i| i as f64 * 1e-6).collect();
        let maps = ContactMaps::new(values.clone()).unwrap();
        assert_eq!(maps.values(), values);
        assert_eq!(maps.gels().concat(), values);
        assert_eq!(ContactMaps::new(values[1..].to_vec()), None);
        let mut damaged = values;
        damaged[7] = f64::NAN;
        assert_eq!(ContactMaps::new(damaged), None);
    }
}
