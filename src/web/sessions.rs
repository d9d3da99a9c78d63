//! Browsers that have logged in, and addresses that have shown a wrong token.

use std::collections::HashMap;
use std::net::IpAddr;
use std::time::{Duration, Instant};

use subtle::ConstantTimeEq as _;

use gripcast_base::error::{Error, Result};
use gripcast_base::files::sha256_hex;

/// Sessions at a time; one more ends the one that was used least lately.
const MAX_SESSIONS: usize = 64;
/// A session ends after this time without a request …
const IDLE: Duration = Duration::from_secs(12 * 3600);
/// … and this long after the login in any case.
const MAX: Duration = Duration::from_secs(7 * 24 * 3600);

/// Wrong tokens of an address within [`FAILURE_WINDOW`] after which it is not heard.
pub(super) const MAX_FAILURES: u32 = 10;
/// How long wrong tokens are remembered.
const FAILURE_WINDOW: Duration = Duration::from_secs(60);
/// Addresses that are remembered.
const MAX_ADDRESSES: usize = 1024;

/// Digest of a session's id. The id itself is known to the browser alone.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct SessionKey(String);

impl SessionKey {
    /// The key of an id that a browser shows.
    pub(super) fn of(id: &str) -> Self {
        Self(sha256_hex(id))
    }
}

#[derive(Debug)]
struct Session {
    key: SessionKey,
    opened: Instant,
    used: Instant,
}

/// All sessions.
#[derive(Debug, Default)]
pub(super) struct Sessions(Vec<Session>);

impl Sessions {
    /// Opens a session and returns its id.
    ///
    /// # Errors
    /// `Internal` when the operating system gives no random numbers.
    pub(super) fn open(&mut self, now: Instant) -> Result<String> {
        let mut random = [0; 32];
        getrandom::fill(&mut random).map_err(|e| {
            Error::internal("the operating system gives no random numbers for a session").because(e)
        })?;
        let id: String = random.iter().map(|byte| format!("{byte:02x}")).collect();
        self.end_old(now);
        if self.0.len() >= MAX_SESSIONS {
            let oldest = (0..self.0.len()).min_by_key(|&place| self.0[place].used);
            oldest.map(|place| self.0.swap_remove(place));
        }
        self.0.push(Session {
            key: SessionKey::of(&id),
            opened: now,
            used: now,
        });
        Ok(id)
    }

    /// Whether a session is open; a request (`is_use`) keeps it from being idle.
    pub(super) fn is_open(&mut self, key: &SessionKey, now: Instant, is_use: bool) -> bool {
        self.end_old(now);
        let mut found = false;
        for session in &mut self.0 {
            // All are compared, each in constant time: the time tells nothing of them.
            if bool::from(session.key.0.as_bytes().ct_eq(key.0.as_bytes())) {
                found = true;
                if is_use {
                    session.used = now;
                }
            }
        }
        found
    }

    /// Ends one.
    pub(super) fn close(&mut self, key: &SessionKey) {
        self.0.retain(|session| session.key != *key);
    }

    /// Ends all.
    pub(super) fn clear(&mut self) {
        self.0.clear();
    }

    fn end_old(&mut self, now: Instant) {
        self.0.retain(|session| {
            now.saturating_duration_since(session.used) < IDLE
                && now.saturating_duration_since(session.opened) < MAX
        });
    }
}

/// Wrong tokens by address.
#[derive(Debug, Default)]
pub(super) struct Failures(HashMap<IpAddr, Failed>);

#[derive(Clone, Copy, Debug)]
struct Failed {
    count: u32,
    since: Instant,
}

impl Failed {
    /// How long it is remembered from now on.
    fn left(self, now: Instant) -> Duration {
        FAILURE_WINDOW.saturating_sub(now.saturating_duration_since(self.since))
    }
}

impl Failures {
    /// How long no token of this address is looked at; `None`: now it is.
    pub(super) fn wait(&self, from: IpAddr, now: Instant) -> Option<Duration> {
        let failed = self.0.get(&from)?;
        let left = failed.left(now);
        (failed.count >= MAX_FAILURES && !left.is_zero()).then_some(left)
    }

    /// Remembers a wrong token.
    pub(super) fn note(&mut self, from: IpAddr, now: Instant) {
        self.0.retain(|_, failed| !failed.left(now).is_zero());
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
    fn sessions_end_when_they_are_idle_and_when_they_are_old() {
        let (start, mut sessions) = (Instant::now(), Sessions::default());
        let key = SessionKey::of(&sessions.open(start).unwrap());
        let nearly = start + IDLE - MINUTE;
        // A look that is no use does not keep it open.
        assert!(sessions.is_open(&key, nearly, false));
        assert!(!sessions.is_open(&key, start + IDLE, true));

        let key = SessionKey::of(&sessions.open(start).unwrap());
        let mut now = start;
        while now + IDLE / 2 < start + MAX {
            now += IDLE / 2;
            assert!(sessions.is_open(&key, now, true));
        }
        assert!(!sessions.is_open(&key, start + MAX, true));
    }

    #[test]
    fn sessions_are_random_bounded_and_can_be_closed() {
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
        let keys: Vec<SessionKey> = ids.iter().map(|id| SessionKey::of(id)).collect();
        assert!(
            !sessions.is_open(&keys[0], now, true),
            "the oldest made room"
        );
        assert!(sessions.is_open(&keys[1], now, true));
        sessions.close(&keys[1]);
        assert!(!sessions.is_open(&keys[1], now, true));
        assert!(sessions.is_open(&keys[2], now, true));
        let stored = format!("{sessions:?}");
        assert!(ids.iter().all(|id| !stored.contains(id.as_str())));
    }

    #[test]
    fn wrong_tokens_are_counted_by_address_and_forgotten() {
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
    fn addresses_are_bounded_and_the_oldest_is_forgotten() {
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
