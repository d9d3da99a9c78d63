//! The settings that an engine tried, as a grid.

use crate::report::Setting;

/// Frictions and forces of a set of settings, each ascending and once.
pub(super) struct Grid {
    pub(super) frictions: Vec<f64>,
    pub(super) forces_n: Vec<f64>,
}

impl Grid {
    pub(super) fn of(settings: impl Iterator<Item = Setting>) -> Self {
        let (frictions, forces_n) = settings.map(|s| (s.friction, s.force_n)).unzip();
        Self {
            frictions: ascending(frictions),
            forces_n: ascending(forces_n),
        }
    }
}

fn ascending(mut values: Vec<f64>) -> Vec<f64> {
    values.retain(|value| value.is_finite());
    values.sort_by(f64::total_cmp);
    values.dedup();
    values
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_value_once_in_order() {
        let settings = [(0.4, 20.0), (0.2, 20.0), (0.4, 5.0), (f64::NAN, 5.0)];
        let grid = Grid::of(
            settings
                .into_iter()
                .map(|(friction, force_n)| Setting { friction, force_n }),
        );
        assert_eq!(grid.frictions, [0.2, 0.4]);
        assert_eq!(grid.forces_n, [5.0, 20.0]);
    }
}
