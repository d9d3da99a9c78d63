//! Who may talk to the daemon.
//!
//! * A Unix socket: whoever may open it.
//! * Loopback without a token: this machine's programs, and no page of another site: the `Host` must
//!   name this machine (a foreign name that was made to point here does not), an `Origin` must be
//!   our own.
//! * With a token: whoever shows it, as `Authorization: Bearer` or as the cookie that a login sets.

use std::fmt;
use std::fs::File;
use std::io::Read as _;
use std::net::IpAddr;
use std::os::unix::fs::MetadataExt as _;
use std::path::Path;
use std::sync::{Arc, PoisonError, RwLock};

use axum::extract::{Request, State};
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse as _, Response};
use subtle::ConstantTimeEq as _;

use super::failure::Failure;
use crate::error::{Error, ErrorKind, Result};
use crate::files::sha256_hex;

/// Shortest token that is taken, characters.
const SHORTEST_TOKEN: usize = 16;
/// Longest one; a larger file is no token.
const LONGEST_TOKEN: u64 = 1024;
/// Cookie of a browser that has logged in.
const COOKIE: &str = "gripcast";

/// Nothing but our own files, no frames around us.
const CONTENT_SECURITY_POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; \
     img-src 'self' blob: data:; connect-src 'self'; manifest-src 'self'; base-uri 'none'; \
     form-action 'none'; frame-ancestors 'none'";

/// A secret; it is never printed.
#[derive(Clone)]
pub(crate) struct Token(String);

impl fmt::Debug for Token {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Token(…)")
    }
}

impl Token {
    /// The token in a file that only its owner can read.
    ///
    /// # Errors
    /// `Config` for a file that others may read or that holds no token of at least 16 printable
    /// characters; `Io`, `NotFound`, … when it cannot be read.
    pub(crate) fn read(path: &Path) -> Result<Self> {
        let unreadable = |e| Error::io("cannot read the token", e).at(path.display());
        let file = File::open(path).map_err(unreadable)?;
        let mode = file.metadata().map_err(unreadable)?.mode();
        if mode & 0o077 != 0 {
            return Err(Error::new(
                ErrorKind::Config,
                format!("others may read the token (mode {:o})", mode & 0o777),
            )
            .at(path.display())
            .remedy(format!("chmod 600 {}", path.display())));
        }
        let mut text = String::new();
        file.take(LONGEST_TOKEN)
            .read_to_string(&mut text)
            .map_err(unreadable)?;
        Self::parse(&text).map_err(|e| e.at(path.display()))
    }

    fn parse(text: &str) -> Result<Self> {
        let token = text.trim();
        let printable = token.chars().all(|c| c.is_ascii_graphic());
        if token.len() < SHORTEST_TOKEN || !printable {
            return Err(Error::new(
                ErrorKind::Config,
                format!(
                    "expected a token of at least {SHORTEST_TOKEN} printable ASCII characters \
                     without blanks, found {} characters",
                    token.chars().count()
                ),
            )
            .remedy("make one: head -c 24 /dev/urandom | base64 > FILE; chmod 600 FILE"));
        }
        Ok(Self(token.to_owned()))
    }

    fn is(&self, shown: &str) -> bool {
        // Digests have one length, so that not even the token's is told by the time.
        let (ours, theirs) = (sha256_hex(&self.0), sha256_hex(shown));
        bool::from(ours.as_bytes().ct_eq(theirs.as_bytes()))
    }

    /// The header with which a program shows it.
    pub(super) fn bearer(&self) -> String {
        format!("Bearer {}", self.0)
    }

    /// What a browser shows after a login: it proves the token and does not tell it.
    fn cookie(&self) -> String {
        sha256_hex(format!("gripcast page\n{}", self.0))
    }
}

/// How a connection came in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Peer {
    /// Over TCP.
    Network,
    /// Over the Unix socket.
    Local,
}

/// The rule.
#[derive(Debug, Default)]
pub(crate) struct Access {
    token: RwLock<Option<Token>>,
}

impl Access {
    /// With a token, or without on loopback.
    pub(crate) fn new(token: Option<Token>) -> Self {
        Self {
            token: RwLock::new(token),
        }
    }

    /// Takes another token from now on; logins with the one before no longer count.
    pub(crate) fn replace(&self, token: Option<Token>) {
        *self.token.write().unwrap_or_else(PoisonError::into_inner) = token;
    }

    fn token(&self) -> Option<Token> {
        self.token
            .read()
            .unwrap_or_else(PoisonError::into_inner)
            .clone()
    }

    /// The cookie for who shows the token.
    ///
    /// # Errors
    /// 401 for another token.
    pub(crate) fn login(&self, shown: &str) -> Result<Option<HeaderValue>, Failure> {
        let Some(token) = self.token() else {
            return Ok(None);
        };
        if !token.is(shown) {
            return Err(Failure::new(
                StatusCode::UNAUTHORIZED,
                "this is not the token",
            ));
        }
        let cookie = format!(
            "{COOKIE}={}; Path=/; HttpOnly; SameSite=Strict",
            token.cookie()
        );
        Ok(HeaderValue::from_str(&cookie).ok())
    }

    /// Whether a request may pass.
    fn check(&self, peer: Peer, path: &str, headers: &HeaderMap) -> Result<(), Failure> {
        if peer == Peer::Local {
            return Ok(());
        }
        let host = text(headers, header::HOST).unwrap_or_default();
        let foreign = |what: String| {
            Failure::new(StatusCode::FORBIDDEN, what)
                .remedy("open the page under the address that the daemon printed")
        };
        if let Some(origin) = text(headers, header::ORIGIN)
            && origin != format!("http://{host}")
            && origin != format!("https://{host}")
        {
            return Err(foreign(format!("a page of {origin:.100} may not ask here")));
        }
        let Some(token) = self.token() else {
            if is_this_machine(host) {
                return Ok(());
            }
            return Err(foreign(format!("`{host:.100}` is no name of this machine")));
        };
        let open = !path.starts_with("/api/") && path != "/metrics" || path == "/api/login";
        if open || shows(&token, headers) {
            return Ok(());
        }
        Err(Failure::new(
            StatusCode::UNAUTHORIZED,
            "this needs the token of the daemon",
        )
        .remedy("send `Authorization: Bearer TOKEN`, or log in on the page"))
    }
}

fn text(headers: &HeaderMap, name: header::HeaderName) -> Option<&str> {
    headers.get(name)?.to_str().ok()
}

fn shows(token: &Token, headers: &HeaderMap) -> bool {
    let bearer = text(headers, header::AUTHORIZATION).and_then(|text| text.strip_prefix("Bearer "));
    if bearer.is_some_and(|shown| token.is(shown.trim())) {
        return true;
    }
    let cookies = headers.get_all(header::COOKIE).iter();
    let expected = token.cookie();
    cookies
        .filter_map(|value| value.to_str().ok())
        .flat_map(|line| line.split(';'))
        .filter_map(|pair| pair.trim().split_once('='))
        .any(|(name, value)| {
            name == COOKIE && bool::from(value.as_bytes().ct_eq(expected.as_bytes()))
        })
}

/// Whether a `Host` names this machine's loopback.
fn is_this_machine(host: &str) -> bool {
    let name = match host.strip_prefix('[') {
        Some(rest) => rest.split(']').next().unwrap_or_default(),
        None => host.split(':').next().unwrap_or_default(),
    };
    name.eq_ignore_ascii_case("localhost")
        || name
            .parse::<IpAddr>()
            .is_ok_and(|address| address.is_loopback())
}

/// Lets a request pass or not, and marks every answer.
pub(crate) async fn guard(
    State(access): State<Arc<Access>>,
    peer: axum::Extension<Peer>,
    request: Request,
    next: Next,
) -> Response {
    let path = request.uri().path();
    let is_api = path.starts_with("/api/") || path == "/metrics";
    let mut response = match access.check(peer.0, path, request.headers()) {
        Ok(()) => next.run(request).await,
        Err(failure) => failure.into_response(),
    };
    let headers = response.headers_mut();
    let fixed = [
        (header::CONTENT_SECURITY_POLICY, CONTENT_SECURITY_POLICY),
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (header::REFERRER_POLICY, "no-referrer"),
        (header::X_FRAME_OPTIONS, "DENY"),
    ];
    for (name, value) in fixed {
        headers.insert(name, HeaderValue::from_static(value));
    }
    if is_api {
        let entry = headers.entry(header::CACHE_CONTROL);
        entry.or_insert(HeaderValue::from_static("no-store"));
    }
    response
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::PermissionsExt as _;

    const SECRET: &str = "correct-horse-battery";

    fn headers(pairs: &[(header::HeaderName, &str)]) -> HeaderMap {
        pairs
            .iter()
            .map(|(name, value)| (name.clone(), HeaderValue::from_str(value).unwrap()))
            .collect()
    }

    fn status(access: &Access, path: &str, pairs: &[(header::HeaderName, &str)]) -> u16 {
        match access.check(Peer::Network, path, &headers(pairs)) {
            Ok(()) => 200,
            Err(failure) => failure.into_response().status().as_u16(),
        }
    }

    #[test]
    fn without_a_token_only_this_machine_under_its_own_name_is_heard() {
        let access = Access::default();
        for host in [
            "127.0.0.1:7471",
            "localhost:7471",
            "[::1]:7471",
            "LOCALHOST",
        ] {
            assert_eq!(status(&access, "/api/state", &[(header::HOST, host)]), 200);
        }
        for host in [
            "rebound.example:7471",
            "192.168.0.7:7471",
            "localhost.evil",
            "",
        ] {
            assert_eq!(status(&access, "/api/state", &[(header::HOST, host)]), 403);
        }
    }

    #[test]
    fn pages_of_other_sites_are_refused() {
        let access = Access::default();
        let host = (header::HOST, "127.0.0.1:7471");
        let own = (header::ORIGIN, "http://127.0.0.1:7471");
        assert_eq!(status(&access, "/api/commands", &[host.clone(), own]), 200);
        for origin in ["http://evil.example", "null", "http://127.0.0.1:8000"] {
            let foreign = (header::ORIGIN, origin);
            assert_eq!(
                status(&access, "/api/events", &[host.clone(), foreign]),
                403
            );
        }
    }

    #[test]
    fn the_token_opens_the_api_and_nothing_else_does() {
        let access = Access::new(Some(Token::parse(SECRET).unwrap()));
        let bearer = format!("Bearer {SECRET}");
        let cookie = access.login(SECRET).unwrap().unwrap();
        let cookie = cookie
            .to_str()
            .unwrap()
            .split(';')
            .next()
            .unwrap()
            .to_owned();
        assert!(!cookie.contains(SECRET));
        for shown in [
            (header::AUTHORIZATION, bearer.as_str()),
            (header::COOKIE, cookie.as_str()),
        ] {
            assert_eq!(status(&access, "/api/state", &[shown]), 200);
        }
        for shown in [
            (header::AUTHORIZATION, "Bearer correct-horse-batterz"),
            (header::AUTHORIZATION, "Bearer "),
            (header::AUTHORIZATION, SECRET),
            (header::COOKIE, "gripcast=0"),
        ] {
            assert_eq!(
                status(&access, "/api/state", std::slice::from_ref(&shown)),
                401
            );
            assert_eq!(status(&access, "/metrics", &[shown]), 401);
        }
        assert_eq!(status(&access, "/", &[]), 200, "the page shows the login");
        assert_eq!(status(&access, "/api/login", &[]), 200);
        assert!(access.login("something-else-entirely").is_err());

        access.replace(Some(Token::parse("another-token-altogether").unwrap()));
        let old = (header::COOKIE, cookie.as_str());
        assert_eq!(status(&access, "/api/state", &[old]), 401);
    }

    #[test]
    fn tokens_that_others_can_read_or_that_are_short_are_refused() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("token");
        let write = |text: &str, mode: u32| {
            std::fs::write(&path, text).unwrap();
            std::fs::set_permissions(&path, std::fs::Permissions::from_mode(mode)).unwrap();
        };
        write("correct-horse-battery\n", 0o600);
        let token = Token::read(&path).unwrap();
        assert!(token.is(SECRET));
        assert_eq!(format!("{token:?}"), "Token(…)");
        write(SECRET, 0o644);
        let error = Token::read(&path).unwrap_err();
        assert!(error.to_string().contains("chmod 600"), "{error}");
        write("short", 0o600);
        let error = Token::read(&path).unwrap_err();
        assert!(error.to_string().contains("found 5 characters"), "{error}");
        assert!(!error.to_string().contains("short\n"), "{error}");
    }
}
