//! What simulations ask for: the compiled code of a step, once for the whole process.

use std::collections::HashMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use fearless_simd::Level;
use propwash_trace::export::c::{Target, kernel};
use propwash_trace::kernel::{hash, key};
use propwash_trace::lanes::Number;
use propwash_trace::schedule::Schedule;

use crate::loaded::Code;
use crate::{CompileError, Sizes, cache, compiler};

/// How compiling a step goes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Status {
    /// It was not begun: byte code flies.
    Waiting,
    /// It is being compiled: byte code flies.
    Running,
    /// Compiled and loaded; the time that compiling took, none where it was in the cache.
    Ready(Option<Duration>),
    /// Not compiled, and why: byte code flies.
    Failed(CompileError),
}

/// The compiled code of a step, or the way to it.
#[derive(Debug)]
pub struct Request {
    source: String,
    name: String,
    target: Result<Target, CompileError>,
    number: usize,
    sizes: Sizes,
    begun: AtomicBool,
    /// The code and how long it took, once that is known.
    result: OnceLock<Result<(Code, Option<Duration>), CompileError>>,
}

/// Requests by what is asked for: key of the schedule, bytes of a number, target; and by the process, since a process that was forked while one was
/// being compiled has no thread that would end it.
type Known = HashMap<(u128, usize, Option<Target>, u32), Arc<Request>>;

static KNOWN: Mutex<Option<Known>> = Mutex::new(None);

/// The code of a schedule for N's lanes at a SIMD level. What the cache holds is loaded at once; nothing is compiled yet.
pub fn request<N: Number>(schedule: &Schedule, level: Level) -> Arc<Request> {
    let target = Target::of(level);
    let asked = (key(schedule), size_of::<N>(), target, std::process::id());
    let mut known = KNOWN.lock().unwrap_or_else(PoisonError::into_inner);
    let known = known.get_or_insert_default();
    if let Some(request) = known.get(&asked) {
        return request.clone();
    }
    let source = target.map_or_else(String::new, |target| kernel::<N>(schedule, target));
    let flags = target.map_or_else(Vec::new, |target| compiler::flags(&source, target));
    let parts = [&source, std::env::consts::ARCH].into_iter().chain(flags);
    let name = hash(parts.flat_map(|part| part.bytes().chain([0])));
    let level = format!("{level:?}");
    let level = level.split('(').next().unwrap_or_default().to_string();
    let request = Arc::new(Request {
        source,
        name: format!("{name:032x}"),
        target: target.ok_or(CompileError::Level { level }),
        number: size_of::<N>(),
        sizes: Sizes::of(schedule),
        begun: AtomicBool::new(false),
        result: OnceLock::new(),
    });
    if let Some(code) = request.of_cache() {
        request.result.get_or_init(|| Ok((code, None)));
    }
    known.insert(asked, request.clone());
    request
}

impl Request {
    /// What the cache holds, if it is whole and can be loaded.
    fn of_cache(&self) -> Option<Code> {
        let file = cache::find(&cache::folder().ok()?, &self.name)?;
        Code::load(&file, self.number, self.sizes).ok()
    }

    /// The code, once it is there.
    pub fn code(&self) -> Option<Code> {
        self.result.get().and_then(|r| r.as_ref().ok()).map(|(code, _)| *code)
    }

    /// Whether the code is there, or known not to come.
    pub fn is_done(&self) -> bool {
        self.result.get().is_some()
    }

    /// How it goes.
    pub fn status(&self) -> Status {
        match self.result.get() {
            Some(Ok((_, took))) => Status::Ready(*took),
            Some(Err(e)) => Status::Failed(e.clone()),
            None if self.begun.load(Ordering::Relaxed) => Status::Running,
            None => Status::Waiting,
        }
    }

    /// Compiles in the background, unless that was begun or done. Where no thread can be had, byte code stays.
    pub fn begin(self: &Arc<Self>) {
        if !self.is_done() && !self.begun.swap(true, Ordering::Relaxed) {
            let own = self.clone();
            let spawned =
                thread::Builder::new().name("propwash-compile".into()).spawn(move || own.wait().map(|_| ()));
            if let Err(e) = spawned {
                let message = format!("no thread for it: {e}");
                self.result.get_or_init(|| Err(CompileError::Compiler { compiler: "cc".into(), message }));
            }
        }
    }

    /// Compiles, or waits for whoever does.
    ///
    /// # Errors
    /// [`CompileError`], the same at every call: what failed is not tried again in this process.
    pub fn wait(&self) -> Result<Code, CompileError> {
        self.begun.store(true, Ordering::Relaxed);
        self.result.get_or_init(|| self.built()).as_ref().map(|(code, _)| *code).map_err(Clone::clone)
    }

    fn built(&self) -> Result<(Code, Option<Duration>), CompileError> {
        let target = self.target.clone()?;
        let folder = cache::folder()?;
        // Another process may have made it since it was asked for.
        if let Some(code) = self.of_cache() {
            return Ok((code, None));
        }
        let begun = Instant::now();
        let file = cache::put(&folder, &self.name, |to| compiler::build(&self.source, target, to))?;
        let code = Code::load(&file, self.number, self.sizes)?;
        Ok((code, Some(begun.elapsed())))
    }
}
