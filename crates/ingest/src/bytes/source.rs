//! Opens exports: text, plain or compressed, Parquet, MCAP bags and the formats of makers, distinguished by their first
//! bytes.

use std::io::{self, BufReader, Read, Seek};
use std::path::Path;

use flate2::read::MultiGzDecoder;

use super::access::asking;
use super::bag::{self, BagText};
use super::fingerprint::{HashingReader, RunningHash, regular_file};
use super::parquet::{self, ParquetText};
use super::scope;
use super::trace::{self, TraceText};
use crate::rejection::{Rejection, Unreadable};
use armwatch_model::text;

/// Most bytes an export may have after decompression. A ten-hour recording of a nine-axis arm at
/// 1 kHz is about 20 GB; a few kilobytes of gzip can claim any size.
pub const MAX_DECOMPRESSED_BYTES: u64 = 64 << 30;

/// Largest window of a Zstandard stream, as a power of two: 8 MiB, the limit of levels up to 19, which every decoder
/// must support. Each export that is being read needs one.
const MAX_WINDOW_LOG: u32 = 23;

/// Bytes read from disk at once for the decoders, whose own requests are small.
const DISK_BUFFER_BYTES: usize = 256 << 10;

/// Bytes that distinguish formats.
pub(crate) const MAGIC_BYTES: u64 = scope::HEAD_BYTES;

/// Opens an export for reading its decompressed bytes.
///
/// The first bytes determine the format, not the name: plain text, gzip with any number of members, Zstandard with any
/// number of frames, Parquet, MCAP bags, KUKA traces and TwinCAT Scope exports, whose rows become lines of CSV. Reading
/// fails if a compressed stream is cut or damaged, or exceeds [`MAX_DECOMPRESSED_BYTES`]; [`Rejection::from_io`]
/// explains such an error.
///
/// # Errors
/// A rejection for a path that is not a regular file, cannot be opened, or is an archive of another kind.
pub fn open(path: &Path) -> Result<Box<dyn Read + Send>, Rejection> {
    open_hashing(path).map(|(reader, _)| reader)
}

/// Like [`open`], and also hashes the bytes on disk: at the reader's end the hash equals
/// [`super::fingerprint::fingerprint`], unless the file changed during reading.
///
/// # Errors
/// Those of [`open`].
pub fn open_hashing(path: &Path) -> Result<(Box<dyn Read + Send>, RunningHash), Rejection> {
    open_hashing_up_to(path, MAX_DECOMPRESSED_BYTES)
}

/// Like [`open_hashing`], with `most` bytes after decompression as the bound.
///
/// # Errors
/// Those of [`open`].
pub fn open_hashing_up_to(path: &Path, most: u64) -> Result<(Box<dyn Read + Send>, RunningHash), Rejection> {
    let failed = |error: io::Error| Rejection::from_io(path, &error);
    let mut file = regular_file(path).map_err(failed)?;
    let mut head = Vec::new();
    asking(|| file.by_ref().take(MAGIC_BYTES).read_to_end(&mut head)).map_err(failed)?;
    asking(|| file.rewind()).map_err(failed)?;
    let format = format(&head);
    if matches!(format, Format::Parquet) {
        let (text, hash) = ParquetText::open(file, path)?;
        return Ok((Box::new(LimitedReader { inner: text, left: most, most }), hash));
    }
    if matches!(format, Format::Trace) {
        let (text, hash) = TraceText::open(file, path)?;
        return Ok((Box::new(LimitedReader { inner: text, left: most, most }), hash));
    }
    let (file, hash) = HashingReader::new(file);
    let decoded = decoded(file, format, &hash, path)?;
    Ok((Box::new(LimitedReader { inner: decoded, left: most, most }), hash))
}

/// Returns true if the first bytes of a file are those of plain text, which is readable in part.
pub(crate) fn is_plain(head: &[u8]) -> bool {
    matches!(format(head), Format::Plain) && !scope::is_scope(head)
}

/// Endings of the names of exports.
pub const ENDINGS: [&str; 5] = [".csv", ".csv.gz", ".csv.zst", ".parquet", ".mcap"];

/// Returns true if a file of this name is an export, see [`ENDINGS`]. Upper and lower case are equal. Hidden files are
/// not exports, and neither are files with the suffix `.part` or `.tmp`, which writers use until a file is complete.
pub fn is_export(path: &Path) -> bool {
    let Some(name) = path.file_name() else { return false };
    let name = name.to_string_lossy().to_ascii_lowercase();
    let stem = ENDINGS.iter().find_map(|ending| name.strip_suffix(ending));
    stem.is_some_and(|stem| !stem.is_empty() && !stem.starts_with('.'))
}

/// A path as text that identifies it: absolute, so independent of the working folder, and also valid if its bytes are
/// not UTF-8, as in names from an old controller. [`text::to_path`] restores the path.
pub fn path_text(path: &Path) -> String {
    text::of_path(&std::path::absolute(path).unwrap_or_else(|_| path.to_owned()))
}

fn decoded(
    file: impl Read + Send + 'static,
    format: Format,
    raw: &RunningHash,
    path: &Path,
) -> Result<Box<dyn Read + Send>, Rejection> {
    let failed = |error: io::Error| Rejection::from_io(path, &error);
    match format {
        Format::Plain => scope::plain(file).map_err(failed),
        Format::Gzip => {
            let decoder = MultiGzDecoder::new(BufReader::with_capacity(DISK_BUFFER_BYTES, file));
            let text = ExplainingReader { inner: decoder, format: "gzip", raw: raw.clone(), given: 0 };
            scope::plain(text).map_err(failed)
        }
        Format::Zstandard => {
            let mut decoder = zstd::Decoder::with_buffer(BufReader::with_capacity(DISK_BUFFER_BYTES, file))
                .map_err(failed)?;
            decoder.window_log_max(MAX_WINDOW_LOG).map_err(failed)?;
            let text = ExplainingReader { inner: decoder, format: "zstd", raw: raw.clone(), given: 0 };
            scope::plain(text).map_err(failed)
        }
        Format::Bag => Ok(Box::new(BagText::new(file, path))),
        // opened separately, since they are not read from start to end
        Format::Parquet | Format::Trace => {
            Err(Rejection::of_file(path, "a file that changed", "export again"))
        }
        Format::Other(name) => {
            Err(Rejection::of_file(path, name, "unpack it, or compress the export with gzip or zstd"))
        }
    }
}

enum Format {
    Plain,
    Gzip,
    Zstandard,
    Parquet,
    Bag,
    Trace,
    /// Known, but unsupported.
    Other(&'static str),
}

fn format(head: &[u8]) -> Format {
    match head {
        [0x1F, 0x8B, ..] => Format::Gzip,
        [0x28, 0xB5, 0x2F, 0xFD, ..] => Format::Zstandard,
        // A zstd stream may begin with a skippable frame, marked 0x184D2A50 to 0x184D2A5F.
        [0x50..=0x5F, 0x2A, 0x4D, 0x18, ..] => Format::Zstandard,
        [b'P', b'A', b'R', b'E', ..] => Format::Other("an encrypted Parquet file, which is not supported"),
        _ if head.starts_with(&parquet::MAGIC) => Format::Parquet,
        _ if head.starts_with(&bag::MAGIC) => Format::Bag,
        _ if trace::is_header(head) => Format::Trace,
        [b'P', b'K', 3, 4, ..] => Format::Other("a zip archive or spreadsheet, not a CSV export"),
        [0xFD, b'7', b'z', b'X', b'Z', 0, ..] => Format::Other("xz compression, which is not supported"),
        [b'B', b'Z', b'h', b'1'..=b'9', ..] => Format::Other("bzip2 compression, which is not supported"),
        [b'7', b'z', 0xBC, 0xAF, ..] => Format::Other("a 7z archive, not a CSV export"),
        _ => Format::Plain,
    }
}

/// Replaces the decoder's errors by messages with a remedy.
struct ExplainingReader<R> {
    inner: R,
    format: &'static str,
    /// Counts the bytes on disk.
    raw: RunningHash,
    /// Decompressed bytes so far.
    given: u64,
}

impl<R: Read> Read for ExplainingReader<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let read = self.inner.read(buffer);
        self.given += read.as_ref().map_or(0, |count| *count as u64);
        read.map_err(|error| match error.kind() {
            // an error of the file below, not of the stream in it
            _ if error.raw_os_error().is_some() => error,
            io::ErrorKind::Interrupted => error,
            io::ErrorKind::UnexpectedEof => unreadable(
                format!(
                    "a {} stream that ends too early, at byte {} of the file, after {} bytes of text",
                    self.format,
                    self.raw.bytes(),
                    self.given
                ),
                "the copy or the compression was cut off; copy the export again",
            ),
            // the library has no other way to identify it
            _ if error.to_string().contains("too much memory") => unreadable(
                format!(
                    "a {} stream whose window is larger than {} MiB",
                    self.format,
                    (1_u64 << MAX_WINDOW_LOG) >> 20
                ),
                "compress it again without --long, at level 19 or below",
            ),
            _ => unreadable(
                format!("a damaged {} stream after {} bytes of text ({error})", self.format, self.given),
                "copy or compress the export again",
            ),
        })
    }
}

/// Ends a stream with an error once it exceeds its limit.
struct LimitedReader<R> {
    inner: R,
    left: u64,
    most: u64,
}

impl<R: Read> Read for LimitedReader<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let count = self.inner.read(buffer)?;
        self.left = self.left.checked_sub(count as u64).ok_or_else(|| {
            unreadable(
                format!("more than {} bytes after decompression", self.most),
                "split the recording into several exports, or raise limits.export_max_bytes",
            )
        })?;
        Ok(count)
    }
}

pub(crate) fn unreadable(reason: String, remedy: &str) -> io::Error {
    io::Error::other(Unreadable { reason, remedy: remedy.to_owned() })
}

#[cfg(test)]
mod tests {
    use std::io::Write;
    use std::path::PathBuf;

    use flate2::Compression;
    use flate2::write::GzEncoder;

    use super::super::fingerprint::fingerprint;
    use super::*;

    const TEXT: &[u8] = b"time,pos_1\n0.0,1.5\n0.002,1.6\n";

    fn gzip(bytes: &[u8]) -> Vec<u8> {
        let mut encoder = GzEncoder::new(Vec::new(), Compression::default());
        encoder.write_all(bytes).unwrap();
        encoder.finish().unwrap()
    }

    fn zstandard(bytes: &[u8]) -> Vec<u8> {
        zstd::encode_all(bytes, 3).unwrap()
    }

    struct FormatCase {
        _folder: tempfile::TempDir,
        path: PathBuf,
    }

    fn case(name: &str, bytes: &[u8]) -> FormatCase {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        FormatCase { _folder: folder, path }
    }

    fn read(path: &Path) -> Result<Vec<u8>, Rejection> {
        let mut bytes = Vec::new();
        open(path)?.read_to_end(&mut bytes).map_err(|e| Rejection::from_io(path, &e))?;
        Ok(bytes)
    }

    #[test]
    fn the_first_bytes_decide_not_the_name() {
        let (front, back) = TEXT.split_at(13);
        let members = [gzip(front), gzip(back)].concat();
        let frames = [zstandard(front), zstandard(back)].concat();
        for (name, bytes) in [
            ("a.csv", TEXT.to_vec()),
            ("a.csv.gz", gzip(TEXT)),
            ("a.csv.zst", zstandard(TEXT)),
            ("gzip_called_plain.csv", gzip(TEXT)),
            ("plain_called_gzip.csv.gz", TEXT.to_vec()),
            ("members.csv.gz", members),
            ("frames.csv.zst", frames),
        ] {
            assert_eq!(read(&case(name, &bytes).path).unwrap(), TEXT, "{name}");
        }
        assert_eq!(read(&case("empty.csv.gz", b"").path).unwrap(), b"");
    }

    #[test]
    fn a_cut_stream_is_said_to_be_cut_wherever_it_is_cut() {
        let long = TEXT.repeat(50);
        for (format, bytes) in [("gzip", gzip(&long)), ("zstd", zstandard(&long))] {
            for keep in [6, bytes.len() / 2, bytes.len() - 1] {
                let rejection = read(&case("a.csv.gz", &bytes[..keep]).path).unwrap_err();
                let said =
                    format!("a {format} stream that ends too early, at byte {keep} of the file, after ");
                assert!(rejection.reason.starts_with(&said), "{rejection}");
            }
        }
    }

    #[test]
    fn a_damaged_stream_is_said_to_be_damaged() {
        let mut bytes = gzip(&TEXT.repeat(50));
        let checksum = bytes.len() - 8;
        bytes[checksum] ^= 0xFF;
        let rejection = read(&case("a.csv.gz", &bytes).path).unwrap_err();
        assert!(rejection.reason.starts_with("a damaged gzip stream"), "{rejection}");
    }

    #[test]
    fn a_window_of_many_megabytes_is_refused_and_that_of_a_high_level_is_not() {
        let long: Vec<u8> =
            (0..3_000_000_u32).flat_map(|n| n.wrapping_mul(2_654_435_761).to_le_bytes()).collect();
        let packed = |window_log| {
            let mut encoder = zstd::Encoder::new(Vec::new(), 3).unwrap();
            encoder.window_log(window_log).unwrap();
            encoder.write_all(&long).unwrap();
            encoder.finish().unwrap()
        };
        assert_eq!(read(&case("a.csv.zst", &packed(23)).path).unwrap(), long);
        assert_eq!(read(&case("a.csv.zst", &zstd::encode_all(TEXT, 19).unwrap()).path).unwrap(), TEXT);
        let rejection = read(&case("a.csv.zst", &packed(27)).path).unwrap_err();
        assert_eq!(&*rejection.reason, "a zstd stream whose window is larger than 8 MiB", "{rejection}");
    }

    #[test]
    fn other_archives_are_named() {
        let rejection = read(&case("a.csv", b"PK\x03\x04....").path).unwrap_err();
        assert_eq!(&*rejection.reason, "a zip archive or spreadsheet, not a CSV export");
    }

    #[test]
    fn only_regular_files_are_opened() {
        let folder = tempfile::tempdir().unwrap();
        let reason = |path: &Path| open(path).err().unwrap().reason;
        assert_eq!(&*reason(folder.path()), "a folder, not a regular file");
        assert_eq!(&*reason(&folder.path().join("none.csv")), "no such file");
        #[cfg(unix)]
        {
            let special = "a special file (pipe, socket or device), not a regular file";
            assert_eq!(&*reason(Path::new("/dev/zero")), special);
            let socket = folder.path().join("socket.csv");
            let _bound = std::os::unix::net::UnixListener::bind(&socket).unwrap();
            assert_eq!(&*reason(&socket), special);
            let link = folder.path().join("link.csv");
            let target = case("a.csv", TEXT);
            std::os::unix::fs::symlink(&target.path, &link).unwrap();
            assert_eq!(read(&link).unwrap(), TEXT);
        }
    }

    #[test]
    fn a_stream_over_the_limit_ends_with_an_error() {
        let mut stream = LimitedReader { inner: io::repeat(b'0'), left: 100_000, most: 100_000 };
        let error = io::copy(&mut stream, &mut io::sink()).unwrap_err();
        let rejection = Rejection::from_io(Path::new("bomb.csv.gz"), &error);
        assert_eq!(&*rejection.reason, "more than 100000 bytes after decompression");
        let mut exact = LimitedReader { inner: io::repeat(b'0').take(100_000), left: 100_000, most: 100_000 };
        assert_eq!(io::copy(&mut exact, &mut io::sink()).unwrap(), 100_000);
    }

    #[test]
    fn hash_on_the_side_is_of_the_bytes_on_disk() {
        for (name, bytes) in [
            ("a.csv", TEXT.repeat(9000)),
            ("a.csv.gz", gzip(&TEXT.repeat(9000))),
            ("a.csv.zst", zstandard(&TEXT.repeat(9000))),
        ] {
            let case = case(name, &bytes);
            let (mut reader, hash) = open_hashing(&case.path).unwrap();
            io::copy(&mut reader, &mut io::sink()).unwrap();
            assert_eq!(hash.so_far(), fingerprint(&case.path).unwrap(), "{name}");
        }
    }

    #[test]
    fn names_of_exports() {
        for yes in
            ["R01_20260101_0800.csv", "a/b/R01.csv.gz", "R01.csv.zst", "R01.CSV", "R01.parquet", "R01.mcap"]
        {
            assert!(is_export(Path::new(yes)), "{yes}");
        }
        for no in [
            ".R01.csv",
            ".csv",
            "R01.csv.part",
            "R01.csv.tmp",
            "R01.csv.gz.part",
            "R01.truth.json",
            "R01.csv.truth.json",
            "R01.txt",
            "R01.gz",
            "csv",
            "..",
        ] {
            assert!(!is_export(Path::new(no)), "{no}");
        }
    }
}
