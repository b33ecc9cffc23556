//! The port of the live view, its connections and their threads.

use std::io::{self, Read, Write};
use std::net::{IpAddr, Ipv4Addr, Shutdown, SocketAddr, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use tungstenite::handshake::server::{create_response, write_response};
use tungstenite::http::Request;
use tungstenite::protocol::{Role, WebSocket, WebSocketConfig};
use tungstenite::{Error as WireError, Message};

use super::gate::{Asked, Wanted, judge};
use super::state::{LiveState, Snapshot};

/// Time between two snapshots to one page: 50 Hz.
pub const PERIOD: Duration = Duration::from_millis(20);
/// Connections at once; one more gets a refusal.
pub const CONNECTIONS_MAX: usize = 32;
const REQUEST_MAX_BYTES: usize = 16 * 1024;
/// Bytes that are taken in after an answer.
const LEFT_OVER_MAX_BYTES: usize = 256 * 1024;
const HEADERS_MAX: usize = 64;
/// A connection without a request by then is closed.
const REQUEST_WITHIN: Duration = Duration::from_secs(5);
/// A page that reads nothing for this long is disconnected.
const WRITE_WITHIN: Duration = Duration::from_secs(2);
/// Longest message that a page sends, bytes.
const MESSAGE_MAX_BYTES: usize = 64 * 1024;
/// What a page sends to stop.
const STOP: &str = "stop";

/// Why the live view cannot be served.
#[derive(Debug, thiserror::Error)]
pub enum ServeError {
    /// The port would be reached from other machines.
    #[error("{0} is not an address of this machine's loopback")]
    NotLoopback(SocketAddr),
    /// The port cannot be had.
    #[error("cannot listen at {address}: {source}")]
    Listen {
        /// Where.
        address: SocketAddr,
        /// The system's answer.
        source: io::Error,
    },
}

impl ServeError {
    /// What to do.
    #[must_use]
    pub fn next(&self) -> Option<String> {
        Some(match self {
            Self::NotLoopback(..) => "give a port, or 127.0.0.1:PORT; from another machine use a tunnel \
         (`ssh -L PORT:127.0.0.1:PORT`)"
                .to_owned(),
            Self::Listen { .. } => "choose another port, or 0 for any that is free".to_owned(),
        })
    }
}

/// What a job has come to.
#[derive(Clone, Debug, serde::Serialize)]
struct Ended {
    /// In words.
    text: String,
    report: bool,
}

/// A snapshot, and the result of the job if it has ended.
#[derive(serde::Serialize)]
struct Shown<'a> {
    #[serde(flatten)]
    snapshot: &'a Snapshot,
    ended: Option<Ended>,
}

struct Shared {
    job: Mutex<Option<(Ended, String)>>,
    state: Arc<Mutex<LiveState>>,
    stop: Arc<AtomicBool>,
    page: String,
    own: SocketAddr,
    ended: AtomicBool,
    connections: AtomicUsize,
}

/// A port that serves the live view until it is dropped.
pub struct LiveServer {
    shared: Arc<Shared>,
    accepting: Option<JoinHandle<()>>,
}

impl LiveServer {
    /// Serves `page` and what `state` holds at `address`, which must be of the loopback; port 0 is any that is free. A page that
    /// stops sets `stop`.
    pub fn start(
        address: SocketAddr,
        state: Arc<Mutex<LiveState>>,
        page: String,
        stop: Arc<AtomicBool>,
    ) -> Result<Self, ServeError> {
        if !address.ip().is_loopback() {
            return Err(ServeError::NotLoopback(address));
        }
        let refused = |source| ServeError::Listen { address, source };
        let listener = TcpListener::bind(address).map_err(refused)?;
        let own = listener.local_addr().map_err(refused)?;
        listener.set_nonblocking(true).map_err(refused)?;
        let (ended, connections) = (AtomicBool::new(false), AtomicUsize::new(0));
        let job = Mutex::new(None);
        let shared = Arc::new(Shared { job, state, stop, page, own, ended, connections });
        let accepting = {
            let shared = Arc::clone(&shared);
            thread::Builder::new()
                .name("live view".to_owned())
                .spawn(move || accept(&listener, &shared))
                .map_err(refused)?
        };
        Ok(Self { shared, accepting: Some(accepting) })
    }

    /// The job has ended: the page keeps its last picture, shows `text`, and links the page `report` if there is one.
    pub fn end(&self, text: String, report: Option<String>) {
        let ended = Ended { text, report: report.is_some() };
        *self.shared.job.lock().unwrap_or_else(PoisonError::into_inner) =
            Some((ended, report.unwrap_or_default()));
    }

    /// Where the page is.
    #[must_use]
    pub fn url(&self) -> String {
        format!("http://{}/", self.shared.own)
    }

    #[must_use]
    pub fn address(&self) -> SocketAddr {
        self.shared.own
    }
}

impl Drop for LiveServer {
    fn drop(&mut self) {
        self.shared.ended.store(true, Ordering::Relaxed);
        if let Some(accepting) = self.accepting.take() {
            // A thread that panicked has already reported it.
            let _ = accepting.join();
        }
    }
}

/// Address of a port number or of `HOST:PORT`.
///
/// # Errors
/// Neither.
pub fn address(text: &str) -> Result<SocketAddr, String> {
    if let Ok(port) = text.parse::<u16>() {
        return Ok(SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), port));
    }
    text.replace("localhost:", "127.0.0.1:")
        .parse()
        .map_err(|_| "expected a port, or HOST:PORT with the address of the loopback".to_owned())
}

impl Shared {
    fn ended_job(&self) -> Option<(Ended, String)> {
        self.job.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

fn accept(listener: &TcpListener, shared: &Arc<Shared>) {
    let mut threads: Vec<JoinHandle<()>> = Vec::new();
    while !shared.ended.load(Ordering::Relaxed) {
        match listener.accept() {
            Ok((stream, _)) => {
                threads.retain(|thread| !thread.is_finished());
                let connection = Arc::clone(shared);
                shared.connections.fetch_add(1, Ordering::Relaxed);
                let spawned = thread::Builder::new().name("live connection".to_owned()).spawn(move || {
                    // A connection that breaks is the other side's affair.
                    let _ = serve(stream, &connection);
                    connection.connections.fetch_sub(1, Ordering::Relaxed);
                });
                match spawned {
                    Ok(thread) => threads.push(thread),
                    Err(_) => {
                        shared.connections.fetch_sub(1, Ordering::Relaxed);
                    }
                }
            }
            // No client came, or a client left before it was accepted.
            Err(_) => thread::sleep(PERIOD),
        }
    }
    for thread in threads {
        let _ = thread.join();
    }
}

fn serve(mut stream: TcpStream, shared: &Shared) -> io::Result<()> {
    stream.set_nonblocking(false)?;
    stream.set_nodelay(true)?;
    stream.set_write_timeout(Some(WRITE_WITHIN))?;
    let Some(head) = head_of(&mut stream, shared)? else { return Ok(()) };
    let mut headers = [httparse::EMPTY_HEADER; HEADERS_MAX];
    let mut request = httparse::Request::new(&mut headers);
    if !matches!(request.parse(&head), Ok(httparse::Status::Complete(_))) {
        return answer(&mut stream, "400 Bad Request", "text/plain", "not a request of HTTP/1.1\n");
    }
    let header = |name: &str| {
        let found = request.headers.iter().find(|header| header.name.eq_ignore_ascii_case(name));
        found.and_then(|header| std::str::from_utf8(header.value).ok())
    };
    let asked = Asked {
        method: request.method.unwrap_or_default(),
        path: request.path.unwrap_or_default(),
        host: header("Host"),
        origin: header("Origin"),
        upgrade: header("Upgrade").is_some_and(|upgrade| upgrade.eq_ignore_ascii_case("websocket")),
    };
    let wanted = match judge(&asked, shared.own) {
        Ok(wanted) => wanted,
        Err(refused) => {
            return answer(&mut stream, refused.status(), "text/plain", &format!("{refused}\n"));
        }
    };
    // A stop is never refused.
    if wanted != Wanted::Stop && shared.connections.load(Ordering::Relaxed) > CONNECTIONS_MAX {
        return answer(&mut stream, "503 Service Unavailable", "text/plain", "too many connections\n");
    }
    match wanted {
        Wanted::Stop => {
            shared.stop.store(true, Ordering::Relaxed);
            answer(&mut stream, "200 OK", "text/plain", "stopping\n")
        }
        Wanted::Page => answer(&mut stream, "200 OK", "text/html; charset=utf-8", &shared.page),
        Wanted::Report => match shared.ended_job() {
            Some((Ended { report: true, .. }, page)) => {
                answer(&mut stream, "200 OK", "text/html; charset=utf-8", &page)
            }
            _ => answer(&mut stream, "404 Not Found", "text/plain", "there is no report yet\n"),
        },
        Wanted::Live => live(stream, &request, shared),
    }
}

/// Serves snapshots until the page leaves or the view ends.
fn live(stream: TcpStream, request: &httparse::Request<'_, '_>, shared: &Shared) -> io::Result<()> {
    let Some(mut socket) = upgraded(stream, request)? else { return Ok(()) };
    match show(&mut socket, shared) {
        // Orderly ends, and connections that broke.
        Ok(()) | Err(WireError::ConnectionClosed | WireError::AlreadyClosed) => Ok(()),
        Err(WireError::Io(error)) => Err(error),
        Err(other) => Err(io::Error::other(other)),
    }
}

/// The head of a request, or `None` if none comes.
fn head_of(stream: &mut TcpStream, shared: &Shared) -> io::Result<Option<Vec<u8>>> {
    let until = Instant::now() + REQUEST_WITHIN;
    stream.set_read_timeout(Some(Duration::from_millis(100)))?;
    let (mut head, mut chunk) = (Vec::new(), [0_u8; 1024]);
    while Instant::now() < until && !shared.ended.load(Ordering::Relaxed) {
        match stream.read(&mut chunk) {
            Ok(0) => return Ok(None),
            Ok(n) => head.extend_from_slice(&chunk[..n]),
            Err(error) if is_time(&error) => continue,
            Err(error) => return Err(error),
        }
        if head.windows(4).any(|end| end == b"\r\n\r\n") {
            return Ok(Some(head));
        }
        if head.len() > REQUEST_MAX_BYTES {
            answer(stream, "431 Request Header Fields Too Large", "text/plain", "too long\n")?;
            return Ok(None);
        }
    }
    Ok(None)
}

fn is_time(error: &io::Error) -> bool {
    matches!(error.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut)
}

/// A whole answer; the connection ends with it. The page may load and run nothing but what is inside it.
fn answer(stream: &mut TcpStream, status: &str, kind: &str, body: &str) -> io::Result<()> {
    let head = format!(
        "HTTP/1.1 {status}\r\nContent-Type: {kind}\r\nContent-Length: {}\r\nConnection: close\r\nCache-Control: no-store\r\n\
         X-Frame-Options: DENY\r\nX-Content-Type-Options: nosniff\r\nContent-Security-Policy: default-src 'none'; \
         script-src 'unsafe-inline'; style-src 'unsafe-inline'; connect-src 'self'; frame-ancestors 'none'; base-uri \
         'none'; form-action 'none'\r\n\r\n",
        body.len()
    );
    stream.write_all(head.as_bytes())?;
    stream.write_all(body.as_bytes())?;
    // Remaining data of the other side are read: closing before that would discard the answer.
    stream.shutdown(Shutdown::Write)?;
    let (mut rest, mut left) = ([0_u8; 1024], LEFT_OVER_MAX_BYTES);
    while left > 0 {
        match stream.read(&mut rest) {
            Ok(0) | Err(_) => break,
            Ok(n) => left = left.saturating_sub(n),
        }
    }
    Ok(())
}

/// Makes the handshake; `None` if the request for a WebSocket is not valid, which is answered with an error.
fn upgraded(
    mut stream: TcpStream,
    request: &httparse::Request<'_, '_>,
) -> io::Result<Option<WebSocket<TcpStream>>> {
    let mut asked = Request::builder().method(request.method.unwrap_or_default()).uri("/");
    for header in request.headers.iter() {
        asked = asked.header(header.name, header.value);
    }
    let response = asked.body(()).map_err(|_| ()).and_then(|asked| create_response(&asked).map_err(|_| ()));
    let Ok(response) = response else {
        answer(&mut stream, "400 Bad Request", "text/plain", "not a good request for a WebSocket\n")?;
        return Ok(None);
    };
    let mut head = Vec::new();
    write_response(&mut head, &response).map_err(io::Error::other)?;
    stream.write_all(&head)?;
    let config = WebSocketConfig::default()
        .read_buffer_size(4 * 1024)
        .write_buffer_size(0)
        .max_message_size(Some(MESSAGE_MAX_BYTES))
        .max_frame_size(Some(MESSAGE_MAX_BYTES));
    Ok(Some(WebSocket::from_raw_socket(stream, Role::Server, Some(config))))
}

/// Reads what comes until `until`: a page can stop.
fn listen(socket: &mut WebSocket<TcpStream>, until: Instant, stop: &AtomicBool) -> Result<(), WireError> {
    loop {
        let left = until.saturating_duration_since(Instant::now());
        if left.is_zero() {
            return Ok(());
        }
        socket.get_ref().set_read_timeout(Some(left))?;
        match socket.read() {
            Ok(Message::Text(text)) if text.as_str() == STOP => stop.store(true, Ordering::Relaxed),
            Ok(_) => {}
            Err(WireError::Io(error)) if is_time(&error) => return Ok(()),
            Err(error) => return Err(error),
        }
    }
}

/// Snapshots for a page, as JSON.
fn show(socket: &mut WebSocket<TcpStream>, shared: &Shared) -> Result<(), WireError> {
    let mut last_event = 0;
    let mut next = Instant::now();
    while !shared.ended.load(Ordering::Relaxed) {
        let snapshot = shared.state.lock().unwrap_or_else(PoisonError::into_inner).snapshot(last_event);
        last_event = snapshot.events.last().map_or(last_event, |event| event.number);
        let ended = shared
            .job
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .as_ref()
            .map(|(ended, _)| ended.clone());
        let text = serde_json::to_string(&Shown { snapshot: &snapshot, ended })
            .map_err(|error| WireError::Io(error.into()))?;
        socket.send(Message::text(text))?;
        next = (next + PERIOD).max(Instant::now());
        listen(socket, next, &shared.stop)?;
    }
    socket.close(None)
}
