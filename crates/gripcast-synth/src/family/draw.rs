//! Random numbers of a shape.

use gripcast_base::random::SeedStream;

/// Draws the numbers of one shape.
pub(super) struct Draw(pub(super) SeedStream);

impl Draw {
    /// Chooses one of the forms, such as "spoon".
    pub(super) fn form(&mut self, forms: &[&'static str]) -> &'static str {
        let form = forms.get(self.0.index(forms.len()));
        form.copied().unwrap_or_default()
    }

    /// Uniform between two numbers, to the micrometre or microradian: the rest of the shape then
    /// starts from the same bits on every machine.
    pub(super) fn between(&mut self, low: f64, high: f64) -> f64 {
        (self.0.between(low, high) * 1e6).round() * 1e-6
    }

    /// A whole number between two, both included.
    pub(super) fn count(&mut self, low: usize, high: usize) -> usize {
        low + self.0.index(high - low + 1)
    }

    /// Whether something that happens with a probability happens.
    pub(super) fn chance(&mut self, probability: f64) -> bool {
        self.0.uniform() < probability
    }
}
