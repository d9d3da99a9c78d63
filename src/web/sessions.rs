//! Login sessions, and addresses with invalid tokens.

use std::collections::HashMap;
use std::net::IpAddr;
use std::time::{Duration, Instant};

use subtle::ConstantTimeEq as _;

use gripcast_base::error::{Error, Result};
use gripcast_base::files::sha256_hex;

/// Maximum sessions; a further login ends the least recently used one.
const MAX_SESSIONS: usize = 64;
/// Time without a request after which a session ends.
const IDLE_TIMEOUT: Duration = Duration::from_secs(12 * 3600);
/// Maximum duration of a session.
const MAX_DURATION: Duration = Duration::from_secs(7 * 24 * 3600);

/// Invalid tokens from an address within [`FAILURE_WINDOW`] after which it is blocked.
pub(super) const MAX_FAILURES: u32 = 10;
/// Time for which invalid tokens are counted.
const FAILURE_WINDOW: Duration = Duration::from_secs(60);
/// Maximum number of counted addresses.
const MAX_ADDRESSES: usize = 1024;

/// Digest of a session id; only the browser has the id itself.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct SessionKey(String);

impl SessionKey {
    /// Computes the key of a session id.
    pub(super) fn new(id: &str) -> Self {
        Self(sha256_hex(id))
    }
}

#[derive(Debug)]
struct Session {
    key: SessionKey,
    opened: Instant,
    used: Instant,
}

/// All open sessions.
#[derive(Debug, Default)]
pub(super) struct Sessions(Vec<Session>);

impl Sessions {
    /// Opens a session and returns its id.
    ///
    /// # Errors
    /// `Internal` if the operating system provides no random numbers.
    pub(super) fn open(&mut self, now: Instant) -> Result<String> {
        let mut random = [0; 32];
        getrandom::fill(&mut random)
            .map_err(|e| Error::internal("cannot get random numbers for a session").because(e))?;
        let id: String = random.iter().map(|byte| format!("{byte:02x}")).collect();
        self.end_old(now);
        if self.0.len() >= MAX_SESSIONS {
            let oldest = (0..self.0.len()).min_by_key(|&index| self.0[index].used);
            oldest.map(|index| self.0.swap_remove(index));
        }
        self.0.push(Session {
            key: SessionKey::new(&id),
            opened: now,
            used: now,
        });
        Ok(id)
    }

    /// Returns whether a session is open; a request (`is_use`) resets its idle time.
    pub(super) fn is_open(&mut self, key: &SessionKey, now: Instant, is_use: bool) -> bool {
        self.end_old(now);
        let mut found = false;
        for session in &mut self.0 {
            // All keys are compared in constant time.
            if bool::from(session.key.0.as_bytes().ct_eq(key.0.as_bytes())) {
                found = true;
                if is_use {
                    session.used = now;
                }
            }
        }
        found
    }

    /// Closes a session.
    pub(super) fn close(&mut self, key: &SessionKey) {
        self.0.retain(|session| session.key != *key);
    }

    /// Closes all sessions.
    pub(super) fn clear(&mut self) {
        self.0.clear();
    }

    fn end_old(&mut self, now: Instant) {
        self.0.retain(|session| {
            now.saturating_duration_since(session.used) < IDLE_TIMEOUT
                && now.saturating_duration_since(session.opened) < MAX_DURATION
        });
    }
}

/// Invalid tokens by address.
#[derive(Debug, Default)]
pub(super) struct Failures(HashMap<IpAddr, Failed>);

#[derive(Clone, Copy, Debug)]
struct Failed {
    count: u32,
    since: Instant,
}

impl Failed {
    /// Returns the remaining time in the window.
    fn remaining(self, now: Instant) -> Duration {
        FAILURE_WINDOW.saturating_sub(now.saturating_duration_since(self.since))
    }
}

impl Failures {
    /// Returns how long an address is blocked; `None` if it is not.
    pub(super) fn wait(&self, from: IpAddr, now: Instant) -> Option<Duration> {
        let failed = self.0.get(&from)?;
        let wait = failed.remaining(now);
        (failed.count >= MAX_FAILURES && !wait.is_zero()).then_some(wait)
    }

    /// Counts an invalid token.
    pub(super) fn note(&mut self, from: IpAddr, now: Instant) {
        self.0.retain(|_, failed| !failed.remaining(now).is_zero());
        if self.0.len() >= MAX_ADDRESSES && !self.0.contains_key(&from) {
            let oldest = self.0.iter().min_by_key(|(_, failed)| failed.since);
            let oldest = oldest.map(|(address, _)| *address);
            oldest.map(|address| self.0.remove(&address));
        }
        let first = Failed {
            count: 0,
            since: now,
        };
        self.0.entry(from).or_insert(first).count += 1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;
    use std::net::Ipv4Addr;

    const MINUTE: Duration = Duration::from_secs(60);

    #[test]
    fn sessions_end_when_idle_or_old() {
        let (start, mut sessions) = (Instant::now(), Sessions::default());
        let key = SessionKey::new(&sessions.open(start).unwrap());
        let nearly = start + IDLE_TIMEOUT - MINUTE;
        // A check that is not a request does not reset the idle time.
        assert!(sessions.is_open(&key, nearly, false));
        assert!(!sessions.is_open(&key, start + IDLE_TIMEOUT, true));

        let key = SessionKey::new(&sessions.open(start).unwrap());
        let mut now = start;
        while now + IDLE_TIMEOUT / 2 < start + MAX_DURATION {
            now += IDLE_TIMEOUT / 2;
            assert!(sessions.is_open(&key, now, true));
        }
        assert!(!sessions.is_open(&key, start + MAX_DURATION, true));
    }

    #[test]
    fn sessions_are_random_bounded_and_closable() {
        let (start, mut sessions) = (Instant::now(), Sessions::default());
        let mut ids = Vec::new();
        for second in 0..=MAX_SESSIONS as u64 {
            let at = start + Duration::from_secs(second);
            ids.push(sessions.open(at).unwrap());
        }
        let different: BTreeSet<&String> = ids.iter().collect();
        assert_eq!(different.len(), ids.len());
        assert!(ids.iter().all(|id| id.len() == 64));
        assert_eq!(sessions.0.len(), MAX_SESSIONS);
        let now = start + MINUTE * 2;
        let keys: Vec<SessionKey> = ids.iter().map(|id| SessionKey::new(id)).collect();
        assert!(
            !sessions.is_open(&keys[0], now, true),
            "the oldest session must be closed"
        );
        assert!(sessions.is_open(&keys[1], now, true));
        sessions.close(&keys[1]);
        assert!(!sessions.is_open(&keys[1], now, true));
        assert!(sessions.is_open(&keys[2], now, true));
        let stored = format!("{sessions:?}");
        assert!(ids.iter().all(|id| !stored.contains(id.as_str())));
    }

    #[test]
    fn invalid_tokens_are_counted_by_address_and_expire() {
        let (start, mut failures) = (Instant::now(), Failures::default());
        let (one, other) = (
            Ipv4Addr::LOCALHOST.into(),
            Ipv4Addr::new(10, 0, 0, 2).into(),
        );
        for _ in 0..MAX_FAILURES {
            assert_eq!(failures.wait(one, start), None);
            failures.note(one, start);
        }
        let later = start + Duration::from_secs(20);
        assert_eq!(failures.wait(one, later), Some(Duration::from_secs(40)));
        assert_eq!(failures.wait(other, later), None);
        assert_eq!(failures.wait(one, start + FAILURE_WINDOW), None);
        failures.note(one, start + FAILURE_WINDOW);
        assert_eq!(failures.wait(one, start + FAILURE_WINDOW), None);
    }

    #[test]
    fn addresses_are_bounded_and_oldest_is_dropped() {
        let (start, mut failures) = (Instant::now(), Failures::default());
        for number in 0..=MAX_ADDRESSES as u32 {
            let at = start + Duration::from_millis(number.into());
            failures.note(Ipv4Addr::from_bits(number).into(), at);
        }
        assert_eq!(failures.0.len(), MAX_ADDRESSES);
        assert!(
            !failures
                .0
                .contains_key(&IpAddr::from(Ipv4Addr::from_bits(0)))
        );
    }
}
