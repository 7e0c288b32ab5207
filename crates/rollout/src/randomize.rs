//! Domain randomisation: which parameters and initial states are drawn anew at every reset, and from what.

use super::RolloutError;
use crate::random::{Key, Stream, purpose};

/// What a drawn number does to the nominal one.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields, rename_all = "snake_case")]
pub enum Draw {
    /// Takes its place: uniform in [low, high).
    Uniform([f64; 2]),
    /// Multiplies it: uniform in [low, high).
    Scale([f64; 2]),
    /// Is added to it: normal with this standard deviation.
    Normal(f64),
}

/// One rule. `parameter` is a name of [`propwash_physics::drone::Drone::visit`], where `*` stands for any part between
/// dots (`rotors.*.thrust_curve.2`), or one of `initial.pos.0` … `2`, `initial.vel.*`, `initial.ang_vel.*` and
/// `initial.rotation.*` (rotation vector, rad, body). Every matching number is drawn for itself unless `shared` is set.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Rule {
    /// Which number.
    pub parameter: String,
    /// How it is drawn.
    pub draw: Draw,
    /// One draw for all numbers that match.
    #[serde(default)]
    pub shared: bool,
}

/// All rules. As TOML: a list of `[[rule]]` tables.
///
/// ```
/// use propwash_rollout::randomize::Randomization;
///
/// let rules = Randomization::from_toml("[[rule]]\nparameter = \"body.mass_kg\"\ndraw = { scale = [0.9, 1.1] }")?;
/// assert_eq!(rules.rules.len(), 1);
/// # Ok::<(), propwash_rollout::RolloutError>(())
/// ```
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Randomization {
    /// The rules, applied in order.
    #[serde(default, rename = "rule")]
    pub rules: Vec<Rule>,
}

impl Randomization {
    /// Reads rules from TOML text.
    pub fn from_toml(text: &str) -> Result<Self, RolloutError> {
        let out: Self = toml::from_str(text).map_err(|e| {
            let line = e.span().map_or(1, |at| 1 + text[..at.start].matches('\n').count());
            RolloutError::Randomization {
                rule: "file".into(),
                reason: format!("line {line}: {}", e.message().trim()),
            }
        })?;
        for rule in &out.rules {
            rule.check()?;
        }
        Ok(out)
    }
}

impl Rule {
    /// Refuses bounds that are not finite or in the wrong order.
    pub fn check(&self) -> Result<(), RolloutError> {
        let fault = match self.draw {
            Draw::Uniform([a, b]) | Draw::Scale([a, b]) => !(a.is_finite() && b.is_finite() && a <= b),
            Draw::Normal(sigma) => !(sigma.is_finite() && sigma >= 0.0),
        };
        if fault {
            return Err(RolloutError::Randomization {
                rule: self.parameter.clone(),
                reason: format!(
                    "expected finite bounds in order, or a sigma of at least 0; got {:?}",
                    self.draw
                ),
            });
        }
        Ok(())
    }

    /// Whether this rule speaks of the number called `name`.
    pub fn matches(&self, name: &str) -> bool {
        let (mut a, mut b) = (self.parameter.split('.'), name.split('.'));
        loop {
            match (a.next(), b.next()) {
                (None, None) => return true,
                (Some(x), Some(y)) if x == "*" || x == y => {}
                _ => return false,
            }
        }
    }

    /// The drawn number for a nominal one; `key` names world, drone and episode.
    pub fn apply(&self, name: &str, nominal: f64, key: Key) -> f64 {
        let of = if self.shared { self.parameter.as_str() } else { name };
        let mut stream: Stream = Key { purpose: purpose(of), ..key }.stream();
        match self.draw {
            Draw::Uniform([low, high]) => stream.uniform(low, high),
            Draw::Scale([low, high]) => nominal * stream.uniform(low, high),
            Draw::Normal(sigma) => nominal + sigma * stream.normal(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_star_stands_for_one_part_of_a_name() {
        let rule = Rule { parameter: "rotors.*.spin_up.0".into(), draw: Draw::Normal(0.1), shared: false };
        assert!(rule.matches("rotors.3.spin_up.0"));
        assert!(!rule.matches("rotors.3.spin_up.1"));
        assert!(!rule.matches("rotors.3.spin_up"));
    }

    #[test]
    fn wrong_rules_are_refused_with_their_name() {
        let text = "[[rule]]\nparameter = \"body.mass_kg\"\ndraw = { uniform = [2.0, 1.0] }\n";
        let message = Randomization::from_toml(text).unwrap_err().to_string();
        assert!(message.contains("body.mass_kg") && message.contains("in order"), "{message}");
        let text = "[[rule]]\nparameter = \"body.mass_kg\"\ndraw = { gamma = 1.0 }\n";
        let message = Randomization::from_toml(text).unwrap_err().to_string();
        assert!(message.contains("gamma") && message.contains("uniform"), "{message}");
    }

    #[test]
    fn shared_draws_are_equal_and_others_are_not() {
        let key = Key { seed: 1, world: 0, drone: 0, step: 0, purpose: 0 };
        let mut rule =
            Rule { parameter: "rotors.*.spin_up.0".into(), draw: Draw::Scale([0.5, 1.5]), shared: true };
        let draw = |r: &Rule, n: &str| r.apply(n, 1.0, key);
        assert_eq!(draw(&rule, "rotors.0.spin_up.0"), draw(&rule, "rotors.1.spin_up.0"));
        rule.shared = false;
        assert_ne!(draw(&rule, "rotors.0.spin_up.0"), draw(&rule, "rotors.1.spin_up.0"));
    }
}
