//! Scenes made from a seed: forests, corridors with gates, clutter of boxes, race tracks, rooms, as MJCF text.
//!
//! The same options give the same text, byte for byte, on every machine: random numbers are counter-based (ChaCha8, keyed by seed,
//! purpose and item), the arithmetic keeps to operations that IEEE 754 rounds exactly (no sine, no cosine), and numbers are printed with
//! four decimals. Every scene leaves the start around (0, 0, 1) m free, names each geom and body, has cameras `overview` and `top`, and
//! carries its moving obstacles as mocap bodies `mover_0`, `mover_1`, ….

mod boxes;
mod corridor;
mod forest;
mod rooms;
mod track;

pub use boxes::boxes;
pub use corridor::corridor;
use corridor::{BAR_M, Gate, WALL_M, gate, wall};
pub use forest::forest;
pub use rooms::{RoomsOptions, rooms};
pub use track::{TrackOptions, track};

use std::collections::HashMap;
use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::random::{Key, Stream};

/// What can be wrong with the options of a generated scene.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum GenerateError {
    /// The name is none of [`Kind::ALL`].
    #[error("unknown scene kind {found:?}: expected one of {}", Kind::names())]
    UnknownKind {
        /// What was given.
        found: String,
    },
    /// An option is outside its range.
    #[error("option {option} of a {kind} scene is {found}: expected {expected}")]
    OptionRange {
        /// The kind of scene.
        kind: Kind,
        /// The option's name.
        option: &'static str,
        /// What was given.
        found: f64,
        /// The range, in words, with its unit.
        expected: String,
    },
    /// Not all things found a place.
    #[error("only {fit} of {wanted} {what} fit into this {kind} scene: ask for at most {fit}, or {remedy}")]
    TooMany {
        /// The kind of scene.
        kind: Kind,
        /// The things, in words.
        what: &'static str,
        /// How many were asked for.
        wanted: usize,
        /// How many found a place.
        fit: usize,
        /// What else would help, with the values of now.
        remedy: String,
    },
}

/// The kinds of scene that can be generated.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Kind {
    /// Trees of several shapes, bushes, rocks and fallen logs: [`forest`].
    Forest,
    /// A hall and a winding corridor with gates and overhead beams: [`corridor`].
    Corridor,
    /// Boxes, pillars and slabs, standing and floating: [`boxes`].
    Boxes,
    /// Gates along a closed course: [`track`].
    Track,
    /// Rooms with doors and furniture: [`rooms`].
    Rooms,
}

impl Kind {
    /// All kinds.
    pub const ALL: [Kind; 5] = [Kind::Forest, Kind::Corridor, Kind::Boxes, Kind::Track, Kind::Rooms];

    /// The name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Kind::Forest => "forest",
            Kind::Corridor => "corridor",
            Kind::Boxes => "boxes",
            Kind::Track => "track",
            Kind::Rooms => "rooms",
        }
    }

    fn names() -> String {
        Self::ALL.map(Self::name).join(", ")
    }
}

impl fmt::Display for Kind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Kind {
    type Err = GenerateError;

    fn from_str(name: &str) -> Result<Self, GenerateError> {
        Self::ALL
            .into_iter()
            .find(|kind| kind.name() == name)
            .ok_or_else(|| GenerateError::UnknownKind { found: name.to_string() })
    }
}

/// Options of [`forest`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ForestOptions {
    /// Seed of everything random.
    pub seed: u64,
    /// Number of trees, up to 20 000. The first trees of a seed stay what they are when more are asked for.
    pub trees: usize,
    /// Number of rocks on the ground, up to 20 000.
    pub rocks: usize,
    /// Number of fallen logs, up to 20 000.
    pub logs: usize,
    /// Number of moving obstacles (mocap bodies), up to 1 000.
    pub moving: usize,
    /// Edge of the square that the trunks stand in, centred on the origin, m.
    pub size_m: f64,
    /// Nothing but the ground is nearer than this to the vertical axis through the origin, m.
    pub clearing_radius_m: f64,
    /// Smallest free distance between two trunks, at any height, m. Crowns may meet.
    pub min_gap_m: f64,
}

impl Default for ForestOptions {
    fn default() -> Self {
        Self {
            seed: 0,
            trees: 60,
            rocks: 12,
            logs: 5,
            moving: 3,
            size_m: 16.0,
            clearing_radius_m: 1.0,
            min_gap_m: 0.9,
        }
    }
}

/// Options of [`corridor`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CorridorOptions {
    /// Seed of everything random.
    pub seed: u64,
    /// Number of gates.
    pub gates: usize,
    /// Number of moving obstacles (mocap bodies) in the corridor. They share its length with the gates.
    pub moving: usize,
    /// Length of the corridor's centre line, from the hall to its end, m.
    pub length_m: f64,
    /// Free width of the corridor, m.
    pub width_m: f64,
    /// Height of the walls, m. There is no ceiling.
    pub height_m: f64,
}

impl Default for CorridorOptions {
    fn default() -> Self {
        Self { seed: 0, gates: 6, moving: 2, length_m: 32.0, width_m: 2.4, height_m: 2.4 }
    }
}

/// Options of [`boxes`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct BoxesOptions {
    /// Seed of everything random.
    pub seed: u64,
    /// Number of boxes, pillars and slabs, up to 20 000.
    pub count: usize,
    /// Number of moving obstacles (mocap bodies), up to 1 000.
    pub moving: usize,
    /// Edge of the square that everything stands in, centred on the origin, m.
    pub size_m: f64,
    /// Nothing but the ground is nearer than this to the vertical axis through the origin, m.
    pub clearing_radius_m: f64,
    /// Smallest free distance between any two things, seen from above, m.
    pub min_gap_m: f64,
}

impl Default for BoxesOptions {
    fn default() -> Self {
        Self { seed: 0, count: 30, moving: 2, size_m: 12.0, clearing_radius_m: 1.0, min_gap_m: 0.5 }
    }
}

// ------------------------------------------------------------------------------------------------ random numbers

/// What random numbers are for; part of their key, so that no two uses share numbers.
#[derive(Clone, Copy)]
enum Purpose {
    ForestTree = 0x5C_0001,
    ForestRock = 0x5C_0002,
    ForestLog = 0x5C_0003,
    ForestMover = 0x5C_0004,
    CorridorPath = 0x5C_0011,
    CorridorSlots = 0x5C_0012,
    CorridorGate = 0x5C_0013,
    CorridorMover = 0x5C_0014,
    CorridorBeam = 0x5C_0015,
    BoxesThing = 0x5C_0021,
    BoxesMover = 0x5C_0022,
    TrackGate = 0x5C_0031,
    TrackCourse = 0x5C_0032,
    TrackPost = 0x5C_0033,
    TrackMover = 0x5C_0034,
    RoomsDoor = 0x5C_0041,
    RoomsThing = 0x5C_0042,
    RoomsMover = 0x5C_0043,
}

/// A stream of random numbers for one item.
struct Draw(Stream);

impl Draw {
    /// The stream of one item; world and drone are 0.
    fn new(seed: u64, purpose: Purpose, item: usize) -> Self {
        Draw(Key { seed, world: 0, drone: 0, step: item as u64, purpose: purpose as u32 }.stream())
    }

    /// Uniform in [0, 1), 53 bits.
    fn unit(&mut self) -> f64 {
        self.0.unit()
    }

    /// Uniform in [low, high).
    fn within(&mut self, low: f64, high: f64) -> f64 {
        self.0.uniform(low, high)
    }

    /// Uniform in 0..n; n is small, so the bias of 2⁻⁵³ n does not matter.
    fn below(&mut self, n: usize) -> usize {
        (self.unit() * n as f64) as usize
    }

    /// A direction in the plane as (cosine, sine), by rejection from the square: no trigonometry.
    fn direction(&mut self) -> [f64; 2] {
        loop {
            let (x, y) = (self.within(-1.0, 1.0), self.within(-1.0, 1.0));
            let square = x * x + y * y;
            if square > 1e-4 && square <= 1.0 {
                let length = square.sqrt();
                return [x / length, y / length];
            }
        }
    }
}

// ------------------------------------------------------------------------------------------------ places

/// A disc on the ground that something covers.
#[derive(Clone, Copy)]
struct Disc {
    x: f64,
    y: f64,
    radius: f64,
}

impl Disc {
    /// Free distance between two discs; negative where they overlap.
    fn gap(&self, other: &Disc) -> f64 {
        let (dx, dy) = (self.x - other.x, self.y - other.y);
        (dx * dx + dy * dy).sqrt() - self.radius - other.radius
    }
}

/// The discs taken so far, in square cells so that a query looks at its neighbourhood only.
struct Places {
    cell: f64,
    largest_radius: f64,
    cells: HashMap<(i64, i64), Vec<Disc>>,
}

/// Darts thrown for one thing before it counts as not fitting.
const TRIES: usize = 2_000;

impl Places {
    fn new(cell: f64) -> Self {
        Self { cell, largest_radius: 0.0, cells: HashMap::new() }
    }

    fn index(&self, v: f64) -> i64 {
        (v / self.cell).floor() as i64
    }

    fn is_free(&self, disc: &Disc, gap: f64) -> bool {
        let reach = disc.radius + self.largest_radius + gap;
        for i in self.index(disc.x - reach)..=self.index(disc.x + reach) {
            for j in self.index(disc.y - reach)..=self.index(disc.y + reach) {
                if let Some(taken) = self.cells.get(&(i, j))
                    && taken.iter().any(|other| disc.gap(other) < gap)
                {
                    return false;
                }
            }
        }
        true
    }

    fn take(&mut self, disc: Disc) {
        self.largest_radius = self.largest_radius.max(disc.radius);
        let cell = (self.index(disc.x), self.index(disc.y));
        self.cells.entry(cell).or_default().push(disc);
    }

    /// Throws darts at the square |x|, |y| ≤ `half` until a disc of `radius` has `gap` to all others and `reach` does not come within
    /// `clearing` of the origin. None when [`TRIES`] darts found no place.
    fn throw(
        &self,
        draw: &mut Draw,
        half: f64,
        radius: f64,
        gap: f64,
        reach: f64,
        clearing: f64,
    ) -> Option<Disc> {
        let half = half - radius;
        for _ in 0..TRIES {
            let disc = Disc { x: draw.within(-half, half), y: draw.within(-half, half), radius };
            let off = (disc.x * disc.x + disc.y * disc.y).sqrt();
            if off >= clearing + reach && self.is_free(&disc, gap) {
                return Some(disc);
            }
        }
        None
    }
}

// ------------------------------------------------------------------------------------------------ MJCF text

/// Four decimals at most, no trailing zeros, no minus zero.
fn number(value: f64) -> String {
    let text = format!("{value:.4}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text == "-0" { "0".to_string() } else { text.to_string() }
}

fn numbers(values: &[f64]) -> String {
    values.iter().map(|&v| number(v)).collect::<Vec<_>>().join(" ")
}

/// MJCF text under construction.
struct Mjcf {
    text: String,
    depth: usize,
}

impl Mjcf {
    fn line(&mut self, line: &str) {
        self.text.extend(std::iter::repeat_n("  ", self.depth));
        self.text.push_str(line);
        self.text.push('\n');
    }

    /// The head that all generated scenes share, up to the open `<worldbody>`.
    fn begin(
        kind: Kind,
        about: &str,
        settings: &str,
        extent_m: f64,
        sky: [[f64; 3]; 2],
        ground: [[f64; 3]; 2],
        materials: &[(&str, [f64; 3])],
    ) -> Self {
        let mut out = Mjcf { text: String::new(), depth: 0 };
        out.line("<!--");
        out.line(about);
        out.line(&format!("Written by `propwash scene new {kind}`: change the options, not this file. XML comments may not hold a double hyphen,"));
        out.line("so the options stand here by their names:");
        out.line(&format!("  {settings}"));
        out.line("-->");
        out.line(&format!("<mujoco model=\"{kind}\">"));
        out.depth = 1;
        out.line("<size memory=\"16M\"/>");
        out.line(&format!("<statistic center=\"0 0 1\" extent=\"{}\"/>", number(extent_m)));
        out.line("<visual>");
        out.line("  <headlight ambient=\"0.38 0.38 0.38\" diffuse=\"0.35 0.35 0.35\"/>");
        out.line("  <map znear=\"0.002\"/>");
        out.line("</visual>");
        out.line("<asset>");
        out.line(&format!(
            "  <texture name=\"sky\" type=\"skybox\" builtin=\"gradient\" rgb1=\"{}\" rgb2=\"{}\" width=\"256\" height=\"1536\"/>",
            numbers(&sky[0]),
            numbers(&sky[1])
        ));
        out.line(&format!(
            "  <texture name=\"ground\" type=\"2d\" builtin=\"checker\" rgb1=\"{}\" rgb2=\"{}\" width=\"256\" height=\"256\"/>",
            numbers(&ground[0]),
            numbers(&ground[1])
        ));
        out.line(
            "  <material name=\"ground\" texture=\"ground\" texrepeat=\"0.5 0.5\" texuniform=\"true\"/>",
        );
        for (name, rgb) in materials {
            out.line(&format!("  <material name=\"{name}\" rgba=\"{} 1\"/>", numbers(rgb)));
        }
        out.line("  <material name=\"mover\" rgba=\"0.95 0.35 0.15 1\"/>");
        out.line("</asset>");
        out.line("<worldbody>");
        out.depth = 2;
        out.line("<light name=\"sun\" type=\"directional\" pos=\"0 0 20\" dir=\"-0.4 0.3 -1\" diffuse=\"0.7 0.68 0.62\"/>");
        out.line("<geom name=\"ground\" type=\"plane\" size=\"0 0 0.1\" material=\"ground\"/>");
        out
    }

    /// A camera that looks from `from` at `at`, upright.
    fn camera(&mut self, name: &str, from: [f64; 3], at: [f64; 3], fovy_deg: f64) {
        // A camera looks along its -z; x is right, y is up in the picture.
        let z = unit([from[0] - at[0], from[1] - at[1], from[2] - at[2]]);
        let x = if z[0] == 0.0 && z[1] == 0.0 { [1.0, 0.0, 0.0] } else { unit([-z[1], z[0], 0.0]) };
        let y = [z[1] * x[2] - z[2] * x[1], z[2] * x[0] - z[0] * x[2], z[0] * x[1] - z[1] * x[0]];
        self.line(&format!(
            "<camera name=\"{name}\" pos=\"{}\" xyaxes=\"{} {}\" fovy=\"{}\"/>",
            numbers(&from),
            numbers(&x),
            numbers(&y),
            number(fovy_deg)
        ));
    }

    /// Opens a static body whose x axis points along `heading` (cosine, sine).
    fn open(&mut self, name: &str, pos: [f64; 3], heading: [f64; 2]) {
        let turn = if heading == [1.0, 0.0] {
            String::new()
        } else {
            format!(
                " xyaxes=\"{} {}\"",
                numbers(&[heading[0], heading[1], 0.0]),
                numbers(&[-heading[1], heading[0], 0.0])
            )
        };
        self.line(&format!("<body name=\"{name}\" pos=\"{}\"{turn}>", numbers(&pos)));
        self.depth += 1;
    }

    fn open_mocap(&mut self, name: &str, pos: [f64; 3]) {
        self.line(&format!("<body name=\"{name}\" mocap=\"true\" pos=\"{}\">", numbers(&pos)));
        self.depth += 1;
    }

    fn close(&mut self) {
        self.depth -= 1;
        self.line("</body>");
    }

    /// A geom given by its sizes and its place in the body.
    fn geom(&mut self, name: &str, shape: &str, size: &[f64], pos: [f64; 3], material: &str) {
        self.line(&format!(
            "<geom name=\"{name}\" type=\"{shape}\" size=\"{}\" pos=\"{}\" material=\"{material}\"/>",
            numbers(size),
            numbers(&pos)
        ));
    }

    /// A place with a name, which nothing sees or touches: a box by half sizes.
    fn site(&mut self, name: &str, size: [f64; 3], pos: [f64; 3]) {
        self.line(&format!(
            "<site name=\"{name}\" type=\"box\" size=\"{}\" pos=\"{}\" group=\"4\"/>",
            numbers(&size),
            numbers(&pos)
        ));
    }

    /// A capsule or cylinder between two points.
    fn stick(&mut self, name: &str, shape: &str, radius: f64, from: [f64; 3], to: [f64; 3], material: &str) {
        self.line(&format!(
            "<geom name=\"{name}\" type=\"{shape}\" size=\"{}\" fromto=\"{} {}\" material=\"{material}\"/>",
            number(radius),
            numbers(&from),
            numbers(&to)
        ));
    }

    /// The moving obstacle number `i`: ball, post or box by turns.
    fn mover(&mut self, i: usize, x: f64, y: f64, z: f64) {
        let name = format!("mover_{i}");
        self.open_mocap(&name, [x, y, z]);
        match i % 3 {
            0 => self.geom(&name, "sphere", &[0.25], [0.0; 3], "mover"),
            1 => self.geom(&name, "capsule", &[0.1, 0.45], [0.0; 3], "mover"),
            _ => self.geom(&name, "box", &[0.2, 0.2, 0.2], [0.0; 3], "mover"),
        }
        self.close();
    }

    fn end(mut self) -> String {
        self.depth = 1;
        self.line("</worldbody>");
        self.depth = 0;
        self.line("</mujoco>");
        self.text
    }
}

/// Places moving obstacles clear of everything in `places`: near the flight space where there is room, else anywhere.
/// The error is how many found a place.
fn movers(
    out: &mut Mjcf,
    places: &mut Places,
    seed: u64,
    purpose: Purpose,
    count: usize,
    half: f64,
    clearing: f64,
) -> Result<(), usize> {
    let near = half.min(clearing + 3.5);
    for i in 0..count {
        let mut draw = Draw::new(seed, purpose, i);
        let z = draw.within(0.8, 1.6);
        let disc = [near, half]
            .into_iter()
            .find_map(|half| places.throw(&mut draw, half, MOVER_RADIUS_M, 0.1, MOVER_RADIUS_M, clearing))
            .ok_or(i)?;
        places.take(disc);
        out.mover(i, disc.x, disc.y, z);
    }
    Ok(())
}

/// Largest horizontal radius of a moving obstacle: the half diagonal of its box.
const MOVER_RADIUS_M: f64 = 0.283;

fn unit(v: [f64; 3]) -> [f64; 3] {
    let length = (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]).sqrt();
    v.map(|c| c / length)
}

// ------------------------------------------------------------------------------------------------ checks

/// Refuses values outside [low, high], NaN included.
fn check(
    kind: Kind,
    option: &'static str,
    found: f64,
    low: f64,
    high: f64,
    unit: &str,
) -> Result<(), GenerateError> {
    if (low..=high).contains(&found) {
        return Ok(());
    }
    let expected = format!("{} to {}{unit}", number(low), number(high));
    Err(GenerateError::OptionRange { kind, option, found, expected })
}

const MOST_THINGS: f64 = 20_000.0;
const MOST_MOVING: f64 = 1_000.0;

// ------------------------------------------------------------------------------------------------ a square of things

/// The square around the start that a forest or boxes fill.
struct Square {
    kind: Kind,
    size_m: f64,
    clearing_radius_m: f64,
    min_gap_m: f64,
}

impl Square {
    /// Refuses options out of range.
    fn check(&self) -> Result<(), GenerateError> {
        let (kind, half) = (self.kind, self.half());
        check(kind, "size_m", self.size_m, 4.0, 1_000.0, " m")?;
        let most = " m (half of size_m at most)";
        check(kind, "clearing_radius_m", self.clearing_radius_m, 0.5, half, most)?;
        check(kind, "min_gap_m", self.min_gap_m, 0.0, half, most)
    }

    /// Half of an edge, m.
    fn half(&self) -> f64 {
        0.5 * self.size_m
    }

    /// Only `fit` of the things find a place.
    fn too_many(&self, what: &'static str, wanted: usize, fit: usize) -> GenerateError {
        GenerateError::TooMany {
            kind: self.kind,
            what,
            wanted,
            fit,
            remedy: format!(
                "enlarge size_m (now {}), or lower min_gap_m (now {}) or clearing_radius_m (now {})",
                number(self.size_m),
                number(self.min_gap_m),
                number(self.clearing_radius_m)
            ),
        }
    }

    /// Its options as the head of the file states them.
    fn settings(&self) -> String {
        format!(
            "size_m {}, clearing_radius_m {}, min_gap_m {}",
            number(self.size_m),
            number(self.clearing_radius_m),
            number(self.min_gap_m)
        )
    }

    /// Cameras that see all of it.
    fn cameras(&self, out: &mut Mjcf) {
        let size = self.size_m;
        out.camera("overview", [-0.62 * size, -0.7 * size, 0.55 * size], [0.0; 3], 50.0);
        out.camera("top", [0.0, 0.0, 1.2 * size], [0.0; 3], 50.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand_chacha::ChaCha8Rng;
    use rand_chacha::rand_core::{Rng, SeedableRng};
    use roxmltree::{Document, Node};

    fn floats(node: Node, attribute: &str) -> Vec<f64> {
        let text = node.attribute(attribute).unwrap_or_else(|| panic!("{attribute} of {node:?}"));
        text.split(' ').map(|v| v.parse().unwrap()).collect()
    }

    fn is(node: &Node, tag: &str) -> bool {
        node.has_tag_name(tag)
    }

    /// Points on the surface's outline seen from above: (x, y, radius) discs in the world that together hold the geom.
    fn discs(body: Node, geom: Node) -> Vec<[f64; 3]> {
        let at = floats(body, "pos");
        let [c, s] = match body.attribute("xyaxes") {
            Some(_) => [floats(body, "xyaxes")[0], floats(body, "xyaxes")[1]],
            None => [1.0, 0.0],
        };
        let world = |p: &[f64]| [at[0] + c * p[0] - s * p[1], at[1] + s * p[0] + c * p[1]];
        let size = floats(geom, "size");
        if geom.has_attribute("fromto") {
            let ends = floats(geom, "fromto");
            return (0..=50)
                .map(|k| {
                    let t = f64::from(k) / 50.0;
                    let p: Vec<f64> = (0..3).map(|i| ends[i] + t * (ends[i + 3] - ends[i])).collect();
                    let [x, y] = world(&p);
                    [x, y, size[0]]
                })
                .collect();
        }
        let [x, y] = world(&floats(geom, "pos"));
        let radius = match geom.attribute("type").unwrap() {
            "box" => (size[0] * size[0] + size[1] * size[1]).sqrt(),
            "ellipsoid" => size[0].max(size[1]),
            _ => size[0],
        };
        vec![[x, y, radius]]
    }

    /// Every geom but the ground, with its body's name, its own, and its discs.
    fn things(xml: &str) -> Vec<(String, String, Vec<[f64; 3]>)> {
        let doc = Document::parse(xml).unwrap();
        let geoms: Vec<Node> = doc.descendants().filter(|n| is(n, "geom")).collect();
        geoms
            .into_iter()
            .filter(|g| g.attribute("name") != Some("ground"))
            .map(|g| {
                let body = g.parent().unwrap();
                let name = |n: Node| n.attribute("name").unwrap().to_string();
                (name(body), name(g), discs(body, g))
            })
            .collect()
    }

    #[test]
    fn the_same_options_give_the_same_text_and_another_seed_gives_another() {
        for seed in [0, 1, u64::MAX] {
            let o = ForestOptions { seed, ..Default::default() };
            assert_eq!(forest(&o).unwrap(), forest(&o).unwrap());
            let c = CorridorOptions { seed, ..Default::default() };
            assert_eq!(corridor(&c).unwrap(), corridor(&c).unwrap());
            let b = BoxesOptions { seed, ..Default::default() };
            assert_eq!(boxes(&b).unwrap(), boxes(&b).unwrap());
        }
        let bodies = |seed| {
            let text = forest(&ForestOptions { seed, ..Default::default() }).unwrap();
            text.split_once("<worldbody>").unwrap().1.to_string()
        };
        assert_ne!(bodies(0), bodies(1));
    }

    #[test]
    fn the_random_numbers_are_chacha8_keyed_by_seed_purpose_and_item() {
        let mut key = [0u8; 32];
        key[0] = 7;
        key[20..24].copy_from_slice(&0x5C_0002u32.to_le_bytes());
        key[24] = 9;
        let mut expected = ChaCha8Rng::from_seed(key);
        let mut draw = Draw::new(7, Purpose::ForestRock, 9);
        for _ in 0..5 {
            let bits = expected.next_u64() >> 11;
            assert_eq!(draw.unit(), bits as f64 / 9_007_199_254_740_992.0);
        }
    }

    #[test]
    fn the_first_trees_stay_when_more_are_asked_for() {
        let trees = |n| {
            let o = ForestOptions { trees: n, rocks: 0, logs: 0, moving: 0, ..Default::default() };
            let text = forest(&o).unwrap();
            text.split_once("material=\"ground\"/>").unwrap().1.to_string()
        };
        let (few, many) = (trees(20), trees(50));
        let few: Vec<&str> = few.lines().filter(|l| !l.contains("camera")).collect();
        let many: Vec<&str> = many.lines().filter(|l| !l.contains("camera")).collect();
        let shared = few.len() - 2; // without the closing tags of the world and the file
        assert_eq!(few[..shared], many[..shared]);
    }

    #[test]
    fn nothing_reaches_into_the_clearing() {
        for seed in 0..20 {
            for clearing_radius_m in [0.5, 1.0, 2.3] {
                let f = forest(&ForestOptions { seed, clearing_radius_m, trees: 45, ..Default::default() });
                let b = boxes(&BoxesOptions { seed, clearing_radius_m, count: 20, ..Default::default() });
                for (body, geom, discs) in things(&f.unwrap()).into_iter().chain(things(&b.unwrap())) {
                    for [x, y, r] in discs {
                        let free = (x * x + y * y).sqrt() - r;
                        assert!(
                            free > clearing_radius_m - 1e-3,
                            "seed {seed}: {body}/{geom} is {free} m near"
                        );
                    }
                }
            }
        }
    }

    #[test]
    fn trunks_keep_the_gap_at_every_height() {
        for (seed, min_gap_m) in [(0, 0.9), (1, 0.5), (2, 1.3), (3, 0.0)] {
            let o = ForestOptions { seed, min_gap_m, trees: 40, ..Default::default() };
            let trunks: Vec<_> =
                things(&forest(&o).unwrap()).into_iter().filter(|t| t.1.ends_with("_trunk")).collect();
            assert_eq!(trunks.len(), 40);
            let mut smallest = f64::INFINITY;
            for (i, a) in trunks.iter().enumerate() {
                for b in &trunks[..i] {
                    for [xa, ya, ra] in &a.2 {
                        for [xb, yb, rb] in &b.2 {
                            let gap = (xa - xb).hypot(ya - yb) - ra - rb;
                            smallest = smallest.min(gap);
                        }
                    }
                }
            }
            assert!(smallest > min_gap_m - 1e-3, "seed {seed}: {smallest}");
            assert!(smallest < min_gap_m + 1.0, "the gap asked for is not what limits: {smallest}");
        }
    }

    #[test]
    fn things_of_the_clutter_keep_the_gap() {
        let o = BoxesOptions { seed: 5, moving: 0, ..Default::default() };
        let all = things(&boxes(&o).unwrap());
        assert_eq!(all.len(), o.count);
        for (i, a) in all.iter().enumerate() {
            for b in &all[..i] {
                let ([xa, ya, ra], [xb, yb, rb]) = (a.2[0], b.2[0]);
                assert!((xa - xb).hypot(ya - yb) - ra - rb > o.min_gap_m - 1e-3, "{} and {}", a.0, b.0);
            }
        }
    }

    #[test]
    fn moving_obstacles_are_mocap_bodies_clear_of_all_trees() {
        let o = ForestOptions { seed: 4, moving: 6, rocks: 0, logs: 0, ..Default::default() };
        let text = forest(&o).unwrap();
        let doc = Document::parse(&text).unwrap();
        let mocap: Vec<_> = doc
            .descendants()
            .filter(|n| n.attribute("mocap") == Some("true"))
            .map(|n| n.attribute("name").unwrap().to_string())
            .collect();
        assert_eq!(mocap, (0..6).map(|i| format!("mover_{i}")).collect::<Vec<_>>());
        let all = things(&text);
        let (movers, trees): (Vec<_>, Vec<_>) = all.iter().partition(|t| t.0.starts_with("mover_"));
        for m in movers {
            for t in &trees {
                for [x, y, r] in &t.2 {
                    let gap = (x - m.2[0][0]).hypot(y - m.2[0][1]) - r - m.2[0][2];
                    assert!(gap > 0.0, "{} is in {}", m.0, t.1);
                }
            }
        }
    }

    #[test]
    fn names_are_unique_and_everything_has_one() {
        let texts = [
            forest(&ForestOptions { trees: 150, size_m: 30.0, ..Default::default() }).unwrap(),
            corridor(&CorridorOptions { length_m: 60.0, gates: 15, moving: 4, ..Default::default() })
                .unwrap(),
            boxes(&BoxesOptions { count: 130, size_m: 30.0, ..Default::default() }).unwrap(),
            track(&TrackOptions { moving: 3, ..Default::default() }).unwrap(),
            rooms(&RoomsOptions { moving: 2, room_m: 6.0, ..Default::default() }).unwrap(),
        ];
        for text in texts {
            let doc = Document::parse(&text).unwrap();
            for tag in ["geom", "body", "camera", "light"] {
                let mut names: Vec<_> = doc
                    .descendants()
                    .filter(|n| is(n, tag))
                    .map(|n| n.attribute("name").expect("a name"))
                    .collect();
                let all = names.len();
                names.sort_unstable();
                names.dedup();
                assert!(all > 0 && names.len() == all, "{tag}: {} of {all} names differ", names.len());
            }
        }
    }

    #[test]
    fn a_corridor_has_the_gates_asked_for_inside_its_walls() {
        let o = CorridorOptions { seed: 2, gates: 8, length_m: 40.0, width_m: 1.8, ..Default::default() };
        let text = corridor(&o).unwrap();
        let doc = Document::parse(&text).unwrap();
        let gates: Vec<_> = doc
            .descendants()
            .filter(|n| n.attribute("name").is_some_and(|v| is(n, "body") && v.starts_with("gate_")))
            .collect();
        assert_eq!(gates.len(), 8);
        let mut seen = 0;
        for gate in gates {
            for geom in gate.children().filter(|n| is(n, "geom")) {
                let sideways: Vec<f64> = if geom.has_attribute("fromto") {
                    let p = floats(geom, "fromto");
                    let r = floats(geom, "size")[0];
                    vec![p[1].abs() + r, p[4].abs() + r]
                } else {
                    vec![floats(geom, "pos")[1].abs() + floats(geom, "size")[1]]
                };
                for s in sideways {
                    seen += 1;
                    assert!(s < 0.5 * o.width_m, "{geom:?} reaches {s} m sideways");
                }
            }
        }
        assert!(seen >= 8 * 6);
    }

    #[test]
    fn gates_of_a_track_follow_each_other_counter_clockwise_and_point_onwards() {
        for seed in 0..20 {
            let o = TrackOptions { seed, gates: 9, ..Default::default() };
            let text = track(&o).unwrap();
            let doc = Document::parse(&text).unwrap();
            let gates: Vec<([f64; 2], [f64; 2])> = doc
                .descendants()
                .filter(|n| is(n, "body") && n.attribute("name").is_some_and(|v| v.starts_with("gate_")))
                .map(|g| {
                    let (at, x) = (floats(g, "pos"), floats(g, "xyaxes"));
                    let site = g.children().find(|n| is(n, "site")).expect("a site");
                    assert_eq!(site.attribute("name"), g.attribute("name"));
                    ([at[0], at[1]], [x[0], x[1]])
                })
                .collect();
            assert_eq!(gates.len(), 9);
            for (i, (at, along)) in gates.iter().enumerate() {
                let (next, _) = gates[(i + 1) % 9];
                let turn = at[0] * next[1] - at[1] * next[0];
                let onwards = (next[0] - at[0]) * along[0] + (next[1] - at[1]) * along[1];
                assert!(turn > 0.0 && onwards > 0.0, "seed {seed}, gate {i}");
                let r = (at[0] * at[0] + at[1] * at[1]).sqrt() / o.radius_m;
                assert!((1.0 - o.bend..=1.0 + o.bend).contains(&r), "seed {seed}, gate {i}: {r}");
            }
        }
    }

    #[test]
    fn every_room_can_be_reached_through_doors() {
        for seed in 0..50 {
            let o = RoomsOptions { seed, columns: 4, rows: 3, things: 0, ..Default::default() };
            let text = rooms(&o).unwrap();
            let doc = Document::parse(&text).unwrap();
            let mut reached: Vec<usize> = (0..12).collect();
            let room = |x: f64, y: f64| {
                (y / o.room_m).round() as usize * o.columns + (x / o.room_m).round() as usize
            };
            for site in doc.descendants().filter(|n| is(n, "site")) {
                let (at, size) = (floats(site, "pos"), floats(site, "size"));
                let across = if size[0] < size[1] { [0.6, 0.0] } else { [0.0, 0.6] };
                let (a, b) =
                    (room(at[0] - across[0], at[1] - across[1]), room(at[0] + across[0], at[1] + across[1]));
                assert_ne!(a, b, "a door joins two rooms");
                let (a, b) = (reached[a], reached[b]);
                reached.iter_mut().filter(|r| **r == b).for_each(|r| *r = a);
            }
            assert!(reached.iter().all(|r| *r == reached[0]), "seed {seed}: {reached:?}");
        }
    }

    #[test]
    fn the_default_options_fit_for_every_seed() {
        for seed in 0..200 {
            forest(&ForestOptions { seed, ..Default::default() }).unwrap();
            corridor(&CorridorOptions { seed, ..Default::default() }).unwrap();
            boxes(&BoxesOptions { seed, ..Default::default() }).unwrap();
            track(&TrackOptions { seed, ..Default::default() }).unwrap();
            rooms(&RoomsOptions { seed, ..Default::default() }).unwrap();
        }
    }

    #[test]
    fn absurd_options_are_refused_by_name() {
        let option = |e: GenerateError| match e {
            GenerateError::OptionRange { option, .. } => option,
            other => panic!("{other}"),
        };
        let d = ForestOptions::default;
        assert_eq!(option(forest(&ForestOptions { size_m: -5.0, ..d() }).unwrap_err()), "size_m");
        assert_eq!(option(forest(&ForestOptions { size_m: f64::NAN, ..d() }).unwrap_err()), "size_m");
        assert_eq!(option(forest(&ForestOptions { size_m: f64::INFINITY, ..d() }).unwrap_err()), "size_m");
        assert_eq!(option(forest(&ForestOptions { trees: usize::MAX, ..d() }).unwrap_err()), "trees");
        assert_eq!(option(forest(&ForestOptions { min_gap_m: -0.1, ..d() }).unwrap_err()), "min_gap_m");
        assert_eq!(
            option(forest(&ForestOptions { clearing_radius_m: 9.0, ..d() }).unwrap_err()),
            "clearing_radius_m"
        );
        let d = CorridorOptions::default;
        assert_eq!(option(corridor(&CorridorOptions { width_m: 0.5, ..d() }).unwrap_err()), "width_m");
        assert_eq!(option(corridor(&CorridorOptions { length_m: 1.0, ..d() }).unwrap_err()), "length_m");
        assert_eq!(option(corridor(&CorridorOptions { height_m: -1.0, ..d() }).unwrap_err()), "height_m");
        let d = BoxesOptions::default;
        assert_eq!(option(boxes(&BoxesOptions { count: 1_000_000, ..d() }).unwrap_err()), "count");
        let d = TrackOptions::default;
        assert_eq!(option(track(&TrackOptions { gates: 2, ..d() }).unwrap_err()), "gates");
        assert_eq!(option(track(&TrackOptions { gates: 200, ..d() }).unwrap_err()), "gates");
        assert_eq!(option(track(&TrackOptions { bend: f64::NAN, ..d() }).unwrap_err()), "bend");
        let d = RoomsOptions::default;
        assert_eq!(option(rooms(&RoomsOptions { door_m: 3.9, ..d() }).unwrap_err()), "door_m");
        assert_eq!(option(rooms(&RoomsOptions { columns: 0, ..d() }).unwrap_err()), "columns");
        let message =
            forest(&ForestOptions { size_m: -5.0, ..ForestOptions::default() }).unwrap_err().to_string();
        assert_eq!(message, "option size_m of a forest scene is -5: expected 4 to 1000 m");
    }

    #[test]
    fn too_many_trees_are_refused_with_the_number_that_fits_and_that_number_does_fit() {
        let o = ForestOptions { trees: 500, rocks: 0, logs: 0, moving: 0, ..Default::default() };
        let error = forest(&o).unwrap_err();
        let GenerateError::TooMany { what: "trees", wanted: 500, fit, .. } = error else { panic!("{error}") };
        assert!(fit > 50 && fit < 200, "{fit}");
        assert!(error.to_string().contains(&format!("only {fit} of 500 trees fit")), "{error}");
        assert!(error.to_string().contains("min_gap_m (now 0.9)"), "{error}");
        forest(&ForestOptions { trees: fit, ..o }).unwrap();
    }

    #[test]
    fn too_many_gates_are_refused_with_the_number_that_fits_and_that_number_does_fit() {
        let o = CorridorOptions { gates: 100, moving: 0, ..Default::default() };
        let error = corridor(&o).unwrap_err();
        let GenerateError::TooMany { wanted: 100, fit, .. } = error else { panic!("{error}") };
        corridor(&CorridorOptions { gates: fit, ..o.clone() }).unwrap();
        assert!(corridor(&CorridorOptions { gates: fit + 1, ..o }).is_err());
    }

    #[test]
    fn kinds_are_read_by_name_and_an_unknown_one_lists_them() {
        for kind in Kind::ALL {
            assert_eq!(kind.name().parse(), Ok(kind));
        }
        let error = "desert".parse::<Kind>().unwrap_err().to_string();
        assert_eq!(
            error,
            "unknown scene kind \"desert\": expected one of forest, corridor, boxes, track, rooms"
        );
    }

    #[test]
    fn numbers_have_no_minus_zero_and_no_idle_zeros() {
        assert_eq!(number(-0.000_01), "0");
        assert_eq!(number(1.5), "1.5");
        assert_eq!(number(-100.0), "-100");
        assert_eq!(number(2.0 / 3.0), "0.6667");
    }

    #[test]
    fn the_checked_in_forest_and_corridor_are_what_the_generator_writes() {
        let o = ForestOptions { seed: FOREST_SEED, ..Default::default() };
        assert!(forest(&o).unwrap() == include_str!("../../../xml/forest.xml"), "write xml/forest.xml again");
        let o = CorridorOptions { seed: CORRIDOR_SEED, ..Default::default() };
        assert!(
            corridor(&o).unwrap() == include_str!("../../../xml/corridor.xml"),
            "write xml/corridor.xml again"
        );
    }

    const FOREST_SEED: u64 = 7;
    const CORRIDOR_SEED: u64 = 1;
}
