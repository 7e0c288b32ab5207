//! Scenes that benchmarks share.

use std::fmt::Write as _;

use propwash::random::{Key, Stream, purpose};

/// A floor and `n − 1` trunks, crowns, rocks and posts, as dense for any number.
pub fn forest(n: usize, assets: &str, more: &str) -> String {
    let mut s = draws(n as u64);
    let reach = 2.0 * (n as f64).sqrt();
    let mut geoms = String::from("<geom type='plane' size='0 0 1'/>");
    for k in 1..n {
        let (x, y) = (s.uniform(-reach, reach), s.uniform(-reach, reach));
        let (r, h) = (s.uniform(0.1, 0.3), s.uniform(1.0, 2.5));
        let _ = match k % 5 {
            0 => write!(geoms, "<geom type='cylinder' size='{r} {h}' pos='{x} {y} {h}'/>"),
            1 => write!(geoms, "<geom type='capsule' size='{r} {h}' pos='{x} {y} {h}'/>"),
            2 => write!(geoms, "<geom type='sphere' size='{}' pos='{x} {y} {h}'/>", 3.0 * r),
            3 => write!(
                geoms,
                "<geom type='box' size='{r} {} {h}' pos='{x} {y} {h}' euler='0 0 {}'/>",
                2.0 * r,
                90.0 * r
            ),
            _ => {
                write!(geoms, "<geom type='ellipsoid' size='{} {} {h}' pos='{x} {y} {h}'/>", 2.0 * r, 3.0 * r)
            }
        };
    }
    // MJX fails in a scene without a material.
    format!(
        "<mujoco><asset><material name='paint'/>{assets}</asset><worldbody>{geoms}{more}</worldbody></mujoco>"
    )
}

/// Heights of `n` × `n` samples.
pub fn hills(n: usize) -> String {
    let mut out = String::new();
    for row in 0..n {
        for col in 0..n {
            let (x, y) = (row as f64 * 0.13, col as f64 * 0.11);
            let _ = write!(out, "{:.4} ", 0.5 + 0.25 * (x.sin() + y.cos() * (0.4 * x + y).sin()));
        }
    }
    out
}

/// Random numbers for a purpose of the caller.
pub fn draws(step: u64) -> Stream {
    Key { seed: 1, world: 0, drone: 0, step, purpose: purpose("forest of the depth benchmark") }.stream()
}
