//! The lab: a server of this machine and its page, on which a person goes from a flight log to a better vehicle file without a terminal.
//!
//! It binds 127.0.0.1 alone and answers whoever knows the secret of its address ([`Lab::address`]); `guard` has the rules. What a person works
//! on is a session ([`desk`]): logs, a vehicle, a scene, and the engine of `gap` over them, all owned by one thread ([`worker`]). Requests are
//! JSON by POST, uploads are streamed into the session's folder, progress comes as server-sent events.
//!
//! ```no_run
//! use propwash::lab::{Lab, Options};
//!
//! let lab = Lab::bind(Options { logs: vec!["flight.csv".into()], ..Options::default() })?;
//! println!("{}", lab.address());
//! lab.run()?; // until Ctrl-C
//! # Ok::<(), propwash::Error>(())
//! ```

use std::net::{Ipv4Addr, TcpListener};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use crate::{Error, Result};

mod answer;
mod desk;
mod engine;
mod examples;
mod guard;
mod mapping;
mod page;
mod room;
mod routes;
mod sanity;
mod saving;
mod uploads;
mod worker;

/// Most sessions at a time.
pub const MAX_SESSIONS: usize = 4;
/// Largest file that can be uploaded, bytes: 512 MB.
pub const MAX_UPLOAD_BYTES: u64 = 512 << 20;
/// How long requests and workers may take to end after Ctrl-C.
const FAREWELL: Duration = Duration::from_secs(5);

/// What the lab begins with.
#[derive(Clone, Debug, Default)]
pub struct Options {
    /// Logs that a first session opens.
    pub logs: Vec<PathBuf>,
    /// Its vehicle: a built-in name or a vehicle file.
    pub vehicle: Option<String>,
    /// Its scene: a name or a file.
    pub scene: Option<PathBuf>,
    /// Port on 127.0.0.1; 0 for any that is free.
    pub port: u16,
}

/// A lab that is bound to its port.
pub struct Lab {
    listener: TcpListener,
    room: Arc<room::Room>,
}

impl Lab {
    /// Looks at what it is given and takes the port.
    ///
    /// # Errors
    /// [`Error::Usage`] where the port is taken or a file is not there, and those of vehicle and scene.
    pub fn bind(options: Options) -> Result<Self> {
        let refused = |e: std::io::Error| Error::Usage {
            flag: "--port",
            expected: "a port of this machine that is free, or 0 for any".into(),
            got: format!("{}: {e}", options.port),
        };
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, options.port)).map_err(refused)?;
        listener.set_nonblocking(true).map_err(refused)?;
        let port = listener.local_addr().map_err(refused)?.port();
        let door = guard::Door::new(port)?;
        Ok(Self { listener, room: Arc::new(room::Room::new(door, options)?) })
    }

    /// The address to open, with its secret: `http://127.0.0.1:PORT/?token=…`.
    pub fn address(&self) -> String {
        self.room.door.address()
    }

    /// Serves until Ctrl-C (or SIGTERM). What is being written then is finished, searches are cancelled, and temporary folders go.
    ///
    /// # Errors
    /// [`Error::Io`] where the system takes no more connections.
    pub fn run(self) -> Result<()> {
        let fault = |source: std::io::Error| Error::Io { path: self.address().into(), source };
        let runtime = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(2)
            .enable_io()
            .enable_time()
            .thread_name("lab")
            .build()
            .map_err(fault)?;
        let routes = routes::all(self.room.clone());
        let listener = self.listener.try_clone().map_err(fault)?;
        let served = runtime.block_on(async {
            let listener = tokio::net::TcpListener::from_std(listener)?;
            tokio::select! {
                served = axum::serve(listener, routes).into_future() => served,
                () = asked_to_end() => Ok(()),
            }
        });
        self.room.close(FAREWELL);
        runtime.shutdown_timeout(FAREWELL);
        served.map_err(fault)
    }
}

/// Waits for Ctrl-C or the system's wish to end the program.
async fn asked_to_end() {
    use tokio::signal::unix::{SignalKind, signal};
    let wait = |kind| async move {
        match signal(kind) {
            Ok(mut heard) => drop(heard.recv().await),
            // Without a handler the signal ends the process by itself.
            Err(_) => std::future::pending().await,
        }
    };
    tokio::select! {
        () = wait(SignalKind::interrupt()) => {}
        () = wait(SignalKind::terminate()) => {}
    }
}
