//! Rooms on a grid, joined by doors, with furniture.

use serde::{Deserialize, Serialize};

use super::{
    Disc, Draw, GenerateError, Kind, MOST_MOVING, Mjcf, Places, Purpose, WALL_M, check, movers, number, wall,
};

/// Options of [`rooms`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RoomsOptions {
    /// Seed of everything random.
    pub seed: u64,
    /// Rooms along x.
    pub columns: usize,
    /// Rooms along y.
    pub rows: usize,
    /// Pieces of furniture in all rooms together.
    pub things: usize,
    /// Number of moving obstacles (mocap bodies).
    pub moving: usize,
    /// Edge of a room, from the middle of one wall to that of the next, m.
    pub room_m: f64,
    /// Width of doors, m.
    pub door_m: f64,
    /// Height of walls, m. There is no ceiling.
    pub height_m: f64,
}

impl Default for RoomsOptions {
    fn default() -> Self {
        Self { seed: 0, columns: 3, rows: 2, things: 10, moving: 0, room_m: 4.0, door_m: 1.0, height_m: 2.5 }
    }
}

/// Height of doors, m.
const DOOR_HEIGHT_M: f64 = 2.0;
/// Of the walls that need no door, so many have one all the same.
const SPARE_DOORS: f64 = 0.35;
/// Nothing but the ground is nearer than this to the vertical axis through the origin, m.
const CLEARING_M: f64 = 0.8;

/// A wall between two rooms, or the outside.
struct Between {
    /// Room before and after it along the axis across it.
    rooms: [usize; 2],
    /// Where it starts, m.
    start: [f64; 2],
    /// It runs along y; else along x.
    along_y: bool,
    door: bool,
}

/// Rooms on a grid; the start is in the middle of the first. Every room can be reached through doors.
///
/// # Errors
///
/// An option out of range, or more furniture and moving obstacles than find a place.
pub fn rooms(options: &RoomsOptions) -> Result<String, GenerateError> {
    let kind = Kind::Rooms;
    let o = options;
    check(kind, "columns", o.columns as f64, 1.0, 100.0, "")?;
    check(kind, "rows", o.rows as f64, 1.0, 100.0, "")?;
    check(kind, "room_m", o.room_m, 2.0, 50.0, " m")?;
    check(kind, "door_m", o.door_m, 0.5, o.room_m - 0.6, " m (room_m − 0.6 m at most)")?;
    check(kind, "height_m", o.height_m, DOOR_HEIGHT_M + 0.1, 20.0, " m")?;
    check(kind, "things", o.things as f64, 0.0, 20_000.0, "")?;
    check(kind, "moving", o.moving as f64, 0.0, MOST_MOVING, "")?;

    let settings = format!(
        "seed {}, columns {}, rows {}, things {}, moving {}, room_m {}, door_m {}, height_m {}",
        o.seed,
        o.columns,
        o.rows,
        o.things,
        o.moving,
        number(o.room_m),
        number(o.door_m),
        number(o.height_m)
    );
    let (wide, deep, half) = (o.columns as f64 * o.room_m, o.rows as f64 * o.room_m, 0.5 * o.room_m);
    let middle = [0.5 * wide - half, 0.5 * deep - half, 0.0];
    let span = wide.max(deep);
    let mut out = Mjcf::begin(
        kind,
        "Rooms joined by doors, with furniture; every room can be reached. The start is in the middle of the first. No ceiling.",
        &settings,
        0.6 * span,
        [[0.55, 0.65, 0.78], [0.92, 0.93, 0.95]],
        [[0.62, 0.50, 0.36], [0.57, 0.46, 0.33]],
        &[
            ("wall", [0.88, 0.86, 0.80]),
            ("wood", [0.50, 0.33, 0.20]),
            ("cloth", [0.25, 0.38, 0.48]),
            ("metal", [0.35, 0.36, 0.38]),
            ("plant", [0.22, 0.48, 0.22]),
            ("pot", [0.70, 0.40, 0.28]),
        ],
    );
    let from = [middle[0] - 0.4 * span, middle[1] - 0.85 * span, 0.95 * span];
    out.camera("overview", from, middle, 55.0);
    out.camera("top", [middle[0], middle[1], 1.3 * span], middle, 50.0);

    // The house around all rooms.
    let (low, high) = ([-half, -half], [wide - half, deep - half]);
    let (t, h) = (0.5 * WALL_M, o.height_m);
    out.open("house", [0.0; 3], [1.0, 0.0]);
    wall(&mut out, "house_south", [low[0] - t, low[1] - t], [high[0] + t, low[1] + t], h);
    wall(&mut out, "house_north", [low[0] - t, high[1] - t], [high[0] + t, high[1] + t], h);
    wall(&mut out, "house_west", [low[0] - t, low[1] + t], [low[0] + t, high[1] - t], h);
    wall(&mut out, "house_east", [high[0] - t, low[1] + t], [high[0] + t, high[1] - t], h);
    out.close();

    for (i, between) in walls(o).iter().enumerate() {
        write_wall(&mut out, o, i, between);
    }

    let mut places = Places::new(1.0);
    furnish(&mut out, &mut places, o)?;
    let too_many = |fit: usize| GenerateError::TooMany {
        kind,
        what: "moving obstacles",
        wanted: o.moving,
        fit,
        remedy: format!("enlarge room_m (now {}) or lower things (now {})", number(o.room_m), o.things),
    };
    movers(&mut out, &mut places, o.seed, Purpose::RoomsMover, o.moving, half - 0.5, CLEARING_M)
        .map_err(too_many)?;
    Ok(out.end())
}

/// The walls between rooms. Doors make a tree of all rooms, and a few more.
fn walls(o: &RoomsOptions) -> Vec<Between> {
    let half = 0.5 * o.room_m;
    let mut all = Vec::new();
    for row in 0..o.rows {
        for column in 0..o.columns {
            let room = row * o.columns + column;
            let corner = [column as f64 * o.room_m + half, row as f64 * o.room_m - half];
            if column + 1 < o.columns {
                all.push(Between { rooms: [room, room + 1], start: corner, along_y: true, door: false });
            }
            if row + 1 < o.rows {
                let start = [corner[0] - o.room_m, corner[1] + o.room_m];
                all.push(Between { rooms: [room, room + o.columns], start, along_y: false, door: false });
            }
        }
    }
    // A random order of walls; a door wherever it joins rooms that were apart (Kruskal's tree).
    let mut draw = Draw::new(o.seed, Purpose::RoomsDoor, 0);
    let mut order: Vec<usize> = (0..all.len()).collect();
    for i in (1..order.len()).rev() {
        order.swap(i, draw.below(i + 1));
    }
    let mut joined: Vec<usize> = (0..o.columns * o.rows).collect();
    for i in order {
        let [a, b] = all[i].rooms.map(|room| joined[room]);
        all[i].door = a != b || draw.unit() < SPARE_DOORS;
        if a != b {
            joined.iter_mut().filter(|j| **j == b).for_each(|j| *j = a);
        }
    }
    all
}

/// A wall, or the two pieces and the lintel that a door leaves of it.
fn write_wall(out: &mut Mjcf, o: &RoomsOptions, i: usize, between: &Between) {
    let t = 0.5 * WALL_M;
    // From `a` to `b` along the wall, both ends free of the walls across.
    let (first, last) = (t, o.room_m - t);
    let piece = |a: f64, b: f64| {
        let [x, y] = between.start;
        if between.along_y { ([x - t, y + a], [x + t, y + b]) } else { ([x + a, y - t], [x + b, y + t]) }
    };
    let name = format!("wall_{i:03}");
    out.open(&name, [0.0; 3], [1.0, 0.0]);
    if between.door {
        let mut draw = Draw::new(o.seed, Purpose::RoomsDoor, 1 + i);
        let left = draw.within(first + 0.2, last - 0.2 - o.door_m);
        let (a, b) = piece(first, left);
        wall(out, &format!("{name}_left"), a, b, o.height_m);
        let (a, b) = piece(left + o.door_m, last);
        wall(out, &format!("{name}_right"), a, b, o.height_m);
        let (a, b) = piece(left, left + o.door_m);
        let above = 0.5 * (o.height_m - DOOR_HEIGHT_M);
        let size = [0.5 * (b[0] - a[0]), 0.5 * (b[1] - a[1]), above];
        let pos = [0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1]), DOOR_HEIGHT_M + above];
        out.geom(&format!("{name}_lintel"), "box", &size, pos, "wall");
        out.site(
            &format!("door_{i:03}"),
            [size[0], size[1], 0.5 * DOOR_HEIGHT_M],
            [pos[0], pos[1], 0.5 * DOOR_HEIGHT_M],
        );
    } else {
        let (a, b) = piece(first, last);
        wall(out, &name, a, b, o.height_m);
    }
    out.close();
}

/// Puts furniture into the rooms by turns, clear of walls and of each other.
fn furnish(out: &mut Mjcf, places: &mut Places, o: &RoomsOptions) -> Result<(), GenerateError> {
    let rooms = o.columns * o.rows;
    let digits = o.things.saturating_sub(1).max(100).to_string().len();
    for i in 0..o.things {
        let mut draw = Draw::new(o.seed, Purpose::RoomsThing, i);
        let room = i % rooms;
        let center = [(room % o.columns) as f64 * o.room_m, (room / o.columns) as f64 * o.room_m];
        let heading = draw.direction();
        let which = draw.below(5);
        let found = free_place(&mut draw, places, o, center, REACH_M[which]);
        let disc = found.ok_or_else(|| GenerateError::TooMany {
            kind: Kind::Rooms,
            what: "things",
            wanted: o.things,
            fit: i,
            remedy: format!("enlarge room_m (now {})", number(o.room_m)),
        })?;
        places.take(disc);
        let (at, draw) = ([disc.x, disc.y, 0.0], &mut draw);
        let name = format!("{}_{i:0digits$}", ["table", "shelf", "plant", "sofa", "lamp"][which]);
        match which {
            0 => table(out, &name, at, heading, draw),
            1 => shelf(out, &name, at, heading, draw),
            2 => plant(out, &name, at, heading, draw),
            3 => sofa(out, &name, at, heading),
            _ => lamp(out, &name, at, heading, draw),
        }
        out.close();
    }
    Ok(())
}

/// Radius of the disc that holds a table, a shelf, a plant, a sofa, a lamp, m.
const REACH_M: [f64; 5] = [0.62, 0.5, 0.3, 0.55, 0.2];

/// A free disc in the room around `center`, clear of its walls by the way that a drone needs.
fn free_place(
    draw: &mut Draw,
    places: &Places,
    o: &RoomsOptions,
    center: [f64; 2],
    radius: f64,
) -> Option<Disc> {
    let play = 0.5 * o.room_m - 0.5 * WALL_M - radius - 0.15;
    (0..200).find_map(|_| {
        let disc = Disc {
            x: center[0] + draw.within(-play.max(0.0), play.max(1e-9)),
            y: center[1] + draw.within(-play.max(0.0), play.max(1e-9)),
            radius,
        };
        let clear = (disc.x * disc.x + disc.y * disc.y).sqrt() > CLEARING_M + radius;
        (play > 0.0 && clear && places.is_free(&disc, 0.25)).then_some(disc)
    })
}

/// A table on four legs.
fn table(out: &mut Mjcf, name: &str, at: [f64; 3], heading: [f64; 2], draw: &mut Draw) {
    let (x, y, z) = (draw.within(0.3, 0.5), draw.within(0.25, 0.35), draw.within(0.65, 0.78));
    out.open(name, at, heading);
    out.geom(&format!("{name}_top"), "box", &[x, y, 0.02], [0.0, 0.0, z], "wood");
    for (k, (sx, sy)) in [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)].into_iter().enumerate() {
        let (lx, ly) = (sx * (x - 0.04), sy * (y - 0.04));
        out.stick(&format!("{name}_leg_{k}"), "cylinder", 0.025, [lx, ly, 0.0], [lx, ly, z], "metal");
    }
}

/// A shelf.
fn shelf(out: &mut Mjcf, name: &str, at: [f64; 3], heading: [f64; 2], draw: &mut Draw) {
    let (x, y, z) = (draw.within(0.3, 0.45), draw.within(0.12, 0.2), draw.within(0.8, 1.1));
    out.open(name, at, heading);
    out.geom(name, "box", &[x, y, z], [0.0, 0.0, z], "wood");
}

/// A plant in a pot.
fn plant(out: &mut Mjcf, name: &str, at: [f64; 3], heading: [f64; 2], draw: &mut Draw) {
    out.open(name, at, heading);
    out.geom(&format!("{name}_pot"), "cylinder", &[0.14, 0.15], [0.0, 0.0, 0.15], "pot");
    let z = draw.within(0.25, 0.5);
    out.geom(&format!("{name}_leaves"), "ellipsoid", &[0.26, 0.26, z], [0.0, 0.0, 0.3 + z], "plant");
}

/// A sofa with a back.
fn sofa(out: &mut Mjcf, name: &str, at: [f64; 3], heading: [f64; 2]) {
    out.open(name, at, heading);
    out.geom(&format!("{name}_seat"), "box", &[0.45, 0.3, 0.2], [0.0, 0.0, 0.2], "cloth");
    out.geom(&format!("{name}_back"), "box", &[0.45, 0.06, 0.2], [0.0, 0.24, 0.6], "cloth");
}

/// A lamp on a pole.
fn lamp(out: &mut Mjcf, name: &str, at: [f64; 3], heading: [f64; 2], draw: &mut Draw) {
    let z = draw.within(1.3, 1.7);
    out.open(name, at, heading);
    out.stick(&format!("{name}_pole"), "capsule", 0.015, [0.0, 0.0, 0.0], [0.0, 0.0, z], "metal");
    out.geom(&format!("{name}_shade"), "sphere", &[0.16], [0.0, 0.0, z], "cloth");
}
