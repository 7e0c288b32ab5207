//! The thread of a session. It owns the desk and works off requests one after the other; of requests for the same thing only the newest
//! waits.

use std::collections::VecDeque;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;

use serde_json::Value;
use tokio::sync::{broadcast, oneshot};

use super::answer::{Answer, Refusal};
use super::desk::Desk;

/// Messages that a slow page may lag behind.
const NEWS: usize = 256;

/// What work is told, and what it tells.
#[derive(Clone)]
pub struct Run {
    /// Set where the person does not want the result any more.
    pub cancel: Arc<AtomicBool>,
    news: broadcast::Sender<String>,
}

impl Run {
    /// Tells every page of the session.
    pub fn tell(&self, news: &Value) {
        // No page listens: nobody misses it.
        let _ = self.news.send(news.to_string());
    }
}

type Work = Box<dyn FnOnce(&mut Desk, &Run) -> Answer + Send>;

struct Job {
    /// What it is about: a newer job about the same replaces it while it waits.
    about: String,
    work: Work,
    reply: oneshot::Sender<Answer>,
}

#[derive(Default)]
struct Line {
    waiting: VecDeque<Job>,
    closed: bool,
    /// Of the job that is worked on.
    cancel: Option<Arc<AtomicBool>>,
}

#[derive(Default)]
struct Shared {
    line: Mutex<Line>,
    more: Condvar,
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, Line> {
        self.line.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A session's thread.
pub struct Worker {
    folder: PathBuf,
    uploads: AtomicUsize,
    shared: Arc<Shared>,
    news: broadcast::Sender<String>,
    thread: Mutex<Option<JoinHandle<()>>>,
}

impl Worker {
    /// Starts a thread that owns a desk.
    ///
    /// # Errors
    /// Where the system starts no more threads.
    pub fn start(mut desk: Desk) -> std::io::Result<Self> {
        let folder = desk.folder().to_path_buf();
        let (shared, news) = (Arc::new(Shared::default()), broadcast::Sender::new(NEWS));
        let (line, sender) = (shared.clone(), news.clone());
        let work = move || {
            while let Some((job, cancel)) = next(&line) {
                let run = Run { cancel, news: sender.clone() };
                let work = job.work;
                let done = catch_unwind(AssertUnwindSafe(|| work(&mut desk, &run)));
                let answer = done.unwrap_or_else(|_| {
                    // What it had half done is not trusted.
                    desk.forget_engine();
                    let words = "this is a bug of Propwash: the work failed where it should have been refused in words; the program's \
                                 terminal says where. Please report it. The session has been set back to its logs";
                    Err(Refusal::new(axum::http::StatusCode::INTERNAL_SERVER_ERROR, words))
                });
                line.lock().cancel = None;
                // A page that is gone waits for nothing.
                let _ = job.reply.send(answer);
            }
        };
        let thread = std::thread::Builder::new().name("lab session".into()).spawn(work)?;
        Ok(Self { folder, uploads: AtomicUsize::new(0), shared, news, thread: Mutex::new(Some(thread)) })
    }

    /// A new folder of the session for one file that is uploaded: names of files may repeat.
    ///
    /// # Errors
    /// Where the session's folder is gone or takes no more.
    pub fn folder_for_upload(&self) -> Result<PathBuf, Refusal> {
        let folder = self.folder.join(format!("upload_{}", self.uploads.fetch_add(1, Ordering::Relaxed)));
        std::fs::create_dir(&folder).map_err(|source| crate::Error::Io { path: folder.clone(), source })?;
        Ok(folder)
    }

    /// Whether it works on something now.
    pub fn is_busy(&self) -> bool {
        self.shared.lock().cancel.is_some()
    }

    /// Has something done; the answer comes through the receiver. A waiting request about the same is told that it was replaced.
    pub fn ask(
        &self,
        about: impl Into<String>,
        work: impl FnOnce(&mut Desk, &Run) -> Answer + Send + 'static,
    ) -> oneshot::Receiver<Answer> {
        let (reply, answer) = oneshot::channel();
        let job = Job { about: about.into(), work: Box::new(work), reply };
        let mut line = self.shared.lock();
        if line.closed {
            drop(line);
            let _ = job.reply.send(Err(Refusal::missing("this session is closed: begin a new one")));
            return answer;
        }
        if let Some(old) = line.waiting.iter().position(|waiting| waiting.about == job.about)
            && let Some(old) = line.waiting.remove(old)
        {
            let _ = old.reply.send(Err(Refusal::replaced()));
        }
        line.waiting.push_back(job);
        self.shared.more.notify_one();
        answer
    }

    /// Asks what is worked on to stop; whether there was anything.
    pub fn cancel(&self) -> bool {
        let line = self.shared.lock();
        let Some(cancel) = &line.cancel else { return false };
        cancel.store(true, Ordering::Relaxed);
        true
    }

    /// What the session tells from now on.
    pub fn listen(&self) -> broadcast::Receiver<String> {
        self.news.subscribe()
    }

    /// Cancels what is worked on, refuses what waits, and takes nothing more.
    pub fn close(&self) {
        let mut line = self.shared.lock();
        line.closed = true;
        line.waiting.clear();
        if let Some(cancel) = &line.cancel {
            cancel.store(true, Ordering::Relaxed);
        }
        self.shared.more.notify_all();
    }

    /// Whether its thread has ended, and its folder is gone.
    pub fn has_ended(&self) -> bool {
        self.thread
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .as_ref()
            .is_none_or(JoinHandle::is_finished)
    }
}

impl Drop for Worker {
    fn drop(&mut self) {
        self.close();
    }
}

/// The next job and its cancel flag; none when the session is closed.
fn next(shared: &Shared) -> Option<(Job, Arc<AtomicBool>)> {
    let line = shared.lock();
    let mut line = shared
        .more
        .wait_while(line, |line| line.waiting.is_empty() && !line.closed)
        .unwrap_or_else(PoisonError::into_inner);
    let job = line.waiting.pop_front()?;
    let cancel = Arc::new(AtomicBool::new(false));
    line.cancel = Some(cancel.clone());
    Some((job, cancel))
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;
    use std::sync::mpsc;

    fn worker() -> Worker {
        Worker::start(Desk::new().unwrap()).unwrap()
    }

    #[test]
    fn of_requests_about_the_same_only_the_newest_waits() {
        let worker = worker();
        let (begun, begins) = mpsc::channel();
        let (go, goes) = mpsc::channel::<()>();
        let first = worker.ask("slider", move |_, _| {
            begun.send(()).unwrap();
            goes.recv().unwrap();
            Ok(json!(0))
        });
        begins.recv().unwrap();
        let second = worker.ask("slider", |_, _| Ok(json!(1)));
        let other = worker.ask("switch", |_, _| Ok(json!("other")));
        let third = worker.ask("slider", |_, _| Ok(json!(2)));
        go.send(()).unwrap();
        assert_eq!(first.blocking_recv().unwrap().unwrap(), json!(0), "what has begun is finished");
        assert!(second.blocking_recv().unwrap().unwrap_err().words().contains("newer"));
        assert_eq!(other.blocking_recv().unwrap().unwrap(), json!("other"));
        assert_eq!(third.blocking_recv().unwrap().unwrap(), json!(2));
    }

    #[test]
    fn work_is_cancelled_and_a_panic_becomes_words() {
        let worker = worker();
        assert!(!worker.cancel(), "nothing is worked on");
        let (begun, begins) = mpsc::channel();
        let long = worker.ask("find", move |_, run| {
            begun.send(()).unwrap();
            while !run.cancel.load(Ordering::Relaxed) {
                std::thread::yield_now();
            }
            Err(Refusal::cancelled())
        });
        begins.recv().unwrap();
        assert!(worker.cancel());
        assert!(long.blocking_recv().unwrap().unwrap_err().words().starts_with("cancelled"));
        let broken = worker.ask("find", |_, _| panic!("on purpose"));
        assert!(broken.blocking_recv().unwrap().unwrap_err().words().contains("a bug of Propwash"));
        let after = worker.ask("find", |_, _| Ok(json!(7)));
        assert_eq!(after.blocking_recv().unwrap().unwrap(), json!(7));
        worker.close();
        let late = worker.ask("find", |_, _| Ok(json!(8)));
        assert!(late.blocking_recv().unwrap().unwrap_err().words().contains("closed"));
    }
}
