//! A scripted HTTP server for tests.

use std::io::{Read as _, Write as _};
use std::net::{TcpListener, TcpStream};
use std::sync::{Arc, Mutex};
use std::thread;

use serde_json::json;

/// Reply to one connection.
pub(super) enum Reply {
    /// Status line and headers without length, body.
    Http(String, Vec<u8>),
    /// A body that never ends.
    Endless,
    /// The connection is closed without a reply.
    Hangup,
    /// The connection stays open without a reply.
    Silence,
}

impl Reply {
    pub(super) fn status(status: &str, headers: &str, body: &str) -> Self {
        Self::Http(
            format!("HTTP/1.1 {status}\r\n{headers}"),
            body.as_bytes().to_vec(),
        )
    }

    /// Answer of a model.
    pub(super) fn answer(content: &str) -> Self {
        let message = json!({"role": "assistant", "content": content});
        let body = json!({"id": "x", "choices": [{"index": 0, "message": message}]});
        Self::status(
            "200 OK",
            "content-type: application/json\r\n",
            &body.to_string(),
        )
    }
}

/// Serves its script, one connection per reply; then connections are refused.
pub(super) struct TestServer {
    pub(super) url: String,
    requests: Arc<Mutex<Vec<String>>>,
}

impl TestServer {
    pub(super) fn new(script: Vec<Reply>) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let url = format!("http://{}/v1", listener.local_addr().unwrap());
        let requests = Arc::new(Mutex::new(Vec::new()));
        let seen = Arc::clone(&requests);
        thread::spawn(move || {
            let mut open = Vec::new();
            for reply in script {
                let (mut stream, _) = listener.accept().unwrap();
                seen.lock().unwrap().push(request(&mut stream));
                serve(&mut stream, &reply);
                if matches!(reply, Reply::Silence) {
                    open.push(stream);
                }
            }
            if !open.is_empty() {
                let _ = listener.accept();
            }
        });
        Self { url, requests }
    }

    /// The requests so far, head and body.
    pub(super) fn requests(&self) -> Vec<String> {
        self.requests.lock().unwrap().clone()
    }
}

fn request(stream: &mut TcpStream) -> String {
    let mut bytes = Vec::new();
    let mut buffer = [0; 4096];
    loop {
        let count = stream.read(&mut buffer).unwrap();
        bytes.extend_from_slice(&buffer[..count]);
        let text = String::from_utf8_lossy(&bytes).into_owned();
        let whole = text.split_once("\r\n\r\n").is_some_and(|(head, body)| {
            let head = head.to_lowercase();
            let length = head
                .lines()
                .find_map(|l| l.strip_prefix("content-length: "));
            body.len() >= length.map_or(0, |l| l.parse().unwrap())
        });
        if whole || count == 0 {
            return text;
        }
    }
}

fn serve(stream: &mut TcpStream, reply: &Reply) {
    match reply {
        Reply::Http(head, body) => {
            let length = body.len();
            let head = format!("{head}content-length: {length}\r\nconnection: close\r\n\r\n");
            stream.write_all(head.as_bytes()).unwrap();
            stream.write_all(body).unwrap();
        }
        Reply::Endless => {
            stream
                .write_all(b"HTTP/1.1 200 OK\r\nconnection: close\r\n\r\n")
                .unwrap();
            while stream.write_all(&[b' '; 1 << 16]).is_ok() {}
        }
        Reply::Hangup | Reply::Silence => {}
    }
}
