//! Random numbers for shapes.

use gripcast_base::random::SeedStream;

/// Draws the numbers of one shape.
pub(super) struct Draw(pub(super) SeedStream);

impl Draw {
    /// Draws one of the forms, such as "spoon".
    pub(super) fn form(&mut self, forms: &[&'static str]) -> &'static str {
        let form = forms.get(self.0.index(forms.len()));
        form.copied().unwrap_or_default()
    }

    /// Uniform between two numbers, rounded to the micrometre or microradian, so that shapes start
    /// from the same bits on every machine.
    pub(super) fn between(&mut self, low: f64, high: f64) -> f64 {
        (self.0.between(low, high) * 1e6).round() * 1e-6
    }

    /// Uniform integer between two, inclusive.
    pub(super) fn count(&mut self, low: usize, high: usize) -> usize {
        low + self.0.index(high - low + 1)
    }

    /// True with a probability.
    pub(super) fn chance(&mut self, probability: f64) -> bool {
        self.0.uniform() < probability
    }
}
