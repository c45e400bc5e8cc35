//! The thread that receives: one task per subscription, none of which decodes.

use std::sync::Arc;
use std::thread::JoinHandle;

use futures::StreamExt;
use ros2_client::Context;
use smol::LocalExecutor;
use smol::channel::{Receiver, Sender};

use crate::wire::event::MessageType;

use super::clock::{CLOCK_TYPE, RosClock};
use super::error::NodeError;
use super::graph::EntityList;
use super::inbox::{Inbox, Waiting};
use super::inputs::{Choice, Input};
use super::transport::{DdsTopic, RawReader, TopicQos};

/// Orders that may wait: more than there are inputs.
const MAX_ORDERS: usize = 64;

enum Order {
    Input {
        reader: Box<RawReader>,
        topic: usize,
        message_type: MessageType,
    },
    Clock(Box<RawReader>),
}

/// Adds subscriptions to the thread that receives; when it goes, the thread ends, and with it the
/// subscriptions.
pub(super) struct Receiving {
    orders: Option<Sender<Order>>,
    thread: Option<JoinHandle<()>>,
    context: Context,
    entities: Arc<EntityList>,
}

impl Receiving {
    pub(super) fn start(
        context: &Context,
        entities: Arc<EntityList>,
        inbox: Arc<Inbox>,
        clock: Arc<RosClock>,
    ) -> Result<Self, NodeError> {
        let (sender, orders) = smol::channel::bounded(MAX_ORDERS);
        let thread = std::thread::Builder::new()
            .name("veneer-receive".to_owned())
            .spawn(move || receive(&orders, &inbox, &clock))
            .map_err(|source| NodeError::System {
                what: "the thread that receives",
                source,
            })?;
        Ok(Self {
            orders: Some(sender),
            thread: Some(thread),
            context: context.clone(),
            entities,
        })
    }

    /// Subscribes to an input as chosen.
    pub(super) fn subscribe(&self, inputs: &[Input], choice: &Choice) -> Result<(), NodeError> {
        let topic = &inputs[choice.input].topic;
        let type_name = choice.message_type.name();
        let reader = RawReader::new(
            &self.context,
            &DdsTopic::message(topic, type_name),
            choice.qos,
        )?;
        self.entities.add_reader(reader.gid());
        self.order(
            topic,
            Order::Input {
                reader: Box::new(reader),
                topic: choice.input,
                message_type: choice.message_type,
            },
        )
    }

    /// Subscribes to `/clock`, or what it was remapped to.
    pub(super) fn subscribe_clock(&self, topic: &str) -> Result<(), NodeError> {
        let reader = RawReader::new(
            &self.context,
            &DdsTopic::message(topic, CLOCK_TYPE),
            TopicQos::SENSOR_DATA,
        )?;
        self.entities.add_reader(reader.gid());
        self.order(topic, Order::Clock(Box::new(reader)))
    }

    fn order(&self, topic: &str, order: Order) -> Result<(), NodeError> {
        let sent = self.orders.as_ref().map(|orders| orders.try_send(order));
        match sent {
            Some(Ok(())) => Ok(()),
            _ => Err(NodeError::dds(topic, &"the thread that receives has ended")),
        }
    }
}

impl Drop for Receiving {
    fn drop(&mut self) {
        // The closed channel ends the thread.
        self.orders = None;
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            tracing::error!("the thread that receives has panicked");
        }
    }
}

fn receive(orders: &Receiver<Order>, inbox: &Inbox, clock: &RosClock) {
    let executor = LocalExecutor::new();
    let mut tasks = Vec::new();
    let run = async {
        while let Ok(order) = orders.recv().await {
            tasks.push(match order {
                Order::Input {
                    reader,
                    topic,
                    message_type,
                } => executor.spawn(read_input(reader, topic, message_type, inbox, clock)),
                Order::Clock(reader) => executor.spawn(read_clock(reader, clock)),
            });
        }
    };
    smol::block_on(executor.run(run));
}

async fn read_input(
    reader: Box<RawReader>,
    topic: usize,
    message_type: MessageType,
    inbox: &Inbox,
    clock: &RosClock,
) {
    let mut samples = std::pin::pin!(reader.samples());
    while let Some(sample) = samples.next().await {
        match sample {
            Ok(sample) => {
                inbox.note_sequence(topic, sample.writer.to_bytes(), sample.sequence_number);
                inbox.put(Waiting {
                    topic,
                    message_type,
                    received: clock.now(),
                    bytes: sample.bytes,
                });
            }
            Err(error) => {
                inbox.note_unreadable(topic);
                tracing::debug!("a sample was not given out: {error}");
            }
        }
    }
}

async fn read_clock(reader: Box<RawReader>, clock: &RosClock) {
    let mut samples = std::pin::pin!(reader.samples());
    while let Some(sample) = samples.next().await {
        if let Ok(sample) = sample
            && let Err(error) = clock.take(&sample.bytes)
        {
            tracing::warn!("/clock: {error}");
        }
    }
}
