//! Input files: regular files and pipes, with limits that stop the reading of an endless one.

use std::fs::{self, File, Metadata};
use std::io::{self, Read};
use std::path::Path;

use input::InputError;

/// Longest row of a CSV file, bytes.
const MAX_ROW_BYTES: u64 = 1 << 20;
/// Longest image, bytes.
const MAX_IMAGE_BYTES: u64 = 1 << 28;

/// Opens a file or a pipe, which is read once. A device such as `/dev/zero` may be endless.
///
/// # Errors
/// The file cannot be opened, or is something else.
pub fn open(path: &Path) -> Result<File, InputError> {
    let unreadable = |error: io::Error| InputError::new(format!("cannot be read: {error}")).file(path);
    let found = fs::metadata(path).map_err(unreadable)?;
    if !found.is_file() && !is_pipe(&found) {
        return Err(InputError::new("must be a regular file or a pipe").file(path));
    }
    File::open(path).map_err(unreadable)
}

#[cfg(unix)]
fn is_pipe(found: &Metadata) -> bool {
    use std::os::unix::fs::FileTypeExt as _;
    found.file_type().is_fifo()
}

#[cfg(not(unix))]
fn is_pipe(_: &Metadata) -> bool {
    false
}

/// Reads the image of a firmware.
///
/// # Errors
/// The file cannot be read, is no regular file, or is longer than 256 MiB.
pub fn read_image(path: &Path) -> io::Result<Vec<u8>> {
    let found = fs::metadata(path)?;
    if !found.is_file() {
        return Err(io::Error::other("it must be a regular file"));
    }
    if found.len() > MAX_IMAGE_BYTES {
        return Err(io::Error::other(format!("it is longer than {} MiB", MAX_IMAGE_BYTES >> 20)));
    }
    fs::read(path)
}

/// A source of CSV rows that fails in a row longer than 1 MiB. A CSV reader holds a whole row in memory, and a row may be
/// endless.
#[derive(Debug)]
pub struct RowLimit<R> {
    source: R,
    left: u64,
}

impl<R> RowLimit<R> {
    /// Creates the source, before its first row.
    pub fn new(source: R) -> Self {
        Self { source, left: MAX_ROW_BYTES }
    }

    /// Begins the next row.
    pub fn next_row(&mut self) {
        self.left = MAX_ROW_BYTES;
    }
}

impl<R: Read> Read for RowLimit<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let read = (&mut self.source).take(self.left).read(buffer)?;
        self.left -= read as u64;
        if self.left == 0 {
            return Err(io::Error::other(format!("a row is longer than {MAX_ROW_BYTES} bytes")));
        }
        Ok(read)
    }
}
