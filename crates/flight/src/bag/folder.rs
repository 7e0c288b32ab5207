//! Folders of ROS 2 bags: `metadata.yaml` and the files that it names.

use crate::files;
use crate::{FlightError, Result};
use std::path::{Path, PathBuf};

/// First bytes of an SQLite file, which older recorders of ROS 2 wrote.
const SQLITE: &[u8] = b"SQLite format 3\0";
/// First bytes of a bag of ROS 1.
const ROS1: &[u8] = b"#ROSBAG V";

/// Files of a bag in the order of their times.
#[derive(Debug, Default, PartialEq)]
pub(in super::super) struct Files {
    pub paths: Vec<PathBuf>,
    /// What is odd about the folder.
    pub notes: Vec<String>,
}

/// How a bag of another storage becomes one that is read.
const CONVERT: &str = "convert it where ROS 2 is installed: write `output_bags: [{uri: NEW, storage_id: mcap, all: true}]` into convert.yaml, \
                       run `ros2 bag convert -i OLD -o convert.yaml`, and give the folder NEW";

/// Refuses files of bags that are not MCAP, by their first bytes or their ending.
///
/// # Errors
/// [`FlightError::Format`] with what to do.
pub(in super::super) fn refuse_others(path: &Path, bytes: &[u8]) -> Result<()> {
    let ending = path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default();
    let wrong = |found: &str, remedy: &str| {
        Err(FlightError::Format {
            path: path.to_path_buf(),
            expected: "a bag in MCAP".into(),
            found: found.into(),
            remedy: remedy.into(),
        })
    };
    if bytes.starts_with(SQLITE) || ending == "db3" {
        return wrong("a bag in SQLite (.db3)", CONVERT);
    }
    if bytes.starts_with(ROS1) || ending == "bag" {
        return wrong(
            "a bag of ROS 1 (.bag)",
            "convert it by `mcap convert OLD.bag NEW.mcap` (the program `mcap` of Foxglove)",
        );
    }
    Ok(())
}

/// Whether a folder is that of a ROS 2 bag, whatever its storage: it has the bag's `metadata.yaml` or a file of messages.
///
/// Source: <https://github.com/ros2/rosbag2> (README, storage format plugins).
pub fn is_bag(folder: &Path) -> bool {
    let names = std::fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.file_name());
    names.map(|n| n.to_string_lossy().to_lowercase()).any(|name| {
        name == "metadata.yaml"
            || [".mcap", ".db3", ".mcap.zstd", ".db3.zstd"].iter().any(|e| name.ends_with(e))
    })
}

/// The MCAP files of a bag's folder.
///
/// # Errors
/// [`FlightError`] where the folder holds none, and for what is compressed as a whole or stands in SQLite.
pub(in super::super) fn files(folder: &Path) -> Result<Files> {
    let unread = |e: std::io::Error| FlightError::Read { path: folder.to_path_buf(), reason: e.to_string() };
    let mut names: Vec<String> = std::fs::read_dir(folder)
        .map_err(unread)?
        .flatten()
        .map(|entry| entry.file_name().to_string_lossy().into_owned())
        .collect();
    names.sort();
    let ends = |ending: &str| names.iter().any(|n| n.to_lowercase().ends_with(ending));
    let wrong = |expected: &str, found: &str, remedy: &str| FlightError::Format {
        path: folder.to_path_buf(),
        expected: expected.into(),
        found: found.into(),
        remedy: remedy.into(),
    };
    let bags: Vec<&String> = names.iter().filter(|n| n.to_lowercase().ends_with(".mcap")).collect();
    if bags.is_empty() {
        return Err(if ends(".mcap.zstd") || ends(".db3.zstd") {
            let remedy = "unpack them first (`unzstd FILE`), then give the folder again";
            wrong("MCAP files", "files that are compressed as a whole (.zstd)", remedy)
        } else if ends(".db3") {
            wrong("a bag in MCAP", "a bag in SQLite (.db3)", CONVERT)
        } else if names.iter().any(|n| n == "manifest.json") {
            let remedy = "take a flight out of it by `propwash log from-dataset`";
            wrong("a flight log", "the folder of a data set", remedy)
        } else {
            let remedy = "give the path of a log, or of the folder that `ros2 bag record` made";
            wrong(
                "a flight log, or the folder of a ROS 2 bag with .mcap files",
                "a folder without any",
                remedy,
            )
        });
    }
    let mut out = Files::default();
    let listed = match files::read_text(&folder.join("metadata.yaml")) {
        Ok(text) => listed(&text),
        Err(_) => {
            out.notes.push(
                "metadata.yaml cannot be read: the files were taken in the order of their names".into(),
            );
            Vec::new()
        }
    };
    let missing: Vec<&str> = listed.iter().filter(|l| !names.contains(l)).map(String::as_str).collect();
    if !missing.is_empty() {
        out.notes.push(format!("metadata.yaml names files that are not there: {}", missing.join(", ")));
    }
    let mut chosen: Vec<&String> = listed.iter().filter(|l| bags.contains(l)).collect();
    if chosen.is_empty() {
        chosen = bags;
    } else if chosen.len() < bags.len() {
        let more: Vec<&str> = bags.iter().filter(|b| !chosen.contains(b)).map(|b| b.as_str()).collect();
        out.notes.push(format!("files that metadata.yaml does not name were left out: {}", more.join(", ")));
    }
    out.paths = chosen.into_iter().map(|name| folder.join(name)).collect();
    Ok(out)
}

/// Names under `relative_file_paths`. The rest of the file says nothing that the bags do not say themselves, so that no reader of YAML is needed.
fn listed(text: &str) -> Vec<String> {
    let after = text.lines().skip_while(|line| line.trim() != "relative_file_paths:").skip(1);
    let items = after.map_while(|line| line.trim().strip_prefix("- "));
    // Some versions write the path from the folder above.
    let bare = |item: &str| {
        let item = item.trim().trim_matches(['"', '\'']);
        item.rsplit('/').next().unwrap_or(item).to_string()
    };
    items.map(bare).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_come_in_the_order_of_the_metadata_and_what_is_odd_is_said() {
        let made = tempfile::tempdir().unwrap();
        let write = |name: &str, text: &str| std::fs::write(made.path().join(name), text).unwrap();
        for name in ["b_10.mcap", "b_2.mcap", "b_9.mcap"] {
            write(name, "");
        }
        let names = |files: &Files| -> Vec<String> {
            files.paths.iter().map(|p| p.file_name().unwrap().to_string_lossy().into_owned()).collect()
        };
        let found = files(made.path()).unwrap();
        assert_eq!(names(&found), ["b_10.mcap", "b_2.mcap", "b_9.mcap"]);
        assert!(found.notes[0].contains("order of their names"));
        let list = "rosbag2_bagfile_information:\n  version: 5\n  relative_file_paths:\n    - b_2.mcap\n    - \"b_10.mcap\"\n    - b_77.mcap\n  files:\n    - path: x\n";
        write("metadata.yaml", list);
        let found = files(made.path()).unwrap();
        assert_eq!(names(&found), ["b_2.mcap", "b_10.mcap"]);
        assert!(
            found.notes[0].contains("b_77.mcap") && found.notes[1].contains("b_9.mcap"),
            "{:?}",
            found.notes
        );
    }

    #[test]
    fn other_folders_say_what_to_do() {
        for (name, words) in [
            ("b_0.db3", "ros2 bag convert -i OLD"),
            ("b_0.mcap.zstd", "unzstd"),
            ("manifest.json", "log from-dataset"),
            ("readme.txt", "a folder without any"),
        ] {
            let made = tempfile::tempdir().unwrap();
            std::fs::write(made.path().join(name), "").unwrap();
            let said = files(made.path()).unwrap_err().to_string();
            assert!(said.contains(words), "{said}");
        }
    }
}
