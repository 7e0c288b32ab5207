//! Units of expressions: what is added must be of one unit, functions take ratios and angles, and the coefficient gets the
//! unit that makes a force or a torque of the whole.

use propwash_physics::effects::expression::{Op, Program, VARIABLES};

/// Powers of m, kg, s; angles count as ratios.
pub(crate) type Powers = [i32; 3];

/// A unit with a power of the coefficient's unknown one.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Unit {
    powers: Powers,
    coefficient: i32,
    /// A number as typed: it takes the unit of what it is added to.
    bare: bool,
}

/// What is wrong with the units of an expression.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Fault {
    pub expected: String,
    pub found: String,
    /// The last variable that was read.
    near: Option<&'static str>,
}

impl Fault {
    /// Its column: the variable nearest to it, from 1.
    pub fn column(&self, text: &str) -> usize {
        let at = self.near.and_then(|name| text.rfind(name));
        at.map_or(1, |i| text[..i].chars().count() + 1)
    }
}

pub(crate) const RATIO: Powers = [0; 3];

/// Powers of a unit as variables have it: `m/s`, `rad/s`, `N`, `kg/m³`.
fn powers(unit: &str) -> Powers {
    let mut out = RATIO;
    for (i, part) in unit.split('/').enumerate() {
        let side = if i == 0 { 1 } else { -1 };
        for factor in part.split('·') {
            let base = factor.trim_end_matches(['²', '³']);
            let power = if factor.ends_with('²') {
                2
            } else if factor.ends_with('³') {
                3
            } else {
                1
            };
            let one: Powers = match base {
                "m" => [1, 0, 0],
                "kg" => [0, 1, 0],
                "s" => [0, 0, 1],
                "N" => [1, 1, -2],
                _ => RATIO,
            };
            (0..3).for_each(|k| out[k] += side * power * one[k]);
        }
    }
    out
}

/// A unit in words: newtons first, since forces are what expressions make.
pub(crate) fn words(mut p: Powers) -> String {
    let mut up = Vec::new();
    let mut down = Vec::new();
    let newtons = p[1];
    p[0] -= newtons;
    p[1] = 0;
    p[2] += 2 * newtons;
    for (name, power) in [("N", newtons), ("m", p[0]), ("kg", p[1]), ("s", p[2])] {
        let list = if power > 0 { &mut up } else { &mut down };
        let power = power.unsigned_abs();
        match power {
            0 => {}
            1 => list.push(name.to_string()),
            2 => list.push(format!("{name}²")),
            3 => list.push(format!("{name}³")),
            n => list.push(format!("{name}^{n}")),
        }
    }
    match (up.is_empty(), down.is_empty()) {
        (true, true) => "1".into(),
        (_, true) => up.join("·"),
        (true, false) if down.len() == 1 => format!("1/{}", down[0]),
        (true, false) => format!("1/({})", down.join("·")),
        (false, false) if down.len() == 1 => format!("{}/{}", up.join("·"), down[0]),
        (false, false) => format!("{}/({})", up.join("·"), down.join("·")),
    }
}

/// The unit of the coefficient with which an expression has the unit `of`.
pub(crate) fn unit_of_coefficient(program: &Program, of: &str) -> Result<String, Fault> {
    let bare = Unit { powers: RATIO, coefficient: 0, bare: true };
    let mut stack: Vec<Unit> = Vec::new();
    let mut near: Option<&'static str> = None;
    for op in program.ops() {
        let mut pop = || stack.pop().unwrap_or(bare);
        let next = match op {
            Op::Literal(_) => bare,
            Op::Input(i) => match VARIABLES.get(usize::from(*i)) {
                Some(v) => {
                    near = Some(v.name);
                    Unit { powers: powers(v.unit), coefficient: 0, bare: false }
                }
                None => Unit { powers: RATIO, coefficient: 1, bare: false },
            },
            Op::Add | Op::Subtract | Op::Min | Op::Max => {
                let (b, a) = (pop(), pop());
                same(a, b, near)?
            }
            Op::Less | Op::LessEqual | Op::Greater | Op::GreaterEqual | Op::Atan2 => {
                let (b, a) = (pop(), pop());
                same(a, b, near)?;
                Unit { bare: false, ..bare }
            }
            Op::Where => {
                let (b, a) = (pop(), pop());
                pop();
                same(a, b, near)?
            }
            Op::Sign => {
                pop();
                Unit { bare: false, ..bare }
            }
            Op::Multiply | Op::Divide => {
                let (b, a) = (pop(), pop());
                let side = if matches!(op, Op::Multiply) { 1 } else { -1 };
                Unit {
                    powers: core::array::from_fn(|k| a.powers[k] + side * b.powers[k]),
                    coefficient: a.coefficient + side * b.coefficient,
                    bare: a.bare && b.bare,
                }
            }
            Op::Power(n) => {
                let a = pop();
                let n = i32::from(*n);
                Unit { powers: a.powers.map(|p| n * p), coefficient: n * a.coefficient, ..a }
            }
            Op::Negate | Op::Abs => pop(),
            Op::Sqrt => {
                let a = pop();
                if a.powers.iter().any(|p| p % 2 != 0) || a.coefficient % 2 != 0 {
                    return Err(fault("a square under the root", words(a.powers), near));
                }
                Unit { powers: a.powers.map(|p| p / 2), coefficient: a.coefficient / 2, ..a }
            }
            Op::Sin | Op::Cos | Op::Tan | Op::Asin | Op::Acos | Op::Exp | Op::Tanh | Op::Floor => {
                let a = pop();
                if a.powers != RATIO || a.coefficient != 0 {
                    let found = if a.coefficient != 0 { "k".into() } else { words(a.powers) };
                    return Err(fault(
                        "an angle or a ratio in sin, cos, tan, asin, acos, exp, tanh and floor",
                        found,
                        near,
                    ));
                }
                a
            }
        };
        stack.push(next);
    }
    let whole = stack.pop().unwrap_or(bare);
    let power = if whole.coefficient == 0 { 1 } else { whole.coefficient };
    let wanted = powers(of);
    let missing: Powers = core::array::from_fn(|k| wanted[k] - whole.powers[k]);
    if missing.iter().any(|p| p % power != 0) {
        return Err(fault("a coefficient with a unit of whole powers", words(missing), near));
    }
    Ok(words(missing.map(|p| p / power)))
}

fn fault(expected: &str, found: String, near: Option<&'static str>) -> Fault {
    Fault { expected: expected.into(), found, near }
}

/// The unit of a sum of two.
fn same(a: Unit, b: Unit, near: Option<&'static str>) -> Result<Unit, Fault> {
    match (a.bare, b.bare) {
        (true, _) => Ok(b),
        (_, true) => Ok(a),
        _ if a.powers == b.powers && a.coefficient == b.coefficient => Ok(a),
        // The coefficient takes the unit that the other one asks for.
        _ if a.coefficient != b.coefficient => Ok(if a.coefficient == 0 { a } else { b }),
        _ => Err(fault(
            &format!("the same unit on both sides of a sum: {}", words(a.powers)),
            words(b.powers),
            near,
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use propwash_vehicle::expression::parse;

    fn unit(text: &str, of: &str) -> Result<String, Fault> {
        unit_of_coefficient(&parse(text, &["k"]).unwrap(), of)
    }

    #[test]
    fn the_coefficient_gets_the_unit_that_makes_a_force_of_all() {
        assert_eq!(unit("-k * vx_body", "N").unwrap(), "N·s/m");
        assert_eq!(unit("-0.1 * vx_body * abs(vx_body)", "N").unwrap(), "N·s²/m²");
        assert_eq!(unit("k * thrust_n", "N").unwrap(), "1");
        assert_eq!(unit("k * wz * rotor_sum", "N·m").unwrap(), "N·m·s²");
        assert_eq!(unit("k * air_density * vx^2", "N").unwrap(), "m²");
        // Numbers have no unit of their own: that of 0.5 m stays with the coefficient.
        assert_eq!(unit("k * max(0, 1 - ground_m / 0.5)", "N").unwrap(), "N/m");
    }

    #[test]
    fn a_sum_of_two_units_is_refused_where_it_stands() {
        let wrong = unit("k * (vx_body + roll)", "N").unwrap_err();
        assert!(wrong.expected.contains("same unit"), "{wrong:?}");
        assert_eq!(wrong.column("k * (vx_body + roll)"), 16);
        let wrong = unit("k * sin(vx)", "N").unwrap_err();
        assert!(wrong.expected.contains("angle") && wrong.found == "m/s", "{wrong:?}");
    }
}
