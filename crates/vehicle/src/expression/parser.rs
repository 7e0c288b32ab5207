//! From the text of an expression to its program.
//!
//! Grammar: comparisons of sums of products of powers, with parentheses, a sign before a factor, integer powers (`x^2`, `x^-1`), functions.
//! `-x^2` is −(x²), `a < b` is 1 or 0. Every fault names its place by column, counted from 1.

use propwash_physics::effects::expression::{Input, MAX_DEPTH, Op, Program, ProgramError, VARIABLES};
use propwash_trace::names::suggestion;

/// Functions with their number of arguments.
pub(super) const FUNCTIONS: &[(&str, usize, Op)] = &[
    ("abs", 1, Op::Abs),
    ("sqrt", 1, Op::Sqrt),
    ("exp", 1, Op::Exp),
    ("sin", 1, Op::Sin),
    ("cos", 1, Op::Cos),
    ("tanh", 1, Op::Tanh),
    ("min", 2, Op::Min),
    ("max", 2, Op::Max),
    ("tan", 1, Op::Tan),
    ("asin", 1, Op::Asin),
    ("acos", 1, Op::Acos),
    ("atan2", 2, Op::Atan2),
    ("floor", 1, Op::Floor),
    ("sign", 1, Op::Sign),
    ("where", 3, Op::Where),
];

/// Longest text of one expression, in characters.
const MAX_LENGTH: usize = 1000;
/// Greatest integer power.
const MAX_POWER: i8 = 16;
/// Most parentheses, signs and functions within one another.
const MAX_NESTING: usize = 64;

/// A fault in the text of an expression.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("column {column}: expected {expected}, found {found}")]
pub struct ExpressionError {
    /// Where, in characters from 1.
    pub column: usize,
    /// What would be right.
    pub expected: String,
    /// What stands there.
    pub found: String,
}

/// Names that an expression may use beside the variables.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Names<'a> {
    /// Parameters, in their order.
    pub parameters: &'a [&'a str],
    /// Numbers that are remembered.
    pub memory: &'a [&'a str],
    /// Values computed before.
    pub lets: &'a [&'a str],
    /// Names of somebody else, in place of all of these and of the variables.
    pub others: Option<&'a [&'a str]>,
}

impl<'a> Names<'a> {
    /// The input that a name stands for.
    fn find(&self, name: &str) -> Option<u16> {
        let place = |list: &[&str]| list.iter().position(|own| *own == name);
        if let Some(others) = self.others {
            return place(others).map(|i| i as u16);
        }
        let own =
            place(self.parameters).map(Input::Parameter).or_else(|| place(self.memory).map(Input::Memory));
        let own = own.or_else(|| place(self.lets).map(Input::Let));
        own.or_else(|| VARIABLES.iter().position(|v| v.name == name).map(Input::Variable)).map(Input::index)
    }

    fn all(&self) -> Vec<&'a str> {
        let own = [self.parameters, self.memory, self.lets].into_iter().flatten().copied();
        match self.others {
            Some(others) => others.to_vec(),
            None => VARIABLES.iter().map(|v| v.name).chain(own).collect(),
        }
    }
}

/// The program of an expression of other numbers than those of effects: an input is a place among `names`.
///
/// # Errors
/// [`ExpressionError`] where the text is no expression, or names what is neither among `names` nor a function.
pub fn parse_names(text: &str, names: &[&str]) -> Result<Program, ExpressionError> {
    parse_with(text, Names { others: Some(names), ..Names::default() })
}

/// The program of an expression whose parameters have these names, in this order.
///
/// # Errors
/// [`ExpressionError`] where the text is no expression, or names what is neither variable nor parameter nor function.
pub fn parse(text: &str, parameters: &[&str]) -> Result<Program, ExpressionError> {
    parse_with(text, Names { parameters, ..Names::default() })
}

/// The same with all the names that an effect has.
pub(super) fn parse_with(text: &str, names: Names) -> Result<Program, ExpressionError> {
    let chars: Vec<char> = text.chars().collect();
    let mut parser = Parser { chars: &chars, at: 0, names, ops: Vec::new(), nesting: 0 };
    if chars.len() > MAX_LENGTH {
        return Err(parser.fault(
            MAX_LENGTH,
            format!("at most {MAX_LENGTH} characters"),
            format!("{} characters", chars.len()),
        ));
    }
    parser.whole()?;
    if parser.peek().is_some() {
        return Err(parser.unexpected("an operator (+ - * / ^ < <= > >=) or the end"));
    }
    Program::new(parser.ops).map_err(|error| ExpressionError {
        column: 1,
        expected: format!("an expression that needs at most {MAX_DEPTH} numbers at once"),
        found: match error {
            ProgramError::TooDeep(depth) => format!("one that needs {depth}"),
            other => other.to_string(),
        },
    })
}

struct Parser<'a> {
    chars: &'a [char],
    at: usize,
    names: Names<'a>,
    ops: Vec<Op>,
    nesting: usize,
}

impl Parser<'_> {
    fn fault(&self, at: usize, expected: impl Into<String>, found: impl Into<String>) -> ExpressionError {
        ExpressionError { column: at + 1, expected: expected.into(), found: found.into() }
    }

    /// The next character that is no blank.
    fn peek(&mut self) -> Option<char> {
        while self.chars.get(self.at).is_some_and(|c| c.is_whitespace()) {
            self.at += 1;
        }
        self.chars.get(self.at).copied()
    }

    /// Whether `wanted` comes next; then it is taken.
    fn take(&mut self, wanted: char) -> bool {
        let there = self.peek() == Some(wanted);
        self.at += usize::from(there);
        there
    }

    fn unexpected(&mut self, expected: &str) -> ExpressionError {
        let found = match self.peek() {
            None => "the end".to_string(),
            Some(c) if is_name(c) => format!("`{}`", self.word(self.at)),
            Some('−' | '–') => "a dash that is no minus sign: write -".to_string(),
            Some('×' | '·') => "a sign for products: write *".to_string(),
            Some(c) => format!("`{c}`"),
        };
        self.fault(self.at, expected, found)
    }

    /// Letters, digits and underscores from `start` on.
    fn word(&self, start: usize) -> String {
        self.chars[start..].iter().take_while(|c| is_name(**c)).collect()
    }

    fn deeper(&mut self) -> Result<(), ExpressionError> {
        self.nesting += 1;
        if self.nesting > MAX_NESTING {
            let expected = format!("at most {MAX_NESTING} parentheses and signs within one another");
            return Err(self.fault(self.at, expected, "more"));
        }
        Ok(())
    }

    /// A sum, or two that are compared.
    fn whole(&mut self) -> Result<(), ExpressionError> {
        self.sum()?;
        let less = match self.peek() {
            Some('<') => true,
            Some('>') => false,
            _ => return Ok(()),
        };
        self.at += 1;
        let or_equal = self.chars.get(self.at) == Some(&'=');
        self.at += usize::from(or_equal);
        self.sum()?;
        if matches!(self.peek(), Some('<' | '>')) {
            return Err(self.unexpected("one comparison: min(a < b, b < c) is 1 where both hold"));
        }
        self.ops.push(match (less, or_equal) {
            (true, false) => Op::Less,
            (true, true) => Op::LessEqual,
            (false, false) => Op::Greater,
            (false, true) => Op::GreaterEqual,
        });
        Ok(())
    }

    fn sum(&mut self) -> Result<(), ExpressionError> {
        self.product()?;
        loop {
            let op = match self.peek() {
                Some('+') => Op::Add,
                Some('-') => Op::Subtract,
                _ => return Ok(()),
            };
            self.at += 1;
            self.product()?;
            self.ops.push(op);
        }
    }

    fn product(&mut self) -> Result<(), ExpressionError> {
        self.signed()?;
        loop {
            let op = match self.peek() {
                Some('*') => Op::Multiply,
                Some('/') => Op::Divide,
                _ => return Ok(()),
            };
            self.at += 1;
            self.signed()?;
            self.ops.push(op);
        }
    }

    fn signed(&mut self) -> Result<(), ExpressionError> {
        if !self.take('-') {
            return self.power();
        }
        self.deeper()?;
        self.signed()?;
        self.nesting -= 1;
        self.ops.push(Op::Negate);
        Ok(())
    }

    fn power(&mut self) -> Result<(), ExpressionError> {
        self.factor()?;
        while self.take('^') {
            self.peek();
            let start = self.at;
            let negative = self.take('-');
            self.peek();
            let digits = self.word(self.at);
            self.at += digits.chars().count();
            let expected = format!("an integer from -{MAX_POWER} to {MAX_POWER} as power");
            let fraction = self.chars.get(self.at) == Some(&'.');
            let size = digits.parse::<i8>().ok().filter(|n| *n <= MAX_POWER && !fraction);
            let Some(size) = size else {
                let found: String = self.chars[start..].iter().take(12).collect();
                let found = if found.is_empty() { "the end".into() } else { format!("`{found}`") };
                return Err(self.fault(start, expected, found));
            };
            self.ops.push(Op::Power(if negative { -size } else { size }));
        }
        Ok(())
    }

    fn factor(&mut self) -> Result<(), ExpressionError> {
        match self.peek() {
            Some('(') => {
                self.at += 1;
                self.deeper()?;
                self.whole()?;
                self.nesting -= 1;
                if self.take(')') { Ok(()) } else { Err(self.unexpected("`)` or an operator")) }
            }
            Some(c) if c.is_ascii_digit() || c == '.' => self.number(),
            Some(c) if is_name(c) => self.named(),
            _ => Err(self.unexpected("a number, a variable, a parameter, a function, `(` or `-`")),
        }
    }

    fn number(&mut self) -> Result<(), ExpressionError> {
        let start = self.at;
        let mut end = start;
        while let Some(c) = self.chars.get(end) {
            let exponent_sign = matches!(c, '+' | '-') && matches!(self.chars[end - 1], 'e' | 'E');
            if !(c.is_ascii_alphanumeric() || matches!(c, '.' | '_') || exponent_sign) {
                break;
            }
            end += 1;
        }
        let text: String = self.chars[start..end].iter().collect();
        match text.parse::<f64>().ok().filter(|v| v.is_finite()) {
            Some(value) => {
                self.at = end;
                self.ops.push(Op::Literal(value));
                Ok(())
            }
            None => Err(self.fault(start, "a finite number such as 2, 0.5 or 1.5e-3", format!("`{text}`"))),
        }
    }

    fn named(&mut self) -> Result<(), ExpressionError> {
        let start = self.at;
        let name = self.word(start);
        self.at += name.chars().count();
        if self.peek() == Some('(') {
            return self.call(&name, start);
        }
        match self.names.find(&name) {
            Some(input) => self.ops.push(Op::Input(input)),
            None => {
                let expected = if FUNCTIONS.iter().any(|(f, ..)| *f == name) {
                    format!("`(` after the function `{name}`")
                } else {
                    format!(
                        "a variable or a declared parameter{}",
                        suggestion(&name, self.names.all().into_iter())
                    )
                };
                return Err(self.fault(start, expected, format!("`{name}`")));
            }
        }
        Ok(())
    }

    fn call(&mut self, name: &str, start: usize) -> Result<(), ExpressionError> {
        let Some((_, wanted, op)) = FUNCTIONS.iter().find(|(f, ..)| *f == name) else {
            let known: Vec<&str> = FUNCTIONS.iter().map(|(f, ..)| *f).collect();
            let close = suggestion(name, known.iter().copied());
            let expected = format!("a function ({}){close}", known.join(", "));
            return Err(self.fault(start, expected, format!("`{name}(`")));
        };
        self.at += 1;
        self.deeper()?;
        let mut given = 0;
        if self.peek() != Some(')') {
            loop {
                self.whole()?;
                given += 1;
                if !self.take(',') {
                    break;
                }
            }
        }
        if !self.take(')') {
            return Err(self.unexpected("`,`, `)` or an operator"));
        }
        self.nesting -= 1;
        if given != *wanted {
            let plural = if *wanted == 1 { "" } else { "s" };
            let expected = format!("{wanted} argument{plural} of {name}");
            return Err(self.fault(start, expected, given.to_string()));
        }
        self.ops.push(*op);
        Ok(())
    }
}

pub(super) fn is_name(c: char) -> bool {
    c.is_ascii_alphanumeric() || c == '_'
}
