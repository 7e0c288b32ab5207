//! Adam: steps along a gradient, each weight by the size of its own (Kingma & Ba, "Adam: a method for stochastic optimization", 2015).

/// Shares of the past in the mean gradient and in its mean square, and what keeps the division finite, as in the paper.
const BETA: [f32; 2] = [0.9, 0.999];
const LEAST: f32 = 1e-8;

/// Its memory.
#[derive(Clone, Debug)]
pub(crate) struct Adam {
    mean: Vec<f32>,
    square: Vec<f32>,
    steps: i32,
}

impl Adam {
    pub fn new(n: usize) -> Self {
        Self { mean: vec![0.0; n], square: vec![0.0; n], steps: 0 }
    }

    /// Takes a step of at most about `rate` down the gradient.
    pub fn step(&mut self, weights: &mut [f32], gradient: &[f32], rate: f32) {
        self.steps += 1;
        let unbiased = BETA.map(|beta| 1.0 - beta.powi(self.steps));
        for (((w, g), m), v) in weights.iter_mut().zip(gradient).zip(&mut self.mean).zip(&mut self.square) {
            *m = BETA[0] * *m + (1.0 - BETA[0]) * g;
            *v = BETA[1] * *v + (1.0 - BETA[1]) * g * g;
            *w -= rate * (*m / unbiased[0]) / ((*v / unbiased[1]).sqrt() + LEAST);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_finds_the_bottom_of_a_narrow_valley() {
        let (mut x, mut adam) = (vec![1.0, -2.0], Adam::new(2));
        for k in 0..2000 {
            let gradient = [2.0 * x[0], 200.0 * (x[1] - 0.5)];
            adam.step(&mut x, &gradient, 0.02 * (1.0 - k as f32 / 2000.0));
        }
        assert!(x[0].abs() < 1e-3 && (x[1] - 0.5).abs() < 2e-3, "{x:?}");
    }
}
