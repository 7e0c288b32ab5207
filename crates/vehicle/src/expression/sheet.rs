//! Expressions over the same numbers, with named values before them: what functions in Python that run once become.

use super::{ExpressionError, parse_names};
use propwash_trace::Real;
use propwash_trace::program::Program;

/// Expressions over numbers with names.
///
/// ```
/// use propwash_vehicle::expression::Sheet;
///
/// let mut sheet = Sheet::over(["x", "y"]);
/// sheet.add("far", "sqrt(x^2 + y^2)")?;
/// let cost = sheet.program("far + 0.5 * far^2")?;
/// assert_eq!(Sheet::value(&cost, &sheet.numbers(vec![3.0, 4.0])), 17.5);
/// # Ok::<(), propwash_vehicle::expression::ExpressionError>(())
/// ```
#[derive(Clone, Debug, Default)]
pub struct Sheet {
    names: Vec<String>,
    lets: Vec<Program>,
}

impl Sheet {
    /// Over numbers of these names.
    pub fn over<T: Into<String>>(names: impl IntoIterator<Item = T>) -> Self {
        Self { names: names.into_iter().map(Into::into).collect(), lets: Vec::new() }
    }

    /// Gives a value a name, which expressions after it may read.
    ///
    /// # Errors
    /// [`ExpressionError`] for what is no expression of the names before it.
    pub fn add(&mut self, name: &str, text: &str) -> Result<(), ExpressionError> {
        let program = self.program(text)?;
        self.lets.push(program);
        self.names.push(name.into());
        Ok(())
    }

    /// An expression of all names so far.
    ///
    /// # Errors
    /// [`ExpressionError`] for what is none.
    pub fn program(&self, text: &str) -> Result<Program, ExpressionError> {
        let known: Vec<&str> = self.names.iter().map(String::as_str).collect();
        parse_names(text, &known)
    }

    /// All numbers that its expressions may read, from those that are given, in the order of their names.
    pub fn numbers<S: Real>(&self, given: Vec<S>) -> Vec<S> {
        let mut out = given;
        for program in &self.lets {
            let value = Self::value(program, &out);
            out.push(value);
        }
        out
    }

    /// An expression of these numbers.
    pub fn value<S: Real>(program: &Program, numbers: &[S]) -> S {
        program.eval(|i| numbers[usize::from(i)])
    }
}
