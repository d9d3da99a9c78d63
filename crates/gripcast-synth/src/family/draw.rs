//! Parameters of a shape, drawn from random numbers and kept for the record.

use serde::{Deserialize, Serialize};

use gripcast_base::random::SeedStream;

/// One drawn number of a shape.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Parameter {
    /// What it is, with its unit: `radius_m`, `bend_rad`, `teeth`.
    pub name: String,
    /// Its value.
    pub value: f64,
}

/// Draws the parameters of one shape and keeps them.
pub(super) struct Draw {
    stream: SeedStream,
    form: &'static str,
    record: Vec<Parameter>,
}

impl Draw {
    pub(super) fn new(stream: SeedStream) -> Self {
        Self {
            stream,
            form: "",
            record: Vec::new(),
        }
    }

    /// Chooses the form, such as "spoon".
    pub(super) fn form<const N: usize>(&mut self, forms: [&'static str; N]) -> &'static str {
        self.form = self.stream.pick(forms);
        self.form
    }

    /// Uniform between two numbers, to the micrometre or microradian: the rest of the shape then
    /// starts from the same bits on every machine.
    pub(super) fn between(&mut self, name: &str, low: f64, high: f64) -> f64 {
        let value = self.quiet(low, high);
        self.keep(name, value);
        value
    }

    /// As [`Draw::between`], without a record: for the many small numbers of a random body.
    pub(super) fn quiet(&mut self, low: f64, high: f64) -> f64 {
        (self.stream.between(low, high) * 1e6).round() * 1e-6
    }

    /// A whole number between two, both included.
    pub(super) fn count(&mut self, name: &str, low: usize, high: usize) -> usize {
        let value = low + self.stream.index(high - low + 1);
        self.keep(name, value as f64);
        value
    }

    /// Whether something that happens with a probability happens.
    pub(super) fn chance(&mut self, name: &str, probability: f64) -> bool {
        let value = self.stream.uniform() < probability;
        self.keep(name, f64::from(u8::from(value)));
        value
    }

    /// Form and parameters that were drawn.
    pub(super) fn into_record(self) -> (&'static str, Vec<Parameter>) {
        (self.form, self.record)
    }

    fn keep(&mut self, name: &str, value: f64) {
        self.record.push(Parameter {
            name: name.to_string(),
            value,
        });
    }
}
