//! What the two topics for viewers have in common: pieces go out under names, those that change under
//! new ones, and a message that deletes all begins each whole state.

use crate::atlas::TexturePage;

use super::pieces::{self, Piece, Pieces, Place, Step};
use super::sent::Sent;
use super::{Content, PublishError, PublishParams, Snapshot};

/// How pieces become messages for one kind of viewer.
pub(super) trait Format: Sync {
    /// A piece as it goes into a message.
    type Built: Send;
    /// What one is called, for errors.
    const WHAT: &'static str;

    /// # Errors
    /// [`PublishError`] when its texture does not encode.
    fn build(&self, piece: &Piece, page: &TexturePage) -> Result<Self::Built, PublishError>;

    /// What some steps delete and add, as a message.
    fn message(&self, steps: &[Step<Self::Built>]) -> Vec<u8>;

    /// A message that deletes all.
    fn deletion_of_all(&self) -> Vec<u8>;

    /// How many deletions fit into a message of that many bytes.
    fn max_removed(&self, max_bytes: usize) -> usize;
}

/// What readers hold, and how many messages ago it began.
#[derive(Debug)]
pub(super) struct Held {
    scene: Option<(u64, String)>,
    sent: Sent<Place>,
    pieces: Pieces,
    num_since_whole: usize,
}

impl Default for Held {
    fn default() -> Self {
        Self {
            scene: None,
            sent: Sent::default(),
            pieces: Pieces::staying_divided(),
            num_since_whole: 0,
        }
    }
}

impl Held {
    pub(super) fn forget(&mut self) {
        self.scene = None;
        self.num_since_whole = 0;
    }

    pub(super) fn num_since_whole(&self) -> usize {
        self.num_since_whole
    }

    /// What changed; the whole where readers hold nothing of this session, or their writer would not
    /// keep all since the last whole.
    pub(super) fn publish<F: Format>(
        &mut self,
        format: &F,
        snapshot: &Snapshot<'_>,
        content: &Content<'_>,
        params: &PublishParams,
    ) -> Result<Vec<Vec<u8>>, PublishError> {
        let now = Some((snapshot.session, snapshot.frame_id.to_owned()));
        if self.scene == now {
            let messages = self.publish_change(format, content, params)?;
            let num_kept = self.num_since_whole + messages.len();
            if num_kept <= params.history_messages {
                self.num_since_whole = num_kept;
                return Ok(messages);
            }
        }
        self.sent.clear();
        self.pieces = Pieces::staying_divided();
        let mut messages = vec![params.checked(F::WHAT, format.deletion_of_all())?];
        messages.extend(self.publish_change(format, content, params)?);
        self.scene = now;
        self.num_since_whole = messages.len();
        Ok(messages)
    }

    fn publish_change<F: Format>(
        &mut self,
        format: &F,
        content: &Content<'_>,
        params: &PublishParams,
    ) -> Result<Vec<Vec<u8>>, PublishError> {
        let max_bytes = params.max_message_bytes;
        let length = |step: &Step<F::Built>| format.message(std::slice::from_ref(step)).len();
        let sent = &self.sent;
        let cut = self.pieces.cut(
            content,
            params,
            &|digest| sent.contains(digest),
            &|piece, page| {
                let step = Step {
                    removed: Vec::new(),
                    added: Some((0, format.build(piece, page)?)),
                };
                let fits = length(&step) <= max_bytes;
                Ok(step.added.filter(|_| fits).map(|(_, built)| built))
            },
        )?;
        let steps = pieces::in_steps(self.sent.change(pieces::placed(cut))?);
        let groups = pieces::grouped(steps, max_bytes, format.max_removed(max_bytes), &length);
        let messages = groups
            .iter()
            .map(|steps| params.checked(F::WHAT, format.message(steps)));
        messages.collect()
    }
}
