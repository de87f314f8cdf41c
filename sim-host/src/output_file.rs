//! Output files that appear complete or not at all.
//!
//! The content goes to a temporary file in the same directory, and [`OutputFile::finish`] renames it in one step of
//! the file system. A run that stops early leaves the old file, or none. It never leaves half a log, which would look
//! like the log of a short flight.

use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use std::sync::{Mutex, PoisonError};

use tempfile::NamedTempFile;

use input::InputError;

/// A file that is being written. Dropped without [`finish`](Self::finish), it removes its temporary file.
#[derive(Debug)]
pub struct OutputFile {
    sink: BufWriter<Sink>,
    path: PathBuf,
}

#[derive(Debug)]
enum Sink {
    Temporary(NamedTempFile),
    /// A pipe or a device, which is written directly: a rename would replace `/dev/null` by a file.
    Direct(File),
}

impl Write for Sink {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match self {
            Self::Temporary(file) => file.write(bytes),
            // A pipe whose reader has ended (`| head`) is no error.
            Self::Direct(file) => match file.write(bytes) {
                Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Ok(bytes.len()),
                written => written,
            },
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
    /// Starts a file that will be `path`. An old file stays until [`finish`](Self::finish).
    ///
    /// # Errors
    /// The directory does not exist or cannot be written.
    pub fn create(path: impl AsRef<Path>) -> Result<Self, InputError> {
        let path = path.as_ref().to_path_buf();
        let sink = open(&path).map_err(|error| cannot_write(&path, &error))?;
        if let Sink::Temporary(file) = &sink {
            unfinished(|files| files.push(file.path().to_path_buf()));
        }
        Ok(Self { sink: BufWriter::with_capacity(1 << 16, sink), path })
    }

    /// Writes everything to the disk and renames the file to its path.
    ///
    /// # Errors
    /// The disk is full, or the file cannot be renamed.
    pub fn finish(self) -> Result<(), InputError> {
        finish_all([self])
    }

    /// Writes everything to the disk before the file gets its name. Otherwise the path could name an empty file after a
    /// power cut.
    fn write_to_disk(&mut self) -> io::Result<()> {
        self.sink.flush()?;
        match self.sink.get_ref() {
            Sink::Temporary(file) => file.as_file().sync_all(),
            Sink::Direct(_) => Ok(()),
        }
    }

    /// Renames the file to its path.
    fn rename(self) -> io::Result<()> {
        match self.sink.into_inner().map_err(io::IntoInnerError::into_error)? {
            Sink::Temporary(file) => {
                file.persist(target_of(&self.path)?).map_err(|error| error.error)?;
                Ok(())
            }
            Sink::Direct(_) => Ok(()),
        }
    }

    /// Returns the error for a failed write to this file.
    pub fn error(&self, error: &io::Error) -> InputError {
        cannot_write(&self.path, error)
    }
}

/// Completes several files: all, or none if one of them cannot be written to the disk.
///
/// # Errors
/// As [`OutputFile::finish`].
pub fn finish_all(files: impl IntoIterator<Item = OutputFile>) -> Result<(), InputError> {
    let mut files: Vec<OutputFile> = files.into_iter().collect();
    for file in &mut files {
        file.write_to_disk().map_err(|error| cannot_write(&file.path, &error))?;
    }
    for file in files {
        let path = file.path.clone();
        file.rename().map_err(|error| cannot_write(&path, &error))?;
    }
    Ok(())
}

/// Writes a text file: complete, or not at all.
///
/// # Errors
/// As [`OutputFile::create`] and [`OutputFile::finish`].
pub fn write(path: impl AsRef<Path>, text: &str) -> Result<(), InputError> {
    let mut file = OutputFile::create(path)?;
    file.write_text(text)?;
    file.finish()
}

impl OutputFile {
    /// Appends text to the file.
    ///
    /// # Errors
    /// The write fails, for example because the disk is full.
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

/// Paths of the temporary files. After a signal the program ends without dropping values, so the handler removes these.
static UNFINISHED: Mutex<Vec<PathBuf>> = Mutex::new(Vec::new());

fn unfinished<T>(change: impl FnOnce(&mut Vec<PathBuf>) -> T) -> T {
    change(&mut UNFINISHED.lock().unwrap_or_else(PoisonError::into_inner))
}

/// Removes all temporary files. Only for a program that is about to end.
pub fn remove_unfinished() {
    // Finished files have been renamed and dropped ones removed, so a failure to remove is no error.
    unfinished(|files| files.drain(..).for_each(|path| drop(fs::remove_file(path))));
}

/// Checks that no output would overwrite an input or another output. A recording or a scene cannot be restored.
/// Each output comes with the name of its option, for the error.
///
/// # Errors
/// An output is one of `inputs`, or two outputs are the same file.
pub fn check_outputs(inputs: &[&Path], outputs: &[(&str, Option<&Path>)]) -> Result<(), InputError> {
    for (n, (option, out)) in outputs.iter().enumerate() {
        let Some(out) = out else { continue };
        for (other, same) in &outputs[..n] {
            if same.is_some_and(|same| is_same(same, out)) {
                return Err(InputError::new(format!("is already the file of {other}"))
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

/// Whether two paths name the same regular file, which need not exist yet. A device or a pipe may take several outputs.
fn is_same(one: &Path, other: &Path) -> bool {
    let is_file = |path: &Path| fs::metadata(path).map_or(true, |found| found.is_file());
    target_of(one).is_ok_and(|one| target_of(other).is_ok_and(|other| one == other)) && is_file(one)
}

/// Prints a line on standard output. A pipe whose reader has ended (`| head`) is no error.
///
/// # Errors
/// The line cannot be written, for example to a full disk.
pub fn print(line: &str) -> Result<(), InputError> {
    let mut stdout = io::stdout();
    match writeln!(stdout, "{line}").and_then(|()| stdout.flush()) {
        Err(error) if error.kind() != io::ErrorKind::BrokenPipe => {
            Err(cannot_write(Path::new("standard output"), &error))
        }
        _ => Ok(()),
    }
}

/// Prints a line on standard error. If it cannot be written, nobody can be told, so this is no error.
pub fn print_note(line: &str) {
    let _ = writeln!(io::stderr(), "{line}");
}

fn cannot_write(path: &Path, error: &io::Error) -> InputError {
    // Cuts the end of the message, which names the temporary file: the user does not know it.
    let message = error.to_string();
    InputError::new(format!("cannot be written: {}", message.split(" at path ").next().unwrap_or(&message)))
        .file(path)
}

fn open(path: &Path) -> io::Result<Sink> {
    if let Ok(found) = fs::metadata(path)
        && !found.is_file()
    {
        // Opening a directory fails here, with the error of the system.
        return File::options().write(true).open(path).map(Sink::Direct);
    }
    let target = target_of(path)?;
    let directory = target.parent().unwrap_or(Path::new("/"));
    let mut builder = tempfile::Builder::new();
    builder.prefix(".kestrel-");
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt as _;
        // Temporary files are private by default. This one becomes an ordinary file, with the permissions of the umask.
        builder.permissions(fs::Permissions::from_mode(0o666));
    }
    builder.tempfile_in(directory).map(Sink::Temporary)
}

/// Returns the full path of a file that need not exist. A symbolic link is followed, so that the link stays and its target
/// is replaced.
fn target_of(path: &Path) -> io::Result<PathBuf> {
    /// Longest chain of links to files that do not exist, as in the kernel.
    const MAX_LINKS: usize = 40;
    let mut path = path.to_path_buf();
    for _ in 0..MAX_LINKS {
        if let Ok(found) = fs::canonicalize(&path) {
            return Ok(found);
        }
        let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
        match fs::read_link(&path) {
            Ok(target) => path = folder.join(target),
            Err(_) => {
                let name = path.file_name().ok_or(io::ErrorKind::IsADirectory)?;
                return Ok(fs::canonicalize(folder)?.join(name));
            }
        }
    }
    Err(io::Error::other("too many symbolic links"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn file_appears_only_when_finished() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("log.csv");
        fs::write(&path, "old").unwrap();

        let mut abandoned = OutputFile::create(&path).unwrap();
        abandoned.write_all(b"half").unwrap();
        abandoned.flush().unwrap();
        assert_eq!(fs::read_to_string(&path).unwrap(), "old");
        drop(abandoned);
        assert_eq!(fs::read_dir(directory.path()).unwrap().count(), 1, "the temporary file is removed");

        let mut finished = OutputFile::create(&path).unwrap();
        finished.write_all(b"new").unwrap();
        finished.finish().unwrap();
        assert_eq!(fs::read_to_string(&path).unwrap(), "new");
    }

    #[test]
    fn unwritable_path_gives_a_one_line_error() {
        let directory = tempfile::tempdir().unwrap();
        for path in [directory.path().to_path_buf(), directory.path().join("missing/log.csv")] {
            let error = OutputFile::create(&path).unwrap_err().to_string();
            assert!(error.starts_with(&format!("{}: cannot be written: ", path.display())), "{error}");
            assert_eq!(error.lines().count(), 1);
        }
    }

    #[cfg(unix)]
    #[test]
    fn symbolic_link_stays_and_its_target_is_replaced() {
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
    fn link_to_a_new_file_stays_and_is_the_same_output() {
        let directory = tempfile::tempdir().unwrap();
        let (target, link) = (directory.path().join("target"), directory.path().join("link"));
        std::os::unix::fs::symlink("target", &link).unwrap();
        let error = check_outputs(&[], &[("--log", Some(&link)), ("--report", Some(&target))]).unwrap_err();
        assert!(error.to_string().ends_with("is already the file of --log"), "{error}");
        write(&link, "new").unwrap();
        assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
        assert_eq!(fs::read_to_string(&target).unwrap(), "new");
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn all_files_are_completed_or_none() {
        let directory = tempfile::tempdir().unwrap();
        let log = directory.path().join("log.csv");
        let mut files = [log.as_path(), Path::new("/dev/full")].map(|path| OutputFile::create(path).unwrap());
        files.iter_mut().for_each(|file| file.write_text("text").unwrap());
        let error = finish_all(files).unwrap_err().to_string();
        assert!(error.starts_with("/dev/full: cannot be written: "), "{error}");
        assert_eq!(fs::read_dir(directory.path()).unwrap().count(), 0);
    }

    #[cfg(unix)]
    #[test]
    fn pipe_is_written_and_not_replaced() {
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
