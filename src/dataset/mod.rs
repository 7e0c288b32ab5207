//! Data sets: one folder with a manifest, a folder per world, and a picture that shows it at a glance.
//!
//! `docs/formats.md` describes every file, column, unit and code. The bytes depend on nothing but the manifest and
//! what is written: not on the clock, the number of threads, or interruptions.

mod changes;
pub mod depth_png;
mod error;
mod files;
mod flight_log;
mod manifest;
pub mod map;
pub mod mcap;
mod npz;
mod overview;
mod reader;
pub mod recorder;
mod table;
mod user_recorder;
mod world_log;
mod writer;

pub use changes::{MAX_DRONES, MAX_WORLDS, change_camera, table};
pub use depth_png::{MAX_DISTANCE, MISS, TOO_FAR, TOO_NEAR, decode, encode, read as read_depth_png, status};
pub use error::DatasetError;
pub use files::FileRecord;
pub use manifest::{
    BodyRecord, CameraRecord, DepthPng, FORMAT, FORMAT_VERSION, FlightRecord, GeomRecord, Manifest,
    SceneRecord, SensorRecord, VehicleRecord,
};
pub use overview::{HeightMap, OVERVIEW_SIZE, Overview, PathLine, Picture, SheetFrame};
pub use reader::{Dataset, Frames, SensorSamples, WorldReader};
pub use table::{Column, Dtype, Table, clearance_columns, contact_columns, state_columns};
pub use user_recorder::{RecordOptions, Recorder};
pub use writer::{
    ClearanceRow, CompleteRecord, ContactRow, FrameInput, Nearest, NoisyDepth, Quarantine, Reference,
    StateRow, Summary, View, WorldRecord, WorldSeal, WorldWriter, Writer, create_or_resume, world_dir_name,
};
