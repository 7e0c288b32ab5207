//! Trees of six shapes.

use crate::scene::generate::{Draw, Mjcf};

const SHAPES: [&str; 6] = ["pine", "oak", "birch", "poplar", "dead", "bush"];

/// A tree before it has a place. Lengths in m.
pub(super) struct Tree {
    pub(super) shape: &'static str,
    height: f64,
    trunk_radius: f64,
    /// How far the trunk's top is off its foot, in the body's frame.
    lean: [f64; 2],
    heading: [f64; 2],
    /// Disc that holds the whole trunk seen from above.
    pub(super) trunk_reach: f64,
    /// Disc that holds the whole tree seen from above.
    pub(super) reach: f64,
    parts: Vec<Part>,
}

/// A crown (ellipsoid) or a branch (capsule) of a tree, in the body's frame.
enum Part {
    Crown { size: [f64; 3], pos: [f64; 3], material: &'static str },
    Branch { radius: f64, from: [f64; 3], to: [f64; 3] },
}

impl Part {
    /// Radius of the disc around the body's axis that holds the part, seen from above.
    fn reach(&self) -> f64 {
        let off = |p: &[f64; 3]| (p[0] * p[0] + p[1] * p[1]).sqrt();
        match self {
            Part::Crown { size, pos, .. } => off(pos) + size[0].max(size[1]),
            Part::Branch { radius, from, to } => off(from).max(off(to)) + radius,
        }
    }
}

/// The trunk of a tree that is being drawn.
struct Trunk {
    height: f64,
    /// How far its top is off its foot.
    lean: [f64; 2],
}

impl Trunk {
    /// A point on its axis at a fraction of its height.
    fn axis(&self, fraction: f64) -> [f64; 3] {
        [self.lean[0] * fraction, self.lean[1] * fraction, self.height * fraction]
    }
}

impl Tree {
    /// A tree of a shape, a size and a heading by chance.
    pub(super) fn draw(draw: &mut Draw) -> Self {
        // Of ten trees: three pines, two oaks, two birches, one each of the others.
        let shape = SHAPES[[0, 0, 0, 1, 1, 2, 2, 3, 4, 5][draw.below(10)]];
        let heading = draw.direction();
        let (height, trunk_radius, lean) = match shape {
            "pine" => (draw.within(2.6, 4.6), draw.within(0.07, 0.13), draw.within(0.0, 0.05)),
            "oak" => (draw.within(2.2, 3.2), draw.within(0.10, 0.18), draw.within(0.0, 0.12)),
            "birch" => (draw.within(2.8, 3.8), draw.within(0.04, 0.07), draw.within(0.0, 0.20)),
            "poplar" => (draw.within(3.4, 5.2), draw.within(0.06, 0.10), draw.within(0.0, 0.05)),
            "dead" => (draw.within(1.8, 3.0), draw.within(0.06, 0.12), draw.within(0.05, 0.25)),
            _ => (draw.within(0.3, 0.6), draw.within(0.03, 0.05), 0.0),
        };
        let lean_to = draw.direction().map(|c| c * lean);
        let trunk = Trunk { height, lean: lean_to };
        let parts = match shape {
            "pine" => pine(draw, &trunk),
            "oak" => oak(draw, &trunk),
            "birch" => birch(draw, &trunk),
            "poplar" => poplar(draw, &trunk),
            "dead" => dead(draw, &trunk),
            _ => bush(draw, &trunk),
        };
        let trunk_reach = trunk_radius + lean;
        let reach = parts.iter().map(Part::reach).fold(trunk_reach, f64::max);
        Tree { shape, height, trunk_radius, lean: lean_to, heading, trunk_reach, reach, parts }
    }

    /// Writes it as a body whose foot is at (x, y).
    pub(super) fn write(&self, out: &mut Mjcf, name: &str, x: f64, y: f64) {
        out.open(name, [x, y, 0.0], self.heading);
        let bark = match self.shape {
            "birch" => "bark_birch",
            "dead" => "bark_dead",
            _ => "bark",
        };
        let top = [self.lean[0], self.lean[1], self.height];
        out.stick(&format!("{name}_trunk"), "capsule", self.trunk_radius, [0.0; 3], top, bark);
        for (i, part) in self.parts.iter().enumerate() {
            match part {
                Part::Crown { size, pos, material } => {
                    out.geom(&format!("{name}_crown_{i}"), "ellipsoid", size, *pos, material);
                }
                Part::Branch { radius, from, to } => {
                    out.stick(&format!("{name}_branch_{i}"), "capsule", *radius, *from, *to, bark);
                }
            }
        }
        out.close();
    }
}

/// Tiers, each narrower than the one below.
fn pine(draw: &mut Draw, trunk: &Trunk) -> Vec<Part> {
    let mut parts = Vec::new();
    let tiers = 3 + draw.below(2);
    let (widest, lowest) = (draw.within(0.55, 0.85), draw.within(0.25, 0.4));
    for tier in 0..tiers {
        let t = tier as f64 / tiers as f64;
        let radius = widest * (1.0 - 0.75 * t);
        let thick = 0.62 * (1.0 - lowest) * trunk.height / tiers as f64;
        let pos = trunk.axis(lowest + (1.0 - lowest) * (t + 0.5 / tiers as f64));
        parts.push(Part::Crown { size: [radius, radius, thick], pos, material: "needles" });
    }
    parts
}

/// Crowns around the top, and a low branch that reaches out at the height of flight.
fn oak(draw: &mut Draw, trunk: &Trunk) -> Vec<Part> {
    let mut parts = Vec::new();
    for i in 0..3 + draw.below(2) {
        let radius = draw.within(0.45, 0.75);
        let [c, s] = draw.direction();
        let off = if i == 0 { 0.0 } else { draw.within(0.25, 0.5) };
        let top = trunk.axis(1.0);
        let pos = [top[0] + c * off, top[1] + s * off, top[2] + draw.within(-0.15, 0.35)];
        let material = if i % 2 == 0 { "leaves" } else { "leaves_light" };
        parts.push(Part::Crown { size: [radius, radius, 0.8 * radius], pos, material });
    }
    let [c, s] = draw.direction();
    let (from, out) = (trunk.axis(draw.within(0.4, 0.6)), draw.within(0.5, 0.8));
    let to = [from[0] + c * out, from[1] + s * out, from[2] + 0.35 * out];
    parts.push(Part::Branch { radius: 0.035, from, to });
    parts
}

/// One slender crown.
fn birch(draw: &mut Draw, trunk: &Trunk) -> Vec<Part> {
    let mut parts = Vec::new();
    let radius = draw.within(0.35, 0.5);
    let size = [radius, radius, draw.within(0.7, 1.0)];
    parts.push(Part::Crown { size, pos: trunk.axis(0.85), material: "leaves_light" });
    parts
}

/// One tall crown.
fn poplar(draw: &mut Draw, trunk: &Trunk) -> Vec<Part> {
    let mut parts = Vec::new();
    let radius = draw.within(0.3, 0.42);
    let size = [radius, radius, 0.44 * trunk.height];
    parts.push(Part::Crown { size, pos: trunk.axis(0.58), material: "leaves" });
    parts
}

/// Bare branches.
fn dead(draw: &mut Draw, trunk: &Trunk) -> Vec<Part> {
    let mut parts = Vec::new();
    for _ in 0..2 + draw.below(4) {
        let from = trunk.axis(draw.within(0.3, 0.95));
        let [c, s] = draw.direction();
        let out = draw.within(0.3, 0.8);
        let to = [from[0] + c * out, from[1] + s * out, from[2] + draw.within(0.1, 0.5) * out];
        parts.push(Part::Branch { radius: draw.within(0.015, 0.035), from, to });
    }
    parts
}

/// Low crowns, hardly a trunk.
fn bush(draw: &mut Draw, trunk: &Trunk) -> Vec<Part> {
    let mut parts = Vec::new();
    for i in 0..2 + draw.below(2) {
        let radius = draw.within(0.25, 0.42);
        let [c, s] = draw.direction();
        let off = if i == 0 { 0.0 } else { draw.within(0.15, 0.3) };
        let pos = [c * off, s * off, 0.75 * radius + trunk.height * 0.3];
        parts.push(Part::Crown { size: [radius, radius, 0.85 * radius], pos, material: "leaves" });
    }
    parts
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_shape_of_tree_grows_in_a_large_forest() {
        let o = crate::scene::generate::ForestOptions { trees: 300, size_m: 40.0, ..Default::default() };
        let text = crate::scene::generate::forest(&o).unwrap();
        for shape in SHAPES {
            assert!(text.contains(&format!("<body name=\"{shape}_")), "no {shape}");
        }
    }
}
