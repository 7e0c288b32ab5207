//! What replays of one log share, whatever parameter of the vehicle is tried: kept with the track, since a search, a judge
//! and a page look at the same log hundreds of times.

use super::{Around, Raw};
use crate::cable;
use crate::track::Track;
use propwash_physics::drone::Drone;
use std::sync::{Arc, Mutex, PoisonError};

/// The context and the inputs of a log.
#[derive(Clone, Debug)]
pub(crate) struct Context {
    pub around: Arc<Around>,
    pub raw: Arc<Raw>,
}

/// Contexts of a track, the latest last, by what they depend on; clones of a track share them.
#[derive(Clone, Debug, Default)]
pub(crate) struct Contexts(Arc<Mutex<Vec<(String, Context)>>>);

/// Most of them: more would only be of cables tried one after the other.
const KEPT: usize = 2;

impl Context {
    /// The context of a log for a vehicle.
    pub fn of(track: &Track, drone: &Drone<f64>) -> Self {
        let key = key(track, drone);
        let kept = || track.contexts.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, found)) = kept().iter().find(|(k, _)| *k == key) {
            return found.clone();
        }
        // Not inside the lock: what makes it may wait for other threads, which may wait for it.
        let around = Around::new(track, drone);
        let raw = Raw::new(track, &around);
        let out = Self { around: Arc::new(around), raw: Arc::new(raw) };
        let mut kept = kept();
        kept.push((key, out.clone()));
        let extra = kept.len().saturating_sub(KEPT);
        kept.drain(..extra);
        out
    }
}

/// All numbers of track and vehicle by which contexts differ; of the vehicle only what hangs on it, and its wake where other
/// vehicles are near.
fn key(track: &Track, drone: &Drone<f64>) -> String {
    let wake = (!track.neighbours.is_empty()).then(|| (drone.hover_thrust(), drone.disc_radius_m()));
    let Track { span_s, noise, neighbours, load, excluded, .. } = track;
    let (gravity, hung) = (drone.body.gravity_m_s2, cable::filed(drone));
    format!("{span_s:?} {noise:?} {neighbours:?} {load:?} {} {gravity:?} {wake:?} {hung:?}", excluded.len())
}
