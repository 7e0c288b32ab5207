//! A hall around the start and a winding corridor.

use super::{
    CorridorOptions, Draw, GenerateError, Kind, MOST_MOVING, MOVER_RADIUS_M, Mjcf, Purpose, check, number,
};

/// Half of the hall's edge, around the start, m: room for a flight of ±2 m before the corridor begins.
const HALL_HALF_M: f64 = 3.0;
/// Thickness of walls, m.
pub(super) const WALL_M: f64 = 0.1;
/// Distance between gates along the corridor, m.
const GATE_STEP_M: f64 = 1.2;
/// A straight piece is at least this much longer than the corridor is wide, m: corners stay apart and have room for a gate between them.
const SHORTEST_RUN_OVER_WIDTH_M: f64 = 1.6;
/// Thickness of a gate's bars, m.
pub(super) const BAR_M: f64 = 0.06;

/// A straight piece of the corridor: from `start` along `along`, which is a unit vector of an axis.
struct Run {
    start: [f64; 2],
    along: [f64; 2],
    length: f64,
}

impl Run {
    /// The point `s` m along the run and `side` m to its left.
    fn at(&self, s: f64, side: f64) -> [f64; 2] {
        let [c, n] = self.along;
        [self.start[0] + c * s - n * side, self.start[1] + n * s + c * side]
    }
}

/// Runs along +x and ±y by turns: the way never comes back, so it cannot cross itself.
fn corridor_path(o: &CorridorOptions) -> Vec<Run> {
    let mut draw = Draw::new(o.seed, Purpose::CorridorPath, 0);
    let shortest = o.width_m + SHORTEST_RUN_OVER_WIDTH_M;
    let mut runs: Vec<Run> = Vec::new();
    let (mut at, mut along, mut left) = ([HALL_HALF_M, 0.0], [1.0, 0.0], o.length_m);
    loop {
        let mut length = draw.within(shortest, shortest + 3.4);
        if left - length < shortest {
            length = left;
        }
        runs.push(Run { start: at, along, length });
        left -= length;
        if left <= 0.0 {
            return runs;
        }
        at = [at[0] + along[0] * length, at[1] + along[1] * length];
        along = match along {
            [1.0, 0.0] if draw.unit() < 0.5 => [0.0, 1.0],
            [1.0, 0.0] => [0.0, -1.0],
            _ => [1.0, 0.0],
        };
    }
}

/// A box on the ground between two corners of its footprint.
pub(super) fn wall(out: &mut Mjcf, name: &str, a: [f64; 2], b: [f64; 2], height: f64) {
    let half = [0.5 * (b[0] - a[0]).abs(), 0.5 * (b[1] - a[1]).abs(), 0.5 * height];
    let pos = [0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1]), 0.5 * height];
    out.geom(name, "box", &half, pos, "wall");
}

/// A gate: a frame around an opening, on posts.
pub(super) struct Gate {
    /// Foot, m.
    pub(super) at: [f64; 2],
    /// The way through, a unit vector: the x axis of the body.
    pub(super) along: [f64; 2],
    /// Half of the free width and height, m.
    pub(super) opening: f64,
    /// The opening's middle: to the left of the foot, and above the ground, m.
    pub(super) side: f64,
    pub(super) z: f64,
    /// An octagon of round bars; else a square.
    pub(super) octagon: bool,
}

impl Gate {
    /// One that fits into the corridor.
    fn in_corridor(at: [f64; 2], along: [f64; 2], draw: &mut Draw, o: &CorridorOptions) -> Self {
        let opening = draw.within(0.4, 0.5);
        let play = 0.5 * o.width_m - opening - BAR_M - 0.02;
        let side = draw.within(-play, play);
        let z = draw.within(0.8, (o.height_m - opening - BAR_M).min(1.5));
        Self { at, along, opening, side, z, octagon: draw.unit() < 0.5 }
    }
}

/// Writes a gate, with a site of its name that fills the opening: what a race looks for. Its x axis is the way through.
pub(super) fn gate(out: &mut Mjcf, name: &str, gate: &Gate) {
    let Gate { at, along, opening, side, z, octagon } = *gate;
    let frame = opening + 0.5 * BAR_M; // to the middle of the bars
    let b = 0.5 * BAR_M;
    out.open(name, [at[0], at[1], 0.0], along);
    out.site(name, [b, opening, opening], [0.0, side, z]);
    if octagon {
        // The apothem is `frame`; half of a side is frame tan 22.5 degrees = frame (sqrt 2 - 1).
        let k = frame * (std::f64::consts::SQRT_2 - 1.0);
        let corners = [
            (frame, k),
            (k, frame),
            (-k, frame),
            (-frame, k),
            (-frame, -k),
            (-k, -frame),
            (k, -frame),
            (frame, -k),
        ];
        for i in 0..8 {
            let ((y0, z0), (y1, z1)) = (corners[i], corners[(i + 1) % 8]);
            let (from, to) = ([0.0, side + y0, z + z0], [0.0, side + y1, z + z1]);
            out.stick(&format!("{name}_bar_{i}"), "capsule", b, from, to, "gate_round");
        }
    } else {
        let long = opening + BAR_M;
        out.geom(&format!("{name}_left"), "box", &[b, b, long], [0.0, side + frame, z], "gate_square");
        out.geom(&format!("{name}_right"), "box", &[b, b, long], [0.0, side - frame, z], "gate_square");
        out.geom(&format!("{name}_top"), "box", &[b, opening, b], [0.0, side, z + frame], "gate_square");
        out.geom(&format!("{name}_bottom"), "box", &[b, opening, b], [0.0, side, z - frame], "gate_square");
    }
    // Posts carry the frame at its lower corners.
    let (foot, top) =
        if octagon { (frame * (std::f64::consts::SQRT_2 - 1.0), z - frame) } else { (frame, z - frame) };
    for (end, y) in [("left", side + foot), ("right", side - foot)] {
        out.stick(&format!("{name}_post_{end}"), "capsule", 0.02, [0.0, y, 0.0], [0.0, y, top], "post");
    }
    out.close();
}

/// A hall around the start and a winding corridor with gates and overhead beams, as MJCF text. Flight begins along +x.
///
/// # Errors
///
/// An option out of range, or more gates and moving obstacles than fit along the corridor.
pub fn corridor(options: &CorridorOptions) -> Result<String, GenerateError> {
    let kind = Kind::Corridor;
    let o = options;
    check(kind, "width_m", o.width_m, 1.4, 5.0, " m (5 m so that it leaves the hall through one wall)")?;
    check(kind, "height_m", o.height_m, 2.0, 20.0, " m")?;
    let shortest = o.width_m + SHORTEST_RUN_OVER_WIDTH_M;
    check(kind, "length_m", o.length_m, shortest, 2_000.0, " m (width_m + 1.6 m at least)")?;
    check(kind, "gates", o.gates as f64, 0.0, MOST_MOVING, "")?;
    check(kind, "moving", o.moving as f64, 0.0, MOST_MOVING, "")?;

    let runs = corridor_path(o);
    let slots = slots(o, &runs);
    let wanted = o.gates + o.moving;
    if wanted > slots.len() {
        return Err(GenerateError::TooMany {
            kind,
            what: "gates and moving obstacles together",
            wanted,
            fit: slots.len(),
            remedy: format!(
                "enlarge length_m (now {}) or lower width_m (now {})",
                number(o.length_m),
                number(o.width_m)
            ),
        });
    }
    let chosen = choose(o, slots.len());
    let mut out = begin(o, &runs);
    build_hall(o, &mut out);
    for r in 0..runs.len() {
        build_run(o, &mut out, &runs, r);
    }
    for (i, &slot) in chosen[..o.gates].iter().enumerate() {
        let (r, s) = slots[slot];
        let mut draw = Draw::new(o.seed, Purpose::CorridorGate, i);
        let at = runs[r].at(s + draw.within(-0.15, 0.15), 0.0);
        gate(&mut out, &format!("gate_{i:02}"), &Gate::in_corridor(at, runs[r].along, &mut draw, o));
    }
    let w = 0.5 * o.width_m;
    for (i, &slot) in chosen[o.gates..wanted].iter().enumerate() {
        let (r, s) = slots[slot];
        let mut draw = Draw::new(o.seed, Purpose::CorridorMover, i);
        let play = w - MOVER_RADIUS_M;
        let [x, y] = runs[r].at(s, draw.within(-play, play));
        out.mover(i, x, y, draw.within(0.8, 1.5));
    }
    Ok(out.end())
}

/// Slots for gates and moving obstacles (run, place along it): evenly along each run, out of the corners.
fn slots(o: &CorridorOptions, runs: &[Run]) -> Vec<(usize, f64)> {
    let w = 0.5 * o.width_m;
    let mut slots = Vec::new();
    for (r, run) in runs.iter().enumerate() {
        let low = if r == 0 { 0.5 } else { w + 0.2 };
        let free = run.length - low - if r + 1 == runs.len() { 0.6 } else { w + 0.2 };
        let n = ((free / GATE_STEP_M).floor() as usize).max(usize::from(free >= 0.0));
        let step = free / n.max(1) as f64;
        slots.extend((0..n).map(|k| (r, low + (k as f64 + 0.5) * step)));
    }
    slots
}

/// A random choice of slots without repetition: the first `wanted` cards of a shuffled pack; gates in the order in which they are flown
/// through, then moving obstacles.
fn choose(o: &CorridorOptions, n_slots: usize) -> Vec<usize> {
    let mut pack: Vec<usize> = (0..n_slots).collect();
    let mut draw = Draw::new(o.seed, Purpose::CorridorSlots, 0);
    for i in 0..o.gates + o.moving {
        let j = i + draw.below(pack.len() - i);
        pack.swap(i, j);
    }
    pack[..o.gates].sort_unstable();
    pack
}

/// The head of the file: what it is, its light, its materials, and cameras that see the whole way.
fn begin(o: &CorridorOptions, runs: &[Run]) -> Mjcf {
    let w = 0.5 * o.width_m;
    let settings = format!(
        "seed {}, gates {}, moving {}, length_m {}, width_m {}, height_m {}",
        o.seed,
        o.gates,
        o.moving,
        number(o.length_m),
        number(o.width_m),
        number(o.height_m)
    );
    let (mut min, mut max) = ([-HALL_HALF_M; 2], [HALL_HALF_M; 2]);
    for run in runs {
        for axis in 0..2 {
            let end = run.at(run.length, 0.0)[axis];
            min[axis] = min[axis].min(end - w);
            max[axis] = max[axis].max(end + w);
        }
    }
    let middle = [0.5 * (min[0] + max[0]), 0.5 * (min[1] + max[1]), 0.0];
    let span = (max[0] - min[0]).max(max[1] - min[1]);
    let mut out = Mjcf::begin(
        Kind::Corridor,
        "A hall around the start and a winding corridor with gates to fly through, overhead beams and moving obstacles. No ceiling.",
        &settings,
        0.6 * span,
        [[0.30, 0.36, 0.45], [0.75, 0.78, 0.82]],
        [[0.46, 0.46, 0.48], [0.41, 0.41, 0.43]],
        &[
            ("wall", [0.80, 0.79, 0.75]),
            ("gate_square", [0.90, 0.45, 0.10]),
            ("gate_round", [0.15, 0.45, 0.80]),
            ("post", [0.25, 0.26, 0.28]),
            ("beam", [0.50, 0.34, 0.22]),
            ("pipe", [0.60, 0.62, 0.66]),
        ],
    );
    let from = [middle[0] - 0.35 * span, middle[1] - 0.75 * span, 0.8 * span];
    out.camera("overview", from, middle, 55.0);
    out.camera("top", [middle[0], middle[1], 1.3 * span], middle, 55.0);
    out
}

/// The hall; its wall towards +x leaves the corridor's mouth open.
fn build_hall(o: &CorridorOptions, out: &mut Mjcf) {
    let w = 0.5 * o.width_m;
    let (h, t, height) = (HALL_HALF_M, WALL_M, o.height_m);
    out.open("hall", [0.0; 3], [1.0, 0.0]);
    wall(out, "hall_back", [-h - t, -h - t], [-h, h + t], height);
    wall(out, "hall_left", [-h, h], [h, h + t], height);
    wall(out, "hall_right", [-h, -h - t], [h, -h], height);
    wall(out, "hall_front_left", [h, w], [h + t, h + t], height);
    wall(out, "hall_front_right", [h, -h - t], [h + t, -w], height);
    let (corner, side) = (h - 0.4, h - 0.2);
    let columns = [
        (-corner, -corner),
        (-corner, corner),
        (corner, corner),
        (corner, -corner),
        (0.0, side),
        (0.0, -side),
    ];
    for (i, (x, y)) in columns.into_iter().enumerate() {
        let at = [x, y, 0.5 * height];
        out.geom(&format!("hall_column_{i}"), "cylinder", &[0.12, 0.5 * height], at, "pipe");
    }
    out.close();
}

/// One straight piece: its walls, and beams and pipes overhead.
fn build_run(o: &CorridorOptions, out: &mut Mjcf, runs: &[Run], r: usize) {
    out.open(&format!("run_{r:02}"), [0.0; 3], [1.0, 0.0]);
    build_walls(o, out, runs, r);
    hang_beams(o, out, &runs[r], r);
    out.close();
}

/// Walls on both sides of a run, and behind the last one.
fn build_walls(o: &CorridorOptions, out: &mut Mjcf, runs: &[Run], r: usize) {
    let (run, w, t, height) = (&runs[r], 0.5 * o.width_m, WALL_M, o.height_m);
    let turn = |a: &Run, b: &Run| a.along[0] * b.along[1] - a.along[1] * b.along[0]; // +1 to the left, -1 to the right
    let turn_in = r.checked_sub(1).map_or(0.0, |before| turn(&runs[before], run));
    let turn_out = runs.get(r + 1).map_or(0.0, |after| turn(run, after));
    for (end, side) in [("left", 1.0), ("right", -1.0)] {
        // At a corner the wall on the inside of the turn ends half a width before the centre line's corner, the outer one half a width after.
        // Where two walls meet, the one before fills the corner.
        let (inner_in, outer_out) = (side * turn_in > 0.0, side * turn_out < 0.0);
        let first = if r == 0 { t } else { side * turn_in * w + if inner_in { t } else { 0.0 } };
        let last = run.length - side * turn_out * w + if outer_out { t } else { 0.0 };
        let name = format!("run_{r:02}_{end}");
        wall(out, &name, run.at(first, side * w), run.at(last, side * (w + t)), height);
    }
    if r + 1 == runs.len() {
        wall(out, "end", run.at(run.length, -w - t), run.at(run.length + t, w + t), height);
    }
}

/// Overhead beams and pipes, from wall to wall.
fn hang_beams(o: &CorridorOptions, out: &mut Mjcf, run: &Run, r: usize) {
    let (w, height) = (0.5 * o.width_m, o.height_m);
    let mut draw = Draw::new(o.seed, Purpose::CorridorBeam, r);
    for i in 0..1 + draw.below(2) {
        let s = draw.within(w + 0.2, run.length - w - 0.2);
        let z = draw.within((0.82 * height).max(1.8), height - 0.1);
        let (a, b) = (run.at(s, w), run.at(s, -w));
        let name = format!("run_{r:02}_beam_{i}");
        if i == 0 {
            let half = [(0.5 * (a[0] - b[0]).abs()).max(0.06), (0.5 * (a[1] - b[1]).abs()).max(0.06), 0.08];
            out.geom(&name, "box", &half, [0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1]), z], "beam");
        } else {
            out.stick(&name, "cylinder", 0.04, [a[0], a[1], z], [b[0], b[1], z], "pipe");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_corridor_is_as_long_as_asked_and_never_meets_itself() {
        for seed in 0..50 {
            let o = CorridorOptions { seed, length_m: 40.0, ..Default::default() };
            let runs = corridor_path(&o);
            let length: f64 = runs.iter().map(|r| r.length).sum();
            assert!((length - 40.0).abs() < 1e-9);
            assert!(runs.len() >= 3);
            // Free space of a run, seen from above; runs that are not neighbours must not touch, walls included.
            let hull = |r: &Run| {
                let (a, b) = (r.at(0.0, 0.0), r.at(r.length, 0.0));
                let w = 0.5 * o.width_m + WALL_M;
                [a[0].min(b[0]) - w, a[1].min(b[1]) - w, a[0].max(b[0]) + w, a[1].max(b[1]) + w]
            };
            for (i, a) in runs.iter().enumerate() {
                for b in runs.iter().skip(i + 2) {
                    let (p, q) = (hull(a), hull(b));
                    let apart = p[2] < q[0] || q[2] < p[0] || p[3] < q[1] || q[3] < p[1];
                    assert!(apart, "seed {seed}");
                }
            }
        }
    }
}
