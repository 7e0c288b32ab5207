//! Flags of `propwash view`.

use super::args::whole;
use clap::Args as ClapArgs;
use std::path::PathBuf;

/// Ends the help of `propwash view`.
pub const VIEW_EXAMPLES: &str = "\
Examples:
  propwash view data/forest --open              worlds of a data set, with what the cameras saw
  propwash view data/forest --world 3 --out third.html
  propwash view my_scene.xml --open             a scene, and what sensors miss of it
  propwash view my_scene.xml --watch --open     the same, drawn again whenever the file is saved
  propwash view flight.csv --vehicle quad.toml --scene hall.xml

The page is one file of at most 1.5 MB for a flight of 60 s; it needs no other file and no network.
What does not fit is thinned, and the page says so. Keys on it: space plays, left and right move by
0.1 s, with shift by 1 s. Units are SI (m, s).";

/// `propwash view`.
#[derive(Clone, Debug, ClapArgs)]
pub struct ViewArgs {
    /// Folder of a data set, scene (a file or one of corridor, forest, meshes, room, terrain, zoo), or flight log (.csv, .parquet, .ulg, .mcap, or the folder of a ROS 2 bag).
    #[arg(value_name = "WHAT")]
    pub what: PathBuf,
    /// World of a data set; repeat it for several. Default: the first ones that fit.
    #[arg(long, value_name = "N", value_parser = whole::<usize>)]
    pub world: Vec<usize>,
    /// Scene that a flight log was flown in: a file or a name.
    #[arg(long, value_name = "FILE")]
    pub scene: Option<PathBuf>,
    /// Vehicle of a flight log, a built-in name or a vehicle file: its model flies beside the measured one and starts again from it every
    /// 0.1 to 1 s.
    #[arg(long, visible_alias = "drone", value_name = "NAME|FILE")]
    pub vehicle: Option<String>,
    /// The page. Default: view.html.
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Open the page in the browser.
    #[arg(long)]
    pub open: bool,
    /// Serve the page of a scene on this machine in place of writing it, and load it again whenever a file in the scene's folder is saved;
    /// what MuJoCo finds wrong stands on it. A depth camera can be flown there by keys, and a drone's path tried for collisions.
    #[arg(long, conflicts_with_all = ["out", "json", "force", "world", "scene", "vehicle"])]
    pub watch: bool,
    /// Port of --watch on 127.0.0.1. Default: any that is free.
    #[arg(long, value_name = "N", requires = "watch", value_parser = whole::<u16>)]
    pub port: Option<u16>,
    /// Replace a file that is there already.
    #[arg(long)]
    pub force: bool,
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
}
