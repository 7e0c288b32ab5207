//! What the measured voltage of a battery goes with: the charge that was drawn and the current.
//!
//! Regression of V = V_full − k q − R I, the law of the effect `battery_sag`, with the current of ideal discs at its default
//! efficiency. Only products of that efficiency with k and R are told.

use super::replay::{Around, Context, STEP, TICK_S, drive};
use super::track::Track;
use super::track::throttle::{has_voltage, voltage};
use nalgebra::{DMatrix, DVector};
use propwash_flight::clean::{median, quantile};
use propwash_physics::drone::Drone;
use propwash_physics::effects::{Command, View, battery_sag};
use propwash_physics::rigid_body::State;
use propwash_physics::surroundings::Surroundings;
use propwash_vehicle::schema::ThrottleOf;

/// Share by which a voltage must fall for what goes with it to show.
const FALLS: f64 = 0.01;
/// Fewest instants for a law.
const FEWEST: usize = 100;

/// Law of a battery's voltage.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Law {
    /// At the beginning of a flight, V: what a vehicle is built and measured with.
    nominal_v: f64,
    /// Of the full battery, V: mean over the logs, each of which may begin with another charge.
    full_v: f64,
    /// Internal resistance, Ω.
    resistance_ohm: f64,
    /// Fall with the charge, V/(A·s).
    drop_v_per_a_s: f64,
}

impl Law {
    /// A parameter of the effect `battery_sag`.
    pub fn of(&self, name: &str) -> Option<f64> {
        match name {
            "nominal_v" => Some(self.nominal_v),
            "full_v" => Some(self.full_v),
            "resistance_ohm" => Some(self.resistance_ohm),
            "drop_v_per_a_s" => Some(self.drop_v_per_a_s),
            _ => None,
        }
    }
}

/// Whether the battery's voltage falls along a log by more than noise.
pub(crate) fn falls(track: &Track) -> bool {
    let in_flight: Vec<f64> = flown(track).map(|v| v.1).collect();
    let (low, high) = (quantile(&in_flight, 0.05), quantile(&in_flight, 0.95));
    low.zip(high).is_some_and(|(low, high)| high - low > FALLS * high)
}

/// Times and voltages of the samples in flight.
fn flown(track: &Track) -> impl Iterator<Item = (f64, f64)> + '_ {
    let [from, to] = track.span_s;
    let all = track.log.vbat_v.t_s.iter().zip(&track.log.vbat_v.values).map(|(t, v)| (*t, v[0]));
    all.filter(move |(t, _)| (from..=to).contains(t))
}

/// The law behind the voltages of logs; `None` where too little was logged.
pub(crate) fn law(drone: &Drone<f64>, tracks: &[&Track], arounds: &[&Around]) -> Option<Law> {
    let with: Vec<(&&Track, &&Around)> =
        tracks.iter().zip(arounds).filter(|(t, _)| has_voltage(&t.log)).collect();
    let begins =
        |(track, _): &(&&Track, &&Around)| quantile(&flown(track).map(|v| v.1).collect::<Vec<_>>(), 0.95);
    let nominal_v = median(with.iter().filter_map(begins).collect())?;
    // Columns: charge, current, one constant per log.
    let (mut rows, mut volts) = (Vec::new(), Vec::new());
    for (log, (track, around)) in with.iter().enumerate() {
        let at: Vec<f64> = (0..around.n_ticks).step_by(STEP).map(|k| around.time_s(k)).collect();
        let measured = voltage(&track.log.vbat_v, ThrottleOf::Battery, 0.0, &at);
        let mut charge = 0.0;
        for (power, v) in powers(track, around, drone).into_iter().zip(measured) {
            let current = power / (battery_sag::Params::default().efficiency * v.max(1e-3));
            charge += current * STEP as f64 * TICK_S;
            rows.push((log, -charge, -current));
            volts.push(v);
        }
    }
    if rows.len() < FEWEST {
        return None;
    }
    let b = DVector::from_vec(volts);
    let fitted = |free: [bool; 2]| -> Option<DVector<f64>> {
        let a = DMatrix::from_fn(rows.len(), 2 + with.len(), |i, j| match (j, rows[i]) {
            (0, (_, charge, _)) => {
                if free[0] {
                    charge
                } else {
                    0.0
                }
            }
            (1, (_, _, current)) => {
                if free[1] {
                    current
                } else {
                    0.0
                }
            }
            (j, (log, ..)) => f64::from(u8::from(j - 2 == log)),
        });
        // The least solution leaves what is not free at zero.
        a.svd(true, true).solve(&b, 1e-12).ok()
    };
    // A battery neither charges in flight nor has a negative resistance.
    let mut free = [true; 2];
    let mut x = fitted(free)?;
    for _ in 0..2 {
        let Some(k) = (0..2).find(|k| x[*k] < 0.0) else { break };
        free[k] = false;
        x = fitted(free)?;
    }
    let rounded = |v: f64| format!("{v:.4e}").parse().unwrap_or(v);
    Some(Law {
        nominal_v: rounded(nominal_v),
        full_v: rounded(x.rows(2, with.len()).mean()),
        drop_v_per_a_s: rounded(x[0].max(0.0)),
        resistance_ohm: rounded(x[1].max(0.0)),
    })
}

/// Power that the rotors put into the air at every step, W, by the model's motors.
fn powers(track: &Track, around: &Around, drone: &Drone<f64>) -> Vec<f64> {
    let Context { raw, .. } = Context::of(track, drone);
    let parts = drone.parts();
    let surroundings = Surroundings::calm();
    let battery = battery_sag::Params::default();
    let one = |tick: &super::replay::Tick<f64>| {
        let state = State { rotor_vel: tick.rotor_vel, thrust: tick.thrust, ..State::rest() };
        let collective_n = parts.response.is_some().then_some(tick.thrust);
        let view = View {
            body: &parts.body,
            airframe: &parts.airframe,
            state: &state,
            surroundings: &surroundings,
            collective_n,
            memory: &[],
        };
        let command = match collective_n {
            Some(thrust) => Command::Attitude([0.0, 0.0, 0.0, thrust]),
            None => Command::Rotors(tick.rotor_vel),
        };
        battery.power(&view, &command)
    };
    drive(track, around, &raw, drone).iter().step_by(STEP).map(one).collect()
}
