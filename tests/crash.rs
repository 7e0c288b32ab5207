//! Whatever stops a recording (killed at any moment, a full disk, a second writer), the same command again ends with the same bytes.

#[path = "common/tree.rs"]
mod tree;

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::Duration;

use propwash::random::{Key, purpose};
use tree::files;

/// Kills in all.
const KILLS: u64 = 200;

/// Worlds with images of two kinds, contacts, and a sensor.
const LINE: &str = "fly --scene room --drone cf2x_L250 --worlds 24 --seconds 0.2 --size 16x12 --normals --sensor imu --obstacle-jitter 0.2";

fn command(out: &Path) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_propwash"));
    command.args(LINE.split_whitespace()).arg("--out").arg(out).stdout(Stdio::null()).stderr(Stdio::null());
    command
}

fn run(out: &Path) -> Output {
    command(out).stdout(Stdio::piped()).stderr(Stdio::piped()).output().unwrap()
}

fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// What a run that nobody stops writes.
fn whole(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let out = folder.join("whole");
    let output = run(&out);
    assert!(output.status.success(), "{}", said(&output));
    files(&out)
}

/// The names of the files that differ.
fn differing(a: &BTreeMap<PathBuf, Vec<u8>>, b: &BTreeMap<PathBuf, Vec<u8>>) -> Vec<PathBuf> {
    a.keys().chain(b.keys()).filter(|name| a.get(*name) != b.get(*name)).cloned().collect()
}

#[test]
fn killed_at_any_moment_it_goes_on_to_the_same_bytes() {
    let dir = tempfile::tempdir().unwrap();
    let expected = whole(dir.path());
    let mut draw =
        Key { seed: 1, world: 0, drone: 0, step: 0, purpose: purpose("moments of kills") }.stream();
    let (mut kills, mut sets) = (0, 0);
    while kills < KILLS || sets == 0 {
        let out = dir.path().join(format!("set{sets}"));
        // Until it is whole, or killed often enough: then it may run to its end.
        loop {
            let mut child = command(&out).spawn().unwrap();
            if kills < KILLS {
                std::thread::sleep(Duration::from_micros((draw.unit() * 150_000.0) as u64));
                child.kill().unwrap();
            }
            let status = child.wait().unwrap();
            match status.code() {
                Some(0) => break,
                None => kills += 1,
                Some(code) => panic!("after {kills} kills it ended with {code}: {}", said(&run(&out))),
            }
        }
        let found = files(&out);
        assert_eq!(differing(&found, &expected), Vec::<PathBuf>::new(), "after {kills} kills");
        fs::remove_dir_all(&out).unwrap();
        sets += 1;
    }
}

#[test]
fn a_full_disk_is_told_and_the_run_goes_on_when_there_is_room() {
    let dir = tempfile::tempdir().unwrap();
    let expected = whole(dir.path());
    let out = dir.path().join("set");
    // No file may be larger than 2 kB: that of the states is.
    let limited = format!(
        "trap '' XFSZ; ulimit -f 4; exec {} {LINE} --out {}",
        env!("CARGO_BIN_EXE_propwash"),
        out.display()
    );
    let output = Command::new("sh").arg("-c").arg(limited).output().unwrap();
    assert_eq!(output.status.code(), Some(2), "{}", said(&output));
    assert!(said(&output).contains("the space on the disk"), "{}", said(&output));
    let output = run(&out);
    assert!(output.status.success(), "{}", said(&output));
    assert_eq!(differing(&files(&out), &expected), Vec::<PathBuf>::new());
}

#[test]
fn a_second_writer_is_refused_and_harms_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let expected = whole(dir.path());
    let out = dir.path().join("set");
    let mut refused = 0;
    while refused < 4 {
        // Others come while the first one writes, or just after it: only refusals of a first one that still writes count.
        let mut first = command(&out).spawn().unwrap();
        while !out.join("manifest.json").exists() && first.try_wait().unwrap().is_none() {
            std::thread::sleep(Duration::from_micros(200));
        }
        let second = run(&out);
        match second.status.code() {
            Some(0) => {}
            _ => assert!(said(&second).contains("another process"), "{}", said(&second)),
        }
        // A first one that still holds the folder's lock has held it for as long as the second one ran. That it has not
        // ended would say less: it may be done with the folder, and slow to end.
        let lock = fs::File::open(&out).unwrap();
        let still_writes = matches!(lock.try_lock(), Err(fs::TryLockError::WouldBlock));
        drop(lock);
        if still_writes {
            assert_ne!(second.status.code(), Some(0), "two processes wrote into one folder");
            refused += 1;
        }
        assert!(first.wait().unwrap().success());
        assert_eq!(differing(&files(&out), &expected), Vec::<PathBuf>::new());
        fs::remove_dir_all(&out).unwrap();
    }
}
