//! What MuJoCo keeps for the whole process: its parser and compiler, its memory of assets, its log, its plugins.

use std::cell::{Cell, RefCell};
use std::ffi::{CStr, OsString, c_char, c_int};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicPtr, Ordering};
use std::sync::{Mutex, MutexGuard, OnceLock, PoisonError};

use mujoco_rs::mujoco_c as ffi;
use mujoco_rs::prelude::{MjLogMessage, MjtLogLevel};

use super::SceneError;
use super::model::{c_string, check_file};
use super::workers::Guard;

/// One scene is built at a time.
static BUILD: Mutex<()> = Mutex::new(());

/// The right to build a scene.
pub(super) struct Building {
    _lock: MutexGuard<'static, ()>,
}

thread_local! {
    /// Warnings that MuJoCo gave to this thread, while it builds.
    static HEARD: RefCell<Option<Vec<String>>> = const { RefCell::new(None) };
    /// Whether this thread is inside a call of MuJoCo that we make.
    static INSIDE: Cell<bool> = const { Cell::new(false) };
}

/// The handler of the log before ours, null for MuJoCo's own.
static BEFORE: AtomicPtr<()> = AtomicPtr::new(std::ptr::null_mut());

/// Runs `work`, which calls MuJoCo: what the log says meanwhile in this thread is ours, and comes back through return values.
pub(super) fn inside<T>(work: impl FnOnce() -> T) -> T {
    let before = INSIDE.replace(true);
    let done = work();
    INSIDE.set(before);
    done
}

impl Building {
    /// Waits for its turn.
    pub(super) fn begin() -> Self {
        let lock = BUILD.lock().unwrap_or_else(PoisonError::into_inner);
        HEARD.with_borrow_mut(|heard| *heard = Some(Vec::new()));
        // The log is MuJoCo's for the whole process, and the program around may use MuJoCo too: ours goes first, and passes on what
        // other threads say. Without one MuJoCo writes MUJOCO_LOG.TXT into the current folder.
        // SAFETY: the handler is a function for the whole run; MuJoCo exchanges one pointer for another.
        let before = unsafe { ffi::mju_setLogHandler(Some(listen)) };
        if before.is_none_or(|f| f as *mut () != listen as *mut ()) {
            BEFORE.store(before.map_or(std::ptr::null_mut(), |f| f as *mut ()), Ordering::Release);
        }
        // A mesh that MuJoCo remembers from another scene comes out other than one that it reads, and the model, with its hash, would
        // depend on what was built before.
        // SAFETY: the cache is MuJoCo's own, which locks it; models hold copies of what it holds.
        unsafe { ffi::mj_clearCache(ffi::mj_getCache()) };
        Self { _lock: lock }
    }

    /// Warnings since the beginning or the last call.
    pub(super) fn heard(&self) -> Vec<String> {
        HEARD.with_borrow_mut(|heard| heard.as_mut().map(std::mem::take)).unwrap_or_default()
    }
}

impl Drop for Building {
    fn drop(&mut self) {
        HEARD.with_borrow_mut(|heard| *heard = None);
    }
}

/// The handler of the log before.
fn before() -> ffi::mjfLogHandler {
    let before = BEFORE.load(Ordering::Acquire);
    // SAFETY: null, or what `begin` was given as a handler.
    unsafe { std::mem::transmute::<*mut (), ffi::mjfLogHandler>(before) }
}

/// The first fields of a message of MuJoCo's log (`mjLogMessage`), whose subject may be any bytes: names of a scene stand in it as they
/// are, and it may end in the middle of a letter.
#[repr(C)]
struct MessageHead {
    level: c_int,
    topic: c_int,
    subject: [c_char; 1024],
}

impl MessageHead {
    /// The subject up to its end; what is no UTF-8 becomes the replacement character.
    fn subject(&self) -> String {
        let bytes: Vec<u8> = self.subject.iter().take_while(|c| **c != 0).map(|c| *c as u8).collect();
        String::from_utf8_lossy(&bytes).into_owned()
    }
}

unsafe extern "C" fn listen(message: *const MjLogMessage) {
    // SAFETY: MuJoCo hands over a message that lives until the handler returns; it begins with the fields of the head.
    let (level, subject) = unsafe { ((*message).level(), (*message.cast::<MessageHead>()).subject()) };
    let builds = HEARD.with_borrow(Option::is_some);
    if !builds && !INSIDE.get() {
        return pass_on(message, level);
    }
    match level {
        MjtLogLevel::mjLOG_ERROR => {
            eprintln!("MuJoCo cannot go on: {subject}");
            // It would go on in a broken state.
            std::process::exit(1);
        }
        MjtLogLevel::mjLOG_WARNING => {
            HEARD.with_borrow_mut(|heard| heard.as_mut().map(|heard| heard.push(subject)));
        }
        _ => {}
    }
}

/// Gives a message that is not ours to whoever had the log before.
fn pass_on(message: *const MjLogMessage, level: MjtLogLevel) {
    // SAFETY: whoever had the log before takes such messages. MuJoCo's own handler has no name: it answers where there is no other. An
    // error does not come back; the next scene that is built puts our handler in its place again.
    unsafe {
        if let Some(before) = before() {
            return before(message);
        }
        ffi::mju_setLogHandler(None);
        ffi::mju_message(message);
        if level != MjtLogLevel::mjLOG_ERROR {
            ffi::mju_setLogHandler(Some(listen));
        }
    }
}

/// The libraries of MuJoCo's own plugins, by file name, once they are loaded.
static LOADED: OnceLock<Vec<OsString>> = OnceLock::new();

/// Loads MuJoCo's own plugins (signed distance fields, elasticity, sensors, actuators), where a scene asks for one and nobody has loaded
/// them: those beside its library. Whether there are plugins now that were not there before.
pub(super) fn load_plugins() -> bool {
    let mut is_new = false;
    LOADED.get_or_init(|| {
        let _building = Building::begin();
        // MuJoCo does not survive two copies of a library, which register their plugins twice.
        let (Some(folder), false) = (plugin_folder(), has_own_plugins()) else { return Vec::new() };
        let Ok(text) = c_string(&folder.to_string_lossy(), String::new) else { return Vec::new() };
        // SAFETY: a NUL-terminated path that outlives the call; no library of the folder was loaded before.
        unsafe { ffi::mj_loadAllPluginLibraries(text.as_ptr(), None) };
        is_new = true;
        std::fs::read_dir(folder)
            .map_or_else(|_| Vec::new(), |all| all.flatten().map(|e| e.file_name()).collect())
    });
    is_new
}

/// Whether plugins of MuJoCo itself are registered.
fn has_own_plugins() -> bool {
    // SAFETY: slots below the count hold plugins, whose names are terminated and live as long as the process.
    unsafe {
        (0..ffi::mjp_pluginCount()).any(|slot| {
            let plugin = ffi::mjp_getPluginAtSlot(slot);
            !plugin.is_null()
                && !(*plugin).name.is_null()
                && CStr::from_ptr((*plugin).name).to_bytes().starts_with(b"mujoco.")
        })
    }
}

/// The folder of MuJoCo's own plugins: beside its library, or beside the folder of it. In Python it is that of the package `mujoco`, from
/// which the package itself loads them.
fn plugin_folder() -> Option<PathBuf> {
    // SAFETY: dladdr writes into the struct where it answers with a number other than zero; the name is that of a loaded file.
    let library = unsafe {
        let mut info: libc::Dl_info = std::mem::zeroed();
        if libc::dladdr(ffi::mj_version as *const libc::c_void, &raw mut info) == 0
            || info.dli_fname.is_null()
        {
            return None;
        }
        PathBuf::from(CStr::from_ptr(info.dli_fname).to_string_lossy().into_owned())
    };
    let folder = library.canonicalize().ok()?.parent()?.to_path_buf();
    [folder.join("plugin"), folder.parent()?.join("plugin")].into_iter().find(|f| f.is_dir())
}

/// Loads a library of MuJoCo plugins (e.g. signed distance fields), for all scenes built afterwards. Those of MuJoCo itself are loaded
/// where a scene asks for them; naming one of them again does nothing.
///
/// # Errors
/// [`SceneError::Read`] when there is no such file. MuJoCo reports a library that it cannot load only when a scene
/// asks for the plugin.
pub fn load_plugin_library(path: &Path) -> Result<(), SceneError> {
    check_file(path)?;
    if path
        .file_name()
        .is_some_and(|name| LOADED.get().is_some_and(|loaded| loaded.iter().any(|l| l == name)))
    {
        return Ok(());
    }
    let c_path = c_string(&path.to_string_lossy(), || format!("path {}", path.display()))?;
    let guard = Guard::new()?;
    let _building = Building::begin();
    let text = c_path.as_ptr();
    // SAFETY: a NUL-terminated path that outlives the call; plugins register themselves under MuJoCo's own lock.
    unsafe { guard.run(|| ffi::mj_loadPluginLibrary(text)) }.map_err(|message| SceneError::Engine {
        call: "mj_loadPluginLibrary",
        message,
        remedy: "; give a plugin library of this MuJoCo version",
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_that_are_cut_within_a_letter_are_read_up_to_there() {
        let mut head = MessageHead { level: 1, topic: 0, subject: [0; 1024] };
        for (c, byte) in head.subject.iter_mut().zip("geom 'Bäume".bytes().take(8)) {
            *c = byte as c_char;
        }
        assert_eq!(head.subject(), "geom 'B\u{fffd}");
        // Without an end it is read to the end of its memory.
        head.subject = [b'x' as c_char; 1024];
        assert_eq!(head.subject().len(), 1024);
        assert_eq!(std::mem::offset_of!(MessageHead, subject), 8);
    }
}
