//! How do I read a data set that `propwash fly` wrote?
//!
//! `cargo run --example read_dataset -- FOLDER`; without a folder it makes a small data set first.

use std::path::{Path, PathBuf};

use propwash::arena::{CameraConfig, FlightPattern, SceneConfig, SimConfig};
use propwash::dataset::recorder::{FlightConfig, record};
use propwash::dataset::{Dataset, decode};
use propwash::rollout::SimOptions;

fn main() -> propwash::Result<()> {
    let folder = match std::env::args_os().nth(1) {
        Some(folder) => PathBuf::from(folder),
        None => {
            let folder = std::env::temp_dir().join(format!("propwash_read_dataset_{}", std::process::id()));
            make(&folder)?;
            folder
        }
    };

    let data = Dataset::open(&folder)?;
    // Compares every file with its hash; leave it out where that takes too long.
    data.verify()?;
    let manifest = data.manifest();
    println!("{} worlds of {} drones for {} s", manifest.n_worlds, manifest.n_drones, manifest.seconds);

    for number in data.worlds() {
        let world = data.world(number)?;

        // Tables by column, one row per drone and logged step.
        let states = world.states(Some(&["t", "drone", "vx", "vy", "vz"]))?;
        let [vx, vy, vz] = [states.column("vx")?, states.column("vy")?, states.column("vz")?];
        let speed = |i: usize| (vx[i] * vx[i] + vy[i] * vy[i] + vz[i] * vz[i]).sqrt();
        let fastest = (0..states.n_rows()).map(speed).fold(0.0, f64::max);
        // Empty cells are NaN, which `min` passes over: nothing was within the largest clearance that was looked for.
        let least = world.clearance(None)?.column("distance")?.iter().copied().fold(f64::INFINITY, f64::min);
        let contacts = world.contacts(None)?.n_rows();
        println!(
            "world {number}: up to {fastest:.2} m/s, {least:.3} m from the nearest thing, {contacts} contacts"
        );

        // Frames as arrays, shape (frame, drone, row, column): exact depth, and which geom each pixel shows.
        let frames = world.frames()?;
        let last = frames.time_s.len() - 1;
        let centre = [last, 0, frames.depth_m.shape()[2] / 2, frames.depth_m.shape()[3] / 2];
        let geom = usize::try_from(frames.geom_id[centre]).ok().and_then(|g| manifest.geoms.get(g));
        let name = geom.map_or("nothing", |g| g.name.as_str());
        println!("  at {} s straight ahead: {name} at {} m", frames.time_s[last], frames.depth_m[centre]);

        // The same image as 16-bit PNG, rounded to the manifest's unit.
        let image = world.image(0, last, false)?;
        let value = image[centre[2] * manifest.cameras[0].width + centre[3]];
        let (depth_m, _) = decode(value, manifest.depth_png.metres_per_unit);
        println!("  the same pixel of the PNG: {value}, which is {depth_m} m");
    }
    Ok(())
}

/// Two short flights in the furnished room; `propwash fly` does this from the command line.
fn make(folder: &Path) -> propwash::Result<()> {
    let flight = FlightConfig {
        sim: SimConfig {
            options: SimOptions { n_worlds: 2, ..SimOptions::default() },
            scene: Some(SceneConfig::Files(vec!["xml/room.xml".into()])),
            pattern: Some(FlightPattern::Circle),
            camera: Some(CameraConfig { width: Some(32), height: Some(24), ..CameraConfig::default() }),
            ..SimConfig::default()
        },
        seconds: 1.0,
        fps: 10,
        ..FlightConfig::default()
    };
    let flight = flight.load()?;
    let recorded = record(&flight, folder, &|done, all| println!("{done} of {all} worlds"))?;
    println!("made {} images in {}", recorded.summary.n_images, folder.display());
    Ok(())
}
