//! What a run needs to go on, as bytes.
//!
//! | bytes | content |
//! |---|---|
//! | 8 | [`MAGIC`], the last of which is the version |
//! | 32 | SHA-256 of what follows |
//! | any | settings, state of the loop, lengths of the states of all units (postcard: floats keep all their bits) |
//! | rest | states of all units |

use sha2::{Digest, Sha256};

use crate::error::CouplingError;
use crate::interface::Interface;
use crate::run::{Settings, State};

const MAGIC: [u8; 8] = *b"couple\0\x03";
/// Bytes of the digest.
const DIGEST: usize = 32;

/// Everything that a run needs to go on: with it, a run that was stopped gives the same bits as one that was not.
#[derive(Clone, Debug, PartialEq)]
pub struct Checkpoint {
    /// Interface and settings that the run had.
    of: String,
    pub(crate) state: State,
    pub(crate) units: Vec<Vec<u8>>,
}

impl Checkpoint {
    pub(crate) fn new(interface: &Interface, settings: &Settings, state: State, units: Vec<Vec<u8>>) -> Self {
        Self { of: describe(interface, settings), state, units }
    }

    pub(crate) fn check(&self, interface: &Interface, settings: &Settings, units: usize) -> Result<(), CouplingError> {
        if self.of != describe(interface, settings) {
            return Err(CouplingError::Checkpoint { reason: "it belongs to a run with other settings" });
        }
        let fields = interface.fields.len();
        let state = &self.state;
        let fits = state.ranges.len() == fields
            && state.initial.len() == fields
            && state.sensitivities.len() == fields
            && state.history.iter().all(|(_, f)| f.len() == fields)
            && !state.history.is_empty()
            && self.units.len() == units;
        if fits { Ok(()) } else { Err(CouplingError::Checkpoint { reason: "its content is inconsistent" }) }
    }

    /// Time (s) at which it was made.
    pub fn time(&self) -> f64 {
        self.state.time
    }

    /// Number of time steps done.
    pub fn number(&self) -> usize {
        self.state.number
    }

    /// As bytes.
    ///
    /// # Errors
    /// [`CouplingError::Checkpoint`] where it cannot be written, as for want of memory.
    pub fn to_bytes(&self) -> Result<Vec<u8>, CouplingError> {
        let Self { of, state, units } = self;
        let lengths: Vec<usize> = units.iter().map(Vec::len).collect();
        let head = [&MAGIC[..], &[0; DIGEST]].concat();
        let mut bytes = postcard::to_extend(&(of, state, lengths), head)
            .map_err(|_| CouplingError::Checkpoint { reason: "its content cannot be written" })?;
        units.iter().for_each(|unit| bytes.extend_from_slice(unit));
        let (head, content) = bytes.split_at_mut(MAGIC.len() + DIGEST);
        head[MAGIC.len()..].copy_from_slice(&Sha256::digest(content));
        Ok(bytes)
    }

    /// From bytes.
    ///
    /// # Errors
    /// [`CouplingError::Checkpoint`] where they are of another version, cut short or damaged.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, CouplingError> {
        let fail = |reason| CouplingError::Checkpoint { reason };
        let rest = bytes.strip_prefix(&MAGIC).ok_or(fail("it is none, or of another version"))?;
        let (digest, content) = rest.split_at_checked(DIGEST).ok_or(fail("it is cut short"))?;
        if Sha256::digest(content)[..] != *digest {
            return Err(fail("it is damaged"));
        }
        let inconsistent = fail("its content is inconsistent");
        type Head = (String, State, Vec<usize>);
        let Ok(((of, state, lengths), mut rest)) = postcard::take_from_bytes::<Head>(content) else {
            return Err(inconsistent);
        };
        let mut units = Vec::new();
        for length in lengths {
            let Some((unit, others)) = rest.split_at_checked(length) else { return Err(inconsistent) };
            units.push(unit.to_vec());
            rest = others;
        }
        if rest.is_empty() { Ok(Self { of, state, units }) } else { Err(inconsistent) }
    }
}

/// What must be the same to go on. Its text has all digits of all numbers.
fn describe(interface: &Interface, settings: &Settings) -> String {
    format!("{interface:?} {settings:?}")
}
