//! Steps that no kernel was generated for, compiled by the C compiler of the machine and loaded.
//!
//! A [`Schedule`] is printed as C ([`propwash_trace::export::c`]), built by `cc` once, kept in the user's cache folder under the hash of what was
//! printed, and loaded. What it computes has the same bits as the byte code that flies until then, at every SIMD level. Whatever fails (no compiler, a
//! full disk, a folder from which nothing may be loaded) leaves byte code in force, with the reason in words ([`Request::status`]).
//!
//! | variable | what it says |
//! | --- | --- |
//! | `PROPWASH_COMPILE` | `off`, `auto` or `now`: what a simulation does that was not told otherwise |
//! | `PROPWASH_CACHE` | the cache folder, instead of `propwash` in `$XDG_CACHE_HOME` or `~/.cache` (macOS: `~/Library/Caches`) |
//! | `CC` | the compiler, instead of the first of `cc`, `gcc` and `clang` |

mod cache;
mod compiler;
mod loaded;
mod request;

pub use loaded::Code;
pub use request::{Request, Status, request};

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError};

use propwash_trace::schedule::Schedule;
use serde::{Deserialize, Serialize};

/// When steps are compiled.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Compile {
    /// Never: kernels where there are some, else byte code.
    Off,
    /// What the cache holds is taken at once. Anything else begins as byte code, and is compiled in the background as soon as flying by byte code has
    /// taken about as long as compiling does. Results do not depend on when that happens.
    #[default]
    Auto,
    /// Before the first step, which waits for it; where it fails, making the simulation is an error.
    Now,
}

impl Compile {
    /// That of a name: `off`, `auto`, `now`.
    pub fn named(name: &str) -> Option<Self> {
        match name {
            "off" => Some(Self::Off),
            "auto" => Some(Self::Auto),
            "now" => Some(Self::Now),
            _ => None,
        }
    }

    /// What the variable `PROPWASH_COMPILE` asks for, in place of [`Compile::Auto`].
    ///
    /// # Errors
    /// [`CompileError::Variable`] where it is none of the names.
    pub fn or_of_environment(self) -> Result<Self, CompileError> {
        match (self, std::env::var("PROPWASH_COMPILE")) {
            (Self::Auto, Ok(value)) if !value.is_empty() => {
                Self::named(&value).ok_or(CompileError::Variable { value })
            }
            _ => Ok(self),
        }
    }
}

/// Why a step was not compiled.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum CompileError {
    /// The variable `PROPWASH_COMPILE` makes no sense.
    #[error("PROPWASH_COMPILE: expected off, auto or now, got {value:?}")]
    Variable {
        /// What it was.
        value: String,
    },
    /// There is no C compiler.
    #[error("no C compiler: tried {tried}; install one (Debian: apt install gcc) or name it in CC")]
    NoCompiler {
        /// Programs that were looked for.
        tried: String,
    },
    /// The processor has no SIMD level for which code is printed.
    #[error("code is compiled for AVX-512, AVX2, SSE4.2 and NEON, and this processor has {level}")]
    Level {
        /// Its level.
        level: String,
    },
    /// The cache folder cannot be used.
    #[error("the cache folder {folder}: {why}; name another in PROPWASH_CACHE")]
    Cache {
        /// The folder.
        folder: String,
        /// What is wrong with it.
        why: String,
    },
    /// The compiler refused the code or could not run.
    #[error("{compiler} failed: {message}")]
    Compiler {
        /// The compiler.
        compiler: String,
        /// The end of what it said.
        message: String,
    },
    /// What was compiled cannot be loaded.
    #[error(
        "{file} cannot be loaded: {message}; is its folder mounted noexec? name another in PROPWASH_CACHE"
    )]
    Load {
        /// The file.
        file: String,
        /// What the loader said.
        message: String,
    },
}

/// What could not be compiled in the background, until somebody was told.
static COMPLAINT: Mutex<Option<CompileError>> = Mutex::new(None);
static COMPLAINED: AtomicBool = AtomicBool::new(false);

/// Keeps the first failure of the process for [`complaint`].
pub fn complain(why: &CompileError) {
    if !COMPLAINED.swap(true, Ordering::Relaxed) {
        *COMPLAINT.lock().unwrap_or_else(PoisonError::into_inner) = Some(why.clone());
    }
}

/// Why steps fly as byte code that [`Compile::Auto`] would have compiled: once for each process, to whoever asks first.
pub fn complaint() -> Option<CompileError> {
    if !COMPLAINED.load(Ordering::Relaxed) {
        return None;
    }
    COMPLAINT.lock().unwrap_or_else(PoisonError::into_inner).take()
}

impl core::fmt::Display for Status {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Waiting => write!(f, "byte code"),
            Self::Running => write!(f, "byte code, compiling"),
            Self::Ready(None) => write!(f, "compiled, from the cache"),
            Self::Ready(Some(took)) => write!(f, "compiled in {:.2} s", took.as_secs_f64()),
            Self::Failed(why) => write!(f, "byte code: {why}"),
        }
    }
}

/// What the code of a schedule reaches.
#[derive(Clone, Copy, Debug)]
struct Sizes {
    /// Cells of home and scratch.
    home: usize,
    scratch: usize,
    /// Numbers that are given anew before each step.
    fresh: usize,
}

impl Sizes {
    fn of(schedule: &Schedule) -> Self {
        Self { home: schedule.n_home(), scratch: schedule.n_scratch(), fresh: schedule.fresh().len() }
    }
}

#[cfg(test)]
mod tests;
