//! Security tests of the daemon over real sockets. One file, because all tests share the fixture.

use std::io::{Read, Write};
use std::net::{Ipv4Addr, SocketAddr, TcpStream};
use std::os::unix::net::UnixStream;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use image::RgbImage;
use tokio::net::TcpSocket;
use tokio::runtime::Runtime;
use tokio::sync::{Semaphore, mpsc, watch};

use super::access::{Access, Token};
use super::backend::Backend;
use super::router::router;
use super::serve::{Listeners, serve};
use super::sessions::MAX_FAILURES;
use super::slots::Slots;
use crate::daemon::{CameraState, CameraStatus, CommandRequest, EngineStatus, Preview, Tasks};
use gripcast_capture::camera::monotonic_ns;
use gripcast_dataset::GraspIndex;
use gripcast_imaging::Role;
use gripcast_session::{CommandResult, Labels};

const SECRET: &str = "correct-horse-battery";
/// Timeout that tests wait for.
const SHORT: Duration = Duration::from_millis(100);
/// Maximum wait of a test.
const RESPONSE_TIMEOUT: Duration = Duration::from_secs(60);
/// Side of an image larger than all socket buffers, px.
const LARGE_SIDE: u32 = 1600;

/// A daemon without an engine.
struct Site {
    runtime: Runtime,
    address: SocketAddr,
    socket: PathBuf,
    backend: Arc<Backend>,
    /// Connection slots.
    slots: Slots,
    stop: watch::Sender<bool>,
    server: Option<std::thread::JoinHandle<()>>,
    engine: (
        watch::Sender<Arc<EngineStatus>>,
        mpsc::Receiver<CommandRequest>,
    ),
    _dir: tempfile::TempDir,
}

impl Site {
    fn open(token: Option<&str>, change: impl FnOnce(&mut Listeners, &mut Backend)) -> Self {
        let dir = tempfile::tempdir().unwrap();
        let socket = dir.path().join("s");
        let runtime = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(2)
            .enable_all()
            .build()
            .unwrap();
        let (status, newest) = watch::channel(Arc::new(status()));
        let (commands, requests) = mpsc::channel(1);
        let (stop, stopped) = watch::channel(false);
        let token = token.map(|token| Token::parse(token).unwrap());
        let mut backend = Backend::new(
            newest,
            commands,
            Tasks::default(),
            Arc::new(Access::new(token)),
            None,
            GraspIndex::new(dir.path().join("no-dataset")),
        );
        let listen = Some((Ipv4Addr::LOCALHOST, 0).into());
        let mut listeners = runtime
            .block_on(Listeners::open(listen, Some(&socket)))
            .unwrap();
        change(&mut listeners, &mut backend);
        let (address, slots) = (listeners.address().unwrap(), listeners.slots.clone());
        let backend = Arc::new(backend);
        let router = router(Arc::clone(&backend));
        let handle = runtime.handle().clone();
        let server = std::thread::spawn(move || {
            handle.block_on(serve(listeners, router, Tasks::default(), stopped));
        });
        Self {
            runtime,
            address,
            socket,
            backend,
            slots,
            stop,
            server: Some(server),
            engine: (status, requests),
            _dir: dir,
        }
    }

    fn tcp(&self) -> TcpStream {
        self.tcp_from(Ipv4Addr::LOCALHOST)
    }

    /// Connects from a loopback address with a small receive buffer.
    fn tcp_from(&self, from: Ipv4Addr) -> TcpStream {
        let connecting = async {
            let socket = TcpSocket::new_v4().unwrap();
            socket.set_recv_buffer_size(16 * 1024).unwrap();
            socket.bind((from, 0).into()).unwrap();
            socket.connect(self.address).await.unwrap()
        };
        let stream = self.runtime.block_on(connecting).into_std().unwrap();
        stream.set_nonblocking(false).unwrap();
        stream.set_read_timeout(Some(RESPONSE_TIMEOUT)).unwrap();
        stream
    }

    fn unix(&self) -> UnixStream {
        let stream = UnixStream::connect(&self.socket).unwrap();
        stream.set_read_timeout(Some(RESPONSE_TIMEOUT)).unwrap();
        stream
    }

    /// Opens a connection that has been served and stays open.
    fn open_connection(&self) -> TcpStream {
        let mut stream = self.tcp();
        start(&mut stream, "HEAD /api/state", "Host: localhost\r\n");
        let mut head = Vec::new();
        while !head.ends_with(b"\r\n\r\n") {
            let mut byte = [0];
            stream.read_exact(&mut byte).unwrap();
            head.push(byte[0]);
        }
        stream
    }

    /// Waits until all `count` slots are free.
    fn wait_until_free(&self, slots: &Semaphore, count: u32) {
        let all = async { tokio::time::timeout(RESPONSE_TIMEOUT, slots.acquire_many(count)).await };
        let all = self.runtime.block_on(all);
        drop(all.expect("a slot must be released").unwrap());
    }

    /// Logs in and returns the cookie.
    fn log_in(&self) -> String {
        let answer = log_in(self.tcp(), SECRET).unwrap();
        assert_eq!(answer.status, 204, "{}", answer.text);
        answer.cookie()
    }

    fn status_with(&self, cookie: &str) -> u16 {
        let headers = format!("Host: lab\r\nCookie: {cookie}\r\n");
        request(self.tcp(), "GET /api/state", &headers, "")
            .unwrap()
            .status
    }

    /// Opens an event WebSocket.
    fn listen<S: Read + Write>(
        &self,
        stream: S,
        cookie: Option<&str>,
    ) -> tungstenite::WebSocket<S> {
        use tungstenite::client::IntoClientRequest as _;
        let mut request = "ws://localhost/api/events?previews=true"
            .into_client_request()
            .unwrap();
        if let Some(cookie) = cookie {
            let headers = request.headers_mut();
            headers.insert("cookie", cookie.parse().unwrap());
        }
        match tungstenite::client(request, stream) {
            Ok((socket, _)) => socket,
            Err(error) => panic!("no WebSocket: {error}"),
        }
    }
}

impl Drop for Site {
    fn drop(&mut self) {
        // The server must not outlive the runtime. Its failures fail the test on their own.
        let _ = self.stop.send(true);
        let _ = self.server.take().map(std::thread::JoinHandle::join);
    }
}

/// Returns a status with a preview that is large as a JPEG.
fn status() -> EngineStatus {
    let mut status = EngineStatus::starting("d", "r", Labels::default());
    status.cameras.push(CameraStatus {
        role: Role::Left,
        product: String::new(),
        serial: String::new(),
        port: String::new(),
        state: CameraState::Live,
        measured_fps: 25.0,
        nominal_fps: 25.0,
        frame_age_ms: None,
        counters: Default::default(),
        markers: None,
    });
    let mut noise = 1_u32;
    let image = RgbImage::from_fn(LARGE_SIDE, LARGE_SIDE, |_, _| {
        noise = noise.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        let [_, r, g, b] = noise.to_le_bytes();
        image::Rgb([r, g, b])
    });
    let preview = Preview {
        image: Arc::new(image),
        difference: None,
        levels: None,
        driver_time_ns: 0,
    };
    status.previews.insert(Role::Left, preview);
    status
}

struct HttpResponse {
    status: u16,
    /// Head and body.
    text: String,
}

impl HttpResponse {
    fn header(&self, name: &str) -> Option<&str> {
        self.text.lines().find_map(|line| {
            let (found, value) = line.split_once(": ")?;
            found.eq_ignore_ascii_case(name).then_some(value)
        })
    }

    fn cookie(&self) -> String {
        let cookie = self.header("set-cookie").expect("a cookie");
        cookie.split(';').next().unwrap().to_owned()
    }
}

fn start(stream: &mut impl Write, line: &str, headers: &str) {
    write!(stream, "{line} HTTP/1.1\r\n{headers}\r\n").unwrap();
}

/// Sends a request and reads the response; `None` if the connection is closed without one.
fn request<S: Read + Write>(
    stream: S,
    line: &str,
    headers: &str,
    body: &str,
) -> Option<HttpResponse> {
    let length = body.len();
    let headers = format!("{headers}Content-Length: {length}\r\nConnection: close\r\n");
    let text = format!("{line} HTTP/1.1\r\n{headers}\r\n{body}");
    request_bytes(stream, text.as_bytes())
}

fn request_bytes<S: Read + Write>(mut stream: S, request: &[u8]) -> Option<HttpResponse> {
    // A rejecting server may close before it has read the request.
    let _ = stream.write_all(request);
    read_response(stream)
}

fn read_response(mut stream: impl Read) -> Option<HttpResponse> {
    let mut bytes = Vec::new();
    match stream.read_to_end(&mut bytes) {
        Ok(_) => {}
        Err(e) if e.kind() == std::io::ErrorKind::ConnectionReset => {}
        Err(e) => panic!("no response: {e}"),
    }
    let text = String::from_utf8_lossy(&bytes).into_owned();
    let status = text.split(' ').nth(1)?.parse().unwrap();
    Some(HttpResponse { status, text })
}

fn log_in<S: Read + Write>(stream: S, token: &str) -> Option<HttpResponse> {
    let headers = "Host: localhost\r\nContent-Type: application/json\r\n";
    let body = format!("{{\"token\": \"{token}\"}}");
    request(stream, "POST /api/login", headers, &body)
}

/// Reads a WebSocket until it is closed.
fn read_to_end<S: Read + Write>(mut socket: tungstenite::WebSocket<S>) {
    // States arrive ten times per second.
    const MAX_MESSAGES: usize = 600;
    for _ in 0..MAX_MESSAGES {
        match socket.read() {
            Ok(_) => {}
            Err(tungstenite::Error::Io(e)) if e.kind() == std::io::ErrorKind::WouldBlock => break,
            Err(_) => return,
        }
    }
    panic!("the connection is not closed");
}

/// Reads the start of a successful response.
fn expect_ok(stream: &mut impl Read) {
    let mut head = [0; 12];
    stream.read_exact(&mut head).unwrap();
    assert_eq!(&head, b"HTTP/1.1 200");
}

#[test]
fn missing_body_times_out_and_frees_its_slot() {
    let site = Site::open(Some(SECRET), |listeners, backend| {
        listeners.slots = Slots::new(1, 1);
        backend.body_timeout = SHORT;
    });
    let mut slow = site.tcp();
    let headers = "Host: lab\r\nContent-Type: application/json\r\nContent-Length: 100\r\n";
    start(&mut slow, "POST /api/login", headers);
    slow.write_all(b"{").unwrap();
    let answer = read_response(slow).unwrap();
    assert_eq!(answer.status, 408, "{}", answer.text);
    assert_eq!(log_in(site.tcp(), SECRET).unwrap().status, 204);
}

#[test]
fn missing_head_times_out_and_frees_its_slot() {
    let site = Site::open(None, |listeners, _| {
        listeners.slots = Slots::new(1, 1);
        listeners.limits.head_timeout = SHORT;
    });
    let mut slow = site.tcp();
    slow.write_all(b"GET /api/state HTTP/1.1\r\nHost: ")
        .unwrap();
    assert!(read_response(slow).is_none_or(|answer| answer.status == 408));
    site.wait_until_free(&site.slots.network, 1);
}

#[test]
fn tcp_flood_does_not_block_the_unix_socket() {
    const MAX: usize = 4;
    let site = Site::open(None, |listeners, backend| {
        listeners.slots = Slots::new(MAX, MAX);
        backend.listeners = Slots::new(1, 1);
        backend.previews.streams = Slots::new(1, 1);
    });
    let over_socket = |line| {
        let headers = "Host: localhost\r\n";
        request(site.unix(), line, headers, "").unwrap().status
    };
    // Uses up event slots, stream slots, then connections.
    let _listener = site.listen(site.tcp(), None);
    let mut stream = site.tcp();
    start(
        &mut stream,
        "GET /api/cameras/left/preview.mjpg",
        "Host: localhost\r\n",
    );
    expect_ok(&mut stream);
    let busy = |line, headers: &str| {
        let headers = format!("Host: localhost\r\n{headers}");
        request(site.tcp(), line, &headers, "").unwrap().status
    };
    assert_eq!(busy("GET /api/cameras/left/preview.mjpg", ""), 503);
    let upgrade = "Upgrade: websocket\r\nConnection: upgrade\r\nSec-WebSocket-Version: 13\r\n\
                   Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n";
    assert_eq!(busy("GET /api/events", upgrade), 503);
    let _connections: Vec<TcpStream> = (2..MAX).map(|_| site.open_connection()).collect();
    assert!(request(site.tcp(), "GET /", "Host: localhost\r\n", "").is_none());

    assert_eq!(over_socket("GET /api/state"), 200);
    let _other = site.listen(site.unix(), None);
    let mut stream = site.unix();
    start(
        &mut stream,
        "GET /api/cameras/left/preview.mjpg",
        "Host: localhost\r\n",
    );
    expect_ok(&mut stream);
}

#[test]
fn connections_per_address_are_limited() {
    let site = Site::open(None, |listeners, _| listeners.limits.per_address = 2);
    let connections = [site.open_connection(), site.open_connection()];
    let is_refused = |from: [u8; 4]| {
        request(
            site.tcp_from(from.into()),
            "GET /",
            "Host: localhost\r\n",
            "",
        )
        .is_none()
    };
    assert!(is_refused([127, 0, 0, 1]));
    assert!(!is_refused([127, 0, 0, 2]));
    drop(connections);
    // Released slots can be taken again.
    site.wait_until_free(&site.slots.network, 128);
    assert!(!is_refused([127, 0, 0, 1]));
}

#[test]
fn event_connection_keeps_its_slot() {
    let site = Site::open(None, |listeners, _| listeners.slots = Slots::new(1, 1));
    let _listener = site.listen(site.tcp(), None);
    assert!(request(site.tcp(), "GET /", "Host: localhost\r\n", "").is_none());
}

#[test]
fn large_websocket_frame_is_rejected_before_its_payload() {
    let site = Site::open(None, |_, _| {});
    for length in [4097_u64, 15 << 20] {
        let mut socket = site.listen(site.tcp(), None);
        // Binary, masked, 64-bit length: the header of a frame without its payload.
        let head = [&[0x82, 0xff][..], &length.to_be_bytes(), &[0; 4]].concat();
        socket.get_mut().write_all(&head).unwrap();
        read_to_end(socket);
    }
}

#[test]
fn clients_that_do_not_read_are_dropped() {
    let site = Site::open(None, |listeners, _| listeners.limits.write_timeout = SHORT);
    let headers = "Host: localhost\r\n";
    let mut unread = site.tcp();
    start(&mut unread, "GET /api/cameras/left/preview.mjpg", headers);
    expect_ok(&mut unread);
    site.wait_until_free(&site.backend.previews.streams.network, 32);

    let _listener = site.listen(site.tcp(), None);
    site.wait_until_free(&site.backend.listeners.network, 32);
    let _listener = site.listen(site.unix(), None);
    site.wait_until_free(&site.backend.listeners.local, 32);

    let mut unread = [site.tcp(), site.tcp()];
    for stream in &mut unread {
        start(stream, "GET /api/cameras/left/preview.jpg", headers);
        expect_ok(stream);
    }
    site.wait_until_free(&site.slots.network, 128);
    let mut unread = site.unix();
    start(&mut unread, "GET /api/cameras/left/preview.jpg", headers);
    expect_ok(&mut unread);
    site.wait_until_free(&site.slots.local, 64);
}

/// Request headers and the expected status without a token.
fn header_cases() -> Vec<(&'static str, u16)> {
    let own = [
        ("Host: localhost\r\n", 200),
        (
            "Host: LOCALHOST:7471\r\nOrigin: http://localhost:7471\r\n",
            200,
        ),
        ("Host: [::1]:7471\r\nOrigin: http://[::1]:7471\r\n", 200),
        ("Host: localhost\r\nSec-Fetch-Site: same-origin\r\n", 200),
        ("Host: localhost\r\nSec-Fetch-Site: none\r\n", 200),
        // A proxy replaced the host.
        (
            "Host: localhost\r\nSec-Fetch-Site: same-origin\r\nOrigin: http://localhost:8000\r\n",
            200,
        ),
    ];
    let hosts = [
        ("", 400),
        ("Host: \r\n", 400),
        ("Host: localhost\r\nHost: localhost\r\n", 400),
        ("Host: localhost.\r\n", 400),
        ("Host: evil@localhost\r\n", 400),
        ("Host: localhost:\r\n", 400),
        ("Host: localhost:evil\r\n", 400),
        ("Host: localhost:99999\r\n", 400),
        ("Host: [::1]evil\r\n", 400),
        ("Host: l\u{f6}calhost\r\n", 400),
        ("Host: rebound.example\r\n", 403),
        ("Host: 192.168.0.7\r\n", 403),
    ];
    let origins = [
        ("Host: localhost\r\nOrigin: http://evil.example\r\n", 403),
        ("Host: localhost\r\nOrigin: http://localhost:8000\r\n", 403),
        ("Host: localhost\r\nOrigin: http://localhost.\r\n", 403),
        ("Host: localhost\r\nOrigin: ftp://localhost\r\n", 403),
        ("Host: localhost\r\nOrigin: localhost\r\n", 403),
        ("Host: localhost\r\nOrigin: null\r\n", 403),
        ("Host: localhost\r\nOrigin: \r\n", 403),
        (
            "Host: localhost\r\nOrigin: http://\u{e4}vil.example\r\n",
            403,
        ),
        (
            "Host: localhost\r\nOrigin: http://localhost\r\nOrigin: http://evil.example\r\n",
            403,
        ),
    ];
    let sites = [
        (
            "Host: localhost\r\nSec-Fetch-Site: cross-site\r\nSec-Fetch-Mode: no-cors\r\nSec-Fetch-Dest: image\r\n",
            403,
        ),
        (
            "Host: localhost\r\nSec-Fetch-Site: same-site\r\nSec-Fetch-Mode: no-cors\r\nSec-Fetch-Dest: image\r\n",
            403,
        ),
        (
            "Host: localhost\r\nSec-Fetch-Site: cross-site\r\nSec-Fetch-Mode: navigate\r\nSec-Fetch-Dest: document\r\n",
            403,
        ),
        ("Host: localhost\r\nSec-Fetch-Site: whatever\r\n", 403),
        (
            "Host: localhost\r\nSec-Fetch-Site: none\r\nOrigin: http://evil.example\r\n",
            403,
        ),
        (
            "Host: localhost\r\nSec-Fetch-Site: same-origin\r\nSec-Fetch-Site: same-origin\r\n\
             Origin: http://evil.example\r\n",
            403,
        ),
        (
            "Host: localhost\r\nSec-Fetch-Site: none\r\nSec-Fetch-Site: cross-site\r\n",
            403,
        ),
    ];
    let all = [&own[..], &hosts, &origins, &sites].concat();
    all.into_iter().collect()
}

#[test]
fn cross_site_requests_and_invalid_hosts_are_rejected() {
    let site = Site::open(None, |_, _| {});
    for (headers, expected) in header_cases() {
        let paths = ["/api/state", "/api/cameras/left/preview.jpg"];
        for path in paths {
            let line = format!("GET {path}");
            for answer in [
                request(site.tcp(), &line, headers, ""),
                // `ssh -L` connects browsers to the socket.
                request(site.unix(), &line, headers, ""),
            ] {
                let answer = answer.unwrap();
                assert_eq!(answer.status, expected, "{headers}{}", answer.text);
                for (name, value) in [
                    ("cross-origin-resource-policy", "same-origin"),
                    ("cross-origin-opener-policy", "same-origin"),
                    ("x-content-type-options", "nosniff"),
                    ("x-frame-options", "DENY"),
                    ("referrer-policy", "no-referrer"),
                ] {
                    assert_eq!(answer.header(name), Some(value), "{headers}{path}");
                }
                let policy = answer.header("content-security-policy").unwrap();
                assert!(policy.contains("frame-ancestors 'none'"));
            }
        }
    }
    let elsewhere = request(
        site.tcp(),
        "GET http://evil.example/api/state",
        "Host: localhost\r\n",
        "",
    );
    assert_eq!(elsewhere.unwrap().status, 400);
}

/// A proxy that replaces `Host` passes the `Origin` of module scripts.
#[test]
fn files_of_the_page_need_no_origin() {
    let site = Site::open(None, |_, _| {});
    let status = |line, headers| {
        let headers = format!("Host: localhost\r\n{headers}");
        request(site.tcp(), line, &headers, "").unwrap().status
    };
    let origin = "Origin: http://lab.example:8080\r\n";
    for path in ["GET /", "GET /app.js", "HEAD /style.css"] {
        assert_eq!(status(path, origin), 200, "{path}");
    }
    for line in ["POST /app.js", "GET /api/state", "POST /api/commands"] {
        assert_eq!(status(line, origin), 403, "{line}");
    }
}

/// A proxy that maps `/rig` to `/` passes `/rig/api/state` as `//api/state`.
#[test]
fn leading_slashes_are_one_before_all_checks() {
    let site = Site::open(Some(SECRET), |_, _| {});
    let answer = |line: &str| request(site.tcp(), line, "Host: lab\r\n", "").unwrap();
    assert!(answer("GET //").text.contains("<!DOCTYPE html>"));
    assert_eq!(answer("GET ///app.js").status, 200);
    for path in [
        "//api/state",
        "///metrics",
        "//api/cameras/left/preview.jpg",
    ] {
        assert_eq!(answer(&format!("GET {path}")).status, 401, "{path}");
    }
    let bearer = format!("Host: lab\r\nAuthorization: Bearer {SECRET}\r\n");
    let line = "GET //api/state?x=//y";
    assert_eq!(request(site.tcp(), line, &bearer, "").unwrap().status, 200);
}

/// A browser shows an image once the next boundary has arrived.
#[test]
fn newest_image_of_a_stream_is_followed_by_a_boundary_at_once() {
    let site = Site::open(None, |_, _| {});
    let mut stream = site.tcp();
    start(
        &mut stream,
        "GET /api/cameras/left/preview.mjpg",
        "Host: localhost\r\n",
    );
    let mut text = String::new();
    // The camera delivers one image only; the second boundary ends it.
    while text.matches("--gripcast-frame\r\n").count() < 2 {
        let mut some = [0; 1 << 16];
        let count = stream.read(&mut some).unwrap();
        assert!(count > 0, "{text}");
        text += &String::from_utf8_lossy(&some[..count]);
    }
}

#[test]
fn cross_site_link_opens_the_page_only() {
    let site = Site::open(None, |_, _| {});
    let status = |line, mode, dest| {
        let headers = format!(
            "Host: localhost\r\nSec-Fetch-Site: cross-site\r\nSec-Fetch-Mode: {mode}\r\n\
             Sec-Fetch-Dest: {dest}\r\n"
        );
        request(site.tcp(), line, &headers, "").unwrap().status
    };
    assert_eq!(status("GET /", "navigate", "document"), 200);
    assert_eq!(status("GET /", "navigate", "iframe"), 403);
    assert_eq!(status("GET /", "no-cors", "document"), 403);
    assert_eq!(status("POST /", "navigate", "document"), 403);
    assert_eq!(status("GET /app.js", "no-cors", "script"), 403);
    assert_eq!(status("GET /metrics", "navigate", "document"), 403);
}

#[test]
fn logout_ends_the_session_and_its_connections() {
    let site = Site::open(Some(SECRET), |_, _| {});
    let (one, two) = (site.log_in(), site.log_in());
    assert!(one != two && !one.contains(SECRET));
    assert_eq!((site.status_with(&one), site.status_with(&two)), (200, 200));
    let login_state = |cookie: &str| {
        let headers = format!("Host: lab\r\nCookie: {cookie}\r\n");
        request(site.tcp(), "GET /api/login", &headers, "")
            .unwrap()
            .text
    };
    assert!(login_state(&one).ends_with(r#"{"needs_token":true,"logged_in":true}"#));
    assert!(login_state("no=1").ends_with(r#"{"needs_token":true,"logged_in":false}"#));

    let events = site.listen(site.tcp(), Some(&one));
    let mut stream = site.tcp();
    let headers = format!("Host: lab\r\nCookie: {one}\r\n");
    let closing = format!("{headers}Connection: close\r\n");
    start(&mut stream, "GET /api/cameras/left/preview.mjpg", &closing);
    expect_ok(&mut stream);
    let answer = request(site.tcp(), "POST /api/logout", &headers, "").unwrap();
    assert_eq!(answer.status, 204, "{}", answer.text);
    assert!(answer.header("set-cookie").unwrap().ends_with("Max-Age=0"));
    read_to_end(events);
    std::io::copy(&mut stream, &mut std::io::sink()).unwrap();
    assert_eq!((site.status_with(&one), site.status_with(&two)), (401, 200));

    let another = Token::parse("another-token-altogether").unwrap();
    let events = site.listen(site.tcp(), Some(&two));
    site.backend.access.replace(Some(another));
    read_to_end(events);
    assert_eq!(site.status_with(&two), 401);
}

#[test]
fn guessing_address_is_blocked_and_others_are_not() {
    let site = Site::open(Some(SECRET), |_, _| {});
    let cookie = site.log_in();
    let bearer = |token: &str| {
        let headers = format!("Host: lab\r\nAuthorization: Bearer {token}\r\n");
        request(site.tcp(), "GET /api/state", &headers, "").unwrap()
    };
    for number in 0..MAX_FAILURES {
        let answer = match number % 2 {
            0 => bearer("a-guess-of-the-token"),
            _ => log_in(site.tcp(), "a-guess-of-the-token").unwrap(),
        };
        assert_eq!(answer.status, 401, "{}", answer.text);
    }
    for answer in [bearer(SECRET), log_in(site.tcp(), SECRET).unwrap()] {
        assert_eq!(answer.status, 429, "{}", answer.text);
        let wait: u64 = answer.header("retry-after").unwrap().parse().unwrap();
        assert!((1..=60).contains(&wait));
    }
    let other = site.tcp_from(Ipv4Addr::new(127, 0, 0, 2));
    assert_eq!(log_in(other, SECRET).unwrap().status, 204);
    assert_eq!(log_in(site.unix(), SECRET).unwrap().status, 204);
    assert_eq!(site.status_with(&cookie), 200);
}

/// A command that is repeated with its id reaches the engine once.
#[test]
fn repeated_command_gets_the_first_answer() {
    let mut site = Site::open(None, |_, _| {});
    let headers = "Host: localhost\r\nContent-Type: application/json\r\n";
    let send = |site: &Site, command: &str| {
        let stream = site.tcp();
        let sender = r#"{"request_id": "tap-1", "age_ms": 300, "seen": {"revision": 7}}"#;
        let body = format!(r#"{{"command": "{command}", "sender": {sender}}}"#);
        std::thread::spawn(move || request(stream, "POST /api/commands", headers, &body).unwrap())
    };
    let known = |site: &Site, id: &str| {
        let line = format!("GET /api/commands/{id}");
        request(site.tcp(), &line, "Host: localhost\r\n", "").unwrap()
    };
    let first = send(&site, "undo");
    let queued = site.runtime.block_on(site.engine.1.recv()).unwrap();
    assert_eq!(queued.seen.revision, Some(7));
    assert!(queued.age_ms(monotonic_ns()) >= 300.0);
    let second = send(&site, "undo");
    let other = send(&site, "redo").join().unwrap();
    assert_eq!(other.status, 422, "{}", other.text);
    queued
        .response
        .unwrap()
        .send(CommandResult::Accepted)
        .unwrap();
    for answer in [
        first.join().unwrap(),
        second.join().unwrap(),
        known(&site, "tap-1"),
    ] {
        assert_eq!(answer.status, 200, "{}", answer.text);
        assert!(
            answer.text.contains(r#""result":"accepted""#),
            "{}",
            answer.text
        );
    }
    assert!(site.engine.1.try_recv().is_err(), "executed once");
    assert_eq!(known(&site, "tap-2").status, 404);
}

#[test]
fn previews_wait_for_a_decoder_with_timeout() {
    const PATH: &str = "GET /api/grasps/2026-11-20T10-15-03Z-7f3a/preview/grasp/left.jpg";
    let site = Site::open(None, |_, backend| {
        backend.decodes = Arc::new(Semaphore::new(1));
        backend.decode_timeout = SHORT;
    });
    let get = || request(site.tcp(), PATH, "Host: localhost\r\n", "").unwrap();
    let permit = Arc::clone(&site.backend.decodes)
        .try_acquire_owned()
        .unwrap();
    let answer = get();
    assert_eq!(answer.status, 503, "{}", answer.text);
    assert_eq!(answer.header("retry-after"), Some("1"));
    drop(permit);
    assert_eq!(get().status, 404, "the dataset does not exist");
}
