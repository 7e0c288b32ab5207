//! The formulas that are tried: along some axes of the body or of the world, a coefficient times products of at most two
//! quantities of flight, with at most one inner scale.
//!
//! Every quantity has a unit, so that coefficient and scale get theirs, and functions see ratios only.

use super::units::{Powers, RATIO};

/// A quantity of flight as expressions read it.
#[derive(Clone, Debug)]
pub(super) struct Quantity {
    /// In the language of expressions.
    pub text: String,
    /// For readers.
    pub words: &'static str,
    pub unit: Powers,
}

/// What a formula is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Acts {
    /// A force along axes of the body.
    ForceBody,
    /// A force along axes of the world.
    ForceWorld,
    /// A torque about axes of the body.
    Torque,
    /// A change of the thrust of all rotors, as a share of it: a force along their axes, and the torque by which they steer.
    Thrust,
}

/// A formula without values: `c` is its coefficient, `s` its inner scale.
#[derive(Clone, Debug)]
pub(super) struct Shape {
    pub acts: Acts,
    /// Axes on which it acts, `xy`.
    pub axes: &'static [usize],
    /// Expressions of those axes, without the coefficient.
    pub texts: Vec<String>,
    /// What the scale divides, for its start values: the same quantities, without a scale.
    pub scaled: Option<Vec<String>>,
    /// Unit of the scale; turning in rad/s.
    pub scale_words: &'static str,
    /// Whether the logs can tell the scale from the coefficient.
    pub tells_scale: bool,
    /// Unit of the formula without its coefficient.
    pub unit: Powers,
    /// For readers, with `{s}` in place of the scale.
    pub words: String,
    /// Physics that looks like it.
    pub like: &'static str,
    /// Number of quantities, functions and scales: what it costs to say.
    pub cost: f64,
}

const SPEED: Powers = [1, 0, -1];
const RATE: Powers = [0, 0, -1];
const FORCE: Powers = [1, 1, -2];

/// Name of the size of a motion along its own axis.
const OWN_SIZE: &str = "own size";

/// Airspeed; the added square keeps the slope at rest finite.
const AIRSPEED: &str = "sqrt(vx_body^2 + vy_body^2 + vz_body^2 + 1e-4)";
const LATERAL: &str = "sqrt(vx_body^2 + vy_body^2 + 1e-4)";
const TURNING: &str = "sqrt(wx^2 + wy^2 + wz^2 + 1e-4)";

const VEL: [&str; 3] = ["vx_body", "vy_body", "vz_body"];
/// Over ground.
const VEL_WORLD: [&str; 3] = ["vx", "vy", "vz"];
const RATES: [&str; 3] = ["wx", "wy", "wz"];

impl Shape {
    /// What a force along the axes of the rotors is as a change of their thrust, and whether it is told by the thrust itself; else the
    /// coefficient is to be divided by the usual one. `None` for anything else.
    pub fn as_thrust(&self) -> Option<(Self, bool)> {
        let [text] = &self.texts[..] else { return None };
        if self.acts != Acts::ForceBody || self.axes != [2] {
            return None;
        }
        let by_thrust = text.strip_suffix(" * thrust_n").zip(self.words.strip_suffix(" · T"));
        let (text, words) = by_thrust.unwrap_or((text, &self.words));
        if text.contains("thrust_n") || words.is_empty() {
            return None;
        }
        let force = if by_thrust.is_some() { FORCE } else { RATIO };
        let shape = Self {
            acts: Acts::Thrust,
            texts: vec![text.to_string()],
            unit: core::array::from_fn(|k| self.unit[k] - force[k]),
            words: words.to_string(),
            like: "a thrust that changes in flight",
            cost: if by_thrust.is_some() { self.cost - 0.5 } else { self.cost + 0.5 },
            ..self.clone()
        };
        Some((shape, by_thrust.is_some()))
    }
}

fn quantity(text: &str, words: &'static str, unit: Powers) -> Quantity {
    Quantity { text: text.into(), words, unit }
}

/// What a quantity is multiplied by; the first says nothing.
fn factors() -> Vec<Quantity> {
    vec![
        quantity("", "", RATIO),
        quantity(AIRSPEED, "|v|", SPEED),
        quantity("(vx_body^2 + vy_body^2 + vz_body^2)", "|v|²", [2, 0, -2]),
        quantity("rotor_sum", "ΣΩ", RATE),
        quantity("thrust_n", "T", FORCE),
        quantity(TURNING, "|ω|", RATE),
        quantity("wz", "ω_z", RATE),
    ]
}

/// Quantities without a direction of their own, each for any axis.
fn scalars() -> Vec<Quantity> {
    let mut out = vec![
        quantity("vx_body", "v_x", SPEED),
        quantity("vy_body", "v_y", SPEED),
        quantity("vz_body", "v_z", SPEED),
        quantity("wx", "ω_x", RATE),
        quantity("wy", "ω_y", RATE),
        quantity("wz", "ω_z", RATE),
        quantity("sin(roll)", "sin(roll)", RATIO),
        quantity("sin(pitch)", "sin(pitch)", RATIO),
        quantity("sin(roll)^2", "sin²(roll)", RATIO),
        quantity("sin(pitch)^2", "sin²(pitch)", RATIO),
        quantity("cos(roll) * cos(pitch)", "cos(tilt)", RATIO),
        quantity(AIRSPEED, "|v|", SPEED),
        quantity("(vx_body^2 + vy_body^2 + vz_body^2)", "|v|²", [2, 0, -2]),
        quantity(LATERAL, "|v_xy|", SPEED),
        quantity("(vx_body^2 + vy_body^2)", "|v_xy|²", [2, 0, -2]),
        quantity(TURNING, "|ω|", RATE),
        quantity("rotor_sum", "ΣΩ", RATE),
        quantity("rotor_sum^2", "ΣΩ²", [0, 0, -2]),
        quantity("thrust_n", "T", FORCE),
        quantity("thrust_n^2", "T²", [2, 2, -4]),
        quantity("t", "t", [0, 0, 1]),
        quantity("max(0, vx_body)", "v_x ahead only", SPEED),
        quantity("max(0, -vx_body)", "v_x astern only", SPEED),
        quantity("max(0, vz_body)", "v_z up only", SPEED),
        quantity("max(0, -vz_body)", "v_z down only", SPEED),
    ];
    const VV: [[&str; 3]; 3] = [["v_x²", "v_x v_y", "v_x v_z"], ["", "v_y²", "v_y v_z"], ["", "", "v_z²"]];
    const WW: [[&str; 3]; 3] = [["ω_x²", "ω_x ω_y", "ω_x ω_z"], ["", "ω_y²", "ω_y ω_z"], ["", "", "ω_z²"]];
    const VW: [[&str; 3]; 3] = [
        ["v_x ω_x", "v_x ω_y", "v_x ω_z"],
        ["v_y ω_x", "v_y ω_y", "v_y ω_z"],
        ["v_z ω_x", "v_z ω_y", "v_z ω_z"],
    ];
    for i in 0..3 {
        for j in 0..3 {
            if j >= i {
                out.push(quantity(&format!("{} * {}", VEL[i], VEL[j]), VV[i][j], [2, 0, -2]));
                out.push(quantity(&format!("{} * {}", RATES[i], RATES[j]), WW[i][j], [0, 0, -2]));
            }
            out.push(quantity(&format!("{} * {}", VEL[i], RATES[j]), VW[i][j], [1, 0, -2]));
        }
    }
    out
}

/// Quantities that a threshold, a saturation or a decay is tried on.
fn bent() -> Vec<Quantity> {
    vec![
        quantity(AIRSPEED, "|v|", SPEED),
        quantity(LATERAL, "|v_xy|", SPEED),
        quantity(TURNING, "|ω|", RATE),
        quantity("vx_body", "v_x", SPEED),
        quantity("vy_body", "v_y", SPEED),
        quantity("vz_body", "v_z", SPEED),
        quantity("wx", "ω_x", RATE),
        quantity("wy", "ω_y", RATE),
        quantity("wz", "ω_z", RATE),
        quantity("t", "t", [0, 0, 1]),
        quantity("z", "z", [1, 0, 0]),
    ]
}

/// A function of a quantity with a scale: expression and words, `q` for the quantity, `s` for the scale.
struct Bend {
    text: &'static str,
    words: &'static str,
    /// Whether the result has the unit of the quantity, and is none otherwise.
    keeps_unit: bool,
    /// Whether it turns with the sign of the quantity.
    odd: bool,
    /// Whether the logs can tell its scale from its coefficient.
    tells_scale: bool,
    like: &'static str,
}

const BENDS: [Bend; 6] = [
    Bend {
        text: "tanh((q) / s)",
        words: "tanh(q / {s})",
        keeps_unit: false,
        odd: true,
        tells_scale: true,
        like: "dry friction, or a drag that saturates",
    },
    Bend {
        text: "((q) / sqrt(abs(q) / s + 0.01) / s)",
        words: "√(q / {s})",
        keeps_unit: false,
        odd: true,
        tells_scale: false,
        like: "a drag that grows slower than the speed",
    },
    Bend {
        text: "((q) - max(-s, min(s, q)))",
        words: "(q beyond ±{s})",
        keeps_unit: true,
        odd: true,
        tells_scale: true,
        like: "what begins at a threshold",
    },
    Bend {
        text: "max(0, abs(q) - s)",
        words: "(|q| above {s})",
        keeps_unit: true,
        odd: false,
        tells_scale: true,
        like: "what begins at a threshold",
    },
    Bend {
        text: "exp(-abs(q) / s)",
        words: "exp(−|q| / {s})",
        keeps_unit: false,
        odd: false,
        tells_scale: true,
        like: "what fades",
    },
    // Nothing at rest, so that no constant force has to make up for it, as the one above would need.
    Bend {
        text: "(1 - exp(-((q) / s)^2))",
        words: "(1 − exp(−(q / {s})²))",
        keeps_unit: false,
        odd: false,
        tells_scale: true,
        like: "what saturates",
    },
];

fn add(a: Powers, b: Powers) -> Powers {
    core::array::from_fn(|k| a[k] + b[k])
}

fn times(a: &str, factor: &Quantity) -> String {
    if factor.text.is_empty() { a.into() } else { format!("{a} * {}", factor.text) }
}

fn words_times(a: &str, factor: &Quantity) -> String {
    if factor.text.is_empty() { a.into() } else { format!("{a} · {}", factor.words) }
}

/// Sets of axes on which a formula acts alike.
const TOGETHER: [&[usize]; 5] = [&[0, 1, 2], &[0, 1], &[0], &[1], &[2]];
const ALONE: [&[usize]; 3] = [&[0], &[1], &[2]];

/// All shapes.
pub(super) fn shapes() -> Vec<Shape> {
    let mut out = Vec::new();
    for acts in [Acts::ForceBody, Acts::Torque] {
        along_own_axis(&mut out, acts);
        across(&mut out, acts);
        if acts == Acts::ForceBody {
            along_velocity(&mut out);
        }
        free_of_axes(&mut out, acts);
    }
    along_own_axis(&mut out, Acts::ForceWorld);
    by_place(&mut out);
    out
}

/// What acts against, or along, the motion of its own axis: drags, dampings, friction; along axes of the world, that of rails, cables and
/// guides.
fn along_own_axis(out: &mut Vec<Shape>, acts: Acts) {
    let world = acts == Acts::ForceWorld;
    let motions = [(VEL, "v", SPEED), (RATES, "ω", RATE)];
    let (motions, more) =
        if world { (&[(VEL_WORLD, "v", SPEED)][..], OF_WORLD) } else { (&motions[..], 0.0) };
    for (names, words, unit) in motions.iter().copied() {
        for axes in TOGETHER {
            let straight = Shape {
                acts,
                axes,
                texts: axes.iter().map(|k| names[*k].to_string()).collect(),
                scaled: None,
                scale_words: "",
                tells_scale: false,
                unit,
                words: words.into(),
                like: like(acts, words, ""),
                cost: 1.0 + more,
            };
            // What is alike along all axes, with a size that has none, is the same along the world's and the body's: of such sizes
            // the body's have enough.
            for factor in factors().iter().filter(|f| !world || f.text.is_empty() && axes.len() < 3) {
                out.push(Shape {
                    texts: axes.iter().map(|k| times(names[*k], factor)).collect(),
                    unit: add(unit, factor.unit),
                    words: words_times(words, factor),
                    like: like(acts, words, factor.words),
                    cost: if factor.text.is_empty() { 1.0 } else { 2.0 } + more,
                    ..straight.clone()
                });
            }
            out.push(Shape {
                texts: axes.iter().map(|k| step(names[*k])).collect(),
                unit: RATIO,
                words: format!("sign({words})"),
                like: DRY_FRICTION,
                cost: 2.0 + more,
                ..straight.clone()
            });
            // The square along each axis alone: the drag of most simulators (MuJoCo's boxes, PyFlyt).
            out.push(Shape {
                texts: axes.iter().map(|k| format!("{0} * abs({0})", names[*k])).collect(),
                unit: add(unit, unit),
                words: format!("{words} · |{words} along the axis|"),
                like: like(acts, words, OWN_SIZE),
                cost: 2.0 + more,
                ..straight.clone()
            });
            for bend in BENDS.iter().filter(|b| b.odd) {
                out.push(Shape {
                    texts: axes.iter().map(|k| with_quantity(bend.text, names[*k])).collect(),
                    scaled: Some(straight.texts.clone()),
                    scale_words: shown(unit),
                    tells_scale: bend.tells_scale,
                    unit: if bend.keeps_unit { unit } else { RATIO },
                    words: bent_words(bend, words),
                    like: bend.like,
                    cost: 3.0 + more,
                    ..straight.clone()
                });
            }
        }
    }
}

/// What acts against, or along, the whole velocity, and bends with its size.
fn along_velocity(out: &mut Vec<Shape>) {
    // Expression of the factor on an axis' velocity, words, whether the scale can be told, unit of the product, physics.
    let bends: [(&str, &str, bool, Powers, &str); 3] = [
        ("max(0, 1 - s / V)", "v beyond |v| = {s}", true, SPEED, "what begins at a threshold"),
        ("tanh(V / s) / V", "v/|v| · tanh(|v| / {s})", true, RATIO, "dry friction, or a drag that saturates"),
        ("1 / sqrt(V * s)", "v/|v| · √(|v| / {s})", false, RATIO, "a drag that grows slower than the speed"),
    ];
    for (text, words, tells_scale, unit, like) in bends {
        for axes in &TOGETHER[..2] {
            let factor = text.replace('V', AIRSPEED);
            out.push(Shape {
                acts: Acts::ForceBody,
                axes,
                texts: axes.iter().map(|k| format!("{} * {factor}", VEL[*k])).collect(),
                scaled: Some(vec![AIRSPEED.into()]),
                scale_words: "m/s",
                tells_scale,
                unit,
                words: words.into(),
                like,
                cost: 3.0,
            });
        }
    }
}

/// What acts across the motion in the plane of the rotors: a push along y pushes or turns about x.
fn across(out: &mut Vec<Shape>, acts: Acts) {
    let [vx, vy, vz] = VEL;
    let product = |a: &str, p: &str, b: &str, q: &str| format!("({a} * {p} - {b} * {q})");
    out.push(Shape {
        acts,
        axes: TOGETHER[0],
        texts: vec![product("wy", vz, "wz", vy), product("wz", vx, "wx", vz), product("wx", vy, "wy", vx)],
        scaled: None,
        scale_words: "",
        tells_scale: false,
        unit: [1, 0, -2],
        words: "ω × v".into(),
        like: if acts == Acts::Torque { "" } else { "added mass, or a Magnus force" },
        cost: 2.0,
    });
    const PLANE: &[usize] = &[0, 1];
    for (names, words, unit) in [(VEL, "e_z × v", SPEED), (RATES, "e_z × ω", RATE)] {
        for factor in factors() {
            out.push(Shape {
                acts,
                axes: PLANE,
                texts: vec![times(&format!("-{}", names[1]), &factor), times(names[0], &factor)],
                scaled: None,
                scale_words: "",
                tells_scale: false,
                unit: add(unit, factor.unit),
                words: words_times(words, &factor),
                like: if acts == Acts::Torque && words == "e_z × v" {
                    "a force above or below the centre of mass"
                } else {
                    ""
                },
                cost: if factor.text.is_empty() { 1.0 } else { 2.0 },
            });
        }
    }
}

/// What goes with a quantity that has no axis, or with that of another axis.
fn free_of_axes(out: &mut Vec<Shape>, acts: Acts) {
    let gains =
        [quantity("", "", RATIO), quantity("thrust_n", "T", FORCE), quantity("rotor_sum", "ΣΩ", RATE)];
    for axes in ALONE {
        for q in scalars() {
            for gain in &gains {
                let shape = Shape {
                    acts,
                    axes,
                    texts: vec![times(&format!("({})", q.text), gain)],
                    scaled: None,
                    scale_words: "",
                    tells_scale: false,
                    unit: add(q.unit, gain.unit),
                    words: words_times(q.words, gain),
                    like: if acts == Acts::ForceBody && axes == [2] && gain.words == "T" {
                        "a thrust that changes in flight"
                    } else {
                        ""
                    },
                    cost: if gain.text.is_empty() { 1.5 } else { 2.5 },
                };
                out.push(shape);
            }
        }
        for q in bent() {
            for bend in &BENDS {
                for gain in &gains[..2] {
                    let text = with_quantity(bend.text, &q.text);
                    out.push(Shape {
                        acts,
                        axes,
                        texts: vec![times(&text, gain)],
                        scaled: Some(vec![q.text.clone()]),
                        scale_words: shown(q.unit),
                        tells_scale: bend.tells_scale,
                        unit: add(if bend.keeps_unit { q.unit } else { RATIO }, gain.unit),
                        words: words_times(&bent_words(bend, q.words), gain),
                        like: bend.like,
                        cost: if gain.text.is_empty() { 3.5 } else { 4.5 },
                    });
                }
            }
        }
    }
}

/// What a formula along axes of the world costs more: one of the body that says as much comes first.
const OF_WORLD: f64 = 0.5;

/// Forces along axes of the world by place, by time and by how near others are: springs, tethers, fields, outflows.
fn by_place(out: &mut Vec<Shape>) {
    let both = [
        quantity("x", "x", [1, 0, 0]),
        quantity("y", "y", [1, 0, 0]),
        quantity("z", "z", [1, 0, 0]),
        quantity("t", "t", [0, 0, 1]),
        quantity(AIRSPEED, "|v|", SPEED),
    ];
    let square = quantity("(vx_body^2 + vy_body^2 + vz_body^2)", "|v|²", [2, 0, -2]);
    // Where nobody else flies it is a million metres: no size to take the scale from.
    let others = quantity("min(others_m, 10)", "distance to others", [1, 0, 0]);
    for axes in ALONE {
        let shape = |q: &Quantity| Shape {
            acts: Acts::ForceWorld,
            axes,
            texts: vec![q.text.clone()],
            scaled: None,
            scale_words: "",
            tells_scale: false,
            unit: q.unit,
            words: q.words.into(),
            like: "",
            cost: 1.5 + OF_WORLD,
        };
        out.extend(both.iter().chain([&square]).map(shape));
        for q in both.iter().chain([&others]) {
            for bend in &BENDS {
                out.push(Shape {
                    texts: vec![with_quantity(bend.text, &q.text)],
                    scaled: Some(vec![q.text.clone()]),
                    scale_words: shown(q.unit),
                    tells_scale: bend.tells_scale,
                    unit: if bend.keeps_unit { q.unit } else { RATIO },
                    words: bent_words(bend, q.words),
                    like: bend.like,
                    cost: 3.5 + OF_WORLD,
                    ..shape(q)
                });
            }
        }
    }
}

const DRY_FRICTION: &str = "dry friction";

/// Square of the width within which a sign is smooth, so that its slope stays finite, while formulas are tried: there windows start at
/// measured velocities, and a steeper step would be crossed at another time.
const SMOOTH_TRIED: &str = "4e-4";
/// And where it is written, fitted and flown: half as wide, and half as much too large a coefficient.
const SMOOTH_WRITTEN: &str = "1e-5";

/// The sign of a quantity: a saturation whose scale is too small for the logs to tell.
fn step(q: &str) -> String {
    format!("{q} / sqrt({q}^2 + {SMOOTH_TRIED})")
}

/// An expression of a shape as a vehicle file has it.
pub(super) fn written(text: &str) -> String {
    text.replace(SMOOTH_TRIED, SMOOTH_WRITTEN)
}

/// A function's expression with the quantity put in for the lone letter `q`.
fn with_quantity(text: &str, quantity: &str) -> String {
    let mut out = String::new();
    let letters: Vec<char> = text.chars().collect();
    for (i, c) in letters.iter().enumerate() {
        let joined = |at: Option<&char>| at.is_some_and(char::is_ascii_alphanumeric);
        let alone = !joined(i.checked_sub(1).and_then(|b| letters.get(b))) && !joined(letters.get(i + 1));
        if *c == 'q' && alone { out.push_str(quantity) } else { out.push(*c) }
    }
    out
}

/// A unit of a scale for readers.
fn shown(unit: Powers) -> &'static str {
    match unit {
        SPEED => "m/s",
        RATE => "rad/s",
        [1, 0, 0] => "m",
        _ => "s",
    }
}

fn bent_words(bend: &Bend, quantity: &str) -> String {
    bend.words.replace('q', quantity).replace("||", "|")
}

fn like(acts: Acts, motion: &str, factor: &str) -> &'static str {
    match (acts == Acts::Torque, motion, factor) {
        (false, "v", "") => "a drag that grows with the speed",
        (false, "v", "|v|") => "a drag that grows with the square of the speed",
        (false, "v", OWN_SIZE) => "a drag that grows with the square of the speed along each axis",
        (false, "v", "|v|²") => "a drag that grows with the cube of the speed",
        (false, "v", "ΣΩ" | "T") => "a drag of the rotors",
        (true, "ω", _) => "a damping of the rotation",
        _ => "",
    }
}

#[cfg(test)]
mod tests {
    use super::super::units::{unit_of_coefficient, words};
    use super::*;
    use propwash_vehicle::expression::parse;

    #[test]
    fn every_formula_is_an_expression_whose_units_agree() {
        let all = shapes();
        assert!(all.len() > 1000, "{}", all.len());
        for shape in &all {
            assert_eq!(shape.axes.len(), shape.texts.len());
            for text in &shape.texts {
                assert!(parse(text, &["s"]).is_ok(), "{text}");
                if shape.scaled.is_some() {
                    // A scale is a parameter with a unit of its own, which the check of units does not know.
                    continue;
                }
                let torque = shape.acts == Acts::Torque;
                let on = if torque { "N·m" } else { "N" };
                let program = parse(&format!("k * ({text})"), &["k"]).unwrap();
                let own = [[1, 1, -2], [2, 1, -2]][usize::from(torque)];
                let missing = core::array::from_fn(|k| own[k] - shape.unit[k]);
                // Numbers under a root stand for a square of what they are added to.
                assert_eq!(unit_of_coefficient(&program, on).unwrap(), words(missing), "{text}");
            }
        }
    }

    #[test]
    fn a_force_along_the_rotors_is_a_change_of_their_thrust() {
        let all = shapes();
        let of = |words: &str, acts: Acts, axes: &[usize]| {
            all.iter().find(|s| s.words == words && s.acts == acts && s.axes == axes).unwrap().as_thrust()
        };
        let (by_thrust, told) = of("sin(roll) · T", Acts::ForceBody, &[2]).unwrap();
        assert!(
            told && by_thrust.words == "sin(roll)" && by_thrust.texts == ["(sin(roll))"],
            "{by_thrust:?}"
        );
        assert_eq!(by_thrust.unit, RATIO);
        let (plain, told) = of("v_x²", Acts::ForceBody, &[2]).unwrap();
        assert!(!told && plain.words == "v_x²" && plain.cost > by_thrust.cost - 0.5, "{plain:?}");
        // Neither what acts elsewhere nor the thrust itself.
        assert!(of("sin(roll) · T", Acts::ForceBody, &[0]).is_none());
        assert!(of("v_x²", Acts::Torque, &[2]).is_none());
        assert!(of("T²", Acts::ForceBody, &[2]).is_none() && of("v", Acts::ForceBody, &[0, 1, 2]).is_none());
    }

    #[test]
    fn a_quantity_replaces_the_lone_letter_only() {
        assert_eq!(with_quantity("(q / sqrt(abs(q)))", "wx"), "(wx / sqrt(abs(wx)))");
    }
}
