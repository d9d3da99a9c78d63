//! Access control of the daemon.
//!
//! * Every request: a valid `Host`, and no cross-site request ([`super::origin`]).
//! * Unix socket: everyone who may open it. The `Host` must name this machine, because `ssh -L`
//!   connects browsers to the socket.
//! * TCP without a token (loopback only): programs on this machine. The `Host` must name it,
//!   against DNS rebinding.
//! * TCP with a token: `Authorization: Bearer`, or the cookie of a login session.

use std::fmt;
use std::fs::File;
use std::io::Read as _;
use std::net::IpAddr;
use std::os::unix::fs::MetadataExt as _;
use std::path::Path;
use std::sync::{Arc, Mutex};
use std::time::Instant;

use axum::extract::{Request, State};
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse as _, Response};
use subtle::ConstantTimeEq as _;

use super::failure::Failure;
use super::origin;
use super::sessions::{Failures, SessionKey, Sessions};
use crate::daemon::lock;
use gripcast_base::error::{Error, Result};
use gripcast_base::files::sha256_hex;

/// Minimum length of a token, characters.
const MIN_TOKEN_CHARS: usize = 16;
/// Maximum size of a token file, bytes.
const MAX_TOKEN_BYTES: u64 = 1024;
/// Name of the session cookie.
const COOKIE: &str = "gripcast";
/// Maximum cookies of that name to check; a browser sends one.
const MAX_COOKIES: usize = 4;
/// Attributes of the cookie: not readable by scripts, not sent by other sites.
const COOKIE_ATTRIBUTES: &str = "Path=/; HttpOnly; SameSite=Strict";

/// Allows own files only, and no embedding. The hash is that of the only inline script, which adds
/// a missing `/` to the address of the page below a proxy's path.
pub(super) const CONTENT_SECURITY_POLICY: &str = "default-src 'none'; \
     script-src 'self' 'sha256-3oLP79nhG9DuRkiDt5p87o4gLPlodsizyYywHO19FkA='; style-src 'self'; \
     img-src 'self' blob: data:; connect-src 'self'; manifest-src 'self'; base-uri 'none'; \
     form-action 'none'; frame-ancestors 'none'";

/// Headers of every response: no embedding and no window access by other sites.
const SECURITY_HEADERS: [(HeaderName, &str); 6] = [
    (header::CONTENT_SECURITY_POLICY, CONTENT_SECURITY_POLICY),
    (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
    (header::REFERRER_POLICY, "no-referrer"),
    (header::X_FRAME_OPTIONS, "DENY"),
    (
        HeaderName::from_static("cross-origin-resource-policy"),
        "same-origin",
    ),
    (
        HeaderName::from_static("cross-origin-opener-policy"),
        "same-origin",
    ),
];

/// Returns whether others can read or change a file. Files of root may be readable by their group:
/// the package gives the token to the service's group.
fn is_open(owner: u32, mode: u32) -> bool {
    let allowed = if owner == 0 { 0o040 } else { 0 };
    mode & 0o077 & !allowed != 0
}

/// A secret token, never printed.
#[derive(Clone)]
pub(crate) struct Token(String);

impl fmt::Debug for Token {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Token(…)")
    }
}

impl Token {
    /// Reads a token from a file that only its owner, or the group of a root-owned file, can read.
    ///
    /// # Errors
    /// `Config` for a file that others can read or without a token of at least 16 printable
    /// characters; `Io`, `NotFound`, … if it cannot be read.
    pub(crate) fn read(path: &Path) -> Result<Self> {
        let unreadable = |e| Error::io("cannot read the token", e).at(path.display());
        let file = File::open(path).map_err(unreadable)?;
        let metadata = file.metadata().map_err(unreadable)?;
        let mode = metadata.mode();
        if is_open(metadata.uid(), mode) {
            return Err(Error::config(format!(
                "the token file is readable by others (mode {:o})",
                mode & 0o777
            ))
            .at(path.display())
            .remedy(format!("chmod 600 {}", path.display())));
        }
        let mut text = String::new();
        file.take(MAX_TOKEN_BYTES)
            .read_to_string(&mut text)
            .map_err(unreadable)?;
        Self::parse(&text).map_err(|e| e.at(path.display()))
    }

    pub(super) fn parse(text: &str) -> Result<Self> {
        let token = text.trim();
        let printable = token.chars().all(|c| c.is_ascii_graphic());
        if token.len() < MIN_TOKEN_CHARS || !printable {
            return Err(Error::config(format!(
                "expected a token of at least {MIN_TOKEN_CHARS} printable ASCII characters \
                     without spaces, found {} characters",
                token.chars().count()
            ))
            .remedy("create one: head -c 24 /dev/urandom | base64 > FILE; chmod 600 FILE"));
        }
        Ok(Self(token.to_owned()))
    }

    fn matches(&self, shown: &str) -> bool {
        // Digests have equal lengths, so timing does not reveal the length of the token.
        let (ours, theirs) = (sha256_hex(&self.0), sha256_hex(shown));
        bool::from(ours.as_bytes().ct_eq(theirs.as_bytes()))
    }

    /// Returns the value of the `Authorization` header.
    pub(super) fn bearer(&self) -> String {
        format!("Bearer {}", self.0)
    }
}

/// Origin of a connection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Peer {
    /// TCP, from this address.
    Network(IpAddr),
    /// Unix socket.
    Local,
}

/// Token and login sessions.
#[derive(Debug, Default)]
pub(crate) struct Access(Mutex<Inner>);

#[derive(Debug, Default)]
struct Inner {
    token: Option<Token>,
    sessions: Sessions,
    failures: Failures,
}

impl Inner {
    /// Checks a token. An address with too many invalid tokens is blocked for a while.
    fn check_token(&mut self, from: Peer, shown: &str, now: Instant) -> Result<bool, Failure> {
        let Some(token) = &self.token else {
            return Ok(false);
        };
        let Peer::Network(from) = from else {
            return Ok(token.matches(shown));
        };
        if let Some(wait) = self.failures.wait(from, now) {
            return Err(Failure::new(
                StatusCode::TOO_MANY_REQUESTS,
                format!("too many invalid tokens from {from}"),
            )
            .remedy(format!(
                "wait {} s, or use the Unix socket",
                wait.as_secs() + 1
            ))
            .retry_after(wait));
        }
        let is_token = token.matches(shown);
        if !is_token {
            self.failures.note(from, now);
        }
        Ok(is_token)
    }
}

/// Credential with which a request was accepted.
#[derive(Clone, Debug)]
pub(crate) struct Authorisation {
    access: Arc<Access>,
    credential: Credential,
}

#[derive(Clone, Debug)]
enum Credential {
    /// Unix socket.
    Local,
    /// None: no token is set, or the path is public.
    None,
    Token(Token),
    Session(SessionKey),
}

impl Authorisation {
    /// Returns whether the credential is still valid: not after a logout or a change of the token.
    /// Long responses check this repeatedly.
    pub(crate) fn is_valid(&self) -> bool {
        let mut inner = lock(&self.access.0);
        match &self.credential {
            Credential::Local => true,
            Credential::None => inner.token.is_none(),
            Credential::Token(shown) => inner
                .token
                .as_ref()
                .is_some_and(|token| token.matches(&shown.0)),
            Credential::Session(key) => inner.sessions.is_open(key, Instant::now(), false),
        }
    }

    /// Returns whether the request belongs to a login session.
    pub(crate) fn is_session(&self) -> bool {
        matches!(self.credential, Credential::Session(_))
    }

    /// Closes the session, if any, and returns an expired cookie.
    pub(crate) fn log_out(&self) -> HeaderValue {
        if let Credential::Session(key) = &self.credential {
            lock(&self.access.0).sessions.close(key);
        }
        HeaderValue::from_static("gripcast=; Path=/; HttpOnly; SameSite=Strict; Max-Age=0")
    }
}

impl Access {
    /// Creates access control with an optional token.
    pub(crate) fn new(token: Option<Token>) -> Self {
        Self(Mutex::new(Inner {
            token,
            ..Inner::default()
        }))
    }

    /// Replaces the token; sessions opened with another token are closed.
    pub(crate) fn replace(&self, token: Option<Token>) {
        let mut inner = lock(&self.0);
        let is_same = match (&inner.token, &token) {
            (Some(before), Some(now)) => before.matches(&now.0),
            (None, None) => true,
            _ => false,
        };
        if !is_same {
            inner.sessions.clear();
            inner.token = token;
        }
    }

    /// Returns whether a token is required.
    pub(crate) fn needs_token(&self) -> bool {
        lock(&self.0).token.is_some()
    }

    /// Opens a session for a valid token and returns its cookie; `None` if no token is required.
    ///
    /// # Errors
    /// 401 for an invalid token, 429 after too many of them.
    pub(crate) fn log_in(&self, from: Peer, shown: &str) -> Result<Option<HeaderValue>, Failure> {
        let (mut inner, now) = (lock(&self.0), Instant::now());
        if inner.token.is_none() {
            return Ok(None);
        }
        if !inner.check_token(from, shown, now)? {
            return Err(Failure::new(StatusCode::UNAUTHORIZED, "invalid token"));
        }
        let id = inner.sessions.open(now)?;
        Ok(HeaderValue::from_str(&format!("{COOKIE}={id}; {COOKIE_ATTRIBUTES}")).ok())
    }

    /// Checks a request and returns its credential.
    fn check(&self, peer: Peer, request: &Request) -> Result<Credential, Failure> {
        let host = origin::check(request)?;
        let (mut inner, now) = (lock(&self.0), Instant::now());
        let is_open = peer == Peer::Local || inner.token.is_none();
        if is_open && !host.is_this_machine() {
            return Err(Failure::new(
                StatusCode::FORBIDDEN,
                "expected a `Host` that names this machine, for example localhost",
            )
            .remedy(
                "open the page at the address printed by the daemon; behind a proxy with another \
                 name, start the daemon with --token-file",
            ));
        }
        if peer == Peer::Local {
            return Ok(Credential::Local);
        }
        let keys = session_keys(request.headers());
        for key in keys {
            if inner.sessions.is_open(&key, now, true) {
                return Ok(Credential::Session(key));
            }
        }
        if let Some(token) = bearer(request.headers())
            && inner.check_token(peer, token, now)?
        {
            return Ok(Credential::Token(Token(token.to_owned())));
        }
        let path = request.uri().path();
        if is_open || !is_api(path) || path == "/api/login" {
            return Ok(Credential::None);
        }
        Err(
            Failure::new(StatusCode::UNAUTHORIZED, "the daemon requires its token")
                .remedy("send `Authorization: Bearer TOKEN`, or log in on the page"),
        )
    }
}

/// Whether a path belongs to the API; all others are public files of the page.
pub(super) fn is_api(path: &str) -> bool {
    path.starts_with("/api/") || path == "/metrics"
}

fn bearer(headers: &HeaderMap) -> Option<&str> {
    let text = headers.get(header::AUTHORIZATION)?.to_str().ok()?;
    text.strip_prefix("Bearer ").map(str::trim)
}

fn session_keys(headers: &HeaderMap) -> impl Iterator<Item = SessionKey> {
    let cookies = headers.get_all(header::COOKIE).iter();
    cookies
        .filter_map(|value| value.to_str().ok())
        .flat_map(|line| line.split(';'))
        .filter_map(|pair| pair.trim().split_once('='))
        .filter(|(name, _)| *name == COOKIE)
        .map(|(_, id)| SessionKey::new(id))
        .take(MAX_COOKIES)
}

/// Middleware that checks every request and adds the security headers.
pub(crate) async fn guard(
    State(access): State<Arc<Access>>,
    peer: axum::Extension<Peer>,
    mut request: Request,
    next: Next,
) -> Response {
    let is_api = is_api(request.uri().path());
    let mut response = match access.check(peer.0, &request) {
        Ok(credential) => {
            request
                .extensions_mut()
                .insert(Authorisation { access, credential });
            next.run(request).await
        }
        Err(failure) => failure.into_response(),
    };
    let headers = response.headers_mut();
    headers.reserve(SECURITY_HEADERS.len() + 1);
    for (name, value) in SECURITY_HEADERS {
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

    const FROM: Peer = Peer::Network(IpAddr::V4(std::net::Ipv4Addr::LOCALHOST));

    fn status(access: &Access, path: &str, pairs: &[(&str, &str)]) -> u16 {
        let mut request = Request::builder().uri(path);
        for (name, value) in pairs {
            request = request.header(*name, *value);
        }
        let request = request.body(axum::body::Body::empty()).unwrap();
        match access.check(FROM, &request) {
            Ok(_) => 200,
            Err(failure) => failure.into_response().status().as_u16(),
        }
    }

    const LAB: (&str, &str) = ("host", "lab.example");

    #[test]
    fn api_requires_token_or_session_cookie() {
        let access = Access::new(Some(Token::parse(SECRET).unwrap()));
        let bearer = format!("Bearer {SECRET}");
        let cookie = access.log_in(FROM, SECRET).unwrap().unwrap();
        let cookie = cookie.to_str().unwrap();
        assert!(!cookie.contains(SECRET) && cookie.ends_with("; HttpOnly; SameSite=Strict"));
        let cookie = cookie.split(';').next().unwrap();
        for shown in [("authorization", bearer.as_str()), ("cookie", cookie)] {
            assert_eq!(status(&access, "/api/state", &[LAB, shown]), 200);
        }
        for shown in [
            ("authorization", "Bearer correct-horse-batterz"),
            ("authorization", "Bearer "),
            ("authorization", SECRET),
            ("cookie", "gripcast=0"),
            ("cookie", "gripcast="),
        ] {
            assert_eq!(status(&access, "/api/state", &[LAB, shown]), 401);
            assert_eq!(status(&access, "/metrics", &[LAB, shown]), 401);
        }
        assert_eq!(status(&access, "/", &[LAB]), 200, "the page must be public");
        assert_eq!(status(&access, "/api/login", &[LAB]), 200);
        assert_eq!(status(&access, "/api/logout", &[LAB]), 401);
        assert!(access.log_in(FROM, "something-else-entirely").is_err());

        let show = ("cookie", cookie);
        access.replace(Some(Token::parse(SECRET).unwrap()));
        assert_eq!(status(&access, "/api/state", &[LAB, show]), 200);
        access.replace(Some(Token::parse("another-token-altogether").unwrap()));
        assert_eq!(status(&access, "/api/state", &[LAB, show]), 401);
    }

    #[test]
    fn group_may_read_token_of_root_only() {
        for (owner, mode, open) in [
            (1000, 0o600, false),
            (1000, 0o640, true),
            (0, 0o640, false),
            (0, 0o660, true),
            (0, 0o644, true),
        ] {
            assert_eq!(is_open(owner, mode), open, "{owner} {mode:o}");
        }
    }

    #[test]
    fn readable_or_short_tokens_are_rejected() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("token");
        let write = |text: &str, mode: u32| {
            std::fs::write(&path, text).unwrap();
            std::fs::set_permissions(&path, std::fs::Permissions::from_mode(mode)).unwrap();
        };
        write("correct-horse-battery\n", 0o600);
        let token = Token::read(&path).unwrap();
        assert!(token.matches(SECRET));
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
