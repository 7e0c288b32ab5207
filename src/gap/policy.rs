//! Thresholds of the gap finder: each a named number with what it states and what set it.
//!
//! Nothing is written into a vehicle file that makes it fly worse on flight that the fit has not seen. A vehicle's errors
//! there are those of six channels: force and torque that the model lacks at the instants, position and attitude at the
//! end of roll-outs of 0.5 and 1 s. One vehicle is *worse* than another where the geometric mean of its errors over
//! theirs is above one.

/// Part of the frequencies up to half the sample rate in which a measured input holds nothing but noise.
///
/// Rotors of small vehicles follow to 5 to 10 Hz; speeds are logged at 100 to 500 Hz. The uppermost part is left out: loggers
/// that interpolate have less noise there (a Crazyflie's deck at 500 Hz: 2.4 rad/s up to 200 Hz, 0.7 at 250 Hz).
pub(crate) const NOISE_BAND: [f64; 2] = [0.4, 0.8];

/// Part of the time over which an input was smoothed by which sensors may seem late for it. A simulated flight whose clocks are
/// right, with 8 rad/s of noise on rotor speeds or 2 % on thrust, seemed to have inertial sensors 3 and 7 ms early.
pub(crate) const SMOOTHED_TIMING: f64 = 0.5;

/// Uncertainty of a vehicle's answer to its measured rotors (or thrust), as a share of it, from which on nothing is tried that scales that
/// answer; below, it widens their tolerance. Inertias of usual tolerance are told from 20 % on. In hovers by rotor speeds with 4 to 6 rad/s
/// of noise it is 0.3 to 3, and inertias of twice the true ones, or half the mass with half the thrust, stood for trims of the rotors.
pub(crate) const UNKNOWN_ANSWER: f64 = 0.25;

/// Logarithm of the ratio below which the noise of a channel counts as settled.
pub(crate) const NOISE_SETTLED: f64 = 0.15;

/// Windows of a log from which the noise of its channels is taken: some 10,000 samples of each, whose standard deviation is
/// known to 1 %.
pub(crate) const NOISE_WINDOWS: usize = 100;

/// Samples on end over which errors of a channel are looked for that keep their sign. Windows of 0.25 s hold 60 poses at
/// 240 Hz; what lasts longer is part of a window's start.
pub(crate) const SLOWEST_NOISE: usize = 40;

/// Error of an attitude that drives the model, before a log says more, rad: estimators are off by one to two degrees in
/// manoeuvres.
pub(crate) const GIVEN_ATTITUDE_RAD: f64 = 0.02;

/// Lengths of the roll-outs that judge a vehicle, s: short enough that a flight of a few seconds has some, long enough that
/// they integrate what the instants show.
pub(crate) const JUDGE_HORIZONS_S: [f64; 2] = [0.5, 1.0];

/// Length of the means by which force and torque at the instants are judged, s. Means over 50 ms pass 3 Hz on by 96 % and
/// have their first zero at 20 Hz: the motion of a multirotor, without the vibration of its frame.
pub(crate) const BAND_S: f64 = 0.05;

/// Fewest of those means on which a judgement rests: 1 s of flight.
pub(crate) const FEWEST_INSTANTS: usize = 20;

/// Ratio of errors above which a vehicle counts as worse. One, and no tolerance: a finding that helps by nothing is not
/// missed in a file, and one that harms by little harms.
pub(crate) const WORSE: f64 = 1.0;

/// Ratio above which a single error (force, torque, position after either horizon) counts as risen by what is written. Two flights
/// of one vehicle differ by a tenth of that hundredth.
pub(crate) const RISES: f64 = 1.01;

/// Ratio of errors, of a finding's own channel and of all together, above which a finding that was searched for brings too little to
/// be written: ratios on another flight of the same vehicle were up to 5 % larger, so that what takes less away here may add there. A true
/// flapping that took 2 % off the torque and 3 % off positions raised positions on the next flight by 1 to 3 %.
pub(crate) const LITTLE_GAIN: f64 = 0.95;

/// Ratio of all errors together that one more such group must reach once no error rises, and that findings written with such groups
/// must reach over the vehicle without them. On another flight of the same vehicle ratios were up to 5 % larger.
pub(crate) const WELL_BELOW: f64 = 0.9;

/// Most groups of parameters within tolerance that are written with what was found: more is a calibration.
pub(crate) const MOST_PARTNERS: usize = 3;

/// Share of an effect's squared change that one direction must hold for the effect to be told by that direction alone
/// ("force across the rotors").
pub(crate) const ONE_DIRECTION: f64 = 0.8;

/// Root mean square of an effect's change of force and torque, over the noise of the sensors in the same means, below
/// which the effect acts on neither and is told by the attitude of roll-outs: a twentieth adds 0.1 % to an error that is all noise.
pub(crate) const ACTS_NOWHERE: f64 = 0.05;

/// An effect within tolerance is not written where its parameters together are no further from the file than so many
/// standard deviations (root mean square over them): at one, chance alone moves them as far.
pub(crate) const NO_INFLUENCE_SIGMAS: f64 = 1.0;

/// Tolerances from which on a number of the calibration is not called within tolerance: one vehicle in four hundred is off as far
/// in a number that its builder took care of.
pub(crate) const FAR_TOLERANCES: f64 = 3.0;

/// Named groups of calibration that a ladder shows as rungs of their own; the rest is one rung. More make it unreadable.
pub(crate) const GROUPS_SHOWN: usize = 3;

/// Most characters of a headline: one line of 34 px on a page of 1400 px, and of a terminal.
pub const HEADLINE_CHARS: usize = 90;

/// Evidence, in nats, from which an effect that the second estimator cannot see (sensors, clocks, what stays the same throughout)
/// is certain all the same: from here on effects are not tried to be left out either. On real flights a tilt of the world of 0.4°
/// (27 nats) and a marker 23 mm up (18 nats) had less, of which nothing is known; a motion capture body that was askew had 66.
pub(crate) const CERTAIN_ALONE_NATS: f64 = WEAK_NATS;

/// Standard deviations, by the scatter of the log's parts, beyond which one number of an effect must be from the file for the effect to be
/// named: otherwise all of its intervals of 95 % hold "nothing". A wind of −0.25 ± 0.20 m/s stood beside a downwash with 13 nats.
pub(crate) const NAMED_SIGMAS: f64 = 1.96;

/// Evidence, in nats, below which an effect is tried to be left out with a new fit: it may only stand because the model was bent
/// towards it.
pub(crate) const WEAK_NATS: f64 = 40.0;

/// Evidence, in nats, below which nothing speaks for an effect any more once the model has moved to all its estimates: half of
/// what it takes to be added, so that an effect does not come and go. On a real flight of a slung load a clock stayed with −1.
pub(crate) const LOST_NATS: f64 = 0.5 * super::search::THRESHOLD;

/// About so many of the short windows are looked at after a first look at all of them: they only lead to where the long ones
/// begin. 24 s of flight are all used; of 40 s every second window, by which the verdicts on twelve logs did not change.
pub(crate) const SHORT_WINDOWS: usize = 240;

/// Windows and rounds by which `compare` tells whether anything is missing: 30 s of flight, and a second round with the noise that
/// the first has found. With these it exited as `diagnose` did on 43 of 43 logs.
pub(crate) const GLANCE_WINDOWS: usize = 120;
pub(crate) const GLANCE_ROUNDS: usize = 2;

/// Share of the error of roll-outs that must stay at most for a verdict in which nothing is missing to speak of calibration.
pub(crate) const WORTH_CORRECTING: f64 = 0.8;

/// Attitude error of roll-outs, rad, below which the attitude is an input of the model and no result: rounding makes
/// 10⁻¹⁵, the best sensor of attitude 10⁻⁴.
pub(crate) const FED_IN_RAD: f64 = 1e-9;

/// A mean force or torque is a finding in words where it is at least so many times the noise of a sample: what agrees with a
/// log by [`super::compare::AGREE`] is not spoken of.
pub(crate) const CONSTANT_TIMES_NOISE: f64 = super::compare::AGREE;

/// … and makes at least this share of the mean square in its axis: otherwise what varies is the matter, and its mean comes by the
/// way that was flown.
pub(crate) const CONSTANT_SHARE: f64 = 0.5;

/// Seconds at the beginning of a log driven by commands that are not judged: how fast the motors turn there is not known, and a
/// wrong start of motors with a lag of 0.15 s falls to a thousandth in 1 s. The built-in Crazyflies, flown from hover, were off by
/// 0.7 % of their weight 80 ms after the start, by 0.01 % after 0.9 s.
pub(crate) const SETTLING_S: f64 = 1.0;

/// A mean comes by a cause where at least this share of the variance goes with it, and all but the rest of the mean is gone
/// where the cause is zero: rotor drag in a Lissajous figure flown nose ahead went with the velocity by 98 % of its variance.
pub(crate) const CONSTANT_CAUSE: f64 = 0.7;

/// Time over which poses and inertial data are held against each other, s: that of the windows by which disturbances are judged.
pub(crate) const CROSS_CHECK_S: f64 = 0.25;

/// Part of a line in the spectrum of forces that must stay beside what goes with velocity and acceleration, where the vehicle
/// itself swings at that frequency, for the line to be taken for a gust's.
pub(crate) const GUST_BESIDE_MOTION: f64 = 0.5;

/// Share of the measured torque's variance about an axis that a file must leave for its rotors to be doubted: all of it, as if it had
/// none …
pub(crate) const WIRED_FILED: f64 = 1.0;
/// … and what another order or sense of them may leave there to be the right one, and may leave more about other axes.
pub(crate) const WIRED_BEST: f64 = 0.5;
pub(crate) const WIRED_WORSE: f64 = 0.1;

/// Times by which the rotors' lift must be off, up or down, for a file to be taken for another vehicle's: twice the weight would be
/// a load that no vehicle of the field carries unknown, and speeds in turns per minute lift 91 times as much.
pub(crate) const ANOTHER_LIFT: f64 = 2.0;

/// Standard deviations by which a log must differ from the others in a clock, a bias or the wind for it to be told:
/// five logs have some ninety such numbers, of which at two standard deviations four would be chance.
pub(crate) const DIFFERS_SIGMAS: f64 = 3.0;

/// Share of its tolerance to which such a difference is known at best. Clocks of two planted flights by measured rotor speeds were told
/// to 0.5 to 0.6 ms of a tolerance of 7.7 ms, which is that of smoothed inputs, where the fit alone said 0.01 to 0.07 ms; by commands to
/// 0.01 to 0.13 ms of 0.5 ms.
pub(crate) const DIFFERS_KNOWN: f64 = 0.1;

/// Standard deviations from which on an attitude is said to lean with the acceleration.
pub(crate) const LEAN_SIGMAS: f64 = 3.0;

/// Share of what is explained along an axis, beside the tolerances of the air, from which on an effect acts there.
pub(crate) const OWN_SHARE: f64 = 0.25;

/// Evidence by which a term must describe what an effect leaves.
pub(crate) const SHAPE_NATS: f64 = 25.0;

/// Size of what a term describes from which on it matters.
pub(crate) const REGULAR_FORCE_M_S2: f64 = 0.03;
pub(crate) const REGULAR_TORQUE_RAD_S2: f64 = 0.06;

/// Agility ([`crate::physics::drone::Drone::agility_rad_s2`]) below which torques matter from a size on that is less in proportion. The sizes
/// were set with a quadrotor of 0.75 kg and this agility; a vehicle of 5 kg turns a third as quickly, and a regular torque of
/// 0.04 to 0.06 rad/s² on 1 and 2 kg, 94 % of what was left, passed for nothing.
pub(crate) const USUAL_AGILITY_RAD_S2: f64 = 333.0;

/// Share of the scatter from which on a term says that something regular is missing.
pub(crate) const REGULAR_SHARE: f64 = 0.2;

/// Force over mass and torque over inertia that a well-known vehicle in calm air does not leave.
pub(crate) const LARGE_FORCE_M_S2: f64 = 0.06;
pub(crate) const LARGE_TORQUE_RAD_S2: f64 = 0.8;

/// Scatter of the worst two seconds over that of usual ones from which on a disturbance is an event and no weather.
pub(crate) const EVENT: f64 = 3.5;

/// Share of the scatter that a term may describe by chance, where the wind itself sets the vehicle in motion.
pub(crate) const WEATHER_SHARE: f64 = 0.14;

/// Scatter of what is left, over what disturbances and noise make, beyond which a force is no weather. Flights in turbulence of
/// the generator have 1.0 to 1.7, in effects that are in no list up to 20.
pub(crate) const MOST_DISPERSION: f64 = 2.0;

/// Share of the disturbances' variance that findings must explain, where something regular or large is left.
pub(crate) const LEANING: f64 = 0.7;

/// The same where what is left is an event.
pub(crate) const EVENTFUL: f64 = 0.9;

/// Nats of evidence from which an effect stands beside weather.
pub(crate) const BESIDE_WEATHER: f64 = 20.0;

/// Share of the error on flight that the fit has not seen which an effect beside others must take away.
pub(crate) const LEAST_SHARE: f64 = 0.1;

/// The same of an effect alone, on weak evidence.
pub(crate) const LEAST_SHARE_ALONE: f64 = 0.3;
