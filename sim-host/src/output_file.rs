//! A file that appears complete or not at all.
//!
//! Everything goes to a temporary file in the same directory, and [`OutputFile::finish`] gives it the name
//! in one step of the file system. A run that stops half-way leaves the old file, or none: never half a
//! log that reads like a short flight.

use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use std::sync::{Mutex, PoisonError};

use tempfile::NamedTempFile;

use input::InputError;

/// A file being written. Dropping it without [`finish`](Self::finish) leaves nothing behind.
#[derive(Debug)]
pub struct OutputFile {
    sink: BufWriter<Sink>,
    path: PathBuf,
}

#[derive(Debug)]
enum Sink {
    Temporary(NamedTempFile),
    /// A pipe or a device. Putting a file in its place would replace `/dev/null`.
    Direct(File),
}

impl Write for Sink {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match self {
            Self::Temporary(file) => file.write(bytes),
            Self::Direct(file) => file.write(bytes),
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        match self {
            Self::Temporary(file) => file.flush(),
            Self::Direct(file) => file.flush(),
        }
    }
}

impl OutputFile {
    /// Begins to write what will be `path`. What is there now stays until [`finish`](Self::finish).
    pub fn create(path: impl AsRef<Path>) -> Result<Self, InputError> {
        let path = path.as_ref().to_path_buf();
        let sink = open(&path).map_err(|error| cannot_write(&path, &error))?;
        if let Sink::Temporary(file) = &sink {
            unfinished(|files| files.push(file.path().to_path_buf()));
        }
        Ok(Self { sink: BufWriter::with_capacity(1 << 16, sink), path })
    }

    /// Puts everything on the disk and gives the file its name.
    pub fn finish(self) -> Result<(), InputError> {
        let Self { sink, path } = self;
        let finished = || {
            match sink.into_inner().map_err(io::IntoInnerError::into_error)? {
                Sink::Temporary(file) => {
                    // First the content, then the name: after a power cut the name must not stand on an
                    // empty file.
                    file.as_file().sync_all()?;
                    file.persist(end_of_links(&path)?).map_err(|error| error.error)?;
                    Ok(())
                }
                Sink::Direct(mut file) => file.flush(),
            }
        };
        finished().map_err(|error| cannot_write(&path, &error))
    }

    /// The error for a failed write to this file.
    pub fn error(&self, error: &io::Error) -> InputError {
        cannot_write(&self.path, error)
    }
}

/// Writes a file of text: complete, or not at all.
///
/// # Errors
/// A place that cannot be written.
pub fn write(path: impl AsRef<Path>, text: &str) -> Result<(), InputError> {
    let mut file = OutputFile::create(path)?;
    file.write_text(text)?;
    file.finish()
}

impl OutputFile {
    /// Writes text into a file that has been begun.
    ///
    /// # Errors
    /// A disk that is full, and the like.
    pub fn write_text(&mut self, text: &str) -> Result<(), InputError> {
        self.write_all(text.as_bytes()).map_err(|error| self.error(&error))
    }
}

impl Write for OutputFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.sink.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.sink.flush()
    }
}

/// Temporary files that are being written, for an interrupt to remove: it ends the program without dropping
/// anything.
static UNFINISHED: Mutex<Vec<PathBuf>> = Mutex::new(Vec::new());

fn unfinished<T>(change: impl FnOnce(&mut Vec<PathBuf>) -> T) -> T {
    change(&mut UNFINISHED.lock().unwrap_or_else(PoisonError::into_inner))
}

/// Removes every file that has not been finished. Only for a program that is about to end.
pub fn remove_unfinished() {
    // What was finished has another name by now, and what was dropped is gone: neither is an error.
    unfinished(|files| files.drain(..).for_each(|path| drop(fs::remove_file(path))));
}

/// Refuses to put an output in the place of an input: a recording or a scene can't be made again. Each output is named
/// by its option.
///
/// # Errors
/// An output is one of `inputs`, or two of them are one file.
pub fn spare(inputs: &[&Path], outputs: &[(&str, Option<&Path>)]) -> Result<(), InputError> {
    for (n, (option, out)) in outputs.iter().enumerate() {
        let Some(out) = out else { continue };
        for (other, same) in &outputs[..n] {
            if same.is_some_and(|same| is_same(same, out)) {
                return Err(InputError::new(format!("is {other}'s file already"))
                    .field(*option)
                    .value(out.display()));
            }
        }
        let Ok(target) = fs::canonicalize(out) else { continue };
        if inputs.iter().any(|input| fs::canonicalize(input).is_ok_and(|input| input == target)) {
            return Err(InputError::new("must not be a file that is read")
                .field(*option)
                .value(out.display()));
        }
    }
    Ok(())
}

/// Whether two paths are one file, which may not be there yet. A device or a pipe takes more than one output.
fn is_same(one: &Path, other: &Path) -> bool {
    let place = |path: &Path| {
        let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let made = || Some(fs::canonicalize(folder).ok()?.join(path.file_name()?));
        fs::canonicalize(path).ok().or_else(made)
    };
    let is_file = |path: &Path| fs::metadata(path).map_or(true, |found| found.is_file());
    place(one).is_some_and(|one| place(other) == Some(one)) && is_file(one)
}

/// Prints a line to standard output. A reader that has gone away (`| head`) is no error.
///
/// # Errors
/// It can't be written, to a full disk for instance.
pub fn print(line: &str) -> Result<(), InputError> {
    let mut stdout = io::stdout();
    match writeln!(stdout, "{line}").and_then(|()| stdout.flush()) {
        Err(error) if error.kind() != io::ErrorKind::BrokenPipe => {
            Err(cannot_write(Path::new("standard output"), &error))
        }
        _ => Ok(()),
    }
}

fn cannot_write(path: &Path, error: &io::Error) -> InputError {
    // The error ends with the name of the temporary file, which the user does not know.
    let why = error.to_string();
    InputError::new(format!("cannot be written: {}", why.split(" at path ").next().unwrap_or(&why)))
        .file(path)
}

fn open(path: &Path) -> io::Result<Sink> {
    if let Ok(found) = fs::metadata(path)
        && !found.is_file()
    {
        // A directory fails here, with the system's own words.
        return File::options().write(true).open(path).map(Sink::Direct);
    }
    let target = end_of_links(path)?;
    let directory = match target.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
    let mut builder = tempfile::Builder::new();
    builder.prefix(".kestrel-");
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt as _;
        // Temporary files are private by default; this one becomes an ordinary file, so the umask decides.
        builder.permissions(fs::Permissions::from_mode(0o666));
    }
    builder.tempfile_in(directory).map(Sink::Temporary)
}

/// Where a symbolic link leads, so that the link stays and its target is replaced.
fn end_of_links(path: &Path) -> io::Result<PathBuf> {
    if path.exists() { fs::canonicalize(path) } else { Ok(path.to_path_buf()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn appears_only_when_finished() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("log.csv");
        fs::write(&path, "old").unwrap();

        let mut abandoned = OutputFile::create(&path).unwrap();
        abandoned.write_all(b"half").unwrap();
        abandoned.flush().unwrap();
        assert_eq!(fs::read_to_string(&path).unwrap(), "old");
        drop(abandoned);
        assert_eq!(fs::read_dir(directory.path()).unwrap().count(), 1, "the temporary file is gone");

        let mut whole = OutputFile::create(&path).unwrap();
        whole.write_all(b"new").unwrap();
        whole.finish().unwrap();
        assert_eq!(fs::read_to_string(&path).unwrap(), "new");
    }

    #[test]
    fn a_place_that_cannot_be_written_is_named_in_one_line() {
        let directory = tempfile::tempdir().unwrap();
        for path in [directory.path().to_path_buf(), directory.path().join("missing/log.csv")] {
            let error = OutputFile::create(&path).unwrap_err().to_string();
            assert!(error.starts_with(&format!("{}: cannot be written: ", path.display())), "{error}");
            assert_eq!(error.lines().count(), 1);
        }
    }

    #[cfg(unix)]
    #[test]
    fn a_symbolic_link_stays_and_its_target_is_replaced() {
        let directory = tempfile::tempdir().unwrap();
        let (target, link) = (directory.path().join("target"), directory.path().join("link"));
        fs::write(&target, "old").unwrap();
        std::os::unix::fs::symlink(&target, &link).unwrap();
        let mut file = OutputFile::create(&link).unwrap();
        file.write_all(b"new").unwrap();
        file.finish().unwrap();
        assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
        assert_eq!(fs::read_to_string(&target).unwrap(), "new");
    }

    #[cfg(unix)]
    #[test]
    fn a_pipe_is_written_to_and_not_replaced() {
        use std::os::unix::fs::FileTypeExt as _;
        let directory = tempfile::tempdir().unwrap();
        let pipe = directory.path().join("pipe");
        assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        let reader = std::thread::spawn({
            let pipe = pipe.clone();
            move || fs::read_to_string(pipe).unwrap()
        });
        let mut file = OutputFile::create(&pipe).unwrap();
        file.write_all(b"through").unwrap();
        file.finish().unwrap();
        assert_eq!(reader.join().unwrap(), "through");
        assert!(fs::metadata(&pipe).unwrap().file_type().is_fifo());
    }
}
