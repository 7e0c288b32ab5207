//! A forest.

mod tree;

use super::{
    Disc, Draw, ForestOptions, GenerateError, Kind, MOST_MOVING, MOST_THINGS, Mjcf, Places, Purpose, Square,
    TRIES, check, movers,
};
use tree::Tree;

/// A forest as MJCF text.
///
/// # Errors
///
/// An option out of range, or more trees, rocks, logs or moving obstacles than find a place.
pub fn forest(options: &ForestOptions) -> Result<String, GenerateError> {
    let o = options;
    let square = Square {
        kind: Kind::Forest,
        size_m: o.size_m,
        clearing_radius_m: o.clearing_radius_m,
        min_gap_m: o.min_gap_m,
    };
    square.check()?;
    check(square.kind, "trees", o.trees as f64, 0.0, MOST_THINGS, "")?;
    check(square.kind, "rocks", o.rocks as f64, 0.0, MOST_THINGS, "")?;
    check(square.kind, "logs", o.logs as f64, 0.0, MOST_THINGS, "")?;
    check(square.kind, "moving", o.moving as f64, 0.0, MOST_MOVING, "")?;
    let mut out = begin(o, &square);
    square.cameras(&mut out);
    // What is on the ground, and the same with crowns and branches, for the moving obstacles.
    let mut trunks = Places::new(o.min_gap_m.max(1.0));
    let mut wholes = Places::new(1.0);
    plant_trees(o, &square, &mut out, &mut trunks, &mut wholes)?;
    // Rocks and logs lie between the trunks: they keep off them and off each other, but need no gap to fly through.
    lay_rocks(o, &square, &mut out, &mut trunks)?;
    lay_logs(o, &square, &mut out, &mut trunks)?;
    if let Err(fit) = movers(
        &mut out,
        &mut wholes,
        o.seed,
        Purpose::ForestMover,
        o.moving,
        square.half(),
        o.clearing_radius_m,
    ) {
        return Err(square.too_many("moving obstacles", o.moving, fit));
    }
    Ok(out.end())
}

/// The head of the file: what it is, its light and its materials.
fn begin(o: &ForestOptions, square: &Square) -> Mjcf {
    let settings = format!(
        "seed {}, trees {}, rocks {}, logs {}, moving {}, {}",
        o.seed,
        o.trees,
        o.rocks,
        o.logs,
        o.moving,
        square.settings()
    );
    Mjcf::begin(
        square.kind,
        "A forest: trees of six shapes, rocks, fallen logs and moving obstacles, with a clearing around the start.",
        &settings,
        0.7 * o.size_m,
        [[0.50, 0.70, 0.90], [0.93, 0.94, 0.90]],
        [[0.33, 0.40, 0.24], [0.29, 0.36, 0.21]],
        &[
            ("bark", [0.36, 0.26, 0.18]),
            ("bark_birch", [0.88, 0.87, 0.82]),
            ("bark_dead", [0.52, 0.47, 0.42]),
            ("needles", [0.11, 0.30, 0.19]),
            ("leaves", [0.24, 0.45, 0.16]),
            ("leaves_light", [0.50, 0.62, 0.22]),
            ("rock", [0.55, 0.54, 0.52]),
        ],
    )
}

/// Trees, apart from each other by their trunks.
fn plant_trees(
    o: &ForestOptions,
    square: &Square,
    out: &mut Mjcf,
    trunks: &mut Places,
    wholes: &mut Places,
) -> Result<(), GenerateError> {
    let digits = o.trees.saturating_sub(1).max(100).to_string().len();
    for i in 0..o.trees {
        let mut draw = Draw::new(o.seed, Purpose::ForestTree, i);
        let tree = Tree::draw(&mut draw);
        let place = trunks.throw(
            &mut draw,
            square.half(),
            tree.trunk_reach,
            o.min_gap_m,
            tree.reach,
            o.clearing_radius_m,
        );
        let disc = place.ok_or_else(|| square.too_many("trees", o.trees, i))?;
        trunks.take(disc);
        wholes.take(Disc { radius: tree.reach, ..disc });
        tree.write(out, &format!("{}_{i:0digits$}", tree.shape), disc.x, disc.y);
    }
    Ok(())
}

/// Rocks.
fn lay_rocks(
    o: &ForestOptions,
    square: &Square,
    out: &mut Mjcf,
    trunks: &mut Places,
) -> Result<(), GenerateError> {
    for i in 0..o.rocks {
        let mut draw = Draw::new(o.seed, Purpose::ForestRock, i);
        let size = [draw.within(0.12, 0.4), draw.within(0.12, 0.4), draw.within(0.1, 0.3)];
        let radius = size[0].max(size[1]);
        let heading = draw.direction();
        let place = trunks.throw(&mut draw, square.half(), radius, 0.05, radius, o.clearing_radius_m);
        let disc = place.ok_or_else(|| square.too_many("rocks", o.rocks, i))?;
        trunks.take(disc);
        let name = format!("rock_{i:02}");
        out.open(&name, [disc.x, disc.y, 0.0], heading);
        out.geom(&name, "ellipsoid", &size, [0.0, 0.0, 0.3 * size[2]], "rock");
        out.close();
    }
    Ok(())
}

/// Fallen logs.
fn lay_logs(
    o: &ForestOptions,
    square: &Square,
    out: &mut Mjcf,
    trunks: &mut Places,
) -> Result<(), GenerateError> {
    for i in 0..o.logs {
        let mut draw = Draw::new(o.seed, Purpose::ForestLog, i);
        let (radius, half_length) = (draw.within(0.06, 0.14), draw.within(0.5, 1.2));
        let name = format!("log_{i:02}");
        let found = free_row(&mut draw, square, trunks, radius, half_length);
        let (row, [x, y], along) = found.ok_or_else(|| square.too_many("logs", o.logs, i))?;
        row.into_iter().for_each(|disc| trunks.take(disc));
        out.open(&name, [x, y, 0.0], along);
        out.stick(
            &name,
            "capsule",
            radius,
            [-half_length, 0.0, 0.9 * radius],
            [half_length, 0.0, 0.9 * radius],
            "bark",
        );
        out.close();
    }
    Ok(())
}

/// A free place for a log as a row of discs, each as free as a rock: the row, its middle and its direction.
fn free_row(
    draw: &mut Draw,
    square: &Square,
    trunks: &Places,
    radius: f64,
    half_length: f64,
) -> Option<([Disc; 7], [f64; 2], [f64; 2])> {
    let (half, step) = (square.half(), half_length / 3.0);
    let disc_radius = radius + 0.5 * step;
    let inside = |d: &Disc| {
        d.x.abs() <= half
            && d.y.abs() <= half
            && (d.x * d.x + d.y * d.y).sqrt() >= square.clearing_radius_m + d.radius
    };
    for _ in 0..TRIES {
        let (x, y) = (draw.within(-half, half), draw.within(-half, half));
        let [c, s] = draw.direction();
        let row = [-3.0, -2.0, -1.0, 0.0, 1.0, 2.0, 3.0].map(|k: f64| {
            let along = k * step;
            Disc { x: x + c * along, y: y + s * along, radius: disc_radius }
        });
        if row.iter().all(|d| inside(d) && trunks.is_free(d, 0.0)) {
            return Some((row, [x, y], [c, s]));
        }
    }
    None
}
