//! A page that is served while something flies: on loopback alone, one port, one thread, as many viewers as come.
//!
//! `GET /` is the page, `GET /events` the flight as server-sent events: `flight`, all that was recorded so far, then one
//! message per frame. A request must be whole within [`PATIENCE`] and [`MAX_REQUEST`], a GET of one of the two, and name this
//! server in `Host`, so that no page of elsewhere gets here by a name that it makes point to loopback. Whoever asks for anything
//! else gets an empty answer, and who does not even speak HTTP none.

use super::page::live_page;
use super::recording::Recording;
use omnidrones::error::{Error, Result};
use std::io::{ErrorKind, Read, Write};
use std::net::{Ipv4Addr, TcpListener, TcpStream};
use std::time::{Duration, Instant};

/// Longest request, bytes.
const MAX_REQUEST: usize = 8192;
/// Longest time for a request to arrive whole.
const PATIENCE: Duration = Duration::from_secs(5);
/// How long who was answered may take to read the page.
const READING: Duration = Duration::from_secs(30);
/// Most connections at once.
const MAX_CLIENTS: usize = 32;
/// Who has not fetched so much is dropped, bytes: a browser comes back by itself and gets all there is.
const MAX_BEHIND: usize = 8 << 20;

/// The server of a live page. Nothing happens but in its functions: call [`pump`](Server::pump) often.
#[derive(Debug)]
pub struct Server {
    listener: TcpListener,
    port: u16,
    page: String,
    clients: Vec<Client>,
}

#[derive(Debug)]
struct Client {
    stream: TcpStream,
    came: Instant,
    request: Vec<u8>,
    /// What is to be sent still.
    waiting: Vec<u8>,
    talk: Talk,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Talk {
    /// The request is not whole.
    Asking,
    /// The answer is; then the connection ends.
    Answered,
    /// Frames follow.
    Listening,
    Gone,
}

impl Server {
    /// On a port of 127.0.0.1; 0 takes one that is free.
    ///
    /// # Errors
    /// [`Error::Value`] for a port that cannot be had.
    pub fn new(port: u16) -> Result<Self> {
        let refused = |error: std::io::Error| {
            let value = format!("{port} ({error})");
            Error::value("port", value, "one that is free", "Name another one, or 0 for any that is free.")
        };
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, port)).map_err(refused)?;
        listener.set_nonblocking(true).map_err(refused)?;
        let port = listener.local_addr().map_err(refused)?.port();
        Ok(Self { listener, port, page: live_page(), clients: Vec::new() })
    }

    /// What to open.
    pub fn address(&self) -> String {
        format!("http://127.0.0.1:{}/", self.port)
    }

    /// Viewers that listen now.
    pub fn viewers(&self) -> usize {
        self.clients.iter().filter(|c| c.talk == Talk::Listening).count()
    }

    /// Tells everybody of a flight that begins.
    pub fn begin(&mut self, recording: &Recording) {
        self.tell(&flight(recording));
    }

    /// Tells everybody of its last frame.
    pub fn frame(&mut self, recording: &Recording) {
        self.tell(&format!("data: {}\n\n", recording.last_row()));
    }

    fn tell(&mut self, event: &str) {
        for client in self.clients.iter_mut().filter(|c| c.talk == Talk::Listening) {
            client.waiting.extend_from_slice(event.as_bytes());
        }
    }

    /// Takes in who comes, answers, sends; `now` is what those get to see who come in the middle. Never waits.
    pub fn pump(&mut self, now: Option<&Recording>) {
        for _ in 0..MAX_CLIENTS {
            let Ok((stream, _)) = self.listener.accept() else { break };
            if self.clients.len() < MAX_CLIENTS && stream.set_nonblocking(true).is_ok() {
                let _ = stream.set_nodelay(true);
                let (came, talk) = (Instant::now(), Talk::Asking);
                self.clients.push(Client { stream, came, request: Vec::new(), waiting: Vec::new(), talk });
            }
        }
        let (page, port) = (&self.page, self.port);
        for client in &mut self.clients {
            if client.talk == Talk::Asking {
                client.listen(|request| answer(request, port, page, now));
            } else {
                client.drain();
            }
            client.send();
        }
        self.clients.retain(|client| client.talk != Talk::Gone);
    }
}

impl Client {
    /// Reads on until the request is whole.
    fn listen(&mut self, answer: impl FnOnce(&[u8]) -> Option<(Vec<u8>, Talk)>) {
        let mut part = [0; 2048];
        loop {
            match self.stream.read(&mut part) {
                Ok(0) => return self.talk = Talk::Gone,
                Ok(n) => self.request.extend_from_slice(&part[..n]),
                Err(error) if error.kind() == ErrorKind::WouldBlock => break,
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(_) => return self.talk = Talk::Gone,
            }
            if self.request.len() > MAX_REQUEST {
                return self.talk = Talk::Gone;
            }
        }
        if self.request.windows(4).any(|end| end == b"\r\n\r\n") {
            match answer(&self.request) {
                Some((bytes, talk)) => (self.waiting, self.talk) = (bytes, talk),
                None => self.talk = Talk::Gone,
            }
            self.request = Vec::new();
        } else if self.came.elapsed() > PATIENCE {
            self.talk = Talk::Gone;
        }
    }

    /// What else it says is of no interest, but for its end.
    fn drain(&mut self) {
        let mut part = [0; 512];
        match self.stream.read(&mut part) {
            Ok(0) => self.talk = Talk::Gone,
            Err(error) if ![ErrorKind::WouldBlock, ErrorKind::Interrupted].contains(&error.kind()) => {
                self.talk = Talk::Gone;
            }
            _ => {}
        }
    }

    /// Sends as much as goes without waiting.
    fn send(&mut self) {
        let mut sent = 0;
        while self.talk != Talk::Gone && sent < self.waiting.len() {
            match self.stream.write(&self.waiting[sent..]) {
                Ok(0) => self.talk = Talk::Gone,
                Ok(n) => sent += n,
                Err(error) if error.kind() == ErrorKind::WouldBlock => break,
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(_) => self.talk = Talk::Gone,
            }
        }
        self.waiting.drain(..sent);
        let slow = self.talk == Talk::Answered && self.came.elapsed() > PATIENCE + READING;
        if slow || self.waiting.len() > MAX_BEHIND || self.talk == Talk::Answered && self.waiting.is_empty() {
            self.talk = Talk::Gone;
        }
    }
}

/// What a whole request gets; none for what is no HTTP.
fn answer(request: &[u8], port: u16, page: &str, now: Option<&Recording>) -> Option<(Vec<u8>, Talk)> {
    let text = std::str::from_utf8(request).ok()?;
    let (head, _) = text.split_once("\r\n\r\n")?;
    let mut lines = head.split("\r\n");
    let mut words = lines.next()?.split(' ');
    let (method, path, version) = (words.next()?, words.next()?, words.next()?);
    if words.next().is_some() || !version.starts_with("HTTP/1.") {
        return None;
    }
    let hosts: Vec<&str> = lines
        .filter_map(|line| line.split_once(':'))
        .filter(|(name, _)| name.eq_ignore_ascii_case("host"))
        .map(|(_, value)| value.trim())
        .collect();
    let own = [format!("127.0.0.1:{port}"), format!("localhost:{port}")];
    // of the usual port browsers say nothing
    let bare: &[&str] = if port == 80 { &["127.0.0.1", "localhost"] } else { &[] };
    let mut names = own.iter().map(String::as_str).chain(bare.iter().copied());
    if hosts.len() != 1 || !names.any(|name| name.eq_ignore_ascii_case(hosts[0])) {
        return Some(empty("403 Forbidden"));
    }
    if method != "GET" {
        return Some(empty("405 Method Not Allowed"));
    }
    match path {
        "/" => {
            let head = head_of("200 OK", "text/html; charset=utf-8", Some(page.len()));
            Some(((head + page).into_bytes(), Talk::Answered))
        }
        "/events" => {
            let head = head_of("200 OK", "text/event-stream", None);
            Some(((head + &now.map(flight).unwrap_or_default()).into_bytes(), Talk::Listening))
        }
        _ => Some(empty("404 Not Found")),
    }
}

fn empty(status: &str) -> (Vec<u8>, Talk) {
    (head_of(status, "text/plain", Some(0)).into_bytes(), Talk::Answered)
}

fn head_of(status: &str, kind: &str, length: Option<usize>) -> String {
    let length = length.map_or_else(String::new, |n| format!("Content-Length: {n}\r\n"));
    format!(
        "HTTP/1.1 {status}\r\nContent-Type: {kind}\r\n{length}Cache-Control: no-store\r\nX-Content-Type-Options: nosniff\r\n\
         X-Frame-Options: DENY\r\nCross-Origin-Resource-Policy: same-origin\r\nReferrer-Policy: no-referrer\r\n\
         Connection: close\r\n\r\n"
    )
}

/// All that was recorded so far, as an event.
fn flight(recording: &Recording) -> String {
    format!("event: flight\ndata: {}\n\n", recording.to_json())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn recording() -> Recording {
        Recording::new("a\nname", 0.02, Vec::new(), Vec::new())
    }

    /// What a client gets that sends this; the connection is closed for writing behind it unless it `stays`.
    fn asked(server: &mut Server, request: &[u8]) -> String {
        let mut stream = TcpStream::connect((Ipv4Addr::LOCALHOST, server.port)).unwrap();
        stream.set_read_timeout(Some(Duration::from_millis(5))).unwrap();
        // a server that has had enough closes the connection under the writer
        let _ = stream.write_all(request);
        let (mut all, mut part) = (Vec::new(), [0; 65_536]);
        for _ in 0..200 {
            server.pump(Some(&recording()));
            match stream.read(&mut part) {
                Ok(0) => break,
                Ok(n) => all.extend_from_slice(&part[..n]),
                Err(error) if error.kind() == ErrorKind::ConnectionReset => break,
                Err(_) if all.windows(7).any(|w| w == b"flight\n") => break,
                Err(_) => {}
            }
        }
        String::from_utf8(all).unwrap()
    }

    fn get(server: &Server, path: &str) -> String {
        format!("GET {path} HTTP/1.1\r\nHost: 127.0.0.1:{}\r\n\r\n", server.port)
    }

    #[test]
    fn the_page_and_the_flight_are_served_on_loopback_and_nothing_else_is() {
        let mut server = Server::new(0).unwrap();
        assert!(server.listener.local_addr().unwrap().ip().is_loopback());
        let page = get(&server, "/");
        let page = asked(&mut server, page.as_bytes());
        assert!(page.starts_with("HTTP/1.1 200 OK\r\n") && page.trim_end().ends_with("</html>"));
        let port = server.port;
        let line = |method: &str, path: &str, host: &str| format!("{method} {path} HTTP/1.1\r\nHost: {host}\r\n\r\n");
        let own = format!("127.0.0.1:{port}");
        for (request, status) in [
            (line("GET", "/../../etc/passwd", &own), "404"),
            (line("GET", "/%2e%2e/etc/passwd", &own), "404"),
            (line("GET", "//", &own), "404"),
            (line("GET", "http://evil.example/", &own), "404"),
            (line("POST", "/", &own), "405"),
            (line("OPTIONS", "/events", &own), "405"),
            (line("get", "/", &own), "405"),
            (line("GET", "/", "evil.example"), "403"),
            (line("GET", "/events", &format!("evil.example:{port}")), "403"),
            (line("GET", "/", &format!("127.0.0.1:{}", port ^ 1)), "403"),
            (format!("GET / HTTP/1.1\r\nHost: {own}\r\nHost: evil.example\r\n\r\n"), "403"),
            ("GET / HTTP/1.1\r\n\r\n".into(), "403"),
        ] {
            let told = asked(&mut server, request.as_bytes());
            assert!(told.starts_with(&format!("HTTP/1.1 {status} ")), "{request}: {told}");
            assert!(told.contains("Content-Length: 0\r\n") && told.ends_with("\r\n\r\n"), "{request}: {told}");
        }
    }

    #[test]
    fn what_is_no_request_gets_no_byte() {
        let mut server = Server::new(0).unwrap();
        let own = format!("Host: 127.0.0.1:{}\r\n", server.port);
        let long = format!("GET / HTTP/1.1\r\n{own}X: {}\r\n\r\n", "x".repeat(2 * MAX_REQUEST));
        for request in [
            b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03\r\n\r\n".to_vec(),
            b"\xff\xfe\r\n\r\n".to_vec(),
            format!("GET /\r\n{own}\r\n").into_bytes(),
            format!("GET / HTTP/2\r\n{own}\r\n").into_bytes(),
            format!("GET / a HTTP/1.1\r\n{own}\r\n").into_bytes(),
            b"\r\n\r\n".to_vec(),
            long.into_bytes(),
        ] {
            assert_eq!(asked(&mut server, &request), "", "{}", String::from_utf8_lossy(&request));
        }
        assert!(server.clients.is_empty());
    }

    #[test]
    fn who_comes_late_or_comes_back_gets_all_there_is() {
        let mut server = Server::new(0).unwrap();
        for _ in 0..2 {
            let request = get(&server, "/events");
            let told = asked(&mut server, request.as_bytes());
            let (_, body) = told.split_once("\r\n\r\n").unwrap();
            let data = body.strip_prefix("event: flight\ndata: ").unwrap().trim_end();
            let value: serde_json::Value = serde_json::from_str(data).unwrap();
            assert_eq!((&value["title"], &value["frames"]), (&"a\nname".into(), &0.into()));
        }
        server.pump(None);
        assert_eq!(server.viewers(), 0, "both have gone");
    }

    #[test]
    fn two_viewers_see_the_same_frames() {
        let mut server = Server::new(0).unwrap();
        let mut streams: Vec<TcpStream> =
            (0..2).map(|_| TcpStream::connect((Ipv4Addr::LOCALHOST, server.port)).unwrap()).collect();
        let request = get(&server, "/events");
        for stream in &mut streams {
            stream.write_all(request.as_bytes()).unwrap();
            stream.set_read_timeout(Some(Duration::from_millis(5))).unwrap();
        }
        while server.viewers() < 2 {
            server.pump(None);
        }
        server.begin(&recording());
        server.frame(&recording());
        let mut told = vec![String::new(); 2];
        for _ in 0..200 {
            server.pump(None);
            for (stream, told) in streams.iter_mut().zip(&mut told) {
                let mut part = [0; 4096];
                if let Ok(n) = stream.read(&mut part) {
                    *told += std::str::from_utf8(&part[..n]).unwrap();
                }
            }
            if told.iter().all(|t| t.ends_with("data: []\n\n")) {
                break;
            }
        }
        assert!(told[0].ends_with("data: []\n\n") && told[0] == told[1], "{told:?}");
    }
}
