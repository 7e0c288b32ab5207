//! What can go wrong at the MuJoCo boundary.

use std::path::PathBuf;

/// Errors of building a scene and of working in it. MuJoCo's own words are kept.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SceneError {
    /// The scene file does not exist or is not a file.
    #[error("scene file {} cannot be read: {source}; give the path of an MJCF or URDF file", path.display())]
    Read {
        /// The path that was asked for.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The scene is a name, and no scene that comes with Propwash has it.
    #[error(
        "scene '{name}' is no file and none of the scenes that come with Propwash;{guess} there are: {known}; or give the path of an \
         MJCF or URDF file"
    )]
    NoSuchScene {
        /// The name that was asked for.
        name: String,
        /// A question for the nearest name with a space before it, or empty.
        guess: String,
        /// The names that exist.
        known: String,
    },
    /// MuJoCo could not parse the XML of the scene or of a shell.
    #[error("{what}: MuJoCo cannot parse it: {message}")]
    Parse {
        /// Which scene or shell.
        what: String,
        /// MuJoCo's words.
        message: String,
    },
    /// MuJoCo parsed the scene but could not compile it.
    #[error("{what}: MuJoCo cannot compile it: {message}")]
    Compile {
        /// Which scene.
        what: String,
        /// MuJoCo's words.
        message: String,
    },
    /// A shell does not have the form that a drone needs.
    #[error("shell '{shell}': {message}")]
    Shell {
        /// Name of the shell.
        shell: String,
        /// What was expected, found, and what to do.
        message: String,
    },
    /// A name in the scene begins with a prefix that is reserved for drones.
    #[error(
        "{scene}: the {kind} '{name}' has a name that begins with 'drone{drone}/', which is reserved for drone \
         {drone}; rename it in the scene"
    )]
    NameClash {
        /// Which scene.
        scene: String,
        /// Kind of element, e.g. `body`.
        kind: &'static str,
        /// The name that clashes.
        name: String,
        /// The drone whose prefix it uses.
        drone: usize,
    },
    /// A pose held NaN, an infinity, a huge number or a zero quaternion.
    #[error(
        "pose of {who}: {what}; give finite positions within 1e9 m and a quaternion (x, y, z, w) that is not zero"
    )]
    BadPose {
        /// Which drone, obstacle or camera.
        who: String,
        /// The offending numbers.
        what: String,
    },
    /// An index was out of range.
    #[error("{what} {index} does not exist: this scene has {count} (numbered from 0)")]
    NoSuch {
        /// Kind of thing: drone, obstacle, geom, camera.
        what: &'static str,
        /// The index that was asked for.
        index: usize,
        /// How many there are.
        count: usize,
    },
    /// A name was not found.
    #[error("{what} '{name}' does not exist in {scene}; there are: {known}")]
    NoSuchName {
        /// Kind of thing.
        what: &'static str,
        /// The name that was asked for.
        name: String,
        /// Which scene.
        scene: String,
        /// The names that exist.
        known: String,
    },
    /// Something was asked of the worker before the poses were brought up to date.
    #[error("{asked} was asked before `update`: call `update` after setting poses")]
    Stale {
        /// What was asked.
        asked: &'static str,
    },
    /// MuJoCo raised an error while it worked. The worker was reset and can be used again.
    #[error("MuJoCo failed in {call}: {message}{remedy}")]
    Engine {
        /// The operation.
        call: &'static str,
        /// MuJoCo's words.
        message: String,
        /// What to do, or empty.
        remedy: &'static str,
    },
    /// An earlier failure left the worker unusable.
    #[error(
        "this worker failed before and could not be reset ({message}); make a new one with `Scene::worker`"
    )]
    Poisoned {
        /// MuJoCo's words of the failure.
        message: String,
    },
    /// MuJoCo dropped contacts because its memory was full.
    #[error(
        "contacts were lost: MuJoCo's arena of {arena_bytes} bytes was full after {count} contacts; raise it with \
         <size memory=\"...\"/> in the scene"
    )]
    ContactsLost {
        /// Contacts that were kept.
        count: usize,
        /// Size of the arena, bytes.
        arena_bytes: i64,
    },
    /// An argument made no sense.
    #[error("{what}")]
    Argument {
        /// What was expected, what was found, what to do.
        what: String,
    },
}
