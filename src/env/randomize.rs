//! Disturbances, delays and noise of an environment, fixed or drawn anew at every reset.

use serde::{Deserialize, Serialize};

use super::EnvError;
use crate::random::Key;
use crate::rollout::randomize::{Draw, Randomization, Rule};

/// Levels of what an environment adds to flying and sensing. Rules of a [`Randomization`] change them under the name
/// `env.FIELD`, or `env.FIELD.AXIS`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Levels {
    /// Time that a command takes to the vehicle, s; whole steps of the simulation, to the nearest.
    pub action_delay_s: f64,
    /// Age of a depth image when it is observed, s; whole steps of the environment, to the nearest.
    pub depth_delay_s: f64,
    /// Velocity of the air, m/s, world.
    pub wind_m_s: [f64; 3],
    /// Force that disturbs every drone, N, world.
    pub force_n: [f64; 3],
    /// Standard deviation of the observed position, m.
    pub pos_sigma_m: f64,
    /// Of the observed velocity, m/s.
    pub vel_sigma_m_s: f64,
    /// Of the observed attitude, rad about each axis of the body.
    pub attitude_sigma_rad: f64,
    /// Of the observed angular velocity, rad/s.
    pub ang_vel_sigma_rad_s: f64,
    /// Factor of all standard deviations and chances of the depth sensor's noise.
    pub depth_noise: f64,
}

/// Names of the levels, as rules give them.
pub const LEVELS: [&str; 13] = [
    "env.action_delay_s",
    "env.depth_delay_s",
    "env.wind_m_s.0",
    "env.wind_m_s.1",
    "env.wind_m_s.2",
    "env.force_n.0",
    "env.force_n.1",
    "env.force_n.2",
    "env.pos_sigma_m",
    "env.vel_sigma_m_s",
    "env.attitude_sigma_rad",
    "env.ang_vel_sigma_rad_s",
    "env.depth_noise",
];

/// Most seconds of a delay: images and commands are kept that long.
const MOST_DELAY_S: f64 = 1.0;

impl Default for Levels {
    /// No disturbance, no delay, no noise but the depth sensor's own.
    fn default() -> Self {
        Self {
            action_delay_s: 0.0,
            depth_delay_s: 0.0,
            wind_m_s: [0.0; 3],
            force_n: [0.0; 3],
            pos_sigma_m: 0.0,
            vel_sigma_m_s: 0.0,
            attitude_sigma_rad: 0.0,
            ang_vel_sigma_rad_s: 0.0,
            depth_noise: 1.0,
        }
    }
}

impl Levels {
    /// The numbers in the order of [`LEVELS`].
    fn numbers(&mut self) -> [&mut f64; LEVELS.len()] {
        let [wx, wy, wz] = &mut self.wind_m_s;
        let [fx, fy, fz] = &mut self.force_n;
        [
            &mut self.action_delay_s,
            &mut self.depth_delay_s,
            wx,
            wy,
            wz,
            fx,
            fy,
            fz,
            &mut self.pos_sigma_m,
            &mut self.vel_sigma_m_s,
            &mut self.attitude_sigma_rad,
            &mut self.ang_vel_sigma_rad_s,
            &mut self.depth_noise,
        ]
    }

    /// Refuses numbers that make no sense.
    pub(super) fn check(&self) -> Result<(), EnvError> {
        let mut own = *self;
        for (name, value) in LEVELS.iter().zip(own.numbers()) {
            let free = name.starts_with("env.wind") || name.starts_with("env.force");
            let most = if name.ends_with("delay_s") { MOST_DELAY_S } else { 1e6 };
            if !(value.is_finite() && *value <= most && (free || *value >= 0.0)) {
                let expected = if free { "a finite number".to_string() } else { format!("0 to {most}") };
                return Err(EnvError::option(*name, expected, value));
            }
        }
        Ok(())
    }

    /// Whether the air moves or a force acts.
    pub(super) fn disturb(&self) -> bool {
        self.wind_m_s != [0.0; 3] || self.force_n != [0.0; 3]
    }

    /// Whether the observed state differs from the true one.
    pub(super) fn is_noisy(&self) -> bool {
        [self.pos_sigma_m, self.vel_sigma_m_s, self.attitude_sigma_rad, self.ang_vel_sigma_rad_s]
            .iter()
            .any(|v| *v > 0.0)
    }
}

/// The rules of an environment, those of the simulation taken out.
#[derive(Clone, Debug, Default)]
pub(super) struct LevelRules(Vec<Rule>);

impl LevelRules {
    /// Parts the rules: those for the simulation, and those for [`Levels`].
    ///
    /// # Errors
    /// [`EnvError::Option`] for a rule of `env.…` that names no level or whose draws could be negative where they must not be.
    pub fn part(all: &Randomization, levels: &Levels) -> Result<(Randomization, Self), EnvError> {
        let (own, rest): (Vec<Rule>, Vec<Rule>) =
            all.rules.iter().cloned().partition(|r| r.parameter.starts_with("env."));
        for rule in &own {
            rule.check()?;
            if !LEVELS.iter().any(|name| rule.matches(name)) {
                return Err(EnvError::option(
                    format!("randomization of {}", rule.parameter),
                    format!("one of {}", LEVELS.join(", ")),
                    "a name that none of them has",
                ));
            }
        }
        let rules = Self(own);
        // The ends of every draw must be levels that are allowed: a normal draw of what cannot be negative is not.
        for end in 0..2 {
            let mut probe = *levels;
            for (name, value) in LEVELS.iter().zip(probe.numbers()) {
                for rule in rules.0.iter().filter(|r| r.matches(name)) {
                    *value = match rule.draw {
                        Draw::Uniform(ends) => ends[end],
                        Draw::Scale(ends) => *value * ends[end],
                        Draw::Normal(sigma) => *value + if end == 0 { -6.0 * sigma } else { 6.0 * sigma },
                    };
                }
            }
            probe.check()?;
        }
        Ok((Randomization { rules: rest }, rules))
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// The levels of one episode. A `normal` draw beyond six sigmas of what must not be negative is taken as 0.
    pub fn draw(&self, levels: &Levels, key: Key) -> Levels {
        let mut out = *levels;
        if self.0.is_empty() {
            return out;
        }
        for (name, value) in LEVELS.iter().zip(out.numbers()) {
            for rule in self.0.iter().filter(|r| r.matches(name)) {
                *value = rule.apply(name, *value, key);
            }
            if !(name.starts_with("env.wind") || name.starts_with("env.force")) {
                *value = value.max(0.0);
            }
        }
        out
    }

    /// The greatest value that a level can have.
    pub fn most(&self, name: &str, level: f64) -> f64 {
        self.0.iter().filter(|r| r.matches(name)).fold(level, |value, rule| match rule.draw {
            Draw::Uniform(ends) => ends[1],
            Draw::Scale(ends) => value * ends[1],
            Draw::Normal(sigma) => value + 10.0 * sigma,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rules(text: &str) -> Randomization {
        Randomization::from_toml(text).unwrap()
    }

    #[test]
    fn rules_are_parted_by_their_names_and_draw_within_their_bounds() {
        let all = rules(
            "[[rule]]\nparameter = \"body.mass_kg\"\ndraw = { scale = [0.9, 1.1] }\n\
             [[rule]]\nparameter = \"env.wind_m_s.*\"\ndraw = { uniform = [-2.0, 2.0] }\n\
             [[rule]]\nparameter = \"env.action_delay_s\"\ndraw = { uniform = [0.01, 0.03] }\n",
        );
        let (rest, own) = LevelRules::part(&all, &Levels::default()).unwrap();
        assert_eq!(rest.rules.len(), 1);
        let draw = |step| own.draw(&Levels::default(), Key { seed: 1, world: 2, drone: 0, step, purpose: 0 });
        let (a, b) = (draw(0), draw(1));
        assert_eq!(a, draw(0));
        assert_ne!(a, b);
        assert_ne!(a.wind_m_s[0], a.wind_m_s[1], "every axis is drawn for itself");
        assert!((0.01..0.03).contains(&a.action_delay_s) && a.wind_m_s.iter().all(|v| v.abs() < 2.0));
        assert_eq!(own.most("env.action_delay_s", 0.0), 0.03);
    }

    #[test]
    fn rules_that_make_no_sense_are_refused_by_name() {
        let refused =
            |text: &str| LevelRules::part(&rules(text), &Levels::default()).unwrap_err().to_string();
        let message = refused("[[rule]]\nparameter = \"env.wind\"\ndraw = { uniform = [0.0, 1.0] }\n");
        assert!(message.contains("env.wind") && message.contains("env.wind_m_s.0"), "{message}");
        let message =
            refused("[[rule]]\nparameter = \"env.pos_sigma_m\"\ndraw = { uniform = [-0.1, 0.1] }\n");
        assert!(message.contains("env.pos_sigma_m") && message.contains("-0.1"), "{message}");
        let message =
            refused("[[rule]]\nparameter = \"env.depth_delay_s\"\ndraw = { uniform = [0.0, 20.0] }\n");
        assert!(message.contains("env.depth_delay_s") && message.contains("0 to 1"), "{message}");
    }
}
