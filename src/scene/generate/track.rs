//! A race track in the open: gates along a closed course around the start.

use std::f64::consts::{FRAC_PI_4, TAU};

use serde::{Deserialize, Serialize};

use super::{
    BAR_M, Disc, Draw, Gate, GenerateError, Kind, MOST_MOVING, Mjcf, Places, Purpose, check, gate, movers,
    number,
};

/// Options of [`track`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TrackOptions {
    /// Seed of everything random.
    pub seed: u64,
    /// Number of gates, flown through in the order of their names, counter-clockwise.
    pub gates: usize,
    /// Number of posts that stand beside the course.
    pub posts: usize,
    /// Number of moving obstacles (mocap bodies).
    pub moving: usize,
    /// Radius of the course, m.
    pub radius_m: f64,
    /// How far gates stand off the circle, as a part of its radius.
    pub bend: f64,
}

impl Default for TrackOptions {
    fn default() -> Self {
        Self { seed: 0, gates: 8, posts: 12, moving: 0, radius_m: 6.0, bend: 0.25 }
    }
}

/// Half of a gate's opening, m: least and most.
const OPENING_M: [f64; 2] = [0.45, 0.6];
/// Heights of the middle of openings, m.
const MIDDLE_M: [f64; 2] = [0.9, 1.8];
/// Nothing but the ground is nearer than this to the vertical axis through the origin, m.
const CLEARING_M: f64 = 1.0;
/// Free distance between a post and a gate, m.
const APART_M: f64 = 0.8;

/// The direction of part `u` of a turn (0 to 1) as (cosine, sine), without trigonometry: each quarter by t → (1 − t², 2 t) / (1 + t²),
/// where t grows so that angles are even to 1 %.
fn around(u: f64) -> [f64; 2] {
    let quarters = 4.0 * u;
    let (quarter, x) = (quarters.floor(), quarters - quarters.floor());
    let t = x * (FRAC_PI_4 + (1.0 - FRAC_PI_4) * x * x);
    let (c, s) = ((1.0 - t * t) / (1.0 + t * t), 2.0 * t / (1.0 + t * t));
    match quarter as i64 & 3 {
        0 => [c, s],
        1 => [-s, c],
        2 => [-c, -s],
        _ => [s, -c],
    }
}

/// The head of the file: what it is, its light, its materials, and cameras that see `reach` m around.
fn begin(o: &TrackOptions, reach: f64) -> Mjcf {
    let settings = format!(
        "seed {}, gates {}, posts {}, moving {}, radius_m {}, bend {}",
        o.seed,
        o.gates,
        o.posts,
        o.moving,
        number(o.radius_m),
        number(o.bend)
    );
    let mut out = Mjcf::begin(
        Kind::Track,
        "A race track: gates along a closed course around the start, counter-clockwise in the order of their names, and posts.",
        &settings,
        1.2 * reach,
        [[0.35, 0.55, 0.80], [0.88, 0.92, 0.96]],
        [[0.42, 0.52, 0.36], [0.38, 0.47, 0.33]],
        &[
            ("gate_square", [0.90, 0.45, 0.10]),
            ("gate_round", [0.15, 0.45, 0.80]),
            ("post", [0.25, 0.26, 0.28]),
            ("pole", [0.85, 0.82, 0.30]),
        ],
    );
    out.camera("overview", [-1.3 * reach, -1.5 * reach, 1.1 * reach], [0.0; 3], 50.0);
    out.camera("top", [0.0, 0.0, 2.5 * reach], [0.0; 3], 50.0);
    out
}

/// Gates at their feet; each looks along the way from the one before to the one after.
fn stand_gates(o: &TrackOptions, out: &mut Mjcf, places: &mut Places, feet: &[[f64; 2]]) {
    for (i, at) in feet.iter().enumerate() {
        let mut draw = Draw::new(o.seed, Purpose::TrackGate, i);
        let (before, after) = (feet[(i + o.gates - 1) % o.gates], feet[(i + 1) % o.gates]);
        let way = [after[0] - before[0], after[1] - before[1]];
        let length = (way[0] * way[0] + way[1] * way[1]).sqrt();
        let opening = draw.within(OPENING_M[0], OPENING_M[1]);
        let z = draw.within(MIDDLE_M[0], MIDDLE_M[1]);
        let along = way.map(|v| v / length);
        let octagon = draw.unit() < 0.5;
        gate(out, &format!("gate_{i:02}"), &Gate { at: *at, along, opening, side: 0.0, z, octagon });
        places.take(Disc { x: at[0], y: at[1], radius: opening + BAR_M + APART_M });
    }
}

/// Gates of a race along a closed course around the start, counter-clockwise, and posts beside it, as MJCF text. The sites `gate_00`,
/// `gate_01`, … fill the openings; their x axes point the way through.
///
/// # Errors
///
/// An option out of range, or more posts and moving obstacles than find a place.
pub fn track(options: &TrackOptions) -> Result<String, GenerateError> {
    let kind = Kind::Track;
    let o = options;
    check(kind, "radius_m", o.radius_m, 3.0, 200.0, " m")?;
    check(kind, "bend", o.bend, 0.0, 0.4, " of the radius")?;
    // Gates of 1.4 m need their place on the circle.
    let most = (TAU * o.radius_m * (1.0 - o.bend) / 2.5).floor();
    check(kind, "gates", o.gates as f64, 3.0, most, " (2.5 m of the course each)")?;
    check(kind, "posts", o.posts as f64, 0.0, 2_000.0, "")?;
    check(kind, "moving", o.moving as f64, 0.0, MOST_MOVING, "")?;

    let mut draw = Draw::new(o.seed, Purpose::TrackCourse, 0);
    let turn = draw.unit();
    let feet: Vec<[f64; 2]> = (0..o.gates)
        .map(|i| {
            let [c, s] = around((i as f64 / o.gates as f64 + turn).fract());
            let r = o.radius_m * (1.0 + draw.within(-o.bend, o.bend));
            [r * c, r * s]
        })
        .collect();

    let reach = o.radius_m * (1.0 + o.bend) + 1.0;
    let mut out = begin(o, reach);
    let mut places = Places::new(1.0);
    stand_gates(o, &mut out, &mut places, &feet);
    let too_many = |what: &'static str, wanted: usize, fit: usize| GenerateError::TooMany {
        kind,
        what,
        wanted,
        fit,
        remedy: format!("enlarge radius_m (now {})", number(o.radius_m)),
    };
    for i in 0..o.posts {
        let mut draw = Draw::new(o.seed, Purpose::TrackPost, i);
        let (radius, half) = (draw.within(0.05, 0.12), 0.5 * draw.within(1.5, 3.0));
        let disc = places
            .throw(&mut draw, reach, radius, 0.5, radius, CLEARING_M)
            .ok_or_else(|| too_many("posts", o.posts, i))?;
        places.take(disc);
        let name = format!("pole_{i:03}");
        out.open(&name, [disc.x, disc.y, half], [1.0, 0.0]);
        out.geom(&name, "cylinder", &[radius, half], [0.0; 3], "pole");
        out.close();
    }
    movers(&mut out, &mut places, o.seed, Purpose::TrackMover, o.moving, reach, CLEARING_M)
        .map_err(|fit| too_many("moving obstacles", o.moving, fit))?;
    Ok(out.end())
}
