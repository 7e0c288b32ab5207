//! Every threshold of the gap finder, each with what it states and what set it.

/// Part of the frequencies up to half the sample rate in which a measured input holds nothing but noise.
///
/// Rotors of small vehicles follow to 5 to 10 Hz; speeds are logged at 100 to 500 Hz. The uppermost part is left out: loggers
/// that interpolate have less noise there (a Crazyflie's deck at 500 Hz: 2.4 rad/s up to 200 Hz, 0.7 at 250 Hz).
pub(in crate::gap) const NOISE_BAND: [f64; 2] = [0.4, 0.8];

/// Coherence of an input with what answers it, at its best frequency, from which on frequencies of less coherence are taken
/// to hold noise. Below, it is the answer that is noisy.
pub(in crate::gap) const COHERENT_FROM: f64 = 0.6;

/// Logarithm of the ratio below which the noise of a channel counts as settled.
pub(in crate::gap) const NOISE_SETTLED: f64 = 0.15;

/// Samples on end over which errors of a channel are looked for that keep their sign. Windows of 0.25 s hold 60 poses at
/// 240 Hz; what lasts longer is part of a window's start.
pub(in crate::gap) const SLOWEST_NOISE: usize = 40;

/// Error of an attitude that drives the model, before a log says more, rad: estimators are off by one to two degrees in
/// manoeuvres.
pub(in crate::gap) const GIVEN_ATTITUDE_RAD: f64 = 0.02;
