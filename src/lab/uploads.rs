//! Uploads: streamed into the session's folder, and refused beyond a limit before they fill the disk.

use std::path::{Path, PathBuf};

use axum::body::Body;
use axum::http::{HeaderMap, StatusCode, header};
use std::io::Write as _;
use tokio_stream::StreamExt as _;

use super::MAX_UPLOAD_BYTES;
use super::answer::Refusal;
use crate::Error;

/// Longest name that is kept, bytes; systems take 255.
const MAX_NAME: usize = 180;

/// A name without folders, as a file of ours may have it. What is left of it is shown as it was given.
pub fn plain(name: &str) -> String {
    let last = name.rsplit(['/', '\\']).next().unwrap_or_default();
    let kept: String = last.chars().filter(|c| !c.is_control()).collect();
    let mut kept = kept.trim().trim_start_matches('.').to_string();
    while kept.len() > MAX_NAME {
        // The ending tells what it is.
        let middle = kept.char_indices().nth(1).map_or(kept.len(), |(i, _)| i);
        kept.drain(..middle);
    }
    if kept.is_empty() { "file".into() } else { kept }
}

fn too_large() -> Refusal {
    let limit = MAX_UPLOAD_BYTES >> 20;
    let words = format!(
        "the file is larger than {limit} MB, the most that the lab takes: start `propwash lab FILE` with it, or part it"
    );
    Refusal::new(StatusCode::PAYLOAD_TOO_LARGE, words)
}

/// Writes what comes into a new file of the folder `into`; nothing is left of it where it is too large or breaks off.
///
/// # Errors
/// In words, for a file beyond [`MAX_UPLOAD_BYTES`], a connection that breaks, and a full disk.
pub async fn receive(headers: &HeaderMap, body: Body, into: &Path, name: &str) -> Result<PathBuf, Refusal> {
    let told =
        headers.get(header::CONTENT_LENGTH).and_then(|v| v.to_str().ok()).and_then(|v| v.parse::<u64>().ok());
    if told.is_some_and(|bytes| bytes > MAX_UPLOAD_BYTES) {
        return Err(too_large());
    }
    let path = into.join(name);
    let fault = |source: std::io::Error| Refusal::from(Error::Io { path: name.into(), source });
    let mut partial = tempfile::NamedTempFile::new_in(into).map_err(fault)?;
    let mut stream = body.into_data_stream();
    let mut written = 0;
    while let Some(piece) = stream.next().await {
        let piece = piece
            .map_err(|e| Refusal::bad(format!("the upload of {name} broke off: {e}; drop the file again")))?;
        written += piece.len() as u64;
        if written > MAX_UPLOAD_BYTES {
            return Err(too_large());
        }
        partial.write_all(&piece).map_err(fault)?;
    }
    if told.is_some_and(|bytes| bytes != written) {
        return Err(Refusal::bad(format!(
            "the upload of {name} broke off after {written} bytes; drop the file again"
        )));
    }
    partial.persist(&path).map_err(|e| fault(e.error))?;
    Ok(path)
}

#[cfg(test)]
mod tests {
    use super::plain;

    #[test]
    fn names_keep_no_folders() {
        assert_eq!(plain("../../etc/passwd"), "passwd");
        assert_eq!(plain("C:\\logs\\flight 7.csv"), "flight 7.csv");
        assert_eq!(plain("..."), "file");
        assert_eq!(plain(".hidden\n.csv"), "hidden.csv");
        assert_eq!(plain("<script>alert(1)</script>.csv"), "script>.csv");
        let long = plain(&format!("{}.csv", "ä".repeat(300)));
        assert!(long.len() <= super::MAX_NAME && long.ends_with("ä.csv"));
    }
}
