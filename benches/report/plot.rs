//! Steps per second by the number of worlds, a panel for each control mode.

use propwash::picture::{Anchor, Canvas, Effort, Ink};
use serde_json::Value;

use super::common::Fallible;

const SIZE: [u32; 2] = [1600, 640];
const DARK: Ink = [28, 32, 38];
const SOFT: Ink = [96, 104, 116];
const GRID: Ink = [226, 229, 234];
/// Ours and the peer's: blue and vermilion of M. Okabe and K. Ito, "Color Universal Design", 2008.
const INKS: [Ink; 2] = [[0, 114, 178], [213, 94, 0]];
/// Names in JSON and on the picture.
const WHO: [(&str, &str); 2] = [("propwash", "Propwash"), ("crazyflow", "Crazyflow")];
const PRECISIONS: [&str; 2] = ["f32", "f64"];

/// Number of worlds at which the picture states the ratio.
const RATIO_AT: f64 = 1024.0;

/// Values along an axis from 10^low to 10^high, and where they are in pixels.
struct Axis {
    low: f64,
    high: f64,
    from: f32,
    to: f32,
}

impl Axis {
    fn at(&self, value: f64) -> f32 {
        let share = (value.log10() - self.low) / (self.high - self.low);
        self.from + (self.to - self.from) * share as f32
    }

    fn decades(&self) -> impl Iterator<Item = i32> + use<> {
        self.low.ceil() as i32..=self.high.floor() as i32
    }
}

/// The picture, from the lines that `steps` wrote, as PNG.
pub fn picture(lines: &[Value]) -> Fallible<Vec<u8>> {
    let rows: Vec<&Value> =
        lines.iter().filter(|l| l["table"] == "rates").filter_map(|l| l.get("row")).collect();
    let mut modes: Vec<&str> = Vec::new();
    for mode in rows.iter().filter_map(|row| row["mode"].as_str()) {
        if !modes.contains(&mode) {
            modes.push(mode);
        }
    }
    let rates = rows.iter().flat_map(|row| WHO.iter().filter_map(|(name, _)| row[name].as_f64()));
    let (least, most) = rates.fold((f64::INFINITY, 0.0f64), |(low, high), v| (low.min(v), high.max(v)));
    let largest = rows.iter().filter_map(|row| row["worlds"].as_f64()).fold(1.0, f64::max);
    if modes.is_empty() || least <= 0.0 {
        return Err("no rates in what `steps` wrote: run it with the part `rates`".into());
    }
    let mut canvas = Canvas::new(SIZE[0], SIZE[1], [255; 3])?;
    let title = "Steps per second on one core, by the number of worlds";
    canvas.text([70.0, 52.0], 28.0, true, DARK, Anchor::Start, title);
    let machine = machine(lines);
    canvas.text([SIZE[0] as f32 - 20.0, 52.0], 18.0, false, SOFT, Anchor::End, &machine);
    legend(&mut canvas);
    let left = 110.0;
    let pitch = (SIZE[0] as f32 - left - 20.0) / modes.len() as f32;
    for (k, mode) in modes.iter().enumerate() {
        let x = left + pitch * k as f32;
        let across = Axis { low: 0.0, high: largest.log10() + 0.1, from: x + 14.0, to: x + pitch - 40.0 };
        let up = Axis {
            low: (1e6 * least).log10().floor(),
            high: (1e6 * most).log10().ceil(),
            from: 548.0,
            to: 150.0,
        };
        grid(&mut canvas, &across, &up, k == 0);
        canvas.text([across.from, up.to - 14.0], 20.0, true, DARK, Anchor::Start, mode);
        for (precision, dashed) in PRECISIONS.into_iter().zip([false, true]) {
            for ((name, _), ink) in WHO.into_iter().zip(INKS) {
                let points: Vec<[f32; 2]> = rows
                    .iter()
                    .filter(|row| row["mode"] == *mode && row["precision"] == precision)
                    .filter_map(|row| Some((row["worlds"].as_f64()?, row[name].as_f64()?)))
                    .map(|(worlds, rate)| [across.at(worlds), up.at(1e6 * rate)])
                    .collect();
                canvas.line(&points, ink, 3.0, dashed);
                points.iter().for_each(|point| marker(&mut canvas, *point, ink, dashed));
            }
        }
        gap(&mut canvas, &rows, mode, &across, &up);
    }
    canvas.text([0.5 * SIZE[0] as f32, 622.0], 19.0, false, SOFT, Anchor::Middle, "worlds");
    Ok(canvas.png(Effort::Best)?)
}

/// Machine, version and day of what is shown.
fn machine(lines: &[Value]) -> String {
    let head = lines.iter().find_map(|line| line.get("head"));
    let word = |key: &str| head.and_then(|h| h[key].as_str()).unwrap_or("?").to_string();
    let cores = head.and_then(|h| h["cores"].as_u64()).unwrap_or(0);
    format!("{}, {cores} cores; Propwash {}; {}", word("processor"), word("propwash"), word("date"))
}

/// How many times as fast ours is as the peer, between their lines in f32 at the number of worlds [`RATIO_AT`].
fn gap(canvas: &mut Canvas, rows: &[&Value], mode: &str, across: &Axis, up: &Axis) {
    let row = rows.iter().find(|row| {
        row["mode"] == mode && row["precision"] == PRECISIONS[0] && row["worlds"].as_f64() == Some(RATIO_AT)
    });
    let rate = |who: usize| row.and_then(|row| row[WHO[who].0].as_f64());
    let (Some(ours), Some(peer)) = (rate(0), rate(1)) else { return };
    let (x, from, to) = (across.at(RATIO_AT), up.at(1e6 * peer) - 10.0, up.at(1e6 * ours) + 10.0);
    canvas.line(&[[x, from], [x, to]], SOFT, 1.5, false);
    canvas.text(
        [x + 10.0, 0.3 * from + 0.7 * to + 26.0],
        19.0,
        true,
        DARK,
        Anchor::Start,
        &format!("{:.0} ×", ours / peer),
    );
}

/// A disc; hollow ones are white inside.
fn marker(canvas: &mut Canvas, at: [f32; 2], ink: Ink, hollow: bool) {
    canvas.disc(at, 6.0, ink);
    if hollow {
        canvas.disc(at, 0.55 * 6.0, [255; 3]);
    }
}

fn legend(canvas: &mut Canvas) {
    let mut x = 70.0;
    for ((_, who), ink) in WHO.into_iter().zip(INKS) {
        for (precision, dashed) in PRECISIONS.into_iter().zip([false, true]) {
            canvas.line(&[[x, 86.0], [x + 46.0, 86.0]], ink, 3.0, dashed);
            marker(canvas, [x + 23.0, 86.0], ink, dashed);
            let words = format!("{who}, {precision}");
            x += 56.0 + canvas.text([x + 56.0, 93.0], 19.0, false, DARK, Anchor::Start, &words) + 34.0;
        }
    }
}

fn grid(canvas: &mut Canvas, across: &Axis, up: &Axis, labels: bool) {
    for decade in up.decades() {
        let y = up.at(10f64.powi(decade));
        canvas.line(&[[across.from - 8.0, y], [across.to, y]], GRID, 1.5, false);
        if labels {
            canvas.text([across.from - 16.0, y + 6.0], 18.0, false, SOFT, Anchor::End, &power(decade));
        }
    }
    for decade in across.decades() {
        let x = across.at(10f64.powi(decade));
        canvas.line(&[[x, up.from], [x, up.to]], GRID, 1.5, false);
        let words = if decade < 4 { 10u32.pow(decade as u32).to_string() } else { power(decade) };
        canvas.text([x, up.from + 28.0], 18.0, false, SOFT, Anchor::Middle, &words);
    }
    canvas.line(&[[across.from - 8.0, up.from], [across.to, up.from]], SOFT, 1.5, false);
}

/// Powers of ten in words that need no small digits: `100 k`, `10 M`.
fn power(decade: i32) -> String {
    let letter = match decade.div_euclid(3) {
        0 => "",
        1 => " k",
        2 => " M",
        3 => " G",
        _ => return format!("1e{decade}"),
    };
    format!("{}{letter}", 10u32.pow(decade.rem_euclid(3) as u32))
}
