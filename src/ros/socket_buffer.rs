//! Whether the system grants the socket buffer that images need.
//!
//! A raw frame is a burst of thousands of datagrams; what does not fit into the socket's buffer is
//! lost (with the stock 208 KiB, 447 of 450 frames of 2.7 MB).

use socket2::{Domain, Protocol, Socket, Type};

use super::error::NodeError;

/// What RustDDS asks for, bytes.
const WANTED_BYTES: usize = rustdds::DomainParticipantBuilder::DEFAULT_SOCKET_RECEIVE_BUFFER_SIZE;
/// With this much, 720p colour and depth at 30 Hz arrived whole, bytes.
pub const ENOUGH_BYTES: usize = 4 << 20;

/// Bytes that a socket gets which asks for what DDS asks for.
///
/// # Errors
/// [`NodeError::System`] when there is no socket to be had.
pub fn granted_bytes() -> Result<usize, NodeError> {
    let failed = |source| NodeError::System {
        what: "a socket to try its buffer",
        source,
    };
    let socket = Socket::new(Domain::IPV4, Type::DGRAM, Some(Protocol::UDP)).map_err(failed)?;
    socket.set_recv_buffer_size(WANTED_BYTES).map_err(failed)?;
    let reported = socket.recv_buffer_size().map_err(failed)?;
    // Linux reports twice what it grants: it counts its own bookkeeping.
    Ok(reported / if cfg!(target_os = "linux") { 2 } else { 1 })
}

/// What to do about a buffer of `granted` bytes; `None` where it is enough.
pub fn remedy(granted_bytes: usize) -> Option<String> {
    (granted_bytes < ENOUGH_BYTES).then(|| {
        format!(
            "the system grants sockets {granted_bytes} bytes of receive buffer; raw images will be lost. \
             Run: sudo sysctl -w net.core.rmem_max={WANTED_BYTES} (and put it into /etc/sysctl.d/), \
             or use compressed images"
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_remedy_names_the_exact_setting() {
        let words = remedy(208 << 10).unwrap();
        assert!(
            words.contains("sysctl -w net.core.rmem_max=8388608"),
            "{words}"
        );
        assert!(words.contains("212992 bytes"));
        assert_eq!(remedy(ENOUGH_BYTES), None);
    }

    #[test]
    fn a_socket_tells_what_it_got() {
        let granted = granted_bytes().unwrap();
        assert!((1024..=2 * WANTED_BYTES).contains(&granted), "{granted}");
    }
}
