//! The scan as one GLB over HTTP, for viewers that load a model by its URL. Off by default, and on
//! this host only unless told otherwise.
//!
//! | path | what |
//! |---|---|
//! | `/` | JSON: session, revision, and the URL of that revision |
//! | `/scan.glb` | what was painted last |
//! | `/SESSION/REVISION/scan.glb` | the same while it is that revision, for caches that go by URL; 404 after |
//!
//! GET and HEAD only. Peers can make it hold `limits.http_clients` threads, each as long as
//! `limits.http_silence_s` for a whole request and between two parts of the answer that it takes, and read
//! `limits.http_request_bytes` of each request. A GLB is made once per revision, when it is asked for.

use std::io::{ErrorKind, Read, Write};
use std::net::{Shutdown, SocketAddr, TcpListener, TcpStream};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use crate::config::{Config, NodeLimits};
use crate::export::{EncodedPages, ExportError, TexturedMesh, glb};

use super::engine::{Painting, Shared};
use super::error::NodeError;

/// How often the listener looks whether the node stops.
const POLL: Duration = Duration::from_millis(100);
/// How long a client that is turned away may go on sending: closing on what it sends would take the
/// answer from it.
const PARTING: Duration = Duration::from_millis(200);

/// A GLB and what it is of.
struct Made {
    session: u64,
    revision: u64,
    bytes: Arc<Vec<u8>>,
}

/// Why there is no GLB.
#[derive(Debug, thiserror::Error)]
enum GlbError {
    #[error(transparent)]
    Export(#[from] ExportError),
    #[error("the GLB was not made: {0}")]
    Write(#[from] std::io::Error),
}

struct Server {
    shared: Arc<Shared>,
    made: Mutex<Option<Made>>,
    num_connections: AtomicUsize,
    limits: NodeLimits,
}

/// Starts to serve where the configuration says so; the address it listens on.
pub(super) fn start(shared: &Arc<Shared>) -> Result<Option<SocketAddr>, NodeError> {
    let config = shared.config();
    let Ok(port @ 1..) = u16::try_from(config.node.http_port) else {
        return Ok(None);
    };
    let failed = |source| NodeError::System {
        what: "the HTTP server",
        source,
    };
    let address = config.node.http_address.as_deref().unwrap_or("127.0.0.1");
    let listener = TcpListener::bind((address, port)).map_err(failed)?;
    listener.set_nonblocking(true).map_err(failed)?;
    let bound = listener.local_addr().map_err(failed)?;
    let server = Arc::new(Server {
        shared: Arc::clone(shared),
        made: Mutex::default(),
        num_connections: AtomicUsize::new(0),
        limits: config.node.limits,
    });
    std::thread::Builder::new()
        .name("veneer-http".to_owned())
        .spawn(move || listen(&listener, &server))
        .map_err(failed)?;
    Ok(Some(bound))
}

fn listen(listener: &TcpListener, server: &Arc<Server>) {
    while !server.shared.painted.is_shut() {
        let Ok((stream, _)) = listener.accept() else {
            std::thread::sleep(POLL);
            continue;
        };
        let num_before = server.num_connections.fetch_add(1, Ordering::Relaxed);
        let answer = {
            let server = Arc::clone(server);
            move || {
                let served = if num_before < server.limits.http_clients {
                    serve(&server, stream)
                } else {
                    let words = "limits.http_clients are being answered; try again";
                    Answer::text("503 Service Unavailable", words).turn_away(&stream)
                };
                // A peer that hangs up is its own affair.
                served.ok();
                server.num_connections.fetch_sub(1, Ordering::Relaxed);
            }
        };
        let thread = std::thread::Builder::new().name("veneer-http-peer".to_owned());
        if thread.spawn(answer).is_err() {
            server.num_connections.fetch_sub(1, Ordering::Relaxed);
        }
    }
}

fn serve(server: &Server, stream: TcpStream) -> std::io::Result<()> {
    stream.set_nonblocking(false)?;
    let silence = Duration::from_secs(server.limits.http_silence_s.into());
    stream.set_write_timeout(Some(silence))?;
    let Some(head) = read_head(&stream, server.limits.http_request_bytes, silence)? else {
        let words = "the request is longer than limits.http_request_bytes";
        let refusal = Answer::text("431 Request Header Fields Too Large", words);
        return refusal.turn_away(&stream);
    };
    let mut words = head.lines().next().unwrap_or("").split_whitespace();
    let (method, path) = (words.next().unwrap_or(""), words.next().unwrap_or(""));
    answer(server, method, path).write(&stream, method == "HEAD")
}

/// The head of a request, which must be there `within` that time, however often a byte comes. `None`
/// where it is longer than `max_bytes`.
fn read_head(
    mut stream: &TcpStream,
    max_bytes: usize,
    within: Duration,
) -> std::io::Result<Option<String>> {
    let deadline = Instant::now() + within;
    let (mut head, mut buffer) = (Vec::new(), [0; 1024]);
    loop {
        let left = deadline.saturating_duration_since(Instant::now());
        if left.is_zero() {
            return Err(ErrorKind::TimedOut.into());
        }
        stream.set_read_timeout(Some(left))?;
        let num_bytes = stream.read(&mut buffer)?;
        head.extend_from_slice(&buffer[..num_bytes]);
        if head.len() > max_bytes {
            return Ok(None);
        }
        let is_whole = head.ends_with(b"\r\n\r\n") || head.ends_with(b"\n\n");
        if is_whole || num_bytes == 0 {
            return Ok(Some(String::from_utf8_lossy(&head).into_owned()));
        }
    }
}

struct Answer {
    status: &'static str,
    content_type: &'static str,
    body: Arc<Vec<u8>>,
    is_immutable: bool,
}

impl Answer {
    fn text(status: &'static str, words: &str) -> Self {
        Self {
            status,
            content_type: "text/plain; charset=utf-8",
            body: Arc::new(format!("{words}\n").into_bytes()),
            is_immutable: false,
        }
    }

    /// Answers a client whose request was not read.
    fn turn_away(&self, mut stream: &TcpStream) -> std::io::Result<()> {
        stream.set_nonblocking(false)?;
        stream.set_write_timeout(Some(PARTING))?;
        self.write(stream, false)?;
        stream.shutdown(Shutdown::Write)?;
        stream.set_read_timeout(Some(PARTING / 4))?;
        let (begun, mut buffer) = (Instant::now(), [0; 4096]);
        while begun.elapsed() < PARTING && stream.read(&mut buffer)? > 0 {}
        Ok(())
    }

    fn write(&self, mut out: &TcpStream, is_head: bool) -> std::io::Result<()> {
        write!(
            out,
            "HTTP/1.1 {}\r\nContent-Type: {}\r\nContent-Length: {}\r\n{}Access-Control-Allow-Origin: *\r\nConnection: close\r\n\r\n",
            self.status,
            self.content_type,
            self.body.len(),
            if self.is_immutable {
                "Cache-Control: max-age=31536000, immutable\r\n"
            } else {
                "Cache-Control: no-cache\r\n"
            },
        )?;
        if !is_head {
            out.write_all(&self.body)?;
        }
        out.flush()
    }
}

/// What a path asks for.
#[derive(Debug, PartialEq, Eq)]
enum Wanted {
    Index,
    Latest,
    Revision(u64, u64),
}

fn wanted(path: &str) -> Option<Wanted> {
    let path = path.split(['?', '#']).next().unwrap_or("");
    let parts: Vec<&str> = path.split('/').skip(1).collect();
    match parts[..] {
        [""] => Some(Wanted::Index),
        ["scan.glb"] => Some(Wanted::Latest),
        [session, revision, "scan.glb"] => Some(Wanted::Revision(
            session.parse().ok()?,
            revision.parse().ok()?,
        )),
        _ => None,
    }
}

fn answer(server: &Server, method: &str, path: &str) -> Answer {
    if method != "GET" && method != "HEAD" {
        return Answer::text("405 Method Not Allowed", "GET or HEAD");
    }
    let Some(wanted) = wanted(path) else {
        return Answer::text("404 Not Found", "there are / and /scan.glb");
    };
    let Some(painting) = server.shared.last_painted() else {
        return Answer::text("503 Service Unavailable", "nothing was painted yet");
    };
    let (session, revision) = (painting.session, painting.revision);
    match wanted {
        Wanted::Index => Answer {
            status: "200 OK",
            content_type: "application/json",
            body: Arc::new(
                format!(
                    "{{\"session\": {session}, \"revision\": {revision}, \"url\": \"/{session}/{revision}/scan.glb\"}}\n"
                )
                .into_bytes(),
            ),
            is_immutable: false,
        },
        Wanted::Revision(s, r) if (s, r) != (session, revision) => {
            Answer::text("404 Not Found", "that revision is gone; / names the present one")
        }
        Wanted::Latest | Wanted::Revision(..) => match server.glb(&painting) {
            Ok(body) => Answer {
                status: "200 OK",
                content_type: "model/gltf-binary",
                body,
                is_immutable: wanted != Wanted::Latest,
            },
            Err(error) => Answer::text("500 Internal Server Error", &error.to_string()),
        },
    }
}

impl Server {
    /// The GLB of a painting, made where it is not there. One at a time: who comes meanwhile waits
    /// and finds it made.
    fn glb(&self, painting: &Painting) -> Result<Arc<Vec<u8>>, GlbError> {
        let mut made = self.made.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(made) = made.as_ref()
            && (made.session, made.revision) == (painting.session, painting.revision)
        {
            return Ok(Arc::clone(&made.bytes));
        }
        let bytes = Arc::new(glb_bytes(painting, &self.shared.config())?);
        *made = Some(Made {
            session: painting.session,
            revision: painting.revision,
            bytes: Arc::clone(&bytes),
        });
        Ok(bytes)
    }
}

fn glb_bytes(painting: &Painting, config: &Config) -> Result<Vec<u8>, GlbError> {
    let painted = &painting.painted;
    let textured = TexturedMesh::new(&painted.mesh, &painted.layout, &painted.texture)?;
    let pages = EncodedPages::encode(&painted.texture, config.export.glb_pages)?;
    let mut bytes = Vec::new();
    let (name, normals) = (&config.export.name, config.export.normals);
    glb::write(&textured, &pages, name, normals, &mut bytes)?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_say_what_is_wanted_and_nothing_else_is_there() {
        for (path, expected) in [
            ("/", Some(Wanted::Index)),
            ("/scan.glb", Some(Wanted::Latest)),
            ("/scan.glb?x=1", Some(Wanted::Latest)),
            ("/7/3/scan.glb", Some(Wanted::Revision(7, 3))),
            ("/../etc/passwd", None),
            ("/7/x/scan.glb", None),
            ("//scan.glb", None),
            ("", None),
        ] {
            assert_eq!(wanted(path), expected, "{path}");
        }
    }

    /// What a server reads of a client that does `speak`, and how long it takes.
    fn read_of(
        max_bytes: usize,
        within: Duration,
        speak: impl FnOnce(TcpStream) + Send + 'static,
    ) -> (std::io::Result<Option<String>>, Duration) {
        let listener = TcpListener::bind(("127.0.0.1", 0)).unwrap();
        let address = listener.local_addr().unwrap();
        let client = std::thread::spawn(move || speak(TcpStream::connect(address).unwrap()));
        let (stream, _) = listener.accept().unwrap();
        let begun = Instant::now();
        let read = read_head(&stream, max_bytes, within);
        let took = begun.elapsed();
        drop(stream);
        client.join().unwrap();
        (read, took)
    }

    #[test]
    fn a_head_in_pieces_is_read_whole() {
        let (read, _) = read_of(100, Duration::from_secs(20), |mut stream| {
            for piece in ["GET / HT", "TP/1.1\r\nHost: x\r", "\n\r\n"] {
                stream.write_all(piece.as_bytes()).unwrap();
                std::thread::sleep(Duration::from_millis(20));
            }
        });
        let head = read.unwrap().unwrap();
        assert_eq!(head, "GET / HTTP/1.1\r\nHost: x\r\n\r\n");
    }

    #[test]
    fn a_head_that_is_too_long_is_not_read_to_its_end() {
        let (read, took) = read_of(100, Duration::from_secs(20), |mut stream| {
            // The server may hang up meanwhile.
            stream.write_all(&[b'a'; 5000]).ok();
            std::thread::sleep(Duration::from_millis(50));
        });
        assert!(read.unwrap().is_none() && took < Duration::from_secs(10));
    }

    #[test]
    fn a_client_that_dribbles_is_not_waited_for() {
        let (read, took) = read_of(100, Duration::from_millis(300), |mut stream| {
            // One byte at a time, never silent for long.
            for _ in 0..40 {
                if stream.write_all(b"a").is_err() {
                    return;
                }
                std::thread::sleep(Duration::from_millis(100));
            }
        });
        let error = read.unwrap_err();
        let kinds = [ErrorKind::TimedOut, ErrorKind::WouldBlock];
        assert!(kinds.contains(&error.kind()), "{error}");
        assert!(took < Duration::from_secs(3), "{took:?}");
    }
}
