//! The second estimator: band-limited equation error, which needs no model of sensor noise and no initial states.
//!
//! At every instant the measured specific force and angular acceleration, minus the model's at the measured state, are
//! linear in the missing effects. Both sides pass the same zero-phase low-pass, means are removed per log and axis, and the
//! rest is least squares, with channels weighted by their residual variance. An effect is scored by the variance that it
//! explains on held-out flight. Compared with output error it is less precise, but independent of noise figures, priors and
//! initial states.
//!
//! Sources: Morelli & Klein, "Aircraft system identification: theory and practice", 2nd ed., Sunflyte 2016, ch. 5 and 6, and
//! their programs SIDPAC (equation error, stepwise regression by predicted squared error); cluster-robust standard errors:
//! Liang & Zeger, "Longitudinal data analysis using generalized linear models", Biometrika 73(1), 1986.

mod band;
mod regress;
mod samples;
#[cfg(test)]
mod tests;

use super::fit::Prepared;
use super::model::{Enters, Model};
use super::per_log::Values;
use super::solve::Solution;
use propwash_physics::effects::{Area, Sign};
use rayon::prelude::*;
use regress::{Band, Left};
use samples::Samples;

/// Specific force x, y, z and angular acceleration x, y, z.
pub(crate) const CHANNELS: usize = 6;
/// Cut-off of the band, Hz. The vehicles' own motion is below 3 Hz; measured rotor speeds and estimators are accurate up to
/// 8 Hz.
const BAND_HZ: f64 = 5.0;
/// Root mean square of a candidate's column at its plausible size, m/s² or rad/s², below which it is only rounding.
const LEAST_COLUMN: f64 = 1e-6;
/// Standard errors by which a gain on held-out flight must exceed zero.
const SURE: f64 = 2.0;
/// Most steps of the forward selection: more effects than a verdict holds, and some tolerances beside them.
const MOST_STEPS: usize = 8;
/// Spikes (standard deviations of a tolerance) up to which an estimate is within tolerance.
const TOLERANCE: f64 = 3.0;
/// Least share of the remaining force or torque, all axes together, that a step of the forward selection must remove.
const LEAST_GAIN: f64 = 0.02;
/// Standard errors by which a claimed value must differ from the nominal one for the witness to be able to see it.
const VISIBLE: f64 = 3.0;
/// Factor within which two estimates agree regardless of their standard errors: equation error is biased by noise in its
/// regressors and by effects outside the set.
const FACTOR: f64 = 2.0;
/// Joint standard errors within which two estimates agree.
const JOINT: f64 = 3.0;
/// Share of a channel that an effect of mass or drive must explain. Rotor speeds are the pilot's response to whatever moves
/// the vehicle: their column correlates with every disturbance, and a threshold below a half would be passed by a
/// correlation of 0.7. Two quiet flights in which nothing is missing (a hover and a Lissajous figure) reached 0.24 and
/// 0.32, rotor inertia 0.98, inertia by 17 % 0.90.
const OWN_SHARE: f64 = 0.5;

/// The regressions of some logs.
pub(crate) struct Witness {
    /// Parameters by candidate, only those that the witness can observe.
    members: Vec<Vec<usize>>,
    /// Values at the linearisation point.
    at: Vec<f64>,
    /// Nominal values.
    filed: Vec<f64>,
    /// Allowed direction of the parameters from the linearisation point.
    sides: Vec<f64>,
    spike: Vec<f64>,
    /// Candidates of mass and drive, whose columns contain the pilot's response.
    answers: Vec<bool>,
    may: Vec<bool>,
    band: Band,
}

/// An estimate of a parameter: its index, value (not offset) and standard error, in the parameter's unit.
pub(crate) type Estimate = (usize, f64, f64);

/// The regressions' result for a candidate beside others.
#[derive(Clone, Debug)]
pub(crate) struct Testimony {
    /// Estimates in the main band from force and torque together.
    pub values: Vec<Estimate>,
    /// The same from force alone and from torque alone, for the parameters that act there.
    pub by_force: Vec<Estimate>,
    pub by_torque: Vec<Estimate>,
    /// Share of the held-out variance left by the others that the candidate removes, per body axis.
    pub force_gain: [f64; 3],
    pub torque_gain: [f64; 3],
    /// The same over all axes, in the group (force or torque) in which it acts most.
    pub gain: f64,
    /// Standard error of `gain` by the scatter of blocks.
    pub gain_sigma: f64,
    /// Whether that group is the torque.
    pub by_turning: bool,
    /// Whether one of the groups (force, torque) loses more than by chance: a compromise between conflicting data.
    pub harms: bool,
    /// Whether the columns contain the pilot's response, see [`OWN_SHARE`].
    answers: bool,
    /// Nominal values.
    filed: Vec<f64>,
}

/// A step of the forward selection.
#[derive(Clone, Debug)]
pub(crate) struct Step {
    pub candidate: usize,
    /// As in [`Testimony`], beside the candidates of the previous steps.
    pub gain: f64,
    pub gain_sigma: f64,
    /// Whether all of its estimates are within the vehicle's tolerances: not an effect, but a step of its own since it
    /// would otherwise disturb the next.
    pub within_tolerance: bool,
}

/// Whether another estimator's result agrees.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Agreement {
    /// Held-out flight gains, and the values agree.
    Agrees,
    /// The witness would see the claimed effect, and sees something else.
    Differs {
        /// The parameter that differs most, the claimed value, and the witness's value with its standard error.
        parameter: usize,
        claimed: f64,
        found: f64,
        sigma: f64,
        /// Whether held-out flight gains at all.
        gains: bool,
    },
    /// The band contains too little of it.
    Mute,
}

/// Reduction of the channels' residual squares by a candidate.
struct Gain {
    channel: [f64; CHANNELS],
    /// Force and torque: share and its standard error.
    group: [(f64, f64); 2],
    /// The same with the channels weighted by their residual.
    weighted: [(f64, f64); 2],
    /// Sum over channels of the logarithm of squares before over after.
    score: f64,
}

impl Gain {
    fn new(before: &Left, after: &Left) -> Self {
        let total = |list: &Left, c: usize| list.iter().map(|b| b[c]).sum::<f64>();
        let sums: Vec<(f64, f64)> = (0..CHANNELS).map(|c| (total(before, c), total(after, c))).collect();
        let channel = core::array::from_fn(|c| {
            let (a, b) = sums[c];
            if a > 0.0 { 1.0 - b / a } else { 0.0 }
        });
        let score = sums.iter().filter(|(a, b)| *a > 0.0 && *b > 0.0).map(|(a, b)| (a / b).ln()).sum();
        let share = |group: usize, weight: &dyn Fn(usize) -> f64| {
            let channels = 3 * group..3 * group + 3;
            let whole: f64 = channels.clone().map(|c| weight(c) * sums[c].0).sum();
            if whole <= 0.0 {
                return (0.0, 0.0);
            }
            let each: Vec<f64> = before
                .iter()
                .zip(after)
                .map(|(a, b)| channels.clone().map(|c| weight(c) * (a[c] - b[c])).sum::<f64>() / whole)
                .collect();
            let n = each.len() as f64;
            let sum: f64 = each.iter().sum();
            let spread: f64 = each.iter().map(|d| (d - sum / n).powi(2)).sum();
            (sum, (spread * n / (n - 1.0).max(1.0)).sqrt())
        };
        let even = |c: usize| if sums[c].0 > 0.0 { 1.0 / sums[c].0 } else { 0.0 };
        Self {
            channel,
            group: [share(0, &|_| 1.0), share(1, &|_| 1.0)],
            weighted: [share(0, &even), share(1, &even)],
            score,
        }
    }

    /// The group in which most is gained.
    fn most(&self) -> usize {
        usize::from(self.group[1].0 > self.group[0].0)
    }

    /// Whether force or torque loses more than by chance.
    fn harms(&self) -> bool {
        self.group.iter().any(|(gain, sigma)| *gain < -SURE * sigma && *gain < -LEAST_GAIN)
    }

    /// Whether force or torque gains more than by chance, over all axes together or with each axis scaled to its own size.
    fn sure(&self) -> bool {
        self.group.iter().chain(&self.weighted).any(|(gain, sigma)| *gain > SURE * sigma && *gain > 0.0)
    }
}

const ALL: [bool; CHANNELS] = [true; CHANNELS];
const FORCES: [bool; CHANNELS] = [true, true, true, false, false, false];
const TORQUES: [bool; CHANNELS] = [false, false, false, true, true, true];

impl Witness {
    /// With the nominal model except for the clocks of every log, which are those of a fit: half a millisecond would bias a
    /// regression. In what was found, logs differ from each other as the fit says: a regression of one wind for two days of opposite winds
    /// would find none.
    pub fn beside(model: &Model, logs: &[Prepared], fit: &Solution) -> Self {
        let timing = model.timing();
        let mut chosen = timing.clone();
        let mut values = Values { shared: model.filed(), apart: vec![model.filed(); logs.len()] };
        values.apart.iter_mut().for_each(|log| log.fill(0.0));
        for k in timing.iter().flat_map(|c| model.of(*c)) {
            values.shared[k] = fit.posterior.mean[k];
            for (log, apart) in values.apart.iter_mut().enumerate() {
                apart[k] = fit.values_of(log)[k] - fit.posterior.mean[k];
            }
        }
        for k in model.per_log(logs.len()) {
            let c = model.parameters[k].candidate;
            if !fit.set.contains(&c) || timing.contains(&c) {
                continue;
            }
            for (log, apart) in values.apart.iter_mut().enumerate() {
                apart[k] = fit.values_of(log)[k] - fit.posterior.mean[k];
            }
            if !chosen.contains(&c) {
                chosen.push(c);
            }
        }
        Self::at(logs, model, &values, &chosen)
    }

    /// With the nominal model.
    #[cfg(test)]
    pub fn new(logs: &[Prepared], model: &Model) -> Self {
        Self::at(logs, model, &model.filed().into(), &[])
    }

    /// With the model at parameter values `values` and the effects of `chosen` active: an effect that only shows beside
    /// another one (wind beside drag) has a derivative there.
    pub fn at(logs: &[Prepared], model: &Model, values: &Values, chosen: &[usize]) -> Self {
        let by: Vec<usize> = (0..model.parameters.len()).filter(|k| linear(model, *k)).collect();
        let samples: Vec<Samples> = logs
            .par_iter()
            .enumerate()
            .map(|(i, log)| Samples::new(log, model, &values.of(i), chosen, &by))
            .collect();
        let slab: Vec<f64> = model.parameters.iter().map(|p| p.slab).collect();
        let band = Band::new(&samples, slab.clone(), BAND_HZ);
        let visible = |k: usize| (0..CHANNELS).any(|c| band.size(k, c) * slab[k] > LEAST_COLUMN);
        let witnessed = |k: &usize| by.contains(k) && visible(*k);
        let sides = model
            .parameters
            .iter()
            .zip(&values.shared)
            .map(|(p, at)| match p.sign {
                // An effect listed in the file can be smaller, and a moved parameter may come back.
                _ if model.listed[p.effect] || *at != p.filed => 0.0,
                Sign::Any => 0.0,
                Sign::Up => 1.0,
                Sign::Down => -1.0,
            })
            .collect();
        Self {
            members: (0..model.candidates.len()).map(|c| model.of(c).filter(witnessed).collect()).collect(),
            at: values.shared.clone(),
            filed: model.filed(),
            sides,
            spike: model.parameters.iter().map(|p| p.spike).collect(),
            answers: model.candidates.iter().map(|c| c.area != Area::Airframe).collect(),
            may: model.may.clone(),
            band,
        }
    }

    /// Whether the regressions carry information about a candidate: its derivative at the model's values is not zero.
    pub fn covers(&self, c: usize) -> bool {
        self.band.judges() && !self.members[c].is_empty()
    }

    fn parameters(&self, set: &[usize]) -> Vec<usize> {
        set.iter().flat_map(|c| self.members[*c].iter().copied()).collect()
    }

    /// Share of the residual's variance that a set explains on flight held out from each fit: specific force x, y, z,
    /// angular acceleration x, y, z.
    #[cfg(test)]
    pub fn explained(&self, set: &[usize]) -> Option<[f64; CHANNELS]> {
        let band = &self.band;
        let left = band.left(&self.parameters(set), &ALL, &self.sides)?;
        Some(Gain::new(&band.before(), &left).channel)
    }

    /// The same on the logs of another witness, with a fit to all of this one's.
    #[cfg(test)]
    pub fn explains(&self, set: &[usize], unseen: &Self) -> Option<[f64; CHANNELS]> {
        let fit = self.band.fit(&self.parameters(set), &ALL, &self.sides)?;
        Some(Gain::new(&unseen.band.before(), &unseen.band.left_by(&fit)).channel)
    }

    fn estimates(&self, set: &[usize], c: usize, on: &[bool; CHANNELS]) -> Option<Vec<Estimate>> {
        let band = &self.band;
        let acts = |k: &usize| (0..CHANNELS).any(|ch| on[ch] && band.size(*k, ch) > 0.0);
        let parameters: Vec<usize> = self.parameters(set).into_iter().filter(acts).collect();
        // Signs are left free: an estimate of the wrong sign is informative too.
        let fit = band.fit(&parameters, on, &vec![0.0; self.sides.len()])?;
        let errors = band.standard_errors(&fit);
        let own = |k: &usize| self.members[c].contains(k);
        Some(
            (0..fit.parameters.len())
                .filter(|i| own(&fit.parameters[*i]))
                .map(|i| (fit.parameters[i], self.at[fit.parameters[i]] + fit.beta[i], errors[i]))
                .collect(),
        )
    }

    /// Held-out residual squares of a set.
    fn left(&self, set: &[usize]) -> Option<Left> {
        self.band.left(&self.parameters(set), &ALL, &self.sides)
    }

    /// The logs' testimony about candidate `c` beside the others of `set`; `None` where it is not covered.
    pub fn testimony(&self, set: &[usize], c: usize) -> Option<Testimony> {
        if !self.covers(c) {
            return None;
        }
        let rest: Vec<usize> = set.iter().copied().filter(|x| *x != c).collect();
        let with: Vec<usize> = rest.iter().copied().chain([c]).collect();
        let gain = Gain::new(&self.left(&rest)?, &self.left(&with)?);
        let most = gain.most();
        let [x, y, z, roll, pitch, yaw] = gain.channel;
        Some(Testimony {
            values: self.estimates(&with, c, &ALL)?,
            by_force: self.estimates(&with, c, &FORCES).unwrap_or_default(),
            by_torque: self.estimates(&with, c, &TORQUES).unwrap_or_default(),
            force_gain: [x, y, z],
            torque_gain: [roll, pitch, yaw],
            gain: gain.group[most].0,
            gain_sigma: gain.group[most].1,
            by_turning: most == 1,
            harms: gain.harms(),
            answers: self.answers[c],
            filed: self.filed.clone(),
        })
    }

    /// Forward selection: the candidate that explains most on held-out flight, then the next beside it, as long as one
    /// explains more than by chance.
    pub fn search(&self) -> Vec<Step> {
        let mut out: Vec<Step> = Vec::new();
        let mut set: Vec<usize> = Vec::new();
        while out.len() < MOST_STEPS {
            let Some(before) = self.left(&set) else { break };
            let free: Vec<usize> = (0..self.members.len())
                .filter(|c| self.may[*c] && self.covers(*c) && !set.contains(c))
                .collect();
            let best = free
                .into_par_iter()
                .filter_map(|c| {
                    let with: Vec<usize> = set.iter().copied().chain([c]).collect();
                    Some((c, Gain::new(&before, &self.left(&with)?)))
                })
                .filter(|(_, g)| {
                    g.sure() && !g.harms() && g.group.iter().any(|(share, _)| *share > LEAST_GAIN)
                })
                .max_by(|a, b| a.1.score.total_cmp(&b.1.score));
            let Some((candidate, gain)) = best else { break };
            let most = gain.most();
            set.push(candidate);
            let within =
                |(k, value, _): &Estimate| (value - self.filed[*k]).abs() < TOLERANCE * self.spike[*k];
            let found = self.estimates(&set, candidate, &ALL).unwrap_or_default();
            out.push(Step {
                within_tolerance: found.iter().all(within),
                candidate,
                gain: gain.group[most].0,
                gain_sigma: gain.group[most].1,
            });
        }
        out
    }
}

/// Whether a parameter is linear enough: it enters forces, torques or the drive, and is no limit.
fn linear(model: &Model, k: usize) -> bool {
    let p = &model.parameters[k];
    matches!(p.enters, Enters::Dynamics | Enters::Drive) && p.name != "max_rotor_vel_rad_s"
}

/// Whether two offsets from nominal agree, given their standard errors.
fn alike(a: f64, a_sigma: f64, b: f64, b_sigma: f64) -> bool {
    (a - b).abs() < JOINT * (a_sigma * a_sigma + b_sigma * b_sigma).sqrt()
        || (1.0 / FACTOR..=FACTOR).contains(&(a / b))
}

impl Testimony {
    fn off(&self, e: &Estimate) -> f64 {
        e.1 - self.filed[e.0]
    }

    /// Whether held-out flight gains by the candidate, without a loss anywhere.
    pub fn gains(&self) -> bool {
        self.gain > SURE * self.gain_sigma && !self.harms
    }

    /// Whether the pilot's response to something else could look like it, see [`OWN_SHARE`].
    pub fn could_be_an_answer(&self) -> bool {
        let shares = self.force_gain.iter().chain(&self.torque_gain);
        self.answers && shares.fold(0.0f64, |a, b| a.max(*b)) < OWN_SHARE
    }

    /// The parameter for which force and torque give different values: from force, from torque.
    pub fn split(&self) -> Option<(Estimate, Estimate)> {
        self.by_force.iter().find_map(|f| {
            let t = self.by_torque.iter().find(|t| t.0 == f.0)?;
            (!alike(self.off(f), f.2, self.off(t), t.2)).then_some((*f, *t))
        })
    }
}

/// Whether a posterior (mean and standard deviation, by parameter) agrees with a testimony.
///
/// The witness is mute where it could not see the claimed effect, or where a pilot's response could look the same. It
/// differs where held-out flight does not gain, where its estimate of a visible parameter has another sign or size, and
/// where force and torque give different values.
pub(crate) fn agreement(testimony: &Testimony, mean: &[f64], sigma: &[f64]) -> Agreement {
    let off = |k: usize| mean[k] - testimony.filed[k];
    let gains = testimony.gains();
    let differs = |e: &Estimate| Agreement::Differs {
        parameter: e.0,
        claimed: mean[e.0],
        found: e.1,
        sigma: e.2,
        gains,
    };
    let seen: Vec<&Estimate> =
        testimony.values.iter().filter(|(k, _, error)| off(*k).abs() > VISIBLE * error).collect();
    if seen.is_empty() || testimony.could_be_an_answer() {
        return Agreement::Mute;
    }
    // The one furthest off in standard errors decides.
    let far = |e: &Estimate| (e.1 - mean[e.0]).abs() / e.2.max(1e-300);
    let furthest = |keep: &dyn Fn(&Estimate) -> bool| {
        seen.iter().filter(|e| keep(e)).max_by(|a, b| far(a).total_cmp(&far(b))).map(|e| differs(e))
    };
    if let Some(differs) = furthest(&|e| !alike(testimony.off(e), e.2, off(e.0), sigma[e.0])) {
        return differs;
    }
    if let Some((force, torque)) = testimony.split() {
        return differs(if far(&force) > far(&torque) { &force } else { &torque });
    }
    if gains { Agreement::Agrees } else { furthest(&|_| true).unwrap_or(Agreement::Mute) }
}
