//! How do I give drones a sensor that Propwash does not have?
//!
//! Here it is a barometer: pressure by the standard atmosphere (ISO 2533), white noise, and a drift that it remembers. One value
//! serves all drones of all worlds. Run it from the folder of the project: `cargo run --example own_sensor`.

use std::sync::Arc;

use propwash::arena::{Arena, SimConfig};
use propwash::rollout::trajectory::Reference;
use propwash::sense::{Moment, SenseError, Sensor, SensorChannel};

/// A barometer.
struct Barometer {
    /// Standard deviation of a sample, Pa.
    noise_pa: f64,
    /// Drift, Pa/√s.
    drift_pa_sqrt_s: f64,
}

/// Pressure at a height over sea level, Pa.
fn pressure_pa(height_m: f64) -> f64 {
    101_325.0 * (1.0 - 2.255_77e-5 * height_m).powf(5.255_88)
}

impl Sensor for Barometer {
    fn name(&self) -> &str {
        "barometer"
    }

    fn channels(&self) -> Vec<SensorChannel> {
        vec![SensorChannel::new("pressure", "Pa", &[])]
    }

    /// How far it has drifted, Pa.
    fn memory_len(&self) -> usize {
        1
    }

    fn sample(&self, at: &mut Moment, memory: &mut [f64], out: &mut [&mut [f32]]) -> Result<(), SenseError> {
        memory[0] += self.drift_pa_sqrt_s * at.since_s.sqrt() * at.draw.normal();
        let noise = self.noise_pa * at.draw.normal();
        out[0][0] = (pressure_pa(at.pose.pos_m[2]) + memory[0] + noise) as f32;
        Ok(())
    }
}

fn main() -> propwash::Result<()> {
    // Eight worlds of one drone each climb by 5 m.
    let mut config = SimConfig::default();
    config.options.n_worlds = 8;
    let mut arena = Arena::<f32>::from_config(&config)?;
    let sensor = arena.add_sensor(Arc::new(Barometer { noise_pa: 1.0, drift_pa_sqrt_s: 0.2 }))?;
    arena.sample(sensor, None)?;
    let before = arena.samples(sensor, "pressure")?.to_vec();
    arena.set_command(&Reference::hover([0.0, 0.0, 5.0], 0.0).command().repeat(8))?;
    for _ in 0..200 {
        arena.step(25)?;
        arena.sample(sensor, None)?;
    }
    let after = arena.samples(sensor, "pressure")?;
    let fall: f32 = before.iter().zip(after).map(|(b, a)| b - a).sum::<f32>() / 8.0;
    let truth = pressure_pa(0.0) - pressure_pa(arena.sim().data.state(0, 0).pos[2]);
    println!("pressure falls by {fall:.1} Pa, by the standard atmosphere {truth:.1} Pa");
    println!("eight barometers read {after:.1?} Pa");
    Ok(())
}
