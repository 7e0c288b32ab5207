//! What the sensors of a log read at its instants, through local fits: it depends on a sensor's clock, and on nothing else of
//! a vehicle, so that it is kept for the next one.

use propwash_flight::resample::Local;
use std::sync::{Arc, Mutex, PoisonError};

/// Local fits through the inertial sensors, and angular accelerations from attitudes, at all instants of a log.
#[derive(Debug, Default)]
pub(crate) struct Readings {
    pub accel: Kept<Vec<Option<Local<3>>>>,
    pub position: Kept<Vec<Option<Local<3>>>>,
    pub gyro: Kept<Vec<Option<Local<3>>>>,
    pub bends: Kept<Vec<Option<[f64; 3]>>>,
}

/// Most clocks for which they are kept: as filed, and as estimated.
const KEPT: usize = 4;

/// Values by a sensor's delay.
#[derive(Debug)]
pub(crate) struct Kept<T>(Mutex<Vec<(u64, Arc<T>)>>);

impl<T> Default for Kept<T> {
    fn default() -> Self {
        Self(Mutex::default())
    }
}

impl<T> Kept<T> {
    /// The values for a delay, s.
    pub fn at(&self, late_s: f64, make: impl FnOnce() -> T) -> Arc<T> {
        let key = late_s.to_bits();
        let known = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, found)) = known.iter().find(|(k, _)| *k == key) {
            return found.clone();
        }
        // Not inside the lock: what makes it may wait for other threads, which may wait for it.
        drop(known);
        let made = Arc::new(make());
        let mut known = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        known.push((key, made.clone()));
        let extra = known.len().saturating_sub(KEPT);
        known.drain(..extra);
        made
    }
}
