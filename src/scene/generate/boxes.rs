//! Clutter: boxes, pillars, slabs and floating blocks.

use super::{
    BoxesOptions, Draw, GenerateError, Kind, MOST_MOVING, MOST_THINGS, Mjcf, Places, Purpose, Square, check,
    movers,
};

/// Boxes, pillars, slabs and floating blocks, as MJCF text.
///
/// # Errors
///
/// An option out of range, or more things than find a place.
pub fn boxes(options: &BoxesOptions) -> Result<String, GenerateError> {
    let o = options;
    let square = Square {
        kind: Kind::Boxes,
        size_m: o.size_m,
        clearing_radius_m: o.clearing_radius_m,
        min_gap_m: o.min_gap_m,
    };
    square.check()?;
    check(square.kind, "count", o.count as f64, 0.0, MOST_THINGS, "")?;
    check(square.kind, "moving", o.moving as f64, 0.0, MOST_MOVING, "")?;
    let mut out = Mjcf::begin(
        square.kind,
        "Clutter: boxes, pillars, slabs and floating blocks, with a clearing around the start.",
        &format!("seed {}, count {}, moving {}, {}", o.seed, o.count, o.moving, square.settings()),
        0.7 * o.size_m,
        [[0.45, 0.55, 0.70], [0.90, 0.90, 0.92]],
        [[0.62, 0.62, 0.64], [0.55, 0.55, 0.58]],
        &[
            ("paint_0", [0.80, 0.30, 0.28]),
            ("paint_1", [0.25, 0.50, 0.75]),
            ("paint_2", [0.92, 0.76, 0.30]),
            ("paint_3", [0.32, 0.60, 0.42]),
            ("paint_4", [0.58, 0.44, 0.70]),
        ],
    );
    square.cameras(&mut out);

    let mut places = Places::new(o.min_gap_m.max(1.0));
    let digits = o.count.saturating_sub(1).max(100).to_string().len();
    for i in 0..o.count {
        let mut draw = Draw::new(o.seed, Purpose::BoxesThing, i);
        let heading = draw.direction();
        let material = format!("paint_{}", draw.below(5));
        let (name, shape, size, z) = thing(&mut draw);
        let radius = if shape == "box" { (size[0] * size[0] + size[1] * size[1]).sqrt() } else { size[0] };
        let place = places.throw(&mut draw, square.half(), radius, o.min_gap_m, radius, o.clearing_radius_m);
        let disc = place.ok_or_else(|| square.too_many("boxes", o.count, i))?;
        places.take(disc);
        let name = format!("{name}_{i:0digits$}");
        out.open(&name, [disc.x, disc.y, z], heading);
        out.geom(&name, shape, &size, [0.0; 3], &material);
        out.close();
    }
    if let Err(fit) = movers(
        &mut out,
        &mut places,
        o.seed,
        Purpose::BoxesMover,
        o.moving,
        square.half(),
        o.clearing_radius_m,
    ) {
        return Err(square.too_many("moving obstacles", o.moving, fit));
    }
    Ok(out.end())
}

/// A thing: what it is, its shape, its half sizes and the height of its centre, m.
fn thing(draw: &mut Draw) -> (&'static str, &'static str, Vec<f64>, f64) {
    match draw.below(4) {
        0 => {
            let size = [draw.within(0.15, 0.45), draw.within(0.15, 0.45), draw.within(0.15, 0.9)];
            ("box", "box", size.to_vec(), size[2])
        }
        1 => {
            let tall = draw.within(0.8, 1.6);
            ("pillar", "cylinder", vec![draw.within(0.08, 0.25), tall], tall)
        }
        2 => {
            let size = [draw.within(0.4, 0.8), draw.within(0.03, 0.08), draw.within(0.4, 1.2)];
            ("slab", "box", size.to_vec(), size[2])
        }
        _ => {
            let size = [draw.within(0.1, 0.35), draw.within(0.1, 0.35), draw.within(0.1, 0.3)];
            ("floating", "box", size.to_vec(), draw.within(0.7, 2.0))
        }
    }
}
