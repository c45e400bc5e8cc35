//! Announces the node to the peers that `ROS_STATIC_PEERS` names, which multicast may not reach.
//!
//! RustDDS 0.15.1 takes no list of peers, but it sends each announcement of its participant (SPDP) not
//! only by multicast: it goes to the well-known ports of participants 0 to 11 of this host as well. One
//! of these ports that is free is listened on here, and announcements of our own participant go on from
//! there, byte for byte, to the same ports of every peer. An announcement says where to answer, so that
//! all the rest is between the two DDS.

use std::io::ErrorKind;
use std::net::{IpAddr, Ipv4Addr, SocketAddr, ToSocketAddrs, UdpSocket};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use rustdds::GUID;

use super::error::NodeError;

/// Participants of one host that are announced to; as many as RustDDS itself announces to on this one.
const PARTICIPANTS: u16 = 12;
/// How often it is looked whether the node stops.
const POLL: Duration = Duration::from_millis(200);
/// An announcement is one datagram.
const MAX_DATAGRAM_BYTES: usize = 65_536;
/// Of the header of a message (RTPS 2.5, 9.4.4): what it begins with, and where its sender's prefix is.
const MAGIC: &[u8] = b"RTPS";
const PREFIX: std::ops::Range<usize> = 8..20;

/// Where participant `participant` of a host hears announcements (RTPS 2.5, 9.6.2.3).
fn discovery_port(domain_id: u16, participant: u16) -> u16 {
    7400 + 250 * domain_id + 10 + 2 * participant
}

/// Whether a datagram is a message of the participant of `member`.
fn is_ours(datagram: &[u8], member: GUID) -> bool {
    datagram.starts_with(MAGIC) && datagram.get(PREFIX) == Some(member.prefix.as_ref())
}

/// A socket that hears what this host's participants announce.
pub(super) struct Listener {
    socket: UdpSocket,
    domain_id: u16,
    peers: Vec<IpAddr>,
}

impl Listener {
    /// Listens for the announcements that are to go to `peers`, before the participant is made, so that
    /// its first is heard; with it, in words, which peers are unknown. `None` where there is nobody to
    /// announce to.
    ///
    /// # Errors
    /// [`NodeError::System`] where no port is free.
    pub(super) fn new(
        domain_id: u16,
        peers: &[String],
    ) -> Result<(Option<Self>, Vec<String>), NodeError> {
        let (mut addresses, mut notes) = (Vec::new(), Vec::new());
        for peer in peers {
            match (peer.as_str(), 0).to_socket_addrs() {
                Ok(found) => addresses.extend(found.map(|a| a.ip()).filter(IpAddr::is_ipv4)),
                Err(error) => notes.push(format!(
                    "ROS_STATIC_PEERS names {peer}, whose address is not to be found: {error}"
                )),
            }
        }
        if addresses.is_empty() {
            return Ok((None, notes));
        }
        let mut ports = (0..PARTICIPANTS)
            .rev()
            .map(|p| discovery_port(domain_id, p));
        let socket = ports.find_map(|port| UdpSocket::bind((Ipv4Addr::LOCALHOST, port)).ok());
        let failed = |source| NodeError::System {
            what: "a socket for ROS_STATIC_PEERS",
            source,
        };
        let socket = socket.ok_or_else(|| failed(ErrorKind::AddrInUse.into()))?;
        socket.set_read_timeout(Some(POLL)).map_err(failed)?;
        let listener = Self {
            socket,
            domain_id,
            peers: addresses,
        };
        Ok((Some(listener), notes))
    }

    /// Sends on what the participant of `member` announces, until the result is dropped.
    ///
    /// # Errors
    /// [`NodeError::System`] where there is no socket or thread to be had.
    pub(super) fn announce(self, member: GUID) -> Result<Announcing, NodeError> {
        let failed = |source| NodeError::System {
            what: "what announces to ROS_STATIC_PEERS",
            source,
        };
        let out = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0)).map_err(failed)?;
        let is_over = Arc::new(AtomicBool::new(false));
        let thread = std::thread::Builder::new()
            .name("veneer-peers".to_owned())
            .spawn({
                let is_over = Arc::clone(&is_over);
                move || self.send_on(&out, member, &is_over)
            })
            .map_err(failed)?;
        Ok(Announcing {
            is_over,
            thread: Some(thread),
        })
    }

    fn send_on(&self, out: &UdpSocket, member: GUID, is_over: &AtomicBool) {
        let mut datagram = vec![0; MAX_DATAGRAM_BYTES];
        let mut told = vec![false; self.peers.len()];
        while !is_over.load(Ordering::Relaxed) {
            let Ok(length) = self.socket.recv(&mut datagram) else {
                continue;
            };
            if !is_ours(&datagram[..length], member) {
                continue;
            }
            for (peer, told) in self.peers.iter().zip(&mut told) {
                let ports = (0..PARTICIPANTS).map(|p| discovery_port(self.domain_id, p));
                let mut sent = ports
                    .map(|port| out.send_to(&datagram[..length], SocketAddr::new(*peer, port)));
                if let Some(Err(error)) = sent.find(Result::is_err)
                    && !std::mem::replace(told, true)
                {
                    tracing::warn!("{peer} of ROS_STATIC_PEERS is not reached: {error}");
                }
            }
        }
    }
}

/// Sends announcements on until it is dropped.
pub(super) struct Announcing {
    is_over: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Drop for Announcing {
    fn drop(&mut self) {
        self.is_over.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            tracing::error!("the thread that announces to ROS_STATIC_PEERS has panicked");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ports_are_those_of_the_standard() {
        assert_eq!(discovery_port(0, 0), 7410);
        assert_eq!(discovery_port(1, 3), 7666);
        // The last domain's still fit.
        assert_eq!(discovery_port(232, PARTICIPANTS - 1), 65_432);
    }

    #[test]
    fn only_messages_of_ours_go_on() {
        let member = GUID::GUID_UNKNOWN;
        let mut message = [b"RTPS".as_slice(), &[2, 3, 1, 18], &[0; 12], &[9, 9]].concat();
        assert!(is_ours(&message, member));
        message[19] = 1;
        assert!(!is_ours(&message, member));
        assert!(!is_ours(&message[..10], member));
        assert!(!is_ours(&[0; 40], member));
    }

    #[test]
    fn an_unknown_name_is_told() {
        let peers = ["no such host".to_owned()];
        let (listener, notes) = Listener::new(231, &peers).unwrap();
        assert!(listener.is_none());
        assert!(notes[0].contains("no such host"), "{notes:?}");
    }
}
