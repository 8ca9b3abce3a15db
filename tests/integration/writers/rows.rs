//! The matrix: actions of the writer, and the expected runs.

use std::ffi::OsString;
use std::fs::{self, File, OpenOptions};
use std::io::{Seek, SeekFrom, Write};
use std::os::unix::ffi::OsStringExt;
use std::os::unix::fs::{PermissionsExt, symlink};
use std::path::Path;
use std::process::Command;
use std::time::{Duration, SystemTime};

use super::stage::{Stage, append_slowly};
use crate::small::{Export, gzip};
use crate::support::pass;

/// An action of a writer, and each expected run: status, cycles, and a part of its reason.
pub struct Row {
    pub name: &'static str,
    pub act: fn(&Stage),
    pub runs: &'static [&'static str],
}

const WHOLE: &[&str] = &["complete|2|"];
const TWO: &[&str] = &["complete|2|", "complete|2|"];
const REPLACED: &[&str] = &["superseded|2|exported again", "complete|2|"];
const LEADS_OUT: &[&str] = &["quarantined|0|a link to a place outside"];
const NOTHING: &[&str] = &[];

/// A pause much shorter than the time to settle.
const SHORT: Duration = Duration::from_millis(40);

pub const ROWS: &[Row] = &[
    Row { name: "moved in whole", act: moved_in, runs: WHOLE },
    Row { name: "appended slowly", act: |s| appended(s, 30, SHORT), runs: WHOLE },
    Row {
        name: "appended with long pauses",
        act: |s| appended(s, 4, Duration::from_millis(1500)),
        runs: WHOLE,
    },
    Row { name: "opened anew for every piece", act: opened_anew, runs: WHOLE },
    Row { name: "last line cut, then completed", act: last_line_cut, runs: WHOLE },
    Row { name: "last line without its end", act: no_last_line_end, runs: WHOLE },
    Row { name: "copied with an old time", act: |s| timed(s, at(1_500_000_000)), runs: WHOLE },
    Row { name: "time in the future", act: |s| timed(s, at(4_200_000_000)), runs: WHOLE },
    Row { name: "time 1970", act: |s| timed(s, SystemTime::UNIX_EPOCH), runs: WHOLE },
    Row {
        name: "truncated and rewritten shorter",
        act: rewritten_shorter,
        runs: &["superseded|2|", "complete|1|"],
    },
    Row { name: "truncated and rewritten", act: rewritten, runs: REPLACED },
    Row { name: "changed in place, same size and time", act: changed_in_place, runs: REPLACED },
    Row { name: "renamed over", act: renamed_over, runs: REPLACED },
    Row { name: "two files with one header", act: two_files, runs: TWO },
    Row { name: "one name, one recording after the other", act: one_name, runs: TWO },
    Row { name: "another name, same content", act: another_name, runs: WHOLE },
    Row { name: "corrected under another name", act: corrected, runs: REPLACED },
    Row {
        name: "a part of a copy under another name",
        act: part_of_a_copy,
        runs: &["complete|2|", "complete|1|"],
    },
    Row { name: "number of a file given again", act: number_again, runs: TWO },
    Row { name: "hard link", act: hard_link, runs: WHOLE },
    Row { name: "symbolic link to a file of the folder", act: link_to_file, runs: WHOLE },
    Row { name: "symbolic link to a file elsewhere", act: link_out, runs: LEADS_OUT },
    Row { name: "symbolic link to nothing, then to a file", act: link_to_nothing, runs: WHOLE },
    Row { name: "symbolic link to a folder", act: link_to_folder, runs: LEADS_OUT },
    Row { name: "loops of links", act: loops, runs: WHOLE },
    Row { name: "deleted while it is read", act: deleted_while_read, runs: WHOLE },
    Row { name: "deleted after it was read", act: deleted_after, runs: WHOLE },
    Row { name: "empty, then written", act: empty_then_written, runs: WHOLE },
    Row { name: "a header, then the rows", act: header_then_rows, runs: WHOLE },
    Row { name: "a header only", act: header_only, runs: &["quarantined|0|no rows"] },
    Row { name: "set to its size, then filled", act: set_to_its_size, runs: WHOLE },
    Row { name: "line ends of Windows from the middle on", act: windows_line_ends, runs: WHOLE },
    Row { name: "byte order mark", act: byte_order_mark, runs: WHOLE },
    Row { name: "header again in the middle", act: header_again, runs: &["quarantined|1|repeated header"] },
    Row { name: "numbers that are none", act: not_numbers, runs: &["quarantined|1|not a finite number"] },
    Row { name: "time jumps back", act: |s| time_jumps(s, -5.0), runs: &["quarantined|1|time"] },
    Row { name: "time jumps forward", act: |s| time_jumps(s, 30.0), runs: WHOLE },
    Row { name: "no permission, then permission", act: no_permission, runs: WHOLE },
    Row { name: "folder that may only be read", act: read_only_folder, runs: WHOLE },
    Row { name: "folder that may not be read, then may", act: closed_folder, runs: WHOLE },
    Row { name: "gzip cut", act: |s| cut(s, &s.export(5).gzip()), runs: &["quarantined|1|ends too early"] },
    Row { name: "zstd cut", act: |s| cut(s, &s.export(5).zstd()), runs: &["quarantined|1|ends too early"] },
    Row { name: "gzip cut, then whole", act: cut_then_whole, runs: WHOLE },
    Row { name: "gzip written slowly", act: gzip_slowly, runs: WHOLE },
    Row { name: "gzip of two members", act: two_members, runs: WHOLE },
    Row { name: "zstd of two frames", act: two_frames, runs: WHOLE },
    Row { name: "gzip bomb", act: bomb, runs: &["quarantined|0|"] },
    Row { name: "named pipe", act: |s| made_by(s, "mkfifo", &[]), runs: NOTHING },
    Row {
        name: "device",
        act: |s| symlink("/dev/zero", s.path("R_20260105_0847.csv")).expect("linked"),
        runs: LEADS_OUT,
    },
    Row { name: "socket", act: socket, runs: NOTHING },
    Row { name: "name that is not UTF-8", act: |s| named(s, b"_20260105_0847_M\xe4rz.csv"), runs: WHOLE },
    Row { name: "name of 255 bytes", act: long_name, runs: WHOLE },
    Row {
        name: "name with quotes and points",
        act: |s| named(s, b"_20260105_0847_'\"..;--.csv"),
        runs: WHOLE,
    },
    Row {
        name: "name with a line end",
        act: |s| named(s, b"_20260105_0847_a\nb.csv"),
        runs: &["quarantined|0|"],
    },
    Row { name: "name in capitals", act: |s| named(s, b"_20260105_0847_X.CSV"), runs: WHOLE },
    Row { name: "mark before the file", act: mark_before, runs: WHOLE },
    Row { name: "mark after the file", act: mark_after, runs: WHOLE },
    Row {
        name: "mark without a file",
        act: |s| fs::write(s.path("R_20260105_0847.csv.done"), "").expect("written"),
        runs: NOTHING,
    },
    Row { name: "hidden and unfinished names", act: unfinished_names, runs: NOTHING },
    Row { name: "moved to another folder", act: moved, runs: WHOLE },
    Row { name: "moved to another folder while it grows", act: moved_while_growing, runs: WHOLE },
    Row { name: "touched", act: touched, runs: WHOLE },
    Row { name: "uploaded again over itself", act: uploaded_again, runs: WHOLE },
    Row { name: "watched folder that comes later", act: folder_comes_later, runs: WHOLE },
    Row { name: "watched folder removed and made again", act: folder_made_again, runs: TWO },
];

fn at(seconds: u64) -> SystemTime {
    SystemTime::UNIX_EPOCH + Duration::from_secs(seconds)
}

fn append(path: &Path, bytes: &[u8]) {
    let mut file = OpenOptions::new().create(true).append(true).open(path).expect("an export");
    file.write_all(bytes).expect("written");
}

fn moved_in(stage: &Stage) {
    let export = stage.export(5);
    fs::write(stage.outside("x"), &export.bytes).expect("written");
    fs::rename(stage.outside("x"), stage.path(&export.name)).expect("moved");
}

fn appended(stage: &Stage, pieces: usize, pause: Duration) {
    let export = stage.export(5);
    append_slowly(&stage.path(&export.name), &export.bytes, pieces, pause);
}

fn opened_anew(stage: &Stage) {
    let export = stage.export(5);
    for piece in export.bytes.chunks(export.bytes.len() / 20) {
        append(&stage.path(&export.name), piece);
        pass(SHORT);
    }
}

fn last_line_cut(stage: &Stage) {
    let export = stage.export(5);
    let path = stage.path(&export.name);
    let cut = export.bytes.len() - 30;
    append(&path, &export.bytes[..cut]);
    stage.wait(&["complete|2|"]);
    append(&path, &export.bytes[cut..]);
}

fn no_last_line_end(stage: &Stage) {
    let mut export = stage.export(5);
    export.bytes.pop();
    stage.put(&export);
}

fn timed(stage: &Stage, time: SystemTime) {
    let export = stage.export(5);
    let path = stage.outside(&export.name);
    fs::write(&path, &export.bytes).expect("written");
    File::options().write(true).open(&path).expect("it is there").set_modified(time).expect("a time");
    fs::rename(&path, stage.path(&export.name)).expect("moved");
}

/// Another content for the same recording.
fn second(stage: &Stage) -> Export {
    stage.export(6).named(&stage.export(5).name)
}

fn first_cycle(export: &Export) -> Vec<u8> {
    let of_first = |line: &&&[u8]| line.rsplit(|byte| *byte == b',').nth(2) != Some(b"2");
    export.lines().iter().filter(of_first).copied().collect::<Vec<_>>().concat()
}

fn rewritten_shorter(stage: &Stage) {
    stage.put(&stage.export(5));
    stage.wait(WHOLE);
    let second = second(stage);
    stage.put(&Export { bytes: first_cycle(&second), ..second });
}

fn rewritten(stage: &Stage) {
    stage.put(&stage.export(5));
    stage.wait(WHOLE);
    stage.put(&second(stage));
}

fn changed_in_place(stage: &Stage) {
    let path = stage.put(&stage.export(5));
    stage.wait(WHOLE);
    let (time, second) = (fs::metadata(&path).and_then(|m| m.modified()).expect("a time"), second(stage));
    let mut file = File::options().write(true).open(&path).expect("it is there");
    file.seek(SeekFrom::Start(0)).expect("a place");
    file.write_all(&second.bytes).expect("written");
    // a time that differs by the tolerance of a file server's clock
    file.set_modified(time + Duration::from_millis(1)).expect("a time");
}

fn renamed_over(stage: &Stage) {
    let path = stage.put(&stage.export(5));
    stage.wait(WHOLE);
    fs::write(stage.outside("x"), second(stage).bytes).expect("written");
    fs::rename(stage.outside("x"), path).expect("renamed");
}

fn two_files(stage: &Stage) {
    stage.put(&stage.export(5));
    stage.put(&stage.export(6));
}

fn one_name(stage: &Stage) {
    let name = stage.export(5).name.replace("_20260105_0847_x", "");
    stage.put(&stage.export(5).named(&name));
    stage.wait(WHOLE);
    stage.put(&stage.export(6).named(&name));
}

fn another_name(stage: &Stage) {
    let export = stage.export(5);
    stage.put(&export);
    stage.wait(WHOLE);
    stage.put(&export.named(&export.name.replace("_x", "_again")));
    stage.pause();
}

fn corrected(stage: &Stage) {
    stage.put(&stage.export(5));
    stage.wait(WHOLE);
    let corrected = second(stage);
    let path = stage.put(&corrected.named(&corrected.name.replace("_x", "_corrected")));
    stage.wait(REPLACED);
    // a touched file does not change the decision
    for path in [path, stage.path(&corrected.name)] {
        File::options()
            .write(true)
            .open(path)
            .expect("it is there")
            .set_modified(at(1_600_000_000))
            .expect("a time");
    }
    stage.pause();
}

fn part_of_a_copy(stage: &Stage) {
    let export = stage.export(5);
    stage.put(&export);
    stage.wait(WHOLE);
    let part = Export { bytes: first_cycle(&export), name: export.name.replace("_x", "_part") };
    stage.put(&part);
}

fn number_again(stage: &Stage) {
    let path = stage.put(&stage.export(5));
    stage.wait(WHOLE);
    fs::remove_file(path).expect("removed");
    stage.put(&stage.export(6));
}

fn hard_link(stage: &Stage) {
    let export = stage.export(5);
    let path = stage.put(&export);
    fs::hard_link(path, stage.path(export.name.replace("_x", "_linked"))).expect("linked");
    stage.wait(WHOLE);
    stage.pause();
}

fn link_to_file(stage: &Stage) {
    let export = stage.export(5);
    fs::write(stage.path("latest"), &export.bytes).expect("written");
    symlink("latest", stage.path(&export.name)).expect("linked");
}

fn link_out(stage: &Stage) {
    let export = stage.export(5);
    fs::write(stage.outside(&export.name), &export.bytes).expect("written");
    symlink(stage.outside(&export.name), stage.path(&export.name)).expect("linked");
    stage.pause();
}

fn link_to_nothing(stage: &Stage) {
    let export = stage.export(5);
    symlink("latest", stage.path(&export.name)).expect("linked");
    stage.pause();
    fs::write(stage.path("latest"), &export.bytes).expect("written");
}

fn link_to_folder(stage: &Stage) {
    let export = stage.export(5);
    fs::write(stage.outside(&export.name), &export.bytes).expect("written");
    symlink(stage.outside(""), stage.path("folder")).expect("linked");
    stage.pause();
}

fn loops(stage: &Stage) {
    symlink(".", stage.path("loop")).expect("linked");
    symlink("R_20260105_0847.csv", stage.path("R_20260105_0847.csv")).expect("linked");
    stage.put(&stage.export(5));
}

fn deleted_while_read(stage: &Stage) {
    let export = stage.export(5);
    let path = stage.path(&export.name);
    let most = export.bytes.len() * 9 / 10;
    append_slowly(&path, &export.bytes[..most], 30, SHORT);
    stage.wait_for_a_cycle();
    // after a whole line, since a cut one would be a fault
    append(&path, &export.bytes[most..]);
    fs::remove_file(path).expect("removed");
}

fn deleted_after(stage: &Stage) {
    let path = stage.put(&stage.export(5));
    stage.wait(WHOLE);
    fs::remove_file(path).expect("removed");
    stage.pause();
}

fn empty_then_written(stage: &Stage) {
    let export = stage.export(5);
    fs::write(stage.path(&export.name), "").expect("written");
    stage.wait(&["quarantined|0|an empty file"]);
    append(&stage.path(&export.name), &export.bytes);
}

fn header_then_rows(stage: &Stage) {
    let export = stage.export(5);
    let header = export.lines()[0].len();
    let path = stage.path(&export.name);
    append(&path, &export.bytes[..header]);
    stage.pause();
    append(&path, &export.bytes[header..]);
}

fn header_only(stage: &Stage) {
    let export = stage.export(5);
    // a header that no other row has
    stage.put(&export.with(|text| text.lines().next().unwrap_or_default().to_owned() + ",row29\n"));
}

fn set_to_its_size(stage: &Stage) {
    let export = stage.export(5);
    let mut file = File::create(stage.path(&export.name)).expect("an export");
    file.set_len(export.bytes.len() as u64).expect("room");
    for piece in export.bytes.chunks(export.bytes.len() / 10) {
        pass(SHORT);
        file.write_all(piece).expect("written");
    }
}

fn windows_line_ends(stage: &Stage) {
    stage.put(&stage.export(5).with(|text| {
        let (first, second) = text.split_at(text.len() / 2);
        first.to_owned() + &second.replace('\n', "\r\n")
    }));
}

fn byte_order_mark(stage: &Stage) {
    stage.put(&stage.export(5).with(|text| format!("\u{feff}{text}")));
}

/// The row's export with a changed line of its second cycle.
fn line_of_second_cycle(stage: &Stage, change: impl Fn(&str, &str) -> String) {
    stage.put(&stage.export(5).with(|text| {
        let lines: Vec<&str> = text.split_inclusive('\n').collect();
        let place = lines.len() * 3 / 4;
        let changed = change(lines[0], lines[place]);
        lines[..place].concat() + &changed + &lines[place + 1..].concat()
    }));
}

fn header_again(stage: &Stage) {
    line_of_second_cycle(stage, |header, line| format!("{header}{line}"));
}

fn not_numbers(stage: &Stage) {
    line_of_second_cycle(stage, |_, line| {
        let mut cells: Vec<&str> = line.split(',').collect();
        cells[2] = "NaN";
        cells.join(",")
    });
}

fn time_jumps(stage: &Stage, seconds: f64) {
    stage.put(&stage.export(5).with(|text| {
        let lines: Vec<&str> = text.split_inclusive('\n').collect();
        let place = lines.len() * 3 / 4;
        let later = |line: &&str| {
            let (time, rest) = line.split_once(',').expect("a cell");
            format!("{:.4},{rest}", time.parse::<f64>().expect("a time") + seconds)
        };
        lines[..place].concat() + &lines[place..].iter().map(later).collect::<String>()
    }));
}

fn no_permission(stage: &Stage) {
    let export = stage.export(5);
    fs::write(stage.outside("x"), &export.bytes).expect("written");
    fs::set_permissions(stage.outside("x"), fs::Permissions::from_mode(0o000)).expect("closed");
    fs::rename(stage.outside("x"), stage.path(&export.name)).expect("moved");
    stage.wait(&["quarantined|0|no permission to read"]);
    fs::set_permissions(stage.path(&export.name), fs::Permissions::from_mode(0o600)).expect("opened");
}

fn read_only_folder(stage: &Stage) {
    let path = stage.put(&stage.export(5));
    fs::set_permissions(&path, fs::Permissions::from_mode(0o444)).expect("set");
    fs::set_permissions(stage.path(""), fs::Permissions::from_mode(0o555)).expect("set");
    stage.wait(WHOLE);
    // otherwise the test's folder could not be deleted
    fs::set_permissions(stage.path(""), fs::Permissions::from_mode(0o755)).expect("set");
}

fn closed_folder(stage: &Stage) {
    fs::create_dir(stage.path("closed")).expect("a folder");
    let export = stage.export(5);
    fs::write(stage.path("closed").join(&export.name), &export.bytes).expect("written");
    fs::set_permissions(stage.path("closed"), fs::Permissions::from_mode(0o000)).expect("closed");
    stage.pause();
    fs::set_permissions(stage.path("closed"), fs::Permissions::from_mode(0o755)).expect("opened");
}

fn cut(stage: &Stage, export: &Export) {
    let most = export.bytes.len() * 9 / 10;
    stage.put(&Export { bytes: export.bytes[..most].to_vec(), name: export.name.clone() });
}

fn cut_then_whole(stage: &Stage) {
    let export = stage.export(5).gzip();
    cut(stage, &export);
    stage.wait(&["quarantined|1|ends too early"]);
    stage.put(&export);
}

fn gzip_slowly(stage: &Stage) {
    let export = stage.export(5).gzip();
    append_slowly(&stage.path(&export.name), &export.bytes, 20, SHORT);
}

fn halves(export: &Export) -> [Export; 2] {
    let (first, second) = export.bytes.split_at(export.bytes.len() / 2);
    [first, second].map(|half| Export { name: export.name.clone(), bytes: half.to_vec() })
}

fn two_members(stage: &Stage) {
    let [first, second] = halves(&stage.export(5)).map(|half| half.gzip());
    stage.put(&Export { bytes: [first.bytes, second.bytes].concat(), name: first.name });
}

fn two_frames(stage: &Stage) {
    let [first, second] = halves(&stage.export(5)).map(|half| half.zstd());
    stage.put(&Export { bytes: [first.bytes, second.bytes].concat(), name: first.name });
}

fn bomb(stage: &Stage) {
    let name = stage.export(5).gzip().name;
    // a member of 64 KB expands to 64 MB, and there are a hundred of them
    let member = gzip(&vec![b'0'; 64 << 20]);
    stage.put(&Export { name, bytes: member.repeat(100) });
}

fn made_by(stage: &Stage, program: &str, arguments: &[&str]) {
    let made = Command::new(program).arg(stage.path("R_20260105_0847.csv")).args(arguments).status();
    assert!(made.expect("it runs").success());
    stage.pause();
}

fn socket(stage: &Stage) {
    // addresses of sockets are short: created elsewhere and moved in
    let folder = tempfile::tempdir().expect("a folder");
    drop(std::os::unix::net::UnixListener::bind(folder.path().join("s")).expect("a socket"));
    let moved = fs::rename(folder.path().join("s"), stage.path("R_20260105_0847.csv"));
    moved.expect("one file system for all of a test's folders");
    stage.pause();
}

fn named(stage: &Stage, behind_the_robot: &[u8]) {
    let export = stage.export(5);
    let robot = export.name.split('_').next().expect("a robot").as_bytes();
    let name = OsString::from_vec([robot, behind_the_robot].concat());
    fs::write(stage.path(name), &export.bytes).expect("written");
}

fn long_name(stage: &Stage) {
    let export = stage.export(5);
    let filled = format!("_{}.csv", "x".repeat(255 - (export.name.len() - 2)));
    let name = export.name.replace("_x.csv", &filled);
    let name = name[..251].to_owned() + ".csv";
    stage.put(&export.named(&name));
}

fn mark_before(stage: &Stage) {
    let export = stage.export(5);
    fs::write(stage.path(format!("{}.done", export.name)), "").expect("written");
    stage.pause();
    fs::write(stage.outside("x"), &export.bytes).expect("written");
    fs::rename(stage.outside("x"), stage.path(&export.name)).expect("moved");
}

fn mark_after(stage: &Stage) {
    let export = stage.export(5);
    append_slowly(&stage.path(&export.name), &export.bytes, 10, SHORT);
    fs::write(stage.path(format!("{}.done", export.name)), "").expect("written");
}

fn unfinished_names(stage: &Stage) {
    let export = stage.export(5);
    for name in [format!(".{}", export.name), format!("{}.part", export.name), format!("{}.tmp", export.name)]
    {
        stage.put(&export.named(&name));
    }
    fs::create_dir(stage.path(".hidden")).expect("a folder");
    fs::write(stage.path(".hidden").join(&export.name), &export.bytes).expect("written");
    stage.pause();
}

fn moved(stage: &Stage) {
    let export = stage.export(5);
    let path = stage.put(&export);
    stage.wait(WHOLE);
    fs::create_dir(stage.path("done")).expect("a folder");
    fs::rename(path, stage.path("done").join(&export.name)).expect("moved");
    stage.pause();
}

fn moved_while_growing(stage: &Stage) {
    let export = stage.export(5);
    let path = stage.path(&export.name);
    let most = export.bytes.len() * 9 / 10;
    append_slowly(&path, &export.bytes[..most], 20, SHORT);
    stage.wait_for_a_cycle();
    fs::create_dir(stage.path("done")).expect("a folder");
    let moved = stage.path("done").join(&export.name);
    fs::rename(path, &moved).expect("moved");
    append(&moved, &export.bytes[most..]);
}

fn touched(stage: &Stage) {
    let path = stage.put(&stage.export(5));
    for second in [1_600_000_000, 1_700_000_000] {
        stage.wait(WHOLE);
        File::options()
            .write(true)
            .open(&path)
            .expect("it is there")
            .set_modified(at(second))
            .expect("a time");
        stage.pause();
    }
}

fn uploaded_again(stage: &Stage) {
    let export = stage.export(5);
    for _ in 0..2 {
        stage.put(&export);
        stage.wait(WHOLE);
        stage.pause();
    }
}

fn folder_comes_later(stage: &Stage) {
    stage.pause();
    let folder = stage.row_in(&stage.watched("later"));
    fs::create_dir_all(&folder).expect("a folder");
    let export = stage.export(5);
    fs::write(folder.join(&export.name), &export.bytes).expect("written");
}

fn folder_made_again(stage: &Stage) {
    let folder = stage.row_in(&stage.watched("again"));
    for (day, wanted) in [(5, WHOLE), (6, TWO)] {
        fs::create_dir_all(&folder).expect("a folder");
        let export = stage.export(day);
        fs::write(folder.join(&export.name), &export.bytes).expect("written");
        stage.wait(wanted);
        fs::remove_dir_all(stage.watched("again")).expect("removed");
        stage.pause();
    }
}
