//! One frame: what the sensor may see, near to far, and the packets of rays through it.

use fearless_simd::prelude::*;
use fearless_simd::{Level, dispatch, f32x16, f64x8, i32x16};

use super::lanes::{Lanes, none};
use super::pattern::{Exact, RayPattern, Tile};
use super::placed::Placed;
use super::tree::Stack;
use super::{RayFilter, Rays, capsule, cuboid, cylinder, ellipsoid, plane, sphere};
use crate::broad::groups::Rounds;
use crate::kind::GeomType;
use crate::shape::round::Round;
use crate::table::{Geom, Table};
use propwash_trace::lanes::vectorize;

/// Where results go; each is optional.
#[derive(Default)]
pub(crate) struct Sink<'a> {
    pub depth: Option<&'a mut [f32]>,
    pub status: Option<&'a mut [u8]>,
    pub geom: Option<&'a mut [i32]>,
    pub body: Option<&'a mut [i32]>,
    /// Distance along the ray, whatever the rule; infinite for a miss.
    pub range: Option<&'a mut [f32]>,
}

/// A geom that the sensor may see.
#[derive(Clone, Copy)]
struct Entry {
    /// No surface of it is nearer, m.
    near: f32,
    id: u32,
    /// In the sensor's frame.
    round: Round,
}

/// Buffers that frames reuse.
#[derive(Default)]
pub(crate) struct Buffers {
    entries: Vec<Entry>,
    rounds: Rounds,
    near: Vec<f32>,
    /// Where in `placed` an entry is; `LATER` until a tile needs it.
    slot: Vec<u32>,
    placed: Vec<Placed<f32>>,
}

const LATER: u32 = u32::MAX;

pub(crate) fn level() -> Level {
    static LEVEL: std::sync::OnceLock<Level> = std::sync::OnceLock::new();
    *LEVEL.get_or_init(Level::new)
}

/// The processor's lanes that are used, for benchmarks and reports, e.g. `Avx512`.
pub fn lanes_in_use() -> String {
    let text = format!("{:?}", level());
    text.split('(').next().unwrap_or_default().to_string()
}

/// Casts all rays of a pattern.
pub(crate) fn cast(job: &Rays, buffers: &mut Buffers, sink: &mut Sink) {
    cast_at(level(), job, buffers, sink);
}

/// With the lanes of a level.
pub(crate) fn cast_at(level: Level, job: &Rays, buffers: &mut Buffers, sink: &mut Sink) {
    dispatch!(level, simd => vectorize(simd, #[inline(always)] || run(simd, job, buffers, sink)));
}

#[inline(always)]
fn run<S: Simd>(simd: S, job: &Rays, buffers: &mut Buffers, sink: &mut Sink) {
    gather(simd, job, buffers);
    let like = f32x16::splat(simd, 0.0);
    let mut stack = Stack::new(like);
    let pattern = job.pattern;
    for (index, tile) in pattern.tiles.iter().enumerate() {
        let packets = &pattern.packets[4 * index..4 * index + 4];
        let mut d = [[like; 3]; 4];
        for part in 0..4 {
            for k in 0..3 {
                d[part][k] = f32x16::simd_from(simd, packets[part][k]);
            }
        }
        let mut best = [none(like); 4];
        let mut ids = [f32x16::splat(simd, -1.0); 4];
        trace(simd, job, buffers, index, tile, &d, &mut stack, &mut best, &mut ids);
        for part in 0..4 {
            let place = match &pattern.exact {
                Exact::Image(pinhole) => {
                    let (width, height) = (pinhole.width, pinhole.height);
                    let across = width.div_ceil(8);
                    let row = 8 * (index / across) + 4 * (part / 2);
                    let col = 8 * (index % across) + 4 * (part % 2);
                    if row >= height || col >= width {
                        continue;
                    }
                    Place {
                        at: row * width + col,
                        rows: 4.min(height - row),
                        cols: 4.min(width - col),
                        width,
                    }
                }
                Exact::List(_) => {
                    let at = 64 * index + 16 * part;
                    if at >= pattern.n {
                        continue;
                    }
                    Place { at, rows: 1, cols: 16.min(pattern.n - at), width: 16 }
                }
            };
            vectorize(
                simd,
                #[inline(always)]
                || store(simd, job, &place, d[part][2], best[part], ids[part], sink),
            );
        }
    }
}

/// Fills the list of geoms that the pattern as a whole may meet, near to far.
#[inline(always)]
fn gather<S: Simd>(simd: S, job: &Rays, buffers: &mut Buffers) {
    let table = job.table;
    // For all geoms at once, so that no later frame needs more.
    let most = table.still.rays.ids.len() + table.moving.len();
    buffers.entries.clear();
    buffers.entries.reserve(most);
    let o = job.origin_m;
    let from = [o[0] as f32, o[1] as f32, o[2] as f32];
    // What rounding of the origin may hide.
    let slack = 1e-6 * (o[0].abs() + o[1].abs() + o[2].abs());
    let mut sides = [[0.0f32; 3]; 4];
    for (side, own) in sides.iter_mut().zip(&job.pattern.sides) {
        for i in 0..3 {
            let r = &job.frame[i];
            side[i] = (r[0] * f64::from(own[0]) + r[1] * f64::from(own[1]) + r[2] * f64::from(own[2])) as f32;
        }
    }
    let fixed = &table.still.rays;
    for many in 0..fixed.groups.groups() {
        let mut groups = inside(simd, &fixed.groups, many, &sides, from, slack as f32);
        while groups != 0 {
            let group = 16 * many + groups.trailing_zeros() as usize;
            groups &= groups - 1;
            let mut bits = inside(simd, &fixed.rounds, group, &sides, from, slack as f32);
            while bits != 0 {
                let k = 16 * group + bits.trailing_zeros() as usize;
                bits &= bits - 1;
                let at = |column: usize| f64::from(fixed.rounds.data[column][k]);
                let round =
                    Round { centre: [at(0), at(1), at(2)], half: [at(3), at(4), at(5)], radius: at(6) };
                enter(job, buffers, fixed.ids[k], round, slack);
            }
        }
    }
    for &id in &table.moving {
        let shape = &table.geoms[id as usize];
        let round = shape.round.placed(job.poses.geom_pos_m[id as usize], &job.poses.geom_mat[id as usize]);
        let mut seen = true;
        for side in &sides {
            let mut centre = round.radius + slack;
            let mut half = 0.0;
            for k in 0..3 {
                centre += f64::from(side[k]) * (round.centre[k] - o[k]);
                half += f64::from(side[k]) * round.half[k];
            }
            seen &= centre + half.abs() >= 0.0;
        }
        if seen {
            enter(job, buffers, id, round, slack);
        }
    }
    buffers.entries.sort_unstable_by(|a, b| a.near.total_cmp(&b.near).then(a.id.cmp(&b.id)));
    buffers.rounds.clear();
    buffers.rounds.reserve(most);
    buffers.near.clear();
    buffers.near.reserve(most);
    buffers.slot.clear();
    buffers.slot.reserve(most);
    buffers.placed.clear();
    buffers.placed.reserve(most);
    for entry in &buffers.entries {
        buffers.rounds.push(&entry.round);
        buffers.near.push(entry.near);
        buffers.slot.push(LATER);
    }
    buffers.rounds.pad();
}

fn enter(job: &Rays, buffers: &mut Buffers, id: u32, round: Round, slack: f64) {
    let shape = &job.table.geoms[id as usize];
    if !job.filter.sees(shape) {
        return;
    }
    let o = job.origin_m;
    let mut near = round.distance(o);
    if shape.kind == GeomType::Plane {
        let (pos, mat) = (&job.poses.geom_pos_m[id as usize], &job.poses.geom_mat[id as usize]);
        let above = mat[2] * (o[0] - pos[0]) + mat[5] * (o[1] - pos[1]) + mat[8] * (o[2] - pos[2]);
        if above < 0.0 {
            return;
        }
        near = near.max(above);
    }
    let mut own = Round { centre: [0.0; 3], half: [0.0; 3], radius: round.radius + slack };
    for i in 0..3 {
        for j in 0..3 {
            own.centre[i] += job.frame[j][i] * (round.centre[j] - o[j]);
            own.half[i] += job.frame[j][i] * round.half[j];
        }
    }
    let near = (near - slack) * (1.0 - 1e-6);
    buffers.entries.push(Entry { near: near as f32, id, round: own });
}

/// Which of sixteen reach into a pyramid with its tip at `from`.
#[inline(always)]
fn inside<S: Simd>(
    simd: S,
    rounds: &Rounds,
    group: usize,
    sides: &[[f32; 3]; 4],
    from: [f32; 3],
    slack: f32,
) -> u32 {
    let at = 16 * group;
    let x = f32x16::from_slice(simd, &rounds.data[0][at..at + 16]) - from[0];
    let y = f32x16::from_slice(simd, &rounds.data[1][at..at + 16]) - from[1];
    let z = f32x16::from_slice(simd, &rounds.data[2][at..at + 16]) - from[2];
    let u = f32x16::from_slice(simd, &rounds.data[3][at..at + 16]);
    let v = f32x16::from_slice(simd, &rounds.data[4][at..at + 16]);
    let w = f32x16::from_slice(simd, &rounds.data[5][at..at + 16]);
    let radius = f32x16::from_slice(simd, &rounds.data[6][at..at + 16]) + slack;
    let mut least = none(x);
    for n in sides {
        let centre = z.fma(x.all(n[2]), y.fma(x.all(n[1]), x * n[0]));
        let half = w.fma(x.all(n[2]), v.fma(x.all(n[1]), u * n[0]));
        least = Lanes::min(least, centre + Lanes::abs(half));
    }
    <f32x16<S> as Lanes>::bits(Lanes::le(x.lit(0.0), least + radius))
}

/// The nearest surface along the rays of a tile.
#[inline(always)]
fn trace<S: Simd>(
    simd: S,
    job: &Rays,
    buffers: &mut Buffers,
    index: usize,
    tile: &Tile,
    d: &[[f32x16<S>; 3]; 4],
    stack: &mut Stack<f32x16<S>>,
    best: &mut [f32x16<S>; 4],
    ids: &mut [f32x16<S>; 4],
) {
    for group in 0..buffers.rounds.groups() {
        if !still_open(buffers.near[16 * group], best) {
            return;
        }
        let mut bits = inside(simd, &buffers.rounds, group, &tile.sides, [0.0; 3], 0.0);
        while bits != 0 {
            let entry = 16 * group + bits.trailing_zeros() as usize;
            bits &= bits - 1;
            if !still_open(buffers.near[entry], best) {
                return;
            }
            if buffers.slot[entry] == LATER {
                let id = buffers.entries[entry].id as usize;
                buffers.slot[entry] = buffers.placed.len() as u32;
                let (pos, mat) = (job.poses.geom_pos_m[id], &job.poses.geom_mat[id]);
                let placed = Placed::new(&job.table.geoms[id], pos, mat, job.origin_m, &job.frame, id);
                buffers.placed.push(placed);
            }
            let g = &buffers.placed[buffers.slot[entry] as usize];
            meet(simd, job, g, index, tile, d, stack, best, ids);
        }
    }
}

/// The surfaces of one geom along the rays of a tile, where they are nearer than what was found.
#[inline(always)]
fn meet<S: Simd>(
    simd: S,
    job: &Rays,
    g: &Placed<f32>,
    index: usize,
    tile: &Tile,
    d: &[[f32x16<S>; 3]; 4],
    stack: &mut Stack<f32x16<S>>,
    best: &mut [f32x16<S>; 4],
    ids: &mut [f32x16<S>; 4],
) {
    match g.kind {
        GeomType::Sphere => {
            for part in 0..4 {
                closer(g.id, sphere::hit(g, d[part]), &mut best[part], &mut ids[part]);
            }
        }
        GeomType::Capsule => {
            for part in 0..4 {
                closer(g.id, capsule::hit(g, d[part]), &mut best[part], &mut ids[part]);
            }
        }
        GeomType::Ellipsoid => {
            for part in 0..4 {
                closer(g.id, ellipsoid::hit(g, d[part]), &mut best[part], &mut ids[part]);
            }
        }
        GeomType::Cylinder => {
            for part in 0..4 {
                closer(g.id, cylinder::hit(g, d[part]), &mut best[part], &mut ids[part]);
            }
        }
        GeomType::Box => {
            for part in 0..4 {
                closer(g.id, cuboid::hit(g, d[part]), &mut best[part], &mut ids[part]);
            }
        }
        GeomType::Plane => {
            if faces_away(g, tile) {
                return;
            }
            for part in 0..4 {
                let dz = along(simd, g.up64, job.pattern, 4 * index + part, d[part][2]);
                closer(g.id, plane::hit(g, d[part], dz), &mut best[part], &mut ids[part]);
            }
        }
        GeomType::Mesh => {
            let mesh = &job.table.meshes[g.asset as usize];
            for part in 0..4 {
                let t = vectorize(
                    simd,
                    #[inline(always)]
                    || mesh.hit(g, d[part], best[part], stack, None),
                );
                closer(g.id, t, &mut best[part], &mut ids[part]);
            }
        }
        GeomType::Hfield => {
            let field = &job.table.hfields[g.asset as usize];
            for part in 0..4 {
                let t = vectorize(
                    simd,
                    #[inline(always)]
                    || field.hit(g, d[part], best[part]),
                );
                closer(g.id, t, &mut best[part], &mut ids[part]);
            }
        }
        GeomType::Sdf => {}
    }
}

/// Some ray may still find something at this distance.
#[inline(always)]
fn still_open<S: Simd>(near: f32, best: &[f32x16<S>; 4]) -> bool {
    let far = Lanes::max(Lanes::max(best[0], best[1]), Lanes::max(best[2], best[3]));
    <f32x16<S> as Lanes>::any(Lanes::le(far.all(near), far))
}

/// Keeps the nearer surface; of two at the same distance that of the lower id, as MuJoCo does.
#[inline(always)]
fn closer<S: Simd>(id: f32, t: f32x16<S>, best: &mut f32x16<S>, ids: &mut f32x16<S>) {
    let id = t.all(id);
    let yes = Lanes::lt(t, *best) | (Lanes::le(t, *best) & Lanes::lt(id, *ids));
    *best = Lanes::pick(yes, t, *best);
    *ids = Lanes::pick(yes, id, *ids);
}

/// No ray of the tile runs against the plane's normal.
#[inline(always)]
fn faces_away(g: &Placed<f32>, tile: &Tile) -> bool {
    let Some(edges) = &tile.edges else { return false };
    let n = g.turn[2];
    let mut away = true;
    for e in edges {
        away &= n[0] * e[0] + n[1] * e[1] + n[2] * e[2] > 1e-6;
    }
    away
}

/// Component of a packet's directions along a vector, computed in f64. `d2` is their component along the sensor's z.
#[inline(always)]
fn along<S: Simd>(simd: S, up: [f64; 3], pattern: &RayPattern, packet: usize, d2: f32x16<S>) -> f32x16<S> {
    match &pattern.exact {
        Exact::List(packets) => {
            let wide = &packets[packet];
            let mut low = f64x8::splat(simd, 0.0);
            let mut high = low;
            for k in 0..3 {
                let n = f64x8::splat(simd, up[k]);
                low = f64x8::from_slice(simd, &wide[k][..8]).mul_add(n, low);
                high = f64x8::from_slice(simd, &wide[k][8..]).mul_add(n, high);
            }
            low.narrow(high)
        }
        Exact::Image(pinhole) => {
            // Of (x, y, −1), whose terms may cancel; its length, which takes no digits away, is −1 / d2.
            let (x, y) = pinhole.packet(packet / 4, packet % 4);
            let base =
                f64x8::from_slice(simd, x).mul_add(f64x8::splat(simd, up[0]), f64x8::splat(simd, -up[2]));
            let n = f64x8::splat(simd, up[1]);
            let low = f64x8::from_slice(simd, &y[0]).mul_add(n, base);
            let high = f64x8::from_slice(simd, &y[1]).mul_add(n, base);
            low.narrow(high) * -d2
        }
    }
}

/// Lanes `4 r ..` go to `cols` results from `at + r × width` on; a list has one row of up to sixteen.
struct Place {
    at: usize,
    rows: usize,
    cols: usize,
    width: usize,
}

impl Place {
    #[inline(always)]
    fn put<T: Copy>(&self, from: &[T; 16], to: &mut [T]) {
        if self.cols == 4 && self.rows == 4 {
            for r in 0..4 {
                let at = self.at + r * self.width;
                to[at..at + 4].copy_from_slice(&from[4 * r..4 * r + 4]);
            }
        } else if self.cols == 16 {
            to[self.at..self.at + 16].copy_from_slice(from);
        } else {
            for r in 0..self.rows {
                for k in 0..self.cols {
                    to[self.at + r * self.width + k] = from[4 * r + k];
                }
            }
        }
    }
}

#[inline(always)]
fn store<S: Simd>(
    simd: S,
    job: &Rays,
    place: &Place,
    dz: f32x16<S>,
    t: f32x16<S>,
    ids: f32x16<S>,
    sink: &mut Sink,
) {
    let rule = &job.rule;
    // A face on which the sensor lies may be at −0.
    let t = t + t.lit(0.0);
    if let Some(range) = &mut sink.range {
        place.put(&t.into(), range);
    }
    let infinite = none(t);
    let hit = Lanes::lt(t, infinite);
    if sink.depth.is_some() || sink.status.is_some() {
        let value = if rule.z_depth { Lanes::pick(hit, t * -dz, infinite) } else { t };
        let near = Lanes::lt(value, f32x16::splat(simd, rule.near));
        let far = Lanes::lt(f32x16::splat(simd, rule.far), value);
        if let Some(depth) = &mut sink.depth {
            let shown = Lanes::pick(near, value.lit(0.0), Lanes::pick(far, infinite, value));
            place.put(&shown.into(), depth);
        }
        if let Some(status) = &mut sink.status {
            // See `Planes::status`.
            let code = near
                .select(i32x16::splat(simd, 3), far.select(i32x16::splat(simd, 2), i32x16::splat(simd, 0)));
            let code = hit.select(code, i32x16::splat(simd, 1));
            let half = code.narrow(code);
            let bytes: [i8; 64] = half.narrow(half).into();
            let mut own = [0u8; 16];
            for k in 0..16 {
                own[k] = bytes[k] as u8;
            }
            place.put(&own, status);
        }
    }
    if sink.geom.is_some() || sink.body.is_some() {
        let geoms: [i32; 16] = i32x16::truncate_from(ids).into();
        if let Some(geom) = &mut sink.geom {
            place.put(&geoms, geom);
        }
        if let Some(body) = &mut sink.body {
            let table = &job.table.bodies;
            let mut bodies = [table[(geoms[0] + 1) as usize]; 16];
            if ids.simd_eq(ids.all(ids.lane(0))).any_false() {
                for k in 1..16 {
                    bodies[k] = table[(geoms[k] + 1) as usize];
                }
            }
            place.put(&bodies, body);
        }
    }
}

/// Groups of sixteen static geoms whose balls a ray may meet, for single rays. `found` gets the ids.
pub(crate) fn candidates(
    table: &Table,
    filter: &RayFilter,
    origin: [f64; 3],
    direction: [f64; 3],
    found: &mut Vec<u32>,
) {
    found.clear();
    dispatch!(level(), simd => vectorize(simd, #[inline(always)] || along_ray(simd, table, filter, origin, direction, found)));
}

#[inline(always)]
fn along_ray<S: Simd>(
    simd: S,
    table: &Table,
    filter: &RayFilter,
    origin: [f64; 3],
    direction: [f64; 3],
    found: &mut Vec<u32>,
) {
    let slack = (1e-6 * (origin[0].abs() + origin[1].abs() + origin[2].abs())) as f32;
    let o = [origin[0] as f32, origin[1] as f32, origin[2] as f32];
    let d = [direction[0] as f32, direction[1] as f32, direction[2] as f32];
    let fixed = &table.still.rays;
    for many in 0..fixed.groups.groups() {
        let mut groups = near_ray(simd, &fixed.groups, many, o, d, slack);
        while groups != 0 {
            let group = 16 * many + groups.trailing_zeros() as usize;
            groups &= groups - 1;
            let mut bits = near_ray(simd, &fixed.rounds, group, o, d, slack);
            while bits != 0 {
                let id = fixed.ids[16 * group + bits.trailing_zeros() as usize];
                bits &= bits - 1;
                if filter.sees(&table.geoms[id as usize]) {
                    found.push(id);
                }
            }
        }
    }
    for &id in &table.moving {
        let shape: &Geom = &table.geoms[id as usize];
        if filter.sees(shape) {
            found.push(id);
        }
    }
}

/// Which of sixteen geoms a ray may meet.
#[inline(always)]
fn near_ray<S: Simd>(simd: S, rounds: &Rounds, group: usize, o: [f32; 3], d: [f32; 3], slack: f32) -> u32 {
    let at = 16 * group;
    let x = f32x16::from_slice(simd, &rounds.data[0][at..at + 16]) - o[0];
    let y = f32x16::from_slice(simd, &rounds.data[1][at..at + 16]) - o[1];
    let z = f32x16::from_slice(simd, &rounds.data[2][at..at + 16]) - o[2];
    let u = f32x16::from_slice(simd, &rounds.data[3][at..at + 16]);
    let v = f32x16::from_slice(simd, &rounds.data[4][at..at + 16]);
    let w = f32x16::from_slice(simd, &rounds.data[5][at..at + 16]);
    let half = Lanes::sqrt(w.fma(w, v.fma(v, u * u)));
    let far = Lanes::abs(x) + Lanes::abs(y) + Lanes::abs(z);
    let radius = f32x16::from_slice(simd, &rounds.data[6][at..at + 16]) + half + far * 1e-6 + slack;
    let ahead = x * d[0] + y * d[1] + z * d[2];
    let (a, b, c) = (y * d[2] - z * d[1], z * d[0] - x * d[2], x * d[1] - y * d[0]);
    let aside = a * a + b * b + c * c;
    let zero = x.lit(0.0);
    <f32x16<S> as Lanes>::bits(
        Lanes::le(aside, radius * radius) & Lanes::le(-radius, ahead) & Lanes::le(zero, radius),
    )
}
