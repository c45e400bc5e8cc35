//! SHA-256 of every output, in the form that `sha256sum -c hashes.txt` checks.

use std::fs::File;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use rayon::prelude::*;
use sha2::{Digest, Sha256};

use super::atomic::{FileError, write_atomic};

/// Name of the list in the output folder.
pub const FILE_NAME: &str = "hashes.txt";

const BLOCK_BYTES: usize = 1 << 20;

/// Lower-case hexadecimal SHA-256 of a file.
///
/// # Errors
/// [`FileError`] when it cannot be read.
pub fn sha256_hex(path: &Path) -> Result<String, FileError> {
    let failed = |source: io::Error| FileError {
        action: "read back",
        path: path.to_owned(),
        source,
    };
    let mut file = File::open(path).map_err(failed)?;
    let mut hasher = Sha256::new();
    let mut block = vec![0; BLOCK_BYTES];
    loop {
        let length = file.read(&mut block).map_err(failed)?;
        if length == 0 {
            break;
        }
        hasher.update(&block[..length]);
    }
    let digest = hasher.finalize();
    Ok(digest.iter().map(|byte| format!("{byte:02x}")).collect())
}

/// Writes `hashes.txt` into `out_dir`: `reproducible` files (relative paths) first, sorted by
/// path, then under a comment those in `timed`, whose bytes hold times and change from run to run.
///
/// # Errors
/// [`FileError`] when a file cannot be read or the list cannot be written.
pub fn write(out_dir: &Path, reproducible: &[PathBuf], timed: &[PathBuf]) -> Result<(), FileError> {
    let mut text = lines(out_dir, reproducible)?;
    if !timed.is_empty() {
        text.push_str("# These hold times, and change from run to run:\n");
        text.push_str(&lines(out_dir, timed)?);
    }
    write_atomic(&out_dir.join(FILE_NAME), |out| {
        out.write_all(text.as_bytes())
    })
}

fn lines(out_dir: &Path, files: &[PathBuf]) -> Result<String, FileError> {
    let mut files: Vec<&PathBuf> = files.iter().collect();
    files.sort();
    let lines: Vec<Result<String, FileError>> = files
        .par_iter()
        .map(|file| {
            Ok(format!(
                "{}  {}\n",
                sha256_hex(&out_dir.join(file))?,
                file.display()
            ))
        })
        .collect();
    lines.into_iter().collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn matches_the_published_vectors() {
        // FIPS 180-4 examples.
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("abc"), b"abc").unwrap();
        std::fs::write(folder.path().join("empty"), b"").unwrap();
        write(folder.path(), &["empty".into(), "abc".into()], &[]).unwrap();
        let list = std::fs::read_to_string(folder.path().join(FILE_NAME)).unwrap();
        assert_eq!(
            list,
            "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad  abc\n\
             e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855  empty\n"
        );
    }

    #[test]
    fn a_missing_file_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let error = write(folder.path(), &["gone".into()], &[]).unwrap_err();
        assert!(error.to_string().contains("gone"));
    }
}
