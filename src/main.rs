//! The `propwash` program.

fn main() -> std::process::ExitCode {
    propwash::cli::run()
}
