//! Formatting of numbers and names.

/// Placeholder for a missing number.
pub const MISSING: &str = "–";

/// Replaces invisible characters by spaces: control characters, and bidirectional controls that
/// reorder the text around them.
pub(crate) fn printable(text: String) -> String {
    let is_hidden = |c: char| (c.is_control() && c != '\n') || is_bidi_control(c);
    if text.contains(is_hidden) {
        text.replace(is_hidden, " ")
    } else {
        text
    }
}

fn is_bidi_control(c: char) -> bool {
    matches!(c, '\u{200e}' | '\u{200f}' | '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}')
}

/// Formats `value` with `digits` decimals and a minus sign (U+2212); [`MISSING`] if it is not
/// finite.
pub fn fixed(value: f64, digits: usize) -> String {
    if !value.is_finite() {
        return MISSING.to_owned();
    }
    let text = format!("{:.digits$}", value.abs());
    let is_zero = text.bytes().all(|b| matches!(b, b'0' | b'.'));
    if value < 0.0 && !is_zero {
        format!("−{text}")
    } else {
        text
    }
}

/// Formats as [`fixed`], or as [`MISSING`].
pub fn optional(value: Option<f64>, digits: usize) -> String {
    value.map_or_else(|| MISSING.to_owned(), |value| fixed(value, digits))
}

/// Formats with at most `digits` decimals, without trailing zeros.
pub fn trimmed(value: f64, digits: usize) -> String {
    let text = fixed(value, digits);
    if text.contains('.') {
        text.trim_end_matches('0').trim_end_matches('.').to_owned()
    } else {
        text
    }
}

/// Formats a duration in suitable units.
pub fn duration(seconds: f64) -> String {
    if !seconds.is_finite() || seconds < 0.0 {
        return MISSING.to_owned();
    }
    if seconds < 0.995 {
        return format!("{:.0} ms", 1e3 * seconds);
    }
    if seconds < 9.95 {
        return format!("{seconds:.1} s");
    }
    let whole = seconds.round() as u64;
    let (hours, minutes, rest) = (whole / 3600, whole / 60 % 60, whole % 60);
    match (hours, minutes) {
        (0, 0) => format!("{rest} s"),
        (0, _) => format!("{minutes} min {rest:02} s"),
        _ => format!("{hours} h {minutes:02} min"),
    }
}

/// Returns the display name of an engine.
pub fn engine_name(engine: &str) -> &str {
    match engine {
        "fem" => "Finite elements",
        "rigid" => "Rigid bodies",
        other => other,
    }
}

/// Returns the display name of a simulation outcome.
pub fn outcome_name(outcome: &str) -> &str {
    match outcome {
        "success" => "stable",
        "slip" => "slip",
        "eject" => "ejected",
        "miss" => "miss",
        "closed" => "gels met",
        "penetrating_start" => "collision at start",
        "not_converged" => "not converged",
        other => other,
    }
}

/// Returns the display name of a label.
pub fn outcome_label(stable: bool) -> &'static str {
    if stable { "stable" } else { "slip" }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hidden_characters_become_spaces() {
        let hostile = "a\u{0}b\u{202e}c\u{1b}[1m\td\n\u{85}é".to_owned();
        assert_eq!(printable(hostile), "a b c [1m d\n é");
    }

    #[test]
    fn numbers_have_fixed_digits() {
        assert_eq!(fixed(-1.25, 1), "−1.2");
        assert_eq!(fixed(-0.001, 2), "0.00");
        assert_eq!(fixed(f64::NAN, 2), MISSING);
        assert_eq!(optional(None, 2), MISSING);
        assert_eq!(trimmed(40.0, 2), "40");
        assert_eq!(trimmed(0.25, 3), "0.25");
        assert_eq!(trimmed(100.0, 0), "100");
    }

    #[test]
    fn durations_have_suitable_units() {
        let times = [0.02, 4.2, 59.6, 61.0, 4500.0, f64::NAN].map(duration);
        assert_eq!(
            times,
            [
                "20 ms",
                "4.2 s",
                "1 min 00 s",
                "1 min 01 s",
                "1 h 15 min",
                "–"
            ]
        );
    }
}
