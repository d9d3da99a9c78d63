//! What a client tells about a command: its id, its age, and what its sender saw.

use axum::http::StatusCode;
use gripcast_capture::camera::monotonic_ns;
use gripcast_session::Seen;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::failure::Failure;

/// Maximum length of a request id, characters.
const MAX_ID_CHARS: usize = 64;
/// Maximum time by which a client may be ahead of this machine's clock, ms; it estimates the clock.
const MAX_AHEAD_MS: f64 = 1_000.0;

/// Time at which a request arrived.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Arrival {
    /// `CLOCK_MONOTONIC`, ns.
    ns: u64,
}

impl Arrival {
    /// A request that arrives now.
    pub(crate) fn now() -> Self {
        Self { ns: monotonic_ns() }
    }
}

/// What a client tells about a command, all of it optional.
#[derive(Clone, Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct Sender {
    /// Id of the command, unique for its sender: 1 to 64 printable ASCII characters. A command
    /// whose id is repeated is not executed again and gets the first answer.
    #[schema(value_type = Option<String>, min_length = 1, max_length = 64, example = "9f86d081884c")]
    pub(super) request_id: Option<RequestId>,
    /// Time from the press to the sending by the sender's monotonic clock, ms.
    #[schema(minimum = 0, example = 12.5)]
    age_ms: f64,
    /// Time of the sending on this machine's clock, ms: `monotonic_ms` of a state, plus the time
    /// since that state arrived. The time in flight counts as age.
    #[schema(minimum = 0)]
    sent_at_ms: Option<f64>,
    /// What the sender saw; the command is refused where it differs.
    pub(super) seen: Seen,
}

impl Sender {
    /// Returns the time at which the operator gave the command, `CLOCK_MONOTONIC`, ns.
    ///
    /// # Errors
    /// 422 for a negative age, or a sending later than the arrival.
    pub(super) fn given_ns(&self, arrival: Arrival) -> Result<u64, Failure> {
        if self.age_ms < 0.0 {
            return Err(Failure::input(format!(
                "expected an `age_ms` of 0 or more, found {}",
                self.age_ms
            )));
        }
        let arrival_ms = arrival.ns as f64 * 1e-6;
        let in_flight_ms = self.sent_at_ms.map_or(0.0, |sent| arrival_ms - sent);
        if in_flight_ms < -MAX_AHEAD_MS {
            return Err(Failure::input(format!(
                "`sent_at_ms` is {:.1} s ahead of this machine's clock",
                -in_flight_ms * 1e-3
            ))
            .remedy("take it from `monotonic_ms` of the newest state"));
        }
        let given_ms = arrival_ms - self.age_ms - in_flight_ms.max(0.0);
        Ok((given_ms.max(0.0) * 1e6) as u64)
    }
}

/// Id of a command, chosen by its sender.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String")]
pub(crate) struct RequestId(String);

impl TryFrom<String> for RequestId {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        let printable = text.chars().all(|c| c.is_ascii_graphic());
        if printable && (1..=MAX_ID_CHARS).contains(&text.len()) {
            return Ok(Self(text));
        }
        Err(format!(
            "expected a `request_id` of 1 to {MAX_ID_CHARS} printable ASCII characters"
        ))
    }
}

impl RequestId {
    /// Parses the id in a path.
    ///
    /// # Errors
    /// 422 for an invalid id.
    pub(crate) fn parse(text: String) -> Result<Self, Failure> {
        Self::try_from(text).map_err(Failure::input)
    }

    /// The failure of an id that was used for another command.
    pub(super) fn reused(&self) -> Failure {
        Failure::new(
            StatusCode::UNPROCESSABLE_ENTITY,
            format!("the request id `{}` was used for another command", self.0),
        )
        .remedy("send every command with a new id; repeat an id only to repeat its command")
    }

    /// The failure of an id without a command.
    pub(super) fn unknown(&self) -> Failure {
        Failure::not_found(format!("no command with the request id `{}`", self.0))
            .remedy("it did not arrive since the daemon started, or too many have arrived since")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const NOW: Arrival = Arrival {
        ns: 100_000_000_000,
    };

    fn sender(json: &str) -> Sender {
        serde_json::from_str(json).unwrap()
    }

    fn age_ms(json: &str) -> f64 {
        let given = sender(json).given_ns(NOW).unwrap();
        (NOW.ns - given) as f64 * 1e-6
    }

    #[test]
    fn age_is_that_of_the_press_and_of_the_flight() {
        assert_eq!(age_ms("{}"), 0.0);
        assert_eq!(age_ms(r#"{"age_ms": 40}"#), 40.0);
        // Sent 13 s ago: the line was dead.
        assert_eq!(age_ms(r#"{"age_ms": 40, "sent_at_ms": 87000}"#), 13_040.0);
        // The estimate of the clock may be a little ahead.
        assert_eq!(age_ms(r#"{"sent_at_ms": 100200}"#), 0.0);
        // Older than the machine.
        assert_eq!(age_ms(r#"{"age_ms": 1e12}"#), 100_000.0);
    }

    #[test]
    fn impossible_times_and_ids_are_refused() {
        for json in [r#"{"age_ms": -1}"#, r#"{"sent_at_ms": 102000}"#] {
            assert!(sender(json).given_ns(NOW).is_err(), "{json}");
        }
        for json in [
            r#"{"request_id": ""}"#,
            r#"{"request_id": "a b"}"#,
            r#"{"age_ms": 1e999}"#,
            r#"{"seen": {"step_number": 1}}"#,
            r#"{"agems": 1}"#,
        ] {
            assert!(serde_json::from_str::<Sender>(json).is_err(), "{json}");
        }
        let long = "x".repeat(MAX_ID_CHARS + 1);
        assert!(RequestId::try_from(long).is_err());
    }
}
