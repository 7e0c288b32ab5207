//! Arithmetic as data: the compiled form of a user's expression, evaluated over any number type.
//!
//! A program is a list of stack operations (postfix notation). It is checked once, when it is built; running it allocates
//! nothing and has no data-dependent branch.

use super::Real;

/// Greatest stack depth of a program.
pub const MAX_DEPTH: usize = 32;

/// One operation on the stack.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Op {
    /// Pushes a constant.
    Literal(f64),
    /// Pushes an input.
    Input(u16),
    /// −a.
    Negate,
    /// a + b.
    Add,
    /// a − b.
    Subtract,
    /// a b.
    Multiply,
    /// a / b.
    Divide,
    /// a to an integer power.
    Power(i8),
    /// Magnitude.
    Abs,
    /// Square root.
    Sqrt,
    /// e to the power of a.
    Exp,
    /// Sine of an angle in radians.
    Sin,
    /// Cosine of an angle in radians.
    Cos,
    /// Hyperbolic tangent.
    Tanh,
    /// The smaller of a and b.
    Min,
    /// The larger of a and b.
    Max,
    /// Tangent of an angle in radians.
    Tan,
    /// Angle in radians whose sine is a, which lies between −1 and 1.
    Asin,
    /// Angle in radians whose cosine is a, which lies between −1 and 1.
    Acos,
    /// Angle in radians of the point (b, a), in (−π, π].
    Atan2,
    /// Largest integer not above a.
    Floor,
    /// −1, 0 or 1.
    Sign,
    /// 1 where a < b, else 0.
    Less,
    /// 1 where a ≤ b, else 0.
    LessEqual,
    /// 1 where a > b, else 0.
    Greater,
    /// 1 where a ≥ b, else 0.
    GreaterEqual,
    /// b where a is not 0, else c; both are computed.
    Where,
}

impl Op {
    /// Number of operands popped from the stack; one result is pushed.
    pub fn takes(self) -> usize {
        match self {
            Self::Literal(_) | Self::Input(_) => 0,
            Self::Negate | Self::Power(_) | Self::Abs | Self::Sqrt => 1,
            Self::Exp | Self::Sin | Self::Cos | Self::Tanh | Self::Tan => 1,
            Self::Asin | Self::Acos | Self::Floor | Self::Sign => 1,
            Self::Add | Self::Subtract | Self::Multiply | Self::Divide | Self::Min | Self::Max => 2,
            Self::Atan2 | Self::Less | Self::LessEqual | Self::Greater | Self::GreaterEqual => 2,
            Self::Where => 3,
        }
    }
}

/// A checked program that leaves exactly one number on the stack.
#[derive(Clone, Debug, PartialEq)]
pub struct Program {
    ops: Vec<Op>,
}

/// Why a list of operations is not a valid program.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ProgramError {
    /// It needs a deeper stack than allowed.
    #[error("needs {0} numbers at once, more than {MAX_DEPTH}")]
    TooDeep(usize),
    /// It pops an empty stack, or does not leave exactly one number.
    #[error("does not leave exactly one number")]
    Unbalanced,
}

impl Program {
    /// Checks the operations.
    ///
    /// # Errors
    /// [`ProgramError`] where they need a deeper stack than [`MAX_DEPTH`] or do not leave exactly one number.
    pub fn new(ops: Vec<Op>) -> Result<Self, ProgramError> {
        let (mut depth, mut deepest) = (0usize, 0usize);
        for op in &ops {
            depth = depth.checked_sub(op.takes()).ok_or(ProgramError::Unbalanced)? + 1;
            deepest = deepest.max(depth);
        }
        if deepest > MAX_DEPTH {
            return Err(ProgramError::TooDeep(deepest));
        }
        if depth != 1 {
            return Err(ProgramError::Unbalanced);
        }
        Ok(Self { ops })
    }

    /// The operations.
    pub fn ops(&self) -> &[Op] {
        &self.ops
    }

    /// Evaluates the program; `input` gives the inputs.
    pub fn eval<S: Real>(&self, input: impl Fn(u16) -> S) -> S {
        let mut stack = [S::zero(); MAX_DEPTH];
        // Where a number is 1 or 0 by a comparison, the comparison itself, so that a choice need not compare again.
        let mut masks: [Option<S::Mask>; MAX_DEPTH] = [None; MAX_DEPTH];
        let mut top = 0;
        for op in &self.ops {
            let first = top - op.takes();
            let [a, b, c] = core::array::from_fn(|i| stack[(first + i).min(MAX_DEPTH - 1)]);
            let two = (masks[first.min(MAX_DEPTH - 1)], masks[(first + 1).min(MAX_DEPTH - 1)]);
            let mask = match (*op, two) {
                (Op::Less, _) => Some(a.lt(b)),
                (Op::LessEqual, _) => Some(a.le(b)),
                (Op::Greater, _) => Some(b.lt(a)),
                (Op::GreaterEqual, _) => Some(b.le(a)),
                (Op::Min, (Some(x), Some(y))) => Some(x & y),
                (Op::Max, (Some(x), Some(y))) => Some(x | y),
                _ => None,
            };
            stack[first] = match *op {
                Op::Literal(v) => S::lit(v),
                Op::Input(i) => input(i),
                Op::Negate => -a,
                Op::Add => a + b,
                Op::Subtract => a - b,
                Op::Multiply => a * b,
                Op::Divide => a / b,
                Op::Power(n) => power(a, n),
                Op::Abs => a.abs(),
                Op::Sqrt => a.sqrt(),
                Op::Exp => a.exp(),
                Op::Sin => a.sin_cos().0,
                Op::Cos => a.sin_cos().1,
                Op::Tanh => tanh(a),
                Op::Min => a.min(b),
                Op::Max => a.max(b),
                Op::Tan => {
                    let (sin, cos) = a.sin_cos();
                    sin / cos
                }
                Op::Asin => a.atan2(beside(a)),
                Op::Acos => beside(a).atan2(a),
                Op::Atan2 => a.atan2(b),
                Op::Floor => a.floor(),
                Op::Sign => sign(a),
                Op::Less | Op::LessEqual | Op::Greater | Op::GreaterEqual => {
                    mask.map_or(S::zero(), |mask| S::select(mask, S::one(), S::zero()))
                }
                Op::Where => match two.0 {
                    Some(mask) => S::select(mask, b, c),
                    None => S::select(a.le(S::zero()) & S::zero().le(a), c, b),
                },
            };
            masks[first] = mask;
            top = first + 1;
        }
        stack[0]
    }
}

/// The cosine of an angle between −π/2 and π/2 with this sine, √(1 − a²).
fn beside<S: Real>(a: S) -> S {
    // By factors: 1 − a² loses digits near ±1.
    ((S::one() - a) * (S::one() + a)).sqrt()
}

/// −1, 0 or 1.
fn sign<S: Real>(a: S) -> S {
    let zero = S::zero();
    S::select(zero.lt(a), S::one(), S::select(a.lt(zero), -S::one(), zero))
}

/// `a` to the power of `n`, by repeated multiplication.
fn power<S: Real>(a: S, n: i8) -> S {
    let product = (0..n.unsigned_abs()).fold(S::one(), |product, _| product * a);
    if n < 0 { S::one() / product } else { product }
}

/// Hyperbolic tangent, 1 − 2 / (e^(2a) + 1). Beyond ±20 it differs from ±1 by less than rounding.
pub(crate) fn tanh<S: Real>(a: S) -> S {
    let held = a.clamp(S::lit(-20.0), S::lit(20.0));
    let two = S::lit(2.0);
    S::one() - two / ((two * held).exp() + S::one())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dual::Dual;

    #[test]
    fn programs_compute_over_any_number_type() {
        // max(x, 1) · sin(y)² − |x| / 2^−2
        let ops = vec![
            Op::Input(0),
            Op::Literal(1.0),
            Op::Max,
            Op::Input(1),
            Op::Sin,
            Op::Power(2),
            Op::Multiply,
            Op::Input(0),
            Op::Abs,
            Op::Literal(2.0),
            Op::Power(-2),
            Op::Divide,
            Op::Subtract,
        ];
        let program = Program::new(ops).unwrap();
        let value = |x: f64, y: f64| program.eval(|i| [x, y][usize::from(i)]);
        for (x, y) in [(3.0f64, 0.4f64), (-2.0, 1.3)] {
            let expected = f64::max(x, 1.0) * y.sin().powi(2) - x.abs() * 4.0;
            assert!((value(x, y) - expected).abs() < 1e-14);
            let dual = program.eval(|i| Dual::<f64, 2>::input([x, y][usize::from(i)], i.into()));
            let slope = (value(x + 1e-6, y) - value(x - 1e-6, y)) / 2e-6;
            assert!((dual.partials[0] - slope).abs() < 1e-8 && dual.value == value(x, y));
        }
        assert!((program.eval(|i| [3.0f32, 0.4][usize::from(i)]) - value(3.0, 0.4) as f32).abs() < 1e-5);
    }

    #[test]
    fn tanh_is_right_and_flat_far_out() {
        let program = Program::new(vec![Op::Input(0), Op::Tanh]).unwrap();
        for x in [-700.0, -3.0, -1e-3, 0.0, 0.5, 30.0, 1e9] {
            let dual = program.eval(|_| Dual::<f64, 1>::input(x, 0));
            assert!((dual.value - x.tanh()).abs() < 1e-15, "{x}");
            assert!((dual.partials[0] - (1.0 - x.tanh().powi(2))).abs() < 1e-14, "{x}");
        }
    }

    #[test]
    fn angles_choices_and_comparisons_are_those_of_the_standard_library() {
        let unary = |op: Op, x: f64| Program::new(vec![Op::Input(0), op]).unwrap().eval(|_| x);
        for x in [-1.0f64, -0.999_999_9, -0.3, 0.0, 0.5, 0.97, 1.0] {
            assert!((unary(Op::Asin, x) - x.asin()).abs() < 1e-14, "asin {x}");
            assert!((unary(Op::Acos, x) - x.acos()).abs() < 1e-14, "acos {x}");
            assert!((unary(Op::Tan, x) - x.tan()).abs() < 1e-14, "tan {x}");
        }
        for (x, down, sign) in [(-1.5, -2.0, -1.0), (0.0, 0.0, 0.0), (2.5, 2.0, 1.0)] {
            assert_eq!((unary(Op::Floor, x), unary(Op::Sign, x)), (down, sign));
        }
        let of = |op: Op, list: &[f64]| {
            let mut ops: Vec<Op> = (0..list.len() as u16).map(Op::Input).collect();
            ops.push(op);
            Program::new(ops).unwrap().eval(|i| list[usize::from(i)])
        };
        assert_eq!(of(Op::Atan2, &[1.0, -1.0]), 1f64.atan2(-1.0));
        assert_eq!(
            [of(Op::Less, &[1.0, 2.0]), of(Op::Less, &[2.0, 2.0]), of(Op::Less, &[3.0, 2.0])],
            [1.0, 0.0, 0.0]
        );
        assert_eq!([of(Op::LessEqual, &[2.0, 2.0]), of(Op::LessEqual, &[3.0, 2.0])], [1.0, 0.0]);
        assert_eq!(
            [of(Op::Greater, &[3.0, 2.0]), of(Op::Greater, &[2.0, 2.0]), of(Op::GreaterEqual, &[2.0, 2.0])],
            [1.0, 0.0, 1.0]
        );
        assert_eq!([of(Op::Where, &[0.0, 2.0, 3.0]), of(Op::Where, &[-0.5, 2.0, 3.0])], [3.0, 2.0]);
        // A slope goes through the side that is taken.
        let program = Program::new(vec![
            Op::Input(0),
            Op::Literal(1.0),
            Op::Less,
            Op::Input(0),
            Op::Power(2),
            Op::Literal(5.0),
            Op::Where,
        ]);
        let slope = |x: f64| program.as_ref().unwrap().eval(|_| Dual::<f64, 1>::input(x, 0)).partials[0];
        assert_eq!([slope(0.5), slope(2.0)], [1.0, 0.0]);
    }

    #[test]
    fn lists_that_are_no_programs_are_refused() {
        assert_eq!(Program::new(vec![]), Err(ProgramError::Unbalanced));
        assert_eq!(Program::new(vec![Op::Literal(1.0), Op::Add]), Err(ProgramError::Unbalanced));
        assert_eq!(Program::new(vec![Op::Literal(1.0); 2]), Err(ProgramError::Unbalanced));
        let sum = |n: usize| [vec![Op::Literal(1.0); n], vec![Op::Add; n - 1]].concat();
        assert_eq!(Program::new(sum(32)).unwrap().eval(|_| 0.0), 32.0);
        assert_eq!(Program::new(sum(33)), Err(ProgramError::TooDeep(33)));
    }
}
