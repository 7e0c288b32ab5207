//! What the tests compared with what, told at the end of `cargo xtask test`.

use std::fs::OpenOptions;
use std::io::Write;

/// Prints a line and adds it to the file that `cargo xtask test` names.
pub fn tell(line: &str) {
    println!("{line}");
    if let Some(path) = std::env::var_os("PROPWASH_COMPARISONS") {
        let mut file =
            OpenOptions::new().create(true).append(true).open(&path).expect("PROPWASH_COMPARISONS");
        file.write_all(format!("{line}\n").as_bytes()).expect("PROPWASH_COMPARISONS");
    }
}
