//! Exit codes and how errors are printed.

use crate::Error;
use crate::flight::files::suggestion;
use crate::names::of_list;
use crate::scene::SceneError;
use crate::vehicle::VehicleError;
use anstyle::AnsiColor;
use std::path::Path;

/// What a command came to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// It did what it should.
    Fine,
    /// It is a check and found a problem.
    Found,
}

/// Prints an error with its causes and gives the exit code.
pub fn code(outcome: Result<Outcome, Error>) -> u8 {
    match outcome {
        Ok(Outcome::Fine) => 0,
        Ok(Outcome::Found) => 1,
        // A reader that has seen enough (`propwash … | head`) is no error.
        Err(Error::Io { source, .. }) if source.kind() == std::io::ErrorKind::BrokenPipe => 0,
        Err(error) => {
            // Vehicles and scenes look at no folders themselves.
            let meant = match &error {
                Error::Vehicle(VehicleError::Read { path, .. })
                | Error::Scene(SceneError::Read { path, .. }) => suggestion(path),
                // A path with a mistyped ending looks like a name.
                Error::Vehicle(VehicleError::UnknownVehicle { name, known })
                    if of_list(name, known).is_empty() =>
                {
                    suggestion(Path::new(name))
                }
                _ => String::new(),
            };
            complain(&(one_line(&error.to_string()) + &meant));
            2
        }
    }
}

/// Prints what is wrong with a command line, in one line, and gives the exit code. `message` is clap's, `command` the
/// sub-command whose help explains it.
pub fn refuse(message: &str, command: &str) -> u8 {
    let is_rest = |line: &str| line.starts_with("Usage:") || line.starts_with("For more information");
    let fault: Vec<&str> = message.lines().take_while(|line| !is_rest(line)).collect();
    let fault = one_line(&fault.join("\n"));
    complain(&format!("{}; `{command} --help` explains", fault.strip_prefix("error: ").unwrap_or(&fault)));
    2
}

/// Prints what a panic said as the error that it is, and gives the exit code.
pub fn bug(said: &str) -> u8 {
    complain(&format!(
        "this is a bug of Propwash: {}; please report it with the command line and its files",
        one_line(said)
    ));
    2
}

/// Prints an error.
fn complain(text: &str) {
    let style = AnsiColor::Red.on_default().bold();
    anstream::eprintln!("{style}error:{style:#} {text}");
}

/// Prints what the user should know, and what does not end the command.
pub fn warn(text: &str) {
    let style = AnsiColor::Yellow.on_default().bold();
    anstream::eprintln!("{style}warning:{style:#} {text}");
}

/// The lines of a message as one line.
fn one_line(text: &str) -> String {
    let mut out = String::new();
    for line in text.lines().map(str::trim).filter(|line| !line.is_empty()) {
        if !out.is_empty() {
            let goes_on = out.ends_with([':', ';', ',']) || line.starts_with(['[', '-', '(']);
            out.push_str(if goes_on { " " } else { "; " });
        }
        out.push_str(line);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::one_line;

    #[test]
    fn lines_become_one_that_reads_on() {
        assert_eq!(one_line("a differs:\n  x: 1\n  y: 2\n\nuse other"), "a differs: x: 1; y: 2; use other");
        assert_eq!(one_line("wrong value\n  [possible: a, b]\n"), "wrong value [possible: a, b]");
    }
}
