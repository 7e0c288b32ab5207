//! Sensors on the drones of an arena, and what they have sampled.

use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use rayon::prelude::*;

use super::{Arena, ArenaError, Look};
use crate::random::{Key, purpose};
use crate::rollout::Equations;
use crate::scalar::lanes::Number;
use crate::sense::{Moment, SenseError, Sensor, SensorChannel};

/// When a world was sampled.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Taken {
    episode: u64,
    step: u64,
    /// Step of the sample before this one in the same episode.
    before: Option<u64>,
}

/// A sensor on every drone.
#[derive(Clone)]
pub(super) struct Mounted {
    sensor: Arc<dyn Sensor>,
    channels: Vec<SensorChannel>,
    /// What it has sampled, by channel: (world, drone, shape of the channel).
    values: Vec<Vec<f32>>,
    /// (world, drone, number)
    memory: Vec<f64>,
    /// The same before the last sample, from which a second one in the same step starts again.
    memory_before: Vec<f64>,
    /// The last sample, (world)
    sampled: Vec<Option<Taken>>,
}

/// What sensors remember of an arena that was saved.
#[derive(Clone, Debug, Default)]
pub(super) struct SavedSensors(Vec<Saved>);

/// What one of them remembers.
#[derive(Clone, Debug)]
struct Saved {
    memory: Vec<f64>,
    memory_before: Vec<f64>,
    sampled: Vec<Option<Taken>>,
    values: Vec<Vec<f32>>,
}

impl<N: Number> Arena<N> {
    /// Mounts a sensor on every drone, and gives its number. It samples when it is asked to ([`Arena::sample`]).
    ///
    /// # Errors
    /// [`ArenaError::Option`] for a name that another sensor has, and for channels without a name of their own or without numbers.
    pub fn add_sensor(&mut self, sensor: Arc<dyn Sensor>) -> Result<usize, ArenaError> {
        let (name, channels) = (sensor.name(), sensor.channels());
        if name.is_empty() || self.sensors.iter().any(|s| s.sensor.name() == name) {
            let expected = "a name that no other sensor has";
            return Err(ArenaError::option("sensor", expected, format!("{name:?}")));
        }
        for (i, channel) in channels.iter().enumerate() {
            let known = channels[..i].iter().any(|c| c.name == channel.name);
            if channel.name.is_empty() || known || channel.is_empty() {
                let expected = "channels of at least one number, each with a name of its own";
                return Err(ArenaError::option("sensor", expected, format!("{channel:?} of {name}")));
            }
        }
        let data = &self.sim.data;
        let rows = data.n_worlds * data.n_drones;
        self.sensors.push(Mounted {
            values: channels.iter().map(|c| vec![0.0; rows * c.len()]).collect(),
            memory: vec![0.0; rows * sensor.memory_len()],
            memory_before: vec![0.0; rows * sensor.memory_len()],
            sampled: vec![None; data.n_worlds],
            channels,
            sensor,
        });
        Ok(self.sensors.len() - 1)
    }

    /// Number of the sensor of this name.
    ///
    /// # Errors
    /// [`ArenaError::Option`] for a name that no sensor has, listing those that there are.
    pub fn sensor(&self, name: &str) -> Result<usize, ArenaError> {
        self.sensors.iter().position(|m| m.sensor.name() == name).ok_or_else(|| {
            let names: Vec<&str> = self.sensors.iter().map(|m| m.sensor.name()).collect();
            let expected = match names.is_empty() {
                true => "none, since no sensor is mounted".into(),
                false => format!("one of {}", names.join(", ")),
            };
            ArenaError::option("sensor", expected, name)
        })
    }

    /// Number of sensors.
    pub fn n_sensors(&self) -> usize {
        self.sensors.len()
    }

    /// The channels of a sensor.
    ///
    /// # Errors
    /// [`ArenaError::Option`] for a sensor that there is not.
    pub fn sensor_channels(&self, sensor: usize) -> Result<&[SensorChannel], ArenaError> {
        Ok(&self.mounted(sensor)?.channels)
    }

    /// Names of the sensors, by number.
    pub fn sensor_names(&self) -> impl ExactSizeIterator<Item = &str> {
        self.sensors.iter().map(Mounted::name)
    }

    /// As [`Arena::samples`], to be written into by whoever owns the arena; the array keeps its place and length as long as the arena lives.
    ///
    /// # Errors
    /// As [`Arena::samples`].
    pub fn samples_mut(&mut self, sensor: usize, channel: &str) -> Result<&mut [f32], ArenaError> {
        self.samples(sensor, channel)?;
        let mounted = &mut self.sensors[sensor];
        let i = mounted.channels.iter().position(|c| c.name == channel).unwrap_or_default();
        Ok(&mut mounted.values[i])
    }

    /// What a sensor sampled last, by channel: (world, drone, shape of the channel); zero before the first sample.
    ///
    /// # Errors
    /// [`ArenaError::Option`] for a sensor or a channel that there is not.
    pub fn samples(&self, sensor: usize, channel: &str) -> Result<&[f32], ArenaError> {
        let mounted = self.mounted(sensor)?;
        let found = mounted.channels.iter().position(|c| c.name == channel);
        found.map(|i| &mounted.values[i][..]).ok_or_else(|| {
            let names: Vec<&str> = mounted.channels.iter().map(|c| &*c.name).collect();
            ArenaError::option("channel", format!("one of {}", names.join(", ")), channel)
        })
    }

    fn mounted(&self, sensor: usize) -> Result<&Mounted, ArenaError> {
        self.sensors.get(sensor).ok_or_else(|| {
            let expected = format!("less than {}, the number of sensors", self.sensors.len());
            ArenaError::option("sensor", expected, sensor)
        })
    }

    /// Lets a sensor sample all drones of all worlds, or of those whose entry in `mask` is true, in parallel. Quarantined worlds keep
    /// their last sample. A second sample in the same step has the random numbers and the memory of the first: it differs only where the
    /// world was changed in between.
    ///
    /// # Errors
    /// [`ArenaError::Option`] for a sensor that there is not and for a mask of another length, [`ArenaError::Scene`] and
    /// [`ArenaError::Sense`] by worlds.
    pub fn sample(&mut self, sensor: usize, mask: Option<&[bool]>) -> Result<(), ArenaError> {
        self.mounted(sensor)?;
        self.sim.check_data()?;
        let n_worlds = self.sim.data.n_worlds;
        if let Some(mask) = mask.filter(|mask| mask.len() != n_worlds) {
            return Err(ArenaError::option(
                "mask",
                format!("one entry for each of {n_worlds} worlds"),
                mask.len(),
            ));
        }
        // Out of the arena while it looks at the arena.
        let mut mounted = self.sensors.swap_remove(sensor);
        let outcome = mounted.sample(self.look(), self.sim.equations(), mask);
        self.sensors.push(mounted);
        let last = self.sensors.len() - 1;
        self.sensors.swap(sensor, last);
        outcome
    }

    pub(super) fn save_sensors(&self) -> SavedSensors {
        let of = |m: &Mounted| Saved {
            memory: m.memory.clone(),
            memory_before: m.memory_before.clone(),
            sampled: m.sampled.clone(),
            values: m.values.clone(),
        };
        SavedSensors(self.sensors.iter().map(of).collect())
    }

    /// Refuses what other sensors remember.
    pub(super) fn check_sensors(&self, saved: &SavedSensors) -> Result<(), ArenaError> {
        let shape = |memory: &[f64], values: &[Vec<f32>]| -> Vec<usize> {
            core::iter::once(memory.len()).chain(values.iter().map(Vec::len)).collect()
        };
        let own: Vec<_> = self.sensors.iter().map(|m| shape(&m.memory, &m.values)).collect();
        let found: Vec<_> = saved.0.iter().map(|s| shape(&s.memory, &s.values)).collect();
        if own == found {
            return Ok(());
        }
        let words = |n: usize| format!("{n} sensors");
        Err(ArenaError::option(
            "saved state",
            words(own.len()) + " like those of this arena",
            words(found.len()),
        ))
    }

    pub(super) fn restore_sensors(&mut self, saved: &SavedSensors) {
        for (mounted, saved) in self.sensors.iter_mut().zip(&saved.0) {
            mounted.memory.copy_from_slice(&saved.memory);
            mounted.memory_before.copy_from_slice(&saved.memory_before);
            mounted.sampled.copy_from_slice(&saved.sampled);
            mounted.values.iter_mut().zip(&saved.values).for_each(|(to, from)| to.copy_from_slice(from));
        }
    }

    /// Copies what sensors remember of one world into all others.
    pub(super) fn fork_sensors(&mut self, world: usize) {
        let n_worlds = self.sim.data.n_worlds;
        fn spread<T: Copy>(list: &mut [T], n_worlds: usize, world: usize) {
            let each = list.len() / n_worlds;
            for w in 0..n_worlds {
                list.copy_within(world * each..(world + 1) * each, w * each);
            }
        }
        for mounted in &mut self.sensors {
            spread(&mut mounted.memory, n_worlds, world);
            spread(&mut mounted.memory_before, n_worlds, world);
            spread(&mut mounted.sampled, n_worlds, world);
            mounted.values.iter_mut().for_each(|values| spread(values, n_worlds, world));
        }
    }
}

impl Mounted {
    pub(super) fn name(&self) -> &str {
        self.sensor.name()
    }

    /// What it sampled last in a world, (drone, shape of the channel).
    pub(super) fn of_world(&self, world: usize, channel: &str) -> Option<&[f32]> {
        let values = &self.values[self.channels.iter().position(|c| c.name == channel)?];
        let each = values.len() / self.sampled.len();
        values.get(world * each..(world + 1) * each)
    }

    fn sample<N: Number>(
        &mut self,
        look: Look<N>,
        sim: Equations<N>,
        mask: Option<&[bool]>,
    ) -> Result<(), ArenaError> {
        let (n_worlds, n_drones) = (look.data().n_worlds, look.data().n_drones);
        let (sensor, channels) = (&self.sensor, &self.channels);
        let each = n_drones * sensor.memory_len();
        let (mut memory, mut memory_before) = (&mut self.memory[..], &mut self.memory_before[..]);
        let mut values: Vec<_> = self
            .values
            .iter_mut()
            .zip(channels)
            .map(|(v, c)| v.chunks_exact_mut(n_drones * c.len()))
            .collect();
        let mut worlds: Vec<_> = self
            .sampled
            .iter_mut()
            .enumerate()
            .map(|(world, sampled)| {
                let own = memory.split_off_mut(..each).unwrap_or_default();
                let before = memory_before.split_off_mut(..each).unwrap_or_default();
                let rows: Vec<&mut [f32]> = values.iter_mut().filter_map(Iterator::next).collect();
                (world, Rows { sampled, memory: own, memory_before: before, values: rows })
            })
            .collect();
        let found: Vec<Result<(), ArenaError>> = worlds
            .par_iter_mut()
            .map(|(world, rows)| {
                if mask.is_some_and(|mask| !mask[*world]) {
                    return Ok(());
                }
                sample_world(&**sensor, channels, (look, sim), *world, rows)
            })
            .collect();
        let mut failures = Vec::new();
        for (world, outcome) in found.into_iter().enumerate() {
            match outcome {
                Ok(()) => {}
                Err(ArenaError::Sense(e)) => failures.push((world, e)),
                Err(ArenaError::Scene(e)) => failures.push((world, e.into())),
                Err(e) => return Err(e),
            }
        }
        match failures.is_empty() {
            true => Ok(()),
            false => Err(SenseError::Worlds { worlds: n_worlds, failures }.into()),
        }
    }
}

/// Where the sample of one world goes.
struct Rows<'a, 'b> {
    /// The sample before.
    sampled: &'a mut Option<Taken>,
    memory: &'a mut [f64],
    memory_before: &'a mut [f64],
    /// Of each channel.
    values: Vec<&'b mut [f32]>,
}

fn sample_world<N: Number>(
    sensor: &dyn Sensor,
    channels: &[SensorChannel],
    (look, sim): (Look<N>, Equations<N>),
    world: usize,
    rows: &mut Rows,
) -> Result<(), ArenaError> {
    let data = look.data();
    if data.quarantine[world].is_some() {
        return Ok(());
    }
    let (episode, step) = (data.episodes[world], data.steps[world]);
    // A sample of an episode before this one is none.
    let last = rows.sampled.filter(|t| t.episode == episode && t.step <= step);
    let before = match last {
        // Once more in this step: from where the first one started, so that nothing depends on how often one looks.
        Some(taken) if taken.step == step => {
            rows.memory.copy_from_slice(rows.memory_before);
            taken.before
        }
        _ => {
            if last.is_none() {
                rows.memory.fill(0.0);
            }
            rows.memory_before.copy_from_slice(rows.memory);
            last.map(|t| t.step)
        }
    };
    let outcome = sample_drones(sensor, channels, (look, sim), world, before, rows);
    match outcome {
        Ok(()) => *rows.sampled = Some(Taken { episode, step, before }),
        // As if it had not been tried.
        Err(_) => rows.memory.copy_from_slice(rows.memory_before),
    }
    outcome
}

/// Samples every drone of a world, whose last sample was at step `before` of this episode.
fn sample_drones<N: Number>(
    sensor: &dyn Sensor,
    channels: &[SensorChannel],
    (look, sim): (Look<N>, Equations<N>),
    world: usize,
    before: Option<u64>,
    rows: &mut Rows,
) -> Result<(), ArenaError> {
    let data = look.data();
    let (n, options) = (data.n_drones, sim.options());
    let (episode, step) = (data.episodes[world], data.steps[world]);
    let dt_s = 1.0 / f64::from(options.sim_hz);
    let mut worker = match look.layout(world) {
        Some(_) => Some(look.world(world)?),
        None => None,
    };
    let each = sensor.memory_len();
    // Read once for all drones, where the sensor asks for it.
    let equations = OnceLock::new();
    for drone in 0..n {
        let state = data.state(world, drone);
        let read = || {
            let of_world = equations.get_or_init(|| Mutex::new(sim.of_world(world)));
            of_world.lock().unwrap_or_else(PoisonError::into_inner).reading(drone)
        };
        let (seed, number) = options.origin(world);
        let key = Key {
            seed,
            world: number,
            drone: drone as u32,
            // Episodes count from the top bits down, so that steps of two episodes never share a number.
            step: episode.rotate_left(40) ^ step,
            purpose: purpose(sensor.name()),
        };
        let mut at = Moment {
            drone,
            layout: look.layout(world),
            time_s: step as f64 * dt_s,
            since_s: (step - before.unwrap_or(0)).max(1) as f64 * dt_s,
            first: before.is_none(),
            pose: look.pose(world, drone),
            vel_m_s: state.vel,
            ang_vel_rad_s: state.ang_vel,
            worker: worker.as_deref_mut(),
            draw: key.stream(),
            read: &read,
        };
        let mut out: Vec<&mut [f32]> = rows
            .values
            .iter_mut()
            .zip(channels)
            .map(|(row, c)| &mut row[drone * c.len()..(drone + 1) * c.len()])
            .collect();
        sensor.sample(&mut at, &mut rows.memory[drone * each..(drone + 1) * each], &mut out)?;
    }
    Ok(())
}
