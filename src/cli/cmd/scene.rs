//! `propwash scene`: check a scene, make a new one.

use super::{print, print_json};
use crate::cli::args::{LintArgs, NewArgs, NewScene, SceneArgs, SceneCommand};
use crate::cli::exit::Outcome;
use crate::cli::output;
use crate::cli::progress::waiting;
use crate::scene::generate::{
    self, BoxesOptions, CorridorOptions, ForestOptions, GenerateError, RoomsOptions, TrackOptions,
};
use crate::scene::{SceneSource, lint};
use crate::{Error, Result};
use serde_json::json;

/// Runs the command.
pub fn run(args: &SceneArgs) -> Result<Outcome> {
    match &args.command {
        SceneCommand::Lint(a) => check(a),
        SceneCommand::New(a) => new(a),
    }
}

fn check(args: &LintArgs) -> Result<Outcome> {
    let source = SceneSource::file(&args.file);
    let report = waiting("looking at the scene", || lint(&source, args.spawn, args.spawn_radius))?;
    if args.json {
        print_json(&json!(report))?;
    } else {
        print(&report)?;
    }
    let clean = report.mismatches().next().is_none() && !report.spawn_is_blocked();
    Ok(if clean { Outcome::Fine } else { Outcome::Found })
}

fn new(kind: &NewScene) -> Result<Outcome> {
    let (NewScene::Forest { common, .. }
    | NewScene::Corridor { common, .. }
    | NewScene::Boxes { common, .. }
    | NewScene::Track { common, .. }
    | NewScene::Rooms { common, .. }) = kind;
    output::check(&[("--out", Some(&common.out))], common.force)?;
    let text = match kind {
        NewScene::Forest { common, trees, rocks, logs, extent, clearing, gap } => {
            let d = ForestOptions::default();
            let options = ForestOptions {
                seed: common.seed,
                trees: trees.unwrap_or(d.trees),
                rocks: rocks.unwrap_or(d.rocks),
                logs: logs.unwrap_or(d.logs),
                moving: common.moving.unwrap_or(d.moving),
                size_m: extent.unwrap_or(d.size_m),
                clearing_radius_m: clearing.unwrap_or(d.clearing_radius_m),
                min_gap_m: gap.unwrap_or(d.min_gap_m),
            };
            generate::forest(&options).map_err(named)?
        }
        NewScene::Corridor { common, gates, length, width, height } => {
            let d = CorridorOptions::default();
            let options = CorridorOptions {
                seed: common.seed,
                gates: gates.unwrap_or(d.gates),
                moving: common.moving.unwrap_or(d.moving),
                length_m: length.unwrap_or(d.length_m),
                width_m: width.unwrap_or(d.width_m),
                height_m: height.unwrap_or(d.height_m),
            };
            generate::corridor(&options).map_err(named)?
        }
        NewScene::Boxes { common, count, extent, clearing, gap } => {
            let d = BoxesOptions::default();
            let options = BoxesOptions {
                seed: common.seed,
                count: count.unwrap_or(d.count),
                moving: common.moving.unwrap_or(d.moving),
                size_m: extent.unwrap_or(d.size_m),
                clearing_radius_m: clearing.unwrap_or(d.clearing_radius_m),
                min_gap_m: gap.unwrap_or(d.min_gap_m),
            };
            generate::boxes(&options).map_err(named)?
        }
        NewScene::Track { common, gates, posts, radius, bend } => {
            let d = TrackOptions::default();
            let options = TrackOptions {
                seed: common.seed,
                gates: gates.unwrap_or(d.gates),
                posts: posts.unwrap_or(d.posts),
                moving: common.moving.unwrap_or(d.moving),
                radius_m: radius.unwrap_or(d.radius_m),
                bend: bend.unwrap_or(d.bend),
            };
            generate::track(&options).map_err(named)?
        }
        NewScene::Rooms { common, columns, rows, things, room, door, height } => {
            let d = RoomsOptions::default();
            let options = RoomsOptions {
                seed: common.seed,
                columns: columns.unwrap_or(d.columns),
                rows: rows.unwrap_or(d.rows),
                things: things.unwrap_or(d.things),
                moving: common.moving.unwrap_or(d.moving),
                room_m: room.unwrap_or(d.room_m),
                door_m: door.unwrap_or(d.door_m),
                height_m: height.unwrap_or(d.height_m),
            };
            generate::rooms(&options).map_err(named)?
        }
    };
    write(common, &text)
}

/// The error with the option's name on the command line.
fn named(error: GenerateError) -> Error {
    let flag = |option: &str| {
        Some(match option {
            "trees" => "--trees",
            "rocks" => "--rocks",
            "logs" => "--logs",
            "count" => "--count",
            "gates" => "--gates",
            "moving" => "--moving",
            "size_m" => "--extent",
            "clearing_radius_m" => "--clearing",
            "min_gap_m" => "--gap",
            "length_m" => "--length",
            "width_m" => "--width",
            "height_m" => "--height",
            "posts" => "--posts",
            "radius_m" => "--radius",
            "bend" => "--bend",
            "columns" => "--columns",
            "rows" => "--rows",
            "things" => "--things",
            "room_m" => "--room",
            "door_m" => "--door",
            _ => return None,
        })
    };
    match error {
        GenerateError::OptionRange { option, found, expected, .. } if flag(option).is_some() => {
            Error::Usage {
                flag: flag(option).unwrap_or_default(),
                expected: expected
                    .replace("size_m", "--extent")
                    .replace("width_m", "--width")
                    .replace("room_m", "--room"),
                got: found.to_string(),
            }
        }
        other => other.into(),
    }
}

fn write(args: &NewArgs, text: &str) -> Result<Outcome> {
    output::write("--out", &args.out, text.as_bytes(), args.force)?;
    print(format_args!("wrote {} ({} geoms)", args.out.display(), text.matches("<geom ").count()))?;
    Ok(Outcome::Fine)
}
