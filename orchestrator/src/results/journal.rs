//! The truth about a run: what each accepted time step did and left, appended and brought to the disk.
//!
//! | bytes | content |
//! |---|---|
//! | 8 | [`MAGIC`], the last of which is the version |
//! | for each entry: 8 | length of its content, little-endian |
//! | 32 | SHA-256 of its content |
//! | any | its content (postcard: floats keep all their bits, also those that are not numbers) |
//!
//! A process that is killed leaves whole entries and at most one that is cut short, which does not count.

use std::fs::{File, OpenOptions, TryLockError};
use std::io::{BufReader, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use super::{ResultsError, Snapshot};
use crate::record::StepRecord;

const MAGIC: [u8; 8] = *b"journal\x01";

/// A time step, or with number 0 and without attempts the start.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub(crate) struct Entry {
    pub(crate) record: StepRecord,
    pub(crate) snapshot: Snapshot,
}

/// As [`Entry`].
#[derive(Serialize)]
struct EntryRef<'a> {
    record: &'a StepRecord,
    snapshot: &'a Snapshot,
}

/// A journal to append to. It is locked.
#[derive(Debug)]
pub(crate) struct Journal {
    path: PathBuf,
    file: File,
    /// Where the entries end.
    length: u64,
}

impl Journal {
    pub(crate) fn create(path: &Path) -> Result<Self, ResultsError> {
        let mut file = File::create_new(path).map_err(ResultsError::io(path))?;
        lock(path, &file)?;
        file.write_all(&MAGIC).map_err(ResultsError::io(path))?;
        Ok(Self { path: path.into(), file, length: MAGIC.len() as u64 })
    }

    /// Fails where another process writes to a journal.
    pub(crate) fn probe(path: &Path) -> Result<(), ResultsError> {
        let file = OpenOptions::new().write(true).open(path).map_err(ResultsError::io(path))?;
        lock(path, &file)
    }

    /// Says where the journal is after its folder was moved.
    pub(crate) fn moved_to(&mut self, path: PathBuf) {
        self.path = path;
    }

    /// Keeps the entries up to a time step, or all that are complete, and passes them to `each`.
    pub(crate) fn reopen(
        path: &Path,
        last: Option<usize>,
        mut each: impl FnMut(Entry) -> Result<(), ResultsError>,
    ) -> Result<Self, ResultsError> {
        let file = OpenOptions::new().read(true).write(true).open(path).map_err(ResultsError::io(path))?;
        lock(path, &file)?;
        let mut length = MAGIC.len() as u64;
        let mut reached = None;
        let mut entries = Entries::open(path)?;
        while reached.is_none() || reached != last {
            let Some(entry) = entries.next() else { break };
            let entry = entry?;
            reached = Some(entry.record.number);
            length = entries.position;
            each(entry)?;
        }
        match (reached, last) {
            (None, _) => Err(ResultsError::Incomplete { path: path.into(), wanted: last.unwrap_or(0) }),
            (_, Some(wanted)) if reached != last => Err(ResultsError::Incomplete { path: path.into(), wanted }),
            _ => {
                let mut journal = Self { path: path.into(), file, length };
                journal.cut().map_err(ResultsError::io(path))?;
                Ok(journal)
            }
        }
    }

    fn cut(&mut self) -> std::io::Result<()> {
        self.file.set_len(self.length)?;
        self.file.seek(SeekFrom::Start(self.length))?;
        self.file.sync_data()
    }

    /// Appends an entry; on an error the journal stays as it was.
    pub(crate) fn append(&mut self, record: &StepRecord, snapshot: &Snapshot) -> Result<(), ResultsError> {
        let content = postcard::to_stdvec(&EntryRef { record, snapshot })
            .map_err(|error| ResultsError::damaged(&self.path, error))?;
        let bytes = [&(content.len() as u64).to_le_bytes()[..], &Sha256::digest(&content)[..], &content].concat();
        let written = self.file.write_all(&bytes).and_then(|()| self.file.sync_data());
        if let Err(source) = written {
            // What cannot be cut off does not count all the same.
            let _ = self.cut();
            return Err(ResultsError::Io { path: self.path.clone(), source });
        }
        self.length += bytes.len() as u64;
        Ok(())
    }
}

fn lock(path: &Path, file: &File) -> Result<(), ResultsError> {
    file.try_lock().map_err(|error| match error {
        TryLockError::WouldBlock => ResultsError::InUse(path.parent().unwrap_or(path).into()),
        TryLockError::Error(source) => ResultsError::Io { path: path.into(), source },
    })
}

/// The entries of a journal, up to the first that is not complete.
pub(crate) struct Entries {
    path: PathBuf,
    file: BufReader<File>,
    position: u64,
    length: u64,
}

impl Entries {
    pub(crate) fn open(path: &Path) -> Result<Self, ResultsError> {
        let file = File::open(path).map_err(ResultsError::io(path))?;
        let length = file.metadata().map_err(ResultsError::io(path))?.len();
        let mut file = BufReader::new(file);
        let mut magic = [0; MAGIC.len()];
        file.read_exact(&mut magic).map_err(ResultsError::io(path))?;
        if magic != MAGIC {
            return Err(ResultsError::damaged(path, "it is no journal, or one of another version"));
        }
        Ok(Self { path: path.into(), file, position: MAGIC.len() as u64, length })
    }

    /// The content of the next entry, if it is complete.
    fn content(&mut self) -> std::io::Result<Option<Vec<u8>>> {
        const HEAD: u64 = 40;
        let rest = self.length - self.position;
        if rest < HEAD {
            return Ok(None);
        }
        let (mut size, mut digest) = ([0; 8], [0; 32]);
        self.file.read_exact(&mut size)?;
        self.file.read_exact(&mut digest)?;
        let size = u64::from_le_bytes(size);
        if size > rest - HEAD {
            return Ok(None);
        }
        let mut content = vec![0; size as usize];
        self.file.read_exact(&mut content)?;
        self.position += HEAD + size;
        Ok((Sha256::digest(&content)[..] == digest).then_some(content))
    }
}

impl Iterator for Entries {
    type Item = Result<Entry, ResultsError>;

    fn next(&mut self) -> Option<Self::Item> {
        match self.content() {
            Ok(content) => {
                content.map(|content| postcard::from_bytes(&content).map_err(|e| ResultsError::damaged(&self.path, e)))
            }
            Err(source) => Some(Err(ResultsError::Io { path: self.path.clone(), source })),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_full_disk_is_an_error_with_the_place() {
        let path = PathBuf::from("/dev/full");
        let file = OpenOptions::new().write(true).open(&path).unwrap();
        let mut journal = Journal { path: path.clone(), file, length: 8 };
        let record = StepRecord { number: 0, time: 0.0, attempts: Vec::new() };
        let snapshot = Snapshot { time: 0.0, scalars: Vec::new(), arrays: Vec::new() };
        match journal.append(&record, &snapshot) {
            Err(ResultsError::Io { path: found, source }) => {
                assert_eq!(found, path);
                assert_eq!(source.kind(), std::io::ErrorKind::StorageFull);
            }
            other => panic!("{other:?}"),
        }
        assert_eq!(journal.length, 8);
    }
}
