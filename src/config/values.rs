//! Checks of the values that do not depend on where they come from: file, variable or flag.

use toml::Value;

use gripcast_base::error::Result;
use gripcast_base::files::{Label, ObjectName};
use gripcast_base::number::NumberRange;

/// Error rates of prediction sets; 0: no sets.
pub(crate) const ERROR_RATE_OR_NONE: NumberRange = NumberRange::between(0.0, 0.5);
/// Weights of the model's base rate in the adaptation, in labels.
pub(crate) const ADAPT_STRENGTH: NumberRange = NumberRange::above(0.0, 1e6).unit("labels");
/// Times after the grasp trigger for which frames can be kept.
pub(crate) const KEEP_LIFT_S: NumberRange = NumberRange::between(0.0, 10.0).unit("s");
/// Milliseconds up to an hour.
const TIME_MS: NumberRange = NumberRange::between(0.0, 3.6e6).unit("ms");

/// Returns the range of a numeric key. A key without an entry must not be negative.
fn range(key: &str) -> NumberRange {
    match key {
        "collect.adapt_strength" => ADAPT_STRENGTH,
        "collect.error_rate" => ERROR_RATE_OR_NONE,
        "collect.keep_lift_s" => KEEP_LIFT_S,
        "guards.max_frame_age_ms" => NumberRange::above(0.0, 3.6e6).unit("ms"),
        "guards.max_skew_ms" => TIME_MS,
        "guards.min_contact_fraction" => NumberRange::FRACTION,
        "guards.min_free_bytes" => NumberRange::between(0.0, 1e15).unit("bytes"),
        "guards.initial_warn_age_s" => NumberRange::between(0.0, 604_800.0).unit("s"),
        "black_box.file_mib" => NumberRange::between(1.0, f64::from(1 << 20)).unit("MiB"),
        "black_box.total_gib" => NumberRange::above(0.0, 1e6).unit("GiB"),
        "black_box.reserve_gb" => NumberRange::between(0.0, 1e6).unit("GB"),
        _ => NumberRange::NOT_NEGATIVE,
    }
}

/// Checks a value of the right type: the range of a number, the form of a name. Returns it in its
/// normal form.
///
/// # Errors
/// `Input` with what is expected and found.
pub(super) fn checked(key: &str, value: Value) -> Result<Value> {
    Ok(match (key, value) {
        (_, Value::Float(number)) => Value::Float(range(key).check(number)?),
        (_, Value::Integer(number)) => {
            range(key).check(number as f64)?;
            Value::Integer(number)
        }
        ("collect.object", Value::String(name)) => Value::String(ObjectName::parse(&name)?.into()),
        ("collect.scene" | "collect.operator", Value::String(name)) => {
            Value::String(Label::parse(&name)?.into())
        }
        (_, value) => value,
    })
}
