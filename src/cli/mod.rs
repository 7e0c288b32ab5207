//! The command line.

mod args;
mod bench_args;
mod cmd;
mod exit;
mod gap_args;
mod gap_logs;
mod interrupt;
mod lab_args;
mod output;
mod progress;
mod sitl_args;
mod view_args;
mod watch_args;

use clap::error::ErrorKind;
use clap::{CommandFactory, Parser};
use std::ffi::OsString;
use std::io::Write;
use std::panic::{self, AssertUnwindSafe};
use std::process::ExitCode;
use std::sync::{Arc, Mutex, PoisonError};

use cmd::bench::Start;

/// Parses the command line of this process, runs the command and gives the exit code: 0 fine, 1 a check found a problem, 2 error.
pub fn run() -> ExitCode {
    // A system that does not say which file this is finds it as it found it now.
    let this = std::env::current_exe().map_or_else(|_| std::env::args_os().next(), |path| Some(path.into()));
    ExitCode::from(run_with(std::env::args_os().skip(1), this))
}

/// Runs the command that `words` say, those that would follow `propwash`, with the input and output of this process, and gives
/// the exit code. `again` starts the program anew where `words` are put behind it, which `bench` does: a file and what it is told first.
pub fn run_with(words: impl IntoIterator<Item = OsString>, again: impl IntoIterator<Item = OsString>) -> u8 {
    let line: Vec<OsString> = std::iter::once("propwash".into()).chain(words).collect();
    let again: Vec<OsString> = again.into_iter().collect();
    let code = caught(|| parse_and_run(&line, &again)).unwrap_or_else(|said| exit::bug(&said));
    if let Some(why) = crate::compile::complaint() {
        eprintln!("note: steps flew as byte code, more slowly: {why}");
    }
    // In a process whose main program is not ours, nothing else writes out what is still kept.
    let _ = std::io::stdout().flush();
    code
}

/// Runs `work`; where it panics, in this thread or in one that works for it, gives what the panic says and where. Nothing else is
/// printed of it, unless RUST_BACKTRACE asks for that.
fn caught<T>(work: impl FnOnce() -> T) -> Result<T, String> {
    let said = Arc::new(Mutex::new(Vec::<String>::new()));
    let before = panic::take_hook();
    let (hears, tell) = (said.clone(), std::env::var_os("RUST_BACKTRACE").is_some_and(|v| v != "0"));
    let before = Arc::new(before);
    let passes_on = before.clone();
    panic::set_hook(Box::new(move |info| {
        hears.lock().unwrap_or_else(PoisonError::into_inner).push(info.to_string());
        // Sessions of the lab go on after a panic, of which nothing else would be seen.
        if tell || std::thread::current().name().is_some_and(|name| name.starts_with("lab")) {
            passes_on(info);
        }
    }));
    let done = panic::catch_unwind(AssertUnwindSafe(work));
    panic::set_hook(Box::new(move |info| before(info)));
    done.map_err(|panic| {
        let text = panic.downcast_ref::<String>().cloned();
        let text = text.or_else(|| panic.downcast_ref::<&str>().map(ToString::to_string)).unwrap_or_default();
        let said = said.lock().unwrap_or_else(PoisonError::into_inner);
        // Threads that work on their own, as those of the lab do, may have panicked too and been caught elsewhere.
        said.iter().rfind(|heard| heard.contains(&text)).cloned().unwrap_or(text)
    })
}

fn parse_and_run(line: &[OsString], again: &[OsString]) -> u8 {
    let args = match args::Args::try_parse_from(line) {
        Ok(args) => args,
        Err(error) => match error.kind() {
            ErrorKind::DisplayHelp
            | ErrorKind::DisplayVersion
            | ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand => {
                // A reader that has seen enough is no error.
                let _ = error.print();
                return u8::try_from(error.exit_code()).unwrap_or(2);
            }
            _ => return exit::refuse(&error.render().to_string(), &subcommand(&line[1..])),
        },
    };
    let outcome = match args.command {
        args::Command::Fly(a) => cmd::fly::run(&a),
        args::Command::View(a) => cmd::view::run(&a),
        args::Command::Lab(a) => cmd::lab::run(&a),
        args::Command::Sitl(a) => cmd::sitl::run(&a),
        args::Command::Depth(a) => cmd::depth::run(&a),
        args::Command::Drones(a) => cmd::drones::run(&a),
        args::Command::Export(a) => cmd::export::run(&a),
        args::Command::Scene(a) => cmd::scene::run(&a),
        args::Command::Urdf(a) => cmd::urdf::run(&a),
        args::Command::Dataset(a) => cmd::dataset::run(&a),
        args::Command::Log(a) => cmd::log::run(&a),
        args::Command::Remove(a) => cmd::remove::run(&a),
        args::Command::Vehicle(a) => cmd::vehicle::run(&a),
        args::Command::Identify(a) => cmd::identify::run(&a),
        args::Command::Compare(a) => cmd::compare::run(&a),
        args::Command::Diagnose(a) => cmd::diagnose::run(&a),
        args::Command::Add(a) => cmd::add::run(&a),
        args::Command::Watch(a) => cmd::watch::run(&a),
        args::Command::Excite(a) => cmd::excite::run(&a),
        args::Command::Bench(a) => cmd::bench::run(&a, &Start { again, words: &line[1..] }),
        args::Command::Completions(a) => cmd::completions::run(&a),
    };
    exit::code(outcome)
}

/// The program with the sub-commands that were named, as in `propwash scene new`.
fn subcommand(words: &[OsString]) -> String {
    let mut path = "propwash".to_string();
    let mut command = args::Args::command();
    for word in words {
        let Some(inner) = command.find_subcommand(word) else { break };
        path = format!("{path} {}", inner.get_name());
        command = inner.clone();
    }
    path
}

#[cfg(test)]
mod tests {
    use super::caught;

    #[test]
    fn a_panic_becomes_words_in_this_thread_and_in_others() {
        assert_eq!(caught(|| 7), Ok(7));
        let said = caught(|| panic!("there is no spoon")).unwrap_err();
        assert!(said.contains("there is no spoon") && said.contains("mod.rs"), "{said}");
        let said = caught(|| rayon::join(|| panic!("of another thread"), || 1)).unwrap_err();
        assert!(said.contains("of another thread"), "{said}");
    }
}
