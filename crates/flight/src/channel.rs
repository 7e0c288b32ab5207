//! One measured quantity with its own sample times.

use serde::Serialize;

/// Samples of a quantity of `N` numbers, each with its time; empty where it was not measured.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Channel<const N: usize> {
    /// Times, s from the start of the log, shape `(sample,)`.
    pub t_s: Vec<f64>,
    /// Values in the unit of the field that holds the channel, shape `(sample, N)`.
    #[serde(serialize_with = "values")]
    pub values: Vec<[f64; N]>,
}

fn values<const N: usize, S: serde::Serializer>(values: &[[f64; N]], s: S) -> Result<S::Ok, S::Error> {
    s.collect_seq(values.iter().map(|v| v.as_slice()))
}

impl<const N: usize> Default for Channel<N> {
    fn default() -> Self {
        Self { t_s: Vec::new(), values: Vec::new() }
    }
}

impl<const N: usize> Channel<N> {
    /// A channel of times (s) and values, which must be of one length; the longer is cut.
    pub fn new(mut t_s: Vec<f64>, mut values: Vec<[f64; N]>) -> Self {
        let n = t_s.len().min(values.len());
        t_s.truncate(n);
        values.truncate(n);
        Self { t_s, values }
    }

    /// Number of samples.
    pub fn len(&self) -> usize {
        self.t_s.len()
    }

    /// Whether it was never measured.
    pub fn is_empty(&self) -> bool {
        self.t_s.is_empty()
    }

    /// Appends a sample at `t_s` s.
    pub fn push(&mut self, t_s: f64, value: [f64; N]) {
        self.t_s.push(t_s);
        self.values.push(value);
    }

    /// One component, shape `(sample,)`.
    pub fn component(&self, i: usize) -> Vec<f64> {
        self.values.iter().map(|v| v[i]).collect()
    }

    /// Median distance of neighbouring samples, s; `None` with fewer than two.
    pub fn period_s(&self) -> Option<f64> {
        let steps = self.t_s.windows(2).map(|w| w[1] - w[0]).filter(|d| *d > 0.0).collect();
        super::clean::median(steps)
    }

    /// The samples with `from_s <= t < to_s`, times unchanged.
    pub fn between(&self, from_s: f64, to_s: f64) -> Self {
        let kept = || (0..self.len()).filter(|i| self.t_s[*i] >= from_s && self.t_s[*i] < to_s);
        Self { t_s: kept().map(|i| self.t_s[i]).collect(), values: kept().map(|i| self.values[i]).collect() }
    }

    /// The channel with every value changed by `f`.
    pub fn map(&self, f: impl Fn([f64; N]) -> [f64; N]) -> Self {
        Self { t_s: self.t_s.clone(), values: self.values.iter().map(|v| f(*v)).collect() }
    }

    /// Whether the times rise from sample to sample.
    pub fn is_ordered(&self) -> bool {
        self.t_s.windows(2).all(|w| w[1] > w[0])
    }
}
