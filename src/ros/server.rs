//! One service's server, as bytes: requests come in, answers go to whoever asked.
//!
//! Whose request an answer belongs to travels beside the bytes, as rmw_fastrtps has it
//! (`related_sample_identity`), and so an answer must go in one datagram: RustDDS 0.15.1 writes a
//! message that goes in fragments and has such a note with a byte too many, and no client can read
//! it. How long a datagram may be depends on the client: [`longest_to`].

use std::cell::RefCell;
use std::collections::VecDeque;
use std::time::{Duration, Instant};

use futures::StreamExt;
use ros2_client::Context;
use ros2_client::gid::Gid;
use rustdds::GUID;
use rustdds::bytes::Bytes;
use rustdds::rpc::SampleIdentity;

use super::error::NodeError;
use super::graph::{self, Client};
use super::transport::{DdsTopic, RawReader, RawWriter, TopicQos, Written};

/// How long an answer waits for the writer to know its client, and for room in the writer's window.
const CLIENT_WAIT: Duration = Duration::from_secs(2);
/// How often that is looked at.
const CLIENT_POLL: Duration = Duration::from_millis(10);
/// Clients that are remembered as known to the writer; an older one waits a little longer.
const MAX_MATCHED: usize = 1000;
/// Rest after a request that could not be read: a peer that sends nothing else gets no more.
const REST: Duration = Duration::from_millis(20);
/// Requests that wait; more than a person or a manager sends at once.
const QUEUE_SIZE: usize = 10;

/// Longest answer to a client elsewhere, bytes: one datagram of a network with an MTU of 1500,
/// less RustDDS' headers and the two notes of whose request it was.
pub(super) const MAX_REMOTE_BYTES: usize = 1280;
/// Longest answer to a client that is reached over this host's loopback alone: RustDDS then takes
/// datagrams as long as that interface's MTU of 65536.
pub(super) const MAX_LOCAL_BYTES: usize = 60_000;

/// Longest answer that reaches all of `clients`, bytes.
pub(super) fn longest_to(clients: &[Client]) -> usize {
    let is_local = !clients.is_empty() && clients.iter().all(|client| client.is_local);
    if is_local {
        MAX_LOCAL_BYTES
    } else {
        MAX_REMOTE_BYTES
    }
}

/// A request, and by what its answer will be known.
pub(super) struct Request {
    /// Serialised, with its encapsulation header.
    pub(super) bytes: Vec<u8>,
    identity: SampleIdentity,
    writer: GUID,
}

/// Reads requests and writes answers.
pub(super) struct RawServer {
    context: Context,
    replies: DdsTopic,
    requests: RawReader,
    answers: RawWriter,
    /// Whom the writer knows.
    matched: RefCell<VecDeque<GUID>>,
}

impl RawServer {
    /// A server of `service` (an absolute name) of the type `package/srv/Name`.
    pub(super) fn new(
        context: &Context,
        service: &str,
        type_name: &str,
    ) -> Result<Self, NodeError> {
        let qos = TopicQos {
            is_reliable: true,
            is_latched: false,
            depth: QUEUE_SIZE,
        };
        let replies = DdsTopic::reply(service, type_name);
        let requests = DdsTopic::request(service, type_name);
        Ok(Self {
            context: context.clone(),
            requests: RawReader::new(context, &requests, qos)?,
            answers: RawWriter::new(context, &replies, qos)?,
            replies,
            matched: RefCell::default(),
        })
    }

    /// Of its reader and its writer.
    pub(super) fn gids(&self) -> (Gid, Gid) {
        (self.requests.gid(), self.answers.gid())
    }

    /// Answers each request by `answer`, one after the other, without end. It is given the longest
    /// answer that reaches the client, and leaves a request unanswered by `None`.
    pub(super) async fn serve<F>(&self, answer: impl Fn(Request, usize) -> F)
    where
        F: Future<Output = Option<Vec<u8>>>,
    {
        let mut requests = std::pin::pin!(self.requests.samples());
        while let Some(sample) = requests.next().await {
            let request = match sample {
                Ok(sample) => Request {
                    bytes: sample.bytes,
                    identity: sample.identity,
                    writer: sample.writer,
                },
                Err(error) => {
                    tracing::warn!(
                        "{}: a request was not given out: {error}",
                        self.replies.name
                    );
                    smol::Timer::after(REST).await;
                    continue;
                }
            };
            let (identity, clients) = (request.identity, self.clients(&request).await);
            match answer(request, longest_to(&clients)).await {
                Some(answer) => self.send(Bytes::from(answer), identity, &clients).await,
                None => drop(smol::Timer::after(REST).await),
            }
        }
    }

    /// Who waits for the answer, once the writer knows them. A client may ask before that: discovery
    /// finds it first, and an answer that is written in between never reaches it.
    async fn clients(&self, request: &Request) -> Vec<Client> {
        let begun = Instant::now();
        loop {
            let known = graph::clients(&self.context, &self.replies.name, request.writer);
            // Fast DDS names the reader; others do not, and every reader of theirs gets it.
            let named = known
                .iter()
                .find(|c| c.reader == request.identity.writer_guid);
            let clients = named.map_or_else(|| known.clone(), |client| vec![*client]);
            if self.are_matched(&clients) || begun.elapsed() >= CLIENT_WAIT {
                return clients;
            }
            smol::Timer::after(CLIENT_POLL).await;
        }
    }

    /// Whether there are clients, and the writer knows all of them.
    fn are_matched(&self, clients: &[Client]) -> bool {
        let mut matched = self.matched.borrow_mut();
        matched.extend(self.answers.newly_matched());
        let num_over = matched.len().saturating_sub(MAX_MATCHED);
        matched.drain(..num_over);
        !clients.is_empty() && clients.iter().all(|c| matched.contains(&c.reader))
    }

    async fn send(&self, mut answer: Bytes, identity: SampleIdentity, clients: &[Client]) {
        let reader = match clients {
            [client] => Some(client.reader),
            _ => None,
        };
        let begun = Instant::now();
        loop {
            match self.answers.answer(answer, identity, reader) {
                Written::Sent => return,
                // Earlier clients have not acknowledged yet.
                Written::WindowFull(same) if begun.elapsed() < CLIENT_WAIT => answer = same,
                Written::WindowFull(_) => {
                    tracing::warn!("{}: clients do not take their answers", self.replies.name);
                    return;
                }
                Written::Failed(reason) => {
                    tracing::warn!("{}: the answer was not sent: {reason}", self.replies.name);
                    return;
                }
            }
            smol::Timer::after(CLIENT_POLL).await;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_farthest_client_bounds_the_answer() {
        let client = |is_local| Client {
            reader: GUID::GUID_UNKNOWN,
            is_local,
        };
        assert_eq!(longest_to(&[client(true)]), MAX_LOCAL_BYTES);
        assert_eq!(longest_to(&[client(true), client(false)]), MAX_REMOTE_BYTES);
        assert_eq!(longest_to(&[]), MAX_REMOTE_BYTES);
    }
}
