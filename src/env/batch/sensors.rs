//! Sensors of an environment: when they sample, and what worlds that ended had sampled.

use std::sync::Arc;

use super::Env;
use crate::arena::Arena;
use crate::env::EnvError;
use crate::env::config::{Autoreset, EnvConfig};
use crate::physics::controllers::ticks;
use crate::sense::{Sensor, SensorChannel};

/// A channel of a sensor, which is observed as `name`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct EnvSensorChannel {
    /// Name in observations: that of the sensor, an underscore and that of the channel.
    pub name: String,
    /// Name of the sensor.
    pub sensor: String,
    /// The channel.
    pub channel: SensorChannel,
}

/// When sensors sample, and what they had sampled in worlds that ended.
#[derive(Default)]
pub(super) struct Sensors {
    pub channels: Vec<EnvSensorChannel>,
    /// Samples per second of each sensor; none: one in each step of the environment.
    sample_hz: Vec<Option<u32>>,
    /// Which worlds are sampled; reused.
    due: Vec<bool>,
    /// By channel, as in the arena; empty unless worlds are reset within a step.
    finals: Vec<Vec<f32>>,
}

impl Sensors {
    /// Takes over a sensor that the arena has just got.
    fn add(
        &mut self,
        arena: &Arena<f32>,
        config: &EnvConfig,
        sensor: usize,
        sample_hz: Option<u32>,
    ) -> Result<(), EnvError> {
        let name = arena.sensor_names().nth(sensor).unwrap_or_default().to_string();
        if let Some(hz) = sample_hz.filter(|hz| !(1..=config.step_hz).contains(hz)) {
            let expected =
                format!("1 to {} Hz, at most one sample in each step of the environment", config.step_hz);
            return Err(EnvError::option(format!("sample_hz of the sensor {name}"), expected, hz));
        }
        for channel in arena.sensor_channels(sensor)? {
            let values = arena.samples(sensor, &channel.name)?;
            let kept = if config.autoreset == Autoreset::SameStep { values.len() } else { 0 };
            self.finals.push(vec![0.0; kept]);
            self.channels.push(EnvSensorChannel {
                name: format!("{name}_{}", channel.name),
                sensor: name.clone(),
                channel: channel.clone(),
            });
        }
        self.sample_hz.push(sample_hz);
        Ok(())
    }

    /// Lets sensors sample the worlds of a mask, or all, where a sample is due. In a new episode there is one at once.
    pub fn sample(
        &mut self,
        arena: &mut Arena<f32>,
        config: &EnvConfig,
        mask: Option<&[bool]>,
    ) -> Result<(), EnvError> {
        let substeps = u64::from(config.substeps());
        for (sensor, hz) in self.sample_hz.iter().enumerate() {
            let Some(hz) = *hz else {
                arena.sample(sensor, mask)?;
                continue;
            };
            let steps = &arena.sim().data.steps;
            self.due.clear();
            self.due.extend(
                steps.iter().enumerate().map(|(w, steps)| {
                    mask.is_none_or(|m| m[w]) && ticks(steps / substeps, hz, config.step_hz)
                }),
            );
            arena.sample(sensor, Some(&self.due))?;
        }
        Ok(())
    }

    /// Keeps what worlds of a mask have sampled.
    pub fn keep_final(&mut self, arena: &Arena<f32>, mask: &[bool]) -> Result<(), EnvError> {
        for (kept, channel) in self.finals.iter_mut().zip(&self.channels) {
            let values = arena.samples(arena.sensor(&channel.sensor)?, &channel.channel.name)?;
            let each = values.len() / mask.len();
            for w in (0..mask.len()).filter(|w| mask[*w]) {
                let row = w * each..(w + 1) * each;
                kept[row.clone()].copy_from_slice(&values[row]);
            }
        }
        Ok(())
    }

    /// What worlds that ended had sampled.
    pub fn final_samples(&mut self, sensor: &str, channel: &str) -> &mut [f32] {
        let of = |c: &EnvSensorChannel| c.sensor == sensor && c.channel.name == channel;
        match self.channels.iter().position(of) {
            Some(i) => &mut self.finals[i],
            None => &mut [],
        }
    }
}

impl Env {
    /// Mounts a sensor of the caller's on every drone, beside those of the description, before the first reset. It samples `sample_hz` times
    /// a second, or in every step.
    ///
    /// # Errors
    /// [`EnvError::Option`] for a name that another sensor has, for a rate above that of steps, for a channel
    /// that would be observed under a name that there is already, and after a reset.
    pub fn add_sensor(&mut self, sensor: Arc<dyn Sensor>, sample_hz: Option<u32>) -> Result<(), EnvError> {
        if self.begun {
            return Err(EnvError::option("sensor", "one before the first reset", sensor.name()));
        }
        let number = self.arena.add_sensor(sensor)?;
        self.take_sensor(number, sample_hz)
    }

    /// Takes over a sensor of the arena.
    pub(super) fn take_sensor(&mut self, number: usize, sample_hz: Option<u32>) -> Result<(), EnvError> {
        let before = self.sensors.channels.len();
        self.sensors.add(&self.arena, &self.plan.config, number, sample_hz)?;
        let known: Vec<String> = self.channels().into_iter().map(|c| c.name.into_owned()).collect();
        for (i, channel) in self.sensors.channels.iter().enumerate().skip(before) {
            let name = &channel.name;
            let twice = self.sensors.channels[..i].iter().any(|c| c.name == *name);
            if twice || name == "depth" || known.contains(name) {
                let expected = format!("a name under which nothing else is observed, not one of {known:?}");
                return Err(EnvError::option("sensor", expected, format!("{name:?}")));
            }
        }
        Ok(())
    }
}
