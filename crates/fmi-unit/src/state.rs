//! Serialised states: an envelope around what the unit writes.
//!
//! | bytes | meaning |
//! |---|---|
//! | 8 | `FMIUNIT` and the version of this format |
//! | 32 | SHA-256 of the instantiation token: model, mesh and library must be the same |
//! | 1 | mode |
//! | 1 | initial equations still to be evaluated |
//! | 8, 8, 9, 9 | time, start time, stop time and tolerance (with a byte "is there") |
//! | rest | the unit's bytes |
//! | 32 | SHA-256 of all before |
//!
//! Numbers are little-endian.

use sha2::{Digest, Sha256};

use crate::modes::Mode;
use crate::unit::Experiment;

const MAGIC: &[u8; 7] = b"FMIUNIT";
const VERSION: u8 = 1;
const HASH: usize = 32;
const HEADER: usize = 8 + HASH + 2 + 8 + 8 + 9 + 9;

/// Why a serialised state was refused.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum StateError {
    /// Truncated, changed, or no state at all.
    #[error("its {0} bytes are corrupt")]
    Corrupt(usize),
    /// Written by another version of the layer.
    #[error("it has format {found}, this library reads format {VERSION}")]
    Version {
        /// Format of the state.
        found: u8,
    },
    /// Written by another unit, or with other resources.
    #[error("it belongs to another model, or to another version of this one")]
    OtherModel,
}

/// The layer's part of a state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Header {
    pub(crate) mode: Mode,
    pub(crate) uninitialized: bool,
    pub(crate) time: f64,
    pub(crate) experiment: Experiment,
}

pub(crate) fn encode(token: &str, header: &Header, unit: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(HEADER + unit.len() + HASH);
    bytes.extend_from_slice(MAGIC);
    bytes.push(VERSION);
    bytes.extend_from_slice(&Sha256::digest(token));
    bytes.push(Mode::ALL.iter().position(|m| *m == header.mode).map_or(u8::MAX, |i| i as u8));
    bytes.push(header.uninitialized.into());
    bytes.extend_from_slice(&header.time.to_le_bytes());
    bytes.extend_from_slice(&header.experiment.start.to_le_bytes());
    for optional in [header.experiment.stop, header.experiment.tolerance] {
        bytes.push(optional.is_some().into());
        bytes.extend_from_slice(&optional.unwrap_or_default().to_le_bytes());
    }
    bytes.extend_from_slice(unit);
    let hash = Sha256::digest(&bytes);
    bytes.extend_from_slice(&hash);
    bytes
}

/// The header and the unit's bytes.
pub(crate) fn decode<'a>(token: &str, bytes: &'a [u8]) -> Result<(Header, &'a [u8]), StateError> {
    let corrupt = || StateError::Corrupt(bytes.len());
    let (content, hash) = bytes.split_last_chunk::<HASH>().ok_or_else(corrupt)?;
    if content.len() < HEADER || !content.starts_with(MAGIC) || Sha256::digest(content).as_slice() != hash {
        return Err(corrupt());
    }
    if content[7] != VERSION {
        return Err(StateError::Version { found: content[7] });
    }
    let mut rest = &content[8..];
    let mut take = |n: usize| {
        let (head, tail) = rest.split_at(n);
        rest = tail;
        head
    };
    if take(HASH) != Sha256::digest(token).as_slice() {
        return Err(StateError::OtherModel);
    }
    let mode = Mode::ALL.get(usize::from(take(1)[0])).filter(|m| **m != Mode::Failed).ok_or_else(corrupt)?;
    let uninitialized = take(1)[0] != 0;
    let number = |bytes: &[u8]| bytes.try_into().map(f64::from_le_bytes).map_err(|_| corrupt());
    let time = number(take(8))?;
    let start = number(take(8))?;
    let mut optional = || {
        let some = take(1)[0] != 0;
        number(take(8)).map(|value| some.then_some(value))
    };
    let (stop, tolerance) = (optional()?, optional()?);
    let experiment = Experiment { start, stop, tolerance };
    Ok((Header { mode: *mode, uninitialized, time, experiment }, rest))
}

#[cfg(test)]
mod tests {
    use super::*;

    const HEAD: Header = Header {
        mode: Mode::Step,
        uninitialized: false,
        time: 1.5,
        experiment: Experiment { start: 0.25, stop: Some(9.0), tolerance: None },
    };

    fn sealed(change: impl FnOnce(&mut Vec<u8>)) -> Vec<u8> {
        let mut bytes = encode("token", &HEAD, b"unit");
        bytes.truncate(bytes.len() - HASH);
        change(&mut bytes);
        let hash = Sha256::digest(&bytes);
        bytes.extend_from_slice(&hash);
        bytes
    }

    #[test]
    fn states_come_back() {
        let bytes = encode("token", &HEAD, b"unit");
        assert_eq!(decode("token", &bytes), Ok((HEAD, &b"unit"[..])));
    }

    #[test]
    fn every_changed_or_missing_byte_is_noticed() {
        let bytes = encode("token", &HEAD, b"unit");
        for i in 0..bytes.len() {
            let mut changed = bytes.clone();
            changed[i] ^= 1;
            assert_eq!(decode("token", &changed), Err(StateError::Corrupt(bytes.len())), "byte {i}");
            assert_eq!(decode("token", &bytes[..i]), Err(StateError::Corrupt(i)));
        }
    }

    #[test]
    fn other_versions_and_models_are_refused() {
        assert_eq!(decode("token", &sealed(|b| b[7] = 2)), Err(StateError::Version { found: 2 }));
        assert_eq!(decode("other", &sealed(|_| ())), Err(StateError::OtherModel));
        assert!(matches!(decode("token", &sealed(|b| b[40] = 99)), Err(StateError::Corrupt(_))));
    }
}
