//! What a journal needs of a disk, so that a test can be a worse one.

use std::fs::{File, OpenOptions, TryLockError};
use std::io::{self, ErrorKind, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use crate::bag::writer::partial_path;

/// An open file of a journal.
pub trait JournalFile: Send {
    /// Its length now.
    ///
    /// # Errors
    /// The system's.
    fn num_bytes(&mut self) -> io::Result<u64>;

    /// Fills `into` from `offset` on.
    ///
    /// # Errors
    /// The system's; [`ErrorKind::UnexpectedEof`] where the file is shorter.
    fn read_at(&mut self, offset: u64, into: &mut [u8]) -> io::Result<()>;

    /// Writes some of `bytes` at `offset`, and says how many.
    ///
    /// # Errors
    /// The system's; nothing is known of what was written then.
    fn write_at(&mut self, offset: u64, bytes: &[u8]) -> io::Result<usize>;

    /// Cuts the file to `num_bytes`.
    ///
    /// # Errors
    /// The system's.
    fn truncate(&mut self, num_bytes: u64) -> io::Result<()>;

    /// Returns when all that was written is on the disk.
    ///
    /// # Errors
    /// The system's; what was written since the last success may be lost then.
    fn sync(&mut self) -> io::Result<()>;
}

/// Where a journal lies, and the file that is to take its place.
pub trait JournalDisk: Send {
    /// The journal's path.
    fn path(&self) -> &Path;

    /// The journal, held against other processes; `None` where there is none.
    ///
    /// # Errors
    /// The system's; [`ErrorKind::WouldBlock`] when another process holds it.
    fn open(&mut self) -> io::Result<Option<Box<dyn JournalFile>>>;

    /// An empty file beside the journal.
    ///
    /// # Errors
    /// The system's.
    fn create_partial(&mut self) -> io::Result<Box<dyn JournalFile>>;

    /// Gives the file beside the journal the journal's name.
    ///
    /// # Errors
    /// The system's; the journal is then what it was.
    fn rename_partial(&mut self) -> io::Result<()>;

    /// Removes the file beside the journal, if it is there and can be.
    fn remove_partial(&mut self);

    /// Returns when the names are on the disk.
    ///
    /// # Errors
    /// The system's.
    fn sync_folder(&mut self) -> io::Result<()>;
}

/// A path of the file system.
#[derive(Clone, Debug)]
pub struct PathDisk {
    path: PathBuf,
    partial: PathBuf,
}

impl PathDisk {
    /// The journal at `path`.
    pub fn new(path: &Path) -> Self {
        Self {
            path: path.to_owned(),
            partial: partial_path(path),
        }
    }
}

impl JournalDisk for PathDisk {
    fn path(&self) -> &Path {
        &self.path
    }

    fn open(&mut self) -> io::Result<Option<Box<dyn JournalFile>>> {
        match OpenOptions::new().read(true).write(true).open(&self.path) {
            Ok(file) => Ok(Some(locked(file)?)),
            Err(error) if error.kind() == ErrorKind::NotFound => Ok(None),
            Err(error) => Err(error),
        }
    }

    fn create_partial(&mut self) -> io::Result<Box<dyn JournalFile>> {
        // Emptied only once it is held: another process may be writing it.
        let mut file = OpenOptions::new()
            .read(true)
            .write(true)
            .create(true)
            .truncate(false)
            .open(&self.partial)
            .and_then(locked)?;
        file.truncate(0)?;
        Ok(file)
    }

    fn rename_partial(&mut self) -> io::Result<()> {
        std::fs::rename(&self.partial, &self.path)
    }

    fn remove_partial(&mut self) {
        // The failure that led here is on its way to the caller; this one adds nothing.
        drop(std::fs::remove_file(&self.partial));
    }

    fn sync_folder(&mut self) -> io::Result<()> {
        let folder = self.path.parent().filter(|p| !p.as_os_str().is_empty());
        File::open(folder.unwrap_or(Path::new(".")))?.sync_all()
    }
}

fn locked(file: File) -> io::Result<Box<dyn JournalFile>> {
    match file.try_lock() {
        Ok(()) => Ok(Box::new(file)),
        Err(TryLockError::WouldBlock) => Err(io::Error::new(
            ErrorKind::WouldBlock,
            "another process writes this journal",
        )),
        // Some network file systems have no locks; a journal there is better than none.
        Err(TryLockError::Error(error)) if error.kind() == ErrorKind::Unsupported => {
            Ok(Box::new(file))
        }
        Err(TryLockError::Error(error)) => Err(error),
    }
}

impl JournalFile for File {
    fn num_bytes(&mut self) -> io::Result<u64> {
        Ok(self.metadata()?.len())
    }

    fn read_at(&mut self, offset: u64, into: &mut [u8]) -> io::Result<()> {
        self.seek(SeekFrom::Start(offset))?;
        self.read_exact(into)
    }

    fn write_at(&mut self, offset: u64, bytes: &[u8]) -> io::Result<usize> {
        self.seek(SeekFrom::Start(offset))?;
        self.write(bytes)
    }

    fn truncate(&mut self, num_bytes: u64) -> io::Result<()> {
        self.set_len(num_bytes)
    }

    fn sync(&mut self) -> io::Result<()> {
        self.sync_data()
    }
}
