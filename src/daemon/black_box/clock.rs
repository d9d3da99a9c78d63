//! Conversion of driver times to wall clock time.

use jiff::Timestamp;

use gripcast_capture::camera::monotonic_ns;

/// Constant offset of the wall clock from `CLOCK_MONOTONIC`, measured once per collection.
///
/// Time differences in a log are those of the drivers, and driver times can be recovered exactly.
/// Changes of the wall clock during the collection are ignored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct WallClock {
    /// Wall clock minus monotonic clock, ns.
    pub(super) offset_ns: i128,
}

impl WallClock {
    /// Measures the offset with one wall clock reading between two monotonic ones.
    pub(super) fn now() -> Self {
        let before_ns = monotonic_ns();
        let wall_ns = Timestamp::now().as_nanosecond();
        let after_ns = monotonic_ns();
        let between_ns = i128::from(before_ns) + i128::from(after_ns.saturating_sub(before_ns)) / 2;
        Self {
            offset_ns: wall_ns - between_ns,
        }
    }

    /// Converts a monotonic time to nanoseconds since 1970.
    pub(super) fn wall_ns(self, monotonic_ns: u64) -> u64 {
        let wall_ns = i128::from(monotonic_ns) + self.offset_ns;
        u64::try_from(wall_ns.max(0)).unwrap_or(u64::MAX)
    }

    /// Formats a monotonic time as RFC 3339, UTC.
    pub(super) fn text(self, monotonic_ns: u64) -> String {
        Timestamp::from_nanosecond(i128::from(self.wall_ns(monotonic_ns)))
            .map_or_else(|_| String::new(), |at| at.to_string())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn driver_time_is_recovered_exactly() {
        let clock = WallClock {
            offset_ns: 1_795_000_000_123_456_789,
        };
        let wall = clock.wall_ns(987_654_321);
        assert_eq!(i128::from(wall) - clock.offset_ns, 987_654_321);
        assert_eq!(clock.text(0), "2026-11-18T11:06:40.123456789Z");
    }

    #[test]
    fn times_before_1970_are_clamped() {
        let clock = WallClock { offset_ns: -5 };
        assert_eq!((clock.wall_ns(3), clock.wall_ns(7)), (0, 2));
    }
}
