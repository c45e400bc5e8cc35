//! The scan as one GLB over HTTP, for viewers that load a model by its URL. Off by default, and on
//! this host only unless told otherwise.
//!
//! | path | what |
//! |---|---|
//! | `/` | JSON: session, revision, and the URL of that revision |
//! | `/scan.glb` | what was painted last |
//! | `/SESSION/REVISION/scan.glb` | the same while it is that revision, for caches that go by URL; 404 after |
//!
//! GET and HEAD only. Peers can make it hold `limits.http_clients` threads while each is silent for
//! `limits.http_silence_s`, and read `limits.http_request_bytes` of each request; a GLB is made once
//! per revision, when it is asked for.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use crate::config::{Config, NodeLimits};
use crate::export::{EncodedPages, ExportError, TexturedMesh, glb};

use super::engine::{Painting, Shared};
use super::error::NodeError;

/// How often the listener looks whether the node stops.
const POLL: Duration = Duration::from_millis(100);

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
                if num_before < server.limits.http_clients {
                    // A peer that hangs up is its own affair.
                    serve(&server, stream).ok();
                }
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
    stream.set_read_timeout(Some(silence))?;
    stream.set_write_timeout(Some(silence))?;
    let mut reader = BufReader::new((&stream).take(server.limits.http_request_bytes as u64));
    let mut first = String::new();
    reader.read_line(&mut first)?;
    // The rest of the head is read so that closing does not reset the connection.
    let mut line = String::new();
    while reader.read_line(&mut line)? > 2 {
        line.clear();
    }
    let mut words = first.split_whitespace();
    let (method, path) = (words.next().unwrap_or(""), words.next().unwrap_or(""));
    let answer = answer(server, method, path);
    let is_head = method == "HEAD";
    let mut out = &stream;
    write!(
        out,
        "HTTP/1.1 {}\r\nContent-Type: {}\r\nContent-Length: {}\r\n{}Access-Control-Allow-Origin: *\r\nConnection: close\r\n\r\n",
        answer.status,
        answer.content_type,
        answer.body.len(),
        if answer.is_immutable {
            "Cache-Control: max-age=31536000, immutable\r\n"
        } else {
            "Cache-Control: no-cache\r\n"
        },
    )?;
    if !is_head {
        out.write_all(&answer.body)?;
    }
    out.flush()
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
}
