//! The whole state of an optimisation as bytes, to go on from.
//!
//! Little endian: magic and version; steps done; the discriminator's own bytes; per tile of the
//! atlas a kind (0 no step made, 1 stepped) and, of stepped ones, values, moments and counts. What no
//! step touched is the texture's own and is not written. A checkpoint belongs to one layout and
//! texture, and to the charts that may change: the number of tiles and a hash of the pattern of texels
//! that are painted and may change are checked.

use super::texels::{Moments, TILE_TEXEL, Texels};

const MAGIC: &[u8; 8] = b"veneerTS";
const VERSION: u32 = 1;
const TILE_AREA: usize = TILE_TEXEL * TILE_TEXEL;

/// Why a checkpoint cannot be gone on from.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum CheckpointError {
    /// Not a checkpoint.
    #[error("these bytes are no checkpoint of veneer")]
    Magic,
    /// Another version's.
    #[error("checkpoint of version {0}; this is version {VERSION}")]
    Version(u32),
    /// It ends early, or has more than it should.
    #[error("checkpoint is damaged at byte {0}")]
    Damaged(usize),
    /// Another atlas'.
    #[error("checkpoint has {found} tiles, the atlas {expected}, or other texels are painted")]
    Atlas {
        /// Tiles of the checkpoint.
        found: u64,
        /// Tiles of the atlas.
        expected: u64,
    },
}

/// What a checkpoint holds beside the texels.
pub(super) struct Saved {
    pub(super) num_steps: usize,
    pub(super) critic: Vec<u8>,
}

pub(super) fn write(num_steps: usize, critic: &[u8], texels: &Texels) -> Vec<u8> {
    let mut out = Vec::new();
    out.extend_from_slice(MAGIC);
    out.extend_from_slice(&VERSION.to_le_bytes());
    out.extend_from_slice(&(num_steps as u64).to_le_bytes());
    out.extend_from_slice(&(critic.len() as u64).to_le_bytes());
    out.extend_from_slice(critic);
    out.extend_from_slice(&(texels.tiles.len() as u64).to_le_bytes());
    out.extend_from_slice(&pattern(texels).to_le_bytes());
    for tile in &texels.tiles {
        let Some(moments) = &tile.moments else {
            out.push(0);
            continue;
        };
        out.push(1);
        for values in [&tile.value, &moments.first, &moments.second] {
            for channel in values.iter().flatten() {
                out.extend_from_slice(&channel.to_le_bytes());
            }
        }
        for count in &moments.num_steps {
            out.extend_from_slice(&count.to_le_bytes());
        }
    }
    out
}

/// Puts a checkpoint's texels in their places.
pub(super) fn read(bytes: &[u8], texels: &mut Texels) -> Result<Saved, CheckpointError> {
    let mut reader = Reader { bytes, at: 0 };
    if reader.take(MAGIC.len()).ok() != Some(MAGIC.as_slice()) {
        return Err(CheckpointError::Magic);
    }
    let version = u32::from_le_bytes(reader.array()?);
    if version != VERSION {
        return Err(CheckpointError::Version(version));
    }
    let num_steps = reader.length()?;
    let num_critic_bytes = reader.length()?;
    let critic = reader.take(num_critic_bytes)?.to_vec();
    let found = u64::from_le_bytes(reader.array()?);
    let expected = texels.tiles.len() as u64;
    let found_pattern = u64::from_le_bytes(reader.array()?);
    if found != expected || found_pattern != pattern(texels) {
        return Err(CheckpointError::Atlas { found, expected });
    }
    for tile in &mut texels.tiles {
        match reader.array::<1>()? {
            [0] => {}
            [1] if !tile.value.is_empty() => {
                tile.value = reader.colors()?;
                tile.moments = Some(Box::new(Moments {
                    first: reader.colors()?,
                    second: reader.colors()?,
                    num_steps: reader.counts()?,
                    is_unwritten: true,
                }));
            }
            _ => return Err(CheckpointError::Damaged(reader.at)),
        }
    }
    if reader.at != bytes.len() {
        return Err(CheckpointError::Damaged(reader.at));
    }
    Ok(Saved { num_steps, critic })
}

/// Which texels are painted and may change, as a hash (FNV-1a).
fn pattern(texels: &Texels) -> u64 {
    let mut hash = 0xcbf2_9ce4_8422_2325_u64;
    let mut add = |bit: bool| hash = (hash ^ u64::from(bit)).wrapping_mul(0x0100_0000_01b3);
    for tile in &texels.tiles {
        add(tile.value.is_empty());
        tile.value.iter().for_each(|value| add(value[0].is_nan()));
        tile.is_fixed.iter().for_each(|&is_fixed| add(is_fixed));
    }
    hash
}

struct Reader<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Reader<'a> {
    fn take(&mut self, num: usize) -> Result<&'a [u8], CheckpointError> {
        let end = self.at.checked_add(num);
        let taken = end.and_then(|end| self.bytes.get(self.at..end));
        let taken = taken.ok_or(CheckpointError::Damaged(self.at))?;
        self.at += num;
        Ok(taken)
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], CheckpointError> {
        let at = self.at;
        self.take(N)?
            .try_into()
            .map_err(|_| CheckpointError::Damaged(at))
    }

    fn length(&mut self) -> Result<usize, CheckpointError> {
        let at = self.at;
        usize::try_from(u64::from_le_bytes(self.array()?)).map_err(|_| CheckpointError::Damaged(at))
    }

    fn colors(&mut self) -> Result<Vec<[f32; 3]>, CheckpointError> {
        let bytes = self.take(12 * TILE_AREA)?;
        Ok(bytes
            .chunks_exact(12)
            .map(|color| {
                std::array::from_fn(|c| {
                    let at = 4 * c;
                    f32::from_le_bytes([color[at], color[at + 1], color[at + 2], color[at + 3]])
                })
            })
            .collect())
    }

    fn counts(&mut self) -> Result<Vec<u16>, CheckpointError> {
        let bytes = self.take(2 * TILE_AREA)?;
        Ok(bytes
            .chunks_exact(2)
            .map(|count| u16::from_le_bytes([count[0], count[1]]))
            .collect())
    }
}
