//! Thresholds of the gap finder: named constants, each with its meaning and the data that set it.
//!
//! Nothing is written into a vehicle file that makes it worse on held-out flight. A vehicle's errors are those of six
//! channels: force and torque that the model lacks at the instants, position and attitude at the end of roll-outs of 0.5
//! and 1 s. One vehicle is *worse* than another where the geometric mean of its errors over the other's is above one.

/// Band, as a share of half the sample rate, in which a measured input contains only noise.
///
/// Rotors of small vehicles follow to 5 to 10 Hz; speeds are logged at 100 to 500 Hz. The uppermost part is left out: loggers
/// that interpolate have less noise there (a Crazyflie's deck at 500 Hz: 2.4 rad/s up to 200 Hz, 0.7 at 250 Hz).
pub(crate) const NOISE_BAND: [f64; 2] = [0.4, 0.8];

/// Share of the smoothing time of an input by which all sensors may appear delayed relative to it, and the share by which one sensor
/// may beside the others. A simulated flight with correct clocks, with 8 rad/s of noise on rotor speeds or 2 % on thrust, seemed to
/// have inertial sensors 3 and 7 ms early. With the first share for each sensor, one sensor that was 12 to 30 ms late in flights of
/// MuJoCo (7 of 7) was taken for a tolerance.
pub(crate) const SMOOTHED_TIMING: f64 = 0.5;
pub(crate) const SMOOTHED_TIMING_APART: f64 = 0.05;

/// Time by which all sensors must agree that a smoothed input is late, or early, for it to be said, and the standard deviations of each:
/// with correct clocks it seemed 7 ms late at most (above); in a flight of MuJoCo in which it was 30 ms late it was found 29.6 ± 2 ms
/// late, and nothing said so but a list of small corrections.
pub(crate) const LATE_S: f64 = 0.01;
pub(crate) const LATE_SIGMAS: f64 = 3.0;

/// Relative uncertainty of the vehicle's response to its measured rotors (or thrust) above which no effect is tried that
/// scales this response; below, it widens their tolerance. Inertias of usual tolerance are told from 20 % on. In hovers by
/// rotor speeds with 4 to 6 rad/s of noise it is 0.3 to 3, and inertias of twice the true ones, or half the mass with half
/// the thrust, were fitted in place of rotor trims.
pub(crate) const UNKNOWN_ANSWER: f64 = 0.25;

/// Largest log ratio of a channel's noise in consecutive iterations that counts as converged.
pub(crate) const NOISE_SETTLED: f64 = 0.15;

/// Windows of a log used to estimate the noise of its channels: some 10,000 samples of each, which give the standard
/// deviation to 1 %.
pub(crate) const NOISE_WINDOWS: usize = 100;

/// Longest lag, in samples, at which correlated errors of a channel are looked for. Windows of 0.25 s hold 60 poses at 240
/// Hz; longer correlations are absorbed by a window's initial state.
pub(crate) const SLOWEST_NOISE: usize = 40;

/// Prior error of an attitude that drives the model, rad: estimators are off by one to two degrees in manoeuvres.
pub(crate) const GIVEN_ATTITUDE_RAD: f64 = 0.02;

/// Lengths of the roll-outs used to judge a vehicle, s: short enough for a flight of a few seconds, long enough to
/// integrate the errors seen at the instants.
pub(crate) const JUDGE_HORIZONS_S: [f64; 2] = [0.5, 1.0];

/// Averaging time of the force and torque residuals at the instants, s. Means over 50 ms pass 3 Hz with a gain of 96 % and
/// have their first zero at 20 Hz: they keep the motion of a multirotor and remove the vibration of its frame.
pub(crate) const BAND_S: f64 = 0.05;

/// Fewest of those means for a judgement: 1 s of flight.
pub(crate) const FEWEST_INSTANTS: usize = 20;

/// Ratio of errors above which a vehicle counts as worse. Exactly one, no tolerance: a finding without benefit is not
/// missed in a file, and a slightly harmful one does harm.
pub(crate) const WORSE: f64 = 1.0;

/// Ratio above which a single error (force, torque, position after either horizon) counts as raised by what is written. Two
/// flights of one vehicle differ by a tenth of that hundredth.
pub(crate) const RISES: f64 = 1.01;

/// The same in a third of a held-out flight, which has room for three roll-outs of 1 s that do not overlap: by chance such a third differs
/// from the next. With a thrust that goes with the roll, found with its true value, the position after 1 s rose by 4 to 9 % in one of
/// them, or the torque by 1 to 3 % (six flights by the generator of the tests, seeds 10, 11 and 13); of 19 flights by other programs that
/// leave something unexplained, no verdict differs with 15 %.
pub(crate) const RISES_IN_PART: f64 = 1.1;

/// The same for one group of calibration beside those before it: corrections make up for each other in part, so that one may raise an error
/// by some per cent that the next takes off. Of a flight without noise, curves of thrust and torque with an inertia took 37 % off the torque
/// and nearly doubled the position after 1 s.
pub(crate) const RISES_IN_STEP: f64 = 1.1;

/// Ratio of errors, of a finding's own channel and of all together, above which the gain of a searched finding is too small
/// to write it: ratios on another flight of the same vehicle were up to 5 % larger, so a small gain here may be a loss
/// there. A true flapping that took 2 % off the torque and 3 % off positions raised positions on the next flight by 1 to 3
/// %.
pub(crate) const LITTLE_GAIN: f64 = 0.95;

/// Ratio of all errors together that one more such group must reach once no error rises, and that findings written with
/// such groups must reach over the vehicle without them. On another flight of the same vehicle ratios were up to 5 %
/// larger. Where something is unexplained, it must be reached in every part of the held-out flight.
pub(crate) const WELL_BELOW: f64 = 0.9;

/// Ratio to the file's error in the own channel of each of several findings, were it alone left out, from which they make up for
/// each other where something is unexplained. In flights of another simulator (MuJoCo) with a load on a cable that was not tracked, 0.70 of
/// the mass and a force of −2.3 N along the rotors were named: without either the force was off by 3 and 5 times what it was before.
pub(crate) const MAKES_UP: f64 = 2.0;

/// Parts of each held-out flight in which a vehicle is judged where something is unexplained: 10 s, the last fifth of the usual
/// 50 s, give parts of 3 s, the least in which roll-outs of 1 s can be judged.
pub(crate) const PARTS_JUDGED: usize = 3;

/// Most groups of parameters within tolerance written together with the findings: more would be a calibration. With three the missing
/// torque of one planted vehicle rose from 13.8 to 14.5 times noise on the next flight, in seven cases; with four it falls to 8.6,
/// and on four seeds that were kept back no error of 160 rises.
pub(crate) const MOST_PARTNERS: usize = 4;

/// Longest delay, s, that may be a log's clocks: where it is in doubt and one log alone shows it, it is not written. Clocks of planted
/// flights with filtered sensors are some ms off (8.3 in those looked at) and differ from flight to flight: written, delays of 4 to 5 ms raised errors of the
/// next flight by 5 to 56 %. Delays of the vehicle itself, 12 ms and more there, are written, of which 11 of 16 were in doubt.
pub(crate) const CLOCKS_OFF_S: f64 = 0.01;

/// Share of an effect's squared change that one direction must hold for the effect to be reported by that direction alone
/// ("force across the rotors").
pub(crate) const ONE_DIRECTION: f64 = 0.8;

/// Root mean square of an effect's change of force and torque, over the sensor noise in the same means, below which the
/// effect counts as acting on neither and is reported by the attitude of roll-outs: a twentieth adds 0.1 % to an error that
/// is all noise.
pub(crate) const ACTS_NOWHERE: f64 = 0.05;

/// An effect within tolerance is not written if its parameters differ from the file by no more than so many standard
/// deviations (root mean square over them): at one, chance alone moves them as far.
pub(crate) const NO_INFLUENCE_SIGMAS: f64 = 1.0;

/// Factor by which the tolerances of a vehicle count as wider in the intervals of what was found: how well it was built is
/// itself known to a factor of two only (rms of widths between half and twice the usual: 1.3). With 1.0, a vehicle of twice
/// the usual tolerances whose thrust was 4 % off had 0.837 ± 0.017 of its filed mass where 0.865 was true.
pub(crate) const INTERVAL_TOLERANCE: f64 = 1.4;

/// Number of tolerances from which a calibrated parameter is no longer called within tolerance: one vehicle in four hundred
/// is that far off in a parameter that its builder took care of.
pub(crate) const FAR_TOLERANCES: f64 = 3.0;

/// Groups of calibration that a ladder shows as steps of their own; the rest is one step. More make it unreadable.
pub(crate) const GROUPS_SHOWN: usize = 3;

/// Most characters of a headline: one line of 34 px on a page of 1400 px, or of a terminal.
pub const HEADLINE_CHARS: usize = 90;

/// Evidence, in nats, from which an effect that the second estimator cannot observe (sensors, clocks, constants) is certain
/// nevertheless; from here on it is not tried to leave effects out, either. On real flights a tilt of the world of 0.4° (27
/// nats) and a marker 23 mm up (18 nats) had less, and nothing confirms them; a misaligned motion capture body had 66.
pub(crate) const CERTAIN_ALONE_NATS: f64 = WEAK_NATS;

/// Standard deviations, by the scatter of the log's parts, by which at least one parameter of an effect must differ from
/// the file for the effect to be named: otherwise all of its 95 % intervals contain zero. A wind of −0.25 ± 0.20 m/s was
/// found beside a downwash with 13 nats.
pub(crate) const NAMED_SIGMAS: f64 = 1.96;

/// Standard deviations beyond which an estimate speaks against what the vehicle file states: three, as for outliers.
pub(crate) const AGAINST_STATED_SIGMAS: f64 = 3.0;

/// Evidence, in nats, below which an effect is tentatively left out with a new fit: it may exist only because the model was
/// linearised with it.
pub(crate) const WEAK_NATS: f64 = 40.0;

/// Evidence, in nats, below which an effect is dropped after relinearising the model at all its estimates: half of what it
/// takes to be added, a hysteresis against effects that come and go. On a real flight of a slung load a clock stayed with
/// −1.
pub(crate) const LOST_NATS: f64 = 0.5 * super::search::THRESHOLD;

/// Evidence, in nats, by which another effect must fit better in the place of one that was found to be fitted instead, and how
/// often that is tried. Flights of another simulator (MuJoCo) with 8 % more mass ended with a payload where the mass fitted
/// better by 5 nats.
pub(crate) const EXCHANGE_NATS: f64 = LOST_NATS;
pub(crate) const MOST_EXCHANGES: usize = 2;

/// About how many of the short windows are used after a first pass over all of them: they only lead to the start of the
/// long ones. 24 s of flight are all used; of 40 s every second window, by which the verdicts on twelve logs did not
/// change.
pub(crate) const SHORT_WINDOWS: usize = 240;

/// Windows and rounds by which `compare` tells whether any effect is missing: 30 s of flight, and a second round with the
/// noise estimated in the first. With these it exited as `diagnose` did on 43 of 43 logs.
pub(crate) const GLANCE_WINDOWS: usize = 120;
pub(crate) const GLANCE_ROUNDS: usize = 2;

/// Windows in which `compare` looks first, one number after the other, and the evidence in them, in nats, that needs no more
/// windows: ten times what a set of effects must bring.
pub(crate) const CLEAR_WINDOWS: [usize; 2] = [12, 40];
pub(crate) const CLEAR_NATS: f64 = 10.0 * super::search::THRESHOLD;
/// Factor by which what is left must be large ([`LARGE_FORCE_M_S2`], [`LARGE_TORQUE_RAD_S2`]) to need no more windows: its
/// size is known to a tenth from so few.
pub(crate) const CLEAR_TIMES: f64 = 1.5;
/// Length of the flights from which on it looks first in so few: shorter ones have hardly more.
pub(crate) const CLEAR_FROM_S: f64 = 20.0;

/// Largest remaining share of the roll-out errors for which a verdict of nothing missing mentions calibration.
pub(crate) const WORTH_CORRECTING: f64 = 0.8;

/// Attitude error of roll-outs, rad, below which the attitude is an input of the model, not a result: rounding makes 10⁻¹⁵,
/// the best attitude sensor 10⁻⁴.
pub(crate) const FED_IN_RAD: f64 = 1e-9;

/// A mean force or torque is reported as a finding in words if it is at least so many times the noise of a sample: what
/// agrees with a log by [`super::compare::AGREE`] is not reported.
pub(crate) const CONSTANT_TIMES_NOISE: f64 = super::compare::AGREE;

/// … and makes at least this share of the mean square in its axis: otherwise the varying part dominates, and the mean is a
/// property of the path flown.
pub(crate) const CONSTANT_SHARE: f64 = 0.5;

/// Seconds at the beginning of a log driven by commands that are not judged: the initial motor speeds are unknown, and with
/// a lag of 0.15 s a wrong start decays to a thousandth in 1 s. The built-in Crazyflies, flown from hover, were off by 0.7
/// % of their weight 80 ms after the start, by 0.01 % after 0.9 s.
pub(crate) const SETTLING_S: f64 = 1.0;

/// A mean is attributed to a cause if at least this share of the variance depends on it, and at least this share of the
/// mean vanishes where the cause is zero: rotor drag in a Lissajous figure flown nose ahead had 98 % of its variance
/// explained by the velocity.
pub(crate) const CONSTANT_CAUSE: f64 = 0.7;

/// Time over which poses and inertial data are cross-checked, s: that of the windows by which disturbances are judged.
pub(crate) const CROSS_CHECK_S: f64 = 0.25;

/// Share of a line in the force spectrum that must remain after regression on velocity and acceleration, where the vehicle
/// itself oscillates at that frequency, for the line to count as a gust.
pub(crate) const GUST_BESIDE_MOTION: f64 = 0.5;

/// Share of the measured torque's variance about an axis that the nominal rotors must leave for their order to be doubted:
/// all of it, as if the file had none …
pub(crate) const WIRED_FILED: f64 = 1.0;
/// … and the share that another order or spin direction may leave there to be accepted; it may leave more about other axes.
pub(crate) const WIRED_BEST: f64 = 0.5;
pub(crate) const WIRED_WORSE: f64 = 0.1;

/// Factor by which the rotors' lift must be off, up or down, for a file to be taken for another vehicle's: twice the weight
/// would be a load that no vehicle of the field carries unnoticed, and speeds in turns per minute lift 91 times as much.
pub(crate) const ANOTHER_LIFT: f64 = 2.0;

/// Standard deviations by which a log must differ from the others in a clock, a bias or the wind to be reported: five logs
/// have some ninety such parameters, of which at two standard deviations four would differ by chance.
pub(crate) const DIFFERS_SIGMAS: f64 = 3.0;

/// Best relative accuracy of such a difference, as a share of its tolerance. Clocks of two planted flights by measured
/// rotor speeds were found to 0.5 to 0.6 ms with a tolerance of 7.7 ms, which is that of smoothed inputs, where the fit
/// alone claimed 0.01 to 0.07 ms; by commands to 0.01 to 0.13 ms of 0.5 ms.
pub(crate) const DIFFERS_KNOWN: f64 = 0.1;

/// Share of the way from the file to the mean of all logs by which a log's own value must be off that mean for the mean to be no value
/// of any flight. Winds of 1.2 and 0 m/s are 1 of it apart, 1.0 and -0.94 m/s, with 0.03 between them, 32; biases of two flights of one gyroscope, 0.05 and
/// 0.02 rad/s, 0.4.
pub(crate) const NO_COMMON_VALUE: f64 = 0.5;

/// Standard deviations from which an attitude is reported to lean with the acceleration.
pub(crate) const LEAN_SIGMAS: f64 = 3.0;

/// Share of the variance explained along an axis, beside the tolerances of the air, above which an effect acts there.
pub(crate) const OWN_SHARE: f64 = 0.25;

/// Evidence with which a term must describe the residual of an effect, nats.
pub(crate) const SHAPE_NATS: f64 = 25.0;

/// Evidence by which a shape outside the list must beat the effect in whose place it stands, nats. In nine flights (seven by another
/// program with a drag above or below the centre of mass, where flapping blades were in the set; two by the generator with a drag from
/// a threshold on, where that with the square of the speed was) it has 68 to 496; in 21 with effects of the list never more than −1.
pub(crate) const IN_PLACE_NATS: f64 = 10.0;

/// Size above which a described term matters. Of 288 flights of the develop half in which everything was known, one left a
/// regular torque of 0.03 rad/s² or more, and rightly so.
pub(crate) const REGULAR_FORCE_M_S2: f64 = 0.03;
pub(crate) const REGULAR_TORQUE_RAD_S2: f64 = 0.03;

/// Agility ([`propwash_physics::drone::Drone::agility_rad_s2`]) below which the torque thresholds shrink in proportion. They were set on a
/// quadrotor of 0.75 kg with this agility; a vehicle of 5 kg turns a third as quickly, and a regular torque of 0.04 to 0.06 rad/s² on
/// vehicles of 1 and 2 kg, 94 % of what was left, went unnoticed.
pub(crate) const USUAL_AGILITY_RAD_S2: f64 = 333.0;

/// Evidence, in nats, of a term that all windows agree on though none shows it. In 72 flights of the develop half in which everything was
/// known, by rotor commands and speeds, terms of the sizes above never had more than 8.4 (36 with nothing hidden: 5.6); torques that go with
/// speed and yaw rate have 7 to 300 about one axis.
pub(crate) const FAINT_NATS: f64 = 10.0;

/// Share of the scatter above which a term indicates a regular missing effect.
pub(crate) const REGULAR_SHARE: f64 = 0.2;

/// Residual force over mass and torque over inertia that a well-known vehicle in calm air stays below.
pub(crate) const LARGE_FORCE_M_S2: f64 = 0.06;
pub(crate) const LARGE_TORQUE_RAD_S2: f64 = 0.8;

/// Scatter of the worst two seconds over that of usual ones above which a disturbance is an event, not turbulence.
pub(crate) const EVENT: f64 = 3.5;

/// Share of the scatter that a term may describe by chance, where the wind itself moves the vehicle.
pub(crate) const WEATHER_SHARE: f64 = 0.14;

/// Reduced chi-square of the residuals, given disturbances and noise, above which an unexplained force is not attributed to
/// turbulence. Flights in turbulence of the generator have 1.0 to 1.7, in effects that are in no list up to 20.
pub(crate) const MOST_DISPERSION: f64 = 2.0;

/// Share of the disturbances' variance that findings must explain if a regular or large remainder is left.
pub(crate) const LEANING: f64 = 0.7;

/// The same if the remainder is an event.
pub(crate) const EVENTFUL: f64 = 0.9;

/// Evidence from which an effect is kept beside turbulence, nats.
pub(crate) const BESIDE_WEATHER: f64 = 20.0;

/// Share of what the windows lack that a formula must describe on unseen blocks of time to be tried.
pub(crate) const FORMULA_SHARE: f64 = 0.1;

/// Squared correlation from which two formulas along the same axes count as one.
pub(crate) const FORMULA_SAME: f64 = 0.99;

/// Evidence that a formula must bring beside what is in the list, nats. A thousand formulas are looked at, which makes chance worth
/// seven nats; a missing effect that matters brings hundreds.
pub(crate) const FORMULA_NATS: f64 = 25.0;

/// Evidence that a shorter formula may bring less, nats.
pub(crate) const FORMULA_SHORTER: f64 = 12.0;

/// Standard errors by which a network must lower the error on blocks of flight that its fit has not seen: the blocks are few, and
/// weather goes with the flight in one of them easily.
pub(crate) const NETWORK_SIGMAS: f64 = 3.0;

/// Share of the held-out error that an effect must remove beside other effects.
pub(crate) const LEAST_SHARE: f64 = 0.1;

/// The same for an effect alone, on weak evidence.
pub(crate) const LEAST_SHARE_ALONE: f64 = 0.3;

/// By how much an unchanged vehicle seems different from one log to the next, as a share of the tolerance of each parameter, beside what
/// the fit of each log knows of its own error. 48 planted flights of six unchanged vehicles, each with another wind and battery: from one
/// flight to the next nine of ten parameters moved by less (median 0.03, drag with the square of the speed 0.5).
pub(crate) const DRIFT_REPEATS: f64 = 0.25;

/// Most logs ago at which a drift may have begun that is looked for: what is older was looked for when it was new.
pub(crate) const DRIFT_BEGINNINGS: usize = 50;

/// Most drifts that one log brings to light: as many as a verdict names effects.
pub(crate) const DRIFTS_PER_LOG: usize = super::search::MOST;

/// Evidence that a step in mid-flight needs, nats, over all effects and all times at which it may be.
pub(crate) const MOMENT_NATS: f64 = 12.0;
/// Share of the variance of what a flight leaves unexplained, in force or in torque, that its moments must take together.
pub(crate) const MOMENT_SHARE: f64 = 0.75;
/// Widest interval of the time of a moment, s.
pub(crate) const MOMENT_WIDEST_S: f64 = 1.0;
/// Most moments of a flight: one that changes more often has weather.
pub(crate) const MOMENTS_PER_LOG: usize = 3;
